//! Streamed goals: the program writes goals while the arm moves, and every joint follows as fast as its limits allow. One
//! net runs all the while; an older goal is given up in the cycle in which the next one arrives.

use super::{ArmDescription, frame};
use crate::engine::Failure;
use crate::error::ErrorKind;
use crate::live::KEY;
use crate::net::{Net, Port, array};
use crate::order::{Operation, Ports, Requests};
use crate::pose::Pose;

/// An arm that follows goals.
#[derive(Clone, Debug)]
pub(crate) struct Stream {
    pub(crate) arm: ArmDescription,
    pub(crate) goals: Goals,
}

/// What goals are.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Goals {
    /// Positions of the joints.
    Joints,
    /// Poses of a motion centre, which is at this place in the flange, in the base.
    Poses(Pose),
}

impl Stream {
    /// The goal of each joint, null until a program writes one; and whether there are no joints for it.
    fn write_goal(&self, net: &mut Net) -> (Port, Option<Port>) {
        let arm = &self.arm;
        let kind = match self.goals {
            Goals::Joints => "Core::DoubleArray",
            Goals::Poses(_) => "World::Frame",
        };
        let mut arguments = vec![("Key", KEY.into())];
        if matches!(self.goals, Goals::Joints) {
            let zeros = array(&vec![0.0; arm.joints.len()]);
            arguments.push(("Value", zeros.into()));
        }
        let sent = net.add_with(&format!("{kind}NetcommIn"), &arguments);
        // The age is null until a program writes.
        let now = net.add("Core::TimeNet", []).out("outValue");
        let age = net.of_two("Core::TimeDiff", &now, &sent.out("outLastUpdated"));
        let never = net.of("Core::DoubleIsNull", &age);
        let mut arguments = vec![
            ("inValue", (&sent.out("outValue")).into()),
            ("inNull", (&never).into()),
        ];
        if matches!(self.goals, Goals::Joints) {
            arguments.push(("Size", arm.joints.len().into()));
        }
        let goal = net.add_with(&format!("{kind}SetNull"), &arguments);
        let goal = goal.out("outValue");
        match self.goals {
            Goals::Joints => (goal, None),
            Goals::Poses(tool) => {
                let flange = net.transform(&goal, &tool.inverse());
                let (joints, beyond) = frame::inverse(net, arm, &flange);
                (joints, Some(beyond))
            }
        }
    }
}

impl Operation for Stream {
    fn devices(&self) -> Vec<String> {
        vec![self.arm.name.clone()]
    }

    fn check(&self) -> Result<(), ErrorKind> {
        match self.goals {
            Goals::Poses(tool) if !tool.is_finite() => {
                let text = format!("{}: the motion centre is not finite", self.arm.name);
                Err(ErrorKind::Invalid(text))
            }
            Goals::Joints | Goals::Poses(_) => Ok(()),
        }
    }

    fn needs_begins(&self) -> bool {
        false
    }

    fn write(&self, net: &mut Net, requests: &Requests<'_>) -> Result<Ports, ErrorKind> {
        let arm = &self.arm;
        let (goal, beyond) = self.write_goal(net);
        let beyond = beyond.map(|beyond| {
            let latched = [("inOn", (&beyond).into())];
            net.add("Core::Trigger", latched).out("outActive")
        });
        let stop = std::iter::once(requests.stop.clone()).chain(beyond.clone());
        let stop = net.any(&stop.collect::<Vec<_>>());
        let stop = stop.unwrap_or_else(|| requests.stop.clone());
        let track = arm.track(net, &goal, &stop, requests.speed);
        let rests = track.out("outDone");
        let mut failures = arm.command(net, &track.out("outPosition"));
        if let Some(beyond) = &beyond {
            // The net ends when the arm is at rest.
            let ended = net.of_two("Core::BooleanAnd", &rests, beyond);
            failures.push((Failure::unreachable(&arm.name), ended));
        }
        Ok(Ports {
            done: net.of_two("Core::BooleanAnd", &rests, &requests.stop),
            progress: None,
            failures,
            results: Vec::new(),
            fault: beyond,
        })
    }
}
