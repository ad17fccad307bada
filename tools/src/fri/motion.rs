//! A small motion of one joint in the cycle of its controller: it starts when the robot follows, and ends at rest whatever
//! happens. Its path is that of the drivers' last stage. It has no thread and no clock; `shift` requests and reports.
//!
//! ```text
//!           (1) requested, robot follows               (2) at the goal
//!   Idle ────────────────────────────────▶ Moving ─────────────────▶ Arrived
//!    │ (5) beyond the range                │  │ (3) stop requested, bad quality
//!    ▼                                     │  └────────▶ Braking ──(4) at rest──▶ Stopped
//!   Beyond          Left ◀──(6) command mode left┴────────────┘
//! ```
//! 1 and 5 are in [`Motion::begin`], 6 and 3 at the top of [`Motion::next`], 2 and 4 in [`Motion::advance`]; a position
//! withheld by the session leads from Moving to Braking too.

use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};

use takt_core::device::last_stage::LastStage;
use takt_fri::client::{AXES, Client, Phase, Quality, Version, Withheld};
use takt_fri::sunrise::wire::CommandMode;
use takt_net::JointLimits;

use super::live::Task;

/// Gentle: reaches 10 deg/s in a third of a second, rad/s².
const ACCELERATION: f64 = 0.5;
/// Margin to the ranges of the data sheets, rad: 2 degrees.
pub(super) const MARGIN_RAD: f64 = 0.034_906_585;

/// The requested motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Goal {
    /// Index of the joint, 0 to 6.
    pub(super) joint: usize,
    /// Distance, rad, either sign.
    pub(super) by_rad: f64,
    /// Largest speed, rad/s, above zero.
    pub(super) speed: f64,
}

impl Goal {
    /// Limits of the joint in this motion.
    fn limits(&self, version: Version) -> JointLimits {
        let range = version.position_max_rad()[self.joint] - MARGIN_RAD;
        JointLimits {
            position_min: -range,
            position_max: range,
            velocity_max: self.speed,
            acceleration_max: ACCELERATION,
        }
    }
}

/// State of the motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum MotionState {
    /// The robot does not follow, or no motion is requested.
    Idle,
    Moving,
    Braking,
    /// At rest at the goal.
    Arrived,
    /// At rest before the goal, after braking.
    Stopped,
    /// The robot stopped following.
    Left,
    /// The goal is out of range.
    Beyond,
}

impl MotionState {
    const ALL: [Self; 7] = [
        Self::Idle,
        Self::Moving,
        Self::Braking,
        Self::Arrived,
        Self::Stopped,
        Self::Left,
        Self::Beyond,
    ];

    /// Whether it is final.
    pub(super) fn is_end(self) -> bool {
        match self {
            Self::Idle | Self::Moving | Self::Braking => false,
            Self::Arrived | Self::Stopped | Self::Left | Self::Beyond => true,
        }
    }
}

/// The request of the user.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
enum Request {
    Hold,
    Move,
    Brake,
}

/// Why a motion braked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum BrakeCause {
    Requested,
    Quality,
    Withheld,
}

/// Exchange between the user and the cycle.
#[derive(Debug, Default)]
pub(super) struct Control {
    request: AtomicU8,
    state: AtomicU8,
    cause: AtomicU8,
}

impl Control {
    /// Requests the motion.
    pub(super) fn start(&self) {
        self.request.store(Request::Move as u8, Ordering::Relaxed);
    }

    /// Requests to brake.
    pub(super) fn brake(&self) {
        self.request.store(Request::Brake as u8, Ordering::Relaxed);
    }

    /// State of the motion.
    pub(super) fn state(&self) -> MotionState {
        let code = usize::from(self.state.load(Ordering::Acquire));
        let state = MotionState::ALL.get(code).copied();
        state.unwrap_or(MotionState::Idle)
    }

    /// Why it brakes; valid once it does.
    pub(super) fn cause(&self) -> BrakeCause {
        match self.cause.load(Ordering::Relaxed) {
            code if code == BrakeCause::Quality as u8 => BrakeCause::Quality,
            code if code == BrakeCause::Withheld as u8 => BrakeCause::Withheld,
            _ => BrakeCause::Requested,
        }
    }

    fn request(&self) -> Request {
        match self.request.load(Ordering::Relaxed) {
            code if code == Request::Move as u8 => Request::Move,
            code if code == Request::Brake as u8 => Request::Brake,
            _ => Request::Hold,
        }
    }
}

/// The motion, in the cycle.
pub(super) struct Motion {
    goal: Goal,
    control: Arc<Control>,
    state: MotionState,
    start: [f64; AXES],
    /// The joint on its path, once it moves.
    stage: Option<LastStage>,
}

