//! Writes recordings as pcap with nanoseconds. What was written before an error stays readable: only whole records are
//! written, and none after a failed one.

use std::fmt;
use std::io::{self, Write};
use std::time::Duration;

use super::LinkType;

const NANOSECONDS: u32 = 0xA1B2_3C4D;
const HEADER: usize = 24;
const RECORD: usize = 16;
/// Longest packet stated to readers, bytes.
const SNAPLEN: u32 = 0x0004_0000;

/// Writes a recording, each packet at once: after a crash at most the last one is missing.
pub struct Writer<W> {
    to: W,
    record: Vec<u8>,
    has_failed: bool,
}

impl<W: Write> Writer<W> {
    /// Writes the header of the file.
    pub fn new(mut to: W, link: LinkType) -> io::Result<Self> {
        let mut header = [0; HEADER];
        header[..4].copy_from_slice(&NANOSECONDS.to_le_bytes());
        (header[4], header[6]) = (2, 4);
        header[16..20].copy_from_slice(&SNAPLEN.to_le_bytes());
        header[20..].copy_from_slice(&link.0.to_le_bytes());
        to.write_all(&header)?;
        Ok(Self {
            to,
            record: Vec::new(),
            has_failed: false,
        })
    }

    /// Writes a packet; times beyond the year 2106 are written as zero.
    ///
    /// # Errors
    /// If it cannot be written, or an earlier packet could not: records after half a record are unreadable anyway.
    pub fn write(&mut self, at: Duration, packet: &[u8]) -> io::Result<()> {
        if self.has_failed {
            let why = "an earlier error ended the recording";
            return Err(io::Error::other(why));
        }
        let packet = packet.get(..SNAPLEN as usize).unwrap_or(packet);
        let len = u32::try_from(packet.len())
            .unwrap_or(u32::MAX)
            .to_le_bytes();
        let seconds = u32::try_from(at.as_secs()).unwrap_or(0).to_le_bytes();
        self.record.clear();
        self.record.reserve(RECORD + packet.len());
        for field in [seconds, at.subsec_nanos().to_le_bytes(), len, len] {
            self.record.extend(field);
        }
        self.record.extend(packet);
        let written = self.to.write_all(&self.record);
        self.has_failed = written.is_err();
        written
    }

    /// Flushes the buffers of the inner writer.
    pub fn flush(&mut self) -> io::Result<()> {
        let flushed = self.to.flush();
        self.has_failed |= flushed.is_err();
        flushed
    }

    /// Returns the inner writer.
    pub fn into_inner(self) -> W {
        self.to
    }
}

impl<W> fmt::Debug for Writer<W> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Writer")
            .field("has_failed", &self.has_failed)
            .finish_non_exhaustive()
    }
}
