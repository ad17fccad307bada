//! The youBot's state machines against the emulated one, in virtual time: reference are the positions of its motors.
//! Each cell of the state tables of drive and homing is tested in `cells`.

use std::time::Duration;

use super::homing::HomingError;
use super::*;
use crate::config::MasterConfig;
use crate::emulator::{YouBot, YouBotConfig};
use crate::master::tests::Rig;
use crate::master::{Job, JobError, JobKind, Master};

mod cells;
mod gripper;

/// Cycles of inputs that may be missing.
const OLD: u32 = 4;

/// A youBot controlled cycle by cycle: drives 0 to 3 wheels, 4 to 8 joints.
struct Lead {
    rig: Rig,
    bot: YouBot,
    drives: Vec<Drive>,
    wanted: [Option<Command>; 9],
    may_move: bool,
    homing: Vec<Homing>,
    gripper: Gripper,
}

fn slave(drive: usize) -> usize {
    if drive < 4 { 1 + drive } else { 2 + drive }
}

impl Lead {
    fn new(firmware: Firmware) -> Self {
        let config = YouBotConfig {
            firmware,
            ..YouBotConfig::default()
        };
        let (segment, bot) = YouBot::segment(&config);
        let rig = Rig::new(MasterConfig::default(), segment);
        let drive = |n: usize| {
            let config = DriveConfig {
                current_max_ma: 3000,
                direction: if n < 4 || n == 6 { 1 } else { -1 },
            };
            Drive::new(slave(n), config)
        };
        let mut lead = Self {
            rig,
            bot,
            drives: (0..9).map(drive).collect(),
            wanted: [None; 9],
            may_move: true,
            homing: HOMING.map(Homing::new).to_vec(),
            gripper: Gripper::new(BarConfig::default()),
        };
        lead.rig.until(5000, Master::is_operational);
        lead
    }

    /// One whose drives follow.
    fn ready(firmware: Firmware) -> Self {
        let mut lead = Self::new(firmware);
        lead.until(4000, |lead| lead.drives.iter().all(Drive::follows));
        lead
    }

    fn cycle(&mut self) {
        let now = self.rig.now;
        let master = &mut self.rig.master;
        while let Some(reply) = master.poll_reply() {
            let of = |drive: &&mut Drive| drive.slave() == reply.job.slave;
            let drive = self.drives.iter_mut().find(of).unwrap();
            drive.mailbox().handle_reply(reply, now);
        }
        for (n, drive) in self.drives.iter_mut().enumerate() {
            let mut wanted = self.wanted[n];
            let reported = drive.feedback().copied().filter(|_| drive.follows());
            if n >= 4
                && let Some(reported) = reported
            {
                let homing = &mut self.homing[n - 4];
                let may_move = self.may_move;
                if let Some(order) = homing.cycle(&reported, drive.mailbox(), may_move, now) {
                    wanted = Some(order);
                }
            }
            if n == 8 && drive.follows() {
                self.gripper.cycle(drive.mailbox(), self.may_move, now);
            }
            let (bytes, age) = master.inputs(slave(n));
            let inputs = (age <= OLD).then_some(bytes);
            let command = drive.cycle(inputs, wanted, self.may_move, now);
            master
                .outputs_mut(slave(n))
                .copy_from_slice(&command.encode());
            drive.mailbox().poll(master, now);
        }
        self.rig.cycle();
    }

    fn cycles(&mut self, count: usize) {
        for _ in 0..count {
            self.cycle();
        }
    }

    #[track_caller]
    fn until(&mut self, most: usize, holds: impl Fn(&Self) -> bool) -> usize {
        for count in 0..most {
            if holds(self) {
                return count;
            }
            self.cycle();
        }
        let states: Vec<_> = self.drives.iter().map(Drive::state).collect();
        panic!(
            "not within {most} cycles: {states:?} {:?} {:?}",
            self.homing, self.gripper
        );
    }

