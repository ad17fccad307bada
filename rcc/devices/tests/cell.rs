//! Cell files with all drivers: the examples of the documentation, and what is wrong with a table of a driver.

use takt_core::cell::Section;
use takt_core::{CellConfig, Controller};
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

/// Sections of docs/cell.md, with a cell in which the program meets an unknown key there.
const SECTIONS: [(&str, &str); 32] = [
    ("[controller]", "[controller]\nzz = 1"),
    ("[live]", "[live]\nzz = 1"),
    ("[[controller.thread]]", "[[controller.thread]]\nzz = 1"),
    ("[[frame]]", "[[frame]]\nzz = 1"),
    ("[[base]]", "[[base]]\nzz = 1"),
    ("[[tool]]", "[[tool]]\nzz = 1"),
    ("[[home]]", "[[home]]\nzz = 1"),
    ("[[object]]", "[[object]]\nzz = 1"),
    (
        "[[device]] of type kuka_lwr_fri",
        "[[device]]\ntype = 'kuka_lwr_fri'\nzz = 1",
    ),
    (
        "[[device]] of type kuka_iiwa_fri",
        "[[device]]\ntype = 'kuka_iiwa_fri'\nzz = 1",
    ),
    (
        "device.io of kuka_iiwa_fri",
        "[[device]]\ntype = 'kuka_iiwa_fri'\nio = { zz = 1 }",
    ),
    (
        "device.on_end",
        "[[device]]\ntype = 'kuka_lwr_fri'\non_end = { zz = 1 }",
    ),
    (
        "[[device]] of type segway_rmp",
        "[[device]]\ntype = 'segway_rmp'\nzz = 1",
    ),
    (
        "[[device]] of type schunk_wsg",
        "[[device]]\ntype = 'schunk_wsg'\nzz = 1",
    ),
    (
        "[[device]] of type arm_sim",
        "[[device]]\ntype = 'arm_sim'\nzz = 1",
    ),
    ("[[ethercat]]", "[[ethercat]]\nzz = 1"),
    ("[ethercat.clocks]", "[[ethercat]]\nclocks = { zz = 1 }"),
    ("[[ethercat.slave]]", "[[ethercat]]\nslave = [{ zz = 1 }]"),
    (
        "ethercat.slave.timeouts",
        "[[ethercat]]\nslave = [{ timeouts = { zz = 1 } }]",
    ),
    (
        "ethercat.slave.outputs and inputs",
        "[[ethercat]]\nslave = [{ outputs = [{ zz = 1 }] }]",
    ),
    (
        "ethercat.slave.startup",
        "[[ethercat]]\nslave = [{ startup = [{ zz = 1 }] }]",
    ),
    ("[[ethercat.arm]]", "[[ethercat]]\narm = [{ zz = 1 }]"),
    (
        "ethercat.arm.joint",
        "[[ethercat]]\narm = [{ joint = [{ zz = 1 }] }]",
    ),
    ("[[ethercat.io]]", "[[ethercat]]\nio = [{ zz = 1 }]"),
    (
        "ethercat.io.analogue_in and analogue_out",
        "[[ethercat]]\nio = [{ analogue_in = [{ zz = 1 }] }]",
    ),
    ("[[ethercat.servo]]", "[[ethercat]]\nservo = [{ zz = 1 }]"),
    (
        "ethercat.servo.homing",
        "[[ethercat]]\nservo = [{ homing = { zz = 1 } }]",
    ),
    (
        "[[ethercat.youbot_base]]",
        "[[ethercat]]\nyoubot_base = [{ zz = 1 }]",
    ),
    (
        "[[ethercat.youbot_arm]]",
        "[[ethercat]]\nyoubot_arm = [{ zz = 1 }]",
    ),
    ("[[canopen]]", "[[canopen]]\nzz = 1"),
    ("[[canopen.arm]]", "[[canopen]]\narm = [{ zz = 1 }]"),
    (
        "canopen.arm.joint",
        "[[canopen]]\narm = [{ joint = [{ zz = 1 }] }]",
    ),
];

/// Texts between backticks.
fn quoted(text: &str) -> Vec<&str> {
    text.split('`').skip(1).step_by(2).collect()
}

