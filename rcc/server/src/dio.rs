//! One client's side of the protocol, without sockets and without a clock: lines in, lines out.
//! It knows nothing of other clients; they meet in the controller only.

mod commands;
mod devices;
mod figures;
mod nets;
mod refusal;
mod rules;
mod sessions;

#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::time::Duration;

use std::sync::Arc;

use takt_core::controller::{DeviceInfo, RuleId};
use takt_core::device::DeviceStatus;
use takt_core::{Controller, NetId, OnLoss, SessionId};

use crate::access::{Admission, Credential, Gate, Peer};
use crate::sessions::Sessions;
use crate::wire::{Message, Value};
pub(crate) use commands::DESCRIPTION_BYTES_MAX;
use devices::DeviceWatch;
use nets::NetWatch;
use refusal::Refusal;
use rules::RuleWatch;
use sessions::SessionWatch;

/// Most subscriptions of one connection: nets, sessions, rules and devices together.
pub const SUBSCRIPTIONS_MAX: usize = 4096;

/// How often values of running nets are looked at. A client's refresh interval below this one has
/// no effect.
pub const VALUES_EVERY: Duration = Duration::from_millis(10);

/// Name and type of the device that is the controller itself.
const CONTROLLER: &str = "rcc";

/// A client and what it subscribed to.
///
/// Hand every line of the client to [`handle_line`](Self::handle_line), call
/// [`handle_change`](Self::handle_change) when the controller says that something changed, and
/// [`poll_pushes`](Self::poll_pushes) after either and when [`poll_timeout`](Self::poll_timeout)
/// is over. All times count from the same moment, such as the start of the connection. Calls may
/// block for as long as the controller needs, which for loading a net can be long.
#[derive(Debug)]
pub struct Connection {
    controller: Controller,
    greeted: bool,
    nets: BTreeMap<NetId, NetWatch>,
    rules: BTreeMap<RuleId, RuleWatch>,
    sessions: BTreeMap<SessionId, SessionWatch>,
    devices: Option<DeviceWatch>,
    opened: Vec<SessionId>,
    changed: bool,
    /// What becomes of sessions that do not say otherwise.
    on_loss: OnLoss,
    /// Where a token is given.
    door: Option<Door>,
    /// Whether it must be given first.
    needs_token: bool,
    /// What the client was admitted for.
    credential: Credential,
    /// Whether the connection is to end.
    refused: bool,
    /// Whether the first line that is not as it should be ends the connection.
    strict: bool,
    /// Whether the answer is to be sent after [`WRONG_PAUSE`](crate::access::WRONG_PAUSE).
    slowed: bool,
    /// What all connections of a server opened, and the beginning of this one on its time line.
    all_sessions: Option<(Sessions, Duration)>,
}

/// A gate, and who stands before it.
#[derive(Debug)]
struct Door {
    gate: Arc<Gate>,
    peer: Peer,
    /// When the connection began, on the time line of the gate.
    begin: Duration,
}

impl Door {
    fn check(&self, given: Option<&str>, now: Duration) -> Admission {
        self.gate.check(self.peer, given, self.begin + now)
    }
}

/// How much of what is due is sent.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Pushes {
    /// What the command caused that is about to be answered.
    BeforeReply,
    /// Everything, including that nets are gone and that values changed.
    All,
}

impl Connection {
    /// A client that has said nothing yet.
    #[must_use]
    pub const fn new(controller: Controller) -> Self {
        Self {
            controller,
            greeted: false,
            nets: BTreeMap::new(),
            rules: BTreeMap::new(),
            sessions: BTreeMap::new(),
            devices: None,
            opened: Vec::new(),
            changed: false,
            on_loss: OnLoss::End,
            door: None,
            needs_token: false,
            credential: Credential::Loopback,
            refused: false,
            strict: false,
            slowed: false,
            all_sessions: None,
        }
    }

    /// The same, with what becomes of sessions that do not say it themselves.
    #[must_use]
    pub const fn with_on_loss(mut self, on_loss: OnLoss) -> Self {
        self.on_loss = on_loss;
        self
    }

    /// The same, behind a gate, where it may have to give a token before anything else; the connection begins
    /// at `begin` on the gate's time line.
    #[must_use]
    pub fn behind(mut self, gate: &Arc<Gate>, peer: Peer, begin: Duration) -> Self {
        let without = gate.without_token(peer);
        self.credential = without.unwrap_or(Credential::Token);
        // With or without need of one, a right token has places of its own.
        let gate = Arc::clone(gate);
        self.needs_token = without.is_none();
        self.door = Some(Door { gate, peer, begin });
        self
    }

    /// The same, of a client that was admitted already.
    #[must_use]
    pub const fn admitted_for(mut self, credential: Credential) -> Self {
        self.credential = credential;
        self
    }

    /// The same, but the first line that is neither token nor handshake, or a wrong one, ends it.
    #[must_use]
    pub const fn strict(mut self) -> Self {
        self.strict = true;
        self
    }

