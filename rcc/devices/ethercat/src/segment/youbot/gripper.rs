//! The gripper of a youBot as a device: orders of nets, and the distance between its fingers. It uses the mailbox of
//! the last joint's drive, between that drive's own requests.

use takt_ethercat::youbot::{BarConfig, Drive, DriveState, Gripper as Fingers, GripperState};
use takt_net::device::Answer;
use takt_rt::cycle::Tick;

use super::{Wait, now};
use crate::segment::wire::{WireValues, wire_figures};
use takt_core::device::driver::DeviceEnd;
use takt_core::device::endpoint::Endpoint;
use takt_core::device::parts::with_figures;
use takt_core::device::{DeviceStatus, Part};

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
    /// The latest order, and whether it is being executed.
    order: u64,
    under_way: bool,
    answer: Option<Answer>,
    end: Endpoint,
}

impl Gripper {
    pub(super) fn new(end: DeviceEnd) -> Self {
        let fingers = Fingers::new(BarConfig::default());
        let distance_max = fingers.distance_max();
        Self {
            fingers,
            order: 0,
            under_way: false,
            answer: None,
            end: Endpoint::new(
                end,
                &with_figures(&[Part::Gripper { distance_max }], wire_figures()),
                0,
            ),
        }
    }

    /// Reports the figures of the wire with the next cycle.
    pub(super) fn report_wire(&mut self, values: &WireValues) {
        self.end.report_figures(0, values.iter().copied());
    }

    /// One cycle behind this drive. The fingers are homed only if they `may_move`. `fresh` is whether the net thread
    /// is alive: orders end with it.
    pub(super) fn cycle(&mut self, drive: &mut Drive, may_move: bool, fresh: bool, tick: &Tick) {
        self.end.take();
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
        let place = self.end.interfaces.gripper.as_ref();
        let given = place.and_then(|it| it.order.command.read(&self.end.taken.words));
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
                self.finish(error);
            }
        }
        if !in_force {
            self.fingers.stop();
            if self.under_way {
                self.finish(error::WITHDRAWN);
            }
        }
        if !self.under_way {
            return;
        }
        match self.fingers.state() {
            GripperState::Order => {}
            GripperState::Ready => self.finish(0),
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
            | GripperState::Failed(..) => self.finish(error::FAILED),
        }
    }

    const fn finish(&mut self, error: i32) {
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
        let reported = &mut self.end.reported;
        reported.enter(status, tick.scheduled);
        if let Some(place) = &self.end.interfaces.gripper {
            let signals = &mut reported.signals;
            place.distance.report(signals, self.fingers.distance());
            place.order.answer.report(signals, self.answer);
        }
        self.end.publish();
    }
}
