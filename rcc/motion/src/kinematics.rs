//! Kinematics of arms, without allocation and with bounded work, so that they can run in every cycle: those that Takt
//! knows by name in closed form, any other serial arm by the structure of its axes. Not here: dynamics or tools.

mod chain;
mod geometry;
mod joints;
mod numeric;
mod opw;
mod parallel;
mod primitives;
mod serial;
mod srs;
mod structure;
#[cfg(test)]
mod tests;
mod wrist;
mod youbot;

use std::sync::Arc;

use takt_net::JointLimits;
use takt_net::device::Kinematics;

pub use chain::{Axis, Chain};
pub(crate) use geometry::rot_z;
use geometry::{frame, rot_y, two_links};
pub use joints::Range;
use joints::{Nearest, ON_LIMIT, checked, columns_or_nan, joints_or_nan};
pub use opw::{Opw, OpwGeometry};
pub(crate) use primitives::table;
pub(crate) use serial::Fixed;
pub use serial::{JOINTS_MAX, Joint, JointKind, Serial, SerialError};
pub use srs::{Srs, SrsGeometry};
pub use structure::Structure;
pub use youbot::YouBot;

/// The kinematics of an arm by the name of its model, with the joint ranges of its data sheet:
/// `staubli_tx90`, `kuka_lwr4`, `kuka_iiwa7`, `kuka_iiwa14`, `kuka_youbot` or `kuka_youbot_upright`.
pub fn named(model: &str) -> Option<Arc<dyn Kinematics>> {
    Some(match model {
        "staubli_tx90" => Arc::new(Opw::staubli_tx90()),
        "kuka_lwr4" => Arc::new(Srs::kuka_lwr4()),
        "kuka_iiwa7" => Arc::new(Srs::kuka_iiwa7()),
        "kuka_iiwa14" => Arc::new(Srs::kuka_iiwa14()),
        "kuka_youbot" => Arc::new(YouBot::default()),
        "kuka_youbot_upright" => Arc::new(YouBot::upright(YouBot::UPRIGHT_RANGES)),
        _ => return None,
    })
}

/// As [`named`], with the joint limits of a particular arm; `None` also if the number of limits is
/// not the number of joints.
pub fn limited(model: &str, limits: &[JointLimits]) -> Option<Arc<dyn Kinematics>> {
    Some(match model {
        "staubli_tx90" => Arc::new(Opw::staubli_tx90().within(ranges(limits)?)),
        "kuka_lwr4" => Arc::new(Srs::kuka_lwr4().within(ranges(limits)?)),
        "kuka_iiwa7" => Arc::new(Srs::kuka_iiwa7().within(ranges(limits)?)),
        "kuka_iiwa14" => Arc::new(Srs::kuka_iiwa14().within(ranges(limits)?)),
        "kuka_youbot" => Arc::new(YouBot::new(ranges(limits)?)),
        "kuka_youbot_upright" => Arc::new(YouBot::upright(ranges(limits)?)),
        _ => return None,
    })
}

/// The ranges of all joints, from the limits of an arm.
fn ranges<const N: usize>(limits: &[JointLimits]) -> Option<[Range; N]> {
    let limits: [JointLimits; N] = limits.try_into().ok()?;
    Some(limits.map(Range::from))
}
