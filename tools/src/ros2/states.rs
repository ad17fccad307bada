//! Joint states, wrenches and frames in motion: samples of the controller's scope, published at a rate. A thread for each arm and base;
//! nothing waits for it.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use takt_fleet::ros::keys::Qos;
use takt_fleet::ros::messages::{self, Nanos, Transform};
use takt_fleet::ros::node::{Node, NodeError, Publisher, now};
use takt_fleet::ros::types::{JOINT_STATE, TF_MESSAGE, WRENCH_STAMPED};

use super::frames::{Frames, Moving};
use super::names::RosArm;
use crate::http::Http;
use crate::output::complain;
use crate::scope::{Event, Frame, Group, Mode, Rejected, Request, Source};

/// Frames a second that the controller sends at most; each has all samples since the one before.
const FRAMES_HZ: f64 = 100.0;
/// How long a thread waits for the next event.
const WAIT: Duration = Duration::from_millis(200);
/// Frames that move; the same for all namespaces, as in ROS.
const TF: &str = "/tf";
/// Places of a frame a second at most: viewers draw no more.
const TF_HZ: u32 = 50;
/// A clock of the host that was set moves stamps by more than this, ns.
const SET: Nanos = 500_000_000;

/// What an arm was commanded and did, at a time.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Sample {
    /// ns since 1970.
    pub(super) stamp: Nanos,
    /// rad; not a number where unknown.
    pub(super) commanded: Vec<f64>,
    /// rad.
    pub(super) measured: Vec<f64>,
}

/// The last sample of each arm, by its name of ROS.
#[derive(Clone, Debug, Default)]
pub(super) struct Latest(Arc<Mutex<BTreeMap<String, Sample>>>);

impl Latest {
    pub(super) fn of(&self, arm: &str) -> Option<Sample> {
        let all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        all.get(arm).cloned()
    }

    fn set(&self, arm: &str, sample: Sample) {
        let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        all.insert(arm.to_owned(), sample);
    }
}

/// Starts the threads; they end with the process.
pub(super) fn start(
    node: &Node,
    http: &Http,
    arms: &[RosArm],
    frames: &Frames,
    rate: u32,
) -> Result<Latest, NodeError> {
    let latest = Latest::default();
    for arm in arms {
        let described = arm.arm.description();
        let has = |interface: &str| described.interfaces.iter().any(|it| it == interface);
        let [has_force, has_torques] = [has("wrench"), has("torques")];
        let name = format!("{}/wrench", arm.name);
        let wrench = has_force.then(|| node.publisher(&name, &WRENCH_STAMPED, Qos::TOPIC));
        let moving = match frames.of_arms.get(&arm.name) {
            Some(moving) => Some((moving.clone(), Places::new(node, rate)?)),
            None => None,
        };
        let mut states = States {
            arm: arm.clone(),
            joint_states: node.publisher("joint_states", &JOINT_STATE, Qos::TOPIC)?,
            wrench: wrench.transpose()?,
            moving,
            latest: latest.clone(),
        };
        let cycles = 1.0 / (f64::from(rate) * described.period.as_secs_f64());
        let probes = probes(
            &described.name,
            described.joints.len(),
            [has_torques, has_force],
        );
        let source = sampled(http, probes, every(cycles), rate);
        let feed = Feed::new(format!("joint states of {}", arm.name));
        std::thread::spawn(move || feed.run(&source, |stamp, of| states.row(stamp, of)));
    }
    for base in &frames.bases {
        let names = [format!("{base}.odometry"), format!("{base}.base")];
        let mut places = Places::new(node, rate)?;
        let probes = POSE.iter().map(|part| format!("{base}.base.pose.{part}"));
        let source = sampled(http, probes.collect(), 1, rate.min(TF_HZ));
        let feed = Feed::new(format!("poses of {base}"));
        let device = base.clone();
        let row = move |stamp: Nanos, of: &Of<'_>| {
            let parts = POSE.map(|part| of(&format!("{device}.base.pose.{part}")));
            let [
                Some(x),
                Some(y),
                Some(z),
                Some(w),
                Some(i),
                Some(j),
                Some(k),
            ] = parts
            else {
                return;
            };
            if [x, y, z, w, i, j, k].iter().any(|it| it.is_nan()) {
                return;
            }
            let [parent, child] = names.clone();
            let place = Transform {
                parent,
                child,
                position: [x, y, z],
                rotation: [i, j, k, w],
            };
            places.publish(stamp, || vec![place]);
        };
        std::thread::spawn(move || feed.run(&source, row));
    }
    Ok(latest)
}

