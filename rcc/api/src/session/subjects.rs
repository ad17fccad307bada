//! What the pushes of a controller are about.

use std::collections::BTreeMap;
use std::sync::Arc;

use takt_client::Message;

use crate::slot::Shared;

/// What the tags of pushes stand for. The lock is held while a push is handled, so that pushes of one subject are handled
/// in their order.
#[derive(Debug, Default)]
pub(super) struct Subjects {
    pub(super) known: BTreeMap<String, Subject>,
    /// Pushes whose subscription was not yet confirmed.
    pub(super) early: Vec<Message>,
}

#[derive(Clone, Debug)]
pub(super) enum Subject {
    Net(String),
    Rule(String),
    /// A net whose values a program listens to.
    Listener(String, Arc<Shared>),
    /// A net that the controller rejected; it is unloaded at once.
    Rejected,
}
