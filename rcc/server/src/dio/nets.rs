//! What one client was told of one net, and what it is to be told next. It asks the controller
//! nothing.

use std::collections::BTreeMap;
use std::time::Duration;

use takt_core::controller::NetState;

use super::{VALUES_EVERY, push};
use crate::wire::{Message, Value};

/// A subscription to a net.
///
/// Every state is pushed once, in order, as `ns`. Values are pushed as `nc` while the net runs,
/// each at most once per refresh interval and only when it changed; and all of them together
/// with a change of state: soon after `RUNNING`, but before the states that end a net, so that
/// the last values of a net are always there before `TERMINATED` is.
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
        let Some(last) = new.last() else {
            return Vec::new();
        };
        self.running = matches!(last, NetState::Running | NetState::Cancelling);
        self.ended |= matches!(last, NetState::Terminated);
        let mut out: Vec<_> = new
            .iter()
            .map(|s| push(&self.tag, "ns", s.word()))
            .collect();
        if let Some(place) = new.iter().position(|s| comes_after_values(*s)) {
            out.splice(place..place, self.report(values(), true, now));
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

    /// When values are to be looked at next.
    pub(super) fn poll_timeout(&self) -> Option<Duration> {
        self.running.then_some(self.next_look)
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
        self.sent
            .get(key)
            .is_none_or(|s| s.text != text && now >= s.at + self.refresh)
    }
}

/// Whether all values are told before this state is.
const fn comes_after_values(state: NetState) -> bool {
    matches!(
        state,
        NetState::Cancelling | NetState::Terminated | NetState::Unloaded
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use NetState::{Cancelling, Loading, Ready, Rejected, Running, Scheduled, Terminated};

    const REFRESH: Duration = Duration::from_millis(100);

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    fn watch(states: usize) -> NetWatch {
        NetWatch::new("t".to_owned(), REFRESH, states)
    }

    fn running() -> NetWatch {
        let mut watch = watch(1);
        watch.handle_states(&[Loading, Ready, Running], Vec::new, ms(0));
        watch
    }

    fn values(values: &[(&str, &str)]) -> Values {
        values
            .iter()
            .map(|(k, v)| ((*k).to_owned(), (*v).to_owned()))
            .collect()
    }

    fn states(watch: &mut NetWatch, states: &[NetState], at: Duration) -> Vec<String> {
        let messages = watch.handle_states(states, || values(&[("outa", "1")]), at);
        messages.iter().map(Message::to_string).collect()
    }

    fn told(watch: &mut NetWatch, of: &[(&str, &str)], at: Duration) -> Option<String> {
        watch.handle_values(values(of), at).map(|m| m.to_string())
    }

    #[test]
    fn of_the_past_only_the_present_state_is_told() {
        assert_eq!(
            states(&mut watch(2), &[Loading, Ready], ms(0)),
            [r#"t=ns("READY")"#]
        );
        assert_eq!(
            states(&mut watch(2), &[Loading, Rejected], ms(0)),
            [r#"t=ns("REJECTED")"#]
        );
        let ended = states(&mut watch(4), &[Loading, Ready, Running, Terminated], ms(0));
        assert_eq!(ended, [r#"t=nc({outa:"1"})"#, r#"t=ns("TERMINATED")"#]);
    }

    #[test]
    fn every_later_state_is_told_once_in_order() {
        let mut watch = watch(2);
        let life = [Loading, Ready, Scheduled, Running, Cancelling, Terminated];
        let told: Vec<_> = (2..=6)
            .flat_map(|n| states(&mut watch, &life[..n], ms(0)))
            .collect();
        let expected = [
            r#"t=ns("READY")"#,
            r#"t=ns("SCHEDULED")"#,
            r#"t=ns("RUNNING")"#,
            r#"t=nc({outa:"1"})"#,
            r#"t=ns("CANCELLING")"#,
            r#"t=nc({outa:"1"})"#,
            r#"t=ns("TERMINATED")"#,
        ];
        assert_eq!(told, expected);
        assert_eq!(states(&mut watch, &life, ms(0)), Vec::<String>::new());
    }

    #[test]
    fn states_passed_at_once_are_all_told_with_the_values_before_the_end() {
        let life = [Loading, Ready, Running, Cancelling, Terminated];
        let expected = [
            r#"t=ns("RUNNING")"#,
            r#"t=nc({outa:"1"})"#,
            r#"t=ns("CANCELLING")"#,
            r#"t=ns("TERMINATED")"#,
        ];
        assert_eq!(states(&mut watch(3), &life, ms(0)), expected);
    }

    #[test]
    fn values_are_looked_at_only_while_the_net_runs() {
        let mut watch = watch(2);
        states(&mut watch, &[Loading, Ready], ms(0));
        assert_eq!(watch.poll_timeout(), None);
        states(&mut watch, &[Loading, Ready, Running], ms(5));
        assert!(watch.poll_timeout().is_some_and(|at| at <= ms(5)));
        told(&mut watch, &[], ms(5));
        assert_eq!(watch.poll_timeout(), Some(ms(15)));
        states(&mut watch, &[Loading, Ready, Running, Terminated], ms(6));
        assert_eq!(watch.poll_timeout(), None);
    }

    #[test]
    fn a_value_is_told_when_it_changed_and_its_interval_is_over() {
        let mut watch = running();
        let nc = |text: &str| Some(format!("t=nc({{outa:\"{text}\"}})"));
        assert_eq!(told(&mut watch, &[("outa", "1")], ms(10)), nc("1"));
        assert_eq!(told(&mut watch, &[("outa", "2")], ms(109)), None);
        assert_eq!(told(&mut watch, &[("outa", "2")], ms(110)), nc("2"));
        assert_eq!(told(&mut watch, &[("outa", "2")], ms(500)), None);
        assert_eq!(told(&mut watch, &[("outa", "3")], ms(501)), nc("3"));
    }

    #[test]
    fn each_value_has_its_own_interval() {
        let mut watch = running();
        told(&mut watch, &[("outa", "1")], ms(0));
        let second = told(&mut watch, &[("outa", "2"), ("outb", "1")], ms(50));
        assert_eq!(second.as_deref(), Some(r#"t=nc({outb:"1"})"#));
        let third = told(&mut watch, &[("outa", "2"), ("outb", "2")], ms(100));
        assert_eq!(third.as_deref(), Some(r#"t=nc({outa:"2"})"#));
    }

    #[test]
    fn a_change_of_state_tells_values_again_whatever_their_interval() {
        let mut watch = running();
        told(&mut watch, &[("outa", "1")], ms(0));
        let end = states(&mut watch, &[Loading, Ready, Running, Terminated], ms(1));
        assert_eq!(end, [r#"t=nc({outa:"1"})"#, r#"t=ns("TERMINATED")"#]);
    }

    #[test]
    fn a_net_that_is_gone_has_ended() {
        let mut watch = running();
        let end = watch.handle_end().map(|m| m.to_string());
        assert_eq!(end.as_deref(), Some(r#"t=ns("TERMINATED")"#));
        assert_eq!(watch.handle_end(), None);
        assert_eq!(watch.handle_gone().to_string(), r#"t=ns("UNLOADED")"#);
    }
}
