//! `takt net check`: a net's faults without a controller. What depends on a running cell, such as
//! whether its robots are ready, is not looked at.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use clap::Args;
use takt_core::CellConfig;
use takt_core::cell::DeviceConfig;
use takt_core::device::{ARM_JOINTS_MAX, DeviceTable, lwr};
use takt_net::{ArmBinding, Devices, JointLimits, LoadContext, load};

use super::{complain_of, read};
use crate::Verdict;
use crate::output::{say, span};

/// Check a net.
#[derive(Debug, Args)]
pub(crate) struct Check {
    /// The net; `-` for standard input.
    file: PathBuf,
    /// Devices are those of this cell; without it any robot is taken to exist, with 8 joints.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Time from one cycle of the net to the next.
    #[arg(long, value_name = "TIME", default_value = "1ms", value_parser = span)]
    period: Duration,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

impl Check {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let text = read(&self.file)?;
        let devices = self.devices()?;
        let registry = takt_core::registry();
        let context = LoadContext {
            registry: &registry,
            devices: &*devices,
            period: self.period,
            limits: takt_core::controller::limits_for(self.period),
        };
        let name = self.file.display().to_string();
        let checked = load(&text, &context);
        if self.json {
            say(&json(&name, &text, &checked).to_string())?;
        } else {
            match &checked {
                Ok(plan) => say(&format!("{name}: good, {} primitives", plan.primitives()))?,
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
        for DeviceConfig::Lwr(device) in CellConfig::read(config)?.devices {
            table.add_arm(lwr::describe(&device.name))?;
        }
        Ok(Box::new(table))
    }
}

fn json(
    name: &str,
    text: &str,
    checked: &Result<takt_net::Plan, takt_net::Rejection>,
) -> serde_json::Value {
    match checked {
        Ok(plan) => serde_json::json!({
            "ok": true, "file": name, "primitives": plan.primitives(), "bytes": plan.bytes(),
            "resources": plan.resources(), "faults": [],
        }),
        Err(rejection) => {
            let fault = |fault: &takt_net::Fault| {
                let (line, column) = fault.place(text);
                let (start, end) = (fault.at.start, fault.at.end);
                let what = fault.kind.to_string();
                serde_json::json!({
                    "line": line, "column": column, "start": start, "end": end, "text": what,
                })
            };
            let faults: Vec<_> = rejection.faults.iter().map(fault).collect();
            serde_json::json!({"ok": false, "file": name, "faults": faults})
        }
    }
}

/// Every robot exists, so that a net can be checked apart from its cell.
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

    fn names(&self) -> Vec<String> {
        Vec::new()
    }
}
