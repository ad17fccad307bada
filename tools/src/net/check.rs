//! `takt net check`: a net's faults without a controller. Conditions of a running cell, such as whether its robots are
//! ready, are not checked.

use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use clap::Args;
use takt_core::costs::CostTable;
use takt_core::device::{ARM_JOINTS_MAX, DeviceTable, parts};
use takt_net::device::{Interfaces, Kinematics, Unreachable};
use takt_net::{
    ArmBinding, CostShare, Devices, Finding, Frame, JointLimits, Limits, LoadContext, NetCost,
    Plan, Registry, Rejection, Twist, check,
};

use super::{complain_of, read};
use crate::Verdict;
use crate::output::{complain, positive_span, say};

/// Check a net.
#[derive(Debug, Args)]
pub(crate) struct Check {
    /// The net; `-` for standard input.
    file: PathBuf,
    /// Use the devices of this cell; without it any robot exists, with 8 joints.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Time from one cycle of the net to the next.
    #[arg(long, value_name = "TIME", default_value = "1ms", value_parser = positive_span)]
    period: Duration,
    /// Use the costs in this table of `takt net calibrate`; without it, those that primitives declare.
    #[arg(long, value_name = "FILE")]
    costs: Option<PathBuf>,
    /// Exit with 1 if there are warnings or notes.
    #[arg(long)]
    deny_warnings: bool,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

/// A net without faults, or one that only a cell can judge; and what may not be meant in it.
type Checked = (Option<Plan>, Vec<Finding>);

/// Heaviest types of primitives that are shown.
const HEAVIEST: usize = 3;

impl Check {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let text = read(&self.file)?;
        let mut registry = takt_core::registry();
        if let Some(path) = &self.costs {
            take_costs(path, &mut registry)?;
        }
        let limits = takt_core::controller::limits_for(self.period);
        let checked = self.check(&text, &registry, limits)?;
        let name = self.file.display().to_string();
        if self.json {
            say(&json(&name, &text, &checked, limits.cost).to_string())?;
        } else {
            match &checked {
                Ok((plan, findings)) => {
                    for finding in findings {
                        complain(finding.render(&name, &text).trim_end());
                    }
                    say(&verdict_line(&name, plan.as_ref(), findings.len()))?;
                    if let Some(plan) = plan {
                        say(&cost_line(plan.cost(), limits.cost))?;
                    }
                }
                Err(rejection) => complain_of(rejection, &name, &text),
            }
        }
        let is_good = |(_, findings): &Checked| !self.deny_warnings || findings.is_empty();
        Ok(if checked.is_ok_and(|checked| is_good(&checked)) {
            Verdict::Good
        } else {
            Verdict::Failed
        })
    }

    fn check(
        &self,
        text: &str,
        registry: &Registry,
        limits: Limits,
    ) -> anyhow::Result<Result<Checked, Rejection>> {
        let with = |devices: &dyn Devices| {
            let context = LoadContext {
                registry,
                devices,
                period: self.period,
                limits,
            };
            check(text, &context).map(|(plan, found)| (Some(plan), found))
        };
        let Some(config) = &self.config else {
            return Ok(apart(with));
        };
        let mut table = DeviceTable::default();
        let cell = takt_devices::read_cell(config)?;
        for device in cell.drivers().flat_map(|config| config.devices()) {
            table.add(device)?;
        }
        Ok(with(&table))
    }
}

