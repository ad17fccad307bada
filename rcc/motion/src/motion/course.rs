//! A motion along a path, cycle by cycle: from its start to its end, slower on demand, to a stop on the path, and from
//! any state onto the path. Nets and plans run the same course. Its owner knows the path.

use super::bounds::{Bounds, State, stopping};
use super::lead::{Lead, SAMPLES};
use super::profile::Profile;

/// Override below which a motion holds.
pub(super) const HOLD_BELOW: f64 = 0.001;
/// Deviation, per unit of the limits, below which a motion counts as on its path.
const ON_PATH: f64 = 1e-9;
/// Parts of the velocity limit at which a motion that comes onto its path is tried.
const PARTS: [f64; 6] = [1.0, 0.7, 0.4, 0.2, 0.08, 0.02];
/// The same with a gentle deviation.
const GENTLE_PARTS: &[f64] = &[1.0, 0.85, 0.7, 0.5];

/// All of the limits of acceleration and jerk.
pub(super) const WHOLE: [f64; 2] = [1.0, 1.0];
/// Least part of a limit.
const LEAST: f64 = 0.1;
/// Acceleration beside the path, relative to that along it, up to which a motion accelerates mostly along it.
pub(super) const MOSTLY: f64 = 0.1;

/// Parts of the limit of jerk that the deviation gets where accelerations do not decide, and at most: so, motions take over from
/// others in the shortest time.
const JERK: [f64; 2] = [0.45, 0.85];

/// Margin of a gentle deviation for its jerk.
const GENTLE: f64 = 1.2;

/// The target of the profile.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Aim {
    /// The end of the path, at this part of the velocity limit.
    End(f64),
    /// Standstill, to continue later.
    Hold,
    /// Standstill for good.
    Stop,
}

/// The state on the path.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Progress {
    /// Part of the path; beyond 0 to 1 only beside the path.
    pub(super) part: f64,
    /// Its rate, 1/s.
    pub(super) rate: f64,
    /// The rate of that, 1/s².
    pub(super) acceleration: f64,
    /// Whether the motion is over.
    pub(super) is_done: bool,
}

/// Coordinates of a deviation that share limits: their norm is bounded.
#[derive(Clone, Copy, Debug)]
pub(super) struct Group {
    /// The first of them.
    pub(super) first: usize,
    /// Number of them.
    pub(super) axes: usize,
    pub(super) bounds: Bounds,
}

/// A path and the limits along it.
pub(super) trait Geometry {
    /// Length of the path (m or rad), and the bounds along it that keep these parts of the limits of acceleration and
    /// jerk.
    fn along(&self, parts: [f64; 2]) -> (f64, Bounds);

    /// Number of groups.
    fn groups(&self) -> usize;

    /// A group of deviations.
    fn group(&self, number: usize) -> Group;

    /// The largest velocity relative to its limit where the part changes by `rate` (1/s) and the deviations by `off`.
    fn speed(&self, part: f64, rate: f64, off: &[f64]) -> f64;
}

/// The state in which a motion begins.
pub(super) struct Departure<'d> {
    /// Along the path.
    pub(super) along: State,
    /// Deviation from the path, by coordinate.
    pub(super) off: &'d [State],
    /// Part of the path at which the deviation should be zero.
    pub(super) join: Option<f64>,
}

/// A motion along a path.
pub(super) struct Course {
    profile: Profile,
    length: f64,
    bounds: Bounds,
    /// Part of the speed at which it takes its time; a stop brakes within the whole limits of acceleration and jerk.
    speed: f64,
    /// Velocity limit, while the bounds of its path are those of a stop, since it begins beyond its limits.
    beyond: Option<f64>,
    lead: Option<Lead>,
    is_leading: bool,
    /// Part of the velocity limit while the motion comes onto its path.
    part: f64,
    aim: Aim,
    has_started: bool,
    is_stopped: bool,
}

impl Course {
    /// A course on a path of that length (in the unit of the bounds, at most the largest of the lengths from which the
    /// bounds are derived). The bounds are those at a part of the speed, `speed` (above 0 to 1). `None` if no motion keeps
    /// the bounds.
    pub(super) fn new((length, bounds): (f64, Bounds), speed: f64, period_s: f64) -> Option<Self> {
        let mut profile = Profile::new(0.0, bounds, period_s).forward_only();
        profile.set_bounds([bounds, bounds.braking(speed)]);
        profile.go_to(length, 1.0).then_some(Self {
            profile,
            length,
            bounds,
            speed,
            beyond: None,
            lead: None,
            is_leading: false,
            part: 1.0,
            aim: Aim::End(1.0),
            has_started: false,
            is_stopped: false,
        })
    }

