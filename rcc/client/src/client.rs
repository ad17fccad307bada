//! Blocking client over a Unix socket or plain TCP, shared by any number of threads. A thread of its own reads the
//! connection: a call waits for its reply alone, so that a thread which loads a net delays no other thread. Pushes are
//! not interpreted; they are queued until [`Client::next_push`].
//!
//! It does not reconnect by itself: the nets of a session that was opened to end with its connection have then been
//! cancelled, and only the program knows whether to start again.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::io::{self, ErrorKind, Read, Write};
use std::net::{Shutdown, TcpStream, ToSocketAddrs};
use std::os::unix::net::UnixStream;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crate::error::{Conflict, Error};
use crate::token::Token;
use crate::wire::lines::LineReader;
use crate::wire::{Message, Value};

/// Timeout of a connection attempt.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);

/// Timeout of a reply. Loading a large net takes seconds.
const REPLY_TIMEOUT: Duration = Duration::from_secs(30);

/// How long after a failed transmission the reading thread may take to find why the connection ended.
const END_TIMEOUT: Duration = Duration::from_millis(100);

/// Most pushes that wait to be received; with more, the connection is closed, since a lost push is a lost state.
const PUSHES_MAX: usize = 1 << 16;

/// The reply to a command that succeeded.
#[derive(Clone, Debug, PartialEq)]
pub struct Reply {
    /// The tag that pushes carry if the command was a subscription.
    pub tag: String,
    /// The values of the reply.
    pub values: Vec<Value>,
}

impl Reply {
    /// The first value, if it is a text: the identifier returned by `nse` and `nene`.
    pub fn text(&self) -> Option<&str> {
        self.values.first().and_then(Value::as_str)
    }
}

/// The version of the line protocol, in the handshake.
pub const VERSION: &str = "2.0";

/// Default address for plain lines on this host.
pub const TCP_ADDRESS: &str = "127.0.0.1:8081";

/// The byte stream of either kind of connection.
#[derive(Debug)]
enum Stream {
    Tcp(TcpStream),
    Unix(UnixStream),
}

impl Stream {
    fn try_clone(&self) -> io::Result<Self> {
        Ok(match self {
            Self::Tcp(stream) => Self::Tcp(stream.try_clone()?),
            Self::Unix(stream) => Self::Unix(stream.try_clone()?),
        })
    }

    fn shut_down(&self) {
        // Fails only if the peer closed first.
        let _ = match self {
            Self::Tcp(stream) => stream.shutdown(Shutdown::Both),
            Self::Unix(stream) => stream.shutdown(Shutdown::Both),
        };
    }
}

impl Read for Stream {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Tcp(stream) => stream.read(bytes),
            Self::Unix(stream) => stream.read(bytes),
        }
    }
}

impl Write for Stream {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::Tcp(stream) => stream.write(bytes),
            Self::Unix(stream) => stream.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match self {
            Self::Tcp(stream) => stream.flush(),
            Self::Unix(stream) => stream.flush(),
        }
    }
}

/// A connection to a controller. Clones share it; it is closed with the last of them.
#[derive(Clone, Debug)]
pub struct Client {
    connection: Arc<Connection>,
}

/// Closes the connection with its last user, which ends the reading thread.
#[derive(Debug)]
struct Connection {
    shared: Arc<Shared>,
    control: Stream,
}

impl Drop for Connection {
    fn drop(&mut self) {
        self.control.shut_down();
    }
}

#[derive(Debug)]
struct Shared {
    address: String,
    writer: Mutex<Stream>,
    inbox: Mutex<Inbox>,
    /// Notified after each change of the inbox.
    changed: Condvar,
}

/// What was received and is not consumed yet.
#[derive(Debug, Default)]
struct Inbox {
    commands: u32,
    /// Replies by tag of the command; `None` while it is awaited.
    replies: BTreeMap<String, Option<Message>>,
    /// Tags of commands whose reply is not awaited any more and may still come: no other command has them.
    overdue: BTreeSet<String>,
    pushes: VecDeque<Message>,
    /// The last error message that replies to no command.
    last_error: Option<String>,
    end: Option<End>,
}

/// Why nothing more is received.
#[derive(Clone, Debug)]
enum End {
    Closed,
    Unread,
    Broken(ErrorKind, String),
}

impl Client {
    /// Connects to the controller of this host: at the Unix socket of the account's session or of the service, else at
    /// [`TCP_ADDRESS`].
    ///
    /// # Errors
    /// If no controller listens there, or the account is not admitted.
    pub fn connect_here(token: Option<&Token>) -> Result<Self, Error> {
        for path in crate::local::client_paths() {
            if let Ok(stream) = UnixStream::connect(&path) {
                let address = path.display().to_string();
                return Self::begin(Stream::Unix(stream), address, token);
            }
        }
        Self::connect_with(TCP_ADDRESS, token)
    }

    /// Connects to `host:port`, or to the Unix socket with an absolute path, and does the handshake.
    pub fn connect(address: &str) -> Result<Self, Error> {
        Self::connect_with(address, None)
    }

