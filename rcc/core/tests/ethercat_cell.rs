//! What a cell's file can say of an EtherCAT segment, against emulated slaves at the end of a cable inside of this
//! process: how slaves are found and set up, a ring, inputs and outputs, and a segment that is not as expected at first.

#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

mod common;
#[path = "common/hall.rs"]
mod hall;

use std::time::Duration;

use takt_can::cia402::State;
use takt_can::cia402::dictionary::Address;
use takt_core::cell::EthercatConfig;
use takt_core::device::DeviceStatus;
use takt_core::device::ethercat::master_config;
use takt_core::{CellConfig, NetId};
use takt_ethercat::config::{Location, Unlocked};
use takt_ethercat::emulator::{Coupler, Io, PdoImage, Segment, ServoConfig, ServoDrive, Slave};
use takt_ethercat::linux::monotonic;
use takt_tests::steady;

use hall::{Hall, Log};

fn config(text: &str) -> EthercatConfig {
    let text = format!(
        "[[ethercat]]\nname = 'segment'\ninterface = 'near'\ncycle = '2ms'\npriority = 85\n{text}"
    );
    let cell = CellConfig::parse(&text).unwrap();
    cell.ethercat.into_iter().next().unwrap()
}

fn refused(text: &str) -> String {
    let text = format!("[[ethercat]]\nname = 'segment'\ninterface = 'near'\n{text}");
    CellConfig::parse(&text).unwrap_err().to_string()
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
fn a_slave_is_found_by_its_name_and_set_up_by_objects() {
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
    let hall = Hall::start(&config, Segment::line([Coupler::slave(), slave]));
    hall.wait_until_operational();
    assert_eq!(value(&drive, 0x6083, 0), 54_321_u32.to_le_bytes());
}

#[test]
fn all_that_a_file_says_of_a_slave_reaches_the_master() {
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
fn what_cannot_be_is_refused_with_its_slave() {
    let slave = |rest: &str| refused(&format!("[[ethercat.slave]]\nname = 'a'\n{rest}\n"));
    let io = |rest: &str| {
        refused(&format!(
            "[[ethercat.slave]]\nname = 'a'\nposition = 0\n[[ethercat.io]]\nname = 'io'\n{rest}\n"
        ))
    };
    let usize_max = i64::MAX;
    for (told, why) in [
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
            "axis 0 cannot be led without 607A",
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
        assert!(told.contains(why), "{why}: {told}");
    }
}

#[test]
fn nets_read_and_set_analogue_channels_in_their_units() {
    let config = config(
        "[[ethercat.slave]]\nname = 'volts'\nposition = 0\n\
         [[ethercat.io]]\nname = 'io'\n\
         analogue_in = [{ slave = 'volts', object = [0x6010, 0x11], scale = 0.5 }]\n\
         analogue_out = [{ slave = 'volts', bit = 16, scale = 0.5, offset = 1.0 }]\n",
    );
    steady(|| {
        let (terminal, io) = Io::analogue(2, 2);
        let hall = Hall::start(&config, Segment::line([terminal]));
        hall.cell().wait_for("io", DeviceStatus::Operational);
        let net = hall.cell().load(
            "{ in=IO::InReal(DeviceID='io',Port='0'),
           out=IO::OutReal(inIO=in.outIO,DeviceID='io',Port='0'),
           cancel=Cancel(),outTerminate=cancel.outCancel }",
        );
        hall.cell().controller.start_net(net).unwrap();
        for (raw, value) in [(100_i16, 98_i16), (-7, -9), (i16::MIN, i16::MIN)] {
            let [low, high] = raw.to_le_bytes();
            io.set_inputs(&[0, 0, low, high]);
            let [low, high] = value.to_le_bytes();
            hall.cell().wait("the output as the input", |_| {
                io.outputs() == [0, 0, low, high]
            });
        }
    });
}

#[test]
fn a_ring_of_two_interfaces_goes_on_when_a_cable_is_cut() {
    let config = config(
        "second = 'far'\n\
         [[ethercat.slave]]\nname = 'a'\nposition = 0\n\
         [[ethercat.slave]]\nname = 'b'\nposition = 1\n\
         [[ethercat.io]]\nname = 'io'\ndigital_in = [['a', 8], ['b', 8]]\ndigital_out = [['a', 8], ['b', 8]]\n",
    );
    steady(|| {
        let ((a, _a), (b, io)) = (Io::digital(8, 8), Io::digital(8, 8));
        let hall = Hall::start(&config, Segment::line([a, b]));
        hall.cell().wait_for("io", DeviceStatus::Operational);
        let net = hall.cell().load(
            "{ in=IO::InBool(DeviceID='io',Port='8'),
           out=IO::OutBool(inIO=in.outIO,DeviceID='io',Port='15'),
           cancel=Cancel(),outTerminate=cancel.outCancel }",
        );
        hall.cell().controller.start_net(net).unwrap();
        let follows = |value: u8| {
            io.set_inputs(&[value]);
            hall.cell()
                .wait("the output as the input", |_| io.outputs() == [value << 7]);
        };
        follows(1);
        hall.segment().set_link(1, false);
        follows(0);
        follows(1);
        assert!(hall.figures().operational);
        hall.segment().set_link(1, true);
        follows(0);
    });
}

