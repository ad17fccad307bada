//! The world behind its lock: what there is, what was posted, and the step. Which forces act stands in the files of the
//! contacts.

mod gather;
mod report;

use crate::body::{Body, Carrier};
use crate::dock::Dock;
use crate::event::{EventKind, Log};
use crate::geometry::{Pose, Twist, Wrench, finite_pose, moved, origin};
use crate::grasp::{FingersState, GraspConfig, Held, anchor, is_within};
use crate::handle::Stopped;
use crate::hole::Hole;
use crate::motion::Motion;
use crate::screw::{Bit, Place, Screw, Thread, engage};
use crate::solver::{Element, Mass, Solver};
use crate::surface::{Anchor, Surface};
use nalgebra::{UnitQuaternion, Vector3};
use std::time::Duration;

/// Step, ns: short against the fastest arm on the stiffest contact.
const STEP_NS: u64 = 250_000;
/// Step, s.
pub(crate) const STEP_S: f64 = 0.000_25;
/// Longest time simulated in one call; a host that stalls longer loses the rest.
const CATCH_UP_MAX: Duration = Duration::from_secs(2);
/// A base that changes its velocity at once by more throws off what it carries, m/s.
const JOLT: f64 = 1.0;
/// Fingers this much wider than a body do not hold it, m.
const OPEN: f64 = 0.000_3;
/// The bit turns at most this far between two posts, rad.
const TURN_MAX: f64 = 30.0;

/// Faults and offsets, for [`World::turn_knobs`](crate::World::turn_knobs).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Knobs {
    /// Scales the friction of all fingers, 1 for none: oil on the pads.
    pub grip_friction: f64,
    /// Depth at which burrs stop pegs, m.
    pub obstructed_m: Option<f64>,
    /// Screws bite askew, however well they are placed.
    pub cross_threads: bool,
    /// Where bases are in truth, seen from where they believe to be: x and y, m, and heading, rad; those with docks only there.
    /// Applies with the next post of each base.
    pub docking_offset: [f64; 3],
}

impl Default for Knobs {
    fn default() -> Self {
        Self {
            grip_friction: 1.0,
            obstructed_m: None,
            cross_threads: false,
            docking_offset: [0.0; 3],
        }
    }
}

/// Tool of a hand.
#[derive(Debug, Clone)]
pub(crate) enum Tool {
    Tip,
    Fingers(Box<FingersState>),
    Bit(Bit),
}

impl Tool {
    pub(crate) fn fingers(config: GraspConfig) -> Self {
        Self::Fingers(Box::new(FingersState {
            config,
            width: f64::INFINITY,
            force: 0.0,
            held: None,
            friction: 1.0,
            slip_m: 0.0,
        }))
    }

    pub(crate) fn bit() -> Self {
        Self::Bit(Bit::default())
    }
}

#[derive(Debug, Clone)]
pub(crate) struct HandState {
    pub(crate) name: String,
    pub(crate) tool: Pose,
    pub(crate) kind: Tool,
    motion: Motion,
    /// Flange and tool centre point as of this step, with the twist of the flange.
    pub(crate) now: Option<(Pose, Pose, Twist)>,
    pub(crate) wrench: Wrench,
    /// Largest force so far, N.
    pub(crate) force_max: f64,
    pub(crate) tip: Anchor,
    /// Touches this one: surfaces count from 0, bodies follow.
    pub(crate) touches: Option<usize>,
}

impl HandState {
    pub(crate) const fn new(name: String, tool: Pose, kind: Tool) -> Self {
        Self {
            name,
            tool,
            kind,
            motion: Motion::new(),
            now: None,
            wrench: Wrench {
                force: Vector3::new(0.0, 0.0, 0.0),
                torque: Vector3::new(0.0, 0.0, 0.0),
            },
            force_max: 0.0,
            tip: Anchor(None),
            touches: None,
        }
    }
}

#[derive(Debug, Clone)]
pub(crate) struct BaseState {
    pub(crate) name: String,
    pub(crate) pose: Pose,
    twist: Twist,
    motion: Motion,
}

impl BaseState {
    pub(crate) fn new(name: String, pose: Pose) -> Self {
        Self {
            name,
            pose,
            twist: Twist::default(),
            motion: Motion::of_base(),
        }
    }
}

/// A peg against a hole.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct PegState {
    pub(crate) body: usize,
    pub(crate) hole: usize,
    pub(crate) depth: f64,
    pub(crate) offset: f64,
    pub(crate) force: f64,
    /// Largest so far, N.
    pub(crate) force_max: f64,
    pub(crate) touches: bool,
    pub(crate) is_seated: bool,
}

