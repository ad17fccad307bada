//! One connection: moves its bytes and calls its [`Connection`] in threads that may block. It opens and ends no
//! session.

mod file;
mod live;
mod scope;

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use takt_client::token::TOKEN_CHARS_MAX;
use takt_client::wire::Message;
use takt_client::wire::lines::LineReader;
use takt_core::controller::Changed;
use takt_core::{OnLoss, SessionId};
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::sync::{Notify, watch};
use tokio::task::JoinError;
use tokio::time::{Instant, timeout};

use super::slots::{Full, Pool};
use super::{ConnectionContext, Kind};
use crate::access::origin::Origins;
use crate::access::{Admission, WRONG_DELAY};
use crate::codec::{Codec, Received};
use crate::dio::Connection;
use crate::error::Error;
use crate::http::{self, DebugStream};
use crate::site::{Counters, Limits};
use crate::websocket::FrameReader;

/// Bytes per read.
const READ_BYTES: usize = 64 << 10;

/// The same before the client is admitted.
const WAITING_READ_BYTES: usize = 4 << 10;

/// Timeout of a client's request, and of its handshake.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(10);

/// Most bytes of a line before the handshake.
const TOKEN_LINE_BYTES_MAX: usize = 2 * TOKEN_CHARS_MAX;

/// Send interval of a debug stream.
const STREAM_INTERVAL: Duration = Duration::from_millis(100);

/// How long to wait for the client to close after the response.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(1);

/// A client that reads nothing for this time counts as lost.
const WRITE_TIMEOUT: Duration = Duration::from_secs(10);

/// A silent client without subscription and session is disconnected after this time.
const IDLE_TIMEOUT: Duration = Duration::from_secs(600);

/// Any kind of byte stream.
pub(super) trait Bytes: AsyncRead + AsyncWrite + Unpin + Send {}

impl<T: AsyncRead + AsyncWrite + Unpin + Send> Bytes for T {}

/// A connection that ended with an error.
pub(super) struct Failure {
    /// The cause.
    pub(super) error: Error,
    /// Sessions that it had open.
    pub(super) opened: Vec<SessionId>,
}

/// Serves one client until its connection ends; returns the sessions that it left open.
pub(super) async fn serve(
    stream: Box<dyn Bytes>,
    kind: Kind,
    context: &ConnectionContext,
) -> Result<Vec<SessionId>, Failure> {
    let mut link = Link::new(stream, kind, context);
    let work = async {
        match kind {
            Kind::Lines => link.serve_lines(context).await,
            Kind::Http => link.serve_http(context).await,
            Kind::Live => link.serve_live(context).await,
        }
    };
    let ended = tokio::select! {
        ended = work => ended,
        () = context.slot.evicted() => Err(Error::Evicted),
    };
    if let Err(error @ (Error::Evicted | Error::Full { .. })) = &ended {
        link.send_close_reason(kind, error).await;
    }
    let opened = link.opened;
    match ended {
        Ok(()) => Ok(opened),
        Err(error) => Err(Failure { error, opened }),
    }
}

struct Link {
    stream: Box<dyn Bytes>,
    peer: String,
    counters: Arc<Counters>,
    codec: Codec,
    /// `None` only while a blocking thread has it; lost if that thread panics.
    connection: Option<Connection>,
    /// Sessions it has open, as of the last call that returned.
    opened: Vec<SessionId>,
    begin: Instant,
    /// When data was last received.
    received_at: Instant,
}

impl Link {
    fn new(stream: Box<dyn Bytes>, kind: Kind, context: &ConnectionContext) -> Self {
        let codec = match kind {
            Kind::Lines => Codec::Plain(LineReader::bounded(TOKEN_LINE_BYTES_MAX)),
            Kind::Http | Kind::Live => Codec::WebSocket(FrameReader::bounded(TOKEN_LINE_BYTES_MAX)),
        };
        let site = &context.site;
        let now = Instant::now();
        let begin = now.duration_since(site.begin);
        let connection = Connection::new(site.controller.clone())
            .with_on_loss(site.on_loss.unwrap_or_default())
            .with_sessions(&site.sessions, begin);
        let connection = match kind {
            Kind::Lines => connection
                .with_gate(&site.gate, context.peer, begin)
                .strict(),
            // The HTTP request carries the token.
            Kind::Http | Kind::Live => connection,
        };
        Self {
            stream,
            peer: context.name.clone(),
            counters: Arc::clone(&site.counters),
            codec,
            connection: Some(connection),
            opened: Vec::new(),
            begin: now,
            received_at: now,
        }
    }

