//! The cells that a demo can show, and the emulated machines in them. What moves and how is in `motion`.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context as _;
use clap::ValueEnum;
use takt_core::cell::ControllerConfig;
use takt_core::device::driver::DriverConfig;
use takt_core::{CellConfig, Controller};
use takt_devices::ethercat::{self, Ethercat, EthercatConfig, Wire};
use takt_devices::fri::LwrConfig;
use takt_ethercat::emulator::{
    Coupler, DriveHandle, Segment, Server, ServoConfig, ServoDrive, SharedSegment, YouBot,
    YouBotConfig,
};
use takt_ethercat::linux::{CableEnd, cable, monotonic};
use takt_rt::Nanos;
use takt_rt::stats::stalls;

use super::motion;
use crate::emulate::{Robot, Service, resting};

/// The larger cell, as users write theirs.
const FACTORY: &str = include_str!("factory.toml");
/// Address of the master in a segment that has no other.
const MASTER: [u8; 6] = [2, 0, 0, 0, 0, 1];
/// Longest wait of an emulated segment for a frame, so that a stop is seen soon.
const WAIT: Duration = Duration::from_millis(5);
/// A turn of this length counts as a stall: its wait, and four cycles of the segments.
const STALL: Nanos = Nanos::from_millis(13);

/// A cell to show: two KUKA LWRs, or these beside a Stäubli TX90 and a KUKA youBot, each on an EtherCAT segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum Kind {
    Pair,
    Factory,
}

/// An arm of a cell, or a base.
#[derive(Clone, Copy, Debug)]
pub(super) struct Arm {
    pub(super) name: &'static str,
    /// What it is.
    pub(super) make: &'static str,
    /// Radius of its wheels, m, if it goes on wheels.
    pub(super) wheel: Option<f64>,
    /// Names of its joints, from the base, or of its wheels.
    pub(super) joints: &'static [&'static str],
}

const LEFT: Arm = Arm {
    name: "left",
    make: "KUKA LWR",
    wheel: None,
    joints: &takt_fri::lwr::JOINT_NAMES,
};
const RIGHT: Arm = Arm {
    name: "right",
    make: "KUKA LWR",
    wheel: None,
    joints: &takt_fri::lwr::JOINT_NAMES,
};
const TX90: Arm = Arm {
    name: "tx90",
    make: "Stäubli TX90",
    wheel: None,
    joints: &["J1", "J2", "J3", "J4", "J5", "J6"],
};

const ARM: Arm = Arm {
    name: "arm",
    make: "KUKA youBot arm",
    wheel: None,
    joints: &["A1", "A2", "A3", "A4", "A5"],
};
const BASE: Arm = Arm {
    name: "base",
    make: "KUKA youBot base",
    wheel: Some(0.0475),
    joints: &["front left", "front right", "rear left", "rear right"],
};

impl Kind {
    /// The nets that move all that can move, for a motion of that length.
    pub(super) fn nets(self, duration: Duration) -> Vec<String> {
        let parts = self.parts().iter();
        parts.map(|arms| motion::of(arms, duration)).collect()
    }

    /// What moves, by the net that moves it.
    pub(super) const fn parts(self) -> &'static [&'static [Arm]] {
        match self {
            Self::Pair => &[&[LEFT, RIGHT]],
            Self::Factory => &[&[LEFT, RIGHT], &[TX90], &[ARM], &[BASE]],
        }
    }

    /// What moves, in the order of the report.
    pub(super) const fn moved(self) -> &'static [Arm] {
        match self {
            Self::Pair => &[LEFT, RIGHT],
            Self::Factory => &[LEFT, RIGHT, TX90, ARM, BASE],
        }
    }

    /// The cell and, apart from it, the segments that are emulated inside of this process.
    pub(super) fn config(self) -> anyhow::Result<(CellConfig, Vec<EthercatConfig>)> {
        match self {
            Self::Pair => Ok((pair(), Vec::new())),
            Self::Factory => {
                let mut cell = takt_devices::parse_cell(FACTORY)?;
                cell.controller.websocket = None;
                let segments = cell.of_kind().cloned().collect();
                cell.buses.clear();
                Ok((cell, segments))
            }
        }
    }
}

