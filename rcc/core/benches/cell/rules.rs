//! Cost of pending rules per cycle at the limit of their literals, beside the maximum number of running
//! nets: in every cycle, and in the one in which all of them fire.

use std::time::Duration;

use serde_json::{Value, json};
use takt_core::executor::rules::{Literal, NetActions, Question, RULES_MAX, Rule, Step, WORK_MAX};
use takt_core::executor::{Executor, RUNNING_MAX, Running};
use takt_net::{Limits, LoadContext, Moment, NoDevices, load};
use takt_rt::latest::latest;
use takt_rt::monotonic;

use crate::quantiles::{as_f64, median};

const PERIOD: Duration = Duration::from_millis(1);
const CYCLES: u64 = 2_000;
/// Literals of a condition.
const LITERALS: usize = 100;
const BRIEF: &str = "{clock=Core::Clock(Increment='1000'),end=Core::DoubleGreater(inFirst=clock.outValue,\
                     Second='1e9'),outTerminate=end.outValue}";

/// The maximum number of nets, all endless.
fn executor() -> Executor {
    let registry = takt_core::registry();
    let mut executor = Executor::default();
    for id in (0_u32..).take(RUNNING_MAX) {
        let context = LoadContext {
            registry: &registry,
            devices: &NoDevices,
            period: PERIOD,
            limits: Limits::default(),
        };
        let plan = load(BRIEF, &context).expect("the net is good");
        let words = |n: usize| vec![0; n].into_boxed_slice();
        let (out, _) = latest(1, || words(plan.outbox().words()));
        let (_, inbox) = latest(1, || words(plan.inbox().words()));
        let net = Box::new(Running::new(id, plan, out, inbox));
        assert!(executor.start(net).is_ok(), "there is room");
    }
    executor
}

fn asked(net: u32) -> Literal {
    Literal {
        net,
        question: Question::Terminated,
        value: None,
        last: false,
    }
}

/// Rules with long conditions, up to the limit.
fn conditions(executor: &mut Executor) -> usize {
    let nets = (0..).take(RUNNING_MAX).cycle();
    let mut count = 0;
    loop {
        let literals = nets.clone().skip(count).take(LITERALS).map(asked).collect();
        let mut steps: Vec<_> = (0..LITERALS).map(Step::Literal).collect();
        steps.extend((1..LITERALS).map(|_| Step::Or));
        let number = u32::try_from(count).expect("few rules");
        let rule = Rule::new(number, literals, steps, NetActions::default());
        if executor.add_rule(Box::new(rule)).is_err() {
            return count;
        }
        count += 1;
    }
}

/// The maximum number of rules, which wait for the end of net 0 to stop others, up to the limit.
fn orders(executor: &mut Executor) -> usize {
    let stops = WORK_MAX / RULES_MAX - 2;
    for number in (0_u32..).take(RULES_MAX) {
        let first = number % u32::try_from(RUNNING_MAX - stops).expect("few nets");
        let stop = (first + 1..).take(stops).collect();
        let orders = NetActions {
            stop,
            ..NetActions::default()
        };
        let rule = Rule::new(number, vec![asked(0)], vec![Step::Literal(0)], orders);
        assert!(executor.add_rule(Box::new(rule)).is_ok(), "there is room");
    }
    RULES_MAX
}

/// Runs a cycle; returns how long it took, ns.
fn cycle(executor: &mut Executor, number: u64) -> f64 {
    let moment = Moment {
        cycle: number,
        ..Moment::default()
    };
    let begin = monotonic();
    executor.announce_takeovers(|_, _| ());
    executor.cycle(moment);
    executor.fire_rules();
    executor.take_rules(|_| Ok(()));
    as_f64((monotonic() - begin).0)
}

fn median_cycle(executor: &mut Executor) -> f64 {
    let cycles = (1..=CYCLES).map(|number| cycle(executor, number));
    median(&cycles.collect::<Vec<_>>())
}

pub(crate) fn run() -> Value {
    let none = median_cycle(&mut executor());
    let mut with_conditions = executor();
    let long = conditions(&mut with_conditions);
    let conditions = median_cycle(&mut with_conditions);
    let mut with_orders = executor();
    let many = orders(&mut with_orders);
    let orders = median_cycle(&mut with_orders);
    with_orders.abort(0);
    let burst = cycle(&mut with_orders, CYCLES + 1);
    println!(
        "{RUNNING_MAX} nets and rules at their bound, us a cycle: {:.1} without rules, {:.1} with {long} of \
         {LITERALS} literals, {:.1} with {many} that stop nets, {:.1} when these end",
        none / 1e3,
        conditions / 1e3,
        orders / 1e3,
        burst / 1e3
    );
    json!({
        "rules_none_ns": none,
        "rules_conditions_ns": conditions,
        "rules_orders_ns": orders,
        "rules_burst_ns": burst,
        "rules_ratio": conditions.max(orders) / none,
    })
}
