//! Subscription of one client to one synchronization rule. It does not call the controller.

use takt_client::wire::Message;
use takt_core::controller::RuleState;

use super::push;

/// A subscription to a rule. It ends with the rule, whose state is final then.
#[derive(Debug)]
pub(super) struct RuleWatch {
    tag: String,
    reported: Option<RuleState>,
}

impl RuleWatch {
    /// A new subscription.
    pub(super) const fn new(tag: String) -> Self {
        Self {
            tag,
            reported: None,
        }
    }

    /// Push for the state, if it is new.
    pub(super) fn handle_state(&mut self, state: RuleState) -> Option<Message> {
        let new = self.reported != Some(state);
        self.reported = Some(state);
        new.then(|| push(&self.tag, "rs", state.word()))
    }

    /// Whether the rule can still change its state.
    pub(super) fn is_pending(&self) -> bool {
        self.reported.is_none_or(|state| state == RuleState::Active)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rule_state_is_pushed_once() {
        let mut watch = RuleWatch::new("t".to_owned());
        let mut pushed = |state| watch.handle_state(state).map(|m| m.to_string());
        assert_eq!(
            pushed(RuleState::Active).as_deref(),
            Some(r#"t=rs("ACTIVE")"#)
        );
        assert_eq!(pushed(RuleState::Active), None);
        assert_eq!(
            pushed(RuleState::Fired).as_deref(),
            Some(r#"t=rs("FIRED")"#)
        );
        assert!(!watch.is_pending());
    }

    #[test]
    fn rule_states_use_known_words() {
        let words = [
            (RuleState::FireFailed, r#"t=rs("FIREFAILED")"#),
            (RuleState::Inactive, r#"t=rs("INACTIVE")"#),
        ];
        for (state, word) in words {
            let mut watch = RuleWatch::new("t".to_owned());
            assert!(watch.is_pending());
            assert_eq!(watch.handle_state(state).unwrap().to_string(), word);
        }
    }
}
