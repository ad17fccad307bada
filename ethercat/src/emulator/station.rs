//! Three DC servomotors on terminals: a coupler, digital inputs (proximity switches, amplifiers ready), digital outputs (brakes,
//! enables), an analogue output of three channels, and three encoder terminals with latch and counter. The motors are one model
//! that all terminals share; a test reads their true angles and injects faults.

mod encoder;
mod motor;

use std::ops::{Deref, DerefMut};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

pub use motor::{StationFaults, StationMotor};

use crate::AlState;
use crate::sii::Identity;
use encoder::EncoderTerminal;
use motor::Motor;

use super::application::{Application, Cycle};
use super::image::{PdoImage, SiiImage};
use super::segment::Segment;
use super::slave::{Slave, SlaveConfig};
use super::terminal::{Coupler, VENDOR};

/// Number of motors.
pub const STATION_AXES: usize = 3;
/// Full scale of an analogue output: 10 V.
const FULL_SCALE: f64 = 32_767.0;

/// Positions of the slaves on the segment: the encoder terminals follow from [`Station::ENCODER`] on.
#[derive(Clone, Debug)]
pub struct Station {
    motors: Arc<Mutex<[Motor; STATION_AXES]>>,
    shown: Arc<[Shown; STATION_AXES]>,
}

/// What is seen of a motor, read without the lock: who looks must not hold up a segment that runs in real time.
#[derive(Debug, Default)]
struct Shown {
    /// Bits of the angle, degrees.
    angle: AtomicU64,
    is_braked: AtomicBool,
}

/// The motors while a slave works on them; what is seen of them is renewed at its end.
struct Motors<'a> {
    motors: MutexGuard<'a, [Motor; STATION_AXES]>,
    shown: &'a [Shown; STATION_AXES],
}

impl Deref for Motors<'_> {
    type Target = [Motor; STATION_AXES];

    fn deref(&self) -> &Self::Target {
        &self.motors
    }
}

impl DerefMut for Motors<'_> {
    fn deref_mut(&mut self) -> &mut Self::Target {
        &mut self.motors
    }
}

impl Drop for Motors<'_> {
    fn drop(&mut self) {
        for (motor, shown) in self.motors.iter().zip(self.shown) {
            let angle = motor.angle().to_bits();
            shown.angle.store(angle, Ordering::Relaxed);
            shown.is_braked.store(motor.is_braked(), Ordering::Relaxed);
        }
    }
}

impl Station {
    /// Digital inputs: bits 0 to 2 the proximity switches, 3 to 5 the amplifiers that are ready.
    pub const INPUTS: usize = 1;
    /// Digital outputs: bits 0 to 2 release the brakes, 3 to 5 enable the amplifiers.
    pub const OUTPUTS: usize = 2;
    /// Analogue output: three channels of 16 bits, 7FFFh is +10 V.
    pub const ANALOGUE: usize = 3;
    /// The first encoder terminal.
    pub const ENCODER: usize = 4;

    /// The segment and this handle to its motors.
    pub fn segment(motors: [StationMotor; STATION_AXES]) -> (Segment, Self) {
        let station = Self {
            motors: Arc::new(Mutex::new(motors.map(Motor::new))),
            shown: Arc::default(),
        };
        drop(station.lock());
        let terminal = |part| Terminal {
            station: station.clone(),
            part,
        };
        let mut slaves = vec![
            Coupler::slave(),
            terminal(Part::Inputs).slave(),
            terminal(Part::Outputs).slave(),
            terminal(Part::Analogue).slave(),
        ];
        slaves.extend((0..STATION_AXES).map(|axis| EncoderTerminal::slave(station.clone(), axis)));
        (Segment::line(slaves), station)
    }

