//! One connection: bytes in, bytes out, and the calls of the [`Connection`] between them, made
//! in threads that may block. It opens and ends no session.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use takt_core::{OnLoss, SessionId};
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::sync::{Notify, watch};
use tokio::task::JoinError;
use tokio::time::{Instant, timeout};

use super::places::{Full, Pool};
use super::{Kind, Visit};
use crate::access::{Admission, TOKEN_CHARS_MAX, WRONG_PAUSE};
use crate::codec::{Codec, Received};
use crate::dio::Connection;
use crate::error::Error;
use crate::http::{self, DebugStream};
use crate::site::{Counters, Limits};
use crate::wire::Message;
use crate::wire::lines::LineReader;
use crate::wire::websocket::FrameReader;

/// Bytes read at once.
const READ_BYTES: usize = 64 << 10;

/// The same while it is not known who the client is.
const WAITING_READ_BYTES: usize = 4 << 10;

/// How long a client may take to send its request, and again to shake hands.
const REQUEST_WITHIN: Duration = Duration::from_secs(10);

/// Most bytes of a line before the handshake.
const TOKEN_LINE_BYTES_MAX: usize = 2 * TOKEN_CHARS_MAX;

/// How often a debug stream sends.
const STREAM_EVERY: Duration = Duration::from_millis(100);

/// How long a client may take to close after it was answered.
const CLOSE_WITHIN: Duration = Duration::from_secs(1);

/// How long a client may take to read what is sent before it counts as lost.
const WRITE_WITHIN: Duration = Duration::from_secs(10);

/// How long a client that waits for nothing and has no session may be silent.
const IDLE_WITHIN: Duration = Duration::from_secs(600);

/// Bytes of any kind of stream.
pub(super) trait Bytes: AsyncRead + AsyncWrite + Unpin + Send {}

impl<T: AsyncRead + AsyncWrite + Unpin + Send> Bytes for T {}

/// A connection that did not end by itself.
pub(super) struct Failure {
    /// Why.
    pub(super) error: Error,
    /// Sessions that it had opened.
    pub(super) opened: Vec<SessionId>,
}

