//! Angles, lengths and poses of the command line. A number needs its unit, except 0.

use takt_api::Pose;

/// A pose of the command line: a position and, if it was written, an orientation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Place {
    /// m.
    position: [f64; 3],
    /// About z, then the new y, then the new x, rad.
    abc: Option<[f64; 3]>,
}

impl Place {
    /// The pose, with another orientation if none was written.
    pub(crate) fn pose(&self, otherwise: Option<Pose>) -> Option<Pose> {
        let [x, y, z] = self.position;
        match self.abc {
            Some([a, b, c]) => Some(Pose::xyz(x, y, z).abc(a, b, c)),
            None => Some(Pose::quaternion(self.position, otherwise?.orientation())),
        }
    }

    /// Whether it has an orientation of its own.
    pub(crate) const fn is_whole(&self) -> bool {
        self.abc.is_some()
    }
}

/// Units with their size in the SI unit.
type Units<'a> = &'a [(&'a str, f64)];

const ANGLES: Units<'_> = &[("deg", std::f64::consts::PI / 180.0), ("rad", 1.0)];
/// `m` is the last one, since `mm` ends in it.
const LENGTHS: Units<'_> = &[("mm", 1e-3), ("cm", 1e-2), ("m", 1.0)];

const FORCES: Units<'_> = &[("kN", 1e3), ("N", 1.0)];

fn read(text: &str, units: Units<'_>) -> Option<f64> {
    let text = text.trim();
    let of = |(unit, size): &(&str, f64)| {
        let number: f64 = text.strip_suffix(unit)?.trim().parse().ok()?;
        Some(number * size)
    };
    let zero = || text.parse::<f64>().ok().filter(|number| *number == 0.0);
    let value = units.iter().find_map(of).or_else(zero)?;
    value.is_finite().then_some(value)
}

/// Reads a size, bytes.
pub(crate) fn size(text: &str) -> Result<u64, String> {
    let units = [
        ("KiB", 1 << 10),
        ("MiB", 1 << 20),
        ("GiB", 1 << 30),
        ("TiB", 1 << 40),
    ];
    let of = |(unit, bytes): (&str, u64)| {
        let number: u64 = text.strip_suffix(unit)?.trim().parse().ok()?;
        number.checked_mul(bytes)
    };
    units.into_iter().find_map(of).ok_or_else(|| {
        format!("`{text}` is no size: write a number and a unit, such as 256MiB or 1GiB")
    })
}

/// Reads an angle, rad.
pub(crate) fn angle(text: &str) -> Result<f64, String> {
    let wrong = || {
        let text = text.trim();
        format!("`{text}` is no angle: write a number and a unit, such as 5deg or 0.1rad")
    };
    read(text, ANGLES).ok_or_else(wrong)
}

/// Reads a length, m.
pub(crate) fn length(text: &str) -> Result<f64, String> {
    let wrong = || {
        let text = text.trim();
        format!("`{text}` is no length: write a number and a unit, such as 0.5m or -20mm")
    };
    read(text, LENGTHS).ok_or_else(wrong)
}

/// Reads a force, N.
pub(crate) fn force(text: &str) -> Result<f64, String> {
    let wrong = || {
        let text = text.trim();
        format!("`{text}` is no force: write a number and a unit, such as 20N")
    };
    read(text, FORCES).ok_or_else(wrong)
}

/// Reads a pose: `X,Y,Z` or `X,Y,Z,A,B,C`.
pub(crate) fn place(text: &str) -> Result<Place, String> {
    let parts: Vec<_> = text.split(',').collect();
    let (position, abc) = match *parts {
        [x, y, z] => ([x, y, z], None),
        [x, y, z, a, b, c] => ([x, y, z], Some([a, b, c])),
        _ => {
            let count = parts.len();
            return Err(format!(
                "a pose has 3 or 6 parts, not {count}: X,Y,Z or X,Y,Z,A,B,C, such as 0.5m,0,400mm"
            ));
        }
    };
    let [x, y, z] = position.map(length);
    let position = [x?, y?, z?];
    let Some(abc) = abc else {
        return Ok(Place {
            position,
            abc: None,
        });
    };
    let [a, b, c] = abc.map(angle);
    Ok(Place {
        position,
        abc: Some([a?, b?, c?]),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angle_takes_units_and_bare_zero() {
        assert_eq!(angle("0"), Ok(0.0));
        assert_eq!(angle("-0.1rad"), Ok(-0.1));
        assert!((angle(" -180 deg").unwrap() + std::f64::consts::PI).abs() < 1e-12);
        for wrong in ["5", "", "deg", "5m", "NaN", "infdeg", "1e999rad", "5 degs"] {
            let error = angle(wrong).unwrap_err();
            assert!(error.contains("such as 5deg"), "{wrong}: {error}");
        }
    }

    #[test]
    fn force_and_length_need_units() {
        assert_eq!(force("20N"), Ok(20.0));
        assert_eq!(force("0.02 kN"), Ok(20.0));
        assert_eq!(length("50mm"), Ok(0.05));
        for wrong in ["20", "N", "NaNN", "20mm", "infkN"] {
            assert!(force(wrong).unwrap_err().contains("such as 20N"), "{wrong}");
        }
    }

    #[test]
    fn place_reads_lengths_and_angles() {
        let there = place("0.5m,-20mm,4cm").unwrap();
        assert_eq!(format!("{:?}", there.position), "[0.5, -0.02, 0.04]");
        assert!(!there.is_whole() && there.pose(None).is_none());
        let turned = place("0,0,1m,180deg,0,1rad").unwrap();
        assert_eq!(turned.abc, Some([std::f64::consts::PI, 0.0, 1.0]));
        for (wrong, cause) in [
            ("0,0", "not 2"),
            ("0,0,0,0", "not 4"),
            ("1,0,0", "`1` is no length"),
            ("0,0,1deg", "`1deg` is no length"),
            ("0,0,0,1m,0,0", "`1m` is no angle"),
            ("0,0,,0,0,0", "`` is no length"),
        ] {
            let error = place(wrong).unwrap_err();
            assert!(error.contains(cause), "{wrong}: {error}");
        }
    }

    #[test]
    fn place_without_orientation_takes_another() {
        let now = Pose::xyz(9.0, 9.0, 9.0).abc(0.3, 0.2, 0.1);
        let pose = place("1m,0,0").unwrap().pose(Some(now)).unwrap();
        assert_eq!(format!("{:?}", pose.position()), "[1.0, 0.0, 0.0]");
        let turned = pose.isometry().rotation.angle_to(&now.isometry().rotation);
        assert!(turned < 1e-12, "{turned}");
    }

    #[test]
    fn size_needs_unit_and_fits() {
        assert_eq!(size("4MiB"), Ok(4 << 20));
        assert_eq!(size("1 GiB"), Ok(1 << 30));
        for wrong in ["", "5", "1GB", "-1MiB", "1.5GiB", "99999999999TiB"] {
            let error = size(wrong).unwrap_err();
            assert!(error.contains("is no size"), "{error}");
        }
    }
}