    /// A request to a drive, answered.
    #[track_caller]
    fn call(&mut self, drive: usize, request: Request) -> Result<Answer, CallError> {
        for _ in 0..4000 {
            if let Some(outcome) = self.drives[drive].mailbox().call(request) {
                return outcome;
            }
            self.cycle();
        }
        panic!("no answer to {request:?}");
    }

    fn angle(&self, joint: usize) -> f64 {
        let angle = self.bot.arms[0][joint].lock().angle();
        // The third joint counts towards negative angles.
        angle * -ARM[joint].sign
    }
}

#[test]
fn drives_of_either_firmware_become_ready() {
    for (firmware, number) in [(Firmware::V148, 148), (Firmware::V200, 200)] {
        let lead = Lead::ready(firmware);
        for (n, drive) in lead.drives.iter().enumerate() {
            let board = if n < 4 { 1632 } else { 1610 };
            assert_eq!(drive.version(), Some(Version { board, number }));
            assert_eq!(drive.counters().commutations, 1);
        }
        assert_eq!(
            lead.rig.master.groups()[0].misses,
            0,
            "cycles go on meanwhile"
        );
    }
}

#[test]
fn commutation_search_waits_for_permission() {
    let mut lead = Lead::new(Firmware::V200);
    lead.may_move = false;
    lead.cycles(1500);
    for drive in &lead.drives {
        assert_eq!(drive.drive_fault(), Some(DriveFault::Uncommutated));
    }
    let before = lead.bot.wheels[0].lock().angle();
    lead.cycles(500);
    assert!((lead.bot.wheels[0].lock().angle() - before).abs() < 1e-6);
    lead.may_move = true;
    lead.until(1500, |lead| lead.drives.iter().all(Drive::follows));
}

#[test]
fn odometry_measures_the_motion_of_the_base() {
    let mut lead = Lead::ready(Firmware::V200);
    let (mecanum, mut odometry) = (Mecanum::default(), Odometry::default());
    let mut ramp = Ramp::new(1.0, 2.0);
    let angles =
        |lead: &Lead| -> [f64; 4] { std::array::from_fn(|n| lead.bot.wheels[n].lock().angle()) };
    let before = angles(&lead);
    for n in 0..2500 {
        let wanted = if n < 2000 { [0.2, 0.1, 0.0] } else { [0.0; 3] };
        ramp.step(wanted, 1e-3);
        for (wanted, rpm) in lead.wanted.iter_mut().zip(mecanum.rpm(ramp.velocity())) {
            *wanted = Some(Command::velocity(rpm));
        }
        lead.cycle();
        let ticks = std::array::from_fn(|n| lead.drives[n].feedback().unwrap().position);
        odometry.advance(&mecanum, ticks);
    }
    // `angle` counts against the motor.
    let after = angles(&lead);
    let turned = std::array::from_fn(|n| before[n] - after[n]);
    let truth = mecanum.velocity(turned);
    let pose = odometry.pose();
    for (reported, truth) in pose.into_iter().zip(truth) {
        assert!((reported - truth).abs() < 0.003, "{pose:?} {truth:?}");
    }
    assert!(
        (pose[0] - 0.4).abs() < 0.02 && (pose[1] - 0.2).abs() < 0.01,
        "{pose:?}"
    );
}

