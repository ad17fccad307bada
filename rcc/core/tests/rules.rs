//! Succession of nets: synchronization rules, takeover, resources kept for successors, and no gap
//! between predecessor and successor. No devices; arms are in `arms.rs`.

#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test may fail anywhere, its helpers too"
)]

use std::time::{Duration, Instant};

use takt_core::controller::{
    Begun, LoadRequest, NetState, PreparedStart, PreparedState, RuleId, RuleRequest, RuleState,
};
use takt_core::{CellConfig, Controller, NetId, SessionId};

struct Bench(Controller);

impl Bench {
    fn new() -> Self {
        Self(Controller::start(&CellConfig::default()).unwrap())
    }

    fn load(&self, text: &str) -> NetId {
        let request = LoadRequest {
            text: text.to_owned(),
            session: SessionId::NONE,
            description: String::new(),
            period: None,
        };
        let id = self.0.load(request).unwrap();
        assert_eq!(
            self.state(id),
            NetState::Ready,
            "{:?}",
            self.0.net(id).unwrap().rejection
        );
        id
    }

    fn state(&self, id: NetId) -> NetState {
        self.0.net(id).unwrap().state()
    }

    fn rule(&self, condition: &str, stop: &[NetId], cancel: &[NetId], start: &[NetId]) -> RuleId {
        self.try_rule(condition, stop, cancel, start).unwrap()
    }

    fn try_rule(
        &self,
        condition: &str,
        stop: &[NetId],
        cancel: &[NetId],
        start: &[NetId],
    ) -> Result<RuleId, String> {
        let request = RuleRequest {
            condition: condition.to_owned(),
            stop: stop.to_vec(),
            cancel: cancel.to_vec(),
            start: start.to_vec(),
            description: String::new(),
        };
        self.0.schedule(request).map_err(|e| e.to_string())
    }

    fn wait(&self, what: &str, done: impl Fn() -> bool) {
        let until = Instant::now() + Duration::from_secs(20);
        while !done() {
            assert!(Instant::now() < until, "waited in vain for: {what}");
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    fn wait_state(&self, id: NetId, state: NetState) {
        self.wait(&format!("{id} {state}"), || self.state(id) == state);
    }

    fn wait_rule(&self, id: RuleId, state: RuleState) {
        self.wait(&format!("rule {id} {state:?}"), || {
            self.0.rule(id).unwrap().state == state
        });
    }

    fn value(&self, net: NetId, key: &str) -> Option<String> {
        self.0
            .out_values(net)
            .into_iter()
            .find(|(k, _)| k == key)
            .map(|(_, text)| text)
    }
}

/// Runs for `seconds`, counts its cycles, reports `done` and ends if `ends`.
fn lasting(seconds: f64, ends: bool) -> String {
    let end = if ends {
        "over.outValue"
    } else {
        "never.outValue"
    };
    format!(
        "{{clock=Core::Clock(),over=Core::DoubleGreater(inFirst=clock.outValue,Second='{seconds}'),
        never=Core::BooleanValue(),done=Core::BooleanNetcommOut(inValue=over.outValue,Key='done'),
        true=Core::BooleanValue(Value='true'),
        past=Core::BooleanPre(inValue=true.outValue),
        first=Core::BooleanIsNull(inValue=past.outValue),
        cycles=Core::IntAdd(inFirst=before.outValue,Second='1'),kept=Core::IntPre(inValue=cycles.outValue),
        isNull=Core::IntIsNull(inValue=kept.outValue),
        before=Core::IntConditional(inCondition=isNull.outValue,inFalse=kept.outValue),
        count=Core::IntNetcommOut(inValue=cycles.outValue,Key='count'),
        seen=Core::DoubleNetcommOut(inValue=clock.outValue,Key='clock'),
        takeover=Takeover(),wanted=Core::BooleanNetcommOut(inValue=takeover.outTakeover,Key='wanted'),
        cancel=Cancel(),asked=Core::BooleanNetcommOut(inValue=cancel.outCancel,Key='asked'),
        outTerminate={end}}}"
    )
}

#[test]
fn rule_condition_true_starts_net() {
    let bench = Bench::new();
    let (first, second) = (
        bench.load(&lasting(0.05, false)),
        bench.load(&lasting(0.05, true)),
    );
    let rule = bench.rule(&format!("{first}.outdone"), &[first], &[], &[second]);
    assert_eq!(bench.state(second), NetState::Scheduled);
    assert_eq!(bench.0.rule(rule).unwrap().state, RuleState::Active);
    bench.0.start_net(first).unwrap();
    bench.wait_state(second, NetState::Terminated);
    assert_eq!(bench.state(first), NetState::Terminated);
    assert_eq!(
        bench.0.net(first).unwrap().end.as_deref(),
        Some("stopped by a rule")
    );
    bench.wait_rule(rule, RuleState::Fired);
}

