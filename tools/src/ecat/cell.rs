//! Segments as a cell configures them, for tools that are masters themselves. `takt-core` reads cells.

use std::time::Duration;

use anyhow::Context as _;
use takt_core::CellConfig;
use takt_devices::ethercat::{EthercatConfig, master_config};
use takt_ethercat::AlState;
use takt_ethercat::config::MasterConfig;

/// The segment of that name; without one, the only one.
pub(super) fn segment<'a>(
    cell: &'a CellConfig,
    name: Option<&str>,
) -> anyhow::Result<&'a EthercatConfig> {
    let segments: Vec<&EthercatConfig> = cell.of_kind().collect();
    let names: Vec<&str> = segments.iter().map(|it| it.name.as_str()).collect();
    let names = names.join(", ");
    match (name, &segments[..]) {
        (_, []) => anyhow::bail!("the cell has no [[ethercat]]"),
        (None, [only]) => Ok(only),
        (None, _) => {
            anyhow::bail!("the cell has several segments: {names}\nhint: name one by --segment")
        }
        (Some(name), all) => {
            let found = all.iter().copied().find(|segment| segment.name == name);
            found.with_context(|| format!("the cell has no segment `{name}`; it has {names}"))
        }
    }
}

/// The master configuration of a segment, as the controller has it, for a cycle and up to a state.
pub(super) fn master(segment: &EthercatConfig, cycle: Duration, goal: AlState) -> MasterConfig {
    let segment = EthercatConfig {
        cycle,
        ..segment.clone()
    };
    MasterConfig {
        goal,
        ..master_config(&segment)
    }
}

/// The interfaces at both ends of a segment: those that the command line names, else those of the cell. The other end of
/// a ring counts if it has a link; without one the ring is a line.
pub(super) fn ends(
    segment: &EthercatConfig,
    interface: Option<String>,
    second: Option<String>,
) -> (Option<String>, Option<String>) {
    let interface = interface.unwrap_or_else(|| segment.interface.clone());
    // A ring is entered at either end.
    let of_cell = [&segment.second, &Some(segment.interface.clone())];
    let other = || {
        let mut ends = of_cell.into_iter().flatten();
        let other = ends.find(|end| **end != interface && segment.second.is_some());
        other
            .filter(|end| crate::link::fault(end).is_none())
            .cloned()
    };
    let second = second.or_else(other);
    (Some(interface), second)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ecat::tests::{CYCLE, session, tree};
    use crate::ecat::{dc, finding, stat};

    /// The tree of the tests, with its drive run by SYNC0.
    const CELL: &str = "[[ethercat]]\nname = 'tree'\ninterface = 'eth1'\n\
        [[ethercat.slave]]\nname = 'coupler'\nposition = 0\n\
        [[ethercat.slave]]\nname = 'drive'\nposition = 1\naxes = 1\nsync0 = true\n\
        [[ethercat.slave]]\nname = 'valves'\nposition = 2\n";

    fn config(text: &str, tag: &str) -> MasterConfig {
        let name = format!("takt-ecat-cell-{tag}-{}.toml", std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::write(&path, text).unwrap();
        let cell = takt_devices::read_cell(&path).unwrap();
        std::fs::remove_file(&path).unwrap();
        master(segment(&cell, None).unwrap(), CYCLE, AlState::SafeOp)
    }

    #[test]
    fn ecat_frames_of_a_cell_are_sent_between_sync0() {
        let mut session = session(tree(), AlState::SafeOp);
        session.restart(config(CELL, "sync")).unwrap();
        session.follow_sync0();
        session.bring_up(Duration::from_secs(10)).unwrap();
        session.run_for(Duration::from_secs(2)).unwrap();
        let watched = dc::Watched::take(&mut session, Duration::from_millis(500)).unwrap();
        let text = dc::text(&session, &watched, &[]);
        let (least, most) = watched.phase.range_ns().unwrap();
        assert!(least > -2000 && most < 2000, "{text}");
        assert!(text.contains("from the middle between two SYNC0"), "{text}");
        assert!(session.master().slave(1).unwrap().sync_start_ns().is_some());
    }

    #[test]
    fn segment_ends_default_to_those_of_cell() {
        let text = "[[ethercat]]\nname = 'ring'\ninterface = 'nowhere0'\nsecond = 'lo'\n";
        let cell = takt_devices::parse_cell(text).unwrap();
        let segment = segment(&cell, None).unwrap();
        let name = |text: &str| Some(text.to_owned());
        assert_eq!(ends(segment, None, None), (name("nowhere0"), name("lo")));
        // The first interface has no link, so that from its other end the ring is a line.
        assert_eq!(ends(segment, name("lo"), None), (name("lo"), None));
        let given = ends(segment, name("eth7"), name("eth8"));
        assert_eq!(given, (name("eth7"), name("eth8")));
    }

    #[test]
    fn ecat_slaves_that_differ_from_the_cell_are_reported() {
        let mut session = session(tree(), AlState::SafeOp);
        let wrong = CELL.replace("position = 2\n", "position = 2\nproduct = 7\n");
        session.restart(config(&wrong, "differs")).unwrap();
        session.bring_up(Duration::from_secs(10)).unwrap();
        let measured = stat::Measured::take(&mut session, Duration::from_millis(100)).unwrap();
        let text = finding::verdict("tree", &measured.findings(session.master()));
        assert!(text.contains("valves"), "{text}");
        assert!(text.contains("00000007"), "{text}");
    }
}
