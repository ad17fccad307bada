//! The steps that synchronise a slave's clock to the reference and start its SYNC signals. The arithmetic is in
//! [`crate::dc`].

use super::super::event::{Fault, Outbox};
use super::op::Op;
use super::start::Step;
use super::steps::Prepared;
use super::watch::difference;
use super::{Context, Unit};
use crate::config::{MasterConfig, Unlocked};
use crate::{dc, register};

/// Consecutive differences within the window after which a clock counts as locked.
const LOCKED: u8 = 16;

impl Unit {
    /// Whether its clock can be the reference: present, not failed, and brought to a state in which clocks are set up.
    pub(in crate::master) fn can_lead(&self, config: &MasterConfig) -> bool {
        self.is_present()
            && self.mapped
            && !self.has_failed()
            && self.info.has_clock()
            && self.goes_on(config)
    }

    /// Whether its clock is synchronised.
    pub(super) fn follows(&self, cx: &Context<'_>) -> bool {
        self.info.has_clock() && cx.reference.is_some()
    }

    /// All slaves but the reference wait for the reference.
    pub(super) fn clock_wait(&self, cx: &Context<'_>) -> Prepared {
        if self.spec.sync.is_some() && !self.info.has_clock() {
            return Prepared::Fail(Fault::NoClock);
        }
        let first = cx.reference == Some(self.number) || cx.reference_ns.is_some();
        if first || !self.follows(cx) {
            Prepared::Skip
        } else {
            Prepared::Wait
        }
    }

    /// Proceeds as soon as the reference shows its time. A slave with SYNC signals fails after the lock timeout; a
    /// slave without does not need the time and proceeds.
    pub(super) fn pass_clock(&mut self, cx: &Context<'_>, out: &mut Outbox) {
        let first = self.start.step == Step::ClockWait && cx.reference == Some(self.number);
        let waited = cx.now.saturating_sub(self.operation.since);
        let ready = first || cx.reference_ns.is_some() || !self.follows(cx);
        let Some(slave) = cx.reference.filter(|_| !ready) else {
            return self.enter(self.start.step, cx, out);
        };
        if waited <= cx.config.clocks.lock {
            return;
        }
        if self.spec.sync.is_some() {
            self.fail(Fault::NoReference { slave }, cx, out);
        } else {
            self.enter(Step::SafeOp, cx, out);
        }
    }

    pub(super) fn write_clock(&mut self) -> Op {
        let mut bytes = [0; 12];
        let (offset, delay) = bytes.split_at_mut(8);
        offset.copy_from_slice(&self.clock.offset.to_le_bytes());
        delay.copy_from_slice(&self.clock.delay_ns.to_le_bytes());
        self.operation.write(register::DC_OFFSET, &bytes)
    }

    pub(super) fn lock(&mut self, cx: &Context<'_>) -> Prepared {
        if cx.reference == Some(self.number) && self.follows(cx) {
            self.clock.locked = true;
            return Prepared::Skip;
        }
        if self.spec.sync.is_none() || !self.follows(cx) {
            return Prepared::Skip;
        }
        Prepared::Do(Op::Read {
            at: register::DC_DIFFERENCE,
            len: 4,
        })
    }

    pub(super) fn sync_start(&mut self, cx: &Context<'_>) -> Prepared {
        let Some(sync) = self.spec.sync.filter(|_| self.follows(cx)) else {
            return Prepared::Skip;
        };
        let Some(now) = cx.reference_ns else {
            return Prepared::Wait;
        };
        let start = dc::start_time(now, cx.config.clocks.lead, sync.sync0, sync.shift_ns);
        self.clock.start_ns = Some(start);
        Prepared::Do(
            self.operation
                .write(register::DC_START_TIME, &start.to_le_bytes()),
        )
    }

    pub(super) fn sync(&mut self, step: Step) -> Prepared {
        let Some(sync) = self.spec.sync.filter(|_| self.clock.start_ns.is_some()) else {
            return Prepared::Skip;
        };
        if step == Step::SyncOn {
            return Prepared::Do(
                self.operation
                    .write(register::DC_CONTROL, &sync.assign_activate.to_le_bytes()),
            );
        }
        let ns = |time: std::time::Duration| {
            u32::try_from(time.as_nanos())
                .unwrap_or(u32::MAX)
                .to_le_bytes()
        };
        let mut bytes = [0; 8];
        let (sync0, sync1) = bytes.split_at_mut(4);
        sync0.copy_from_slice(&ns(sync.sync0));
        sync1.copy_from_slice(&ns(sync.sync1));
        Prepared::Do(self.operation.write(register::DC_SYNC0_CYCLE, &bytes))
    }

    pub(super) fn take_times(&mut self, data: &[u8]) -> bool {
        for (time, four) in self.clock.times.iter_mut().zip(data.chunks_exact(4)) {
            *time = four
                .first_chunk()
                .map_or(0, |four| u32::from_le_bytes(*four));
        }
        self.clock.latched = !data.is_empty();
        true
    }

    /// Computes the offset to the reference time; `false` if this frame does not show it.
    pub(super) fn take_offset(&mut self, data: &[u8], cx: &Context<'_>) -> bool {
        let local = data
            .first_chunk()
            .map_or(0, |eight| u64::from_le_bytes(*eight));
        // Bits beyond the width of a clock are not part of its time.
        let local = local & u64::MAX >> (64 - self.info.clock_bits());
        let wanted = if cx.reference == Some(self.number) {
            let sent = u64::try_from(cx.sent_at.as_nanos()).unwrap_or(u64::MAX);
            cx.config.clocks.epoch_ns.wrapping_add(sent)
        } else if let Some(reference) = cx.reference_ns {
            reference.wrapping_add(self.clock.delay_ns.into())
        } else {
            return false;
        };
        self.clock.offset = wanted.wrapping_sub(local);
        true
    }

    /// Whether the clock is locked, or the lock timeout has expired.
    pub(super) fn take_difference(
        &mut self,
        data: &[u8],
        cx: &Context<'_>,
        out: &mut Outbox,
    ) -> bool {
        let found = data
            .first_chunk()
            .map_or(i32::MAX, |four| difference(*four));
        let window_ns = cx.config.clocks.window_ns;
        self.clock.difference_ns = Some(found);
        self.clock.streak = if found.unsigned_abs() <= window_ns {
            self.clock.streak + 1
        } else {
            0
        };
        // It may have become the reference meanwhile, which has no difference to itself.
        if self.clock.streak >= LOCKED || cx.reference == Some(self.number) {
            self.clock.locked = true;
            return true;
        }
        if cx.now.saturating_sub(self.operation.since) <= cx.config.clocks.lock {
            return false;
        }
        match cx.config.clocks.unlocked {
            Unlocked::Start => true,
            Unlocked::Refuse => {
                self.fail(
                    Fault::Clock {
                        difference_ns: found,
                        window_ns,
                    },
                    cx,
                    out,
                );
                false
            }
        }
    }
}