#[test]
fn net_termination_is_a_condition() {
    let bench = Bench::new();
    let (first, second) = (
        bench.load(&lasting(0.05, true)),
        bench.load(&lasting(0.0, true)),
    );
    bench.rule(&format!("{first}.terminated"), &[], &[], &[second]);
    bench.0.start_net(first).unwrap();
    bench.wait_state(second, NetState::Terminated);
}

#[test]
fn takeover_is_announced_to_predecessor() {
    let bench = Bench::new();
    let (first, second) = (
        bench.load(&lasting(9.0, true)),
        bench.load(&lasting(0.0, true)),
    );
    bench.0.start_net(first).unwrap();
    bench.wait("a first value", || {
        bench.value(first, "outwanted").as_deref() == Some("false")
    });
    bench.rule(&format!("{first}.terminated"), &[], &[], &[second]);
    bench.wait("the takeover flag", || {
        bench.value(first, "outwanted").as_deref() == Some("true")
    });
    bench.0.abort(second).unwrap();
    bench.wait("the flag to fall", || {
        bench.value(first, "outwanted").as_deref() == Some("false")
    });
}

#[test]
fn rule_ends_if_condition_impossible() {
    let bench = Bench::new();
    let (first, second) = (
        bench.load(&lasting(9.0, true)),
        bench.load(&lasting(0.0, true)),
    );
    bench.0.start_net(first).unwrap();
    let rule = bench.rule(&format!("{first}.terminated"), &[], &[], &[second]);
    bench.0.abort(first).unwrap();
    bench.wait_rule(rule, RuleState::Inactive);
    // The scheduled net can still be started by hand.
    bench.wait("the net to be free", || bench.0.start_net(second).is_ok());
    bench.wait_state(second, NetState::Terminated);
}

#[test]
fn successor_is_chosen_by_result() {
    let bench = Bench::new();
    let first = bench.load(&lasting(0.05, true));
    let (good, bad) = (
        bench.load(&lasting(0.0, true)),
        bench.load(&lasting(0.0, true)),
    );
    let chosen = bench.rule(&format!("{first}.outdone"), &[first], &[], &[good]);
    let other = bench.rule(
        &format!("{first}.terminated & !{first}.outdone"),
        &[first],
        &[],
        &[bad],
    );
    bench.0.start_net(first).unwrap();
    bench.wait_state(good, NetState::Terminated);
    bench.wait_rule(chosen, RuleState::Fired);
    bench.wait_rule(other, RuleState::Inactive);
    assert_eq!(bench.state(bad), NetState::Scheduled);
}

#[test]
fn rule_stops_cancels_and_starts_nets_at_once() {
    let bench = Bench::new();
    let nets: Vec<NetId> = (0..4).map(|_| bench.load(&lasting(9.0, false))).collect();
    let starter = bench.load(&lasting(0.02, true));
    bench.0.start_net(nets[0]).unwrap();
    bench.0.start_net(nets[1]).unwrap();
    bench.rule(
        &format!("{starter}.outdone"),
        &nets[..1],
        &nets[1..2],
        &nets[2..],
    );
    bench.0.start_net(starter).unwrap();
    bench.wait_state(nets[0], NetState::Terminated);
    bench.wait_state(nets[1], NetState::Cancelling);
    bench.wait_state(nets[2], NetState::Running);
    bench.wait_state(nets[3], NetState::Running);
    let clocks = || {
        let values = nets[2..].iter().map(|n| bench.0.out_values(*n));
        values
            .map(|v| v.into_iter().find(|(k, _)| k == "outclock"))
            .collect::<Vec<_>>()
    };
    bench.wait("both in step", || {
        let both = clocks();
        both[0].is_some() && both[0] == both[1]
    });
    assert_eq!(bench.value(nets[1], "outasked").as_deref(), Some("true"));
}

