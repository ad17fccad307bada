//! The commands of the protocol: checks the values, calls the controller, encodes its answer. The effects of a
//! command are reported by the subscriptions, not here.

use std::time::Duration;

use takt_client::client::VERSION;
use takt_client::wire::{Message, Value};
use takt_core::controller::{
    LoadRequest, NetInfo, RejectedInfo, RuleId, RuleRequest, RuleState, TapRecord, Taps,
};
use takt_core::{Error, NetId, OnLoss, SessionId};

use super::Connection;
use super::args::Args;
use super::details;
use super::devices::DeviceWatch;
use super::error::CommandError;
use super::figures;
use super::limits::{SESSIONS_PER_CONNECTION, SUBSCRIPTIONS_MAX};
use super::nets::NetWatch;
use super::pace::Pushes;
use super::rules::RuleWatch;
use super::sessions::SessionWatch;
use crate::access::Admission;

/// Fault number of a syntax error in the text of a net.
const SYNTAX_FAULT: u32 = 12;

/// Most faults of one net that are reported.
const FAULTS_MAX: usize = 20;

/// Upper bound of the refresh interval, so that times do not overflow.
const REFRESH_MAX: Duration = Duration::from_secs(3600);

/// Most records of debug taps in one reply.
const TAP_RECORDS_MAX: usize = 256;

/// Most values in these records, less than a message may have.
const TAP_VALUES_MAX: usize = 60_000;

pub(super) type Outcome = Result<Vec<Value>, CommandError>;

