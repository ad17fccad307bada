//! Faults in the middle of an assembly, by name, and when each of them begins. The program that assembles does not know them: it
//! meets their effects.

use std::fmt;
use std::str::FromStr;

use takt_world::{BodyTruth, EventKind, Truth, World};

use crate::watch::{AT_HOLE, CARRIED};

/// How far the base docks beside its place, m: twice the tolerance of its switch.
const BESIDE: f64 = 0.008;
/// Friction of oiled pads: 38 N do not hold a box with them, 80 N do. Of one of 1.4 kg each hand carries 6.9 N: they hold 0.7 and
/// 1.46 times that.
const OILED: f64 = 0.105;
/// Friction of pads that hold no box at all.
const SOAKED: f64 = 0.01;
/// Depth at which burrs stop the peg, m.
const BURRS: f64 = 0.01;
/// Where the base is at its dock, and where it has driven away again, beyond the guides, x, m.
const DOCK: [f64; 2] = [0.97, 1.02];
/// Speed at which a box counts as carried, m/s.
const MOVES: f64 = 0.05;

/// A fault of an assembly.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// The base docks 8 mm off, once.
    DocksBeside,
    /// The base docks 8 mm off each time.
    StaysBeside,
    /// There is oil on the pads of the right hand: a box slips until it is grasped harder.
    Slips,
    /// No force holds a box in the right hand.
    StaysSlippery,
    /// The peg is not in its box.
    NoPeg,
    /// Burrs stop the peg, once.
    Jams,
    /// Burrs stop the peg each time.
    StaysJammed,
    /// The screw bites askew, once.
    CrossThreads,
    /// The screw bites askew each time.
    StaysAskew,
    /// The right arm loses its network while both arms carry a box: the first one, or after a hand has slipped at that, the second.
    ArmLost,
    /// The program is killed then.
    ProgramKilled,
    /// The controller is killed then.
    ControllerKilled,
}

/// Each fault and its name on command lines.
const NAMES: [(Fault, &str); 12] = [
    (Fault::DocksBeside, "docks-beside"),
    (Fault::StaysBeside, "stays-beside"),
    (Fault::Slips, "slips"),
    (Fault::StaysSlippery, "stays-slippery"),
    (Fault::NoPeg, "no-peg"),
    (Fault::Jams, "jams"),
    (Fault::StaysJammed, "stays-jammed"),
    (Fault::CrossThreads, "cross-threads"),
    (Fault::StaysAskew, "stays-askew"),
    (Fault::ArmLost, "arm-lost"),
    (Fault::ProgramKilled, "program-killed"),
    (Fault::ControllerKilled, "controller-killed"),
];

impl Fault {
    /// Each of them.
    pub fn all() -> impl Iterator<Item = Self> {
        NAMES.iter().map(|(fault, _)| *fault)
    }

    /// Whether the assembly is completed nevertheless.
    #[must_use]
    pub const fn is_overcome(self) -> bool {
        matches!(
            self,
            Self::DocksBeside | Self::Slips | Self::Jams | Self::CrossThreads
        )
    }

    /// Words of the error by which it ends the assembly; of one that is overcome, none.
    #[must_use]
    pub const fn named_by(self) -> &'static str {
        match self {
            Self::DocksBeside | Self::Slips | Self::Jams | Self::CrossThreads => "",
            Self::StaysBeside => "the base docks beside its place twice",
            Self::StaysSlippery => "a hand slips at its largest force",
            Self::NoPeg => "box 1 has no peg",
            Self::StaysJammed => "the peg jams",
            Self::StaysAskew => "the screw is tight",
            Self::ArmLost => "right",
            Self::ProgramKilled => "signal: 9",
            Self::ControllerKilled => "connection",
        }
    }

    /// Whether it is none of the world: see [`Faults::poll`].
    #[must_use]
    pub const fn is_outside(self) -> bool {
        matches!(
            self,
            Self::ArmLost | Self::ProgramKilled | Self::ControllerKilled
        )
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut names = NAMES.iter().filter(|(fault, _)| fault == self);
        f.write_str(names.next().map_or("", |(_, name)| name))
    }
}

impl FromStr for Fault {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = NAMES.iter().find(|(_, name)| *name == text);
        found.map(|(fault, _)| *fault).ok_or_else(|| {
            let names = NAMES.map(|(_, name)| name).join(", ");
            format!("there is no fault `{text}`\nhint: the faults are {names}")
        })
    }
}

/// Faults of one assembly.
#[derive(Clone, Debug)]
pub struct Faults {
    world: World,
    faults: Vec<Fault>,
    has_docked: bool,
    has_jammed: bool,
    has_begun: bool,
}

