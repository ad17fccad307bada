//! Settings and fault knobs of the emulated controller, with the defaults and where they come from. No behaviour.

use crate::emulator::{Contact, LineFaults, PowerOff, Sensing, Timing};
use crate::lwr::AXES;
use crate::lwr::Protocol;
use crate::lwr::wire::{Control, Quality};
use std::time::Duration;

/// Settings of an emulated controller.
#[derive(Debug, Clone, PartialEq)]
pub struct KrcConfig {
    /// Period of measurements and commands, 1 ms to 100 ms as friOpen accepts; values beyond are clamped.
    pub period: Duration,
    /// Joint positions at the start, rad.
    pub joints: [f64; AXES],
    /// Axis limits.
    pub limits: Limits,
    /// Time constant with which measured positions follow the set-point.
    pub lag: Duration,
    /// How answers are rated.
    pub timing: Timing,
    /// Largest deviation of a mirrored position from the set-point, rad; *assumption*: 0.01.
    pub mirror_tolerance_rad: f64,
    /// Control strategy at the start.
    pub control: Control,
    /// `$STIFFNESS`: used by the impedance modes unless the client commands other values.
    pub stiffness: Stiffness,
    /// What the tip of the tool touches.
    pub contact: Option<Contact>,
    /// Index of a digital signal of the client, from 0 to 15, that takes the contact away while it is true.
    pub contact_off: Option<u32>,
    /// Tip of the tool in the frame of the flange, m.
    pub tool_m: [f64; 3],
    /// How it estimates external forces.
    pub sensing: Sensing,
    /// A screwdriver at its user variables.
    pub screwdriver: Option<super::Screwdriver>,
    /// The KRL program.
    pub script: Script,
    /// Faults.
    pub faults: Faults,
    /// Random seed.
    pub seed: u64,
}

impl Default for KrcConfig {
    fn default() -> Self {
        Self {
            period: Duration::from_millis(2),
            joints: [0.0; AXES],
            limits: Limits::default(),
            lag: Duration::from_millis(10),
            timing: Timing::default(),
            mirror_tolerance_rad: 0.01,
            control: Control::Position,
            stiffness: Stiffness::default(),
            contact: None,
            contact_off: None,
            tool_m: [0.0; 3],
            sensing: Sensing::default(),
            screwdriver: None,
            script: Script::default(),
            faults: Faults::default(),
            seed: 1,
        }
    }
}

/// Axis limits, symmetric about zero. The ranges are published; existing drivers use this speed and acceleration for
/// every axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Largest absolute position, rad: alternating 170 and 120 degrees.
    pub position_rad: [f64; AXES],
    /// Largest absolute speed, rad/s, scaled by the argument of friStart: 112.5 degrees per second.
    pub speed_rad_per_s: [f64; AXES],
    /// Braking deceleration, rad/s2. Commanded accelerations are not checked: no such check is known.
    pub acceleration_rad_per_s2: [f64; AXES],
    /// Largest absolute added torque, Nm: the joint torques in the data sheet of the LWR 4+.
    pub torque_nm: [f64; AXES],
}

impl Default for Limits {
    fn default() -> Self {
        let degrees = [170.0, 120.0, 170.0, 120.0, 170.0, 120.0, 170.0_f64];
        Self {
            position_rad: degrees.map(f64::to_radians),
            speed_rad_per_s: [112.5_f64.to_radians(); AXES],
            acceleration_rad_per_s2: [4.0; AXES],
            torque_nm: [176.0, 176.0, 100.0, 100.0, 100.0, 38.0, 38.0],
        }
    }
}

/// Parameters of the impedance modes; the defaults are *assumptions*.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stiffness {
    /// Nm/rad, from 0: 1000.
    pub joint_stiffness: [f64; AXES],
    /// 0..=1: 0.7.
    pub joint_damping: [f64; AXES],
    /// X, Y, Z in N/m: 2000, then about Z, Y, X in Nm/rad: 200.
    pub cartesian_stiffness: [f64; 6],
    /// In the same order, 0..=1: 0.7.
    pub cartesian_damping: [f64; 6],
}

impl Default for Stiffness {
    fn default() -> Self {
        Self {
            joint_stiffness: [1000.0; AXES],
            joint_damping: [0.7; AXES],
            cartesian_stiffness: [2000.0, 2000.0, 2000.0, 200.0, 200.0, 200.0],
            cartesian_damping: [0.7; 6],
        }
    }
}

/// The KRL program after friOpen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Script {
    /// Nothing: the owner calls [`super::Krc::fri_start`] and [`super::Krc::fri_stop`].
    Manual,
    /// Waits for quality and drive power, then friStart.
    Auto {
        /// Quality to wait for.
        quality: Quality,
        /// Argument of friStart, 0..=1.
        scale: f64,
        /// Pause before the next friStart after command mode was lost; `None` stays in monitor mode.
        restart: Option<Duration>,
    },
    /// Executes the client's requests in user data.
    Handshake(Protocol),
}

impl Default for Script {
    fn default() -> Self {
        let restart = Some(Duration::from_secs(1));
        Self::Auto {
            quality: Quality::Perfect,
            scale: 1.0,
            restart,
        }
    }
}

/// Fault settings.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Faults {
    /// Measurements on the way to the client.
    pub to_client: LineFaults,
    /// Answers on the way to the controller.
    pub to_krc: LineFaults,
    /// A loss of drive power.
    pub power_off: Option<PowerOff>,
    /// Replaces the computed quality.
    pub quality: Option<Quality>,
    /// How slow the controller's clock runs, parts per million; at most 100,000 either way. Read at the start only.
    pub drift_ppm: f64,
}
