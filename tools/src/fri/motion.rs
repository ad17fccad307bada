//! A small motion of one joint in the cycle of its controller: begun when the robot follows, ended at rest whatever
//! happens. No thread, no clock; who asks and who is told is in `shift`.
//!
//! ```text
//!           (1) told to go, robot follows              (2) there
//!   Idle ────────────────────────────────▶ Moving ─────────────────▶ Arrived
//!    │ (5) beyond the range                │  │ (3) told to brake, bad quality
//!    ▼                                     │  └────────▶ Braking ──(4) at rest──▶ Stopped
//!   Beyond          Left ◀──(6) command mode left┴────────────┘
//! ```
//! 1 and 5 are made in [`Motion::begin`], 6 and 3 at the top of [`Motion::next`], 2 and 4 in [`Motion::advance`]; a
//! position withheld by the session leads from Moving to Braking too.

use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};

use takt_fri::client::{AXES, Client, Phase, Quality, Withheld};
use takt_fri::sunrise::wire::CommandMode;

use super::live::Task;

/// Gentle: reaches 10 deg/s in a third of a second, rad/s2.
const ACCELERATION: f64 = 0.5;
/// Nearer than this is arrived, rad: below the resolution of a single-precision datagram.
const ARRIVED_RAD: f64 = 1e-7;
/// The data sheets' ranges less this may be reached, rad: 2 degrees.
pub(super) const MARGIN_RAD: f64 = 0.034_906_585;

/// What is wanted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Goal {
    /// Index of the joint, 0..=6.
    pub(super) joint: usize,
    /// By how much, rad.
    pub(super) by_rad: f64,
    /// Largest speed, rad/s, above zero.
    pub(super) speed: f64,
}

/// What the motion does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Stage {
    /// The robot does not follow, or nobody has said go.
    Idle,
    Moving,
    Braking,
    /// At rest at the goal.
    Arrived,
    /// At rest elsewhere, as it was told to.
    Stopped,
    /// The robot stopped following.
    Left,
    /// The goal is out of range.
    Beyond,
}

impl Stage {
    const ALL: [Self; 7] = [
        Self::Idle,
        Self::Moving,
        Self::Braking,
        Self::Arrived,
        Self::Stopped,
        Self::Left,
        Self::Beyond,
    ];

    /// Whether nothing changes from here on.
    pub(super) fn is_end(self) -> bool {
        match self {
            Self::Idle | Self::Moving | Self::Braking => false,
            Self::Arrived | Self::Stopped | Self::Left | Self::Beyond => true,
        }
    }
}

/// What the user wants.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
enum Wish {
    Hold,
    Go,
    Brake,
}

/// Why a motion braked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Why {
    Asked,
    Quality,
    Withheld,
}

/// What user and cycle tell each other.
#[derive(Debug, Default)]
pub(super) struct Remote {
    wish: AtomicU8,
    stage: AtomicU8,
    why: AtomicU8,
}

impl Remote {
    pub(super) fn go(&self) {
        self.wish.store(Wish::Go as u8, Ordering::Relaxed);
    }

    pub(super) fn brake(&self) {
        self.wish.store(Wish::Brake as u8, Ordering::Relaxed);
    }

    pub(super) fn stage(&self) -> Stage {
        let code = usize::from(self.stage.load(Ordering::Acquire));
        Stage::ALL.get(code).copied().unwrap_or(Stage::Idle)
    }

    /// Meaningful once it brakes.
    pub(super) fn why(&self) -> Why {
        match self.why.load(Ordering::Relaxed) {
            code if code == Why::Quality as u8 => Why::Quality,
            code if code == Why::Withheld as u8 => Why::Withheld,
            _ => Why::Asked,
        }
    }

    fn wish(&self) -> Wish {
        match self.wish.load(Ordering::Relaxed) {
            code if code == Wish::Go as u8 => Wish::Go,
            code if code == Wish::Brake as u8 => Wish::Brake,
            _ => Wish::Hold,
        }
    }
}

/// From rest to rest on a line, within speed and acceleration at every cycle.
#[derive(Clone, Copy, Debug, Default)]
struct Profile {
    /// Way gone, rad, and speed, rad/s; both towards the goal.
    way: f64,
    speed: f64,
}

impl Profile {
    /// A cycle of `dt_s` towards `length`: as fast as can still be braked before it.
    fn approach(&mut self, length: f64, speed_max: f64, dt_s: f64) {
        let left = length - self.way;
        let brakes =
            ACCELERATION * (dt_s.hypot((2.0 * left / ACCELERATION).max(0.0).sqrt()) - dt_s);
        let speed = speed_max.min(self.speed + ACCELERATION * dt_s).min(brakes);
        self.advance(speed, dt_s);
        if length - self.way < ARRIVED_RAD {
            *self = Self {
                way: length,
                speed: 0.0,
            };
        }
    }

    fn brake(&mut self, dt_s: f64) {
        let speed = (self.speed - ACCELERATION * dt_s).max(0.0);
        self.advance(speed, dt_s);
    }

