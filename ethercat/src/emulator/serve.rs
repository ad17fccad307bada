//! A segment at the end of one or two cables: frames come in by a [`Link`], go through the segment
//! and back out, in real time or whatever time its caller keeps. It makes no thread and reads no
//! clock.

use std::collections::VecDeque;
use std::io;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use crate::link::{FRAME_MAX, Link};

use super::segment::{Entry, Segment};

/// A frame that takes longer than this is held back; less is less than a host's own delay.
const HELD_FROM: u64 = 100_000;
/// Frames that are held back; more are lost, as in a switch that is full.
const HELD_MAX: usize = 64;
/// Frames taken in one turn before held ones are looked at.
const BATCH: usize = 16;
/// With two cables each is asked this often, as neither may wait for the other.
const ALTERNATE: Duration = Duration::from_micros(20);

/// A frame on its late way back.
#[derive(Debug)]
struct Held {
    due: Duration,
    by: Entry,
    frame: Vec<u8>,
}

/// A segment that is served, shared with whoever puts faults in.
#[derive(Clone, Debug)]
pub struct SharedSegment(Arc<Mutex<Segment>>);

impl SharedSegment {
    /// Shares a segment.
    #[must_use]
    pub fn new(segment: Segment) -> Self {
        Self(Arc::new(Mutex::new(segment)))
    }

    /// The segment; frames wait as long as it is held.
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
    #[must_use]
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
    #[must_use]
    pub const fn segment(&self) -> &SharedSegment {
        &self.segment
    }

    /// Waits at most `timeout` for a frame, lets it and those behind it pass, and sends what is
    /// due; returns how many frames came. `clock` is asked for the time, that of the links' stamps.
    ///
    /// # Errors
    /// Those of the links.
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

    /// One frame that comes in by an end; returns whether one came.
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

fn send<L: Link>(first: &mut L, second: Option<&mut L>, by: Entry, frame: &[u8]) -> io::Result<()> {
    match (by, second) {
        (Entry::First, _) => first.send(frame),
        (Entry::Last, Some(second)) => second.send(frame),
        (Entry::Last, None) => Ok(()),
    }
}
