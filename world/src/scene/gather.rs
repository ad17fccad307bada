//! Which forces act on the moving bodies in this step.

use super::{Frame, HandState, STEP_S, Scene, Source, Tool};
use crate::body::Carrier;
use crate::event::EventKind;
use crate::geometry::{Twist, Wrench, local, origin, point};
use crate::hole;
use crate::solver::{Against, Element, Mass};
use crate::surface::{Anchor, Touch};
use nalgebra::{Matrix3, Vector3};
use std::time::Duration;

/// Of the earth, m/s2.
pub(crate) const GRAVITY: f64 = 9.81;

impl Frame {
    /// Velocity of a point of the world that is fixed to it, m/s.
    pub(crate) fn velocity(&self, at: &Vector3<f64>) -> Vector3<f64> {
        self.twist.at(&(at - origin(&self.pose)))
    }

    fn against(&self, at: &Vector3<f64>) -> Against {
        self.slot.map_or_else(
            || {
                Against::Prescribed(Twist {
                    linear: self.velocity(at),
                    angular: self.twist.angular,
                })
            },
            |slot| Against::Body(slot, at - origin(&self.pose)),
        )
    }
}

impl Scene {
    /// Numbers the moving bodies.
    pub(super) fn number(&mut self) {
        let mut count = 0;
        for body in &mut self.bodies {
            body.slot = (body.rest.is_none() && !body.is_missing).then_some(count);
            count += usize::from(body.slot.is_some());
            body.support = None;
            body.held.clear();
        }
    }

    /// Masses with their weight, that of riding bodies included.
    pub(super) fn weigh(&mut self) {
        self.masses.clear();
        for body in self.bodies.iter().filter(|body| body.slot.is_some()) {
            let inertia = body.inertia();
            let spin = body.twist.angular;
            let down = Vector3::z() * (-GRAVITY * body.config.mass_kg);
            self.masses.push(Mass {
                mass: body.config.mass_kg,
                inertia,
                twist: body.twist,
                weight: (down, -spin.cross(&(inertia * spin))),
            });
        }
        for rider in self.bodies.iter().filter(|body| !body.is_missing) {
            let Some(carrier) = self.carried_by(rider.rest.map(|rest| rest.0)) else {
                continue;
            };
            let arm = origin(&rider.pose) - origin(&self.bodies[carrier].pose);
            let slot = self.bodies[carrier].slot;
            if let Some(mass) = slot.and_then(|slot| self.masses.get_mut(slot)) {
                let its = rider.config.mass_kg;
                let down = Vector3::z() * (-GRAVITY * its);
                mass.mass += its;
                mass.inertia += Matrix3::identity() * (its * arm.norm_squared());
                mass.weight.0 += down;
                mass.weight.1 += arm.cross(&down);
            }
        }
    }

    /// The moving body that carries something, directly or through others.
    fn carried_by(&self, carrier: Option<Carrier>) -> Option<usize> {
        let mut next = carrier;
        for _ in 0..self.bodies.len() {
            let Some(Carrier::Body(index)) = next else {
                return None;
            };
            let body = self.bodies.get(index)?;
            if body.slot.is_some() {
                return Some(index);
            }
            next = body.rest.map(|rest| rest.0);
        }
        None
    }

    /// Whether something is carried by a body.
    pub(super) fn rests_on(&self, carrier: Carrier, body: usize) -> bool {
        let mut next = Some(carrier);
        for _ in 0..=self.bodies.len() {
            match next {
                Some(Carrier::Body(index)) if index == body => return true,
                Some(Carrier::Body(index)) => {
                    next = self.bodies.get(index).and_then(|it| it.rest).map(|it| it.0);
                }
                _ => return false,
            }
        }
        true
    }

    /// Corners of bodies on surfaces: of those that move, and of those that ride on them.
    pub(super) fn surfaces(&mut self) {
        for number in 0..self.bodies.len() {
            let body = &self.bodies[number];
            let owner = if body.slot.is_some() {
                Some(number)
            } else {
                self.carried_by(body.rest.map(|rest| rest.0))
            };
            let Some(owner) = owner.filter(|_| !body.is_missing && !self.is_at_hole(number)) else {
                continue;
            };
            for (corner, at) in self.bodies[number].corners().into_iter().enumerate() {
                self.corner(number, owner, corner, &at);
            }
        }
    }

