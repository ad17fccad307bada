//! A server in threads of its own, for programs that have no executor.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use takt_core::Controller;

use crate::error::Error;
use crate::server::Server;

/// Threads that serve the connections.
const THREADS: usize = 2;

/// A server that runs in threads of its own until it is stopped.
#[derive(Debug)]
pub struct ServerThreads {
    runtime: tokio::runtime::Runtime,
    task: tokio::task::JoinHandle<()>,
    stop: tokio::sync::oneshot::Sender<()>,
    http: Option<SocketAddr>,
    tcp: Option<SocketAddr>,
    foxglove: Option<SocketAddr>,
    local: Option<PathBuf>,
}

impl ServerThreads {
    /// Starts the threads, binds the server, such as by [`Server::bind`], and serves clients.
    ///
    /// # Errors
    /// If it cannot be bound, or the system refuses the threads.
    pub fn start(
        bind: impl Future<Output = Result<Server, Error>>,
        controller: &Controller,
    ) -> Result<Self, Error> {
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(THREADS)
            .enable_all()
            .thread_name("takt-server")
            .build()
            .map_err(Error::Threads)?;
        let server = runtime.block_on(bind)?;
        let local = server.local_path().map(Path::to_owned);
        let (http, tcp) = (server.http_address(), server.tcp_address());
        let foxglove = server.foxglove_address();
        let (stop, stopped) = tokio::sync::oneshot::channel();
        let shutdown = async {
            // A dropped sender means the same as a message.
            let _ = stopped.await;
        };
        let task = runtime.spawn(server.run(controller.clone(), shutdown));
        Ok(Self {
            runtime,
            task,
            stop,
            http,
            tcp,
            foxglove,
            local,
        })
    }

    /// Address for HTTP and WebSocket.
    pub const fn http_address(&self) -> Option<SocketAddr> {
        self.http
    }

    /// Address for plain TCP.
    pub const fn tcp_address(&self) -> Option<SocketAddr> {
        self.tcp
    }

    /// Address of the Foxglove WebSocket.
    pub const fn foxglove_address(&self) -> Option<SocketAddr> {
        self.foxglove
    }

    /// Path of the Unix socket.
    pub fn local_path(&self) -> Option<&Path> {
        self.local.as_deref()
    }

    /// Ends all connections and the threads. False if the server had ended by a panic.
    pub fn stop(self) -> bool {
        let _ = self.stop.send(());
        self.runtime.block_on(self.task).is_ok()
    }
}