    /// Sends the reason for closing, if the client still reads.
    async fn send_close_reason(&mut self, kind: Kind, error: &Error) {
        let text = match (kind, &self.codec, error) {
            (Kind::Http | Kind::Live, _, Error::Full { bound }) => {
                http::too_many_connections(*bound).to_string().into_bytes()
            }
            _ => self.encode(&[Message::new("none", "err")
                .with(error.to_string())
                .to_string()]),
        };
        let sending = async {
            self.stream.write_all(&text).await?;
            self.stream.shutdown().await
        };
        let _ = timeout(CLOSE_TIMEOUT, sending).await;
    }

    async fn serve_http(&mut self, context: &ConnectionContext) -> Result<(), Error> {
        let request = timeout(REQUEST_TIMEOUT, self.read_request(context)).await;
        let response = match request {
            Ok(Ok(Some(http::Action::Upgrade(upgrade)))) if upgrade.is_scope => {
                return self.serve_scope(upgrade, context).await;
            }
            Ok(Ok(Some(http::Action::Upgrade(upgrade)))) => {
                self.send(upgrade.response.as_bytes()).await?;
                let on_loss = context.site.on_loss.unwrap_or(if upgrade.is_versioned {
                    OnLoss::End
                } else {
                    // The known client, which reconnects and expects its nets to run on.
                    OnLoss::Keep
                });
                let connection = self.connection.take();
                let admitted = |c: Connection| c.admitted_for(upgrade.credential);
                self.connection = connection.map(|c| admitted(c).with_on_loss(on_loss));
                return self.serve_lines(context).await;
            }
            Ok(Ok(Some(http::Action::Serve(request)))) => {
                Counters::add(&self.counters.requests, 1);
                admit(context, Pool::Request(request.credential))?;
                match DebugStream::from_request(&context.site.controller, &request) {
                    None => self.respond(request, context).await?,
                    Some(Err(response)) => response,
                    Some(Ok(stream)) => match Arc::clone(&context.streams).try_acquire_owned() {
                        Ok(_permit) => return self.stream(stream, context).await,
                        Err(_) => DebugStream::too_many(),
                    },
                }
            }
            Ok(Ok(Some(http::Action::Reject(response)))) => response,
            Ok(Ok(Some(http::Action::ReadBody { .. }) | None)) => return Ok(()),
            Ok(Err(error)) => return Err(error),
            Err(_) => return Err(self.io_error(io::ErrorKind::TimedOut.into())),
        };
        self.send(response.to_string().as_bytes()).await?;
        if let Some(download) = response.download() {
            self.send_file(download, context).await?;
        }
        self.finish().await
    }

    async fn respond(
        &mut self,
        request: http::Request,
        context: &ConnectionContext,
    ) -> Result<http::Response, Error> {
        let _permit = match request.path.first().map(String::as_str) {
            // The semaphore is never closed.
            Some("eval") => context.evaluations.acquire().await.ok(),
            _ => None,
        };
        let site = context.site.clone();
        let work = move || http::respond(&site, &request);
        let worked = tokio::task::spawn_blocking(work).await;
        worked.map_err(|e: JoinError| self.io_error(io::Error::other(e)))
    }

