//! An in-process wire with two endpoints for tests and examples. [`Memory`] never blocks and the caller sets its time;
//! `linux::cable` waits on the host's clock.

use std::collections::VecDeque;
use std::io;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use crate::Link;

/// Maximum number of queued frames per direction; more are dropped, as by a full socket buffer.
const CAPACITY: usize = 64;
/// Longest frame carried whole, bytes: an Ethernet frame without its check sequence. Longer ones are truncated.
const LONGEST: usize = 1514;

pub(crate) type Frames = VecDeque<(usize, [u8; LONGEST])>;

/// One direction of a wire; all memory is allocated at its creation.
#[derive(Debug)]
pub(crate) struct Queue {
    frames: Mutex<Frames>,
    pub(crate) changed: Condvar,
}

impl Queue {
    fn new() -> Arc<Self> {
        Arc::new(Self {
            frames: Mutex::new(VecDeque::with_capacity(CAPACITY)),
            changed: Condvar::new(),
        })
    }

    /// Two directions.
    pub(crate) fn both() -> (Arc<Self>, Arc<Self>) {
        (Self::new(), Self::new())
    }

    pub(crate) fn lock(&self) -> MutexGuard<'_, Frames> {
        self.frames.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn push(&self, bytes: &[u8]) -> usize {
        let mut frames = self.lock();
        if frames.len() < CAPACITY {
            let mut frame = [0; LONGEST];
            let len = bytes.len().min(LONGEST);
            frame[..len].copy_from_slice(&bytes[..len]);
            frames.push_back((len, frame));
        }
        drop(frames);
        self.changed.notify_one();
        bytes.len()
    }
}

/// Copies the oldest frame into `buf` and returns its length there.
pub(crate) fn pop(frames: &mut Frames, buf: &mut [u8]) -> Option<usize> {
    let (len, frame) = frames.pop_front()?;
    let len = len.min(buf.len());
    buf[..len].copy_from_slice(&frame[..len]);
    Some(len)
}

/// One endpoint of a [`pair`].
#[derive(Debug)]
pub struct Memory {
    outbound: Arc<Queue>,
    inbound: Arc<Queue>,
    now: Duration,
}

/// Two connected endpoints in virtual time.
pub fn pair() -> (Memory, Memory) {
    let (there, back) = Queue::both();
    let endpoint = |outbound: &Arc<Queue>, inbound: &Arc<Queue>| Memory {
        outbound: Arc::clone(outbound),
        inbound: Arc::clone(inbound),
        now: Duration::ZERO,
    };
    (endpoint(&there, &back), endpoint(&back, &there))
}

impl Memory {
    /// Sets the time that stamps received frames.
    pub const fn set_now(&mut self, now: Duration) {
        self.now = now;
    }
}

impl Link for Memory {
    fn send(&mut self, bytes: &[u8]) -> io::Result<usize> {
        Ok(self.outbound.push(bytes))
    }

    fn receive(&mut self, buf: &mut [u8], _: Duration) -> io::Result<Option<(usize, Duration)>> {
        Ok(pop(&mut self.inbound.lock(), buf).map(|len| (len, self.now)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pair_keeps_datagram_order_and_boundaries() {
        let (mut a, mut b) = pair();
        a.send(&[1, 2]).unwrap();
        a.send(&[3]).unwrap();
        b.set_now(Duration::from_millis(7));
        let mut buf = [0; 8];
        let stamp = Duration::from_millis(7);
        assert_eq!(
            b.receive(&mut buf, Duration::ZERO).unwrap(),
            Some((2, stamp))
        );
        assert_eq!(&buf[..2], [1, 2]);
        assert_eq!(
            b.receive(&mut buf, Duration::ZERO).unwrap(),
            Some((1, stamp))
        );
        assert_eq!(b.receive(&mut buf, Duration::ZERO).unwrap(), None);
        assert_eq!(a.receive(&mut buf, Duration::ZERO).unwrap(), None);
    }

    #[test]
    fn pair_full_queue_drops_short_buffer_truncates() {
        let (mut a, mut b) = pair();
        for _ in 0..CAPACITY + 5 {
            assert_eq!(a.send(&[7; 4]).unwrap(), 4);
        }
        let mut buf = [0; 3];
        let mut received = 0;
        while let Some((len, _)) = b.receive(&mut buf, Duration::ZERO).unwrap() {
            assert_eq!(len, 3);
            received += 1;
        }
        assert_eq!(received, CAPACITY);
    }
}
