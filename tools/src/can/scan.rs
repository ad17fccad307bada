//! `takt can scan`: finds the nodes of a CANopen bus by their heartbeats and their SDO answers. It changes the state
//! of no node; `--lss` identifies slaves without a number and leaves them as they were.

mod survey;
mod text;

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use takt_can::canopen::NodeId;
use takt_can::canopen::eds::Eds;

use super::sheet;
use super::wire::Live;
use crate::Verdict;
use crate::output::{say, span};

/// Find the nodes of a CANopen bus: numbers, states, device types, identities.
///
/// It listens for heartbeats, then reads 1000h of every number, and 1018h and 1008h of each node that answers. Exit
/// status: 0 nodes found, no findings; 1 no nodes, or findings; 2 it could not be tried.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt can scan can0
  takt can scan can0 --nodes 1-10,32 --observe 5s
  takt can scan can0 --lss --json")]
pub(crate) struct Scan {
    /// The CAN interface.
    interface: String,
    /// The node numbers to query: 1-127, or 5,8-10.
    #[arg(long, value_name = "NUMBERS", default_value = "1-127", value_parser = numbers)]
    nodes: Numbers,
    /// How long to listen for heartbeats before the queries.
    #[arg(long, value_name = "TIME", default_value = "1s", value_parser = span)]
    observe: Duration,
    /// How long to wait for answers.
    #[arg(long, alias = "wait", value_name = "TIME", default_value = "500ms", value_parser = span)]
    timeout: Duration,
    /// Also find devices without a number (LSS fast scan, CiA 305).
    #[arg(long)]
    lss: bool,
    /// Data sheets (EDS) for the names of vendors and products.
    #[arg(long, value_name = "FILE")]
    eds: Vec<PathBuf>,
    /// Print one JSON object instead of the table.
    #[arg(long)]
    json: bool,
}

/// Node numbers of the command line.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Numbers(Vec<NodeId>);

fn numbers(text: &str) -> Result<Numbers, String> {
    let wrong = || format!("`{text}` is not a list of node numbers\nhint: write 1-127, or 5,8-10");
    let number = |text: &str| text.trim().parse::<u8>().map_err(|_| wrong());
    let mut nodes = Vec::new();
    for part in text.split(',') {
        let (first, last) = part.split_once('-').unwrap_or((part, part));
        for raw in number(first)?..=number(last)? {
            nodes.push(NodeId::new(raw).map_err(|error| error.to_string())?);
        }
    }
    nodes.sort_unstable();
    nodes.dedup();
    if nodes.is_empty() {
        return Err(wrong());
    }
    Ok(Numbers(nodes))
}

impl Scan {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let sheets: Vec<Eds> = self
            .eds
            .iter()
            .map(|path| sheet::read(path))
            .collect::<Result<_, _>>()?;
        let mut wire = Live::open(&self.interface)?;
        let plan = survey::Plan {
            nodes: self.nodes.0,
            listen: self.observe,
            wait: self.timeout,
            lss: self.lss,
        };
        let report = survey::survey(&mut wire, &plan)?;
        if self.json {
            say(&text::json(&self.interface, &report, &sheets).to_string())?;
        } else {
            say(text::table(&self.interface, &report, &sheets).trim_end())?;
        }
        Ok(if report.findings().is_empty() {
            Verdict::Good
        } else {
            Verdict::Failed
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn node_number_list_is_parsed_and_checked() {
        let raw = |text| numbers(text).map(|n| n.0.iter().map(|n| n.raw()).collect::<Vec<_>>());
        assert_eq!(raw("5,8-10,9"), Ok(vec![5, 8, 9, 10]));
        assert_eq!(raw("1-127").map(|all| all.len()), Ok(127));
        for wrong in ["", "0", "128", "5-", "9-8", "a", "1,,2"] {
            assert!(raw(wrong).is_err(), "{wrong}");
        }
    }
}
