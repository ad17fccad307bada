//! After a step: wrenches on hands, internal forces, rest and fall of bodies, and the truth.

use super::{HandState, STEP_S, Scene, Source, Tool};
use crate::body::Body;
use crate::event::EventKind;
use crate::geometry::{Wrench, origin};
use crate::scene::gather::GRAVITY;
use crate::screw::{Place, Screw, Thread};
use crate::solver::{Element, reaction};
use crate::surface::Surface;
use crate::truth::{BodyTruth, HandTruth, PegTruth, ScrewTruth, Truth};
use nalgebra::Vector3;
use std::time::Duration;

/// A body that is slower for [`CALM_S`] comes to rest, m/s and rad/s.
const CALM: [f64; 2] = [0.002, 0.02];
/// s
const CALM_S: f64 = 0.05;
/// A body that no hand holds and that is faster downwards falls, m/s.
const FALLS: f64 = 0.3;

impl Scene {
    /// Forces of the step on hands and pegs, and the largest so far.
    pub(super) fn react(&mut self) {
        self.react_elements();
        for peg in &mut self.pegs {
            peg.force_max = peg.force_max.max(peg.force);
        }
        for hand in &mut self.hands {
            hand.force_max = hand.force_max.max(hand.wrench.force.norm());
        }
    }

    fn react_elements(&mut self) {
        for (element, source) in &self.elements {
            match *source {
                Source::Other => {}
                Source::Grasp(hand, at) => {
                    let (force, torque) = reaction(element, &self.masses);
                    if let Some(HandState {
                        now: Some((flange, ..)),
                        wrench,
                        ..
                    }) = self.hands.get_mut(hand)
                    {
                        wrench.add_at(&-force, &(at - origin(flange)));
                        wrench.torque -= torque;
                    }
                    let mut bodies = self.bodies.iter_mut();
                    if let Some(body) = bodies.find(|body| body.slot == Some(element.body)) {
                        body.held.push((hand, force, at));
                    }
                }
                Source::Peg(peg, out) => {
                    let (force, _) = reaction(element, &self.masses);
                    if let Some(peg) = self.pegs.get_mut(peg) {
                        peg.force += force.dot(&out);
                    }
                }
            }
        }
    }

    /// Who rests, who falls, how hard two hands pull.
    pub(super) fn observe(&mut self, at: Duration) {
        for number in 0..self.bodies.len() {
            let is_cyclic = self.bodies[number]
                .support
                .is_some_and(|carrier| self.rests_on(carrier, number));
            let frame = self.bodies[number]
                .support
                .map(|carrier| self.frame(carrier));
            let hands = &self.hands;
            let body = &mut self.bodies[number];
            strain(body, hands);
            if body.slot.is_none() {
                continue;
            }
            let is_free = body.held.is_empty();
            let falls = is_free && body.twist.linear.z < -FALLS;
            if falls && !body.falls {
                let body = body.config.name.clone();
                self.log.push(at, EventKind::Dropped { body });
            }
            body.falls = falls || (body.falls && is_free && body.support.is_none());
            let Some((carrier, frame)) = body.support.zip(frame).filter(|_| !is_cyclic) else {
                body.calm_s = 0.0;
                continue;
            };
            let slide = body.twist.linear - frame.velocity(&origin(&body.pose));
            let turn = body.twist.angular - frame.twist.angular;
            let is_calm = is_free && slide.norm() < CALM[0] && turn.norm() < CALM[1];
            body.calm_s = if is_calm { body.calm_s + STEP_S } else { 0.0 };
            if body.calm_s > CALM_S {
                body.rest = Some((carrier, frame.pose.inverse() * body.pose));
                body.slot = None;
                let body = body.config.name.clone();
                self.log.push(at, EventKind::Rested { body });
            }
        }
    }

    pub(crate) fn truth(&self) -> Truth {
        let of = |index: usize| self.bodies.get(index).map(|it| it.config.name.clone());
        let surface = |index: usize| self.surfaces.get(index).map(|it| it.config.name.clone());
        let hands = self.hands.iter().map(|hand| {
            let (holds, slip_m) = match &hand.kind {
                Tool::Fingers(it) => (it.held.and_then(|held| of(held.body)), it.slip_m),
                Tool::Tip | Tool::Bit(_) => (None, 0.0),
            };
            let beyond = self.surfaces.len();
            let touches = hand.touches;
            HandTruth {
                name: hand.name.clone(),
                flange: hand.now.map(|now| now.0),
                wrench: hand.wrench,
                force_max_n: hand.force_max,
                holds,
                slip_m,
                touches: touches
                    .and_then(|it| surface(it).or_else(|| of(it.saturating_sub(beyond)))),
                refused: hand.motion.refused,
            }
        });
        Truth {
            at: self.now(),
            steps: self.steps,
            bodies: self
                .bodies
                .iter()
                .map(|body| self.body_truth(body))
                .collect(),
            hands: hands.collect(),
            pegs: self.peg_truths(),
            screws: self.screws.iter().map(|it| self.screw_truth(it)).collect(),
            bases: self
                .bases
                .iter()
                .map(|it| (it.name.clone(), it.pose))
                .collect(),
            events: self.log.events.clone(),
            events_lost: self.log.lost,
            energy_j: self.bodies.iter().map(energy).sum(),
        }
    }

