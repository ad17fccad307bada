//! One connection: bytes in, bytes out, and the calls of the [`Connection`] between them, made
//! in threads that may block. It opens and ends no session.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use takt_core::SessionId;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::sync::{Notify, watch};
use tokio::time::{Instant, timeout};

use super::{CONNECTIONS_MAX, Kind, Visit};
use crate::codec::{Codec, Received};
use crate::dio::Connection;
use crate::error::Error;
use crate::http;
use crate::wire::Message;
use crate::wire::lines::LineReader;
use crate::wire::websocket::FrameReader;

/// Bytes read at once.
const READ_BYTES: usize = 64 << 10;

/// How long a client may take to send its request.
const REQUEST_WITHIN: Duration = Duration::from_secs(10);

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
    let opened = link
        .connection
        .map(|c| c.opened_sessions().to_vec())
        .unwrap_or_default();
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
    codec: Codec,
    /// Away only while a blocking thread has it; lost if that thread panics.
    connection: Option<Connection>,
    begin: Instant,
}

impl Link {
    fn new(stream: TcpStream, kind: Kind, visit: &Visit) -> Self {
        let peer = stream
            .peer_addr()
            .map_or_else(|e| e.to_string(), |a| a.to_string());
        let codec = match kind {
            Kind::Tcp => Codec::Plain(LineReader::default()),
            Kind::Http => Codec::WebSocket(FrameReader::default()),
        };
        let connection = Some(Connection::new(visit.controller.clone()));
        Self {
            stream,
            peer,
            codec,
            connection,
            begin: Instant::now(),
        }
    }

    async fn serve_http(&mut self, visit: &Visit) -> Result<(), Error> {
        let request = timeout(REQUEST_WITHIN, self.read_request()).await;
        let response = match request {
            Ok(Ok(Some(http::Answer::Upgrade(text)))) => {
                self.send(text.as_bytes()).await?;
                return self.serve_lines(visit).await;
            }
            Ok(Ok(Some(http::Answer::Serve(request)))) => {
                let controller = visit.controller.clone();
                let work = move || http::respond(&controller, &request);
                let worked = tokio::task::spawn_blocking(work).await;
                worked.map_err(|e| self.broken(io::Error::other(e)))?
            }
            Ok(Ok(Some(http::Answer::Refuse(response)))) => response,
            Ok(Ok(Some(http::Answer::Continue(_)) | None)) => return Ok(()),
            Ok(Err(error)) => return Err(error),
            Err(_) => return Err(self.broken(io::ErrorKind::TimedOut.into())),
        };
        self.send(response.to_string().as_bytes()).await?;
        self.finish().await
    }

    /// Reads a request; what follows its head belongs to the frames if it asks for WebSocket.
    async fn read_request(&mut self) -> Result<Option<http::Answer>, Error> {
        let (mut received, mut continued) = (Vec::new(), false);
        while self.read(&mut received).await? {
            match http::answer(&received, continued) {
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
        let _watch = visit.controller.on_change(move || wake.notify_one());
        let mut closing = visit.closing.clone();
        let mut received = Vec::with_capacity(READ_BYTES);
        loop {
            if !self.handle_received().await? {
                return Ok(());
            }
            let next = self.connection.as_ref().and_then(Connection::poll_timeout);
            let next = next.map(|at| self.begin + at);
            tokio::select! {
                biased;
                () = closed(&mut closing) => return Ok(()),
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
                    self.with_connection(move |c, now| {
                        let mut out = c.handle_line(&line, now);
                        out.extend(c.poll_pushes(now));
                        out
                    })
                    .await?;
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
        self.connection = Some(connection);
        self.send_lines(&lines).await
    }

    async fn send_lines(&mut self, lines: &[String]) -> Result<(), Error> {
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
