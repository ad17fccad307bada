//! Faults of a program as the report of its net: packed into a word by the real-time thread, formatted where the net ends.

use crate::code::Location;
use crate::machine::{Fault, FaultKind};

/// Bits of line and column; larger ones are shown as the largest.
const BITS: u32 = 24;
const MASK: u64 = (1 << BITS) - 1;

/// Cause, line and column in a word that is not 0.
pub(super) fn code_of_failure(fault: Fault) -> u64 {
    let Location { line, column } = fault.at;
    let clip = |value: u32| u64::from(value).min(MASK);
    (fault.kind as u64) << (2 * BITS) | clip(line) << BITS | clip(column)
}

/// The text of such words for a program of that name.
pub(super) fn text_of_failure(name: String) -> impl Fn(u64) -> String + Send + Sync {
    move |code| {
        let (line, column) = (code >> BITS & MASK, code & MASK);
        let number = usize::try_from(code >> (2 * BITS)).unwrap_or(0);
        let kind = number.checked_sub(1).and_then(|i| FaultKind::ALL.get(i));
        let kind = kind.copied().unwrap_or(FaultKind::BadCode);
        format!(
            "program {name} failed at {line}:{column}: {kind}\nhint: {}",
            kind.hint()
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn failures_survive_their_packing() {
        for (number, kind) in (1..).zip(FaultKind::ALL) {
            assert_eq!(kind as i32, number);
            let at = Location {
                line: 12,
                column: u32::MAX,
            };
            let text = text_of_failure("p".to_owned())(code_of_failure(Fault { kind, at }));
            let wanted = format!(
                "program p failed at 12:16777215: {kind}\nhint: {}",
                kind.hint()
            );
            assert_eq!(text, wanted);
        }
    }
}
