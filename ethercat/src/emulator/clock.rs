//! The distributed clock of a slave (ETG.1000.4, clause 9.1.3; register block 0900h): a local
//! clock that drifts, the loop that follows the reference, and SYNC0. It latches nothing by itself.

/// Future pulses of SYNC0 or SYNC1, system time in ns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Pulses {
    next: u64,
    /// 0 for a single shot.
    period: u64,
}

impl Pulses {
    /// Returns the pulse that was due, if any, and advances to the next.
    const fn take(pulses: &mut Option<Self>, system_time: u64) -> Option<u64> {
        let Some(Self { next, period }) = *pulses else {
            return None;
        };
        if system_time < next {
            return None;
        }
        *pulses = match period {
            0 => None,
            period => Some(Self {
                next: next.wrapping_add(period),
                period,
            }),
        };
        Some(next)
    }
}

/// A clock over the segment's time, both in ns.
#[derive(Clone, Debug)]
pub struct Clock {
    /// Segment time at which `local` was exact.
    at: u64,
    /// Local time at that instant.
    local: u64,
    /// Local time at power-on.
    first: u64,
    /// Drift of its crystal against the segment's time, ppb.
    drift_ppb: i64,
    /// Frequency correction of the loop, ppb.
    trim_ppb: i64,
    /// Filtered difference to the reference, ns; positive when this clock is ahead.
    difference: Option<f64>,
    sync0: Option<Pulses>,
    sync1: Option<Pulses>,
}

/// Largest correction by one system time datagram, ns.
const STEP_MAX: i64 = 2000;

impl Clock {
    /// A clock that shows `local` ns at power-on and gains `drift_ppb` ns per second.
    pub const fn new(local: u64, drift_ppb: i64) -> Self {
        Self {
            at: 0,
            local,
            first: local,
            drift_ppb,
            trim_ppb: 0,
            difference: None,
            sync0: None,
            sync1: None,
        }
    }

    /// Resets at power-on.
    pub(super) const fn restart(&mut self, now: u64) {
        *self = Self {
            at: now,
            ..Self::new(self.first, self.drift_ppb)
        };
    }

    /// Local time at a segment time.
    pub fn local(&self, now: u64) -> u64 {
        let passed = i128::from(now) - i128::from(self.at);
        let gained = passed * i128::from(self.drift_ppb + self.trim_ppb) / 1_000_000_000;
        let local = i128::from(self.local) + passed + gained;
        // Times wrap at 64 bits, after five hundred years.
        u64::try_from(local & i128::from(u64::MAX)).unwrap_or(0)
    }

    /// Changes the drift of the crystal from now on.
    pub fn set_drift(&mut self, drift_ppb: i64, now: u64) {
        (self.local, self.at) = (self.local(now), now);
        self.drift_ppb = drift_ppb;
    }

    /// Makes the clock jump.
    pub fn jump(&mut self, by_ns: i64, now: u64) {
        (self.local, self.at) = (self.local(now).wrapping_add_signed(by_ns), now);
    }

    /// Follows a system time datagram that arrived at `now` and differed by `difference` ns, positive when this clock
    /// is ahead; `depth` is that of the filter. Returns the filtered difference, ns.
    pub fn follow(&mut self, difference: i64, depth: u8, now: u64) -> i64 {
        let exact = difference as f64;
        let weight = 0.5_f64.powi(depth.min(16).into());
        // A reset filter starts with the first difference.
        let before = self.difference.unwrap_or(exact);
        let filtered = before + (exact - before) * weight;
        self.difference = Some(filtered);
        // Phase by a bounded step, frequency by a small fraction of it.
        let step = (-difference / 8).clamp(-STEP_MAX, STEP_MAX);
        (self.local, self.at) = (self.local(now).wrapping_add_signed(step), now);
        self.trim_ppb = (self.trim_ppb + step * 16).clamp(-1_000_000, 1_000_000);
        #[expect(clippy::cast_possible_truncation, reason = "it saturates")]
        let filtered = filtered.round() as i64;
        filtered
    }

    /// Resets the loop, as a write to its settings does.
    pub(super) const fn reset_loop(&mut self) {
        self.difference = None;
        self.trim_ppb = 0;
    }

    /// Frequency correction of the loop, in steps of 1 ppm (register 0932h).
    pub(super) fn speed_difference(&self) -> i16 {
        i16::try_from(self.trim_ppb / 1000).unwrap_or(i16::MAX)
    }

