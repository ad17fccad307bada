//! The minimal client of a KRC over a socket: like a C client that copies a fixed answer and patches its counters.
//! It decodes, checks and commands nothing.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use takt_fri::link::Link;
use takt_fri::linux::UdpLink;
use takt_fri::lwr::wire::{Cmd, Msr};
use takt_rt::stats::{Recorder, RecorderReader};
use takt_rt::thread::{Thread, ThreadConfig, spawn};

/// The client in a thread of its own, like a driver.
pub(crate) struct Baseline {
    pub(crate) answer_time: RecorderReader,
    stop: Arc<AtomicBool>,
    thread: Option<Thread<()>>,
}

impl Baseline {
    pub(crate) fn start(mut link: UdpLink, priority: Option<u8>, cpus: Vec<usize>) -> Self {
        let mut times = Recorder::new();
        let answer_time = times.reader();
        let stop = Arc::new(AtomicBool::new(false));
        let stopping = Arc::clone(&stop);
        let config = ThreadConfig {
            priority,
            cpus,
            ..ThreadConfig::new("baseline")
        };
        let body = move || {
            let (mut answer, mut count) = ([0; Cmd::LEN], 0_u16);
            let _fits = Cmd::default().encode(&mut answer);
            while !stopping.load(Ordering::Relaxed) {
                let mut state = [0; Msr::LEN + 1];
                let received = link.receive(&mut state, Duration::from_millis(20));
                let Ok(Some((Msr::LEN, at))) = received else {
                    continue;
                };
                count = count.wrapping_add(1);
                answer[..2].copy_from_slice(&count.to_le_bytes());
                answer[2..4].copy_from_slice(&state[..2]);
                let _sent = link.send(&answer);
                times.record(takt_rt::monotonic() - at.into());
            }
        };
        let thread = spawn(config, body).expect("the system has a thread to give");
        Self {
            answer_time,
            stop,
            thread: Some(thread),
        }
    }
}

impl Drop for Baseline {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.join().expect("it does not panic");
        }
    }
}
