//! One direction of an unreliable wire: datagrams with a time of arrival. Fixed memory, and no clock of its own.

use super::LineFaults;
use std::time::Duration;
use takt_link::Random;

/// Maximum number of datagrams in flight.
const CAPACITY: usize = 64;

#[derive(Debug, Clone, Copy)]
struct Slot<const N: usize> {
    /// Time of arrival, then send order; `None` when free.
    due: Option<(Duration, u64)>,
    len: usize,
    bytes: [u8; N],
}

/// A wire for datagrams of at most `N` bytes.
#[derive(Debug, Clone)]
pub(crate) struct Line<const N: usize> {
    slots: Box<[Slot<N>]>,
    serial: u64,
    lost: u64,
}

impl<const N: usize> Line<N> {
    pub(crate) fn new() -> Self {
        let free = Slot {
            due: None,
            len: 0,
            bytes: [0; N],
        };
        Self {
            slots: vec![free; CAPACITY].into_boxed_slice(),
            serial: 0,
            lost: 0,
        }
    }

    /// Sends a datagram at `now`; `behind` is the delay of a reordered datagram.
    pub(crate) fn push(
        &mut self,
        bytes: &[u8],
        now: Duration,
        behind: Duration,
        faults: &mut LineFaults,
        random: &mut Random,
    ) {
        // Always the same number of draws, so that one fault setting does not change the randomness of the others.
        let dropped = random.chance(faults.drop);
        let twice = random.chance(faults.duplicate);
        let held = random.chance(faults.reorder);
        let mut due = now + faults.delay + random.span(faults.jitter);
        if held {
            due += behind;
        }
        let forced = faults.drop_next > 0;
        faults.drop_next = faults.drop_next.saturating_sub(1);
        if dropped || forced {
            self.lost += 1;
            return;
        }
        self.store(bytes, due);
        if twice {
            self.store(bytes, due);
        }
    }

    fn store(&mut self, bytes: &[u8], due: Duration) {
        let free = self.slots.iter_mut().find(|slot| slot.due.is_none());
        let Some(slot) = free.filter(|_| bytes.len() <= N) else {
            self.lost += 1;
            return;
        };
        slot.due = Some((due, self.serial));
        slot.len = bytes.len();
        slot.bytes[..bytes.len()].copy_from_slice(bytes);
        self.serial += 1;
    }

    /// The next datagram that has arrived by `now`, with its time of arrival.
    pub(crate) fn pop(&mut self, now: Duration) -> Option<(Duration, &[u8])> {
        let slot = self
            .slots
            .iter_mut()
            .filter(|slot| slot.due.is_some_and(|(due, _)| due <= now))
            .min_by_key(|slot| slot.due)?;
        let (due, _) = slot.due.take()?;
        Some((due, &slot.bytes[..slot.len]))
    }

    /// Arrival time of the next datagram.
    pub(crate) fn next_due(&self) -> Option<Duration> {
        self.slots
            .iter()
            .filter_map(|slot| slot.due)
            .min()
            .map(|(due, _)| due)
    }

    /// Datagrams lost so far.
    pub(crate) fn lost(&self) -> u64 {
        self.lost
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    fn arrivals(line: &mut Line<1>) -> Vec<u8> {
        std::iter::from_fn(|| line.pop(MS * 1000).map(|(_, bytes)| bytes[0])).collect()
    }

    fn send(count: u8, mut faults: LineFaults) -> Line<1> {
        let (mut line, mut random) = (Line::new(), Random::new(3));
        for byte in 0..count {
            line.push(
                &[byte],
                MS * byte.into(),
                MS * 3 / 2,
                &mut faults,
                &mut random,
            );
        }
        line
    }

    #[test]
    fn line_without_faults_keeps_order_and_time() {
        let mut line = send(3, LineFaults::default());
        assert_eq!(line.next_due(), Some(Duration::ZERO));
        assert_eq!(
            line.pop(MS / 2).map(|(due, bytes)| (due, bytes[0])),
            Some((Duration::ZERO, 0))
        );
        assert_eq!(line.pop(MS / 2), None);
        assert_eq!(arrivals(&mut line), [1, 2]);
    }

    #[test]
    fn line_fault_has_stated_effect() {
        let always = |faults| arrivals(&mut send(3, faults));
        assert!(
            always(LineFaults {
                drop: 1.0,
                ..LineFaults::default()
            })
            .is_empty()
        );
        let twice = LineFaults {
            duplicate: 1.0,
            ..LineFaults::default()
        };
        assert_eq!(always(twice), [0, 0, 1, 1, 2, 2]);
        assert_eq!(
            always(LineFaults {
                drop_next: 2,
                ..LineFaults::default()
            }),
            [2]
        );
        let delayed = LineFaults {
            delay: MS * 5,
            ..LineFaults::default()
        };
        assert_eq!(send(1, delayed).next_due(), Some(MS * 5));
        let jittered = LineFaults {
            jitter: MS * 20,
            ..LineFaults::default()
        };
        assert!(!arrivals(&mut send(60, jittered)).is_sorted());
        let reordered = LineFaults {
            reorder: 0.5,
            ..LineFaults::default()
        };
        assert!(!arrivals(&mut send(60, reordered)).is_sorted());
    }

    #[test]
    fn line_full_drops_datagrams() {
        let mut line = send(
            70,
            LineFaults {
                delay: MS,
                ..LineFaults::default()
            },
        );
        assert_eq!((line.lost(), arrivals(&mut line).len()), (6, CAPACITY));
    }
}
