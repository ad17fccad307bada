//! What rules keep for the nets they start, cycle by cycle, without threads. Rules as programs give them are in
//! `tests/rules.rs`.

use takt_net::Moment;
use takt_rt::Nanos;

use super::*;
use crate::executor::tests::{BRIEF, ENDLESS, holding};
use crate::executor::{End, Executor, RUNNING_MAX, StartError};

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
    let orders = NetActions {
        start: vec![start],
        ..NetActions::default()
    };
    Box::new(Rule::new(
        id,
        followed.iter().map(asked).collect(),
        steps,
        orders,
    ))
}

#[derive(Default)]
struct Bench(Executor);

impl Bench {
    fn start(&mut self, id: u32, text: &str) -> Result<(), StartError> {
        let net = holding(id, text, &[ARM]);
        self.0.start(net).map_err(|(_, refusal)| refusal)
    }

    /// Schedules a net for when others have ended.
    fn after(&mut self, followed: &[u32], start: u32, text: &str) -> Result<(), RuleError> {
        self.0.schedule(holding(start, text, &[ARM])).unwrap();
        let rule = self.0.add_rule(after(start, followed, start));
        rule.map_err(|(_, refusal)| refusal)
    }

    /// One cycle; gives the nets that run after it.
    fn run(&mut self) -> Vec<u32> {
        self.0.cycle(Moment::default());
        self.0.fire_rules();
        while self.0.take_ended(|_, _| Ok(())) {}
        self.0.take_rules(|_| Ok(()));
        self.0.running().iter().map(|net| net.id).collect()
    }
}

#[test]
fn waiting_successor_does_not_block_predecessor() {
    let mut bench = Bench::default();
    bench.after(&[1], 2, ENDLESS).unwrap();
    assert_eq!(bench.start(9, BRIEF), Err(StartError::ResourceKept(ARM)));
    bench.start(1, BRIEF).unwrap();
    assert_eq!(bench.run(), [2]);
}

#[test]
fn successor_chain_is_accepted_running_or_not() {
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
        assert_eq!(bench.start(9, BRIEF), Err(StartError::ResourceInUse(ARM)));
        assert_eq!(bench.run(), [3]);
    }
}

#[test]
fn successor_resources_stay_reserved_after_predecessor() {
    let mut bench = Bench::default();
    bench.start(1, BRIEF).unwrap();
    bench.after(&[1, 7], 2, ENDLESS).unwrap();
    assert!(bench.run().is_empty());
    assert_eq!(bench.start(9, BRIEF), Err(StartError::ResourceKept(ARM)));
    assert_eq!(
        bench.after(&[8], 10, BRIEF),
        Err(RuleError::ResourceInUse(ARM))
    );
}

#[test]
fn late_final_answer_reaches_rule() {
    let mut bench = Bench::default();
    bench.after(&[1], 2, ENDLESS).unwrap();
    assert!(bench.run().is_empty());
    bench.0.set_final_answer(Literal {
        net: 1,
        question: Question::Terminated,
        value: Some(true),
        last: true,
    });
    assert_eq!(bench.run(), [2]);
}

#[test]
fn rules_exceeding_work_max_are_rejected() {
    let mut bench = Bench::default();
    let stopping = |id, first: u32, count: usize| {
        let orders = NetActions {
            stop: (first..).take(count).collect(),
            ..NetActions::default()
        };
        Box::new(Rule::new(id, vec![], vec![Step::Constant(false)], orders))
    };
    bench.0.add_rule(stopping(0, 10, WORK_MAX / 2)).unwrap();
    let refused = bench.0.add_rule(stopping(1, 10, WORK_MAX / 2)).unwrap_err();
    assert_eq!(refused.1, RuleError::TooLong);
    // As many nets as rules can name, all different.
    bench
        .0
        .add_rule(stopping(2, 9999, WORK_MAX / 2 - 2))
        .unwrap();
    assert!(bench.run().is_empty());
    assert_eq!(bench.0.rule_work(), 0);
    bench.0.add_rule(stopping(3, 10, WORK_MAX - 1)).unwrap();
}

/// A net that never ends and costs so many microseconds a cycle.
fn costing(id: u32, us: i64) -> Box<Running> {
    let mut net = holding(id, ENDLESS, &[]);
    net.cost = Nanos::from_micros(us);
    net
}

