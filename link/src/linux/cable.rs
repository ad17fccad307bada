//! A cable within this process, on the host's clock: two endpoints for two threads. It replaces hardware in tests: it
//! uses locks, so it gives no real-time guarantees.

use std::io;
use std::sync::{Arc, PoisonError};
use std::time::Duration;

use super::monotonic;
use crate::Link;
use crate::pair::{Queue, pop};

/// An endpoint of a cable.
#[derive(Clone, Debug)]
pub struct CableEnd {
    outbound: Arc<Queue>,
    inbound: Arc<Queue>,
}

/// Creates a cable; all memory is allocated here.
pub fn cable() -> (CableEnd, CableEnd) {
    let (there, back) = Queue::both();
    let near = CableEnd {
        outbound: Arc::clone(&there),
        inbound: Arc::clone(&back),
    };
    let far = CableEnd {
        outbound: back,
        inbound: there,
    };
    (near, far)
}

impl Link for CableEnd {
    fn send(&mut self, frame: &[u8]) -> io::Result<usize> {
        Ok(self.outbound.push(frame))
    }

    fn receive(
        &mut self,
        buf: &mut [u8],
        timeout: Duration,
    ) -> io::Result<Option<(usize, Duration)>> {
        let until = takt_rt::monotonic() + timeout.into();
        let mut frames = self.inbound.lock();
        loop {
            if let Some(len) = pop(&mut frames, buf) {
                return Ok(Some((len, monotonic()?)));
            }
            let left = takt_rt::may_wait(until);
            if left.is_zero() {
                return Ok(None);
            }
            let waited = self.inbound.changed.wait_timeout(frames, left);
            frames = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cable_waiting_end_receives_frame() {
        let (mut near, mut far) = cable();
        std::thread::scope(|scope| {
            let received = scope.spawn(move || {
                let mut frame = [0; 60];
                let timeout = Duration::from_secs(10);
                let (len, _) = far.receive(&mut frame, timeout).unwrap().unwrap();
                frame[..len].to_vec()
            });
            near.send(&[7; 60]).unwrap();
            assert_eq!(received.join().unwrap(), [7; 60]);
        });
        assert_eq!(near.receive(&mut [0; 60], Duration::ZERO).unwrap(), None);
    }
}
