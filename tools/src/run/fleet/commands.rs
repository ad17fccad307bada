//! Sessions of the fleet at the controller: each is a connection of its own to the controller's lines, so that what a session holds ends
//! as that of any lost client. It admits nothing.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use takt_client::client::VERSION;
use takt_client::{Client, Message, Token, Value};
use takt_core::OnLoss;
use takt_fleet::command::{LossPolicy, Lost};

/// Pushes that are added to a reply, or fetched at once; further ones are added to the next.
const PUSHES_MAX: usize = 256;

/// All sessions.
#[derive(Debug)]
pub(super) struct Commands {
    /// Where the controller takes lines.
    address: Option<String>,
    token: Option<Token>,
    sessions: Mutex<BTreeMap<u32, Arc<Session>>>,
}

/// A session of the fleet.
#[derive(Debug)]
struct Session {
    client: String,
    on_loss: LossPolicy,
    /// Its client fetches pushes: replies have none.
    listens: AtomicBool,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    /// Made by the first command.
    connection: Option<Client>,
    has_ended: bool,
    /// Sessions of the controller that it opened.
    opened: Vec<Value>,
}

impl Session {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// No command begins any more; those that wait for their reply end.
    fn end(&self) -> (Option<Client>, Vec<Value>) {
        let mut state = self.state();
        state.has_ended = true;
        (state.connection.take(), std::mem::take(&mut state.opened))
    }
}

impl Commands {
    pub(super) const fn new(address: Option<String>, token: Option<Token>) -> Self {
        Self {
            address,
            token,
            sessions: Mutex::new(BTreeMap::new()),
        }
    }

    fn sessions(&self) -> MutexGuard<'_, BTreeMap<u32, Arc<Session>>> {
        self.sessions.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn open(&self, number: u32, client: &str, on_loss: LossPolicy) {
        tracing::info!("session {number} of the fleet is opened by `{client}`");
        let session = Session {
            client: client.to_owned(),
            on_loss,
            listens: AtomicBool::new(false),
            state: Mutex::default(),
        };
        self.sessions().insert(number, Arc::new(session));
    }

    /// The connection ends, and with it what the controller ends of a client that has gone.
    pub(super) fn close(&self, number: u32) {
        let session = self.sessions().remove(&number);
        if let Some((Some(connection), _)) = session.map(|session| session.end()) {
            connection.close();
        }
    }

    pub(super) fn lose(&self, lost: Lost) {
        match lost.on_loss {
            // By how its sessions were opened.
            LossPolicy::Continue | LossPolicy::Cancel => self.close(lost.session),
            LossPolicy::Stop => {
                let session = self.sessions().remove(&lost.session);
                if let Some((Some(connection), opened)) = session.map(|session| session.end()) {
                    abort(connection, opened);
                }
            }
        }
    }

    /// Executes a line. Replies come first, then what the session was notified of meanwhile.
    pub(super) fn execute(&self, number: u32, line: &str) -> Vec<String> {
        let session = self.sessions().get(&number).cloned();
        let Some(session) = session else {
            return vec![err("none", "the session has ended")];
        };
        let message = match Message::decode(line) {
            Ok(message) => message,
            Err(why) => {
                let hint = "hint: a line is tag=command(value,value), such as a=nin(\"rpinet0\")";
                return vec![err("none", &format!("{why}\n{hint}"))];
            }
        };
        match self.connection(&session) {
            // It was the first command of the connection already.
            Ok(_) if message.command == "ver" => handshake(&message),
            Ok(connection) => exchange(&session, &connection, message),
            Err(why) => vec![err(&message.tag, &why)],
        }
    }

    /// What a session was notified of; waits for the first push.
    pub(super) fn notifications(&self, number: u32, wait: Duration) -> Result<Vec<String>, String> {
        let session = self.sessions().get(&number).cloned();
        let connection = session.and_then(|session| {
            session.listens.store(true, Ordering::Release);
            session.state().connection.clone()
        });
        let Some(connection) = connection else {
            // Nothing was subscribed to before the first command.
            std::thread::sleep(wait);
            return Ok(Vec::new());
        };
        let first = connection.next_push(wait);
        let Some(first) = first.map_err(|why| why.to_string())? else {
            return Ok(Vec::new());
        };
        Ok([first.to_string()]
            .into_iter()
            .chain(pushes(&connection))
            .collect())
    }

    /// The connection of a session.
    fn connection(&self, session: &Session) -> Result<Client, String> {
        let ended = || "the session has ended".to_owned();
        {
            let state = session.state();
            if state.has_ended {
                return Err(ended());
            }
            if let Some(connection) = &state.connection {
                return Ok(connection.clone());
            }
        }
        let address = self.address.as_ref().ok_or(
            "the controller takes commands neither over TCP nor over a Unix socket\nhint: set tcp or socket under [controller]",
        )?;
        let connection = Client::connect_with(address, self.token.as_ref());
        let connection = connection.map_err(|why| why.to_string())?;
        let mut state = session.state();
        if state.has_ended {
            return Err(ended());
        }
        state.connection = Some(connection.clone());
        Ok(connection)
    }
}