#[test]
fn arm_is_homed_at_its_stops_once() {
    for firmware in [Firmware::V148, Firmware::V200] {
        let mut lead = Lead::ready(firmware);
        lead.homing.iter_mut().for_each(Homing::start);
        lead.until(6000, |lead| lead.homing.iter().all(Homing::is_done));
        for (joint, geometry) in ARM.iter().enumerate() {
            assert!(
                lead.angle(joint).abs() < 0.05,
                "{joint} at {}",
                lead.angle(joint)
            );
            let reported = lead.drives[4 + joint].feedback().unwrap().position;
            let angle = geometry.angle(reported);
            assert!(
                (angle - lead.angle(joint)).abs() < 0.02,
                "{joint} reported {angle}"
            );
        }
        // Positions are those of the joints.
        let targets = [1.0, 0.5, -1.0, 0.8, 1.5];
        for (joint, target) in targets.into_iter().enumerate() {
            lead.wanted[4 + joint] = Some(Command::position(ARM[joint].ticks(target)));
        }
        lead.cycles(4000);
        for (joint, target) in targets.into_iter().enumerate() {
            assert!((lead.angle(joint) - target).abs() < 0.02, "{joint}");
        }
        // The drives are marked as homed.
        lead.homing.iter_mut().for_each(Homing::forget);
        lead.homing.iter_mut().for_each(Homing::start);
        lead.may_move = false;
        lead.until(400, |lead| lead.homing.iter().all(Homing::is_done));
        assert!((lead.angle(0) - 1.0).abs() < 0.02);
    }
}

#[test]
fn homing_in_progress_is_cancelled() {
    let mut lead = Lead::ready(Firmware::V200);
    lead.homing[0].start();
    lead.until(500, |lead| {
        matches!(lead.homing[0].state(), HomingState::Approach(..))
    });
    lead.cycles(30);
    lead.homing[0].cancel();
    lead.cycles(100);
    let at = lead.angle(0);
    lead.cycles(300);
    assert!((lead.angle(0) - at).abs() < 1e-3, "it stands");
    assert_eq!(lead.homing[0].state(), HomingState::Cancelled);
}

#[test]
fn drive_timeout_is_cleared_up_to_the_limit() {
    let mut lead = Lead::ready(Firmware::V200);
    let mut first = None;
    for count in 1..=7_u64 {
        lead.rig.segment.set_link(0, false);
        lead.until(300, |lead| lead.drives[0].state() == DriveState::Absent);
        lead.cycles(200);
        lead.rig.segment.set_link(0, true);
        lead.until(3000, |lead| lead.drives[0].counters().timeouts == count);
        let first = *first.get_or_insert(lead.rig.now);
        lead.cycles(150);
        // Five at once, and one more each ten seconds.
        let most = 5 + (lead.rig.now - first).as_secs() / 10;
        let drive = &lead.drives[0];
        assert_eq!(
            drive.follows(),
            count <= most,
            "{count}: {:?}",
            drive.state()
        );
    }
    assert!(!lead.drives[0].follows(), "seven are too many");
    assert_eq!(lead.drives[0].counters().commutations, 1, "found once");
}

#[test]
fn i2t_flag_is_cleared_five_times_then_waits() {
    let mut lead = Lead::ready(Firmware::V200);
    let order = Command::current(100_000);
    lead.wanted[0] = Some(order);
    lead.cycles(5);
    let current = lead.drives[0].feedback().unwrap().current_ma;
    assert_eq!(current, 3000, "the drive itself would have taken it");
    assert!(lead.drives[0].counters().clamped > 0);
    assert_eq!(lead.call(0, Request::get(6)), Ok(Answer::Value(3000)));
    lead.wanted[0] = None;
    for count in 1..=6 {
        lead.bot.wheels[0].lock().overheat();
        lead.cycles(200);
        let drive = &lead.drives[0];
        assert_eq!(drive.counters().i2t, count);
        assert_eq!(drive.follows(), count <= 5, "{count}: {:?}", drive.state());
    }
    assert_eq!(lead.drives[0].drive_fault(), Some(DriveFault::TooOften));
    // One expires each ten seconds.
    lead.until(11_000, |lead| lead.drives[0].follows());
    assert_eq!(lead.drives[0].counters().i2t, 6);
}

