//! Rules over two executors, cycle by cycle and without threads: what is decided where, when it takes
//! effect, and that it takes effect everywhere or nowhere.

use std::sync::Arc;

use takt_net::Moment;

use super::*;
use crate::device::DeviceStatus;
use crate::executor::rules::{NetActions, Question, Rule, RuleError, RuleState, Step};
use crate::executor::tests::net;
use crate::executor::{DeviceView, Effect, End, Executor, Running};

/// Never ends by itself.
const ENDLESS: &str = "{never=Core::BooleanValue(),outTerminate=never.outValue}";
/// Ends in its first cycle.
const BRIEF: &str = "{yes=Core::BooleanValue(Value='true'),outTerminate=yes.outValue}";

/// One executor with what its thread does around it.
#[derive(Default)]
struct Thread {
    executor: Executor,
    cycle: u64,
}

impl Thread {
    fn start(&mut self, net: Box<Running>) {
        self.executor.start(net).unwrap();
    }

    /// Runs a cycle; returns what happened to nets and rules in it, and which nets run after it.
    fn run(&mut self) -> (Vec<String>, Vec<u32>) {
        self.cycle += 1;
        let mut reported = Vec::new();
        let mut effects = |executor: &mut Executor| {
            executor.effects(|id, effect| {
                if effect != Effect::Stopped {
                    reported.push(format!("{id} {effect:?}"));
                }
            });
        };
        let moment = Moment {
            cycle: self.cycle,
            ..Moment::default()
        };
        if self.executor.fire_decided(moment, takt_rt::Nanos::ZERO) {
            effects(&mut self.executor);
        }
        self.executor.cycle(moment);
        self.executor.fire_rules();
        effects(&mut self.executor);
        while self.executor.take_ended(|net, end| {
            reported.push(format!("{} {end:?}", net.id));
            Ok(())
        }) {}
        self.executor.take_rules(|rule| {
            reported.push(format!("rule {:?}", rule.state));
            Ok(())
        });
        let running = self.executor.running().iter().map(|net| net.id);
        (reported, running.collect())
    }
}

fn terminated(net: u32) -> Literal {
    Literal {
        net,
        question: Question::Terminated,
        value: None,
        last: false,
    }
}

/// The parts of a rule: when net 0 of the first thread and, if `both`, net 10 of the second have ended,
/// net 11 of the second is stopped, and nets 1 and 12 start, one in each thread.
fn parts(both: bool) -> [Box<Rule>; 2] {
    parts_that_start(both, &[1])
}

/// The same, of which the first starts these nets.
fn parts_that_start(both: bool, starts: &[u32]) -> [Box<Rule>; 2] {
    let mut owned = vec![(terminated(0), Some(0))];
    let mut steps = vec![Step::Literal(0)];
    if both {
        owned.push((terminated(10), Some(1)));
        steps.extend([Step::Literal(1), Step::And]);
    }
    let shared = Arc::new(Shared::new(&owned, 2, 0, true));
    let literals: Vec<_> = owned.iter().map(|(literal, _)| *literal).collect();
    [0, 1].map(|number| {
        let (stop, start) = match number {
            0 => (vec![], starts.to_vec()),
            _ => (vec![11], vec![12]),
        };
        let orders = NetActions {
            stop,
            start,
            ..NetActions::default()
        };
        let mut rule = Rule::new(5, literals.clone(), steps.clone(), orders);
        rule.part = Some(Part::new(Arc::clone(&shared), number));
        Box::new(rule)
    })
}

/// Both threads with the nets of [`parts`], of which none runs but 11.
fn threads() -> [Thread; 2] {
    let mut threads = [Thread::default(), Thread::default()];
    threads[0].executor.schedule(net(1, ENDLESS)).unwrap();
    threads[1].executor.schedule(net(12, ENDLESS)).unwrap();
    threads[1].start(net(11, ENDLESS));
    threads
}

fn add(threads: &mut [Thread; 2], both: bool) {
    for (thread, part) in threads.iter_mut().zip(parts(both)) {
        thread.executor.add_rule(part).unwrap();
    }
}

