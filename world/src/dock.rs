//! Places where mobile bases dock, with a switch that closes within a tolerance. They hold no base: they only sense.

use crate::geometry::Pose;
use nalgebra::UnitQuaternion;

/// A place where a base docks, for [`Builder::dock`](crate::Builder::dock): a switch there is closed while the base is within
/// the tolerance.
#[derive(Debug, Clone, PartialEq)]
pub struct DockConfig {
    /// Its name, unique among docks.
    pub name: String,
    /// The base.
    pub base: String,
    /// Where the base is to be, in the world; m.
    pub pose: Pose,
    /// Guides centre a base that is nearer than this, m: fully within 0.3 of it.
    pub guides_m: f64,
    /// Along the floor, m.
    pub tolerance_m: f64,
    /// rad.
    pub tolerance_rad: f64,
}

#[derive(Debug, Clone)]
pub(crate) struct Dock {
    pub(crate) config: DockConfig,
    pub(crate) base: usize,
}

/// Share of the range of the guides within which they centre fully.
const CENTRED: f64 = 0.3;

impl Dock {
    /// Where the guides bring a base that drives there.
    pub(crate) fn guided(&self, base: &Pose) -> Pose {
        let off = self.config.pose.inverse() * base;
        let way = off.translation.vector.xy().norm();
        if way >= self.config.guides_m {
            return *base;
        }
        let left = (way - CENTRED * self.config.guides_m) / (1.0 - CENTRED);
        let share = (left / way.max(1e-9)).max(0.0);
        let turn = UnitQuaternion::from_scaled_axis(off.rotation.scaled_axis() * share);
        let left = off.translation.vector * share;
        self.config.pose * Pose::from_parts(left.into(), turn)
    }

    /// How much a base that drives there is within the guides: 0 outside, 1 where they centre fully.
    pub(crate) fn nearness(&self, base: &Pose) -> f64 {
        let guides = self.config.guides_m;
        let off = self.config.pose.inverse() * base;
        let way = off.translation.vector.xy().norm();
        ((guides - way) / (guides * (1.0 - CENTRED)).max(1e-9)).clamp(0.0, 1.0)
    }

    /// Whether the switch is closed while the base is there.
    pub(crate) fn is_closed(&self, base: &Pose) -> bool {
        let off = self.config.pose.inverse() * base;
        let is_near = off.translation.vector.xy().norm() <= self.config.tolerance_m;
        is_near && off.rotation.angle() <= self.config.tolerance_rad
    }
}
