//! A log as a link: recorded frames are received at their recorded times, on a virtual clock. Sent frames are recorded
//! but have no effect.

use std::time::Duration;

use super::{Link, LinkError, Origin, Received};
use crate::AnyFrame;
use crate::log::{Direction, Record};

/// A link that replays a recording and records what is sent.
#[derive(Debug)]
pub struct Replay<I: Iterator<Item = Record>> {
    records: std::iter::Peekable<I>,
    now: Duration,
    sent: Vec<(Duration, AnyFrame)>,
}

impl<I: Iterator<Item = Record>> Replay<I> {
    /// A link that replays these records; its clock starts at the time of the first one.
    pub fn new(records: impl IntoIterator<IntoIter = I>) -> Self {
        let mut records = records.into_iter().peekable();
        let now = records.peek().map_or(Duration::ZERO, |record| record.at);
        Self {
            records,
            now,
            sent: Vec::new(),
        }
    }

    /// The current time on the log's clock.
    pub const fn now(&self) -> Duration {
        self.now
    }

    /// Whether all records were received.
    pub fn is_at_end(&mut self) -> bool {
        self.records.peek().is_none()
    }

    /// Sent frames with their times.
    pub fn sent(&self) -> &[(Duration, AnyFrame)] {
        &self.sent
    }
}

impl<I: Iterator<Item = Record>> Link for Replay<I> {
    fn send(&mut self, frame: &AnyFrame) -> Result<(), LinkError> {
        self.sent.push((self.now, *frame));
        Ok(())
    }

    /// Advances the clock to the next frame, or by `timeout`. A log that jumps back does not move the clock.
    fn receive(&mut self, timeout: Duration) -> Result<Option<Received>, LinkError> {
        let until = self.now.saturating_add(timeout);
        let Some(record) = self.records.next_if(|record| record.at <= until) else {
            self.now = until;
            return Ok(None);
        };
        self.now = self.now.max(record.at);
        let origin = match record.direction {
            Some(Direction::Transmitted) => Origin::Host,
            Some(Direction::Received) | None => Origin::Bus,
        };
        Ok(Some(Received {
            frame: record.frame,
            at: record.at,
            hardware: None,
            origin,
            dropped: 0,
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Frame, Id};

    fn record(ms: u64, id: u16, direction: Option<Direction>) -> Record {
        Record {
            at: Duration::from_millis(ms),
            interface: "can0".to_owned(),
            frame: Frame::empty(Id::standard(id).unwrap()).into(),
            direction,
        }
    }

    #[test]
    fn replay_records_arrive_at_their_times() {
        let ms = Duration::from_millis;
        let mut link = Replay::new([
            record(100, 0x80, None),
            record(110, 0x181, Some(Direction::Transmitted)),
            record(130, 0x182, Some(Direction::Received)),
        ]);
        let first = link.receive(Duration::ZERO).unwrap().unwrap();
        assert_eq!((first.at, first.origin), (ms(100), Origin::Bus));
        assert_eq!(link.receive(ms(5)), Ok(None));
        link.send(&first.frame).unwrap();
        assert_eq!(link.sent(), [(ms(105), first.frame)]);
        let second = link.receive(ms(5)).unwrap().unwrap();
        assert_eq!((second.at, second.origin), (ms(110), Origin::Host));
        assert!(!link.is_at_end());
        assert!(link.receive(ms(100)).unwrap().is_some());
        assert!(link.is_at_end());
        assert_eq!(link.now(), ms(130));
        assert_eq!(link.receive(ms(10)), Ok(None));
        assert_eq!(link.now(), ms(140));
    }
}
