//! What one client was told of one net, and what it is to be told next. It asks the controller
//! nothing.

use std::collections::BTreeMap;
use std::time::Duration;

use takt_core::NetState;

use super::{VALUES_EVERY, push};
use crate::wire::{Message, Value};

/// A subscription to a net.
///
/// Every state is pushed once, in order, as `ns`. Values are pushed as `nc` while the net runs,
/// each at most once per refresh interval and only when it changed; and all of them together
/// with a change of state: after `RUNNING`, but before the states that end a net, so that the
/// last values of a net are always there before `TERMINATED` is.
#[derive(Debug)]
pub(super) struct NetWatch {
    tag: String,
    refresh: Duration,
    /// How many states of the net were told.
    told: usize,
    running: bool,
    ended: bool,
    sent: BTreeMap<String, Sent>,
    next_look: Duration,
}

#[derive(Debug)]
struct Sent {
    text: String,
    at: Duration,
}

/// Key and text of each value.
type Values = Vec<(String, String)>;

impl NetWatch {
    /// A subscription to a net that has been in so many states; of those only the last is told.
    pub(super) const fn new(tag: String, refresh: Duration, states: usize) -> Self {
        Self {
            tag,
            refresh,
            told: states.saturating_sub(1),
            running: false,
            ended: false,
            sent: BTreeMap::new(),
            next_look: Duration::ZERO,
        }
    }

    /// Tells the states that are new.
    pub(super) fn handle_states(
        &mut self,
        states: &[NetState],
        values: impl FnOnce() -> Values,
        now: Duration,
    ) -> Vec<Message> {
        let new = states.get(self.told..).unwrap_or_default();
        self.told = states.len();
        let Some(last) = new.last() else { return Vec::new() };
        self.running = matches!(last, NetState::Running | NetState::Cancelling);
        self.ended |= matches!(last, NetState::Terminated);
        self.next_look = now + VALUES_EVERY;
        let mut out: Vec<_> = new.iter().map(|s| push(&self.tag, "ns", s.word())).collect();
        let before_end = new.iter().position(|s| ends(*s));
        let running = (*last == NetState::Running).then_some(out.len());
        if let Some(place) = before_end.or(running)
            && let Some(values) = self.report(values(), true, now)
        {
            out.insert(place, values);
        }
        out
    }

    /// Tells the values that changed, if the net runs.
    pub(super) fn handle_values(&mut self, values: Values, now: Duration) -> Option<Message> {
        self.next_look = now + VALUES_EVERY;
        self.report(values, false, now)
    }

    /// Tells that the net is being unloaded, which clients know as one more `TERMINATED`.
    pub(super) fn handle_unloading(&mut self) -> Message {
        self.running = false;
        self.ended = true;
        push(&self.tag, "ns", NetState::Terminated.word())
    }

    /// Tells that the net ended, if that was not told.
    pub(super) fn handle_end(&mut self) -> Option<Message> {
        (!self.ended).then(|| self.handle_unloading())
    }

    /// Tells that the net is gone.
    pub(super) fn handle_gone(&self) -> Message {
        push(&self.tag, "ns", NetState::Unloaded.word())
    }

    /// Whether `TERMINATED` was told.
    pub(super) const fn ended(&self) -> bool {
        self.ended
    }

    /// When values are to be looked at next.
    pub(super) fn poll_timeout(&self) -> Option<Duration> {
        self.running.then_some(self.next_look)
    }

    fn report(&mut self, values: Values, all: bool, now: Duration) -> Option<Message> {
        let mut changed = BTreeMap::new();
        for (key, text) in values {
            if all || self.is_due(&key, &text, now) {
                self.sent.insert(key.clone(), Sent { text: text.clone(), at: now });
                changed.insert(key, Value::String(text));
            }
        }
        (!changed.is_empty()).then(|| push(&self.tag, "nc", changed))
    }

    fn is_due(&self, key: &str, text: &str, now: Duration) -> bool {
        self.sent.get(key).is_none_or(|s| s.text != text && now >= s.at + self.refresh)
    }
}

/// Whether values are told before this state.
const fn ends(state: NetState) -> bool {
    matches!(state, NetState::Cancelling | NetState::Terminated | NetState::Unloaded)
}
