//! The protocol of one client, without sockets and without a clock: lines in, lines out. It knows no other clients;
//! they share the controller only.

mod args;
mod commands;
mod details;
mod devices;
mod error;
mod figures;
mod limits;
mod machines;
mod nets;
mod pace;
mod push;
mod rules;
mod sessions;

#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::time::Duration;

use std::sync::Arc;

use takt_client::wire::Message;
use takt_core::controller::{Changed, DeviceInfo, RuleId};
use takt_core::device::DeviceStatus;
use takt_core::{Controller, NetId, OnLoss, SessionId};

use crate::access::{Admission, Credential, Gate, Peer};
use crate::sessions::Sessions;
use devices::DeviceWatch;
use error::CommandError;
pub(crate) use limits::{DESCRIPTION_BYTES_MAX, VALUES_INTERVAL};
use nets::NetWatch;
use pace::Pushes;
use push::push;
use rules::RuleWatch;
use sessions::SessionWatch;

/// Name and type of the device that represents the controller itself.
const CONTROLLER: &str = "rcc";

/// One client and its subscriptions.
///
/// Pass every line of the client to [`handle_line`](Self::handle_line), call
/// [`handle_change`](Self::handle_change) when the controller reports a change, and
/// [`poll_pushes`](Self::poll_pushes) after either and when [`poll_timeout`](Self::poll_timeout)
/// expires. All times count from the same moment, such as the start of the connection. Calls may
/// block as long as the controller does, which can be long when it loads a net.
#[derive(Debug)]
pub(crate) struct Connection {
    controller: Controller,
    handshake_done: bool,
    nets: BTreeMap<NetId, NetWatch>,
    rules: BTreeMap<RuleId, RuleWatch>,
    sessions: BTreeMap<SessionId, SessionWatch>,
    devices: Option<DeviceWatch>,
    opened: Vec<SessionId>,
    changed: bool,
    /// Whether Boolean values may have changed.
    has_results: bool,
    /// Default for sessions that are opened without it.
    on_loss: OnLoss,
    /// Checks tokens; `None` if there is no gate.
    token_check: Option<TokenCheck>,
    /// Whether a token must be sent first.
    needs_token: bool,
    /// On which grounds the client was admitted.
    credential: Credential,
    /// Whether the connection must end.
    rejected: bool,
    /// Whether a failed token or handshake ends the connection.
    strict: bool,
    /// Whether the reply is to be sent after [`WRONG_DELAY`](crate::access::WRONG_DELAY).
    delayed: bool,
    /// The sessions of all connections of a server, and the start of this one on their time line.
    all_sessions: Option<(Sessions, Duration)>,
}

/// Checks the tokens of one peer at a gate.
#[derive(Debug)]
struct TokenCheck {
    gate: Arc<Gate>,
    peer: Peer,
    /// Start of the connection on the gate's time line.
    begin: Duration,
}

impl TokenCheck {
    fn check(&self, given: Option<&str>, now: Duration) -> Admission {
        self.gate.check(self.peer, given, self.begin + now)
    }
}

impl Connection {
    /// A new client.
    pub(crate) const fn new(controller: Controller) -> Self {
        Self {
            controller,
            handshake_done: false,
            nets: BTreeMap::new(),
            rules: BTreeMap::new(),
            sessions: BTreeMap::new(),
            devices: None,
            opened: Vec::new(),
            changed: false,
            has_results: false,
            on_loss: OnLoss::End,
            token_check: None,
            needs_token: false,
            credential: Credential::Loopback,
            rejected: false,
            strict: false,
            delayed: false,
            all_sessions: None,
        }
    }

    /// Sets the default for what happens to sessions when the client is lost.
    #[must_use]
    pub(crate) const fn with_on_loss(mut self, on_loss: OnLoss) -> Self {
        self.on_loss = on_loss;
        self
    }

    /// Sets the gate that may require a token before anything else; the connection starts at `begin` on the gate's
    /// time line.
    #[must_use]
    pub(crate) fn with_gate(mut self, gate: &Arc<Gate>, peer: Peer, begin: Duration) -> Self {
        let without = gate.without_token(peer);
        self.credential = without.unwrap_or(Credential::Token);
        // The right token gives its own credential, even where none is required.
        let gate = Arc::clone(gate);
        self.needs_token = without.is_none();
        self.token_check = Some(TokenCheck { gate, peer, begin });
        self
    }

    /// Sets the credential of a client that is already admitted.
    #[must_use]
    pub(crate) const fn admitted_for(mut self, credential: Credential) -> Self {
        self.credential = credential;
        self
    }

    /// Ends the connection after a first line that is neither a right token nor a right handshake.
    #[must_use]
    pub(crate) const fn strict(mut self) -> Self {
        self.strict = true;
        self
    }

    /// Sets the sessions shared by all connections; this one starts at `begin` on their time line.
    pub(crate) fn with_sessions(mut self, sessions: &Sessions, begin: Duration) -> Self {
        self.all_sessions = Some((sessions.clone(), begin));
        self
    }

    /// Whether the handshake has succeeded.
    pub(crate) const fn is_handshake_done(&self) -> bool {
        self.handshake_done
    }

    /// On which grounds the client was admitted.
    pub(crate) const fn credential(&self) -> Credential {
        self.credential
    }

    /// Whether the connection must end after a wrong token or a failed handshake.
    pub(crate) const fn is_rejected(&self) -> bool {
        self.rejected
    }

    /// Whether the reply must be delayed.
    pub(crate) const fn is_delayed(&self) -> bool {
        self.delayed
    }

