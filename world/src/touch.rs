//! Hands that touch: the tip of a tool on surfaces and bodies, the palm of a gripper over a grip, the bit of a screwdriver
//! on screws. Hands move as posted, so these forces are explicit.

use crate::body::Carrier;
use crate::event::EventKind;
use crate::geometry::{Pose, Wrench, local, origin};
use crate::grasp::is_over;
use crate::scene::{Frame, HandState, Scene, Tool};
use crate::screw::{BIT_DAMPING, BIT_STIFFNESS, Place, RECESS_STIFFNESS, has_left};
use crate::surface::{Anchor, Touch};
use nalgebra::Vector3;
use std::time::Duration;

/// Of a tip on a body, N/m.
const TIP_STIFFNESS: f64 = 20_000.0;
/// Of a tip on a body.
const TIP_FRICTION: f64 = 0.4;
/// The palm of a gripper meets a body this far beyond the middle of the grip, m.
const PALM: f64 = 0.006;
/// What is deeper inside of a body is no contact, m.
const DEPTH_MAX: f64 = 0.02;
/// A screw's tip touches the face around a thread within this radius, m.
const FACE: f64 = 0.015;

/// A found contact: what, its frame, how.
struct Found {
    what: usize,
    owner: Frame,
    touch: Touch,
    /// Pose of the surface or body, in which the anchor is kept, and the point in it.
    frame: Pose,
    at: Vector3<f64>,
}

impl Scene {
    /// Tips of all hands.
    pub(super) fn tips(&mut self, at: Duration) {
        for number in 0..self.hands().len() {
            self.tip(number, at);
        }
    }

    fn tip(&mut self, number: usize, time: Duration) {
        let hand = &self.hands()[number];
        let Some((flange, tcp, twist)) = hand.now else {
            return;
        };
        let at = origin(&tcp);
        let velocity = twist.at(&(at - origin(&flange)));
        let found = self.touched(hand, &tcp);
        let touches = found.as_ref().map(|found| found.what);
        if touches != hand.touches {
            let kind = match touches {
                Some(what) => EventKind::Touched {
                    hand: hand.name.clone(),
                    on: self.name_of(what),
                },
                None => EventKind::Left {
                    hand: hand.name.clone(),
                },
            };
            self.note(time, kind);
        }
        let mut tip = Anchor(None);
        let mut force = Vector3::zeros();
        if let Some(found) = &found {
            let mut touch = found.touch;
            let Anchor(anchor) = self.hands()[number].tip;
            let stuck = anchor.filter(|(on, _)| *on == found.what);
            let stuck = stuck.map_or(found.at, |it| it.1);
            let slide = found.frame.rotation * (found.at - stuck);
            touch.slide = slide - touch.normal * touch.normal.dot(&slide);
            let (push, excess) = touch.push_hand(&(velocity - found.owner.velocity(&at)));
            force = push;
            let kept = stuck + found.frame.rotation.inverse() * excess;
            tip = Anchor(Some((found.what, kept)));
            let back = Wrench {
                force: -push,
                torque: Vector3::zeros(),
            };
            self.press_back(&found.owner, &at, &back);
        }
        let hand = &mut self.hands_mut()[number];
        (hand.touches, hand.tip) = (touches, tip);
        hand.wrench.add_at(&force, &(at - origin(&flange)));
    }

    fn touched(&self, hand: &HandState, tcp: &Pose) -> Option<Found> {
        let at = origin(tcp);
        if matches!(hand.kind, Tool::Bit(bit) if bit.screw.is_some()) || self.is_over_screw(&at) {
            return None;
        }
        let held = match &hand.kind {
            Tool::Fingers(fingers) => fingers.held.map(|held| held.body),
            Tool::Tip | Tool::Bit(_) => None,
        };
        let surface = self.on_surface(&at);
        // Around a held body, what it meets is its own affair.
        if held.is_some() {
            return surface;
        }
        surface.or_else(|| {
            let bodies = self.bodies().iter().enumerate();
            let mut others = bodies.filter(|(_, it)| !it.is_missing);
            others.find_map(|(index, _)| self.on_body(hand, tcp, index))
        })
    }

    /// Bits meet screws before they meet the magazine.
    fn is_over_screw(&self, at: &Vector3<f64>) -> bool {
        let mut screws = self.screws().iter();
        screws.any(|screw| {
            let off = local(&screw.config.pose, at);
            screw.place == Place::Magazine && off.xy().norm() < 0.005
        })
    }

