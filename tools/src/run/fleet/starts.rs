//! Nets of this controller in coordinated starts. What begins together is decided by the fleet; the net thread holds to the instant.

use std::time::{Duration, Instant};

use takt_core::controller::{PreparedStart, PreparedState};
use takt_core::{Controller, Nanos, NetId};
use takt_fleet::command::LossPolicy;
use takt_fleet::session::member::{Held, HeldState};

/// How long cancelled nets may run before they are aborted, as with a lost client.
const CANCEL_TIMEOUT: Duration = Duration::from_secs(2);
/// How often they are asked for.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// Nets that are kept for a start.
pub(super) struct HeldNets {
    controller: Controller,
    start: PreparedStart,
}

impl HeldNets {
    /// Keeps what the nets of these names need.
    pub(super) fn prepare(controller: &Controller, nets: &[String]) -> Result<Self, String> {
        let id = |name: &String| {
            let id = name.parse::<NetId>();
            id.map_err(|_| format!("`{name}` is no net; nets are named as rpinet0"))
        };
        let nets: Vec<NetId> = nets.iter().map(id).collect::<Result<_, _>>()?;
        let start = controller.prepare_start(&nets, "coordinated start of the fleet");
        Ok(Self {
            controller: controller.clone(),
            start: start.map_err(|why| why.to_string())?,
        })
    }
}

impl Held for HeldNets {
    fn period(&self) -> Nanos {
        self.start.period().into()
    }

    fn begin_at(&mut self, at: Nanos) {
        self.start.begin_at(at);
    }

    fn state(&mut self) -> HeldState {
        match self.start.state() {
            PreparedState::Waiting => HeldState::Waiting,
            PreparedState::Failed(why) => HeldState::Failed(why),
            PreparedState::Begun(begun) => HeldState::Running {
                cycle: begun.cycle,
                begin: begun.begin,
                woken: begun.woken,
                end: self.start.end(),
            },
        }
    }

    fn lose_partner(&mut self, policy: LossPolicy) {
        let (controller, nets) = (self.controller.clone(), self.start.nets().to_vec());
        let grace = match policy {
            LossPolicy::Continue => return,
            LossPolicy::Cancel => CANCEL_TIMEOUT,
            LossPolicy::Stop => Duration::ZERO,
        };
        // Ending a net waits for its thread.
        let thread = std::thread::Builder::new().name("fleet-end".to_owned());
        let started = thread.spawn(move || end(&controller, &nets, grace));
        if let Err(why) = started {
            tracing::error!("no thread to end the nets of a coordinated start: {why}");
            for net in self.start.nets() {
                if let Err(why) = self.controller.cancel(*net) {
                    tracing::error!("cannot cancel {net}: {why}");
                }
            }
        }
    }
}

/// Cancels nets, and aborts those that run on for longer than `grace`.
fn end(controller: &Controller, nets: &[NetId], grace: Duration) {
    let until = Instant::now() + grace;
    while Instant::now() < until {
        if controller.wind_down(nets) {
            return;
        }
        std::thread::sleep(POLL_INTERVAL);
    }
    for net in nets {
        match controller.abort(*net) {
            Ok(()) | Err(takt_core::Error::NoSuchNet(_)) => {}
            Err(why) => tracing::error!("cannot abort {net} of a coordinated start: {why}"),
        }
    }
}
