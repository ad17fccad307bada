//! Commands to arms, grippers, inputs and outputs of emulated cells whose controller runs in the test: jogging by time and by
//! keys, `takt grip`, `takt io`, `takt cell frame`. What the devices do is tested in takt-api.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on ends")]

mod common;

use std::io::{Read as _, Write as _};
use std::process::Output;
use std::time::Duration;

use common::{Folder, alone, complaint, expect_status, takt};
use serde_json::Value;
use takt_embedded::Embedded;
use takt_tests::steady;

/// An emulated cell with everything that commands need to reach it.
struct Cell {
    address: String,
    folder: Folder,
    _embedded: Embedded,
}

impl Cell {
    fn start(name: &str) -> Self {
        let embedded = Embedded::emulated(name).unwrap();
        Self {
            address: embedded.address().to_string(),
            folder: Folder::new(),
            _embedded: embedded,
        }
    }

    fn command(&self, args: &[&str]) -> std::process::Command {
        let mut command = takt(args);
        command.args(["--connect", &self.address]);
        command
    }

    fn run(&self, args: &[&str]) -> Output {
        self.command(args).output().unwrap()
    }

    /// Standard output of a command that ends with status 0.
    #[track_caller]
    fn good(&self, args: &[&str]) -> String {
        expect_status(&self.run(args), 0)
    }
}

fn object(text: &str) -> Value {
    serde_json::from_str(text.trim()).unwrap()
}

const BENT: [&str; 12] = [
    "move",
    "left",
    "ptp",
    "0",
    "30deg",
    "0",
    "-70deg",
    "0",
    "45deg",
    "0",
    "--yes",
    "--speed=1",
];

#[test]
fn jog_for_a_time_moves_and_rests() {
    let _alone = alone();
    steady(|| {
        let cell = Cell::start("two_lwr");
        cell.good(&BENT);
        let jog = [
            "move", "left", "jog", "z+", "--for", "700ms", "--yes", "--json",
        ];
        let up = object(&cell.good(&jog));
        assert_eq!(
            (&up["motion"], &up["direction"]),
            (&"jog".into(), &"z+".into())
        );
        // 0.05 m/s for 0.7 s.
        let moved = up["moved_m"].as_f64().unwrap();
        assert!(moved > 0.01 && moved < 0.08, "{up}");
        assert!(up["turned_rad"].as_f64().unwrap() < 1e-3, "{up}");
        let joint = [
            "move",
            "left",
            "jog",
            "j0-",
            "--for=500ms",
            "--speed=0.1",
            "--yes",
        ];
        let text = cell.good(&joint);
        assert!(text.starts_with("at rest after "), "{text}");
        assert!(
            text.contains(" mm and ") && text.contains("left at -"),
            "{text}"
        );
        // Nothing moves any more: a frame is taught at rest.
        let frame = cell.good(&["cell", "frame", "slot", "--from", "left"]);
        assert!(
            frame.starts_with("[[frame]]\nname = \"slot\"\nparent = \"left.base\"\n"),
            "{frame}"
        );
    });
}

#[test]
fn jog_without_need_is_refused() {
    let _alone = alone();
    let cell = Cell::start("two_lwr");
    for (args, status, cause) in [
        (
            &["jog"][..],
            2,
            "hint: `takt move left jog x+ --for 1s` needs none",
        ),
        (&["jog", "x+"], 2, "--for <TIME>"),
        (&["jog", "--for", "1s"], 2, "DIRECTION"),
        (&["jog", "q+", "--for", "1s"], 2, "`q+` is no direction"),
        (
            &["jog", "j7+", "--for", "1s", "--yes"],
            2,
            "joints count from 0; left has 7",
        ),
        (
            &["jog", "x+", "--for", "1s"],
            2,
            "moving left (kuka_lwr_fri) can set a machine in motion",
        ),
        (&["jog", "x+", "--for", "0s"], 2, "must be above 0"),
    ] {
        let output = cell.run(&[&["move", "left"], args].concat());
        expect_status(&output, status);
        assert!(
            complaint(&output).contains(cause),
            "{args:?}: {}",
            complaint(&output)
        );
    }
}

/// A terminal that a command runs in.
struct Terminal {
    master: std::fs::File,
    child: std::process::Child,
}

