//! The clocks of net threads: where their grid of cycles begins, and the device clock that they follow. The device's driver measures it; this
//! module keeps the connection between driver and threads when drivers are added and removed.

use std::time::Duration;

use takt_rt::Nanos;
use takt_rt::cycle::Follow;
use takt_rt::latest::{LatestReader, LatestWriter, latest};
use takt_rt::servo::{Estimate, State};

use crate::cell::{CellConfig, THREADS_MAX};

/// Longest grid that the first cycle is set to.
const GRID_MAX: i64 = 1_000_000_000;

/// Where the cycles of all net threads begin: the last instant of TAI, as this host's kernel has it now, that is a whole multiple of all
/// periods. Controllers whose clocks agree thus have the same cycles, until TAI is stepped; those of one host always, as neither the kernel's
/// quality nor its TAI offset matters there.
pub(super) fn base(periods: &[Duration]) -> Nanos {
    let now = takt_rt::monotonic();
    let offset = takt_rt::read_tai().map_or(Nanos::ZERO, |reading| reading.offset());
    last_common(now, offset, periods)
}

fn last_common(now: Nanos, offset: Nanos, periods: &[Duration]) -> Nanos {
    let periods = periods.iter().map(|period| Nanos::from(*period).0.max(1));
    let grid = periods.fold(1_i64, |grid, period| {
        let (mut a, mut b) = (grid, period);
        while b != 0 {
            (a, b) = (b, a % b);
        }
        let common = (grid / a).checked_mul(period);
        common.filter(|it| *it <= GRID_MAX).unwrap_or(grid)
    });
    now - Nanos((now + offset).0.rem_euclid(grid))
}

/// State of the clock that a net thread follows.
#[derive(Clone, Debug, PartialEq)]
pub struct ClockInfo {
    /// The device whose clock it is.
    pub device: String,
    /// Accuracy of the driver's estimate.
    pub state: State,
    /// How much faster than this host's it runs, ppb; `None` while it is not known.
    pub ppb: Option<f64>,
    /// Offset of the thread's cycles from the device's cycles.
    pub phase: Duration,
}

/// The clock that the net threads of a cell follow.
#[derive(Debug)]
pub(super) struct FollowedClock {
    device: String,
    /// Phases of the threads, the first one first.
    phases: Vec<Duration>,
    /// The writer, while no driver holds it.
    writer: Option<LatestWriter<Estimate>>,
    reader: LatestReader<Estimate>,
}

impl FollowedClock {
    /// As configured in the cell; `None` if its threads follow the host's clock.
    pub(super) fn of(cell: &CellConfig) -> Option<Self> {
        let (writer, reader) = latest(THREADS_MAX + 1, Estimate::default);
        Some(Self {
            device: cell.controller.follow.clone()?,
            phases: cell.phases().collect(),
            writer: Some(writer),
            reader,
        })
    }

    /// The reader and phase for a thread.
    pub(super) fn follow(&self, thread: usize) -> Option<Follow> {
        let phase = self.phases.get(thread)?;
        Some(Follow::new(self.reader.another()?, (*phase).into()))
    }

    /// Where a device's driver writes its clock estimate: to the net threads, or to an unconnected cell.
    pub(super) fn writer_for(followed: &mut Option<Self>, device: &str) -> LatestWriter<Estimate> {
        let followed = followed.as_mut().filter(|clock| clock.device == device);
        let writer = followed.and_then(|clock| clock.writer.take());
        writer.unwrap_or_else(|| latest(1, Estimate::default).0)
    }

    /// Takes back the writer of a removed device's driver, for the next one.
    pub(super) fn give_back(
        followed: &mut Option<Self>,
        device: &str,
        writer: LatestWriter<Estimate>,
    ) {
        if let Some(clock) = followed.as_mut().filter(|clock| clock.device == device) {
            clock.writer = Some(writer);
        }
    }

    /// The present state of the clock, for a thread.
    pub(super) fn info(&mut self, thread: usize) -> Option<ClockInfo> {
        let now = self.reader.read();
        let is_known = now.is_valid_at(takt_rt::monotonic());
        let state = if now.state.is_followed() && !is_known {
            State::Unlocked
        } else {
            now.state
        };
        Some(ClockInfo {
            device: self.device.clone(),
            state,
            ppb: is_known.then_some(now.frequency_ppb),
            phase: *self.phases.get(thread)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base_is_last_common_multiple_of_periods_in_tai() {
        let ms = Duration::from_millis;
        let base = |periods: &[Duration]| {
            last_common(Nanos(1_000_700_003), Nanos(5_000_299_998), periods).0
        };
        // TAI is 6,001,000,001 ns.
        assert_eq!(base(&[ms(1)]), 1_000_700_002);
        assert_eq!(base(&[ms(2), ms(1)]), 1_000_700_002 - 1_000_000);
        assert_eq!(base(&[ms(4), ms(10)]), 1_000_700_002 - 1_000_000);
        // No common multiple of at most 1 s: that of the first ones.
        assert_eq!(base(&[ms(1), ms(997), ms(991)]), 1_000_700_002 - 19_000_000);
        assert_eq!(last_common(Nanos(7), Nanos(-9_000_000), &[ms(1)]), Nanos(0));
    }

    fn cell(follow: Option<&str>) -> CellConfig {
        let mut cell = CellConfig::default();
        cell.controller.follow = follow.map(str::to_owned);
        cell.controller.phase = Some(Duration::from_micros(300));
        cell
    }

    fn locked() -> Estimate {
        Estimate {
            state: State::Locked,
            frequency_ppb: 20.0,
            expires: Nanos::MAX,
            ..Estimate::default()
        }
    }

    #[test]
    fn only_followed_device_clock_is_read() {
        assert!(FollowedClock::of(&cell(None)).is_none());
        let mut clock = FollowedClock::of(&cell(Some("left")));
        let mut stranger = FollowedClock::writer_for(&mut clock, "right");
        stranger.write(locked());
        let state = |clock: &mut Option<FollowedClock>| clock.as_mut()?.info(0).map(|c| c.state);
        assert_eq!(state(&mut clock), Some(State::Unlocked));
        let mut driver = FollowedClock::writer_for(&mut clock, "left");
        driver.write(locked());
        let info = clock.as_mut().unwrap().info(0).unwrap();
        let phase = Duration::from_micros(300);
        assert_eq!((info.ppb, info.phase), (Some(20.0), phase));
        assert_eq!(info.state, State::Locked);
    }

    #[test]
    fn clock_of_restarted_driver_is_read() {
        let mut clock = FollowedClock::of(&cell(Some("left")));
        let driver = FollowedClock::writer_for(&mut clock, "left");
        FollowedClock::give_back(&mut clock, "right", latest(1, Estimate::default).0);
        FollowedClock::give_back(&mut clock, "left", driver);
        let mut next = FollowedClock::writer_for(&mut clock, "left");
        next.write(locked());
        let info = clock.unwrap().info(0).unwrap();
        assert_eq!(info.state, State::Locked);
    }

    #[test]
    fn clock_without_estimate_is_unknown() {
        let mut clock = FollowedClock::of(&cell(Some("left")));
        let mut driver = FollowedClock::writer_for(&mut clock, "left");
        let expired = Estimate {
            expires: Nanos::ZERO,
            ..locked()
        };
        driver.write(expired);
        let info = clock.unwrap().info(0).unwrap();
        assert_eq!((info.state, info.ppb), (State::Unlocked, None));
    }
}
