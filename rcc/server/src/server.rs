//! Listening, and one task per connection that moves bytes between a socket and a
//! [`Connection`](crate::dio::Connection). What the lines mean is not decided here.

mod link;
pub mod local;
mod loss;
mod places;

use std::net::{IpAddr, SocketAddr};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use takt_core::{Controller, SessionId};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Semaphore, watch};
use tokio::task::JoinSet;

use crate::access::origin::Origins;
use crate::access::{Gate, Peer, Token};
use crate::error::Error;
use crate::http::DEBUG_STREAMS_MAX;
use crate::log::LogBook;
use crate::sessions::LEFT_WITHIN;
use crate::site::{Counters, Limits, Site, StopPort};
use local::{Local, LocalSocket};
use places::{Place, Places};

pub use places::{
    CONNECTIONS_MAX, CONNECTIONS_PER_ADDRESS, IDLE_DISPLACED, PLACES_MAX, REQUESTS_MAX,
    WAITING_MAX, WAITING_PER_ADDRESS,
};

/// Nets that are evaluated at once; others wait.
pub const EVALUATIONS_MAX: usize = 2;

/// How often sessions that were left, and lines that were not logged, are looked after.
const HOUSEKEEPING_EVERY: Duration = Duration::from_secs(10);

/// How long connections may take to end when the server is shut down.
const SHUTDOWN_WITHIN: Duration = Duration::from_secs(3);

/// A silent connection is probed after so many seconds, as often, and so many times before it is lost.
const KEEP_ALIVE_IDLE_S: u32 = 30;
/// See [`KEEP_ALIVE_IDLE_S`].
const KEEP_ALIVE_INTERVAL_S: u32 = 10;
/// See [`KEEP_ALIVE_IDLE_S`].
const KEEP_ALIVE_COUNT: u32 = 3;

/// Pause after a connection could not be accepted, so that a lack of files is no busy loop.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);

pub use takt_core::{Loopback, OnLoss};

/// Where a server listens and how it behaves. Port 0 takes any free port.
#[derive(Clone, Debug, Default)]
pub struct ServerConfig {
    /// For HTTP and WebSocket; `None` for not at all.
    pub http: Option<SocketAddr>,
    /// For lines over plain TCP; `None` for not at all.
    pub tcp: Option<SocketAddr>,
    /// For lines over a Unix socket; `None` for not at all.
    pub local: Option<LocalSocket>,
    /// What becomes of nets whose client is gone, unless their session says otherwise. `None`: they end, but
    /// for WebSocket clients that name no version, which expect their nets to run on.
    pub on_loss: Option<OnLoss>,
    /// What clients must give; `None` for nothing, on loopback only.
    pub token: Option<Token>,
    /// Whether clients on loopback must give it; `None`: if there is one.
    pub loopback: Option<Loopback>,
    /// Names of this host by which requests without a token may address it, beside `localhost` and addresses.
    pub hosts: Vec<String>,
    /// Origins of pages of other servers that may send requests.
    pub origins: Vec<String>,
    /// The log that is shown.
    pub log: LogBook,
    /// The port of the stop channel, for the page.
    pub stop: Option<StopPort>,
}

/// A server that listens but does not answer yet.
#[derive(Debug)]
pub struct Server {
    http: Option<TcpListener>,
    tcp: Option<TcpListener>,
    local: Option<Local>,
    on_loss: Option<OnLoss>,
    gate: Gate,
    origins: Origins,
    log: LogBook,
    stop: Option<StopPort>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Http,
    Lines,
}

/// What a connection needs of its server.
struct Visit {
    site: Site,
    peer: Peer,
    /// The peer, for people.
    name: String,
    /// The address that the connection came to.
    reached: Option<IpAddr>,
    place: Place,
    streams: Arc<Semaphore>,
    evaluations: Arc<Semaphore>,
    /// Turns true when the server is shut down.
    closing: watch::Receiver<bool>,
}

impl Visit {
    /// Counts and logs that another connection had to leave for this one.
    fn count_displaced(&self, displaces: bool) {
        if displaces {
            Counters::add(&self.site.counters.refused, 1);
            let line = "a connection had to leave for another one: too many wait, or it was idle";
            self.site.warn(|limits: &Limits| &limits.places, line);
        }
    }
}

