//! The gripper of a youBot as a device: orders of nets, and the distance between its fingers. It uses the mailbox of
//! the last joint's drive, between that drive's own requests.

use takt_ethercat::youbot::{BarConfig, Drive, DriveState, Gripper as Fingers, GripperState};
use takt_net::device::{Answer, Gripper as Interface, Layout};
use takt_rt::cycle::Tick;
use takt_rt::latest::{LatestReader, LatestWriter};

use super::{Wait, now};
use crate::device::driver::DeviceEnd;
use crate::device::{DeviceCommand, DeviceState, DeviceStatus};

/// Error values of answers.
mod error {
    /// The distance is out of range or not finite.
    pub(super) const RANGE: i32 = 1;
    /// The gripper is offline, or its fingers are blocked.
    pub(super) const FAILED: i32 = 2;
    /// Its net ended before the order was executed.
    pub(super) const WITHDRAWN: i32 = 3;
}

/// The gripper.
#[derive(Debug)]
pub(super) struct Gripper {
    fingers: Fingers,
    gripper: Interface,
    /// The latest order, and whether it is being executed.
    order: u64,
    under_way: bool,
    answer: Option<Answer>,
    reported: DeviceState,
    taken: DeviceCommand,
    state: LatestWriter<DeviceState>,
    command: LatestReader<DeviceCommand>,
}

impl Gripper {
    pub(super) fn new(end: DeviceEnd) -> Self {
        let mut layout = Layout::default();
        let fingers = Fingers::new(BarConfig::default());
        // As `parts::lay` does it for a gripper.
        let gripper = Interface::new(&mut layout, fingers.distance_max());
        Self {
            fingers,
            gripper,
            order: 0,
            under_way: false,
            answer: None,
            reported: DeviceState::new(layout.signals),
            taken: DeviceCommand::new(layout.commands),
            state: end.state,
            command: end.command,
        }
    }

    /// One cycle behind this drive. The fingers are homed only if they `may_move`. `fresh` is whether the net thread
    /// is alive: orders end with it.
    pub(super) fn cycle(&mut self, drive: &mut Drive, may_move: bool, fresh: bool, tick: &Tick) {
        let taken = &mut self.taken;
        self.command.read_with(|command| taken.copy_from(command));
        let is_there = drive.feedback().is_some();
        let speaks = match drive.state() {
            DriveState::Absent | DriveState::Identify | DriveState::Refused(..) => false,
            DriveState::Prepare(_)
            | DriveState::Uncommutated
            | DriveState::Commutate(_)
            | DriveState::Settle(_)
            | DriveState::Ready
            | DriveState::Clear(_)
            | DriveState::Exhausted => true,
        };
        if is_there && speaks {
            self.fingers.start(now(tick));
            self.fingers.cycle(drive.mailbox(), may_move, now(tick));
        } else {
            self.fingers.forget();
        }
        self.apply(fresh, tick);
        self.publish(is_there, tick);
    }

    /// Why it accepts no orders, if the cause is persistent.
    pub(super) const fn waits_for(&self, may_move: bool) -> Option<Wait> {
        match self.fingers.state() {
            GripperState::Failed(error, _) => Some(Wait::Gripper(error)),
            GripperState::Query if !may_move => Some(Wait::GripperNotHomed),
            GripperState::Idle
            | GripperState::Setup(_)
            | GripperState::Query
            | GripperState::Origin(_)
            | GripperState::Open
            | GripperState::Close
            | GripperState::Preset(_)
            | GripperState::Mark
            | GripperState::Ready
            | GripperState::Order
            | GripperState::Stop(_)
            | GripperState::Short => None,
        }
    }

    fn apply(&mut self, fresh: bool, tick: &Tick) {
        let given = self.gripper.order.command.read(&self.taken.words);
        let in_force = fresh && given.is_some_and(|given| !given.is_withdrawn());
        if let Some(given) = given.filter(|given| given.cycle != self.order) {
            self.order = given.cycle;
            self.under_way = in_force && self.fingers.order(given.value, now(tick));
            if !self.under_way && in_force {
                let error = if self.fingers.is_ready() {
                    error::RANGE
                } else {
                    error::FAILED
                };
                self.end(error);
            }
        }
        if !in_force {
            self.fingers.stop();
            if self.under_way {
                self.end(error::WITHDRAWN);
            }
        }
        if !self.under_way {
            return;
        }
        match self.fingers.state() {
            GripperState::Order => {}
            GripperState::Ready => self.end(0),
            GripperState::Idle
            | GripperState::Setup(_)
            | GripperState::Query
            | GripperState::Origin(_)
            | GripperState::Open
            | GripperState::Close
            | GripperState::Preset(_)
            | GripperState::Mark
            | GripperState::Short
            | GripperState::Stop(_)
            | GripperState::Failed(..) => self.end(error::FAILED),
        }
    }

    const fn end(&mut self, error: i32) {
        self.under_way = false;
        let order = self.order;
        self.answer = Some(Answer { order, error });
    }

    fn publish(&mut self, is_there: bool, tick: &Tick) {
        let status = match (is_there, self.fingers.is_ready()) {
            (false, _) => DeviceStatus::Offline,
            (true, false) => DeviceStatus::SafeOperational,
            (true, true) => DeviceStatus::Operational,
        };
        let reported = &mut self.reported;
        reported.enter(status, tick.scheduled);
        let gripper = &self.gripper;
        gripper
            .distance
            .report(&mut reported.signals, self.fingers.distance());
        gripper
            .order
            .answer
            .report(&mut reported.signals, self.answer);
        let reported = &self.reported;
        self.state.write_with(|state| state.copy_from(reported));
    }
}