/// Two LWRs, every address chosen by the system.
fn pair() -> CellConfig {
    let anywhere = SocketAddr::from(([127, 0, 0, 1], 0));
    let controller = ControllerConfig {
        websocket: None,
        tcp: Some(anywhere),
        // Between two datagrams, so that neither the arms' drivers nor the robots are in the way.
        follow: Some(LEFT.name.to_owned()),
        phase: Some(Duration::from_micros(500)),
        ..Default::default()
    };
    let lwr = |arm: Arm| -> Arc<dyn DriverConfig> { Arc::new(LwrConfig::new(arm.name, anywhere)) };
    CellConfig {
        controller,
        devices: [LEFT, RIGHT].map(lwr).into(),
        ..CellConfig::default()
    }
}

/// The emulated machines of a cell.
pub(super) struct Machines {
    /// Those of the LWRs, by name of the arm.
    pub(super) krcs: Vec<(String, Robot)>,
    segments: Vec<Service<Server<CableEnd>>>,
    wheels: Vec<DriveHandle>,
}

impl Machines {
    /// Starts them; this share of the datagrams of each KRC is lost in each direction.
    pub(super) fn start(
        controller: &Controller,
        segments: &[EthercatConfig],
        drop: f64,
    ) -> anyhow::Result<Self> {
        let addresses = controller.waits_at();
        let mut krcs = Vec::new();
        for (seed, (name, address)) in (1..).zip(addresses) {
            let mut config = resting(Duration::from_millis(1));
            config.seed = seed;
            config.faults.to_client.drop = drop;
            config.faults.to_krc.drop = drop;
            let robot = Robot::start(&format!("krc-{name}"), address, config)?;
            krcs.push((name, robot));
        }
        let mut machines = Self {
            krcs,
            segments: Vec::new(),
            wheels: Vec::new(),
        };
        for config in segments {
            let slaves = machines.slaves(config)?;
            machines.segments.push(segment(controller, config, slaves)?);
        }
        Ok(machines)
    }

    /// The slaves that a segment is configured for.
    fn slaves(&mut self, config: &EthercatConfig) -> anyhow::Result<Segment> {
        if !config.youbot_bases.is_empty() {
            let (slaves, bot) = YouBot::segment(&YouBotConfig::default());
            self.wheels = bot.wheels.into_iter().collect();
            return Ok(slaves);
        }
        let mut tx90 = ServoConfig::tx90();
        // A host without PREEMPT_RT sometimes misses SYNC0, which the demo is not to show.
        for axis in &mut tx90.axes {
            axis.quirks.missing_set_points = None;
        }
        let (drives, _) =
            ServoDrive::slave(tx90).context("the configuration of the drive is invalid")?;
        Ok(Segment::line([Coupler::slave(), drives]))
    }

    /// Joint positions as an arm reports them, or the angles of the emulated wheels of a base.
    pub(super) fn positions(&self, controller: &Controller, arm: Arm) -> Vec<f64> {
        if arm.name == BASE.name {
            return self
                .wheels
                .iter()
                .map(|wheel| wheel.lock().angle())
                .collect();
        }
        let state = controller.arm_state(arm.name).unwrap_or_default();
        let joints = state.joints.iter().take(arm.joints.len());
        joints
            .map(|joint| joint.measured_position.unwrap_or(f64::NAN))
            .collect()
    }

    pub(super) fn stop(self) -> anyhow::Result<()> {
        for (_, robot) in self.krcs {
            robot.stop()?;
        }
        for segment in self.segments {
            segment.stop()?;
        }
        Ok(())
    }
}

/// Serves a segment inside of this process, and gives it to the controller.
fn segment(
    controller: &Controller,
    config: &EthercatConfig,
    slaves: Segment,
) -> anyhow::Result<Service<Server<CableEnd>>> {
    let slaves = SharedSegment::new(slaves);
    let (near, far) = cable();
    // An emulated segment that stalls puts its devices into fault, as one without power does.
    let (mut stalls, stood_still) = stalls();
    controller.watch_stalls(&format!("emulated {}", config.name), stood_still);
    let mut last = takt_rt::monotonic();
    let service = Service::start(&config.name, Server::new(slaves, far), move |server| {
        let turn = server.turn(WAIT, &mut monotonic);
        let now = takt_rt::monotonic();
        let took = now - std::mem::replace(&mut last, now);
        if took > STALL {
            stalls.note(now, took);
        }
        turn.map(|_| ()).context("the cable failed")
    })?;
    let wire = Wire {
        link: Box::new(near),
        source: MASTER,
    };
    let devices = ethercat::describe(config);
    controller.add_driver(&config.name, devices, config.thread, |ends| {
        Ok(Box::new(Ethercat::start(config, wire, ends)?))
    })?;
    Ok(service)
}