    /// The face of a hole that is in no body stands in for the surface around it.
    fn is_at_hole(&self, body: usize) -> bool {
        let mut pegs = self.pegs.iter().filter(|peg| peg.body == body);
        pegs.any(|peg| {
            let hole = self.holes.get(peg.hole);
            let hole = hole.filter(|it| !matches!(it.carrier, Carrier::Body(_)));
            let face = hole.map_or(0.0, |it| it.config.face_radius_m);
            hole.is_some() && (peg.touches || (peg.depth > 0.0 && peg.offset < face))
        })
    }

    /// A corner of a body that is, or rides on, the body `owner`, which moves.
    fn corner(&mut self, number: usize, owner: usize, corner: usize, at: &Vector3<f64>) {
        let body = &self.bodies[number];
        let at = point(&body.pose, at);
        let velocity = body.twist.at(&(at - origin(&body.pose)));
        let (mover, mass) = (&self.bodies[owner], self.bodies[owner].config.mass_kg);
        let (Some(slot), arm) = (mover.slot, at - origin(&mover.pose)) else {
            return;
        };
        let Anchor(anchor) = body.anchors[corner];
        let mut kept = Anchor(None);
        for (index, surface) in self.surfaces.iter().enumerate() {
            let carrier = self.frame(surface.carrier);
            let pose = carrier.pose * surface.config.pose;
            let below = local(&pose, &at);
            let Some(depth) = surface.depth(&below) else {
                continue;
            };
            let flat = Vector3::new(below.x, below.y, 0.0);
            let stuck = anchor
                .filter(|(on, _)| *on == index)
                .map_or(flat, |it| it.1);
            let touch = Touch {
                normal: pose.rotation * Vector3::z(),
                depth,
                stiffness: surface.config.stiffness / 4.0,
                friction: surface.config.friction,
                slide: pose.rotation * (flat - stuck),
            };
            // Four corners carry a box.
            let Some(push) = touch.push(&(velocity - carrier.velocity(&at)), mass / 4.0, STEP_S)
            else {
                continue;
            };
            kept = Anchor(Some((index, stuck + pose.rotation.inverse() * push.excess)));
            self.elements.push((
                Element {
                    body: slot,
                    arm,
                    against: carrier.against(&at),
                    force: push.force,
                    torque: Vector3::zeros(),
                    resistance: push.resistance,
                    turn_resistance: Matrix3::zeros(),
                },
                Source::Other,
            ));
        }
        self.bodies[number].anchors[corner] = kept;
        if let Anchor(Some((index, _))) = kept {
            self.bodies[owner].support = Some(self.surfaces[index].carrier);
        }
    }

    /// Fingers that hold bodies.
    pub(super) fn grasps(&mut self, at: Duration) {
        let slack = self.knobs.grip_friction;
        for (number, hand) in self.hands.iter_mut().enumerate() {
            let HandState {
                name,
                kind: Tool::Fingers(fingers),
                now: Some((_, tcp, twist)),
                ..
            } = hand
            else {
                continue;
            };
            let Some(mut held) = fingers.held else {
                continue;
            };
            let Some(body) = self.bodies.get_mut(held.body) else {
                continue;
            };
            // It may have come to rest between the fingers before.
            body.wake();
            let Some(slot) = body.slot else {
                continue;
            };
            let slipped = held.slips;
            let mass = body.config.mass_kg;
            let slack = slack * fingers.friction;
            let (hold, slid) = held.hold(fingers, slack, (tcp, &body.pose), mass, STEP_S);
            let says = |lost: bool| {
                let (hand, body) = (name.clone(), body.config.name.clone());
                if lost {
                    EventKind::Lost { hand, body }
                } else {
                    EventKind::Slipped { hand, body }
                }
            };
            if held.slips && !slipped && slid > 1e-7 {
                self.log.push(at, says(false));
            }
            fingers.slip_m += slid;
            let grip = body.config.grips.get(held.grip);
            let grip = grip.map_or(body.pose, |grip| body.pose * grip.0);
            let off = local(&grip, &origin(tcp));
            let reach = fingers.config.reach_m;
            if (0..3).any(|i| off[i].abs() > reach[i] + 0.003) {
                self.log.push(at, says(true));
                fingers.held = None;
                continue;
            }
            fingers.held = Some(held);
            let flange = *tcp * hand.tool.inverse();
            let lever = hold.at - origin(&flange);
            self.elements.push((
                Element {
                    body: slot,
                    arm: hold.at - origin(&body.pose),
                    against: Against::Prescribed(Twist {
                        linear: twist.at(&lever),
                        angular: twist.angular,
                    }),
                    force: hold.force,
                    torque: hold.torque,
                    resistance: hold.resistance,
                    turn_resistance: hold.turn_resistance,
                },
                Source::Grasp(number, hold.at),
            ));
        }
    }

