//! The thread that reads the controller, so that keys are handled while it does not answer. It tries again for ever.

use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel, sync_channel};
use std::time::{Duration, Instant};

use super::report::Report;
use crate::http::Http;
use crate::output::chain;

/// Reports not yet shown; with more the thread waits.
const AHEAD_MAX: usize = 2;

/// What a reading gave: a report, or why there is none.
pub(super) type Reading = Result<Report, String>;

/// The thread, which ends when this is dropped.
#[derive(Debug)]
pub(super) struct Poller {
    readings: Receiver<Reading>,
    _end: Sender<()>,
}

impl Poller {
    pub(super) fn start(http: Http, interval: Duration) -> Self {
        let (sender, readings) = sync_channel(AHEAD_MAX);
        let (end, ended) = channel::<()>();
        std::thread::spawn(move || {
            let mut before: Option<Report> = None;
            loop {
                let begin = Instant::now();
                let reading = Report::read(&http, before.as_ref()).map_err(|it| chain(&it));
                if let Ok(report) = &reading {
                    before = Some(report.clone());
                }
                if sender.send(reading).is_err() {
                    return;
                }
                let rest = interval.saturating_sub(begin.elapsed());
                if ended.recv_timeout(rest) != Err(RecvTimeoutError::Timeout) {
                    return;
                }
            }
        });
        Self {
            readings,
            _end: end,
        }
    }

    /// The latest reading; `None` if there is no new one.
    pub(super) fn latest(&self) -> Option<Reading> {
        self.readings.try_iter().last()
    }
}
