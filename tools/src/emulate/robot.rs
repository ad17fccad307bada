//! An emulated FRI controller in a thread of its own. What it emulates is in `takt_fri`.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::Context as _;
use takt_fri::linux::UdpLink;
use takt_fri::lwr::emulator::{self, Krc, KrcConfig, Served, Status, serve};
use takt_rt::thread::{Thread, ThreadConfig};

use super::knobs::MISSES_MAX;
use crate::Verdict;
use crate::output::say;
use crate::run::until_stopped;

/// An arm in a posture in which every joint can move both ways.
pub(crate) fn resting(period: Duration) -> KrcConfig {
    let joints = [0.0, 0.5, 0.0, -1.2, 0.0, 0.8, 0.0];
    // A real KRC is assumed to tolerate fewer missing answers and to end command mode at bad quality. A host without
    // PREEMPT_RT sometimes stalls for longer, which the demo is not to show.
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

/// An emulated FRI controller in a thread of its own.
#[derive(Debug)]
pub(crate) struct Robot<C: Served = Krc> {
    /// Its state.
    pub(crate) status: Arc<Status<C>>,
    thread: Thread<std::io::Result<()>>,
    stop: Arc<AtomicBool>,
}

impl Robot {
    /// Starts a KRC; its datagrams go to `target`.
    pub(crate) fn start(name: &str, target: SocketAddr, config: KrcConfig) -> anyhow::Result<Self> {
        Self::launch(name, target, |start| Krc::new(config, start))
    }
}

impl<C: Served + 'static> Robot<C> {
    /// Starts the controller that `controller` makes for its start time; its datagrams go to `target`.
    pub(super) fn launch(
        name: &str,
        target: SocketAddr,
        controller: impl FnOnce(Duration) -> C + Send + 'static,
    ) -> anyhow::Result<Self> {
        let local = match target {
            SocketAddr::V4(v4) if v4.ip().is_loopback() => SocketAddr::from(([127, 0, 0, 1], 0)),
            SocketAddr::V4(_) => SocketAddr::from(([0, 0, 0, 0], 0)),
            SocketAddr::V6(_) => SocketAddr::from((std::net::Ipv6Addr::UNSPECIFIED, 0)),
        };
        let mut link = UdpLink::connect(local, target)
            .with_context(|| format!("cannot open a socket to {target}"))?;
        let status = Arc::new(Status::new());
        let stop = Arc::new(AtomicBool::new(false));
        let (shared, stopping) = (Arc::clone(&status), Arc::clone(&stop));
        // Above drivers: the real controller has a processor of its own.
        let config_of_thread = ThreadConfig {
            priority: Some(88),
            ..ThreadConfig::new(name)
        };
        let thread = takt_rt::thread::spawn(config_of_thread, move || {
            let mut controller = controller(takt_fri::linux::monotonic()?);
            serve(&mut controller, &mut link, &shared, &stopping)
        })
        .with_context(|| format!("cannot start thread {name}"))?;
        Ok(Self {
            status,
            thread,
            stop,
        })
    }

    /// Prints changes of state until the end, then the counts of datagrams.
    pub(super) fn watch(self, duration: Option<Duration>) -> anyhow::Result<Verdict> {
        let mut printed = None;
        until_stopped(duration, || {
            // A repeated reason is a change, too.
            let now = (self.status.exits(), line(&self.status));
            if printed.as_ref() == Some(&now) {
                return Ok(());
            }
            say(&printed.insert(now).1)
        })?;
        let status = self.stop()?;
        say(&format!(
            "sent {}, answers {}, missed {}, own stalls {}",
            status.sent(),
            status.answers(),
            status.missed(),
            status.stalls()
        ))?;
        Ok(Verdict::Good)
    }

    /// Ends the thread.
    pub(crate) fn stop(self) -> anyhow::Result<Arc<Status<C>>> {
        self.stop.store(true, Ordering::Relaxed);
        match self.thread.join() {
            Ok(served) => served.context("the emulated controller failed")?,
            Err(_) => anyhow::bail!("the emulated controller ended by a panic"),
        }
        Ok(self.status)
    }
}

/// The state of a controller, in its own terms.
fn line<C: Served>(status: &Status<C>) -> String {
    let power = if status.has_power() { "on" } else { "off" };
    let fall = status.last_exit();
    let fall = fall.map_or_else(String::new, |why| format!("; left command mode: {why}"));
    let (state, quality) = (status.state(), status.quality());
    format!("{state}, quality {quality}, drives {power}{fall}")
}
