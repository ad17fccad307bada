//! Admission control: what nets share, with its limits and error texts: cycle time and slots of their thread, memory,
//! and text. Nets that rules may still start count as [`forest`] computes. It starts and ends nothing.

pub(super) mod forest;

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

use takt_net::fault::{Fault, FaultKind};
use takt_net::{Limits, Plan, Rejection};

use crate::controller::nets::{Counted, Net, Nets, memory};
use crate::controller::rules::Rules;
use crate::error::Error;
use crate::executor::RUNNING_MAX;
use crate::executor::figures::budget;
use crate::ids::{NetId, NetState};
use forest::{Candidate, Succession, most_together};

/// Number of running nets that an error names.
const HEAVIEST: usize = 3;

/// Limits of all nets together.
#[derive(Clone, Copy, Debug)]
pub(super) struct Admission {
    /// Bytes of nets that can run, and of nets being loaded.
    memory: usize,
    /// Bytes of the texts of all nets.
    text: usize,
}

/// Limits for a net of that period: its cost bound is four fifths of the period.
#[must_use]
pub fn limits_for(period: Duration) -> Limits {
    Limits {
        cost: Some(budget(period)),
        ..Limits::default()
    }
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

impl Admission {
    pub(super) const fn of_mib(mib: u32) -> Self {
        let memory = (mib as usize) << 20;
        Self {
            memory,
            text: memory / 16,
        }
    }

    /// Bytes that nets may take together.
    pub(super) const fn memory(&self) -> usize {
        self.memory
    }

    /// Checks the text quota for one more net, for which all ended nets may be unloaded. Returns how many bytes of them
    /// must be.
    ///
    /// # Errors
    /// If the texts of the nets that have not ended exhaust the quota.
    pub(super) fn check_text(&self, nets: &Nets, bytes: usize) -> Result<usize, Error> {
        let bound = self.text;
        let text = |(_, net): (NetId, &Net)| net.text().len();
        let kept = nets.iter().filter(|(_, net)| !net.is_over());
        if kept.map(text).sum::<usize>() + bytes > bound {
            let item = "bytes of the texts of all nets";
            return Err(Error::TooMany { item, bound });
        }
        let taken = nets.iter().map(text).sum::<usize>();
        Ok((taken + bytes).saturating_sub(bound))
    }

    /// Reserves memory for a net while it is loaded: `most`, or all that is left if no other net is being loaded.
    /// Returns the amount; `None` if the net has to wait for others.
    pub(super) fn reserve(&self, nets: &mut Nets, id: NetId, most: usize) -> Option<usize> {
        let free = self.memory.saturating_sub(nets.memory_taken());
        let is_alone = nets.iter().all(|(_, net)| net.reserved() == 0);
        let kept = most.min(free);
        if kept < most && !is_alone {
            return None;
        }
        if let Some(net) = nets.get_mut(id) {
            net.reserve(kept);
        }
        Some(kept)
    }

    /// Checks the memory quota for one more net.
    ///
    /// # Errors
    /// If the other nets leave too little memory.
    pub(super) fn check_memory(&self, nets: &Nets, plan: &Plan) -> Result<(), Rejection> {
        let found = nets.memory_taken() + memory(plan);
        let bound = self.memory;
        if found <= bound {
            return Ok(());
        }
        let item = "bytes together with all other nets (controller.nets_memory_mib)";
        let kind = FaultKind::Bound { item, found, bound };
        Err(Rejection {
            faults: vec![Fault::new(kind, 0..0)],
        })
    }

    /// Checks that a net can start within the budget of its thread and still leave cycle time and slots for the nets of
    /// waiting rules.
    ///
    /// # Errors
    /// If not.
    pub(super) fn check_start(
        &self,
        nets: &Nets,
        rules: &Rules,
        budget: Duration,
        id: NetId,
    ) -> Result<(), Error> {
        let thread = nets.thread_of(id.0);
        let most = most_cost(nets, rules, (thread, budget), Some(id), None);
        if most <= budget {
            return check_slots(nets, rules, thread, Some(id), None);
        }
        let (cost, running) = (cost_of(nets, id), running_cost(nets, thread));
        if running + cost > budget {
            return Err(overload(nets, id, running, budget));
        }
        Err(Error::OverloadKept {
            net: id,
            cost,
            most,
            budget,
            waiting: heaviest(nets, thread, |_, net| waits_for_rules(net)),
        })
    }

    /// Checks that cycle time and slots are guaranteed for the nets that a new rule starts; `budget` is that of a thread.
    ///
    /// # Errors
    /// If not.
    pub(super) fn check_rule(
        &self,
        nets: &Nets,
        rules: &Rules,
        budget: impl Fn(usize) -> Duration,
        new: &Succession,
        start: &[NetId],
    ) -> Result<(), Error> {
        let threads: BTreeSet<_> = start.iter().map(|net| nets.thread_of(net.0)).collect();
        for thread in threads {
            let budget = budget(thread);
            let most = most_cost(nets, rules, (thread, budget), None, Some(new));
            if most > budget {
                let of_thread = start.iter().filter(|net| nets.thread_of(net.0) == thread);
                let is_other = |id| !new.names(id);
                return Err(Error::RuleOverload {
                    started: of_thread.map(|net| cost_of(nets, *net)).sum(),
                    most,
                    budget,
                    running: heaviest(nets, thread, |id, net| net.runs() && is_other(id)),
                    waiting: heaviest(nets, thread, |id, net| waits_for_rules(net) && is_other(id)),
                });
            }
            check_slots(nets, rules, thread, None, Some(new))?;
        }
        Ok(())
    }
}

/// Checks that a machine of that cost can run in a thread beside what runs there or may be started.
///
/// # Errors
/// If the budget of the thread is exceeded.
pub(super) fn check_machine(
    nets: &Nets,
    rules: &Rules,
    (thread, budget): (usize, Duration),
    (name, cost): (&str, Duration),
) -> Result<(), Error> {
    let most = most_cost(nets, rules, (thread, budget), None, None);
    if most + cost <= budget {
        return Ok(());
    }
    Err(Error::Machine(format!(
        "machine `{name}` costs up to {cost:?} a cycle, its step and all its components, and {most:?} of the \
         {budget:?} that nets of its thread may cost together are taken: {}\nhint: end one of them, or make the \
         components smaller",
        heaviest(nets, thread, |_, net| net.runs())
    )))
}

/// The error for a net that cannot start beside the running nets.
pub(super) fn overload(nets: &Nets, net: NetId, running: Duration, budget: Duration) -> Error {
    Error::Overload {
        net,
        cost: cost_of(nets, net),
        running,
        budget,
        heaviest: heaviest(nets, nets.thread_of(net.0), |_, net| net.runs()),
    }
}

fn check_slots(
    nets: &Nets,
    rules: &Rules,
    thread: usize,
    starting: Option<NetId>,
    new: Option<&Succession>,
) -> Result<(), Error> {
    let candidates = candidates(nets, thread, starting, |_| 1);
    let rules = rules.successions().chain(new).collect();
    if most_together(&candidates, rules, RUNNING_MAX as u64) <= RUNNING_MAX as u64 {
        return Ok(());
    }
    Err(Error::TooMany {
        item: "nets of one thread that run or that rules may start beside them",
        bound: RUNNING_MAX,
    })
}

/// The bound on the total cost of a thread's nets, with one more net running now, or one more rule.
fn most_cost(
    nets: &Nets,
    rules: &Rules,
    (thread, budget): (usize, Duration),
    starting: Option<NetId>,
    new: Option<&Succession>,
) -> Duration {
    let candidates = candidates(nets, thread, starting, |net| nanos(net.cost));
    let rules = rules.successions().chain(new).collect();
    let machines = nets.machine_cost(thread);
    machines + Duration::from_nanos(most_together(&candidates, rules, nanos(budget)))
}

fn running_cost(nets: &Nets, thread: usize) -> Duration {
    let candidates = candidates(nets, thread, None, |net| nanos(net.cost));
    let running = candidates.values().filter(|net| net.runs);
    nets.machine_cost(thread) + Duration::from_nanos(running.map(|net| net.weight).sum())
}

/// All nets that can run, from the view of a thread: nets of other threads weigh nothing.
fn candidates(
    nets: &Nets,
    thread: usize,
    starting: Option<NetId>,
    weight: impl Fn(&Counted) -> u64,
) -> BTreeMap<NetId, Candidate> {
    let candidate = |(id, net): (NetId, &Net)| {
        // Machines reserve for their components.
        let counted = net
            .counted()
            .filter(|_| !net.is_over() && net.component_of.is_none())?;
        let weight = if net.thread() == thread {
            weight(counted)
        } else {
            0
        };
        let candidate = Candidate {
            weight,
            runs: net.runs() || net.is_starting() || starting == Some(id),
            resources: counted.resources,
        };
        Some((id, candidate))
    };
    nets.iter().filter_map(candidate).collect()
}

fn waits_for_rules(net: &Net) -> bool {
    net.state() == NetState::Scheduled
}

fn cost_of(nets: &Nets, net: NetId) -> Duration {
    let net = nets.get(net).and_then(Net::counted);
    net.map(|counted| counted.cost).unwrap_or_default()
}

fn priced(nets: &Nets, net: NetId) -> String {
    format!("net {net} with {:?}", cost_of(nets, net))
}

/// The most expensive nets of a thread among those selected.
fn heaviest(nets: &Nets, thread: usize, is_meant: impl Fn(NetId, &Net) -> bool) -> String {
    let meant = nets.iter();
    let meant = meant.filter(|(id, net)| net.thread() == thread && is_meant(*id, net));
    let mut meant: Vec<_> = meant.map(|(id, _)| (cost_of(nets, id), id)).collect();
    meant.sort_by_key(|(cost, _)| std::cmp::Reverse(*cost));
    let others = meant.len().saturating_sub(HEAVIEST);
    let named = meant.iter().take(HEAVIEST);
    let mut named: Vec<_> = named.map(|(_, id)| priced(nets, *id)).collect();
    if others > 0 {
        named.push(format!("{others} more"));
    }
    if named.is_empty() {
        return "none".to_owned();
    }
    named.join(", ")
}

fn nanos(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ids::SessionId;

    #[test]
    fn memory_is_reserved_while_loading() {
        let admission = Admission {
            memory: 100,
            text: 10,
        };
        let mut nets = Nets::default();
        let mut add = || nets.add(SessionId::NONE, String::new(), "".into());
        let (first, second) = (add(), add());
        let keep = |nets: &mut Nets, id, most| admission.reserve(nets, id, most);
        let release = |nets: &mut Nets, id| nets.find(id).unwrap().reserve(0);
        assert_eq!(keep(&mut nets, first, 60), Some(60));
        assert_eq!(keep(&mut nets, second, 60), None, "it waits for the other");
        assert_eq!(keep(&mut nets, second, 40), Some(40));
        for id in [first, second] {
            release(&mut nets, id);
        }
        assert_eq!(keep(&mut nets, second, 200), Some(100), "all there is");
        assert_eq!(keep(&mut nets, first, 1), None);
        // One that is rejected keeps none.
        release(&mut nets, second);
        assert_eq!(keep(&mut nets, first, 1), Some(1));
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
