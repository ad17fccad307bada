//! A cable within this process, on the host's clock: two endpoints for two threads. It replaces hardware in tests: it
//! uses locks, so it gives no real-time guarantees.

use std::collections::VecDeque;
use std::io;
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::Duration;

use super::monotonic;
use crate::link::{FRAME_MAX, Link};

/// Maximum number of frames in transit per direction; more are lost.
const CAPACITY: usize = 64;

#[derive(Debug)]
struct Way {
    frames: Mutex<VecDeque<(usize, [u8; FRAME_MAX])>>,
    changed: Condvar,
}

impl Way {
    fn new() -> Arc<Self> {
        Arc::new(Self {
            frames: Mutex::new(VecDeque::with_capacity(CAPACITY)),
            changed: Condvar::new(),
        })
    }
}

/// An endpoint of a cable.
#[derive(Clone, Debug)]
pub struct CableEnd {
    to: Arc<Way>,
    from: Arc<Way>,
}

/// Creates a cable; all memory is allocated here.
#[must_use]
pub fn cable() -> (CableEnd, CableEnd) {
    let (a, b) = (Way::new(), Way::new());
    let near = CableEnd {
        to: Arc::clone(&a),
        from: Arc::clone(&b),
    };
    (near, CableEnd { to: b, from: a })
}

impl Link for CableEnd {
    fn send(&mut self, frame: &[u8]) -> io::Result<()> {
        let mut bytes = [0; FRAME_MAX];
        let len = frame.len().min(FRAME_MAX);
        bytes[..len].copy_from_slice(&frame[..len]);
        let mut frames = self
            .to
            .frames
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        if frames.len() < CAPACITY {
            frames.push_back((len, bytes));
        }
        drop(frames);
        self.to.changed.notify_one();
        Ok(())
    }

    fn receive(
        &mut self,
        buf: &mut [u8],
        timeout: Duration,
    ) -> io::Result<Option<(usize, Duration)>> {
        let until = monotonic()? + timeout;
        let frames = self.from.frames.lock();
        let mut frames = frames.unwrap_or_else(PoisonError::into_inner);
        loop {
            if let Some((len, bytes)) = frames.pop_front() {
                let len = len.min(buf.len());
                buf[..len].copy_from_slice(&bytes[..len]);
                return Ok(Some((len, monotonic()?)));
            }
            let left = until.saturating_sub(monotonic()?);
            if left.is_zero() {
                return Ok(None);
            }
            let waited = self.from.changed.wait_timeout(frames, left);
            frames = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cable_waiting_endpoint_receives_sent_frame() {
        let (mut near, mut far) = cable();
        std::thread::scope(|scope| {
            let received = scope.spawn(move || {
                let mut frame = [0; FRAME_MAX];
                let (len, _) = far
                    .receive(&mut frame, Duration::from_secs(10))
                    .unwrap()
                    .unwrap();
                frame[..len].to_vec()
            });
            near.send(&[7; 60]).unwrap();
            assert_eq!(received.join().unwrap(), [7; 60]);
        });
        assert_eq!(near.receive(&mut [0; 60], Duration::ZERO).unwrap(), None);
    }
}
