//! Each verdict from figures, and each from datagrams that go wrong in one way.

use super::*;

const PERIOD: Duration = Duration::from_millis(2);
const US: Duration = Duration::from_micros(1);

fn good() -> Observed {
    Observed {
        period: PERIOD,
        measurements: 1_000,
        answers: 1_000,
        acknowledged: 999,
        answer_time_max: US * 40,
        arrival_jitter: US * 20,
        stamp_jitter: Some(US),
        answer_rate: Some(1.0),
        is_good: true,
        ..Observed::default()
    }
}

#[test]
#[expect(clippy::too_many_lines, reason = "a table")]
fn verdict_has_figures_and_remedy() {
    let cases: [(Observed, Verdict, &str); 21] = [
        (good(), Verdict::Good, "good"),
        (
            Observed {
                measurements: 0,
                ..good()
            },
            Verdict::Silent,
            "no measurement received",
        ),
        (
            Observed {
                measurements: 99,
                ..good()
            },
            Verdict::TooFew { measurements: 99 },
            "only 99 measurements received",
        ),
        (
            Observed {
                answers: 0,
                late: 1_000,
                ..good()
            },
            Verdict::Unanswered,
            "no client answers the controller",
        ),
        (
            Observed {
                foreign: 500,
                late: 500,
                ..good()
            },
            Verdict::SecondClient { foreign: 0.5 },
            "another client answers the controller too: 50.0 % of the answers it received",
        ),
        (
            Observed {
                acknowledged: 0,
                answer_rate: Some(0.0),
                is_good: false,
                ..good()
            },
            Verdict::NotReceived,
            "the controller does not receive this host's answers",
        ),
        (
            Observed {
                late: 6,
                answer_time_max: US * 1_900,
                ..good()
            },
            Verdict::Host {
                late: 0.006,
                worst: US * 1_900,
                wake_up: None,
            },
            "this host answers late: 0.6 % of answers, the worst after 1.9ms",
        ),
        (
            Observed {
                late: 6,
                answer_time_max: US * 1_900,
                wake_up_max: Some(US * 1_800),
                ..good()
            },
            Verdict::Host {
                late: 0.006,
                worst: US * 1_900,
                wake_up: Some(US * 1_800),
            },
            "this host answers late: 0.6 % of answers, the worst after 1.9ms; the driver woke up as late as 1.8ms",
        ),
        (Observed { late: 5, ..good() }, Verdict::Good, "good"),
        (
            Observed {
                unanswered: 250,
                ..good()
            },
            Verdict::Skipped { unanswered: 0.2 },
            "this host leaves 20.0 % of measurements unanswered",
        ),
        (
            Observed {
                overtaken: 32,
                ..good()
            },
            Verdict::NetworkJitter { jitter: US * 20 },
            "the network is irregular: 20.0µs on arrival",
        ),
        (
            Observed {
                period: Duration::from_millis(100),
                measurements: 25,
                answers: 25,
                acknowledged: 24,
                late: 1,
                answer_rate: Some(0.25),
                ..good()
            },
            Verdict::Good,
            "good",
        ),
        (
            Observed {
                period: Duration::from_millis(100),
                measurements: 25,
                answers: 25,
                acknowledged: 24,
                is_good: false,
                ..good()
            },
            Verdict::TooFew { measurements: 25 },
            "only 25 measurements received",
        ),
        (
            Observed {
                acknowledged: 400,
                answer_rate: Some(0.0),
                is_good: false,
                ..good()
            },
            Verdict::NotReceived,
            "the controller does not receive this host's answers",
        ),
        (
            Observed {
                unanswered: 10,
                lost: 50,
                measurements: 950,
                ..good()
            },
            Verdict::NetworkInbound {
                lost: 0.05,
                disordered: 0,
            },
            "the network loses measurements: 5.0 %, 0 out of order",
        ),
        (
            Observed {
                stamp_jitter: Some(US * 500),
                arrival_jitter: US * 500,
                ..good()
            },
            Verdict::Controller { jitter: US * 500 },
            "the controller is irregular: 500.0µs by its own stamps",
        ),
        (
            Observed {
                lost: 10,
                measurements: 990,
                ..good()
            },
            Verdict::NetworkInbound {
                lost: 0.01,
                disordered: 0,
            },
            "the network loses measurements: 1.0 %, 0 out of order",
        ),
        (
            Observed {
                disordered: 6,
                ..good()
            },
            Verdict::NetworkInbound {
                lost: 0.0,
                disordered: 6,
            },
            "the network loses measurements: 0.0 %, 6 out of order",
        ),
        (
            Observed {
                arrival_jitter: US * 500,
                ..good()
            },
            Verdict::NetworkJitter { jitter: US * 500 },
            "the network is irregular: 500.0µs on arrival",
        ),
        (
            Observed {
                answer_rate: Some(0.75),
                ..good()
            },
            Verdict::NetworkOutbound { missing: 0.25 },
            "the network loses answers: 25.0 %",
        ),
        (
            Observed {
                is_good: false,
                answer_rate: None,
                ..good()
            },
            Verdict::Unexplained,
            "all answers in time, but the controller reports insufficient quality",
        ),
    ];
    for (observed, verdict, text) in cases {
        assert_eq!(judge(&observed), verdict);
        assert_eq!(
            (verdict.to_string().as_str(), verdict.is_good()),
            (text, text == "good")
        );
        assert!(!verdict.remedy().is_empty());
    }
}