    /// The same course, able to begin with deviations of that many coordinates.
    pub(super) fn with_lead(mut self, axes: usize, period_s: f64) -> Self {
        self.lead = Some(Lead::new(axes, period_s));
        self
    }

    pub(super) const fn lead(&self) -> Option<&Lead> {
        self.lead.as_ref()
    }

    /// Duration of the plan along the path, s.
    pub(super) fn duration(&self) -> f64 {
        self.profile.duration()
    }

    /// Whether it has left its initial state.
    pub(super) const fn has_started(&self) -> bool {
        self.has_started
    }

    /// Whether the motion is on its path.
    pub(super) const fn is_on_path(&self) -> bool {
        !self.is_leading
    }

    /// The part of the speed at which it takes its time.
    pub(super) const fn speed(&self) -> f64 {
        self.speed
    }

    /// Bounds of the path as those of the motion, and those of what brakes.
    fn pair(&self, bounds: Bounds) -> [Bounds; 2] {
        let Some(velocity) = self.beyond else {
            return [bounds, bounds.braking(self.speed)];
        };
        let velocity = bounds.velocity.min(velocity);
        let bounds = Bounds { velocity, ..bounds };
        [bounds.gentle(self.speed), bounds]
    }

    /// Begins as [`Self::begin`] does, from a state beyond the limits of the motion. The bounds of `path` are those of a stop;
    /// `gentle` are those along it within the limits, which apply once the motion has come into them.
    pub(super) fn begin_beyond(
        &mut self,
        path: &impl Geometry,
        from: &Departure<'_>,
        override_: f64,
        gentle: Bounds,
    ) {
        self.beyond = Some(gentle.velocity);
        self.begin(path, from, override_);
        self.beyond = None;
        self.bounds = gentle;
    }

    pub(super) fn restart(&mut self) {
        self.profile.reset(0.0);
        self.profile.set_bounds(self.pair(self.bounds));
        if let Some(lead) = &mut self.lead {
            lead.reset();
        }
        self.is_leading = false;
        self.part = 1.0;
        self.aim = Aim::Hold;
        self.has_started = false;
        self.is_stopped = false;
    }

    /// Begins in a state of motion, in the cycle after that state.
    pub(super) fn begin(&mut self, path: &impl Geometry, from: &Departure<'_>, override_: f64) {
        self.restart();
        (self.length, self.bounds) = path.along(WHOLE);
        self.profile.set_bounds(self.pair(self.bounds));
        self.has_started = true;
        self.is_leading = is_off(path, from.off);
        // A motion that begins without override brakes from the plan for the full one.
        let speed = if override_ >= HOLD_BELOW {
            override_.min(1.0)
        } else {
            1.0
        };
        if self.is_leading {
            self.plan_lead(path, from);
        }
        // A motion without a plan is planned for again from the next cycle on.
        let is_planned = self
            .profile
            .begin(from.along, self.length, speed * self.part);
        self.aim = if is_planned {
            Aim::End(speed)
        } else {
            Aim::Hold
        };
    }

    /// Plans the deviation, and finds the part of the velocity limit along the path that keeps the limits of both
    /// together: first with a deviation that decreases as gently as it can, then with the fastest one.
    fn plan_lead(&mut self, path: &impl Geometry, from: &Departure<'_>) {
        let share = share(path, from, self.length);
        let (_, along) = path.along(share.map(|part| 1.0 - part));
        let along = self.pair(along);
        self.profile.set_bounds(along);
        for (is_gentle, parts) in [(true, GENTLE_PARTS), (false, &PARTS)] {
            let Some(mut lead) = self.lead.take() else {
                return;
            };
            let is_planned = lead.begin(from.off, |axis| {
                let bounds = axis_bounds(path, from.off, axis, share);
                let [mut within, braking] = self.pair(bounds);
                if let Some(off) = from.off.get(axis).filter(|_| is_gentle) {
                    within = gentle(*off, within);
                }
                [within, braking]
            });
            self.lead = Some(lead);
            for part in parts {
                self.part = *part;
                let is_planned = is_planned && self.profile.begin(from.along, self.length, *part);
                if is_planned && self.keeps(path, from) {
                    return;
                }
            }
        }
    }

