//! An upper bound on the total cost or number of the nets of a thread, now and after any
//! firing of waiting rules. The checks that use it are one module above.
//!
//! Nets form a forest. A net that is started only by rules which end net *p* is a child of *p*: the two never run
//! at once. The weight of a subtree is therefore the greater of the net's own weight and the total of its
//! children. All children may run at once, except alternatives. Two nets are alternatives if the
//! conditions of their rules contradict each other in a value of a net that has ended by then, or if their
//! subtrees need the same resource. A net whose rules end several nets is a child of each, with a part of its weight.

use std::cell::Cell;
use std::collections::{BTreeMap, BTreeSet};

use crate::executor::ResourceSet;
use crate::executor::rules::{Question, Rule};
use crate::ids::NetId;

/// Maximum number of comparisons to find alternatives; beyond it, nets count as if they could run at once.
const COMPARISONS_MAX: usize = 50_000;

/// A net that runs or may start to run.
#[derive(Clone, Debug)]
pub(in crate::controller) struct Candidate {
    /// Its cost, or 1 to count nets.
    pub(in crate::controller) weight: u64,
    /// Whether it runs now.
    pub(in crate::controller) runs: bool,
    pub(in crate::controller) resources: ResourceSet,
}

/// A literal that a condition requires in order to become true.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Need {
    literal: (u32, Question),
    value: bool,
    /// Whether the literal never changes again once the rule has fired.
    settled: bool,
}

/// A waiting rule as a succession: nets that end and nets that follow them.
#[derive(Clone, Debug, Default)]
pub(in crate::controller) struct Succession {
    start: Vec<NetId>,
    /// Nets that have certainly run and ended when those of `start` begin.
    ends: Vec<NetId>,
    /// Nets that have ended by then if they run now; others may still begin.
    stops: Vec<NetId>,
    needs: Vec<Need>,
}

impl Succession {
    /// The succession of a rule that stops and starts these nets, in one or several threads. Only conditions and literals
    /// of the rule are used.
    pub(in crate::controller) fn of(
        rule: &Rule,
        stop: &[NetId],
        start: &[NetId],
        in_one_thread: bool,
    ) -> Self {
        let needed = rule.needs();
        let terminated = |literal: &(u32, Question)| literal.1 == Question::Terminated;
        let ended = needed.iter().filter(|(l, value)| *value && terminated(l));
        let ended: BTreeSet<_> = ended.map(|(literal, _)| NetId(literal.0)).collect();
        // A condition that needs a value of a net cannot become true before that net runs.
        let asked: BTreeSet<_> = needed.iter().map(|(literal, _)| NetId(literal.0)).collect();
        let stopped: Vec<_> = stop
            .iter()
            .copied()
            .filter(|net| asked.contains(net))
            .collect();
        let settled =
            |net: NetId| ended.contains(&net) || (in_one_thread && stopped.contains(&net));
        let needs = needed.iter().map(|(literal, value)| Need {
            literal: *literal,
            value: *value,
            settled: settled(NetId(literal.0)),
        });
        Self {
            start: start.to_vec(),
            needs: needs.collect(),
            ends: ended.iter().chain(&stopped).copied().collect(),
            stops: stop.to_vec(),
        }
    }

    /// Whether it ends or starts this net.
    pub(in crate::controller) fn names(&self, id: NetId) -> bool {
        [&self.start, &self.ends, &self.stops]
            .iter()
            .any(|nets| nets.contains(&id))
    }

    fn ends(&self, id: NetId, net: &Candidate) -> bool {
        self.ends.contains(&id) || (net.runs && self.stops.contains(&id))
    }

    /// Whether at most one of the two rules can fire.
    fn excludes(&self, other: &Self) -> bool {
        let contradicts = |a: &Need, b: &Need| a.literal == b.literal && a.value != b.value;
        let bars = |first: &Self, second: &Self| {
            let mut settled = first.needs.iter().filter(|need| need.settled);
            settled.any(|a| second.needs.iter().any(|b| contradicts(a, b)))
        };
        bars(self, other) && bars(other, self)
    }
}

