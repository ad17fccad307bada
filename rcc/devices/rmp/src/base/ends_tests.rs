//! How a Segway RMP comes to rest when the net that drives it ends: the whole driver on a link to an emulated power
//! base, in virtual time.

use std::sync::{Mutex, MutexGuard};

use takt_can::AnyFrame;
use takt_can::link::{Link, LinkError, Origin, Received};
use takt_can::rmp::emulator::{Powerbase, PowerbaseConfig};
use takt_can::rmp::{ACCELERATION, Message};
use takt_rt::Nanos;
use takt_rt::latest::latest;

use takt_core::device::driver::DeviceEnd;
use takt_core::device::{DeviceCommand, DeviceState, parts};
use takt_net::device::Layout;
use takt_rt::latest::{LatestReader, LatestWriter};

use super::*;
use crate::plant::{Jumps, Plant, Row, Wire as Sent, velocity};

const MS: Duration = Duration::from_millis(1);

/// A power base at the end of a link, and what it was commanded last, m/s.
#[derive(Debug)]
struct Far {
    base: Powerbase,
    now: Duration,
    commanded: f64,
}

#[derive(Clone, Debug)]
struct Near(Arc<Mutex<Far>>);

impl Near {
    fn far(&self) -> MutexGuard<'_, Far> {
        self.0.lock().unwrap()
    }
}

impl Link for Near {
    fn send(&mut self, frame: &AnyFrame) -> Result<(), LinkError> {
        let mut far = self.far();
        let now = far.now;
        if let Some(frame) = frame.classic() {
            far.base.handle_frame(frame, now);
            if let Some(Message::Command(command)) = Message::decode(frame) {
                let scale = Model::default().scales().velocity;
                far.commanded = f64::from(command.velocity) / scale;
            }
        }
        Ok(())
    }

    fn receive(&mut self, _timeout: Duration) -> Result<Option<Received>, LinkError> {
        let mut far = self.far();
        let now = far.now;
        Ok(far.base.poll_transmit(now).map(|(_, frame)| Received {
            frame: frame.into(),
            at: now,
            hardware: None,
            origin: Origin::Bus,
            dropped: 0,
        }))
    }
}

/// The driver and its power base.
pub(super) struct Bench {
    driver: Driver,
    near: Near,
    command: LatestWriter<DeviceCommand>,
    state: LatestReader<DeviceState>,
}

impl Bench {
    pub(super) fn new() -> Self {
        let config = RmpConfig {
            model: Model::default().name().to_owned(),
            ..RmpConfig::new("base", &["near"])
        };
        let base = Powerbase::new(PowerbaseConfig {
            model: Model::default(),
            ..PowerbaseConfig::default()
        });
        let near = Near(Arc::new(Mutex::new(Far {
            base,
            now: Duration::ZERO,
            commanded: 0.0,
        })));
        let mut layout = Layout::default();
        let parts = describe(&config).parts;
        let _places = parts::lay(&parts, 0, &mut layout);
        let (driver_state, state) = latest(1, || DeviceState::new(layout.signals));
        let (command, driver_command) = latest(1, || DeviceCommand::new(layout.commands));
        let end = DeviceEnd {
            state: driver_state,
            command: driver_command,
            net_period: MS,
        };
        let mut bench = Self {
            driver: Driver {
                meters: vec![None],
                loads: vec![None],
                wires: vec![Wire::Can(Box::new(near.clone()))],
                platform: Led::new(&config),
                is_stopping: false,
                end: Endpoint::new(end, &parts, 0),
                taken_at: Duration::ZERO,
                jumps: 0,
                shared: Arc::default(),
                errors: vec![Arc::default()],
            },
            near,
            command,
            state,
        };
        for _ in 0..5_000 {
            bench.millisecond();
        }
        assert!(bench.driver.platform.follows());
        bench
    }

    fn millisecond(&mut self) {
        let now = {
            let mut far = self.near.far();
            far.now += MS;
            let now = far.now;
            far.base.advance(now);
            now
        };
        self.driver.receive();
        self.driver.lead(now);
    }
}

impl Plant for Bench {
    fn now(&self) -> Nanos {
        self.near.far().now.into()
    }

    fn run_to(&mut self, until: Nanos, given: &DeviceCommand, is_ending: bool) {
        self.driver.is_stopping = is_ending;
        self.command.write_with(|command| command.copy_from(given));
        while self.now() + MS.into() <= until {
            self.millisecond();
        }
    }

    fn copy_state(&mut self, state: &mut DeviceState) {
        self.state.read_with(|reported| state.copy_from(reported));
    }

    fn sent(&mut self) -> f64 {
        self.near.far().commanded
    }

    fn place(&mut self) -> f64 {
        self.near.far().base.truth().x
    }

    fn fail(&mut self, is_on: bool) {
        self.near.far().base.faults.emergency_stop = is_on;
    }
}

fn row() -> Row {
    let config = RmpConfig::new("base", &["near"]);
    Row {
        name: "Segway RMP",
        description: describe(&config),
        children: velocity(0.6),
        runs: 700,
        wire: Sent::Speeds,
        acceleration: ACCELERATION[0],
        resolution: 1.0 / Model::default().scales().velocity,
        latency: MS * 110,
        creep: 0.02,
        without: |_, _| None,
    }
}

#[test]
fn rmp_net_ends_commands_rest_within_stopping_time() {
    row().comes_to_rest(Bench::new);
}

/// Its integrators are reset behind the driver's back.
#[test]
fn rmp_odometry_jump_gives_scheduled_nets_back() {
    let jumps = Jumps {
        part: JumpPart::Floor,
        by: 1.0,
        is_fault: false,
    };
    jumps.check(&row(), Bench::new(), |bench| {
        bench.near.far().base.disturb_integrators(1.0);
    });
}
