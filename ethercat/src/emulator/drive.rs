//! A CiA 402 drive over CoE with one to eight axes: the profile's emulated drive behind an object dictionary, with
//! configurable PDO assignment and mapping, and cycles by SYNC0 or by outputs (ETG.6010). The behaviour of an axis is
//! in `takt_cia402`.

mod objects;
mod pdo;

pub(super) use objects::counted;
pub(super) use pdo::{check_download as assignable, four as four_pdos};

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use takt_cia402::State;
use takt_cia402::dictionary::{AbortCode, Address, Dictionary, DictionaryError, Hooks, Key};
use takt_cia402::emulator::{Drive, DriveConfig, FaultCode, MotorConfig, Step};

use crate::sii::Identity;
use crate::{AlState, AlStatusCode, Emergency};

use super::application::{Application, Cycle, Setup};
use super::coe::CoeServer;
use super::image::SiiImage;
use super::slave::{ClockUnit, Slave, SlaveConfig};
use super::terminal::VENDOR;

use pdo::Pdos;

/// Default length of each mailbox, bytes.
const MAILBOX: u16 = 128;
/// CoE details: SDO, information, PDO assignment and configuration, complete access.
const COE: u8 = 0x2F;
/// The bits of information and of complete access.
const INFORMATION: u8 = 0x02;
const COMPLETE: u8 = 0x20;
/// Cycle times are whole multiples of this, ns.
const CYCLE_STEP: u32 = 125_000;
/// Bytes by which a mapping may exceed the default one, per axis.
const SPARE: u16 = 32;

/// Configuration of a drive.
#[derive(Clone, Debug)]
pub struct ServoConfig {
    /// Order code and name.
    pub name: String,
    /// Product code.
    pub product: u32,
    /// Its axes, one to eight.
    pub axes: Vec<DriveConfig>,
    /// Whether it runs in OP with SYNC0 only.
    pub needs_sync0: bool,
    /// Its clock: what it shows at power-on, ns, and its drift, ppb.
    pub clock: (u64, i64),
    /// Width of its clock.
    pub clock_unit: ClockUnit,
    /// Length of each of its two mailboxes, bytes.
    pub mailbox: u16,
    /// Its identity, unless it is the emulated servo with this product code.
    pub identity: Option<Identity>,
    /// CoE details: bit 0 SDO, 1 information, 2 PDO assignment, 3 PDO configuration, 5 complete access.
    pub coe: u8,
    /// Its PDOs.
    pub pdos: PdoSet,
    /// It acknowledges a new mapping of the same length, but continues to use the first one since power-on.
    pub keeps_mapping: bool,
}

/// The PDOs of a drive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PdoSet {
    /// One per direction and axis.
    #[default]
    One,
    /// Four per direction for one axis, all assigned. An object may not be mapped twice, but by default some are, so
    /// that it refuses SAFE-OP (001Dh) until other PDOs are assigned, though their lengths are right.
    Four,
}

impl Default for ServoConfig {
    /// One axis.
    fn default() -> Self {
        Self {
            name: "TK4021 servo".to_owned(),
            product: 0x4021,
            axes: vec![DriveConfig::default()],
            needs_sync0: false,
            clock: (0, 0),
            clock_unit: ClockUnit::Bits64,
            mailbox: MAILBOX,
            identity: None,
            coe: COE,
            pdos: PdoSet::One,
            keeps_mapping: false,
        }
    }
}

impl ServoConfig {
    /// A drive with these axes. Drives with other PDOs are other products, as a master distinguishes them by product
    /// code.
    pub fn with_axes(axes: Vec<DriveConfig>) -> Self {
        let more = u32::try_from(axes.len().saturating_sub(1)).unwrap_or(0);
        let product = 0x4021 + 0x100 * more;
        Self {
            name: format!("TK{product:04X} servo"),
            product,
            axes,
            ..Self::default()
        }
    }

    /// Its identity.
    fn identity(&self) -> Identity {
        self.identity.unwrap_or(Identity {
            vendor: VENDOR,
            product: self.product,
            revision: 0x0001_0000,
            serial: 1,
        })
    }

