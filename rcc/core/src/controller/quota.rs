//! Quotas that nets share: cycle time and slots of their thread, memory, and text, with their limits
//! and error texts. Nets that rules may still start count as [`admission`](super::admission) computes.

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

use takt_net::fault::{Fault, FaultKind};
use takt_net::{Plan, Rejection};

use crate::controller::NetState;
use crate::controller::admission::{Candidate, Succession, most_together};
use crate::controller::net::{Counted, Net};
use crate::controller::registry::Registry;
use crate::controller::threads::busy;
use crate::error::Error;
use crate::executor::RUNNING_MAX;
use crate::executor::figures::budget;
use crate::executor::links::OUT_READERS;
use crate::executor::rules::RuleState;
use crate::ids::NetId;

/// Number of running nets that an error names.
const HEAVIEST: usize = 3;

/// Memory limits of all nets together, bytes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Quota {
    /// Nets that can run, and nets being loaded.
    pub(super) memory: usize,
    /// Texts of all nets.
    text: usize,
}

impl Quota {
    pub(super) const fn of_mib(mib: u32) -> Self {
        let memory = (mib as usize) << 20;
        Self {
            memory,
            text: memory / 16,
        }
    }
}

/// Bytes of a net with the boxes through which programs and other nets access it.
pub(super) fn memory(plan: &Plan) -> usize {
    let boxes = (OUT_READERS + 2) * plan.outbox().words() + 3 * plan.inbox().words();
    plan.memory() + boxes * size_of::<u64>()
}

/// Memory is returned to the host after unloaded nets took at least this, bytes.
const RETURN_BYTES_MIN: usize = 16 << 20;
/// Interval of that check.
const RETURN_EVERY: Duration = Duration::from_secs(1);

/// Decides when memory of unloaded nets is returned to the host.
#[derive(Debug, Default)]
pub(super) struct MemoryReturn {
    /// Peak memory of all nets since the last return, bytes.
    peak: usize,
    checked: Option<Instant>,
}

impl MemoryReturn {
    /// Whether the next check is due.
    pub(super) fn is_due(&mut self, now: Instant) -> bool {
        let due = self
            .checked
            .is_none_or(|at| now.duration_since(at) >= RETURN_EVERY);
        if due {
            self.checked = Some(now);
        }
        due
    }

    /// Whether enough was unloaded to return memory; `taken` is what nets take now, bytes.
    pub(super) fn check(&mut self, taken: usize) -> bool {
        let returns = self.peak >= taken.saturating_add(RETURN_BYTES_MIN);
        self.peak = if returns { taken } else { self.peak.max(taken) };
        returns
    }
}

impl Registry {
    /// Reserves text quota for one more net; ended nets may be unloaded for it.
    ///
    /// # Errors
    /// If the texts of the other nets exhaust the quota.
    pub(super) fn take_text(&mut self, bytes: usize) -> Result<(), Error> {
        let bound = self.room.text;
        let text = |net: &Net| net.text().len();
        let kept = self.nets.values().filter(|net| !net.is_over());
        if kept.map(text).sum::<usize>() + bytes > bound {
            let what = "bytes of the texts of all nets";
            return Err(Error::TooMany { what, bound });
        }
        let mut taken: usize = self.nets.values().map(text).sum();
        while taken + bytes > bound {
            let Some(gone) = self.forget_oldest() else {
                return Err(busy());
            };
            taken -= text(&gone);
        }
        Ok(())
    }

    /// Reserves memory for a net while it is loaded: `most`, or all that is left if no other net is being loaded.
    /// Returns the amount; `None` if the net has to wait for others.
    pub(super) fn keep_memory(&mut self, id: NetId, most: usize) -> Option<usize> {
        let free = self.room.memory.saturating_sub(self.memory_taken());
        let is_alone = self.nets.values().all(|net| net.reserved == 0);
        let kept = most.min(free);
        if kept < most && !is_alone {
            return None;
        }
        if let Some(net) = self.nets.get_mut(&id) {
            net.reserved = kept;
        }
        Some(kept)
    }

    pub(super) fn memory_taken(&self) -> usize {
        self.nets.values().map(Net::memory).sum()
    }

    /// Ends the reservation of a net that was loaded.
    pub(super) fn release_memory(&mut self, id: NetId) {
        if let Some(net) = self.nets.get_mut(&id) {
            net.reserved = 0;
        }
    }

