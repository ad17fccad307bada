//! Statements and what they do; errors and where they are; object code and how it is damaged. Motions are in `motion.rs`.

#![allow(
    clippy::unwrap_used,
    reason = "tests and their helpers fail by panicking"
)]
#![allow(clippy::too_many_lines, reason = "tables of statements and errors")]

mod common;

use common::{Run, TWO, errors, run};
use takt_irl::{CodeError, Control, FaultKind, Machine, Phase, Program, System, compile};

#[test]
fn specification_xml_equals_toml() {
    let xml = include_str!("../../../examples/irl/two.xml.spc");
    assert_eq!(System::parse(xml).unwrap(), System::parse(TWO).unwrap());
    let refused = |from: &str, to: &str| {
        System::parse(&xml.replacen(from, to, 1))
            .unwrap_err()
            .to_string()
    };
    for (from, to, why) in [
        (
            "<tool ",
            "<tol ",
            "line 5: `<tol>` is not allowed inside robot",
        ),
        (
            "max=\"180\"",
            "max=\"half\"",
            "line 7: `max` is no number: `half`",
        ),
        ("jerk=\"12000\"", "jolt=\"12000\"", "jolt"),
        ("</system>", "", "is not one closed element"),
        ("<tool z", "<tool w", "a frame has x, y, z, a, b and c"),
        (
            "min=\"-180\"",
            "min=\"200\"",
            "joint 1: min must be below max",
        ),
        ("</robot>", "</robt>", "malformed XML"),
        (
            "<home positions=\"0 0",
            "<home positions=\"0 north",
            "are numbers with spaces between",
        ),
        (
            "<system>",
            "<!DOCTYPE s [<!ENTITY a \"b\">]><system>",
            "with definitions is not accepted",
        ),
    ] {
        let found = refused(from, to);
        assert!(found.contains(why), "{from} to {to}: {found}");
    }
}