    fn body_truth(&self, body: &Body) -> BodyTruth {
        let name = |hand: &usize| self.hands.get(*hand).map(|it| it.name.clone());
        BodyTruth {
            name: body.config.name.clone(),
            pose: body.pose,
            twist: body.twist,
            held_by: body
                .held
                .iter()
                .filter_map(|(hand, ..)| name(hand))
                .collect(),
            is_resting: body.rest.is_some(),
            is_missing: body.is_missing,
            internal_force_n: internal(body).unwrap_or(0.0),
            internal_force_max_n: body.internal_max,
            grasp_distance_m: body.distances,
        }
    }

    fn peg_truths(&self) -> Vec<PegTruth> {
        let truth = |peg: &super::PegState| {
            Some(PegTruth {
                peg: self.bodies.get(peg.body)?.config.name.clone(),
                hole: self.holes.get(peg.hole)?.config.name.clone(),
                depth_m: peg.depth,
                offset_m: peg.offset,
                force_n: peg.force,
                force_max_n: peg.force_max,
                is_seated: peg.is_seated,
            })
        };
        self.pegs.iter().filter_map(truth).collect()
    }

    fn screw_truth(&self, screw: &Screw) -> ScrewTruth {
        let hand = |hand: usize| self.hands.get(hand).map(|it| it.name.clone());
        let (at_bit, thread) = match screw.place {
            Place::Bit(index) => (hand(index), None),
            Place::Thread(index) => (None, self.threads.get(index)),
            Place::Magazine | Place::Missing => (None, None),
        };
        ScrewTruth {
            name: screw.config.name.clone(),
            at_bit,
            thread: thread.map(|it| it.config.name.clone()),
            depth_m: thread.map_or(0.0, |it| screw.depth(&it.config)),
            turned_rad: screw.turned,
            torque_nm: screw.torque,
            torque_max_nm: screw.torque_max,
            is_cross_threaded: screw.is_cross,
            is_seated: screw.is_seated,
            is_stripped: screw.is_stripped,
        }
    }

    pub(crate) fn hands(&self) -> &[HandState] {
        &self.hands
    }

    pub(crate) fn hands_mut(&mut self) -> &mut [HandState] {
        &mut self.hands
    }

    pub(crate) fn bodies(&self) -> &[Body] {
        &self.bodies
    }

    pub(crate) fn surfaces_all(&self) -> &[Surface] {
        &self.surfaces
    }

    pub(crate) fn screws(&self) -> &[Screw] {
        &self.screws
    }

    pub(crate) fn screws_mut(&mut self) -> &mut [Screw] {
        &mut self.screws
    }

    pub(crate) fn threads(&self) -> &[Thread] {
        &self.threads
    }

    pub(crate) fn note(&mut self, at: Duration, kind: EventKind) {
        self.log.push(at, kind);
    }

    /// A force of a hand on what moves.
    pub(crate) fn press_back(&mut self, owner: &super::Frame, at: &Vector3<f64>, wrench: &Wrench) {
        let elements: &mut Vec<(Element, Source)> = &mut self.elements;
        Self::press(elements, owner, at, wrench);
    }
}

/// Half of what two hands pull against each other along the line between them, N.
fn internal(body: &Body) -> Option<f64> {
    let [(_, first, from), (_, second, to)] = *body.held.as_slice() else {
        return None;
    };
    let line = (to - from).try_normalize(1e-9)?;
    Some((second - first).dot(&line) / 2.0)
}

fn strain(body: &mut Body, hands: &[HandState]) {
    let Some(force) = internal(body) else {
        return;
    };
    body.internal_max = body.internal_max.max(force.abs());
    let place = |index: usize| {
        let hand = body.held.get(index).and_then(|it| hands.get(it.0))?;
        hand.now.map(|(_, tcp, _)| origin(&tcp))
    };
    if let (Some(from), Some(to)) = (place(0), place(1)) {
        let now = (to - from).norm();
        let [least, most] = body.distances.unwrap_or([now; 2]);
        body.distances = Some([least.min(now), most.max(now)]);
    }
}

fn energy(body: &Body) -> f64 {
    let mass = body.config.mass_kg;
    let moving = mass * body.twist.linear.norm_squared() / 2.0;
    let turning = body
        .twist
        .angular
        .dot(&(body.inertia() * body.twist.angular))
        / 2.0;
    moving + turning + mass * GRAVITY * body.pose.translation.z
}