/// Samples of these probes in every n-th cycle.
fn sampled(http: &Http, probes: Vec<String>, every: u64, rate: u32) -> Source {
    let request = Request {
        probes,
        every,
        trigger: None,
        pre_s: 0.0,
        post_s: 0.0,
        mode: Mode::Auto,
        rate_hz: f64::from(rate).min(FRAMES_HZ),
    };
    Source::start(http.clone(), request, true)
}

/// Every n-th cycle, for a rate that is a part of that of the cycles.
fn every(cycles: f64) -> u64 {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to small positive numbers"
    )]
    let every = cycles.round().clamp(1.0, 1e6) as u64;
    every
}

/// What is published of each joint.
const OF_JOINT: [&str; 3] = ["measured", "velocity", "commanded"];
/// The parts of a wrench, as probes of it are called.
const OF_WRENCH: [&str; 6] = ["x", "y", "z", "rx", "ry", "rz"];
/// The parts of a pose.
const POSE: [&str; 7] = ["x", "y", "z", "qw", "qx", "qy", "qz"];

/// The probes of an arm, which may measure torques of its joints and the force at its flange.
fn probes(device: &str, joints: usize, [has_torques, has_force]: [bool; 2]) -> Vec<String> {
    let torque = has_torques.then_some("torque");
    let of_joint = OF_JOINT.into_iter().chain(torque);
    let joint = |n| {
        of_joint
            .clone()
            .map(move |what| format!("{device}.joint.{n}.{what}"))
    };
    let mut probes: Vec<_> = (0..joints).flat_map(joint).collect();
    if has_force {
        let parts = OF_WRENCH.iter();
        probes.extend(parts.map(|part| format!("{device}.force.{part}")));
    }
    probes
}

/// The value of a probe in a row.
type Of<'r> = dyn Fn(&str) -> Option<f64> + 'r;

/// Samples as they come.
struct Feed {
    /// What is published of them, in words.
    what: String,
    /// By group: where each probe is in a row.
    columns: Vec<Vec<String>>,
    /// Time of the host less that of the controller, ns: the smallest, as messages take time.
    clock: Option<Nanos>,
}

impl Feed {
    const fn new(what: String) -> Self {
        Self {
            what,
            columns: Vec::new(),
            clock: None,
        }
    }

