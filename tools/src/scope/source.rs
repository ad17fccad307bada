//! The connection to a controller's scope, in a thread of its own: WebSocket `/scope`. What is not taken from it stops its reading,
//! so that the controller counts what is lost.

use std::io;
use std::net::TcpStream;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, channel, sync_channel};
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use tungstenite::client::IntoClientRequest as _;
use tungstenite::handshake::HandshakeError;
use tungstenite::http::header::{AUTHORIZATION, HeaderValue};
use tungstenite::{Message, WebSocket};

use super::wire::{Event, Request, decode_frame, decode_text};
use crate::http::Http;
use crate::output::chain;

/// Events that were not taken yet.
const AHEAD_MAX: usize = 64;

/// How often the end of the command is looked for while nothing comes.
const TICK: Duration = Duration::from_millis(100);

/// How often the controller is asked whether it is there.
const PING_INTERVAL: Duration = Duration::from_secs(1);

/// After this time without anything from the controller the connection is lost.
const SILENCE_MAX: Duration = Duration::from_secs(5);

/// Until the next connection after one was lost.
const RETRY_AFTER: Duration = Duration::from_secs(1);

/// The thread, which ends when this is dropped.
#[derive(Debug)]
pub(crate) struct Source {
    events: Receiver<Event>,
    _end: Sender<()>,
}

impl Source {
    /// Connects, again and again if it `retries`.
    pub(crate) fn start(http: Http, request: Request, retries: bool) -> Self {
        let (sender, events) = sync_channel(AHEAD_MAX);
        let (end, ended) = channel::<()>();
        std::thread::spawn(move || {
            loop {
                let Err(why) = serve(&http, &request, &sender, &ended) else {
                    return;
                };
                let is_over = sender.send(Event::Closed(chain(&why))).is_err();
                if is_over || !retries || is_ended(&ended, RETRY_AFTER) {
                    return;
                }
            }
        });
        Self { events, _end: end }
    }

    /// The next event; `None` if none comes in time, or the thread has ended.
    pub(crate) fn next(&self, wait: Duration) -> Option<Event> {
        self.events.recv_timeout(wait).ok()
    }
}

fn is_ended(ended: &Receiver<()>, wait: Duration) -> bool {
    ended.recv_timeout(wait) != Err(RecvTimeoutError::Timeout)
}

/// A connection until it is lost, or nothing takes its events any more.
fn serve(
    http: &Http,
    request: &Request,
    events: &SyncSender<Event>,
    ended: &Receiver<()>,
) -> anyhow::Result<()> {
    let mut socket = open(http)?;
    let text = serde_json::to_string(request)?;
    socket.send(Message::text(text))?;
    let (mut received_at, mut pinged) = (Instant::now(), Instant::now());
    while !is_ended(ended, Duration::ZERO) {
        let event = match socket.read() {
            Ok(Message::Text(text)) => decode_text(&text)?,
            Ok(Message::Binary(bytes)) => Some(Event::Frame(decode_frame(&bytes)?)),
            Ok(Message::Close(frame)) => {
                let why = frame.map(|frame| frame.reason.to_string());
                let why = why.filter(|why| !why.is_empty());
                bail!(why.unwrap_or_else(|| "the controller closed the connection".to_owned()));
            }
            Ok(Message::Ping(_) | Message::Pong(_) | Message::Frame(_)) => None,
            Err(tungstenite::Error::Io(error)) if is_timeout(&error) => {
                if received_at.elapsed() > SILENCE_MAX {
                    bail!("the controller has not answered within {SILENCE_MAX:?}");
                }
                if pinged.elapsed() > PING_INTERVAL {
                    pinged = Instant::now();
                    socket.send(Message::Ping(Vec::new().into()))?;
                }
                continue;
            }
            Err(error) => return Err(error).context("the connection was lost"),
        };
        received_at = Instant::now();
        if let Some(event) = event
            && events.send(event).is_err()
        {
            return Ok(());
        }
    }
    Ok(())
}

fn is_timeout(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut
    )
}

fn open(http: &Http) -> anyhow::Result<WebSocket<TcpStream>> {
    let address = http.address();
    let mut request = format!("ws://{address}/scope")
        .into_client_request()
        .with_context(|| format!("{address} is no address\nhint: write HOST:PORT"))?;
    if let Some(token) = http.token() {
        let bearer = HeaderValue::from_str(&format!("Bearer {}", token.text()));
        request.headers_mut().insert(AUTHORIZATION, bearer?);
    }
    let stream = http.connect()?;
    let opened = tungstenite::client(request, stream);
    let (socket, _) = opened.map_err(|error| match error {
        HandshakeError::Failure(tungstenite::Error::Http(response)) => {
            let status = response.status();
            let body = response.body().as_deref().unwrap_or_default();
            let body = String::from_utf8_lossy(body);
            let why = body.trim().to_owned();
            if status == 404 {
                anyhow::anyhow!(
                    "{address}: this controller has no scope\nhint: use a `takt run` of this version"
                )
            } else if why.is_empty() {
                anyhow::anyhow!("{address}: {status}")
            } else {
                anyhow::anyhow!("{address}: {why}")
            }
        }
        HandshakeError::Failure(error) => {
            anyhow::Error::from(error).context(format!("{address}: cannot open the scope"))
        }
        HandshakeError::Interrupted(_) => anyhow::anyhow!(
            "{address}: the controller has not answered\nhint: see its log, and the load of its host"
        ),
    })?;
    socket.get_ref().set_read_timeout(Some(TICK))?;
    Ok(socket)
}