#[test]
fn statements_give_expected_values() {
    let cases: &[(&str, &str, f64)] = &[
        ("var x: int;", "x := 2 + 3 * 4 - 10 div 3;", 11.0),
        ("var x: int;", "x := -7 mod 3;", -1.0),
        ("var x: real;", "x := 1 / 4 + 2;", 2.25),
        ("var x: real;", "x := sin(30) + sqrt(16) + abs(-2.0);", 6.5),
        (
            "var x: int;",
            "x := abs(-3) + round(2.6) + trunc(-2.6);",
            4.0,
        ),
        (
            "var x: bool;",
            "x := 1 < 2 and not (3 = 4) exor false;",
            1.0,
        ),
        (
            "var x: int;",
            "if 1 > 2 then x := 1; elsif 2 > 1 then x := 2; else x := 3; endif;",
            2.0,
        ),
        (
            "var x, i: int;",
            "for i := 1 to 10 do x := x + i; endfor;",
            55.0,
        ),
        (
            "var x, i: int;",
            "for i := 10 to 1 step -3 do x := x * 10 + i; endfor;",
            10_741.0,
        ),
        (
            "var x: int; i: real;",
            "for i := 0 to 1 step 0.25 do x := x + 1; endfor;",
            5.0,
        ),
        (
            "var x: int;",
            "while true do x := x + 1; if x = 7 then exit; endif; endwhile;",
            7.0,
        ),
        ("var x: int;", "repeat x := x + 2; until x >= 9;", 10.0),
        (
            "var x: int;",
            "case 4 of when 1, 2: x := 1; when 3, 4: x := 2; default: x := 3; endcase;",
            2.0,
        ),
        (
            "var x: int;",
            "case 9 of when 1: x := 1; default: x := 3; endcase;",
            3.0,
        ),
        (
            "var x: int; c: char := \"a\";",
            "case c of when \"a\": x := ord(c); endcase;",
            97.0,
        ),
        (
            "type v = array[-1..1, 1..2] of int; var a: v; x, i: int;",
            "i := 1; a[-i, i + 1] := 5; x := a[-1, 2];",
            5.0,
        ),
        (
            "type r = record a: int; b: array[1..3] of real; endrecord; var p, q: r; x: real; i: int;",
            "i := 2; p.b[i] := 1.5; q := p; x := q.b[2];",
            1.5,
        ),
        (
            "var x: int; procedure add(in n: int; inout s: int); begin s := s + n; endproc;",
            "add(3, x); add(4, x);",
            7.0,
        ),
        (
            "var x: int; function twice(in n: int): int; var t: int; begin t := n; return t + n; endfct;",
            "x := twice(twice(3)) + twice(1);",
            14.0,
        ),
        (
            "const n := 4; m: real := n; var x: real;",
            "x := m / n;",
            1.0,
        ),
        (
            "var x: real; p: position;",
            "p := (1, 2, 3) + 2.0 * 1 * (1, 0, 0) * 1.0; x := p.x;",
            f64::NAN,
        ),
        (
            "var x: real; p: position;",
            "p := (1, 2, 3) + position(1, 0, 0) * 2.0; x := p.x;",
            3.0,
        ),
        (
            "var x: real; a: pose;",
            "a := pose((10, 0, 0), orizyx(90, 0, 0)); x := (a @ inv(a) @ a @ (1, 0, 0)).y;",
            f64::NAN,
        ),
        (
            "var x: real; a: pose; p: position;",
            "a := pose((10, 0, 0), orizyx(90, 0, 0)); p := a @ position(1, 0, 0); x := p.y;",
            1.0,
        ),
        (
            "var x: real;",
            "x := anglez(orizyx(30, 20, 10)) + dot(cross((1, 0, 0), (0, 1, 0)), (0, 0, 1));",
            31.0,
        ),
        (
            "var x: real;",
            "tx90.r_speed := 300; x := tx90.r_speed + tx90.r_joint_act.a3;",
            390.0,
        ),
        (
            "var x: int; signal out grip = \"grip\"; in part = \"part_present\";",
            "grip := part; if grip then x := 1; endif;",
            1.0,
        ),
        (
            "var x: int; e: event;",
            "par seq wait for e; x := x * 2; endseq seq x := 3; signal event e; endseq endpar",
            6.0,
        ),
        (
            "var x: int;",
            "wait for false timeout 0.02; if timed_out then x := 5; endif;",
            5.0,
        ),
        ("var x: int;", "x := 1; pause; x := 2; halt; x := 3;", 2.0),
    ];
    for (declarations, statements, expected) in cases {
        let text = format!("program t; {declarations} begin {statements} endprogram;");
        if expected.is_nan() {
            assert!(!errors(&text).is_empty(), "{text}");
            continue;
        }
        let run = run(&text);
        assert_eq!((run.phase, run.fault), (Phase::Ended, None), "{text}");
        let x = run.value("x");
        assert!((x - expected).abs() < 1e-9, "{text}: {x}");
    }
}