#[test]
fn rule_on_ended_net_decides_at_once() {
    let bench = Bench::new();
    let (first, second) = (
        bench.load(&lasting(0.0, true)),
        bench.load(&lasting(0.0, true)),
    );
    bench.0.start_net(first).unwrap();
    bench.wait_state(first, NetState::Terminated);
    let fired = bench.rule(&format!("{first}.outdone"), &[first], &[], &[second]);
    bench.wait_rule(fired, RuleState::Fired);
    bench.wait_state(second, NetState::Terminated);
    let third = bench.load(&lasting(0.0, true));
    let never = bench.rule(&format!("!{first}.outdone"), &[], &[], &[third]);
    bench.wait_rule(never, RuleState::Inactive);
    assert_eq!(bench.state(third), NetState::Scheduled);
}

#[test]
fn rule_immediate_fires_and_cancels() {
    let bench = Bench::new();
    let net = bench.load(&lasting(9.0, false));
    let start = bench.rule("t", &[], &[], &[net]);
    bench.wait_rule(start, RuleState::Fired);
    bench.wait_state(net, NetState::Running);
    bench.rule("t", &[], &[net], &[]);
    bench.wait_state(net, NetState::Cancelling);
    bench.rule("t", &[net], &[], &[]);
    bench.wait_state(net, NetState::Terminated);
}

#[test]
fn invalid_rules_are_rejected_with_cause() {
    let bench = Bench::new();
    let (net, ended) = (
        bench.load(&lasting(9.0, true)),
        bench.load(&lasting(0.0, true)),
    );
    bench.0.start_net(ended).unwrap();
    bench.wait_state(ended, NetState::Terminated);
    let refused =
        |condition: &str, start: &[NetId]| bench.try_rule(condition, &[], &[], start).unwrap_err();
    assert!(refused("rpinet99.outx", &[]).contains("there is no net `rpinet99`"));
    assert!(refused(&format!("{net}.outnone"), &[]).contains("has no value `outnone`"));
    assert!(refused(&format!("{net}.outclock"), &[]).contains("no Boolean value"));
    assert!(refused("a b", &[]).contains("column 3"));
    assert!(refused("t", &[ended]).contains("only start a net that is READY"));
    assert!(refused("t", &[net, net]).contains("and once"));
    assert_eq!(bench.state(net), NetState::Ready);
}

/// Every net of a chain runs its five cycles; `switching.rs` shows in virtual time that none is lost between them.
#[test]
fn net_chain_runs_to_its_end() {
    let bench = Bench::new();
    let ring: Vec<NetId> = (0..40).map(|_| bench.load(&counting())).collect();
    for pair in ring.windows(2) {
        bench.rule(&format!("{}.terminated", pair[0]), &[], &[], &pair[1..]);
    }
    bench.0.start_net(ring[0]).unwrap();
    bench.wait_state(ring[39], NetState::Terminated);
    for net in ring {
        assert_eq!(bench.value(net, "outcount").as_deref(), Some("5"));
        assert_eq!(bench.0.net(net).unwrap().end, None);
    }
}

/// Ends in its fifth cycle.
fn counting() -> String {
    "{true=Core::BooleanValue(Value='true'),past=Core::BooleanPre(inValue=true.outValue),
    first=Core::BooleanIsNull(inValue=past.outValue),
    kept=Core::IntPre(inValue=cycles.outValue),
    before=Core::IntConditional(inCondition=first.outValue,inFalse=kept.outValue),
    cycles=Core::IntAdd(inFirst=before.outValue,Second='1'),
    count=Core::IntNetcommOut(inValue=cycles.outValue,Key='count'),
    five=Core::IntEquals(inFirst=cycles.outValue,Second='5'),
    outTerminate=five.outValue}"
        .to_owned()
}

/// Never ends by itself, unless it is cancelled.
const ENDLESS: &str = "{x=Cancel(),outTerminate=x.outCancel}";

