//! A segment at the end of one or two cables: frames are received from a [`Link`], processed by the segment and sent
//! back, in real time or the caller's time. It makes no thread and reads no clock.

use std::collections::VecDeque;
use std::io;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use crate::link::{FRAME_MAX, Link};

use super::segment::{Entry, Segment};

/// Frames with a longer delay are held back; shorter delays are below the latency of a host.
const HELD_FROM: u64 = 100_000;
/// Maximum number of held frames; more are lost, as in a full switch.
const HELD_MAX: usize = 64;
/// Maximum number of frames handled before held ones are checked.
const BATCH: usize = 16;
/// Polling period with two cables, as neither may wait for the other.
const ALTERNATE: Duration = Duration::from_micros(20);

/// A frame held back.
#[derive(Debug)]
struct Held {
    due: Duration,
    by: Entry,
    frame: Vec<u8>,
}

/// A served segment, shared with the code that injects faults.
#[derive(Clone, Debug)]
pub struct SharedSegment(Arc<Mutex<Segment>>);

impl SharedSegment {
    /// Shares a segment.
    pub fn new(segment: Segment) -> Self {
        Self(Arc::new(Mutex::new(segment)))
    }

    /// Locks the segment; frames wait while it is locked.
    pub fn lock(&self) -> MutexGuard<'_, Segment> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A segment and the cables to its master.
#[derive(Debug)]
pub struct Server<L> {
    segment: SharedSegment,
    first: L,
    second: Option<L>,
    held: VecDeque<Held>,
    buffer: Box<[u8; FRAME_MAX]>,
}

impl<L: Link> Server<L> {
    /// Serves a segment at one cable.
    pub fn new(segment: SharedSegment, link: L) -> Self {
        Self {
            segment,
            first: link,
            second: None,
            held: VecDeque::new(),
            buffer: Box::new([0; FRAME_MAX]),
        }
    }

    /// With a second cable from the last slave to the master.
    #[must_use]
    pub fn with_second(mut self, link: L) -> Self {
        self.segment.lock().set_redundant(true);
        self.second = Some(link);
        self
    }

    /// The segment.
    pub const fn segment(&self) -> &SharedSegment {
        &self.segment
    }

    /// Waits at most `timeout` for a frame, processes it and those queued behind it, and sends due frames; returns the
    /// number of received frames. `clock` returns the time of the links' time stamps.
    ///
    /// # Errors
    /// Errors of the links.
    pub fn turn(
        &mut self,
        timeout: Duration,
        clock: &mut impl FnMut() -> io::Result<Duration>,
    ) -> io::Result<usize> {
        let now = clock()?;
        let next = self.held.iter().map(|held| held.due).min();
        let mut wait = next.map_or(timeout, |due| timeout.min(due.saturating_sub(now)));
        if self.second.is_some() {
            wait = wait.min(ALTERNATE);
        }
        let mut frames = 0;
        while frames < BATCH && self.pass(Entry::First, wait)? {
            frames += 1;
            wait = Duration::ZERO;
        }
        while frames < 2 * BATCH && self.pass(Entry::Last, Duration::ZERO)? {
            frames += 1;
        }
        let now = clock()?;
        if frames == 0 {
            self.segment.lock().poll(nanoseconds(now));
        }
        self.send_held(now)?;
        Ok(frames)
    }

    /// Handles one frame of an entry; returns whether one was received.
    fn pass(&mut self, entry: Entry, wait: Duration) -> io::Result<bool> {
        let link = match (entry, &mut self.second) {
            (Entry::First, _) => &mut self.first,
            (Entry::Last, Some(second)) => second,
            (Entry::Last, None) => return Ok(false),
        };
        let Some((len, at)) = link.receive(&mut self.buffer[..], wait)? else {
            return Ok(false);
        };
        let frame = self.buffer.get_mut(..len).unwrap_or_default();
        let now = nanoseconds(at);
        let returned = self.segment.lock().process_ethernet(frame, entry, now);
        let Some(returned) = returned else {
            return Ok(true);
        };
        if returned.after < HELD_FROM {
            send(&mut self.first, self.second.as_mut(), returned.by, frame)?;
        } else if self.held.len() < HELD_MAX {
            self.held.push_back(Held {
                due: at + Duration::from_nanos(returned.after),
                by: returned.by,
                frame: frame.to_vec(),
            });
        }
        Ok(true)
    }

    fn send_held(&mut self, now: Duration) -> io::Result<()> {
        for _ in 0..self.held.len() {
            let Some(held) = self.held.pop_front() else {
                break;
            };
            if held.due > now {
                self.held.push_back(held);
                continue;
            }
            let second = self.second.as_mut();
            send(&mut self.first, second, held.by, &held.frame)?;
        }
        Ok(())
    }
}

fn nanoseconds(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}

fn send<L: Link>(
    first: &mut L,
    second: Option<&mut L>,
    by: Entry,
    frame: &[u8],
) -> io::Result<usize> {
    match (by, second) {
        (Entry::First, _) => first.send(frame),
        (Entry::Last, Some(second)) => second.send(frame),
        (Entry::Last, None) => Ok(0),
    }
}