/// Runs nets that may cost 800 us a cycle together, of which net 1 costs 500.
fn loaded() -> Executor {
    let mut executor = Executor::within(Nanos::from_micros(800));
    executor.start(costing(1, 500)).unwrap();
    executor
}

/// A rule that starts net 2, which costs so much, once net 1 has ended.
fn successor(executor: &mut Executor, us: i64) -> Result<(), RuleError> {
    executor.schedule(costing(2, us)).unwrap();
    let added = executor.add_rule(after(0, &[1], 2));
    added.map_err(|(_, refusal)| refusal)
}

fn run(executor: &mut Executor) -> Vec<u32> {
    executor.cycle(Moment::default());
    executor.fire_rules();
    while executor.take_ended(|_, _| Ok(())) {}
    executor.running().iter().map(|net| net.id).collect()
}

#[test]
fn nets_exceeding_thread_budget_do_not_start() {
    let mut executor = loaded();
    let (running, budget) = (Nanos::from_micros(500), Nanos::from_micros(800));
    let (_, refusal) = executor.start(costing(3, 301)).unwrap_err();
    assert_eq!(refusal, StartError::Overload { running, budget });
    executor.start(costing(3, 300)).unwrap();
}

#[test]
fn successor_costs_nothing_beside_predecessor() {
    let mut executor = loaded();
    successor(&mut executor, 800).unwrap();
    // Nor does what ends in the cycle in which it starts.
    executor.end(1, End::Terminated);
    assert_eq!(run(&mut executor), [2]);
    assert_eq!(executor.load(), Nanos::from_micros(800));
}

#[test]
fn rule_exceeding_budget_fails_when_firing() {
    let mut executor = loaded();
    // The registry rejects it: it does not end net 1.
    executor.schedule(costing(2, 400)).unwrap();
    let asked = Literal {
        net: 1,
        question: Question::Terminated,
        value: None,
        last: false,
    };
    let orders = NetActions {
        start: vec![2],
        ..NetActions::default()
    };
    let steps = vec![Step::Literal(0), Step::Constant(true), Step::Or];
    let rule = Box::new(Rule::new(0, vec![asked], steps, orders));
    executor.add_rule(rule).unwrap();
    assert_eq!(run(&mut executor), [1]);
    let mut states = Vec::new();
    executor.take_rules(|rule| {
        states.push(rule.state);
        Ok(())
    });
    assert_eq!(states, [RuleState::FireFailed]);
}

#[test]
fn rule_with_missing_net_is_rejected() {
    let mut executor = Executor::default();
    let refused = executor.add_rule(after(0, &[1], 2)).unwrap_err();
    assert_eq!(refused.1, RuleError::NotWaiting(2));
}

#[test]
fn maximum_of_nets_hand_over_at_once() {
    let mut executor = Executor::default();
    let most = u32::try_from(RUNNING_MAX).unwrap();
    for id in 0..most {
        executor.start(holding(id, BRIEF, &[])).unwrap();
        executor.schedule(holding(most + id, ENDLESS, &[])).unwrap();
        executor.add_rule(after(id, &[id], most + id)).unwrap();
    }
    assert_eq!(run(&mut executor).len(), RUNNING_MAX);
    assert_eq!(executor.running()[0].id, most);
}

#[test]
fn unaccepted_rules_are_offered_again() {
    let mut bench = Bench::default();
    bench.start(1, BRIEF).unwrap();
    for id in 0..3 {
        let steps = vec![Step::Constant(true)];
        let rule = Rule::new(id, vec![], steps, NetActions::default());
        bench.0.add_rule(Box::new(rule)).unwrap();
    }
    bench.0.fire_rules();
    let mut taken = Vec::new();
    let mut offer = |executor: &mut Executor, room: usize| {
        executor.take_rules(|rule| {
            if taken.len() == room {
                return Err(rule);
            }
            taken.push(rule.id);
            Ok(())
        });
        executor.rules.waiting.len()
    };
    assert_eq!(offer(&mut bench.0, 1), 2);
    assert_eq!(offer(&mut bench.0, 2), 1);
    assert_eq!(offer(&mut bench.0, 3), 0);
    assert_eq!((bench.0.rule_work(), bench.0.rules.over), (0, 0));
}
