//! Converts the cell's configuration of youBots to expected slaves and device descriptions. It opens nothing.

use takt_ethercat::config::{Location, SlaveSpec};
use takt_ethercat::youbot::{BarConfig, Gripper, TRINAMIC};
use takt_net::JointLimits;

use crate::config::{EthercatConfig, YouBotArm, YouBotBase};
use crate::segment::wire::wire_figures;
use takt_core::device::parts::with_figures;
use takt_core::device::{ArmDescription, DeviceDescription, Part};

/// Largest configurable motor current, A.
const CURRENT_MOST: f64 = 20.0;

/// Boards behind a power board.
const WHEELS: u16 = 4;
const JOINTS: u16 = 5;

/// Indices of the drives in the master.
#[derive(Debug, Default)]
pub(super) struct Places {
    pub(super) bases: Vec<[usize; 4]>,
    pub(super) arms: Vec<[usize; 5]>,
}

impl Places {
    /// They follow the individually configured slaves.
    pub(super) fn new(config: &EthercatConfig) -> Self {
        let first = config.slaves.len();
        let base = |n: usize| first + n * usize::from(WHEELS + 1) + 1;
        let behind = first + config.youbot_bases.len() * usize::from(WHEELS + 1);
        let arm = |n: usize| behind + n * usize::from(JOINTS + 1) + 1;
        Self {
            bases: (0..config.youbot_bases.len())
                .map(|n| std::array::from_fn(|i| base(n) + i))
                .collect(),
            arms: (0..config.youbot_arms.len())
                .map(|n| std::array::from_fn(|i| arm(n) + i))
                .collect(),
        }
    }
}

/// The slaves of all youBots: those of each base, then those of each arm.
pub(crate) fn specs(config: &EthercatConfig) -> impl Iterator<Item = SlaveSpec> {
    let bases = config.youbot_bases.iter();
    let bases = bases.map(|base| (base.name.as_str(), base.position, WHEELS, "wheel"));
    let arms = config.youbot_arms.iter();
    let arms = arms.map(|arm| (arm.name.as_str(), arm.position, JOINTS, "joint"));
    bases.chain(arms).flat_map(|(name, first, drives, what)| {
        (0..=drives).map(move |n| {
            let name = match n {
                0 => format!("{name} power board"),
                n => format!("{name} {what} {}", n - 1),
            };
            let place = Location::Position(first.saturating_add(n));
            SlaveSpec {
                vendor: Some(TRINAMIC),
                ..SlaveSpec::new(name, place)
            }
        })
    })
}

/// Their devices: bases, then each arm and its gripper.
pub(crate) fn describe(config: &EthercatConfig) -> impl Iterator<Item = DeviceDescription> {
    let bases = config.youbot_bases.iter().map(of_base);
    let arms = config.youbot_arms.iter().flat_map(|arm| {
        let gripper = arm.gripper.as_deref().map(of_gripper);
        std::iter::once(of_arm(arm)).chain(gripper)
    });
    bases.chain(arms)
}

/// The limits of the joints as nets count them.
pub(super) fn limits(arm: &YouBotArm) -> [JointLimits; 5] {
    let zero = arm.zero.offsets();
    std::array::from_fn(|i| JointLimits {
        position_min: arm.range[i][0].to_radians() - zero[i],
        position_max: arm.range[i][1].to_radians() - zero[i],
        velocity_max: arm.velocity_max[i].to_radians(),
        acceleration_max: arm.acceleration_max[i].to_radians(),
    })
}

pub(super) const ARM_PARTS: [Part; 5] = [
    Part::Strategy,
    Part::JointImpedance,
    Part::CartesianImpedance,
    Part::Torques,
    Part::Drives { count: 5 },
];

fn of_arm(arm: &YouBotArm) -> DeviceDescription {
    ArmDescription {
        name: arm.name.clone(),
        kind: "kuka_youbot_arm",
        limits: limits(arm).to_vec(),
        model: arm.zero.model().into(),
    }
    .with(&with_figures(&ARM_PARTS, wire_figures()))
}

pub(super) fn base_parts(base: &YouBotBase) -> [Part; 3] {
    [
        Part::Base {
            wheels: 4,
            velocity_max: base.velocity_max,
            rotation_max: base.rotation_max,
            acceleration_max: base.acceleration_max,
            rotation_acceleration_max: base.rotation_acceleration_max,
        },
        Part::CartesianPosition,
        Part::Drives { count: 4 },
    ]
}

fn of_base(base: &YouBotBase) -> DeviceDescription {
    DeviceDescription {
        name: base.name.clone(),
        kind: "kuka_youbot_base",
        limits: Vec::new(),
        model: "".into(),
        parts: with_figures(&base_parts(base), wire_figures()),
    }
}

pub(super) fn gripper_part() -> Part {
    Part::Gripper {
        distance_max: Gripper::new(BarConfig::default()).distance_max(),
    }
}

fn of_gripper(name: &str) -> DeviceDescription {
    DeviceDescription {
        name: name.to_owned(),
        kind: "kuka_youbot_gripper",
        limits: Vec::new(),
        model: "".into(),
        parts: with_figures(&[gripper_part()], wire_figures()),
    }
}

/// Checks the youBots of a segment; the master reports overlapping positions.
pub(crate) fn check(config: &EthercatConfig) -> Result<(), String> {
    let current = |amperes: f64| amperes > 0.0 && amperes <= CURRENT_MOST;
    for base in &config.youbot_bases {
        let positive = [
            base.velocity_max,
            base.rotation_max,
            base.acceleration_max,
            base.rotation_acceleration_max,
        ];
        if !positive.iter().all(|v| v.is_finite() && *v > 0.0) {
            return Err(format!(
                "youbot_base {}: velocity_max, rotation_max, acceleration_max and rotation_acceleration_max must be \
                 above 0 and finite",
                base.name
            ));
        }
        if !current(base.current_max) {
            return Err(format!(
                "youbot_base {}: current_max is {} A; it must be above 0, to {CURRENT_MOST} A",
                base.name, base.current_max
            ));
        }
    }
    for arm in &config.youbot_arms {
        check_arm(arm).map_err(|what| format!("youbot_arm {}: {what}", arm.name))?;
    }
    Ok(())
}

fn check_arm(arm: &YouBotArm) -> Result<(), String> {
    let currents = arm.current_max.iter().zip(&arm.homing_current);
    for (joint, (most, homing)) in currents.enumerate() {
        if !(*most > 0.0 && *most <= CURRENT_MOST) {
            return Err(format!(
                "joint {joint}: current_max is {most} A; it must be above 0, to {CURRENT_MOST} A"
            ));
        }
        if !(*homing > 0.0 && homing < most) {
            return Err(format!(
                "joint {joint}: homing_current is {homing} A; it must be above 0 and below current_max, {most} A"
            ));
        }
    }
    for (joint, limits) in limits(arm).iter().enumerate() {
        let JointLimits {
            position_min,
            position_max,
            velocity_max,
            acceleration_max,
        } = *limits;
        let all = [position_min, position_max, velocity_max, acceleration_max];
        let sound = all.iter().all(|value| value.is_finite())
            && position_min < position_max
            && velocity_max > 0.0
            && acceleration_max > 0.0;
        if !sound {
            return Err(format!(
                "joint {joint}: range must go up, velocity_max and acceleration_max must be above 0, all of them finite"
            ));
        }
    }
    Ok(())
}