    /// A Stäubli TX90 with the drives of its uniVAL controller as one slave of six axes. The
    /// ranges are those of the arm; gears are taken as 50 to 1, and one turn of a motor has
    /// 4096 increments.
    pub fn tx90() -> Self {
        // Degrees of each joint.
        let ranges: [(f64, f64); 6] = [
            (-180.0, 180.0),
            (-130.0, 147.5),
            (-145.0, 145.0),
            (-270.0, 270.0),
            (-115.0, 140.0),
            (-270.0, 270.0),
        ];
        let axes = ranges.map(|(low, high)| {
            let (low, high) = (low.to_radians() * 50.0, high.to_radians() * 50.0);
            let mut axis = DriveConfig {
                motor: MotorConfig {
                    negative_limit: low,
                    positive_limit: high,
                    stops: (low - 10.0, high + 10.0),
                    rated_torque: 3.0,
                    inertia: 5e-4,
                    ..MotorConfig::default()
                },
                ..DriveConfig::default()
            };
            axis.quirks.supported_modes = 0x380;
            axis
        });
        Self {
            name: "TKTX90 uniVAL drive".to_owned(),
            product: 0x5458,
            axes: axes.to_vec(),
            needs_sync0: true,
            ..Self::default()
        }
    }
}

/// Keys of the sync objects.
#[derive(Clone, Copy, Debug)]
struct Keys {
    error_register: Key<u8>,
    sync_type: [Key<u16>; 2],
    cycle_time: [Key<u32>; 2],
    missed: Key<u16>,
    sync_error: Key<bool>,
    sync_error_limit: Key<u16>,
}

impl Keys {
    fn new(d: &Dictionary) -> Result<Self, DictionaryError> {
        let at = |index, sub| Address::new(index, sub);
        Ok(Self {
            error_register: d.key(at(0x1001, 0))?,
            sync_type: [d.key(at(0x1C32, 1))?, d.key(at(0x1C33, 1))?],
            cycle_time: [d.key(at(0x1C32, 2))?, d.key(at(0x1C33, 2))?],
            missed: d.key(at(0x1C32, 0x0B))?,
            sync_error: d.key(at(0x1C32, 0x20))?,
            sync_error_limit: d.key(at(0x10F1, 2))?,
        })
    }
}

/// The firmware of a drive.
#[derive(Debug)]
struct Firmware {
    config: ServoConfig,
    dictionary: Dictionary,
    axes: Vec<Drive>,
    keys: Keys,
    coe: CoeServer,
    pdos: Pdos,
    /// The first PDOs since power-on.
    kept: Option<Pdos>,
    state: AlState,
    /// OP ended while an axis had power.
    link_lost: bool,
}

/// Hooks of the dictionary before a write from the bus.
struct Rules<'a> {
    axes: &'a [Drive],
    state: AlState,
}

impl Hooks for Rules<'_> {
    fn before_upload(&mut self, d: &mut Dictionary, at: Address) -> Result<(), AbortCode> {
        for axis in self.axes {
            axis.before_upload(d, at)?;
        }
        Ok(())
    }

    fn before_download(
        &mut self,
        d: &Dictionary,
        at: Address,
        data: &[u8],
    ) -> Result<(), AbortCode> {
        pdo::check_download(d, at, data, self.state)?;
        for axis in self.axes {
            axis.check_download(d, at, data)?;
        }
        Ok(())
    }
}

impl Firmware {
    fn new(config: ServoConfig) -> Result<Self, DictionaryError> {
        let dictionary = Dictionary::new(objects::objects(&config))?;
        let axes = (0..).zip(&config.axes);
        let axes = axes.map(|(n, axis)| Drive::new(axis.clone(), n, &dictionary));
        let axes = axes.collect::<Result<_, _>>()?;
        Ok(Self {
            axes,
            keys: Keys::new(&dictionary)?,
            dictionary,
            coe: CoeServer::new(config.mailbox, config.coe & COMPLETE != 0)
                .with_information(config.coe & INFORMATION != 0),
            config,
            pdos: Pdos::default(),
            kept: None,
            state: AlState::Init,
            link_lost: false,
        })
    }

