//! What a cell expects of its segments, for tools that are masters themselves. What a cell is made of is told by
//! `takt-core`.

use std::time::Duration;

use anyhow::Context as _;
use takt_core::CellConfig;
use takt_core::cell::{EthercatConfig, EthercatSlave};
use takt_ethercat::axis;
use takt_ethercat::config::{Place, SlaveSpec, SyncSpec};

/// The segment of that name; without one, the only one.
pub(super) fn segment<'a>(
    cell: &'a CellConfig,
    name: Option<&str>,
) -> anyhow::Result<&'a EthercatConfig> {
    let names: Vec<&str> = cell
        .ethercat
        .iter()
        .map(|segment| segment.name.as_str())
        .collect();
    let names = names.join(", ");
    match (name, &cell.ethercat[..]) {
        (_, []) => anyhow::bail!("the cell has no [[ethercat]]"),
        (None, [only]) => Ok(only),
        (None, _) => anyhow::bail!("the cell has several segments: {names}; say which"),
        (Some(name), all) => {
            let found = all.iter().find(|segment| segment.name == name);
            found.with_context(|| format!("the cell has no segment `{name}`; it has {names}"))
        }
    }
}

/// The slaves that a segment expects, set up as the controller sets them up.
pub(super) fn slaves(segment: &EthercatConfig, cycle: Duration) -> Vec<SlaveSpec> {
    segment
        .slaves
        .iter()
        .map(|slave| spec(slave, cycle))
        .collect()
}

fn spec(slave: &EthercatSlave, cycle: Duration) -> SlaveSpec {
    let place = slave.alias.map_or_else(
        || Place::Position(slave.position.unwrap_or_default()),
        Place::Alias,
    );
    let mut spec = SlaveSpec {
        vendor: slave.vendor,
        product: slave.product,
        watchdog: slave.watchdog,
        sync: slave.sync0.then(|| SyncSpec::sync0(cycle)),
        ..SlaveSpec::new(slave.name.clone(), place)
    };
    if slave.axes > 0 {
        let (outputs, inputs) = axis::pdos(slave.axes);
        (spec.outputs, spec.inputs) = (Some(outputs), Some(inputs));
        spec.startup = (0..slave.axes)
            .flat_map(|number| axis::interpolation(number, cycle))
            .collect();
    }
    spec
}

#[cfg(test)]
mod tests {
    use takt_ethercat::AlState;
    use takt_ethercat::config::MasterConfig;

    use super::*;
    use crate::ecat::tests::{CYCLE, session, tree};
    use crate::ecat::{dc, stat};

    /// The tree of the tests, with its drive run by SYNC0.
    const CELL: &str = "[[ethercat]]\nname = 'tree'\ninterface = 'eth1'\n\
        [[ethercat.slave]]\nname = 'coupler'\nposition = 0\n\
        [[ethercat.slave]]\nname = 'drive'\nposition = 1\naxes = 1\nsync0 = true\n\
        [[ethercat.slave]]\nname = 'valves'\nposition = 2\n";

    fn config(text: &str, tag: &str) -> MasterConfig {
        let name = format!("takt-ecat-cell-{tag}-{}.toml", std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::write(&path, text).unwrap();
        let cell = CellConfig::read(&path).unwrap();
        std::fs::remove_file(&path).unwrap();
        MasterConfig {
            cycle: CYCLE,
            goal: AlState::SafeOp,
            slaves: slaves(segment(&cell, None).unwrap(), CYCLE),
            ..MasterConfig::default()
        }
    }

    #[test]
    fn frames_keep_the_middle_between_the_sync0_of_a_cell() {
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
    fn what_differs_from_the_cell_is_told_slave_by_slave() {
        let mut session = session(tree(), AlState::SafeOp);
        let wrong = CELL.replace("position = 2\n", "position = 2\nproduct = 7\n");
        session.restart(config(&wrong, "differs")).unwrap();
        session.bring_up(Duration::from_secs(10)).unwrap();
        let measured = stat::Measured::take(&mut session, Duration::from_millis(100)).unwrap();
        let text = stat::verdict("tree", &measured.findings(session.master()));
        assert!(text.contains("valves"), "{text}");
        assert!(text.contains("00000007"), "{text}");
    }
}
