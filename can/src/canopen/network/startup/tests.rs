//! Every phase of a start with every input.

#![expect(
    clippy::wildcard_enum_match_arm,
    reason = "tables of what differs from the rest"
)]

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

/// A start of a node of type 402 with two values, the first of them read back.
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
fn the_way_up() {
    let mut s = startup(Phase::Off);
    assert_eq!(s.begin(NOW), RESET);
    assert_eq!(s.said(NmtState::BootUp, NOW), Action::Read(TYPE));
    assert_eq!(
        s.answered(Answer::Value(&[0x92, 1, 0, 0]), NOW),
        Action::Read(PRODUCT)
    );
    assert_eq!(
        s.answered(Answer::Value(&[7, 0, 0, 0]), NOW),
        Action::Write(0)
    );
    assert_eq!(s.answered(Answer::Written, NOW), Action::Read(FIRST));
    assert_eq!(s.answered(Answer::Value(&[1]), NOW), Action::Write(1));
    assert_eq!(s.answered(Answer::Written, NOW), START);
    assert_eq!(s.said(NmtState::PreOperational, NOW), Action::None);
    assert_eq!(s.said(NmtState::Operational, NOW), Action::None);
    assert_eq!((s.phase(), s.trouble()), (Phase::Running, None));
}

#[test]
fn a_boot_up_message_in_every_phase() {
    for phase in PHASES {
        let mut s = startup(phase);
        let action = s.said(NmtState::BootUp, NOW);
        let (expected, trouble) = match phase {
            Phase::Off => (Action::None, None),
            Phase::Resetting | Phase::Checking(_) | Phase::Failed => (Action::Read(TYPE), None),
            _ => (Action::Read(TYPE), Some(Trouble::Restarted)),
        };
        assert_eq!((action, s.trouble()), (expected, trouble), "{phase:?}");
    }
}

#[test]
fn every_state_that_a_node_can_say_in_every_phase() {
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
            assert_eq!(s.said(state, NOW), action, "{phase:?} {state}");
            let expected = match phase {
                Phase::Starting if operational => Phase::Running,
                Phase::Running if !operational => Phase::Failed,
                _ => phase,
            };
            assert_eq!(s.phase(), expected, "{phase:?} {state}");
        }
    }
    let mut late = startup(Phase::Starting);
    late.said(NmtState::PreOperational, NOW + 100 * MS);
    let trouble = Trouble::NotStarted(NmtState::PreOperational);
    assert_eq!(late.trouble(), Some(trouble));
}

#[test]
fn every_answer_in_every_phase() {
    let refused = AbortCode::NoObject;
    for phase in PHASES {
        let address = match phase {
            Phase::Checking(_) => Some(TYPE),
            Phase::Configuring { .. } => Some(FIRST),
            _ => None,
        };
        let mut s = startup(phase);
        s.answered(Answer::Refused(refused), NOW);
        let code = refused;
        assert_eq!(
            s.trouble(),
            address.map(|address| Trouble::Refused { address, code })
        );
        let mut s = startup(phase);
        s.answered(Answer::Silent, NOW);
        assert_eq!(s.trouble(), address.map(Trouble::Silent), "{phase:?}");
        let mut s = startup(phase);
        s.answered(Answer::Value(&[9]), NOW);
        let wrong = Trouble::WrongDevice {
            address: TYPE,
            expected: 402,
            found: 9,
        };
        let expected = match phase {
            Phase::Checking(_) => Some(wrong),
            Phase::Configuring { .. } => Some(Trouble::NotTaken(FIRST)),
            _ => None,
        };
        assert_eq!(s.trouble(), expected, "{phase:?}");
        let failed = if expected.is_some() {
            Phase::Failed
        } else {
            phase
        };
        assert_eq!(s.phase(), failed, "{phase:?}");
    }
}

#[test]
fn time_in_every_phase() {
    for (phase, ms, expected, trouble) in [
        (Phase::Resetting, 99, Action::None, None),
        (
            Phase::Resetting,
            100,
            Action::None,
            Some(Trouble::NoBootUp(100 * MS)),
        ),
        (Phase::Starting, 199, Action::None, None),
        (
            Phase::Starting,
            200,
            STOP,
            Some(Trouble::NoHeartbeat(200 * MS)),
        ),
        (Phase::Failed, 499, Action::None, None),
        (Phase::Failed, 500, RESET, None),
        (Phase::Off, 9000, Action::None, None),
        (Phase::Checking(0), 9000, Action::None, None),
        (Phase::Running, 9000, Action::None, None),
    ] {
        let mut s = startup(phase);
        assert_eq!(s.poll(NOW + ms * MS), expected, "{phase:?} {ms}");
        assert_eq!(s.trouble(), trouble, "{phase:?} {ms}");
    }
    let mut plan = NodePlan::new(NodeId::new(5).unwrap());
    plan.supervision = Supervision::None;
    let mut unwatched = Startup::new(&plan, vec![], (100 * MS, 500 * MS));
    unwatched.begin(NOW);
    assert_eq!(
        unwatched.said(NmtState::BootUp, NOW),
        START,
        "nothing to check or to write"
    );
    unwatched.poll(NOW);
    assert_eq!(unwatched.phase(), Phase::Running);
}

#[test]
fn only_what_was_started_is_stopped_when_it_fails() {
    for phase in PHASES {
        let mut s = startup(phase);
        let expected = match phase {
            Phase::Starting | Phase::Running => STOP,
            _ => Action::None,
        };
        let lost = Trouble::HeartbeatLost(250 * MS);
        assert_eq!(s.fail(lost, NOW), expected, "{phase:?}");
        assert_eq!((s.phase(), s.trouble()), (Phase::Failed, Some(lost)));
    }
}

#[test]
fn an_object_that_a_device_may_lack_is_passed_over() {
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
        let action = s.answered(Answer::Refused(code), NOW);
        let failed = Trouble::Refused {
            address: FIRST,
            code,
        };
        let expected = if passed {
            (Action::Write(1), None)
        } else {
            (Action::None, Some(failed))
        };
        assert_eq!((action, s.trouble()), expected, "{code:?}");
    }
}
