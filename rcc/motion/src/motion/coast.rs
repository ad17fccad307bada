//! `Motion::Coast`: where joints would be a cycle later if they went on braking from the state in which a motion began. It is
//! the hint of an inverse: a path of a frame says nothing about the elbow of an arm with more joints than the frame has
//! coordinates, and without it an elbow in motion would stop within one cycle. It moves no joint itself.

use takt_net::definition::port;
use takt_net::{ArrayOut, Build, Cycle, Definition, Fault, FaultKind, In, NullRule, Primitive};

use super::bounds::State;
use super::profile::Profile;
use super::ptp::JointsFrom;
use super::{joint_bounds, with_joint_limits};

struct Coast {
    joints: Box<[Profile]>,
    from: JointsFrom,
    reset: In<bool>,
    has_started: bool,
    position: ArrayOut<f64>,
}

impl Primitive for Coast {
    fn step(&mut self, cycle: &Cycle<'_>) {
        if !self.from.read(cycle) {
            self.position.set_null(cycle);
            return;
        }
        if !self.has_started || self.reset.get(cycle) == Some(true) {
            self.has_started = true;
            for (joint, state) in self.joints.iter_mut().zip(&self.from.states) {
                joint.start(State {
                    position: 0.0,
                    ..*state
                });
            }
        }
        let joints = self.joints.iter_mut().zip(&self.from.states);
        let positions = joints.map(|(joint, state)| {
            let before = joint.now().position;
            joint.advance();
            state.position + (joint.now().position - before)
        });
        self.position.set(cycle, positions);
    }
}

fn build(b: &mut Build<'_, '_>) -> Result<Coast, Fault> {
    let Some(from) = JointsFrom::new(b)? else {
        let why = "inFrom is not connected: joints go on from there".to_owned();
        return Err(b.fault(FaultKind::ArraySize(why)));
    };
    let period_s = b.period_s();
    let bounds = joint_bounds(b, from.states.len())?;
    let joint = |bounds| Profile::new(0.0, bounds, period_s);
    Ok(Coast {
        joints: bounds.into_iter().map(joint).collect(),
        position: b.array_output("outPosition", from.states.len())?,
        reset: b.input("inReset")?,
        has_started: false,
        from,
    })
}

pub(super) fn definition() -> Definition {
    let definition = Definition::new(
        "Motion::Coast",
        "Where joints in motion would be one cycle later if they went on braking from the state of the first cycle: the \
         hint of an inverse that lets an elbow come to rest within its limits. Joints at rest stay where they are.",
        build,
    )
    .stateful()
    .array_input::<f64>(port("inFrom", "position of each joint in the previous cycle, rad").required())
    .array_input::<f64>(port(
        "inFromVelocity",
        "velocity of each joint there, rad/s; taken in the first cycle, at rest if not connected",
    ))
    .array_input::<f64>(port(
        "inFromAcceleration",
        "acceleration of each joint there, rad/s²; taken in the first cycle, 0 if not connected",
    ))
    .array_output::<f64>("outPosition", "position of each joint, rad");
    let mut definition = with_joint_limits(definition).cost_ns(500);
    // Three arrays or more have an element for each joint; each joint is planned for once.
    definition.cost.element_ns = 500.0;
    definition.null(NullRule::Own(
        "Null while inFrom or a port of its rates, where connected, is not a number.",
    ))
}
