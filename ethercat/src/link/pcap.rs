//! Recordings of a wire in the classic pcap format, which tcpdump, tshark and Wireshark write and read: a reader, a
//! writer, and a [`Replay`] that plays one back as a link. It does not read pcapng; `tshark -F pcap` converts.

use std::io;
use std::time::Duration;

use super::{FRAME_MAX, Link};

/// Why bytes are no recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum PcapError {
    /// The file is shorter than its header.
    #[error("a pcap file begins with 24 bytes of header, this has {0}")]
    Short(usize),
    /// It begins with something else.
    #[error(
        "no pcap file: it begins with {0:08X}h; a pcapng file is converted by `tshark -r FILE -F pcap -w OTHER`"
    )]
    Magic(u32),
    /// It was recorded on something else than Ethernet.
    #[error("the recording is of link type {0}; Ethernet is 1")]
    LinkType(u32),
    /// A record is cut off, or its length cannot be.
    #[error("record {number} announces {len} bytes, {left} are left; the file is cut off")]
    Record {
        /// Counted from 1.
        number: u64,
        /// As announced.
        len: u32,
        /// Bytes left in the file.
        left: usize,
    },
}

/// A recorded frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PcapRecord<'a> {
    /// When it was recorded, since 1970.
    pub at: Duration,
    /// The Ethernet frame, as much of it as was recorded.
    pub frame: &'a [u8],
}

const MICROSECONDS: u32 = 0xA1B2_C3D4;
const NANOSECONDS: u32 = 0xA1B2_3C4D;
const HEADER: usize = 24;
const RECORD: usize = 16;
const ETHERNET: u32 = 1;

/// Goes through the records of a recording.
#[derive(Clone, Debug)]
pub struct PcapReader<'a> {
    rest: &'a [u8],
    big_endian: bool,
    /// Nanoseconds in a unit of the second half of a time stamp.
    unit_ns: u32,
    number: u64,
}

fn u32_at(bytes: &[u8], at: usize, big_endian: bool) -> u32 {
    let four = bytes.get(at..).and_then(|rest| rest.first_chunk());
    let four = four.copied().unwrap_or_default();
    if big_endian {
        u32::from_be_bytes(four)
    } else {
        u32::from_le_bytes(four)
    }
}

impl<'a> PcapReader<'a> {
    /// Reads the file header.
    pub fn new(bytes: &'a [u8]) -> Result<Self, PcapError> {
        let rest = bytes.get(HEADER..).ok_or(PcapError::Short(bytes.len()))?;
        let magic = u32_at(bytes, 0, false);
        let big_endian = matches!(magic.swap_bytes(), MICROSECONDS | NANOSECONDS);
        let unit_ns = match if big_endian {
            magic.swap_bytes()
        } else {
            magic
        } {
            MICROSECONDS => 1000,
            NANOSECONDS => 1,
            _ => return Err(PcapError::Magic(magic)),
        };
        let kind = u32_at(bytes, 20, big_endian) & 0x0FFF_FFFF;
        if kind != ETHERNET {
            return Err(PcapError::LinkType(kind));
        }
        Ok(Self {
            rest,
            big_endian,
            unit_ns,
            number: 0,
        })
    }
}

impl<'a> Iterator for PcapReader<'a> {
    type Item = Result<PcapRecord<'a>, PcapError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.rest.is_empty() {
            return None;
        }
        self.number += 1;
        let field = |at| u32_at(self.rest, at, self.big_endian);
        let (seconds, part, len) = (field(0), field(4), field(8));
        let body = self.rest.get(RECORD..).unwrap_or_default();
        let Some((frame, rest)) = usize::try_from(len)
            .ok()
            .and_then(|len| body.split_at_checked(len))
        else {
            let left = body.len();
            self.rest = &[];
            return Some(Err(PcapError::Record {
                number: self.number,
                len,
                left,
            }));
        };
        self.rest = rest;
        let part = Duration::from_nanos(u64::from(part) * u64::from(self.unit_ns));
        let at = Duration::from_secs(seconds.into()) + part;
        Some(Ok(PcapRecord { at, frame }))
    }
}

/// Writes a recording with nanoseconds.
#[derive(Debug)]
pub struct PcapWriter<W> {
    to: W,
}

impl<W: io::Write> PcapWriter<W> {
    /// Writes the file header.
    pub fn new(mut to: W) -> io::Result<Self> {
        let mut header = [0; HEADER];
        header[..4].copy_from_slice(&NANOSECONDS.to_le_bytes());
        (header[4], header[6]) = (2, 4);
        header[16..20].copy_from_slice(&0x0004_0000_u32.to_le_bytes());
        header[20..].copy_from_slice(&ETHERNET.to_le_bytes());
        to.write_all(&header)?;
        Ok(Self { to })
    }

