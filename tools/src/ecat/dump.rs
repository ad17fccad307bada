//! `takt ecat dump`: a recording of a segment as text, one line for each datagram, with what registers, states and
//! mailboxes in it mean. It judges nothing; and it reads only what was recorded.

mod meaning;

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context as _, ensure};
use clap::Args;
use takt_ethercat::Frame;
use takt_ethercat::link::{PcapReader, PcapRecord};

use super::ways::{Way, Ways, body};
use crate::Verdict;
use crate::output::{complain, say};
use meaning::Meanings;

/// Show a recording as text, one line for each datagram, with what it means.
///
/// Reads pcap files as `tcpdump -w` and Wireshark write them (pcapng by `tshark -F pcap`). Frames of other
/// protocols are left out. Exit status: 0 read to its end; 1 a frame in it is broken; 2 it is no such file.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  tcpdump -i enp2s0 -w fault.pcap ether proto 0x88a4
  takt ecat dump --from fault.pcap
  takt ecat dump --from fault.pcap --returned --station 1003

> goes to the slaves, < comes back from them with working counters (wkc).")]
pub(crate) struct Dump {
    /// The recording.
    #[arg(long, value_name = "FILE")]
    from: PathBuf,
    /// Show only frames that came back.
    #[arg(long)]
    returned: bool,
    /// Show only datagrams to this station address, hexadecimal.
    #[arg(long, value_name = "ADDRESS", value_parser = station)]
    station: Option<u16>,
    /// End after so many lines.
    #[arg(long, value_name = "N", default_value_t = u64::MAX, hide_default_value = true)]
    count: u64,
}

fn station(text: &str) -> Result<u16, String> {
    u16::from_str_radix(text.trim_start_matches("0x"), 16)
        .map_err(|_| format!("`{text}` is no station address: write up to four hexadecimal digits"))
}

impl Dump {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let name = self.from.display();
        let bytes = std::fs::read(&self.from).with_context(|| format!("cannot read {name}"))?;
        let mut decoder = Decoder::new(&bytes).with_context(|| name.to_string())?;
        let filter = Filter {
            returned: self.returned,
            station: self.station,
        };
        let mut left = self.count;
        say(HEADER)?;
        for record in PcapReader::new(&bytes).with_context(|| name.to_string())? {
            let record = record.with_context(|| name.to_string())?;
            for line in decoder.lines(&record, filter) {
                if left == 0 {
                    return Ok(decoder.verdict());
                }
                left -= 1;
                say(&line)?;
            }
        }
        ensure!(
            decoder.frames > 0,
            "{name}: no EtherCAT frame in it ({} others); was it recorded at the right interface?",
            decoder.others
        );
        if decoder.broken > 0 {
            complain(&format!("{name}: {} broken frames", decoder.broken));
        }
        Ok(decoder.verdict())
    }
}

const HEADER: &str = "     time s    command  idx   address  len  wkc";

/// Which lines are shown.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Filter {
    pub(super) returned: bool,
    pub(super) station: Option<u16>,
}

/// Turns records into lines.
#[derive(Debug)]
pub(super) struct Decoder {
    ways: Ways,
    meanings: Meanings,
    /// What time counts from.
    begin: Option<Duration>,
    pub(super) frames: u64,
    others: u64,
    broken: u64,
}

impl Decoder {
    /// Looks through a recording for what tells frames out from frames back.
    pub(super) fn new(bytes: &[u8]) -> anyhow::Result<Self> {
        Ok(Self {
            ways: Ways::new(bytes)?,
            meanings: Meanings::default(),
            begin: None,
            frames: 0,
            others: 0,
            broken: 0,
        })
    }

    /// Whether all frames could be read.
    pub(super) const fn verdict(&self) -> Verdict {
        if self.broken == 0 {
            Verdict::Good
        } else {
            Verdict::Failed
        }
    }

    /// The lines of one record.
    pub(super) fn lines(&mut self, record: &PcapRecord<'_>, filter: Filter) -> Vec<String> {
        let Some(body) = body(record.frame) else {
            self.others += 1;
            return Vec::new();
        };
        self.frames += 1;
        let begin = *self.begin.get_or_insert(record.at);
        let time = record.at.saturating_sub(begin);
        let time = format!("{:>4}.{:06}", time.as_secs(), time.subsec_micros());
        let frame = match Frame::decode(body) {
            Ok(frame) => frame,
            Err(error) => {
                self.broken += 1;
                return vec![format!("{time}  ! {error}")];
            }
        };
        let way = self.ways.of(record, &frame);
        let mut lines = Vec::new();
        for datagram in frame.datagrams() {
            match datagram {
                Ok(datagram) => {
                    let back = way == Way::Back;
                    let meaning = self.meanings.of(&datagram, back);
                    if (filter.returned && !back) || !filter.lets(&datagram) {
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
    fn lets(self, datagram: &takt_ethercat::Datagram<'_>) -> bool {
        self.station
            .is_none_or(|station| meaning::station(datagram) == Some(station))
    }
}

fn line(way: Way, datagram: &takt_ethercat::Datagram<'_>, meaning: &str) -> String {
    let header = datagram.header;
    let arrow = match way {
        Way::Out => '>',
        Way::Back => '<',
    };
    let counter = match way {
        Way::Out => "-".to_owned(),
        Way::Back => datagram.working_counter.to_string(),
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
