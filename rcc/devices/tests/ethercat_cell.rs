//! EtherCAT segments of cell files, against emulated slaves on a cable inside this process:
//! slave discovery and configuration, a ring, inputs and outputs, and a segment that first differs from the cell.

#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

#[path = "common/bench.rs"]
mod bench;
mod common;

use std::time::Duration;

use takt_can::cia402::State;
use takt_can::cia402::dictionary::Address;
use takt_core::NetId;
use takt_core::device::DeviceStatus;
use takt_devices::ethercat::EthercatConfig;
use takt_devices::ethercat::master_config;
use takt_ethercat::config::{Location, Unlocked};
use takt_ethercat::emulator::{Coupler, Io, PdoImage, Segment, ServoConfig, ServoDrive, Slave};
use takt_ethercat::linux::monotonic;

use bench::{Log, TestBench};

fn config(text: &str) -> EthercatConfig {
    let text = format!(
        "[[ethercat]]\nname = 'segment'\ninterface = 'near'\ncycle = '2ms'\npriority = 85\n{text}"
    );
    let cell = takt_devices::parse_cell(&text).unwrap();
    cell.of_kind::<EthercatConfig>().next().unwrap().clone()
}

fn refused(text: &str) -> String {
    let text = format!("[[ethercat]]\nname = 'segment'\ninterface = 'near'\n{text}");
    takt_devices::parse_cell(&text).unwrap_err().to_string()
}

fn servo() -> (Slave, ServoDrive) {
    let mut config = ServoConfig::default();
    // A host without PREEMPT_RT stalls now and then.
    config.axes[0].quirks.missing_set_points = None;
    ServoDrive::slave(config).unwrap()
}

fn value(drive: &ServoDrive, index: u16, sub: u8) -> Vec<u8> {
    drive.dictionary(|d| {
        d.upload(Address::new(index, sub), &mut ())
            .unwrap()
            .to_vec()
    })
}

#[test]
fn ethercat_slave_found_by_name_configured_by_objects() {
    let config = config(
        "[[ethercat.slave]]\nname = 'head'\nposition = 0\n\
         [[ethercat.slave]]\nname = 'drive'\nsii_name = 'TK4021 servo'\nvendor = 0x7A87\nproduct = 0x4021\naxes = 1\n\
         startup = [\n\
           { index = 0x6083, value = { u32 = 54321 } },\n\
           { index = 0x6085, value = { u32 = 7 }, may_fail = true },\n\
           { index = 0x3000, sub = 9, value = { bytes = [1, 2, 3] }, may_fail = true },\n\
         ]\n",
    );
    let (slave, drive) = servo();
    let bench = TestBench::start(&config, Segment::line([Coupler::slave(), slave]));
    bench.wait_until_operational();
    assert_eq!(value(&drive, 0x6083, 0), 54_321_u32.to_le_bytes());
}

#[test]
fn ethercat_slave_configuration_reaches_master() {
    let config = config(
        "second = 'far'\nspin = '200us'\nclocks = { window = '3us', lock = '8s', unlocked = 'start' }\n\
         [[ethercat.slave]]\nname = 'tool'\nalias = 7\nrevision = 0x10000\noptional = true\ngroup = 2\ngoal = 'SAFE-OP'\n\
         outputs = [{ pdo = 0x1600, entries = [[0x6040, 0, 16], [0, 0, 8], [0x607A, 0, 32]] }]\n\
         inputs = [{ pdo = 0x1A00 }]\ncomplete_access = false\nwatchdog = '50ms'\n\
         sync0 = true\nsync1 = '250us'\nshift = '-100us'\n",
    );
    let master = master_config(&config);
    assert!(master.redundant);
    assert_eq!(config.spin, Duration::from_micros(200));
    assert_eq!(
        (master.clocks.window_ns, master.clocks.unlocked),
        (3000, Unlocked::Start)
    );
    let slave = &master.slaves[0];
    assert_eq!(
        (&slave.location, slave.revision),
        (&Location::Alias(7), Some(0x10000))
    );
    assert_eq!(
        (slave.optional, slave.group, slave.complete_access),
        (true, 2, false)
    );
    let sync = slave.sync.unwrap();
    let sync1 = Duration::from_micros(250);
    assert_eq!(
        (sync.assign_activate, sync.sync1, sync.shift_ns),
        (0x0700, sync1, -100_000)
    );
    let outputs = slave.outputs.as_ref().unwrap();
    let bits: Vec<_> = outputs[0].entries.iter().map(|entry| entry.bits).collect();
    assert_eq!((outputs[0].index, bits), (0x1600, vec![16, 8, 32]));
    assert!(slave.inputs.as_ref().unwrap()[0].entries.is_empty());
}

