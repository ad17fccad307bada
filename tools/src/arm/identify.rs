//! `takt arm identify`: the load that an arm carries beyond the one that its cell file or its controller knows, from its external torques while it
//! swings its joints slowly. It moves the arm by the Robotics API and reads torques by the scope; the weighing is that of `takt-motion`.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use clap::Args;
use nalgebra::Vector3;
use serde_json::json;
use takt_motion::dynamics::{GRAVITY, Sample, Weighing, weigh};

use crate::Verdict;
use crate::http::Http;
use crate::motion::{confirm_arm, hinted, perform_unplanned};
use crate::net::server::Server;
use crate::output::say;
use crate::quantity::angle;
use crate::scope::{Event, Mode, Request, Source};

/// How long the controller may take to answer.
const TIMEOUT: Duration = Duration::from_secs(5);
/// Rate of samples, 1/s, and how often they are sent.
const SAMPLE_HZ: f64 = 100.0;
const FRAME_HZ: f64 = 10.0;
/// How long the last samples may take to arrive.
const LAST: Duration = Duration::from_millis(500);
/// Samples over which an acceleration is measured, and the largest one of a steady motion, rad/s².
const SPAN: usize = 5;
const STEADY: f64 = 0.15;
/// Goals of the arm; more than the joints that swing.
const ROWS: usize = 8;
/// What swings keep from the limits of a joint, rad.
const MARGIN: f64 = 0.02;

/// Find the mass and the centre of the load that an arm carries beyond the one that is stated.
///
/// The arm swings all joints but the first to both sides of its present pose, slowly, in nine motions: begin in a bent pose with free space around,
/// in position control, with nothing that touches the arm. It needs external torques: FRI arms estimate them, arms on drives with `rated_torque` and
/// a URDF with masses. Inertia is not found. Ctrl-C brakes and ends. It asks before it moves.
///
/// Exit status: 0 found, or nothing beyond what is stated; 1 the motion or the torques do not show it; 2 it could not be tried.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt arm identify left
  takt arm identify left --swing 30deg --speed 0.05 --yes --json")]
pub(crate) struct Identify {
    /// Name of the arm, as in cell.toml.
    arm: String,
    /// How far the joints swing to either side.
    #[arg(long, value_name = "ANGLE", default_value = "20deg", value_parser = angle)]
    swing: f64,
    /// Speed as a part of the arm's limits, above 0 to 0.3.
    #[arg(long, default_value_t = 0.1)]
    speed: f64,
    /// Direction of gravity in the base of the arm: x,y,z.
    #[arg(long, value_name = "X,Y,Z", default_value = "0,0,-1", value_parser = direction, allow_hyphen_values = true)]
    down: Vector3<f64>,
    /// Move without asking.
    #[arg(long)]
    yes: bool,
    /// Print JSON.
    #[arg(long)]
    json: bool,
    /// Where the controller serves HTTP: `websocket` of its cell.toml.
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:8080")]
    http: String,
    #[command(flatten)]
    server: Server,
}

/// A direction from three numbers.
fn direction(text: &str) -> Result<Vector3<f64>, String> {
    let numbers: Vec<f64> = text
        .split(',')
        .map_while(|part| part.trim().parse().ok())
        .collect();
    let wrong = || format!("`{text}` is no direction; write three numbers, such as 0,0,-1");
    let &[x, y, z] = numbers.as_slice() else {
        return Err(wrong());
    };
    let of = Vector3::new(x, y, z).try_normalize(1e-9);
    of.filter(|it| it.iter().all(|part| part.is_finite()))
        .ok_or_else(wrong)
}