    /// Writes one frame; times beyond the year 2106 are written as zero.
    pub fn write(&mut self, at: Duration, frame: &[u8]) -> io::Result<()> {
        let len = u32::try_from(frame.len()).unwrap_or(u32::MAX).to_le_bytes();
        let seconds = u32::try_from(at.as_secs()).unwrap_or(0).to_le_bytes();
        let mut record = [0; RECORD];
        let fields = [seconds, at.subsec_nanos().to_le_bytes(), len, len];
        for (to, from) in record.chunks_exact_mut(4).zip(fields) {
            to.copy_from_slice(&from);
        }
        self.to.write_all(&record)?;
        self.to.write_all(frame)
    }

    /// Gives back what was written to.
    pub fn into_inner(self) -> W {
        self.to
    }
}

/// Plays a recording: each frame is received at its recorded time, what is sent goes nowhere.
#[derive(Debug)]
pub struct Replay {
    bytes: Vec<u8>,
    /// Records given so far.
    given: usize,
}

impl Replay {
    /// Checks the whole recording and begins before its first frame.
    pub fn new(bytes: Vec<u8>) -> Result<Self, PcapError> {
        for record in PcapReader::new(&bytes)? {
            record?;
        }
        Ok(Self {
            bytes,
            given: HEADER,
        })
    }
}

impl Link for Replay {
    fn send(&mut self, _frame: &[u8]) -> io::Result<()> {
        Ok(())
    }

    fn receive(
        &mut self,
        buf: &mut [u8],
        _timeout: Duration,
    ) -> io::Result<Option<(usize, Duration)>> {
        let reader = PcapReader::new(&self.bytes).ok();
        let next = reader.and_then(|mut reader| {
            reader.rest = self.bytes.get(self.given..).unwrap_or_default();
            reader.next()?.ok()
        });
        let Some(PcapRecord { at, frame }) = next else {
            return Ok(None);
        };
        self.given += RECORD + frame.len();
        let len = frame.len().min(buf.len()).min(FRAME_MAX);
        buf[..len].copy_from_slice(&frame[..len]);
        Ok(Some((len, at)))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn recording() -> Vec<u8> {
        let mut writer = PcapWriter::new(Vec::new()).unwrap();
        writer.write(Duration::new(7, 8), &[1, 2, 3]).unwrap();
        writer.write(Duration::new(7, 1_000_008), &[4; 60]).unwrap();
        writer.into_inner()
    }

    #[test]
    fn written_recording_reads_back() {
        let bytes = recording();
        let read: Vec<_> = PcapReader::new(&bytes)
            .unwrap()
            .map(Result::unwrap)
            .collect();
        assert_eq!(
            (read[0].at, read[0].frame),
            (Duration::new(7, 8), &[1, 2, 3][..])
        );
        assert_eq!((read.len(), read[1].frame.len()), (2, 60));
        let mut replay = Replay::new(bytes).unwrap();
        let mut buf = [0; FRAME_MAX];
        replay.send(&[1]).unwrap();
        let mut times = vec![];
        while let Some((len, at)) = replay.receive(&mut buf, Duration::ZERO).unwrap() {
            times.push((len, at.subsec_nanos()));
        }
        assert_eq!(times, [(3, 8), (60, 1_000_008)]);
    }

    #[test]
    fn big_endian_microseconds_are_read() {
        let mut bytes: Vec<u8> = MICROSECONDS.to_be_bytes().to_vec();
        bytes.extend([0; 16]);
        bytes.extend(1_u32.to_be_bytes());
        for field in [1_u32, 5, 2, 2] {
            bytes.extend(field.to_be_bytes());
        }
        bytes.extend([9, 9]);
        let record = PcapReader::new(&bytes).unwrap().next().unwrap().unwrap();
        assert_eq!(
            (record.at, record.frame),
            (Duration::new(1, 5000), &[9, 9][..])
        );
    }

    #[test]
    fn each_wrong_file_has_its_error() {
        let mut bytes = recording();
        assert_eq!(
            PcapReader::new(&bytes[..23]).unwrap_err(),
            PcapError::Short(23)
        );
        let cut = PcapError::Record {
            number: 2,
            len: 60,
            left: 59,
        };
        assert_eq!(
            Replay::new(bytes[..bytes.len() - 1].to_vec()).unwrap_err(),
            cut
        );
        bytes[20] = 113;
        assert_eq!(
            PcapReader::new(&bytes).unwrap_err(),
            PcapError::LinkType(113)
        );
        bytes[..4].copy_from_slice(&0x0A0D_0D0A_u32.to_le_bytes());
        let error = PcapReader::new(&bytes).unwrap_err();
        assert!(error.to_string().contains("tshark"), "{error}");
    }

    proptest! {
        #[test]
        fn any_bytes_are_answered(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
            let mut file = recording()[..24].to_vec();
            file.extend(&bytes);
            prop_assert!(PcapReader::new(&file).unwrap().count() <= 20);
            let _ = PcapReader::new(&bytes);
        }
    }
}
