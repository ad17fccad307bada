//! The commands of the protocol: values checked, the controller asked, its answer put into words.
//! What a command causes is not told here, but by the subscriptions.

use std::collections::BTreeMap;
use std::time::Duration;

use takt_core::controller::{LoadRequest, NetInfo, RuleId, RuleRequest};
use takt_core::{Error, NetId, OnLoss, SessionId};

use super::devices::DeviceWatch;
use super::figures;
use super::nets::NetWatch;
use super::refusal::Refusal;
use super::rules::RuleWatch;
use super::sessions::SessionWatch;
use super::{Connection, Pushes, SUBSCRIPTIONS_MAX};
use crate::access::Admission;
use crate::wire::{Message, Value};

/// The version that a client must ask for.
const VERSION: &str = "2.0";

/// Number of the kind of faults of a net whose text does not follow the grammar.
const SYNTAX_FAULT: u32 = 12;

/// Most bytes of the description of a session or a net.
pub(crate) const DESCRIPTION_BYTES_MAX: usize = 4096;

/// Most sessions that one connection has at once.
pub(crate) const SESSIONS_PER_CONNECTION: usize = 64;

/// Most faults of one net that are told.
const FAULTS_MAX: usize = 20;

/// Longest refresh interval that is kept apart from "never again".
const REFRESH_MAX: Duration = Duration::from_secs(3600);

type Outcome = Result<Vec<Value>, Refusal>;

impl Connection {
    /// Does what the message says; the result is what stands in the parentheses of `ok`. What
    /// must be told before it is too late goes to `out`.
    pub(super) fn execute(
        &mut self,
        message: &Message,
        now: Duration,
        out: &mut Vec<Message>,
    ) -> Outcome {
        let args = Args(&message.args);
        let tag = || message.tag.clone();
        match message.command.as_str() {
            "quit" => Ok(vec!["quitting".into()]),
            "tok" => self.admit(args, now),
            _ if self.needs_token => Err(Refusal::TokenMissing),
            "ver" if !self.greeted => self.greet(args),
            _ if !self.greeted => Err(Refusal::BadHandshake),
            "nse" => self.open_session(args, now),
            "ase" => self.end_session(args, now, out),
            "gse" => self.watch_session(args, tag()),
            "gde" => self.watch_devices(tag()),
            "nene" => self.load(args),
            "nest" => self.start(args),
            "neca" => self.cancel(args),
            "neab" => self.abort(args),
            "neun" => self.unload(args, now, out),
            "gne" => self.watch_net(args, tag()),
            "snc" => self.write_values(args),
            "nin" => self.describe_nets(args),
            "nst" => self.figures(args),
            "nesc" => self.schedule(args),
            "gsy" => self.watch_rule(args, tag()),
            _ => Err(Refusal::UnknownCommand),
        }
    }

    /// Takes a token; where none is needed, any will do.
    fn admit(&mut self, args: Args<'_>, now: Duration) -> Outcome {
        let given = args.text(0)?;
        let admission = match &self.door {
            Some(door) => door.check(Some(given), now),
            None => Admission::Admitted(self.credential),
        };
        match admission {
            Admission::Admitted(credential) => {
                self.needs_token = false;
                self.credential = credential;
                return Ok(vec!["token ok".into()]);
            }
            Admission::Missing | Admission::Wrong => self.refused = true,
            Admission::TooMany => {
                (self.refused, self.slowed) = (true, true);
                return Err(Refusal::TooManyTokens);
            }
        }
        Err(Refusal::WrongToken)
    }

    fn greet(&mut self, args: Args<'_>) -> Outcome {
        self.greeted = args.text(0).is_ok_and(|v| v == VERSION);
        if self.greeted {
            Ok(vec!["handshake ok".into()])
        } else {
            Err(Refusal::BadHandshake)
        }
    }

    fn open_session(&mut self, args: Args<'_>, now: Duration) -> Outcome {
        let on_loss = match args.optional(1, Args::text)? {
            None => self.on_loss,
            Some(word) => OnLoss::of_word(word).ok_or(Refusal::OnLoss)?,
        };
        let description = args.description(0)?;
        if self.opened.len() >= SESSIONS_PER_CONNECTION {
            return Err(Refusal::TooManySessions);
        }
        let open = || self.controller.open_session_with(description, on_loss);
        let by = self.credential;
        let Some((sessions, begin)) = &self.all_sessions else {
            let session = open()?;
            self.opened.push(session);
            return Ok(vec![session.to_string().into()]);
        };
        let make_room = || {
            let now = *begin + now;
            sessions.end_left(&self.controller, now, Duration::ZERO, 1) > 0
        };
        if sessions.is_full_for(by) && !make_room() {
            return Err(Refusal::TooManyOpenSessions);
        }
        let session = match open() {
            Err(Error::TooMany { .. }) if make_room() => open(),
            opened => opened,
        }?;
        sessions.add(session, by);
        self.opened.push(session);
        Ok(vec![session.to_string().into()])
    }