impl Identify {
    pub(super) fn run(&self) -> anyhow::Result<Verdict> {
        anyhow::ensure!(
            self.speed > 0.0 && self.speed <= 0.3,
            "--speed {} is not slow\nhint: above 0 to 0.3, so that inertia does not count",
            self.speed
        );
        anyhow::ensure!(
            (0.05..=1.6).contains(&self.swing),
            "--swing is 3deg to 90deg"
        );
        let http = Http::new(&self.http, self.server.token_file.as_deref(), TIMEOUT)?;
        let cell = self.server.cell()?;
        let arm = cell.arm(&self.arm).map_err(hinted)?;
        let about = arm.description().clone();
        let model = about.model.unlimited().with_context(|| {
            format!(
                "the kinematics of {} are not known\nhint: set `model` in its cell file",
                self.arm
            )
        })?;
        let joints = about.joints.len();
        let every = (1.0 / (SAMPLE_HZ * about.period.as_secs_f64())).max(1.0);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a small number of cycles"
        )]
        let every = every as u64;
        let source = self.sample(&http, joints, every)?;
        confirm_arm(&arm, self.yes)?;
        let here = arm.commanded().map_err(hinted)?;
        let limits: Vec<_> = about
            .joints
            .iter()
            .map(|it| (it.position_min + MARGIN, it.position_max - MARGIN))
            .collect();
        let goals = swings(&here, &limits, self.swing);
        let ends = AtomicBool::new(false);
        let (moved, rows) = std::thread::scope(|scope| {
            let ends = &ends;
            let reader = scope.spawn(move || read(&source, ends));
            let moved = goals.into_iter().try_for_each(|goal| {
                let outcome = perform_unplanned(arm.ptp(goal).speed(self.speed))?;
                anyhow::ensure!(
                    outcome == takt_api::Outcome::Completed,
                    "the arm did not come to its goal: {outcome:?}\nhint: begin in a bent pose with free space around"
                );
                Ok(())
            });
            ends.store(true, Ordering::Release);
            (moved, reader.join())
        });
        moved?;
        let rows =
            rows.map_err(|_| anyhow::anyhow!("the thread that reads samples has panicked"))?;
        let rows = rows?;
        let samples = steady(&rows, joints);
        let found = weigh(&*model, None, &samples, &(self.down * GRAVITY));
        cell.close().map_err(hinted)?;
        match found {
            Ok(found) => self.report(&found),
            Err(why) => {
                say(&format!("{}: no load is identified: {why}", self.arm))?;
                Ok(Verdict::Failed)
            }
        }
    }

    /// Begins to sample positions, velocities and external torques of all joints, in this order.
    fn sample(&self, http: &Http, joints: usize, every: u64) -> anyhow::Result<Source> {
        let kinds = ["measured", "velocity", "external_torque"];
        let names = kinds.iter().flat_map(|kind| {
            (0..joints).map(move |joint| format!("{}.joint.{joint}.{kind}", self.arm))
        });
        let request = Request {
            probes: names.collect(),
            every,
            trigger: None,
            pre_s: 0.0,
            post_s: 0.0,
            mode: Mode::Single,
            rate_hz: FRAME_HZ,
        };
        let source = Source::start(http.clone(), request, false);
        match source.next(TIMEOUT) {
            Some(Event::Setup(setup)) if setup.rejected.is_empty() && setup.groups.len() == 1 => {
                Ok(source)
            }
            Some(Event::Setup(setup)) => {
                let why = setup.rejected.first();
                let why = why.map_or("they are in several threads", |it| it.cause.as_str());
                bail!(
                    "{} has no external torques of all joints: {why}\nhint: FRI arms estimate them, and arms on drives with `rated_torque` and a \
                     URDF with masses; `takt scope --list {}` lists what there is",
                    self.arm,
                    self.arm
                )
            }
            Some(Event::Refused(why) | Event::Closed(why)) => bail!("no samples: {why}"),
            _ => bail!("{} does not answer in time", http.address()),
        }
    }

    fn report(&self, found: &Weighing) -> anyhow::Result<Verdict> {
        let (name, [x, y, z]) = (&self.arm, found.centre.into());
        let has_load = found.mass > found.uncertainty;
        if self.json {
            say(&json!({
                "arm": name, "mass_kg": found.mass, "uncertainty_kg": found.uncertainty, "centre_of_mass_m": [x, y, z],
                "residual_nm": found.residual, "torques_nm": found.torques, "readings": found.readings, "has_load": has_load,
            })
            .to_string())?;
            return Ok(Verdict::Good);
        }
        if has_load {
            say(&format!(
                "{name} carries {:.2} kg (within {:.2} kg) beyond what is stated, {x:.3}, {y:.3}, {z:.3} m from the flange",
                found.mass, found.uncertainty
            ))?;
        } else {
            say(&format!(
                "{name} carries nothing beyond what is stated, within {:.2} kg",
                found.uncertainty.max(found.mass.abs())
            ))?;
        }
        say(&format!(
            "{:.2} Nm of {:.2} Nm are not explained, {} torques of moving joints",
            found.residual, found.torques, found.readings
        ))?;
        if has_load {
            say(&format!(
                "cell.toml, if it states no payload yet: payload = {{ mass = {:.2}, centre_of_mass = [{x:.3}, {y:.3}, {z:.3}] }}",
                found.mass
            ))?;
        }
        Ok(Verdict::Good)
    }
}

/// Where the arm moves: to the rows of a Walsh matrix, whose signs are the sides of the joints but the first, and back. Each pair of joints thus
/// is on all four pairs of sides equally often, so that no joint's friction looks like that of another, nor like a weight.
fn swings(here: &[f64], limits: &[(f64, f64)], swing: f64) -> Vec<Vec<f64>> {
    let goal = |row: usize| {
        let joints = here.iter().zip(limits).enumerate();
        let swung = joints.map(|(joint, (at, (min, max)))| {
            if joint == 0 {
                return *at;
            }
            let side = if (joint & row).count_ones().is_multiple_of(2) {
                swing
            } else {
                -swing
            };
            // An arm that stands beyond its margin does not jump to it.
            (at + side).clamp(min.min(*at), max.max(*at))
        });
        swung.collect()
    };
    (0..ROWS).map(goal).chain([here.to_vec()]).collect()
}