    fn advance(&mut self, speed: f64, dt_s: f64) {
        self.speed = speed;
        self.way += speed * dt_s;
    }
}

/// The motion, in the cycle.
pub(super) struct Motion {
    goal: Goal,
    remote: Arc<Remote>,
    stage: Stage,
    start: [f64; AXES],
    profile: Profile,
}

impl Motion {
    pub(super) fn new(goal: Goal, remote: Arc<Remote>) -> Self {
        Self {
            goal,
            remote,
            stage: Stage::Idle,
            start: [0.0; AXES],
            profile: Profile::default(),
        }
    }

    fn enter(&mut self, stage: Stage) {
        self.stage = stage;
        self.remote.stage.store(stage as u8, Ordering::Release);
    }

    fn brake(&mut self, why: Why) {
        self.remote.why.store(why as u8, Ordering::Relaxed);
        self.enter(Stage::Braking);
    }

    /// Begins, if all is ready for it.
    fn begin(&mut self, partner: &mut Client, is_sound: bool) {
        let takes = takes_positions(partner.status().overlay);
        let follows = partner.phase() == Phase::Command && takes;
        let is_ready = self.remote.wish() == Wish::Go && is_sound && follows;
        if !is_ready || partner.engage().is_err() {
            return;
        }
        self.start = partner.mirror();
        let to = self.start[self.goal.joint] + self.goal.by_rad;
        let version = partner.version();
        let is_within = version
            .is_some_and(|it| to.abs() <= it.position_max_rad()[self.goal.joint] - MARGIN_RAD);
        self.enter(if is_within {
            Stage::Moving
        } else {
            Stage::Beyond
        });
    }

    fn advance(&mut self, dt_s: f64) {
        match self.stage {
            Stage::Moving => {
                let length = self.goal.by_rad.abs();
                self.profile.approach(length, self.goal.speed, dt_s);
                if self.profile.way >= length {
                    self.enter(Stage::Arrived);
                }
            }
            Stage::Braking => {
                self.profile.brake(dt_s);
                if self.profile.speed <= 0.0 {
                    self.enter(Stage::Stopped);
                }
            }
            Stage::Idle | Stage::Arrived | Stage::Stopped | Stage::Left | Stage::Beyond => {}
        }
    }

    fn next(&mut self, partner: &mut Client, cycles: u32) -> Option<[f64; AXES]> {
        let is_sound = partner.status().quality.is_some_and(Quality::is_sound);
        match self.stage {
            Stage::Idle => self.begin(partner, is_sound),
            Stage::Moving | Stage::Braking if partner.phase() != Phase::Command => {
                self.enter(Stage::Left);
            }
            Stage::Moving if self.remote.wish() == Wish::Brake => self.brake(Why::Asked),
            Stage::Moving if !is_sound => self.brake(Why::Quality),
            Stage::Moving
            | Stage::Braking
            | Stage::Arrived
            | Stage::Stopped
            | Stage::Left
            | Stage::Beyond => {}
        }
        // At its end the session holds it: a place commanded on and on would be a jump after a re-entry.
        let is_under_way = matches!(self.stage, Stage::Moving | Stage::Braking);
        let dt_s = partner.period()?.as_secs_f64();
        for _ in 0..cycles {
            self.advance(dt_s);
        }
        let mut joints = self.start;
        joints[self.goal.joint] += self.profile.way * self.goal.by_rad.signum();
        (is_under_way && partner.phase() == Phase::Command).then_some(joints)
    }
}

/// Whether joint positions are what an overlay has the client command, if there is one.
pub(super) fn takes_positions(overlay: Option<CommandMode>) -> bool {
    overlay.is_none_or(|mode| mode == CommandMode::Position)
}

impl Task for Motion {
    fn joints(&mut self, partner: &mut Client, cycles: u32) -> Option<[f64; AXES]> {
        self.next(partner, cycles)
    }

    /// It brakes from where it is: the guard lets that through, since speeds only fall.
    fn handle_withheld(&mut self, _withheld: Withheld) {
        if self.stage == Stage::Moving {
            self.brake(Why::Withheld);
        }
    }