impl Connection {
    /// Executes a command; the result is the values of the `ok` reply. Pushes whose data would be lost by
    /// the command itself are appended to `out`.
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
            _ if self.needs_token => Err(CommandError::TokenMissing),
            "ver" if !self.handshake_done => self.handshake(args),
            _ if !self.handshake_done => Err(CommandError::BadHandshake),
            "nse" => self.open_session(args, now),
            "ase" => self.end_session(args, now, out),
            "gse" => self.watch_session(args, tag()),
            "gde" => self.watch_devices(tag()),
            "nene" => self.load(args, tag()),
            "nest" => self.start(args),
            "neca" => self.cancel(args),
            "neab" => self.abort(args),
            "neun" => self.unload(args, now, out),
            "gne" => self.watch_net(args, tag()),
            "snc" => self.write_values(args),
            "nin" => self.describe_nets(args),
            "nva" => self.describe_values(args),
            "nta" => self.taps(args),
            "nst" => self.figures(args),
            "din" => self.describe_devices(args),
            "fin" => Ok(vec![details::frames(&self.controller.frames())]),
            "eva" => self.evaluate(args),
            "nesc" => self.schedule(args, tag()),
            "gsy" => self.watch_rule(args, tag()),
            "mane" => self.load_machine(args),
            "maco" => self.command_machine(args),
            "main" => self.describe_machines(args),
            "magr" => self.draw_machine(args),
            "maen" => self.end_machine(args),
            _ => Err(CommandError::UnknownCommand),
        }
    }

    /// Checks a token; where none is required, any is accepted.
    fn admit(&mut self, args: Args<'_>, now: Duration) -> Outcome {
        let given = args.text(0)?;
        let admission = match &self.token_check {
            Some(token_check) => token_check.check(Some(given), now),
            None => Admission::Admitted(self.credential),
        };
        match admission {
            Admission::Admitted(credential) => {
                self.needs_token = false;
                self.credential = credential;
                return Ok(vec!["token ok".into()]);
            }
            Admission::Missing | Admission::Wrong => self.rejected = true,
            Admission::TooMany => {
                (self.rejected, self.delayed) = (true, true);
                return Err(CommandError::TooManyTokens);
            }
        }
        Err(CommandError::WrongToken)
    }

    fn handshake(&mut self, args: Args<'_>) -> Outcome {
        self.handshake_done = args.text(0).is_ok_and(|v| v == VERSION);
        if self.handshake_done {
            Ok(vec!["handshake ok".into()])
        } else {
            Err(CommandError::BadHandshake)
        }
    }

    fn open_session(&mut self, args: Args<'_>, now: Duration) -> Outcome {
        let on_loss = match args.optional(1, Args::text)? {
            None => self.on_loss,
            Some(word) => OnLoss::of_word(word).ok_or(CommandError::OnLoss)?,
        };
        let description = args.description(0)?;
        if self.opened.len() >= SESSIONS_PER_CONNECTION {
            return Err(CommandError::TooManySessions);
        }
        let open = || self.controller.open_session_with(description, on_loss);
        let by = self.credential;
        let Some((sessions, begin)) = &self.all_sessions else {
            let session = open()?;
            self.opened.push(session);
            return Ok(vec![session.to_string().into()]);
        };
        let free_session = || {
            let now = *begin + now;
            sessions.end_orphaned(&self.controller, now, Duration::ZERO, 1) > 0
        };
        if sessions.is_full_for(by) && !free_session() {
            return Err(CommandError::TooManyOpenSessions);
        }
        let session = match open() {
            Err(Error::TooMany { .. }) if free_session() => open(),
            opened => opened,
        }?;
        sessions.add(session, by);
        self.opened.push(session);
        Ok(vec![session.to_string().into()])
    }

    /// The nets are aborted before they are unloaded, so that their last values can be pushed.
    fn end_session(&mut self, args: Args<'_>, now: Duration, out: &mut Vec<Message>) -> Outcome {
        let session = self.session(args)?;
        self.controller.end_session_machines(session)?;
        for net in self.controller.session_nets(session).unwrap_or_default() {
            ignore_wrong_state(self.controller.abort(net)).or_else(ignore_unloaded_net)?;
        }
        out.extend(self.due(Pushes::BeforeReply, now));
        self.controller
            .end_session(session)
            .map_err(session_error)?;
        self.opened.retain(|s| *s != session);
        Ok(Vec::new())
    }

    fn watch_session(&mut self, args: Args<'_>, tag: String) -> Outcome {
        let session = self.session(args)?;
        self.adopt(session);
        self.check_quota(self.sessions.contains_key(&session))?;
        let pace = args.pace(1)?;
        self.sessions.insert(session, SessionWatch::new(tag, pace));
        Ok(Vec::new())
    }

    /// A second subscription replaces the first and receives everything again.
    fn watch_devices(&mut self, tag: String) -> Outcome {
        self.check_quota(self.devices.is_some())?;
        self.devices = Some(DeviceWatch::new(tag));
        Ok(Vec::new())
    }

    /// A rejected net also gets a name, unless its text has a syntax error. With a refresh interval, it subscribes to the
    /// net, and the reply names its state too.
    fn load(&mut self, args: Args<'_>, tag: String) -> Outcome {
        let refresh = args.optional(5, Args::seconds)?;
        let pace = args.pace(6)?;
        if refresh.is_some() {
            self.check_quota(false)?;
        }
        let session = args
            .optional(1, Args::text)?
            .and_then(|s| self.known_session(s));
        session.into_iter().for_each(|session| self.adopt(session));
        let period = args.optional(3, Args::seconds)?.filter(|p| !p.is_zero());
        // The fifth value, `realtime`, has no meaning any more: all nets are real-time.
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
        let info = self.controller.net(net);
        if let Some(reason) = info.as_ref().and_then(syntax_faults) {
            self.controller.unload(net)?;
            return Err(CommandError::NetSyntax { reason });
        }
        let mut reply = vec![net.to_string().into()];
        if let (Some(refresh), Some(info)) = (refresh, info) {
            let refresh = refresh.min(REFRESH_MAX);
            let watch = NetWatch::new(tag, refresh, pace, info.states.len());
            self.nets.insert(net, watch);
            reply.push(info.state().word().into());
        }
        Ok(reply)
    }

    fn start(&self, args: Args<'_>) -> Outcome {
        let started = self.controller.start_net(self.net(args)?);
        started.map(|()| Vec::new()).map_err(|source| {
            if matches!(source, Error::NoSuchNet(_)) {
                CommandError::InvalidNet
            } else {
                CommandError::StartFailed { source }
            }
        })
    }

    fn cancel(&self, args: Args<'_>) -> Outcome {
        ignore_wrong_state(self.controller.cancel(self.net(args)?))
    }

    fn abort(&self, args: Args<'_>) -> Outcome {
        ignore_wrong_state(self.controller.abort(self.net(args)?))
    }

    /// Unloading pushes `TERMINATED` once more, before the reply.
    fn unload(&mut self, args: Args<'_>, now: Duration, out: &mut Vec<Message>) -> Outcome {
        let net = self.net(args)?;
        out.extend(self.due(Pushes::BeforeReply, now));
        self.controller.unload(net).map_err(net_error)?;
        if self.controller.net(net).is_none() {
            let result = self.controller.retained(net);
            let values = result.map(|net| net.values).unwrap_or_default();
            let watch = self.nets.get_mut(&net);
            out.extend(
                watch
                    .into_iter()
                    .flat_map(|w| w.handle_unloading(values.clone(), now)),
            );
        }
        Ok(Vec::new())
    }

    /// A second subscription to a net replaces the first and receives its state again.
    fn watch_net(&mut self, args: Args<'_>, tag: String) -> Outcome {
        let net = self.net(args)?;
        let refresh = args.seconds(1)?.min(REFRESH_MAX);
        let pace = args.pace(2)?;
        self.check_quota(self.nets.contains_key(&net))?;
        let states = self
            .controller
            .net(net)
            .ok_or(CommandError::InvalidNet)?
            .states
            .len();
        self.nets
            .insert(net, NetWatch::new(tag, refresh, pace, states));
        Ok(Vec::new())
    }

    /// Nothing is written if one of the nets does not exist.
    fn write_values(&self, args: Args<'_>) -> Outcome {
        let mut writes = Vec::new();
        for (name, values) in args.map(0)? {
            let net = self.known_net(name).ok_or(CommandError::InvalidNetName)?;
            for (key, text) in values.as_map().ok_or(CommandError::ParameterType)? {
                writes.push((net, key, text.as_str().ok_or(CommandError::ParameterType)?));
            }
        }
        for (net, key, text) in writes {
            self.controller.write_in(net, key, text)?;
        }
        Ok(Vec::new())
    }

    /// Installs a rule. The state `SCHEDULED` of its nets is pushed before the reply with the rule's number. With a sixth
    /// value that is not 0, it subscribes to the rule.
    fn schedule(&mut self, args: Args<'_>, tag: String) -> Outcome {
        let subscribes = args
            .optional(5, Args::integer)?
            .is_some_and(|flag| flag != 0);
        if subscribes {
            self.check_quota(false)?;
        }
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
        let rule = self.controller.schedule(request).map_err(|source| {
            if matches!(source, Error::NoSuchNet(_)) {
                CommandError::InvalidRuleNet
            } else {
                CommandError::SchedulingNotPossible { source }
            }
        })?;
        if subscribes {
            self.rules.insert(rule, RuleWatch::new(tag));
        }
        Ok(vec![rule.to_string().into()])
    }

    /// A second subscription to a rule replaces the first and receives its state again.
    fn watch_rule(&mut self, args: Args<'_>, tag: String) -> Outcome {
        let rule: RuleId = args
            .text(0)?
            .parse()
            .map_err(|_| CommandError::InvalidRule)?;
        self.controller
            .rule_state(rule)
            .ok_or(CommandError::InvalidRule)?;
        self.check_quota(self.rules.contains_key(&rule))?;
        self.rules.insert(rule, RuleWatch::new(tag));
        Ok(Vec::new())
    }

    /// Describes all nets, or one. Not part of the original protocol, where only HTTP resources have this.
    fn describe_nets(&self, args: Args<'_>) -> Outcome {
        let nets = match args.optional(0, Args::text)? {
            Some(name) => vec![self.known_net(name).ok_or(CommandError::InvalidNet)?],
            None => self.controller.nets(),
        };
        let is_one = args.optional(0, Args::text)?.is_some();
        let infos = nets.into_iter().filter_map(|n| self.controller.net(n));
        Ok(vec![Value::map_of(infos.map(|info| {
            let mut description = self.describe(&info);
            // Of all nets this would compare each with each.
            if let Value::Map(members) = &mut description
                && is_one
            {
                members.extend(self.obstacles(info.id));
            }
            (info.id.to_string(), description)
        }))])
    }

    /// A net, with the nets that a rule started when it stopped this one.
    fn describe(&self, info: &NetInfo) -> Value {
        let rules = self.controller.rules_of(info.id).into_iter();
        let stopped = rules
            .filter(|rule| rule.state == RuleState::Fired && rule.request.stop.contains(&info.id));
        let successors = stopped.flat_map(|rule| rule.request.start);
        let successors = Value::list_of(successors.map(|net| net.to_string()));
        let rejected = self.controller.rejected(Some(info.id));
        let last = self.controller.last_values_of_net(info.id);
        let last = last.map_or_else(String::new, |last| last.table());
        let mut description = describe(info, rejected, &last);
        if let Value::Map(members) = &mut description {
            members.insert("successors".to_owned(), successors);
        }
        description
    }

    /// Why a net does not start: the cause of the latest rule that failed to start it, and the nets of other sessions that
    /// hold what it needs.
    fn obstacles(&self, net: NetId) -> [(String, Value); 2] {
        let rules = self.controller.rules_of(net).into_iter().rev();
        let mut causes = rules.filter(|rule| rule.request.start.contains(&net));
        let cause = causes.find_map(|rule| rule.why).unwrap_or_default();
        let holders = self.controller.holders(net).into_iter().map(|holder| {
            Value::map_of([
                ("resource", Value::from(holder.resource.as_str())),
                ("net", holder.net.to_string().into()),
                ("session", holder.session.to_string().into()),
                ("description", holder.description.as_str().into()),
            ])
        });
        [
            ("failure".to_owned(), Value::from(cause.as_str())),
            ("holders".to_owned(), Value::list_of(holders)),
        ]
    }

    /// The in values and the out values of a net. Not part of the original protocol, as the following one.
    fn describe_values(&self, args: Args<'_>) -> Outcome {
        let net = self.net(args)?;
        let values = [
            self.controller.in_values(net),
            self.controller.out_values(net),
        ];
        Ok(values.map(Value::map_of).into())
    }

    /// Records of a net's debug taps from a number on: the number to ask for next, names and types of the taps, and by
    /// record its number, its time in ns and the texts; null is an empty list. The first request begins the recording.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a number below 0 is the first, and one beyond 2^53 does not occur"
    )]
    fn taps(&self, args: Args<'_>) -> Outcome {
        let net = self.net(args)?;
        let from = args.optional(1, Args::float)?.unwrap_or_default();
        let taps = self.controller.taps(net, from as u64)?;
        let Taps { taps, mut records } = taps.ok_or(CommandError::NotReady)?;
        records.truncate(TAP_RECORDS_MAX.min(TAP_VALUES_MAX / (taps.len() + 3)));
        let next = records.last().map_or(from, |last| number(last.number + 1));
        let record = |record: &TapRecord| {
            let texts = taps.iter().map(|tap| match record.text(tap) {
                Some(text) => Value::from(text),
                None => Value::List(Vec::new()),
            });
            let head = [
                Value::Float(number(record.number)),
                record.time().0.to_string().into(),
            ];
            Value::list_of(head.into_iter().chain(texts))
        };
        Ok(vec![
            Value::Float(next),
            Value::list_of(taps.iter().map(|tap| tap.name.clone())),
            Value::list_of(taps.iter().map(|tap| tap.ty.to_string())),
            Value::list_of(records.iter().map(record)),
        ])
    }

    /// Evaluation cost of all nets, or of one. Not part of the original protocol either.
    fn figures(&self, args: Args<'_>) -> Outcome {
        let nets = match args.optional(0, Args::text)? {
            Some(name) => vec![self.known_net(name).ok_or(CommandError::InvalidNet)?],
            None => self.controller.nets(),
        };
        let figures = |net: NetId| {
            let figures = self.controller.net_figures(net)?;
            Some((net.to_string(), figures::value(&figures)))
        };
        Ok(vec![Value::map_of(nets.into_iter().filter_map(figures))])
    }

    /// Describes all devices, or one, with limits and periods. Not part of the original protocol.
    fn describe_devices(&self, args: Args<'_>) -> Outcome {
        let name = args.optional(0, Args::text)?;
        let mut devices = self.controller.device_details();
        devices.retain(|device| name.is_none_or(|name| device.info.name == name));
        if name.is_some() && devices.is_empty() {
            return Err(CommandError::InvalidDevice);
        }
        Ok(vec![Value::map_of(devices.into_iter().map(details::value))])
    }

    /// Evaluates one cycle of a net with the present device state; the values are texts by their keys. Not part of the
    /// original protocol, where only `/eval/` has this.
    fn evaluate(&self, args: Args<'_>) -> Outcome {
        let text = args.text(0)?;
        let values = self.controller.evaluate(text).map_err(|rejection| {
            let reason = rejection.lines(text).join("; ");
            CommandError::NetRejected { reason }
        })?;
        Ok(vec![Value::map_of(values)])
    }

    fn check_quota(&self, replaces: bool) -> Result<(), CommandError> {
        if replaces || self.subscriptions() < SUBSCRIPTIONS_MAX {
            Ok(())
        } else {
            Err(CommandError::TooManySubscriptions)
        }
    }

    /// A client that reconnects takes over a session of its lost connection.
    fn adopt(&mut self, session: SessionId) {
        let all = self.all_sessions.as_ref();
        if all.is_some_and(|(sessions, _)| sessions.adopt(session)) {
            self.opened.push(session);
        }
    }

    fn session(&self, args: Args<'_>) -> Result<SessionId, CommandError> {
        let session = self
            .known_session(args.text(0)?)
            .filter(|s| *s != SessionId::NONE);
        session.ok_or(CommandError::InvalidSession)
    }

    pub(super) fn known_session(&self, name: &str) -> Option<SessionId> {
        name.parse()
            .ok()
            .filter(|s| self.controller.session_nets(*s).is_some())
    }

    fn net(&self, args: Args<'_>) -> Result<NetId, CommandError> {
        self.known_net(args.text(0)?)
            .ok_or(CommandError::InvalidNet)
    }

    /// The nets of a list, which may be empty.
    fn nets(&self, args: Args<'_>, number: usize) -> Result<Vec<NetId>, CommandError> {
        let name = |value: &Value| {
            let name = value.as_str().ok_or(CommandError::ParameterType)?;
            self.known_net(name).ok_or(CommandError::InvalidRuleNet)
        };
        args.list(number)?.iter().map(name).collect()
    }

    fn known_net(&self, name: &str) -> Option<NetId> {
        name.parse()
            .ok()
            .filter(|n| self.controller.net(*n).is_some())
    }
}

