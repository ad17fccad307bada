//! One connection: bytes in, bytes out, and the calls of the [`Connection`] between them, made
//! in threads that may block. It opens and ends no session.

use std::io;
use std::net::{IpAddr, Ipv4Addr};
use std::sync::Arc;
use std::time::Duration;

use takt_core::SessionId;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::sync::{Notify, watch};
use tokio::task::JoinError;
use tokio::time::{Instant, timeout};

use super::{CONNECTIONS_MAX, Kind, Visit};
use crate::access::{Admission, TOKEN_CHARS_MAX};
use crate::codec::{Codec, Received};
use crate::dio::Connection;
use crate::error::Error;
use crate::http::{self, DebugStream};
use crate::site::Counters;
use crate::wire::Message;
use crate::wire::lines::LineReader;
use crate::wire::websocket::FrameReader;

/// Bytes read at once.
const READ_BYTES: usize = 64 << 10;

/// How long a client may take to send its request.
const REQUEST_WITHIN: Duration = Duration::from_secs(10);

/// Most bytes of a line before the token was given.
const TOKEN_LINE_BYTES_MAX: usize = 2 * TOKEN_CHARS_MAX;

/// How often a debug stream sends.
const STREAM_EVERY: Duration = Duration::from_millis(100);

/// How long a client may take to close after it was answered.
const CLOSE_WITHIN: Duration = Duration::from_secs(1);

/// How long a client may take to read what is sent before it counts as lost.
const WRITE_WITHIN: Duration = Duration::from_secs(10);

/// A connection that did not end by itself.
pub(super) struct Failure {
    /// Why.
    pub(super) error: Error,
    /// Sessions that it had opened.
    pub(super) opened: Vec<SessionId>,
}

/// Serves one client to its end; returns the sessions that it opened and did not end.
pub(super) async fn serve(
    stream: TcpStream,
    kind: Kind,
    visit: &Visit,
) -> Result<Vec<SessionId>, Failure> {
    let mut link = Link::new(stream, kind, visit);
    let ended = match kind {
        Kind::Tcp => link.serve_lines(visit).await,
        Kind::Http => link.serve_http(visit).await,
    };
    let opened = link.opened;
    match ended {
        Ok(()) => Ok(opened),
        Err(error) => Err(Failure { error, opened }),
    }
}

/// Tells a client that there is no room for it, without waiting for it to listen.
pub(super) fn refuse(stream: TcpStream, kind: Kind) {
    let text = match kind {
        Kind::Http => http::too_many_connections(CONNECTIONS_MAX).to_string(),
        Kind::Tcp => {
            let why = format!("too many connections: at most {CONNECTIONS_MAX}; close one first");
            format!("{}\n", Message::new("none", "err").with(why))
        }
    };
    tracing::warn!("refusing a connection: there are {CONNECTIONS_MAX} already");
    // Whether it arrives is not our concern any more.
    let _ = stream.try_write(text.as_bytes());
}

struct Link {
    stream: TcpStream,
    peer: String,
    address: IpAddr,
    counters: Arc<Counters>,
    codec: Codec,
    /// Away only while a blocking thread has it; lost if that thread panics.
    connection: Option<Connection>,
    /// Sessions that it opened and did not end, as of the last work that it finished.
    opened: Vec<SessionId>,
    begin: Instant,
}

impl Link {
    fn new(stream: TcpStream, kind: Kind, visit: &Visit) -> Self {
        let peer = stream
            .peer_addr()
            .map_or_else(|e| e.to_string(), |a| a.to_string());
        let codec = match kind {
            Kind::Tcp if visit.site.gate.is_open() => Codec::Plain(LineReader::default()),
            Kind::Tcp => Codec::Plain(LineReader::bounded(TOKEN_LINE_BYTES_MAX)),
            Kind::Http => Codec::WebSocket(FrameReader::default()),
        };
        let address = stream.peer_addr().map(|a| a.ip());
        let address = address.unwrap_or(IpAddr::V4(Ipv4Addr::UNSPECIFIED));
        let site = &visit.site;
        let connection = Connection::new(site.controller.clone()).with_on_loss(site.on_loss);
        let connection = match kind {
            Kind::Tcp => connection.behind(&site.gate, address, visit.begin.elapsed()),
            // Its request carries the token.
            Kind::Http => connection,
        };
        Self {
            stream,
            peer,
            address,
            counters: Arc::clone(&site.counters),
            codec,
            connection: Some(connection),
            opened: Vec::new(),
            begin: Instant::now(),
        }
    }

