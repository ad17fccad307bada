//! `takt ecat dump`: a recording of a segment as text, one line per datagram, with decoded registers, states and
//! mailboxes. `stat` evaluates recordings.

mod meaning;

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;

use super::directions::{Direction, directions};
use super::frames::{Capture, Taken, datagrams};
use crate::Verdict;
use crate::output::{complain, say};
use meaning::Meanings;

/// Print a recording as text, one line per datagram, with its meaning.
///
/// Reads pcap and pcapng files as `tcpdump -w` and Wireshark write them, and those of capture probes (ERF, ET2000). Frames
/// of other protocols are left out. A truncated file is printed up to the cut. Exit status: 0 read to the end; 1 it contains
/// broken frames; 2 it could not be read.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  tcpdump -i enp2s0 -w fault.pcap ether proto 0x88a4
  takt ecat dump --from fault.pcap
  takt ecat dump --from fault.pcap --returned --station 1003

> is sent to the slaves, < returns from them with working counters (wkc).")]
pub(crate) struct Dump {
    /// The recording.
    #[arg(long, value_name = "FILE")]
    from: PathBuf,
    /// Print only frames that returned.
    #[arg(long)]
    returned: bool,
    /// Print only datagrams to this station address, hexadecimal.
    #[arg(long, value_name = "ADDRESS", value_parser = station)]
    station: Option<u16>,
    /// Stop after this many lines.
    #[arg(long, value_name = "N", default_value_t = u64::MAX, hide_default_value = true)]
    count: u64,
}

fn station(text: &str) -> Result<u16, String> {
    u16::from_str_radix(text.trim_start_matches("0x"), 16).map_err(|_| {
        format!("`{text}` is not a station address\nhint: write up to four hexadecimal digits")
    })
}

impl Dump {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let name = self.from.display();
        let capture = Capture::read(&self.from)?;
        capture.check(&name.to_string())?;
        let mut decoder = Decoder::default();
        let filter = Filter {
            returned: self.returned,
            station: self.station,
        };
        let mut left = self.count;
        say(HEADER)?;
        for (taken, way) in capture.frames.iter().zip(directions(&capture.frames)) {
            for line in decoder.lines(taken, way, filter) {
                if left == 0 {
                    return Ok(decoder.verdict());
                }
                left -= 1;
                say(&line)?;
            }
        }
        for note in capture.notes() {
            complain(&format!("note: {name}: {note}"));
        }
        if decoder.broken > 0 {
            complain(&format!("{name}: {} broken frames", decoder.broken));
        }
        Ok(decoder.verdict())
    }
}

const HEADER: &str = "     time s    command  idx   address  len  wkc";

/// Selects the lines to print.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Filter {
    pub(super) returned: bool,
    pub(super) station: Option<u16>,
}

/// Formats frames as lines.
#[derive(Debug, Default)]
pub(super) struct Decoder {
    meanings: Meanings,
    /// Zero of the time stamps.
    begin: Option<Duration>,
    broken: u64,
}

impl Decoder {
    /// Fails if a frame could not be decoded.
    pub(super) const fn verdict(&self) -> Verdict {
        if self.broken == 0 {
            Verdict::Good
        } else {
            Verdict::Failed
        }
    }

    /// The lines of one frame.
    pub(super) fn lines(&mut self, taken: &Taken, way: Direction, filter: Filter) -> Vec<String> {
        let begin = *self.begin.get_or_insert(taken.at);
        let time = taken.at.saturating_sub(begin);
        let time = format!("{:>4}.{:06}", time.as_secs(), time.subsec_micros());
        let frame = match taken.frame() {
            Ok(frame) => frame,
            Err(error) => {
                self.broken += 1;
                return vec![format!("{time}  ! {error}")];
            }
        };
        let mut lines = Vec::new();
        for datagram in datagrams(&frame) {
            match datagram {
                Ok(datagram) => {
                    let back = way == Direction::Back;
                    let meaning = self.meanings.of(&datagram, back);
                    if (filter.returned && !back) || !filter.matches(&datagram) {
                        continue;
                    }
                    lines.push(format!("{time} {}", line(way, &datagram, &meaning)));
                }
                Err(error) => {
                    self.broken += 1;
                    lines.push(format!("{time}  ! {error}"));
                }
            }
        }
        lines
    }
}

impl Filter {
    fn matches(self, datagram: &takt_ethercat::Datagram<'_>) -> bool {
        self.station
            .is_none_or(|station| meaning::station(datagram) == Some(station))
    }
}

fn line(way: Direction, datagram: &takt_ethercat::Datagram<'_>, meaning: &str) -> String {
    let header = datagram.header;
    let arrow = match way {
        Direction::Out => '>',
        Direction::Back => '<',
    };
    let counter = match way {
        Direction::Out => "-".to_owned(),
        Direction::Back => datagram.working_counter.to_string(),
    };
    let line = format!(
        "{arrow} {:<6}  {:02X}  {:>9}  {:>4}  {counter:>3}  {meaning}",
        header.command.to_string(),
        header.index,
        header.address.to_string().to_uppercase(),
        header.len,
    );
    line.trim_end().to_owned()
}
