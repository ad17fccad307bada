//! A test bench: an emulated EtherCAT segment on a cable inside this process, in a thread of its own, and a
//! controller that commands it, in simulated time. Each test defines its segment. Also the log of such tests.

#![allow(
    dead_code,
    unreachable_pub,
    reason = "shared by test files that need different parts"
)]

use std::collections::VecDeque;
use std::io::Write;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use takt_core::{CellConfig, Controller};
use takt_devices::ethercat::EthercatConfig;
use takt_devices::ethercat::{Ethercat, EthercatFigures, Wire, Wires, describe};
use takt_ethercat::emulator::{Segment, Server, SharedSegment};
use takt_ethercat::link::Link;
use takt_ethercat::linux::{cable, monotonic};
use takt_rt::thread::{Thread, ThreadConfig, spawn};

use crate::common::Cell;

/// A link that delays received frames by a fixed time; with one, it allocates in the thread that receives.
#[derive(Debug)]
struct Delayed<L> {
    link: L,
    latency: Duration,
    /// Under way: when it was sent, and its bytes.
    held: VecDeque<(Duration, Vec<u8>)>,
}

impl<L: Link> Link for Delayed<L> {
    fn send(&mut self, frame: &[u8]) -> std::io::Result<usize> {
        self.link.send(frame)
    }

    fn receive(
        &mut self,
        buf: &mut [u8],
        timeout: Duration,
    ) -> std::io::Result<Option<(usize, Duration)>> {
        if self.latency.is_zero() {
            return self.link.receive(buf, timeout);
        }
        let until = monotonic()? + timeout;
        loop {
            let now = monotonic()?;
            if let Some((at, _)) = self.held.front()
                && *at + self.latency <= now
                && let Some((at, frame)) = self.held.pop_front()
            {
                buf[..frame.len()].copy_from_slice(&frame);
                return Ok(Some((frame.len(), at + self.latency)));
            }
            let next = self
                .held
                .front()
                .map_or(until, |(at, _)| *at + self.latency);
            let wait = next.min(until).saturating_sub(now);
            match self.link.receive(buf, wait)? {
                Some((len, at)) => self.held.push_back((at, buf[..len].to_vec())),
                None if monotonic()? >= until => return Ok(None),
                None => {}
            }
        }
    }
}

/// A segment that answers at the end of its cables.
struct Served {
    stop: Arc<AtomicBool>,
    thread: Option<Thread<()>>,
}

impl Served {
    /// Connected by one cable, or by two as a ring; every answer is delayed.
    fn start(segment: SharedSegment, ring: bool, latency: Duration) -> (Self, Wires) {
        let ((near, far), (near2, far2)) = (cable(), cable());
        let mut server = Server::new(segment, far);
        if ring {
            server = server.with_second(far2);
        }
        let stop = Arc::new(AtomicBool::new(false));
        let stopping = Arc::clone(&stop);
        let config = ThreadConfig {
            priority: Some(88),
            ..ThreadConfig::new("segment")
        };
        let thread = spawn(config, move || {
            while !stopping.load(Ordering::Relaxed) {
                let wait = Duration::from_millis(5);
                server.turn(wait, &mut monotonic).unwrap();
            }
        });
        let wire = |link, last| Wire {
            link: Box::new(Delayed {
                link,
                latency,
                held: VecDeque::new(),
            }),
            source: [2, 0, 0, 0, 0, last],
        };
        let wires = Wires {
            first: wire(near, 1),
            second: ring.then(|| wire(near2, 2)),
        };
        let thread = Some(thread.unwrap());
        (Self { stop, thread }, wires)
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }
}

/// A segment, and a controller that commands it; fields are dropped in this order.
pub struct TestBench {
    cell: Option<Cell>,
    served: Option<Served>,
    segment: SharedSegment,
    latency: Duration,
}

impl TestBench {
    /// By one cable, or by two if the cell names a second interface. Does not wait for devices.
    pub fn start(config: &EthercatConfig, segment: Segment) -> Self {
        Self::start_late(config, segment, Duration::ZERO)
    }

    /// The same with a cable that delays every answer.
    pub fn start_late(config: &EthercatConfig, segment: Segment, latency: Duration) -> Self {
        let mut bench = Self {
            cell: None,
            served: None,
            segment: SharedSegment::new(segment),
            latency,
        };
        bench.lead(config);
        bench
    }

    /// Starts to serve the segment, and a controller that commands it.
    pub fn lead(&mut self, config: &EthercatConfig) {
        takt_tests::simulate_time(1.0);
        let (served, wires) =
            Served::start(self.segment.clone(), config.second.is_some(), self.latency);
        let controller = Controller::start(&CellConfig::default()).unwrap();
        let added = controller.add_driver("segment", describe(config), None, |ends| {
            Ok(Box::new(Ethercat::start(config, wires, ends)?))
        });
        added.unwrap();
        let robots = Vec::new();
        self.cell = Some(Cell { controller, robots });
        self.served = Some(served);
    }

    /// Ends the controller, then disconnects the segment. Its slaves stay powered.
    pub fn leave(&mut self) {
        self.cell = None;
        self.served = None;
    }

    /// Ends the controller; the segment continues.
    pub fn end_controller(&mut self) {
        self.cell = None;
    }

    pub fn cell(&self) -> &Cell {
        self.cell.as_ref().unwrap()
    }

    /// The segment, locked: frames wait until the guard is dropped.
    pub fn segment(&self) -> MutexGuard<'_, Segment> {
        self.segment.lock()
    }

    pub fn figures(&self) -> EthercatFigures {
        self.cell().controller.with_drivers(Ethercat::figures)[0]
    }

    pub fn wait_until_operational(&self) {
        let cell = self.cell();
        cell.wait("the segment", |_| self.figures().operational);
    }
}

/// The log of all tests of the process since [`Log::start`].
#[derive(Clone, Default)]
pub struct Log(Arc<Mutex<Vec<u8>>>);

impl Log {
    pub fn start() -> Self {
        let log = Self::default();
        let writer = log.clone();
        let subscriber = tracing_subscriber::fmt().with_ansi(false);
        let subscriber = subscriber.with_writer(move || writer.clone()).finish();
        tracing::subscriber::set_global_default(subscriber).unwrap();
        log
    }

    pub fn text(&self) -> String {
        String::from_utf8_lossy(&self.0.lock().unwrap()).into_owned()
    }
}

impl Write for Log {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.lock().unwrap().extend(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}
