//! The checks before a machine runs: each error with its location, all at once.

use super::Program;
use super::run::tests::library;

/// Level, location and cause of everything found.
fn findings(text: &str) -> Vec<String> {
    let found = match Program::compile(text, &library) {
        Ok((_, found)) | Err(found) => found,
    };
    let line = |d: &crate::Diagnostic| {
        let (line, column) = d.location(text);
        assert!(!d.hint.is_empty(), "{d:?}");
        format!("{line}:{column} {}", d.text)
    };
    found.all().iter().map(line).collect()
}

/// A machine with these states; `c` is configured.
fn found_in(states: &str) -> Vec<String> {
    findings(&format!(
        "machine M {{ component c from \"c\" configured; event e; var n: int; var ok: bool;\n{states}}}"
    ))
}

/// States and the only finding in them.
const TABLE: &[(&str, &str)] = &[
    ("initial state A { transition to D; } final state D { } state X { transition to D; }",
     "2:62 no path leads from the initial state to `X`"),
    ("initial state A { transition to X; transition on e to D; } final state D { } state X { }",
     "2:84 no path leads from `X` to the final state `D`"),
    ("initial state A { transition to D; } state D { }", "1:9 machine `M` has no final state"),
    ("initial state A { transition to D; } initial state B { transition to D; } final state D { }",
     "2:52 `B` is a second initial state"),
    ("initial state A { transition to E; transition to D; } final state D { }", "2:33 there is no state `E`"),
    ("initial state A { transition on f to D; } final state D { }", "2:33 there is no event `f`"),
    ("initial state A { entry { start c; start c; } transition to D; } final state D { entry { stop c; } }",
     "2:36 `c` is started twice on a path"),
    ("initial state A { entry { start c; } transition to B; } state B { entry { start c; } transition to D; }
      final state D { entry { stop c; } }", "2:75 `c` is started twice on a path"),
    ("initial state A { run { start c; } transition to D; } final state D { entry { stop c; } }",
     "2:25 `c` is started twice on a path"),
    ("initial state A { entry { start c; } transition to D; } final state D { }",
     "2:69 `c` is not stopped on a path to the end of the final state"),
    ("initial state A { entry { cleanup c; start c; } transition to D; } final state D { entry { stop c; } }",
     "2:38 `c` is started before it is configured on a path"),
    ("initial state A { entry { start c; configure c; } transition to D; } final state D { entry { stop c; } }",
     "2:36 `c` may run here"),
    ("initial state A { transition if c.flag to D; } final state D { }",
     "2:33 `c.flag` is read before anything writes it"),
    ("initial state A { transition if c.x > 1 to D; } final state D { }", "2:33 `c.x` is read, but nothing writes it"),
    ("initial state A { handle { wait 1ms; } transition to D; } final state D { }",
     "2:28 this statement cannot finish in one step"),
    ("initial state A { exit { if ok { configure c; } } transition to D; } final state D { }",
     "2:34 this statement cannot finish in one step"),
    ("initial state A { run { while n < 3 { n := n + 1; } } transition to D; } final state D { }",
     "2:31 this loop may not finish in a step"),
    ("initial state A { run { while ok { if ok { yield; } } } transition to D; } final state D { }",
     "2:31 this loop may not finish in a step"),
    ("initial state A { run { ok := n; } transition to D; } final state D { }", "2:31 this is int, but bool is expected"),
    ("initial state A { run { n := 1.5; } transition to D; } final state D { }", "2:30 this is double, but int is expected"),
    ("initial state A { run { ok := n and ok; } transition to D; } final state D { }",
     "2:31 this operator does not take int and bool"),
    ("initial state A { run { m := 1; } transition to D; } final state D { }", "2:25 there is no variable `m`"),
    ("initial state A { run { start d; } transition to D; } final state D { }", "2:31 there is no component `d`"),
    ("initial state A { run { c.gian := 1; } transition to D; } final state D { }", "2:27 `c` has no property or port `gian`"),
    ("initial state A { run { c.gain := 10; } transition to D; } final state D { }",
     "2:35 10 is not in the range 0 to 9 of `gain`"),
    ("initial state A { run { c.flag := true; } transition to D; } final state D { }",
     "2:27 port `flag` cannot be written by the machine"),
    ("initial state A { run { call c.log(); } transition to D; } final state D { }", "2:30 `log` takes 1 arguments, not 0"),
    ("initial state A { run { call c.lgo(1); } transition to D; } final state D { }", "2:32 `c` has no operation `lgo`"),
    ("initial state A { run { pause c; } transition to D; } final state D { }", "2:25 a component cannot pause"),
    ("initial state A { transition if c is runing to D; } final state D { }", "2:38 there is no state `runing` of `c`"),
    ("initial state A { entry { n := 1; } entry { n := 2; } transition to D; } final state D { }", "2:37 `entry` is given twice"),
    ("initial state A { transition to D; transition to D { n := 1; } } final state D { }",
     "2:50 this transition is never examined: an earlier one has no condition"),
    ("initial state A { transition to D; } final state D { } machine B { initial final state Y { } }",
     "2:64 machine `B` is never activated"),
    ("stop on end within 30s; initial state A { transition to D; } final state D { }",
     "2:1 the end of a machine may take less than 20s"),
    ("stop on end within 1s; stop on end within 2s; initial state A { transition to D; } final state D { }",
     "2:24 `stop on end` is given twice"),
    ("stop at end within 1s; initial state A { transition to D; } final state D { }", "2:6 `on` is expected here, not `at`"),
    ("connect c.flag -> c.x; initial state A { transition to D; } final state D { }", "2:9 `flag` is bool, but `x` is int"),
    ("order c, c; initial state A { transition to D; } final state D { }", "2:10 `c` is given twice"),
    ("var c: int; initial state A { transition to D; } final state D { }", "2:5 `c` is declared twice: it is a component"),
    ("initial state A { run { n = 1; } transition to D; } final state D { }", "2:27 `:=` is expected here, not `=`"),
    ("initial state A { run { wait 5; } transition to D; } final state D { }",
     "2:30 a time such as `200ms` or `5s` is expected here, not `5`"),
    ("initial state A { trasition to D; transition to D; } final state D { }",
     "2:19 a part of a state is expected here, not `trasition`"),
];

#[test]
fn check_each_rule_reports_its_location() {
    let differs = |(states, expected): &&(&str, &str)| found_in(states) != [*expected];
    let wrong = TABLE.iter().filter(differs);
    let wrong: Vec<_> = wrong
        .map(|(states, expected)| (states, expected, found_in(states)))
        .collect();
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn check_guarded_start_and_stop_are_accepted() {
    for states in [
        "initial state A { run { if c is stopped { start c; } } transition to D; } final state D { entry { stop c; } }",
        "initial state A { run { if not c is running { start c; } } transition to D; } final state D { entry { stop c; } }",
        "initial state A { entry { start c; } exit { stop c; } transition if ok to A; transition if c.flag to B; transition on e to D; }
         state B { entry { start c; } exit { stop c; } transition if not c.flag to A; transition on e to D; } final state D { }",
        "initial state A { entry { start c; do c.work() until c.level > 2 within 1s else { ok := true; } } \
         transition if has c.level to D; } final state D { entry { stop c; cleanup c; configure c; } }",
    ] {
        assert_eq!(found_in(states), Vec::<String>::new(), "{states}");
    }
}

#[test]
fn check_all_errors_are_reported_at_once() {
    let found = found_in(
        "initial state A { run { m := 1; start d; n := ; } handle { yield; } transition to Z; }\n final state D { entri { } }\n stat X { }",
    );
    let expected = [
        "2:25 there is no variable `m`",
        "2:39 there is no component `d`",
        "2:47 a value is expected here, not `;`",
        "2:60 this statement cannot finish in one step",
        "2:83 there is no state `Z`",
        "3:18 a part of a state is expected here, not `entri`",
        "4:2 an item of a machine is expected here, not `stat`",
    ];
    assert_eq!(found, expected);
}

#[test]
fn check_missing_component_file_is_one_error() {
    let library = |_: &str| Err("No such file".to_owned());
    let text = "machine M { component c from \"c\" started; initial state A { transition if c.flag to D; } final state D { } }";
    let found = Program::compile(text, &library).unwrap_err();
    assert_eq!(found.to_string(), "cannot read c: No such file");
    let broken = |_: &str| Ok("component C { } {".to_owned());
    let found = Program::compile(text, &broken).unwrap_err();
    assert!(found.to_string().starts_with("c:1:"), "{found}");
    // All errors of a component, with the hint of each.
    let broken = |_: &str| Ok("component C { property a: dubble; every 0; } { }".to_owned());
    let found = Program::compile(text, &broken).unwrap_err();
    assert_eq!(
        found.to_string(),
        "c:1:27: a type is expected here, not `dubble`; c:1:41: a component is evaluated every 1 to 100000 cycles"
    );
    assert!(found.all()[0].hint.contains("`double`"), "{found:?}");
}

#[test]
fn check_worst_step_counts_longest_way() {
    let text = |more: &str| {
        format!(
            "machine M {{ var n: int; initial state A {{ run {{ n := 1; {more} }} transition to D; }} final state D {{ }} }}"
        )
    };
    let worst = |more: &str| {
        Program::compile(&text(more), &library)
            .unwrap()
            .0
            .worst_step()
    };
    let base = worst("");
    assert_eq!(worst("n := 2;"), base + 2);
    assert_eq!(worst("yield; n := 2;"), base);
    assert_eq!(
        worst("if n > 0 { n := 1; } else { n := 2; n := 3; }"),
        base + 4 + 4
    );
}
