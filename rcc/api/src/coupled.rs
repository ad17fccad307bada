//! An object that several arms hold, and its motions: the arms move with it as one, and brake as one.

use std::sync::Arc as Shared;

use crate::activity::Activity;
use crate::arm::Arm;
use crate::error::{Error, ErrorKind};
use crate::motion::{CartesianLimits, CoupledMotion, Holder, Route};
use crate::order::Speed;
use crate::pose::Pose;
use crate::session::Session;

/// An object that two or more arms hold. Poses are those of the object in the world, in which the arms have their
/// [bases](Arm::with_base).
#[derive(Clone, Debug)]
pub struct Coupled {
    session: Shared<Session>,
    holders: Vec<Holder>,
    limits: CartesianLimits,
    speed: Speed,
}

/// Couples arms that hold an object, which is at `object` in the world now: each arm keeps its flange where it is now in
/// the object.
///
/// # Errors
/// If an arm is offline or its kinematics are not known, the arms are of different cells, or their bases are not
/// connected.
#[track_caller]
pub fn coupled<'a>(
    object: impl Into<Pose>,
    arms: impl IntoIterator<Item = &'a Arm>,
) -> Result<Coupled, Error> {
    let object = object.into();
    let arms: Vec<_> = arms.into_iter().collect();
    let Some(first) = arms.first() else {
        return Err(ErrorKind::Invalid("no arm holds the object".to_owned()).into());
    };
    if !object.is_finite() {
        return Err(ErrorKind::Invalid("the pose of the object is not finite".to_owned()).into());
    }
    let session = Shared::clone(first.session());
    if !arms
        .iter()
        .all(|arm| Shared::ptr_eq(arm.session(), &session))
    {
        let text = "arms of different cells cannot be coupled";
        return Err(ErrorKind::Invalid(text.to_owned()).into());
    }
    // An arm that is placed nowhere has its base at the origin of what the others are placed in.
    let mut bases = arms.iter().map(|arm| arm.base_frame());
    if let Some(base) = bases.find(|base| !base.is_root()) {
        let others = bases.filter(|other| !other.is_root());
        others
            .map(|other| other.placed_in(base))
            .collect::<Result<Vec<_>, _>>()?;
    }
    let holder = |arm: &&Arm| {
        let description = arm.description();
        let flange = description.pose(&arm.commanded().map_err(|error| error.kind)?);
        let flange = flange.ok_or_else(|| description.no_model())?;
        Ok(Holder {
            arm: description.clone(),
            base: arm.base(),
            grasp: object.inverse() * arm.base() * flange,
        })
    };
    Ok(Coupled {
        holders: arms.iter().map(holder).collect::<Result<_, ErrorKind>>()?,
        session,
        limits: CartesianLimits::default(),
        speed: Speed::FULL,
    })
}

impl Coupled {
    /// The same object with these limits on its motions.
    #[must_use]
    pub const fn with_limits(mut self, limits: CartesianLimits) -> Self {
        self.limits = limits;
        self
    }

    /// The same object, slower: the speed of its motions is multiplied by `factor`, above 0 to 1.
    #[must_use]
    pub fn with_speed(mut self, factor: f64) -> Self {
        self.speed = self.speed.times(factor);
        self
    }

    /// A motion of the object along a straight line to a pose in the world. Where an arm cannot follow, or fails, all arms
    /// brake on the line, and the activity ends with an error when they are at rest.
    pub fn lin(&self, to: impl Into<Pose>) -> Activity {
        self.motion(Route::Line(to.into()))
    }

    /// A motion of the object along the arc through `via` to `to`, both in the world.
    pub fn circ(&self, via: impl Into<Pose>, to: impl Into<Pose>) -> Activity {
        let (via, to) = (via.into(), to.into());
        self.motion(Route::Arc { via, to })
    }

    /// A motion of the object along a smooth curve through 1 to 63 poses in the world.
    pub fn spline<P: Into<Pose>>(&self, through: impl IntoIterator<Item = P>) -> Activity {
        let points = through.into_iter().map(Into::into).collect();
        self.motion(Route::Spline(points))
    }

    fn motion(&self, route: Route) -> Activity {
        let motion = CoupledMotion {
            holders: self.holders.clone(),
            route,
            limits: self.limits,
        };
        Activity::new(&self.session, motion, self.speed)
    }
}
