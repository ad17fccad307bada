//! Names and numbers of a net's values in messages.

use std::collections::BTreeSet;

use takt_net::Element;
use takt_net::netcomm::{Directory, Entry as Value};

/// What names of topics and fields may contain.
pub(super) fn identifier(name: &str) -> String {
    let mut found = String::with_capacity(name.len());
    for letter in name.chars() {
        let letter = letter.to_ascii_lowercase();
        if letter.is_ascii_alphanumeric() {
            found.push(letter);
        } else if !found.is_empty() && !found.ends_with('_') {
            found.push('_');
        }
    }
    let found = found.trim_end_matches('_');
    if found.starts_with(|first: char| first.is_ascii_alphabetic()) {
        found.to_owned()
    } else {
        format!("v_{found}").trim_end_matches('_').to_owned()
    }
}

/// Names of fields, each once.
#[derive(Debug)]
pub(super) struct UniqueNames(BTreeSet<String>);

impl Default for UniqueNames {
    fn default() -> Self {
        // The first field of every message.
        Self(["stamp".to_owned()].into())
    }
}

impl UniqueNames {
    /// The name of the next field.
    pub(super) fn next(&mut self, name: &str) -> String {
        let base = identifier(name);
        let mut names = std::iter::once(base.clone()).chain((2..).map(|n| format!("{base}_{n}")));
        let name = names.find(|name| self.0.insert(name.clone()));
        name.unwrap_or_default()
    }
}

/// The fields of a message with the shown values of a net, and their definition.
pub(super) fn fields(directory: &Directory) -> String {
    let (mut text, mut names) = (String::new(), UniqueNames::default());
    let mut add = |kind: &str, name: &str| text.push_str(&format!("{kind} {}\n", names.next(name)));
    for value in shown(directory) {
        let name = value.key.strip_prefix("out").unwrap_or(&value.key);
        if value.ty.array {
            add("float64[]", name);
        } else {
            for part in parts_of(value.ty.element) {
                add("float64", &format!("{name}_{part}"));
            }
        }
    }
    text
}

pub(super) fn shown(directory: &Directory) -> impl Iterator<Item = &Value> {
    directory
        .entries()
        .iter()
        .filter(|value| !value.is_hidden())
}

/// Names of the words of a value.
pub(super) const fn parts_of(element: Element) -> &'static [&'static str] {
    match element {
        Element::Bool | Element::Int | Element::Double | Element::Nanos => &[""],
        Element::Vector => &["x", "y", "z"],
        Element::Rotation => &["qw", "qx", "qy", "qz"],
        Element::Frame => &["x", "y", "z", "qw", "qx", "qy", "qz"],
        Element::Twist => &["x", "y", "z", "turn_x", "turn_y", "turn_z"],
        Element::Wrench => &["x", "y", "z", "torque_x", "torque_y", "torque_z"],
    }
}

/// A word of a value as a number; times in s.
#[expect(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    reason = "a number to look at; the words beside it are exact"
)]
pub(super) fn number(element: Element, word: u64) -> f64 {
    match element {
        Element::Bool => f64::from(u8::from(word != 0)),
        Element::Int => f64::from((word as u32).cast_signed()),
        Element::Nanos => word.cast_signed() as f64 * 1e-9,
        Element::Double
        | Element::Vector
        | Element::Rotation
        | Element::Frame
        | Element::Twist
        | Element::Wrench => f64::from_bits(word),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn identifiers_are_lower_case_letters_digits_underscores() {
        for (name, wanted) in [
            ("left", "left"),
            ("Left Arm-2", "left_arm_2"),
            ("2nd", "v_2nd"),
            ("__", "v"),
            ("", "v"),
            ("motion.time", "motion_time"),
        ] {
            assert_eq!(identifier(name), wanted, "{name}");
        }
    }
}
