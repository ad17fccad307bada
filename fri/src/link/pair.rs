//! Both endpoints of an in-process link for tests and examples. It never blocks; the caller sets the time.

use super::Link;
use std::collections::VecDeque;
use std::io;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Queued datagrams per direction; further ones are dropped, as by a full socket buffer.
const CAPACITY: usize = 64;
/// Longest datagram carried whole, bytes; longer ones are truncated.
const LONGEST: usize = 1500;

type Queue = Arc<Mutex<VecDeque<(usize, [u8; LONGEST])>>>;

/// One endpoint of a [`pair`].
#[derive(Debug)]
pub struct Memory {
    outbound: Queue,
    inbound: Queue,
    now: Duration,
}

/// Returns two connected endpoints; all memory is allocated here.
#[must_use]
pub fn pair() -> (Memory, Memory) {
    let queue = || Arc::new(Mutex::new(VecDeque::with_capacity(CAPACITY)));
    let (to, fro): (Queue, Queue) = (queue(), queue());
    let here = Memory {
        outbound: to.clone(),
        inbound: fro.clone(),
        now: Duration::ZERO,
    };
    (
        here,
        Memory {
            outbound: fro,
            inbound: to,
            now: Duration::ZERO,
        },
    )
}

impl Memory {
    /// Sets the clock that stamps what this endpoint receives.
    pub fn set_now(&mut self, now: Duration) {
        self.now = now;
    }
}

impl Link for Memory {
    fn send(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut queue = self.outbound.lock().unwrap_or_else(PoisonError::into_inner);
        if queue.len() < CAPACITY {
            let mut datagram = [0; LONGEST];
            let len = bytes.len().min(LONGEST);
            datagram[..len].copy_from_slice(&bytes[..len]);
            queue.push_back((len, datagram));
        }
        Ok(bytes.len())
    }

    fn receive(&mut self, buf: &mut [u8], _: Duration) -> io::Result<Option<(usize, Duration)>> {
        let mut queue = self.inbound.lock().unwrap_or_else(PoisonError::into_inner);
        let Some((len, datagram)) = queue.pop_front() else {
            return Ok(None);
        };
        let len = len.min(buf.len());
        buf[..len].copy_from_slice(&datagram[..len]);
        Ok(Some((len, self.now)))
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
