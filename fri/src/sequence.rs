//! Order of datagrams by their counters of 16 bits (LWR) or 32 (Sunrise). Only increments count: any first value is valid.

/// Order of a datagram in the peer's sequence.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// The first one, or the first after silence.
    First,
    /// Newer than all before; `lost` datagrams are missing in between (0 is the normal case).
    Next {
        /// Number of missing datagrams.
        lost: u16,
    },
    /// The same number again.
    Duplicate,
    /// Older than the newest one.
    Old,
    /// A jump too wide for loss or reordering: the peer has restarted.
    Restart,
}

impl Order {
    /// Whether the datagram is to be used: not a duplicate and not old.
    pub fn is_new(self) -> bool {
        match self {
            Self::First | Self::Next { .. } | Self::Restart => true,
            Self::Duplicate | Self::Old => false,
        }
    }
}

/// Follows the counter of one peer.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Tracker {
    /// 0 before the first; kept after `forget`.
    newest: u32,
    /// Whether the next number is compared with it.
    is_known: bool,
    window: u16,
    /// Largest counter value; one less than the modulus.
    mask: u32,
}

impl Tracker {
    /// For 16-bit counters. A jump of more than `window` in either direction is a restart of the peer.
    pub(crate) fn new(window: u16) -> Self {
        Self {
            newest: 0,
            is_known: false,
            window,
            mask: 0xffff,
        }
    }

    /// For 32-bit counters.
    pub(crate) fn wide(window: u16) -> Self {
        Self {
            mask: u32::MAX,
            ..Self::new(window)
        }
    }

    /// Treats the next number as the first.
    pub(crate) fn forget(&mut self) {
        self.is_known = false;
    }

    /// The newest number, 0 before the first: reflected to the peer, after a silence too.
    #[cfg(feature = "emulator")]
    pub(crate) fn newest(&self) -> u32 {
        self.newest
    }

    /// Classifies a received number and stores it if it is new.
    pub(crate) fn accept(&mut self, number: impl Into<u32>) -> Order {
        let number = number.into();
        let order = self.classify(number);
        if order.is_new() {
            (self.newest, self.is_known) = (number, true);
        }
        order
    }

    /// Distance from `from` to `to`, modulo the counter.
    pub(crate) fn distance(&self, from: u32, to: u32) -> u32 {
        to.wrapping_sub(from) & self.mask
    }

    /// How far `number` is behind `newest`; 0 for a number that is ahead.
    pub(crate) fn behind(&self, number: u32, newest: u32) -> u32 {
        let behind = self.distance(number, newest);
        if behind > self.mask / 2 { 0 } else { behind }
    }

    fn classify(&self, number: u32) -> Order {
        if !self.is_known {
            return Order::First;
        }
        let forward = self.distance(self.newest, number);
        let backward = self.distance(number, self.newest);
        let within = |gap: u32| u16::try_from(gap).ok().filter(|gap| *gap <= self.window);
        match (within(forward), within(backward)) {
            (Some(0), _) => Order::Duplicate,
            (Some(gap), _) => Order::Next { lost: gap - 1 },
            (None, Some(_)) => Order::Old,
            (None, None) => Order::Restart,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Classifies every number after every newest one near the wrap, and a sample of the rest.
    #[test]
    fn tracker_agrees_with_signed_differences() {
        for newest in (0..=u16::MAX).step_by(4099).chain([0, 1, u16::MAX]) {
            for number in 0..=u16::MAX {
                let mut tracker = Tracker::new(50);
                assert_eq!(tracker.accept(newest), Order::First);
                let expected = match number.wrapping_sub(newest).cast_signed() {
                    0 => Order::Duplicate,
                    gap @ 1..=50 => Order::Next {
                        lost: u16::try_from(gap - 1).unwrap(),
                    },
                    -50..=-1 => Order::Old,
                    _ => Order::Restart,
                };
                assert_eq!(tracker.accept(number), expected, "{newest} then {number}");
            }
        }
    }

    #[test]
    fn tracker_old_number_keeps_newest() {
        let mut tracker = Tracker::new(50);
        for (number, order) in [
            (65534_u16, Order::First),
            (0, Order::Next { lost: 1 }),
            (65535, Order::Old),
            (0, Order::Duplicate),
            (1, Order::Next { lost: 0 }),
            (5000, Order::Restart),
        ] {
            assert_eq!(tracker.accept(number), order);
        }
    }

    #[test]
    fn tracker_wide_counter_wraps_at_32_bits() {
        let mut tracker = Tracker::wide(10);
        for (number, order) in [
            (u32::MAX - 1, Order::First),
            (1, Order::Next { lost: 2 }),
            (65_537, Order::Restart),
            (65_536, Order::Old),
            (65_538, Order::Next { lost: 0 }),
        ] {
            assert_eq!(tracker.accept(number), order, "{number}");
        }
    }
}
