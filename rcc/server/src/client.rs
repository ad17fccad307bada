//! The other end, for tools and tests: a blocking connection over a Unix socket or plain TCP. It interprets no
//! pushes; they wait until they are asked for.

use std::collections::VecDeque;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

use crate::access::Token;
use crate::error::Error;
use crate::wire::lines::LineReader;
use crate::wire::{Message, Value};

/// How long to wait for a connection.
const CONNECT_WITHIN: Duration = Duration::from_secs(5);

/// How long to wait for a reply unless told otherwise. Loading a large net takes seconds.
const REPLY_WITHIN: Duration = Duration::from_secs(30);

/// What a command that was done answered.
#[derive(Clone, Debug, PartialEq)]
pub struct Reply {
    /// The tag that pushes carry if the command was a subscription.
    pub tag: String,
    /// The values of the answer.
    pub values: Vec<Value>,
}

impl Reply {
    /// The first value, if it is a text: the identifier that `nse` and `nene` answer.
    #[must_use]
    pub fn text(&self) -> Option<&str> {
        self.values.first().and_then(Value::as_str)
    }
}

/// Where plain lines are taken on this host unless it is configured otherwise.
pub const TCP_ADDRESS: &str = "127.0.0.1:8081";

/// Bytes of either kind of connection.
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
    /// The last message that answers nothing that was asked.
    last_words: Option<String>,
}

impl Client {
    /// Connects to the controller of this host: at the Unix socket of this account's session or of the
    /// service, else at [`TCP_ADDRESS`].
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

    /// Connects to `host:port`, or to the Unix socket of an absolute path, and shakes hands.
    ///
    /// # Errors
    /// If nobody listens there, or it is no controller.
    pub fn connect(address: &str) -> Result<Self, Error> {
        Self::connect_with(address, None)
    }

    /// The same, giving the token first.
    ///
    /// # Errors
    /// If nobody listens there, it is no controller, or the token is wrong.
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
            last_words: None,
        };
        if let Some(token) = token {
            client.call("tok", [token.text()])?;
        }
        client.call("ver", ["2.0"])?;
        Ok(client)
    }

    /// Sends a command and waits for its reply. Pushes that come meanwhile are kept.
    ///
    /// # Errors
    /// If the command is refused, or there is no reply.
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
            .map_err(|e| self.broken(e))?;
        let until = Instant::now() + REPLY_WITHIN;
        loop {
            let Some(message) = self.receive(until)? else {
                return Err(Error::NoReply {
                    command: command.to_owned(),
                    waited: REPLY_WITHIN,
                });
            };
            match message.command.as_str() {
                "ok" if message.tag == tag => {
                    return Ok(Reply {
                        tag,
                        values: message.args,
                    });
                }
                "err" if message.tag == tag => return Err(refused(command, &message)),
                "err" if message.tag == "none" => self.last_words = Some(message.to_string()),
                _ => self.pushes.push_back(message),
            }
        }
    }

    /// The next push, or `None` if none comes in time.
    ///
    /// # Errors
    /// If the connection is lost.
    pub fn next_push(&mut self, timeout: Duration) -> Result<Option<Message>, Error> {
        match self.pushes.pop_front() {
            Some(push) => Ok(Some(push)),
            None => self.receive(Instant::now() + timeout),
        }
    }

    /// The next message, or `None` when the time is up.
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
                .map_err(|e| self.broken(e))?;
            match self.stream.read(&mut bytes) {
                Ok(0) => return Err(self.closed()),
                Ok(count) => self.reader.push(bytes.get(..count).unwrap_or_default()),
                Err(e) if is_timeout(&e) => {}
                Err(e) if e.kind() == ErrorKind::ConnectionReset => return Err(self.closed()),
                Err(e) => return Err(self.broken(e)),
            }
        }
    }

    fn closed(&self) -> Error {
        Error::Closed {
            address: self.address.clone(),
            last: self.last_words.clone(),
        }
    }

    fn broken(&self, source: io::Error) -> Error {
        Error::Connection {
            address: self.address.clone(),
            source,
        }
    }
}

/// Connects to a Unix socket, or to the first of the host's addresses that answers.
fn open(address: &str) -> io::Result<Stream> {
    if address.starts_with('/') {
        return UnixStream::connect(address).map(Stream::Unix);
    }
    let mut failure = io::Error::new(ErrorKind::NotFound, "the host has no address");
    for candidate in address.to_socket_addrs()? {
        match TcpStream::connect_timeout(&candidate, CONNECT_WITHIN) {
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
        Error::NobodyListens { address }
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

fn refused(command: &str, reply: &Message) -> Error {
    let texts: Vec<_> = reply.args.iter().filter_map(Value::as_str).collect();
    Error::Refused {
        command: command.to_owned(),
        text: texts.join(": "),
    }
}
