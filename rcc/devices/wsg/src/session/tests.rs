//! A session against the emulated gripper, in virtual time.

use super::*;
use crate::emulator::{Gripper, GripperConfig};

const MS: Duration = Duration::from_millis(1);

/// A session and its gripper, 1 ms of delay in each direction.
struct Pair {
    session: Session,
    gripper: Gripper,
    now: Duration,
}

impl Pair {
    fn new() -> Self {
        let now = Duration::from_secs(1);
        let mut pair = Self {
            session: Session::new(now),
            gripper: Gripper::new(GripperConfig::default(), now),
            now,
        };
        pair.run(50);
        assert_eq!(pair.session.state(), State::Ready);
        pair
    }

    fn homed() -> Self {
        let mut pair = Self::new();
        assert_eq!(pair.does(&command(0x20, 0.0, 0.0, 1)), Status::SUCCESS);
        pair
    }

    fn run(&mut self, millis: u32) {
        for _ in 0..millis {
            self.now += MS;
            let mut out = [0; QUEUE];
            let len = self.session.transmit(&mut out);
            self.gripper.handle_bytes(&out[..len], self.now);
            self.gripper.step(self.now);
            let answers = self.gripper.transmit();
            self.session.handle_bytes(&answers, self.now);
            self.session.poll(self.now);
        }
    }

    /// Gives a command and waits for its status.
    fn does(&mut self, command: &GripperCommand) -> Status {
        let number = u64::try_from(self.now.as_millis()).unwrap();
        self.session.give(number, command, self.now);
        for _ in 0..100_000 {
            if let Some((_, status)) = self.session.finished().filter(|(it, _)| *it == number) {
                return status;
            }
            self.run(1);
        }
        panic!("no answer to {command:?}");
    }
}

fn command(id: i32, first: f64, second: f64, options: i32) -> GripperCommand {
    GripperCommand {
        id,
        first,
        second,
        options,
    }
}

fn grasp(width: f64) -> GripperCommand {
    command(0x25, width, 0.1, 0)
}

#[test]
fn session_reads_all_values_in_si_units() {
    let mut pair = Pair::homed();
    pair.run(50);
    let values = *pair.session.values();
    assert!((values.width.unwrap() - 0.110).abs() < 1e-5, "{values:?}");
    assert_eq!((values.grasping, values.force), (Some(0), Some(0.0)));
}

#[test]
fn motion_without_homing_is_rejected() {
    let mut pair = Pair::new();
    assert_eq!(pair.does(&grasp(0.03)), Status::NOT_INITIALIZED);
}

#[test]
fn part_is_gripped_and_its_loss_reported() {
    let mut pair = Pair::homed();
    assert_eq!(pair.does(&command(0x32, 40.0, 0.0, 0)), Status::SUCCESS);
    pair.gripper.knobs.part = Some(30.0);
    assert_eq!(pair.does(&grasp(0.03)), Status::SUCCESS);
    pair.run(50);
    let values = *pair.session.values();
    assert_eq!((values.grasping, values.force), (Some(4), Some(40.0)));
    pair.gripper.knobs.part = None;
    pair.run(50);
    assert_eq!(pair.session.values().grasping, Some(3));
    assert_eq!(pair.does(&command(0x26, 0.09, 0.1, 0)), Status::SUCCESS);
}

#[test]
fn grasp_without_part_fails() {
    let mut pair = Pair::homed();
    assert_eq!(pair.does(&grasp(0.03)), Status::CMD_FAILED);
    pair.run(50);
    assert_eq!(pair.session.values().grasping, Some(2));
}

#[test]
fn soft_limits_reject_targets_beyond() {
    let mut pair = Pair::homed();
    assert_eq!(pair.does(&command(0x34, 0.02, 0.08, 0)), Status::SUCCESS);
    let to = |width: f64| command(0x21, width, 0.1, 0);
    assert_eq!(pair.does(&to(0.09)), Status::RANGE);
    assert_eq!(pair.does(&to(0.05)), Status::SUCCESS);
    assert_eq!(pair.does(&command(0x36, 0.0, 0.0, 0)), Status::SUCCESS);
    assert_eq!(pair.does(&to(0.09)), Status::SUCCESS);
    assert!((pair.gripper.width() - 90.0).abs() < 0.1);
}

#[test]
fn second_command_waits_for_no_one() {
    let mut pair = Pair::homed();
    pair.session.give(7, &grasp(0.01), pair.now);
    pair.run(5);
    pair.session.give(8, &grasp(0.02), pair.now);
    assert_eq!(pair.session.finished(), Some((8, Status::ALREADY_RUNNING)));
}

#[test]
fn withdrawn_motion_is_stopped() {
    let mut pair = Pair::homed();
    pair.session.give(7, &grasp(0.01), pair.now);
    pair.run(50);
    assert!(!pair.gripper.rests());
    pair.session.withdraw(7, pair.now);
    pair.run(5);
    assert!(pair.gripper.rests() && !pair.session.is_busy());
    let rests_at = pair.gripper.width();
    pair.run(100);
    assert!((pair.gripper.width() - rests_at).abs() < 1e-9);
}

#[test]
fn fast_stop_is_acknowledged_after_a_second() {
    let mut pair = Pair::homed();
    pair.gripper
        .handle_bytes(&bytes(Command::FastStop), pair.now);
    pair.run(100);
    assert!(!pair.session.is_ready());
    assert_eq!(pair.does(&grasp(0.03)), Status::ACCESS_DENIED);
    pair.run(1500);
    assert!(pair.session.is_ready() && !pair.gripper.is_stopped());
}

fn bytes(command: Command) -> Vec<u8> {
    let mut bytes = [0; PACKET_MAX];
    let len = Packet::new(command).encode(&mut bytes);
    bytes[..len].to_vec()
}

#[test]
fn faults_keep_gripper_from_executing() {
    let mut pair = Pair::homed();
    pair.gripper.knobs.faults = 1 << 14;
    pair.run(50);
    assert!(!pair.session.is_ready());
    pair.gripper.knobs.faults = 0;
    pair.run(50);
    assert!(pair.session.is_ready());
}

#[test]
fn silent_gripper_is_lost_and_its_command_times_out() {
    let mut pair = Pair::homed();
    pair.gripper.knobs.silent = true;
    assert_eq!(pair.does(&grasp(0.03)), Status::TIMEOUT);
    pair.run(10);
    assert!(pair.session.is_lost(pair.now));
}

#[test]
fn wrong_checksums_are_counted() {
    let mut pair = Pair::homed();
    pair.gripper.knobs.bad_checksum = true;
    pair.run(100);
    assert!(pair.session.errors() > 10);
}