/// Upper bound on the total weight of the nets. Nets that neither run nor are started by a rule weigh
/// nothing. If the plain sum is within `bound`, alternatives are not searched.
pub(in crate::controller) fn most_together(
    nets: &BTreeMap<NetId, Candidate>,
    mut rules: Vec<&Succession>,
    bound: u64,
) -> u64 {
    rules.retain(|rule| !rule.start.is_empty());
    let forest = Forest::new(nets, &rules);
    let all: u64 = nets.keys().map(|id| forest.own(*id)).sum();
    if all <= bound { all } else { forest.most() }
}

/// Nets that the same rules start; a single net if no rule starts it.
#[derive(Debug)]
struct Bundle {
    members: Vec<NetId>,
    rules: Vec<usize>,
}

/// A bundle as child of a net, with the part of its weight that counts there.
#[derive(Clone, Copy, Debug)]
struct Branch {
    bundle: usize,
    share: (u64, u64),
}

/// A net with its subtree.
#[derive(Debug, Default)]
struct Lineage {
    /// Their total weight.
    most: u64,
    /// Resources that each of them needs.
    always: ResourceSet,
}

#[derive(Debug)]
struct Forest<'a> {
    nets: &'a BTreeMap<NetId, Candidate>,
    rules: &'a [&'a Succession],
    bundles: Vec<Bundle>,
    /// Nets that rules start.
    started: BTreeSet<NetId>,
    below: BTreeMap<NetId, Vec<Branch>>,
    /// Roots: bundles without a parent.
    roots: Vec<Branch>,
    done: BTreeMap<NetId, Lineage>,
    /// Remaining comparisons.
    left: Cell<usize>,
}

