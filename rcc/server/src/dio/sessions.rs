//! Subscription of one client to the nets of one session: tracks the states already pushed and finds those to be
//! pushed next. It does not call the controller.

use std::collections::BTreeMap;

use takt_client::wire::{Message, Value};
use takt_core::controller::{NetId, NetState};

use super::push;

/// A subscription to the states of all nets of a session.
#[derive(Debug)]
pub(super) struct SessionWatch {
    tag: String,
    /// How many states of each net were pushed.
    reported: BTreeMap<NetId, usize>,
}

impl SessionWatch {
    /// A new subscription.
    pub(super) const fn new(tag: String) -> Self {
        Self {
            tag,
            reported: BTreeMap::new(),
        }
    }

    /// Pushes for what changed. `nets` are those the session has now, `states` all states a net has been in. For a
    /// net seen for the first time, only its present state is pushed; a net that has passed several states since
    /// gives as many messages.
    pub(super) fn handle_nets(
        &mut self,
        nets: Vec<NetId>,
        states: impl Fn(NetId) -> Option<Vec<NetState>>,
    ) -> Vec<Message> {
        let now: BTreeMap<_, _> = nets
            .into_iter()
            .filter_map(|n| Some((n, states(n)?)))
            .collect();
        let mut rounds = Vec::new();
        for (net, states) in &now {
            let reported = self
                .reported
                .get(net)
                .copied()
                .unwrap_or_else(|| states.len().saturating_sub(1));
            for (round, state) in states.iter().skip(reported).enumerate() {
                add(&mut rounds, round, *net, *state);
            }
        }
        for net in self.reported.keys().filter(|n| !now.contains_key(n)) {
            add(&mut rounds, 0, *net, NetState::Unloaded);
        }
        self.reported = now
            .into_iter()
            .map(|(net, states)| (net, states.len()))
            .collect();
        rounds
            .into_iter()
            .map(|states| push(&self.tag, "st", states))
            .collect()
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
        let states: BTreeMap<_, _> = nets.iter().map(|(n, s)| (NetId(*n), s.to_vec())).collect();
        let ids = states.keys().copied().collect();
        let messages = watch.handle_nets(ids, |net| states.get(&net).cloned());
        messages.iter().map(Message::to_string).collect()
    }

    #[test]
    fn session_watch_pushes_present_states_then_changes() {
        let mut watch = SessionWatch::new("t".to_owned());
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
        let mut watch = SessionWatch::new("t".to_owned());
        pushes(&mut watch, &[(0, &[Loading, Ready])]);
        assert_eq!(pushes(&mut watch, &[]), [r#"t=st({rpinet0:"UNLOADED"})"#]);
        assert_eq!(pushes(&mut watch, &[]), Vec::<String>::new());
    }
}
