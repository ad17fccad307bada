//! Every phase of a start with every input.

#![expect(clippy::wildcard_enum_match_arm, reason = "tables of the exceptions")]

use super::*;
use crate::canopen::NodeId;
use crate::canopen::network::Supervision;

const MS: Duration = Duration::from_millis(1);
const NOW: Duration = Duration::from_millis(1000);
const PHASES: [Phase; 8] = [
    Phase::Off,
    Phase::Resetting,
    Phase::Checking(0),
    Phase::Configuring {
        at: 0,
        reading: false,
    },
    Phase::Configuring {
        at: 0,
        reading: true,
    },
    Phase::Starting,
    Phase::Running,
    Phase::Failed,
];

/// Start procedure of a node of type 402 with two values, the first one verified.
fn startup(phase: Phase) -> Startup {
    let mut plan = NodePlan::new(NodeId::new(5).unwrap());
    plan.device_type = Some(402);
    plan.identity = [None, Some(7), None, None];
    let mut second = Download::new(0x2001, 0, &[2]);
    second.verify = false;
    let downloads = vec![Download::new(0x2000, 0, &[1]), second];
    let mut startup = Startup::new(&plan, downloads, (100 * MS, 500 * MS));
    (startup.phase, startup.since) = (phase, NOW);
    startup
}

const RESET: Action = Action::Command(NmtCommand::ResetCommunication);
const START: Action = Action::Command(NmtCommand::Start);
const STOP: Action = Action::Command(NmtCommand::Stop);
const TYPE: Address = Address::new(0x1000, 0);
const PRODUCT: Address = Address::new(0x1018, 2);
const FIRST: Address = Address::new(0x2000, 0);

#[test]
fn startup_reaches_running() {
    let mut s = startup(Phase::Off);
    assert_eq!(s.begin(NOW), RESET);
    assert_eq!(s.handle_state(NmtState::BootUp, NOW), Action::Read(TYPE));
    assert_eq!(
        s.handle_answer(Answer::Value(&[0x92, 1, 0, 0]), NOW),
        Action::Read(PRODUCT)
    );
    assert_eq!(
        s.handle_answer(Answer::Value(&[7, 0, 0, 0]), NOW),
        Action::Write(0)
    );
    assert_eq!(s.handle_answer(Answer::Written, NOW), Action::Read(FIRST));
    assert_eq!(s.handle_answer(Answer::Value(&[1]), NOW), Action::Write(1));
    assert_eq!(s.handle_answer(Answer::Written, NOW), START);
    assert_eq!(s.handle_state(NmtState::PreOperational, NOW), Action::None);
    assert_eq!(s.handle_state(NmtState::Operational, NOW), Action::None);
    assert_eq!((s.phase(), s.fault()), (Phase::Running, None));
}

#[test]
fn startup_boot_up_message_in_every_phase() {
    for phase in PHASES {
        let mut s = startup(phase);
        let action = s.handle_state(NmtState::BootUp, NOW);
        let (expected, fault) = match phase {
            Phase::Off => (Action::None, None),
            Phase::Resetting | Phase::Checking(_) | Phase::Failed => (Action::Read(TYPE), None),
            _ => (Action::Read(TYPE), Some(NodeFault::Restarted)),
        };
        assert_eq!((action, s.fault()), (expected, fault), "{phase:?}");
    }
}

#[test]
fn startup_every_reported_state_in_every_phase() {
    let states = [
        NmtState::Stopped,
        NmtState::Operational,
        NmtState::PreOperational,
        NmtState::Other(3),
    ];
    for phase in PHASES {
        for state in states {
            let mut s = startup(phase);
            let operational = state == NmtState::Operational;
            let action = match phase {
                Phase::Running if !operational => STOP,
                _ => Action::None,
            };
            assert_eq!(s.handle_state(state, NOW), action, "{phase:?} {state}");
            let expected = match phase {
                Phase::Starting if operational => Phase::Running,
                Phase::Running if !operational => Phase::Failed,
                _ => phase,
            };
            assert_eq!(s.phase(), expected, "{phase:?} {state}");
        }
    }
    let mut late = startup(Phase::Starting);
    late.handle_state(NmtState::PreOperational, NOW + 100 * MS);
    let fault = NodeFault::NotStarted(NmtState::PreOperational);
    assert_eq!(late.fault(), Some(fault));
}