#[test]
fn emergency_stop_holds_and_resumes_at_actual_position() {
    let mut lead = Lead::ready(Firmware::V148);
    lead.bot.wheels[1].lock().emergency_stop = true;
    lead.cycles(20);
    let why = lead.drives[1].drive_fault();
    assert!(matches!(why, Some(DriveFault::Flags(flags)) if flags.any(Flags::EMERGENCY_STOP)));
    lead.bot.wheels[1].lock().emergency_stop = false;
    lead.cycles(20);
    assert!(lead.drives[1].follows());
}

#[test]
fn tmcl_request_with_any_lost_frame_gets_its_answer() {
    let mut lead = Lead::ready(Firmware::V200);
    for lost in 0..12 {
        let other = Request::set(11, 4000 + lost);
        for (n, request) in [other, Request::get(11)].into_iter().enumerate() {
            let mut outcome = None;
            for cycle in 0..4000 {
                outcome = lead.drives[0].mailbox().call(request);
                if outcome.is_some() {
                    break;
                }
                if n == 0 && cycle == lost {
                    lead.rig.segment.faults.lose = 1;
                }
                lead.cycle();
            }
            assert_eq!(
                outcome,
                Some(Ok(Answer::Value(4000 + lost))),
                "frame {lost}"
            );
        }
    }
}

#[test]
fn tmcl_late_answer_is_not_matched_to_next_request() {
    let mut lead = Lead::ready(Firmware::V200);
    // For longer than the request timeout.
    lead.rig.segment.slave(1).unwrap().faults().hung = true;
    let slow = Request::get(250);
    assert_eq!(lead.drives[0].mailbox().call(slow), None);
    lead.cycles(300);
    lead.rig.segment.slave(1).unwrap().faults().hung = false;
    assert_eq!(lead.call(0, slow), Ok(Answer::Value(4000)));
    assert_eq!(lead.call(0, Request::get(253)), Ok(Answer::Value(16)));
    assert!(lead.drives[0].mailbox().repeats() > 0);
}

#[test]
fn parameter_errors_name_their_cause() {
    let mut lead = Lead::ready(Firmware::V200);
    for (request, refusal) in [
        (Request::set(26, 5), TmclError::Protected),
        (Request::set(4, -1), TmclError::Value),
        (Request::get(99), TmclError::Type),
        (Request::get_bar(0, 8), TmclError::Command),
    ] {
        assert_eq!(lead.call(0, request), Err(CallError::Refused(refusal)));
    }
    for parameter in parameters::ALL {
        let answer = lead.call(8, parameter.get(1));
        assert!(answer.is_ok(), "{}: {answer:?}", parameter.name);
    }
}

#[test]
fn compliant_joint_yields_to_a_push_and_returns() {
    let mut lead = Lead::ready(Firmware::V200);
    let joint = ARM[0];
    let law = Impedance {
        stiffness: 30.0,
        damping: 1.0,
        torque_max: 8.0,
        added: 0.0,
    };
    let start = lead.drives[4].feedback().unwrap().position;
    let home = joint.angle(start) + 0.5;
    let spring = |lead: &mut Lead, cycles: usize| {
        for _ in 0..cycles {
            let reported = lead.drives[4].feedback().unwrap();
            let torque = law.torque(
                &joint,
                home - joint.angle(reported.position),
                -joint.speed(reported.velocity_rpm),
            );
            lead.wanted[4] = Some(Command::current(joint.current_ma(torque)));
            lead.cycle();
        }
        joint.angle(lead.drives[4].feedback().unwrap().position)
    };
    let rest = spring(&mut lead, 2000);
    assert!((rest - home).abs() < 0.1, "{rest}");
    lead.bot.arms[0][0].lock().pushed = 5.0;
    let pushed = spring(&mut lead, 2000);
    assert!((pushed - rest).abs() > 0.1, "{rest} {pushed}");
    lead.bot.arms[0][0].lock().pushed = 0.0;
    let back = spring(&mut lead, 2000);
    assert!((back - home).abs() < 0.1, "{back}");
}

