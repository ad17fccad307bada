//! `takt irl run` on controllers: on a simulated arm, whose inputs have the values of its outputs, with requests, faults and refusals;
//! and the programs of the examples on emulated arms. What programs do is tested in takt-irl.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on ends")]

mod common;

use std::collections::BTreeMap;
use std::os::unix::fs::PermissionsExt as _;
use std::process::{Output, Stdio};

use common::{Cell, Folder, Process, alone, complaint, expect_status, run, takt};
use takt_core::CellConfig;
use takt_embedded::Embedded;
use takt_tests::steady;

fn example(name: &str) -> String {
    format!("{}/../examples/irl/{name}", env!("CARGO_MANIFEST_DIR"))
}

const SPEC: &str = "<system><robot name='arm' model='kuka_lwr4' speed_ptp='0.5'>
  <joint min='-170' max='170' speed='110' acceleration='400' jerk='4000'/>
  <joint min='-120' max='120' speed='110' acceleration='400' jerk='4000'/>
  <joint min='-170' max='170' speed='128' acceleration='400' jerk='4000'/>
  <joint min='-120' max='120' speed='128' acceleration='400' jerk='4000'/>
  <joint min='-170' max='170' speed='204' acceleration='600' jerk='6000'/>
  <joint min='-120' max='120' speed='184' acceleration='600' jerk='6000'/>
  <joint min='-170' max='170' speed='184' acceleration='600' jerk='6000'/>
</robot>
<signal name='ready' direction='in' kind='digital' channel='0'/>
<signal name='order' direction='in' kind='binary' channel='0' bits='3' io='left:1'/>
<signal name='lamps' direction='out' kind='binary' channel='0' bits='3' io='left:1'/>
</system>";

const PROGRAM: &str = "program one; system_specification \"one.spc\";
var n, m, zero: int;
  a: array[1..2] of int;
signal in ready = \"ready\"; in order = \"order\"; out lamps = \"lamps\";
begin
  n := 1;
  move_inc ptp mainjoint(5, 0, 0, 0, 0, 0, 0);
  wait for ready;
  lamps := 5;
  wait for order = 5 timeout 10;
  m := order; a[2] := m;
  if ready then n := 2; endif;
  n := n div 1;
endprogram;
";

/// A controller with a simulated LWR, `left`, and programs for it.
struct Bench {
    address: String,
    folder: Folder,
    token: String,
    _embedded: Embedded,
}

impl Bench {
    fn start() -> Self {
        let embedded = Embedded::start(&CellConfig::default()).unwrap();
        let controller = embedded.controller().unwrap();
        let list = |value: f64| format!("{:?}", [value; 5]);
        let limits = [
            ("min_joint", -2.0),
            ("max_joint", 2.0),
            ("max_vel", 2.0),
            ("max_acc", 4.0),
        ];
        let limits = limits.map(|(key, value)| (key.to_owned(), list(value)));
        let of_sheet = BTreeMap::new();
        controller
            .add_device("left", "kuka_lwr_sim", &of_sheet)
            .unwrap();
        let small = controller.add_device("small", "kuka_youbot_arm_sim", &limits.into());
        small.unwrap();
        let folder = Folder::new();
        folder.write("one.spc", SPEC);
        folder.write("one.irl", PROGRAM);
        let token = folder.write("token", embedded.token().unwrap().text());
        let mode = std::fs::Permissions::from_mode(0o600);
        std::fs::set_permissions(&token, mode).unwrap();
        Self {
            address: embedded.address().to_string(),
            token,
            folder,
            _embedded: embedded,
        }
    }

    fn command(&self, args: &[&str]) -> std::process::Command {
        let mut command = takt(&["irl", "run", &self.folder.file("one.irl")]);
        command.args(["--connect", &self.address, "--token-file", &self.token]);
        command.args(["--robot", "arm=left"]).args(args);
        command
    }

