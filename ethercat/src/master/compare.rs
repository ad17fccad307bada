//! Compares configured and detected slaves. The reaction to a difference is not decided here.

use std::fmt;

use super::unit::SlaveInfo;
use crate::config::{Location, SlaveSpec};
use crate::sii::Identity;

/// A difference between the configuration and the segment.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Difference {
    /// A configured slave is missing.
    Missing {
        /// Its name in the cell.
        name: String,
        /// Its configured location.
        location: Location,
    },
    /// A slave that is not configured.
    Unexpected {
        /// Position in the ring, from 0.
        position: usize,
        /// Name in its SII.
        name: String,
        /// Its identity.
        identity: Identity,
    },
    /// Another slave than configured.
    Other {
        /// Its name in the cell.
        name: String,
        /// Position in the ring, from 0.
        position: usize,
        /// The field that differs: "vendor", "product" or "revision".
        field: &'static str,
        /// As configured.
        expected: u32,
        /// As found.
        found: u32,
        /// Name in its SII.
        found_name: String,
    },
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Missing { name, location } => {
                write!(
                    f,
                    "\"{name}\" is missing at {location}; see its supply, cable and order in the line"
                )
            }
            Self::Unexpected {
                position,
                name,
                identity,
            } => write!(
                f,
                "position {position}: \"{name}\" ({identity}) is not in the configuration; add it or take it out"
            ),
            Self::Other {
                name,
                position,
                field,
                expected,
                found,
                found_name,
            } => write!(
                f,
                "position {position}: \"{name}\" should have {field} {expected:08X}h, \"{found_name}\" with \
                 {found:08X}h is there; exchanged slaves, or another order in the line?"
            ),
        }
    }
}

/// Position of the matching slave for each configured one.
pub(super) type Matched = Vec<Option<usize>>;

/// Matches each configured slave with a detected one, in the order of the ring.
pub(super) fn compare(specs: &[SlaveSpec], found: &[&SlaveInfo]) -> (Matched, Vec<Difference>) {
    let mut matched: Matched = vec![None; specs.len()];
    let mut taken = vec![false; found.len()];
    // First match slaves by alias or name; the rest is counted by position.
    for optional in [true, false] {
        for (spec, slot) in specs
            .iter()
            .zip(&mut matched)
            .filter(|(spec, _)| spec.optional == optional)
        {
            let free = |position: &usize| taken.get(*position) == Some(&false);
            let is_it =
                |position: &usize| found.get(*position).is_some_and(|info| is_at(spec, info));
            *slot = (0..found.len()).filter(free).find(is_it);
            if let Some(flag) = slot.and_then(|position| taken.get_mut(position)) {
                *flag = true;
            }
        }
    }
    let optional: Vec<usize> = specs
        .iter()
        .zip(&matched)
        .filter(|(s, _)| s.optional)
        .filter_map(|(_, m)| *m)
        .collect();
    let counted: Vec<usize> = (0..found.len())
        .filter(|position| !optional.contains(position))
        .collect();
    for (spec, slot) in specs.iter().zip(&mut matched) {
        let Location::Position(number) = spec.location else {
            continue;
        };
        *slot = counted
            .get(usize::from(number))
            .copied()
            .filter(|position| taken.get(*position) == Some(&false));
        if let Some(flag) = slot.and_then(|position| taken.get_mut(position)) {
            *flag = true;
        }
    }
    let differences = differences(specs, found, &matched, &taken);
    (matched, differences)
}

/// Whether a slave matches a location; positions are counted, not matched.
fn is_at(spec: &SlaveSpec, info: &SlaveInfo) -> bool {
    match &spec.location {
        Location::Position(_) => false,
        Location::Alias(alias) => info.alias == *alias,
        Location::Name(name) => info.name == *name || info.order == *name,
    }
}

/// Whether a returning slave matches a configured one.
pub(super) fn is_expected(spec: &SlaveSpec, info: &SlaveInfo) -> bool {
    is_at(spec, info) && other(spec, 0, info).is_none()
}