/// A connection as it was accepted.
struct Accepted {
    stream: Box<dyn link::Bytes>,
    kind: Kind,
    peer: Peer,
    name: String,
    reached: Option<IpAddr>,
}

impl Server {
    /// Begins to listen.
    ///
    /// # Errors
    /// If an address is not one of loopback and there is no token, or it cannot be had.
    pub async fn bind(config: ServerConfig) -> Result<Self, Error> {
        let ServerConfig {
            http,
            tcp,
            local,
            on_loss,
            token,
            loopback,
            hosts,
            origins,
            log,
            stop,
        } = config;
        let guarded = token.is_some();
        let local = match local {
            Some(socket) => Some(Local::bind(&socket).await?),
            None => None,
        };
        Ok(Self {
            http: listen(http, guarded).await?,
            tcp: listen(tcp, guarded).await?,
            local,
            on_loss,
            gate: Gate::new(token, loopback),
            origins: Origins { hosts, origins },
            log,
            stop,
        })
    }

    /// Where the Unix socket is.
    #[must_use]
    pub fn local_path(&self) -> Option<&Path> {
        self.local.as_ref().map(Local::path)
    }

    /// Where WebSocket connections are taken.
    #[must_use]
    pub fn http_address(&self) -> Option<SocketAddr> {
        self.http.as_ref().and_then(|l| l.local_addr().ok())
    }

    /// Where plain connections are taken.
    #[must_use]
    pub fn tcp_address(&self) -> Option<SocketAddr> {
        self.tcp.as_ref().and_then(|l| l.local_addr().ok())
    }

    /// Serves clients until `shutdown` is over, then closes their connections.
    pub async fn run(self, controller: Controller, shutdown: impl Future<Output = ()>) {
        let places = Places::default();
        let streams = Arc::new(Semaphore::new(DEBUG_STREAMS_MAX));
        let evaluations = Arc::new(Semaphore::new(EVALUATIONS_MAX));
        let site = Site {
            origins: Arc::new(self.origins),
            on_loss: self.on_loss,
            ..Site::new(controller, self.gate, self.log).with_stop(self.stop)
        };
        let (close, closing) = watch::channel(false);
        let mut visits = JoinSet::new();
        let mut housekeeping = tokio::time::interval(HOUSEKEEPING_EVERY);
        tokio::pin!(shutdown);
        loop {
            let accepted = tokio::select! {
                () = &mut shutdown => break,
                accepted = accept_local(self.local.as_ref(), &site) => accepted,
                accepted = accept(self.http.as_ref(), Kind::Http, &site) => accepted,
                accepted = accept(self.tcp.as_ref(), Kind::Lines, &site) => accepted,
                Some(ended) = visits.join_next() => {
                    report(ended);
                    continue;
                }
                _ = housekeeping.tick() => {
                    keep_house(&site);
                    continue;
                }
            };
            let (place, displaces) = places.enter(accepted.peer, site.now());
            let visit = Visit {
                site: site.clone(),
                peer: accepted.peer,
                name: accepted.name,
                reached: accepted.reached,
                place,
                streams: Arc::clone(&streams),
                evaluations: Arc::clone(&evaluations),
                closing: closing.clone(),
            };
            visit.count_displaced(displaces);
            visits.spawn(serve(accepted.stream, accepted.kind, visit));
        }
        // Nobody is left to listen if all connections have ended already.
        let _ = close.send(true);
        let all = async { while visits.join_next().await.is_some() {} };
        if tokio::time::timeout(SHUTDOWN_WITHIN, all).await.is_err() {
            tracing::warn!("some connections did not end within {SHUTDOWN_WITHIN:?}");
        }
    }
}

/// Ends sessions that nobody came back for, and reports what was not logged.
fn keep_house(site: &Site) {
    site.flush_log();
    let site = site.clone();
    tokio::task::spawn_blocking(move || {
        let now = site.now();
        let ended = site
            .sessions
            .end_left(&site.controller, now, LEFT_WITHIN, usize::MAX);
        if ended > 0 {
            tracing::info!("{ended} empty sessions of lost clients ended");
        }
    });
}

