//! A position jumps while its device follows commands: scheduled nets are returned, and the sent values do not follow the
//! jump.

use super::*;
use takt_core::device::continuity::JumpPart;
use takt_core::executor::rules::{Failure, RuleState};

/// Expected results of a jump.
pub(crate) struct Jumps {
    /// Where it is detected.
    pub(crate) part: JumpPart,
    /// Approximate size.
    pub(crate) by: f64,
    /// Whether it is a fault of the device, which then stops following.
    pub(crate) is_fault: bool,
}

impl Jumps {
    /// While a net moves the device of `row` and another waits for its end, `jump` makes a position jump.
    pub(crate) fn check<P: Plant>(&self, row: &Row, plant: P, jump: impl FnOnce(&mut P)) {
        let mut bench = Bench::new(row, plant);
        let text = net(&row.children[0], 1, None);
        bench.fixture.try_start(1, &text, 1).unwrap();
        bench.fixture.start_after(Some(1), 2, &text, 1);
        bench.steps(row.runs + 200);
        assert_eq!(bench.state.jumped.count, 0, "{}", row.name);
        assert_eq!(bench.fixture.rules.get(&2), None, "{}", row.name);
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
        assert_eq!(
            bench.fixture.rules.get(&2),
            Some(&given_back),
            "{}",
            row.name
        );
        let runs = !bench.fixture.ended.contains_key(&1);
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
