//! Why a controller is silent: an ordinary thread beside the driver's analyses the wire once per silence, and reports the
//! cause with its remedy. The real-time thread has no part in it.

use std::net::SocketAddr;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use takt_core::device::driver::DriverEvent;
use takt_fri::client::DatagramError;
use takt_fri::silence::Watch;

use super::Shared;
use super::events::EventReceiver;

/// Time between two looks at the counters.
const POLL_EVERY: Duration = Duration::from_millis(100);
/// Time without a measurement after which packets are captured.
const CAPTURE_AFTER: Duration = Duration::from_millis(500);
/// Time without a measurement after which the cause is reported.
const REPORT_AFTER: Duration = Duration::from_secs(3);
/// The thread formats texts and reads tables of the kernel, with little on its stack. Locked memory counts.
const STACK: usize = 256 << 10;

/// What to do about a silence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    /// Measurements arrive, or the cause was reported.
    Nothing,
    /// Capture packets.
    Capture,
    /// Report the cause, once.
    Report,
}

/// One connection: when its last measurement arrived, and whether its silence was reported.
#[derive(Debug)]
struct Silence {
    received: u64,
    since: Instant,
    is_reported: bool,
}

impl Silence {
    const fn new(now: Instant) -> Self {
        Self {
            received: 0,
            since: now,
            is_reported: false,
        }
    }

    /// Handles the number of measurements received up to `now`.
    fn step(&mut self, received: u64, now: Instant) -> Step {
        if received != self.received {
            self.received = received;
            (self.since, self.is_reported) = (now, false);
        }
        let silent = now.saturating_duration_since(self.since);
        if self.is_reported || silent < CAPTURE_AFTER {
            return Step::Nothing;
        }
        if silent < REPORT_AFTER {
            return Step::Capture;
        }
        self.is_reported = true;
        Step::Report
    }
}

/// The receiver of what the thread reports; the thread ends when this is dropped.
#[derive(Debug)]
pub(super) struct SilenceWatch {
    causes: Mutex<Receiver<String>>,
    _stop: Option<Sender<()>>,
}

impl SilenceWatch {
    /// Starts the thread. Without one, for lack of memory, silences are not analysed.
    pub(super) fn start(
        name: &str,
        listen: SocketAddr,
        shared: Arc<Shared>,
        events: Arc<EventReceiver>,
    ) -> Self {
        let (causes, reported) = channel();
        let (stop, stopping) = channel();
        let thread = std::thread::Builder::new()
            .name(format!("takt-{name}-silence"))
            .stack_size(STACK);
        let started = thread.spawn(move || observe(listen, &shared, &events, &causes, &stopping));
        Self {
            causes: Mutex::new(reported),
            _stop: started.is_ok().then_some(stop),
        }
    }

    /// The cause of a silence that was not read yet.
    pub(super) fn poll(&self) -> Option<DriverEvent> {
        let causes = self.causes.lock().unwrap_or_else(PoisonError::into_inner);
        causes.try_recv().ok().map(DriverEvent::warning)
    }
}

fn observe(
    listen: SocketAddr,
    shared: &Shared,
    events: &EventReceiver,
    causes: &Sender<String>,
    stopping: &Receiver<()>,
) {
    let mut silence = Silence::new(Instant::now());
    // Datagrams rejected before the silence began.
    let mut rejected = 0;
    let mut watch = None;
    while stopping.recv_timeout(POLL_EVERY) == Err(RecvTimeoutError::Timeout) {
        let malformed = shared.malformed.load(Ordering::Relaxed);
        match silence.step(shared.received.load(Ordering::Relaxed), Instant::now()) {
            Step::Nothing => {
                watch = None;
                rejected = malformed;
            }
            Step::Capture => watch.get_or_insert_with(|| Watch::new(listen)).poll(),
            Step::Report => {
                let watch = watch.take().unwrap_or_else(|| Watch::new(listen));
                let error = events.diagnostics().decode_error;
                let refusal = error.filter(|_| malformed > rejected);
                let cause = watch.cause(refusal.map(DatagramError::from));
                if causes.send(cause.to_string()).is_err() {
                    return;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::events::event_channel;
    use super::*;
    use takt_fri::diagnosis::Observer;

    #[test]
    fn fri_silence_is_reported_once_per_onset() {
        let start = Instant::now();
        let mut silence = Silence::new(start);
        let mut reports = Vec::new();
        // Measurements from 5 s to 7 s, and from 20 s on.
        for ms in (0..30_000).step_by(100) {
            let received = match ms {
                0..5_000 => 0,
                5_000..7_000 => ms - 5_000 + 1,
                7_000..20_000 => 1_901,
                _ => ms,
            };
            if silence.step(received, start + Duration::from_millis(ms)) == Step::Report {
                reports.push(ms);
            }
        }
        assert_eq!(reports, [3_000, 9_900]);
    }

    #[test]
    fn fri_silent_controller_is_reported_with_remedy() {
        let shared = Arc::new(Shared::default());
        let (_sender, events) = event_channel(Observer::lwr());
        let listen = SocketAddr::from(([127, 0, 0, 1], 49_938));
        let watch = SilenceWatch::start("arm", listen, shared, Arc::new(events));
        let until = Instant::now() + Duration::from_secs(60);
        let event = loop {
            match watch.poll() {
                Some(event) => break event,
                None if Instant::now() > until => panic!("no report"),
                None => std::thread::sleep(POLL_EVERY),
            }
        };
        assert!(
            event
                .text
                .starts_with("no measurement arrives at 127.0.0.1:49938"),
            "{event:?}"
        );
        assert!(event.text.contains("\nhint: "), "{event:?}");
    }
}
