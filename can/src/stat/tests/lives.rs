//! Life cycles of nodes in recordings: restarts, numbers given twice, states, storms, and producers of SYNC.

use super::*;

fn found(frames: impl IntoIterator<Item = (u32, String)>) -> Vec<&'static str> {
    names_of(&findings_of(frames).1)
}

#[test]
fn stat_boot_loop_is_found() {
    // It never gets to its first heartbeat.
    let frames = once(0, "705#00").chain(every(800, 5, "705#00"));
    let (_, findings) = findings_of(frames);
    let [Finding::BootLoop { times: 5, .. }] = findings[..] else {
        panic!("{findings:?}")
    };
    // It gets to a few of them.
    let life = || once(400, "705#00").chain(every(100, 4, "705#7F"));
    assert_eq!(found((0..5).flat_map(|_| life())), ["boot-loop"]);
    // Resets that were commanded are none.
    let reset = || {
        once(400, "000#8105")
            .chain(once(10, "705#00"))
            .chain(every(100, 4, "705#7F"))
    };
    assert_eq!(found((0..5).flat_map(|_| reset())), [""; 0]);
}

#[test]
fn stat_duplicate_number_is_found_by_each_sign() {
    let signs = |frames: Vec<(u32, String)>| match findings_of(frames).1[..] {
        [Finding::Duplicate { sign, .. }, ..] => Some(sign),
        _ => None,
    };
    let pairs = |one: &str, two: &str| -> Vec<(u32, String)> {
        (0..20)
            .flat_map(|_| once(70, one).chain(once(30, two)))
            .collect()
    };
    assert_eq!(
        signs(pairs("705#05", "705#05")),
        Some(DuplicateSign::Heartbeats)
    );
    let states = (0..20).flat_map(|_| once(50, "705#05").chain(once(50, "705#7F")));
    assert!(matches!(
        signs(states.collect()),
        Some(DuplicateSign::States(_))
    ));
    let twins = every(100, 5, "705#05")
        .chain(once(10, "000#8100"))
        .chain(once(12, "705#00"))
        .chain(once(3, "705#00"));
    assert_eq!(signs(twins.collect()), Some(DuplicateSign::BootUps(1)));
    let ask = |data: &'static str| {
        once(20, "605#4018100400000000")
            .chain(once(1, "585#4318100405000000"))
            .chain(once(1, data))
    };
    let answers = every(100, 5, "705#05").chain((0..3).flat_map(|_| ask("585#4318100463000000")));
    assert_eq!(signs(answers.collect()), Some(DuplicateSign::Answers(3)));
}

/// A node leaves Operational by itself each time, and its master starts it again.
#[test]
fn stat_node_that_drops_out_is_no_duplicate() {
    let turn = |_| {
        every(100, 3, "705#05")
            .chain(every(100, 2, "705#7F"))
            .chain(once(10, "000#0105"))
    };
    assert_eq!(found((0..6).flat_map(turn)), [""; 0]);
}

/// A client that repeats its request gets an answer to each.
#[test]
fn stat_late_answers_to_repeats_are_no_duplicate() {
    let ask = || every(600, 2, "605#4018100400000000").chain(every(5, 2, "585#4318100405000000"));
    let names = found(once(0, "705#05").chain((0..4).flat_map(|_| ask())));
    assert!(!names.contains(&"duplicate"), "{names:?}");
}

#[test]
fn stat_tpdos_outside_operational_are_found() {
    let running = |state: &'static str| {
        (0..5).flat_map(move |_| every(10, 10, "185#3702").chain(once(0, state)))
    };
    let stopped = every(100, 5, "705#05")
        .chain(once(5, "000#0205"))
        .chain(running("705#04"));
    let (_, findings) = findings_of(stopped);
    let [
        Finding::StrayPdos {
            number: 1,
            state: NmtState::Stopped,
            ..
        },
    ] = findings[..]
    else {
        panic!("{findings:?}")
    };
    let pre_operational = every(100, 5, "705#7F").chain(running("705#7F"));
    assert_eq!(found(pre_operational), ["stray-pdos"]);
    // Its last ones may still be under way.
    let ends = every(100, 5, "705#05")
        .chain(once(5, "000#8005"))
        .chain(every(10, 5, "185#3702"));
    assert_eq!(found(ends), [""; 0]);
    // A node without heartbeat may start by itself.
    assert_eq!(
        found(once(0, "705#00").chain(every(10, 50, "185#3702"))),
        [""; 0]
    );
}

#[test]
fn stat_emergency_storm_differs_from_one_emergency() {
    let beats = || every(100, 5, "705#05");
    let storm = |_| every(10, 10, "085#1042090000000000").chain(once(0, "705#05"));
    let storm = beats().chain((0..10).flat_map(storm));
    let (_, findings) = findings_of(storm);
    assert!(
        matches!(findings[0], Finding::EmergencyStorm { times: 100, .. }),
        "{findings:?}"
    );
    assert_eq!(findings[0].severity(), Severity::Failure);
    assert!(findings[0].to_string().contains("100/s"), "{}", findings[0]);
    let names = found(beats().chain(once(10, "085#1042090000000000")));
    assert_eq!(names, ["emergency"]);
}

#[test]
fn stat_two_sync_producers_are_not_jitter() {
    let both = (0..50).flat_map(|_| once(3, "080#").chain(once(7, "080#")));
    let (_, findings) = findings_of(both);
    let [
        Finding::TwoSyncs {
            own: false,
            period: Some(period),
        },
    ] = findings[..]
    else {
        panic!("{findings:?}")
    };
    assert_eq!(period, 10 * MS);
    // This host and another node, at different periods.
    let mut bench = Bench::new();
    for turn in 0..60 {
        let from = if turn % 3 == 0 {
            bench.host
        } else {
            bench.other
        };
        bench.send(from, sync(None));
        bench.run(Duration::from_millis(5));
    }
    let names = bench.names();
    assert_eq!(names, ["two-sync-producers"]);
}

#[test]
fn stat_late_heartbeat_of_this_host_is_named() {
    let mut bench = Bench::new();
    let beat = heartbeat(node(127), NmtState::Operational);
    for turn in 0..20 {
        bench.send(bench.host, beat);
        bench.run(if turn == 12 { 500 * MS } else { 100 * MS });
    }
    let [
        Finding::HeartbeatLate {
            own: true,
            times: 1,
            ..
        },
    ] = bench.findings()[..]
    else {
        panic!("{:?}", bench.findings())
    };
    let finding = bench.findings()[0];
    assert!(finding.to_string().contains("of this host"), "{finding}");
    assert!(
        finding.remedy().contains("this host stalled"),
        "{}",
        finding.remedy()
    );
}
