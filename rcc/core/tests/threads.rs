//! Controllers with several net threads: which net runs where, shared state, rules between them, and
//! what is reported of each net. Simulated arms; none of it depends on a wire.

#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use takt_core::cell::NetThreadSettings;
use takt_core::controller::{LoadRequest, NetInfo, NetState, RuleId, RuleRequest, RuleState};
use takt_core::device::DeviceStatus;
use takt_core::{CellConfig, Controller, NetId, SessionId};

const FAST: Duration = Duration::from_millis(1);
const SLOW: Duration = Duration::from_millis(4);

/// A controller with threads of 1 ms and 4 ms.
struct Bench(Controller);

impl Bench {
    fn new() -> Self {
        let mut cell = CellConfig::default();
        cell.controller.threads = vec![NetThreadSettings::new(SLOW)];
        Self(Controller::start(&cell).unwrap())
    }

    /// Adds a simulated LWR which the thread of that period commands.
    fn arm(&self, name: &str, thread: &str) {
        let list = |value: f64| format!("{:?}", [value; 7]);
        let parameters: BTreeMap<_, _> = [
            ("min_joint", list(-2.0)),
            ("max_joint", list(2.0)),
            ("max_vel", list(2.0)),
            ("max_acc", list(4.0)),
            ("thread", thread.to_owned()),
        ]
        .map(|(key, text)| (key.to_owned(), text))
        .into();
        self.0
            .add_device(name, "kuka_lwr_sim", &parameters)
            .unwrap();
    }

    fn offer(&self, text: &str, period: Option<Duration>) -> NetInfo {
        let request = LoadRequest {
            text: text.to_owned(),
            session: SessionId::NONE,
            description: String::new(),
            period,
        };
        let net = self.0.load(request).unwrap();
        self.0.net(net).unwrap()
    }

    fn load(&self, text: &str, period: Option<Duration>) -> NetId {
        let net = self.offer(text, period);
        assert_eq!(net.state(), NetState::Ready, "{:?}", net.rejection);
        net.id
    }

    fn refusal(&self, text: &str, period: Option<Duration>) -> String {
        self.offer(text, period).rejection.unwrap().to_string()
    }

    /// Period and thread's period of a net.
    fn periods(&self, net: NetId) -> (Duration, Duration) {
        let figures = self.0.net_figures(net).unwrap();
        (figures.period, figures.thread_period)
    }

    fn wait(&self, what: &str, done: impl Fn() -> bool) {
        let until = Instant::now() + Duration::from_secs(20);
        while !done() {
            assert!(Instant::now() < until, "waited in vain for: {what}");
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    fn wait_state(&self, net: NetId, state: NetState) {
        self.wait(&format!("{net} {state}"), || {
            self.0.net(net).unwrap().state() == state
        });
    }

    fn rule(&self, condition: &str, stop: &[NetId], cancel: &[NetId], start: &[NetId]) -> RuleId {
        let request = RuleRequest {
            condition: condition.to_owned(),
            stop: stop.to_vec(),
            cancel: cancel.to_vec(),
            start: start.to_vec(),
            description: String::new(),
        };
        self.0.schedule(request).unwrap()
    }

    fn wait_rule(&self, rule: RuleId, state: RuleState) {
        self.wait(&format!("rule {rule} {state:?}"), || {
            self.0.rule(rule).unwrap().state == state
        });
    }

    fn value(&self, net: NetId, key: &str) -> Option<String> {
        let values = self.0.out_values(net);
        let value = values.into_iter().find(|(k, _)| k == key);
        value.map(|(_, text)| text)
    }
}

/// Reports `done` after so many seconds and ends then, if `ends`, or when asked to cancel.
fn lasting(seconds: f64, ends: bool) -> String {
    let end = if ends { "either" } else { "cancel" };
    let port = if ends { "outValue" } else { "outCancel" };
    format!(
        "{{clock=Core::Clock(),over=Core::DoubleGreater(inFirst=clock.outValue,Second='{seconds}'),
        done=Core::BooleanNetcommOut(inValue=over.outValue,Key='done'),
        takeover=Takeover(),wanted=Core::BooleanNetcommOut(inValue=takeover.outTakeover,Key='wanted'),
        cancel=Cancel(),either=Core::BooleanOr(inFirst=cancel.outCancel,inSecond=over.outValue),
        outTerminate={end}.{port}}}"
    )
}