    fn on_surface(&self, at: &Vector3<f64>) -> Option<Found> {
        self.surfaces_all()
            .iter()
            .enumerate()
            .find_map(|(what, surface)| {
                let owner = self.frame(surface.carrier);
                let frame = owner.pose * surface.config.pose;
                let below = local(&frame, at);
                let touch = Touch {
                    normal: frame.rotation * Vector3::z(),
                    depth: surface.depth(&below)?,
                    stiffness: surface.config.stiffness,
                    friction: surface.config.friction,
                    slide: Vector3::zeros(),
                };
                Some(Found {
                    what,
                    owner,
                    touch,
                    frame,
                    at: below,
                })
            })
    }

    fn on_body(&self, hand: &HandState, tcp: &Pose, index: usize) -> Option<Found> {
        let body = self.bodies().get(index)?;
        let at = local(&body.pose, &origin(tcp));
        let palm = self.palm(hand, tcp, index);
        let (normal, depth) = match palm {
            Some(palm) => palm?,
            None => {
                let found = body.config.wall_m.map_or_else(
                    || inside(&at, &body.half),
                    |wall| in_wall(&at, &body.half, wall),
                );
                found.map(|(normal, depth)| (body.pose.rotation * normal, depth))?
            }
        };
        Some(Found {
            what: self.surfaces_all().len() + index,
            owner: self.frame(Carrier::Body(index)),
            touch: Touch {
                normal,
                depth,
                stiffness: TIP_STIFFNESS,
                friction: TIP_FRICTION,
                slide: Vector3::zeros(),
            },
            frame: body.pose,
            at,
        })
    }

    /// A gripper whose open fingers are around a grip, or on their way there, touches with its palm alone; the outer `None` for all
    /// others.
    #[expect(clippy::option_option, reason = "no grip and no contact differ")]
    fn palm(
        &self,
        hand: &HandState,
        tcp: &Pose,
        index: usize,
    ) -> Option<Option<(Vector3<f64>, f64)>> {
        let Tool::Fingers(fingers) = &hand.kind else {
            return None;
        };
        let body = self.bodies().get(index)?;
        let grips = body.config.grips.iter();
        let mut open = grips.filter(|(_, width)| fingers.width > *width);
        let grip = open.find_map(|(at, _)| {
            let grip = body.pose * at;
            is_over(&fingers.config, tcp, &grip).then_some(grip)
        })?;
        let way = tcp.rotation * Vector3::z();
        let depth = (origin(tcp) - origin(&grip)).dot(&way) - PALM;
        Some((depth > 0.0).then_some((-way, depth)))
    }

    /// Bits of screwdrivers.
    pub(super) fn bits(&mut self, at: Duration) {
        for number in 0..self.hands().len() {
            self.bit(number, at);
        }
    }

    fn bit(&mut self, number: usize, time: Duration) {
        let hand = &self.hands()[number];
        let (&Tool::Bit(mut bit), Some((flange, tcp, twist))) = (&hand.kind, hand.now) else {
            return;
        };
        if bit.screw.is_none() {
            bit.screw = self.take_screw(number, &tcp, time);
        }
        let lever = origin(&tcp) - origin(&flange);
        let way = tcp.rotation * Vector3::z();
        let mut wrench = Wrench::default();
        bit.axial = 0.0;
        if let Some(index) = bit.screw {
            let screw = &self.screws()[index];
            let length = screw.config.length_m;
            let meets = match screw.place {
                Place::Thread(thread) => {
                    let depth = screw.depth(&self.threads()[thread].config);
                    let meets = self.on_head(thread, &tcp, length - depth);
                    if meets.is_none() {
                        (bit.screw, bit.torque) = (None, 0.0);
                    }
                    meets
                }
                Place::Bit(_) => self.on_mouth(&(origin(&tcp) + way * length)),
                Place::Magazine | Place::Missing => {
                    bit.screw = None;
                    None
                }
            };
            if let Some((thread, beyond, aside)) = meets {
                let carrier = self.threads()[thread].carrier;
                let (owner, out) = (self.frame(carrier), self.threads()[thread].pose.rotation);
                let out = out * Vector3::z();
                let speed = twist.at(&lever) - owner.velocity(&origin(&tcp));
                let push = BIT_STIFFNESS * beyond - BIT_DAMPING * speed.dot(&out);
                bit.axial = if beyond > 0.0 { push.max(0.0) } else { 0.0 };
                let force = out * bit.axial - aside * RECESS_STIFFNESS;
                wrench.add_at(&force, &lever);
                wrench.torque -= way * bit.torque;
                let back = Wrench {
                    force: -force,
                    torque: way * bit.torque,
                };
                self.press_back(&owner, &origin(&tcp), &back);
            }
        }
        let hand = &mut self.hands_mut()[number];
        hand.wrench.force += wrench.force;
        hand.wrench.torque += wrench.torque;
        hand.kind = Tool::Bit(bit);
    }