impl Motion {
    pub(super) fn new(goal: Goal, control: Arc<Control>) -> Self {
        Self {
            goal,
            control,
            state: MotionState::Idle,
            start: [0.0; AXES],
            stage: None,
        }
    }

    fn enter(&mut self, state: MotionState) {
        self.state = state;
        self.control.state.store(state as u8, Ordering::Release);
    }

    fn brake(&mut self, cause: BrakeCause) {
        self.control.cause.store(cause as u8, Ordering::Relaxed);
        self.enter(MotionState::Braking);
    }

    /// Target of the joint, rad.
    fn target(&self) -> f64 {
        self.start[self.goal.joint] + self.goal.by_rad
    }

    /// Starts, if everything is ready.
    fn begin(&mut self, client: &mut Client, is_sound: bool) {
        let accepts = accepts_positions(client.status().overlay);
        let follows = client.phase() == Phase::Command && accepts;
        let is_ready = self.control.request() == Request::Move && is_sound && follows;
        if !is_ready || client.engage().is_err() {
            return;
        }
        self.start = client.mirror();
        let limits = client.version().map(|version| self.goal.limits(version));
        let from = self.start[self.goal.joint];
        self.stage = limits.map(|limits| LastStage::moving(limits, from, 0.0));
        let is_within = limits.is_some_and(|limits| self.target().abs() <= limits.position_max);
        self.enter(if is_within {
            MotionState::Moving
        } else {
            MotionState::Beyond
        });
    }

    fn advance(&mut self, dt_s: f64) {
        let target = self.target();
        let Some(stage) = &mut self.stage else {
            return;
        };
        match self.state {
            MotionState::Moving => {
                stage.track(target, 0.0, dt_s);
                let (position, velocity, _) = stage.motion();
                if position.to_bits() == target.to_bits() && velocity.abs() < f64::EPSILON {
                    self.enter(MotionState::Arrived);
                }
            }
            MotionState::Braking => {
                stage.brake(dt_s);
                if stage.motion().1.abs() < f64::EPSILON {
                    self.enter(MotionState::Stopped);
                }
            }
            MotionState::Idle
            | MotionState::Arrived
            | MotionState::Stopped
            | MotionState::Left
            | MotionState::Beyond => {}
        }
    }

    fn next(&mut self, client: &mut Client, cycles: u32) -> Option<[f64; AXES]> {
        let is_sound = client.status().quality.is_some_and(Quality::is_sound);
        match self.state {
            MotionState::Idle => self.begin(client, is_sound),
            MotionState::Moving | MotionState::Braking if client.phase() != Phase::Command => {
                self.enter(MotionState::Left);
            }
            MotionState::Moving if self.control.request() == Request::Brake => {
                self.brake(BrakeCause::Requested);
            }
            MotionState::Moving if !is_sound => self.brake(BrakeCause::Quality),
            MotionState::Moving
            | MotionState::Braking
            | MotionState::Arrived
            | MotionState::Stopped
            | MotionState::Left
            | MotionState::Beyond => {}
        }
        // At its end the session holds it: a position that is commanded further would be a jump after a re-entry.
        let is_commanded = matches!(self.state, MotionState::Moving | MotionState::Braking);
        let dt_s = client.period()?.as_secs_f64();
        for _ in 0..cycles {
            self.advance(dt_s);
        }
        let mut joints = self.start;
        if let Some(stage) = &self.stage {
            joints[self.goal.joint] = stage.motion().0;
        }
        (is_commanded && client.phase() == Phase::Command).then_some(joints)
    }
}

/// Whether an overlay, if there is one, accepts joint positions of the client.
pub(super) fn accepts_positions(overlay: Option<CommandMode>) -> bool {
    overlay.is_none_or(|mode| mode == CommandMode::Position)
}

impl Task for Motion {
    fn joints(&mut self, partner: &mut Client, cycles: u32) -> Option<[f64; AXES]> {
        self.next(partner, cycles)
    }

    /// It brakes from its position: the guard accepts that, since speeds only fall.
    fn handle_withheld(&mut self, _withheld: Withheld) {
        if self.state == MotionState::Moving {
            self.brake(BrakeCause::Withheld);
        }
    }

