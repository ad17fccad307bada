//! `takt net calibrate` and the table it writes, used by `takt net check`. How good the figures are is not
//! judged: a busy host measures too much.

mod common;

use common::{Folder, complaint, expect_status, run};

const NET: &str =
    "{a=Core::DoubleValue(Value='1'),b=Core::DoubleAdd(inFirst=a.outValue,Second='1'),
    out=Core::DoubleNetcommOut(inValue=b.outValue,Key='b'),never=Core::BooleanValue(),outTerminate=never.outValue}";

/// A table as written by hand: what it does not name costs what it declares.
fn table(cpu: &str, rows: &str) -> String {
    format!(
        "version = 1\nhost = \"h\"\ncpu = \"{cpu}\"\nkernel = \"k\"\ndate = \"2026-11-21\"\n\
         [primitive]\n{rows}\n"
    )
}

#[test]
fn calibrate_table_is_accepted_by_check() {
    let folder = Folder::new();
    let (costs, net) = (folder.file("costs.toml"), folder.write("a.net", NET));
    let args = ["net", "calibrate", "--repetitions", "1", "--output", &costs];
    let report = expect_status(&run(&args), 0);
    assert!(report.contains("heaviest primitives") && report.contains("written to"));
    let checked = run(&["net", "check", &net, "--costs", &costs]);
    assert!(expect_status(&checked, 0).contains("a cycle costs up to"));
    assert_eq!(complaint(&checked), "");
}

#[test]
fn calibrate_net_above_budget_is_rejected_with_costs() {
    let folder = Folder::new();
    let net = folder.write("a.net", NET);
    let rows = "\"Core::DoubleAdd\" = { first_ns = 0.0, ns = 900000.0, element_ns = 0.0 }\n\
                \"Core::Missing\" = { first_ns = 0.0, ns = 1.0, element_ns = 0.0 }";
    let costs = folder.write("costs.toml", &table("Z80", rows));
    let args = ["net", "check", &net, "--costs", &costs, "--period"];
    let output = run(&[&args[..], &["1ms"]].concat());
    expect_status(&output, 1);
    let text = complaint(&output);
    for part in [
        "costs up to 900.72",
        "the limit is 800µs of its period of 1ms",
        "1 `Core::DoubleAdd` 100 %",
        "takt net calibrate",
        "primitives that do not exist: Core::Missing",
        "measured on `Z80`",
    ] {
        assert!(text.contains(part), "{part} is not in:\n{text}");
    }
    expect_status(&run(&[&args[..], &["2ms"]].concat()), 0);
}

#[test]
fn run_cost_table_of_other_processor_is_refused() {
    let folder = Folder::new();
    folder.write("costs.toml", &table("Z80", ""));
    let cell = folder.write("cell.toml", "[controller]\ncosts = \"costs.toml\"\n");
    let output = run(&["run", "--config", &cell]);
    expect_status(&output, 78);
    let text = complaint(&output);
    assert!(
        text.contains("Z80") && text.contains("measured on"),
        "{text}"
    );
}