    /// The same, with the sessions of all connections, whose time line it begins on at `begin`.
    pub(crate) fn with_sessions(mut self, sessions: &Sessions, begin: Duration) -> Self {
        self.all_sessions = Some((sessions.clone(), begin));
        self
    }

    /// Whether the client may say anything.
    #[must_use]
    pub const fn is_admitted(&self) -> bool {
        !self.needs_token
    }

    /// Whether the client has shaken hands.
    #[must_use]
    pub const fn is_greeted(&self) -> bool {
        self.greeted
    }

    /// What the client was admitted for.
    #[must_use]
    pub const fn credential(&self) -> Credential {
        self.credential
    }

    /// Whether the client gave a wrong token, or what is no handshake, after which the connection is to end.
    #[must_use]
    pub const fn is_refused(&self) -> bool {
        self.refused
    }

    /// Whether the client is to wait for its answer.
    #[must_use]
    pub const fn is_slowed(&self) -> bool {
        self.slowed
    }

    /// Whether the client waits for nothing and has no session, so that nothing is lost with it.
    #[must_use]
    pub fn is_idle(&self) -> bool {
        self.subscriptions() == 0 && self.opened.is_empty()
    }

    fn subscriptions(&self) -> usize {
        let devices = usize::from(self.devices.is_some());
        self.nets.len() + self.sessions.len() + self.rules.len() + devices
    }

    /// Does what the line says and returns what to send: pushes caused by it, then its reply.
    pub fn handle_line(&mut self, line: &str, now: Duration) -> Vec<String> {
        let message = match Message::decode(line) {
            Ok(message) => message,
            Err(error) => {
                tracing::debug!(%error, "a client sent what is no message");
                self.refused |= self.strict && !self.greeted;
                return vec![Refusal::InvalidSyntax.reply("none").to_string()];
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
            Err(refusal) => {
                self.refused |= self.strict && !self.greeted;
                refusal.reply(&message.tag)
            }
        });
        self.changed = true;
        out.iter().map(Message::to_string).collect()
    }

    /// Notes that nets, sessions or devices of the controller changed.
    pub const fn handle_change(&mut self) {
        self.changed = true;
    }

    /// What the subscriptions have to tell now.
    pub fn poll_pushes(&mut self, now: Duration) -> Vec<String> {
        let changes = if std::mem::take(&mut self.changed) {
            self.due(Pushes::All, now)
        } else {
            Vec::new()
        };
        let values = self.values(now);
        changes
            .iter()
            .chain(&values)
            .map(Message::to_string)
            .collect()
    }

    /// When [`poll_pushes`](Self::poll_pushes) should be called next without being asked.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Duration> {
        if self.changed {
            return Some(Duration::ZERO);
        }
        self.nets.values().filter_map(NetWatch::poll_timeout).min()
    }

    /// The sessions that this connection opened and did not end.
    #[must_use]
    pub fn opened_sessions(&self) -> &[SessionId] {
        &self.opened
    }

    /// Changes of state; values only as far as they belong to those.
    fn due(&mut self, pushes: Pushes, now: Duration) -> Vec<Message> {
        let controller = &self.controller;
        let mut out = Vec::new();
        self.nets.retain(|id, watch| match controller.net(*id) {
            Some(info) => {
                out.extend(watch.handle_states(&info.states, || controller.out_values(*id), now));
                true
            }
            None => {
                if let Some(net) = controller.departed(*id) {
                    out.extend(watch.handle_states(&net.states, || net.values, now));
                }
                out.extend(watch.handle_end());
                out.extend((pushes == Pushes::All).then(|| watch.handle_gone()));
                pushes != Pushes::All
            }
        });
        self.rules.retain(|id, watch| {
            // A rule that was forgotten meanwhile has no state that clients know.
            let state = controller.rule(*id).map(|rule| rule.state);
            out.extend(state.and_then(|state| watch.handle_state(state)));
            state.is_some() && watch.goes_on()
        });
        self.sessions.retain(|id, watch| {
            let nets = controller.session_nets(*id);
            let ended = nets.is_none();
            out.extend(watch.handle_nets(nets.unwrap_or_default(), |net| {
                controller.net(net).map(|info| info.states)
            }));
            !ended
        });
        if let Some(watch) = &mut self.devices {
            out.extend(watch.handle_devices(all_devices(controller)));
        }
        out
    }

    fn values(&mut self, now: Duration) -> Vec<Message> {
        let controller = &self.controller;
        let due = self
            .nets
            .iter_mut()
            .filter(|(_, w)| w.poll_timeout().is_some_and(|t| t <= now));
        due.filter_map(|(id, w)| w.handle_values(controller.out_values(*id), now))
            .collect()
    }
}

/// A push with one value.
fn push(tag: &str, command: &str, value: impl Into<Value>) -> Message {
    Message::new(tag, command).with(value)
}

/// The devices, and the controller itself, which clients expect to be one.
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