    /// A motion does not continue after the robot re-entered command mode.
    fn handle_entered(&mut self) {
        match self.state {
            MotionState::Moving | MotionState::Braking => self.enter(MotionState::Left),
            MotionState::Idle
            | MotionState::Arrived
            | MotionState::Stopped
            | MotionState::Left
            | MotionState::Beyond => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;
    use takt_fri::client::ClientConfig;
    use takt_fri::lwr::emulator::{Krc, KrcConfig};
    use takt_fri::sunrise::emulator::{Cabinet, CabinetConfig};
    use takt_fri::sunrise::wire::MESSAGE_MAX;

    /// An emulated controller in virtual time and the motion of its client; commanded positions, cycle by cycle.
    struct Bench<C> {
        controller: C,
        client: Client,
        motion: Motion,
        control: Arc<Control>,
        path: Vec<f64>,
    }

    trait Controller {
        fn due(&self) -> Duration;
        fn send(&mut self, now: Duration, buf: &mut [u8]) -> Option<usize>;
        fn take(&mut self, bytes: &[u8], now: Duration);
        fn joints(&self) -> [f64; AXES];
        /// Switches the power of the drives.
        fn switch(&mut self, is_on: bool);
    }

    impl Controller for Krc {
        fn due(&self) -> Duration {
            self.poll_timeout()
        }
        fn send(&mut self, now: Duration, buf: &mut [u8]) -> Option<usize> {
            self.poll_transmit(now, buf)
        }
        fn take(&mut self, bytes: &[u8], now: Duration) {
            self.handle_datagram(bytes, now).map(drop).unwrap();
        }
        fn joints(&self) -> [f64; AXES] {
            self.joints()
        }
        fn switch(&mut self, is_on: bool) {
            self.set_power(is_on);
        }
    }

    impl Controller for Cabinet {
        fn due(&self) -> Duration {
            self.poll_timeout()
        }
        fn send(&mut self, now: Duration, buf: &mut [u8]) -> Option<usize> {
            self.poll_transmit(now, buf)
        }
        fn take(&mut self, bytes: &[u8], now: Duration) {
            self.handle_datagram(bytes, now).map(drop).unwrap();
        }
        fn joints(&self) -> [f64; AXES] {
            self.joints()
        }
        fn switch(&mut self, is_on: bool) {
            self.set_power(is_on);
        }
    }

    impl<C: Controller> Bench<C> {
        fn new(controller: C, goal: Goal) -> Self {
            let control = Arc::new(Control::default());
            control.start();
            Self {
                controller,
                client: Client::new(ClientConfig::default()),
                motion: Motion::new(goal, Arc::clone(&control)),
                control,
                path: Vec::new(),
            }
        }

        /// Runs until `done`, at most a minute; answers only if `answers`.
        fn run(&mut self, answers: bool, done: impl Fn(&Self) -> bool) {
            let (mut message, mut answer) = ([0; MESSAGE_MAX], [0; MESSAGE_MAX]);
            while !done(self) && self.controller.due() < Duration::from_secs(60) {
                let now = self.controller.due();
                while let Some(len) = self.controller.send(now, &mut message) {
                    let received = self.client.handle_datagram(&message[..len], now).unwrap();
                    if received.has_entered {
                        self.motion.handle_entered();
                    }
                    let joints = self
                        .motion
                        .joints(&mut self.client, u32::from(received.lost) + 1);
                    self.path
                        .extend(joints.map(|joints| joints[self.motion.goal.joint]));
                    let Ok(built) = self.client.answer(joints.as_ref(), &mut answer) else {
                        continue;
                    };
                    assert_eq!(built.withheld, None);
                    if answers {
                        self.controller.take(&answer[..built.len], now);
                    }
                }
            }
        }

        fn at_end(&self) -> bool {
            self.control.state().is_end()
        }

        /// Largest commanded speed and acceleration, by differences.
        fn worst(&self) -> [f64; 2] {
            let dt_s = self.client.period().unwrap().as_secs_f64();
            let rates = |values: &[f64]| -> Vec<f64> {
                values
                    .windows(2)
                    .map(|pair| (pair[1] - pair[0]) / dt_s)
                    .collect()
            };
            let speeds = rates(&self.path);
            let worst = |all: &[f64]| all.iter().fold(0.0_f64, |worst, it| worst.max(it.abs()));
            [worst(&speeds), worst(&rates(&speeds))]
        }
    }

    fn goal(by_deg: f64) -> Goal {
        Goal {
            joint: 3,
            by_rad: by_deg.to_radians(),
            speed: 0.1,
        }
    }

    fn krc() -> Krc {
        Krc::new(KrcConfig::default(), Duration::ZERO)
    }

    fn cabinet() -> Cabinet {
        Cabinet::new(CabinetConfig::default(), Duration::ZERO)
    }

    fn arrives<C: Controller>(controller: C, by_deg: f64) {
        let before = controller.joints();
        let mut bench = Bench::new(controller, goal(by_deg));
        bench.run(true, Bench::at_end);
        assert_eq!(bench.control.state(), MotionState::Arrived);
        let [speed, acceleration] = bench.worst();
        assert!(speed < 0.1 + 1e-6, "{speed}");
        assert!(acceleration < ACCELERATION + 1e-3, "{acceleration}");
        let (settled, sent) = (
            bench.controller.due() + Duration::from_millis(200),
            bench.path.len(),
        );
        bench.run(true, |bench| bench.controller.due() > settled);
        assert_eq!(bench.path.len(), sent, "held, and not commanded further");
        for (joint, (now, before)) in bench.controller.joints().iter().zip(before).enumerate() {
            let moved = if joint == 3 { by_deg.to_radians() } else { 0.0 };
            assert!(
                (now - before - moved).abs() < 1e-4,
                "joint {joint}: {}",
                now - before
            );
        }
    }

    #[test]
    fn fri_move_arrives_within_speed_and_acceleration() {
        arrives(krc(), 3.0);
        arrives(krc(), -0.01);
        arrives(cabinet(), -3.0);
    }

    #[test]
    fn fri_move_brakes_to_rest_on_request() {
        let mut bench = Bench::new(krc(), goal(8.0));
        bench.run(true, |bench| bench.path.len() > 500);
        bench.control.brake();
        bench.run(true, Bench::at_end);
        assert_eq!(
            (bench.control.state(), bench.control.cause()),
            (MotionState::Stopped, BrakeCause::Requested)
        );
        assert!(bench.worst()[1] < ACCELERATION + 1e-3);
        let distance = bench.path.last().unwrap() - bench.path.first().unwrap();
        assert!((0.05..0.13).contains(&distance), "{distance}");
    }

    #[test]
    fn fri_move_out_of_range_is_not_started() {
        let config = KrcConfig {
            joints: [0.0, 0.0, 0.0, 115.0_f64.to_radians(), 0.0, 0.0, 0.0],
            ..KrcConfig::default()
        };
        let mut bench = Bench::new(Krc::new(config, Duration::ZERO), goal(4.0));
        bench.run(true, Bench::at_end);
        assert_eq!(bench.control.state(), MotionState::Beyond);
        assert!(bench.path.is_empty());
    }

    #[test]
    fn fri_move_ends_when_command_mode_is_left() {
        let mut bench = Bench::new(krc(), goal(8.0));
        bench.run(true, |bench| bench.path.len() > 500);
        bench.run(false, Bench::at_end);
        // Either the quality falls first, or the state changes.
        assert!(matches!(
            bench.control.state(),
            MotionState::Left | MotionState::Stopped
        ));
        let len = bench.path.len();
        let at = bench.controller.joints();
        let later = bench.controller.due() + Duration::from_secs(5);
        bench.run(true, |bench| bench.controller.due() > later);
        let distance = bench.controller.joints()[3] - at[3];
        assert!(distance.abs() < 0.02, "{distance} rad after {len} commands");
    }

    /// Power fails in motion and returns: the joint brakes, and nothing moves afterwards.
    fn is_left_without_power<C: Controller>(controller: C) {
        let mut bench = Bench::new(controller, goal(8.0));
        bench.run(true, |bench| bench.path.len() > 500);
        bench.controller.switch(false);
        bench.run(true, Bench::at_end);
        assert_eq!(bench.control.state(), MotionState::Left);
        assert!(bench.worst()[1] < ACCELERATION + 1e-3);
        let after = |bench: &mut Bench<C>, ms| {
            let until = bench.controller.due() + Duration::from_millis(ms);
            bench.run(true, |bench| bench.controller.due() > until);
            bench.controller.joints()
        };
        let at = after(&mut bench, 1_000);
        bench.controller.switch(true);
        let commands = bench.path.len();
        let later = after(&mut bench, 5_000);
        assert!((later[3] - at[3]).abs() < 1e-6, "{at:?} {later:?}");
        assert_eq!(bench.path.len(), commands, "commands after it was left");
    }

    #[test]
    fn fri_move_ends_when_power_is_lost() {
        is_left_without_power(krc());
        is_left_without_power(cabinet());
    }

    #[test]
    fn fri_move_ends_when_command_mode_is_reentered() {
        let timing = takt_fri::lwr::emulator::Timing {
            misses_max: 1_000,
            bad_from: 0.0,
            ..Default::default()
        };
        let config = KrcConfig {
            timing,
            ..KrcConfig::default()
        };
        let mut bench = Bench::new(Krc::new(config, Duration::ZERO), goal(8.0));
        bench.run(true, |bench| bench.path.len() > 500);
        bench.controller.faults_mut().to_client.drop_next = 60;
        bench.run(true, Bench::at_end);
        assert_eq!(bench.control.state(), MotionState::Left);
    }

    #[test]
    fn fri_move_without_request_commands_nothing() {
        let mut bench = Bench::new(cabinet(), goal(8.0));
        bench
            .control
            .request
            .store(Request::Hold as u8, Ordering::Relaxed);
        bench.run(true, |bench| {
            bench.controller.due() > Duration::from_secs(5)
        });
        assert!(bench.path.is_empty());
        assert_eq!(bench.control.state(), MotionState::Idle);
    }
}