#[test]
fn cell_reference_lists_every_key() {
    let reference = include_str!("../../../docs/cell.md");
    let headings: Vec<_> = reference
        .lines()
        // The keys of a fleet are those of takt-fleet, which compares them.
        .filter(|line| line.starts_with("## ") && *line != "## `[fleet]`")
        .collect();
    assert_eq!(headings.len(), SECTIONS.len());
    for (section, cell) in SECTIONS {
        let error = parse_cell(cell).unwrap_err().to_string();
        let (_, expected) = error.split_once("unknown field `zz`, expected ").unwrap();
        // Other names of a key are named beside it.
        let mut keys = quoted(expected.lines().next().unwrap());
        keys.retain(|key| !section.ends_with("arm.joint") || !["slave", "node"].contains(key));
        let heading = format!("## `{section}`\n");
        let (_, part) = reference.split_once(&heading).unwrap();
        let rows = part.split("\n## ").next().unwrap().lines();
        let rows = rows.filter_map(|row| row.strip_prefix("| `")?.split('`').next());
        let (mut rows, mut keys): (Vec<_>, Vec<_>) = (rows.collect(), keys);
        rows.sort_unstable();
        keys.sort_unstable();
        assert_eq!(rows, keys, "{section}");
    }
}

/// Sections of docs/cell.md that state defaults, with a cell that is accepted with any one of these at the `@`.
const CELLS: [(&str, &str); 31] = [
    ("[controller]", "[controller]\n@"),
    ("[live]", "[live]\nfoxglove = '127.0.0.1:1'\n@"),
    (
        "[[controller.thread]]",
        "[[controller.thread]]\nperiod = '2ms'\n@",
    ),
    (
        "[[device]] of type kuka_lwr_fri",
        "[[device]]\nname = 'n'\ntype = 'kuka_lwr_fri'\n@",
    ),
    (
        "[[device]] of type kuka_iiwa_fri",
        "[[device]]\nname = 'n'\ntype = 'kuka_iiwa_fri'\n@",
    ),
    (
        "device.io of kuka_iiwa_fri",
        "[[device]]\nname = 'n'\ntype = 'kuka_iiwa_fri'\nio = { @ }",
    ),
    (
        "device.on_end",
        "[[device]]\nname = 'n'\ntype = 'kuka_lwr_fri'\non_end = { @ }",
    ),
    (
        "[[device]] of type segway_rmp",
        "[[device]]\nname = 'n'\ntype = 'segway_rmp'\nlinks = ['can0']\n@",
    ),
    (
        "[[device]] of type schunk_wsg",
        "[[device]]\nname = 'n'\ntype = 'schunk_wsg'\naddress = '127.0.0.1:1000'\n@",
    ),
    (
        "[[device]] of type arm_sim",
        "[[device]]\nname = 'n'\ntype = 'arm_sim'\nmodel = 'kuka_iiwa7'\n@",
    ),
    ("[[frame]]", "[[frame]]\nname = 'f'\n@"),
    ("[[base]]", "[[base]]\ndevice = 'n'\n@"),
    ("[[object]]", "[[object]]\nname = 'o'\nsphere = 1\n@"),
    (
        "[[tool]]",
        "[[device]]\nname = 'n'\ntype = 'kuka_lwr_fri'\nlisten = '127.0.0.1:1000'\n[[tool]]\nname = 't'\ndevice = 'n'\n@",
    ),
    ("[[ethercat]]", "SEGMENT@"),
    ("[ethercat.clocks]", "SEGMENTclocks = { @ }"),
    (
        "[[ethercat.slave]]",
        "SEGMENTslave = [{ name = 'd', position = 0, @ }]",
    ),
    (
        "ethercat.slave.timeouts",
        "SEGMENTslave = [{ name = 'd', position = 0, timeouts = { @ } }]",
    ),
    (
        "ethercat.slave.outputs and inputs",
        "SEGMENTslave = [{ name = 'd', position = 0, outputs = [{ pdo = 0x1600, @ }] }]",
    ),
    (
        "ethercat.slave.startup",
        "SEGMENTslave = [{ name = 'd', position = 0, startup = [{ index = 0x2000, value = { u8 = 1 }, @ }] }]",
    ),
    (
        "[[ethercat.arm]]",
        "SEGMENTDRIVE[[ethercat.arm]]\nname = 'a'\njoint = [{ JOINT }]\n@",
    ),
    (
        "ethercat.arm.joint",
        "SEGMENTDRIVE[[ethercat.arm]]\nname = 'a'\njoint = [{ JOINT, @ }]",
    ),
    ("[[ethercat.io]]", "SEGMENT[[ethercat.io]]\nname = 'i'\n@"),
    (
        "ethercat.io.analogue_in and analogue_out",
        "SEGMENTDRIVE[[ethercat.io]]\nname = 'i'\nanalogue_in = [{ slave = 'd', bit = 0, @ }]",
    ),
    (
        "[[ethercat.servo]]",
        "SEGMENTDRIVEarm = [{ name = 'a', joint = [{ AXIS }] }]\nservo = [{ SERVO, @ }]",
    ),
    (
        "ethercat.servo.homing",
        "SEGMENTDRIVEarm = [{ name = 'a', joint = [{ AXIS }] }]\nservo = [{ SERVO, proximity = ['d', 0], homing = { HOMING, @ } }]",
    ),
    (
        "[[ethercat.youbot_base]]",
        "SEGMENTyoubot_base = [{ name = 'b', @ }]",
    ),
    (
        "[[ethercat.youbot_arm]]",
        "SEGMENTyoubot_arm = [{ name = 'a', position = 0, @ }]",
    ),
    ("[[canopen]]", "NETWORK@"),
    (
        "[[canopen.arm]]",
        "NETWORK[[canopen.arm]]\nname = 'a'\njoint = [{ NODE }]\n@",
    ),
    (
        "canopen.arm.joint",
        "NETWORK[[canopen.arm]]\nname = 'a'\njoint = [{ NODE, @ }]",
    ),
];