impl Terminal {
    fn start(mut command: std::process::Command) -> Self {
        let pair = nix::pty::openpty(None, None).unwrap();
        let end = || std::process::Stdio::from(pair.slave.try_clone().unwrap());
        let child = command
            .stdin(end())
            .stderr(end())
            .stdout(std::process::Stdio::piped());
        let child = child.spawn().unwrap();
        let mut shown = std::fs::File::from(pair.master.try_clone().unwrap());
        // A terminal that is not read stalls what writes to it.
        std::thread::spawn(move || {
            let mut part = [0; 4096];
            while shown.read(&mut part).is_ok_and(|count| count > 0) {}
        });
        let master = pair.master.into();
        Self { master, child }
    }

    fn key(&mut self, key: &str) {
        self.master.write_all(key.as_bytes()).unwrap();
    }

    /// Holds a key as a keyboard does that repeats it 25 times a second.
    fn hold(&mut self, key: &str, time: Duration) {
        for _ in 0..time.as_millis() / 40 {
            self.key(key);
            std::thread::sleep(Duration::from_millis(40));
        }
    }
}

#[test]
fn jog_by_keys_moves_while_key_repeats() {
    let _alone = alone();
    steady(|| {
        let cell = Cell::start("two_lwr");
        cell.good(&BENT);
        let jog = ["move", "left", "jog", "--yes", "--json"];
        let mut terminal = Terminal::start(cell.command(&jog));
        // Until it is asked which protocol it speaks, and that is given up.
        std::thread::sleep(Duration::from_secs(4));
        // A tap moves nothing; what is held does, and a key of a joint after it.
        terminal.key("s");
        std::thread::sleep(Duration::from_millis(1500));
        terminal.hold("r", Duration::from_millis(800));
        std::thread::sleep(Duration::from_millis(1000));
        terminal.key("6");
        terminal.hold("+", Duration::from_millis(800));
        std::thread::sleep(Duration::from_millis(1000));
        terminal.key("q");
        let output = terminal.child.wait_with_output().unwrap();
        // Without a controlling terminal, it asks on standard output which protocol the terminal speaks.
        let out = expect_status(&output, 0);
        let report = object(out.get(out.find('{').unwrap()..).unwrap());
        let moved = report["moved_m"].as_f64().unwrap();
        assert!(moved > 0.005, "{report}");
        let at = report["at_rad"].as_array().unwrap();
        assert!(at[6].as_f64().unwrap() > 0.02, "{report}");
        // x was tapped only: joint 0 is where it was.
        assert!(at[0].as_f64().unwrap().abs() < 1e-3, "{report}");
    });
}

#[test]
fn home_of_cell_file_is_where_arm_moves() {
    let _alone = alone();
    steady(|| {
        let mut cell = common::Cell::start_with(
            "[[home]]\ndevice = \"left\"\njoints = [0, 20, 0, -40, 0, 10, 0]\n",
        );
        let _arm = cell.arm();
        let home = [
            "move",
            "left",
            "home",
            "--yes",
            "--speed=1",
            "--connect",
            &cell.tcp,
        ];
        let home = expect_status(&common::run(&home), 0);
        assert!(
            home.ends_with("left at 0.00 20.00 0.00 -40.00 0.00 10.00 0.00 deg\n"),
            "{home}"
        );
    });
}

#[test]
fn grip_commands_report_width_and_force() {
    let _alone = alone();
    steady(|| {
        let cell = Cell::start("lwr_wsg");
        let open = cell.good(&["grip", "gripper", "open", "--yes", "--speed=1"]);
        assert!(open.starts_with("completed after "), "{open}");
        let width = [
            "grip",
            "gripper",
            "width",
            "40mm",
            "--yes",
            "--json",
            "--speed=1",
        ];
        let width = object(&cell.good(&width));
        assert_eq!(width["outcome"], "completed");
        assert!(
            (width["width_m"].as_f64().unwrap() - 0.04).abs() < 1e-3,
            "{width}"
        );
        let state = cell.good(&["grip", "gripper", "state"]);
        assert!(
            state.contains("width 40.0 mm, force ") && state.contains("holds no part"),
            "{state}"
        );
        // There is no part.
        let grasp = [
            "grip",
            "gripper",
            "grasp",
            "20mm",
            "30N",
            "--yes",
            "--speed=1",
        ];
        let grasp = cell.run(&grasp);
        expect_status(&grasp, 1);
        assert!(
            complaint(&grasp).contains("found no part of this width"),
            "{}",
            complaint(&grasp)
        );
        for (args, status, cause) in [
            (
                &["gripper", "width", "-1mm"][..],
                2,
                "the width is -0.001 m",
            ),
            (&["gripper", "width", "20"], 2, "write a number and a unit"),
            (
                &["gripper", "grasp", "20mm", "0"],
                2,
                "the force is 0 N; it is above 0",
            ),
            (
                &["gripper", "open"],
                2,
                "moving gripper (schunk_wsg) can set a machine in motion",
            ),
            (&["hand", "open"], 1, "hint: the controller has gripper"),
        ] {
            let output = cell.run(&[&["grip"], args].concat());
            expect_status(&output, status);
            assert!(
                complaint(&output).contains(cause),
                "{args:?}: {}",
                complaint(&output)
            );
        }
    });
}