    fn take_screw(&mut self, hand: usize, tcp: &Pose, time: Duration) -> Option<usize> {
        let mut screws = self.screws().iter();
        if let Some(index) = screws.position(|screw| screw.is_taken_by(tcp)) {
            let kind = EventKind::ScrewTaken {
                hand: self.hands()[hand].name.clone(),
                screw: self.screws()[index].config.name.clone(),
            };
            self.screws_mut()[index].place = Place::Bit(hand);
            self.note(time, kind);
            return Some(index);
        }
        // A screw that stands in its thread, met by a bit again.
        self.screws().iter().position(|screw| {
            let Place::Thread(thread) = screw.place else {
                return false;
            };
            let above = screw.config.length_m - screw.depth(&self.threads()[thread].config);
            let meets = self.on_head(thread, tcp, above);
            meets.is_some_and(|(_, beyond, _)| beyond >= 0.0)
        })
    }

    /// How far a bit is beyond the head of a screw in a thread, and how far aside; `None` once it has left.
    fn on_head(&self, thread: usize, tcp: &Pose, above: f64) -> Option<(usize, f64, Vector3<f64>)> {
        let pose = &self.threads()[thread].pose;
        let off = local(pose, &origin(tcp));
        let beyond = above - off.z;
        let is_aside = off.xy().norm() > 0.004;
        let aside = pose.rotation * Vector3::new(off.x, off.y, 0.0);
        (!has_left(beyond) && !is_aside && beyond < DEPTH_MAX).then_some((thread, beyond, aside))
    }

    /// How far the tip of a screw is below the face around a free thread.
    fn on_mouth(&self, tip: &Vector3<f64>) -> Option<(usize, f64, Vector3<f64>)> {
        self.threads()
            .iter()
            .enumerate()
            .find_map(|(index, thread)| {
                let off = local(&thread.pose, tip);
                let is_on = !thread.is_taken && off.xy().norm() < FACE;
                (is_on && (-DEPTH_MAX..0.0).contains(&off.z)).then_some((
                    index,
                    -off.z,
                    Vector3::zeros(),
                ))
            })
    }

    fn name_of(&self, what: usize) -> String {
        let surfaces = self.surfaces_all();
        surfaces.get(what).map_or_else(
            || {
                let body = what - surfaces.len();
                let body = self.bodies().get(body);
                body.map_or_else(String::new, |body| body.config.name.clone())
            },
            |surface| surface.config.name.clone(),
        )
    }
}

/// The same for a box that is open at its top: the nearest face, inner or outer, around a point in a wall or the bottom.
fn in_wall(at: &Vector3<f64>, half: &Vector3<f64>, wall: f64) -> Option<(Vector3<f64>, f64)> {
    let outer = inside(at, half);
    // How far it is from the inner faces, into what is around them.
    let across = |axis: usize| {
        (
            at[axis].abs() - (half[axis] - wall),
            axis,
            -at[axis].signum(),
        )
    };
    let below = (wall - half.z - at.z, 2, 1.0);
    let beyond = [across(0), across(1), below];
    // Deepest in the part in which it is; nowhere inside of any, it is in the open.
    let (depth, axis, sign) = beyond.into_iter().max_by(|a, b| a.0.total_cmp(&b.0))?;
    if depth <= 0.0 {
        return None;
    }
    if outer.is_some_and(|(_, outer)| outer <= depth) {
        return outer;
    }
    let is_within = (0..3).all(|axis| at[axis].abs() < half[axis]);
    let mut normal = Vector3::zeros();
    normal[axis] = sign;
    (is_within && depth < DEPTH_MAX).then_some((normal, depth))
}

/// Nearest face of a box around a point inside of it: its normal and how deep the point is.
fn inside(at: &Vector3<f64>, half: &Vector3<f64>) -> Option<(Vector3<f64>, f64)> {
    let depths = half - at.abs();
    let (axis, depth) = (0..3)
        .map(|axis| (axis, depths[axis]))
        .min_by(|a, b| a.1.total_cmp(&b.1))?;
    let mut normal = Vector3::zeros();
    normal[axis] = if at[axis] < 0.0 { -1.0 } else { 1.0 };
    (0.0..DEPTH_MAX).contains(&depth).then_some((normal, depth))
}