/// A cell of `CELLS` with its key.
fn cell_with(cell: &str, key: &str) -> String {
    let joint = "increments_per_turn = 1000.0, range = [-90.0, 90.0], velocity_max = 10.0, acceleration_max = 10.0";
    cell.replace("SEGMENT", "[[ethercat]]\nname = 's'\ninterface = 'none'\n")
        .replace("NETWORK", "[[canopen]]\nname = 'c'\ninterface = 'none'\n")
        .replace(
            "DRIVE",
            "slave = [{ name = 'd', position = 0, axes = 1 }]\n",
        )
        .replace("JOINT", &format!("drive = 'd', {joint}"))
        .replace("AXIS", &format!("drive = 'x', {joint}"))
        .replace(
            "SERVO",
            "name = 'x', encoder = 'd', output = { slave = 'd', bit = 0 }, velocity_10v = 1000.0",
        )
        .replace(
            "HOMING",
            "velocity = -1.0, index_velocity = 1.0, index_position = 0.0, index_every = 2000.0",
        )
        .replace("NODE", &format!("drive = 1, {joint}"))
        .replace(", @", if key.is_empty() { "" } else { ", @" })
        .replace('@', key)
}

/// A default of the reference as TOML; `None` where it states no value.
fn stated(default: &str) -> Option<String> {
    if let Some(each) = default.strip_suffix(" each") {
        return Some(format!("[{}]", [each; 5].join(", ")));
    }
    let value = default.strip_prefix('`')?.strip_suffix('`')?;
    let is_text = !value.starts_with(['[', '-']) && value.parse::<f64>().is_err();
    let is_text = is_text && !["true", "false"].contains(&value);
    Some(if is_text {
        format!("'{value}'")
    } else {
        value.to_owned()
    })
}

#[test]
fn cell_reference_defaults_are_those_of_parser() {
    let reference = include_str!("../../../docs/cell.md");
    let (mut compared, mut differ) = (0, Vec::new());
    for part in reference.split("\n## `").skip(1) {
        let section = part.split('`').next().unwrap();
        let rows = part.lines().filter(|line| line.starts_with("| `"));
        for row in rows {
            let columns: Vec<_> = row.split(" | ").collect();
            let (key, default) = (quoted(columns[0])[0], columns[1]);
            let Some(value) = stated(default) else {
                assert!(
                    ["–", "required", "of the vendor"].contains(&default),
                    "{section}: {row}"
                );
                continue;
            };
            let found = CELLS.iter().find(|(name, _)| *name == section);
            let (_, cell) = found.unwrap_or_else(|| panic!("{section} states defaults"));
            let parse = |key: &str| {
                let text = cell_with(cell, key);
                parse_cell(&text).unwrap_or_else(|error| panic!("{text}\n{error}"))
            };
            let with = parse(&format!("{key} = {value}"));
            if parse("") != with {
                differ.push(format!("{section}: {key} is not {value} if left out"));
            }
            compared += 1;
        }
    }
    assert!(differ.is_empty(), "{differ:#?}");
    assert!(compared > 80, "{compared}");
}

