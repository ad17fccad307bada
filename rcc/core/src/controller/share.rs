//! What nets take together: time of a cycle of their thread, memory, and text. The time is counted where
//! nets start, in the executor; here are the bounds of the rest, and the texts of all refusals.

use std::time::Duration;

use takt_net::fault::{Fault, FaultKind};
use takt_net::{Plan, Rejection};
use takt_rt::Nanos;

use crate::controller::NetState;
use crate::controller::desk::{Desk, Net, Prepared};
use crate::controller::rules::RuleId;
use crate::error::Error;
use crate::executor::links::OUT_READERS;
use crate::executor::rules::Rule;
use crate::ids::NetId;

/// Bytes that all nets that can run take together. Those being loaded do not count yet.
pub const NETS_MEMORY_MAX: usize = 1 << 30;
/// Bytes of the texts of all nets together.
pub const NETS_TEXT_MAX: usize = 64 << 20;
/// Running nets that a refusal names.
const HEAVIEST: usize = 3;

/// Bytes that a net takes with the boxes by which programs and other nets see it.
pub(super) fn memory(plan: &Plan) -> usize {
    let boxes = (OUT_READERS + 2) * plan.outbox().words() + 3 * plan.inbox().words();
    plan.memory() + boxes * size_of::<u64>()
}

impl Desk {
    /// Makes room for the text of one more net, for which nets that are over may have to go.
    ///
    /// # Errors
    /// If the texts of the others leave none.
    pub(super) fn take_text(&mut self, bytes: usize) -> Result<(), Error> {
        loop {
            let taken: usize = self.nets.values().map(|net| net.text().len()).sum();
            if taken + bytes <= NETS_TEXT_MAX {
                return Ok(());
            }
            if !self.forget_oldest() {
                return Err(Error::TooMany {
                    what: "bytes of the texts of all nets",
                    bound: NETS_TEXT_MAX,
                });
            }
        }
    }

    /// Lets a net have its memory.
    ///
    /// # Errors
    /// If the other nets leave too little.
    pub(super) fn take_memory(&self, prepared: Prepared) -> Result<Prepared, Rejection> {
        let taken: usize = self.nets.values().filter_map(Net::memory).sum();
        let found = taken + memory(&prepared.running.plan);
        if found <= NETS_MEMORY_MAX {
            return Ok(prepared);
        }
        let kind = FaultKind::Bound {
            what: "bytes of all nets that can run",
            found,
            bound: NETS_MEMORY_MAX,
        };
        Err(Rejection {
            faults: vec![Fault::new(kind, 0..0)],
        })
    }

    /// Why a net cannot start beside those that run.
    pub(super) fn overload(&self, net: NetId, running: Nanos, budget: Nanos) -> Error {
        Error::Overload {
            net,
            cost: self.cost_of(net),
            running: duration(running),
            budget: duration(budget),
            heaviest: self.heaviest(self.thread_of(net.0)),
        }
    }

    /// Why a net cannot start beside those that a rule is to start.
    pub(super) fn overload_kept(&self, net: NetId, rule: u32, budget: Nanos) -> Error {
        let kept_for = self.rules.get(&RuleId(rule));
        let kept_for = kept_for.map_or(&[][..], |entry| &entry.request.start);
        let kept_for = kept_for.iter().map(|id| self.priced(*id));
        Error::OverloadKept {
            net,
            cost: self.cost_of(net),
            budget: duration(budget),
            rule,
            kept_for: kept_for.collect::<Vec<_>>().join(", "),
        }
    }

    /// Why a rule cannot start its nets beside those that run on.
    pub(super) fn rule_overload(
        &self,
        rule: &Rule,
        running: Nanos,
        started: Nanos,
        budget: Nanos,
    ) -> Error {
        let thread = rule
            .orders()
            .start
            .first()
            .map_or(0, |net| self.thread_of(*net));
        Error::RuleOverload {
            started: duration(started),
            running: duration(running),
            budget: duration(budget),
            heaviest: self.heaviest(thread),
        }
    }

    fn cost_of(&self, net: NetId) -> Duration {
        let net = self.nets.get(&net).and_then(Net::counted);
        net.map(|counted| counted.cost).unwrap_or_default()
    }

    fn priced(&self, net: NetId) -> String {
        format!("net {net} with {:?}", self.cost_of(net))
    }

    /// The running nets of a thread that cost most.
    fn heaviest(&self, thread: usize) -> String {
        let runs = |net: &Net| matches!(net.state(), NetState::Running | NetState::Cancelling);
        let nets = self.nets.iter();
        let nets = nets.filter(|(_, net)| net.thread == thread && runs(net));
        let mut nets: Vec<_> = nets.map(|(id, _)| (self.cost_of(*id), *id)).collect();
        nets.sort_by_key(|(cost, _)| std::cmp::Reverse(*cost));
        let others = nets.len().saturating_sub(HEAVIEST);
        let named = nets.iter().take(HEAVIEST).map(|(_, id)| self.priced(*id));
        let mut named: Vec<_> = named.collect();
        if others > 0 {
            named.push(format!("{others} more"));
        }
        if named.is_empty() {
            return "no net runs there".to_owned();
        }
        named.join(", ")
    }
}

impl Net {
    /// Bytes that it takes; `None` if it cannot run any more.
    fn memory(&self) -> Option<usize> {
        match self.state() {
            NetState::Loading | NetState::Rejected | NetState::Terminated | NetState::Unloaded => {
                None
            }
            NetState::Ready | NetState::Scheduled | NetState::Running | NetState::Cancelling => {
                Some(self.counted()?.memory)
            }
        }
    }
}

fn duration(nanos: Nanos) -> Duration {
    Duration::from_nanos(u64::try_from(nanos.0).unwrap_or(0))
}
