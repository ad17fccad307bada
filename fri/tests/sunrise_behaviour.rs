//! Session and emulated cabinet against each other over the in-process link, in virtual time with seeded faults.
#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

use std::time::Duration;
use takt_fri::guard::Guard;
use takt_fri::link::{Link, Memory, pair};
use takt_fri::sunrise::emulator::{
    Cabinet, CabinetConfig, Contact, Control, ExitReason, LineFaults, Overlay, PowerOff, Program,
    Robot, Shape,
};
use takt_fri::sunrise::wire::{CommandMode, Dialect, MESSAGE_MAX, Quality};
use takt_fri::sunrise::{AXES, Demand, Event, JOINT_NAMES, Session, SessionConfig, Withheld};

const PERIOD: Duration = Duration::from_millis(2);
const START: Duration = Duration::from_secs(100);
const DIALECTS: [Dialect; 3] = [Dialect::V1, Dialect::V2, Dialect::V3];

/// A client and a cabinet.
struct Pair {
    cabinet: Cabinet,
    session: Session,
    cabinet_end: Memory,
    pc_end: Memory,
    now: Duration,
    entered: Option<(Duration, [f64; AXES])>,
    /// Whether the client engages again by itself.
    persists: bool,
    /// Added to the demand.
    wrench: [f64; 6],
    events: Vec<Event>,
    qualities: Vec<Quality>,
    commanded: Vec<[f64; AXES]>,
    withheld: Vec<Withheld>,
}

impl Pair {
    fn new(config: CabinetConfig) -> Self {
        let (cabinet_end, pc_end) = pair();
        Self {
            cabinet: Cabinet::new(config, START),
            session: Session::new(SessionConfig::default()),
            cabinet_end,
            pc_end,
            now: START,
            entered: None,
            persists: true,
            wrench: [0.0; 6],
            events: Vec::new(),
            qualities: Vec::new(),
            commanded: Vec::new(),
            withheld: Vec::new(),
        }
    }

    fn commanding(config: CabinetConfig) -> Self {
        let mut pair = Self::new(config);
        pair.run(250);
        assert!(
            pair.session.is_engaged(),
            "{:?} {:?}",
            pair.cabinet,
            pair.reasons()
        );
        pair
    }

    /// Runs for `cycles` periods of the cabinet.
    fn run(&mut self, cycles: u32) -> &mut Self {
        let end = self.now + PERIOD * cycles;
        while self.cabinet.poll_timeout() <= end {
            self.now = self.cabinet.poll_timeout();
            self.step();
        }
        self.now = end;
        self
    }

    fn step(&mut self) {
        let mut buf = [0; MESSAGE_MAX];
        self.pc_end.set_now(self.now);
        self.cabinet_end.set_now(self.now);
        while let Some(len) = self.cabinet.poll_transmit(self.now, &mut buf) {
            self.cabinet_end.send(&buf[..len]).unwrap();
        }
        self.session.handle_timeout(self.now);
        while let Some((len, at)) = self.pc_end.receive(&mut buf, Duration::ZERO).unwrap() {
            let reception = self.session.handle_datagram(&buf[..len], at).unwrap();
            self.events.extend(reception.event);
            self.qualities.push(reception.quality);
        }
        let demand = self.demand();
        if let Ok(answer) = self.session.answer(&demand, &mut buf) {
            self.withheld.extend(answer.withheld);
            if self.session.is_engaged() {
                self.commanded.push(self.session.mirror());
            }
            self.pc_end.send(&buf[..answer.len]).unwrap();
        }
        while let Some((len, at)) = self.cabinet_end.receive(&mut buf, Duration::ZERO).unwrap() {
            self.cabinet.handle_datagram(&buf[..len], at).unwrap();
        }
    }

    /// Swings A1 by 0.2 rad in position mode, presses in wrench mode.
    fn demand(&mut self) -> Demand {
        let may = self.persists || self.entered.is_none();
        if !self.session.is_engaged() && (!may || self.session.engage().is_err()) {
            return Demand::Hold;
        }
        let (now, mirror) = (self.now, self.session.mirror());
        if self.events.last() == Some(&Event::CommandEntered) {
            self.events.push(Event::Ready);
            self.entered = Some((now, mirror));
        }
        let (since, mut joints) = self.entered.unwrap_or((now, mirror));
        match self.session.command_mode() {
            CommandMode::Wrench => Demand::Wrench {
                wrench: self.wrench,
                joints: None,
            },
            CommandMode::Torque => Demand::Torque {
                torque: [0.0; AXES],
                joints: None,
            },
            CommandMode::Position
            | CommandMode::None
            | CommandMode::CartesianPose
            | CommandMode::Other(_) => {
                joints[0] += 0.1 * (1.0 - (2.0 * (now - since).as_secs_f64()).cos());
                Demand::Position(joints)
            }
        }
    }

    fn reasons(&self) -> Vec<String> {
        self.cabinet
            .log()
            .map(|left| left.reason.to_string())
            .collect()
    }