/// Moves joint 0 of these arms by half a radian.
fn swing(arms: &[&str]) -> String {
    let joints = arms.iter().map(|arm| {
        format!("{arm}=RobotArm::JointPosition(inPosition=smooth.outValue,Robot='{arm}',Axis='0'),")
    });
    format!(
        "{{clock=Core::Clock(),part=Core::Interval(inValue=clock.outValue,Max='1.5'),
        smooth=Core::DoubleBezier(inValue=part.outValue,To='0.5'),{}
        done=Core::DoubleGreater(inFirst=clock.outValue,Second='1.6'),outTerminate=done.outValue}}",
        joints.collect::<String>()
    )
}

// Where nets run.

#[test]
fn nets_run_in_thread_dividing_their_period() {
    let bench = Bench::new();
    for (period, expected) in [
        (None, (FAST, FAST)),
        (Some(FAST), (FAST, FAST)),
        (Some(SLOW), (SLOW, SLOW)),
        (Some(2 * SLOW), (2 * SLOW, SLOW)),
        (Some(3 * FAST), (3 * FAST, FAST)),
    ] {
        let net = bench.load(&lasting(0.1, true), period);
        assert_eq!(bench.periods(net), expected);
        bench.0.start_net(net).unwrap();
        bench.wait_state(net, NetState::Terminated);
        let cycles = bench.0.net_figures(net).unwrap().counts.cycles;
        // The clock gives one period in the first cycle.
        let expected = 100 / u64::try_from(expected.0.as_millis()).unwrap() + 1;
        assert!(cycles.abs_diff(expected) <= 1, "{cycles} not {expected}");
    }
}

#[test]
fn arm_state_is_visible_in_all_threads() {
    let bench = Bench::new();
    bench.arm("arm", "4ms");
    let mover = bench.load(&swing(&["arm"]), None);
    assert_eq!(bench.periods(mover), (SLOW, SLOW));
    let observer = "{m=RobotArm::JointMonitor(Robot='arm',Axis='0'),
        out=Core::DoubleNetcommOut(inValue=m.outMeasuredPosition,Key='position'),
        cancel=Cancel(),outTerminate=cancel.outCancel}";
    let observer = bench.load(observer, None);
    assert_eq!(bench.periods(observer), (FAST, FAST));
    bench.0.start_net(observer).unwrap();
    bench.0.start_net(mover).unwrap();
    bench.wait_state(mover, NetState::Terminated);
    assert_eq!(bench.0.net(mover).unwrap().end, None);
    bench.wait("the position", || {
        let text = bench.value(observer, "outposition");
        text.is_some_and(|text| (text.parse::<f64>().unwrap() - 0.5).abs() < 1e-9)
    });
    bench.0.abort(observer).unwrap();
    for net in [mover, observer] {
        bench.0.unload(net).unwrap();
    }
    bench.0.remove_device("arm").unwrap();
    let gone = bench.refusal(&swing(&["arm"]), None);
    assert!(gone.contains("`arm`"), "{gone}");
    // A new one of that name belongs to the first thread.
    bench.arm("arm", "1ms");
    let mover = bench.load(&swing(&["arm"]), None);
    assert_eq!(bench.periods(mover), (FAST, FAST));
}

#[test]
fn net_commanding_two_threads_is_rejected() {
    let bench = Bench::new();
    bench.arm("left", "1ms");
    bench.arm("right", "4ms");
    let text = bench.refusal(&swing(&["left", "right"]), None);
    assert!(
        text.contains("`left` is served by that of 1ms and `right` by that of 4ms"),
        "{text}"
    );
    let text = bench.refusal(&swing(&["right"]), Some(6 * FAST));
    assert!(
        text.contains(
            "6ms is not a whole multiple of the 4ms of the net thread that serves `right`"
        ),
        "{text}"
    );
    let parameters = BTreeMap::from([("thread".to_owned(), "3ms".to_owned())]);
    let error = bench.0.add_device("third", "kuka_lwr_sim", &parameters);
    assert!(error.is_err());
}

