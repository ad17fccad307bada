//! Subscription of one client to one net: tracks the states and values already pushed and finds those to be pushed
//! next. It does not call the controller.

use std::collections::BTreeMap;
use std::time::Duration;

use takt_client::wire::{Message, Value};
use takt_core::controller::NetState;

use super::{VALUES_INTERVAL, push};

/// A subscription to a net.
///
/// Every state is pushed once, in order, as `ns`. Values are pushed as `nc` while the net runs,
/// each at most once per refresh interval and only when changed. All values are pushed together
/// with a state change: shortly after `RUNNING`, but before the states that end a net, so that the last
/// values always precede `TERMINATED`.
#[derive(Debug)]
pub(super) struct NetWatch {
    tag: String,
    refresh: Duration,
    /// How many states of the net were pushed.
    reported: usize,
    running: bool,
    ended: bool,
    sent: BTreeMap<String, Sent>,
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
    pub(super) const fn new(tag: String, refresh: Duration, states: usize) -> Self {
        Self {
            tag,
            refresh,
            reported: states.saturating_sub(1),
            running: false,
            ended: false,
            sent: BTreeMap::new(),
            next_poll: Duration::ZERO,
        }
    }

    /// Pushes for new states.
    pub(super) fn handle_states(
        &mut self,
        states: &[NetState],
        values: impl FnOnce() -> Values,
        now: Duration,
    ) -> Vec<Message> {
        let new = states.get(self.reported..).unwrap_or_default();
        self.reported = states.len();
        let Some(last) = new.last() else {
            return Vec::new();
        };
        self.running = matches!(last, NetState::Running | NetState::Cancelling);
        self.ended |= matches!(last, NetState::Terminated);
        let mut out: Vec<_> = new
            .iter()
            .map(|s| push(&self.tag, "ns", s.word()))
            .collect();
        if let Some(at) = new.iter().position(|s| follows_values(*s)) {
            out.splice(at..at, self.report(values(), true, now));
        }
        out
    }

    /// Push for changed values, if the net runs.
    pub(super) fn handle_values(&mut self, values: Values, now: Duration) -> Option<Message> {
        self.next_poll = now + VALUES_INTERVAL;
        self.report(values, false, now)
    }

    /// Push for unloading, which the protocol shows as one more `TERMINATED`.
    pub(super) fn handle_unloading(&mut self) -> Message {
        self.running = false;
        self.ended = true;
        push(&self.tag, "ns", NetState::Terminated.word())
    }

    /// Push for the end of the net, unless already sent.
    pub(super) fn handle_end(&mut self) -> Option<Message> {
        (!self.ended).then(|| self.handle_unloading())
    }

    /// Push for an unloaded net.
    pub(super) fn handle_unloaded(&self) -> Message {
        push(&self.tag, "ns", NetState::Unloaded.word())
    }

    /// When values must be polled next.
    pub(super) fn poll_timeout(&self) -> Option<Duration> {
        self.running.then_some(self.next_poll)
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

/// Whether all values are pushed before this state.
const fn follows_values(state: NetState) -> bool {
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

    fn changes(watch: &mut NetWatch, of: &[(&str, &str)], at: Duration) -> Option<String> {
        watch.handle_values(values(of), at).map(|m| m.to_string())
    }

    #[test]
    fn new_watch_pushes_only_present_state() {
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
    fn later_states_are_pushed_once_in_order() {
        let mut watch = watch(2);
        let life = [Loading, Ready, Scheduled, Running, Cancelling, Terminated];
        let pushed: Vec<_> = (2..=6)
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
        assert_eq!(pushed, expected);
        assert_eq!(states(&mut watch, &life, ms(0)), Vec::<String>::new());
    }

    #[test]
    fn states_passed_at_once_are_all_pushed() {
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
    fn values_are_polled_only_while_net_runs() {
        let mut watch = watch(2);
        states(&mut watch, &[Loading, Ready], ms(0));
        assert_eq!(watch.poll_timeout(), None);
        states(&mut watch, &[Loading, Ready, Running], ms(5));
        assert!(watch.poll_timeout().is_some_and(|at| at <= ms(5)));
        changes(&mut watch, &[], ms(5));
        assert_eq!(watch.poll_timeout(), Some(ms(15)));
        states(&mut watch, &[Loading, Ready, Running, Terminated], ms(6));
        assert_eq!(watch.poll_timeout(), None);
    }

    #[test]
    fn value_is_pushed_after_change_and_interval() {
        let mut watch = running();
        let nc = |text: &str| Some(format!("t=nc({{outa:\"{text}\"}})"));
        assert_eq!(changes(&mut watch, &[("outa", "1")], ms(10)), nc("1"));
        assert_eq!(changes(&mut watch, &[("outa", "2")], ms(109)), None);
        assert_eq!(changes(&mut watch, &[("outa", "2")], ms(110)), nc("2"));
        assert_eq!(changes(&mut watch, &[("outa", "2")], ms(500)), None);
        assert_eq!(changes(&mut watch, &[("outa", "3")], ms(501)), nc("3"));
    }

    #[test]
    fn each_value_has_its_own_interval() {
        let mut watch = running();
        changes(&mut watch, &[("outa", "1")], ms(0));
        let second = changes(&mut watch, &[("outa", "2"), ("outb", "1")], ms(50));
        assert_eq!(second.as_deref(), Some(r#"t=nc({outb:"1"})"#));
        let third = changes(&mut watch, &[("outa", "2"), ("outb", "2")], ms(100));
        assert_eq!(third.as_deref(), Some(r#"t=nc({outa:"2"})"#));
    }

    #[test]
    fn state_change_pushes_values_despite_interval() {
        let mut watch = running();
        changes(&mut watch, &[("outa", "1")], ms(0));
        let end = states(&mut watch, &[Loading, Ready, Running, Terminated], ms(1));
        assert_eq!(end, [r#"t=nc({outa:"1"})"#, r#"t=ns("TERMINATED")"#]);
    }

    #[test]
    fn unloaded_net_pushes_terminated_first() {
        let mut watch = running();
        let end = watch.handle_end().map(|m| m.to_string());
        assert_eq!(end.as_deref(), Some(r#"t=ns("TERMINATED")"#));
        assert_eq!(watch.handle_end(), None);
        assert_eq!(watch.handle_unloaded().to_string(), r#"t=ns("UNLOADED")"#);
    }
}