#[test]
fn errors_have_code_location_and_hint() {
    let cases = [
        (
            "program t; tx9.r_speed := 1; endprogram;",
            "E0201 1:12 did you mean `tx90`?",
        ),
        (
            "program t; var a: int; begin a = 1; endprogram;",
            "E0102 1:32 `:=` assigns",
        ),
        (
            "program t; var a: int; begin a := 1 endprogram;",
            "E0102 1:37 each statement",
        ),
        (
            "program t; var a: int begin a := 1; endprogram;",
            "E0102 1:23 each statement",
        ),
        (
            "program t; var a: int; begin ab := 1; endprogram;",
            "E0201 1:30 did you mean `a`?",
        ),
        (
            "program t; var a: int; b: bool; begin a := b; endprogram;",
            "E0301 1:44 ",
        ),
        (
            "program t; var a: int; begin a := 1.5; endprogram;",
            "E0301 1:35 `round(x)`",
        ),
        ("program t; var a, a: int; begin endprogram;", "E0202 1:19 "),
        (
            "program t; var a: array[1..3] of int; begin a[4] := 1; endprogram;",
            "E0304 1:47 ",
        ),
        (
            "program t; var a: array[3..1] of int; begin endprogram;",
            "E0304 1:25 ",
        ),
        (
            "program t; var n: int; a: array[1..n] of int; begin endprogram;",
            "E0303 1:36 ",
        ),
        (
            "program t; const c := 1; begin c := 2; endprogram;",
            "E0203 1:32 ",
        ),
        (
            "program t; const c := (1, 2, 3); begin c.x := 2; endprogram;",
            "E0305 1:40 ",
        ),
        (
            "program t; begin tx90.r_pose_act.pos.x := 2; endprogram;",
            "E0305 1:18 ",
        ),
        (
            "program t; procedure p; begin p; endproc; begin endprogram;",
            "E0306 1:31 the memory",
        ),
        ("program t; exit; endprogram;", "E0307 1:12 `return`"),
        (
            "program t; move ptp mainjoint(1,2,3) act_rob:=\"tx90\"; endprogram;",
            "E0403 1:21 ",
        ),
        (
            "program t; move ptp mainjoint(1,2,300,4,5,6) act_rob:=\"tx90\"; endprogram;",
            "E0403 1:35 ",
        ),
        (
            "program t; move ptp (1,2,3) act_rob:=\"tx9\"; endprogram;",
            "E0402 1:38 did you mean `tx90`?",
        ),
        (
            "program t; move ptp (1,2,3); endprogram;",
            "E0402 1:12 name one",
        ),
        (
            "program t; move ptp (1,2,3) act_rob:=\"lwr\" speed_ptp:=10; endprogram;",
            "E0304 1:55 it is a part",
        ),
        (
            "program t; move ptp (1,2,3) act_rob:=\"lwr\" sped_ptp:=1; endprogram;",
            "E0401 1:44 did you mean `speed_ptp`?",
        ),
        (
            "program t; move ptp (1,2,3) act_rob:=\"lwr\" speed:=1; endprogram;",
            "E0401 1:44 ",
        ),
        (
            "program t; move lin (1,2,3) act_rob:=\"lwr\" wobble:=1; endprogram;",
            "E0401 1:44 program the",
        ),
        (
            "program t; move lin mainjoint(1,2,3,4,5,6,7) act_rob:=\"lwr\"; endprogram;",
            "E0403 1:21 use `move ptp`",
        ),
        (
            "program t; par move ptp (1,2,3) act_rob:=\"lwr\"; move ptp (1,2,4) act_rob:=\"lwr\"; endpar endprogram;",
            "E0404 1:49 one branch",
        ),
        (
            "program t; signal in s = \"grp\"; begin endprogram;",
            "E0201 1:26 did you mean `grip`?",
        ),
        (
            "program t; signal in s = \"grip\"; begin endprogram;",
            "E0203 1:26 ",
        ),
        (
            "program t; signal in s = \"part_present\"; begin s := true; endprogram;",
            "E0305 1:48 ",
        ),
        (
            "program t; signal out c = \"count\"; begin c := 255; c := 256; endprogram;",
            "E0304 1:57 ",
        ),
        ("program t; ? endprogram;", "E0101 1:12 comments"),
        ("program t; while true do", "E0102 1:25 "),
        ("begin endprogram;", "E0102 1:1 "),
    ];
    for (text, expected) in cases {
        let found = errors(text);
        let first = found.first().cloned().unwrap_or_default();
        let (place, hint) = expected.split_at(expected.match_indices(' ').nth(1).unwrap().0);
        assert!(first.starts_with(place), "{text}\n{found:#?}");
        assert!(first.contains(hint.trim()), "{text}\n{found:#?}");
    }
}

#[test]
fn errors_are_reported_all_at_once() {
    let text = "program t;\nvar a: int;\nbegin\n  a := ;\n  b := 1;\n  if a then a := 1; endif;\n  a : = 2;\nendprogram;";
    let found = errors(text);
    let places: Vec<_> = found.iter().map(|e| e.split(' ').nth(1).unwrap()).collect();
    assert_eq!(places, ["4:8", "5:3", "6:6", "7:5"], "{found:#?}");
}

