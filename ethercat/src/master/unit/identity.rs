//! The steps that identify a slave, at the first start and when it returns.

use super::super::compare;
use super::super::event::{Fault, Outbox};
use super::op::Op;
use super::start::{Gate, Step};
use super::{Context, ProcessData, Unit, info};
use crate::AlState;
use crate::sii::{self, Sii};

/// Maximum number of SII words to read: 4 KiB.
const SII_WORDS_MAX: u16 = 2048;

impl Unit {
    /// The whole SII at the first start, the identity whenever the slave returns.
    pub(super) fn read_sii(&mut self) -> Op {
        self.start.sii.clear();
        let (word, end) = if self.start.known {
            (sii::word::IDENTITY, sii::word::IDENTITY + 8)
        } else {
            (0, 0x42)
        };
        Op::Sii {
            word,
            end,
            polls: false,
            writes: false,
        }
    }

    pub(super) fn sii_read(&mut self, cx: &Context<'_>, out: &mut Outbox) {
        if self.start.known {
            return self.recognise(cx, out);
        }
        let have = u16::try_from(self.start.sii.len() / 2).unwrap_or(u16::MAX);
        let need = info::words_needed(&self.start.sii).min(SII_WORDS_MAX);
        if have < need {
            self.operation.op = Op::Sii {
                word: have,
                end: need,
                polls: false,
                writes: false,
            };
            return;
        }
        let bytes = std::mem::take(&mut self.start.sii);
        let sii = Sii::new(&bytes);
        self.info.take_sii(&sii);
        self.process = ProcessData::from_sii(&sii);
        self.mailbox
            .configure(self.info.mailbox, self.info.protocols);
        self.start.sii = bytes;
        self.start.known = true;
        if self.gate == Gate::Identity {
            return self.enter(Step::Identified, cx, out);
        }
        self.joined_late(cx, out);
    }

    /// An optional slave appears for the first time while the segment runs.
    pub(super) fn joined_late(&mut self, cx: &Context<'_>, out: &mut Outbox) {
        let expected = (
            self.spec.vendor.unwrap_or(0),
            self.spec.product.unwrap_or(0),
        );
        let found = (self.info.identity.vendor, self.info.identity.product);
        if !compare::is_expected(&self.spec, &self.info) {
            self.start.known = false;
            return self.fail(Fault::Identity { expected, found }, cx, out);
        }
        self.plan(cx, out);
        self.gate = Gate::Goal;
        if self.start.step != Step::Failed {
            self.enter(Step::Identified, cx, out);
        }
    }

    /// It must be the same slave as before.
    pub(super) fn recognise(&mut self, cx: &Context<'_>, out: &mut Outbox) {
        let number = |at: usize| {
            let four = self.start.sii.get(at..).and_then(|rest| rest.first_chunk());
            four.map_or(0, |four| u32::from_le_bytes(*four))
        };
        let found = (number(0), number(4));
        let expected = (self.info.identity.vendor, self.info.identity.product);
        if found == expected {
            self.enter(Step::Identified, cx, out);
        } else {
            self.fail(Fault::Identity { expected, found }, cx, out);
        }
    }

    /// Its configuration is known: determines its process data.
    pub(in crate::master) fn plan(&mut self, cx: &Context<'_>, out: &mut Outbox) {
        let bytes = std::mem::take(&mut self.start.sii);
        let planned = self.process.want(&self.spec, &Sii::new(&bytes));
        self.start.sii = bytes;
        self.start.assignments = if self.mailbox.speaks_coe() {
            self.process.assignments(&self.spec)
        } else {
            Vec::new()
        };
        self.gate = Gate::Process;
        if self.is_apart() {
            self.process = ProcessData::default();
            if self.spec.goal == AlState::Boot {
                let areas = self.info.boot_mailbox;
                self.mailbox.configure(areas, self.info.protocols);
            }
            return;
        }
        if let Err(fault) = planned {
            self.fail(fault, cx, out);
        }
    }
}