    /// The nets are aborted before they are unloaded, so that their last values can be told.
    fn end_session(&mut self, args: Args<'_>, now: Duration, out: &mut Vec<Message>) -> Outcome {
        let session = self.session(args)?;
        for net in self.controller.session_nets(session).unwrap_or_default() {
            in_any_state(self.controller.abort(net)).or_else(unless_gone)?;
        }
        out.extend(self.due(Pushes::BeforeReply, now));
        self.controller.end_session(session).map_err(of_session)?;
        self.opened.retain(|s| *s != session);
        Ok(Vec::new())
    }

    fn watch_session(&mut self, args: Args<'_>, tag: String) -> Outcome {
        let session = self.session(args)?;
        self.adopt(session);
        self.check_room(self.sessions.contains_key(&session))?;
        self.sessions.insert(session, SessionWatch::new(tag));
        Ok(Vec::new())
    }

    /// A second subscription takes the place of the first and is told everything again.
    fn watch_devices(&mut self, tag: String) -> Outcome {
        self.check_room(self.devices.is_some())?;
        self.devices = Some(DeviceWatch::new(tag));
        Ok(Vec::new())
    }

    /// A net that is rejected has a name, too; only its text must follow the grammar.
    fn load(&mut self, args: Args<'_>) -> Outcome {
        let session = args
            .optional(1, Args::text)?
            .and_then(|s| self.known_session(s));
        session.into_iter().for_each(|session| self.adopt(session));
        let period = args.optional(3, Args::seconds)?.filter(|p| !p.is_zero());
        // Whether the net is real time is not asked for any more: all nets are.
        args.optional(4, Args::integer)?;
        let net = self.controller.load(LoadRequest {
            text: args.text(0)?.to_owned(),
            session: session.unwrap_or(SessionId::NONE),
            description: args
                .optional(2, Args::description)?
                .unwrap_or_default()
                .to_owned(),
            period,
        })?;
        match self.controller.net(net).as_ref().and_then(syntax_faults) {
            None => Ok(vec![net.to_string().into()]),
            Some(reason) => {
                self.controller.unload(net)?;
                Err(Refusal::NetSyntax { reason })
            }
        }
    }

    fn start(&self, args: Args<'_>) -> Outcome {
        let started = self.controller.start_net(self.net(args)?);
        started.map(|()| Vec::new()).map_err(|error| {
            let gone = matches!(error, Error::NoSuchNet(_));
            let reason = error.to_string();
            if gone {
                Refusal::InvalidNet
            } else {
                Refusal::StartFailed { reason }
            }
        })
    }

    fn cancel(&self, args: Args<'_>) -> Outcome {
        in_any_state(self.controller.cancel(self.net(args)?))
    }

    fn abort(&self, args: Args<'_>) -> Outcome {
        in_any_state(self.controller.abort(self.net(args)?))
    }

    /// Clients see that a net is being unloaded as `TERMINATED` once more, before the reply.
    fn unload(&mut self, args: Args<'_>, now: Duration, out: &mut Vec<Message>) -> Outcome {
        let net = self.net(args)?;
        out.extend(self.due(Pushes::BeforeReply, now));
        self.controller.unload(net).map_err(of_net)?;
        if self.controller.net(net).is_none() {
            out.extend(self.nets.get_mut(&net).map(NetWatch::handle_unloading));
        }
        Ok(Vec::new())
    }

    /// A second subscription to a net takes the place of the first and is told its state again.
    fn watch_net(&mut self, args: Args<'_>, tag: String) -> Outcome {
        let net = self.net(args)?;
        let refresh = args.seconds(1)?.min(REFRESH_MAX);
        self.check_room(self.nets.contains_key(&net))?;
        let states = self
            .controller
            .net(net)
            .ok_or(Refusal::InvalidNet)?
            .states
            .len();
        self.nets.insert(net, NetWatch::new(tag, refresh, states));
        Ok(Vec::new())
    }

