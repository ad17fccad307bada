//! Listeners, and one task per connection that moves bytes between a socket and a
//! `dio::Connection`. The meaning of the lines is not known here.

mod link;
pub mod local;
mod loss;
mod slots;

use std::net::{IpAddr, SocketAddr};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use takt_client::Token;
use takt_core::{Controller, SessionId};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Semaphore, watch};
use tokio::task::JoinSet;

use crate::access::origin::Origins;
use crate::access::{Gate, Peer};
use crate::error::Error;
use crate::host_program::HostProgram;
use crate::http::DEBUG_STREAMS_MAX;
use crate::live::{Actions, Datagrams, Drain, Hub, LiveConfig, Messages, Task};
use crate::log::LogBook;
use crate::scope::SCOPES_MAX;
use crate::sessions::ORPHAN_TIMEOUT;
use crate::site::{Counters, Limits, Site, StopPort};
use local::{Local, LocalSocket};
use slots::{Slot, Slots};

pub use slots::{
    CONNECTIONS_MAX, CONNECTIONS_PER_ADDRESS, IDLE_EVICTED_AFTER, REQUESTS_MAX, SLOTS_MAX,
    WAITING_MAX, WAITING_PER_ADDRESS,
};

/// Nets evaluated at the same time; further requests wait.
pub(crate) const EVALUATIONS_MAX: usize = 2;

/// Interval in which orphaned sessions are ended and suppressed log lines are reported.
const HOUSEKEEPING_INTERVAL: Duration = Duration::from_secs(10);

/// Grace period of connections when the server shuts down.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_secs(3);

/// TCP keep-alive: idle time before the first probe, interval of probes, and probes until the connection is lost.
const KEEP_ALIVE_IDLE_S: u32 = 30;
/// Bytes that wait in the host for a client: one that reads slowly gets values of a fraction of a second ago, and its losses
/// are counted here; the host would hold megabytes.
const SEND_BUFFER_BYTES: usize = 192 << 10;
/// See [`KEEP_ALIVE_IDLE_S`].
const KEEP_ALIVE_INTERVAL_S: u32 = 10;
/// See [`KEEP_ALIVE_IDLE_S`].
const KEEP_ALIVE_COUNT: u32 = 3;

/// Delay after a failed accept, so that a lack of file descriptors causes no busy loop.
const ACCEPT_RETRY_DELAY: Duration = Duration::from_millis(100);

pub use takt_core::{Loopback, OnLoss};

/// Configuration of a server. Port 0 selects any free port.
#[derive(Clone, Debug, Default)]
pub struct ServerConfig {
    /// Address for HTTP and WebSocket; `None` disables them.
    pub http: Option<SocketAddr>,
    /// Address for lines over plain TCP; `None` disables them.
    pub tcp: Option<SocketAddr>,
    /// Unix socket for lines; `None` disables it.
    pub local: Option<LocalSocket>,
    /// What happens to the nets of a lost client, unless their session sets it. `None`: they end, except those of
    /// WebSocket clients that name no version, which expect their nets to run on.
    pub on_loss: Option<OnLoss>,
    /// The token that clients must send; `None` for none, which is permitted on loopback only.
    pub token: Option<Token>,
    /// Whether loopback clients must send it; `None`: if there is one.
    pub loopback: Option<Loopback>,
    /// Host names by which requests without a token may address this server, besides `localhost` and addresses.
    pub hosts: Vec<String>,
    /// Page origins of other servers that may send requests.
    pub origins: Vec<String>,
    /// The log that clients can read.
    pub log: LogBook,
    /// The port of the stop channel, for the page.
    pub stop: Option<StopPort>,
    /// What is sent to other tools.
    pub live: LiveConfig,
    /// The program that runs the server, if it adds something to the page.
    pub program: Option<Arc<dyn HostProgram>>,
}

/// A server whose listeners are bound but that does not serve yet.
#[derive(Debug)]
pub struct Server {
    http: Option<TcpListener>,
    tcp: Option<TcpListener>,
    live: Option<TcpListener>,
    live_config: LiveConfig,
    local: Option<Local>,
    on_loss: Option<OnLoss>,
    gate: Gate,
    origins: Origins,
    log: LogBook,
    stop: Option<StopPort>,
    program: Option<Arc<dyn HostProgram>>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Http,
    Live,
    Lines,
}

/// What a connection gets from its server.
struct ConnectionContext {
    site: Site,
    peer: Peer,
    /// The peer's address as text, for the log.
    name: String,
    /// The local address of the connection.
    reached: Option<IpAddr>,
    slot: Slot,
    streams: Arc<Semaphore>,
    scopes: Arc<Semaphore>,
    evaluations: Arc<Semaphore>,
    /// What clients of live data can request; `None` without such clients.
    live: Option<Actions>,
    /// Page origins of those clients.
    live_origins: Arc<Origins>,
    /// True once the server shuts down.
    shutdown: watch::Receiver<bool>,
}