#[test]
fn homing_without_stop_times_out() {
    let mut homing = Homing::new(HOMING[0]);
    let mut mailbox = Mailbox::new(0);
    homing.start();
    let reported = Feedback {
        velocity_rpm: 156,
        ..Feedback::default()
    };
    let mut now = Duration::from_secs(1);
    homing.cycle(&reported, &mut mailbox, true, now);
    mailbox.pretend(Ok(Answer::Value(0)));
    for _ in 0..16_000 {
        homing.cycle(&reported, &mut mailbox, true, now);
        now += Duration::from_millis(1);
    }
    assert_eq!(homing.state(), HomingState::Failed(HomingError::NoStop));
}

/// A homing whose motor turns with this speed and current, after these cycles of the approach.
fn approached(velocity_rpm: i32, current_ma: i32, cycles: u32) -> (Homing, Option<Command>) {
    let mut homing = Homing::new(HOMING[0]);
    let mut mailbox = Mailbox::new(0);
    homing.start();
    let mut feedback = Feedback {
        velocity_rpm,
        current_ma,
        ..Feedback::default()
    };
    homing.cycle(&feedback, &mut mailbox, true, Duration::ZERO);
    mailbox.pretend(Ok(Answer::Value(0)));
    let mut command = None;
    for ms in 0..cycles {
        let now = Duration::from_millis(ms.into());
        command = homing.cycle(&feedback, &mut mailbox, true, now);
        feedback.position += velocity_rpm * 4000 / 60_000;
    }
    (homing, command)
}

#[test]
fn homing_of_a_runaway_motor_takes_its_current() {
    for rpm in [900, -300] {
        let (homing, command) = approached(rpm, 0, 1000);
        let commanded = HOMING[0].rpm;
        let why = HomingError::Runaway { rpm, commanded };
        assert_eq!(homing.state(), HomingState::Failed(why));
        assert_eq!(command, Some(Command::current(0)));
        assert!(why.to_string().contains("\nhint: "), "{why}");
    }
    // Overshoot, and a joint that gravity holds back.
    for rpm in [330, -50] {
        let (homing, _) = approached(rpm, 0, 1000);
        assert!(homing.is_active(), "{rpm}");
    }
}

#[test]
fn homing_reports_whether_the_motor_moved() {
    let (moves, _) = approached(156, 0, 1000);
    assert_eq!(moves.has_moved(), Some(true));
    let (blocked, _) = approached(0, 3000, 206);
    assert!(matches!(blocked.state(), HomingState::Rest(_)));
    assert_eq!(blocked.has_moved(), Some(false));
    assert_eq!(Homing::new(HOMING[0]).has_moved(), None);
}

#[test]
fn raw_mailbox_is_emptied_before_a_request() {
    let mut rig = Lead::ready(Firmware::V200).rig;
    let transact = |rig: &mut Rig, request: Request| {
        let mut data = Vec::with_capacity(64);
        data.extend_from_slice(&request.encode());
        let (slave, kind, token) = (1, JobKind::RawMailbox, 0);
        let job = Job {
            slave,
            kind,
            data,
            token,
        };
        rig.master.submit(job).unwrap();
        for _ in 0..1000 {
            rig.cycle();
            if let Some(reply) = rig.master.poll_reply() {
                return reply.result.map(|()| request.answer(&reply.job.data));
            }
        }
        panic!("no reply");
    };
    rig.segment.slave(1).unwrap().faults().hung = true;
    let late = transact(&mut rig, Request::get(250));
    assert!(matches!(late, Err(JobError::Timeout(_))), "{late:?}");
    rig.segment.slave(1).unwrap().faults().hung = false;
    rig.cycles(2);
    assert_eq!(
        transact(&mut rig, Request::get(253)),
        Ok(Ok(Answer::Value(16))),
        "not 4000, the answer to the previous request"
    );
}