/// The reply to a handshake.
fn handshake(message: &Message) -> Vec<String> {
    let version = message.args.first().and_then(Value::as_str);
    if version != Some(VERSION) {
        return vec![err(&message.tag, "bad handshake")];
    }
    let ok = Message::new(message.tag.as_str(), "ok").with("handshake ok");
    vec![ok.to_string()]
}

fn exchange(session: &Session, connection: &Client, message: Message) -> Vec<String> {
    let Message { tag, command, args } = message;
    let args = if command == "nse" {
        session_args(session, args)
    } else {
        args
    };
    let reply = match connection.call_as(tag.clone(), &command, args) {
        Ok(reply) => {
            if command == "nse" {
                session.state().opened.extend(reply.values.first().cloned());
            }
            let mut ok = Message::new(tag, "ok");
            ok.args = reply.values;
            ok.to_string()
        }
        Err(takt_client::Error::Refused { text, .. }) => err(&tag, &text),
        Err(why) => err(&tag, &why.to_string()),
    };
    let mut lines = vec![reply];
    if !session.listens.load(Ordering::Acquire) {
        lines.extend(pushes(connection));
    }
    lines
}

/// The pushes that wait.
fn pushes(connection: &Client) -> impl Iterator<Item = String> + use<'_> {
    let next = || connection.next_push(Duration::ZERO).ok().flatten();
    let waiting = std::iter::from_fn(next).take(PUSHES_MAX);
    waiting.map(|push| push.to_string())
}

/// Arguments of `nse`: what happens to its nets when the connection ends is decided by the session of the fleet.
fn session_args(session: &Session, mut args: Vec<Value>) -> Vec<Value> {
    let on_loss = match session.on_loss {
        LossPolicy::Continue => OnLoss::Keep,
        LossPolicy::Cancel | LossPolicy::Stop => OnLoss::End,
    };
    if args.is_empty() {
        args.push(Value::from(session.client.as_str()));
    }
    args.truncate(1);
    args.push(Value::from(on_loss.word()));
    args
}

/// Ends the sessions of the controller at once, in a thread: each is an exchange with it.
fn abort(connection: Client, opened: Vec<Value>) {
    let thread = std::thread::Builder::new().name("fleet-abort".to_owned());
    let kept = connection.clone();
    let started = thread.spawn(move || {
        for session in opened {
            if let Err(why) = connection.call("ase", [session]) {
                tracing::warn!("cannot end a session of a lost client of the fleet: {why}");
            }
        }
        connection.close();
    });
    if let Err(why) = started {
        tracing::error!(
            "no thread to abort the nets of a lost client of the fleet, they are cancelled: {why}"
        );
        kept.close();
    }
}

fn err(tag: &str, text: &str) -> String {
    Message::new(tag, "err").with(text).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn session_policy_decides_about_its_nets() {
        let session = |on_loss| Session {
            client: "panel".to_owned(),
            on_loss,
            listens: AtomicBool::new(false),
            state: Mutex::default(),
        };
        let args = |on_loss, args: &[&str]| {
            let args = args.iter().map(|text| Value::from(*text)).collect();
            let args = session_args(&session(on_loss), args);
            args.iter()
                .map(|it| it.as_str().unwrap().to_owned())
                .collect::<Vec<_>>()
        };
        assert_eq!(args(LossPolicy::Continue, &[]), ["panel", "keep"]);
        assert_eq!(args(LossPolicy::Cancel, &["weld", "keep"]), ["weld", "end"]);
        assert_eq!(args(LossPolicy::Stop, &["weld"]), ["weld", "end"]);
    }

    #[test]
    fn handshake_is_that_of_the_version() {
        let said = |line: &str| handshake(&Message::decode(line).unwrap()).concat();
        assert_eq!(said("a=ver(\"2.0\")"), "a=ok(\"handshake ok\")");
        for wrong in ["a=ver(\"1.0\")", "a=ver()", "a=ver(2.0)"] {
            assert_eq!(said(wrong), "a=err(\"bad handshake\")", "{wrong}");
        }
    }

    #[test]
    fn command_without_session_address_or_form_is_answered() {
        let commands = Commands::new(None, None);
        let said = |line: &str| commands.execute(1, line).join("\n");
        assert!(said("a=nin()").contains("the session has ended"));
        commands.open(1, "panel", LossPolicy::Cancel);
        assert!(said("a=nin()").starts_with("a=err("), "{}", said("a=nin()"));
        assert!(said("a=nin()").contains("set tcp or socket"));
        assert!(said("nonsense").contains("hint: a line is tag=command"));
        commands.close(1);
        assert!(said("a=nin()").contains("the session has ended"));
    }
}
