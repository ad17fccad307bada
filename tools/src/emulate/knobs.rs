//! What `takt emulate lwr|iiwa` have in common: faults of the network and of the robot, tolerance of the controller,
//! contact of the flange. It starts nothing.

use std::net::SocketAddr;
use std::time::Duration;

use clap::Args;
use takt_fri::lwr::emulator::{Carried, Contact, LineFaults, PowerOff, Shape, Timing};

use crate::output::{positive_span, share, span};

/// Damping of an obstacle, Ns/m.
const CONTACT_DAMPING: f64 = 50.0;
/// Its stiffness unless another is given, N/m.
const CONTACT_STIFFNESS: f64 = 10_000.0;
/// Fastest and slowest clock, ppm either way.
const DRIFT_MAX_PPM: f64 = 1_000.0;

/// Faults of the network and of the robot, and the duration.
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
    /// Share of datagrams to send after their successor, 0 to 1.
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, value_parser = share)]
    reorder: f64,
    /// How slow the controller's clock runs, parts per million: -1000 to 1000.
    #[arg(long, value_name = "PPM", default_value_t = 0.0, value_parser = drift, allow_hyphen_values = true)]
    drift: f64,
    /// Apply the limits assumed of a real controller: 10 missing answers, or bad quality, end command mode.
    #[arg(long)]
    strict: bool,
    /// Obstacle below the tool: `wall:DEPTH[:STIFFNESS[:DAMPING]]` or `spring:…`, DEPTH in m below its rest position, or
    /// `table:HEIGHT[:STIFFNESS[:DAMPING]]`, HEIGHT in m above the base of the arm; STIFFNESS in N/m (default 10000), DAMPING
    /// in Ns/m (default 50).
    #[arg(long, value_name = "WHAT", value_parser = touch)]
    contact: Option<Touch>,
    /// Length of a tool along the flange's axis, such as 100mm: a contact at its tip has a moment about the flange.
    #[arg(long, value_name = "LENGTH", default_value = "0mm", value_parser = length)]
    tool: f64,
    /// Mass at the tip of the tool that the controller does not know, kg, 0 to 100.
    #[arg(long, value_name = "KG", default_value_t = 0.0, value_parser = mass)]
    carries: f64,
    /// Address and port of the controller, from which its datagrams leave: for clients that connect to the robot.
    #[arg(long, alias = "listen", value_name = "IP:PORT")]
    pub(super) bind: Option<SocketAddr>,
    /// Switch the drives off this long after the start.
    #[arg(long, value_name = "TIME", value_parser = span)]
    power_off: Option<Duration>,
    /// Seed of the random number generator.
    #[arg(long, default_value_t = 1)]
    pub(super) seed: u64,
    /// End after this time; without it, at Ctrl-C.
    #[arg(long, value_name = "TIME", value_parser = positive_span)]
    pub(super) duration: Option<Duration>,
}

/// A mass, kg.
fn mass(text: &str) -> Result<f64, String> {
    let mass = text.parse().ok().filter(|kg| (0.0..=100.0).contains(kg));
    mass.ok_or_else(|| "0 to 100 is expected, kg".to_owned())
}

/// An obstacle, as an option value.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Touch {
    shape: Shape,
    height: Height,
    /// N/m.
    stiffness: f64,
    /// Ns/m.
    damping: f64,
}

/// Where an obstacle is.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Height {
    /// m below the tool at rest.
    Below(f64),
    /// m above the base.
    Above(f64),
}

impl Knobs {
    /// Faults of datagrams, in each direction.
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

    /// Limits for answers: as documented if strict, else `tolerant`.
    pub(super) fn timing(&self, tolerant: Timing) -> Timing {
        if self.strict {
            Timing::default()
        } else {
            tolerant
        }
    }

    /// What hangs at the tip of the tool.
    pub(super) fn carried(&self) -> Option<Box<Carried>> {
        let load = Carried {
            mass: self.carries,
            centre: self.tool_m(),
        };
        (load.mass > 0.0).then(|| Box::new(load))
    }

