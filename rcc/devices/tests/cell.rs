//! Cell files with all drivers: the examples of the documentation, and what is wrong with a table of a driver.

use takt_core::CellConfig;
use takt_core::cell::Section;
use takt_devices::{DRIVERS, parse_cell};

#[test]
fn readme_cell_examples_are_accepted() {
    let readmes = [
        include_str!("../README.md"),
        include_str!("../../core/README.md"),
    ];
    let examples = readmes.iter().flat_map(|it| it.split("```toml\n").skip(1));
    let examples: Vec<_> = examples.collect();
    assert!(examples.len() >= 3);
    for example in examples {
        let example = example.split("```").next().unwrap();
        let taken = parse_cell(example);
        assert!(taken.is_ok(), "{example}\n{taken:?}");
    }
}

#[test]
fn driver_table_faults_show_their_line() {
    for (text, line, said) in [
        (
            "[[device]]\nname = 'a'\ntype = 'kuka_lwr_fri'\nport = 1",
            "line 4, column 1",
            "unknown field `port`",
        ),
        (
            "[[device]]\nname = 'a'\ntype = 'kuka_lwr_fri'\npriority = 'high'",
            "line 4, column 12",
            "invalid type: string \"high\", expected u8",
        ),
        (
            "[[device]]\nname = 'a'\ntype = 'kuka'",
            "line 3, column 8",
            "unknown variant `kuka`, expected one of `kuka_lwr_fri`, `kuka_iiwa_fri`, `segway_rmp`",
        ),
        (
            "[[ethercat]]\nname = 's'\ninterface = 'none'\n[[ethercat.slave]]\nposition = 'x'",
            "line 5, column 12",
            "invalid type: string \"x\", expected u16",
        ),
        (
            "[[canopen]]\nname = 'n'\ninterface = 'none'\ncycle = 3",
            "line 4, column 9",
            "invalid type: integer `3`",
        ),
    ] {
        let error = parse_cell(text).unwrap_err().to_string();
        assert!(
            error.contains(line) && error.contains(said),
            "{text}: {error}"
        );
    }
}

#[test]
fn driver_priority_out_of_range_is_refused() {
    for table in [
        "[[device]]\nname = 'a'\ntype = 'kuka_lwr_fri'",
        "[[ethercat]]\nname = 'a'\ninterface = 'none'",
        "[[canopen]]\nname = 'a'\ninterface = 'none'",
    ] {
        assert!(
            parse_cell(&format!("{table}\npriority = 98")).is_ok(),
            "{table}"
        );
        let error = parse_cell(&format!("{table}\npriority = 99")).unwrap_err();
        let said = "a: priority must be 1 to 98";
        assert!(error.to_string().contains(said), "{table}: {error}");
    }
}

#[test]
fn driver_table_has_each_section_once() {
    let mut names: Vec<_> = DRIVERS
        .iter()
        .map(|kind| match kind.section() {
            Section::Device(name) => format!("device {name}"),
            Section::Bus(name) => name.to_owned(),
        })
        .collect();
    names.sort();
    let count = names.len();
    names.dedup();
    assert_eq!(names.len(), count);
    assert!(
        DRIVERS.iter().all(|kind| kind.is_built()),
        "all features are on by default"
    );
    assert_eq!(parse_cell("").unwrap(), CellConfig::default());
}