    /// Nothing is written if one of the nets does not exist.
    fn write_values(&self, args: Args<'_>) -> Outcome {
        let mut writes = Vec::new();
        for (name, values) in args.map(0)? {
            let net = self.known_net(name).ok_or(Refusal::InvalidNetName)?;
            for (key, text) in values.as_map().ok_or(Refusal::ParameterType)? {
                writes.push((net, key, text.as_str().ok_or(Refusal::ParameterType)?));
            }
        }
        for (net, key, text) in writes {
            self.controller.write_in(net, key, text)?;
        }
        Ok(Vec::new())
    }

    /// Installs a rule. What it starts is told to be scheduled before the rule's number is.
    fn schedule(&self, args: Args<'_>) -> Outcome {
        let request = RuleRequest {
            condition: args.text(0)?.to_owned(),
            stop: self.nets(args, 1)?,
            cancel: self.nets(args, 2)?,
            start: self.nets(args, 3)?,
            description: args
                .optional(4, Args::description)?
                .unwrap_or_default()
                .to_owned(),
        };
        let rule = self.controller.schedule(request).map_err(|error| {
            let gone = matches!(error, Error::NoSuchNet(_));
            let reason = error.to_string();
            if gone {
                Refusal::InvalidRuleNet
            } else {
                Refusal::SchedulingNotPossible { reason }
            }
        })?;
        Ok(vec![rule.to_string().into()])
    }

    /// A second subscription to a rule takes the place of the first and is told its state again.
    fn watch_rule(&mut self, args: Args<'_>, tag: String) -> Outcome {
        let rule: RuleId = args.text(0)?.parse().map_err(|_| Refusal::InvalidRule)?;
        self.controller.rule(rule).ok_or(Refusal::InvalidRule)?;
        self.check_room(self.rules.contains_key(&rule))?;
        self.rules.insert(rule, RuleWatch::new(tag));
        Ok(Vec::new())
    }

    /// Not part of the original protocol, where HTTP resources tell this: all nets, or one.
    fn describe_nets(&self, args: Args<'_>) -> Outcome {
        let nets = match args.optional(0, Args::text)? {
            Some(name) => vec![self.known_net(name).ok_or(Refusal::InvalidNet)?],
            None => self.controller.nets(),
        };
        let infos = nets.into_iter().filter_map(|n| self.controller.net(n));
        Ok(vec![Value::map_of(
            infos.map(|i| (i.id.to_string(), describe(&i))),
        )])
    }

    /// Not part of the original protocol either: what the evaluation of all nets, or of one, costs.
    fn figures(&self, args: Args<'_>) -> Outcome {
        let nets = match args.optional(0, Args::text)? {
            Some(name) => vec![self.known_net(name).ok_or(Refusal::InvalidNet)?],
            None => self.controller.nets(),
        };
        let figures = |net: NetId| {
            let figures = self.controller.net_figures(net)?;
            Some((net.to_string(), figures::value(&figures)))
        };
        Ok(vec![Value::map_of(nets.into_iter().filter_map(figures))])
    }

    fn check_room(&self, replaces: bool) -> Result<(), Refusal> {
        if replaces || self.subscriptions() < SUBSCRIPTIONS_MAX {
            Ok(())
        } else {
            Err(Refusal::TooManySubscriptions)
        }
    }

    /// A client that connects again goes on with a session that its lost connection opened.
    fn adopt(&mut self, session: SessionId) {
        let all = self.all_sessions.as_ref();
        if all.is_some_and(|(sessions, _)| sessions.adopt(session)) {
            self.opened.push(session);
        }
    }

    fn session(&self, args: Args<'_>) -> Result<SessionId, Refusal> {
        let session = self
            .known_session(args.text(0)?)
            .filter(|s| *s != SessionId::NONE);
        session.ok_or(Refusal::InvalidSession)
    }

    fn known_session(&self, name: &str) -> Option<SessionId> {
        name.parse()
            .ok()
            .filter(|s| self.controller.session_nets(*s).is_some())
    }

    fn net(&self, args: Args<'_>) -> Result<NetId, Refusal> {
        self.known_net(args.text(0)?).ok_or(Refusal::InvalidNet)
    }