/// Waits until nets of a prepared start have begun or have failed.
fn decided(start: &PreparedStart) -> PreparedState {
    let until = Instant::now() + Duration::from_secs(20);
    loop {
        let state = start.state();
        if state != PreparedState::Waiting {
            return state;
        }
        assert!(Instant::now() < until, "the start is not decided");
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// The cycles in which nets of these controllers began together; a start that a stall of the host prevents is tried again.
fn begun_together(benches: &[&Bench]) -> Vec<Begun> {
    for _ in 0..100 {
        let prepare = |bench: &&Bench| {
            let net = bench.load(ENDLESS);
            bench.0.prepare_start(&[net], "together").unwrap()
        };
        let starts: Vec<_> = benches.iter().map(prepare).collect();
        // On the grid, so that both have one nearest cycle.
        let reading = takt_core::read_tai().unwrap();
        let ahead = reading.after + takt_core::Nanos::from_millis(50);
        let at = ahead - takt_core::Nanos((ahead + reading.offset()).0.rem_euclid(1_000_000));
        starts.iter().for_each(|start| start.begin_at(at));
        let states: Vec<_> = starts.iter().map(decided).collect();
        let begun: Vec<_> = states
            .iter()
            .filter_map(|state| match state {
                PreparedState::Begun(begun) => Some(*begun),
                PreparedState::Waiting => None,
                PreparedState::Failed(why) => {
                    assert!(why.contains("the host stalled"), "{why}");
                    None
                }
            })
            .collect();
        for (start, bench) in starts.iter().zip(benches) {
            assert!(start.nets().iter().all(|net| bench.0.abort(*net).is_ok()));
        }
        for begun in &begun {
            let beside = (begun.begin - at).0.abs();
            assert!(beside <= 500_000, "{beside} ns beside the instant");
            assert!(begun.woken >= begun.begin, "{begun:?}");
        }
        if begun.len() == benches.len() {
            return begun;
        }
    }
    panic!("the host stalled at each start");
}

#[test]
fn prepared_starts_of_two_controllers_begin_in_one_cycle() {
    let (one, other) = (Bench::new(), Bench::new());
    let begun = begun_together(&[&one, &other]);
    // Both have the cycles of the host's TAI: their grids differ by the error of reading it.
    let beside = (begun[0].begin - begun[1].begin).0.abs();
    assert!(beside <= 100_000, "{beside} ns beside each other");
}

#[test]
fn prepared_start_past_stopped_or_released_never_begins() {
    let bench = Bench::new();
    let prepared = || {
        let net = bench.load(ENDLESS);
        (net, bench.0.prepare_start(&[net], "").unwrap())
    };
    let soon = || takt_core::monotonic() + takt_core::Nanos::from_millis(40);
    let why = |start: &PreparedStart| {
        let PreparedState::Failed(why) = decided(start) else {
            panic!("it began");
        };
        why
    };
    // An instant that was missed, by whatever was late.
    let (net, late) = prepared();
    assert_eq!(bench.state(net), NetState::Scheduled);
    late.begin_at(takt_core::monotonic() - takt_core::Nanos::from_millis(10));
    assert!(why(&late).contains("the host stalled"), "{}", why(&late));
    // The net is free for another start.
    bench.0.start_net(net).unwrap();
    // One that was released in time, though an instant was given.
    let (net, released) = prepared();
    released.begin_at(soon());
    assert!(released.release());
    assert!(why(&released).contains("released"), "{}", why(&released));
    let is_free = |net| bench.0.prepare_start(&[net], "again").is_ok();
    bench.wait("the net is free", || is_free(net));
    // Dropped: its holder is gone.
    let (net, dropped) = prepared();
    drop(dropped);
    bench.wait("the net is free", || is_free(net));
    // A stop in between, even if it is over before the instant.
    let (net, stopped) = prepared();
    let switch = bench.0.stop_switch();
    stopped.begin_at(soon());
    switch.stop(takt_core::stop_channel::Origin::Program);
    assert!(matches!(decided(&stopped), PreparedState::Failed(_)));
    assert!(switch.release());
    std::thread::sleep(Duration::from_millis(60));
    assert_ne!(bench.state(net), NetState::Running);
    assert!(
        !bench
            .0
            .net(net)
            .unwrap()
            .states
            .contains(&NetState::Running)
    );
}

#[test]
fn prepared_start_without_common_period_is_refused() {
    let bench = Bench::new();
    let none = bench.0.prepare_start(&[], "").unwrap_err().to_string();
    assert!(none.contains("names no net"), "{none}");
    let slow = LoadRequest {
        text: ENDLESS.to_owned(),
        session: SessionId::NONE,
        description: String::new(),
        period: Some(Duration::from_millis(4)),
    };
    let (slow, fast) = (bench.0.load(slow).unwrap(), bench.load(ENDLESS));
    let error = bench.0.prepare_start(&[fast, slow], "").unwrap_err();
    assert!(error.to_string().contains("one period"), "{error}");
    let start = bench.0.prepare_start(&[slow], "").unwrap();
    assert_eq!(start.period(), Duration::from_millis(4));
    let twice = bench.0.prepare_start(&[slow], "").unwrap_err().to_string();
    assert!(twice.contains("waits for another start already"), "{twice}");
}