/// What an element stands for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Source {
    Other,
    /// The grasp of a hand, at a point of the body.
    Grasp(usize, Vector3<f64>),
    /// A peg, with the way out of its hole.
    Peg(usize, Vector3<f64>),
}

/// A frame that carries something.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Frame {
    pub(crate) pose: Pose,
    pub(crate) twist: Twist,
    pub(crate) slot: Option<usize>,
}

#[derive(Debug)]
pub(crate) struct Scene {
    pub(crate) knobs: Knobs,
    origin: Option<Duration>,
    steps: u64,
    bases: Vec<BaseState>,
    docks: Vec<Dock>,
    surfaces: Vec<Surface>,
    bodies: Vec<Body>,
    holes: Vec<Hole>,
    pegs: Vec<PegState>,
    screws: Vec<Screw>,
    threads: Vec<Thread>,
    hands: Vec<HandState>,
    solver: Solver,
    masses: Vec<Mass>,
    elements: Vec<(Element, Source)>,
    plain: Vec<Element>,
    log: Log,
}

impl Scene {
    pub(crate) fn new(
        (bases, docks): (Vec<BaseState>, Vec<Dock>),
        surfaces: Vec<Surface>,
        bodies: Vec<Body>,
        holes: Vec<Hole>,
        (screws, threads): (Vec<Screw>, Vec<Thread>),
        hands: Vec<HandState>,
    ) -> Self {
        let pegged = bodies.iter().enumerate();
        let pegged = pegged.filter(|(_, body)| body.config.peg.is_some());
        let pair = |body| {
            (0..holes.len()).map(move |hole| PegState {
                body,
                hole,
                depth: f64::NEG_INFINITY,
                ..PegState::default()
            })
        };
        let pegs = pegged.flat_map(|(body, _)| pair(body)).collect();
        let mut scene = Self {
            knobs: Knobs::default(),
            origin: None,
            steps: 0,
            bases,
            docks,
            surfaces,
            bodies,
            holes,
            pegs,
            screws,
            threads,
            hands,
            solver: Solver::default(),
            masses: Vec::new(),
            elements: Vec::new(),
            plain: Vec::new(),
            log: Log::default(),
        };
        scene.ride();
        scene
    }

    pub(crate) fn hand_index(&self, name: &str) -> Option<usize> {
        self.hands.iter().position(|hand| hand.name == name)
    }

    pub(crate) fn base_index(&self, name: &str) -> Option<usize> {
        self.bases.iter().position(|base| base.name == name)
    }

    pub(crate) fn has_fingers(&self, hand: usize) -> bool {
        let hand = self.hands.get(hand);
        hand.is_some_and(|hand| matches!(hand.kind, Tool::Fingers(_)))
    }

    pub(crate) fn has_bit(&self, hand: usize) -> bool {
        let hand = self.hands.get(hand);
        hand.is_some_and(|hand| matches!(hand.kind, Tool::Bit(_)))
    }

    pub(crate) fn tool(&self, hand: usize) -> Pose {
        self.hands
            .get(hand)
            .map_or_else(Pose::identity, |hand| hand.tool)
    }

    pub(crate) fn remove_body(&mut self, name: &str) -> bool {
        let body = self.bodies.iter().position(|it| it.config.name == name);
        let Some(body) = body else {
            return false;
        };
        self.bodies[body].is_missing = true;
        for hand in &mut self.hands {
            if let Tool::Fingers(fingers) = &mut hand.kind {
                fingers.held = fingers.held.filter(|held| held.body != body);
            }
        }
        true
    }

    /// Scales the friction of the fingers of a hand.
    pub(crate) fn oil(&mut self, hand: &str, friction: f64) -> bool {
        let found = self.hands.iter_mut().find(|it| it.name == hand);
        let Some(Tool::Fingers(fingers)) = found.map(|it| &mut it.kind) else {
            return false;
        };
        fingers.friction = friction.max(0.0);
        true
    }

    /// Whether the base of a dock is within its tolerance.
    pub(crate) fn docked(&self, name: &str) -> Option<bool> {
        let dock = self.docks.iter().find(|dock| dock.config.name == name)?;
        let base = self.bases.get(dock.base)?;
        Some(dock.is_closed(&base.pose))
    }

    pub(crate) fn remove_screw(&mut self, name: &str) -> bool {
        let screw = self.screws.iter_mut().find(|it| it.config.name == name);
        let Some(screw) = screw else {
            return false;
        };
        screw.place = Place::Missing;
        true
    }

    /// Time of the present step.
    fn now(&self) -> Option<Duration> {
        let since = Duration::from_nanos(self.steps.saturating_mul(STEP_NS));
        self.origin.map(|origin| origin.saturating_add(since))
    }