async fn listen(address: Option<SocketAddr>, guarded: bool) -> Result<Option<TcpListener>, Error> {
    let Some(address) = address else {
        return Ok(None);
    };
    if !guarded && !address.ip().is_loopback() {
        return Err(Error::NotLoopback(address));
    }
    let listener = TcpListener::bind(address).await;
    listener
        .map(Some)
        .map_err(|source| Error::Listen { address, source })
}

/// The next connection over the network; never over if there is nothing to listen at.
async fn accept(listener: Option<&TcpListener>, kind: Kind, site: &Site) -> Accepted {
    let Some(listener) = listener else {
        return std::future::pending().await;
    };
    loop {
        match listener.accept().await {
            Ok((stream, peer)) => {
                keep_alive(&stream);
                return Accepted {
                    kind,
                    peer: Peer::Address(peer.ip()),
                    name: peer.to_string(),
                    reached: stream.local_addr().ok().map(|address| address.ip()),
                    stream: Box::new(stream),
                };
            }
            Err(error) => not_accepted(site, &error).await,
        }
    }
}

/// The same of the Unix socket, for accounts that are admitted.
async fn accept_local(local: Option<&Local>, site: &Site) -> Accepted {
    let Some(local) = local else {
        return std::future::pending().await;
    };
    loop {
        match local.accept().await {
            Ok(stream) if local.admits(&stream) => {
                return Accepted {
                    stream: Box::new(stream),
                    kind: Kind::Lines,
                    peer: Peer::Local,
                    name: local.path().display().to_string(),
                    reached: None,
                };
            }
            Ok(stream) => {
                Counters::add(&site.counters.denied, 1);
                let uid = stream.peer_cred().map(|account| account.uid());
                let line = format!("account {uid:?} is refused at the Unix socket");
                site.warn(|limits: &Limits| &limits.denials, &line);
            }
            Err(error) => not_accepted(site, &error).await,
        }
    }
}

async fn not_accepted(site: &Site, error: &std::io::Error) {
    let line = format!("cannot accept a connection: {error}");
    site.warn(|limits: &Limits| &limits.places, &line);
    tokio::time::sleep(ACCEPT_PAUSE).await;
}

/// Has the system find out when the other host is gone without a word, and replies sent at once: delayed small
/// packets would delay them by tens of milliseconds. A connection without either works too.
fn keep_alive(stream: &TcpStream) {
    use nix::sys::socket::{setsockopt, sockopt};
    let _ = stream.set_nodelay(true);
    let _ = setsockopt(stream, sockopt::KeepAlive, &true);
    let _ = setsockopt(stream, sockopt::TcpKeepIdle, &KEEP_ALIVE_IDLE_S);
    let _ = setsockopt(stream, sockopt::TcpKeepInterval, &KEEP_ALIVE_INTERVAL_S);
    let _ = setsockopt(stream, sockopt::TcpKeepCount, &KEEP_ALIVE_COUNT);
}

async fn serve(stream: Box<dyn link::Bytes>, kind: Kind, visit: Visit) {
    let name = visit.name.as_str();
    tracing::debug!(name, ?kind, "connection begins");
    let counters = &visit.site.counters;
    Counters::add(&counters.connections, 1);
    Counters::add(&counters.clients, 1);
    let opened = match link::serve(stream, kind, &visit).await {
        Ok(opened) => opened,
        Err(link::Failure { error, opened }) => {
            if let Error::Full { .. } = error {
                Counters::add(&counters.refused, 1);
            }
            let line = format!("connection of {name} fails: {error}");
            visit.site.warn(|limits: &Limits| &limits.failures, &line);
            opened
        }
    };
    tracing::debug!(name, "connection ends");
    counters.clients.fetch_sub(1, Ordering::Relaxed);
    let Visit { site, place, .. } = visit;
    // What follows may take seconds, and is no connection any more.
    drop(place);
    let controller = &site.controller;
    let ends = |id: &SessionId| controller.session_on_loss(*id) == Some(OnLoss::End);
    let (lost, left): (Vec<_>, Vec<_>) = opened.into_iter().partition(ends);
    for session in left {
        site.sessions.leave(session, site.now());
    }
    if !lost.is_empty() {
        loss::end_sessions(controller, lost, loss::CANCEL_WITHIN).await;
    }
}

fn report(ended: Result<(), tokio::task::JoinError>) {
    if let Err(error) = ended {
        tracing::error!(%error, "a connection ended by a fault of the server");
    }
}