#[test]
fn startup_every_answer_in_every_phase() {
    let refused = AbortCode::NoObject;
    for phase in PHASES {
        let address = match phase {
            Phase::Checking(_) => Some(TYPE),
            Phase::Configuring { .. } => Some(FIRST),
            _ => None,
        };
        let mut s = startup(phase);
        s.handle_answer(Answer::Refused(refused), NOW);
        let code = refused;
        assert_eq!(
            s.fault(),
            address.map(|address| NodeFault::Refused { address, code })
        );
        let mut s = startup(phase);
        s.handle_answer(Answer::Silent, NOW);
        assert_eq!(s.fault(), address.map(NodeFault::Silent), "{phase:?}");
        let mut s = startup(phase);
        s.handle_answer(Answer::Value(&[9]), NOW);
        let wrong = NodeFault::WrongDevice {
            address: TYPE,
            expected: 402,
            found: 9,
        };
        let expected = match phase {
            Phase::Checking(_) => Some(wrong),
            Phase::Configuring { .. } => Some(NodeFault::NotTaken(FIRST)),
            _ => None,
        };
        assert_eq!(s.fault(), expected, "{phase:?}");
        let failed = if expected.is_some() {
            Phase::Failed
        } else {
            phase
        };
        assert_eq!(s.phase(), failed, "{phase:?}");
    }
}

#[test]
fn startup_timeout_in_every_phase() {
    for (phase, ms, expected, fault) in [
        (Phase::Resetting, 99, Action::None, None),
        (
            Phase::Resetting,
            100,
            Action::None,
            Some(NodeFault::NoBootUp(100 * MS)),
        ),
        (Phase::Starting, 199, Action::None, None),
        (
            Phase::Starting,
            200,
            STOP,
            Some(NodeFault::NoHeartbeat(200 * MS)),
        ),
        (Phase::Failed, 499, Action::None, None),
        (Phase::Failed, 500, RESET, None),
        (Phase::Off, 9000, Action::None, None),
        (Phase::Checking(0), 9000, Action::None, None),
        (Phase::Running, 9000, Action::None, None),
    ] {
        let mut s = startup(phase);
        assert_eq!(s.poll(NOW + ms * MS), expected, "{phase:?} {ms}");
        assert_eq!(s.fault(), fault, "{phase:?} {ms}");
    }
    let mut plan = NodePlan::new(NodeId::new(5).unwrap());
    plan.supervision = Supervision::None;
    let mut unwatched = Startup::new(&plan, vec![], (100 * MS, 500 * MS));
    unwatched.begin(NOW);
    assert_eq!(
        unwatched.handle_state(NmtState::BootUp, NOW),
        START,
        "nothing to check or to write"
    );
    unwatched.poll(NOW);
    assert_eq!(unwatched.phase(), Phase::Running);
}

#[test]
fn startup_failure_stops_only_started_node() {
    for phase in PHASES {
        let mut s = startup(phase);
        let expected = match phase {
            Phase::Starting | Phase::Running => STOP,
            _ => Action::None,
        };
        let lost = NodeFault::HeartbeatLost(250 * MS);
        assert_eq!(s.fail(lost, NOW), expected, "{phase:?}");
        assert_eq!((s.phase(), s.fault()), (Phase::Failed, Some(lost)));
    }
}

#[test]
fn startup_missing_optional_object_is_skipped() {
    let configuring = Phase::Configuring {
        at: 0,
        reading: false,
    };
    for (code, passed) in [
        (AbortCode::NoObject, true),
        (AbortCode::NoSubIndex, true),
        (AbortCode::ReadOnly, false),
    ] {
        let mut s = startup(configuring);
        s.downloads[0] = s.downloads[0].clone().where_present();
        let action = s.handle_answer(Answer::Refused(code), NOW);
        let failed = NodeFault::Refused {
            address: FIRST,
            code,
        };
        let expected = if passed {
            (Action::Write(1), None)
        } else {
            (Action::None, Some(failed))
        };
        assert_eq!((action, s.fault()), expected, "{code:?}");
    }
}
