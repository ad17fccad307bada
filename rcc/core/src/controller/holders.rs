//! Which nets hold what another net needs, with the session and the program that loaded them: what a refused start names.

use std::fmt;

use crate::controller::Controller;
use crate::controller::nets::{Net, Nets};
use crate::error::UNKNOWN_HOLDER;
use crate::ids::{NetId, NetState, SessionId};

/// A net that holds a resource, or for which it is reserved.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Holder {
    /// The resource, such as `left_Joint_3`.
    pub resource: String,
    /// The net.
    pub net: NetId,
    /// The session that loaded it.
    pub session: SessionId,
    /// Its description, often the name of its program.
    pub description: String,
    /// Whether it runs; else the resource is reserved for it.
    pub runs: bool,
}

impl fmt::Display for Holder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { net, session, .. } = self;
        write!(f, "net {net} of session {session}")?;
        if self.description.is_empty() {
            return Ok(());
        }
        write!(f, " (`{}`)", self.description)
    }
}

impl Controller {
    /// The nets of other sessions that hold what a net needs, or for which it is reserved; one for each resource.
    #[must_use]
    pub fn holders(&self, net: NetId) -> Vec<Holder> {
        self.inner.lock().nets.holders(net)
    }
}

impl Nets {
    /// The nets of other sessions that hold what a net needs.
    fn holders(&self, id: NetId) -> Vec<Holder> {
        let Some((net, needs)) = self.get(id).and_then(|net| Some((net, net.counted()?))) else {
            return Vec::new();
        };
        let mut wanted = needs.resources;
        let mut found = Vec::new();
        while let Some(number) = wanted.common(&needs.resources) {
            wanted.take(number);
            let other = |_: NetId, other: &Net| other.session != net.session;
            found.extend(self.holder_of(number, other));
        }
        found
    }

    /// Names the net that holds a resource, or for which it is reserved, other than `own`.
    pub(super) fn holder_text(&self, number: usize, own: &[NetId]) -> String {
        let holder = self.holder_of(number, |id, _| !own.contains(&id));
        holder.map_or_else(|| UNKNOWN_HOLDER.to_owned(), |holder| holder.to_string())
    }

    /// The net that holds a resource, of those that `is_meant` accepts: one that runs, else one that a rule is to start.
    fn holder_of(&self, number: usize, is_meant: impl Fn(NetId, &Net) -> bool) -> Option<Holder> {
        let needs = |(id, net): &(NetId, &Net)| {
            let counted = net.counted();
            counted.is_some_and(|counted| counted.resources.contains(number)) && is_meant(*id, net)
        };
        let running = self.iter().filter(needs).find(|(_, net)| net.runs());
        let mut others = self.iter().filter(needs);
        let found = running.or_else(|| others.find(|(_, net)| net.state() == NetState::Scheduled));
        found.map(|(id, net)| Holder {
            resource: self.resource_name(number),
            net: id,
            session: net.session,
            description: net.info(id).description,
            runs: net.runs(),
        })
    }
}
