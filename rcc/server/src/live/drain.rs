//! The thread that drains the rings of the controller about 50 times a second, for all clients. It sends nothing over TCP.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use takt_core::Controller;
use takt_core::record::LiveStream;

use crate::error::Error;
use crate::live::hub::{Batch, Hub};
use crate::log::LogBook;
use crate::site::Counters;

/// Time between two polls.
const INTERVAL: Duration = Duration::from_millis(20);
/// Loss after this long without loss is a new onset.
const QUIET: Duration = Duration::from_secs(10);

/// The thread; dropping it ends it.
#[derive(Debug)]
pub(crate) struct Drain {
    stop: Arc<AtomicBool>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Drop for Drain {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the thread of live data panicked");
        }
    }
}

/// What the thread does each time.
pub(crate) trait Task: Send {
    /// Sends what is new.
    fn poll(&mut self, now: Instant);
}

impl Drain {
    /// Starts the thread with these tasks.
    pub(crate) fn start(mut tasks: Vec<Box<dyn Task>>) -> Result<Self, Error> {
        let stop = Arc::new(AtomicBool::new(false));
        let ends = Arc::clone(&stop);
        let work = move || {
            let mut next = Instant::now();
            while !ends.load(Ordering::Relaxed) {
                tasks.retain_mut(|task| {
                    let polled = catch_unwind(AssertUnwindSafe(|| task.poll(Instant::now())));
                    if polled.is_err() {
                        tracing::error!(
                            "live data: one of its tasks panicked and is off until the controller is started again"
                        );
                    }
                    polled.is_ok()
                });
                next += INTERVAL;
                let now = Instant::now();
                // A stall is not made up for: the rings hold what was missed.
                next = next.max(now);
                std::thread::sleep(next - now);
            }
        };
        let thread = std::thread::Builder::new()
            .name("takt-live".to_owned())
            .spawn(work)
            .map_err(Error::Threads)?;
        Ok(Self {
            stop,
            thread: Some(thread),
        })
    }
}

/// An amount of loss, reported once per onset.
#[derive(Debug, Default)]
pub(crate) struct Loss {
    pub(crate) total: u64,
    grew: Option<Instant>,
}

impl Loss {
    /// Adds to it; returns whether this is an onset.
    pub(crate) fn add(&mut self, amount: u64, now: Instant) -> bool {
        if amount == 0 {
            return false;
        }
        self.total += amount;
        let before = self.grew.replace(now);
        before.is_none_or(|before| now.saturating_duration_since(before) >= QUIET)
    }
}

/// Sends the messages of recordings to clients of the Foxglove WebSocket.
pub(crate) struct Messages {
    stream: LiveStream,
    hub: Arc<Hub>,
    log: LogBook,
    /// Number of the next line of the log.
    line: u64,
    lost: Loss,
    dropped: Loss,
    has_failed: bool,
    clients: usize,
}

impl Task for Messages {
    fn poll(&mut self, now: Instant) {
        self.send_messages(now);
    }
}

impl Messages {
    pub(crate) fn new(controller: &Controller, every: u64, hub: Arc<Hub>, log: LogBook) -> Self {
        let (_, line) = log.lines(u64::MAX, "");
        Self {
            stream: LiveStream::new(controller, every),
            hub,
            log,
            line,
            lost: Loss::default(),
            dropped: Loss::default(),
            has_failed: false,
            clients: 0,
        }
    }

    fn send_messages(&mut self, now: Instant) {
        let hub = Arc::clone(&self.hub);
        let mut batch = Batch::new(&hub);
        let clients = hub.clients();
        if clients > std::mem::replace(&mut self.clients, clients) {
            // A cell that was reloaded has other frames.
            self.stream.repeat_frames();
        }
        let wants = batch.wants_any();
        let result = self.send_log(&mut batch).and_then(|()| {
            let lost = self.stream.poll(&mut batch, wants)?;
            Ok(lost)
        });
        batch.deliver();
        match result {
            Ok(lost) => {
                Counters::add(&hub.counters.live_lost, lost);
                if self.lost.add(lost, now) {
                    tracing::warn!(
                        "live data: {lost} rows were overwritten before they were read: this host stalled; {} in all",
                        self.lost.total
                    );
                }
            }
            Err(error) if !std::mem::replace(&mut self.has_failed, true) => {
                tracing::warn!("live data: {error}; some topics are missing");
            }
            Err(_) => {}
        }
        let dropped = Counters::read(&hub.counters.live_dropped) - self.dropped.total;
        if self.dropped.add(dropped, now) {
            tracing::warn!(
                "live data: a client is too slow and lost {dropped} messages\nhint: subscribe fewer topics, or send fewer cycles \
                 with every under [live] of cell.toml"
            );
        }
    }

    fn send_log(&mut self, batch: &mut Batch<'_>) -> Result<(), takt_core::Error> {
        let (lines, next) = self.log.lines(self.line, "");
        self.line = next;
        for (_, line) in &lines {
            let (level, part, text) = parts_of(line);
            self.stream.log(batch, level, (part, text))?;
        }
        Ok(())
    }
}

/// Level, part of the program and text of a line of the log: `2026-01-01T00:00:00Z  WARN takt_core::x: text`.
fn parts_of(line: &str) -> (tracing::Level, &str, &str) {
    let mut words = line.trim_end().splitn(2, ' ');
    let rest = words.nth(1).unwrap_or(line).trim_start();
    let (level, rest) = rest.split_once(' ').unwrap_or(("", line));
    let Ok(level) = level.parse() else {
        return (tracing::Level::INFO, "", line);
    };
    let (part, text) = rest.split_once(": ").unwrap_or(("", rest));
    (level, part, text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn log_line_splits_into_level_part_text() {
        let line = "2026-01-01T00:00:00.000001Z  WARN takt_core::record: a: b";
        let wanted = (tracing::Level::WARN, "takt_core::record", "a: b");
        assert_eq!(parts_of(line), wanted);
        assert_eq!(parts_of("odd"), (tracing::Level::INFO, "", "odd"));
        assert_eq!(parts_of(""), (tracing::Level::INFO, "", ""));
    }

    #[test]
    fn loss_is_reported_once_per_onset() {
        let (mut loss, begin) = (Loss::default(), Instant::now());
        assert!(!loss.add(0, begin));
        assert!(loss.add(3, begin));
        assert!(!loss.add(3, begin + QUIET / 2));
        assert!(loss.add(1, begin + QUIET * 2));
        assert_eq!(loss.total, 7);
    }
}