    /// Arms SYNC0 for a start in system time; with 64 bits, a start in the past never occurs. SYNC1 follows SYNC0 after
    /// a delay in ns, which may contain whole cycles.
    pub fn arm(&mut self, start: u64, period: u64, sync1: Option<u64>, system_time: u64) {
        self.disarm();
        if start <= system_time {
            return;
        }
        self.sync0 = Some(Pulses {
            next: start,
            period,
        });
        self.sync1 = sync1.map(|after| Pulses {
            next: start.wrapping_add(after),
            period: match after.checked_div(period) {
                Some(cycles) => (cycles + 1) * period,
                None => 0,
            },
        });
    }

    /// Disarms SYNC0.
    pub(crate) const fn disarm(&mut self) {
        (self.sync0, self.sync1) = (None, None);
    }

    /// The next pulse of SYNC0 in system time, ns; `None` if there is none.
    pub(crate) fn next_sync0(&self) -> Option<u64> {
        self.sync0.map(|pulses| pulses.next)
    }

    /// The next pulse of SYNC1 in system time, ns; `None` if there is none.
    pub(crate) fn next_sync1(&self) -> Option<u64> {
        self.sync1.map(|pulses| pulses.next)
    }

    /// The oldest pulse of SYNC0 that was due up to a system time and is not handled yet.
    pub(crate) const fn take_sync0(&mut self, system_time: u64) -> Option<u64> {
        Pulses::take(&mut self.sync0, system_time)
    }

    /// Whether a pulse of SYNC1 was due up to a system time and was not taken yet.
    pub(crate) const fn take_sync1(&mut self, system_time: u64) -> bool {
        Pulses::take(&mut self.sync1, system_time).is_some()
    }

    /// Drops all pulses up to a system time.
    pub(super) fn skip(&mut self, system_time: u64) {
        for pulses in [&mut self.sync0, &mut self.sync1].into_iter().flatten() {
            if pulses.next <= system_time && pulses.period > 0 {
                let passed = (system_time - pulses.next) / pulses.period + 1;
                pulses.next += passed * pulses.period;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clock_locks_to_its_reference() {
        for drift in [-100_000, 0, 100_000] {
            let reference = Clock::new(5_000_000_000, 0);
            let mut clock = Clock::new(1000, drift);
            let mut now = 1_000_000;
            let offset = reference.local(now).wrapping_sub(clock.local(now));
            let mut difference = 0;
            for _ in 0..3000 {
                now += 1_000_000;
                let received = reference.local(now) - 300;
                let copy = clock.local(now).wrapping_add(offset) - 300;
                difference = clock.follow(copy.wrapping_sub(received).cast_signed(), 4, now);
            }
            assert!(difference.abs() < 50, "{drift} ppb: {difference} ns");
            let error = clock
                .local(now)
                .wrapping_add(offset)
                .wrapping_sub(reference.local(now));
            assert!(
                error.cast_signed().abs() < 50,
                "{drift} ppb: {}",
                error.cast_signed()
            );
        }
    }

    #[test]
    fn sync0_with_past_start_never_fires() {
        let mut clock = Clock::new(0, 0);
        clock.arm(10_000, 1000, None, 9000);
        let pulses: Vec<_> = (9000..20_500).filter_map(|t| clock.take_sync0(t)).collect();
        let expected: Vec<_> = (0..11).map(|n| 10_000 + 1000 * n).collect();
        assert_eq!(pulses, expected);
        assert_eq!(clock.next_sync0(), Some(21_000));
        clock.skip(25_500);
        assert_eq!(clock.take_sync0(26_000), Some(26_000));
        clock.arm(10_000, 1000, None, 10_000);
        assert_eq!(clock.next_sync0(), None);
        clock.arm(10_000, 0, None, 9000);
        assert_eq!(clock.take_sync0(30_000), Some(10_000), "a single shot");
        assert_eq!(clock.take_sync0(40_000), None);
    }

    #[test]
    fn sync1_follows_sync0_or_multiples_of_it() {
        for (after, expected) in [
            (0, [10_000, 11_000, 12_000]),
            (300, [10_300, 11_300, 12_300]),
            (1000, [11_000, 13_000, 15_000]),
            (2500, [12_500, 15_500, 18_500]),
        ] {
            let mut clock = Clock::new(0, 0);
            clock.arm(10_000, 1000, Some(after), 9000);
            let pulses = (9000..).filter(|t| clock.take_sync1(*t)).take(3);
            assert_eq!(pulses.collect::<Vec<u64>>(), expected, "{after} ns");
        }
    }

    #[test]
    fn clock_jumps_and_drifts_apply_immediately() {
        let mut clock = Clock::new(0, 100_000);
        assert_eq!(clock.local(1_000_000_000), 1_000_100_000);
        clock.set_drift(-100_000, 1_000_000_000);
        clock.jump(500, 1_000_000_000);
        assert_eq!(clock.local(2_000_000_000), 2_000_000_500);
    }
}