    /// Set-up by the master before SAFE-OP.
    fn check(&mut self, setup: &Setup) -> Result<(), AlStatusCode> {
        self.pdos = Pdos::new(&self.dictionary)?;
        if self.config.pdos == PdoSet::Four {
            pdo::check_twice(&self.dictionary)?;
        }
        if self.pdos.outputs() != usize::from(setup.outputs) {
            return Err(AlStatusCode(0x001D));
        }
        if self.pdos.inputs() != usize::from(setup.inputs) {
            return Err(AlStatusCode(0x001E));
        }
        let kept = self.kept.get_or_insert_with(|| self.pdos.clone());
        let as_long = (kept.outputs(), kept.inputs()) == (self.pdos.outputs(), self.pdos.inputs());
        if self.config.keeps_mapping && as_long {
            self.pdos = kept.clone();
        }
        let k = self.keys;
        for (sync_type, cycle_time) in k.sync_type.into_iter().zip(k.cycle_time) {
            match (setup.sync0, self.dictionary.get(sync_type)) {
                (None, 2 | 3) => return Err(AlStatusCode(0x0030)),
                (None, _) => {}
                (Some(cycle), _) if !cycle.is_multiple_of(CYCLE_STEP) => {
                    return Err(AlStatusCode(0x0035));
                }
                (Some(cycle), _) => {
                    self.dictionary.set(sync_type, 2);
                    self.dictionary.set(cycle_time, cycle);
                }
            }
        }
        Ok(())
    }

    /// The next master may not use SYNC0: the set-up of the previous one is dropped in INIT.
    fn forget_sync0(&mut self) {
        for sync_type in self.keys.sync_type {
            self.dictionary.set(sync_type, objects::SYNC_BY_OUTPUTS);
        }
    }

    fn step(&mut self, cycle: &Cycle<'_>, inputs: &mut [u8]) {
        if let Some(outputs) = cycle.outputs {
            self.pdos
                .unpack(&mut self.dictionary, &mut self.axes, outputs);
        }
        let k = self.keys;
        if cycle.synchronous && cycle.state == AlState::Op {
            let missed = self.dictionary.get(k.missed);
            let missed = missed.saturating_add(u16::from(!cycle.fresh));
            self.dictionary.set(k.missed, missed);
            self.dictionary.set(k.sync_error, !cycle.fresh);
        }
        let step = Step {
            dt: Duration::from_nanos(cycle.dt),
            set_point: cycle.fresh && cycle.outputs.is_some(),
            link_lost: self.link_lost,
        };
        for number in 0..self.axes.len() {
            let stepped = self.axes[number].step(&mut self.dictionary, &step);
            if let Some(code) = stepped.emergency {
                self.send_fault(number, code);
            }
        }
        self.pdos.pack(&self.dictionary, &mut self.axes, inputs);
    }

    /// Sends an emergency of an axis; its number is in the first byte of the manufacturer.
    fn send_fault(&mut self, axis: usize, code: FaultCode) {
        self.dictionary
            .set(self.keys.error_register, code.register());
        let mut data = [0; 5];
        data[0] = u8::try_from(axis).unwrap_or(0);
        self.coe.emergency(&Emergency {
            code: code.0,
            register: code.register(),
            data,
        });
    }

    fn is_powered(&self) -> bool {
        self.axes.iter().any(|axis| match axis.state() {
            State::SwitchedOn
            | State::OperationEnabled
            | State::QuickStopActive
            | State::FaultReactionActive => true,
            State::NotReadyToSwitchOn
            | State::SwitchOnDisabled
            | State::ReadyToSwitchOn
            | State::Fault => false,
        })
    }
}

/// A handle to an emulated drive, which its slave shares.
#[derive(Clone, Debug)]
pub struct ServoDrive(Arc<Mutex<Firmware>>);