#[test]
#[expect(clippy::too_many_lines, reason = "a table of cells")]
fn ethercat_invalid_configuration_is_rejected_with_slave() {
    let slave = |rest: &str| refused(&format!("[[ethercat.slave]]\nname = 'a'\n{rest}\n"));
    let io = |rest: &str| {
        refused(&format!(
            "[[ethercat.slave]]\nname = 'a'\nposition = 0\n[[ethercat.io]]\nname = 'io'\n{rest}\n"
        ))
    };
    let usize_max = i64::MAX;
    for (reported, why) in [
        (
            slave(""),
            "slave a: it needs one of `position`, `alias` and `sii_name`",
        ),
        (slave("position = 0\nalias = 3"), "it needs one of"),
        (
            slave("position = 0\noptional = true"),
            "located by position",
        ),
        (slave("position = 0\ngroup = 8"), "groups are 0 to 7"),
        (slave("position = 0\nsync1 = '1us'"), "need `sync0 = true`"),
        (
            slave("position = 0\nsync0 = true\nshift = '1ms'"),
            "`shift` is 1000000 ns",
        ),
        (slave("position = 0\nwatchdog = '7s'"), "at most 6.5535s"),
        (
            slave(
                "position = 0\naxes = 1\noutputs = [{ pdo = 0x1600, entries = [[0x6040, 0, 16]] }]",
            ),
            "axis 0 cannot be controlled without 607A",
        ),
        (
            slave("position = 0\nstartup = [{ index = 0x6060, value = { i8 = 200 } }]"),
            "200",
        ),
        (
            refused("second = 'near'\n"),
            "`second` is near, as `interface` is",
        ),
        (
            refused("spin = '1ms'\n"),
            "`spin` is 1ms; it must be at most half a cycle",
        ),
        (
            refused("clocks = { window = '2s' }\n"),
            "clocks.window is 2s",
        ),
        (
            io(&format!(
                "digital_in = [['a', {usize_max}], ['a', {usize_max}]]"
            )),
            "bits are more than the",
        ),
        (
            io("digital_out = [['b', 8]]"),
            "io io: there is no slave `b`",
        ),
        (
            io("analogue_in = [{ slave = 'a' }]"),
            "give either `object` or `bit`",
        ),
        (
            io("analogue_in = [{ slave = 'a', bit = 0, scale = 0.0 }]"),
            "not zero",
        ),
        (
            io("analogue_out = [{ slave = 'a', bit = 0, bits = 33 }]"),
            "1 to 32 are possible",
        ),
    ] {
        assert!(reported.contains(why), "{why}: {reported}");
    }
}

