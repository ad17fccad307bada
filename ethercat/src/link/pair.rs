//! An in-process cable with two endpoints for tests and examples. It never blocks: the caller sets the time.

use super::{FRAME_MAX, Link};
use std::collections::VecDeque;
use std::io;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Maximum number of queued frames in one direction; more are dropped, as by a full socket buffer.
const CAPACITY: usize = 64;

type Queue = Arc<Mutex<VecDeque<(usize, [u8; FRAME_MAX])>>>;

/// An endpoint of a [`pair`].
#[derive(Debug)]
pub struct Memory {
    outbound: Queue,
    inbound: Queue,
    now: Duration,
}

/// Two connected endpoints; all memory is allocated here.
#[must_use]
pub fn pair() -> (Memory, Memory) {
    let queue = || Arc::new(Mutex::new(VecDeque::with_capacity(CAPACITY)));
    let (to, fro): (Queue, Queue) = (queue(), queue());
    let end = |outbound: &Queue, inbound: &Queue| Memory {
        outbound: outbound.clone(),
        inbound: inbound.clone(),
        now: Duration::ZERO,
    };
    (end(&to, &fro), end(&fro, &to))
}

impl Memory {
    /// Sets the time that stamps received frames.
    pub const fn set_now(&mut self, now: Duration) {
        self.now = now;
    }
}

impl Link for Memory {
    fn send(&mut self, frame: &[u8]) -> io::Result<()> {
        let mut queue = self.outbound.lock().unwrap_or_else(PoisonError::into_inner);
        if queue.len() < CAPACITY {
            let mut bytes = [0; FRAME_MAX];
            let len = frame.len().min(FRAME_MAX);
            bytes[..len].copy_from_slice(&frame[..len]);
            queue.push_back((len, bytes));
        }
        Ok(())
    }

    fn receive(
        &mut self,
        buf: &mut [u8],
        _timeout: Duration,
    ) -> io::Result<Option<(usize, Duration)>> {
        let mut queue = self.inbound.lock().unwrap_or_else(PoisonError::into_inner);
        Ok(queue.pop_front().map(|(len, frame)| {
            let len = len.min(buf.len());
            buf[..len].copy_from_slice(&frame[..len]);
            (len, self.now)
        }))
    }
}
