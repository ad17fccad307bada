//! Handles to a world that several threads share: each posts what it drives and receives what the world answers. A lock
//! guards the world; it is held for the steps up to the newest post, about 10 us each.

use crate::geometry::{Pose, Twist, Wrench};
use crate::scene::{Knobs, Scene};
use crate::truth::Truth;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// A world, shared by its clones and handles.
///
/// Times are of any one clock that all posts share, such as `CLOCK_MONOTONIC` or virtual time. The world begins with the
/// first post and advances to the newest one in steps of 0.25 ms, whichever handle posts it: hands are interpolated
/// between their posts and extrapolated for at most 20 ms beyond the last. From one thread, the same posts give the same
/// world bit for bit.
#[derive(Debug, Clone)]
pub struct World(Arc<Mutex<Scene>>);

impl World {
    pub(crate) fn new(scene: Scene) -> Self {
        Self(Arc::new(Mutex::new(scene)))
    }

    fn scene(&self) -> MutexGuard<'_, Scene> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A hand by its name.
    #[must_use]
    pub fn hand(&self, name: &str) -> Option<Hand> {
        let index = self.scene().hand_index(name)?;
        Some(Hand {
            world: self.clone(),
            index,
        })
    }

    /// The fingers of a hand; `None` if it has none.
    #[must_use]
    pub fn fingers(&self, hand: &str) -> Option<Fingers> {
        let scene = self.scene();
        let index = scene.hand_index(hand)?;
        scene.has_fingers(index).then(|| Fingers {
            world: self.clone(),
            index,
        })
    }

    /// The screwdriver of a hand; `None` if it has none.
    #[must_use]
    pub fn screwdriver(&self, hand: &str) -> Option<Screwdriver> {
        let scene = self.scene();
        let index = scene.hand_index(hand)?;
        scene.has_bit(index).then(|| Screwdriver {
            world: self.clone(),
            index,
        })
    }

    /// A mobile base by its name.
    #[must_use]
    pub fn base(&self, name: &str) -> Option<Base> {
        let index = self.scene().base_index(name)?;
        Some(Base {
            world: self.clone(),
            index,
        })
    }

    /// Advances to a time without a post.
    pub fn advance(&self, to: Duration) {
        self.scene().advance(to);
    }

    /// What is so now.
    #[must_use]
    pub fn truth(&self) -> Truth {
        self.scene().truth()
    }

    /// Changes the knobs: faults and offsets. The world is locked while `change` runs: it must not use the world.
    pub fn turn_knobs(&self, change: impl FnOnce(&mut Knobs)) {
        change(&mut self.scene().knobs);
    }

    /// Takes a body out of the world, as if it had never been supplied; false if there is none of that name.
    pub fn remove_body(&self, name: &str) -> bool {
        self.scene().remove_body(name)
    }

    /// Scales the friction of the fingers of a hand, 1 for none: oil on its pads; false if there are none.
    pub fn oil(&self, hand: &str, friction: f64) -> bool {
        self.scene().oil(hand, friction)
    }

    /// Whether the base of a dock is within its tolerance; `None` if there is no dock of that name.
    #[must_use]
    pub fn docked(&self, dock: &str) -> Option<bool> {
        self.scene().docked(dock)
    }

    /// Takes a screw out of its magazine; false if there is none of that name.
    pub fn remove_screw(&self, name: &str) -> bool {
        self.scene().remove_screw(name)
    }
}

/// A hand: the flange of an arm with its tool.
#[derive(Debug, Clone)]
pub struct Hand {
    world: World,
    index: usize,
}

impl Hand {
    /// Posts pose and twist of the flange in the world frame at a time; the wrench of the world on the flange, in the axes
    /// of the world, about the origin of the flange. Weight of what the hand carries is part of it. A post that is not
    /// finite or older than the last is refused and counted; the answer is then the last wrench.
    #[must_use]
    pub fn post(&self, at: Duration, flange: &Pose, twist: &Twist) -> Wrench {
        self.world.scene().post_hand(self.index, at, flange, twist)
    }

    /// Frame of its tool centre point in that of its flange.
    #[must_use]
    pub fn tool(&self) -> Pose {
        self.world.scene().tool(self.index)
    }
}

/// What the world answers to fingers.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Stopped {
    /// Width of the body between the fingers, at which they are stopped, m; `None` if there is none.
    pub width_m: Option<f64>,
    /// Whether they hold it.
    pub holds: bool,
    /// How far bodies have slid between them so far, m.
    pub slip_m: f64,
}

/// Fingers of a hand.
#[derive(Debug, Clone)]
pub struct Fingers {
    world: World,
    index: usize,
}

impl Fingers {
    /// Posts the distance of the fingers, m, and the force with which they close, N, at a time. They grasp the body between
    /// them when they are not wider than it and close with a force, and release it when they are wider or the force is 0.
    #[must_use]
    pub fn post(&self, at: Duration, width_m: f64, force_n: f64) -> Stopped {
        let mut scene = self.world.scene();
        scene.post_fingers(self.index, at, width_m, force_n)
    }
}

/// Screwdriver of a hand.
#[derive(Debug, Clone)]
pub struct Screwdriver {
    world: World,
    index: usize,
}

impl Screwdriver {
    /// Posts the angle of the bit at a time, rad, positive into the thread; the torque that the screw takes, Nm.
    #[must_use]
    pub fn post(&self, at: Duration, angle_rad: f64) -> f64 {
        self.world.scene().post_bit(self.index, at, angle_rad)
    }
}

/// A mobile base, whose surfaces carry bodies.
#[derive(Debug, Clone)]
pub struct Base {
    world: World,
    index: usize,
}

impl Base {
    /// Posts where the base believes to be, in the world frame at a time: x and y, m, and heading, rad. In truth it is off
    /// by the docking offset.
    pub fn post(&self, at: Duration, x_m: f64, y_m: f64, heading_rad: f64) {
        let mut scene = self.world.scene();
        scene.post_base(self.index, at, [x_m, y_m, heading_rad]);
    }
}
