//! The cells that a demo can show, and what moves in them. The emulated machines are in `takt_embedded`; how they move is
//! in `motion`.

use std::time::Duration;

use clap::ValueEnum;
use takt_core::Controller;
use takt_embedded::Machines;

use super::motion;

/// A cell to show: two KUKA LWRs, or these beside a Stäubli TX90 and a KUKA youBot, each on an EtherCAT segment, or with grippers, a
/// screwdriver and a youBot base in a world of bodies, or a test station of three servomotors at EtherCAT terminals.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum Kind {
    Pair,
    Factory,
    Assembly,
    Lola,
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

/// The machine of the test station, its arm and the axes of that.
pub(super) const MACHINE: &str = include_str!("../../../examples/machine/station/lola.machine");
pub(super) const AXES: [&str; 3] = ["axis0", "axis1", "axis2"];
pub(super) const STATION: Arm = Arm {
    name: "arm",
    make: "three servo axes",
    wheel: None,
    joints: &["J1", "J2", "J3"],
};

impl Kind {
    /// The nets that move all that can move, for a motion of that length; the machine that does so on the station. A program makes those
    /// of the assembly while it runs.
    pub(super) fn nets(self, duration: Duration) -> Vec<String> {
        if self == Self::Lola {
            return vec![MACHINE.to_owned()];
        }
        let parts = self.parts().iter();
        parts.map(|arms| motion::of(arms, duration)).collect()
    }

    /// What moves, by the net that moves it.
    pub(super) const fn parts(self) -> &'static [&'static [Arm]] {
        match self {
            Self::Pair => &[&[LEFT, RIGHT]],
            Self::Factory => &[&[LEFT, RIGHT], &[TX90], &[ARM], &[BASE]],
            Self::Assembly | Self::Lola => &[],
        }
    }

    /// What moves, in the order of the report.
    pub(super) const fn moved(self) -> &'static [Arm] {
        match self {
            Self::Pair => &[LEFT, RIGHT],
            Self::Factory => &[LEFT, RIGHT, TX90, ARM, BASE],
            Self::Assembly => &[LEFT, RIGHT, BASE],
            Self::Lola => &[STATION],
        }
    }

    /// The name of the emulated cell.
    pub(super) const fn cell(self) -> &'static str {
        match self {
            Self::Pair => "two_lwr",
            Self::Factory => "factory",
            Self::Assembly => "assembly",
            Self::Lola => "lola",
        }
    }
}

/// Joint positions as an arm reports them, or the angles of the emulated wheels of a base.
pub(super) fn positions(machines: &Machines, controller: &Controller, arm: Arm) -> Vec<f64> {
    if arm.name == BASE.name {
        let wheels = machines.wheels().iter();
        return wheels.map(|wheel| wheel.lock().angle()).collect();
    }
    let state = controller.arm_state(arm.name).unwrap_or_default();
    let joints = state.joints.iter().take(arm.joints.len());
    joints
        .map(|joint| joint.measured_position.unwrap_or(f64::NAN))
        .collect()
}
