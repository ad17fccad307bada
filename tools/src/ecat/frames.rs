//! The EtherCAT frames of a recording, without other protocols, frames that were recorded twice, and other lines of a
//! probe. The content of frames is not decoded here.

use std::io::Read;
use std::path::Path;
use std::time::Duration;

use anyhow::{Context as _, ensure};
use takt_ethercat::link::{ETHER_TYPE, HEADER_LEN};
use takt_ethercat::{Datagram, DecodeError, Frame, FrameHeader};
use takt_link::capture::{Cut, EthernetFrame, Frames};

/// Equal frames within this time were recorded twice; on the wire none is repeated that soon.
const TWICE: Duration = Duration::from_micros(5);
/// Bytes after the last datagram that are too few for another: the length in the frame header was rounded up.
const PADDING_MAX: usize = 11;

/// An EtherCAT frame of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Taken {
    pub(super) at: Duration,
    /// The frame from its destination address on.
    bytes: Vec<u8>,
}

impl Taken {
    /// The source address; the first slave marks it.
    pub(super) fn source(&self) -> [u8; 6] {
        let six = self.bytes.get(6..).and_then(|rest| rest.first_chunk());
        six.copied().unwrap_or_default()
    }

    /// The EtherCAT frame after the Ethernet header.
    pub(super) fn frame(&self) -> Result<Frame<'_>, DecodeError> {
        Frame::decode(self.bytes.get(HEADER_LEN..).unwrap_or_default())
    }
}

/// The datagrams of a frame. Bytes after the last that are too few for another are padding.
pub(super) fn datagrams<'a>(
    frame: &Frame<'a>,
) -> impl Iterator<Item = Result<Datagram<'a>, DecodeError>> {
    let is_padding = |error: &DecodeError| matches!(error, DecodeError::TrailingBytes { count } if *count <= PADDING_MAX);
    frame
        .datagrams()
        .filter(move |datagram| !datagram.as_ref().is_err_and(is_padding))
}

/// Length of a datagram without data: header and working counter, bytes.
const DATAGRAM_MIN: usize = 12;

/// Shortens a frame of which only the beginning was recorded to its whole datagrams; whether it was longer. Both directions
/// are cut at the same length, so that answers still fit their frames.
fn end_with_whole_datagram(bytes: &mut Vec<u8>) -> bool {
    let word = |bytes: &[u8], at: usize| {
        let two = bytes.get(at..)?.first_chunk()?;
        Some(u16::from_le_bytes(*two))
    };
    let begin = HEADER_LEN + FrameHeader::LEN;
    let announced = word(bytes, HEADER_LEN).map_or(0, |header| usize::from(header & 0x07FF));
    if bytes.len() >= begin + announced {
        return false;
    }
    let (mut end, mut last) = (begin, None);
    while let Some(len) = word(bytes, end + 6) {
        let next = end + DATAGRAM_MIN + usize::from(len & 0x07FF);
        if next > bytes.len() {
            break;
        }
        last = Some(end + 7);
        end = next;
        if len & 0x8000 == 0 {
            break;
        }
    }
    // No datagram follows the last whole one.
    if let Some(flags) = last.and_then(|at| bytes.get_mut(at)) {
        *flags &= 0x7F;
    }
    bytes.truncate(end);
    let len = u16::try_from(end - begin).unwrap_or_default();
    if let Some(header) = bytes.get_mut(HEADER_LEN..begin) {
        header.copy_from_slice(&(len | 0x1000).to_le_bytes());
    }
    true
}

/// The EtherCAT frames of a recording.
#[derive(Debug, Default)]
pub(super) struct Capture {
    pub(super) frames: Vec<Taken>,
    /// Frames of other protocols.
    pub(super) others: u64,
    /// Frames with a wrong checksum at the probe.
    pub(super) corrupt: u64,
    /// Frames of which only the beginning was recorded; they end with their last whole datagram.
    pub(super) truncated: u64,
    /// Each frame was recorded twice; the copies are left out.
    pub(super) is_doubled: bool,
    /// Number of probe lines that are left out.
    pub(super) other_lines: u64,
    pub(super) cut: Option<Cut>,
}

