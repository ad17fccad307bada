//! Output policies at the end of a net, as configured in the cell file. Drivers apply them to the values that nets
//! gave.

use std::fmt;

use serde::de::{Error, Unexpected, Visitor};
use serde::{Deserialize, Deserializer};
use takt_net::device::Given;

/// Policy of an output when the net that wrote it ends.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum OnEnd<T> {
    /// It keeps its value: `"hold"`.
    #[default]
    Hold,
    /// It takes this value.
    Take(T),
}

impl<T: Copy> OnEnd<T> {
    /// The value of an output, given the last value of a net; `None` before any.
    fn value(self, given: Option<Given<T>>) -> Option<T> {
        let given = given?;
        match self {
            Self::Take(value) if given.is_withdrawn() => Some(value),
            Self::Take(_) | Self::Hold => Some(given.value),
        }
    }
}

/// Policies of a device's outputs by port; outputs without an entry hold.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OutputsOnEnd {
    /// Of digital outputs.
    pub bool: Vec<OnEnd<bool>>,
    /// Of analogue outputs, in the unit that nets use.
    pub real: Vec<OnEnd<f64>>,
}

impl OutputsOnEnd {
    /// The value of a digital output.
    pub fn truth(&self, port: usize, given: Option<Given<bool>>) -> Option<bool> {
        self.bool
            .get(port)
            .copied()
            .unwrap_or_default()
            .value(given)
    }

    /// The value of an analogue output.
    pub fn number(&self, port: usize, given: Option<Given<f64>>) -> Option<f64> {
        self.real
            .get(port)
            .copied()
            .unwrap_or_default()
            .value(given)
    }

    /// Checks that there are no more policies than outputs.
    ///
    /// # Errors
    /// With a text that names the excess.
    pub fn check(&self, bools: usize, reals: usize) -> Result<(), String> {
        let lists = [
            ("bool", self.bool.len(), bools),
            ("real", self.real.len(), reals),
        ];
        match lists.into_iter().find(|(_, states, has)| states > has) {
            Some((kind, states, has)) => Err(format!(
                "`on_end.{kind}` states {states} outputs, there are {has}\n\
                 hint: give one of \"hold\" or a value for each output, in the order of their ports"
            )),
            None => Ok(()),
        }
    }
}

const HOLD: &str = "hold";

struct OfBool;

impl Visitor<'_> for OfBool {
    type Value = OnEnd<bool>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("\"hold\", true or false for an output of `on_end.bool`")
    }

    fn visit_bool<E: Error>(self, value: bool) -> Result<Self::Value, E> {
        Ok(OnEnd::Take(value))
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<Self::Value, E> {
        hold(text, &self)
    }
}

impl<'de> Deserialize<'de> for OnEnd<bool> {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        from.deserialize_any(OfBool)
    }
}

struct OfReal;

impl Visitor<'_> for OfReal {
    type Value = OnEnd<f64>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("\"hold\" or a finite number for an output of `on_end.real`")
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<Self::Value, E> {
        if value.is_finite() {
            return Ok(OnEnd::Take(value));
        }
        Err(E::invalid_value(Unexpected::Float(value), &self))
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<Self::Value, E> {
        let whole = i32::try_from(value);
        let whole = whole.map_err(|_| E::invalid_value(Unexpected::Signed(value), &self))?;
        Ok(OnEnd::Take(whole.into()))
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<Self::Value, E> {
        hold(text, &self)
    }
}

impl<'de> Deserialize<'de> for OnEnd<f64> {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        from.deserialize_any(OfReal)
    }
}

fn hold<'de, V: Visitor<'de>, T, E: Error>(text: &str, visitor: &V) -> Result<OnEnd<T>, E> {
    if text == HOLD {
        return Ok(OnEnd::Hold);
    }
    Err(E::invalid_value(Unexpected::Str(text), visitor))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Device {
        #[serde(rename = "on_end")]
        _on_end: OutputsOnEnd,
    }

    fn fault(on_end: &str) -> String {
        let text = format!("\n\n\n\n\non_end = {on_end}");
        toml::from_str::<Device>(&text).unwrap_err().to_string()
    }

    #[test]
    fn on_end_wrong_type_names_line_and_choices() {
        for (on_end, expected) in [
            ("{ bool = [1] }", "expected \"hold\", true or false"),
            ("{ bool = ['off'] }", "expected \"hold\", true or false"),
            ("{ real = [true] }", "expected \"hold\" or a finite number"),
            ("{ real = [nan] }", "expected \"hold\" or a finite number"),
            (
                "{ real = ['keep'] }",
                "expected \"hold\" or a finite number",
            ),
            ("{ truth = [true] }", "unknown field `truth`"),
        ] {
            let text = fault(on_end);
            assert!(text.contains(expected) && text.contains("line 6"), "{text}");
        }
    }

    #[test]
    fn on_end_beyond_outputs_is_refused_with_counts() {
        let policies = OutputsOnEnd {
            bool: vec![OnEnd::Hold; 9],
            real: Vec::new(),
        };
        let text = policies.check(8, 8).unwrap_err();
        assert!(
            text.starts_with("`on_end.bool` states 9 outputs, there are 8"),
            "{text}"
        );
        assert_eq!(policies.check(9, 0), Ok(()));
    }
}
