//! Arithmetic of distributed clocks (ETG.1000.4, clause 9.1.3): propagation delays from receive times, start times of
//! SYNC0, and phase statistics between a master's frames and SYNC0. It contains no servo: the owner of the cycle gets
//! [`Sample`]s.

use std::time::Duration;

use crate::topology::Topology;

/// The reference clock as a frame passed it, for a servo that disciplines the cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sample {
    /// When the frame was sent, on the master's clock.
    pub sent: Duration,
    /// When its answer was received, on the master's clock.
    pub received: Duration,
    /// System time when it passed the reference clock, ns since 2000-01-01.
    pub system_ns: u64,
}

/// Phase of a system time in a period, ns from 0 to the period; periods start `shift` after multiples of the period.
pub fn phase_ns(system_ns: u64, period: Duration, shift_ns: i32) -> u64 {
    let period = u64::try_from(period.as_nanos()).unwrap_or(u64::MAX).max(1);
    let shift = i64::from(shift_ns)
        .rem_euclid(i64::try_from(period).unwrap_or(i64::MAX))
        .unsigned_abs();
    (system_ns % period + period - shift) % period
}

/// The first shifted start of a period that is at least `lead` after a system time, ns. Slaves with the same period and
/// shift thus pulse simultaneously, whenever they are started.
pub(crate) fn start_time(system_ns: u64, lead: Duration, period: Duration, shift_ns: i32) -> u64 {
    let ns = |time: Duration| u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
    let earliest = system_ns.saturating_add(ns(lead));
    let left = ns(period).saturating_sub(phase_ns(earliest, period, shift_ns));
    earliest.saturating_add(left)
}

/// Extends the time of a 32 bit clock to 64 bits, given the time to within two seconds, ns.
pub fn extended(low: u32, near_ns: u64) -> u64 {
    let [a, b, c, d, ..] = near_ns.to_le_bytes();
    let ahead = low.wrapping_sub(u32::from_le_bytes([a, b, c, d]));
    near_ns.wrapping_add_signed(ahead.cast_signed().into())
}

/// The order in which frames leave by the ports of a slave, after entering by port 0.
pub(crate) const ORDER: [usize; 3] = [3, 1, 2];

/// Delay of each slave from the first one in the ring, ns, from the receive times of its ports.
///
/// A frame that leaves by a port and returns has passed the cable twice and all slaves behind it; the next slave
/// measures the time spent there. Half of the rest is the delay of one direction. Times wrap at 32 bits. A slave
/// without clock (`times` is `None`) counts as part of the path from the nearest slave with a clock before it; its
/// branches count as part of this path.
pub fn delays(topology: &Topology, times: &[Option<[u32; 4]>]) -> Vec<u32> {
    let mut delays = vec![0_u32; times.len()];
    for number in 0..times.len() {
        let Some((parent, port)) = topology.parent(number) else {
            continue;
        };
        let times = |number: usize| times.get(number).copied().flatten();
        let (mut above, mut by) = (parent, port);
        while times(above).is_none()
            && let Some((parent, port)) = topology.parent(above)
        {
            (above, by) = (parent, port);
        }
        let hop = times(above).zip(times(number)).map(|(before, here)| {
            let hop = hop(topology, (above, by, &before), (number, &here));
            (above, hop)
        });
        // Without a clock its own delay is not used.
        let (above, hop) = hop.unwrap_or((parent, 0));
        let before = delays.get(above).copied().unwrap_or(0);
        if let Some(delay) = delays.get_mut(number) {
            *delay = before.wrapping_add(hop);
        }
    }
    delays
}

/// Delay from a slave to the next one behind one of its ports.
fn hop(topology: &Topology, above: (usize, usize, &[u32; 4]), here: (usize, &[u32; 4])) -> u32 {
    let (parent, port, times) = above;
    let used = |p: &usize| topology.has_child(parent, *p);
    // The port by which the frame returned before it left by this one.
    let earlier = ORDER
        .iter()
        .copied()
        .take_while(|p| *p != port)
        .filter(used)
        .last()
        .unwrap_or(0);
    let out = times[port].wrapping_sub(times[earlier]);
    let (number, below) = here;
    let end = ORDER
        .iter()
        .copied()
        .rfind(|p| topology.has_child(number, *p));
    let inside = end.map_or(0, |end| below[end].wrapping_sub(below[0]));
    let one_way = out.wrapping_sub(inside) / 2;
    // Includes the time behind earlier ports.
    one_way.wrapping_add(times[earlier].wrapping_sub(times[0]))
}

/// Statistics of a phase: deviations from the wanted value, ns.
#[derive(Clone, Debug, PartialEq)]
pub struct PhaseFigures {
    count: u64,
    sum: f64,
    squares: f64,
    least: i64,
    most: i64,
    /// Histogram of deviations: below -50 us, 20 bins of 5 us, above 50 us.
    bins: [u64; 22],
}

impl Default for PhaseFigures {
    fn default() -> Self {
        Self {
            count: 0,
            sum: 0.0,
            squares: 0.0,
            least: i64::MAX,
            most: i64::MIN,
            bins: [0; 22],
        }
    }
}