fn differences(
    specs: &[SlaveSpec],
    found: &[&SlaveInfo],
    matched: &Matched,
    taken: &[bool],
) -> Vec<Difference> {
    let mut all = Vec::new();
    for (spec, slot) in specs.iter().zip(matched) {
        match slot.and_then(|position| Some((position, found.get(position)?))) {
            None if spec.optional => {}
            None => all.push(Difference::Missing {
                name: spec.name.clone(),
                location: spec.location.clone(),
            }),
            Some((position, info)) => all.extend(other(spec, position, info)),
        }
    }
    let strangers = found
        .iter()
        .enumerate()
        .filter(|(position, _)| taken.get(*position) == Some(&false));
    all.extend(strangers.map(|(position, info)| Difference::Unexpected {
        position,
        name: info.name.clone(),
        identity: info.identity,
    }));
    all
}

/// The first of vendor, product and revision that differs.
fn other(spec: &SlaveSpec, position: usize, info: &SlaveInfo) -> Option<Difference> {
    let fields = [
        ("vendor", spec.vendor, info.identity.vendor),
        ("product", spec.product, info.identity.product),
        ("revision", spec.revision, info.identity.revision),
    ];
    let differs =
        |(_, expected, found): &(_, Option<u32>, u32)| expected.is_some_and(|e| e != *found);
    let (field, expected, found) = fields.into_iter().find(differs)?;
    Some(Difference::Other {
        name: spec.name.clone(),
        position,
        field,
        expected: expected.unwrap_or_default(),
        found,
        found_name: info.name.clone(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn info(product: u32, alias: u16, name: &str) -> SlaveInfo {
        let identity = Identity {
            vendor: 1,
            product,
            ..Identity::default()
        };
        SlaveInfo {
            identity,
            alias,
            name: name.to_owned(),
            ..SlaveInfo::default()
        }
    }

    fn texts_of(specs: &[SlaveSpec], found: &[SlaveInfo]) -> (Matched, Vec<String>) {
        let found: Vec<_> = found.iter().collect();
        let (matched, differences) = compare(specs, &found);
        (
            matched,
            differences.iter().map(ToString::to_string).collect(),
        )
    }

    #[test]
    fn positions_are_counted_without_optional_slaves() {
        let specs = [
            SlaveSpec::new("coupler", Location::Position(0)),
            SlaveSpec {
                optional: true,
                ..SlaveSpec::new("tool", Location::Alias(7))
            },
            SlaveSpec::new("axis", Location::Position(1)),
            SlaveSpec::new("gripper", Location::Name("GR1".to_owned())),
        ];
        let with_tool = [
            info(1, 0, "a"),
            info(2, 7, "b"),
            info(3, 0, "c"),
            info(4, 0, "GR1"),
        ];
        assert_eq!(
            texts_of(&specs, &with_tool),
            (vec![Some(0), Some(1), Some(2), Some(3)], vec![])
        );
        let without = [info(1, 0, "a"), info(3, 0, "c"), info(4, 0, "GR1")];
        assert_eq!(
            texts_of(&specs, &without),
            (vec![Some(0), None, Some(1), Some(2)], vec![])
        );
    }

    #[test]
    fn differences_are_listed_slave_by_slave() {
        let specs = [
            SlaveSpec {
                product: Some(1),
                ..SlaveSpec::new("coupler", Location::Position(0))
            },
            SlaveSpec {
                product: Some(2),
                revision: Some(0),
                ..SlaveSpec::new("axis 1", Location::Position(1))
            },
            SlaveSpec::new("axis 2", Location::Alias(9)),
        ];
        let found = [info(1, 0, "TK1100"), info(5, 0, "TK5"), info(6, 0, "TK6")];
        let (_, texts) = texts_of(&specs, &found);
        assert_eq!(texts.len(), 3);
        assert!(texts[0].starts_with(
            "position 1: \"axis 1\" should have product 00000002h, \"TK5\" with 00000005h is there"
        ));
        assert!(
            texts[1].starts_with("\"axis 2\" is missing at alias 9"),
            "{}",
            texts[1]
        );
        assert!(
            texts[2].starts_with("position 2: \"TK6\" (vendor 00000001h product 00000006h"),
            "{}",
            texts[2]
        );
    }
}