    fn run(&self, args: &[&str]) -> Output {
        self.command(args).output().unwrap()
    }

    /// A run that takes requests.
    fn asked(&self, args: &[&str]) -> Process {
        let mut command = self.command(args);
        command.stdin(Stdio::piped());
        Process::spawn(command)
    }
}

#[test]
fn irl_run_takes_requests_at_its_lines() {
    let _alone = alone();
    steady(|| {
        let bench = Bench::start();
        let mut run = bench.asked(&["--paused", "--input", "ready=0"]);
        run.wait_for("paused at 6: n := 1;");
        run.enter("print");
        run.wait_for("zero = 0");
        run.enter("step");
        run.wait_for("paused at 7: move_inc ptp");
        run.enter("print n");
        run.wait_for("n = 1");
        run.enter("break 12");
        run.enter("continue");
        run.wait_for("8: wait for ready;");
        run.enter("pause");
        run.enter("set ready=true");
        run.enter("continue");
        // The bits of the output come back as the bits of the input.
        run.wait_for("lamps = 5");
        run.wait_for("paused at 12: if ready");
        run.enter("print a");
        run.wait_for("a[2] = 5");
        for (request, reply) in [
            ("leap", "`leap` is no request"),
            ("print q", "no variable q is watched"),
            (
                "set order=1",
                "cannot set order: its value comes from left:1",
            ),
            ("set lamps=1", "cannot set lamps: it is an output"),
            ("set redy=1", "the program has no signal `redy`"),
            ("set ready=2", "give 0 or 1"),
            ("override 2", "`override` needs 0 to 1"),
        ] {
            run.enter(request);
            run.wait_for(reply);
        }
        for line in 20..40 {
            run.enter(&format!("break {line}"));
        }
        run.wait_for("at most 16 breakpoints are possible");
        run.enter("clear 12");
        run.enter("continue");
        let (lines, status) = run.end();
        assert_eq!(status, Some(0), "{lines:#?}");
        assert!(
            lines.last().unwrap().contains("one.irl: ended after"),
            "{lines:#?}"
        );
    });
}

#[test]
fn irl_run_stops_on_request_and_signal() {
    let _alone = alone();
    steady(|| {
        let bench = Bench::start();
        let text = PROGRAM.replace("(5, 0,", "(160, 0,");
        bench.folder.write("one.irl", &text);
        for by_signal in [false, true] {
            let mut run = bench.asked(&["--input", "ready=1", "--override", "0.2"]);
            run.wait_for("8: wait for ready;");
            run.enter("override 0.1");
            if by_signal {
                run.signal("INT");
                run.wait_for("stopped: waiting for rest");
            } else {
                run.enter("stop");
            }
            let (lines, status) = run.end();
            assert_eq!(status, Some(0), "{lines:#?}");
            assert!(
                !lines.iter().any(|line| line.contains("lamps")),
                "{lines:#?}"
            );
        }
        let list = run(&[
            "net",
            "list",
            "--connect",
            &bench.address,
            "--token-file",
            &bench.token,
        ]);
        assert!(!expect_status(&list, 0).contains("RUNNING"));
    });
}

#[test]
fn irl_run_breakpoint_option_and_end_of_requests() {
    let _alone = alone();
    steady(|| {
        let bench = Bench::start();
        let mut run = bench.asked(&["--input", "ready=1", "--break", "12"]);
        run.wait_for("paused at 12:");
        run.enter("b 13");
        run.enter("s");
        run.wait_for("paused at 13:");
        run.close();
        // No request can make it continue: it is stopped.
        run.signal("INT");
        let (lines, status) = run.end();
        assert_eq!(status, Some(0), "{lines:#?}");
    });
}

