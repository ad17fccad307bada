//! Subscription of one client to one net: tracks the states and values already pushed and finds those to be pushed
//! next. It does not call the controller.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use takt_client::wire::{Message, Value};
use takt_core::controller::{NetState, RetainedNet};

use super::pace::{Pace, Pushes, WINDOW};
use super::{VALUES_INTERVAL, push};

#[cfg(test)]
mod tests;

/// A subscription to a net.
///
/// States are pushed as `ns`, which ones and when depends on the [`Pace`]. Values are pushed as `nc` while the net
/// runs, each at most once per refresh interval and only when changed; with the pace `every`, Boolean values at the change,
/// unless they changed within [`VALUES_INTERVAL`] before. All values are pushed together
/// with a state change: shortly after `RUNNING`, but before any other state, so that the last
/// values always precede `TERMINATED`.
#[derive(Debug)]
pub(super) struct NetWatch {
    tag: String,
    refresh: Duration,
    pace: Pace,
    /// How many states of the net were pushed or passed over.
    reported: usize,
    /// How many states of the net are known.
    noticed: usize,
    /// When what was noticed is pushed.
    due: Option<Duration>,
    /// Until then, neither values nor the end of the net are pushed.
    hold: Duration,
    running: bool,
    /// Whether `TERMINATED` was pushed.
    ended: bool,
    /// The last values, once the net is unloaded.
    last_values: Option<Values>,
    /// Whether the `TERMINATED` of an unloaded net was pushed.
    unloading: bool,
    sent: BTreeMap<String, Sent>,
    /// Keys of Boolean values.
    results: BTreeSet<String>,
    /// The version of the values of which the Boolean ones were polled last.
    results_seen: Option<u64>,
    next_poll: Duration,
}

#[derive(Debug)]
struct Sent {
    text: String,
    at: Duration,
}

/// Key and text of each value.
type Values = Vec<(String, String)>;

impl NetWatch {
    /// A subscription to a net that has been in `states` states; only the last of them is pushed.
    pub(super) const fn new(tag: String, refresh: Duration, pace: Pace, states: usize) -> Self {
        Self {
            tag,
            refresh,
            pace,
            reported: states.saturating_sub(1),
            noticed: states,
            due: Some(Duration::ZERO),
            hold: Duration::ZERO,
            running: false,
            ended: false,
            last_values: None,
            unloading: false,
            sent: BTreeMap::new(),
            results: BTreeSet::new(),
            results_seen: None,
            next_poll: Duration::ZERO,
        }
    }

    /// Pushes for new states.
    pub(super) fn handle_states(
        &mut self,
        states: &[NetState],
        values: impl FnOnce() -> Values,
        pushes: Pushes,
        now: Duration,
    ) -> Vec<Message> {
        match self.pace {
            Pace::Every => self.every_state(states, values, now),
            Pace::Coalesced => self.last_state(states, values, pushes, now),
        }
    }

    fn every_state(
        &mut self,
        states: &[NetState],
        values: impl FnOnce() -> Values,
        now: Duration,
    ) -> Vec<Message> {
        let new = states.get(self.reported..).unwrap_or_default();
        self.reported = states.len();
        self.due = None;
        let Some(last) = new.last() else {
            return Vec::new();
        };
        self.enter(*last);
        let mut out: Vec<_> = new
            .iter()
            .map(|s| push(&self.tag, "ns", s.word()))
            .collect();
        if let Some(at) = new.iter().position(|s| follows_values(*s)) {
            out.splice(at..at, self.report(values(), true, now));
        }
        out
    }

    fn last_state(
        &mut self,
        states: &[NetState],
        values: impl FnOnce() -> Values,
        pushes: Pushes,
        now: Duration,
    ) -> Vec<Message> {
        self.notice(states, now);
        let (Some(due), Some(state)) = (self.due, states.last().copied()) else {
            return Vec::new();
        };
        let hold = follows_values(state).then_some(self.hold);
        if now < pushes.at(due).max(hold.unwrap_or_default()) {
            return Vec::new();
        }
        self.due = None;
        self.reported = states.len();
        self.enter(state);
        let mut out = Vec::new();
        if follows_values(state) {
            out.extend(self.report(values(), true, now));
        } else if begins(state) {
            self.hold = now + WINDOW;
            // The values follow, all of them.
            self.sent.clear();
        }
        out.push(push(&self.tag, "ns", state.word()));
        out
    }

    /// Records states that are not known yet.
    fn notice(&mut self, states: &[NetState], now: Duration) {
        let new = states.get(self.noticed..).unwrap_or_default();
        self.noticed = states.len();
        if !new.is_empty() {
            self.due.get_or_insert(now + WINDOW);
        }
        if new.iter().any(|state| begins(*state)) {
            self.hold = now + WINDOW;
        }
    }