impl ServoDrive {
    /// A slave with this drive, and a handle to it.
    ///
    /// # Errors
    /// If the objects make no dictionary: there are more than eight axes.
    pub fn slave(config: ServoConfig) -> Result<(Slave, Self), DictionaryError> {
        let mut slave = SlaveConfig::new(sii(&config));
        slave.clock = Some(super::Clock::new(config.clock.0, config.clock.1));
        slave.chip.clock = config.clock_unit;
        slave.needs_sync0 = config.needs_sync0;
        Self::with_controller(config, slave)
    }

    /// The same with another controller, SII and times.
    pub(super) fn with_controller(
        config: ServoConfig,
        slave: SlaveConfig,
    ) -> Result<(Slave, Self), DictionaryError> {
        let handle = Self(Arc::new(Mutex::new(Firmware::new(config)?)));
        Ok((Slave::new(slave, Box::new(handle.clone())), handle))
    }

    fn firmware(&self) -> MutexGuard<'_, Firmware> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Access to an axis, to push its motor or inject faults; `None` if there is no such axis.
    pub fn axis<R>(&self, number: usize, f: impl FnOnce(&mut Drive) -> R) -> Option<R> {
        self.firmware().axes.get_mut(number).map(f)
    }

    /// Access to its objects as their owner.
    pub fn dictionary<R>(&self, f: impl FnOnce(&mut Dictionary) -> R) -> R {
        f(&mut self.firmware().dictionary)
    }

    /// Sends an emergency without a fault.
    pub fn emergency(&self, emergency: &Emergency) {
        self.firmware().coe.emergency(emergency);
    }
}

impl Application for ServoDrive {
    fn enter(&mut self, state: AlState, setup: &Setup) -> Result<(), AlStatusCode> {
        if state == AlState::SafeOp {
            self.firmware().check(setup)?;
        }
        Ok(())
    }

    fn leave(&mut self, from: AlState, to: AlState) {
        let mut firmware = self.firmware();
        firmware.state = to;
        firmware.link_lost = match (from, to) {
            (_, AlState::Op) => false,
            (AlState::Op, _) => firmware.is_powered(),
            _ => firmware.link_lost,
        };
        if to == AlState::Init {
            firmware.coe.reset();
            firmware.forget_sync0();
        }
    }

    fn sync_errors(&self) -> Option<u32> {
        let firmware = self.firmware();
        let limit = firmware.dictionary.get(firmware.keys.sync_error_limit);
        Some(limit.into())
    }

    fn mailbox(&mut self, request: &[u8], reply: &mut Vec<u8>) -> bool {
        let firmware = &mut *self.firmware();
        let mut rules = Rules {
            axes: &firmware.axes,
            state: firmware.state,
        };
        let dictionary = &mut firmware.dictionary;
        firmware.coe.answer(request, reply, dictionary, &mut rules)
    }

    fn unasked(&mut self, message: &mut Vec<u8>) -> bool {
        self.firmware().coe.unasked(message)
    }

    fn cycle(&mut self, cycle: &Cycle<'_>, inputs: &mut [u8]) {
        self.firmware().step(cycle, inputs);
    }

    fn reset(&mut self) {
        let mut firmware = self.firmware();
        // It could be built before, so it can be built again.
        if let Ok(fresh) = Firmware::new(firmware.config.clone()) {
            *firmware = fresh;
        }
    }
}

fn sii(config: &ServoConfig) -> SiiImage {
    let axes = config.axes.len();
    SiiImage {
        identity: config.identity(),
        order: config.name.split(' ').next().unwrap_or_default().to_owned(),
        name: config.name.clone(),
        mailbox_len: config.mailbox,
        coe: config.coe,
        clock: true,
        rx_pdos: (0..axes).map(|axis| pdo::image(axis, true)).collect(),
        tx_pdos: (0..axes).map(|axis| pdo::image(axis, false)).collect(),
        spare: SPARE * u16::try_from(axes).unwrap_or(8),
        ..SiiImage::default()
    }
}