/// Width of a bin of [`PhaseFigures::bins`], ns.
pub const BIN_NS: i64 = 5_000;

impl PhaseFigures {
    /// Adds a deviation, ns; positive is late.
    pub fn add(&mut self, distance_ns: i64) {
        let exact = distance_ns as f64;
        self.count += 1;
        self.sum += exact;
        self.squares += exact * exact;
        self.least = self.least.min(distance_ns);
        self.most = self.most.max(distance_ns);
        let bin = usize::try_from((distance_ns.div_euclid(BIN_NS) + 11).clamp(0, 21)).unwrap_or(0);
        if let Some(count) = self.bins.get_mut(bin) {
            *count += 1;
        }
    }

    /// Number of values.
    pub const fn count(&self) -> u64 {
        self.count
    }

    /// Mean, ns; zero without values.
    pub fn mean_ns(&self) -> f64 {
        self.per(self.sum)
    }

    /// Root mean square, ns; zero without values.
    pub fn rms_ns(&self) -> f64 {
        self.per(self.squares).sqrt()
    }

    fn per(&self, sum: f64) -> f64 {
        let count = self.count.max(1) as f64;
        sum / count
    }

    /// Minimum and maximum, ns; `None` without values.
    pub const fn range_ns(&self) -> Option<(i64, i64)> {
        if self.count == 0 {
            None
        } else {
            Some((self.least, self.most))
        }
    }

    /// Histogram of deviations: below -50 us, then 20 bins of [`BIN_NS`], then above 50 us.
    pub const fn bins(&self) -> &[u64; 22] {
        &self.bins
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn sync0_start_is_on_a_common_future_grid() {
        let lead = Duration::from_millis(100);
        for (now, shift, start) in [
            (0, 0, 101_000_000),
            (999_999, 0, 101_000_000),
            (1_000_000, 0, 102_000_000),
            (0, 250_000, 100_250_000),
            (250_000, 250_000, 101_250_000),
            (0, -1, 100_999_999),
        ] {
            assert_eq!(start_time(now, lead, MS, shift), start, "{now} {shift}");
            assert_eq!(phase_ns(start, MS, shift), 0);
        }
        assert_eq!(phase_ns(5_000_300, MS, 500), 999_800);
        assert_eq!(phase_ns(7, Duration::ZERO, -3), 0);
    }

    /// Receive times of a line in which each slave needs 300 ns and each cable 100 ns, as from local clocks that have
    /// nothing to do with each other.
    #[test]
    fn line_delays_follow_from_receive_times() {
        let line = Topology::line(3);
        let times = [
            Some([u32::MAX - 100, 1500_u32.wrapping_sub(100), 0, 0]),
            Some([5000, 5800, 9, 9]),
            Some([77, 9, 9, 9]),
        ];
        // Seen by the first: 1501 - 1 ns there and back; by the second 800.
        let found = delays(&line, &times);
        assert_eq!(found, [0, (1501 - 800) / 2, (1501 - 800) / 2 + 400]);
        // Without a clock in between the delay behind it is the same.
        let times = [times[0], None, times[2]];
        assert_eq!(delays(&line, &times), [0, 0, 1501 / 2]);
        let times = [None, Some([0, 1600, 0, 0]), Some([77, 9, 9, 9])];
        assert_eq!(delays(&line, &times), [0, 0, 800]);
    }

    #[test]
    fn clock_of_32_bits_is_extended_over_wraps() {
        let wrap = 1_u64 << 32;
        for near in [0, 5, wrap - 3, wrap + 2, 7 * wrap - 1, u64::MAX - 1] {
            for away in [-2_000_000_000_i64, -5, 0, 5, 2_000_000_000] {
                let time = near.wrapping_add_signed(away);
                let low = u32::try_from(time & (wrap - 1)).unwrap();
                assert_eq!(extended(low, near), time, "{near} {away}");
            }
        }
    }

    #[test]
    fn tree_delays_include_earlier_branches() {
        // Slave 0 with 1 at port 3, 2 at port 1 and 3 at port 2; each way 400 ns.
        let tree = Topology::new(&[
            [true, true, true, true],
            [true, false, false, false],
            [true, false, false, false],
            [true, false, false, false],
        ]);
        let times = [
            Some([0, 1600, 2400, 800]),
            Some([5, 0, 0, 0]),
            Some([6, 0, 0, 0]),
            Some([7, 0, 0, 0]),
        ];
        assert_eq!(delays(&tree, &times), [0, 400, 1200, 2000]);
    }

    #[test]
    fn phase_figures_accumulate() {
        let mut figures = PhaseFigures::default();
        assert_eq!((figures.range_ns(), figures.count()), (None, 0));
        for distance in [-4000, 4000, 60_000, -60_000] {
            figures.add(distance);
        }
        assert_eq!(figures.range_ns(), Some((-60_000, 60_000)));
        assert!(figures.mean_ns().abs() < 1e-9);
        assert!((figures.rms_ns() - 42_520.58).abs() < 0.1);
        let bins = figures.bins();
        assert_eq!((bins[0], bins[10], bins[11], bins[21]), (1, 1, 1, 1));
    }
}
