//! What `takt emulate lwr|iiwa` have in common: what goes wrong on the way and in the robot, how patient the controller
//! is, what the flange touches. It starts nothing.

use std::time::Duration;

use clap::Args;
use takt_fri::lwr::emulator::{Contact, LineFaults, PowerOff, Shape, Timing};

use crate::output::{share, span};

/// Consecutive cycles without an answer that an emulated controller bridges unless it is strict.
pub(super) const MISSES_MAX: u32 = 100;
/// Damping of what the flange touches, Ns/m.
const CONTACT_DAMPING: f64 = 50.0;
/// Its stiffness unless another is given, N/m.
const CONTACT_STIFFNESS: f64 = 10_000.0;
/// Fastest and slowest clock, ppm either way.
const DRIFT_MAX_PPM: f64 = 1_000.0;

/// What goes wrong on the way and in the robot, and when it ends.
#[derive(Debug, Args)]
pub(super) struct Knobs {
    /// Share of datagrams to lose in each direction, 0 to 1.
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, value_parser = share)]
    drop: f64,
    /// Share of datagrams to send twice, 0 to 1.
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, value_parser = share)]
    duplicate: f64,
    /// Delay of every datagram.
    #[arg(long, value_name = "TIME", default_value = "0ms", value_parser = span)]
    delay: Duration,
    /// Longest additional delay, uniformly distributed.
    #[arg(long, value_name = "TIME", default_value = "0ms", value_parser = span)]
    jitter: Duration,
    /// Share of datagrams to send behind their successor, 0 to 1.
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, value_parser = share)]
    reorder: f64,
    /// How slow the controller's clock runs, parts per million: -1000 to 1000.
    #[arg(long, value_name = "PPM", default_value_t = 0.0, value_parser = drift, allow_hyphen_values = true)]
    drift: f64,
    /// Judge timing as is assumed of a real controller: 10 missing answers, or bad quality, end command mode.
    #[arg(long)]
    strict: bool,
    /// What the flange meets on its way down: `wall:DEPTH[:STIFFNESS]` or `spring:DEPTH[:STIFFNESS]`, so many metres below
    /// where it rests, N/m (10000 if not said).
    #[arg(long, value_name = "WHAT", value_parser = touch)]
    contact: Option<Touch>,
    /// Switch the drives off this long after the start.
    #[arg(long, value_name = "TIME", value_parser = span)]
    power_off: Option<Duration>,
    /// Seed of all that is random.
    #[arg(long, default_value_t = 1)]
    pub(super) seed: u64,
    /// End after this time; without it, at Ctrl-C.
    #[arg(long, value_name = "TIME", value_parser = span)]
    pub(super) duration: Option<Duration>,
}

/// Something to touch, as the command line names it.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Touch {
    shape: Shape,
    /// m below the flange.
    depth: f64,
    /// N/m.
    stiffness: f64,
}

impl Knobs {
    /// What happens to datagrams, in each direction.
    pub(super) fn line(&self) -> LineFaults {
        LineFaults {
            drop: self.drop,
            duplicate: self.duplicate,
            reorder: self.reorder,
            delay: self.delay,
            jitter: self.jitter,
            ..LineFaults::default()
        }
    }

    pub(super) fn power_off(&self) -> Option<PowerOff> {
        self.power_off.map(|at| PowerOff {
            at,
            span: Duration::from_secs(2),
        })
    }

    /// How slow the controller's clock runs, ppm.
    pub(super) fn drift_ppm(&self) -> f64 {
        self.drift
    }

    /// How answers are judged: as documented, or with `patience`.
    pub(super) fn timing(&self, patience: Timing) -> Timing {
        if self.strict {
            Timing::default()
        } else {
            patience
        }
    }

    /// What is touched on the way down from `flange`, m in the base frame.
    pub(super) fn contact(&self, flange: [f64; 3]) -> Option<Contact> {
        let [x, y, z] = flange;
        self.contact.map(|touch| Contact {
            shape: touch.shape,
            point: [x, y, z - touch.depth],
            normal: [0.0, 0.0, 1.0],
            stiffness: touch.stiffness,
            damping: CONTACT_DAMPING,
        })
    }
}

fn drift(text: &str) -> Result<f64, String> {
    let ppm: f64 = text.parse().map_err(|_| format!("`{text}` is no number"))?;
    if (-DRIFT_MAX_PPM..=DRIFT_MAX_PPM).contains(&ppm) {
        Ok(ppm)
    } else {
        Err(format!("must be {} to {DRIFT_MAX_PPM}", -DRIFT_MAX_PPM))
    }
}

fn touch(text: &str) -> Result<Touch, String> {
    let wrong = || {
        format!(
            "`{text}`: write a kind, a depth in m and perhaps a stiffness in N/m, such as wall:0.01:5000"
        )
    };
    let number = |text: &str| -> Result<f64, String> {
        let number: f64 = text.parse().map_err(|_| wrong())?;
        if (0.0..=1e6).contains(&number) {
            Ok(number)
        } else {
            Err(wrong())
        }
    };
    let mut parts = text.split(':');
    let shape = match parts.next() {
        Some("wall") => Shape::Wall,
        Some("spring") => Shape::Spring,
        Some(_) | None => return Err(wrong()),
    };
    let depth = number(parts.next().ok_or_else(wrong)?)?;
    let stiffness = parts.next().map_or(Ok(CONTACT_STIFFNESS), number)?;
    match parts.next() {
        None => Ok(Touch {
            shape,
            depth,
            stiffness,
        }),
        Some(_) => Err(wrong()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn contacts_are_read_and_nonsense_is_refused() {
        let wall = |depth, stiffness| Touch {
            shape: Shape::Wall,
            depth,
            stiffness,
        };
        assert_eq!(touch("wall:0.01"), Ok(wall(0.01, 10_000.0)));
        assert_eq!(touch("wall:0:5000"), Ok(wall(0.0, 5_000.0)));
        assert_eq!(touch("spring:0.2:1").map(|it| it.shape), Ok(Shape::Spring));
        for wrong in [
            "",
            "wall",
            "door:1",
            "wall:-1",
            "wall:NaN",
            "wall:1:2:3",
            "wall:0.01m",
        ] {
            let told = touch(wrong).unwrap_err();
            assert!(told.contains("such as wall:0.01:5000"), "{told}");
        }
    }

    #[test]
    fn clocks_drift_within_bounds() {
        assert_eq!(drift("-50"), Ok(-50.0));
        assert_eq!(drift("1001").unwrap_err(), "must be -1000 to 1000");
        assert!(drift("NaN").is_err() && drift("50ppm").is_err());
    }
}
