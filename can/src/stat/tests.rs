//! Each finding, produced by its cause: on the in-process bus where possible.

mod lives;

use super::*;
use crate::Id;
use crate::bus::{Bus, Config, Counters, Fault, PortId};
use crate::canopen::{Emergency, emergency, heartbeat, sync};
use crate::cia402::dictionary::Address;
use crate::fault::violation;
use crate::{Frame, FrameError};

const MS: Duration = Duration::from_millis(1);

fn node(number: u8) -> NodeId {
    NodeId::new(number).unwrap()
}

fn data(id: u16, len: usize) -> Result<Frame, FrameError> {
    Frame::new(Id::standard(id)?, &[0xA5; 8][..len])
}

/// A bus with two ports and a meter; the first port is this host's.
struct Bench {
    bus: Bus,
    host: PortId,
    other: PortId,
    meter: Meter,
}

impl Bench {
    fn new() -> Self {
        let mut bus = Bus::new(Config::default());
        let (host, other) = (bus.attach(), bus.attach());
        bus.set_echo(host, true);
        let mut meter = Meter::new(Some(Rates::classic(1_000_000)));
        meter.handle_time(Duration::ZERO);
        Self {
            bus,
            host,
            other,
            meter,
        }
    }

    fn send(&mut self, from: PortId, frame: Frame) {
        let now = self.bus.now();
        self.bus.send(from, &frame.into(), now).unwrap();
    }

    fn run(&mut self, span: Duration) {
        self.bus.advance(self.bus.now() + span);
        while let Some(received) = self.bus.receive(self.host) {
            self.meter.handle_frame(&received);
        }
        self.meter.handle_time(self.bus.now());
    }

    /// A frame of another node every `period`, `times` times.
    fn traffic(&mut self, frame: Frame, period: Duration, times: u32) {
        for _ in 0..times {
            self.send(self.other, frame);
            self.run(period);
        }
    }

    fn findings(&self) -> Vec<Finding> {
        self.meter.report().findings(&Limits::default())
    }

    fn names(&self) -> Vec<&'static str> {
        self.findings().iter().map(Finding::name).collect()
    }
}

#[test]
fn stat_good_bus_has_no_finding() {
    let mut bench = Bench::new();
    for _ in 0..100 {
        bench.send(bench.host, sync(None));
        bench.send(bench.other, heartbeat(node(1), NmtState::Operational));
        bench.traffic(data(0x181, 8).unwrap(), 10 * MS, 1);
    }
    assert_eq!(bench.names(), [""; 0]);
    let report = bench.meter.report();
    assert_eq!(
        (report.frames, report.sent, report.ids.len()),
        (300, 100, 3)
    );
    assert_eq!(report.span, Duration::from_secs(1));
    let tpdo = report.ids[&Id::standard(0x181).unwrap()];
    assert_eq!((tpdo.frames, tpdo.bytes), (100, 800));
    let mean = tpdo.intervals.mean();
    assert!(mean.abs_diff(10 * MS) < MS / 10, "{mean:?}");
}

#[test]
fn stat_load_matches_wire_time() {
    let mut bench = Bench::new();
    bench.traffic(data(0x181, 8).unwrap(), MS, 500);
    let report = bench.meter.report();
    let load = report.load().unwrap();
    let on_the_wire = bench.bus.traffic().busy.as_secs_f64() / report.span.as_secs_f64();
    assert!((load - on_the_wire).abs() < 1e-9, "{load} {on_the_wire}");
    assert!((0.111..=0.135).contains(&load));
    assert!(
        (0.11..=0.14).contains(&report.peak_load),
        "{}",
        report.peak_load
    );
    let (least, most) = report.busy_bounds;
    assert!(least <= report.busy && report.busy <= most);
    assert_eq!(least, 500 * Duration::from_micros(111));
    assert_eq!(Meter::new(None).report().load(), None);
}