#[test]
fn faults_name_cause_and_statement() {
    let cases = [
        ("var x: int;", "x := 1 div x;", FaultKind::DivisionByZero),
        ("var x: real;", "x := 1 / x;", FaultKind::DivisionByZero),
        (
            "var x: int;",
            "x := 2147483647; x := x + 1;",
            FaultKind::Overflow,
        ),
        ("var x: real;", "x := sqrt(x - 1);", FaultKind::NotANumber),
        (
            "var x: int; a: array[1..3] of int;",
            "x := 4; a[x] := 1;",
            FaultKind::Index,
        ),
        (
            "var x: int; function f: int; begin endfct;",
            "x := f;",
            FaultKind::NoResult,
        ),
        (
            "var x: real; signal in p = \"pressure\";",
            "x := p;",
            FaultKind::NoInput,
        ),
        (
            "var x: real;",
            "x := 2; move ptp lwr.r_joint_act act_rob:=\"lwr\" speed_ptp:=x;",
            FaultKind::Attribute,
        ),
        (
            "var q: mainjoint := mainjoint(1, 2);",
            "move ptp q act_rob:=\"lwr\";",
            FaultKind::JointCount,
        ),
        (
            "var q: mainjoint;",
            "q := lwr.r_joint_act; q.a2 := 200; move ptp q act_rob:=\"lwr\";",
            FaultKind::JointLimit,
        ),
        (
            "",
            "move ptp (9000, 0, 0) act_rob:=\"lwr\";",
            FaultKind::Unreachable,
        ),
        (
            "var x: int; signal out count = \"count\";",
            "x := 255; count := x; x := x + 1; count := x;",
            FaultKind::SignalRange,
        ),
        (
            "var x: int; signal out count = \"count\";",
            "x := x - 1; count := x;",
            FaultKind::SignalRange,
        ),
    ];
    for (declarations, statements, expected) in cases {
        let run = run(&format!(
            "program t; {declarations} begin\n{statements} endprogram;"
        ));
        assert_eq!(run.phase, Phase::Failed, "{statements}");
        let fault = run.fault.unwrap();
        let line = if expected == FaultKind::NoResult {
            1
        } else {
            2
        };
        assert_eq!(
            (fault.kind, fault.at.line),
            (expected, line),
            "{statements}"
        );
        assert!(fault.to_string().len() > 10);
    }
}

#[test]
fn endless_program_is_bounded_in_each_cycle() {
    let run = Run::new(
        "program t; var x: int; begin while true do x := (x + 1) mod 100000; endwhile; endprogram;",
    );
    let mut machine = run.machine;
    for cycle in 1..=100_u32 {
        machine.cycle(Control::default());
        let x = machine.variable(variable(&machine, "x")).unwrap();
        assert!(x <= f64::from(cycle) * 200.0, "{cycle}: {x}");
        assert!(x >= f64::from(cycle) * 20.0, "{cycle}: {x}");
    }
}

fn variable(machine: &Machine, name: &str) -> usize {
    let variables = &machine.program().variables;
    variables.iter().position(|v| v.name == name).unwrap()
}

#[test]
fn object_code_changed_byte_is_refused() {
    let program = compile(
        "program t; var x: int; begin x := 1; endprogram;",
        &System::default(),
        "",
    )
    .unwrap();
    let code = program.program.encode();
    assert_eq!(Program::decode(&code).unwrap(), program.program);
    for at in 0..code.len() {
        let mut damaged = code.clone();
        damaged[at] ^= 0x10;
        let error = Program::decode(&damaged).unwrap_err();
        let fits = match at {
            0..4 => error == CodeError::Foreign,
            4 | 5 => matches!(error, CodeError::Version(_)),
            _ => matches!(error, CodeError::Damaged { .. }),
        };
        assert!(fits, "{at}: {error}");
        assert!(error.to_string().contains("\nhint: "), "{error}");
        assert!(Program::decode(&code[..at]).is_err());
    }
}

