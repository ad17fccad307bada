//! Emulated FRI controllers in threads of their own, for tests, demos and programs without hardware. What they emulate
//! is in `takt_fri`.

use std::io;
use std::net::{Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;

use takt_fri::linux::UdpLink;
use takt_fri::lwr::emulator::{self, Krc, KrcConfig, Served, Status, serve};
use takt_fri::sunrise::emulator as sunrise;
use takt_rt::thread::{Stoppable, ThreadConfig};

/// Consecutive cycles without an answer that a tolerant controller bridges.
pub const MISSES_MAX: u32 = 100;
/// A posture in which every joint can move both ways, rad.
pub const RESTING: [f64; 7] = [0.0, 0.5, 0.0, -1.2, 0.0, 0.8, 0.0];
/// Above drivers: the real controller has a processor of its own.
const PRIORITY: u8 = 88;
/// Pause of the robot program of a cabinet after a motion has ended.
const RESTART: Duration = Duration::from_secs(1);

/// A KRC for hosts that stall, its arm in a posture in which every joint can move both ways. A real KRC is assumed to
/// tolerate fewer missing answers, and to end command mode at bad quality.
pub fn resting(period: Duration) -> KrcConfig {
    let timing = emulator::Timing {
        misses_max: MISSES_MAX,
        bad_from: 0.0,
        ..emulator::Timing::default()
    };
    KrcConfig {
        period,
        joints: RESTING,
        timing,
        ..KrcConfig::default()
    }
}

/// Timing of a Sunrise cabinet for hosts that stall: as that of [`resting`], and quality is good when half of the answers
/// are in time.
pub fn tolerant_timing() -> sunrise::Timing {
    sunrise::Timing {
        misses_max: MISSES_MAX,
        bad_from: 0.0,
        ok_from: 0.5,
        ..sunrise::Timing::default()
    }
}

/// A robot program that holds the arm with an overlay, and starts again when that ends.
pub const fn holding_program(overlay: sunrise::Overlay) -> sunrise::Program {
    sunrise::Program::Auto {
        overlay,
        restart: Some(RESTART),
    }
}

/// An emulated FRI controller in a thread of its own.
#[derive(Debug)]
pub struct Robot<C: Served = Krc> {
    status: Arc<Status<C>>,
    thread: Stoppable<io::Result<()>>,
}

impl Robot {
    /// Starts a KRC; its datagrams go to `target`, from any port of loopback.
    ///
    /// # Errors
    /// If the system refuses the socket or the thread.
    pub fn start(name: &str, target: SocketAddr, config: KrcConfig) -> io::Result<Self> {
        Self::launch(name, local(target)?, |start| Krc::new(config, start))
    }
}

/// A socket at any port of loopback whose datagrams go to `target`.
///
/// # Errors
/// If the system refuses it.
pub fn local(target: SocketAddr) -> io::Result<UdpLink> {
    UdpLink::connect(SocketAddr::from((Ipv4Addr::LOCALHOST, 0)), target)
}

impl<C: Served + 'static> Robot<C> {
    /// Starts the controller that `controller` makes for its start time.
    ///
    /// # Errors
    /// If the system refuses the thread.
    pub fn launch(
        name: &str,
        mut link: UdpLink,
        controller: impl FnOnce(Duration) -> C + Send + 'static,
    ) -> io::Result<Self> {
        let status = Arc::new(Status::new());
        let shared = Arc::clone(&status);
        let config = ThreadConfig {
            priority: Some(PRIORITY),
            ..ThreadConfig::new(name)
        };
        let thread = Stoppable::spawn(config, move |stop| {
            let mut controller = controller(takt_fri::linux::monotonic()?);
            serve(&mut controller, &mut link, &shared, stop)
        })?;
        Ok(Self { status, thread })
    }

    /// Its state.
    pub fn status(&self) -> &Status<C> {
        &self.status
    }

    /// Ends the thread and returns the last state.
    ///
    /// # Errors
    /// If the socket failed, or the thread panicked.
    pub fn stop(self) -> io::Result<Arc<Status<C>>> {
        let ended = self.thread.stop();
        ended.map_err(|_| io::Error::other("the emulated controller ended by a panic"))??;
        Ok(self.status)
    }
}