#[test]
fn stat_load_above_limits_is_found() {
    let mut bench = Bench::new();
    bench.traffic(data(0x181, 8).unwrap(), Duration::from_micros(150), 200);
    let [
        Finding::Load {
            severity,
            most: Some((id, part)),
            ..
        },
    ] = bench.findings()[..]
    else {
        panic!("{:?}", bench.findings())
    };
    assert_eq!((severity, id.raw()), (Severity::Warning, 0x181));
    assert!(part > 0.99);
    bench.traffic(data(0x181, 8).unwrap(), Duration::from_micros(121), 5_000);
    let findings = bench.findings();
    assert!(
        matches!(
            findings[..],
            [Finding::Load {
                severity: Severity::Failure,
                ..
            }]
        ),
        "{findings:?}"
    );
}

#[test]
fn stat_silence_is_found() {
    let mut bench = Bench::new();
    bench.run(999 * MS);
    assert_eq!(bench.names(), [""; 0]);
    bench.run(MS);
    assert_eq!(bench.names(), ["nothing"]);
}

#[test]
fn stat_bus_off_and_restart_is_found() {
    let mut bench = Bench::new();
    bench.traffic(data(0x181, 1).unwrap(), MS, 3);
    bench.bus.set_counters(
        bench.host,
        Counters {
            transmit: 256,
            receive: 0,
        },
    );
    bench.run(MS);
    assert_eq!(
        bench.findings()[0],
        Finding::BusOff {
            times: 1,
            still: true
        }
    );
    bench.bus.restart(bench.host);
    bench.run(MS);
    assert_eq!(
        bench.findings(),
        [Finding::BusOff {
            times: 1,
            still: false
        }]
    );
}

#[test]
fn stat_missing_acknowledgement_is_found() {
    let mut bench = Bench::new();
    bench.bus.set_listen_only(bench.other, true);
    bench.send(bench.host, sync(None));
    bench.run(100 * MS);
    assert_eq!(bench.names(), ["alone", "weak"]);
    let text = bench.findings()[1].to_string();
    assert!(
        text.starts_with("the controller is error-passive (errors: 128 sending"),
        "{text}"
    );
}

#[test]
fn stat_wrong_bit_rate_is_found() {
    let mut bench = Bench::new();
    bench.bus.set_rates(bench.host, Rates::classic(500_000));
    bench.send(bench.other, data(0x181, 8).unwrap());
    bench.run(5 * MS);
    assert_eq!(bench.names(), ["nothing-but-errors"]);
}

#[test]
fn stat_disturbed_wire_is_found() {
    let mut bench = Bench::new();
    bench.bus.inject(Fault {
        from: None,
        id: None,
        frames: 3,
    });
    bench.traffic(data(0x181, 8).unwrap(), MS, 100);
    assert_eq!(
        bench.findings(),
        [Finding::Disturbed {
            errors: 3,
            frames: 100
        }]
    );
}

#[test]
fn stat_error_passive_controller_is_found() {
    let mut bench = Bench::new();
    bench.bus.set_counters(
        bench.host,
        Counters {
            transmit: 0,
            receive: 110,
        },
    );
    bench.traffic(data(0x181, 8).unwrap(), MS, 1);
    let state = BusState::ErrorWarning;
    let counters = Some((0, 110));
    assert_eq!(bench.findings(), [Finding::Weak { state, counters }]);
}

#[test]
fn stat_lost_heartbeat_is_found() {
    let mut bench = Bench::new();
    let beat = |number| heartbeat(node(number), NmtState::Operational);
    for _ in 0..5 {
        bench.send(bench.other, beat(1));
        bench.send(bench.other, beat(2));
        bench.run(100 * MS);
    }
    bench.traffic(beat(2), 100 * MS, 5);
    let [
        Finding::HeartbeatMissing {
            node: lost,
            silence,
            period,
            own: false,
        },
    ] = bench.findings()[..]
    else {
        panic!("{:?}", bench.findings())
    };
    assert_eq!(lost, node(1));
    assert!(silence > 590 * MS && silence < 601 * MS, "{silence:?}");
    assert!(period.abs_diff(100 * MS) < MS, "{period:?}");
    bench.traffic(beat(1), 100 * MS, 1);
    let times = 1;
    assert_eq!(
        bench.findings()[0],
        Finding::HeartbeatLate {
            node: node(1),
            times,
            own: false,
        }
    );
}

