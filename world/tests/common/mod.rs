//! Hands that are moved by tests in virtual time.

use nalgebra::{UnitQuaternion, Vector3};
use std::f64::consts::PI;
use std::time::Duration;
use takt_world::{Fingers, Hand, Pose, Stopped, Twist, World, Wrench};

/// Between two posts.
pub(crate) const CYCLE: Duration = Duration::from_millis(1);

/// z down, as a tool from above.
pub(crate) fn down(x: f64, y: f64, z: f64) -> Pose {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI);
    Pose::from_parts(Vector3::new(x, y, z).into(), turn)
}

pub(crate) fn at(x: f64, y: f64, z: f64) -> Pose {
    Pose::translation(x, y, z)
}

/// Several hands in one virtual time.
pub(crate) struct Bench {
    pub(crate) world: World,
    pub(crate) now: Duration,
    hands: Vec<(Hand, Pose)>,
    fingers: Vec<(Fingers, f64, f64)>,
    pub(crate) wrenches: Vec<Wrench>,
    pub(crate) stops: Vec<Stopped>,
}

impl Bench {
    /// Hands by name, with their tool centre points there.
    pub(crate) fn new(world: World, hands: &[(&str, Pose)]) -> Self {
        let found = hands.iter().map(|(name, tcp)| {
            let hand = world.hand(name).unwrap();
            let flange = tcp * hand.tool().inverse();
            (hand, flange)
        });
        let hands_with_fingers = hands.iter().filter_map(|(name, _)| world.fingers(name));
        let fingers = hands_with_fingers.map(|it| (it, 0.1, 0.0)).collect();
        let mut bench = Self {
            hands: found.collect(),
            fingers,
            wrenches: Vec::new(),
            stops: Vec::new(),
            now: Duration::from_secs(1),
            world,
        };
        bench.rest(1);
        bench
    }

    /// Fingers of a hand from now on.
    pub(crate) fn fingers(&mut self, hand: usize, width: f64, force: f64) {
        self.fingers[hand] = (self.fingers[hand].0.clone(), width, force);
        self.rest(1);
    }

    /// Moves all tool centre points by this in so many cycles, smoothly from rest to rest.
    pub(crate) fn shift(&mut self, by: &[[f64; 3]], cycles: u32) {
        let place = |cycle: u32| (1.0 - (PI * f64::from(cycle) / f64::from(cycles)).cos()) / 2.0;
        let seconds = CYCLE.as_secs_f64();
        let mut twists = Vec::new();
        for cycle in 1..=cycles {
            let step = place(cycle) - place(cycle - 1);
            let part = PI * f64::from(cycle) / f64::from(cycles);
            let speed = part.sin() * PI / 2.0 / (f64::from(cycles) * seconds);
            twists.clear();
            for ((_, flange), by) in self.hands.iter_mut().zip(by) {
                let by = Vector3::from(*by);
                flange.translation.vector += by * step;
                twists.push(Twist {
                    linear: by * speed,
                    angular: Vector3::zeros(),
                });
            }
            self.cycle(&twists);
        }
        self.cycle(&[]);
    }

    #[allow(dead_code, reason = "one of two test programs tilts")]
    /// Turns the tool of a hand about its tool centre point.
    pub(crate) fn tilt(&mut self, hand: usize, angle: Vector3<f64>, cycles: u32) {
        let tool = self.hands[hand].0.tool();
        let part = UnitQuaternion::from_scaled_axis(angle / f64::from(cycles));
        for _ in 0..cycles {
            let mut tcp = self.hands[hand].1 * tool;
            tcp.rotation = part * tcp.rotation;
            self.hands[hand].1 = tcp * tool.inverse();
            self.cycle(&[]);
        }
    }

    pub(crate) fn rest(&mut self, cycles: u32) {
        for _ in 0..cycles {
            self.cycle(&[]);
        }
    }

    fn cycle(&mut self, twists: &[Twist]) {
        self.now += CYCLE;
        self.wrenches.clear();
        for (index, (hand, flange)) in self.hands.iter().enumerate() {
            let twist = twists.get(index).copied().unwrap_or_default();
            self.wrenches.push(hand.post(self.now, flange, &twist));
        }
        self.stops = self
            .fingers
            .iter()
            .map(|(fingers, width, force)| fingers.post(self.now, *width, *force))
            .collect();
    }
}