/// 1000 measurements and their answers after 50 us; `change` spoils number `i` and may drop it or its answer.
fn run(change: impl Fn(u32, &mut Measurement) -> (bool, Option<Duration>)) -> Verdict {
    let mut observer = Observer::sunrise();
    for i in 0..1_000 {
        let at = PERIOD * i;
        let mut measurement = Measurement {
            at,
            sequence: i,
            reflected: i.wrapping_sub(1),
            stamp: Some(at),
            period: PERIOD,
            answer_every: 1,
            answer_rate: None,
            is_good: true,
        };
        let (comes, answered_after) = change(i, &mut measurement);
        if comes {
            observer.handle_measurement(measurement);
        }
        if let Some(after) = answered_after {
            observer.handle_answer(measurement.at + after, i);
        }
    }
    observer.verdict()
}

#[test]
fn observer_finds_each_fault() {
    let soon = Some(US * 50);
    assert_eq!(run(|_, _| (true, soon)), Verdict::Good);
    assert_eq!(run(|_, _| (true, None)), Verdict::Unanswered);
    assert_eq!(run(|_, _| (false, None)), Verdict::Silent);
    let late = run(|i, _| (true, if i % 10 == 0 { Some(US * 1_100) } else { soon }));
    assert_eq!(
        late,
        Verdict::Host {
            late: 0.1,
            worst: US * 1_100,
            wake_up: None,
        }
    );
    let missing = run(|i, _| (true, soon.filter(|_| i % 10 != 5)));
    assert_eq!(missing, Verdict::Skipped { unanswered: 0.1 });
    let lost = run(|i, _| (i % 20 != 7, soon.filter(|_| i % 20 != 7)));
    assert!(
        matches!(lost, Verdict::NetworkInbound { lost, disordered: 0 } if (lost - 0.05).abs() < 1e-9),
        "{lost}"
    );
    let jitter = run(|i, measurement| {
        measurement.at += US * 900 * (i % 2);
        (true, soon)
    });
    assert!(
        matches!(jitter, Verdict::NetworkJitter { jitter } if jitter.abs_diff(US * 900) < US),
        "{jitter}"
    );
    let stamps = run(|i, measurement| {
        measurement.at += US * 900 * (i % 2);
        measurement.stamp = Some(measurement.at);
        (true, soon)
    });
    assert!(matches!(stamps, Verdict::Controller { .. }), "{stamps}");
    let thither = run(|_, measurement| {
        measurement.answer_rate = Some(0.9);
        (true, soon)
    });
    assert!(
        matches!(thither, Verdict::NetworkOutbound { missing } if (missing - 0.1).abs() < 1e-9),
        "{thither}"
    );
}

#[test]
fn observer_reflection_identifies_received_client() {
    let soon = Some(US * 50);
    // Half of the answers suffice.
    let second = run(|i, measurement| {
        if i % 2 == 0 {
            measurement.reflected = 70_000 + i;
        }
        (true, soon)
    });
    assert!(matches!(second, Verdict::SecondClient { .. }), "{second}");
    // It still reflects the last answer of the client before this one.
    let not_received = run(|_, measurement| {
        measurement.reflected = 70_000;
        (true, soon)
    });
    assert_eq!(not_received, Verdict::NotReceived);
    // For a moment only.
    let taken_over = run(|i, measurement| {
        if i < 3 {
            measurement.reflected = 70_000;
        }
        (true, soon)
    });
    assert_eq!(taken_over, Verdict::Good);
}

/// What an observer makes of a client that answers `behind` measurements late, to every `every`-th one, except those
/// that `skips` names.
fn answering(behind: u32, every: u32, skips: impl Fn(u32) -> bool) -> Observed {
    let mut observer = Observer::sunrise();
    let mut answers = 0;
    for i in 0..2_000 {
        let at = PERIOD * i;
        observer.handle_measurement(Measurement {
            at,
            sequence: i,
            reflected: answers,
            stamp: Some(at),
            period: PERIOD,
            answer_every: every,
            answer_rate: None,
            is_good: true,
        });
        if i % every == 0 && i >= behind && !skips(i) {
            answers += 1;
            observer.handle_answer_to(i - behind, at + US * 50, answers);
        }
    }
    observer.observed()
}

#[test]
fn observer_answers_to_old_measurements_are_late() {
    let observed = answering(900, 1, |_| false);
    assert_eq!(observed.behind_max, 900);
    assert_eq!(observed.answer_time_max, PERIOD * 900 + US * 50);
    assert_eq!((observed.late, observed.unanswered), (1_100, 0));
    let verdict = judge(&observed);
    assert!(
        verdict
            .to_string()
            .starts_with("this host answers late: 100.0 % of answers, the worst after 1.8s"),
        "{verdict}"
    );
}