#[test]
fn a_slave_without_power_at_start_is_missed_once_and_taken_when_it_comes() {
    let log = Log::start();
    let config = config(
        "[[ethercat.slave]]\nname = 'a'\nposition = 0\n\
         [[ethercat.slave]]\nname = 'late'\nposition = 1\n\
         [[ethercat.io]]\nname = 'io'\ndigital_out = [['late', 9]]\n",
    );
    let mut segment = Segment::line([Io::digital(8, 8).0, Io::digital(8, 8).0]);
    segment.set_power(1, false);
    let hall = Hall::start(&config, segment);
    hall.cell()
        .wait("it is told", |_| log.text().contains("\"late\" is missing"));
    hall.segment().set_power(1, true);
    hall.wait_until_operational();
    let told = [
        "as the cell expects them",
        "it has 8 bits of outputs, 9 are named",
    ];
    for told in told {
        hall.cell().wait(told, |_| log.text().contains(told));
    }
    assert_eq!(
        log.text().matches("\"late\" is missing").count(),
        1,
        "{}",
        log.text()
    );
}

/// What becomes of an arm in mid swing when the clock of its drive jumps, by a policy.
fn jumps(policy: &str, judge: impl Fn(&Hall, &ServoDrive, NetId, u64)) {
    let config = config(&format!(
        "clocks = {{ window = '50us', lost = '{policy}' }}\n\
         [[ethercat.slave]]\nname = 'first'\nposition = 0\naxes = 1\nsync0 = true\n\
         [[ethercat.slave]]\nname = 'drive'\nposition = 1\naxes = 1\nsync0 = true\n\
         [[ethercat.arm]]\nname = 'arm'\njoint = [{{ slave = 'drive', axis = 0, increments_per_turn = 204800.0, \
         range = [-170.0, 170.0], velocity_max = 300.0, acceleration_max = 300.0 }}]\n"
    ));
    steady(|| {
        let (slave, drive) = servo();
        let hall = Hall::start(&config, Segment::line([servo().0, slave]));
        hall.cell().wait_for("arm", DeviceStatus::Operational);
        let net = hall.cell().swinging("arm", 0);
        let events = hall.figures().events;
        let now = u64::try_from(monotonic().unwrap().as_nanos()).unwrap();
        hall.segment()
            .slave(1)
            .unwrap()
            .clock()
            .unwrap()
            .jump(400_000, now);
        judge(&hall, &drive, net, events);
    });
}

fn stands(drive: &ServoDrive) -> bool {
    drive.axis(0, |drive| drive.motor().velocity.abs()).unwrap() < 0.5
}

fn state(drive: &ServoDrive) -> State {
    drive.axis(0, |drive| drive.state()).unwrap()
}

#[test]
fn an_arm_whose_clock_is_lost_is_held_until_it_is_back() {
    jumps("hold", |hall, drive, net, _| {
        hall.cell().wait_for("arm", DeviceStatus::SafeOperational);
        hall.cell().wait_for_end(net);
        hall.cell().wait("the motor standing", |_| stands(drive));
        assert_eq!(state(drive), State::OperationEnabled);
        hall.cell().wait_for("arm", DeviceStatus::Operational);
        hall.cell().swinging("arm", 0);
    });
}

#[test]
fn an_arm_whose_clock_is_lost_is_stopped_until_it_is_back() {
    jumps("stop", |hall, drive, net, _| {
        hall.cell().wait_for_end(net);
        hall.cell()
            .wait("power off", |_| state(drive) == State::SwitchOnDisabled);
        assert!(stands(drive), "power went off while it turned");
        hall.cell().wait_for("arm", DeviceStatus::Operational);
        hall.cell().swinging("arm", 0);
    });
}

#[test]
fn an_arm_whose_clock_is_lost_goes_on_if_the_cell_says_so() {
    jumps("ignore", |hall, drive, net, events| {
        hall.cell().wait("its loss and its return", |_| {
            hall.figures().events >= events + 2
        });
        assert!(!hall.cell().is_over(net), "the net was ended");
        assert_eq!(hall.cell().status("arm"), DeviceStatus::Operational);
        assert_eq!(state(drive), State::OperationEnabled);
    });
}

#[test]
fn an_optional_terminal_that_comes_later_is_read_by_its_objects() {
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
    let hall = Hall::start(&config, segment);
    hall.wait_until_operational();
    assert_eq!(hall.cell().status("io"), DeviceStatus::Offline);
    hall.segment().set_power(1, true);
    io.set_inputs(&[0, 0, 7, 0]);
    hall.cell().wait_for("io", DeviceStatus::Operational);
}