    /// Tip of the tool in the frame of the flange, m.
    pub(super) fn tool_m(&self) -> [f64; 3] {
        [0.0, 0.0, self.tool]
    }

    /// The obstacle below `tip`, m in the base frame.
    pub(super) fn contact(&self, tip: [f64; 3]) -> Option<Contact> {
        let [x, y, z] = tip;
        self.contact.map(|touch| Contact {
            shape: touch.shape,
            point: match touch.height {
                Height::Below(depth) => [x, y, z - depth],
                Height::Above(height) => [x, y, height],
            },
            normal: [0.0, 0.0, 1.0],
            stiffness: touch.stiffness,
            damping: touch.damping,
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

/// Reads a length with its unit, m.
fn length(text: &str) -> Result<f64, String> {
    let wrong =
        || format!("`{text}` is no length: write a number and a unit, such as 100mm or 0.1m");
    let (number, factor) = match (text.strip_suffix("mm"), text.strip_suffix('m')) {
        (Some(millimetres), _) => (millimetres, 1e-3),
        (None, Some(metres)) => (metres, 1.0),
        (None, None) => return Err(wrong()),
    };
    let length = number.trim().parse::<f64>().map_err(|_| wrong())? * factor;
    if (0.0..=1.0).contains(&length) {
        Ok(length)
    } else {
        Err(format!("`{text}`: must be 0 to 1m"))
    }
}

fn touch(text: &str) -> Result<Touch, String> {
    let wrong = || {
        format!(
            "`{text}`: write a kind, a depth or height in m, and perhaps a stiffness in N/m and a damping in Ns/m, such as \
             wall:0.01:5000 or table:0.4"
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
    let kind = parts.next().unwrap_or_default();
    let height = number(parts.next().ok_or_else(wrong)?)?;
    let (shape, height) = match kind {
        "wall" => (Shape::Wall, Height::Below(height)),
        "spring" => (Shape::Spring, Height::Below(height)),
        "table" => (Shape::Wall, Height::Above(height)),
        _ => return Err(wrong()),
    };
    let stiffness = parts.next().map_or(Ok(CONTACT_STIFFNESS), number)?;
    let damping = parts.next().map_or(Ok(CONTACT_DAMPING), number)?;
    match parts.next() {
        None => Ok(Touch {
            shape,
            height,
            stiffness,
            damping,
        }),
        Some(_) => Err(wrong()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn contact_option_parses_or_is_refused() {
        let wall = |depth, stiffness| Touch {
            shape: Shape::Wall,
            height: Height::Below(depth),
            stiffness,
            damping: CONTACT_DAMPING,
        };
        let table = Touch {
            height: Height::Above(0.4),
            damping: 80.0,
            ..wall(0.0, 2_000.0)
        };
        assert_eq!(touch("table:0.4:2000:80"), Ok(table));
        assert_eq!(touch("wall:0.01"), Ok(wall(0.01, 10_000.0)));
        assert_eq!(touch("wall:0:5000"), Ok(wall(0.0, 5_000.0)));
        assert_eq!(touch("spring:0.2:1").map(|it| it.shape), Ok(Shape::Spring));
        for wrong in [
            "",
            "wall",
            "door:1",
            "wall:-1",
            "wall:NaN",
            "wall:1:2:3:4",
            "table:-0.1",
            "wall:0.01m",
        ] {
            let error = touch(wrong).unwrap_err();
            assert!(error.contains("such as wall:0.01:5000"), "{error}");
        }
    }

    #[test]
    fn tool_length_has_unit_and_bound() {
        assert!((length("100mm").unwrap() - 0.1).abs() < 1e-12);
        assert!((length("0.25m").unwrap() - 0.25).abs() < 1e-12);
        for wrong in ["0.1", "m", "2m", "-1mm", "NaNm", "1cm "] {
            assert!(length(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn clocks_drift_within_bounds() {
        assert_eq!(drift("-50"), Ok(-50.0));
        assert_eq!(drift("1001").unwrap_err(), "must be -1000 to 1000");
        assert!(drift("NaN").is_err() && drift("50ppm").is_err());
    }
}
