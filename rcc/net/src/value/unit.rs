//! Units of parameters: `30deg`, `250ms`, `5 mm/s`. The value is converted to SI while the net is loaded;
//! values that programs read and write are SI always and have no units.
//!
//! A unit is a product of `rad mrad deg rev m km cm mm um s ms us ns min h kg g N kN mN Nm mNm Hz kHz rpm`,
//! with `/`, `*` or a blank between them and powers such as `m/s^2` or `m/s²`.

use std::f64::consts::PI;
use std::fmt;

/// Exponents of metre, kilogram, second and radian. Angles count as a dimension: radians typed as
/// degrees are the commonest mistake.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Dimension([i8; 4]);

/// Symbols of the exponents.
const SYMBOLS: [&str; 4] = ["m", "kg", "s", "rad"];

impl Dimension {
    const NONE: Self = Self([0, 0, 0, 0]);
    /// Angle, rad.
    pub const ANGLE: Self = Self([0, 0, 0, 1]);
    /// Rotational velocity, rad/s.
    pub const ROTATION: Self = Self([0, 0, -1, 1]);
    /// Length, m.
    pub const LENGTH: Self = Self([1, 0, 0, 0]);
    /// Velocity, m/s.
    pub const VELOCITY: Self = Self([1, 0, -1, 0]);
    /// Force, N.
    pub const FORCE: Self = Self([1, 1, -2, 0]);
    /// Torque, Nm.
    pub const TORQUE: Self = Self([2, 1, -2, 0]);
    /// Time, s.
    pub const TIME: Self = Self([0, 0, 1, 0]);

    /// The usual name, and an example of a value.
    fn usual(self) -> Option<(&'static str, &'static str)> {
        Some(match self.0 {
            [0, 0, 0, 1] => ("an angle", "30deg"),
            [0, 0, -1, 1] => ("a rotational velocity", "30deg/s"),
            [0, 0, -2, 1] => ("a rotational acceleration", "30deg/s^2"),
            [0, 0, -3, 1] => ("a rotational jerk", "30deg/s^3"),
            [1, 0, 0, 0] => ("a length", "5mm"),
            [1, 0, -1, 0] => ("a velocity", "50mm/s"),
            [1, 0, -2, 0] => ("an acceleration", "2m/s^2"),
            [1, 0, -3, 0] => ("a jerk", "5m/s^3"),
            [0, 0, 1, 0] => ("a time", "250ms"),
            [0, 0, -1, 0] => ("a frequency", "10Hz"),
            [0, 1, 0, 0] => ("a mass", "0.5kg"),
            [1, 1, -2, 0] => ("a force", "20N"),
            [2, 1, -2, 0] => ("a torque", "2Nm"),
            [0, 1, -2, 0] => ("a stiffness", "2000N/m"),
            [2, 1, -2, -1] => ("a rotational stiffness", "200Nm/rad"),
            [2, 1, 0, 0] => ("a moment of inertia", "0.01kg m^2"),
            _ => return None,
        })
    }
}

/// The SI unit, such as `rad/s²`.
impl fmt::Display for Dimension {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let known = match self.0 {
            [1, 1, -2, 0] => "N",
            [2, 1, -2, 0] => "Nm",
            [0, 1, -2, 0] => "N/m",
            [2, 1, -2, -1] => "Nm/rad",
            _ => "",
        };
        if !known.is_empty() {
            return f.write_str(known);
        }
        let power = |exponent: i8| match exponent.unsigned_abs() {
            2 => "²".to_owned(),
            3 => "³".to_owned(),
            0 | 1 => String::new(),
            more => format!("^{more}"),
        };
        let with = |sign: i8| {
            let parts = SYMBOLS.iter().zip(self.0);
            let parts = parts.filter(move |(_, exponent)| exponent.signum() == sign);
            parts.map(|(symbol, exponent)| format!("{symbol}{}", power(exponent)))
        };
        let above: Vec<String> = with(1).collect();
        let above = if above.is_empty() {
            "1".to_owned()
        } else {
            above.join(" ")
        };
        let below: String = with(-1).map(|part| format!("/{part}")).collect();
        write!(f, "{above}{below}")
    }
}

/// What a number in a port or parameter measures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// What its net makes of it: a value with any unit is accepted.
    Any,
    /// A number without unit, such as a ratio.
    Number,
    /// A quantity in its SI unit.
    Of(Dimension),
}