/// Checks a net with robots that stand in for those of its cell. What they lack is no fault of the net: where it
/// needs a certain arm, others are tried, and a note is added.
fn apart(with: impl Fn(&dyn Devices) -> Result<Checked, Rejection>) -> Result<Checked, Rejection> {
    let rejection = match with(&AnyArm::new(ARM_JOINTS_MAX, None)) {
        Ok(checked) => return Ok(checked),
        Err(rejection) => rejection,
    };
    let Some(notes) = rejection.as_notes() else {
        return Err(rejection);
    };
    let arms = (5..ARM_JOINTS_MAX).rev();
    let mut tried =
        arms.map(|joints| with(&AnyArm::new(joints, Some(Arc::new(AnyGeometry(joints))))));
    let (plan, mut findings) = tried.find_map(Result::ok).unwrap_or_default();
    findings.extend(notes);
    findings.sort_by_key(|finding| finding.at.start);
    Ok((plan, findings))
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

fn verdict_line(name: &str, plan: Option<&Plan>, findings: usize) -> String {
    let plural = if findings == 1 { "" } else { "s" };
    match plan.map(Plan::primitives) {
        None => format!("{name}: only its cell can judge it, {findings} note{plural}"),
        Some(primitives) if findings == 0 => format!("{name}: good, {primitives} primitives"),
        Some(primitives) => {
            format!("{name}: no faults, {findings} finding{plural}, {primitives} primitives")
        }
    }
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
    checked: &Result<Checked, Rejection>,
    budget: Option<Duration>,
) -> serde_json::Value {
    let place = |at: &std::ops::Range<usize>, line: usize, column: usize| serde_json::json!({"line": line, "column": column, "start": at.start, "end": at.end});
    let warning = |finding: &Finding| {
        let (line, column) = finding.location(text);
        let mut warning = place(&finding.at, line, column);
        warning["severity"] = finding.severity.text().to_lowercase().into();
        warning["text"] = finding.text.as_str().into();
        warning["hint"] = finding.hint.as_str().into();
        warning
    };
    match checked {
        Ok((None, findings)) => serde_json::json!({
            "ok": true, "file": name, "faults": [],
            "warnings": findings.iter().map(warning).collect::<Vec<_>>(),
        }),
        Ok((Some(plan), findings)) => serde_json::json!({
            "ok": true, "file": name, "primitives": plan.primitives(), "bytes": plan.bytes(),
            "resources": plan.resources(), "faults": [],
            "warnings": findings.iter().map(warning).collect::<Vec<_>>(),
            "cost_ns": nanos(plan.cost().total), "budget_ns": budget.map(nanos),
            "shares": plan.cost().shares.iter().map(share).collect::<Vec<_>>(),
        }),
        Err(rejection) => {
            let fault = |fault: &takt_net::Fault| {
                let (line, column) = fault.location(text);
                let mut found = place(&fault.at, line, column);
                found["text"] = fault.kind.to_string().into();
                found
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

/// Every robot exists and offers everything, so that a net can be checked apart from its cell. Each has
/// joints of its own.
#[derive(Debug)]
struct AnyArm {
    joints: usize,
    kinematics: Option<Arc<dyn Kinematics>>,
    /// Arms that the net named, in this order.
    named: RefCell<Vec<String>>,
}

impl AnyArm {
    fn new(joints: usize, kinematics: Option<Arc<dyn Kinematics>>) -> Self {
        Self {
            joints,
            kinematics,
            named: RefCell::default(),
        }
    }
}

/// The geometry of an arm that is not known, with that number of joints. Nothing is computed with it.
#[derive(Debug)]
struct AnyGeometry(usize);

impl Kinematics for AnyGeometry {
    fn joints(&self) -> usize {
        self.0
    }

    fn forward(&self, _joints: &[f64]) -> Frame {
        Frame::identity()
    }

    fn inverse(&self, _: &Frame, _: &[f64], _: &mut [f64]) -> Result<(), Unreachable> {
        Err(Unreachable::Invalid)
    }

    fn jacobian(&self, _: &[f64], columns: &mut [Twist]) {
        columns.fill(Twist::default());
    }
}

impl Devices for AnyArm {
    fn arm(&self, name: &str) -> Option<ArmBinding> {
        let mut named = self.named.borrow_mut();
        let known = named.iter().position(|known| known == name);
        let number = known.unwrap_or_else(|| {
            named.push(name.to_owned());
            named.len() - 1
        });
        let anything = JointLimits {
            position_min: f64::NEG_INFINITY,
            position_max: f64::INFINITY,
            velocity_max: f64::INFINITY,
            acceleration_max: f64::INFINITY,
        };
        let limits = vec![anything; self.joints].into();
        Some(ArmBinding {
            first_joint: number * ARM_JOINTS_MAX,
            limits,
            kinematics: self.kinematics.clone(),
        })
    }

    fn interfaces(&self, _name: &str) -> Option<Interfaces> {
        Some(parts::everything())
    }

    fn names(&self) -> Vec<String> {
        Vec::new()
    }
}
