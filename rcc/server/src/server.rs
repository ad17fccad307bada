//! Listening, and one task per connection that moves bytes between a socket and a
//! [`Connection`](crate::dio::Connection). What the lines mean is not decided here.

mod link;
mod loss;

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use takt_core::{Controller, SessionId};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};
use tokio::task::JoinSet;

use crate::access::Token;
use crate::error::Error;
use crate::http::DEBUG_STREAMS_MAX;
use crate::log::LogBook;
use crate::site::{Counters, Site, StopPort};

/// Most connections at once, of both kinds together.
pub const CONNECTIONS_MAX: usize = 64;

/// Nets that are evaluated at once; others wait.
pub const EVALUATIONS_MAX: usize = 2;

/// How long connections may take to end when the server is shut down.
const SHUTDOWN_WITHIN: Duration = Duration::from_secs(3);

/// Pause after a connection could not be accepted, so that a lack of files is no busy loop.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);

pub use takt_core::OnLoss;

/// Where a server listens and how it behaves. Port 0 takes any free port.
#[derive(Clone, Debug, Default)]
pub struct ServerConfig {
    /// For HTTP and WebSocket; `None` for not at all.
    pub http: Option<SocketAddr>,
    /// For lines over plain TCP; `None` for not at all.
    pub tcp: Option<SocketAddr>,
    /// What becomes of nets whose client is gone, unless their session says otherwise.
    pub on_loss: OnLoss,
    /// What every client must give, on loopback too; `None` for nothing, on loopback only.
    pub token: Option<Token>,
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
    on_loss: OnLoss,
    token: Option<Token>,
    log: LogBook,
    stop: Option<StopPort>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Http,
    Tcp,
}

/// What a connection needs of its server.
struct Visit {
    site: Site,
    /// Time of the gate.
    begin: Instant,
    streams: Arc<Semaphore>,
    evaluations: Arc<Semaphore>,
    /// Turns true when the server is shut down.
    closing: watch::Receiver<bool>,
    _place: OwnedSemaphorePermit,
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
            on_loss,
            token,
            log,
            stop,
        } = config;
        Ok(Self {
            http: listen(http, token.is_some()).await?,
            tcp: listen(tcp, token.is_some()).await?,
            on_loss,
            token,
            log,
            stop,
        })
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
        let places = Arc::new(Semaphore::new(CONNECTIONS_MAX));
        let streams = Arc::new(Semaphore::new(DEBUG_STREAMS_MAX));
        let evaluations = Arc::new(Semaphore::new(EVALUATIONS_MAX));
        let site = Site::new(controller, self.token, self.on_loss, self.log).with_stop(self.stop);
        let begin = Instant::now();
        let (close, closing) = watch::channel(false);
        let mut visits = JoinSet::new();
        tokio::pin!(shutdown);
        loop {
            let (stream, kind) = tokio::select! {
                () = &mut shutdown => break,
                stream = accept(self.http.as_ref()) => (stream, Kind::Http),
                stream = accept(self.tcp.as_ref()) => (stream, Kind::Tcp),
                Some(ended) = visits.join_next() => {
                    report(ended);
                    continue;
                }
            };
            match Arc::clone(&places).try_acquire_owned() {
                Ok(place) => {
                    let visit = Visit {
                        site: site.clone(),
                        begin,
                        streams: Arc::clone(&streams),
                        evaluations: Arc::clone(&evaluations),
                        closing: closing.clone(),
                        _place: place,
                    };
                    visits.spawn(serve(stream, kind, visit));
                }
                Err(_) => {
                    Counters::add(&site.counters.refused, 1);
                    link::refuse(stream, kind);
                }
            }
        }
        // Nobody is left to listen if all connections have ended already.
        let _ = close.send(true);
        let all = async { while visits.join_next().await.is_some() {} };
        if tokio::time::timeout(SHUTDOWN_WITHIN, all).await.is_err() {
            tracing::warn!("some connections did not end within {SHUTDOWN_WITHIN:?}");
        }
    }
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

/// The next connection; never over if there is nothing to listen at.
async fn accept(listener: Option<&TcpListener>) -> TcpStream {
    let Some(listener) = listener else {
        return std::future::pending().await;
    };
    loop {
        match listener.accept().await {
            Ok((stream, _)) => return stream,
            Err(error) => {
                tracing::warn!(%error, "cannot accept a connection");
                tokio::time::sleep(ACCEPT_PAUSE).await;
            }
        }
    }
}

async fn serve(stream: TcpStream, kind: Kind, visit: Visit) {
    let peer = stream.peer_addr().ok();
    tracing::debug!(?peer, ?kind, "connection begins");
    let counters = &visit.site.counters;
    Counters::add(&counters.connections, 1);
    Counters::add(&counters.clients, 1);
    let opened = match link::serve(stream, kind, &visit).await {
        Ok(opened) => opened,
        Err(link::Failure { error, opened }) => {
            tracing::info!(?peer, %error, "connection fails");
            opened
        }
    };
    tracing::debug!(?peer, "connection ends");
    counters.clients.fetch_sub(1, Ordering::Relaxed);
    let controller = &visit.site.controller;
    let ends = |id: &SessionId| controller.session_on_loss(*id) == Some(OnLoss::End);
    let lost: Vec<_> = opened.into_iter().filter(ends).collect();
    if !lost.is_empty() {
        loss::end_sessions(controller, lost, loss::CANCEL_WITHIN).await;
    }
}

fn report(ended: Result<(), tokio::task::JoinError>) {
    if let Err(error) = ended {
        tracing::error!(%error, "a connection ended by a fault of the server");
    }
}
