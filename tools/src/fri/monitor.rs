//! `takt fri monitor`: each datagram of a recording in one line. It judges nothing.

use std::path::PathBuf;

use clap::Args;
use takt_fri::capture::Decoded;

use super::recording::Recording;
use crate::Verdict;
use crate::output::say;

/// Show what robot and host told each other: one line per FRI datagram of a recording.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  tcpdump -i enp3s0 -w arm.pcap udp port 49938
  takt fri monitor --from arm.pcap --count 20")]
pub(crate) struct Monitor {
    /// The recording: pcap or pcapng.
    #[arg(long, value_name = "FILE")]
    from: PathBuf,
    /// End after so many datagrams.
    #[arg(long, value_name = "N")]
    count: Option<u64>,
    /// Show UDP datagrams that are not FRI, too.
    #[arg(long)]
    all: bool,
}

impl Monitor {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let mut recording = Recording::open(&self.from)?;
        let mut shown = 0;
        while self.count.is_none_or(|count| shown < count) {
            let Some(datagram) = recording.next()? else {
                break;
            };
            let is_foreign = matches!(Decoded::of(&datagram.bytes), Decoded::Foreign { .. });
            if self.all || !is_foreign {
                say(&datagram.to_string())?;
                shown += 1;
            }
        }
        Ok(Verdict::Good)
    }
}