#[test]
fn irl_run_fault_ends_with_location() {
    let _alone = alone();
    steady(|| {
        let bench = Bench::start();
        bench
            .folder
            .write("one.irl", &PROGRAM.replace("n div 1", "n div zero"));
        let failed = bench.run(&["--input", "ready=1"]);
        expect_status(&failed, 1);
        let text = complaint(&failed);
        let why =
            "program one failed at 13:8: division by zero\nhint: compare the divisor with 0 before";
        assert!(text.contains(why), "{text}");
        // An output of three bits.
        bench
            .folder
            .write("one.irl", &PROGRAM.replace("lamps := 5", "lamps := n * 9"));
        let failed = bench.run(&["--input", "ready=1"]);
        expect_status(&failed, 1);
        let text = complaint(&failed);
        let why = "program one failed at 9:3: the value does not fit the bits of the output";
        assert!(text.contains(why), "{text}");
        bench
            .folder
            .write("one.irl", &PROGRAM.replace("lamps := 5", "lamps := 8"));
        let refused = bench.run(&["--input", "ready=1"]);
        expect_status(&refused, 1);
        let text = complaint(&refused);
        assert!(
            text.contains("E0304") && text.contains("takes 0 to 7"),
            "{text}"
        );
    });
}

/// Options, exit status and cause.
const WRONG: [(&[&str], i32, &str); 12] = [
    (
        &[],
        2,
        "inputs of the program have no device: ready\nhint: name it with --signal ready=DEVICE:PORT",
    ),
    (&["--signal", "ready=left"], 2, "`left` is not DEVICE:PORT"),
    (
        &["--signal", "redy=left:0"],
        2,
        "the program has no signal `redy`",
    ),
    (
        &["--signal", "ready=up:0"],
        2,
        "signal ready: there is no device with inputs or outputs `up`\nhint: the controller has left",
    ),
    (
        &["--signal", "ready=left:8"],
        2,
        "signal ready: left: there is no digital input 8",
    ),
    (
        &["--input", "ready=1", "--signal", "order=left:6"],
        2,
        "signal order: left: there is no digital input 8",
    ),
    (
        &["--input", "ready=1", "--signal", "ready=left:0"],
        2,
        "input `ready` has a device and a value",
    ),
    (
        &["--signal", "ready=left:0", "--signal", "READY=left:1"],
        2,
        "is bound twice",
    ),
    (
        &["--input", "ready=1", "--input", "order=8"],
        2,
        "a whole number within its bits",
    ),
    (
        &["--input", "ready=1", "--robot", "legs=left"],
        2,
        "the program has no robot `legs`\nhint: its robots are arm",
    ),
    (
        &["--input", "ready=1", "--robot", "arm=right"],
        2,
        "robot arm is bound twice",
    ),
    (&["--input", "ready=1", "--break", "0"], 2, "--break"),
];

#[test]
fn irl_run_refuses_wrong_bindings() {
    let _alone = alone();
    steady(|| {
        let bench = Bench::start();
        for (args, status, cause) in WRONG {
            let refused = bench.run(args);
            expect_status(&refused, status);
            let text = complaint(&refused);
            assert!(text.contains(cause), "{args:?}: {text}");
        }
    });
}