/// The rows of all samples until the motions have ended.
fn read(source: &Source, ends: &AtomicBool) -> anyhow::Result<Vec<(f64, Vec<f64>)>> {
    let mut rows = Vec::new();
    let mut until = None;
    loop {
        if until.is_none() && ends.load(Ordering::Acquire) {
            until = Some(Instant::now() + LAST);
        }
        if until.is_some_and(|until| Instant::now() > until) {
            return Ok(rows);
        }
        match source.next(LAST) {
            Some(Event::Frame(frame)) => {
                rows.extend(frame.rows().map(|(at, values)| (at, values.to_vec())));
            }
            Some(Event::Closed(why) | Event::Refused(why)) => {
                bail!("the samples ended before the motion: {why}")
            }
            Some(Event::Ended(ended)) => {
                bail!("{} has no more values: {}", ended.probe, ended.cause)
            }
            _ => {}
        }
    }
}

/// Samples in which no joint accelerates, with all values. A torque that the surroundings exert is held by the opposite one.
fn steady(rows: &[(f64, Vec<f64>)], joints: usize) -> Vec<Sample> {
    let fits =
        |values: &[f64]| values.len() == 3 * joints && values.iter().all(|value| value.is_finite());
    let around = rows.windows(2 * SPAN + 1).filter_map(|window| {
        let [(before, from), (_, at), (after, to)] =
            [window.first()?, window.get(SPAN)?, window.last()?];
        if !(fits(from) && fits(at) && fits(to)) || after <= before {
            return None;
        }
        let velocities = joints..2 * joints;
        let (from, to) = (from.get(velocities.clone())?, to.get(velocities)?);
        let mut both = from.iter().zip(to);
        both.all(|(from, to)| (to - from).abs() < STEADY * (after - before))
            .then_some(at)
    });
    let sample = |values: &Vec<f64>| {
        let (positions, rest) = values.split_at(joints);
        let (velocities, torques) = rest.split_at(joints);
        let motions = positions.iter().zip(velocities);
        Sample {
            motions: motions.map(|(at, by)| [*at, *by, 0.0]).collect(),
            torques: torques.iter().map(|torque| -torque).collect(),
        }
    };
    around.map(sample).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn swings_stay_within_limits_and_end_where_they_began() {
        let limits = [(-2.0, 2.0); 6];
        let here = [0.1, 0.5, -1.2, 1.95, 0.9, 2.1];
        let goals = swings(&here, &limits, 0.5);
        assert_eq!(goals.len(), 9);
        assert_eq!(goals.last().unwrap(), &here);
        for goal in &goals {
            assert!((goal[0] - 0.1).abs() < 1e-12, "the first joint rests");
            assert!(goal.iter().all(|at| (-2.0..=2.1).contains(at)), "{goal:?}");
        }
        // Each pair of joints is on each pair of sides twice.
        let side = |row: usize, joint: usize| goals[row][joint] > here[joint];
        for (a, b) in [(1, 2), (1, 3), (2, 3), (2, 4), (1, 4)] {
            let both = (0..8).filter(|row| side(*row, a) && side(*row, b));
            assert_eq!(both.count(), 2, "{a}, {b}");
        }
    }

    #[test]
    fn samples_without_acceleration_and_with_all_values_count() {
        let row = |number: i32, velocity: f64, torque: f64| {
            (0.01 * f64::from(number), vec![0.5, velocity, torque])
        };
        let rows: Vec<_> = (0..30).map(|number| row(number, 0.2, 3.0)).collect();
        let samples = steady(&rows, 1);
        assert_eq!(samples.len(), 30 - 2 * SPAN);
        assert_eq!(samples[0].motions, [[0.5, 0.2, 0.0]]);
        assert_eq!(samples[0].torques, [-3.0]);
        let faster: Vec<_> = (0..30)
            .map(|number| row(number, 0.01 * f64::from(number), 3.0))
            .collect();
        assert!(steady(&faster, 1).is_empty());
        let unknown: Vec<_> = (0..30).map(|number| row(number, 0.2, f64::NAN)).collect();
        assert!(steady(&unknown, 1).is_empty());
    }

    #[test]
    fn direction_is_three_numbers_and_has_length_1() {
        assert_eq!(direction("0, 0,-2").unwrap(), -Vector3::z());
        for wrong in ["", "0,0", "0,0,0", "a,0,1", "0,0,1,2", "inf,0,0"] {
            assert!(direction(wrong).is_err(), "{wrong}");
        }
    }
}