    /// The nets of a list; nothing is wrong with one that is empty.
    fn nets(&self, args: Args<'_>, number: usize) -> Result<Vec<NetId>, Refusal> {
        let name = |value: &Value| {
            let name = value.as_str().ok_or(Refusal::ParameterType)?;
            self.known_net(name).ok_or(Refusal::InvalidRuleNet)
        };
        args.list(number)?.iter().map(name).collect()
    }

    fn known_net(&self, name: &str) -> Option<NetId> {
        name.parse()
            .ok()
            .filter(|n| self.controller.net(*n).is_some())
    }
}

/// What cannot be done in the net's state is left undone without a word.
fn in_any_state(result: Result<(), Error>) -> Outcome {
    match result {
        Ok(()) | Err(Error::WrongState { .. }) => Ok(Vec::new()),
        Err(error) => Err(of_net(error)),
    }
}

fn of_net(error: Error) -> Refusal {
    if matches!(error, Error::NoSuchNet(_)) {
        Refusal::InvalidNet
    } else {
        error.into()
    }
}

fn of_session(error: Error) -> Refusal {
    if matches!(error, Error::NoSuchSession(_)) {
        Refusal::InvalidSession
    } else {
        error.into()
    }
}

/// A net that somebody else unloaded meanwhile is what is wanted.
fn unless_gone(refusal: Refusal) -> Outcome {
    if matches!(refusal, Refusal::InvalidNet) {
        Ok(Vec::new())
    } else {
        Err(refusal)
    }
}

fn syntax_faults(info: &NetInfo) -> Option<String> {
    let rejection = info.rejection.as_ref()?;
    let wrong = rejection
        .faults
        .iter()
        .any(|f| f.kind.minor() == SYNTAX_FAULT);
    wrong.then(|| faults(info).join("; "))
}

/// The faults of a net, one line each.
fn faults(info: &NetInfo) -> Vec<String> {
    let rejection = info.rejection.as_ref();
    let mut lines = rejection.map(|r| r.lines(&info.text)).unwrap_or_default();
    let more = lines.len().saturating_sub(FAULTS_MAX);
    lines.truncate(FAULTS_MAX);
    lines.extend((more > 0).then(|| format!("and {more} more")));
    lines
}

fn describe(info: &NetInfo) -> Value {
    let state = info.states.last().map_or("", |s| s.word());
    Value::map_of([
        ("description", info.description.as_str().into()),
        ("end", info.end.as_deref().unwrap_or_default().into()),
        ("rejection", Value::list_of(faults(info))),
        ("session", info.session.to_string().into()),
        ("state", state.into()),
    ])
}

/// The values of a command. More than it takes are ignored.
#[derive(Clone, Copy)]
struct Args<'a>(&'a [Value]);

impl<'a> Args<'a> {
    fn get(self, number: usize) -> Result<&'a Value, Refusal> {
        self.0.get(number).ok_or(Refusal::ParameterMissing)
    }

    fn optional<T>(
        self,
        number: usize,
        get: impl FnOnce(Self, usize) -> Result<T, Refusal>,
    ) -> Result<Option<T>, Refusal> {
        (number < self.0.len())
            .then(|| get(self, number))
            .transpose()
    }

    fn text(self, number: usize) -> Result<&'a str, Refusal> {
        self.get(number)?.as_str().ok_or(Refusal::ParameterType)
    }

    fn description(self, number: usize) -> Result<&'a str, Refusal> {
        let text = self.text(number)?;
        if text.len() <= DESCRIPTION_BYTES_MAX {
            Ok(text)
        } else {
            Err(Refusal::DescriptionTooLong { bytes: text.len() })
        }
    }

    fn map(self, number: usize) -> Result<&'a BTreeMap<String, Value>, Refusal> {
        self.get(number)?.as_map().ok_or(Refusal::ParameterType)
    }

    fn list(self, number: usize) -> Result<&'a [Value], Refusal> {
        self.get(number)?.as_list().ok_or(Refusal::ParameterType)
    }

    fn integer(self, number: usize) -> Result<u32, Refusal> {
        if let Value::Integer(n) = self.get(number)? {
            Ok(*n)
        } else {
            Err(Refusal::ParameterType)
        }
    }

    /// A float is wanted, and an integer is none.
    fn seconds(self, number: usize) -> Result<Duration, Refusal> {
        let Value::Float(seconds) = self.get(number)? else {
            return Err(Refusal::ParameterType);
        };
        Ok(Duration::try_from_secs_f64(*seconds).unwrap_or(Duration::MAX))
    }
}
