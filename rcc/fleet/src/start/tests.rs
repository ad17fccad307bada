//! Coordinated starts: each refusal, each way out, and what must never happen in thousands of histories.

use takt_core::Nanos;
use takt_core::tai::{FreeCause, Tai, TaiState};

use super::participant::{Output, Participant, Readiness, ReleaseCause};
use super::simulator::{Report, Weather, World};
use super::{
    AHEAD_MAX, Armed, Beat, Commit, DECISION, GUARD, Goal, Initiator, Member, OVER, Outcome,
    PARTNERS_MAX, Prepare, REPLY_TIMEOUT, RESERVATION, Ready, Refusal, SILENCE, TRANSACTIONS_MAX,
};
use crate::command::{Boot, Nonce, Txn};

const TXN: Txn = Txn(7);
const BOOT: Boot = Boot(1);
const MS: i64 = 1_000_000;
/// `CLOCK_MONOTONIC` of the participant at first, and TAI minus it.
const NOW: Nanos = Nanos(5_000 * MS);
const OFFSET: Nanos = Nanos(1_000_000 * MS);

fn tai(state: TaiState) -> Tai {
    Tai {
        state,
        cause: FreeCause::Unsynchronised,
        at: NOW,
        offset: OFFSET,
        uncertainty: Nanos(1_000),
        tai_utc_s: 37,
    }
}

fn readiness() -> Readiness {
    Readiness {
        tai: tai(TaiState::Locked),
        period: Nanos(MS),
        lead: Nanos(50 * MS),
    }
}

fn cell() -> Participant {
    let mut count = 100;
    Participant::new(
        "a",
        BOOT,
        "host",
        Box::new(move || {
            count += 1;
            count
        }),
    )
}

fn request(txn: Txn) -> Prepare {
    Prepare {
        txn,
        boot: BOOT,
        partners: vec!["a".to_owned(), "b".to_owned()],
        session: 1,
        nonce: Nonce(1),
        nets: vec!["rpinet0".to_owned()],
        clock: None,
    }
}

/// A start that long after [`NOW`].
fn commit(ready: &Ready, ahead: Nanos) -> Commit {
    let start_tai_ns = (NOW + ahead + OFFSET).0;
    Commit {
        txn: ready.txn,
        boot: BOOT,
        start_tai_ns,
        nonces: vec![ready.nonce, Nonce(9)],
    }
}

fn arm(commit: &Commit) -> Armed {
    let Commit {
        txn,
        start_tai_ns,
        nonces,
        ..
    } = commit.clone();
    Armed {
        txn,
        cell: "b".to_owned(),
        start_tai_ns,
        nonces,
    }
}

const AHEAD: Nanos = Nanos(400 * MS);

/// A participant that has committed.
fn committed() -> (Participant, Commit) {
    let mut cell = cell();
    let ready = cell.prepare(&request(TXN), &readiness(), NOW).unwrap();
    let commit = commit(&ready, AHEAD);
    cell.commit(&commit, &tai(TaiState::Locked), NOW).unwrap();
    (cell, commit)
}

/// A participant whose net was handed over.
fn running() -> (Participant, Commit, Nanos) {
    let (mut cell, commit) = committed();
    cell.armed(&arm(&commit));
    let start = NOW + AHEAD;
    let output = cell.poll(&tai(TaiState::Locked), start - DECISION);
    assert_eq!(
        output,
        Some(Output::Begin {
            txn: TXN,
            at: start
        })
    );
    (cell, commit, start)
}

fn released(cell: &mut Participant, tai: &Tai, now: Nanos) -> Option<ReleaseCause> {
    match cell.poll(tai, now) {
        Some(Output::Release { cause, .. }) => Some(cause),
        Some(Output::Begin { .. } | Output::PartnerLost { .. }) | None => None,
    }
}