    /// Hands on each row with its stamp, for ever.
    fn run(mut self, source: &Source, mut row: impl FnMut(Nanos, &Of<'_>)) {
        let mut is_lost = false;
        let mut rejected = BTreeSet::new();
        loop {
            let Some(event) = source.next(WAIT) else {
                continue;
            };
            match event {
                Event::Setup(setup) => {
                    if is_lost {
                        complain(&format!("takt: {}: connected again", self.what));
                    }
                    is_lost = false;
                    self.clock = None;
                    self.columns = setup.groups.iter().map(names).collect();
                    for Rejected { probe, cause, hint } in setup.rejected {
                        if rejected.insert(probe.clone()) {
                            let what = &self.what;
                            complain(&format!("takt: {what}: `{probe}`: {cause}\nhint: {hint}"));
                        }
                    }
                }
                Event::Frame(frame) => self.frame(&frame, &mut row),
                Event::Closed(why) | Event::Refused(why) => {
                    if !is_lost {
                        complain(&format!("takt: {} are not published: {why}", self.what));
                    }
                    is_lost = true;
                }
                Event::Lost { samples, .. } => complain(&format!(
                    "takt: {}: {samples} samples were lost, since this host was too slow",
                    self.what
                )),
                Event::Triggered(_) | Event::Ended(_) | Event::Done => {}
            }
        }
    }

    fn frame(&mut self, frame: &Frame, row: &mut impl FnMut(Nanos, &Of<'_>)) {
        let Some(names) = self.columns.get(frame.group) else {
            return;
        };
        let at: BTreeMap<&str, usize> = names
            .iter()
            .enumerate()
            .map(|(at, name)| (name.as_str(), at + 1))
            .collect();
        let rows = rows(frame);
        if let Some(time) = rows.last().and_then(|row| row.first()) {
            let offset = now() - nanos(*time);
            let is_new = self
                .clock
                .is_none_or(|clock| offset < clock || offset > clock + SET);
            self.clock = if is_new { Some(offset) } else { self.clock };
        }
        for values in rows {
            let time = values.first().copied().unwrap_or(0.0);
            let stamp = nanos(time) + self.clock.unwrap_or(0);
            let of = |probe: &str| values.get(*at.get(probe)?).copied();
            row(stamp, &of);
        }
    }
}

/// Publishes frames that move, not too often.
struct Places {
    publisher: Publisher,
    /// Time between two of them, ns.
    apart: Nanos,
    last: Nanos,
}

impl Places {
    fn new(node: &Node, rate: u32) -> Result<Self, NodeError> {
        Ok(Self {
            publisher: node.publisher(TF, &TF_MESSAGE, Qos::TOPIC)?,
            apart: 1_000_000_000 / Nanos::from(rate.min(TF_HZ)),
            last: 0,
        })
    }

    fn publish(&mut self, stamp: Nanos, all: impl FnOnce() -> Vec<Transform>) {
        // The clock may be set back; samples are up to a cycle apart.
        if stamp < self.last || stamp - self.last >= self.apart * 9 / 10 {
            self.last = stamp;
            // Fails only when the session is closed, which ends the command.
            let _ = self.publisher.publish(messages::transforms(stamp, &all()));
        }
    }
}

struct States {
    arm: RosArm,
    joint_states: Publisher,
    wrench: Option<Publisher>,
    moving: Option<(Moving, Places)>,
    latest: Latest,
}

impl States {
    fn row(&mut self, stamp: Nanos, of: &Of<'_>) {
        let device = &self.arm.arm.description().name;
        let count = self.arm.joints.len();
        let all = |what: &str| -> Option<Vec<f64>> {
            (0..count)
                .map(|n| of(&format!("{device}.joint.{n}.{what}")))
                .collect()
        };
        let Some(measured) = all("measured") else {
            return;
        };
        // Without a measurement there is no state.
        if measured.iter().any(|position| position.is_nan()) {
            return;
        }
        let list = |what: &str| {
            let values = all(what).unwrap_or_default();
            let is_known = values.iter().all(|value| !value.is_nan());
            if is_known { values } else { Vec::new() }
        };
        let (velocities, torques) = (list("velocity"), list("torque"));
        let lists = [&measured[..], &velocities, &torques];
        let message = messages::joint_state(stamp, &self.arm.joints, lists);
        // Fails only when the session is closed, which ends the command.
        let _ = self.joint_states.publish(message);
        if let Some(wrench) = &self.wrench
            && let Some(values) = OF_WRENCH
                .iter()
                .map(|part| of(&format!("{device}.force.{part}")))
                .collect::<Option<Vec<f64>>>()
            && let Ok(values) = <[f64; 6]>::try_from(values)
            && values.iter().all(|value| !value.is_nan())
        {
            let frame = format!("{device}.flange");
            let _ = wrench.publish(messages::wrench(stamp, &frame, values));
        }
        if let Some((moving, places)) = &mut self.moving {
            places.publish(stamp, || moving.at(&measured));
        }
        let commanded = all("commanded").unwrap_or_default();
        self.latest.set(
            &self.arm.name,
            Sample {
                stamp,
                commanded,
                measured,
            },
        );
    }
}

/// The rows of a frame: the time and each column.
fn rows(frame: &Frame) -> Vec<&[f64]> {
    frame.values.chunks_exact(frame.columns + 1).collect()
}

fn names(group: &Group) -> Vec<String> {
    group
        .probes
        .iter()
        .map(|probe| probe.name.clone())
        .collect()
}

/// s in ns.
fn nanos(time: f64) -> Nanos {
    #[expect(
        clippy::cast_possible_truncation,
        reason = "the run time of a controller"
    )]
    let nanos = (time * 1e9) as Nanos;
    nanos
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rate_is_a_part_of_the_cycles() {
        for (cycles, wanted) in [(10.0, 10), (0.5, 1), (3.4, 3), (f64::INFINITY, 1_000_000)] {
            assert_eq!(every(cycles), wanted);
        }
    }

    #[test]
    fn rows_of_a_frame_begin_with_the_time() {
        let frame = Frame {
            columns: 2,
            values: vec![0.1, 1.0, 2.0, 0.2, 3.0, 4.0],
            ..Frame::default()
        };
        assert_eq!(rows(&frame), [[0.1, 1.0, 2.0], [0.2, 3.0, 4.0]]);
    }

    #[test]
    fn probes_of_an_arm_have_joints_and_force() {
        let all = probes("left", 2, [true, true]);
        assert_eq!(all.len(), 14);
        assert_eq!(all[5], "left.joint.1.velocity");
        assert_eq!(all[7], "left.joint.1.torque");
        assert_eq!(all[13], "left.force.rz");
        assert_eq!(probes("left", 2, [false, false]).len(), 6);
    }
}