#[test]
fn joint_belongs_to_one_net_of_any_period() {
    let bench = Bench::new();
    bench.arm("arm", "1ms");
    let first = bench.load(&swing(&["arm"]), None);
    // A thread of that period exists, but does not command the arm.
    let second = bench.load(&swing(&["arm"]), Some(SLOW));
    assert_eq!(bench.periods(second), (SLOW, FAST));
    bench.0.start_net(first).unwrap();
    let error = bench.0.start_net(second).unwrap_err().to_string();
    assert!(
        error.contains(&format!("arm_Joint_0, which net {first} of session ")),
        "{error}"
    );
    bench.0.abort(first).unwrap();
    bench.0.start_net(second).unwrap();
}

// Rules between threads.

#[test]
fn rule_starts_net_in_other_thread() {
    for (first, second) in [(FAST, SLOW), (SLOW, FAST)] {
        let bench = Bench::new();
        let predecessor = bench.load(&lasting(0.05, true), Some(first));
        let successor = bench.load(&lasting(0.05, true), Some(second));
        let rule = bench.rule(&format!("{predecessor}.terminated"), &[], &[], &[successor]);
        assert_eq!(bench.0.net(successor).unwrap().state(), NetState::Scheduled);
        bench.0.start_net(predecessor).unwrap();
        bench.wait_state(successor, NetState::Terminated);
        bench.wait_rule(rule, RuleState::Fired);
    }
}

#[test]
fn one_rule_stops_cancels_and_starts_in_both_threads() {
    let bench = Bench::new();
    let load = |period| bench.load(&lasting(9.0, false), Some(period));
    let stopped = [load(FAST), load(SLOW)];
    let cancelled = [load(FAST), load(SLOW)];
    let started = [load(FAST), load(SLOW)];
    for net in stopped.iter().chain(&cancelled) {
        bench.0.start_net(*net).unwrap();
    }
    let trigger = [
        bench.load(&lasting(0.05, false), Some(FAST)),
        bench.load(&lasting(0.1, false), Some(SLOW)),
    ];
    let condition = format!("{}.outdone & {}.outdone", trigger[0], trigger[1]);
    let rule = bench.rule(&condition, &stopped, &cancelled, &started);
    bench.wait("the successors to be announced", || {
        let mut both = stopped.iter().map(|net| bench.value(*net, "outwanted"));
        both.all(|text| text.as_deref() == Some("true"))
    });
    assert_eq!(bench.0.rule(rule).unwrap().state, RuleState::Active);
    for net in trigger {
        bench.0.start_net(net).unwrap();
    }
    bench.wait_rule(rule, RuleState::Fired);
    for net in stopped {
        let end = bench.0.net(net).unwrap().end;
        assert_eq!(end.as_deref(), Some("stopped by a rule"));
    }
    for net in cancelled {
        bench.wait_state(net, NetState::Terminated);
        assert_eq!(bench.0.net(net).unwrap().end, None);
    }
    for net in started {
        assert_eq!(bench.0.net(net).unwrap().state(), NetState::Running);
    }
}

#[test]
fn rule_failing_in_one_thread_fails_all() {
    let bench = Bench::new();
    let load = |seconds, period| bench.load(&lasting(seconds, true), Some(period));
    let (trigger, kept) = (load(0.05, FAST), load(9.0, SLOW));
    let nets = [load(9.0, FAST), load(9.0, SLOW)];
    let rule = bench.rule(&format!("{trigger}.outdone"), &[kept], &[], &nets);
    bench.0.start_net(kept).unwrap();
    // Without one of its nets it cannot fire.
    bench.0.abort(nets[1]).unwrap();
    bench.0.start_net(trigger).unwrap();
    bench.wait_rule(rule, RuleState::Inactive);
    bench.wait_state(trigger, NetState::Terminated);
    assert_eq!(bench.0.net(kept).unwrap().state(), NetState::Running);
    // The net that it no longer starts can be started by hand.
    bench.wait("the net to be free", || bench.0.start_net(nets[0]).is_ok());
}