#[test]
fn prepare_repeated_returns_same_permission() {
    let mut cell = cell();
    let first = cell.prepare(&request(TXN), &readiness(), NOW).unwrap();
    let later = NOW + Nanos(MS);
    assert_eq!(
        cell.prepare(&request(TXN), &readiness(), later).unwrap(),
        first
    );
    let expires = cell.poll_timeout().unwrap();
    assert_eq!(
        expires,
        NOW + RESERVATION + Nanos(1),
        "a repeated request extends nothing"
    );
}

#[test]
fn prepare_unfit_is_refused_by_cause() {
    let mut cell = cell();
    let with = |change: &dyn Fn(&mut Prepare)| {
        let mut request = request(TXN);
        change(&mut request);
        request
    };
    let other = with(&|it| it.boot = Boot(2));
    assert_eq!(
        cell.prepare(&other, &readiness(), NOW),
        Err(Refusal::OtherBoot)
    );
    let names = |names: &[&str]| names.iter().map(ToString::to_string).collect::<Vec<_>>();
    let many = (0..PARTNERS_MAX)
        .map(|it| it.to_string())
        .chain(["a".to_owned()])
        .collect();
    for partners in [
        names(&["b", "c"]),
        names(&["a"]),
        names(&["a", "b", "b"]),
        names(&[]),
        many,
    ] {
        let request = with(&|it| it.partners.clone_from(&partners));
        let refused = cell.prepare(&request, &readiness(), NOW);
        assert!(
            matches!(refused, Err(Refusal::Partners { .. })),
            "{partners:?}"
        );
    }
    let free = Readiness {
        tai: tai(TaiState::Free),
        ..readiness()
    };
    assert!(matches!(
        cell.prepare(&request(TXN), &free, NOW),
        Err(Refusal::Clock { .. })
    ));
    let mut vague = readiness();
    vague.tai.uncertainty = Nanos(MS / 4 + 1);
    assert!(matches!(
        cell.prepare(&request(TXN), &vague, NOW),
        Err(Refusal::Uncertain { .. })
    ));
    let holdover = Readiness {
        tai: tai(TaiState::Holdover),
        ..readiness()
    };
    assert!(cell.prepare(&request(TXN), &holdover, NOW).is_ok());
}

#[test]
fn prepare_beyond_bound_is_refused() {
    let mut cell = cell();
    for txn in 0..TRANSACTIONS_MAX as u128 {
        cell.prepare(&request(Txn(txn)), &readiness(), NOW).unwrap();
    }
    let refused = cell.prepare(&request(Txn(99)), &readiness(), NOW);
    assert!(matches!(refused, Err(Refusal::TooMany { .. })));
    cell.ended(Txn(3));
    assert!(cell.prepare(&request(Txn(99)), &readiness(), NOW).is_ok());
}

#[test]
fn reservation_without_commit_expires() {
    let mut cell = cell();
    let ready = cell.prepare(&request(TXN), &readiness(), NOW).unwrap();
    let locked = tai(TaiState::Locked);
    assert_eq!(cell.poll(&locked, NOW + RESERVATION), None);
    let late = NOW + RESERVATION + Nanos(1);
    let refused = cell.commit(
        &commit(&ready, RESERVATION + Nanos(200 * MS)),
        &locked,
        late,
    );
    assert!(
        matches!(refused, Err(Refusal::Unknown { .. })),
        "before it is polled, too"
    );
    assert_eq!(
        released(&mut cell, &locked, late),
        Some(ReleaseCause::Expired)
    );
    assert_eq!(cell.poll_timeout(), None);
}