fn texts(texts: &[&str]) -> Vec<String> {
    texts.iter().map(|text| (*text).to_owned()).collect()
}

#[test]
fn shared_rule_fires_at_next_cycle_boundary() {
    let mut threads = threads();
    add(&mut threads, false);
    let [first, second] = &mut threads;
    assert_eq!(second.run(), (vec![], vec![11]));
    first.start(net(0, BRIEF));
    // Within the thread that decides, the successor follows without a gap.
    let fired = texts(&["1 Started", "0 Terminated", "rule Fired"]);
    assert_eq!(first.run(), (fired, vec![1]));
    // The other does it before its next cycle, in which the successor is evaluated already.
    let follower = Arc::clone(second.executor.rules.scheduled[0].counters());
    let fired = texts(&["12 Started", "11 Stopped", "rule Fired"]);
    assert_eq!(second.run(), (fired, vec![12]));
    assert_eq!(follower.read().cycles, 1);
}

#[test]
fn shared_rule_uses_literals_of_all_threads() {
    let mut threads = threads();
    threads[1].start(net(10, ENDLESS));
    add(&mut threads, true);
    let [first, second] = &mut threads;
    first.start(net(0, BRIEF));
    assert_eq!(first.run().0, ["0 Terminated"]);
    second.run();
    assert_eq!(first.run().0, Vec::<String>::new());
    second.executor.end(10, End::Terminated);
    assert_eq!(second.run().0, ["10 Terminated"], "it does not decide");
    assert_eq!(first.run().0, ["1 Started", "rule Fired"]);
    assert_eq!(second.run().0, ["12 Started", "11 Stopped", "rule Fired"]);
}

#[test]
fn shared_rule_waits_for_all_threads() {
    let mut threads = threads();
    let [mine, other] = parts(false);
    let [first, second] = &mut threads;
    first.executor.add_rule(mine).unwrap();
    first.start(net(0, BRIEF));
    assert_eq!(first.run().0, ["0 Terminated"]);
    assert_eq!(first.run(), (vec![], vec![]));
    second.executor.add_rule(other).unwrap();
    assert_eq!(second.run().0, Vec::<String>::new());
    assert_eq!(first.run(), (texts(&["1 Started", "rule Fired"]), vec![1]));
}

#[test]
fn shared_rule_starts_all_or_none() {
    let mut threads = threads();
    // A device that is not ready.
    threads[1].executor.rules.scheduled[0].devices.push((0, 0));
    add(&mut threads, false);
    let [first, second] = &mut threads;
    second.run();
    first.start(net(0, BRIEF));
    let failed = texts(&["0 Terminated", "rule FireFailed"]);
    assert_eq!(first.run(), (failed, vec![]));
    assert_eq!(second.run(), (texts(&["rule FireFailed"]), vec![11]));
}

#[test]
fn shared_rule_ends_if_condition_impossible() {
    let mut threads = threads();
    add(&mut threads, false);
    let [first, second] = &mut threads;
    second.run();
    first.start(net(0, ENDLESS));
    first.executor.abort(0);
    assert_eq!(first.run().0, ["0 Aborted", "rule Inactive"]);
    assert_eq!(second.run(), (texts(&["rule Inactive"]), vec![11]));
}

#[test]
fn shared_rule_ends_if_net_withdrawn() {
    let mut threads = threads();
    add(&mut threads, false);
    let [first, second] = &mut threads;
    second.run();
    assert!(second.executor.take_unscheduled(12, true).is_some());
    first.start(net(0, BRIEF));
    assert_eq!(
        first.run(),
        (texts(&["0 Terminated", "rule Inactive"]), vec![])
    );
    assert_eq!(second.run(), (texts(&["rule Inactive"]), vec![11]));
}

#[test]
fn shared_rule_ends_if_part_rejected() {
    let mut threads = threads();
    let [mine, other] = parts(false);
    let [first, second] = &mut threads;
    first.executor.add_rule(mine).unwrap();
    // Net 13, of which the rule knows nothing, holds what net 12 needs.
    let mut holder = net(13, ENDLESS);
    holder.resources.insert(3);
    second.start(holder);
    second.executor.rules.scheduled[0].resources.insert(3);
    let (_, refusal) = second.executor.add_rule(other).unwrap_err();
    assert_eq!(refusal, RuleError::ResourceInUse(3));
    assert_eq!(first.run().0, ["rule Inactive"]);
}