    /// Checks the memory quota for one more net.
    ///
    /// # Errors
    /// If the other nets leave too little memory.
    pub(super) fn check_memory(&self, plan: &Plan) -> Result<(), Rejection> {
        let found = self.memory_taken() + memory(plan);
        let bound = self.room.memory;
        if found <= bound {
            return Ok(());
        }
        let item = "bytes together with all other nets (controller.nets_memory_mib)";
        let kind = FaultKind::Bound { item, found, bound };
        Err(Rejection {
            faults: vec![Fault::new(kind, 0..0)],
        })
    }

    /// The error for a net that cannot start beside the running nets.
    pub(super) fn overload(&self, net: NetId, running: Duration, budget: Duration) -> Error {
        Error::Overload {
            net,
            cost: self.cost_of(net),
            running,
            budget,
            heaviest: self.heaviest(self.thread_of(net.0), |_, net| net.runs()),
        }
    }

    /// Checks that a net can start and still leave cycle time and slots for the nets of waiting rules.
    ///
    /// # Errors
    /// If not.
    pub(super) fn keep_for_start(&self, id: NetId) -> Result<(), Error> {
        let thread = self.thread_of(id.0);
        let (budget, most) = self.most_cost(thread, Some(id), None);
        if most <= budget {
            return self.keep_places(thread, Some(id), None);
        }
        let (cost, running) = (self.cost_of(id), self.running_cost(thread));
        if running + cost > budget {
            return Err(self.overload(id, running, budget));
        }
        Err(Error::OverloadKept {
            net: id,
            cost,
            most,
            budget,
            waiting: self.heaviest(thread, |_, net| net.waits_for_rules()),
        })
    }

    /// Checks that cycle time and slots are guaranteed for the nets that a new rule starts.
    ///
    /// # Errors
    /// If not.
    pub(super) fn keep_for_rule(&self, new: &Succession, start: &[NetId]) -> Result<(), Error> {
        let threads: BTreeSet<_> = start.iter().map(|net| self.thread_of(net.0)).collect();
        for thread in threads {
            let (budget, most) = self.most_cost(thread, None, Some(new));
            if most > budget {
                let of_thread = start.iter().filter(|net| self.thread_of(net.0) == thread);
                return Err(Error::RuleOverload {
                    started: of_thread.map(|net| self.cost_of(*net)).sum(),
                    most,
                    budget,
                    running: self.heaviest(thread, |id, net| net.runs() && !new.names(id)),
                    waiting: self
                        .heaviest(thread, |id, net| net.waits_for_rules() && !new.names(id)),
                });
            }
            self.keep_places(thread, None, Some(new))?;
        }
        Ok(())
    }

    fn keep_places(
        &self,
        thread: usize,
        starting: Option<NetId>,
        new: Option<&Succession>,
    ) -> Result<(), Error> {
        let nets = self.candidates(thread, starting, |_| 1);
        if most_together(&nets, self.successions(new), RUNNING_MAX as u64) <= RUNNING_MAX as u64 {
            return Ok(());
        }
        Err(Error::TooMany {
            what: "nets of one thread that run or that rules may start beside them",
            bound: RUNNING_MAX,
        })
    }

    /// The budget of a thread's nets, and the bound on their total cost with one more net running now, or
    /// one more rule.
    fn most_cost(
        &self,
        thread: usize,
        starting: Option<NetId>,
        new: Option<&Succession>,
    ) -> (Duration, Duration) {
        let period = self.threads.get(thread).map(|thread| thread.period);
        let budget = budget(period.unwrap_or_default());
        let nets = self.candidates(thread, starting, |net| nanos(net.cost));
        let most = most_together(&nets, self.successions(new), nanos(budget));
        (budget, Duration::from_nanos(most))
    }

    fn running_cost(&self, thread: usize) -> Duration {
        let nets = self.candidates(thread, None, |net| nanos(net.cost));
        let running = nets.values().filter(|net| net.runs);
        Duration::from_nanos(running.map(|net| net.weight).sum())
    }

    fn successions<'a>(&'a self, new: Option<&'a Succession>) -> Vec<&'a Succession> {
        let rules = self.rules.values();
        let waiting = rules.filter(|rule| rule.state == RuleState::Active);
        waiting.map(|rule| &rule.succession).chain(new).collect()
    }

