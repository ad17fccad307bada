//! Sets of processors as the kernel writes them: lists such as `0-3,6` and masks such as `00000000,0000004f`.
//!
//! It knows nothing of the machine; which of the processors exist is for the caller to ask.

use std::collections::BTreeSet;
use std::fmt;

/// More than any kernel is built for. Numbers beyond are refused, since a range up to them would fill
/// the memory.
const CPUS_MAX: u32 = 8192;

/// A set of processors, counted from 0. Displays as a list.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Cpus(BTreeSet<u32>);

impl Cpus {
    /// Reads a list. `(null)` and nothing are the empty set; a range may have a stride, as in `0-8:1/2`.
    pub(super) fn from_list(text: &str) -> Option<Self> {
        let text = text.trim();
        let mut cpus = BTreeSet::new();
        if matches!(text, "" | "(null)") {
            return Some(Self(cpus));
        }
        for part in text.split(',') {
            cpus.extend(range(part.trim())?);
        }
        Some(Self(cpus))
    }

    /// Reads a mask in hexadecimal, groups of 32 bits separated by commas, the highest first.
    pub(super) fn from_mask(text: &str) -> Option<Self> {
        let mut cpus = BTreeSet::new();
        for (group, digits) in text.trim().split(',').rev().enumerate() {
            let bits = u32::from_str_radix(digits, 16).ok()?;
            let first = u32::try_from(group).ok()?.checked_mul(32)?;
            if first >= CPUS_MAX {
                return None;
            }
            cpus.extend(
                (0..32)
                    .filter(|bit| bits & (1 << bit) != 0)
                    .map(|bit| first + bit),
            );
        }
        Some(Self(cpus))
    }

    /// The mask of this set, as `from_mask` reads it.
    pub(super) fn mask(&self) -> String {
        let groups = self.0.last().map_or(1, |last| last / 32 + 1);
        let bits = |group: u32| {
            let within = self.0.iter().filter(|&&cpu| cpu / 32 == group);
            within.fold(0_u32, |bits, cpu| bits | 1 << (cpu % 32))
        };
        let texts: Vec<String> = (0..groups)
            .rev()
            .map(|group| match group + 1 == groups {
                true => format!("{:x}", bits(group)),
                false => format!("{:08x}", bits(group)),
            })
            .collect();
        texts.join(",")
    }

    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    pub(super) fn len(&self) -> usize {
        self.0.len()
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = u32> {
        self.0.iter().copied()
    }

    pub(super) fn contains(&self, cpu: u32) -> bool {
        self.0.contains(&cpu)
    }

    pub(super) fn contains_all(&self, other: &Self) -> bool {
        other.0.is_subset(&self.0)
    }

    pub(super) fn overlaps(&self, other: &Self) -> bool {
        !self.0.is_disjoint(&other.0)
    }

    pub(super) fn without(&self, other: &Self) -> Self {
        Self(self.0.difference(&other.0).copied().collect())
    }

    pub(super) fn and(&self, other: &Self) -> Self {
        Self(self.0.intersection(&other.0).copied().collect())
    }
}

impl FromIterator<u32> for Cpus {
    fn from_iter<I: IntoIterator<Item = u32>>(cpus: I) -> Self {
        Self(cpus.into_iter().collect())
    }
}

/// `5`, `0-3`, or `0-8:1/2`: of each group of 2 the first 1.
fn range(text: &str) -> Option<Vec<u32>> {
    let (span, stride) = match text.split_once(':') {
        Some((span, stride)) => (span, Some(stride.split_once('/')?)),
        None => (text, None),
    };
    let (first, last) = span.split_once('-').unwrap_or((span, span));
    let (first, last) = (first.parse::<u32>().ok()?, last.parse::<u32>().ok()?);
    if first > last || last >= CPUS_MAX {
        return None;
    }
    let Some((used, group)) = stride else {
        return Some((first..=last).collect());
    };
    let (used, group) = (used.parse::<u32>().ok()?, group.parse::<u32>().ok()?);
    if group == 0 || used > group {
        return None;
    }
    Some(
        (first..=last)
            .filter(|cpu| (cpu - first) % group < used)
            .collect(),
    )
}

impl fmt::Display for Cpus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut rest = self.0.iter().copied().peekable();
        let mut comma = "";
        while let Some(first) = rest.next() {
            let mut last = first;
            while let Some(next) = rest.next_if_eq(&(last + 1)) {
                last = next;
            }
            match last - first {
                0 => write!(f, "{comma}{first}")?,
                _ => write!(f, "{comma}{first}-{last}")?,
            }
            comma = ",";
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn list(text: &str) -> Cpus {
        Cpus::from_list(text).unwrap()
    }

    #[test]
    fn lists_are_read_as_the_kernel_means_them() {
        assert_eq!(list("0-3,6").iter().collect::<Vec<_>>(), [0, 1, 2, 3, 6]);
        assert_eq!(list("0-8:1/2"), list("0,2,4,6,8"));
        assert_eq!(list("0-7:2/4"), list("0-1,4-5"));
        assert!(list("(null)\n").is_empty() && list("\n").is_empty());
        for wrong in [
            "x",
            "3-1",
            "-",
            "1,",
            "0-4294967295",
            "0-8:1",
            "0-8:1/0",
            "0-8:3/2",
        ] {
            assert_eq!(Cpus::from_list(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn masks_have_the_highest_group_first() {
        assert_eq!(Cpus::from_mask("3").unwrap(), list("0-1"));
        assert_eq!(
            Cpus::from_mask("00000001,80000000\n").unwrap(),
            list("31-32")
        );
        assert_eq!(Cpus::from_mask("x"), None);
        assert_eq!(list("").mask(), "0");
        assert_eq!(list("0,33").mask(), "2,00000001");
    }

    proptest! {
        #[test]
        fn what_is_displayed_reads_the_same(cpus in prop::collection::btree_set(0..CPUS_MAX, 0..40)) {
            let cpus = Cpus(cpus);
            prop_assert_eq!(Cpus::from_list(&cpus.to_string()), Some(cpus.clone()));
            prop_assert_eq!(Cpus::from_mask(&cpus.mask()), Some(cpus));
        }

        #[test]
        fn any_text_is_read_or_refused(text in "[0-9,:/()x -]{0,24}|\\PC{0,24}") {
            let _ = Cpus::from_list(&text);
            let _ = Cpus::from_mask(&text);
        }
    }
}
