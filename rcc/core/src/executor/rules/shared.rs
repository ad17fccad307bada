//! A rule whose nets are in several threads: each thread has a part of it. This module is the exchange between
//! the parts, by atomic words and without waiting. It does not access nets.
//!
//! At the end of each cycle a part publishes its literals and whether it could fire. The part of
//! the fastest thread with a literal decides, once all parts have published: it therefore receives each state of
//! the others at least once. All parts apply the decision at their next cycle boundary.

use std::sync::Arc;
use std::sync::atomic::{AtomicU8, AtomicU32, Ordering, fence};

use super::limits::CONDITION_MAX;
use super::literal::Literal;

/// Decision about a rule in several threads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Decision {
    /// Not known yet.
    Open,
    /// All parts fire.
    Fire,
    /// The condition holds, but a part cannot fire; none does.
    Fail,
    /// The condition can never hold any more.
    Never,
}

const DECISIONS: [Decision; 4] = [
    Decision::Open,
    Decision::Fire,
    Decision::Fail,
    Decision::Never,
];

/// A part that has not published yet; the initial state.
const ABSENT: u8 = 0;
/// A part that could fire.
const ABLE: u8 = 1;
/// A part that could not.
const UNABLE: u8 = 2;

/// The published state of one part.
#[derive(Debug, Default)]
struct PartCell {
    /// Whether it has published, and whether it can fire.
    able: AtomicU8,
    /// Sequence count: odd while it writes its literals, even otherwise.
    version: AtomicU32,
}

/// Shared state of the parts of one rule.
#[derive(Debug)]
pub struct Shared {
    /// By literal: whether it is known, its truth, and whether it is the last, as bits 0 to 2.
    literals: Box<[AtomicU8]>,
    /// By literal, the part that answers it; `None` if its answer is final.
    owners: Box<[Option<usize>]>,
    parts: Box<[PartCell]>,
    /// Number of a [`Decision`].
    decision: AtomicU8,
    /// The part that decides.
    decider: usize,
    /// Whether the rule starts any net.
    starts: bool,
}

impl Shared {
    /// A rule in `parts` threads, of which `decider` decides. Each of `literals` comes with the part
    /// that answers it, unless its answer is final.
    #[must_use]
    pub fn new(
        literals: &[(Literal, Option<usize>)],
        parts: usize,
        decider: usize,
        starts: bool,
    ) -> Self {
        let words = literals.iter().map(|(l, _)| AtomicU8::new(word(l)));
        Self {
            literals: words.collect(),
            owners: literals.iter().map(|(_, owner)| *owner).collect(),
            parts: (0..parts).map(|_| PartCell::default()).collect(),
            decision: AtomicU8::new(0),
            decider,
            starts,
        }
    }

    /// Of `things`, one for each literal, those of the literals that a part answers, with the
    /// literals' words.
    fn literals_of<T>(
        &self,
        part: usize,
        things: impl Iterator<Item = T>,
    ) -> impl Iterator<Item = (T, &AtomicU8)> {
        let cells = self.literals.iter().zip(&self.owners);
        let owned = things
            .zip(cells)
            .filter(move |(_, (_, o))| **o == Some(part));
        owned.map(|(thing, (cell, _))| (thing, cell))
    }

    /// The decision.
    #[must_use]
    pub fn decision(&self) -> Decision {
        let number = usize::from(self.decision.load(Ordering::Acquire));
        DECISIONS.get(number).copied().unwrap_or(Decision::Never)
    }

    /// Decides, unless already decided; returns the valid decision.
    pub fn decide(&self, decision: Decision) -> Decision {
        let (order, failed) = (Ordering::AcqRel, Ordering::Acquire);
        // The second writer loses and reads the first decision.
        let _ = self
            .decision
            .compare_exchange(0, decision as u8, order, failed);
        self.decision()
    }
}

/// One thread's part of a rule.
#[derive(Clone, Debug)]
pub struct Part {
    shared: Arc<Shared>,
    number: usize,
}

impl Part {
    /// The part of that number.
    #[must_use]
    pub const fn new(shared: Arc<Shared>, number: usize) -> Self {
        Self { shared, number }
    }

    /// The shared state.
    #[must_use]
    pub fn shared(&self) -> &Shared {
        &self.shared
    }

    /// Number of parts.
    pub(super) fn count(&self) -> usize {
        self.shared.parts.len()
    }

    /// Whether the rule starts a net in any thread.
    pub(super) fn starts(&self) -> bool {
        self.shared.starts
    }

    /// Publishes this part's literals and whether it can fire; the deciding part reads the
    /// literals of the others.
    pub(super) fn exchange(&self, literals: &mut [Literal], able: bool) {
        self.say(literals);
        if let Some(part) = self.shared.parts.get(self.number) {
            part.able
                .store(if able { ABLE } else { UNABLE }, Ordering::Release);
        }
        if self.number == self.shared.decider {
            let others = (0..self.shared.parts.len()).filter(|number| *number != self.number);
            others.for_each(|number| self.receive(number, literals));
        }
    }

    fn say(&self, literals: &[Literal]) {
        let Some(part) = self.shared.parts.get(self.number) else {
            return;
        };
        let version = part.version.load(Ordering::Relaxed);
        part.version
            .store(version.wrapping_add(1), Ordering::Relaxed);
        fence(Ordering::Release);
        for (literal, cell) in self.shared.literals_of(self.number, literals.iter()) {
            cell.store(word(literal), Ordering::Relaxed);
        }
        part.version
            .store(version.wrapping_add(2), Ordering::Release);
    }

    /// Reads the last state of another part. While that part writes, its previous state stays valid:
    /// literals of two of its cycles are never mixed.
    fn receive(&self, number: usize, literals: &mut [Literal]) {
        let Some(part) = self.shared.parts.get(number) else {
            return;
        };
        let mut words = [0; CONDITION_MAX];
        let before = part.version.load(Ordering::Acquire);
        for (received, cell) in self.shared.literals_of(number, words.iter_mut()) {
            *received = cell.load(Ordering::Relaxed);
        }
        fence(Ordering::Acquire);
        let after = part.version.load(Ordering::Relaxed);
        if before != after || !before.is_multiple_of(2) {
            return;
        }
        let pairs = literals.iter_mut().zip(words);
        for ((literal, word), _) in self.shared.literals_of(number, pairs) {
            literal.value = (word & 1 != 0).then_some(word & 2 != 0);
            literal.last = word & 4 != 0;
        }
    }

    /// Whether this part must decide now.
    pub(super) fn is_to_decide(&self) -> bool {
        let came = |part: &PartCell| part.able.load(Ordering::Acquire) != ABSENT;
        self.number == self.shared.decider
            && self.shared.decision() == Decision::Open
            && self.shared.parts.iter().all(came)
    }

    /// Decides about a true condition.
    pub(super) fn decide_to_fire(&self) {
        let able = |part: &PartCell| part.able.load(Ordering::Acquire) == ABLE;
        let all = self.shared.parts.iter().all(able);
        self.shared
            .decide(if all { Decision::Fire } else { Decision::Fail });
    }
}

fn word(literal: &Literal) -> u8 {
    u8::from(literal.value.is_some())
        | u8::from(literal.value == Some(true)) << 1
        | u8::from(literal.last) << 2
}

#[cfg(test)]
mod tests;