/// A count; integers of the protocol have 31 bits.
fn number(count: u64) -> f64 {
    count as f64
}

/// Commands that the net's state does not permit have no effect and succeed.
fn ignore_wrong_state(result: Result<(), Error>) -> Outcome {
    match result {
        Ok(()) | Err(Error::WrongState { .. }) => Ok(Vec::new()),
        Err(error) => Err(net_error(error)),
    }
}

fn net_error(error: Error) -> CommandError {
    if matches!(error, Error::NoSuchNet(_)) {
        CommandError::InvalidNet
    } else {
        error.into()
    }
}

fn session_error(error: Error) -> CommandError {
    if matches!(error, Error::NoSuchSession(_)) {
        CommandError::InvalidSession
    } else {
        error.into()
    }
}

/// A net that another client unloaded meanwhile is no error.
fn ignore_unloaded_net(error: CommandError) -> Outcome {
    if matches!(error, CommandError::InvalidNet) {
        Ok(Vec::new())
    } else {
        Err(error)
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

fn describe(info: &NetInfo, rejected: Vec<RejectedInfo>, last: &str) -> Value {
    let state = info.states.last().map_or("", |s| s.word());
    Value::map_of([
        ("description", info.description.as_str().into()),
        ("end", info.end.as_deref().unwrap_or_default().into()),
        ("last", last.into()),
        (
            "rejected",
            Value::list_of(rejected.into_iter().map(|it| it.text)),
        ),
        ("rejection", Value::list_of(faults(info))),
        ("session", info.session.to_string().into()),
        ("state", state.into()),
    ])
}