    pub(crate) fn advance(&mut self, to: Duration) {
        let Some(now) = self.now() else {
            self.origin = Some(to);
            return self.step_driven(to);
        };
        let span = to.saturating_sub(now);
        if let (Some(origin), true) = (&mut self.origin, span > CATCH_UP_MAX) {
            *origin = origin.saturating_add(span - CATCH_UP_MAX);
        }
        let count = span.min(CATCH_UP_MAX).as_nanos() / u128::from(STEP_NS);
        for _ in 0..count {
            self.steps += 1;
            if let Some(at) = self.now() {
                self.step(at);
            }
        }
    }

    pub(crate) fn post_hand(
        &mut self,
        hand: usize,
        at: Duration,
        flange: &Pose,
        twist: &Twist,
    ) -> Wrench {
        let Some(state) = self.hands.get_mut(hand) else {
            return Wrench::default();
        };
        let is_first = state.now.is_none();
        if state.motion.post(at, flange, Some(*twist)) {
            self.advance(at);
            if is_first && let Some(now) = self.now() {
                self.step_driven(now);
            }
        }
        self.hands[hand].wrench
    }

    pub(crate) fn post_base(&mut self, base: usize, at: Duration, [x, y, heading]: [f64; 3]) {
        let flat = |[x, y, heading]: [f64; 3], z: f64| {
            let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading);
            Pose::from_parts(Vector3::new(x, y, z).into(), turn)
        };
        let offset = self.knobs.docking_offset;
        let Some(state) = self.bases.get_mut(base) else {
            return;
        };
        let mut pose = flat([x, y, heading], state.pose.translation.z);
        // At a dock, it grows with the guides: a base does not jump, and with it what stands there.
        let (mut nearness, mut has_dock) = (0.0_f64, false);
        for dock in self.docks.iter().filter(|dock| dock.base == base) {
            nearness = nearness.max(dock.nearness(&pose));
            has_dock = true;
            pose = dock.guided(&pose);
        }
        let share = if has_dock { nearness } else { 1.0 };
        let pose = pose * flat(offset.map(|part| part * share), 0.0);
        if state.motion.post(at, &pose, None) {
            self.advance(at);
        }
    }

    pub(crate) fn post_fingers(
        &mut self,
        hand: usize,
        at: Duration,
        width: f64,
        force: f64,
    ) -> Stopped {
        self.advance(at);
        let now = self.now().unwrap_or(at);
        let Some(HandState {
            name,
            kind: Tool::Fingers(fingers),
            now: place,
            ..
        }) = self.hands.get_mut(hand)
        else {
            return Stopped::default();
        };
        let slip_m = fingers.slip_m;
        if width.is_nan() || force.is_nan() {
            return Stopped {
                slip_m,
                ..Stopped::default()
            };
        }
        (fingers.width, fingers.force) = (width, force.max(0.0));
        if let Some(held) = fingers.held {
            let body = &self.bodies[held.body];
            let its = body.config.grips.get(held.grip).map_or(0.0, |grip| grip.1);
            if force > 0.0 && width <= its + OPEN {
                return Stopped {
                    width_m: Some(its),
                    holds: true,
                    slip_m,
                };
            }
            fingers.held = None;
            let kind = EventKind::Released {
                hand: name.clone(),
                body: body.config.name.clone(),
            };
            self.log.push(now, kind);
        }
        let Some((_, tcp, _)) = place else {
            return Stopped::default();
        };
        let found = between(&self.bodies, &fingers.config, tcp);
        let Some((body, grip, its)) = found.filter(|(_, _, its)| width >= its - 0.001) else {
            return Stopped {
                slip_m,
                ..Stopped::default()
            };
        };
        let grasps = force > 0.0 && width <= its + OPEN / 2.0;
        if grasps {
            let taken = &mut self.bodies[body];
            let grip_pose = taken.pose * taken.config.grips[grip].0;
            fingers.held = Some(Held {
                body,
                grip,
                anchor: anchor(tcp, &taken.pose, &grip_pose, taken.config.is_notched),
                slips: false,
            });
            taken.wake();
            let kind = EventKind::Grasped {
                hand: name.clone(),
                body: taken.config.name.clone(),
            };
            self.log.push(now, kind);
        }
        Stopped {
            width_m: Some(its),
            holds: grasps,
            slip_m,
        }
    }

    pub(crate) fn post_bit(&mut self, hand: usize, at: Duration, angle: f64) -> f64 {
        self.advance(at);
        let now = self.now().unwrap_or(at);
        let cross = self.knobs.cross_threads;
        let Some(HandState {
            kind: Tool::Bit(bit),
            now: Some((_, tcp, _)),
            ..
        }) = self.hands.get_mut(hand)
        else {
            return 0.0;
        };
        let turned = angle - bit.angle.unwrap_or(angle);
        if !angle.is_finite() || turned.abs() > TURN_MAX {
            return bit.torque;
        }
        bit.angle = Some(angle);
        let Some(screw) = bit.screw.and_then(|screw| self.screws.get_mut(screw)) else {
            bit.torque = 0.0;
            return 0.0;
        };
        if matches!(screw.place, Place::Bit(_)) && turned > 0.0 {
            engage(screw, &mut self.threads, (tcp, bit.axial), cross, |kind| {
                self.log.push(now, kind);
            });
        }
        bit.torque = 0.0;
        if let Place::Thread(thread) = screw.place
            && let Some(thread) = self.threads.get_mut(thread)
        {
            let report = |kind| self.log.push(now, kind);
            bit.torque = screw.turn(&thread.config, turned, bit.axial, report);
            if screw.turned <= 0.0 && turned < 0.0 {
                // Out of the thread again: it hangs at the bit.
                (screw.place, thread.is_taken) = (Place::Bit(hand), false);
            }
        }
        bit.torque
    }

    /// One step of [`STEP_S`].
    fn step(&mut self, at: Duration) {
        self.step_driven(at);
        self.number();
        self.elements.clear();
        self.weigh();
        self.surfaces();
        self.grasps(at);
        self.pegs(at);
        self.bits(at);
        self.tips(at);
        self.plain.clear();
        let elements = self.elements.iter().map(|(element, _)| *element);
        self.plain.extend(elements);
        self.solver.step(&mut self.masses, &self.plain, STEP_S);
        for body in &mut self.bodies {
            if let Some(mass) = body.slot.and_then(|slot| self.masses.get(slot)) {
                body.twist = mass.twist;
                body.pose = moved(&body.pose, &mass.twist, STEP_S);
            }
        }
        self.ride();
        self.react();
        self.observe(at);
    }

    /// Hands and bases as of a time, and what rides on the bases.
    fn step_driven(&mut self, at: Duration) {
        for (number, base) in self.bases.iter_mut().enumerate() {
            let Some((pose, twist)) = base.motion.at(at) else {
                continue;
            };
            let jolts = (twist.linear - base.twist.linear).norm() > JOLT;
            (base.pose, base.twist) = (pose, twist);
            let riding =
                |body: &&mut Body| body.rest.is_some_and(|it| it.0 == Carrier::Base(number));
            if jolts {
                self.bodies.iter_mut().filter(riding).for_each(Body::wake);
            }
        }
        self.ride();
        for hand in &mut self.hands {
            hand.wrench = Wrench::default();
            hand.now = hand
                .motion
                .at(at)
                .map(|(flange, twist)| (flange, flange * hand.tool, twist));
        }
    }

    /// Moves resting bodies and threads with what carries them.
    fn ride(&mut self) {
        for body in 0..self.bodies.len() {
            if let Some((carrier, at)) = self.bodies[body].rest {
                let frame = self.frame(carrier);
                let pose = frame.pose * at;
                let arm = origin(&pose) - origin(&frame.pose);
                let body = &mut self.bodies[body];
                body.pose = pose;
                body.twist = Twist {
                    linear: frame.twist.at(&arm),
                    angular: frame.twist.angular,
                };
            }
        }
        for thread in 0..self.threads.len() {
            let frame = self.frame(self.threads[thread].carrier);
            let thread = &mut self.threads[thread];
            thread.pose = frame.pose * thread.config.pose;
        }
    }

    pub(crate) fn frame(&self, carrier: Carrier) -> Frame {
        let base = |base: usize| self.bases.get(base).map(|it| (it.pose, it.twist, None));
        let body = |body: usize| {
            let body = self.bodies.get(body);
            body.map(|it| (it.pose, it.twist, it.slot))
        };
        let found = match carrier {
            Carrier::World => None,
            Carrier::Base(index) => base(index),
            Carrier::Body(index) => body(index),
        };
        let (pose, twist, slot) =
            found.unwrap_or_else(|| (Pose::identity(), Twist::default(), None));
        Frame { pose, twist, slot }
    }
}

/// The body between fingers: its number, that of its grip, its width there.
fn between(bodies: &[Body], config: &GraspConfig, tcp: &Pose) -> Option<(usize, usize, f64)> {
    let present = bodies.iter().enumerate().filter(|(_, it)| !it.is_missing);
    let mut grips = present.flat_map(|(number, body)| {
        let grips = body.config.grips.iter().enumerate();
        grips.map(move |(grip, (at, width))| (number, grip, *width, body.pose * at))
    });
    grips
        .find(|(.., grip)| finite_pose(grip) && is_within(config, tcp, grip))
        .map(|(body, grip, width, _)| (body, grip, width))
}
