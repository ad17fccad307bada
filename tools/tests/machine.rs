//! `takt machine` against a running controller: each command, its output and its exit status; what is wrong with a file, a name, a
//! request. What machines do is tested elsewhere.

#![expect(clippy::panic, reason = "a test that cannot go on ends")]

mod common;

use std::process::Output;

use common::{Cell, Folder, Process, alone, complaint, expect_status, run};

const COMPONENT: &str = "component Counter {
  property step: int range 0 .. 10 default 1 live;
  property first: int range 0 .. 100 default 0;
  out count: int;
  operation clear(to: int range 0 .. 100);
}
{ step=Core::IntNetcommIn(Key='step', Value='$step'), first=Core::IntValue(Value='$first'),
  calls=Core::IntNetcommIn(Key='clear'), to=Core::IntNetcommIn(Key='clear_to'),
  sum=Core::IntAdd(inFirst=step.outValue, inSecond=to.outValue),
  all=Core::IntAdd(inFirst=sum.outValue, inSecond=first.outValue),
  count=Core::IntNetcommOut(inValue=all.outValue, Key='count'),
  cancel=Cancel(), outTerminate=cancel.outCancel }
";

const MACHINE: &str = "machine M {
  component c from \"c.component\" started;
  param wanted: int = 1;
  event go; event bad;
  initial state A { transition on go to B; transition if false to Z; }
  state B { entry { c.step := wanted; } transition on bad to C; transition if c.count == 60 to Z; }
  state C { entry { c.step := wanted * 20; } transition if false to Z; }
  final state Z { entry { stop c; } }
}
";

struct Bench {
    cell: Cell,
    folder: Folder,
    file: String,
}

impl Bench {
    fn start() -> Self {
        let folder = Folder::new();
        folder.write("c.component", COMPONENT);
        let file = folder.write("m.machine", MACHINE);
        Self {
            cell: Cell::start(),
            folder,
            file,
        }
    }

    fn machine(&self, args: &[&str]) -> Output {
        run(&[&["machine"], args, &["--connect", &self.cell.tcp]].concat())
    }

    /// Runs a command that is good; gives what it prints.
    #[track_caller]
    fn good(&self, args: &[&str]) -> String {
        expect_status(&self.machine(args), 0)
    }

    /// Waits for a state.
    #[track_caller]
    fn until(&self, part: &str) -> String {
        for _ in 0..500 {
            let text = self.good(&["state", "M"]);
            if text.contains(part) {
                return text;
            }
        }
        panic!("{part} is missing in {}", self.good(&["state", "M"]));
    }
}

#[test]
fn machine_is_loaded_commanded_watched_and_stopped() {
    let _alone = alone();
    let bench = Bench::start();
    assert_eq!(bench.good(&["state"]), "no machines\n");
    let toml = bench.folder.write("c.toml", "first = 50\n");
    let properties = format!("c={toml}");
    let load = [
        "load",
        &bench.file,
        "--param",
        "wanted=3",
        "--properties",
        &properties,
    ];
    assert_eq!(bench.good(&load), "M\n");
    let state = bench.good(&["state", "M"]);
    assert!(
        state.starts_with("M                    inactive   -\n"),
        "{state}"
    );
    for part in [
        "  c                  running",
        "  wanted             3\n",
        "a step costs up to",
    ] {
        assert!(state.contains(part), "{part}: {state}");
    }
    let mut watch = Process::start(&["machine", "watch", "M", "--connect", &bench.cell.tcp]);
    watch.wait_for("inactive   -");
    bench.good(&["start", "M"]);
    watch.wait_for("active     A");
    bench.good(&["call", "M", "M.pause()", "raise go"]);
    assert_eq!(bench.good(&["step", "M"]).trim(), "B");
    watch.wait_for("active     B");
    let json = bench.good(&["state", "--json"]);
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(json["M"]["state"], "B");
    assert_eq!(json["M"]["components"]["c"]["phase"], "running");
    let picture = bench.good(&["graph", "M", "--live"]);
    assert!(
        picture.starts_with("<svg") && picture.contains(">B</text>"),
        "{picture}"
    );
    // 50 of the file, 3 of the parameter, and 7 of the call.
    let script = "# A script.\nwait 10ms\nc.clear(7);\n\nM.start()\n";
    let script = bench.folder.write("script.txt", script);
    bench.good(&["call", "M", "--script", &script]);
    let (lines, status) = watch.end();
    assert_eq!(status, Some(0), "{lines:#?}");
    assert!(
        lines
            .last()
            .is_some_and(|line| line.contains("finished   Z")),
        "{lines:#?}"
    );
    let refused = bench.machine(&["stop", "M"]);
    expect_status(&refused, 1);
    assert!(complaint(&refused).contains("while the machine is finished"));
    bench.good(&["end", "M"]);
    assert_eq!(bench.good(&["state"]), "no machines\n");
    // Loaded and started at once, then stopped from its first state.
    bench.good(&["load", &bench.file, "--start"]);
    bench.until("active     A");
    bench.good(&["stop", "M"]);
    bench.until("finished   Z");
}