#[test]
fn observer_multiplier_counts_command_periods() {
    let sound = answering(0, 5, |_| false);
    assert_eq!((sound.late, sound.unanswered, sound.answers), (0, 0, 400));
    assert_eq!(judge(&sound), Verdict::Good);
    // One of four command periods without an answer; the first ones belong to the start.
    let skipping = answering(0, 5, |i| i % 20 == 10);
    assert_eq!((skipping.late, skipping.unanswered), (0, 100));
    assert_eq!(judge(&skipping), Verdict::Skipped { unanswered: 0.25 });
}

#[test]
fn observer_zero_counters_prove_no_reception() {
    // A cabinet that receives nothing reflects 0 for ever, which is near the counters of a client that just began.
    for first in [0, 1, 65_500] {
        let mut observer = Observer::lwr();
        for i in 0..1_000 {
            let at = PERIOD * i;
            observer.handle_measurement(Measurement {
                at,
                sequence: i,
                reflected: 0,
                stamp: None,
                period: PERIOD,
                answer_every: 1,
                answer_rate: None,
                is_good: false,
            });
            observer.handle_answer(at + US * 50, (first + i) & 0xffff);
        }
        assert_eq!(observer.observed().acknowledged, 0);
        assert_eq!(observer.verdict(), Verdict::NotReceived);
    }
}

#[test]
fn observer_start_after_controller_has_good_verdict() {
    let verdict = run(|i, _| (true, (i >= 300).then_some(US * 50)));
    assert_eq!(verdict, Verdict::Good);
}

#[test]
fn observer_bursts_are_not_unanswered() {
    // Every 20th measurement is held back until 100 us before the next one.
    let mut observer = Observer::sunrise();
    for i in 0..1_000 {
        let is_held = i % 20 == 7;
        let at = PERIOD * i
            + if is_held {
                PERIOD - US * 100
            } else {
                Duration::ZERO
            };
        observer.handle_measurement(Measurement {
            at,
            sequence: i,
            reflected: i,
            stamp: None,
            period: PERIOD,
            answer_every: 1,
            answer_rate: None,
            is_good: true,
        });
        if !is_held {
            observer.handle_answer(at + US * 50, i + 1);
        }
    }
    let observed = observer.observed();
    assert_eq!(
        (observed.overtaken, observed.unanswered, observed.late),
        (50, 0, 0)
    );
    assert!(matches!(observer.verdict(), Verdict::NetworkJitter { .. }));
}

#[test]
fn observer_restart_is_neither_loss_nor_jitter() {
    let verdict = run(|i, measurement| {
        if i >= 500 {
            measurement.sequence += 1_000_000;
            measurement.at += Duration::from_secs(20);
            measurement.stamp = Some(Duration::ZERO + PERIOD * i);
        }
        (true, Some(US * 50))
    });
    assert_eq!(verdict, Verdict::Good);
}

/// Real measurements of both generations with nonsense in the numbers that an observer reckons with.
#[test]
fn observer_extreme_numbers_do_not_overflow() {
    use crate::lwr::emulator::{Krc, KrcConfig};
    use crate::lwr::wire::Msr;
    let mut krc = Krc::new(KrcConfig::default(), Duration::ZERO);
    let mut bytes = [0; Msr::LEN];
    krc.poll_transmit(Duration::ZERO, &mut bytes).unwrap();
    let sound = Msr::decode(&bytes).unwrap();
    let wild = [1e19, 1.8e19, f32::MAX, f32::INFINITY, f32::NAN, -1.0, 0.0];
    let mut observer = Observer::lwr();
    for (sequence, (period, stamp)) in (0..)
        .zip(wild.iter().flat_map(|a| wild.map(|b| (*a, b))))
        .map(|(i, it)| (i * 40, it))
    {
        let mut msr = sound;
        msr.header.sequence = sequence;
        (msr.interface.msr_period_s, msr.interface.timestamp_s) = (period, stamp);
        let at = if sequence % 80 == 0 {
            Duration::MAX
        } else {
            Duration::ZERO
        };
        observer.handle_measurement(Measurement::lwr(at, &msr));
        observer.handle_answer(Duration::MAX, 0);
        let period = observer.observed().period;
        assert!((US * 1_000..=US * 100_001).contains(&period), "{period:?}");
    }
    let _line = observer.verdict().to_string();
    let mut sunrise = Observer::sunrise();
    for i in 0..200 {
        let mut message = crate::sunrise::wire::Monitoring::default();
        message.header.sequence = i * 50;
        message.connection = Some(crate::sunrise::wire::ConnectionInfo {
            state: 1.into(),
            quality: 3.into(),
            send_period_ms: Some(u32::MAX),
            receive_multiplier: Some(0),
        });
        sunrise.handle_measurement(Measurement::sunrise(Duration::MAX, &message));
    }
    assert_eq!(sunrise.observed().period, US * 100_000);
}
