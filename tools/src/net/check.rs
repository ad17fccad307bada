//! `takt net check`: a net's faults without a controller. Conditions of a running cell, such as whether its robots are
//! ready, are not checked.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use clap::Args;
use takt_core::CellConfig;
use takt_core::costs::CostTable;
use takt_core::device::{ARM_JOINTS_MAX, DeviceTable, parts};
use takt_net::device::Interfaces;
use takt_net::{ArmBinding, CostShare, Devices, JointLimits, LoadContext, NetCost, Registry, load};

use super::{complain_of, read};
use crate::Verdict;
use crate::output::{complain, say, span};

/// Check a net.
#[derive(Debug, Args)]
pub(crate) struct Check {
    /// The net; `-` for standard input.
    file: PathBuf,
    /// Use the devices of this cell; without it any robot exists, with 8 joints.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Time from one cycle of the net to the next.
    #[arg(long, value_name = "TIME", default_value = "1ms", value_parser = span)]
    period: Duration,
    /// Use the costs in this table of `takt net calibrate`; without it, those that primitives declare.
    #[arg(long, value_name = "FILE")]
    costs: Option<PathBuf>,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

/// Heaviest types of primitives that are shown.
const HEAVIEST: usize = 3;

impl Check {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let text = read(&self.file)?;
        let devices = self.devices()?;
        let mut registry = takt_core::registry();
        if let Some(path) = &self.costs {
            take_costs(path, &mut registry)?;
        }
        let limits = takt_core::controller::limits_for(self.period);
        let context = LoadContext {
            registry: &registry,
            devices: &*devices,
            period: self.period,
            limits,
        };
        let name = self.file.display().to_string();
        let checked = load(&text, &context);
        if self.json {
            say(&json(&name, &text, &checked, limits.cost).to_string())?;
        } else {
            match &checked {
                Ok(plan) => {
                    say(&format!("{name}: good, {} primitives", plan.primitives()))?;
                    say(&cost_line(plan.cost(), limits.cost))?;
                }
                Err(rejection) => complain_of(rejection, &name, &text),
            }
        }
        Ok(if checked.is_ok() {
            Verdict::Good
        } else {
            Verdict::Failed
        })
    }

    fn devices(&self) -> anyhow::Result<Box<dyn Devices>> {
        let Some(config) = &self.config else {
            return Ok(Box::new(AnyArm));
        };
        let mut table = DeviceTable::default();
        for device in CellConfig::read(config)?.devices {
            table.add(device.describe())?;
        }
        Ok(Box::new(table))
    }
}

/// Gives primitives the costs of a table. A table of another processor is accepted too: nets may be checked for a
/// controller elsewhere.
fn take_costs(path: &Path, registry: &mut Registry) -> anyhow::Result<()> {
    let table = CostTable::read(path)?;
    if let Err(why) = table.check_host() {
        complain(&format!("warning: {why}, or check for that host only"));
    }
    let unknown = registry.set_costs(table.costs());
    if !unknown.is_empty() {
        let names = unknown.join(", ");
        complain(&format!(
            "warning: the cost table names primitives that do not exist: {names}"
        ));
    }
    Ok(())
}

fn cost_line(cost: &NetCost, budget: Option<Duration>) -> String {
    let budget = budget.map_or_else(String::new, |budget| format!(" of the {budget:?} it may"));
    let heaviest = cost.heaviest(HEAVIEST);
    format!(
        "a cycle costs up to {:?}{budget}; heaviest: {heaviest}",
        cost.total
    )
}

fn json(
    name: &str,
    text: &str,
    checked: &Result<takt_net::Plan, takt_net::Rejection>,
    budget: Option<Duration>,
) -> serde_json::Value {
    match checked {
        Ok(plan) => serde_json::json!({
            "ok": true, "file": name, "primitives": plan.primitives(), "bytes": plan.bytes(),
            "resources": plan.resources(), "faults": [],
            "cost_ns": nanos(plan.cost().total), "budget_ns": budget.map(nanos),
            "shares": plan.cost().shares.iter().map(share).collect::<Vec<_>>(),
        }),
        Err(rejection) => {
            let fault = |fault: &takt_net::Fault| {
                let (line, column) = fault.location(text);
                let (start, end) = (fault.at.start, fault.at.end);
                let text_of_fault = fault.kind.to_string();
                serde_json::json!({
                    "line": line, "column": column, "start": start, "end": end, "text": text_of_fault,
                })
            };
            let faults: Vec<_> = rejection.faults.iter().map(fault).collect();
            serde_json::json!({"ok": false, "file": name, "faults": faults})
        }
    }
}

fn nanos(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}

fn share(share: &CostShare) -> serde_json::Value {
    serde_json::json!({
        "primitive": share.primitive, "count": share.count, "cost_ns": nanos(share.cost),
    })
}

/// Every robot exists and offers everything, so that a net can be checked apart from its cell.
#[derive(Debug)]
struct AnyArm;

impl Devices for AnyArm {
    fn arm(&self, _name: &str) -> Option<ArmBinding> {
        let anything = JointLimits {
            position_min: f64::NEG_INFINITY,
            position_max: f64::INFINITY,
            velocity_max: f64::INFINITY,
            acceleration_max: f64::INFINITY,
        };
        let limits = Arc::from([anything; ARM_JOINTS_MAX]);
        Some(ArmBinding {
            first_joint: 0,
            limits,
            kinematics: None,
        })
    }

    fn interfaces(&self, _name: &str) -> Option<Interfaces> {
        Some(parts::everything())
    }

    fn names(&self) -> Vec<String> {
        Vec::new()
    }
}
