//! A position that stands elsewhere all of a sudden while its device follows commands: what is scheduled is given back, and
//! what leaves for the wire does not follow the jump.

use super::*;
use crate::device::continuity::JumpPart;
use crate::executor::rules::{Failure, RuleState};

/// What is to come of a jump.
pub(in crate::device) struct Jumps {
    /// Where it is seen.
    pub(in crate::device) part: JumpPart,
    /// About by how much.
    pub(in crate::device) by: f64,
    /// Whether the device takes it for a fault and ceases to follow.
    pub(in crate::device) is_fault: bool,
}

impl Jumps {
    /// While a net moves the device of `row` and another waits for its end, `jump` makes a position jump.
    pub(in crate::device) fn check<P: Plant>(
        &self,
        row: &Row,
        plant: P,
        jump: impl FnOnce(&mut P),
    ) {
        let mut bench = Bench::new(row, plant);
        let text = net(&row.children[0], 1, None);
        bench.stand.try_start(1, &text, 1).unwrap();
        bench.stand.start_after(Some(1), 2, &text, 1);
        bench.steps(row.runs + 200);
        assert_eq!(bench.state.jumped.count, 0, "{}", row.name);
        assert_eq!(bench.stand.rules.get(&2), None, "{}", row.name);
        let begins = bench.sent.len();
        jump(&mut bench.plant);
        bench.steps(150);
        let jumped = bench.state.jumped;
        assert!(jumped.count > 0, "{}: not seen", row.name);
        assert_eq!(jumped.part, self.part, "{}", row.name);
        let (by, most) = (jumped.by, jumped.most);
        assert!(
            by > most && (by - self.by).abs() <= 0.2 * self.by,
            "{}: {jumped}",
            row.name
        );
        let given_back = (RuleState::FireFailed, Some(Failure::DeviceChanged(0)));
        assert_eq!(bench.stand.rules.get(&2), Some(&given_back), "{}", row.name);
        let runs = !bench.stand.ended.contains_key(&1);
        assert_eq!(runs, !self.is_fault, "{}", row.name);
        if runs {
            // As before, from one frame to the next.
            let usual = fastest(&bench.sent[begins - 150..begins], 1);
            let now = fastest(&bench.sent[begins - 1..], 1);
            let most = usual * 1.01 + row.resolution;
            assert!(now <= most, "{}: {now} after {usual}", row.name);
        }
    }
}
