//! `takt can send`: frames in the notation of candump and cansend. Of their meaning it only checks whether they can
//! start a motion.

use std::time::{Duration, Instant};

use anyhow::Context as _;
use clap::Args;
use takt_can::AnyFrame;
use takt_can::link::Link as _;
use takt_can::linux::{Options, QueuePolicy, SocketCan};
use takt_can::log::parse_frame;

use super::confirm;
use super::feed::cannot_open;
use crate::Verdict;
use crate::output::{say, span};
use crate::signal::Stop;

/// Send frames.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt can send can0 000#8205                     NMT: node 5, reset communication
  takt can send can0 605#4041600000000000         SDO: read the statusword of node 5
  takt can send can0 705#R                        request the state of node 5
  takt can send vcan0 123##1AABBCC 18FEF100#01    CAN FD, and 29 bits
  takt can send can0 080# --period 10ms --count 100 --yes")]
pub(crate) struct Send {
    /// The CAN interface.
    interface: String,
    /// Frames: ID#DATA, ID#R for a remote one, ID##FLAGS-DATA for CAN FD.
    #[arg(required = true, value_parser = frame)]
    frames: Vec<AnyFrame>,
    /// How many times to send all frames.
    #[arg(long, value_name = "N", default_value_t = 1)]
    count: u32,
    /// Time from one repetition to the next.
    #[arg(long, value_name = "TIME", default_value = "100ms", value_parser = span)]
    period: Duration,
    /// How long to wait for room in the send queue.
    #[arg(long, alias = "wait", value_name = "TIME", default_value = "1s", value_parser = span)]
    timeout: Duration,
    /// It is safe that a machine moves.
    #[arg(long = "yes", alias = "confirm-motion")]
    confirm_motion: bool,
}

fn frame(text: &str) -> Result<AnyFrame, String> {
    parse_frame(text).map_err(|error| error.to_string())
}

impl Send {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let options = Options {
            queue: QueuePolicy::Wait(self.timeout),
            ..Options::default()
        };
        let link = SocketCan::open(&self.interface, &options);
        let mut link = link.map_err(|error| cannot_open(&self.interface, &error))?;
        confirm::motion(&self.interface, &self.frames, self.confirm_motion)?;
        let stop = Stop::listen()?;
        let start = Instant::now();
        let mut sent = 0_u64;
        for turn in 0..self.count {
            if turn > 0 {
                sleep_until(start + self.period * turn, &stop);
            }
            if stop.is_requested() {
                break;
            }
            for frame in &self.frames {
                let done = link.send(frame);
                done.with_context(|| {
                    format!(
                        "{}: cannot send {frame}, {sent} frames sent",
                        self.interface
                    )
                })?;
                sent += 1;
            }
        }
        say(&format!("{}: sent {sent}", self.interface))?;
        Ok(Verdict::Good)
    }
}

/// Sleeps until `at`, or until shortly after a stop request.
pub(super) fn sleep_until(at: Instant, stop: &Stop) {
    loop {
        let left = at.saturating_duration_since(Instant::now());
        if left.is_zero() || stop.is_requested() {
            return;
        }
        std::thread::sleep(left.min(Duration::from_millis(50)));
    }
}