    /// Whether the client has neither subscription nor session, so that its connection may be closed.
    pub(crate) fn is_idle(&self) -> bool {
        self.subscriptions() == 0 && self.opened.is_empty()
    }

    fn subscriptions(&self) -> usize {
        let devices = usize::from(self.devices.is_some());
        self.nets.len() + self.sessions.len() + self.rules.len() + devices
    }

    /// Executes a line and returns the lines to send: pushes that it caused, then its reply.
    pub(crate) fn handle_line(&mut self, line: &str, now: Duration) -> Vec<String> {
        let message = match Message::decode(line) {
            Ok(message) => message,
            Err(error) => {
                tracing::debug!(%error, "a client sent an invalid message");
                self.rejected |= self.strict && !self.handshake_done;
                return vec![CommandError::InvalidSyntax.reply("none").to_string()];
            }
        };
        let mut out = Vec::new();
        let outcome = self.execute(&message, now, &mut out);
        out.extend(self.due(Pushes::BeforeReply, now));
        out.push(match outcome {
            Ok(values) => Message {
                args: values,
                ..Message::new(message.tag, "ok")
            },
            Err(error) => {
                self.rejected |= self.strict && !self.handshake_done;
                error.reply(&message.tag)
            }
        });
        self.changed = true;
        out.iter().map(Message::to_string).collect()
    }

    /// Records what changed in the controller.
    pub(crate) const fn handle_change(&mut self, changed: Changed) {
        self.has_results = true;
        if matches!(changed, Changed::States) {
            self.changed = true;
        }
    }

    /// Whether a change of Boolean values may cause a push.
    pub(crate) fn wants_results(&self) -> bool {
        self.nets.values().any(NetWatch::wants_results)
    }

    /// The pushes of all subscriptions that are due now.
    pub(crate) fn poll_pushes(&mut self, now: Duration) -> Vec<String> {
        let states_due = self.states_timeout().is_some_and(|at| at <= now);
        let changes = if std::mem::take(&mut self.changed) || states_due {
            self.due(Pushes::Due, now)
        } else {
            Vec::new()
        };
        let values = self.values(now);
        let results = if std::mem::take(&mut self.has_results) {
            self.results(now)
        } else {
            Vec::new()
        };
        changes
            .iter()
            .chain(&values)
            .chain(&results)
            .map(Message::to_string)
            .collect()
    }

    /// When [`poll_pushes`](Self::poll_pushes) must be called next, unless something happens earlier.
    pub(crate) fn poll_timeout(&self) -> Option<Duration> {
        if self.changed || self.has_results {
            return Some(Duration::ZERO);
        }
        let values = self.nets.values().filter_map(NetWatch::values_timeout);
        values.chain(self.states_timeout()).min()
    }

    /// When a state must be pushed that was noticed before.
    fn states_timeout(&self) -> Option<Duration> {
        let nets = self.nets.values().filter_map(NetWatch::state_timeout);
        let sessions = self.sessions.values().filter_map(SessionWatch::timeout);
        nets.chain(sessions).min()
    }

    /// The sessions that this connection has open.
    pub(crate) fn opened_sessions(&self) -> &[SessionId] {
        &self.opened
    }

    /// Pushes for state changes, with the values that belong to those. Rules come first: the known client overwrites
    /// the end of a net by its start if it receives the start rule's `FIRED` last.
    fn due(&mut self, pushes: Pushes, now: Duration) -> Vec<Message> {
        let controller = &self.controller;
        let mut out = Vec::new();
        self.rules.retain(|id, watch| {
            let state = controller.rule_state(*id);
            out.extend(state.and_then(|state| watch.handle_state(state)));
            state.is_some() && watch.is_pending()
        });
        self.nets.retain(|id, watch| match controller.net(*id) {
            Some(info) => {
                let values = || controller.out_values(*id);
                out.extend(watch.handle_states(&info.states, values, pushes, now));
                true
            }
            None => {
                let result = || controller.retained(*id);
                let (messages, last) = watch.handle_unloaded(result, pushes, now);
                out.extend(messages);
                !last
            }
        });
        self.sessions.retain(|id, watch| {
            let nets = controller.session_nets(*id);
            let ended = nets.is_none();
            let states = |net| controller.net(net).map(|info| info.states);
            out.extend(watch.handle_nets(nets.unwrap_or_default(), states, pushes, now));
            !ended || watch.timeout().is_some()
        });
        if let Some(watch) = &mut self.devices {
            out.extend(watch.handle_devices(all_devices(controller)));
        }
        out
    }

    /// Pushes for Boolean values that changed.
    fn results(&mut self, now: Duration) -> Vec<Message> {
        let controller = &self.controller;
        let nets = self.nets.iter_mut();
        let pushes = nets.filter_map(|(id, watch)| {
            watch.handle_results(|seen| controller.new_results(*id, seen), now)
        });
        pushes.collect()
    }

    fn values(&mut self, now: Duration) -> Vec<Message> {
        let controller = &self.controller;
        let due = self
            .nets
            .iter_mut()
            .filter(|(_, w)| w.values_timeout().is_some_and(|t| t <= now));
        due.filter_map(|(id, w)| w.handle_values(controller.out_values(*id), now))
            .collect()
    }
}

/// The devices, and the controller itself, which clients expect as a device.
pub(crate) fn all_devices(controller: &Controller) -> Vec<DeviceInfo> {
    let mut devices = controller.devices();
    if devices.iter().all(|d| d.name != CONTROLLER) {
        devices.push(DeviceInfo {
            name: CONTROLLER.to_owned(),
            kind: CONTROLLER.to_owned(),
            interfaces: BTreeMap::new(),
            status: DeviceStatus::Operational.under(controller.is_stopped()),
        });
    }
    devices
}
