//! Joint states and wrenches: samples of the controller's scope, published at a rate. A thread for each arm; nothing waits for it.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use takt_fleet::ros::keys::Qos;
use takt_fleet::ros::messages::{self, Nanos};
use takt_fleet::ros::node::{Node, NodeError, Publisher, now};
use takt_fleet::ros::types::{JOINT_STATE, WRENCH_STAMPED};

use super::names::RosArm;
use crate::http::Http;
use crate::output::complain;
use crate::scope::{Event, Frame, Group, Mode, Request, Source};

/// Frames a second that the controller sends at most; each has all samples since the one before.
const FRAMES_HZ: f64 = 100.0;
/// How long a thread waits for the next event.
const WAIT: Duration = Duration::from_millis(200);
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
    rate: u32,
) -> Result<Latest, NodeError> {
    let latest = Latest::default();
    for arm in arms {
        let states = States {
            arm: arm.clone(),
            joint_states: node.publisher("joint_states", &JOINT_STATE, Qos::TOPIC)?,
            wrench: None,
            latest: latest.clone(),
            columns: Vec::new(),
            clock: None,
        };
        let described = arm.arm.description();
        let has_force = described.interfaces.iter().any(|it| it == "wrench");
        let name = format!("{}/wrench", arm.name);
        let wrench = has_force.then(|| node.publisher(&name, &WRENCH_STAMPED, Qos::TOPIC));
        let states = States {
            wrench: wrench.transpose()?,
            ..states
        };
        let cycles = 1.0 / (f64::from(rate) * described.period.as_secs_f64());
        let request = Request {
            probes: probes(&described.name, described.joints.len(), has_force),
            every: every(cycles),
            trigger: None,
            pre_s: 0.0,
            post_s: 0.0,
            mode: Mode::Auto,
            rate_hz: f64::from(rate).min(FRAMES_HZ),
        };
        let source = Source::start(http.clone(), request, true);
        std::thread::spawn(move || states.publish(&source));
    }
    Ok(latest)
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

/// What is published of a joint, in this order.
const OF_JOINT: [&str; 4] = ["measured", "velocity", "torque", "commanded"];
/// The parts of a wrench.
const OF_WRENCH: [&str; 6] = [
    "force.x", "force.y", "force.z", "torque.x", "torque.y", "torque.z",
];

fn probes(device: &str, joints: usize, has_force: bool) -> Vec<String> {
    let joint = |n| {
        OF_JOINT
            .iter()
            .map(move |what| format!("{device}.joint.{n}.{what}"))
    };
    let mut probes: Vec<_> = (0..joints).flat_map(joint).collect();
    if has_force {
        probes.extend(
            OF_WRENCH
                .iter()
                .map(|part| format!("{device}.force.{part}")),
        );
    }
    probes
}

struct States {
    arm: RosArm,
    joint_states: Publisher,
    wrench: Option<Publisher>,
    latest: Latest,
    /// By group: where each probe of the arm is in a row.
    columns: Vec<Vec<String>>,
    /// Time of the host less that of the controller, ns: the smallest, as messages take time.
    clock: Option<Nanos>,
}

impl States {
    fn publish(mut self, source: &Source) {
        let mut is_lost = false;
        loop {
            let Some(event) = source.next(WAIT) else {
                continue;
            };
            match event {
                Event::Setup(setup) => {
                    if is_lost {
                        complain(&format!(
                            "takt: joint states of {}: connected again",
                            self.arm.name
                        ));
                    }
                    is_lost = false;
                    self.clock = None;
                    self.columns = setup.groups.iter().map(names).collect();
                }
                Event::Frame(frame) => self.frame(&frame),
                Event::Closed(why) | Event::Refused(why) => {
                    if !is_lost {
                        complain(&format!(
                            "takt: joint states of {} are not published: {why}",
                            self.arm.name
                        ));
                    }
                    is_lost = true;
                }
                Event::Lost { samples, .. } => complain(&format!(
                    "takt: {samples} joint states of {} were lost, since this host was too slow",
                    self.arm.name
                )),
                Event::Triggered(_) | Event::Ended(_) | Event::Done => {}
            }
        }
    }

    fn frame(&mut self, frame: &Frame) {
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
        let device = &self.arm.arm.description().name;
        for row in rows {
            let time = row.first().copied().unwrap_or(0.0);
            let stamp = nanos(time) + self.clock.unwrap_or(0);
            let of = |probe: &str| {
                let column = at.get(format!("{device}.{probe}").as_str());
                column.and_then(|column| row.get(*column)).copied()
            };
            self.row(stamp, of);
        }
    }

    fn row(&self, stamp: Nanos, of: impl Fn(&str) -> Option<f64>) {
        let count = self.arm.joints.len();
        let all = |what: &str| -> Option<Vec<f64>> {
            (0..count)
                .map(|n| of(&format!("joint.{n}.{what}")))
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
                .map(|part| of(&format!("force.{part}")))
                .collect::<Option<Vec<f64>>>()
            && let Ok(values) = <[f64; 6]>::try_from(values)
            && values.iter().all(|value| !value.is_nan())
        {
            let frame = format!("{}.flange", self.arm.name);
            let _ = wrench.publish(messages::wrench(stamp, &frame, values));
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
        let all = probes("left", 2, true);
        assert_eq!(all.len(), 14);
        assert_eq!(all[5], "left.joint.1.velocity");
        assert_eq!(all[13], "left.force.torque.z");
    }
}