    /// Pegs in holes.
    pub(super) fn pegs(&mut self, at: Duration) {
        for number in 0..self.pegs.len() {
            self.peg(number, at);
        }
    }

    fn peg(&mut self, number: usize, at: Duration) {
        let state = self.pegs[number];
        let (body, hole) = (&self.bodies[state.body], &self.holes[state.hole]);
        let owner = self.frame(hole.carrier);
        let is_own = hole.carrier == Carrier::Body(state.body);
        let Some(peg) = body.config.peg.filter(|_| !is_own && !body.is_missing) else {
            return;
        };
        let pose = owner.pose * hole.config.pose;
        let tip = body.pose * peg.tip;
        let depth = hole.config.depth_m;
        let bottom = self.knobs.obstructed_m.map_or(depth, |it| it.min(depth));
        let contact = hole.contact(&pose, &tip, peg.radius_m, bottom);
        let mut state = super::PegState {
            depth: contact.depth,
            offset: contact.offset,
            force: 0.0,
            ..state
        };
        let mut touches = false;
        let mass = body.config.mass_kg;
        for spot in contact.spots.into_iter().flatten() {
            touches = true;
            let (at, normal) = hole::outer(&pose, &spot);
            let arm = at - origin(&body.pose);
            let velocity = body.twist.at(&arm) - owner.velocity(&at);
            let push = hole::push(&hole.config, &spot, &normal, &velocity, mass, STEP_S);
            let (Some(slot), Some((force, resistance))) = (body.slot, push) else {
                continue;
            };
            let element = Element {
                body: slot,
                arm,
                against: owner.against(&at),
                force,
                torque: Vector3::zeros(),
                resistance,
                turn_resistance: Matrix3::zeros(),
            };
            let source = Source::Peg(number, pose.rotation * Vector3::z());
            self.elements.push((element, source));
        }
        let names = || (body.config.name.clone(), hole.config.name.clone());
        if touches && !state.touches {
            let (peg, hole) = names();
            self.log.push(at, EventKind::PegTouched { peg, hole });
        }
        let is_seated = touches && contact.depth >= depth - 1e-4;
        if is_seated && !state.is_seated {
            let (peg, hole) = names();
            self.log.push(at, EventKind::Seated { peg, hole });
        }
        (state.touches, state.is_seated) = (touches, is_seated);
        if touches {
            let carrier = hole.carrier;
            self.bodies[state.body].support = Some(carrier);
        }
        self.pegs[number] = state;
    }

    /// A force on a body or on nothing that moves, and back on the hand.
    pub(super) fn press(
        elements: &mut Vec<(Element, Source)>,
        owner: &Frame,
        at: &Vector3<f64>,
        wrench: &Wrench,
    ) {
        let Some(body) = owner.slot else {
            return;
        };
        elements.push((
            Element {
                body,
                arm: at - origin(&owner.pose),
                against: Against::Prescribed(Twist::default()),
                force: wrench.force,
                torque: wrench.torque,
                resistance: Matrix3::zeros(),
                turn_resistance: Matrix3::zeros(),
            },
            Source::Other,
        ));
    }
}