    /// All nets that can run, from the view of a thread: nets of other threads weigh nothing.
    fn candidates(
        &self,
        thread: usize,
        starting: Option<NetId>,
        weight: impl Fn(&Counted) -> u64,
    ) -> BTreeMap<NetId, Candidate> {
        let candidate = |(id, net): (&NetId, &Net)| {
            let counted = net.counted()?;
            let runs = match net.state() {
                NetState::Running | NetState::Cancelling => true,
                NetState::Ready | NetState::Scheduled => net.is_to_start() || starting == Some(*id),
                NetState::Loading
                | NetState::Rejected
                | NetState::Terminated
                | NetState::Unloaded => return None,
            };
            let weight = if net.thread == thread {
                weight(counted)
            } else {
                0
            };
            let candidate = Candidate {
                weight,
                runs,
                resources: counted.resources,
            };
            Some((*id, candidate))
        };
        self.nets.iter().filter_map(candidate).collect()
    }

    fn cost_of(&self, net: NetId) -> Duration {
        let net = self.nets.get(&net).and_then(Net::counted);
        net.map(|counted| counted.cost).unwrap_or_default()
    }

    fn priced(&self, net: NetId) -> String {
        format!("net {net} with {:?}", self.cost_of(net))
    }

    /// The most expensive nets of a thread among those selected.
    fn heaviest(&self, thread: usize, is_meant: impl Fn(NetId, &Net) -> bool) -> String {
        let nets = self.nets.iter();
        let nets = nets.filter(|(id, net)| net.thread == thread && is_meant(**id, net));
        let mut nets: Vec<_> = nets.map(|(id, _)| (self.cost_of(*id), *id)).collect();
        nets.sort_by_key(|(cost, _)| std::cmp::Reverse(*cost));
        let others = nets.len().saturating_sub(HEAVIEST);
        let named = nets.iter().take(HEAVIEST).map(|(_, id)| self.priced(*id));
        let mut named: Vec<_> = named.collect();
        if others > 0 {
            named.push(format!("{others} more"));
        }
        if named.is_empty() {
            return "none".to_owned();
        }
        named.join(", ")
    }
}

impl Net {
    fn runs(&self) -> bool {
        matches!(self.state(), NetState::Running | NetState::Cancelling)
    }

    fn waits_for_rules(&self) -> bool {
        self.state() == NetState::Scheduled
    }

    /// Bytes that it takes or that are reserved for it.
    fn memory(&self) -> usize {
        match self.state() {
            NetState::Loading => self.reserved,
            NetState::Rejected | NetState::Terminated | NetState::Unloaded => 0,
            NetState::Ready | NetState::Scheduled | NetState::Running | NetState::Cancelling => {
                self.counted().map_or(0, |counted| counted.memory)
            }
        }
    }
}

fn nanos(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::executor::stop::EmergencyStop;
    use crate::ids::SessionId;

    #[test]
    fn memory_is_reserved_while_loading() {
        let room = Quota {
            memory: 100,
            text: 10,
        };
        let stop = Arc::new(EmergencyStop::new(false));
        let mut registry = Registry::new(Vec::new(), None, stop, None, room);
        let [first, second] = [NetId(0), NetId(1)];
        for id in [first, second] {
            let net = Net::new(SessionId::NONE, String::new(), "".into());
            registry.nets.insert(id, net);
        }
        assert_eq!(registry.keep_memory(first, 60), Some(60));
        assert_eq!(
            registry.keep_memory(second, 60),
            None,
            "it waits for the other"
        );
        assert_eq!(registry.keep_memory(second, 40), Some(40));
        for id in [first, second] {
            registry.release_memory(id);
        }
        assert_eq!(registry.keep_memory(second, 200), Some(100), "all there is");
        assert_eq!(registry.keep_memory(first, 1), None);
        // One that is rejected keeps none.
        registry.release_memory(second);
        assert_eq!(registry.keep_memory(first, 1), Some(1));
    }

    #[test]
    fn memory_return_follows_large_unloads() {
        let mut returns = MemoryReturn::default();
        let mib = 1 << 20;
        assert!(!returns.check(0));
        assert!(!returns.check(100 * mib));
        assert!(!returns.check(90 * mib), "too little");
        assert!(returns.check(84 * mib));
        assert!(!returns.check(84 * mib), "once");
        assert!(!returns.check(70 * mib));
        assert!(returns.check(68 * mib), "in small steps too");
    }
}
