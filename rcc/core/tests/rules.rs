//! Succession of nets: synchronization rules, takeover, resources kept for successors, and no gap
//! between predecessor and successor. No devices; arms are in `arms.rs`.

#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

use std::time::{Duration, Instant};

use takt_core::controller::{LoadRequest, NetState, RuleId, RuleRequest, RuleState};
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