/// Serves one client to its end; returns the sessions that it opened and did not end.
pub(super) async fn serve(
    stream: Box<dyn Bytes>,
    kind: Kind,
    visit: &Visit,
) -> Result<Vec<SessionId>, Failure> {
    let mut link = Link::new(stream, kind, visit);
    let work = async {
        match kind {
            Kind::Lines => link.serve_lines(visit).await,
            Kind::Http => link.serve_http(visit).await,
        }
    };
    let ended = tokio::select! {
        ended = work => ended,
        () = visit.place.displaced() => Err(Error::Displaced),
    };
    if let Err(error @ (Error::Displaced | Error::Full { .. })) = &ended {
        link.say_farewell(kind, error).await;
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
    /// Away only while a blocking thread has it; lost if that thread panics.
    connection: Option<Connection>,
    /// Sessions that it opened and did not end, as of the last work that it finished.
    opened: Vec<SessionId>,
    begin: Instant,
    /// When the client last sent something.
    received_at: Instant,
}

impl Link {
    fn new(stream: Box<dyn Bytes>, kind: Kind, visit: &Visit) -> Self {
        let codec = match kind {
            Kind::Lines => Codec::Plain(LineReader::bounded(TOKEN_LINE_BYTES_MAX)),
            Kind::Http => Codec::WebSocket(FrameReader::bounded(TOKEN_LINE_BYTES_MAX)),
        };
        let site = &visit.site;
        let now = Instant::now();
        let begin = now.duration_since(site.begin);
        let connection = Connection::new(site.controller.clone())
            .with_on_loss(site.on_loss.unwrap_or_default())
            .with_sessions(&site.sessions, begin);
        let connection = match kind {
            Kind::Lines => connection.behind(&site.gate, visit.peer, begin).strict(),
            // Its request carries the token.
            Kind::Http => connection,
        };
        Self {
            stream,
            peer: visit.name.clone(),
            counters: Arc::clone(&site.counters),
            codec,
            connection: Some(connection),
            opened: Vec::new(),
            begin: now,
            received_at: now,
        }
    }

    /// Says why the connection ends, if the client listens.
    async fn say_farewell(&mut self, kind: Kind, error: &Error) {
        let text = match (kind, &self.codec, error) {
            (Kind::Http, _, Error::Full { bound }) => {
                http::too_many_connections(*bound).to_string().into_bytes()
            }
            _ => self.encode(&[Message::new("none", "err")
                .with(error.to_string())
                .to_string()]),
        };
        let farewell = async {
            self.stream.write_all(&text).await?;
            self.stream.shutdown().await
        };
        let _ = timeout(CLOSE_WITHIN, farewell).await;
    }

    async fn serve_http(&mut self, visit: &Visit) -> Result<(), Error> {
        let request = timeout(REQUEST_WITHIN, self.read_request(visit)).await;
        let response = match request {
            Ok(Ok(Some(http::Answer::Upgrade(upgrade)))) => {
                self.send(upgrade.response.as_bytes()).await?;
                let on_loss = visit.site.on_loss.unwrap_or(if upgrade.is_versioned {
                    OnLoss::End
                } else {
                    // The known client, which connects again and expects its nets to run.
                    OnLoss::Keep
                });
                let connection = self.connection.take();
                let admitted = |c: Connection| c.admitted_for(upgrade.credential);
                self.connection = connection.map(|c| admitted(c).with_on_loss(on_loss));
                return self.serve_lines(visit).await;
            }
            Ok(Ok(Some(http::Answer::Serve(request)))) => {
                Counters::add(&self.counters.requests, 1);
                admit(visit, Pool::Request(request.credential))?;
                match DebugStream::asked_for(&visit.site.controller, &request) {
                    None => self.respond(request, visit).await?,
                    Some(Err(refusal)) => refusal,
                    Some(Ok(stream)) => match Arc::clone(&visit.streams).try_acquire_owned() {
                        Ok(_place) => return self.stream(stream, visit).await,
                        Err(_) => DebugStream::too_many(),
                    },
                }
            }
            Ok(Ok(Some(http::Answer::Refuse(response)))) => response,
            Ok(Ok(Some(http::Answer::Body { .. }) | None)) => return Ok(()),
            Ok(Err(error)) => return Err(error),
            Err(_) => return Err(self.broken(io::ErrorKind::TimedOut.into())),
        };
        self.send(response.to_string().as_bytes()).await?;
        self.finish().await
    }

    async fn respond(
        &mut self,
        request: http::Request,
        visit: &Visit,
    ) -> Result<http::Response, Error> {
        let _place = match request.path.first().map(String::as_str) {
            // The semaphore is never closed.
            Some("eval") => visit.evaluations.acquire().await.ok(),
            _ => None,
        };
        let site = visit.site.clone();
        let work = move || http::respond(&site, &request);
        let worked = tokio::task::spawn_blocking(work).await;
        worked.map_err(|e: JoinError| self.broken(io::Error::other(e)))
    }

    /// Sends what the debug taps of a net record, until the net ends or the client is gone.
    async fn stream(&mut self, mut stream: DebugStream, visit: &Visit) -> Result<(), Error> {
        self.send(DebugStream::HEAD.as_bytes()).await?;
        let mut closing = visit.closing.clone();
        let mut received = Vec::new();
        loop {
            let worked = tokio::task::spawn_blocking(move || {
                let chunk = stream.poll();
                (stream, chunk)
            });
            let (back, chunk) = worked.await.map_err(|e| self.broken(io::Error::other(e)))?;
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
                () = closed(&mut closing) => return Ok(()),
                // A client that closes, or sends what nobody asked for, has seen enough.
                _ = read(&mut self.stream, &mut received, WAITING_READ_BYTES) => return Ok(()),
                () = tokio::time::sleep(STREAM_EVERY) => {}
            }
        }
    }

    /// Reads a request; what follows its head belongs to the frames if it asks for WebSocket.
    async fn read_request(&mut self, visit: &Visit) -> Result<Option<http::Answer>, Error> {
        let site = &visit.site;
        let slowed = AtomicBool::new(false);
        let admission = |given: Option<&str>| {
            let admission = site.gate.check(visit.peer, given, site.now());
            let admitted = matches!(admission, Admission::Admitted(_));
            Counters::add(&site.counters.denied, (given.is_some() && !admitted).into());
            slowed.store(admission == Admission::TooMany, Ordering::Relaxed);
            admission
        };
        let (mut received, mut continued) = (Vec::new(), false);
        while self.read(&mut received, visit).await? {
            let guard = http::Guard {
                token: &admission,
                origins: &site.origins,
                reached: visit.reached,
            };
            match http::answer(&received, continued, guard) {
                Some((_, http::Answer::Body { credential, ask })) => {
                    continued = true;
                    admit(visit, Pool::Request(credential))?;
                    self.send(ask.as_bytes()).await?;
                }
                Some((length, answer)) => {
                    self.codec.push(received.get(length..).unwrap_or_default());
                    if let http::Answer::Refuse(response) = &answer
                        && response.is_denial()
                    {
                        self.log_denial(visit, response.status());
                    }
                    if slowed.load(Ordering::Relaxed) {
                        tokio::time::sleep(WRONG_PAUSE).await;
                    }
                    return Ok(Some(answer));
                }
                None => {}
            }
        }
        Ok(None)
    }

    fn log_denial(&self, visit: &Visit, why: &str) {
        let line = format!("a client at {} is refused: {why}", self.peer);
        visit.site.warn(|limits: &Limits| &limits.denials, &line);
    }

    /// Closes this side and lets the client close its own: what it still sends, such as the rest
    /// of a body that is too long, would otherwise make its system throw the response away.
    async fn finish(&mut self) -> Result<(), Error> {
        self.stream.shutdown().await.map_err(|e| self.broken(e))?;
        let rest = async {
            let mut bytes = Vec::new();
            let more = |read: io::Result<bool>| read.is_ok_and(|more| more);
            while more(read(&mut self.stream, &mut bytes, READ_BYTES).await) {
                bytes.clear();
            }
        };
        // A client that does not close has had its response all the same.
        let _ = timeout(CLOSE_WITHIN, rest).await;
        Ok(())
    }

    async fn serve_lines(&mut self, visit: &Visit) -> Result<(), Error> {
        let changed = Arc::new(Notify::new());
        let wake = Arc::clone(&changed);
        let _watch = visit.site.controller.on_change(move || wake.notify_one());
        let mut closing = visit.closing.clone();
        let mut received = Vec::new();
        let greeted_by = Instant::now() + REQUEST_WITHIN;
        loop {
            if !self.handle_received(visit).await? {
                return Ok(());
            }
            let next = self.connection.as_ref().and_then(Connection::poll_timeout);
            let next = next.map(|at| self.begin + at);
            let waits = visit.place.waits();
            let at_once = if waits {
                WAITING_READ_BYTES
            } else {
                READ_BYTES
            };
            let is_idle = self.connection.as_ref().is_some_and(Connection::is_idle);
            tokio::select! {
                biased;
                () = closed(&mut closing) => return Ok(()),
                // Before what comes: a client that is never silent is ended too.
                () = tokio::time::sleep_until(greeted_by), if waits => {
                    return Err(self.broken(io::ErrorKind::TimedOut.into()));
                }
                alive = read(&mut self.stream, &mut received, at_once) => {
                    if !alive.map_err(|e| self.broken(e))? {
                        return Ok(());
                    }
                    self.received_at = Instant::now();
                    visit.place.touch(visit.site.now());
                    self.codec.push(&received);
                    received.clear();
                }
                () = changed.notified() => self.push(true).await?,
                () = sleep_until(next) => self.push(false).await?,
                () = tokio::time::sleep_until(self.received_at + IDLE_WITHIN), if is_idle => {
                    let text = format!("closed: nothing came for {} s", IDLE_WITHIN.as_secs());
                    return self.send_lines(&[Message::new("none", "err").with(text).to_string()]).await;
                }
            }
        }
    }

    /// Handles all lines that have come whole; returns whether the connection goes on.
    async fn handle_received(&mut self, visit: &Visit) -> Result<bool, Error> {
        loop {
            if visit.place.waits() && !self.codec.may_begin() {
                Counters::add(&self.counters.denied, 1);
                self.log_denial(visit, "what it sends is no handshake of DirectIO lines");
                let text = "this port takes lines that begin with tag=ver(\"2.0\") or tag=tok(…); HTTP has a port of its own";
                self.send_lines(&[Message::new("none", "err").with(text).to_string()])
                    .await?;
                return Ok(false);
            }
            match self.codec.poll() {
                Ok(None) => return Ok(true),
                Ok(Some(Received::Line(line))) => {
                    if !self.handle_line(line, visit).await? {
                        return Ok(false);
                    }
                }
                Ok(Some(Received::Answer(bytes))) => self.send(&bytes).await?,
                Ok(Some(Received::Goodbye(bytes))) => {
                    self.send(&bytes).await?;
                    return Ok(false);
                }
                Err(error) => {
                    let told = Message::new("none", "err")
                        .with(error.to_string())
                        .to_string();
                    self.send_lines(&[told]).await?;
                    return Err(error);
                }
            }
        }
    }

    /// Handles one line; returns whether the connection goes on.
    async fn handle_line(&mut self, line: String, visit: &Visit) -> Result<bool, Error> {
        Counters::add(&self.counters.received, 1);
        let lines = self
            .with_connection(move |c, now| {
                let mut out = c.handle_line(&line, now);
                out.extend(c.poll_pushes(now));
                out
            })
            .await?;
        if self.connection.as_ref().is_some_and(Connection::is_slowed) {
            tokio::time::sleep(WRONG_PAUSE).await;
        }
        let greeted = self.connection.as_ref().filter(|c| c.is_greeted());
        if let Some(credential) = greeted.map(Connection::credential)
            && visit.place.waits()
        {
            // Before the answer: a client that reads it is admitted.
            admit(visit, Pool::Messages(credential))?;
            self.codec.unbind();
        }
        self.send_lines(&lines).await?;
        if self.connection.as_ref().is_some_and(Connection::is_refused) {
            Counters::add(&self.counters.denied, 1);
            self.log_denial(visit, "its token or handshake is wrong");
            return Ok(false);
        }
        Ok(true)
    }

    async fn push(&mut self, changed: bool) -> Result<(), Error> {
        let lines = self.with_connection(move |c, now| {
            if changed {
                c.handle_change();
            }
            c.poll_pushes(now)
        });
        let lines = lines.await?;
        self.send_lines(&lines).await
    }

    /// Lets the connection work in a thread that may block; returns what is to be sent.
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
        let (connection, lines) = worked.await.map_err(|e| self.broken(io::Error::other(e)))?;
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
        let sent = timeout(WRITE_WITHIN, self.stream.write_all(bytes)).await;
        sent.unwrap_or_else(|_| Err(io::ErrorKind::TimedOut.into()))
            .map_err(|e| self.broken(e))
    }

    async fn read(&mut self, into: &mut Vec<u8>, visit: &Visit) -> Result<bool, Error> {
        let at_once = if visit.place.waits() {
            WAITING_READ_BYTES
        } else {
            READ_BYTES
        };
        read(&mut self.stream, into, at_once)
            .await
            .map_err(|e| self.broken(e))
    }

    fn broken(&self, source: io::Error) -> Error {
        Error::Connection {
            address: self.peer.clone(),
            source,
        }
    }
}

/// Gives a connection the place of a client that is admitted.
fn admit(visit: &Visit, pool: Pool) -> Result<(), Error> {
    match visit.place.admit(pool, visit.site.now()) {
        Ok(displaces) => {
            visit.count_displaced(displaces);
            Ok(())
        }
        Err(Full { bound }) => Err(Error::Full { bound }),
    }
}

/// Appends what comes next, so many bytes at most; returns whether anything can still come. Nothing is lost if
/// this is dropped while it waits.
async fn read(stream: &mut Box<dyn Bytes>, into: &mut Vec<u8>, at_once: usize) -> io::Result<bool> {
    into.reserve(at_once);
    Ok(stream.take(at_once as u64).read_buf(into).await? > 0)
}

/// Waits until the server is shut down or gone.
async fn closed(closing: &mut watch::Receiver<bool>) {
    let _ = closing.wait_for(|closing| *closing).await;
}

/// Sleeps until then; for ever if there is no such time.
async fn sleep_until(time: Option<Instant>) {
    match time {
        Some(time) => tokio::time::sleep_until(time).await,
        None => std::future::pending().await,
    }
}