#[test]
fn commit_wrong_in_one_field_is_refused() {
    type Change = fn(&mut Commit);
    type Check = fn(&Refusal) -> bool;
    let late: Change = |it| it.start_tai_ns = (NOW + GUARD + OFFSET).0 - MS;
    let far: Change = |it| it.start_tai_ns = (NOW + AHEAD_MAX + OFFSET).0 + MS;
    let cases: [(Change, Check); 8] = [
        (|it| it.boot = Boot(2), |it| *it == Refusal::OtherBoot),
        (
            |it| it.txn = Txn(8),
            |it| matches!(it, Refusal::Unknown { .. }),
        ),
        (
            |it| it.nonces[0] = Nonce(1),
            |it| matches!(it, Refusal::Nonce { .. }),
        ),
        (
            |it| it.nonces.truncate(1),
            |it| matches!(it, Refusal::Nonce { .. }),
        ),
        (
            |it| it.start_tai_ns += 1,
            |it| matches!(it, Refusal::Grid { .. }),
        ),
        (late, |it| matches!(it, Refusal::Late { .. })),
        (far, |it| matches!(it, Refusal::Ahead { .. })),
        (
            |it| it.start_tai_ns = i64::MIN,
            |it| matches!(it, Refusal::Late { .. }),
        ),
    ];
    for (number, (change, is_wanted)) in cases.into_iter().enumerate() {
        let mut cell = cell();
        let ready = cell.prepare(&request(TXN), &readiness(), NOW).unwrap();
        let mut commit = commit(&ready, AHEAD);
        let good = commit.clone();
        change(&mut commit);
        let refused = cell
            .commit(&commit, &tai(TaiState::Locked), NOW)
            .unwrap_err();
        assert!(is_wanted(&refused), "{number}: {refused:?}");
        // It has changed nothing.
        assert!(
            cell.commit(&good, &tai(TaiState::Locked), NOW).is_ok(),
            "{number}"
        );
    }
    let mut cell = cell();
    let ready = cell.prepare(&request(TXN), &readiness(), NOW).unwrap();
    let refused = cell.commit(&commit(&ready, AHEAD), &tai(TaiState::Free), NOW);
    assert!(matches!(refused, Err(Refusal::Clock { .. })));
}

#[test]
fn commit_repeated_arms_again_another_is_refused() {
    let (mut cell, commit) = committed();
    let locked = tai(TaiState::Locked);
    let again = cell.commit(&commit, &locked, NOW).unwrap();
    assert_eq!(
        again,
        Armed {
            cell: "a".to_owned(),
            ..arm(&commit)
        }
    );
    let other = Commit {
        start_tai_ns: commit.start_tai_ns + MS,
        ..commit
    };
    assert_eq!(cell.commit(&other, &locked, NOW), Err(Refusal::Prepared));
    assert_eq!(
        cell.prepare(&request(TXN), &readiness(), NOW),
        Err(Refusal::Prepared)
    );
}

#[test]
fn start_with_all_armed_begins_at_instant() {
    let (mut cell, commit) = committed();
    cell.armed(&arm(&commit));
    let start = NOW + AHEAD;
    let locked = tai(TaiState::Locked);
    assert_eq!(cell.poll_timeout(), Some(start - DECISION));
    assert_eq!(cell.poll(&locked, start - DECISION - Nanos(1)), None);
    let output = cell.poll(&locked, start - DECISION);
    assert_eq!(
        output,
        Some(Output::Begin {
            txn: TXN,
            at: start
        })
    );
    assert_eq!(
        cell.abort(TXN),
        None,
        "a net that was handed over is cancelled as any other"
    );
}

#[test]
fn start_not_armed_stalled_or_stepped_is_released() {
    let locked = tai(TaiState::Locked);
    let stepped = Tai {
        offset: OFFSET + Nanos(101_000),
        ..locked
    };
    let slewed = Tai {
        offset: OFFSET + Nanos(99_000),
        ..locked
    };
    let decision = NOW + AHEAD - DECISION;
    let stalled = NOW + AHEAD - Nanos(4 * MS);
    type Case = (bool, Tai, Nanos, Option<ReleaseCause>);
    let cases: [Case; 5] = [
        (false, locked, decision, Some(ReleaseCause::NotArmed)),
        (
            true,
            tai(TaiState::Free),
            decision,
            Some(ReleaseCause::Clock),
        ),
        (true, stepped, decision, Some(ReleaseCause::Clock)),
        (true, locked, stalled, Some(ReleaseCause::Stalled)),
        (true, slewed, decision, None),
    ];
    for (is_armed, tai, now, wanted) in cases {
        let (mut cell, commit) = committed();
        if is_armed {
            cell.armed(&arm(&commit));
        }
        assert_eq!(released(&mut cell, &tai, now), wanted, "{is_armed} {tai:?}");
    }
    let (mut cell, _) = committed();
    let cause = ReleaseCause::Aborted;
    assert_eq!(cell.abort(TXN), Some(Output::Release { txn: TXN, cause }));
    assert_eq!(cell.abort(TXN), None);
}

