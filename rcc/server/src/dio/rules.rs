//! What one client was told of one synchronization rule, and what it is to be told next. It asks
//! the controller nothing.

use takt_core::controller::RuleState;

use super::push;
use crate::wire::Message;

/// A subscription to a rule. It ends with the rule: what became of it cannot change any more.
#[derive(Debug)]
pub(super) struct RuleWatch {
    tag: String,
    told: Option<RuleState>,
}

impl RuleWatch {
    /// A subscription that was told nothing yet.
    pub(super) const fn new(tag: String) -> Self {
        Self { tag, told: None }
    }

    /// Tells the state if it is new.
    pub(super) fn handle_state(&mut self, state: RuleState) -> Option<Message> {
        let new = self.told != Some(state);
        self.told = Some(state);
        new.then(|| push(&self.tag, "rs", state.word()))
    }

    /// Whether there is something to come.
    pub(super) fn goes_on(&self) -> bool {
        self.told.is_none_or(|state| state == RuleState::Active)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_state_is_told_once() {
        let mut watch = RuleWatch::new("t".to_owned());
        let mut told = |state| watch.handle_state(state).map(|m| m.to_string());
        assert_eq!(
            told(RuleState::Active).as_deref(),
            Some(r#"t=rs("ACTIVE")"#)
        );
        assert_eq!(told(RuleState::Active), None);
        assert_eq!(told(RuleState::Fired).as_deref(), Some(r#"t=rs("FIRED")"#));
        assert!(!watch.goes_on());
    }

    #[test]
    fn words_are_those_that_clients_know() {
        let words = [
            (RuleState::FireFailed, r#"t=rs("FIREFAILED")"#),
            (RuleState::Inactive, r#"t=rs("INACTIVE")"#),
        ];
        for (state, word) in words {
            let mut watch = RuleWatch::new("t".to_owned());
            assert!(watch.goes_on());
            assert_eq!(watch.handle_state(state).unwrap().to_string(), word);
        }
    }
}
