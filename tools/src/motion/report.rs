//! What `takt move` prints: the plan before the motion, the outcome after it.

use std::fmt::Write as _;
use std::time::Duration;

use serde_json::{Value, json};
use takt_api::{Arm, Cost, Explanation, Outcome, Plan};

/// A motion as planned, and how it ended.
#[derive(Debug)]
pub(super) struct Report {
    arm: String,
    motion: &'static str,
    speed: f64,
    duration: Duration,
    joints: Vec<Joint>,
    explained: Option<Explanation>,
    end: Option<End>,
}

/// A joint in the plan.
#[derive(Clone, Copy, Debug)]
struct Joint {
    /// rad.
    from: f64,
    /// rad.
    to: f64,
    /// Largest speed, rad/s.
    fastest: f64,
    /// Its limit, rad/s.
    limit: f64,
}

#[derive(Debug)]
struct End {
    took: Duration,
    outcome: Outcome,
    /// Commanded positions, rad.
    at: Option<Vec<f64>>,
}

impl Report {
    pub(super) fn new(arm: &Arm, motion: &'static str, speed: f64, plan: &Plan) -> Self {
        let (from, to) = (plan.positions(Duration::ZERO), plan.end());
        let mut fastest = vec![0.0_f64; to.len()];
        for (time, ..) in plan.cycles() {
            for (most, velocity) in fastest.iter_mut().zip(plan.velocities(time)) {
                *most = most.max(velocity.abs());
            }
        }
        let limits = arm.description().joints.iter().map(|joint| joint.velocity);
        let joints = from.into_iter().zip(to).zip(fastest).zip(limits);
        let joint = |(((from, to), fastest), limit)| Joint {
            from,
            to,
            fastest,
            limit,
        };
        Self {
            arm: arm.description().name.clone(),
            motion,
            speed,
            duration: plan.duration(),
            joints: joints.map(joint).collect(),
            explained: None,
            end: None,
        }
    }

    /// What the motion becomes.
    pub(super) fn explain(&mut self, explained: &Explanation) {
        self.explained = Some(explained.clone());
    }

    /// The motion has ended.
    pub(super) fn end(&mut self, took: Duration, outcome: &Outcome, at: Option<Vec<f64>>) {
        self.end = Some(End {
            took,
            outcome: outcome.clone(),
            at,
        });
    }

    /// The plan as a table.
    pub(super) fn plan(&self) -> String {
        let seconds = self.duration.as_secs_f64();
        let mut text = format!(
            "{}: {} at speed {}, {seconds:.2} s planned\n",
            self.arm, self.motion, self.speed
        );
        text.push_str("joint   from, deg     to, deg  fastest, deg/s  of its limit\n");
        for (number, joint) in self.joints.iter().enumerate() {
            let [from, to, fastest] =
                [joint.from, joint.to, joint.fastest].map(|angle| plain(angle.to_degrees()));
            let share = plain(joint.fastest / joint.limit * 100.0);
            let _ = writeln!(
                text,
                "{number:>5} {from:>11.2} {to:>11.2} {fastest:>15.2} {share:>11.1} %"
            );
        }
        text
    }

    /// How it ended, in a line.
    pub(super) fn outcome(&self) -> String {
        let Some(end) = &self.end else {
            return String::new();
        };
        let mut text = format!(
            "{} after {:.2} s",
            word(&end.outcome),
            end.took.as_secs_f64()
        );
        if let Some(at) = &end.at {
            let _ = write!(text, ", {} at {} deg", self.arm, degrees(at));
        }
        text
    }

    /// Both as one object.
    pub(super) fn json(&self) -> Value {
        let joint = |joint: &Joint| {
            json!({
                "from_rad": joint.from, "to_rad": joint.to,
                "velocity_max_rad_per_s": joint.fastest, "velocity_limit_rad_per_s": joint.limit,
            })
        };
        let joints: Vec<_> = self.joints.iter().map(joint).collect();
        let end = self.end.as_ref();
        let explained = self.explained.as_ref();
        let cost = explained.map(|it| &it.cost);
        json!({
            "arm": self.arm, "motion": self.motion, "speed": self.speed,
            "duration_s": self.duration.as_secs_f64(), "joints": joints,
            "outcome": end.map(|end| word(&end.outcome)),
            "took_s": end.map(|end| end.took.as_secs_f64()),
            "at_rad": end.and_then(|end| end.at.clone()),
            "rules": explained.map(|it| it.rules.clone()),
            "cycle_cost_us": cost.map(|cost| cost.cycle.as_secs_f64() * 1e6),
            "cycle_share": cost.map(Cost::share),
        })
    }
}

/// Angles, rad, in degrees.
pub(super) fn degrees(angles: &[f64]) -> String {
    let angles = angles.iter();
    let angles = angles.map(|angle| format!("{:.2}", plain(angle.to_degrees())));
    angles.collect::<Vec<_>>().join(" ")
}

/// Without the sign of a zero that is shown with two digits.
fn plain(number: f64) -> f64 {
    if number.abs() < 0.005 { 0.0 } else { number }
}

/// An outcome in words.
pub(crate) fn word(outcome: &Outcome) -> String {
    match outcome {
        Outcome::Completed => "completed".to_owned(),
        Outcome::Cancelled => "cancelled".to_owned(),
        Outcome::Maintaining => "maintaining".to_owned(),
        Outcome::Skipped => "skipped".to_owned(),
        Outcome::TakenOver => "taken over".to_owned(),
        Outcome::Stopped(by) => format!("stopped by {by}"),
    }
}