    async fn serve_http(&mut self, visit: &Visit) -> Result<(), Error> {
        let request = timeout(REQUEST_WITHIN, self.read_request(visit)).await;
        let response = match request {
            Ok(Ok(Some(http::Answer::Upgrade(text)))) => {
                self.send(text.as_bytes()).await?;
                return self.serve_lines(visit).await;
            }
            Ok(Ok(Some(http::Answer::Serve(request)))) => {
                Counters::add(&self.counters.requests, 1);
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
            Ok(Ok(Some(http::Answer::Continue(_)) | None)) => return Ok(()),
            Ok(Err(error)) => return Err(error),
            Err(_) => return Err(self.broken(io::ErrorKind::TimedOut.into())),
        };
        self.send(response.to_string().as_bytes()).await?;
        self.finish().await
    }

    async fn respond(
        &self,
        request: http::Request,
        visit: &Visit,
    ) -> Result<http::Response, Error> {
        let broken = |e: JoinError| self.broken(io::Error::other(e));
        let _place = match request.path.first().map(String::as_str) {
            // The semaphore is never closed.
            Some("eval") => visit.evaluations.acquire().await.ok(),
            _ => None,
        };
        let site = visit.site.clone();
        let work = move || http::respond(&site, &request);
        tokio::task::spawn_blocking(work).await.map_err(broken)
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
                _ = read(&mut self.stream, &mut received) => return Ok(()),
                () = tokio::time::sleep(STREAM_EVERY) => {}
            }
        }
    }

    /// Reads a request; what follows its head belongs to the frames if it asks for WebSocket.
    async fn read_request(&mut self, visit: &Visit) -> Result<Option<http::Answer>, Error> {
        let (gate, counters) = (Arc::clone(&visit.site.gate), Arc::clone(&self.counters));
        let address = self.address;
        let admit = |given: Option<&str>| {
            let admission = gate.check(address, given, visit.begin.elapsed());
            let denied = given.is_some() && admission != Admission::Admitted;
            Counters::add(&counters.denied, denied.into());
            admission
        };
        let (mut received, mut continued) = (Vec::new(), false);
        while self.read(&mut received).await? {
            match http::answer(&received, continued, &admit) {
                Some((_, http::Answer::Continue(text))) => {
                    continued = true;
                    self.send(text.as_bytes()).await?;
                }
                Some((length, answer)) => {
                    self.codec.push(received.get(length..).unwrap_or_default());
                    return Ok(Some(answer));
                }
                None => {}
            }
        }
        Ok(None)
    }

    /// Closes this side and lets the client close its own: what it still sends, such as the rest
    /// of a body that is too long, would otherwise make its system throw the response away.
    async fn finish(&mut self) -> Result<(), Error> {
        self.stream.shutdown().await.map_err(|e| self.broken(e))?;
        let rest = async {
            let mut bytes = Vec::new();
            while self.read(&mut bytes).await.is_ok_and(|more| more) {
                bytes.clear();
            }
        };
        // A client that does not close has had its response all the same.
        let _ = timeout(CLOSE_WITHIN, rest).await;
        Ok(())
    }

    async fn serve_lines(&mut self, visit: &Visit) -> Result<(), Error> {
        // Delayed small packets would delay replies by tens of milliseconds.
        self.stream.set_nodelay(true).map_err(|e| self.broken(e))?;
        let changed = Arc::new(Notify::new());
        let wake = Arc::clone(&changed);
        let _watch = visit.site.controller.on_change(move || wake.notify_one());
        let mut closing = visit.closing.clone();
        let mut received = Vec::with_capacity(READ_BYTES);
        let admitted_by = Instant::now() + REQUEST_WITHIN;
        loop {
            if !self.handle_received().await? {
                return Ok(());
            }
            let next = self.connection.as_ref().and_then(Connection::poll_timeout);
            let next = next.map(|at| self.begin + at);
            tokio::select! {
                biased;
                () = closed(&mut closing) => return Ok(()),
                // Before what comes: a client that is never silent is ended too.
                () = tokio::time::sleep_until(admitted_by), if !self.is_admitted() => {
                    return Err(self.broken(io::ErrorKind::TimedOut.into()));
                }
                alive = read(&mut self.stream, &mut received) => {
                    if !alive.map_err(|e| self.broken(e))? {
                        return Ok(());
                    }
                    self.codec.push(&received);
                    received.clear();
                }
                () = changed.notified() => self.push(true).await?,
                () = sleep_until(next) => self.push(false).await?,
            }
        }
    }

    /// Handles all lines that have come whole; returns whether the connection goes on.
    async fn handle_received(&mut self) -> Result<bool, Error> {
        loop {
            match self.codec.poll() {
                Ok(None) => return Ok(true),
                Ok(Some(Received::Line(line))) => {
                    Counters::add(&self.counters.received, 1);
                    let before = self.is_admitted();
                    self.with_connection(move |c, now| {
                        let mut out = c.handle_line(&line, now);
                        out.extend(c.poll_pushes(now));
                        out
                    })
                    .await?;
                    if self.connection.as_ref().is_some_and(Connection::is_refused) {
                        Counters::add(&self.counters.denied, 1);
                        return Ok(false);
                    }
                    if !before && self.is_admitted() {
                        self.codec.unbind();
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

    /// Whether the client gave the token it needs.
    fn is_admitted(&self) -> bool {
        self.connection.as_ref().is_none_or(Connection::is_admitted)
    }

    async fn push(&mut self, changed: bool) -> Result<(), Error> {
        self.with_connection(move |c, now| {
            if changed {
                c.handle_change();
            }
            c.poll_pushes(now)
        })
        .await
    }

    /// Lets the connection work in a thread that may block, and sends what it says.
    async fn with_connection(
        &mut self,
        work: impl FnOnce(&mut Connection, Duration) -> Vec<String> + Send + 'static,
    ) -> Result<(), Error> {
        let now = self.begin.elapsed();
        let Some(mut connection) = self.connection.take() else {
            return Ok(());
        };
        let worked = tokio::task::spawn_blocking(move || {
            let lines = work(&mut connection, now);
            (connection, lines)
        });
        let (connection, lines) = worked.await.map_err(|e| self.broken(io::Error::other(e)))?;
        self.opened = connection.opened_sessions().to_vec();
        self.connection = Some(connection);
        self.send_lines(&lines).await
    }

    async fn send_lines(&mut self, lines: &[String]) -> Result<(), Error> {
        Counters::add(&self.counters.sent, lines.len() as u64);
        let mut bytes = Vec::new();
        for line in lines {
            self.codec.write(line, &mut bytes);
        }
        self.send(&bytes).await
    }

    async fn send(&mut self, bytes: &[u8]) -> Result<(), Error> {
        let sent = timeout(WRITE_WITHIN, self.stream.write_all(bytes)).await;
        sent.unwrap_or_else(|_| Err(io::ErrorKind::TimedOut.into()))
            .map_err(|e| self.broken(e))
    }

    async fn read(&mut self, into: &mut Vec<u8>) -> Result<bool, Error> {
        read(&mut self.stream, into)
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

/// Appends what comes next; returns whether anything can still come. Nothing is lost if this is
/// dropped while it waits.
async fn read(stream: &mut TcpStream, into: &mut Vec<u8>) -> io::Result<bool> {
    into.reserve(READ_BYTES);
    Ok(stream.read_buf(into).await? > 0)
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
