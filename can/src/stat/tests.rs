//! Each finding, brought about by its cause: on the in-process bus where a bus can cause it.

use super::*;
use crate::bus::{Bus, Config, Counters, Fault, PortId};
use crate::canopen::{Emergency, emergency, heartbeat, sync};
use crate::fault::violation;
use crate::{Frame, FrameError};

const MS: Duration = Duration::from_millis(1);

fn node(number: u8) -> NodeId {
    NodeId::new(number).unwrap()
}

fn data(id: u16, len: usize) -> Result<Frame, FrameError> {
    Frame::new(Id::standard(id)?, &[0xA5; 8][..len])
}

/// A bus with two ports, the first of which is this host's, and a meter there.
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
fn good_bus_has_no_finding() {
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
fn load_is_that_of_the_wire() {
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
fn load_beyond_its_limits() {
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
fn silence() {
    let mut bench = Bench::new();
    bench.run(999 * MS);
    assert_eq!(bench.names(), [""; 0]);
    bench.run(MS);
    assert_eq!(bench.names(), ["nothing"]);
}

#[test]
fn off_the_bus_and_back() {
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
fn nobody_acknowledges() {
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
fn another_bit_rate() {
    let mut bench = Bench::new();
    bench.bus.set_rates(bench.host, Rates::classic(500_000));
    bench.send(bench.other, data(0x181, 8).unwrap());
    bench.run(5 * MS);
    assert_eq!(bench.names(), ["nothing-but-errors"]);
}

#[test]
fn disturbed_wire() {
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
fn controller_near_its_end() {
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
fn heartbeat_that_stops() {
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
            times
        }
    );
}

#[test]
fn node_that_starts_anew() {
    let mut bench = Bench::new();
    let told = |state| heartbeat(node(5), state);
    bench.traffic(told(NmtState::BootUp), 10 * MS, 1);
    bench.traffic(told(NmtState::Operational), 10 * MS, 3);
    assert_eq!(bench.names(), [""; 0]);
    bench.traffic(told(NmtState::BootUp), 10 * MS, 1);
    assert_eq!(
        bench.findings(),
        [Finding::Rebooted {
            node: node(5),
            times: 1
        }]
    );
}

#[test]
fn emergency_until_it_is_withdrawn() {
    let mut bench = Bench::new();
    let told = |code| {
        emergency(
            node(3),
            &Emergency {
                code,
                register: 1,
                data: [0; 5],
            },
        )
    };
    bench.traffic(told(0x8611), MS, 1);
    assert_eq!(
        bench.findings(),
        [Finding::Emergency {
            node: node(3),
            code: 0x8611
        }]
    );
    bench.traffic(told(0), MS, 1);
    assert_eq!(bench.names(), [""; 0]);
}

#[test]
fn sync_that_jitters() {
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
fn losses_of_this_host() {
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
fn queue_that_is_full() {
    let mut bench = Bench::new();
    let frame: AnyFrame = data(0x181, 0).unwrap().into();
    let sends = (0..12).map(|_| bench.bus.send(bench.host, &frame, Duration::ZERO));
    let refused = sends.filter(Result::is_err).count();
    bench.meter.handle_refused(refused as u64);
    bench.run(10 * MS);
    assert_eq!(bench.findings(), [Finding::Refused { frames: 2 }]);
}

/// What only a controller can tell is told by it.
#[test]
fn reports_of_a_controller() {
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
    let told = meter.report();
    let errors = told.errors;
    assert_eq!(
        (
            errors.frames,
            errors.lost_arbitration,
            errors.timeouts,
            errors.protocol
        ),
        (4, 1, 1, 1)
    );
    let names: Vec<_> = told
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
fn identifiers_are_bounded() {
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
fn every_finding_has_a_cause_and_a_remedy() {
    let mut bench = Bench::new();
    bench.bus.set_listen_only(bench.other, true);
    bench.send(bench.host, sync(None));
    bench.run(100 * MS);
    for finding in bench.findings() {
        assert!(!finding.to_string().is_empty() && finding.remedy().len() > 20);
    }
}