#[test]
fn machine_that_fails_ends_commands_with_1() {
    let _alone = alone();
    let bench = Bench::start();
    bench.good(&["load", &bench.file, "--start"]);
    let watch = Process::start(&["machine", "watch", "M", "--connect", &bench.cell.tcp]);
    bench.good(&["call", "M", "raise go"]);
    bench.until("active     B");
    bench.good(&["call", "M", "raise bad"]);
    let (lines, status) = watch.end();
    assert_eq!(status, Some(1), "{lines:#?}");
    let text = lines.join("\n");
    assert!(
        text.contains(
            "M failed in state C (line 7): the value is null, not finite or out of its range"
        ),
        "{text}"
    );
    assert!(text.contains("hint: check the value before"), "{text}");
    assert!(
        bench
            .until("failed     C")
            .contains("last error in state C (line 7)")
    );
    expect_status(&bench.machine(&["stop", "M"]), 1);
    bench.good(&["end", "M"]);
}

#[test]
#[expect(clippy::too_many_lines, reason = "a table")]
fn machine_commands_refused_name_cause_and_hint() {
    let _alone = alone();
    let bench = Bench::start();
    bench.good(&["load", &bench.file]);
    let file = |name: &str, text: &str| bench.folder.write(name, text);
    let script = file("bad.txt", "c.step := 2\nc.sted := 2\n");
    let unspaced = file("wait.txt", "wait 5\n");
    let cpf = file("c.cpf", "<properties><simple");
    let cpf = format!("c={cpf}");
    let range = format!("c={}", file("range.toml", "step = 11\n"));
    let named = format!("d={}", file("named.toml", "step = 1\n"));
    let other = file("n.machine", &MACHINE.replace("machine M", "machine N"));
    let broken = file("broken.machine", &MACHINE.replace("to B;", "to Bee;"));
    let missing = file(
        "missing.machine",
        &MACHINE.replace("c.component", "d.component"),
    );
    let mut wrong = Vec::new();
    for (args, status, cause) in [
        (
            &["load", &bench.file][..],
            1,
            "a machine `M` is loaded already",
        ),
        (&["load", &broken], 1, "`Bee`"),
        (&["load", &missing], 1, "cannot read d.component"),
        (
            &["load", "nowhere.machine"],
            2,
            "cannot read nowhere.machine",
        ),
        (
            &["load", &other, "--param", "wanted=much"],
            1,
            "parameter `wanted`: `much` is not a",
        ),
        (
            &["load", &other, "--param", "last=1"],
            1,
            "no parameter `last`",
        ),
        (
            &["load", &other, "--param", "wanted"],
            2,
            "NAME=VALUE is expected",
        ),
        (
            &["load", &other, "--properties", "c"],
            2,
            "COMPONENT=FILE is expected",
        ),
        (
            &["load", &other, "--properties", "c=nowhere.toml"],
            2,
            "cannot read nowhere.toml",
        ),
        (
            &["load", &other, "--properties", &cpf],
            1,
            "properties of c",
        ),
        (
            &["load", &other, "--properties", &range],
            1,
            "11 is not in the range 0 to 10",
        ),
        (
            &["load", &other, "--properties", &named],
            1,
            "there is no such component",
        ),
        (
            &["start", "N"],
            1,
            "there is no machine `N`\nhint: loaded are M",
        ),
        (&["stop", "N"], 1, "there is no machine `N`"),
        (
            &["stop", "M"],
            1,
            "`stop` is not possible while the machine is inactive",
        ),
        (
            &["step", "M"],
            1,
            "`step` is not possible while the machine is inactive\nhint: activate it first",
        ),
        (&["step", "N"], 1, "there is no machine `N`"),
        (&["end", "N"], 1, "there is no machine `N`"),
        (&["state", "N"], 1, "there is no machine `N`"),
        (&["watch", "N"], 1, "there is no machine `N`"),
        (&["graph", "N", "--live"], 1, "there is no machine `N`"),
        (
            &["graph", "M", "--live", "--machine", "I"],
            1,
            "invalid machine",
        ),
        (
            &["call", "M", "c.start()"],
            1,
            "`start` is not allowed while the component is running",
        ),
        (&["call", "M", "c.clear()"], 1, "clear"),
        (
            &["call", "M", "c.step := 2; c.sted := 2"],
            1,
            "the component has no such property",
        ),
        (&["call", "M", "--script", &script], 1, "bad.txt:2"),
        (&["call", "M", "--script", &unspaced], 2, "wait.txt:1"),
        (
            &["call", "M", "--script", "nowhere.txt"],
            2,
            "cannot read nowhere.txt",
        ),
        (&["call", "M"], 2, "required"),
        (&["stop", "M", "--timeout", "5"], 2, "--timeout"),
    ] {
        let output = bench.machine(args);
        let text = complaint(&output);
        if output.status.code() != Some(status) || !text.contains(cause) {
            wrong.push(format!(
                "{cause}: {args:?}: {:?} {text}",
                output.status.code()
            ));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
    assert!(
        bench
            .good(&["state"])
            .starts_with("M                    inactive")
    );
    // No controller is there.
    let unreachable = run(&["machine", "state", "--connect", "127.0.0.1:1"]);
    expect_status(&unreachable, 2);
}

#[test]
fn machine_state_beyond_timeout_is_named() {
    let _alone = alone();
    let bench = Bench::start();
    let file = bench.folder.write(
        "slow.machine",
        &MACHINE.replace("entry { stop c; }", "entry { wait 1000s; stop c; }"),
    );
    bench.good(&["load", &file, "--start"]);
    let output = bench.machine(&["stop", "M", "--timeout", "50ms"]);
    expect_status(&output, 1);
    let text = complaint(&output);
    assert!(
        text.contains("M has not ended within 50ms; it is in state Z\nhint: `takt machine end M`"),
        "{text}"
    );
    bench.good(&["end", "M"]);
    assert_eq!(bench.good(&["state"]), "no machines\n");
}