#[test]
fn object_code_and_listing_are_golden() {
    let text = "program t;\nvar x: int;\nbegin\n  x := 1 + x;\n  move ptp mainjoint(0, 0, 90, 0, 0, 0) act_rob:=\"tx90\" c_ptp:=0.2;\nendprogram;\n";
    let program = compile(text, &System::parse(TWO).unwrap(), "")
        .unwrap()
        .program;
    let listing = program.listing();
    let golden = include_str!("golden.lst");
    if std::env::var_os("TAKT_BLESS").is_some() {
        std::fs::write("tests/golden.lst", &listing).unwrap();
    } else {
        assert_eq!(listing, golden);
    }
    let code = program.encode();
    assert_eq!(&code[..6], b"TIRL\x02\x00");
    assert_eq!(crc32fast::hash(&code[10..]).to_le_bytes(), code[6..10]);
}

#[test]
fn specification_faults_are_named() {
    let cases = [
        (
            TWO.replacen(
                "joints = [",
                "joints = [ { min = 1, max = 0, speed = 1, acceleration = 1, jerk = 1 },",
                1,
            ),
            "min must be below max",
        ),
        (
            TWO.replacen("staubli_tx90", "staubli_tx91", 1),
            "no model `staubli_tx91`",
        ),
        (TWO.replacen("\"lwr\"", "\"tx90\"", 1), "given twice"),
        (
            TWO.replacen("\"tx90\"", "\"while\"", 1),
            "word of the language",
        ),
        (
            TWO.replacen("home = [0, 0, 90, 0, 60, 0]", "home = [0]", 1),
            "home needs",
        ),
        (TWO.replacen("direction", "directon", 1), "directon"),
    ];
    for (text, expected) in cases {
        let error = System::parse(&text).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn step_and_breakpoint_wait_before_lines() {
    let text = "program t; var n: int;
function next(in n: int): int; begin
  return n + 1; endfct; begin
  n := 1;
  while n < 3 do
    n := next(n) + 0;
  endwhile;
  n := 10; endprogram;";
    let line = |machine: &mut Machine, control: Control| {
        machine.cycle(control);
        (machine.phase(), machine.location().line)
    };
    let idle = Control::default();
    let step = Control { step: true, ..idle };
    let resume = Control {
        resume: true,
        ..idle
    };
    let mut machine = Run::new(text).machine;
    // A call returns to its line without waiting there again.
    for expected in [4, 5, 6, 2, 3, 5, 6, 2, 3, 5, 8] {
        assert_eq!(line(&mut machine, step), (Phase::Paused, expected));
        assert_eq!(line(&mut machine, idle), (Phase::Paused, expected));
    }
    line(&mut machine, resume);
    assert_eq!(machine.phase(), Phase::Ended);
    let mut machine = Run::new(text).machine;
    machine.set_breakpoints([0, 6, 3]);
    for expected in [6, 3, 6] {
        assert_eq!(line(&mut machine, resume), (Phase::Paused, expected));
    }
    machine.set_breakpoints([]);
    line(&mut machine, resume);
    assert_eq!(machine.phase(), Phase::Ended);
}

#[test]
fn specification_takes_model_from_urdf() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/cells");
    let folder = std::path::Path::new(folder);
    let joint = "{ min = -90, max = 90, speed = 90, acceleration = 360, jerk = 3600 }";
    let spec = |file: &str| {
        let joints = [joint; 6].join(", ");
        format!("[[robot]]\nname = \"ur\"\nmodel = \"urdf:{file}\"\njoints = [{joints}]\n")
    };
    let system = System::read_in(&spec("ur5e.urdf"), folder).unwrap();
    assert_eq!(system.robots[0].model, "urdf:ur5e");
    let text = "program p; var n: int; begin n := 1; endprogram;";
    let program = compile(text, &system, "").unwrap().program;
    // The object code needs no file.
    let copy = Program::decode(&program.encode()).unwrap();
    assert_eq!(
        copy.system.robots[0].model.text(),
        system.robots[0].model.text()
    );
    let error = System::read_in(&spec("panda.urdf"), folder).unwrap_err();
    assert!(error.to_string().contains("has 7 joints"), "{error}");
    let error = System::read_in(&spec("none.urdf"), folder).unwrap_err();
    assert!(error.to_string().contains("No such file"), "{error}");
}