    /// Sends the records of a net's debug taps until the net ends or the client disconnects.
    async fn stream(
        &mut self,
        mut stream: DebugStream,
        context: &ConnectionContext,
    ) -> Result<(), Error> {
        self.send(DebugStream::HEAD.as_bytes()).await?;
        let mut shutdown = context.shutdown.clone();
        let mut received = Vec::new();
        loop {
            let worked = tokio::task::spawn_blocking(move || {
                let chunk = stream.poll();
                (stream, chunk)
            });
            let (back, chunk) = worked
                .await
                .map_err(|e| self.io_error(io::Error::other(e)))?;
            stream = back;
            let Some(chunk) = chunk else {
                self.send(b"0\r\n\r\n").await?;
                return self.finish().await;
            };
            if !chunk.is_empty() {
                let framed = format!("{:x}\r\n{chunk}\r\n", chunk.len());
                self.send(framed.as_bytes()).await?;
            }
            tokio::select! {
                () = shut_down(&mut shutdown) => return Ok(()),
                // A client that closes or sends anything ends its stream.
                _ = read(&mut self.stream, &mut received, WAITING_READ_BYTES) => return Ok(()),
                () = tokio::time::sleep(STREAM_INTERVAL) => {}
            }
        }
    }

    /// Reads a request. After a WebSocket handshake, the bytes behind its head are frames.
    async fn read_request(
        &mut self,
        context: &ConnectionContext,
    ) -> Result<Option<http::Action>, Error> {
        let (mut received, mut continued) = (Vec::new(), false);
        while self.read(&mut received, context).await? {
            let (parsed, is_delayed) = with_policy(context, &context.site.origins, |policy| {
                http::parse(&received, continued, policy)
            });
            match parsed {
                Some((
                    _,
                    http::Action::ReadBody {
                        credential,
                        interim,
                    },
                )) => {
                    continued = true;
                    admit(context, Pool::Request(credential))?;
                    self.send(interim.as_bytes()).await?;
                }
                Some((length, action)) => {
                    self.codec.push(received.get(length..).unwrap_or_default());
                    if let http::Action::Reject(response) = &action
                        && response.is_denial()
                    {
                        self.log_denial(context, response.status());
                    }
                    if is_delayed {
                        tokio::time::sleep(WRONG_DELAY).await;
                    }
                    return Ok(Some(action));
                }
                None => {}
            }
        }
        Ok(None)
    }

    fn log_denial(&self, context: &ConnectionContext, why: &str) {
        let line = format!("rejected a client at {}: {why}", self.peer);
        context.site.warn(|limits: &Limits| &limits.denials, &line);
    }

    /// Closes this side and waits for the client to close. Unread data, such as the rest of a body that is too long,
    /// would otherwise reset the connection and discard the response.
    async fn finish(&mut self) -> Result<(), Error> {
        self.stream.shutdown().await.map_err(|e| self.io_error(e))?;
        let rest = async {
            let mut bytes = Vec::new();
            let more = |read: io::Result<bool>| read.is_ok_and(|more| more);
            while more(read(&mut self.stream, &mut bytes, READ_BYTES).await) {
                bytes.clear();
            }
        };
        // The response is sent even if the client does not close.
        let _ = timeout(CLOSE_TIMEOUT, rest).await;
        Ok(())
    }