    const fn enter(&mut self, state: NetState) {
        self.running = matches!(state, NetState::Running | NetState::Cancelling);
        self.ended |= matches!(state, NetState::Terminated);
    }

    /// Push for changed values, if the net runs.
    pub(super) fn handle_values(&mut self, values: Values, now: Duration) -> Option<Message> {
        self.next_poll = now + VALUES_INTERVAL;
        self.report(values, false, now)
    }

    /// Whether changed Boolean values are pushed at once.
    pub(super) fn wants_results(&self) -> bool {
        self.running && self.pace == Pace::Every
    }

    /// Push for changed Boolean values, if the pace is `every` and the net runs. `poll` receives the version polled last.
    pub(super) fn handle_results(
        &mut self,
        poll: impl FnOnce(&mut Option<u64>) -> Values,
        now: Duration,
    ) -> Option<Message> {
        if !self.wants_results() {
            return None;
        }
        let values = poll(&mut self.results_seen);
        for (key, _) in &values {
            if !self.results.contains(key) {
                self.results.insert(key.clone());
            }
        }
        self.report(values, false, now)
    }

    /// Pushes for unloading by a command of this client, which the protocol shows as one more `TERMINATED` before the
    /// reply.
    pub(super) fn handle_unloading(&mut self, values: Values, now: Duration) -> Vec<Message> {
        if now < self.hold {
            return Vec::new();
        }
        self.running = false;
        self.ended = true;
        self.unloading = true;
        let mut out = Vec::from_iter(self.report(values, true, now));
        out.push(push(&self.tag, "ns", NetState::Terminated.word()));
        out
    }

    /// Pushes for a net that is unloaded, with its result while that is retained, and whether they are the last.
    pub(super) fn handle_unloaded(
        &mut self,
        result: impl FnOnce() -> Option<RetainedNet>,
        pushes: Pushes,
        now: Duration,
    ) -> (Vec<Message>, bool) {
        let mut out = Vec::new();
        if self.last_values.is_none() {
            let result = result();
            let states = result.as_ref().map(|net| net.states.clone());
            let states = states.unwrap_or_default();
            let values = result.map(|net| net.values).unwrap_or_default();
            match self.pace {
                Pace::Every => out.extend(self.every_state(&states, || values.clone(), now)),
                Pace::Coalesced => {
                    self.notice(&states, now);
                    self.due.get_or_insert(now + WINDOW);
                }
            }
            self.last_values = Some(values);
        }
        let due = self.due.unwrap_or_default();
        if now < pushes.at(due).max(self.hold) {
            return (out, false);
        }
        let repeats = self.pace == Pace::Coalesced && !self.unloading;
        if repeats || !self.ended {
            let values = self.last_values.clone().unwrap_or_default();
            out.extend(self.handle_unloading(values, now));
        }
        let last = pushes == Pushes::Due;
        out.extend(last.then(|| push(&self.tag, "ns", NetState::Unloaded.word())));
        (out, last)
    }

    /// When a state that was noticed must be pushed.
    pub(super) fn state_timeout(&self) -> Option<Duration> {
        Some(self.due?.max(self.hold))
    }

    /// When values must be polled next.
    pub(super) fn values_timeout(&self) -> Option<Duration> {
        self.running.then_some(self.next_poll.max(self.hold))
    }

    fn report(&mut self, values: Values, all: bool, now: Duration) -> Option<Message> {
        let mut changed = BTreeMap::new();
        for (key, text) in values {
            if all || self.is_due(&key, &text, now) {
                self.sent.insert(
                    key.clone(),
                    Sent {
                        text: text.clone(),
                        at: now,
                    },
                );
                changed.insert(key, Value::String(text));
            }
        }
        (!changed.is_empty()).then(|| push(&self.tag, "nc", changed))
    }

    fn is_due(&self, key: &str, text: &str, now: Duration) -> bool {
        let refresh = if self.results.contains(key) {
            self.refresh.min(VALUES_INTERVAL)
        } else {
            self.refresh
        };
        self.sent
            .get(key)
            .is_none_or(|s| s.text != text && now >= s.at + refresh)
    }
}

/// Whether all values are pushed before this state.
const fn follows_values(state: NetState) -> bool {
    matches!(
        state,
        NetState::Cancelling | NetState::Terminated | NetState::Unloaded
    )
}

/// Whether a client takes this state for the start of the net.
const fn begins(state: NetState) -> bool {
    matches!(state, NetState::Scheduled | NetState::Running)
}