    /// The same, but sends the token first.
    pub fn connect_with(address: &str, token: Option<&Token>) -> Result<Self, Error> {
        let stream = open(address).map_err(|e| cannot_connect(address, e))?;
        Self::begin(stream, address.to_owned(), token)
    }

    /// Talks to a controller over a stream that the program opened, and does the handshake. `address` is the peer's name for people.
    ///
    /// # Errors
    /// If the peer does not answer, or rejects the handshake.
    pub fn over(stream: UnixStream, address: String) -> Result<Self, Error> {
        Self::begin(Stream::Unix(stream), address, None)
    }

    fn begin(stream: Stream, address: String, token: Option<&Token>) -> Result<Self, Error> {
        let cloned = || stream.try_clone().map_err(|e| cannot_connect(&address, e));
        let (reader, control) = (cloned()?, cloned()?);
        let shared = Arc::new(Shared {
            address,
            writer: Mutex::new(stream),
            inbox: Mutex::default(),
            changed: Condvar::new(),
        });
        let receiver = Arc::clone(&shared);
        std::thread::Builder::new()
            .name("takt-client".to_owned())
            .spawn(move || receiver.receive(reader))
            .map_err(|e| cannot_connect(&shared.address, e))?;
        let client = Self {
            connection: Arc::new(Connection { shared, control }),
        };
        if let Some(token) = token {
            client.call("tok", [token.text()])?;
        }
        client.call("ver", [VERSION])?;
        Ok(client)
    }

    /// Sends a command and waits for its reply.
    ///
    /// # Errors
    /// If the command is rejected, no reply is received in time, or the connection ends.
    pub fn call<V: Into<Value>>(
        &self,
        command: &str,
        values: impl IntoIterator<Item = V>,
    ) -> Result<Reply, Error> {
        let tag = self.connection.shared.inbox().new_tag();
        self.call_as(tag, command, values)
    }

    /// The same with a tag of the caller: what the controller pushes for a subscription carries it. Tags of [`Self::call`] are `t` and a
    /// number.
    ///
    /// # Errors
    /// As [`Self::call`]; and if the reply to another command with this tag is awaited.
    pub fn call_as<V: Into<Value>>(
        &self,
        tag: String,
        command: &str,
        values: impl IntoIterator<Item = V>,
    ) -> Result<Reply, Error> {
        let shared = &self.connection.shared;
        if !shared.inbox().expect_reply(&tag) {
            return Err(Error::TagInUse { tag });
        }
        let message = Message {
            args: values.into_iter().map(Into::into).collect(),
            ..Message::new(tag.as_str(), command)
        };
        if let Err(source) = shared.send(&message) {
            let end = shared.wait(END_TIMEOUT, |inbox| inbox.end.clone());
            shared.inbox().replies.remove(&tag);
            return Err(end.map_or_else(|| shared.broken(source), |end| shared.error(end)));
        }
        let reply = shared.wait(REPLY_TIMEOUT, |inbox| {
            let reply = inbox.replies.get_mut(&tag)?.take();
            reply.map(Ok).or_else(|| inbox.end.clone().map(Err))
        });
        shared.inbox().end_wait(&tag, reply.is_none());
        match reply {
            Some(Ok(reply)) if reply.command == "ok" => Ok(Reply {
                tag,
                values: reply.args,
            }),
            Some(Ok(reply)) => Err(command_error(command, &reply)),
            Some(Err(end)) => Err(shared.error(end)),
            None => Err(Error::NoReply {
                command: command.to_owned(),
                waited: REPLY_TIMEOUT,
            }),
        }
    }

    /// The next push, or `None` after the timeout.
    ///
    /// # Errors
    /// If the connection ended and all its pushes were received.
    pub fn next_push(&self, timeout: Duration) -> Result<Option<Message>, Error> {
        let shared = &self.connection.shared;
        let next = shared.wait(timeout, |inbox| {
            let push = inbox.pushes.pop_front().map(Ok);
            push.or_else(|| inbox.end.clone().map(Err))
        });
        next.transpose().map_err(|end| shared.error(end))
    }

    /// Closes the connection for all its users: calls and waits in progress end.
    pub fn close(&self) {
        self.connection.control.shut_down();
    }
}

impl Inbox {
    /// A tag that no command in progress has.
    fn new_tag(&mut self) -> String {
        loop {
            let tag = format!("t{}", self.commands);
            self.commands = self.commands.wrapping_add(1);
            if self.is_free(&tag) {
                return tag;
            }
        }
    }

    /// The reply to a command with this tag is awaited from now on, unless that to another one is.
    fn expect_reply(&mut self, tag: &str) -> bool {
        let is_free = self.is_free(tag);
        if is_free {
            self.replies.insert(tag.to_owned(), None);
        }
        is_free
    }

    fn is_free(&self, tag: &str) -> bool {
        !self.replies.contains_key(tag) && !self.overdue.contains(tag)
    }

    /// The reply to a command is not awaited any more, because it was received or did not come in time.
    fn end_wait(&mut self, tag: &str, is_overdue: bool) {
        // It may have come at the last moment.
        let came = self.replies.remove(tag).flatten().is_some();
        if is_overdue && !came {
            self.overdue.insert(tag.to_owned());
        }
    }