impl<'a> Forest<'a> {
    fn new(nets: &'a BTreeMap<NetId, Candidate>, rules: &'a [&'a Succession]) -> Self {
        let mut started: BTreeMap<NetId, Vec<usize>> = BTreeMap::new();
        for (number, rule) in rules.iter().enumerate() {
            for net in &rule.start {
                started.entry(*net).or_default().push(number);
            }
        }
        let mut forest = Self {
            nets,
            rules,
            bundles: Vec::new(),
            started: started.keys().copied().collect(),
            below: BTreeMap::new(),
            roots: Vec::new(),
            done: BTreeMap::new(),
            left: Cell::new(COMPARISONS_MAX),
        };
        let mut together: BTreeMap<Vec<usize>, Vec<NetId>> = BTreeMap::new();
        for (id, net) in nets {
            match started.remove(id).filter(|_| !net.runs) {
                Some(rules) => together.entry(rules).or_default().push(*id),
                None => forest.root(*id),
            }
        }
        for (rules, members) in together {
            forest.hang(Bundle { members, rules });
        }
        forest
    }

    fn root(&mut self, id: NetId) {
        self.hang(Bundle {
            members: vec![id],
            rules: Vec::new(),
        });
    }

    /// Makes a bundle a child of the nets that have ended when any of its rules fires.
    fn hang(&mut self, bundle: Bundle) {
        let mut rules = bundle.rules.iter().map(|rule| self.rules[*rule]);
        let first = rules.next();
        let named = first
            .iter()
            .flat_map(|rule| rule.ends.iter().chain(&rule.stops));
        let named: BTreeSet<_> = named.copied().collect();
        let is_ended = |id: NetId, net| {
            let by_all = first
                .into_iter()
                .chain(rules.clone())
                .all(|rule| rule.ends(id, net));
            by_all && !bundle.members.contains(&id)
        };
        // The heavier a net, the more capacity its end frees.
        let parents = named.into_iter().filter_map(|id| {
            let net = self.nets.get(&id)?;
            is_ended(id, net).then_some((id, net.weight + 1))
        });
        let parents: Vec<_> = parents.collect();
        let number = self.bundles.len();
        self.bundles.push(bundle);
        let branch = |share| Branch {
            bundle: number,
            share,
        };
        let all = parents.iter().map(|(_, weight)| weight).sum();
        for (parent, weight) in &parents {
            let branches = self.below.entry(*parent).or_default();
            branches.push(branch((*weight, all)));
        }
        if parents.is_empty() {
            self.roots.push(branch((1, 1)));
        }
    }

    fn most(mut self) -> u64 {
        for at in 0..self.roots.len() {
            for number in 0..self.members(self.roots[at]).len() {
                self.climb(self.members(self.roots[at])[number]);
            }
        }
        // The rest are cycles of nets that wait for each other: any of them may be started directly.
        let nets = self.nets;
        for id in nets.keys() {
            if !self.done.contains_key(id) {
                self.root(*id);
                self.climb(*id);
            }
        }
        self.sum(&self.roots)
    }

    fn members(&self, branch: Branch) -> &[NetId] {
        &self.bundles[branch.bundle].members
    }

    fn below(&self, id: NetId) -> &[Branch] {
        self.below.get(&id).map_or(&[], Vec::as_slice)
    }

    /// Computes the lineages of a subtree, children first.
    fn climb(&mut self, id: NetId) {
        let mut entered = BTreeSet::new();
        let mut path = vec![(id, false)];
        while let Some((id, all_below_done)) = path.pop() {
            if all_below_done {
                self.done.insert(id, self.lineage(id));
            } else if !self.done.contains_key(&id) && entered.insert(id) {
                path.push((id, true));
                let below = self.below(id).iter();
                let below = below.flat_map(|branch| self.members(*branch));
                path.extend(below.map(|id| (*id, false)));
            }
        }
    }

    /// The lineage of a net without children.
    fn own(&self, id: NetId) -> u64 {
        let net = self.nets.get(&id);
        let net = net.filter(|net| net.runs || self.started.contains(&id));
        net.map_or(0, |net| net.weight)
    }

    fn lineage(&self, id: NetId) -> Lineage {
        let Some(net) = self.nets.get(&id) else {
            return Lineage::default();
        };
        let mut always = net.resources;
        for member in self
            .below(id)
            .iter()
            .flat_map(|branch| self.members(*branch))
        {
            always.keep(&self.always(*member));
        }
        Lineage {
            most: self.own(id).max(self.sum(self.below(id))),
            always,
        }
    }

    /// Resources that each net of a lineage needs; empty for a lineage that is not computed yet.
    fn always(&self, id: NetId) -> ResourceSet {
        self.done
            .get(&id)
            .map(|lineage| lineage.always)
            .unwrap_or_default()
    }

    /// Total weight of branches; of alternatives only the heaviest counts.
    fn sum(&self, branches: &[Branch]) -> u64 {
        let mut weighed: Vec<_> = branches.iter().map(|b| (self.weight(*b), *b)).collect();
        weighed.sort_by_key(|(weight, _)| std::cmp::Reverse(*weight));
        let mut alternatives: Vec<Vec<Branch>> = Vec::new();
        let mut sum = 0_u64;
        for (weight, branch) in weighed {
            let is_one = |others: &&mut Vec<Branch>| {
                others
                    .iter()
                    .all(|other| self.are_alternatives(*other, branch))
            };
            if let Some(others) = alternatives.iter_mut().find(is_one) {
                others.push(branch);
            } else {
                sum = sum.saturating_add(weight);
                alternatives.push(vec![branch]);
            }
        }
        sum
    }

    fn weight(&self, branch: Branch) -> u64 {
        let members = self
            .members(branch)
            .iter()
            .filter_map(|id| self.done.get(id));
        let whole: u128 = members.map(|lineage| u128::from(lineage.most)).sum();
        let (part, all) = branch.share;
        let share = (whole * u128::from(part)).div_ceil(u128::from(all.max(1)));
        u64::try_from(share).unwrap_or(u64::MAX)
    }

    fn are_alternatives(&self, one: Branch, other: Branch) -> bool {
        let Some(left) = self.left.get().checked_sub(1) else {
            return false;
        };
        self.left.set(left);
        let need_one_thing = || {
            let always = |branch| self.members(branch).iter().map(|id| self.always(*id));
            always(one).all(|a| always(other).all(|b| a.common(&b).is_some()))
        };
        let rules = |branch: Branch| self.bundles[branch.bundle].rules.iter();
        let excludes = |a: &usize| rules(other).all(|b| self.rules[*a].excludes(self.rules[*b]));
        let ruled_out = rules(one).next().is_some() && rules(other).next().is_some();
        (ruled_out && rules(one).all(excludes)) || need_one_thing()
    }
}

#[cfg(test)]
mod tests;
