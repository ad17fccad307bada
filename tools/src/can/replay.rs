//! `takt can replay`: sends a recording to an interface, with the recorded timing. It ignores received frames; the
//! diagnostic commands read a recording with `--from`.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::Context as _;
use clap::Args;
use takt_can::link::Link as _;
use takt_can::linux::{Options, QueuePolicy, SocketCan};
use takt_can::log::Record;

use super::confirm;
use super::feed::{cannot_open, read_log};
use super::filter::{Filter, is_shown};
use super::send::sleep_until;
use crate::Verdict;
use crate::output::{complain, say, span};
use crate::signal::Stop;

/// Send a recording: candump log or text, ASC, BLF, TRC, pcap or pcapng.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt can replay fault.log vcan0
  takt can replay fault.blf vcan0 --channel 2 --speed 10
  takt can replay fault.log vcan0 --filter node=5 --at-once")]
pub(crate) struct Replay {
    /// The recording.
    file: PathBuf,
    /// The CAN interface to send on.
    interface: String,
    /// Only frames of this interface or channel of the recording.
    #[arg(long, value_name = "NAME")]
    channel: Option<String>,
    /// Only these frames; filters as in `dump`.
    #[arg(long, value_name = "FILTER")]
    filter: Vec<Filter>,
    /// How many times faster than recorded, 0.001 to 1000.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = speed)]
    speed: f64,
    /// Do not wait between frames.
    #[arg(long, conflicts_with = "speed")]
    at_once: bool,
    /// How long to wait for room in the send queue.
    #[arg(long, alias = "wait", value_name = "TIME", default_value = "1s", value_parser = span)]
    timeout: Duration,
    /// It is safe that a machine moves.
    #[arg(long = "yes", alias = "confirm-motion")]
    confirm_motion: bool,
}

fn speed(text: &str) -> Result<f64, String> {
    let speed: f64 = text
        .parse()
        .map_err(|_| format!("`{text}` is not a number"))?;
    if (0.001..=1000.0).contains(&speed) {
        Ok(speed)
    } else {
        Err("must be 0.001 to 1000".to_owned())
    }
}

impl Replay {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let log = read_log(&self.file)?;
        let (frames, error_frames): (Vec<Record>, Vec<Record>) = log
            .records
            .into_iter()
            .filter(|record| self.selects(record))
            .partition(|record| record.frame.id().is_some());
        if !error_frames.is_empty() {
            let count = error_frames.len();
            complain(&format!(
                "{count} error frames left out: they were never on the bus"
            ));
        }
        anyhow::ensure!(
            !frames.is_empty(),
            "no frame of the recording matches --channel and --filter"
        );
        let options = Options {
            queue: QueuePolicy::Wait(self.timeout),
            ..Options::default()
        };
        let link = SocketCan::open(&self.interface, &options);
        let mut link = link.map_err(|error| cannot_open(&self.interface, &error))?;
        let all = frames.iter().map(|record| &record.frame);
        confirm::motion(&self.interface, all, self.confirm_motion)?;
        self.send(&frames, &mut link)
    }

    fn selects(&self, record: &Record) -> bool {
        let channel = self.channel.as_ref();
        channel.is_none_or(|channel| *channel == record.interface)
            && is_shown(&self.filter, &record.frame)
    }

    fn send(&self, frames: &[Record], link: &mut SocketCan) -> anyhow::Result<Verdict> {
        let stop = Stop::listen()?;
        let begin = frames.first().map(|record| record.at).unwrap_or_default();
        let start = Instant::now();
        let mut sent = 0_u64;
        for record in frames {
            if !self.at_once {
                let offset = record.at.saturating_sub(begin).div_f64(self.speed);
                sleep_until(start + offset, &stop);
            }
            if stop.is_requested() {
                break;
            }
            let done = link.send(&record.frame);
            done.with_context(|| {
                let frame = record.frame;
                format!(
                    "{}: cannot send {frame}, {sent} frames sent",
                    self.interface
                )
            })?;
            sent += 1;
        }
        say(&format!(
            "{}: sent {sent} of {}",
            self.interface,
            frames.len()
        ))?;
        Ok(if sent == frames.len() as u64 {
            Verdict::Good
        } else {
            Verdict::Failed
        })
    }
}