    /// What was under way does not go on where the robot is entered anew.
    fn handle_entered(&mut self) {
        match self.stage {
            Stage::Moving | Stage::Braking => self.enter(Stage::Left),
            Stage::Idle | Stage::Arrived | Stage::Stopped | Stage::Left | Stage::Beyond => {}
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

    /// An emulated controller in virtual time and the motion of its client; positions commanded, cycle by cycle.
    struct Bench<C> {
        controller: C,
        partner: Client,
        motion: Motion,
        remote: Arc<Remote>,
        path: Vec<f64>,
    }

    trait Controller {
        fn due(&self) -> Duration;
        fn send(&mut self, now: Duration, buf: &mut [u8]) -> Option<usize>;
        fn take(&mut self, bytes: &[u8], now: Duration);
        fn joints(&self) -> [f64; AXES];
        /// Switches the drives' power.
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
            let remote = Arc::new(Remote::default());
            remote.go();
            Self {
                controller,
                partner: Client::new(ClientConfig::default()),
                motion: Motion::new(goal, Arc::clone(&remote)),
                remote,
                path: Vec::new(),
            }
        }

        /// Until `done`, or a minute of the robot is over; answers only if `answers`.
        fn run(&mut self, answers: bool, done: impl Fn(&Self) -> bool) {
            let (mut message, mut answer) = ([0; MESSAGE_MAX], [0; MESSAGE_MAX]);
            while !done(self) && self.controller.due() < Duration::from_secs(60) {
                let now = self.controller.due();
                while let Some(len) = self.controller.send(now, &mut message) {
                    let heard = self.partner.handle_datagram(&message[..len], now).unwrap();
                    if heard.has_entered {
                        self.motion.handle_entered();
                    }
                    let joints = self
                        .motion
                        .joints(&mut self.partner, u32::from(heard.lost) + 1);
                    self.path
                        .extend(joints.map(|joints| joints[self.motion.goal.joint]));
                    let Ok(built) = self.partner.answer(joints.as_ref(), &mut answer) else {
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
            self.remote.stage().is_end()
        }

        /// Largest speed and acceleration of what was commanded, by differences.
        fn worst(&self) -> [f64; 2] {
            let dt_s = self.partner.period().unwrap().as_secs_f64();
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
        assert_eq!(bench.remote.stage(), Stage::Arrived);
        let [speed, acceleration] = bench.worst();
        assert!(speed < 0.1 + 1e-6, "{speed}");
        assert!(acceleration < ACCELERATION + 1e-3, "{acceleration}");
        let (settled, sent) = (
            bench.controller.due() + Duration::from_millis(200),
            bench.path.len(),
        );
        bench.run(true, |bench| bench.controller.due() > settled);
        assert_eq!(bench.path.len(), sent, "held, and not commanded on and on");
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
    fn both_robots_go_there_within_speed_and_acceleration() {
        arrives(krc(), 3.0);
        arrives(krc(), -0.01);
        arrives(cabinet(), -3.0);
    }

    #[test]
    fn told_to_brake_it_comes_to_rest_on_the_way() {
        let mut bench = Bench::new(krc(), goal(8.0));
        bench.run(true, |bench| bench.path.len() > 500);
        bench.remote.brake();
        bench.run(true, Bench::at_end);
        assert_eq!(
            (bench.remote.stage(), bench.remote.why()),
            (Stage::Stopped, Why::Asked)
        );
        assert!(bench.worst()[1] < ACCELERATION + 1e-3);
        let way = bench.path.last().unwrap() - bench.path.first().unwrap();
        assert!((0.05..0.13).contains(&way), "{way}");
    }

    #[test]
    fn a_goal_out_of_range_is_not_begun() {
        let config = KrcConfig {
            joints: [0.0, 0.0, 0.0, 115.0_f64.to_radians(), 0.0, 0.0, 0.0],
            ..KrcConfig::default()
        };
        let mut bench = Bench::new(Krc::new(config, Duration::ZERO), goal(4.0));
        bench.run(true, Bench::at_end);
        assert_eq!(bench.remote.stage(), Stage::Beyond);
        assert!(bench.path.is_empty());
    }

    #[test]
    fn command_mode_that_is_left_ends_it_for_good() {
        let mut bench = Bench::new(krc(), goal(8.0));
        bench.run(true, |bench| bench.path.len() > 500);
        bench.run(false, Bench::at_end);
        // Either sees the quality fall first, or the state.
        assert!(matches!(bench.remote.stage(), Stage::Left | Stage::Stopped));
        let len = bench.path.len();
        let at = bench.controller.joints();
        let later = bench.controller.due() + Duration::from_secs(5);
        bench.run(true, |bench| bench.controller.due() > later);
        let way = bench.controller.joints()[3] - at[3];
        assert!(way.abs() < 0.02, "{way} rad after {len} commands");
    }

    /// Power goes in mid-motion and comes back: the joint brakes, and nothing moves after.
    fn is_left_without_power<C: Controller>(controller: C) {
        let mut bench = Bench::new(controller, goal(8.0));
        bench.run(true, |bench| bench.path.len() > 500);
        bench.controller.switch(false);
        bench.run(true, Bench::at_end);
        assert_eq!(bench.remote.stage(), Stage::Left);
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
    fn a_loss_of_power_ends_it_for_good() {
        is_left_without_power(krc());
        is_left_without_power(cabinet());
    }

    #[test]
    fn command_mode_that_is_entered_anew_after_a_silence_ends_it_too() {
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
        assert_eq!(bench.remote.stage(), Stage::Left);
    }

    #[test]
    fn nothing_moves_before_it_is_told_to() {
        let mut bench = Bench::new(cabinet(), goal(8.0));
        bench.remote.wish.store(Wish::Hold as u8, Ordering::Relaxed);
        bench.run(true, |bench| {
            bench.controller.due() > Duration::from_secs(5)
        });
        assert!(bench.path.is_empty());
        assert_eq!(bench.remote.stage(), Stage::Idle);
    }
}
