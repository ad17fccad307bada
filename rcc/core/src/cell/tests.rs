//! What a cell file may contain, with drivers that start nothing.

use crate::device::DeviceDescription;
use crate::device::driver::{DeviceDriver, DriverEnds};

use super::*;

/// A driver that starts nothing, with the table of an LWR.
#[derive(Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct Arm {
    name: String,
    #[serde(default = "Arm::default_priority")]
    priority: Option<u8>,
    listen: Option<SocketAddr>,
    #[serde(default, deserialize_with = "span::text::deserialize_some")]
    thread: Option<Duration>,
}

impl Arm {
    #[expect(clippy::unnecessary_wraps, reason = "the type of the field")]
    fn default_priority() -> Option<u8> {
        Some(85)
    }
}

impl DriverConfig for Arm {
    fn name(&self) -> &str {
        &self.name
    }

    fn thread(&self) -> Option<Duration> {
        self.thread
    }

    fn priority(&self) -> Option<u8> {
        self.priority
    }

    fn devices(&self) -> Vec<DeviceDescription> {
        Vec::new()
    }

    fn start(&self, _: DriverEnds) -> Result<Box<dyn DeviceDriver>, Error> {
        Err(Error::Cell("a driver for tests".to_owned()))
    }
}

const KINDS: &[DriverKind] = &[
    DriverKind::new::<Arm>(Section::Device("kuka_lwr_fri")),
    DriverKind::without(Section::Device("segway_rmp"), "rmp"),
    DriverKind::new::<Arm>(Section::Bus("ethercat")),
    DriverKind::without(Section::Bus("canopen"), "canopen"),
];

fn of_text(text: &str) -> Result<CellConfig, String> {
    CellConfig::of_text(text, KINDS, Path::new(""))
}

#[test]
fn complete_cell_is_read() {
    let text = r#"
        [controller]
        period = "500us"
        cpus = [1]
        follow = "left"
        phase = "300us"
        [[controller.thread]]
        period = "4ms"
        cpus = [0]
        phase = "2ms"
        [[controller.thread]]
        period = "8ms"
        [[device]]
        name = "left"
        type = "kuka_lwr_fri"
        listen = "127.0.0.1:49938"
        thread = "4ms"
    "#;
    let config = of_text(text).unwrap();
    assert_eq!(config.controller.period, Duration::from_micros(500));
    let periods: Vec<_> = config.periods().collect();
    assert_eq!(periods, [500, 4000, 8000].map(Duration::from_micros));
    assert_eq!(config.controller.follow.as_deref(), Some("left"));
    let phases: Vec<_> = config.phases().collect();
    assert_eq!(phases, [300, 2000, 300].map(Duration::from_micros));
    assert_eq!(config.controller.threads[0].priority, Some(79));
    let lwr = config.of_kind::<Arm>().next().unwrap();
    assert_eq!(lwr.thread, Some(Duration::from_millis(4)));
    assert_eq!((lwr.name.as_str(), lwr.priority), ("left", Some(85)));
}

