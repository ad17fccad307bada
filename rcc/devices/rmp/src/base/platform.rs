//! One or two power bases as a platform that nets command, with the last stage: every command sent keeps the limits
//! of the base. It has no link and reads no clock.

use std::ops::{Deref, DerefMut};
use std::time::Duration;

use takt_can::rmp::{
    self, ACCELERATION, Channel, DriverConfig, Model, Motion, Omni, OmniConfig, State, YawSign,
};

use super::{ROTATION_MAX, VELOCITY_MAX};
use crate::config::RmpConfig;
use takt_core::device::DeviceStatus;
use takt_core::device::last_stage::{Limited, PlanarLimits, PlanarStage};

/// A platform and the last stage of its commands.
#[derive(Debug)]
pub(super) struct Led {
    platform: Platform,
    stage: PlanarStage,
    /// Period of commands, s.
    period_s: f64,
}

impl Deref for Led {
    type Target = Platform;

    fn deref(&self) -> &Platform {
        &self.platform
    }
}

impl DerefMut for Led {
    fn deref_mut(&mut self) -> &mut Platform {
        &mut self.platform
    }
}

impl Led {
    pub(super) fn new(config: &RmpConfig) -> Self {
        Self {
            platform: Platform::of(config),
            stage: PlanarStage::new(PlanarLimits {
                velocity: [VELOCITY_MAX, ROTATION_MAX],
                acceleration: ACCELERATION,
            }),
            period_s: config.period.as_secs_f64(),
        }
    }

    /// Whether it is at rest by its last command.
    pub(super) fn rests(&self) -> bool {
        self.stage.rests()
    }

    /// Limit reports of its last stage: along the floor, and turning.
    pub(super) const fn limited(&self) -> &[Limited; 2] {
        self.stage.limited()
    }

    /// Frames of the due command towards a velocity; without one it brakes.
    pub(super) fn command(
        &mut self,
        wanted: Option<[f64; 3]>,
        now: Duration,
    ) -> [Option<takt_can::Frame>; 2] {
        let bounded = self.bound(wanted, now);
        self.platform.transmit(bounded, now)
    }

    /// The velocity of the due command; `None` once the base rests and no net moves it.
    fn bound(&mut self, wanted: Option<[f64; 3]>, now: Duration) -> Option<[f64; 3]> {
        if !self.platform.follows() {
            self.stage.rest();
            return wanted;
        }
        if now >= self.platform.poll_timeout() {
            let platform = &self.platform;
            let wanted = wanted.map(|[ahead, left, turn]| [ahead, platform.left(left), turn]);
            self.stage
                .step(wanted, |twist| platform.reach(twist), self.period_s);
        }
        let rests = wanted.is_none() && self.stage.rests();
        (!rests).then(|| self.stage.velocity())
    }
}

/// One power base or two.
#[derive(Debug)]
pub(super) enum Platform {
    One(Box<rmp::Base>),
    Two(Box<Omni>),
}

impl Platform {
    fn of(config: &RmpConfig) -> Self {
        let [linear, angular] = ACCELERATION;
        let driver = DriverConfig {
            model: Model::named(&config.model).unwrap_or_default(),
            yaw_integral: YawSign::named(&config.yaw_integral).unwrap_or_default(),
            period: config.period,
            ..DriverConfig::default()
        };
        if config.links.len() == 2 {
            Self::Two(Box::new(Omni::new(OmniConfig {
                driver,
                acceleration: linear,
                angular_acceleration: angular,
                ..OmniConfig::default()
            })))
        } else {
            Self::One(Box::new(rmp::Base::new(driver, linear, angular)))
        }
    }

    pub(super) fn handle(
        &mut self,
        part: usize,
        channel: Channel,
        frame: &takt_can::Frame,
        now: Duration,
    ) {
        match self {
            Self::One(base) => base.handle_frame(channel, frame, now),
            Self::Two(omni) => omni.handle_frame(part, channel, frame, now),
        };
    }

    fn transmit(
        &mut self,
        wanted: Option<[f64; 3]>,
        now: Duration,
    ) -> [Option<takt_can::Frame>; 2] {
        match self {
            Self::One(base) => {
                let wanted = wanted.map(|[ahead, _, turn]| [ahead, turn]);
                [base.poll_transmit(wanted, now), None]
            }
            Self::Two(omni) => omni.poll_transmit(wanted, now),
        }
    }

    /// When the next command is due.
    pub(super) fn poll_timeout(&self) -> Duration {
        match self {
            Self::One(base) => base.poll_timeout(),
            Self::Two(omni) => omni.poll_timeout(),
        }
    }

    /// The share of a velocity that it can drive.
    fn reach(&self, twist: [f64; 3]) -> f64 {
        match self {
            Self::One(base) => {
                let [ahead, _, turn] = twist;
                base.reach([ahead, turn])
            }
            Self::Two(omni) => omni.reach(twist),
        }
    }

    /// The lateral part of a velocity that it can drive: none with two wheels.
    const fn left(&self, velocity: f64) -> f64 {
        match self {
            Self::One(_) => 0.0,
            Self::Two(_) => velocity,
        }
    }

    pub(super) fn motion(&self) -> &Motion {
        match self {
            Self::One(base) => base.motion(),
            Self::Two(omni) => omni.motion(),
        }
    }

    pub(super) fn follows(&self) -> bool {
        match self {
            Self::One(base) => base.driver().follows(),
            Self::Two(omni) => omni.follows(),
        }
    }

    pub(super) fn states(&self) -> [Option<State>; 2] {
        match self {
            Self::One(base) => [Some(base.driver().state()), None],
            Self::Two(omni) => omni.drivers().each_ref().map(|driver| Some(driver.state())),
        }
    }

    pub(super) fn status(&self) -> DeviceStatus {
        if self
            .states()
            .into_iter()
            .flatten()
            .all(|state| state == State::Ready)
        {
            return DeviceStatus::Operational;
        }
        let absent = |state| matches!(state, State::Silent | State::PoweredOff);
        if self.states().into_iter().flatten().any(absent) {
            DeviceStatus::Offline
        } else {
            DeviceStatus::SafeOperational
        }
    }

    pub(super) fn jumps(&self) -> u64 {
        match self {
            Self::One(base) => base.jumps(),
            Self::Two(omni) => omni.jumps(),
        }
    }

    /// The latest of these times.
    pub(super) const fn jump(&self) -> Option<rmp::Jump> {
        match self {
            Self::One(base) => base.jump(),
            Self::Two(omni) => omni.jump(),
        }
    }

    /// Angle and rate of each wheel, rad and rad/s.
    pub(super) fn wheels(&self) -> ([f64; 4], [f64; 4]) {
        match self {
            Self::One(base) => base.wheels(),
            Self::Two(omni) => (*omni.wheels(), *omni.rates()),
        }
    }
}
