//! Blocking client for tools and tests, over a Unix socket or plain TCP. It does not interpret pushes; they are
//! queued until [`Client::next_push`].

use std::collections::VecDeque;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

use crate::access::Token;
use crate::error::Error;
use crate::wire::lines::LineReader;
use crate::wire::{Message, Value};

/// Timeout of a connection attempt.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);

/// Timeout of a reply. Loading a large net takes seconds.
const REPLY_TIMEOUT: Duration = Duration::from_secs(30);

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

/// Default address for plain lines on this host.
pub const TCP_ADDRESS: &str = "127.0.0.1:8081";

/// The byte stream of either kind of connection.
#[derive(Debug)]
enum Stream {
    Tcp(TcpStream),
    Unix(UnixStream),
}

impl Stream {
    fn set_read_timeout(&self, timeout: Option<Duration>) -> io::Result<()> {
        match self {
            Self::Tcp(stream) => stream.set_read_timeout(timeout),
            Self::Unix(stream) => stream.set_read_timeout(timeout),
        }
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

/// A connection to a controller.
#[derive(Debug)]
pub struct Client {
    stream: Stream,
    address: String,
    reader: LineReader,
    pushes: VecDeque<Message>,
    commands: u32,
    /// The last error message that replies to no command.
    last_error: Option<String>,
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

    fn begin(stream: Stream, address: String, token: Option<&Token>) -> Result<Self, Error> {
        let mut client = Self {
            stream,
            address,
            reader: LineReader::default(),
            pushes: VecDeque::new(),
            commands: 0,
            last_error: None,
        };
        if let Some(token) = token {
            client.call("tok", [token.text()])?;
        }
        client.call("ver", ["2.0"])?;
        Ok(client)
    }

    /// Sends a command and waits for its reply. Pushes received meanwhile are queued.
    ///
    /// # Errors
    /// If the command is rejected or no reply is received in time.
    pub fn call<V: Into<Value>>(
        &mut self,
        command: &str,
        values: impl IntoIterator<Item = V>,
    ) -> Result<Reply, Error> {
        let tag = format!("t{}", self.commands);
        self.commands = self.commands.wrapping_add(1);
        let args = values.into_iter().map(Into::into).collect();
        let line = Message {
            args,
            ..Message::new(tag.as_str(), command)
        };
        self.stream
            .write_all(format!("{line}\n").as_bytes())
            .map_err(|e| self.io_error(e))?;
        let until = Instant::now() + REPLY_TIMEOUT;
        loop {
            let Some(message) = self.receive(until)? else {
                return Err(Error::NoReply {
                    command: command.to_owned(),
                    waited: REPLY_TIMEOUT,
                });
            };
            match message.command.as_str() {
                "ok" if message.tag == tag => {
                    return Ok(Reply {
                        tag,
                        values: message.args,
                    });
                }
                "err" if message.tag == tag => return Err(command_error(command, &message)),
                "err" if message.tag == "none" => self.last_error = Some(message.to_string()),
                _ => self.pushes.push_back(message),
            }
        }
    }

    /// The next push, or `None` after the timeout.
    pub fn next_push(&mut self, timeout: Duration) -> Result<Option<Message>, Error> {
        match self.pushes.pop_front() {
            Some(push) => Ok(Some(push)),
            None => self.receive(Instant::now() + timeout),
        }
    }

    /// The next message, or `None` at the deadline.
    fn receive(&mut self, until: Instant) -> Result<Option<Message>, Error> {
        let mut bytes = [0; 16 << 10];
        loop {
            if let Some(line) = self.reader.poll_message()? {
                return Ok(Some(Message::decode(&line)?));
            }
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Ok(None);
            }
            self.stream
                .set_read_timeout(Some(left))
                .map_err(|e| self.io_error(e))?;
            match self.stream.read(&mut bytes) {
                Ok(0) => return Err(self.closed()),
                Ok(count) => self.reader.push(bytes.get(..count).unwrap_or_default()),
                Err(e) if is_timeout(&e) => {}
                Err(e) if e.kind() == ErrorKind::ConnectionReset => return Err(self.closed()),
                Err(e) => return Err(self.io_error(e)),
            }
        }
    }

    fn closed(&self) -> Error {
        Error::Closed {
            address: self.address.clone(),
            last: self.last_error.clone(),
        }
    }

    fn io_error(&self, source: io::Error) -> Error {
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

fn is_timeout(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted
    )
}

fn command_error(command: &str, reply: &Message) -> Error {
    let texts: Vec<_> = reply.args.iter().filter_map(Value::as_str).collect();
    Error::Refused {
        command: command.to_owned(),
        text: texts.join(": "),
    }
}
