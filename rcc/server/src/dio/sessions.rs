//! Subscription of one client to the nets of one session: tracks the states already pushed and finds those to be
//! pushed next. It does not call the controller.

use std::collections::BTreeMap;
use std::time::Duration;

use takt_client::wire::{Message, Value};
use takt_core::controller::{NetId, NetState};

use super::pace::{Pace, Pushes, WINDOW};
use super::push;

/// A subscription to the states of all nets of a session.
#[derive(Debug)]
pub(super) struct SessionWatch {
    tag: String,
    pace: Pace,
    /// How many states of each net were pushed.
    reported: BTreeMap<NetId, usize>,
    /// When changes that were noticed are pushed.
    due: Option<Duration>,
}

/// The states that each net of a session has been in.
type States = BTreeMap<NetId, Vec<NetState>>;

impl SessionWatch {
    /// A new subscription.
    pub(super) const fn new(tag: String, pace: Pace) -> Self {
        Self {
            tag,
            pace,
            reported: BTreeMap::new(),
            due: None,
        }
    }

    /// Pushes for what changed. `nets` are those the session has now, `states` all states a net has been in. For a
    /// net seen for the first time, only its present state is pushed. Of a net that has passed several states since,
    /// the last is pushed, or each in a message of its own, as the pace has it.
    pub(super) fn handle_nets(
        &mut self,
        nets: Vec<NetId>,
        states: impl Fn(NetId) -> Option<Vec<NetState>>,
        pushes: Pushes,
        now: Duration,
    ) -> Vec<Message> {
        let states: States = nets
            .into_iter()
            .filter_map(|n| Some((n, states(n)?)))
            .collect();
        let rounds = self.rounds(&states);
        if rounds.is_empty() {
            self.due = None;
            return Vec::new();
        }
        if self.pace == Pace::Coalesced {
            let due = *self.due.get_or_insert(now + WINDOW);
            if now < pushes.at(due) {
                return Vec::new();
            }
            self.due = None;
        }
        self.reported = states
            .into_iter()
            .map(|(net, states)| (net, states.len()))
            .collect();
        rounds
            .into_iter()
            .map(|states| push(&self.tag, "st", states))
            .collect()
    }

    /// When changes that were noticed must be pushed.
    pub(super) const fn timeout(&self) -> Option<Duration> {
        self.due
    }

    /// What is new, as one map for each message.
    fn rounds(&self, now: &States) -> Vec<BTreeMap<String, Value>> {
        let mut rounds = Vec::new();
        for (net, states) in now {
            let reported = self.reported.get(net).copied();
            let reported = match self.pace {
                // All but the last were passed over.
                Pace::Coalesced if reported.is_some_and(|count| count >= states.len()) => continue,
                Pace::Every if reported.is_some() => reported.unwrap_or_default(),
                Pace::Coalesced | Pace::Every => states.len().saturating_sub(1),
            };
            for (round, state) in states.iter().skip(reported).enumerate() {
                add(&mut rounds, round, *net, *state);
            }
        }
        for net in self.reported.keys().filter(|n| !now.contains_key(n)) {
            add(&mut rounds, 0, *net, NetState::Unloaded);
        }
        rounds
    }
}

fn add(rounds: &mut Vec<BTreeMap<String, Value>>, round: usize, net: NetId, state: NetState) {
    if rounds.len() <= round {
        rounds.resize_with(round + 1, BTreeMap::new);
    }
    if let Some(states) = rounds.get_mut(round) {
        states.insert(net.to_string(), state.word().into());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use NetState::{Loading, Ready, Running, Terminated};

    fn pushes(watch: &mut SessionWatch, nets: &[(u32, &[NetState])]) -> Vec<String> {
        pushes_at(watch, nets, Pushes::Due, 0)
    }

    fn pushes_at(
        watch: &mut SessionWatch,
        nets: &[(u32, &[NetState])],
        pushes: Pushes,
        ms: u64,
    ) -> Vec<String> {
        let states: BTreeMap<_, _> = nets.iter().map(|(n, s)| (NetId(*n), s.to_vec())).collect();
        let ids = states.keys().copied().collect();
        let messages = watch.handle_nets(
            ids,
            |net| states.get(&net).cloned(),
            pushes,
            Duration::from_millis(ms),
        );
        messages.iter().map(Message::to_string).collect()
    }

    #[test]
    fn session_watch_pushes_present_states_then_changes() {
        let mut watch = SessionWatch::new("t".to_owned(), Pace::Every);
        assert_eq!(pushes(&mut watch, &[]), Vec::<String>::new());
        let both: &[(u32, &[_])] = &[(0, &[Loading, Ready]), (1, &[Loading, Ready, Running])];
        assert_eq!(
            pushes(&mut watch, both),
            [r#"t=st({rpinet0:"READY",rpinet1:"RUNNING"})"#]
        );
        assert_eq!(pushes(&mut watch, both), Vec::<String>::new());
        let life = [Loading, Ready, Running, Terminated];
        assert_eq!(
            pushes(&mut watch, &[(0, &life), (1, &life)]),
            [
                r#"t=st({rpinet0:"RUNNING",rpinet1:"TERMINATED"})"#,
                r#"t=st({rpinet0:"TERMINATED"})"#
            ]
        );
    }

    #[test]
    fn session_watch_reports_missing_nets_unloaded() {
        let mut watch = SessionWatch::new("t".to_owned(), Pace::Every);
        pushes(&mut watch, &[(0, &[Loading, Ready])]);
        assert_eq!(pushes(&mut watch, &[]), [r#"t=st({rpinet0:"UNLOADED"})"#]);
        assert_eq!(pushes(&mut watch, &[]), Vec::<String>::new());
    }

    #[test]
    fn session_watch_coalesces_states_within_window() {
        let mut watch = SessionWatch::new("t".to_owned(), Pace::Coalesced);
        let life = [Loading, Ready, Running, Terminated];
        let present = pushes_at(&mut watch, &[(0, &life[..2])], Pushes::BeforeReply, 5);
        assert_eq!(present, [r#"t=st({rpinet0:"READY"})"#]);
        let none = Vec::<String>::new();
        for (known, ms) in [(3, 20), (4, 29)] {
            let early = pushes_at(&mut watch, &[(0, &life[..known])], Pushes::Due, ms);
            assert_eq!(early, none);
        }
        assert_eq!(watch.timeout(), Some(Duration::from_millis(30)));
        let both: &[(u32, &[_])] = &[(0, &life), (1, &life[..2])];
        assert_eq!(
            pushes_at(&mut watch, both, Pushes::Due, 30),
            [r#"t=st({rpinet0:"TERMINATED",rpinet1:"READY"})"#]
        );
        assert_eq!(pushes_at(&mut watch, both, Pushes::Due, 60), none);
    }
}