#[test]
fn arm_for_another_start_has_no_effect() {
    type Change = fn(&mut Armed);
    let cases: [Change; 5] = [
        |it| it.txn = Txn(8),
        |it| it.cell = "c".to_owned(),
        |it| it.start_tai_ns += MS,
        |it| it.nonces[1] = Nonce(10),
        |it| it.nonces.clear(),
    ];
    for change in cases {
        let (mut cell, commit) = committed();
        let mut armed = arm(&commit);
        change(&mut armed);
        cell.armed(&armed);
        let cause = released(&mut cell, &tai(TaiState::Locked), NOW + AHEAD - DECISION);
        assert_eq!(cause, Some(ReleaseCause::NotArmed), "{armed:?}");
    }
}

#[test]
fn partner_silent_is_lost_once_and_for_good() {
    let (mut cell, commit, start) = running();
    let locked = tai(TaiState::Locked);
    let beat = |nonce| Beat {
        txn: TXN,
        cell: "b".to_owned(),
        nonce,
        over: false,
    };
    cell.beat(&beat(commit.nonces[1]), start + Nanos(90 * MS));
    assert_eq!(cell.poll(&locked, start + SILENCE + Nanos(MS)), None);
    // One of another start does not count.
    cell.beat(&beat(Nonce(1)), start + Nanos(150 * MS));
    let late = start + Nanos(90 * MS) + SILENCE + Nanos(1);
    let lost = Output::PartnerLost {
        txn: TXN,
        cell: "b".to_owned(),
    };
    assert_eq!(cell.poll(&locked, late), Some(lost));
    cell.beat(&beat(commit.nonces[1]), late);
    assert_eq!(cell.poll(&locked, late + SILENCE + SILENCE), None);
    assert_eq!(cell.beats().len(), 1, "it runs until its net has ended");
    cell.ended(TXN);
    assert!(cell.beats().is_empty() && cell.poll_timeout().is_none());
}

#[test]
fn cells_of_one_host_need_no_time_service() {
    let free = Readiness {
        tai: tai(TaiState::Free),
        ..readiness()
    };
    let on = |clock: &str| Prepare {
        clock: Some(clock.to_owned()),
        ..request(TXN)
    };
    for other in ["", "another host"] {
        let refused = cell().prepare(&on(other), &free, NOW);
        assert!(
            matches!(refused, Err(Refusal::OtherClock { .. })),
            "{other}"
        );
    }
    let mut cell = cell();
    let ready = cell.prepare(&on("host"), &free, NOW).unwrap();
    let commit = commit(&ready, AHEAD);
    let armed = cell.commit(&commit, &free.tai, NOW).unwrap();
    assert_eq!(cell.arms(), [armed]);
    cell.armed(&arm(&commit));
    // A step of the clock releases it all the same: the instant was another before.
    let stepped = Tai {
        offset: OFFSET + Nanos(101_000),
        ..free.tai
    };
    let decision = NOW + AHEAD - DECISION;
    assert_eq!(
        released(&mut cell, &stepped, decision),
        Some(ReleaseCause::Clock)
    );
}