    /// Whether the plan keeps the limits of velocity and joins its path in time.
    fn keeps(&self, path: &impl Geometry, from: &Departure<'_>) -> bool {
        let Some(lead) = &self.lead else { return true };
        let at = |sample| {
            let state = self.profile.peek(lead.time(sample));
            let part = self.part_of(state.position);
            let rate = self.rate_of(state.velocity);
            path.speed(part, rate, lead.rates(sample))
        };
        // A motion that begins too fast may be as fast as that.
        let most = at(0).max(1.0) + 1e-9;
        let joins = from
            .join
            .is_none_or(|join| self.part_of(self.profile.peek(lead.duration()).position) <= join);
        joins && (1..SAMPLES).all(|sample| at(sample) <= most)
    }

    fn part_of(&self, position: f64) -> f64 {
        if self.length > 0.0 {
            position / self.length
        } else {
            1.0
        }
    }

    fn rate_of(&self, velocity: f64) -> f64 {
        if self.length > 0.0 {
            velocity / self.length
        } else {
            0.0
        }
    }

    /// One cycle.
    pub(super) fn step(&mut self, speed: f64, stop: bool) -> Progress {
        self.is_stopped |= stop;
        self.aim_at(speed);
        if self.has_started {
            self.advance();
        }
        self.has_started = true;
        self.progress()
    }

    fn advance(&mut self) {
        self.profile.advance();
        let Some(lead) = &mut self.lead else { return };
        if self.is_leading {
            lead.advance();
            if lead.is_over() {
                // From here on, the limits are those of the path alone.
                self.is_leading = false;
                self.part = 1.0;
                self.profile.set_bounds(self.pair(self.bounds));
                match self.aim {
                    Aim::End(speed) => self.profile.go_to(self.length, speed),
                    Aim::Hold | Aim::Stop => self.profile.is_at_rest() || self.profile.brake(),
                };
            }
        }
    }

    /// Replans if the target has changed.
    fn aim_at(&mut self, speed: f64) {
        let wanted = if self.is_stopped {
            Aim::Stop
        } else if speed >= HOLD_BELOW {
            Aim::End(speed.min(1.0))
        } else {
            Aim::Hold
        };
        if wanted == self.aim || self.is_at_end() {
            return;
        }
        let is_planned = match wanted {
            Aim::End(speed) => self.profile.go_to(self.length, speed * self.part),
            Aim::Hold | Aim::Stop => self.profile.is_at_rest() || self.profile.brake(),
        };
        if is_planned {
            self.aim = wanted;
            if let (Aim::Stop, Some(lead)) = (wanted, self.lead.as_mut()) {
                lead.hurry();
            }
        }
    }

    /// The part of the path at which the motion would be at rest if it were stopped two cycles from now.
    pub(super) fn rest(&self) -> f64 {
        let part = self.part_of(self.profile.rest());
        if self.profile.may_return() {
            part
        } else {
            part.clamp(0.0, 1.0)
        }
    }

    fn is_at_end(&self) -> bool {
        self.profile.is_at_rest() && self.profile.now().position >= self.length
    }

    pub(super) fn progress(&self) -> Progress {
        let now = self.profile.now();
        let is_over = self.is_at_end() || self.aim == Aim::Stop;
        // A path without length is completed as soon as it begins.
        let (part, rate, acceleration) = if self.length > 0.0 {
            let part = now.position / self.length;
            // Rounding must not lead beyond the ends.
            let part = if self.profile.may_return() {
                part
            } else {
                part.clamp(0.0, 1.0)
            };
            (
                part,
                now.velocity / self.length,
                now.acceleration / self.length,
            )
        } else {
            (1.0, 0.0, 0.0)
        };
        Progress {
            part,
            rate,
            acceleration,
            is_done: is_over && self.profile.is_at_rest() && !self.is_leading,
        }
    }
}

fn norm(off: &[State], value: impl Fn(&State) -> f64) -> f64 {
    off.iter()
        .map(|state| value(state).powi(2))
        .sum::<f64>()
        .sqrt()
}