#[test]
fn ethercat_nets_use_analogue_channels_in_units() {
    let config = config(
        "[[ethercat.slave]]\nname = 'volts'\nposition = 0\n\
         [[ethercat.io]]\nname = 'io'\n\
         analogue_in = [{ slave = 'volts', object = [0x6010, 0x11], scale = 0.5 }]\n\
         analogue_out = [{ slave = 'volts', bit = 16, scale = 0.5, offset = 1.0 }]\n",
    );
    let (terminal, io) = Io::analogue(2, 2);
    let bench = TestBench::start(&config, Segment::line([terminal]));
    bench.cell().wait_for("io", DeviceStatus::Operational);
    let net = bench.cell().load(
        "{ in=IO::InReal(DeviceID='io',Port='0'),
       out=IO::OutReal(inIO=in.outIO,DeviceID='io',Port='0'),
       cancel=Cancel(),outTerminate=cancel.outCancel }",
    );
    bench.cell().controller.start_net(net).unwrap();
    for (raw, value) in [(100_i16, 98_i16), (-7, -9), (i16::MIN, i16::MIN)] {
        let [low, high] = raw.to_le_bytes();
        io.set_inputs(&[0, 0, low, high]);
        let [low, high] = value.to_le_bytes();
        bench.cell().wait("the output as the input", |_| {
            io.outputs() == [0, 0, low, high]
        });
    }
}

#[test]
fn ethercat_ring_survives_cut_cable() {
    let config = config(
        "second = 'far'\n\
         [[ethercat.slave]]\nname = 'a'\nposition = 0\n\
         [[ethercat.slave]]\nname = 'b'\nposition = 1\n\
         [[ethercat.io]]\nname = 'io'\ndigital_in = [['a', 8], ['b', 8]]\ndigital_out = [['a', 8], ['b', 8]]\n",
    );
    let ((a, _a), (b, io)) = (Io::digital(8, 8), Io::digital(8, 8));
    let bench = TestBench::start(&config, Segment::line([a, b]));
    bench.cell().wait_for("io", DeviceStatus::Operational);
    let net = bench.cell().load(
        "{ in=IO::InBool(DeviceID='io',Port='8'),
       out=IO::OutBool(inIO=in.outIO,DeviceID='io',Port='15'),
       cancel=Cancel(),outTerminate=cancel.outCancel }",
    );
    bench.cell().controller.start_net(net).unwrap();
    let follows = |value: u8| {
        io.set_inputs(&[value]);
        bench
            .cell()
            .wait("the output as the input", |_| io.outputs() == [value << 7]);
    };
    follows(1);
    bench.segment().set_link(1, false);
    follows(0);
    follows(1);
    assert!(bench.figures().operational);
    bench.segment().set_link(1, true);
    follows(0);
}

#[test]
fn ethercat_unpowered_slave_reported_once_then_accepted() {
    let log = Log::start();
    let config = config(
        "[[ethercat.slave]]\nname = 'a'\nposition = 0\n\
         [[ethercat.slave]]\nname = 'late'\nposition = 1\n\
         [[ethercat.io]]\nname = 'io'\ndigital_out = [['late', 9]]\n",
    );
    let mut segment = Segment::line([Io::digital(8, 8).0, Io::digital(8, 8).0]);
    segment.set_power(1, false);
    let bench = TestBench::start(&config, segment);
    bench
        .cell()
        .wait("its report", |_| log.text().contains("\"late\" is missing"));
    bench.segment().set_power(1, true);
    bench.wait_until_operational();
    let reported = [
        "as the cell expects them",
        "it has 8 bits of outputs, 9 are named",
    ];
    for reported in reported {
        bench
            .cell()
            .wait(reported, |_| log.text().contains(reported));
    }
    assert_eq!(
        log.text().matches("\"late\" is missing").count(),
        1,
        "{}",
        log.text()
    );
}

/// State of an arm in mid swing after the clock of its drive jumps, by policy.
fn jumps(policy: &str, judge: impl Fn(&TestBench, &ServoDrive, NetId, u64)) {
    let config = config(&format!(
        "clocks = {{ window = '50us', lost = '{policy}' }}\n\
         [[ethercat.slave]]\nname = 'first'\nposition = 0\naxes = 1\nsync0 = true\n\
         [[ethercat.slave]]\nname = 'drive'\nposition = 1\naxes = 1\nsync0 = true\n\
         [[ethercat.arm]]\nname = 'arm'\njoint = [{{ slave = 'drive', axis = 0, increments_per_turn = 204800.0, \
         range = [-170.0, 170.0], velocity_max = 300.0, acceleration_max = 300.0 }}]\n"
    ));
    let (slave, drive) = servo();
    let bench = TestBench::start(&config, Segment::line([servo().0, slave]));
    bench.cell().wait_for("arm", DeviceStatus::Operational);
    let net = bench.cell().swinging("arm", 0);
    let events = bench.figures().events;
    let now = u64::try_from(monotonic().unwrap().as_nanos()).unwrap();
    bench
        .segment()
        .slave(1)
        .unwrap()
        .clock()
        .unwrap()
        .jump(400_000, now);
    judge(&bench, &drive, net, events);
}

