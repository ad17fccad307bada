//! `takt arm`: what the controller makes of an arm that a file describes, and what an arm carries.

mod identify;
mod survey;

use std::fs;
use std::path::PathBuf;

use anyhow::Context as _;
use clap::{Args, Subcommand};
use nalgebra::{Matrix3, Vector3};
use serde_json::{Value, json};
use takt_motion::dynamics::Body;
use takt_motion::kinematics::JointKind;
use takt_motion::urdf::{ArmModel, Urdf};

use crate::Verdict;
use crate::output::say;
use survey::{Load, Survey};

/// Arms: the files that describe them, and what they carry.
#[derive(Debug, Subcommand)]
pub(crate) enum Arm {
    Check(Check),
    Identify(identify::Identify),
}

/// Check the arm of a URDF: its joints and limits, how its inverse is computed and how often that succeeds, its reach and
/// singular poses, and the torques that it takes to hold itself. Needs no controller.
///
/// Exit status 1 if the file describes no arm that can be used; every fault is named with its line.
#[derive(Debug, Args)]
pub(crate) struct Check {
    /// The URDF; expand macros (xacro) first.
    file: PathBuf,
    /// Link at which the arm stands; the root of the file without it.
    #[arg(long, value_name = "LINK")]
    base: Option<String>,
    /// Link that is the flange; where the joints end without it.
    #[arg(long, value_name = "LINK")]
    tip: Option<String>,
    /// Mass at the flange, kg, as a point 0.1 m before it, for the torques.
    #[arg(long, value_name = "KG", default_value_t = 0.0)]
    payload: f64,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

impl Arm {
    pub(crate) fn run(self) -> anyhow::Result<Verdict> {
        match self {
            Self::Check(check) => check.run(),
            Self::Identify(identify) => identify.run(),
        }
    }
}

/// Centre of mass of `--payload` in the frame of the flange, m.
const PAYLOAD_AT: Vector3<f64> = Vector3::new(0.0, 0.0, 0.1);

impl Check {
    fn run(self) -> anyhow::Result<Verdict> {
        anyhow::ensure!(
            self.payload.is_finite() && self.payload >= 0.0,
            "--payload {} is no mass\nhint: kilograms, 0 or more",
            self.payload
        );
        let name = self.file.display();
        let text = fs::read_to_string(&self.file).with_context(|| format!("cannot read {name}"))?;
        let arm = Urdf::parse(&text);
        let arm = arm.and_then(|urdf| urdf.arm(self.base.as_deref(), self.tip.as_deref()));
        let arm = match arm {
            Ok(arm) => arm,
            Err(error) => {
                if self.json {
                    let faults = error.findings.iter();
                    let faults = faults
                        .map(|it| json!({ "line": it.line, "cause": it.cause, "hint": it.hint }));
                    say(
                        &json!({ "file": self.file, "faults": faults.collect::<Vec<_>>() })
                            .to_string(),
                    )?;
                } else {
                    say(&format!("{name} describes no arm that can be used"))?;
                    say(&error.to_string())?;
                }
                return Ok(Verdict::Failed);
            }
        };
        let payload = Body::new(self.payload, PAYLOAD_AT, Matrix3::zeros());
        let survey = Survey::of(&arm, &payload);
        if self.json {
            say(&as_json(&arm, &survey).to_string())?;
        } else {
            print(&arm, &survey)?;
        }
        Ok(Verdict::Good)
    }
}

const fn unit(kind: JointKind) -> &'static str {
    match kind {
        JointKind::Revolute => "rad",
        JointKind::Prismatic => "m",
    }
}

fn print(arm: &ArmModel, survey: &Survey) -> anyhow::Result<()> {
    let count = arm.joints.len();
    say(&format!(
        "{}: {count} joints from `{}` to `{}`",
        arm.name, arm.base, arm.tip
    ))?;
    say(&format!("structure  {}", arm.serial.structure()))?;
    let width = arm.joints.iter().map(|it| it.name.len()).max().unwrap_or(0);
    let number = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |it| format!("{it}"));
    for (joint, load) in arm.joints.iter().zip(&survey.loads) {
        let unit = unit(joint.kind);
        let range = if joint.range.min.is_finite() {
            format!("{:.4} to {:.4} {unit}", joint.range.min, joint.range.max)
        } else {
            "without limits".to_owned()
        };
        let load = load.as_ref().map_or_else(String::new, load_text);
        say(&format!(
            "  {:width$}  {range:<26}  at most {} {unit}/s{load}",
            joint.name,
            number(joint.velocity_max)
        ))?;
    }
    say(&format!("reach      {:.3} m from the base", survey.reach))?;
    for (joint, at) in &survey.singular {
        say(&format!("singular   where {joint} is at {at:.4}"))?;
    }
    if survey.singular.is_empty() {
        say("singular   nowhere by one joint alone")?;
    }
    say(&format!(
        "inverse    {:.2} % of reachable poses from 0.1 rad beside them, {:.2} % from anywhere; {:.1} us, at most {:.0} us here",
        100.0 * survey.near,
        100.0 * survey.far,
        survey.inverse_us.0,
        survey.inverse_us.1
    ))?;
    match &arm.dynamics {
        Some(dynamics) => say(&format!("mass       {:.2} kg that move", dynamics.mass()))?,
        None => say("mass       not given for all joints: no torques")?,
    }
    for warning in &arm.warnings {
        say(&format!("warning: {warning}"))?;
    }
    Ok(())
}

fn load_text(load: &Load) -> String {
    let share = load.share.map_or_else(String::new, |share| {
        let word = if share > 1.0 { ", TOO MUCH" } else { "" };
        format!(" ({:.0} % of its largest{word})", 100.0 * share)
    });
    format!("  holds with up to {:.1} {}{share}", load.torque, load.unit)
}

fn as_json(arm: &ArmModel, survey: &Survey) -> Value {
    let joints = arm.joints.iter().zip(&survey.loads).map(|(joint, load)| {
        let bound = |value: f64| value.is_finite().then_some(value);
        json!({
            "name": joint.name, "line": joint.line, "unit": unit(joint.kind),
            "min": bound(joint.range.min), "max": bound(joint.range.max),
            "velocity_max": joint.velocity_max, "effort_max": joint.effort_max,
            "holding_effort": load.as_ref().map(|load| load.torque),
        })
    });
    let singular = survey.singular.iter();
    let singular = singular.map(|(joint, at)| json!({ "joint": joint, "position": at }));
    let warnings = arm.warnings.iter();
    let warnings =
        warnings.map(|it| json!({ "line": it.line, "cause": it.cause, "hint": it.hint }));
    json!({
        "name": arm.name, "base": arm.base, "tip": arm.tip,
        "structure": format!("{:?}", arm.serial.structure()),
        "joints": joints.collect::<Vec<_>>(),
        "reach_m": survey.reach,
        "singular": singular.collect::<Vec<_>>(),
        "inverse": {
            "near": survey.near, "far": survey.far,
            "median_us": survey.inverse_us.0, "max_us": survey.inverse_us.1,
        },
        "mass_kg": arm.dynamics.as_ref().map(takt_motion::dynamics::Dynamics::mass),
        "warnings": warnings.collect::<Vec<_>>(),
    })
}