#[test]
fn impossible_condition_ends_rule_in_both_threads() {
    let bench = Bench::new();
    let first = bench.load(&lasting(9.0, true), Some(FAST));
    let second = bench.load(&lasting(9.0, true), Some(SLOW));
    bench.0.start_net(first).unwrap();
    let rule = bench.rule(&format!("{first}.terminated"), &[], &[], &[second]);
    bench.0.abort(first).unwrap();
    bench.wait_rule(rule, RuleState::Inactive);
    bench.wait("the net to be free", || bench.0.start_net(second).is_ok());
}

#[test]
fn rule_on_ended_remote_net_decides_at_once() {
    let bench = Bench::new();
    let first = bench.load(&lasting(0.0, true), Some(SLOW));
    bench.0.start_net(first).unwrap();
    bench.wait_state(first, NetState::Terminated);
    let second = bench.load(&lasting(0.0, true), Some(FAST));
    let rule = bench.rule(&format!("{first}.outdone"), &[], &[], &[second]);
    bench.wait_rule(rule, RuleState::Fired);
    bench.wait_state(second, NetState::Terminated);
}

#[test]
fn net_chain_alternates_between_threads() {
    let bench = Bench::new();
    let period = |i: usize| Some(if i.is_multiple_of(2) { FAST } else { SLOW });
    let nets: Vec<_> = (0..40)
        .map(|i| bench.load(&lasting(0.0, true), period(i)))
        .collect();
    for pair in nets.windows(2) {
        bench.rule(&format!("{}.terminated", pair[0]), &[], &[], &pair[1..]);
    }
    bench.0.start_net(nets[0]).unwrap();
    bench.wait_state(nets[39], NetState::Terminated);
    for net in nets {
        assert_eq!(bench.0.net(net).unwrap().end, None);
        assert_eq!(bench.0.net_figures(net).unwrap().counts.cycles, 1);
    }
}

// Figures.

/// Says `stop` to the emergency stop until cancelled; programs can change it.
fn says(stop: bool) -> String {
    format!(
        "{{stop=Core::BooleanNetcommIn(Key='stop',Value='{stop}'),say=EStop(inEStop=stop.outValue),
        cancel=Cancel(),outTerminate=cancel.outCancel}}"
    )
}

#[test]
fn estop_ends_commanding_nets_in_all_threads() {
    let bench = Bench::new();
    bench.arm("fast", "1ms");
    bench.arm("slow", "4ms");
    let guard = bench.load(&says(false), None);
    let moving = [swing(&["fast"]), swing(&["slow"])].map(|text| bench.load(&text, None));
    for net in [guard].iter().chain(&moving) {
        bench.0.start_net(*net).unwrap();
    }
    assert!(!bench.0.is_stopped());
    assert!(bench.0.write_in(guard, "instop", "true").unwrap());
    for (net, name) in moving.iter().zip(["fast", "slow"]) {
        bench.wait_state(*net, NetState::Terminated);
        let end = bench.0.net(*net).unwrap().end.unwrap();
        let expected = format!(
            "device {name} stopped following commands and is safe-operational: the emergency stop is on"
        );
        assert_eq!(end, expected);
    }
    assert!(bench.0.is_stopped());
    assert_eq!(bench.0.net(guard).unwrap().state(), NetState::Running);
    let safe = |status: DeviceStatus| status == DeviceStatus::SafeOperational;
    assert!(bench.0.devices().iter().all(|device| safe(device.status)));
    let again = bench.load(&swing(&["slow"]), None);
    let error = bench.0.start_net(again).unwrap_err().to_string();
    assert!(
        error.contains("safe-operational: the emergency stop is on"),
        "{error}"
    );
    // The stop outlives the net that requested it; it is in force until it is released.
    bench.0.abort(guard).unwrap();
    assert!(bench.0.is_stopped());
    let relief = bench.load(&says(false), Some(SLOW));
    bench.0.start_net(relief).unwrap();
    bench.wait("the end of the stop", || !bench.0.is_stopped());
    let next = bench.load(&swing(&["slow"]), None);
    bench.wait("an arm that follows", || bench.0.start_net(next).is_ok());
}