#[test]
fn partner_whose_nets_ended_is_not_lost() {
    let (mut cell, commit, start) = running();
    let locked = tai(TaiState::Locked);
    let over = Beat {
        txn: TXN,
        cell: "b".to_owned(),
        nonce: commit.nonces[1],
        over: true,
    };
    cell.beat(&over, start + Nanos(50 * MS));
    let late = start + SILENCE + SILENCE;
    assert_eq!(cell.poll(&locked, late), None);
    // It says so itself for a while, then forgets the start.
    cell.over(TXN, late);
    assert!(cell.beats()[0].over && cell.knows(TXN));
    assert_eq!(cell.abort(TXN), None, "there is nothing to be released");
    assert_eq!(cell.poll(&locked, late + OVER), None);
    assert!(cell.knows(TXN));
    assert_eq!(cell.poll(&locked, late + OVER + Nanos(1)), None);
    assert!(!cell.knows(TXN) && cell.beats().is_empty());
}

#[test]
fn messages_survive_json() {
    let (_, commit) = committed();
    let armed = arm(&commit);
    let text = crate::command::to_json(&armed);
    assert_eq!(serde_json::from_str::<Armed>(&text).unwrap(), armed);
    assert!(serde_json::from_str::<Armed>(&text.replacen('{', "{\"more\":1,", 1)).is_err());
    let text = crate::command::to_json(&request(TXN));
    assert_eq!(
        serde_json::from_str::<Prepare>(&text).unwrap(),
        request(TXN)
    );
}

/// An initiator of two members whose prepare was sent.
fn initiator() -> Initiator {
    let member = |cell: &str| Member {
        cell: cell.to_owned(),
        boot: BOOT,
        clock: String::new(),
        session: 1,
        nonce: Nonce(1),
        nets: vec!["rpinet0".to_owned()],
    };
    let members = vec![member("a"), member("b")];
    let mut initiator = Initiator::new(TXN, members, Nanos::ZERO, NOW);
    for place in 0..2 {
        assert!(matches!(initiator.poll(NOW), Some(Goal::Prepare(at, _)) if at == place));
    }
    assert_eq!(initiator.poll(NOW), None);
    initiator
}

/// TAI of the participants at their replies.
const TAI: i64 = 1_000_000_001;

fn ready(nonce: u128, period_ms: i64, lead_ms: i64, tai_utc_s: i32) -> Ready {
    Ready {
        txn: TXN,
        nonce: Nonce(nonce),
        period_ns: period_ms * MS,
        lead_ns: lead_ms * MS,
        uncertainty_ns: 0,
        tai_utc_s,
        tai_ns: TAI,
    }
}

fn end(initiator: &mut Initiator, now: Nanos) -> (usize, Option<Outcome>) {
    let mut aborts = 0;
    while let Some(goal) = initiator.poll(now) {
        match goal {
            Goal::Abort(_) => aborts += 1,
            Goal::Finished(outcome) => return (aborts, Some(outcome)),
            Goal::Prepare(..) | Goal::Commit(..) => {}
        }
    }
    (aborts, None)
}

#[test]
fn initiator_chooses_multiple_of_all_periods_beyond_all_leads() {
    let mut initiator = initiator();
    initiator.handle_ready(0, Ok(ready(1, 4, 50, 37)), NOW);
    initiator.handle_ready(1, Ok(ready(2, 6, 700, 37)), NOW);
    let later = NOW + Nanos(7 * MS);
    let Some(Goal::Commit(0, commit)) = initiator.poll(later) else {
        panic!("no commit")
    };
    assert_eq!(commit.start_tai_ns % (12 * MS), 0);
    let ahead = commit.start_tai_ns - TAI - 7 * MS;
    assert!((700 * MS..712 * MS).contains(&ahead), "{ahead}");
    assert_eq!(commit.nonces, [Nonce(1), Nonce(2)]);
    assert!(matches!(initiator.poll(NOW), Some(Goal::Commit(1, _))));
    initiator.handle_armed(0, Ok(()));
    assert_eq!(initiator.poll(NOW), None);
    initiator.handle_armed(1, Ok(()));
    let start_tai_ns = commit.start_tai_ns;
    let armed = Outcome::Armed { start_tai_ns };
    assert_eq!(end(&mut initiator, NOW), (0, Some(armed)));
    assert_eq!(initiator.poll(NOW), None);
}