impl Quantity {
    /// The quantity that a description names: its SI unit is one of the parts between commas, such
    /// as `largest speed, m/s`; a ratio has its range there, such as `damping ratio, 0 to 1`.
    #[must_use]
    pub(crate) fn of_doc(doc: &str) -> Self {
        let parts = doc.split([',', ';', ':']).skip(1).map(str::trim);
        for part in parts {
            let last = part.rsplit(' ').next().unwrap_or(part);
            let range = part.contains(" to ").then_some(last);
            let unit = Unit::parse(part).or_else(|| range.and_then(Unit::parse));
            match unit {
                Some(unit) if unit.is_si() && unit.dimension != Dimension::NONE => {
                    return Self::Of(unit.dimension);
                }
                _ => {}
            }
            if part == "no unit" || range.is_some_and(|last| last.parse::<f64>().is_ok()) {
                return Self::Number;
            }
        }
        Self::Any
    }

    /// The quantity with that SI unit, such as `rad/s`; `1` is a plain number. `None` for any other text or unit.
    #[must_use]
    pub fn of_unit(unit: &str) -> Option<Self> {
        let unit = Unit::parse(unit).filter(Unit::is_si)?;
        if unit.dimension == Dimension::NONE {
            return Some(Self::Number);
        }
        Some(Self::Of(unit.dimension))
    }

    /// That of a component of a value with this quantity, whose type defines it.
    pub(super) fn part(self, dimension: Dimension) -> Self {
        match self {
            Self::Number => Self::Number,
            Self::Any | Self::Of(_) => Self::Of(dimension),
        }
    }

    /// A sentence part such as `an angle is expected, such as 30deg`.
    fn expected(self) -> String {
        match self {
            Self::Any => "known are rad, deg, m, mm, s, ms, kg, N, Nm, Hz and others".to_owned(),
            Self::Number => "a number without unit is expected".to_owned(),
            Self::Of(dimension) => match dimension.usual() {
                Some((name, example)) => format!("{name} is expected, such as `{example}`"),
                None => format!("a value in {dimension} is expected"),
            },
        }
    }
}

/// The SI unit, `1` for a plain number, `any`.
impl fmt::Display for Quantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Any => f.write_str("any"),
            Self::Number => f.write_str("1"),
            Self::Of(dimension) => dimension.fmt(f),
        }
    }
}

/// A unit: its dimension, and by what a value in it is multiplied and divided to be SI.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Unit {
    dimension: Dimension,
    times: f64,
    over: f64,
}

/// Upper bound on the factors of a unit.
const FACTORS_MAX: usize = 6;

impl Unit {
    fn is_si(&self) -> bool {
        let is_one = |factor: f64| factor.total_cmp(&1.0).is_eq();
        is_one(self.times) && is_one(self.over)
    }

    fn named(name: &str) -> Option<Self> {
        let (exponents, times, over) = match name {
            "rad" => ([0, 0, 0, 1], 1.0, 1.0),
            "mrad" => ([0, 0, 0, 1], 1.0, 1e3),
            "deg" | "°" => ([0, 0, 0, 1], PI, 180.0),
            "rev" => ([0, 0, 0, 1], 2.0 * PI, 1.0),
            "m" => ([1, 0, 0, 0], 1.0, 1.0),
            "km" => ([1, 0, 0, 0], 1e3, 1.0),
            "cm" => ([1, 0, 0, 0], 1.0, 1e2),
            "mm" => ([1, 0, 0, 0], 1.0, 1e3),
            "um" | "µm" => ([1, 0, 0, 0], 1.0, 1e6),
            "s" => ([0, 0, 1, 0], 1.0, 1.0),
            "ms" => ([0, 0, 1, 0], 1.0, 1e3),
            "us" | "µs" => ([0, 0, 1, 0], 1.0, 1e6),
            "ns" => ([0, 0, 1, 0], 1.0, 1e9),
            "min" => ([0, 0, 1, 0], 60.0, 1.0),
            "h" => ([0, 0, 1, 0], 3600.0, 1.0),
            "kg" => ([0, 1, 0, 0], 1.0, 1.0),
            "g" => ([0, 1, 0, 0], 1.0, 1e3),
            "N" => ([1, 1, -2, 0], 1.0, 1.0),
            "kN" => ([1, 1, -2, 0], 1e3, 1.0),
            "mN" => ([1, 1, -2, 0], 1.0, 1e3),
            "Nm" => ([2, 1, -2, 0], 1.0, 1.0),
            "mNm" => ([2, 1, -2, 0], 1.0, 1e3),
            "Hz" => ([0, 0, -1, 0], 1.0, 1.0),
            "kHz" => ([0, 0, -1, 0], 1e3, 1.0),
            "rpm" => ([0, 0, -1, 1], 2.0 * PI, 60.0),
            "1" => ([0, 0, 0, 0], 1.0, 1.0),
            _ => return None,
        };
        Some(Self {
            dimension: Dimension(exponents),
            times,
            over,
        })
    }