#[test]
fn stat_node_restart_is_found() {
    let mut bench = Bench::new();
    let message = |state| heartbeat(node(5), state);
    bench.traffic(message(NmtState::BootUp), 10 * MS, 1);
    bench.traffic(message(NmtState::Operational), 10 * MS, 3);
    assert_eq!(bench.names(), [""; 0]);
    bench.traffic(message(NmtState::BootUp), 10 * MS, 1);
    assert_eq!(
        bench.findings(),
        [Finding::Rebooted {
            node: node(5),
            times: 1
        }]
    );
}

#[test]
fn stat_emergency_is_active_until_cleared() {
    let mut bench = Bench::new();
    let message = |code| {
        emergency(
            node(3),
            &Emergency {
                code,
                register: 1,
                data: [0; 5],
            },
        )
    };
    bench.traffic(message(0x8611), MS, 1);
    assert_eq!(
        bench.findings(),
        [Finding::Emergency {
            node: node(3),
            code: 0x8611,
            times: 1
        }]
    );
    bench.traffic(message(0), MS, 1);
    assert_eq!(bench.names(), ["emergency-withdrawn"]);
}

/// The findings of a recording, frames with the time between them: `ms id#data`.
fn findings_of(frames: impl IntoIterator<Item = (u32, String)>) -> (Report, Vec<Finding>) {
    let mut meter = Meter::new(Some(Rates::classic(1_000_000)));
    let mut at = Duration::from_secs(100);
    for (ms, text) in frames {
        at += ms * MS;
        meter.handle_frame(&Received {
            frame: crate::log::parse_frame(&text).unwrap(),
            at,
            hardware: None,
            origin: Origin::Bus,
            dropped: 0,
        });
    }
    let report = meter.report();
    let findings = report.findings(&Limits::default());
    (report, findings)
}

/// `times` frames of that text, with this interval in ms.
fn every(ms: u32, times: usize, text: &str) -> impl Iterator<Item = (u32, String)> + use<> {
    std::iter::repeat_n((ms, text.to_owned()), times)
}

fn once(ms: u32, text: &str) -> impl Iterator<Item = (u32, String)> + use<> {
    every(ms, 1, text)
}

fn names_of(findings: &[Finding]) -> Vec<&'static str> {
    findings.iter().map(Finding::name).collect()
}

#[test]
fn stat_heartbeat_period_written_by_sdo_is_used() {
    let frames = every(100, 10, "701#7F")
        .chain(once(5, "601#2B171000E8030000"))
        .chain(once(4, "581#6017100000000000"))
        .chain(every(1_000, 6, "701#05"));
    let (report, findings) = findings_of(frames);
    assert_eq!(findings, []);
    let beat = report.heartbeats[&node(1)];
    assert_eq!((beat.gaps, beat.period()), (0, 1_000 * MS));
    assert_eq!(
        (beat.earlier, beat.written),
        (Some(100 * MS), Some(1_000 * MS))
    );
    // A disabled heartbeat is not missing; a configured one is missing even if it was never received.
    let to = |ms: u16| format!("601#2B171000{:04X}0000", ms.swap_bytes());
    for (ms, expected) in [(0, vec![]), (50, vec!["heartbeat-missing"])] {
        let frames = every(100, 10, "701#7F")
            .chain(once(5, &to(ms)))
            .chain(once(4, "581#6017100000000000"))
            .chain(every(100, 20, "080#"));
        assert_eq!(names_of(&findings_of(frames).1), expected, "{ms}");
    }
}

