//! L-IRL programs on EtherCAT terminals: three servo axes that home and then move, and digital inputs and outputs as signals of
//! bits. The emulated motors and terminals are the ground truth.

#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

#[path = "common/bench.rs"]
mod bench;
mod common;

use std::fmt::Write as _;

use takt_core::NetId;
use takt_core::device::DeviceStatus;
use takt_devices::ethercat::EthercatConfig;
use takt_ethercat::emulator::{Io, Station, StationMotor};
use takt_irl::net::{Binding, net};
use takt_irl::{Program, System, compile};
use takt_tests::{pass, simulate_time};

const SPEC: &str = include_str!("../../../examples/irl/station.spc");
const SOURCE: &str = include_str!("../../../examples/irl/station.irl");

fn config() -> EthercatConfig {
    let mut text = "[[ethercat]]\nname = 'segment'\ninterface = 'none'\ncycle = '2ms'\n".to_owned();
    let slaves = [
        "coupler", "in", "out", "volts", "enc0", "enc1", "enc2", "panel",
    ];
    for (position, name) in slaves.iter().enumerate() {
        let _ = write!(
            text,
            "[[ethercat.slave]]\nname = '{name}'\nposition = {position}\n"
        );
    }
    text += "[[ethercat.arm]]\nname = 'station'\n";
    for n in 0..3 {
        let _ = write!(
            text,
            "[[ethercat.arm.joint]]\nslave = 'axis{n}'\nincrements_per_turn = 200000\nrange = [-100, 100]\n\
             velocity_max = 90\nacceleration_max = 300\n"
        );
    }
    text +=
        "[[ethercat.io]]\nname = 'io'\ndigital_in = [['panel', 8]]\ndigital_out = [['panel', 8]]\n";
    for n in 0..3 {
        let _ = write!(
            text,
            "[[ethercat.servo]]\nname = 'axis{n}'\nencoder = 'enc{n}'\n\
             output = {{ slave = 'volts', object = [{}, 1] }}\n\
             brake = ['out', {n}]\nenable = ['out', {}]\nproximity = ['in', {n}]\nready = ['in', {}]\n\
             velocity_10v = 100000\nbrake_time = '50ms'\n\
             homing = {{ velocity = -80, index_velocity = 4, index_position = -78, index_every = 2000, start = 0, timeout = '60s' }}\n",
            0x7000 + 0x10 * n,
            n + 3,
            n + 3
        );
    }
    let cell = takt_devices::parse_cell(&text).unwrap();
    cell.of_kind::<EthercatConfig>().next().unwrap().clone()
}

struct TestBench {
    bench: bench::TestBench,
    station: Station,
    panel: Io,
}

impl TestBench {
    fn new() -> Self {
        simulate_time(2.0);
        // Near their switches, so that homing is short.
        let motor = StationMotor {
            start_deg: -70.0,
            ..StationMotor::default()
        };
        let (mut segment, station) = Station::segment([motor; 3]);
        let (terminal, panel) = Io::digital(8, 8);
        let last = segment.len() - 1;
        segment.add(terminal, Some((last, 1)));
        let bench = bench::TestBench::start(&config(), segment);
        for device in ["station", "io"] {
            bench.cell().wait_for(device, DeviceStatus::Operational);
        }
        Self {
            bench,
            station,
            panel,
        }
    }

    fn start(&self, text: &str) -> NetId {
        let net = self.bench.cell().load(text);
        self.bench.cell().controller.start_net(net).unwrap();
        net
    }

    /// All axes at once.
    fn home(&self) {
        let axes = (0..3).fold(String::new(), |mut text, n| {
            let _ = write!(text, "axis{n}=Homing::Axis(Device='axis{n}'),");
            text
        });
        let net = self.start(&format!(
            "{{{axes}two=Core::BooleanAnd(inFirst=axis0.outHomed,inSecond=axis1.outHomed),
            all=Core::BooleanAnd(inFirst=two.outValue,inSecond=axis2.outHomed),outTerminate=all.outValue}}"
        ));
        let end = self.bench.cell().wait_for_end(net).end;
        assert_eq!(end, None);
    }

    fn output(&self) -> u8 {
        self.panel.outputs().first().copied().unwrap_or(0)
    }

    fn value(&self, net: NetId, key: &str) -> String {
        let values = self.bench.cell().controller.out_values(net);
        let found = values.into_iter().find(|(name, _)| name == key);
        found.map_or_else(String::new, |(_, value)| value)
    }
}

fn program(source: &str) -> Program {
    let system = System::parse(SPEC).unwrap();
    let compiled = compile(source, &system, SPEC);
    compiled
        .map_err(|rejection| rejection.render("station.irl", source))
        .unwrap()
        .program
}

fn text(program: &Program) -> String {
    let signals = &program.system.signals;
    let binding = Binding {
        arms: vec!["station".to_owned()],
        channels: signals.iter().map(|signal| signal.io.clone()).collect(),
        values: vec![None; signals.len()],
        watch: vec!["n".to_owned()],
        steps: 1_000,
        speed: 1.0,
        ..Binding::default()
    };
    net(program, &binding).unwrap()
}

#[test]
fn irl_station_homes_and_obeys_panel() {
    let bench = TestBench::new();
    bench.home();
    let off = std::array::from_fn::<_, 3, _>(|axis| {
        bench.bench.cell().position("station", axis).to_degrees() - bench.station.angle(axis)
    });
    let net = bench.start(&text(&program(SOURCE)));
    // Nothing moves before its switch is on.
    pass(std::time::Duration::from_millis(300));
    assert_eq!(bench.value(net, "outline"), "11");
    let still = bench.station.angle(0);
    assert!((still + off[0]).abs() < 2.0, "{still} {off:?}");
    // Bit 0 is the switch, bits 1 to 3 are the number of times.
    bench.panel.set_inputs(&[0b0101]);
    let cell = bench.bench.cell();
    cell.wait("the first time", |_| {
        bench.output() & 0xF == 1 || cell.is_over(net)
    });
    let angles = [0, 1, 2].map(|axis| bench.station.angle(axis) + off[axis]);
    for (angle, wanted) in angles.iter().zip([45.0, -45.0, 45.0]) {
        assert!((angle - wanted).abs() < 3.0, "{angles:?}");
    }
    let ended = cell.wait_for_end(net);
    assert_eq!(ended.end, None);
    assert_eq!(bench.output() & 0xF, 2);
    assert_eq!(bench.value(net, "outwatch"), "[3]");
    let angles = [0, 1, 2].map(|axis| bench.station.angle(axis) + off[axis]);
    assert!(angles.iter().all(|angle| angle.abs() < 0.5), "{angles:?}");
}

#[test]
fn irl_wait_for_terminal_input_times_out() {
    let bench = TestBench::new();
    bench.home();
    let source = "program w; var n: int; signal in start = \"start\"; in order = \"order\"; out done = \"done\"; begin
        wait for start timeout 0.2; if timed_out then done := 9; endif;
        wait for order = 6 timeout 20; if timed_out then done := 15; else done := order; endif; wait 1 sec; endprogram;";
    let net = bench.start(&text(&program(source)));
    let cell = bench.bench.cell();
    cell.wait("the timeout", |_| {
        bench.output() & 0xF == 9 || cell.is_over(net)
    });
    bench.panel.set_inputs(&[0b1100]);
    assert_eq!(cell.wait_for_end(net).end, None);
    assert_eq!(bench.output() & 0xF, 6);
}