    /// Reads a unit such as `deg/s^2`; `None` if it is none.
    fn parse(text: &str) -> Option<Self> {
        let mut unit = Self {
            dimension: Dimension::NONE,
            times: 1.0,
            over: 1.0,
        };
        let mut rest = text.trim();
        let mut is_below = false;
        for _ in 0..FACTORS_MAX {
            let end = rest
                .find(|c: char| !c.is_alphabetic() && c != '°')
                .unwrap_or(rest.len());
            // `1` is a factor of its own, such as in `1/s`.
            let end = if end == 0 && rest.starts_with('1') {
                1
            } else {
                end
            };
            let factor = Self::named(rest.get(..end)?)?;
            let (power, after) = power(&rest[end..])?;
            unit = unit.with(factor, if is_below { -power } else { power });
            let after = after.trim_start();
            if after.is_empty() {
                return Some(unit);
            }
            is_below = after.starts_with('/');
            rest = after.strip_prefix(['/', '*', '·']).unwrap_or(after);
            rest = rest.trim_start();
        }
        None
    }

    fn with(self, factor: Self, power: i8) -> Self {
        let raised = |value: f64| value.powi(i32::from(power.abs()));
        let (times, over) = if power > 0 {
            (raised(factor.times), raised(factor.over))
        } else {
            (raised(factor.over), raised(factor.times))
        };
        let exponents = std::array::from_fn(|i| {
            self.dimension.0[i].saturating_add(factor.dimension.0[i].saturating_mul(power))
        });
        Self {
            dimension: Dimension(exponents),
            times: self.times * times,
            over: self.over * over,
        }
    }
}

/// The power after a unit's name, 1 to 3, and what follows it.
fn power(text: &str) -> Option<(i8, &str)> {
    let marked = text.strip_prefix('^');
    let mut after = marked.unwrap_or(text).chars();
    let power = match after.next() {
        Some('2' | '²') => 2,
        Some('3' | '³') => 3,
        Some('1') if marked.is_some() => 1,
        _ if marked.is_some() => return None,
        _ => return Some((1, text)),
    };
    Some((power, after.as_str()))
}

/// Splits a text such as `30 deg` after its number.
fn split(text: &str) -> (&str, &str) {
    let bytes = text.as_bytes();
    let digits = |from: usize| {
        let rest = bytes.get(from..).unwrap_or_default();
        let is_number = |b: &&u8| b.is_ascii_digit() || **b == b'.';
        from + rest.iter().take_while(is_number).count()
    };
    let sign = usize::from(text.starts_with(['+', '-']));
    let mut end = digits(sign);
    if bytes.get(end).is_some_and(|b| b"eE".contains(b)) {
        let sign = usize::from(bytes.get(end + 1).is_some_and(|b| b"+-".contains(b)));
        let exponent = digits(end + 1 + sign);
        if exponent > end + 1 + sign {
            end = exponent;
        }
    }
    let (number, unit) = text.split_at(end);
    (number, unit.trim())
}

/// Upper bound on the characters of a number with a unit, so that messages stay short.
const TEXT_MAX: usize = 40;

/// The SI value of a text with a unit. The error is a sentence about `text`; none if it is no number
/// at all.
pub(super) fn parse(text: &str, quantity: Quantity) -> Result<f64, Option<String>> {
    if text.chars().count() > TEXT_MAX {
        return Err(None);
    }
    let (number, name) = split(text);
    let value: f64 = number.parse().map_err(|_| None)?;
    if name.is_empty() {
        return Ok(value);
    }
    if !name.starts_with(|c: char| c.is_alphabetic() || "°1".contains(c)) {
        return Err(None);
    }
    let unit = Unit::parse(name);
    let expected = quantity.expected();
    match (quantity, unit) {
        (Quantity::Number, None) => Err(None),
        (_, None) => Err(Some(format!(
            "`{text}`: there is no unit `{name}`; {expected}"
        ))),
        (Quantity::Any, Some(unit)) => Ok(value * unit.times / unit.over),
        (Quantity::Of(dimension), Some(unit)) if unit.dimension == dimension => {
            Ok(value * unit.times / unit.over)
        }
        (Quantity::Number | Quantity::Of(_), Some(unit)) => {
            let found = match unit.dimension.usual() {
                Some((name, _)) => name.to_owned(),
                None => format!("a value in {}", unit.dimension),
            };
            Err(Some(format!("`{text}` is {found}, but {expected}")))
        }
    }
}