    async fn serve_lines(&mut self, context: &ConnectionContext) -> Result<(), Error> {
        let changed = Arc::new(Notify::new());
        let has_states = Arc::new(AtomicBool::new(false));
        let (wake, noted) = (Arc::clone(&changed), Arc::clone(&has_states));
        let _watch = context.site.controller.on_change(move |what| {
            noted.fetch_or(what == Changed::States, Ordering::Relaxed);
            wake.notify_one();
        });
        let mut shutdown = context.shutdown.clone();
        let mut received = Vec::new();
        let handshake_deadline = Instant::now() + REQUEST_TIMEOUT;
        loop {
            if !self.handle_received(context).await? {
                return Ok(());
            }
            let next = self.connection.as_ref().and_then(Connection::poll_timeout);
            let next = next.map(|at| self.begin + at);
            let is_waiting = context.slot.is_waiting();
            let at_once = if is_waiting {
                WAITING_READ_BYTES
            } else {
                READ_BYTES
            };
            let is_idle = self.connection.as_ref().is_some_and(Connection::is_idle);
            tokio::select! {
                biased;
                () = shut_down(&mut shutdown) => return Ok(()),
                // Before reading: a client that sends without pause times out too.
                () = tokio::time::sleep_until(handshake_deadline), if is_waiting => {
                    return Err(self.io_error(io::ErrorKind::TimedOut.into()));
                }
                alive = read(&mut self.stream, &mut received, at_once) => {
                    if !alive.map_err(|e| self.io_error(e))? {
                        return Ok(());
                    }
                    self.received_at = Instant::now();
                    context.slot.touch(context.site.now());
                    self.codec.push(&received);
                    received.clear();
                }
                () = changed.notified() => {
                    let has_states = has_states.swap(false, Ordering::Relaxed);
                    let wants_results = self.connection.as_ref().is_some_and(Connection::wants_results);
                    // A net may change its results in each cycle: others need not look for them.
                    if !has_states && !wants_results {
                        continue;
                    }
                    self.push(Some(if has_states { Changed::States } else { Changed::Results })).await?;
                }
                () = sleep_until(next) => self.push(None).await?,
                () = tokio::time::sleep_until(self.received_at + IDLE_TIMEOUT), if is_idle => {
                    let text = format!("closed: nothing came for {} s", IDLE_TIMEOUT.as_secs());
                    return self.send_lines(&[Message::new("none", "err").with(text).to_string()]).await;
                }
            }
        }
    }

    /// Handles all complete lines; returns whether the connection stays open.
    async fn handle_received(&mut self, context: &ConnectionContext) -> Result<bool, Error> {
        loop {
            if context.slot.is_waiting() && !self.codec.may_be_first_line() {
                Counters::add(&self.counters.denied, 1);
                self.log_denial(context, "its first bytes are not a DirectIO handshake");
                let text = "this port takes lines that begin with tag=ver(\"2.0\") or tag=tok(…); HTTP has a port of its own";
                self.send_lines(&[Message::new("none", "err").with(text).to_string()])
                    .await?;
                return Ok(false);
            }
            match self.codec.poll() {
                Ok(None) => return Ok(true),
                Ok(Some(Received::Line(line))) => {
                    if !self.handle_line(line, context).await? {
                        return Ok(false);
                    }
                }
                Ok(Some(Received::Reply(bytes))) => self.send(&bytes).await?,
                Ok(Some(Received::Close(bytes))) => {
                    self.send(&bytes).await?;
                    return Ok(false);
                }
                Err(error) => {
                    let reply = Message::new("none", "err")
                        .with(error.to_string())
                        .to_string();
                    self.send_lines(&[reply]).await?;
                    return Err(error);
                }
            }
        }
    }

    /// Handles one line; returns whether the connection stays open.
    async fn handle_line(
        &mut self,
        line: String,
        context: &ConnectionContext,
    ) -> Result<bool, Error> {
        Counters::add(&self.counters.received, 1);
        let lines = self
            .with_connection(move |c, now| {
                let mut out = c.handle_line(&line, now);
                out.extend(c.poll_pushes(now));
                out
            })
            .await?;
        if self.connection.as_ref().is_some_and(Connection::is_delayed) {
            tokio::time::sleep(WRONG_DELAY).await;
        }
        let handshake_done = self.connection.as_ref().filter(|c| c.is_handshake_done());
        if let Some(credential) = handshake_done.map(Connection::credential)
            && context.slot.is_waiting()
        {
            // Before the reply: a client that has read it is admitted.
            admit(context, Pool::Messages(credential))?;
            self.codec.raise_bound();
        }
        self.send_lines(&lines).await?;
        if self
            .connection
            .as_ref()
            .is_some_and(Connection::is_rejected)
        {
            Counters::add(&self.counters.denied, 1);
            self.log_denial(context, "its token or handshake is wrong");
            return Ok(false);
        }
        Ok(true)
    }

    async fn push(&mut self, changed: Option<Changed>) -> Result<(), Error> {
        let lines = self.with_connection(move |c, now| {
            if let Some(changed) = changed {
                c.handle_change(changed);
            }
            c.poll_pushes(now)
        });
        let lines = lines.await?;
        self.send_lines(&lines).await
    }