fn is_at_rest(drive: &ServoDrive) -> bool {
    drive.axis(0, |drive| drive.motor().velocity.abs()).unwrap() < 0.5
}

fn state(drive: &ServoDrive) -> State {
    drive.axis(0, |drive| drive.state()).unwrap()
}

#[test]
fn ethercat_lost_clock_holds_arm_until_recovery() {
    jumps("hold", |bench, drive, net, _| {
        bench.cell().wait_for("arm", DeviceStatus::SafeOperational);
        bench.cell().wait_for_end(net);
        bench
            .cell()
            .wait("standstill of the motor", |_| is_at_rest(drive));
        assert_eq!(state(drive), State::OperationEnabled);
        bench.cell().wait_for("arm", DeviceStatus::Operational);
        bench.cell().swinging("arm", 0);
    });
}

#[test]
fn ethercat_lost_clock_stops_arm_until_recovery() {
    jumps("stop", |bench, drive, net, _| {
        bench.cell().wait_for_end(net);
        bench
            .cell()
            .wait("power off", |_| state(drive) == State::SwitchOnDisabled);
        assert!(is_at_rest(drive), "power went off while it turned");
        bench.cell().wait_for("arm", DeviceStatus::Operational);
        bench.cell().swinging("arm", 0);
    });
}

#[test]
fn ethercat_lost_clock_continues_if_configured() {
    jumps("ignore", |bench, drive, net, events| {
        bench.cell().wait("its loss and its return", |_| {
            bench.figures().events >= events + 2
        });
        assert!(!bench.cell().is_over(net), "the net was ended");
        assert_eq!(bench.cell().status("arm"), DeviceStatus::Operational);
        assert_eq!(state(drive), State::OperationEnabled);
    });
}

#[test]
fn ethercat_optional_terminal_later_is_read_by_objects() {
    let entries = (0..2).map(|n| format!("[{}, 17, 16]", 0x6000 + 0x10 * n));
    let config = config(&format!(
        "[[ethercat.slave]]\nname = 'gate'\nposition = 0\n\
         [[ethercat.slave]]\nname = 'volts'\nsii_name = 'TK0002 analogue'\noptional = true\n\
         outputs = []\ninputs = [{{ pdo = 0x1A00, entries = [{}] }}]\n\
         [[ethercat.io]]\nname = 'io'\nanalogue_in = [{{ slave = 'volts', object = [0x6010, 0x11] }}]\n",
        entries.collect::<Vec<_>>().join(", ")
    ));
    let (terminal, io) = Io::terminal(
        "TK0002 analogue".to_owned(),
        0x4002,
        Vec::new(),
        vec![PdoImage {
            index: 0x1A00,
            sync_manager: 1,
            name: "volts".to_owned(),
            entries: vec![(0x6000, 17, 16, 3), (0x6010, 17, 16, 3)],
        }],
    );
    let mut segment = Segment::line([Coupler::slave(), terminal]);
    segment.set_power(1, false);
    let bench = TestBench::start(&config, segment);
    bench.wait_until_operational();
    assert_eq!(bench.cell().status("io"), DeviceStatus::Offline);
    bench.segment().set_power(1, true);
    io.set_inputs(&[0, 0, 7, 0]);
    bench.cell().wait_for("io", DeviceStatus::Operational);
}