#[test]
fn takeover_is_announced_across_threads() {
    let mut threads = threads();
    let [mine, other] = parts_that_start(false, &[]);
    let [first, second] = &mut threads;
    first.start(net(0, ENDLESS));
    first.executor.add_rule(mine).unwrap();
    second.executor.add_rule(other).unwrap();
    let mut reported = Vec::new();
    first
        .executor
        .announce_takeovers(|id, waits| reported.push((id, waits)));
    second
        .executor
        .announce_takeovers(|id, waits| reported.push((id, waits)));
    assert_eq!(reported, [(0, true), (11, true)]);
}

#[test]
fn shared_rule_never_mixes_two_cycles() {
    let owned = [(terminated(0), Some(1)), (terminated(1), Some(1))];
    let shared = Arc::new(Shared::new(&owned, 2, 0, false));
    let [decider, other] = [0, 1].map(|number| Part::new(Arc::clone(&shared), number));
    let stop = Arc::new(std::sync::atomic::AtomicBool::new(false));
    let stopping = Arc::clone(&stop);
    // Says both true, both false, and so on.
    let writer = std::thread::spawn(move || {
        let mut literals = owned.map(|(literal, _)| literal);
        while !stopping.load(Ordering::Relaxed) {
            for literal in &mut literals {
                literal.value = Some(literal.value != Some(true));
            }
            other.exchange(&mut literals, true);
        }
    });
    let mut literals = owned.map(|(literal, _)| literal);
    let mut changes = 0;
    for _ in 0..2_000_000 {
        let before = literals[0].value;
        decider.exchange(&mut literals, true);
        assert_eq!(literals[0].value, literals[1].value);
        changes += u32::from(literals[0].value != before);
        if changes > 1000 {
            break;
        }
    }
    stop.store(true, Ordering::Relaxed);
    writer.join().unwrap();
    assert!(changes > 0, "nothing was received");
}

#[test]
fn shared_rule_first_decision_wins() {
    let shared = Shared::new(&[], 2, 0, false);
    assert_eq!(shared.decision(), Decision::Open);
    assert_eq!(shared.decide(Decision::Fire), Decision::Fire);
    assert_eq!(shared.decide(Decision::Never), Decision::Fire);
    let rule = |part: usize| {
        let mut rule = Rule::new(0, vec![], vec![], NetActions::default());
        rule.part = Some(Part::new(Arc::new(Shared::new(&[], 2, 0, false)), part));
        rule
    };
    assert_eq!(rule(1).give_up(), RuleState::Inactive);
}

#[test]
fn shared_rule_fault_fails_all_parts() {
    let mut threads = threads();
    let mut view = DeviceView {
        status: DeviceStatus::Operational,
        faults: 0,
        jumps: 0,
    };
    let mut arm = net(13, ENDLESS);
    arm.devices.push((0, 0));
    let [first, second] = &mut threads;
    second.executor.set_device(0, view);
    second.executor.schedule(arm).unwrap();
    let [one, other] = parts_that_start(false, &[1]);
    let orders = NetActions {
        start: vec![13],
        ..NetActions::default()
    };
    let mut slow = Rule::new(5, vec![terminated(0)], vec![Step::Literal(0)], orders);
    slow.part = other.part;
    first.executor.add_rule(one).unwrap();
    second.executor.add_rule(Box::new(slow)).unwrap();
    first.run();
    second.run();
    // It fails and comes back: no condition holds yet, and none will do it any more.
    view.faults = 1;
    second.executor.set_device(0, view);
    assert_eq!(second.run(), (texts(&["rule FireFailed"]), vec![11]));
    first.start(net(0, BRIEF));
    let (reported, runs) = first.run();
    assert!(
        reported.contains(&"rule FireFailed".to_owned()),
        "{reported:?}"
    );
    assert!(runs.is_empty(), "{runs:?}");
    second.run();
    assert_eq!(second.run().1, [11]);
}