    fn worst(&self, last: usize) -> Quality {
        let recent = &self.qualities[self.qualities.len() - last..];
        *recent.iter().min_by_key(|quality| quality.code()).unwrap()
    }
}

fn with(dialect: Dialect, overlay: Overlay) -> CabinetConfig {
    CabinetConfig {
        dialect,
        program: Program::Auto {
            overlay,
            restart: Some(Duration::from_secs(1)),
        },
        ..CabinetConfig::default()
    }
}

fn overlay(control: Control, command: CommandMode) -> Overlay {
    Overlay { control, command }
}

fn compliant() -> Overlay {
    let control = Control::CartesianImpedance {
        stiffness: [2000.0, 2000.0, 2000.0, 200.0, 200.0, 200.0],
        damping: [0.7; 6],
    };
    overlay(control, CommandMode::Wrench)
}

fn lossy(drop: f64) -> LineFaults {
    LineFaults {
        drop,
        ..LineFaults::default()
    }
}

#[test]
fn sunrise_robot_follows_in_every_dialect() {
    for dialect in DIALECTS {
        for robot in [Robot::Iiwa7, Robot::Iiwa14] {
            let config = CabinetConfig {
                robot,
                ..with(dialect, Overlay::default())
            };
            let start = config.joints;
            let mut pair = Pair::commanding(config);
            pair.run(1000);
            assert_eq!(pair.reasons(), Vec::<String>::new());
            assert_eq!(pair.session.dialect(), Some(dialect));
            assert!((pair.cabinet.joints()[0] - start[0]).abs() > 0.05);
            assert_eq!(pair.worst(900), Quality::Excellent);
            let shown = pair.events[..4].to_vec();
            assert_eq!(
                shown,
                [
                    Event::Online,
                    Event::Ready,
                    Event::Synchronising,
                    Event::CommandEntered
                ]
            );
        }
    }
}

#[test]
fn sunrise_impedance_modes_are_entered_and_held() {
    let joint = Control::JointImpedance {
        stiffness: [300.0; AXES],
        damping: [0.7; AXES],
    };
    for mode in [
        overlay(joint, CommandMode::Torque),
        compliant(),
        overlay(joint, CommandMode::Position),
    ] {
        let mut pair = Pair::commanding(with(Dialect::V1, mode));
        pair.run(1000);
        assert_eq!(pair.reasons(), Vec::<String>::new(), "{mode:?}");
        assert_eq!(
            pair.withheld
                .iter()
                .filter(|it| matches!(it, Withheld::Mode { .. }))
                .count(),
            0
        );
    }
}

#[test]
fn sunrise_1_percent_loss_and_jitter_keep_quality() {
    let line = LineFaults {
        drop: 0.01,
        jitter: Duration::from_micros(100),
        ..LineFaults::default()
    };
    for (seed, dialect) in (1..).zip(DIALECTS) {
        let mut config = CabinetConfig {
            seed,
            ..with(dialect, Overlay::default())
        };
        (config.faults.to_client, config.faults.to_cabinet) = (line, line);
        let mut pair = Pair::new(config);
        pair.run(10_000);
        assert_eq!(pair.reasons(), Vec::<String>::new());
        assert!(pair.session.is_engaged() && pair.worst(9_000).code() >= Quality::Good.code());
        assert!(pair.session.counters().lost > 50);
    }
}

#[test]
fn sunrise_delay_duplicates_and_disorder_are_harmless() {
    let line = LineFaults {
        delay: Duration::from_micros(300),
        duplicate: 0.1,
        reorder: 0.02,
        ..LineFaults::default()
    };
    let mut config = with(Dialect::V3, Overlay::default());
    (config.faults.to_client, config.faults.to_cabinet) = (line, line);
    let mut pair = Pair::new(config);
    pair.run(5_000);
    assert_eq!(pair.reasons(), Vec::<String>::new());
    assert!(pair.session.counters().old > 300 && pair.session.is_engaged());
}

#[test]
fn sunrise_drifting_clock_is_followed() {
    let mut config = with(Dialect::V2, Overlay::default());
    config.faults.drift_ppm = 300.0;
    let mut pair = Pair::commanding(config);
    pair.run(5_000);
    assert_eq!(
        (pair.reasons(), pair.worst(4_000)),
        (Vec::new(), Quality::Excellent)
    );
}

#[test]
fn sunrise_20_lost_answers_end_overlay_until_engage() {
    let mut pair = Pair::commanding(with(Dialect::V1, Overlay::default()));
    pair.persists = false;
    pair.run(200);
    pair.cabinet.faults_mut().to_cabinet.drop_next = 20;
    pair.run(300);
    assert_eq!(pair.reasons().len(), 1, "{:?}", pair.reasons());
    assert!(matches!(
        pair.cabinet.log().next().unwrap().reason,
        ExitReason::Misses { .. }
    ));
    let rest = pair.cabinet.joints();
    pair.run(1_500);
    assert!(pair.events.contains(&Event::CommandLeft));
    assert_eq!(
        pair.session.phase(),
        takt_fri::sunrise::Phase::CommandingActive
    );
    assert!(!pair.session.is_engaged());
    let moved = (pair.cabinet.joints()[0] - rest[0]).abs();
    assert!(moved < 1e-6, "{moved}");
    pair.persists = true;
    pair.run(1_000);
    assert!((pair.cabinet.joints()[0] - rest[0]).abs() > 0.01);
    assert_eq!(pair.reasons().len(), 1, "{:?}", pair.reasons());
}