#[test]
fn stat_heartbeat_period_change_is_detected() {
    for (before, after) in [(100, 1_000), (1_000, 100)] {
        let frames = every(before, 10, "701#05").chain(every(after, 6, "701#05"));
        let (report, findings) = findings_of(frames);
        assert_eq!(findings, [], "{before} {after}");
        let beat = report.heartbeats[&node(1)];
        assert_eq!(beat.period(), after * MS);
        assert_eq!(beat.earlier, Some(before * MS));
    }
    // One long interval is a gap, and so are two of different lengths.
    for gaps in [vec![1_000_u32], vec![1_000, 400], vec![500, 100, 500]] {
        let mut frames: Vec<_> = every(100, 10, "701#05").collect();
        for gap in &gaps {
            frames.extend(once(*gap, "701#05"));
        }
        frames.extend(every(100, 10, "701#05"));
        let (report, findings) = findings_of(frames);
        assert_eq!(names_of(&findings), ["heartbeat-late"], "{gaps:?}");
        let late = gaps.iter().filter(|gap| **gap > 200).count();
        assert_eq!(report.heartbeats[&node(1)].gaps as usize, late, "{gaps:?}");
    }
}

#[test]
fn stat_boot_up_after_recorded_reset_is_explained() {
    for (reset, explained) in [
        ("000#8201", true),
        ("000#8200", true),
        ("000#8101", true),
        ("000#8202", false),
        ("000#0101", false),
    ] {
        let frames = every(100, 20, "701#05")
            .chain(once(10, reset))
            .chain(once(14, "701#00"))
            .chain(every(100, 20, "701#05"));
        let (report, findings) = findings_of(frames);
        let expected = if explained { vec![] } else { vec!["rebooted"] };
        assert_eq!(names_of(&findings), expected, "{reset}");
        let beat = report.heartbeats[&node(1)];
        assert_eq!((beat.resets.0 > 0, beat.boots), (explained, 1), "{reset}");
    }
}

#[test]
fn stat_cleared_and_multiple_emergencies_are_all_shown() {
    let frames = every(100, 5, "701#05")
        .chain(once(10, "081#0152800000007008"))
        .chain(every(100, 9, "701#05"))
        .chain(once(100, "081#0000000000000000"));
    let (_, findings) = findings_of(frames);
    assert_eq!(names_of(&findings), ["emergency-withdrawn"]);
    let text = findings[0].to_string();
    assert_eq!(
        text,
        "node 1: emergency 5201h control hardware, 1 times, withdrawn since"
    );
    let frames = every(100, 5, "701#05")
        .chain(once(2, "081#B081010000000000"))
        .chain(once(2, "081#A081010000000000"))
        .chain(every(2, 2, "081#1186210000000000"))
        // One of them is cleared, others remain.
        .chain(once(2, "081#0000010000000000"));
    let codes: Vec<_> = findings_of(frames)
        .1
        .iter()
        .map(|finding| {
            if let Finding::Emergency { code, times, .. } = finding {
                (*code, *times, true)
            } else if let Finding::EmergencyEnded { code, times, .. } = finding {
                (*code, *times, false)
            } else {
                panic!("{finding}")
            }
        })
        .collect();
    assert_eq!(
        codes,
        [(0x81B0, 1, true), (0x81A0, 1, true), (0x8611, 2, false)]
    );
}

#[test]
fn stat_unanswered_sdo_requests_are_found() {
    let requests = |node: u8| {
        (0..8).flat_map(move |_| {
            let request = once(
                500,
                &format!("{:03X}#4000100000000000", 0x600 + u16::from(node)),
            );
            let abort = format!("{:03X}#8000100000000405", 0x600 + u16::from(node));
            request.chain(once(500, &abort)).collect::<Vec<_>>()
        })
    };
    let (report, findings) = findings_of(requests(1));
    assert_eq!(names_of(&findings), ["sdo-unanswered"]);
    assert_eq!(findings[0].severity(), Severity::Failure);
    assert_eq!(
        findings[0].to_string(),
        "node 1: no answer to 8 SDO requests, last 1000h:00"
    );
    assert_eq!(report.sdos[&node(1)].given_up, (0, None));
    // A scan sends requests to absent nodes.
    let (_, findings) = findings_of((1..=20).flat_map(requests));
    assert_eq!(names_of(&findings), ["sdo-absent"]);
    assert_eq!(findings[0].severity(), Severity::Warning);
    // Recent requests may still get a response.
    let (_, findings) = findings_of(once(0, "601#4000100000000000"));
    assert_eq!(findings, []);
}