    /// Calls the connection in a thread that may block; returns the lines to send.
    async fn with_connection(
        &mut self,
        work: impl FnOnce(&mut Connection, Duration) -> Vec<String> + Send + 'static,
    ) -> Result<Vec<String>, Error> {
        let now = self.begin.elapsed();
        let Some(mut connection) = self.connection.take() else {
            return Ok(Vec::new());
        };
        let worked = tokio::task::spawn_blocking(move || {
            let lines = work(&mut connection, now);
            (connection, lines)
        });
        let (connection, lines) = worked
            .await
            .map_err(|e| self.io_error(io::Error::other(e)))?;
        self.opened = connection.opened_sessions().to_vec();
        self.connection = Some(connection);
        Ok(lines)
    }

    async fn send_lines(&mut self, lines: &[String]) -> Result<(), Error> {
        Counters::add(&self.counters.sent, lines.len() as u64);
        self.send(&self.encode(lines)).await
    }

    fn encode(&self, lines: &[String]) -> Vec<u8> {
        let mut bytes = Vec::new();
        for line in lines {
            self.codec.write(line, &mut bytes);
        }
        bytes
    }

    async fn send(&mut self, bytes: &[u8]) -> Result<(), Error> {
        let sent = timeout(WRITE_TIMEOUT, self.stream.write_all(bytes)).await;
        sent.unwrap_or_else(|_| Err(io::ErrorKind::TimedOut.into()))
            .map_err(|e| self.io_error(e))
    }

    async fn read(
        &mut self,
        into: &mut Vec<u8>,
        context: &ConnectionContext,
    ) -> Result<bool, Error> {
        let at_once = if context.slot.is_waiting() {
            WAITING_READ_BYTES
        } else {
            READ_BYTES
        };
        read(&mut self.stream, into, at_once)
            .await
            .map_err(|e| self.io_error(e))
    }

    fn io_error(&self, source: io::Error) -> Error {
        Error::Connection {
            address: self.peer.clone(),
            source,
        }
    }
}

/// Parses a request under the access policy of a connection; returns also whether the answer is to be delayed.
fn with_policy<T>(
    context: &ConnectionContext,
    origins: &Origins,
    parse: impl FnOnce(http::AccessPolicy<'_>) -> T,
) -> (T, bool) {
    let site = &context.site;
    let delayed = AtomicBool::new(false);
    let admission = |given: Option<&str>| {
        let admission = site.gate.check(context.peer, given, site.now());
        let admitted = matches!(admission, Admission::Admitted(_));
        Counters::add(&site.counters.denied, (given.is_some() && !admitted).into());
        delayed.store(admission == Admission::TooMany, Ordering::Relaxed);
        admission
    };
    let parsed = parse(http::AccessPolicy {
        check_token: &admission,
        origins,
        reached: context.reached,
    });
    (parsed, delayed.load(Ordering::Relaxed))
}

/// Moves a connection to the slot of an admitted client.
fn admit(context: &ConnectionContext, pool: Pool) -> Result<(), Error> {
    match context.slot.admit(pool, context.site.now()) {
        Ok(evicts) => {
            context.count_eviction(evicts);
            Ok(())
        }
        Err(Full { bound }) => Err(Error::Full { bound }),
    }
}

/// Appends the bytes received next, at most `at_once`; returns false at the end of the stream. Cancel-safe: no byte
/// is lost if the future is dropped.
async fn read(stream: &mut Box<dyn Bytes>, into: &mut Vec<u8>, at_once: usize) -> io::Result<bool> {
    into.reserve(at_once);
    Ok(stream.take(at_once as u64).read_buf(into).await? > 0)
}

/// Waits until the server shuts down.
async fn shut_down(shutdown: &mut watch::Receiver<bool>) {
    let _ = shutdown.wait_for(|shutdown| *shutdown).await;
}

/// Sleeps until `time`; for ever if it is `None`.
async fn sleep_until(time: Option<Instant>) {
    match time {
        Some(time) => tokio::time::sleep_until(time).await,
        None => std::future::pending().await,
    }
}