impl ConnectionContext {
    /// Counts and logs that another connection was evicted for this one.
    fn count_eviction(&self, evicts: bool) {
        if evicts {
            Counters::add(&self.site.counters.refused, 1);
            let line =
                "a connection was evicted for another one: too many are waiting, or it was idle";
            self.site.warn(|limits: &Limits| &limits.slots, line);
        }
    }
}

/// An accepted connection.
struct Accepted {
    stream: Box<dyn link::Bytes>,
    kind: Kind,
    peer: Peer,
    name: String,
    reached: Option<IpAddr>,
}

impl Server {
    /// Binds the listeners.
    ///
    /// # Errors
    /// If an address is not a loopback address and there is no token, or it cannot be bound.
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
            program,
            live,
        } = config;
        let guarded = token.is_some();
        let local = match local {
            Some(socket) => Some(Local::bind(&socket).await?),
            None => None,
        };
        Ok(Self {
            http: listen(http, guarded).await?,
            tcp: listen(tcp, guarded).await?,
            live: listen(live.foxglove, guarded).await?,
            live_config: live,
            local,
            on_loss,
            gate: Gate::new(token, loopback),
            origins: Origins {
                hosts,
                origins,
                ..Origins::default()
            },
            log,
            stop,
            program,
        })
    }

    /// Path of the Unix socket.
    pub fn local_path(&self) -> Option<&Path> {
        self.local.as_ref().map(Local::path)
    }

    /// Address for HTTP and WebSocket.
    pub fn http_address(&self) -> Option<SocketAddr> {
        self.http.as_ref().and_then(|l| l.local_addr().ok())
    }

    /// Address for plain TCP.
    pub fn tcp_address(&self) -> Option<SocketAddr> {
        self.tcp.as_ref().and_then(|l| l.local_addr().ok())
    }

    /// Address of the Foxglove WebSocket.
    pub fn foxglove_address(&self) -> Option<SocketAddr> {
        self.live.as_ref().and_then(|l| l.local_addr().ok())
    }

    /// Starts the thread of live data, if any is to be sent.
    fn start_live(
        &self,
        controller: &Controller,
        counters: &Arc<Counters>,
    ) -> Result<(Option<Actions>, Option<Drain>), Error> {
        let config = &self.live_config;
        let every = config.every.max(1);
        let mut tasks: Vec<Box<dyn Task>> = Vec::new();
        let actions = self.live.is_some().then(|| {
            let hub = Arc::new(Hub::new(Arc::clone(counters)));
            let log = self.log.clone();
            tasks.push(Box::new(Messages::new(
                controller,
                every,
                Arc::clone(&hub),
                log,
            )));
            Actions::new(controller.clone(), config.services, every, hub)
        });
        if let Some(to) = config.udp {
            tasks.push(Box::new(Datagrams::new(
                controller.clone(),
                to,
                (&config.probes, every),
                Arc::clone(counters),
            )?));
        }
        let drain = (!tasks.is_empty())
            .then(|| Drain::start(tasks))
            .transpose()?;
        Ok((actions, drain))
    }

    /// Serves clients until `shutdown` completes, then closes their connections.
    pub async fn run(self, controller: Controller, shutdown: impl Future<Output = ()>) {
        let slots = Slots::default();
        let streams = Arc::new(Semaphore::new(DEBUG_STREAMS_MAX));
        let scopes = Arc::new(Semaphore::new(SCOPES_MAX));
        let evaluations = Arc::new(Semaphore::new(EVALUATIONS_MAX));
        let counters = Arc::default();
        let live = self.start_live(&controller, &counters);
        let live = live.unwrap_or_else(|error| {
            tracing::error!("no live data: {error}");
            (None, None)
        });
        let (actions, _drain) = live;
        let live_origins = Arc::new(Origins {
            hosts: self.origins.hosts.clone(),
            origins: self.live_config.origins.clone(),
            section: "[live]",
        });
        let site = Site {
            origins: Arc::new(self.origins),
            on_loss: self.on_loss,
            program: self.program,
            counters,
            ..Site::new(controller, self.gate, self.log).with_stop(self.stop)
        };
        let (shutdown_sender, shutdown_receiver) = watch::channel(false);
        let mut connections = JoinSet::new();
        let mut housekeeping = tokio::time::interval(HOUSEKEEPING_INTERVAL);
        tokio::pin!(shutdown);
        loop {
            let accepted = tokio::select! {
                () = &mut shutdown => break,
                accepted = accept_local(self.local.as_ref(), &site) => accepted,
                accepted = accept(self.http.as_ref(), Kind::Http, &site) => accepted,
                accepted = accept(self.tcp.as_ref(), Kind::Lines, &site) => accepted,
                accepted = accept(self.live.as_ref(), Kind::Live, &site) => accepted,
                Some(ended) = connections.join_next() => {
                    report(ended);
                    continue;
                }
                _ = housekeeping.tick() => {
                    run_housekeeping(&site);
                    continue;
                }
            };
            let (slot, evicts) = slots.enter(accepted.peer, site.now());
            let context = ConnectionContext {
                site: site.clone(),
                peer: accepted.peer,
                name: accepted.name,
                reached: accepted.reached,
                slot,
                streams: Arc::clone(&streams),
                scopes: Arc::clone(&scopes),
                evaluations: Arc::clone(&evaluations),
                live: actions.clone(),
                live_origins: Arc::clone(&live_origins),
                shutdown: shutdown_receiver.clone(),
            };
            context.count_eviction(evicts);
            connections.spawn(serve(accepted.stream, accepted.kind, context));
        }
        // Fails only if all connections have already ended.
        let _ = shutdown_sender.send(true);
        let all = async { while connections.join_next().await.is_some() {} };
        if tokio::time::timeout(SHUTDOWN_TIMEOUT, all).await.is_err() {
            tracing::warn!("not all connections ended within {SHUTDOWN_TIMEOUT:?}");
        }
    }
}

