//! Fixture: a server with a controller without devices, on free ports of this host.

#![allow(dead_code, reason = "shared by test files that need different parts")]

use std::net::SocketAddr;
use std::thread::JoinHandle;

use takt_core::{CellConfig, Controller};
use takt_server::{OnLoss, Server, ServerConfig};
use tokio::sync::oneshot;

/// A running server; dropping it stops the server.
pub(crate) struct TestServer {
    pub(crate) controller: Controller,
    pub(crate) http: SocketAddr,
    pub(crate) tcp: SocketAddr,
    pub(crate) foxglove: Option<SocketAddr>,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl TestServer {
    pub(crate) fn start(on_loss: OnLoss) -> Self {
        Self::start_with(ServerConfig {
            on_loss: Some(on_loss),
            ..ServerConfig::default()
        })
    }

    /// Starts a server on any free ports.
    pub(crate) fn start_with(config: ServerConfig) -> Self {
        let mut cell = CellConfig::default();
        cell.controller.priority = None;
        let controller = Controller::start(&cell).unwrap();
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .enable_all()
            .build()
            .unwrap();
        let any = Some(SocketAddr::from(([127, 0, 0, 1], 0)));
        let config = ServerConfig {
            http: any,
            tcp: any,
            ..config
        };
        let server = runtime.block_on(Server::bind(config)).unwrap();
        let (http, tcp) = (
            server.http_address().unwrap(),
            server.tcp_address().unwrap(),
        );
        let foxglove = server.foxglove_address();
        let (stop, stopped) = oneshot::channel();
        let served = controller.clone();
        let thread = std::thread::spawn(move || {
            runtime.block_on(server.run(served, async {
                let _ = stopped.await;
            }));
        });
        Self {
            controller,
            http,
            tcp,
            foxglove,
            stop: Some(stop),
            thread: Some(thread),
        }
    }

    pub(crate) fn stop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }
}

impl Drop for TestServer {
    fn drop(&mut self) {
        self.stop();
    }
}
