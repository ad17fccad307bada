//! `takt emulate`: the other end of a wire, for labs and tests. The protocols and robots are in
//! the protocol crates.

mod drive;
mod iiwa;
mod knobs;
mod lwr;
mod rmp;
pub(crate) mod segment;
mod service;
mod youbot;

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::Context as _;
use clap::Subcommand;
use takt_fri::linux::UdpLink;
use takt_fri::lwr::emulator::{self, Krc, KrcConfig, KrcStatus, serve};
use takt_rt::thread::{Thread, ThreadConfig};

use crate::Verdict;
use crate::output::say;
use knobs::MISSES_MAX;
pub(crate) use service::Service;

/// Emulated robots.
#[derive(Debug, Subcommand)]
pub(crate) enum Emulate {
    /// A KRC with a KUKA LWR, speaking FRI 1.0 over UDP.
    ///
    /// It bridges up to 100 missing answers and no quality ends its command mode: more patience than a
    /// real KRC has, for hosts that stall; `--strict` takes it away.
    Lwr(lwr::Lwr),
    Iiwa(iiwa::Iiwa),
    /// A Segway power base on CAN or on its USB port.
    Rmp(rmp::Rmp),
    /// A CiA 402 drive as a CANopen node.
    Drive(drive::DriveArgs),
    /// A Stäubli TX90 of six CiA 402 axes on an EtherCAT segment.
    Tx90(segment::Tx90),
    Youbot(youbot::YouBot),
}

impl Emulate {
    pub(crate) fn run(self) -> anyhow::Result<Verdict> {
        match self {
            Self::Lwr(lwr) => lwr.run(),
            Self::Iiwa(iiwa) => iiwa.run(),
            Self::Rmp(rmp) => rmp.run(),
            Self::Drive(drive) => drive.run(),
            Self::Tx90(tx90) => tx90.run(),
            Self::Youbot(youbot) => youbot.run(),
        }
    }
}

/// What a FRI controller sent and was answered, at the end.
fn farewell(sent: u64, answers: u64, missed: u32, stalls: u64) -> anyhow::Result<Verdict> {
    say(&format!(
        "sent {sent}, answers {answers}, missed {missed}, own stalls {stalls}"
    ))?;
    Ok(Verdict::Good)
}

/// An arm in a posture in which every joint can move both ways.
pub(crate) fn resting(period: Duration) -> KrcConfig {
    let joints = [0.0, 0.5, 0.0, -1.2, 0.0, 0.8, 0.0];
    // A real KRC bridges fewer missing answers and ends command mode at a bad quality. A host
    // without PREEMPT_RT stalls for longer now and then, and the demo is to show Takt, not the host.
    let timing = emulator::Timing {
        misses_max: MISSES_MAX,
        bad_from: 0.0,
        ..emulator::Timing::default()
    };
    KrcConfig {
        period,
        joints,
        timing,
        ..KrcConfig::default()
    }
}

/// An emulated controller in a thread of its own.
#[derive(Debug)]
pub(crate) struct Robot<S = KrcStatus> {
    /// What it is doing.
    pub(crate) status: Arc<S>,
    thread: Thread<std::io::Result<()>>,
    stop: Arc<AtomicBool>,
}

impl Robot {
    /// Starts a KRC; its datagrams go to `target`.
    pub(crate) fn start(name: &str, target: SocketAddr, config: KrcConfig) -> anyhow::Result<Self> {
        Self::launch(name, target, KrcStatus::new(), move |link, status, stop| {
            let mut krc = Krc::new(config, takt_fri::linux::monotonic()?);
            serve(&mut krc, link, status, stop)
        })
    }
}

impl<S: Send + Sync + 'static> Robot<S> {
    /// Starts what `serve` serves; its datagrams go to `target`.
    fn launch(
        name: &str,
        target: SocketAddr,
        status: S,
        serve: impl FnOnce(&mut UdpLink, &S, &AtomicBool) -> std::io::Result<()> + Send + 'static,
    ) -> anyhow::Result<Self> {
        let local = match target {
            SocketAddr::V4(v4) if v4.ip().is_loopback() => SocketAddr::from(([127, 0, 0, 1], 0)),
            SocketAddr::V4(_) => SocketAddr::from(([0, 0, 0, 0], 0)),
            SocketAddr::V6(_) => SocketAddr::from((std::net::Ipv6Addr::UNSPECIFIED, 0)),
        };
        let mut link = UdpLink::connect(local, target)
            .with_context(|| format!("cannot open a socket to {target}"))?;
        let status = Arc::new(status);
        let stop = Arc::new(AtomicBool::new(false));
        let (shared, stopping) = (Arc::clone(&status), Arc::clone(&stop));
        // Above drivers: the real controller has a processor of its own.
        let config_of_thread = ThreadConfig {
            priority: Some(88),
            ..ThreadConfig::new(name)
        };
        let thread = takt_rt::thread::spawn(config_of_thread, move || {
            serve(&mut link, &shared, &stopping)
        })
        .with_context(|| format!("cannot start thread {name}"))?;
        Ok(Self {
            status,
            thread,
            stop,
        })
    }

    /// Ends it.
    pub(crate) fn stop(self) -> anyhow::Result<Arc<S>> {
        self.stop.store(true, Ordering::Relaxed);
        match self.thread.join() {
            Ok(served) => served.context("the emulated controller failed")?,
            Err(_) => anyhow::bail!("the emulated controller ended by a panic"),
        }
        Ok(self.status)
    }
}