#[test]
fn stat_sdo_aborts_repeats_unsolicited_answers_are_found() {
    let read = || once(10, "601#4000100000000000");
    let answer = || once(3, "581#4300100092010200");
    let (report, findings) = findings_of(read().chain(answer()));
    assert_eq!(findings, []);
    let sdo = report.sdos[&node(1)];
    assert_eq!((sdo.requests, sdo.answered, sdo.longest), (1, 1, 3 * MS));
    let refused = once(10, "601#4002650000000000").chain(once(3, "581#8002650000000206"));
    let given_up = read()
        .chain(once(3, "581#0020000000000000"))
        .chain(once(1, "601#8000100001000405"));
    for (more, expected) in [
        (refused.collect::<Vec<_>>(), &["sdo-refused"][..]),
        (given_up.collect(), &["sdo-given-up", "sdo-unasked"]),
        (
            read().chain(read()).chain(answer()).collect(),
            &["sdo-unanswered", "sdo-repeated"],
        ),
        (answer().chain(answer()).collect(), &["sdo-unasked"]),
    ] {
        let (_, findings) = findings_of(read().chain(answer()).chain(more));
        assert_eq!(names_of(&findings), expected);
        assert!(findings.iter().all(|f| f.severity() == Severity::Warning));
    }
}

/// Transfers of every kind, of our own client and server, have no finding.
#[test]
fn stat_valid_sdo_transfers_have_no_finding() {
    use crate::canopen::emulator::{DriveNode, DriveNodeConfig};
    use crate::canopen::sdo::Client;
    let mut config = DriveNodeConfig::new(node(1));
    config.domain_len = 2_000;
    let mut server = DriveNode::power_on(config, Duration::ZERO).unwrap();
    let mut client = Client::new(2_000, Duration::from_secs(1));
    let mut meter = Meter::new(None);
    let mut now = Duration::ZERO;
    let mut see = |frame: Frame, at| {
        meter.handle_frame(&Received {
            frame: frame.into(),
            at,
            hardware: None,
            origin: Origin::Bus,
            dropped: 0,
        });
    };
    let (domain, status) = (Address::new(0x2000, 0), Address::new(0x6041, 0));
    let value = [0xA1; 1_500];
    for turn in 0..6 {
        let (blocks, write) = (turn % 2 == 1, turn < 2);
        let address = if turn < 4 { domain } else { status };
        let mut message = Some(if write {
            client.write(address, &value, blocks, now).unwrap()
        } else {
            client.read(address, blocks, now)
        });
        while !client.is_idle() || message.is_some() {
            now += MS;
            if let Some(message) = message.take() {
                let frame = Frame::new(node(1).cob(0x600), &message).unwrap();
                see(frame, now);
                server.handle_frame(&frame, now);
            }
            while let Some(frame) = server.poll_transmit(now) {
                see(frame, now);
                if frame.id() == node(1).cob(0x580) {
                    message = client.handle(frame.data().first_chunk().unwrap(), now).send;
                }
            }
            while let Some(more) = client.poll(now).send {
                let frame = Frame::new(node(1).cob(0x600), &more).unwrap();
                see(frame, now);
                server.handle_frame(&frame, now);
            }
        }
    }
    let report = meter.report();
    let sdo = report.sdos[&node(1)];
    assert_eq!(
        (sdo.requests, sdo.answered, sdo.strange),
        (6, 6, 0),
        "{sdo:?}"
    );
    assert_eq!(report.findings(&Limits::default()), []);
}

/// Cars send their data cyclically under the identifiers of emergencies and SDOs.
#[test]
fn stat_car_frames_are_no_sdo_dialogues() {
    let frames = (0..200_u64).flat_map(|turn| {
        let data = turn.wrapping_mul(0x9E37_79B9_7F4A_7C15);
        [0x0A1, 0x5A0, 0x601, 0x621, 0x581].map(|id: u16| (2, format!("{id:03X}#{data:016X}")))
    });
    assert_eq!(findings_of(frames).1, []);
}

/// 702h 00: no heartbeat, one boot-up.
#[test]
fn stat_master_boot_up_is_no_finding() {
    let frames = once(0, "702#00").chain(every(100, 20, "701#05"));
    assert_eq!(findings_of(frames).1, []);
}