#[test]
fn controller_needing_estop_stops_without_one() {
    let mut cell = CellConfig::default();
    cell.controller.need_estop = true;
    let bench = Bench(Controller::start(&cell).unwrap());
    bench.arm("arm", "1ms");
    let net = bench.load(&swing(&["arm"]), None);
    assert!(bench.0.is_stopped());
    bench.0.start_net(net).unwrap_err();
    let guard = bench.load(&says(false), None);
    bench.0.start_net(guard).unwrap();
    bench.wait("the end of the stop", || !bench.0.is_stopped());
    bench.0.abort(guard).unwrap();
    bench.wait("a stop for want of words", || bench.0.is_stopped());
}

#[test]
fn net_figures_remain_after_its_end() {
    let bench = Bench::new();
    let net = bench.load(&lasting(0.05, true), None);
    let before = bench.0.net_figures(net).unwrap();
    assert_eq!((before.counts.cycles, before.budget), (0, FAST * 4 / 5));
    assert_eq!(before.primitives, 7);
    assert!(before.cost > Duration::ZERO && before.cost < before.budget);
    bench.0.start_net(net).unwrap();
    bench.wait_state(net, NetState::Terminated);
    let after = bench.0.net_figures(net).unwrap();
    assert!(after.counts.cycles >= 50, "{after:?}");
    assert!(after.counts.max >= after.counts.mean && !after.counts.mean.is_zero());
    assert_eq!(bench.0.net_figures(net).unwrap(), after);
    let rejected = bench.offer("{", None);
    assert_eq!(bench.0.net_figures(rejected.id), None);
}

#[test]
fn each_thread_has_its_own_figures() {
    let bench = Bench::new();
    bench.wait("cycles of both", || {
        bench.0.threads().iter().all(|t| t.stats.cycles > 10)
    });
    let threads = bench.0.threads();
    assert_eq!(
        threads.iter().map(|t| t.period).collect::<Vec<_>>(),
        [FAST, SLOW]
    );
    assert!(threads[0].stats.cycles > threads[1].stats.cycles);
    assert!(bench.0.stats().cycles >= threads[0].stats.cycles);
}

#[test]
fn inconsistent_cell_does_not_start() {
    let mut cell = CellConfig::default();
    cell.controller.threads = vec![NetThreadSettings::new(FAST)];
    let error = Controller::start(&cell).unwrap_err().to_string();
    assert!(error.contains("1ms is given twice"), "{error}");
}

#[test]
fn net_unloaded_while_starting_ends() {
    let slow = Duration::from_millis(100);
    let mut cell = CellConfig::default();
    cell.controller.period = slow;
    let bench = Bench(Controller::start(&cell).unwrap());
    bench.arm("left", "100ms");
    let end_while_starting = |unload: bool| {
        let net = bench.load(&swing(&["left"]), None);
        std::thread::scope(|scope| {
            // Whether it still has an answer is a matter of luck.
            scope.spawn(|| bench.0.start_net(net).ok());
            std::thread::sleep(Duration::from_millis(10));
            if unload {
                bench.0.unload(net).unwrap();
            } else {
                bench.0.abort(net).unwrap();
            }
        });
        let state = bench.0.net(net).map(|net| net.state());
        if state == Some(NetState::Running) {
            bench.0.abort(net).unwrap();
        }
        state
    };
    for unload in [true, false] {
        // A cycle may begin within these 10 ms: the net then runs, which unloading does not affect.
        let states = std::iter::repeat_with(|| end_while_starting(unload));
        let mut ended = states
            .take(10)
            .skip_while(|state| *state == Some(NetState::Running));
        assert_eq!(
            ended.next(),
            Some((!unload).then_some(NetState::Terminated))
        );
        // Nothing holds the arm any more.
        let next = bench.load(&swing(&["left"]), None);
        bench.0.start_net(next).unwrap();
        bench.0.abort(next).unwrap();
    }
}

#[test]
fn period_out_of_range_is_rejected() {
    let bench = Bench::new();
    let endless = "{never=Core::BooleanValue(),outTerminate=never.outValue}";
    let period = Duration::from_secs(5_000_000_000_000_000_000);
    let refusal = bench.refusal(endless, Some(period));
    assert!(refusal.contains("longer than the 60s"), "{refusal}");
}
