//! A controller with two simulated arms, for programs of the Robotics API over the real line protocol.

#![allow(
    dead_code,
    clippy::unwrap_used,
    reason = "each test program uses a part; helpers fail by panicking"
)]

pub(crate) mod watched;

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::thread::JoinHandle;

use takt_api::{Arm, Cell, Outcome, together};
use takt_core::{CellConfig, Controller};
use takt_server::{Server, ServerConfig};
use tokio::sync::oneshot;

/// A controller with the arms `left` and `right`.
pub(crate) struct Bench {
    pub(crate) controller: Controller,
    pub(crate) address: String,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Bench {
    pub(crate) fn start() -> Self {
        let bench = Self::of(&CellConfig::default());
        let controller = &bench.controller;
        for arm in ["left", "right"] {
            let list = |value: f64| format!("{:?}", [value; 7]);
            let parameters = [
                ("min_joint", list(-2.9)),
                ("max_joint", list(2.9)),
                ("max_vel", list(2.0)),
                ("max_acc", list(8.0)),
            ];
            let parameters: BTreeMap<_, _> = parameters
                .map(|(key, value)| (key.to_owned(), value))
                .into();
            controller
                .add_device(arm, "kuka_lwr_sim", &parameters)
                .unwrap();
        }
        bench
    }

    /// A controller with the devices of a cell.
    pub(crate) fn of(cell: &CellConfig) -> Self {
        Self::serving(Controller::start(cell).unwrap())
    }

    /// A server of this controller.
    pub(crate) fn serving(controller: Controller) -> Self {
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .enable_all()
            .build()
            .unwrap();
        let tcp = Some(SocketAddr::from(([127, 0, 0, 1], 0)));
        let config = ServerConfig {
            tcp,
            ..ServerConfig::default()
        };
        let server = runtime.block_on(Server::bind(config)).unwrap();
        let address = server.tcp_address().unwrap().to_string();
        let (stop, stopped) = oneshot::channel();
        let served = controller.clone();
        let thread = std::thread::spawn(move || {
            runtime.block_on(server.run(served, async {
                let _ = stopped.await;
            }));
        });
        Self {
            controller,
            address,
            stop: Some(stop),
            thread: Some(thread),
        }
    }

    pub(crate) fn cell(&self) -> Cell {
        Cell::connect(&self.address).unwrap()
    }

    /// The arms, bent, as a line needs it.
    pub(crate) fn arms(&self) -> (Cell, Arm, Arm) {
        let cell = self.cell();
        let (left, right) = (cell.arm("left").unwrap(), cell.arm("right").unwrap());
        let begun = together([left.ptp(BENT), right.ptp(BENT)]).run();
        assert_eq!(begun, Ok(Outcome::Completed));
        (cell, left, right)
    }

    /// How many nets are loaded.
    pub(crate) fn nets(&self) -> usize {
        self.controller.nets().len()
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

pub(crate) const BENT: [f64; 7] = [0.0, 0.5, 0.0, -1.2, 0.0, 0.8, 0.0];