#[test]
fn stat_sync_jitter_is_found() {
    let mut bench = Bench::new();
    for turn in 0..20 {
        bench.traffic(sync(None), if turn == 7 { 12 * MS } else { 10 * MS }, 1);
    }
    let [Finding::SyncJitter { jitter, .. }] = bench.findings()[..] else {
        panic!("{:?}", bench.findings())
    };
    assert!((jitter - 0.198).abs() < 0.002, "{jitter}");
}

#[test]
fn stat_frame_losses_of_host_are_found() {
    let config = Config {
        receive_queue: 2,
        ..Config::default()
    };
    let mut bench = Bench::new();
    bench.bus = Bus::new(config);
    bench.host = bench.bus.attach();
    bench.other = bench.bus.attach();
    for _ in 0..5 {
        bench.send(bench.other, data(0x181, 0).unwrap());
    }
    bench.run(MS);
    bench.traffic(data(0x181, 0).unwrap(), MS, 1);
    assert_eq!(bench.findings(), [Finding::Dropped { frames: 3 }]);
    bench.meter.handle_lost(4);
    assert_eq!(bench.findings(), [Finding::Dropped { frames: 7 }]);
}

#[test]
fn stat_full_send_queue_is_found() {
    let mut bench = Bench::new();
    let frame: AnyFrame = data(0x181, 0).unwrap().into();
    let sends = (0..12).map(|_| bench.bus.send(bench.host, &frame, Duration::ZERO));
    let refused = sends.filter(Result::is_err).count();
    bench.meter.handle_refused(refused as u64);
    bench.run(10 * MS);
    assert_eq!(bench.findings(), [Finding::Refused { frames: 2 }]);
}

/// Counts that only a controller can report.
#[test]
fn stat_controller_error_frames_are_counted() {
    let report = |class, data| Received {
        frame: ErrorFrame::new(class, data).into(),
        at: Duration::ZERO,
        hardware: None,
        origin: Origin::Bus,
        dropped: 0,
    };
    let mut meter = Meter::new(None);
    meter.handle_frame(&report(
        class::CONTROLLER,
        [0, controller::RX_OVERFLOW, 0, 0, 0, 0, 0, 0],
    ));
    meter.handle_frame(&report(class::TRANSCEIVER, [0, 0, 0, 0, 0x04, 0, 0, 0]));
    meter.handle_frame(&report(class::LOST_ARBITRATION, [5, 0, 0, 0, 0, 0, 0, 0]));
    meter.handle_frame(&report(
        class::TX_TIMEOUT | class::PROTOCOL,
        [0, 0, violation::STUFF, 0, 0, 0, 0, 0],
    ));
    let report = meter.report();
    let errors = report.errors;
    assert_eq!(
        (
            errors.frames,
            errors.lost_arbitration,
            errors.timeouts,
            errors.protocol
        ),
        (4, 1, 1, 1)
    );
    let names: Vec<_> = report
        .findings(&Limits::default())
        .iter()
        .map(Finding::name)
        .collect();
    assert_eq!(
        names,
        ["wires", "nothing-but-errors", "controller-overflow"]
    );
}

#[test]
fn stat_number_of_identifiers_is_bounded() {
    let mut meter = Meter::new(None);
    for raw in 0..5_000 {
        meter.handle_frame(&Received {
            frame: Frame::empty(Id::extended(raw).unwrap()).into(),
            at: Duration::ZERO,
            hardware: None,
            origin: Origin::Bus,
            dropped: 0,
        });
    }
    let report = meter.report();
    assert_eq!(
        (report.ids.len(), report.other_ids),
        (IDS_MAX, 5_000 - IDS_MAX as u64)
    );
}

#[test]
fn stat_every_finding_has_text_and_remedy() {
    let mut bench = Bench::new();
    bench.bus.set_listen_only(bench.other, true);
    bench.send(bench.host, sync(None));
    bench.run(100 * MS);
    for finding in bench.findings() {
        assert!(!finding.to_string().is_empty() && finding.remedy().len() > 20);
    }
}
