//! Plays back a recording as a link. Nothing is captured or checked here.

use std::io;
use std::time::Duration;

use super::{CaptureError, Frames};
use crate::Link;

/// Plays a recording of Ethernet: each frame is received at its recorded time, sent frames are discarded.
#[derive(Debug)]
pub struct Replay {
    frames: std::vec::IntoIter<(Duration, Vec<u8>)>,
}

impl Replay {
    /// Reads the whole recording and starts before its first frame. A truncated recording is played up to its end; a
    /// damaged one is an error.
    pub fn new(bytes: &[u8]) -> Result<Self, CaptureError> {
        let frames = Frames::new(bytes)?.map(|frame| frame.map(|frame| (frame.at, frame.bytes)));
        let frames = frames.collect::<Result<Vec<_>, _>>()?.into_iter();
        Ok(Self { frames })
    }
}

impl Link for Replay {
    fn send(&mut self, frame: &[u8]) -> io::Result<usize> {
        Ok(frame.len())
    }

    fn receive(
        &mut self,
        buf: &mut [u8],
        _timeout: Duration,
    ) -> io::Result<Option<(usize, Duration)>> {
        let Some((at, frame)) = self.frames.next() else {
            return Ok(None);
        };
        let len = frame.len().min(buf.len());
        buf[..len].copy_from_slice(&frame[..len]);
        Ok(Some((len, at)))
    }
}

#[cfg(test)]
mod tests {
    use super::super::{LinkType, Writer};
    use super::*;

    #[test]
    fn replay_gives_frames_at_their_recorded_times() {
        let mut writer = Writer::new(Vec::new(), LinkType::ETHERNET).unwrap();
        writer.write(Duration::new(7, 8), &[1, 2, 3]).unwrap();
        writer.write(Duration::new(7, 1_000_008), &[4; 60]).unwrap();
        let bytes = writer.into_inner();
        // Cut off in the second frame, only the first is played.
        for (len, expected) in [(bytes.len(), 2), (bytes.len() - 1, 1)] {
            let mut replay = Replay::new(&bytes[..len]).unwrap();
            let mut buf = [0; 1514];
            replay.send(&[1]).unwrap();
            let mut times = vec![];
            while let Some((len, at)) = replay.receive(&mut buf, Duration::ZERO).unwrap() {
                times.push((len, at.subsec_nanos()));
            }
            assert_eq!(times, [(3, 8), (60, 1_000_008)][..expected]);
        }
    }

    #[test]
    fn replay_of_another_link_type_is_refused() {
        let mut writer = Writer::new(Vec::new(), LinkType::RAW).unwrap();
        writer.write(Duration::ZERO, &[0; 40]).unwrap();
        let error = Replay::new(&writer.into_inner()).unwrap_err().to_string();
        assert!(error.contains("link type 101"), "{error}");
    }
}