impl Capture {
    /// Reads a file.
    pub(super) fn read(path: &Path) -> anyhow::Result<Self> {
        let name = path.display().to_string();
        let file = std::fs::File::open(path).with_context(|| format!("cannot read {name}"))?;
        Self::of(file).context(name)
    }

    /// Reads a recording.
    pub(super) fn of(from: impl Read) -> anyhow::Result<Self> {
        let mut all = Self::default();
        let mut frames = Frames::new(from)?;
        let mut lined = Vec::new();
        for frame in frames.by_ref() {
            let EthernetFrame {
                at,
                port,
                is_corrupt,
                is_truncated,
                mut bytes,
                ..
            } = frame?;
            if bytes.get(12..HEADER_LEN) != Some(&ETHER_TYPE.to_be_bytes()) {
                all.others += 1;
                continue;
            }
            all.corrupt += u64::from(is_corrupt);
            let is_cut = is_truncated && end_with_whole_datagram(&mut bytes);
            all.truncated += u64::from(is_cut);
            // Without a whole datagram neither direction nor answer is known.
            if is_cut && bytes.len() <= HEADER_LEN + FrameHeader::LEN {
                continue;
            }
            lined.push((port.map(|port| port / 2), Taken { at, bytes }));
        }
        all.cut = frames.cut();
        // Each line of a probe is at another position of a segment, or at another segment.
        let first = lined.iter().find_map(|(line, _)| *line);
        let of_first = |line: &Option<u8>| line.is_none() || *line == first;
        let mut other_lines: Vec<u8> = lined.iter().filter_map(|(line, _)| *line).collect();
        other_lines.sort_unstable();
        other_lines.dedup();
        all.other_lines = u64::try_from(other_lines.len().saturating_sub(1)).unwrap_or(0);
        let kept = lined.into_iter().filter(|(line, _)| of_first(line));
        all.frames = kept.map(|(_, frame)| frame).collect();
        all.undouble();
        Ok(all)
    }

    /// Removes the second of each pair if the whole recording consists of pairs, as at a bridge or at `any`. Single pairs
    /// are frames that a master repeated.
    fn undouble(&mut self) {
        let is_pair =
            |one: &Taken, next: &Taken| one.bytes == next.bytes && next.at.abs_diff(one.at) < TWICE;
        let mut seconds = Vec::new();
        let mut at = 1;
        while let (Some(one), Some(next)) = (self.frames.get(at - 1), self.frames.get(at)) {
            if is_pair(one, next) {
                seconds.push(at);
                at += 1;
            }
            at += 1;
        }
        // Two frames are too few to decide.
        self.is_doubled = self.frames.len() > 2 && seconds.len() * 20 >= self.frames.len() * 9;
        if self.is_doubled {
            let mut number = 0;
            self.frames.retain(|_| {
                let is_second = seconds.binary_search(&number).is_ok();
                number += 1;
                !is_second
            });
        }
    }

    /// Checks that there is something to evaluate.
    ///
    /// # Errors
    /// With what the recording has instead.
    pub(super) fn check(&self, name: &str) -> anyhow::Result<()> {
        ensure!(
            !self.frames.is_empty() || self.truncated == 0,
            "{name}: {} frames are recorded in part, none up to the end of its first datagram\nhint: record whole frames \
             (`tcpdump -s 0`)",
            self.truncated
        );
        ensure!(
            !self.frames.is_empty() || self.cut.is_some(),
            "{name}: no EtherCAT frames, {} others\nhint: record at the interface of the segment",
            self.others
        );
        Ok(())
    }

    /// Notes on how the recording was made.
    pub(super) fn notes(&self) -> Vec<String> {
        let mut notes: Vec<String> = self.cut.iter().map(ToString::to_string).collect();
        if self.is_doubled {
            notes.push("each frame was recorded twice; the copies are left out".to_owned());
        }
        if self.truncated > 0 {
            let truncated = self.truncated;
            notes.push(format!(
                "{truncated} frames are recorded in part; datagrams behind the cut are left out\nhint: record whole frames \
                 (`tcpdump -s 0`)"
            ));
        }
        if self.other_lines > 0 {
            let lines = self.other_lines;
            notes.push(format!(
                "the probe recorded {lines} other lines; only the first is evaluated\nhint: `tshark -Y esl.port==N` selects another"
            ));
        }
        notes
    }
}