#[test]
fn io_commands_list_get_and_set() {
    let _alone = alone();
    steady(|| {
        let cell = Cell::start("two_lwr");
        let all = cell.good(&["io", "list"]);
        assert!(all.contains("left (kuka_lwr_fri)\n  in0 to in15 "), "{all}");
        assert!(all.contains("right (kuka_lwr_fri)"), "{all}");
        let set = |args: &[&str]| cell.good(&[&["io", "set", "left"], args, &["--yes"]].concat());
        set(&["out3", "true"]);
        assert_eq!(cell.good(&["io", "get", "left", "out3"]), "true\n");
        set(&["out3", "off"]);
        set(&["aout1", "-2.5"]);
        assert_eq!(cell.good(&["io", "get", "left", "aout1"]), "-2.5\n");
        set(&["out4", "true", "--for", "100ms"]);
        let left = object(&cell.good(&["io", "list", "left", "--json"]));
        assert_eq!(
            (&left["out"][3], &left["out"][4]),
            (&false.into(), &false.into())
        );
        for (args, status, cause) in [
            (
                &["set", "left", "in0", "true"][..],
                2,
                "inputs cannot be set\nhint:",
            ),
            (&["set", "left", "out0", "2"], 2, "`2` is no state"),
            (&["set", "left", "aout0", "NaN"], 2, "`NaN` is no value"),
            (
                &["set", "left", "aout0", "1", "--for", "1s"],
                2,
                "--for is for digital outputs",
            ),
            (
                &["set", "left", "out0", "true", "--for", "7200s"],
                2,
                "at most 3600 s",
            ),
            (
                &["set", "left", "out0", "true"],
                2,
                "setting an output of left (kuka_lwr_fri)",
            ),
            (
                &["set", "left", "out16", "true"],
                1,
                "there is no digital output 16\nhint: ports count from 0",
            ),
            (
                &["get", "left", "ain16"],
                1,
                "there is no analogue input 16",
            ),
            (&["get", "left", "x0"], 2, "`x0` is no port"),
            (
                &["get", "middle", "in0"],
                1,
                "hint: the controller has left, right",
            ),
        ] {
            let output = cell.run(&[&["io"], args].concat());
            expect_status(&output, status);
            assert!(
                complaint(&output).contains(cause),
                "{args:?}: {}",
                complaint(&output)
            );
        }
    });
}

#[test]
fn taught_frame_is_written_into_cell_file() {
    let _alone = alone();
    steady(|| {
        let cell = Cell::start("two_lwr");
        cell.good(&BENT);
        let file = "[[device]]\nname = \"left\"\ntype = \"kuka_lwr_fri\" # KRC 2\n";
        let file = cell.folder.write("cell.toml", file);
        let frame = ["cell", "frame", "slot", "--from", "left", "--config", &file];
        let text = cell.good(&frame);
        assert!(text.contains("frame `slot`"), "{text}");
        let written = std::fs::read_to_string(&file).unwrap();
        assert!(written.contains("# KRC 2"), "{written}");
        let read = takt_devices::parse_cell(&written).unwrap();
        let hint = &read.frames.frames[0].hints["left"];
        assert!((hint[3] + 70.0).abs() < 0.1, "{written}");
        let output = cell.run(&["cell", "frame", "a.b", "--from", "left"]);
        expect_status(&output, 2);
        assert!(
            complaint(&output).contains("contains a dot"),
            "{}",
            complaint(&output)
        );
    });
}