/// The quantity that the text of a number states by its unit.
pub(crate) fn stated(text: &str) -> Option<Quantity> {
    let (number, name) = split(text.trim());
    number.parse::<f64>().ok()?;
    Some(Quantity::Of(Unit::parse(name)?.dimension))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(text: &str) -> Result<f64, Option<String>> {
        parse(text, Quantity::Any)
    }

    #[test]
    fn quantity_of_si_unit_is_found() {
        assert_eq!(Quantity::of_unit("1"), Some(Quantity::Number));
        let speed = Dimension::ROTATION;
        assert_eq!(Quantity::of_unit("rad/s"), Some(Quantity::Of(speed)));
        for other in ["deg", "mm", "", "rad/", "fathom"] {
            assert_eq!(Quantity::of_unit(other), None, "{other}");
        }
    }

    #[test]
    fn unit_texts_are_converted_to_si() {
        for (text, expected) in [
            ("30deg", PI / 6.0),
            ("-180 deg", -PI),
            ("90°", PI / 2.0),
            ("250ms", 0.25),
            ("5mm", 0.005),
            ("7mm", 0.007),
            ("1.5e3 um", 0.0015),
            ("1e-3km", 1.0),
            ("60deg/s", PI / 3.0),
            ("360 deg / s^2", 2.0 * PI),
            ("360deg/s²", 2.0 * PI),
            ("2m/s3", 2.0),
            ("30rpm", PI),
            ("2kg m^2", 2.0),
            ("100mNm", 0.1),
            ("10/min", f64::NAN),
            ("1m*/s", f64::NAN),
            ("1m//s", f64::NAN),
            ("10 1/min", 10.0 / 60.0),
            ("2000 N/m", 2000.0),
        ] {
            match value(text) {
                Ok(found) => assert!((found - expected).abs() < 1e-15, "{text}: {found}"),
                Err(why) => assert!(expected.is_nan(), "{text}: {why:?}"),
            }
        }
        assert_eq!(value("7mm"), Ok(0.007));
        assert_eq!(value("300us"), Ok(0.0003));
    }

    #[test]
    fn unit_of_wrong_dimension_is_error_with_example() {
        let angle = Quantity::Of(Dimension::ANGLE);
        for (text, quantity, error) in [
            (
                "5mm",
                angle,
                "`5mm` is a length, but an angle is expected, such as `30deg`",
            ),
            (
                "5foo",
                angle,
                "`5foo`: there is no unit `foo`; an angle is expected, such as `30deg`",
            ),
            (
                "5mm",
                Quantity::Number,
                "`5mm` is a length, but a number without unit is expected",
            ),
            (
                "1e5e5deg",
                angle,
                "`1e5e5deg`: there is no unit `e5deg`; an angle is expected, such as `30deg`",
            ),
            (
                "5m^4",
                angle,
                "`5m^4`: there is no unit `m^4`; an angle is expected, such as `30deg`",
            ),
            (
                "5m s",
                angle,
                "`5m s` is a value in m s, but an angle is expected, such as `30deg`",
            ),
        ] {
            assert_eq!(parse(text, quantity), Err(Some(error.to_owned())));
        }
        assert_eq!(parse("5foo", Quantity::Number), Err(None));
        assert_eq!(parse("deg", angle), Err(None));
        assert!(
            value("5 m m m m m m m").is_err()
                && value("5deg/").is_err()
                && value("5m//s/").is_err()
        );
    }

    #[test]
    fn description_names_quantity() {
        for (doc, unit) in [
            ("angle about Z, rad", "rad"),
            ("largest jerk of the orientation, rad/s³", "rad/s³"),
            ("stiffness, Nm/rad, from 0", "Nm/rad"),
            ("time constant τ, s; the cut-off frequency is 1/(2πτ)", "s"),
            ("natural frequency, Hz", "1/s"),
            ("the angle, 0 to π rad", "rad"),
            ("damping ratio, 0 to 1", "1"),
            ("factor of i, no unit", "1"),
            ("moments of inertia, kg m²", "m² kg"),
            ("first operand", "any"),
            ("distance, of what the net says", "any"),
        ] {
            assert_eq!(Quantity::of_doc(doc).to_string(), unit, "{doc}");
        }
    }
}