#[test]
fn sunrise_guard_keeps_commands_within_cabinet_limits() {
    let speed = 0.05;
    let mut pair = Pair::new(with(Dialect::V2, Overlay::default()));
    let guard = Guard {
        speed_rad_per_s: [speed; AXES],
        ..Guard::open(JOINT_NAMES)
    };
    pair.session = Session::new(SessionConfig {
        guard,
        ..SessionConfig::default()
    });
    pair.run(1_000);
    assert_eq!(pair.reasons(), Vec::<String>::new());
    assert!(
        pair.withheld
            .iter()
            .any(|it| it.to_string().starts_with("A1 commanded 0.")),
        "{:?}",
        pair.withheld.last()
    );
    for two in pair.commanded.windows(2) {
        assert!((two[1][0] - two[0][0]).abs() <= speed * PERIOD.as_secs_f64() + 1e-6);
    }
}

#[test]
fn sunrise_power_return_allows_commands_again() {
    let mut config = with(Dialect::V3, Overlay::default());
    config.faults.power_off = Some(PowerOff {
        at: Duration::from_secs(1),
        span: Duration::from_millis(500),
    });
    let mut pair = Pair::commanding(config);
    pair.run(450);
    assert_eq!(pair.reasons(), ["the drives lost their power"]);
    assert!(!pair.session.is_engaged());
    pair.run(1_000);
    assert!(pair.session.is_engaged());
}

#[test]
fn sunrise_client_restart_continues_with_new_counter() {
    let mut pair = Pair::commanding(with(Dialect::V1, Overlay::default()));
    pair.session = Session::new(SessionConfig::default());
    pair.entered = None;
    pair.events.clear();
    pair.run(100);
    // The controller sees a client that mirrors its interpolator: far from where the old one was, that is too fast.
    pair.run(1_000);
    assert!(pair.session.is_engaged(), "{:?}", pair.reasons());
}

#[test]
fn sunrise_controller_restart_in_other_version_is_followed() {
    let mut pair = Pair::commanding(with(Dialect::V1, Overlay::default()));
    pair.cabinet = Cabinet::new(
        with(Dialect::V3, Overlay::default()),
        pair.now + PERIOD * 100,
    );
    pair.run(1_000);
    assert_eq!(pair.session.dialect(), Some(Dialect::V3));
    assert!(pair.session.is_engaged());
    assert_eq!(
        pair.session.counters().silences + pair.session.counters().restarts,
        1
    );
}

#[test]
fn sunrise_contact_approach_hold_and_loss() {
    let mut pair = Pair::commanding(with(Dialect::V3, compliant()));
    let height = pair.cabinet.flange()[2];
    *pair.cabinet.contact_mut() = Some(Contact {
        shape: Shape::Wall,
        point: [0.0, 0.0, height - 0.005],
        normal: [0.0, 0.0, 1.0],
        stiffness: 10_000.0,
        damping: 50.0,
    });
    let felt = |pair: &Pair| {
        let data = pair.session.message().unwrap().monitor.unwrap();
        data.external_force.unwrap()[2]
    };
    // Presses harder until 15 N are felt.
    while felt(&pair) < 15.0 {
        assert!(pair.wrench[2] > -100.0);
        pair.wrench[2] -= 0.05;
        pair.run(5);
    }
    pair.run(500);
    assert!((felt(&pair) - 15.0).abs() < 2.0, "{}", felt(&pair));
    let pressed = pair.cabinet.flange()[2];
    *pair.cabinet.contact_mut() = None;
    pair.run(3);
    assert!(
        felt(&pair).abs() < 1e-9,
        "the loss shows within three cycles"
    );
    pair.wrench = [0.0; 6];
    pair.run(1_000);
    assert!(
        pair.cabinet.flange()[2] > pressed + 0.003,
        "back at the centre of the impedance"
    );
    assert_eq!(pair.reasons(), Vec::<String>::new());
}

#[test]
fn sunrise_heavy_loss_never_reaches_quality() {
    let mut config = with(Dialect::V1, Overlay::default());
    config.faults.to_cabinet = lossy(0.3);
    let mut pair = Pair::new(config);
    pair.run(6_000);
    assert!(
        pair.reasons()[0].starts_with("Timeout before FRI connection quality reached GOOD"),
        "{:?}",
        pair.reasons()
    );
    assert!(pair.commanded.is_empty());
}
