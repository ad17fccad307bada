//! Which PDOs of a device to assign: those that its axes need, then those of its default, as far as they do not exclude each
//! other. Vendors mark sets that replace one another by Exclude on one side or on both.

use super::Pdo;

/// PDOs to assign, in the order of the file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(in crate::ecat) struct Choice {
    /// Their indices.
    pub(in crate::ecat) pdos: Vec<u16>,
    /// PDOs of the default that another one excludes, and that one.
    pub(in crate::ecat) excluded: Vec<(u16, u16)>,
    /// Needed entries, index and sub-index, that no PDO carries or only excluded ones do.
    pub(in crate::ecat) lacking: Vec<(u16, u8)>,
}

fn are_exclusive(one: &Pdo, other: &Pdo) -> bool {
    one.excludes.contains(&other.index) || other.excludes.contains(&one.index)
}

/// Chooses among the PDOs of one direction: mandatory ones, those with the needed entries, and those that `is_default`
/// names.
pub(in crate::ecat) fn choose(
    all: &[Pdo],
    needed: &[(u16, u8)],
    is_default: impl Fn(&Pdo) -> bool,
) -> Choice {
    let mut chosen: Vec<&Pdo> = all.iter().filter(|it| it.is_mandatory).collect();
    let mut choice = Choice::default();
    let blocker = |chosen: &[&Pdo], pdo: &Pdo| {
        let found = chosen.iter().find(|it| are_exclusive(it, pdo));
        found.map(|it| it.index)
    };
    let carries = |pdo: &Pdo, address: &(u16, u8)| {
        let mut entries = pdo.entries.iter();
        entries.any(|it| (it.0, it.1) == *address)
    };
    let mut open = needed.to_vec();
    loop {
        open.retain(|address| !chosen.iter().any(|pdo| carries(pdo, address)));
        let possible = all.iter().rev();
        let possible = possible.filter(|it| blocker(&chosen, it).is_none());
        let found = possible.map(|pdo| (open.iter().filter(|it| carries(pdo, it)).count(), pdo));
        // The one that carries most; of equal ones that of the default, then the first one of the file.
        let best = found.max_by_key(|(count, pdo)| (*count, is_default(pdo)));
        match best.filter(|(count, _)| *count > 0) {
            Some((_, pdo)) => chosen.push(pdo),
            None => break,
        }
    }
    choice.lacking = open;
    for pdo in all.iter().filter(|it| is_default(it)) {
        if chosen.iter().any(|it| it.index == pdo.index) {
            continue;
        }
        match blocker(&chosen, pdo) {
            Some(by) => choice.excluded.push((pdo.index, by)),
            None => chosen.push(pdo),
        }
    }
    let in_order = all.iter().map(|it| it.index);
    choice.pdos = in_order
        .filter(|index| chosen.iter().any(|it| it.index == *index))
        .collect();
    choice.pdos.dedup();
    choice
}