#[test]
fn irl_run_refuses_other_arms_and_shared_outputs() {
    let _alone = alone();
    steady(|| {
        let bench = Bench::start();
        // An arm with other joints is refused by the net, and nothing begins.
        let file = bench.folder.file("one.irl");
        let args = [
            "irl",
            "run",
            &file,
            "--connect",
            &bench.address,
            "--token-file",
            &bench.token,
        ];
        let other = run(&[&args[..], &["--robot", "arm=small", "--input", "ready=1"]].concat());
        expect_status(&other, 1);
        let text = complaint(&other);
        assert!(
            text.contains("robot `arm` of the program has 7 joints, device `small` has 5"),
            "{text}"
        );
        let none = run(&[&args[..], &["--input", "ready=1"]].concat());
        expect_status(&none, 2);
        let text = complaint(&none);
        let cause = "robot arm of the program has no arm `arm`\nhint: name one with --robot arm=ARM; the controller has left, small";
        assert!(text.contains(cause), "{text}");
        // Two signals at one output.
        bench.folder.write(
        "one.spc",
        &SPEC.replace(
            "</system>",
            "<signal name='more' direction='out' kind='digital' channel='0' io='left:3'/></system>",
        ),
    );
        let shared = bench.run(&["--input", "ready=1"]);
        expect_status(&shared, 2);
        let text = complaint(&shared);
        assert!(
            text.contains("signals `lamps` and `more` both set output left:3"),
            "{text}"
        );
        // A device that is left out: its signals are values of the net.
        let free = [
            "--signal",
            "more=none",
            "--input",
            "ready=1",
            "--signal",
            "lamps=none",
            "--input",
            "order=5",
        ];
        let free = expect_status(&bench.run(&free), 0);
        assert!(free.contains("lamps = 5"), "{free}");
    });
}

#[test]
fn irl_run_asks_before_real_arms_move() {
    let _alone = alone();
    let mut cell = Cell::start();
    let _arm = cell.arm();
    let file = example("lwr.irl");
    let args = [
        "irl",
        "run",
        &file,
        "--connect",
        &cell.tcp,
        "--robot",
        "lwr=left",
    ];
    let refused = run(&args);
    expect_status(&refused, 2);
    let text = complaint(&refused);
    assert!(
        text.contains("moving left can set a machine in motion"),
        "{text}"
    );
    steady(|| {
        let ended = run(&[&args[..], &["--yes"]].concat());
        let out = expect_status(&ended, 0);
        assert!(out.contains("move circle start"), "{out}");
        assert!(out.contains(": ended after "), "{out}");
    });
}

/// Runs a program of the examples on an emulated cell.
fn emulated(cell: &str, robots: &[(&str, &str)]) {
    let _alone = alone();
    for (robot, arm) in robots {
        steady(|| {
            let file = example(&format!("{robot}.irl"));
            let bound = format!("{robot}={arm}");
            let ended = run(&["irl", "run", &file, "--emulated", cell, "--robot", &bound]);
            let out = expect_status(&ended, 0);
            assert!(out.contains(": ended after "), "{out}");
        });
    }
}

#[test]
fn irl_program_runs_on_emulated_tx90_and_youbot() {
    emulated("factory", &[("tx90", "tx90"), ("youbot", "arm")]);
}

#[test]
fn irl_program_runs_on_emulated_iiwa_with_signals() {
    let _alone = alone();
    steady(|| {
        let folder = Folder::new();
        let config = folder.write(
            "cell.toml",
            "[controller]\nwebsocket = \"127.0.0.1:0\"\ntcp = \"127.0.0.1:0\"\n\
             [[device]]\nname = \"iiwa\"\ntype = \"kuka_iiwa_fri\"\nmodel = \"iiwa14\"\nlisten = \"127.0.0.1:0\"\n\
             io = { bool_in = [\"Media.Part\"], bool_out = [\"Media.Light\"] }\n",
        );
        let mut cell = Process::start(&["run", "--config", &config]);
        let address = |line: String, before: &str| line.rsplit_once(before).unwrap().1.to_owned();
        let tcp = address(cell.wait_for("lines at tcp"), "tcp ");
        let udp = address(cell.wait_for("waits for its robot"), "udp ");
        let shared = [
            "--input",
            "Media.Part=true",
            "--output",
            "Media.Light=false",
        ];
        let _arm = Process::start(&[&["emulate", "iiwa", "--connect", &udp], &shared[..]].concat());
        cell.wait_for("now=operational");
        let file = example("iiwa.irl");
        let ended = run(&["irl", "run", &file, "--connect", &tcp, "--yes"]);
        let out = expect_status(&ended, 0);
        assert!(
            out.contains("light = true") && out.contains(": ended after "),
            "{out}"
        );
    });
}