impl Faults {
    /// Those of an assembly in a world whose robots have not started. Several that are overcome may be given together.
    #[must_use]
    pub fn new(world: &World, faults: &[Fault]) -> Self {
        let has = |fault| faults.contains(&fault);
        if has(Fault::NoPeg) {
            world.remove_body("peg");
        }
        if has(Fault::Slips) || has(Fault::StaysSlippery) {
            let friction = if has(Fault::Slips) { OILED } else { SOAKED };
            world.oil("right", friction);
        }
        world.turn_knobs(|knobs| {
            if has(Fault::DocksBeside) || has(Fault::StaysBeside) {
                knobs.docking_offset = [BESIDE, 0.0, 0.0];
            }
            if has(Fault::Jams) || has(Fault::StaysJammed) {
                knobs.obstructed_m = Some(BURRS);
            }
            knobs.cross_threads = has(Fault::CrossThreads) || has(Fault::StaysAskew);
        });
        Self {
            world: world.clone(),
            faults: faults.to_vec(),
            has_docked: false,
            has_jammed: false,
            has_begun: false,
        }
    }

    /// Ends what does not last, as the truth proceeds. Returns once, at its time, the fault that the caller is to cause: an arm
    /// without its network, or a killed process.
    pub fn poll(&mut self, truth: &Truth) -> Option<Fault> {
        for fault in self.faults.clone() {
            match fault {
                Fault::DocksBeside => self.dock(truth),
                Fault::Slips if is_unloaded(truth) => {
                    self.world.oil("right", 1.0);
                }
                Fault::Jams => self.jam(truth),
                Fault::CrossThreads if has_bitten(truth) => {
                    self.world.turn_knobs(|knobs| knobs.cross_threads = false);
                }
                Fault::StaysBeside
                | Fault::Slips
                | Fault::StaysSlippery
                | Fault::NoPeg
                | Fault::StaysJammed
                | Fault::CrossThreads
                | Fault::StaysAskew
                | Fault::ArmLost
                | Fault::ProgramKilled
                | Fault::ControllerKilled => {}
            }
        }
        let outside = self.faults.iter().find(|fault| fault.is_outside());
        let is_first = !self.faults.contains(&Fault::Slips);
        let is_due = (is_first || is_unloaded(truth)) && is_carried(truth);
        let outside = outside.filter(|_| !self.has_begun && is_due);
        self.has_begun |= outside.is_some();
        outside.copied()
    }

    /// The base docks in its place once it has driven away from the dock.
    fn dock(&mut self, truth: &Truth) {
        let Some((_, base)) = truth.bases.first().filter(|_| truth.at.is_some()) else {
            return;
        };
        let [arrived, left] = DOCK;
        self.has_docked |= base.translation.x < arrived;
        if self.has_docked && base.translation.x > left {
            let knobs = |knobs: &mut takt_world::Knobs| knobs.docking_offset = [0.0; 3];
            self.world.turn_knobs(knobs);
        }
    }

    /// The burrs are gone once the peg is drawn back from them.
    fn jam(&mut self, truth: &Truth) {
        let peg = truth.pegs.first().filter(|peg| peg.offset_m < AT_HOLE);
        let depth = peg.map_or(f64::NAN, |peg| peg.depth_m);
        self.has_jammed |= depth > BURRS * 0.9;
        if self.has_jammed && depth < 0.0 {
            self.world.turn_knobs(|knobs| knobs.obstructed_m = None);
        }
    }
}

/// A box in both hands.
pub(crate) fn carried(truth: &Truth) -> Option<&BodyTruth> {
    truth.bodies.iter().find(|body| body.held_by.len() == 2)
}

fn is_carried(truth: &Truth) -> bool {
    carried(truth)
        .is_some_and(|body| body.pose.translation.z > CARRIED && body.twist.linear.norm() > MOVES)
}

/// Whether the first box stands on the bench, and no hand holds it.
fn is_unloaded(truth: &Truth) -> bool {
    let first = truth.body("box_1").filter(|body| body.held_by.is_empty());
    first.is_some_and(|body| body.pose.translation.x < 0.5 && body.pose.translation.z < CARRIED)
}

/// Whether the screw has bitten askew.
fn has_bitten(truth: &Truth) -> bool {
    let askew = |kind: &EventKind| matches!(kind, EventKind::CrossThreaded { .. });
    truth.first(|event| askew(&event.kind)).is_some()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What the program says, and by what its faults are recognized, do not drift apart.
    #[test]
    fn fault_words_are_those_of_program() {
        let program = include_str!("../../api/examples/assembly/program.rs");
        let by_program = Fault::all().filter(|fault| !fault.is_outside());
        for fault in by_program {
            let words = fault.named_by();
            assert!(program.contains(words), "{fault}: {words}");
            assert_eq!(words.is_empty(), fault.is_overcome(), "{fault}");
        }
    }

    #[test]
    fn fault_name_reads_back_and_unknown_lists_all() {
        for fault in Fault::all() {
            assert_eq!(fault.to_string().parse(), Ok(fault));
        }
        let error = "peg".parse::<Fault>().unwrap_err();
        assert!(error.contains("docks-beside, stays-beside"), "{error}");
    }
}
