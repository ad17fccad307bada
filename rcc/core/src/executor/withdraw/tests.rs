//! What becomes of commands in the image, with the executor alone. Devices and drivers are in `tests/ends.rs`.

use takt_net::Moment;
use takt_net::device::JointCommand;

use crate::executor::Executor;
use crate::executor::rules::shared::{Decision, Part, Shared};
use crate::executor::rules::{Literal, NetActions, Question, Rule, Step};
use crate::executor::tests::{BRIEF, ENDLESS, net};

/// A slow net's set-point for joint 0, given in cycle 1.
fn set_point(executor: &mut Executor, net: u32) {
    executor.use_joints(1);
    executor.image.joints[0].command.set(JointCommand {
        cycle: 1,
        every: 1000,
        position: 0.5,
        net: Some(net),
    });
}

fn stands(executor: &Executor) -> bool {
    executor.joints()[0].command.get().is_in_force(2)
}

fn cycle(executor: &mut Executor) {
    executor.cycle(Moment {
        cycle: 2,
        ..Moment::default()
    });
}

#[test]
fn commands_of_other_nets_stay() {
    let mut executor = Executor::default();
    executor.start(net(1, ENDLESS)).unwrap();
    executor.start(net(2, ENDLESS)).unwrap();
    set_point(&mut executor, 2);
    executor.abort(1);
    cycle(&mut executor);
    assert!(stands(&executor));
    executor.abort(2);
    cycle(&mut executor);
    assert!(!stands(&executor));
}

#[test]
fn net_that_ends_in_a_cycle_commands_until_its_end() {
    let mut executor = Executor::default();
    executor.start(net(1, BRIEF)).unwrap();
    set_point(&mut executor, 1);
    cycle(&mut executor);
    assert!(stands(&executor), "its last cycle counts");
    assert!(executor.withdraw());
    assert!(!stands(&executor));
    assert!(!executor.withdraw(), "once");
}

/// Its end goes back before a rule of several threads is decided: that may start a successor in the next cycle.
#[test]
fn commands_wait_one_cycle_for_other_threads() {
    let mut executor = Executor::default();
    executor.start(net(1, BRIEF)).unwrap();
    executor.schedule(net(2, ENDLESS)).unwrap();
    set_point(&mut executor, 1);
    let literal = |net| Literal {
        net,
        question: Question::Terminated,
        value: None,
        last: false,
    };
    let literals = [(literal(1), Some(0)), (literal(7), Some(1))];
    let shared = std::sync::Arc::new(Shared::new(&literals, 2, 1, true));
    let orders = NetActions {
        start: vec![2],
        ..NetActions::default()
    };
    let steps = vec![Step::Literal(0), Step::Literal(1), Step::And];
    let asked = literals.iter().map(|(literal, _)| *literal).collect();
    let mut rule = Box::new(Rule::new(1, asked, steps, orders));
    rule.part = Some(Part::new(std::sync::Arc::clone(&shared), 0));
    executor.add_rule(rule).unwrap();
    cycle(&mut executor);
    executor.fire_rules();
    assert!(!executor.withdraw(), "a successor may still come");
    while executor.take_ended(|_, _| Ok(())) {}
    assert!(stands(&executor));
    // None came.
    assert_eq!(shared.decision(), Decision::Open);
    cycle(&mut executor);
    assert!(!stands(&executor));
}

#[test]
fn removed_nets_leave_no_commands() {
    let mut executor = Executor::default();
    executor.start(net(1, BRIEF)).unwrap();
    set_point(&mut executor, 1);
    cycle(&mut executor);
    while executor.take_ended(|_, _| Ok(())) {}
    cycle(&mut executor);
    assert!(!stands(&executor));
}