#[test]
fn cell_faults_name_line_or_field() {
    for (text, said) in [
        ("[controller]\nperiod = 1", "invalid type"),
        ("[controller]\nperiod = \"1\"", "is no duration"),
        ("[controller]\nperiod = \"1s\"", "must be 100us to 100ms"),
        ("[controller]\npriority = 99", "priority must be 1 to 98"),
        (
            "[[controller.thread]]\nperiod = \"50us\"",
            "period is 50µs; it must be 100us to 100ms",
        ),
        (
            "[[controller.thread]]\nperiod = \"1ms\"",
            "period 1ms is given twice",
        ),
        (
            "[[controller.thread]]\nperiod = \"2ms\"\npriority = 0",
            "controller.thread: priority must be 1 to 98",
        ),
        (
            "[[controller.thread]]\npriority = 70",
            "missing field `period`",
        ),
        (
            "[[device]]\nname = \"a\"\ntype = \"kuka_lwr_fri\"\nthread = \"4ms\"\n\
             [[controller.thread]]\nperiod = \"2ms\"",
            "a: thread = 4ms, but the net threads are those of 1ms and 2ms",
        ),
        (
            "[controller]\nphase = \"300us\"",
            "phase is 300µs, but nothing is followed",
        ),
        (
            "[controller]\nfollow = \"left\"",
            "controller.follow is `left`, but the cell has no device of that name",
        ),
        (
            "[controller]\nfollow = \"a\"\nphase = \"1ms\"\n\
             [[device]]\nname = \"a\"\ntype = \"kuka_lwr_fri\"",
            "phase is 1ms; it must be less than the net thread's period of 1ms",
        ),
        ("[controller]\nfollow = \"a\"\nphase = 3\n", "invalid type"),
        ("[controller]\nperoid = \"1ms\"", "unknown field `peroid`"),
        (
            "[[device]]\nname = \"a\"\ntype = \"kuka\"",
            "unknown variant `kuka`",
        ),
        (
            "[[device]]\nname = \"a\"\ntype = \"kuka_lwr_fri\"\nport = 1",
            "unknown field `port`",
        ),
    ] {
        let error = of_text(text).unwrap_err();
        assert!(error.contains(said), "{text}: {error}");
    }
    let many: String = (1..=8)
        .map(|n| format!("[[controller.thread]]\nperiod = \"{}ms\"\n", 2 * n))
        .collect();
    let many = of_text(&many).unwrap_err();
    assert!(many.contains("9 net threads; at most 8"), "{many}");
    let twice = "[[device]]\nname = \"a\"\ntype = \"kuka_lwr_fri\"\n".repeat(2);
    assert!(of_text(&twice).unwrap_err().contains("given twice"));
}

#[test]
fn cell_faults_show_their_line() {
    for (text, line, said) in [
        (
            "[[device]]\nname = \"a\"\ntype = \"kuka\"",
            "line 3, column 8",
            "unknown variant `kuka`, expected `kuka_lwr_fri` or `segway_rmp`",
        ),
        (
            "[[device]]\nname = \"a\"\ntype = \"kuka_lwr_fri\"\nport = 1",
            "line 4, column 1",
            "unknown field `port`",
        ),
        (
            "[[device]]\nname = \"a\"",
            "line 1, column 1",
            "missing field `type`",
        ),
        ("[device]\ntype = 1", "line 1, column 1", "expected tables"),
        (
            "[controller]\n[profibus]",
            "line 2, column 2",
            "unknown field `profibus`, expected one of `controller`, `live`, `fleet`, `frame`, `base`, `tool`, `home`, `object`, `device`, `ethercat`, `canopen`",
        ),
        (
            "[[ethercat]]\nname = 's'\n[[ethercat]]\nname = 3",
            "line 4, column 8",
            "invalid type: integer `3`, expected a string",
        ),
    ] {
        let error = of_text(text).unwrap_err();
        assert!(
            error.contains(line) && error.contains(said),
            "{text}: {error}"
        );
    }
}

#[test]
fn cell_fleet_is_kept_as_written() {
    let cell = of_text("[fleet]\ncell = \"weld3\"\nlinks = 7").unwrap();
    let fleet = cell.fleet.clone().unwrap();
    assert_eq!(fleet["cell"].as_str(), Some("weld3"));
    assert_ne!(cell, CellConfig::default());
    let error = of_text("fleet = 1").unwrap_err();
    assert!(error.contains("line 1, column 9"), "{error}");
}

#[test]
fn cell_driver_not_built_names_feature() {
    for (text, said) in [
        (
            "[[device]]\nname = \"a\"\ntype = \"segway_rmp\"",
            "the driver of `segway_rmp`\nhint: build it with the cargo feature `rmp`",
        ),
        (
            "[[canopen]]\nname = \"a\"",
            "the driver of `canopen`\nhint: build it with the cargo feature `canopen`",
        ),
    ] {
        let error = of_text(text).unwrap_err();
        assert!(
            error.contains("line 1") && error.contains(said),
            "{text}: {error}"
        );
    }
}

#[test]
fn cells_compare_by_driver_type_and_value() {
    let arm = "name = \"a\"\n";
    let device = format!("[[device]]\ntype = \"kuka_lwr_fri\"\n{arm}");
    let one = of_text(&device).unwrap();
    assert_eq!(one, of_text(&device).unwrap());
    assert_ne!(one, of_text(&format!("{device}priority = 1")).unwrap());
    assert_ne!(one, of_text(&format!("[[ethercat]]\n{arm}")).unwrap());
}