/// The deviations of a group.
fn of<'s>(off: &'s [State], group: &Group) -> &'s [State] {
    off.get(group.first..group.first + group.axes)
        .unwrap_or_default()
}

/// Whether there is a deviation.
fn is_off(path: &impl Geometry, off: &[State]) -> bool {
    (0..path.groups()).any(|number| {
        let group = path.group(number);
        let (off, bounds) = (of(off, &group), group.bounds);
        norm(off, |s| s.position) > ON_PATH
            || norm(off, |s| s.velocity) > ON_PATH * bounds.velocity
            || norm(off, |s| s.acceleration) > ON_PATH * bounds.acceleration
    })
}

/// The parts of the limits of acceleration and jerk that the deviation gets: half of them, or more or less where the
/// accelerations at the beginning require it.
fn share(path: &impl Geometry, from: &Departure<'_>, length: f64) -> [f64; 2] {
    let groups = (0..path.groups()).map(|number| path.group(number));
    let beside = groups
        .map(|group| norm(of(from.off, &group), |s| s.acceleration) / group.bounds.acceleration);
    let beside = beside.fold(0.0, f64::max);
    let (_, along) = path.along(WHOLE);
    let forwards = if length > 0.0 {
        from.along.acceleration.abs() / along.acceleration
    } else {
        0.0
    };
    let least = beside.clamp(LEAST, 1.0 - LEAST);
    let acceleration = 0.5_f64.min(1.0 - forwards).max(least);
    // The more of the acceleration one of them has, the more of the jerk ends it.
    let [jerk, most] = JERK;
    let jerk = (jerk + beside - forwards).clamp(LEAST, most);
    [acceleration, jerk]
}

/// How far each coordinate of a deviation moves until it is at rest, braking with its share of the limits. A path that
/// begins there is one that the deviation ends on without a way back. It is no longer than that: on a longer way the deviation
/// would not brake at once, and motions that replace each other often would never brake.
pub(super) fn stopping_ways(path: &impl Geometry, from: &Departure<'_>, ways: &mut [f64]) {
    let (length, _) = path.along(WHOLE);
    let share = share(path, from, length);
    for (axis, (off, way)) in from.off.iter().zip(ways).enumerate() {
        *way = stopping(*off, axis_bounds(path, from.off, axis, share));
    }
}

/// The bounds with the least acceleration that stops a deviation on its way to zero there, if it can be less.
fn gentle(off: State, bounds: Bounds) -> Bounds {
    let is_on_its_way = off.position * off.velocity < 0.0;
    let needed = off.velocity.powi(2) / (2.0 * off.position.abs());
    let acceleration = (needed * GENTLE).max(off.acceleration.abs());
    let gentle = Bounds {
        acceleration,
        ..bounds
    };
    let stops = stopping(off, gentle).abs() <= off.position.abs();
    if is_on_its_way && acceleration < bounds.acceleration && stops {
        gentle
    } else {
        bounds
    }
}

/// Bounds of one coordinate of a deviation: such that their norm keeps the limits of its group.
fn axis_bounds(path: &impl Geometry, off: &[State], axis: usize, share: [f64; 2]) -> Bounds {
    let groups = (0..path.groups()).map(|number| path.group(number));
    let mut groups = groups.filter(|group| (group.first..group.first + group.axes).contains(&axis));
    let Some(group) = groups.next() else {
        return path.group(0).bounds;
    };
    let all = of(off, &group);
    // The longer its way and the faster it is, the more of the limits it gets.
    let values: [fn(&State) -> f64; 3] = [|s| s.position, |s| s.velocity, |s| s.acceleration];
    let wholes = values.map(|value| norm(all, value).max(f64::MIN_POSITIVE));
    let weight = |state: &State| {
        let parts = values.iter().zip(wholes);
        0.01 + parts
            .map(|(value, whole)| (value(state) / whole).powi(2))
            .sum::<f64>()
    };
    let whole: f64 = all.iter().map(weight).sum();
    let this = off.get(axis).copied().unwrap_or_default();
    let part = if group.axes > 1 {
        (weight(&this) / whole).sqrt()
    } else {
        1.0
    };
    let Bounds {
        velocity,
        acceleration,
        jerk,
    } = group.bounds;
    Bounds {
        velocity: velocity * part,
        acceleration: acceleration * part * share[0],
        jerk: jerk * part * share[1],
    }
}
