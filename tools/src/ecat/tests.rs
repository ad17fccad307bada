//! The commands on an emulated segment, in virtual time. What is shown is compared as text.

use std::collections::VecDeque;
use std::io;
use std::time::Duration;

use takt_ethercat::AlState;
use takt_ethercat::config::MasterConfig;
use takt_ethercat::emulator::{Coupler, Entry, Io, Segment, ServoConfig, ServoDrive};
use takt_ethercat::link::{FRAME_MAX, Link};

use super::session::{Session, Wire};

/// A cable with a segment at its end; time passes when somebody waits.
#[derive(Debug)]
pub(super) struct Emulated {
    pub(super) segment: Segment,
    now: Duration,
    returned: VecDeque<(Duration, Vec<u8>)>,
    /// All frames, both ways.
    pub(super) seen: Vec<(Duration, Vec<u8>)>,
}

impl Emulated {
    pub(super) fn new(segment: Segment) -> Self {
        Self {
            segment,
            now: Duration::from_secs(1),
            returned: VecDeque::new(),
            seen: Vec::new(),
        }
    }
}

impl Link for Emulated {
    fn send(&mut self, frame: &[u8]) -> io::Result<()> {
        let mut frame = frame.to_vec();
        self.seen.push((self.now, frame.clone()));
        let now = self.now.as_nanos() as u64;
        if let Some(back) = self.segment.process_ethernet(&mut frame, Entry::First, now) {
            let due = self.now + Duration::from_nanos(back.after);
            self.seen.push((due, frame.clone()));
            self.returned.push_back((due, frame));
        }
        Ok(())
    }

    fn receive(
        &mut self,
        buf: &mut [u8],
        timeout: Duration,
    ) -> io::Result<Option<(usize, Duration)>> {
        let until = self.now + timeout;
        match self.returned.pop_front() {
            Some((due, frame)) if due <= until => {
                self.now = self.now.max(due);
                let len = frame.len().min(buf.len()).min(FRAME_MAX);
                buf[..len].copy_from_slice(&frame[..len]);
                Ok(Some((len, self.now)))
            }
            later => {
                self.returned.extend(later);
                self.wait_until(until)?;
                Ok(None)
            }
        }
    }
}

impl Wire for Emulated {
    fn now(&mut self) -> io::Result<Duration> {
        Ok(self.now)
    }

    fn wait_until(&mut self, at: Duration) -> io::Result<()> {
        self.now = self.now.max(at);
        self.segment.poll(self.now.as_nanos() as u64);
        Ok(())
    }
}

pub(super) const CYCLE: Duration = Duration::from_millis(1);

/// A coupler with a terminal at its port 1 and a drive at port 3.
pub(super) fn tree() -> Segment {
    let (terminal, _) = Io::digital(8, 8);
    let (drive, _) = ServoDrive::slave(ServoConfig::default()).unwrap();
    let mut segment = Segment::line([Coupler::slave()]);
    segment.add(terminal, Some((0, 1)));
    segment.add(drive, Some((0, 3)));
    segment
}

pub(super) fn session(segment: Segment, goal: AlState) -> Session<Emulated> {
    let config = MasterConfig {
        goal,
        cycle: CYCLE,
        ..MasterConfig::default()
    };
    Session::new("emulated0", Emulated::new(segment), [2, 0, 0, 0, 0, 1], config).unwrap()
}

/// Brought up.
pub(super) fn up(segment: Segment, goal: AlState) -> Session<Emulated> {
    let mut session = session(segment, goal);
    session.listen().unwrap();
    session.bring_up(Duration::from_secs(10)).unwrap();
    session
}
