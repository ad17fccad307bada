//! `takt fleet list`: the cells of a fleet, a line each.

use clap::Args;

use super::link::Link;
use super::reading::{Cell, read, table};
use crate::Verdict;
use crate::output::say;

/// List the cells: whether they are alive, how they are, which version and run of the controller.
///
/// STATE: good, warn or fail by the worst finding; stopped; stale: its telemetry does not come; silent: alive without an answer in time.
/// Exit status: 0 good; 1 there is no cell, or one is silent; 2 the fleet is not reachable.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt fleet list
  takt fleet list --connect tls/line2.local:7447 --ca ca.pem --certificate panel.pem --key panel.key
  takt fleet list --json | jq '.[].cell'")]
pub(crate) struct List {
    /// Print one JSON array.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    link: Link,
}

impl List {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let fleet = self.link.open()?;
        let cells = read(&fleet, self.link.timeout)?;
        if self.json {
            say(&serde_json::to_string(&cells)?)?;
        } else if cells.is_empty() {
            say(
                "no cell is alive\nhint: cells behind another cell are seen if that one has mode = \"router\" under [fleet]",
            )?;
        } else {
            for line in lines(&cells) {
                say(&line)?;
            }
        }
        let is_good = !cells.is_empty() && cells.iter().all(|cell| !cell.summary.is_null());
        Ok(if is_good {
            Verdict::Good
        } else {
            Verdict::Failed
        })
    }
}

/// The table of `list`.
fn lines(cells: &[Cell]) -> Vec<String> {
    let head = [
        "CELL", "STATE", "DEVICES", "NETS", "VERSION", "BOOT", "HOST",
    ];
    let mut rows = vec![head.map(str::to_owned).to_vec()];
    rows.extend(cells.iter().map(|cell| {
        let devices = format!("{}/{} op", cell.count("operational"), cell.count("devices"));
        vec![
            cell.cell.clone(),
            cell.state().to_owned(),
            devices,
            cell.count("running").to_string(),
            cell.info("version").to_owned(),
            cell.boot().to_owned(),
            cell.info("host").to_owned(),
        ]
    }));
    table(&rows)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn list_has_a_line_for_each_cell() {
        let cell = Cell {
            cell: "weld3".to_owned(),
            alive: true,
            boots: vec!["0123456789".to_owned()],
            info: json!({"version": "0.1.0", "host": "rob1"}),
            summary: json!({"state": "good", "devices": 2, "operational": 1, "running": 3}),
            ..Cell::default()
        };
        let silent = Cell {
            cell: "a".to_owned(),
            alive: true,
            ..Cell::default()
        };
        assert_eq!(
            lines(&[cell, silent]),
            [
                "CELL   STATE   DEVICES  NETS  VERSION  BOOT      HOST",
                "weld3  good    1/2 op   3     0.1.0    01234567  rob1",
                "a      silent  0/0 op   0     -        -         -",
            ]
        );
    }
}