#[test]
fn initiator_refused_silent_or_mismatched_aborts_all() {
    let late = NOW + REPLY_TIMEOUT + Nanos(1);
    let mut silent = initiator();
    silent.handle_ready(0, Ok(ready(1, 1, 1, 37)), NOW);
    assert_eq!(end(&mut silent, NOW + REPLY_TIMEOUT), (0, None));
    let cell = "b".to_owned();
    assert_eq!(
        end(&mut silent, late),
        (2, Some(Outcome::Silent { cell: cell.clone() }))
    );
    let mut refused = initiator();
    refused.handle_ready(1, Err(Refusal::OtherBoot), NOW);
    let why = Refusal::OtherBoot;
    assert_eq!(
        end(&mut refused, NOW),
        (
            2,
            Some(Outcome::Refused {
                cell: cell.clone(),
                why
            })
        )
    );
    let mut armless = initiator();
    armless.handle_ready(0, Ok(ready(1, 1, 1, 37)), NOW);
    armless.handle_ready(1, Ok(ready(2, 1, 1, 37)), NOW);
    assert_eq!(end(&mut armless, NOW), (0, None));
    armless.handle_armed(0, Ok(()));
    assert_eq!(end(&mut armless, late), (2, Some(Outcome::Silent { cell })));
    for other in [
        ready(2, 1, 1, 0),
        ready(2, 0, 1, 37),
        ready(2, 999_983, 1, 37),
        ready(2, -1, 1, 37),
    ] {
        let mut mismatched = initiator();
        mismatched.handle_ready(0, Ok(ready(1, 1, 1, 37)), NOW);
        mismatched.handle_ready(1, Ok(other), NOW);
        let (aborts, outcome) = end(&mut mismatched, NOW);
        assert!(
            aborts == 2 && matches!(outcome, Some(Outcome::Mismatch { .. })),
            "{outcome:?}"
        );
    }
}

const GOOD: Weather = Weather {
    loss: 0,
    repeat: 0,
    delay_ms: 5,
    reboot: 0,
    step: 0,
    split: 0,
};
const BAD: Weather = Weather {
    loss: 10,
    repeat: 20,
    delay_ms: 60,
    reboot: 30,
    step: 10,
    split: 30,
};
/// Delays after which replies arrive just in time, restarts, and many repetitions.
const WORST: Weather = Weather {
    loss: 5,
    repeat: 60,
    delay_ms: 250,
    reboot: 200,
    step: 5,
    split: 10,
};

/// Many histories; more of them with a larger range: a million takes hours in a debug build.
fn histories(seeds: std::ops::Range<u64>, weather: Weather, ignores_arms: bool) -> Report {
    let mut sum = Report::default();
    for seed in seeds {
        let report = World::new(seed, weather, ignores_arms).run(ignores_arms);
        sum.violations.extend(
            report
                .violations
                .into_iter()
                .map(|it| format!("seed {seed}: {it}")),
        );
        sum.all += report.all;
        sum.some += report.some;
        sum.none += report.none;
    }
    sum
}

#[test]
fn start_on_good_network_begins_everywhere_at_instant() {
    let report = histories(0..60, GOOD, false);
    assert!(
        report.violations.is_empty(),
        "{:?}",
        report.violations.first()
    );
    assert_eq!((report.all, report.some, report.none), (60, 0, 0));
}

#[test]
fn start_on_bad_network_never_begins_without_all_armed() {
    for weather in [BAD, WORST] {
        let report = histories(0..120, weather, false);
        assert!(
            report.violations.is_empty(),
            "{:?}",
            report.violations.first()
        );
        assert!(report.all > 10 && report.none > 10, "{report:?}");
    }
}

#[test]
fn start_without_wait_for_arms_is_caught() {
    let report = histories(0..2000, WORST, true);
    assert!(
        !report.violations.is_empty(),
        "the simulator finds no fault that was put in"
    );
}
