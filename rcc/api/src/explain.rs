//! What an activity becomes, before it is begun: the net, what it follows and what ends it in words, what it costs in each
//! cycle, and its plan. Nothing moves for that.

use std::fmt;

use crate::cost::Cost;
use crate::engine::{Failure, Start, When};
use crate::error::ErrorKind;
use crate::order::Order;
use crate::plan::Plan;
use crate::session::Session;

/// What an activity becomes.
#[derive(Clone, Debug)]
pub struct Explanation {
    /// The text of its net.
    pub net: String,
    /// What it follows, what it permits, and what ends it, a sentence each.
    pub rules: Vec<String>,
    /// What it costs in each cycle.
    pub cost: Cost,
    /// Its course, if that is known before it runs.
    pub plan: Option<Plan>,
}

impl Explanation {
    /// Its plan as a picture: positions and velocities of the joints over time, an SVG file; `None` without a plan.
    pub fn svg(&self) -> Option<String> {
        self.plan.as_ref().map(Plan::svg)
    }
}

/// Rules, cost and net, for people.
impl fmt::Display for Explanation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for rule in &self.rules {
            writeln!(f, "{rule}")?;
        }
        writeln!(f, "{}", self.cost)?;
        if let Some(plan) = &self.plan {
            writeln!(f, "planned: {:.3} s", plan.duration().as_secs_f64())?;
        }
        write!(f, "{}", self.net)
    }
}

impl Session {
    /// What an order becomes if it is begun now.
    pub(crate) fn explain(&self, order: &Order, when: When) -> Result<Explanation, ErrorKind> {
        order.check()?;
        let begins = self.begins(order, when, &crate::preparation::Before::new())?;
        let start = order.compile(&begins)?;
        let plan = order.operation.plan(&begins, order.speed.factor()).ok();
        let rules = self.rules(order, when, &start);
        let cost = self.cost(&start.net)?;
        let net = start.net;
        Ok(Explanation {
            net,
            rules,
            cost,
            plan,
        })
    }

    /// What an activity follows and permits, and what ends it.
    fn rules(&self, order: &Order, when: When, start: &Start) -> Vec<String> {
        let mut rules: Vec<_> = start
            .devices
            .iter()
            .map(|device| self.beginning(device, when))
            .collect();
        rules.extend(start.results.iter().filter_map(|key| match key.as_str() {
            "completed" => Some("When it is completed, what follows begins.".to_owned()),
            "maintaining" => {
                Some("From its goal on it keeps that up, and what follows takes over.".to_owned())
            }
            _ => None,
        }));
        if let Some(blend) = order.blend {
            let percent = blend * 100.0;
            rules.push(format!(
                "From {percent:.0} % of its path on, what follows takes over in motion."
            ));
        }
        rules.extend(order.until.iter().map(|(name, _)| {
            format!("When `{name}` holds, it stops on its path; at rest, what follows begins.")
        }));
        rules.push(
            "When it is cancelled, it stops on its path; what waits for it is cancelled."
                .to_owned(),
        );
        rules.extend(start.failures.iter().map(failing));
        rules
    }

    fn beginning(&self, device: &str, when: When) -> String {
        let engine = self.engine();
        let latest = engine.latest(device);
        match (when, latest) {
            (When::Now, Some(_)) => {
                format!("It begins in the next cycle, in place of what {device} does.")
            }
            (_, None) => format!("It begins at once: {device} has nothing to do."),
            (When::Follow, Some(latest)) => {
                let from = if engine.may_blend(latest) {
                    ", or far enough on its path to blend"
                } else {
                    ""
                };
                format!(
                    "It begins when what {device} does now is completed or stopped by a condition{from}; it does not begin if \
                     that fails or is cancelled."
                )
            }
        }
    }
}

/// A failure in words.
fn failing(failure: &Failure) -> String {
    let (device, cause) = if let ErrorKind::DeviceFailed { device, cause }
    | ErrorKind::Unreachable { device, cause, .. }
    | ErrorKind::Stale { device, cause } = &failure.error
    {
        (device, cause.as_str())
    } else if let ErrorKind::Conflict { device, .. } = &failure.error {
        (device, "another net commands it")
    } else {
        return failure.error.to_string();
    };
    format!("It fails, and what waits for it does not begin, if of {device}: {cause}.")
}