    fn handle(&mut self, message: Message) {
        match message.command.as_str() {
            // Too late: the caller has reported that it did not come.
            "ok" | "err" if self.overdue.remove(&message.tag) => {}
            "ok" | "err" if self.replies.contains_key(&message.tag) => {
                self.replies.insert(message.tag.clone(), Some(message));
            }
            "err" if message.tag == "none" => self.last_error = Some(message.to_string()),
            _ if self.pushes.len() == PUSHES_MAX => self.end = Some(End::Unread),
            _ => self.pushes.push_back(message),
        }
    }
}

impl Shared {
    fn inbox(&self) -> MutexGuard<'_, Inbox> {
        self.inbox.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn send(&self, message: &Message) -> io::Result<()> {
        let mut writer = self.writer.lock().unwrap_or_else(PoisonError::into_inner);
        writer.write_all(format!("{message}\n").as_bytes())
    }

    /// Polls the inbox after each change until there is a result, or the timeout.
    fn wait<T>(
        &self,
        timeout: Duration,
        mut poll: impl FnMut(&mut Inbox) -> Option<T>,
    ) -> Option<T> {
        let until = Instant::now() + timeout;
        let mut inbox = self.inbox();
        loop {
            if let Some(found) = poll(&mut inbox) {
                return Some(found);
            }
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return None;
            }
            let waited = self.changed.wait_timeout(inbox, left);
            inbox = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Body of the reading thread: receives until the connection ends.
    fn receive(&self, mut stream: Stream) {
        let mut reader = LineReader::default();
        let mut bytes = [0; 16 << 10];
        let mut end = None;
        while end.is_none() {
            end = match stream.read(&mut bytes) {
                Ok(0) => Some(End::Closed),
                Ok(count) => {
                    reader.push(bytes.get(..count).unwrap_or_default());
                    self.handle_lines(&mut reader)
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => None,
                Err(error) if error.kind() == ErrorKind::ConnectionReset => Some(End::Closed),
                Err(error) => Some(End::Broken(error.kind(), error.to_string())),
            };
        }
        stream.shut_down();
        self.inbox().end = end;
        self.changed.notify_all();
    }

    /// Handles all complete lines; returns why the connection is to be ended, if so.
    fn handle_lines(&self, reader: &mut LineReader) -> Option<End> {
        let broken =
            |error: &dyn ToString| Some(End::Broken(ErrorKind::InvalidData, error.to_string()));
        let end = loop {
            let line = match reader.poll_message() {
                Ok(Some(line)) => line,
                Ok(None) => break None,
                Err(error) => break broken(&error),
            };
            let message = match Message::decode(&line) {
                Ok(message) => message,
                Err(error) => break broken(&error),
            };
            let mut inbox = self.inbox();
            inbox.handle(message);
            if inbox.end.is_some() {
                break inbox.end.clone();
            }
        };
        self.changed.notify_all();
        end
    }

    fn error(&self, end: End) -> Error {
        let address = self.address.clone();
        match end {
            End::Closed => Error::Closed {
                address,
                last: self.inbox().last_error.clone(),
            },
            End::Unread => Error::Unread {
                address,
                bound: PUSHES_MAX,
            },
            End::Broken(kind, text) => self.broken(io::Error::new(kind, text)),
        }
    }

    fn broken(&self, source: io::Error) -> Error {
        Error::Connection {
            address: self.address.clone(),
            source,
        }
    }
}

/// Connects to a Unix socket, or to the first of the host's addresses that accepts.
fn open(address: &str) -> io::Result<Stream> {
    if address.starts_with('/') {
        return UnixStream::connect(address).map(Stream::Unix);
    }
    let mut failure = io::Error::new(ErrorKind::NotFound, "the host has no address");
    for candidate in address.to_socket_addrs()? {
        match TcpStream::connect_timeout(&candidate, CONNECT_TIMEOUT) {
            Ok(stream) => {
                stream.set_nodelay(true)?;
                return Ok(Stream::Tcp(stream));
            }
            Err(error) => failure = error,
        }
    }
    Err(failure)
}

fn cannot_connect(address: &str, source: io::Error) -> Error {
    let address = address.to_owned();
    if source.kind() == ErrorKind::ConnectionRefused {
        Error::NotListening { address }
    } else {
        Error::Connect { address, source }
    }
}

fn command_error(command: &str, reply: &Message) -> Error {
    let texts: Vec<_> = reply.args.iter().filter_map(Value::as_str).collect();
    Error::Refused {
        command: command.to_owned(),
        text: texts.join(": "),
        conflict: reply.args.iter().find_map(conflict),
    }
}

/// The conflict of a reply; controllers of older versions send none.
fn conflict(value: &Value) -> Option<Conflict> {
    let text = |key: &str| Some(value.as_map()?.get(key)?.as_str()?.to_owned());
    Some(Conflict {
        resource: text("resource")?,
        holder: text("holder"),
    })
}

#[cfg(test)]
mod tests;
