//! The period of SYNC as a drive sees it. Drives take it as interpolation time (60C2h) if their master does not write
//! that.

use std::time::Duration;

/// Observed SYNC messages.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct SyncPeriod {
    last: Option<Duration>,
    interval: Option<Duration>,
}

impl SyncPeriod {
    /// Handles a SYNC; returns the period in the format of 60C2h once two intervals in a row agree.
    pub(super) fn handle(&mut self, now: Duration) -> Option<(u8, i8)> {
        let last = self.last.replace(now)?;
        let interval = now.saturating_sub(last);
        let before = self.interval.replace(interval)?;
        let differ = before.abs_diff(interval);
        (differ <= interval / 4).then(|| nearest((before + interval) / 2))?
    }
}

/// A period in the format of 60C2h, value and decimal exponent: whole milliseconds if it is near to them.
fn nearest(period: Duration) -> Option<(u8, i8)> {
    let tenths = (period.as_micros() + 50) / 100;
    let ms = (period.as_micros() + 500) / 1000;
    let off = (ms * 10).abs_diff(tenths);
    let is_whole = off * 10 <= tenths || tenths > u128::from(u8::MAX);
    let (value, exponent) = if is_whole { (ms, -3) } else { (tenths, -4) };
    let value = u8::try_from(value).ok().filter(|value| *value > 0)?;
    Some((value, exponent))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sync_period_is_rounded_to_60c2h() {
        let us = Duration::from_micros;
        for (period, known) in [
            (10_000, Some((10, -3))),
            (4_130, Some((4, -3))),
            (1_000, Some((1, -3))),
            (2_500, Some((25, -4))),
            (250_000, Some((250, -3))),
            (400_000, None),
            (10, None),
        ] {
            let mut sync = SyncPeriod::default();
            let seen: Vec<_> = (0..3).map(|n| sync.handle(us(n * period))).collect();
            assert_eq!(seen, [None, None, known], "{period}");
        }
    }

    #[test]
    fn sync_intervals_that_differ_have_no_period() {
        let ms = Duration::from_millis;
        let mut sync = SyncPeriod::default();
        let seen = [0, 10, 12, 22, 24].map(|at| sync.handle(ms(at)));
        assert_eq!(seen, [None; 5]);
    }
}
