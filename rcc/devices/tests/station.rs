//! The machine of `examples/machine/station` on an emulated station of three servo axes: all states, ends in each of them, faults.
//! Where the brakes are and whether joints move is read from the motors, not from the controller.

#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

#[path = "common/bench.rs"]
mod bench;
mod common;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use takt_core::cell::OnLoss;
use takt_core::controller::MachineRequest;
use takt_core::device::DeviceStatus;
use takt_devices::ethercat::EthercatConfig;
use takt_ethercat::emulator::{Station, StationFaults, StationMotor};
use takt_irl::{System, compile};
use takt_machine::machine::Status;
use takt_tests::{pass, simulate_time};

use bench::TestBench;

const STATES: [&str; 5] = [
    "StartRobot",
    "CalibrateOffsets",
    "InitializationSequence",
    "MoveRobot",
    "StopRobot",
];

fn cell() -> EthercatConfig {
    let mut text =
        "[[ethercat]]\nname = 'segment'\ninterface = 'near'\ncycle = '1ms'\npriority = 85\n"
            .to_owned();
    for (position, name) in ["coupler", "in", "out", "volts", "enc0", "enc1", "enc2"]
        .iter()
        .enumerate()
    {
        let _ = writeln!(
            text,
            "[[ethercat.slave]]\nname = '{name}'\nposition = {position}"
        );
    }
    text += "[[ethercat.arm]]\nname = 'arm'\n";
    for n in 0..3 {
        let _ = writeln!(
            text,
            "[[ethercat.arm.joint]]\ndrive = 'axis{n}'\nincrements_per_turn = 200000\nrange = [-100, 100]\n\
             velocity_max = 120\nacceleration_max = 720\n"
        );
    }
    for n in 0..3 {
        let _ = writeln!(
            text,
            "[[ethercat.servo]]\nname = 'axis{n}'\npower = 'on_request'\nencoder = 'enc{n}'\n\
             output = {{ slave = 'volts', object = [{}, 1] }}\nbrake = ['out', {n}]\nenable = ['out', {}]\n\
             proximity = ['in', {n}]\nready = ['in', {}]\nvelocity_10v = 100000\nbrake_time = '50ms'\n\
             homing = {{ velocity = -80, index_velocity = 8, index_position = -78, index_every = 2000, start = 0 }}",
            0x7000 + 0x10 * n,
            n + 3,
            n + 3
        );
    }
    let cell = takt_devices::parse_cell(&text).unwrap();
    cell.of_kind::<EthercatConfig>().next().unwrap().clone()
}

fn examples() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples")
}

fn read(name: &str) -> String {
    std::fs::read_to_string(examples().join(name)).unwrap()
}

