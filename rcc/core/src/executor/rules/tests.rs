//! What rules keep for the nets they start, cycle by cycle, without threads. Rules as programs give them are in
//! `tests/rules.rs`.

use takt_net::Moment;

use super::*;
use crate::executor::Refusal;
use crate::executor::tests::{BRIEF, ENDLESS, holding};

const ARM: usize = 3;

/// A rule that starts a net once all of these have ended by themselves.
fn after(id: u32, followed: &[u32], start: u32) -> Box<Rule> {
    let asked = |net: &u32| Literal {
        net: *net,
        question: Question::Terminated,
        value: None,
        last: false,
    };
    let mut steps: Vec<_> = (0..followed.len()).map(Step::Literal).collect();
    steps.extend((1..followed.len()).map(|_| Step::And));
    let mut rule = Rule::new(id, followed.iter().map(asked).collect(), steps);
    rule.start = vec![start];
    Box::new(rule)
}

#[derive(Default)]
struct Bench(Executor);

impl Bench {
    fn start(&mut self, id: u32, text: &str) -> Result<(), Refusal> {
        let net = holding(id, text, &[ARM]);
        self.0.start(net).map_err(|(_, refusal)| refusal)
    }

    /// Schedules a net for when others have ended.
    fn after(&mut self, followed: &[u32], start: u32, text: &str) -> Result<(), RuleRefusal> {
        self.0.schedule(holding(start, text, &[ARM])).unwrap();
        let rule = self.0.add_rule(after(start, followed, start));
        rule.map_err(|(_, refusal)| refusal)
    }

    /// One cycle; gives the nets that run after it.
    fn run(&mut self) -> Vec<u32> {
        self.0.cycle(Moment::default());
        self.0.fire_rules();
        while self.0.take_ended(|_, _| Ok(())) {}
        while self.0.take_rule(|_| Ok(())) {}
        self.0.running().iter().map(|net| net.id).collect()
    }
}

#[test]
fn a_successor_that_waits_does_not_keep_its_predecessor_from_starting() {
    let mut bench = Bench::default();
    bench.after(&[1], 2, ENDLESS).unwrap();
    assert_eq!(bench.start(9, BRIEF), Err(Refusal::ResourceKept(ARM)));
    bench.start(1, BRIEF).unwrap();
    assert_eq!(bench.run(), [2]);
}

#[test]
fn a_chain_of_successors_is_taken_whether_its_first_runs_or_not() {
    for runs in [false, true] {
        let mut bench = Bench::default();
        if runs {
            bench.start(1, BRIEF).unwrap();
        }
        bench.after(&[1], 2, BRIEF).unwrap();
        bench.after(&[2], 3, ENDLESS).unwrap();
        if !runs {
            bench.start(1, BRIEF).unwrap();
        }
        assert_eq!(bench.run(), [2]);
        assert_eq!(bench.start(9, BRIEF), Err(Refusal::ResourceInUse(ARM)));
        assert_eq!(bench.run(), [3]);
    }
}

#[test]
fn what_a_successor_needs_stays_kept_after_its_predecessor() {
    let mut bench = Bench::default();
    bench.start(1, BRIEF).unwrap();
    bench.after(&[1, 7], 2, ENDLESS).unwrap();
    assert_eq!(bench.run(), []);
    assert_eq!(bench.start(9, BRIEF), Err(Refusal::ResourceKept(ARM)));
    assert_eq!(
        bench.after(&[8], 10, BRIEF),
        Err(RuleRefusal::ResourceInUse(ARM))
    );
}

#[test]
fn an_answer_that_comes_after_the_rule_is_heard() {
    let mut bench = Bench::default();
    bench.after(&[1], 2, ENDLESS).unwrap();
    assert_eq!(bench.run(), []);
    bench.0.answer_for_good(Literal {
        net: 1,
        question: Question::Terminated,
        value: Some(true),
        last: true,
    });
    assert_eq!(bench.run(), [2]);
}

#[test]
fn rules_that_are_too_much_for_a_cycle_are_refused() {
    let mut bench = Bench::default();
    let mut rule = after(0, &[1], 2);
    rule.stop = (10..10 + u32::try_from(WORK_MAX).unwrap() / 2).collect();
    bench.0.add_rule(rule).unwrap();
    let mut more = after(1, &[1], 2);
    more.stop = (10..10 + u32::try_from(WORK_MAX).unwrap() / 2).collect();
    let refused = bench.0.add_rule(more).unwrap_err();
    assert_eq!(refused.1, RuleRefusal::TooLong);
    bench.0.add_rule(after(2, &[1], 2)).unwrap();
}