#[test]
fn example_cells_are_read_and_run() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/cells");
    let readme = std::fs::read_to_string(folder.join("README.md")).unwrap();
    let (mut read, mut ran) = (0, 0);
    for entry in std::fs::read_dir(&folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap().to_owned();
        if name == "README.md" {
            continue;
        }
        if name.ends_with(".urdf") {
            assert!(readme.contains(&format!("`{name}`")), "{name}");
            continue;
        }
        assert!(readme.contains(&format!("`{name}`")), "{name}");
        let text = std::fs::read_to_string(&path).unwrap();
        // Ports that the system chooses, so that tests do not collide; threads without priority.
        let text = text.replace("0.0.0.0:49938", "127.0.0.1:0");
        let text = text.replace("0.0.0.0:30200", "127.0.0.1:0");
        // Files beside it.
        let text = text.replace("urdf:", &format!("urdf:{}/", folder.display()));
        let mut cell = parse_cell(&text).unwrap_or_else(|error| panic!("{name}: {error}"));
        read += 1;
        cell.controller.priority = None;
        let needs_interface = ["interface = ", "links = "];
        if !needs_interface.iter().any(|key| text.contains(key)) {
            Controller::start(&cell).unwrap_or_else(|error| panic!("{name}: {error}"));
            ran += 1;
        }
    }
    assert!(read >= 9 && ran >= 3, "{read} {ran}");
}

#[test]
fn main_readme_cell_is_accepted() {
    let readme = include_str!("../../../README.md");
    let line = readme
        .lines()
        .find(|line| line.ends_with("> cell.toml"))
        .unwrap();
    let example = line.split('\'').nth(1).unwrap();
    let cell = parse_cell(example).unwrap();
    assert_eq!(cell.devices.len(), 1);
}

#[test]
fn servo_axis_faults_are_named() {
    let cell = "SEGMENTDRIVEarm = [{ name = 'a', joint = [{ AXIS }] }]\nservo = [{ SERVO, @ }]";
    let error = |key: &str| {
        let text = cell_with(cell, key);
        parse_cell(&text).err().map(|error| error.to_string())
    };
    assert_eq!(error(""), None);
    for (key, cause) in [
        ("gain = 0.0", "`gain` must be from 0.1 to 1000"),
        ("offset_max = 11.0", "`offset_max` must be from 0 to 10"),
        ("brake_time = '2s'", "`brake_time` must be at most 1s"),
        ("channel = 4", "`channel` must be less than 4"),
        ("ready = ['e', 0]", "there is no slave `e`"),
        (
            "enable = ['d', 99999]",
            "the bit of `enable` must be less than",
        ),
    ] {
        let error = error(key).unwrap();
        assert!(
            error.contains("servo x: ") && error.contains(cause),
            "{key}: {error}"
        );
    }
    let homing = |keys: &str| {
        let keys = format!("proximity = ['d', 1], homing = {{ {keys} }}");
        error(&keys).unwrap()
    };
    let rest = "index_velocity = 1.0, index_position = 0.0";
    for (keys, cause) in [
        (
            format!("velocity = 0.0, {rest}, index_every = 1.0"),
            "`homing.velocity` must be",
        ),
        (
            format!("velocity = 1.0, {rest}, index_every = 0.0"),
            "`homing.index_every` must be above 0",
        ),
        (
            format!("velocity = 1.0, {rest}, index_every = 1.0, timeout = '7200s'"),
            "`homing.timeout` must be",
        ),
        (
            format!("velocity = 1.0, {rest}, index_every = 1.0, start = nan"),
            "`homing.start` must be",
        ),
    ] {
        let error = homing(&keys);
        assert!(error.contains(cause), "{keys}: {error}");
    }
    let unused = cell.replace("AXIS", "JOINT");
    let error = parse_cell(&cell_with(&unused, "")).unwrap_err().to_string();
    assert!(error.contains("servo x: it moves 0 joints"), "{error}");
    let restarts = cell.replace("name = 'a',", "name = 'a', recovery = 'on_restart',");
    let error = parse_cell(&cell_with(&restarts, "power = 'on_request'")).unwrap_err();
    let error = error.to_string();
    assert!(error.contains("needs an arm with `recovery ="), "{error}");
    let without = cell_with(
        cell,
        "homing = { velocity = 1.0, index_velocity = 1.0, index_position = 0.0, index_every = 1.0 }",
    );
    let error = parse_cell(&without).unwrap_err().to_string();
    assert!(error.contains("`homing` needs `proximity`"), "{error}");
}