    fn lock(&self) -> Motors<'_> {
        Motors {
            motors: self.motors.lock().unwrap_or_else(PoisonError::into_inner),
            shown: &self.shown,
        }
    }

    /// The true angle of a joint, degrees; 0 for an axis that does not exist.
    pub fn angle(&self, axis: usize) -> f64 {
        let shown = self.shown.get(axis);
        shown.map_or(0.0, |it| f64::from_bits(it.angle.load(Ordering::Relaxed)))
    }

    /// Whether the brake of an axis holds.
    pub fn is_braked(&self, axis: usize) -> bool {
        let shown = self.shown.get(axis);
        shown.is_some_and(|it| it.is_braked.load(Ordering::Relaxed))
    }

    /// Sets the faults of an axis.
    pub fn inject(&self, axis: usize, faults: StationFaults) {
        if let Some(motor) = self.lock().get_mut(axis) {
            motor.faults = faults;
        }
    }

    /// The faults of an axis; none for an axis that does not exist.
    pub fn faults(&self, axis: usize) -> StationFaults {
        let motors = self.lock();
        motors
            .get(axis)
            .map_or_else(StationFaults::default, |motor| motor.faults)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Part {
    Inputs,
    Outputs,
    Analogue,
}

/// A terminal that several motors share.
#[derive(Debug)]
struct Terminal {
    station: Station,
    part: Part,
}

/// A slave with these PDOs.
fn slave(
    name: &str,
    product: u32,
    [rx, tx]: [Vec<PdoImage>; 2],
    application: Box<dyn Application>,
) -> Slave {
    let sii = SiiImage {
        identity: Identity {
            vendor: VENDOR,
            product,
            revision: 0x0001_0000,
            serial: 0,
        },
        order: name.split(' ').next().unwrap_or_default().to_owned(),
        name: name.to_owned(),
        ebus_ma: 100,
        rx_pdos: rx,
        tx_pdos: tx,
        device_emulation: true,
        ..SiiImage::default()
    };
    Slave::new(SlaveConfig::new(sii), application)
}

impl Terminal {
    fn slave(self) -> Slave {
        let pdos = |first: u16, object: u16, entry: (u8, u8, u8), sm, count: u16| {
            let (sub, bits, kind) = entry;
            let pdo = |n| PdoImage {
                index: first + n,
                sync_manager: sm,
                name: format!("channel {}", n + 1),
                entries: vec![(object + 0x10 * n, sub, bits, kind)],
            };
            (0..count).map(pdo).collect::<Vec<_>>()
        };
        let bit = (1, 1, 1);
        match self.part {
            Part::Inputs => {
                let tx = pdos(0x1A00, 0x6000, bit, 1, 6);
                slave("TK0006 digital", 0x2006, [Vec::new(), tx], Box::new(self))
            }
            Part::Outputs => {
                let rx = pdos(0x1600, 0x7000, bit, 0, 6);
                slave("TK0600 digital", 0x2600, [rx, Vec::new()], Box::new(self))
            }
            Part::Analogue => {
                let rx = pdos(0x1600, 0x7000, (1, 16, 3), 0, 3);
                slave("TK4034 analogue", 0x4034, [rx, Vec::new()], Box::new(self))
            }
        }
    }
}

impl Application for Terminal {
    fn cycle(&mut self, cycle: &Cycle<'_>, inputs: &mut [u8]) {
        let mut motors = self.station.lock();
        // Without OP all outputs are off.
        let outputs = cycle.outputs.filter(|_| cycle.state == AlState::Op);
        let outputs = outputs.unwrap_or_default();
        let bit = |n: usize| outputs.first().is_some_and(|byte| byte >> n & 1 != 0);
        match self.part {
            Part::Inputs => {
                let mut bits = 0;
                for (n, motor) in motors.iter().enumerate() {
                    bits |= u8::from(motor.proximity()) << n;
                    bits |= u8::from(motor.is_ready()) << (n + STATION_AXES);
                }
                inputs.iter_mut().take(1).for_each(|byte| *byte = bits);
            }
            Part::Outputs => {
                for (n, motor) in motors.iter_mut().enumerate() {
                    (motor.released, motor.enabled) = (bit(n), bit(n + STATION_AXES));
                }
            }
            Part::Analogue => {
                for (n, motor) in motors.iter_mut().enumerate() {
                    let raw = outputs.get(2 * n..).and_then(|rest| rest.first_chunk());
                    let raw = raw.map_or(0, |bytes| i16::from_le_bytes(*bytes));
                    motor.volts = f64::from(raw) / FULL_SCALE * 10.0;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests;