/// Object code of the program of the example, with that share of the speed and acceleration of the joints.
fn code(share: &str) -> String {
    let (text, spec) = (read("irl/lola15.irl"), read("irl/lola15.spc"));
    let text = text.replace(":=0.1", &format!(":={share}"));
    let program = compile(&text, &System::parse(&spec).unwrap(), &spec).unwrap();
    let bytes = program.program.encode();
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The machine with a faster program than that of the example.
fn lola(parameters: &[(&str, bool)]) -> MachineRequest {
    let text = read("machine/station/lola.machine");
    let files = text.lines().filter_map(|line| {
        let (_, rest) = line.split_once(" from \"")?;
        Some(rest.split_once('"')?.0.to_owned())
    });
    let files = files.map(|file| (file.clone(), read(&format!("machine/station/{file}"))));
    let parameters = parameters.iter();
    MachineRequest {
        files: files.collect(),
        text,
        parameters: parameters
            .map(|(name, value)| ((*name).to_owned(), value.to_string()))
            .collect(),
        properties: vec![("trajectory".to_owned(), format!("code = '{}'", code("0.8")))],
        ..MachineRequest::default()
    }
}

struct Rig {
    bench: TestBench,
    station: Station,
}

impl Rig {
    fn start() -> Self {
        simulate_time(2.0);
        let motor = |offset_v| StationMotor {
            offset_v,
            start_deg: -60.0,
            ..StationMotor::default()
        };
        let (segment, station) = Station::segment([motor(0.03), motor(-0.02), motor(0.0)]);
        let bench = TestBench::start(&cell(), segment);
        bench.cell().wait_for("arm", DeviceStatus::SafeOperational);
        Self { bench, station }
    }

    fn controller(&self) -> &takt_core::Controller {
        &self.bench.cell().controller
    }

    fn state(&self, name: &str) -> String {
        self.controller().machine(name).unwrap().state().to_owned()
    }

    fn load(&self, request: &MachineRequest) -> String {
        let name = self.controller().load_machine(request).unwrap();
        self.controller().start_machine(&name).unwrap();
        name
    }

    /// Waits until the machine is in a state, or beyond it in the order of the text.
    fn reach(&self, name: &str, state: &str) {
        let wanted = STATES.iter().position(|one| *one == state);
        self.bench.cell().wait(state, |_| {
            let now = self.state(name);
            STATES.iter().position(|one| *one == now) >= wanted
        });
    }

    fn are_braked(&self) -> bool {
        (0..3).all(|axis| self.station.is_braked(axis))
    }

    fn angles(&self) -> [f64; 3] {
        [0, 1, 2].map(|axis| self.station.angle(axis))
    }

    /// All brakes are closed, and nothing moves behind them.
    fn expect_braked(&self, when: &str) {
        self.bench.cell().wait(when, |_| self.are_braked());
        let before = self.angles();
        pass(std::time::Duration::from_millis(100));
        assert!(self.are_braked(), "{when}");
        let moved = before.iter().zip(self.angles()).map(|(a, b)| (a - b).abs());
        assert!(moved.fold(0.0, f64::max) < 0.05, "{when}");
    }
}

#[test]
fn station_machine_runs_through_all_states() {
    let rig = Rig::start();
    assert!(rig.are_braked());
    let name = rig.load(&lola(&[]));
    let mut visited = Vec::new();
    let (mut least, mut most) = ([f64::MAX; 3], [f64::MIN; 3]);
    rig.bench.cell().wait("the end", |controller| {
        let info = controller.machine(&name).unwrap();
        if visited
            .last()
            .is_none_or(|last: &String| last != info.state())
        {
            visited.push(info.state().to_owned());
        }
        if info.state() == "MoveRobot" {
            for (axis, angle) in rig.angles().into_iter().enumerate() {
                least[axis] = angle.min(least[axis]);
                most[axis] = angle.max(most[axis]);
            }
        }
        info.status() != Status::Active
    });
    let end = rig.controller().machine(&name).unwrap();
    assert_eq!((end.failure(0), end.status()), (None, Status::Finished));
    assert_eq!(visited, STATES);
    rig.expect_braked("the final state closes the brakes");
    assert_eq!(end.program.variables()[2].name, "runs");
    assert_eq!(end.view.variables[2].to_string(), "1");
    // Figure 5: (45, 0, -45), (-45, 45, 45), (45, -45, 45) degrees; where the zero of the encoders is differs by the index.
    for (found, expected) in [(least, [-45.0, -45.0, -45.0]), (most, [45.0, 45.0, 45.0])] {
        for (found, expected) in found.into_iter().zip(expected) {
            assert!((found - expected).abs() < 5.0, "{least:?} {most:?}");
        }
    }
}

#[test]
fn station_machine_ended_in_each_state_is_braked() {
    let rig = Rig::start();
    let mut parameters: &[(&str, bool)] = &[];
    for state in STATES {
        for client_is_lost in [false, true] {
            let controller = rig.controller();
            let session = controller.open_session_with("client", OnLoss::End).unwrap();
            let request = MachineRequest {
                session: session.0,
                ..lola(parameters)
            };
            let name = rig.load(&request);
            rig.reach(&name, state);
            if matches!(state, "InitializationSequence" | "MoveRobot") {
                let before = rig.angles();
                rig.bench.cell().wait("a motion", |_| {
                    let moved = before.iter().zip(rig.angles());
                    moved.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) > 3.0
                });
            }
            if client_is_lost {
                controller.end_session(session).unwrap();
            } else {
                controller.end_machine(&name).unwrap();
            }
            rig.expect_braked(state);
            assert!(controller.machines().is_empty());
        }
        if state == "InitializationSequence" {
            // The next ones need the zeros.
            let name = rig.load(&lola(&[]));
            rig.reach(&name, "MoveRobot");
            rig.controller().end_machine(&name).unwrap();
            rig.expect_braked("homed");
            parameters = &[("was_calibrated", true), ("was_initialized", true)];
        }
    }
}

#[test]
fn station_machine_fault_leads_to_closed_brakes() {
    let rig = Rig::start();
    rig.station.inject(
        1,
        StationFaults {
            no_index: true,
            ..StationFaults::default()
        },
    );
    let name = rig.load(&lola(&[("was_calibrated", true)]));
    rig.reach(&name, "StopRobot");
    rig.expect_braked("homing failed");
    rig.bench.cell().wait("the end", |controller| {
        controller.machine(&name).unwrap().status() == Status::Finished
    });
    rig.controller().end_machine(&name).unwrap();
    // An amplifier that fails in motion.
    rig.station.inject(1, StationFaults::default());
    let name = rig.load(&lola(&[("was_calibrated", true)]));
    rig.reach(&name, "MoveRobot");
    rig.station.inject(
        2,
        StationFaults {
            not_ready: true,
            ..StationFaults::default()
        },
    );
    rig.reach(&name, "StopRobot");
    rig.expect_braked("an amplifier failed");
    let failure = rig.controller().machine(&name).unwrap().failure(0);
    assert!(failure.is_some());
}

#[test]
fn station_program_is_that_of_example() {
    let name = "machine/station/trajectory_generator.component";
    let text = read(name);
    let (before, rest) = text.split_once("property code: string default '").unwrap();
    let (_, after) = rest.split_once('\'').unwrap();
    let code = code("0.1");
    let expected = format!("{before}property code: string default '{code}'{after}");
    if std::env::var_os("TAKT_BLESS").is_some() {
        std::fs::write(examples().join(name), &expected).unwrap();
    }
    assert!(
        text == expected || std::env::var_os("TAKT_BLESS").is_some(),
        "set TAKT_BLESS=1 to write it"
    );
}
