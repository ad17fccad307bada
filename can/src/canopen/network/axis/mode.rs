//! The constant mode of operation of an axis: requests of another one are refused, and 6061h, which is not in its process data, is
//! watched by SDO.

use std::time::Duration;

use super::AxisFault;

/// Time between two uploads of 6061h.
const EVERY: Duration = Duration::from_secs(1);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Upload {
    /// None before then.
    Idle(Duration),
    Due,
    /// Its answer is awaited.
    Sent,
}

/// The mode of an axis; of one whose mode is not constant it watches nothing, and refuses nothing.
#[derive(Clone, Copy, Debug)]
pub(super) struct ConstantMode {
    planned: Option<i8>,
    refused: Option<AxisFault>,
    upload: Upload,
    /// 6061h as uploaded last, if it is another mode.
    other: Option<i8>,
}

impl ConstantMode {
    pub(super) const fn new(planned: Option<i8>) -> Self {
        Self {
            planned,
            refused: None,
            upload: Upload::Idle(Duration::ZERO),
            other: None,
        }
    }

    /// Its node no longer runs.
    pub(super) const fn restart(&mut self) {
        (self.upload, self.other) = (Upload::Idle(Duration::ZERO), None);
    }

    /// Whether the axis can have that mode; notes a refusal.
    pub(super) fn takes(&mut self, requested: i8) -> bool {
        let planned = self.planned.filter(|mode| *mode != requested);
        self.refused = planned.map(|planned| AxisFault::ConstantMode { planned, requested });
        planned.is_none()
    }

    /// The last request, if it was refused.
    pub(super) const fn refused(&self) -> Option<AxisFault> {
        self.refused
    }

    /// The mode that the drive shows, if it is another one.
    pub(super) const fn other(&self) -> Option<i8> {
        self.other
    }

    /// One cycle. Drives may show no mode before they are enabled.
    pub(super) fn step(&mut self, is_enabled: bool, now: Duration) {
        if !is_enabled {
            self.other = None;
        } else if let Upload::Idle(until) = self.upload
            && self.planned.is_some()
            && now >= until
        {
            self.upload = Upload::Due;
        }
    }

    /// Whether an upload of 6061h is due.
    pub(super) fn is_due(&self) -> bool {
        self.upload == Upload::Due
    }

    /// Takes the upload that is due; its answer goes to [`Self::answered`].
    pub(super) fn take(&mut self) -> bool {
        let is_due = self.is_due();
        if is_due {
            self.upload = Upload::Sent;
        }
        is_due
    }

    /// Takes the answer, `None` if there is no value; returns whether one was awaited. A drive that does not answer is watched by its heartbeat.
    pub(super) fn answered(&mut self, shown: Option<i8>, now: Duration) -> bool {
        if self.upload != Upload::Sent {
            return false;
        }
        self.upload = Upload::Idle(now + EVERY);
        if shown.is_some() {
            self.other = shown.filter(|_| shown != self.planned);
        }
        true
    }
}