/// Ends orphaned sessions and reports suppressed log lines.
fn run_housekeeping(site: &Site) {
    site.flush_log();
    let site = site.clone();
    tokio::task::spawn_blocking(move || {
        let now = site.now();
        let ended = site
            .sessions
            .end_orphaned(&site.controller, now, ORPHAN_TIMEOUT, usize::MAX);
        if ended > 0 {
            tracing::info!("ended {ended} empty sessions of lost clients");
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

/// The next network connection; pends for ever without a listener.
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
            Err(error) => log_accept_error(site, &error).await,
        }
    }
}

/// The next connection at the Unix socket whose account is admitted.
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
                let line = format!("rejected account {uid:?} at the Unix socket");
                site.warn(|limits: &Limits| &limits.denials, &line);
            }
            Err(error) => log_accept_error(site, &error).await,
        }
    }
}

async fn log_accept_error(site: &Site, error: &std::io::Error) {
    let line = format!("cannot accept a connection: {error}");
    site.warn(|limits: &Limits| &limits.slots, &line);
    tokio::time::sleep(ACCEPT_RETRY_DELAY).await;
}

/// Makes the system detect a dead peer, and sends replies at once: Nagle's algorithm would delay them by tens of
/// milliseconds. A connection without either works too.
fn keep_alive(stream: &TcpStream) {
    use nix::sys::socket::{setsockopt, sockopt};
    let _ = stream.set_nodelay(true);
    let _ = setsockopt(stream, sockopt::SndBuf, &SEND_BUFFER_BYTES);
    let _ = setsockopt(stream, sockopt::KeepAlive, &true);
    let _ = setsockopt(stream, sockopt::TcpKeepIdle, &KEEP_ALIVE_IDLE_S);
    let _ = setsockopt(stream, sockopt::TcpKeepInterval, &KEEP_ALIVE_INTERVAL_S);
    let _ = setsockopt(stream, sockopt::TcpKeepCount, &KEEP_ALIVE_COUNT);
}

async fn serve(stream: Box<dyn link::Bytes>, kind: Kind, context: ConnectionContext) {
    let name = context.name.as_str();
    tracing::debug!(name, ?kind, "connection accepted");
    let counters = &context.site.counters;
    Counters::add(&counters.connections, 1);
    Counters::add(&counters.clients, 1);
    let opened = match link::serve(stream, kind, &context).await {
        Ok(opened) => opened,
        Err(link::Failure { error, opened }) => {
            if let Error::Full { .. } = error {
                Counters::add(&counters.refused, 1);
            }
            let line = format!("connection of {name} failed: {error}");
            context.site.warn(|limits: &Limits| &limits.failures, &line);
            opened
        }
    };
    tracing::debug!(name, "connection ended");
    counters.clients.fetch_sub(1, Ordering::Relaxed);
    let ConnectionContext { site, slot, .. } = context;
    // The rest may take seconds and needs no connection slot.
    drop(slot);
    let controller = &site.controller;
    let ends = |id: &SessionId| controller.session_on_loss(*id) == Some(OnLoss::End);
    let (lost, left): (Vec<_>, Vec<_>) = opened.into_iter().partition(ends);
    for session in left {
        site.sessions.orphan(session, site.now());
    }
    if !lost.is_empty() {
        loss::end_sessions(controller, lost, loss::CANCEL_TIMEOUT).await;
    }
}

fn report(ended: Result<(), tokio::task::JoinError>) {
    if let Err(error) = ended {
        tracing::error!(%error, "the task of a connection panicked");
    }
}
