//! Jogs: by profile velocity, by a set-point of profile position, or by cyclic set-points over SDO and SYNC. Each begins
//! and ends at rest.

use takt_cia402::dictionary::Address;
use takt_cia402::{Change, HandShake, SetPoint};

use super::{AT_REST, CSP, Cause, Duration, End, Go, Jog, PP, REST, Session, Step, TURN, Wire};
use crate::jog::Profile;

/// Interpolation time value and exponent (60C2h) of cyclic set-points over SDO.
const PERIOD: Address = Address::new(0x60C2, 1);
const EXPONENT: Address = Address::new(0x60C2, 2);
/// Profile velocity of a set-point.
const PROFILE_VELOCITY: Address = Address::new(0x6081, 0);
/// Shortest and longest period of set-points over SDO, ms.
const PERIOD_MS: (u64, u64) = (20, 250);

/// Whether a commanded motor turns.
struct Turning {
    wanted: i32,
    /// When it turned last.
    turned: Duration,
    fastest: u32,
}

impl Turning {
    const fn new(wanted: i32, now: Duration) -> Self {
        Self {
            wanted,
            turned: now,
            fastest: 0,
        }
    }

    const fn least(&self) -> u32 {
        self.wanted.unsigned_abs() / 20
    }

    /// Notes a velocity; an error if it has not turned for a while although it must.
    fn note(&mut self, shown: i32, must: bool, now: Duration) -> Go<()> {
        let speed = shown.unsigned_abs();
        self.fastest = speed.max(self.fastest);
        if speed > self.least() || self.wanted == 0 || !must {
            self.turned = now;
        }
        if now > self.turned + TURN {
            let wanted = self.wanted;
            return Err(End::Because(Cause::DoesNotTurn { wanted, shown }));
        }
        Ok(())
    }

    /// At the end of a jog, which may be shorter than the timeout.
    fn judge(&self) -> Go<()> {
        if self.wanted != 0 && self.fastest <= self.least() {
            let wanted = self.wanted;
            return Err(End::Because(Cause::DoesNotTurn { wanted, shown: 0 }));
        }
        Ok(())
    }
}

impl<W: Wire> Session<'_, W> {
    /// Turns it for a time, and stops it.
    pub(super) fn jog(&mut self, jog: Jog) -> Go<()> {
        let done = match self.plan.mode {
            PP => self.jog_to_set_point(jog),
            CSP => self.jog_by_set_points(jog),
            _ => self.jog_by_velocity(jog),
        };
        match done {
            Err(End::Because(cause @ Cause::DoesNotTurn { .. })) => {
                Err(End::Because(self.overwritten()?.unwrap_or(cause)))
            }
            done => done,
        }
    }

    pub(super) fn turn(&mut self, velocity: i32) -> Go<()> {
        self.command_object(0x60FF, velocity)
    }

    /// Writes an object that commands a motion.
    fn command_object(&mut self, index: u16, value: i32) -> Go<()> {
        match self.write(index, &value.to_le_bytes())? {
            Ok(()) => Ok(()),
            Err(refusal) => Err(End::Because(Cause::Refused(refusal))),
        }
    }

    fn jog_by_velocity(&mut self, jog: Jog) -> Go<()> {
        self.moving = true;
        self.turn(jog.velocity)?;
        let end = self.wire.now() + jog.time;
        let mut turning = Turning::new(jog.velocity, self.wire.now());
        while self.wire.now() < end {
            let (step, _) = self.cycle()?;
            turning.note(step.velocity, true, self.wire.now())?;
        }
        self.stopping = true;
        self.turn(0)?;
        self.wait_for_rest()?;
        self.moving = false;
        turning.judge()
    }

    /// One set-point, as far as the velocity gets in that time.
    fn jog_to_set_point(&mut self, jog: Jog) -> Go<()> {
        let start = self.steps_position()?;
        let target = start.wrapping_add(self.distance(jog, jog.velocity)?);
        self.set(PROFILE_VELOCITY, &jog.velocity.unsigned_abs().to_le_bytes())?;
        let mut hand = HandShake::new(TURN);
        hand.offer(SetPoint {
            target,
            relative: false,
            change: Change::AtOnce,
        });
        self.moving = true;
        let begun = self.wire.now();
        let mut turning = Turning::new(jog.velocity, begun);
        let mut still = 0;
        loop {
            let (step, _) = self.cycle()?;
            let offer = hand.step(step.status, true, self.wire.now());
            if let Some(target) = offer.target
                && self.aligned != Some(target)
            {
                self.command_object(0x607A, target)?;
                self.aligned = Some(target);
            }
            // With the next cycle, after the target.
            self.bits = offer.bits;
            if let Some(Err(error)) = offer.outcome {
                return Err(End::Because(Cause::SetPoint(error)));
            }
            still = self.still(&step, still);
            let has_arrived = is_near(step.position, target, start);
            if has_arrived && still >= AT_REST {
                self.moving = false;
                return turning.judge();
            }
            turning.note(step.velocity, !has_arrived, self.wire.now())?;
            if self.wire.now() > begun + jog.time + REST {
                let shown = step.position;
                return Err(End::Because(Cause::DoesNotArrive { target, shown }));
            }
        }
    }

    /// Smooth set-points whose largest speed is the velocity, one per period.
    fn jog_by_set_points(&mut self, jog: Jog) -> Go<()> {
        let start = self.steps_position()?;
        let profile = Profile::new(self.distance(jog, jog.velocity / 2)?, jog.time);
        self.begin_cyclic(start)?;
        self.moving = true;
        let begun = self.wire.now();
        let mut turning = Turning::new(jog.velocity, begun);
        let mut still = 0;
        loop {
            let passed = self.wire.now().saturating_sub(begun);
            let target = start.wrapping_add(profile.at(passed));
            self.command_object(0x607A, target)?;
            (self.aligned, self.cyclic) = (Some(target), Some(target));
            let (step, _) = self.cycle()?;
            still = self.still(&step, still);
            // A smooth motion begins and ends slowly.
            let is_fast = passed > profile.end() / 4 && passed < profile.end() / 4 * 3;
            turning.note(step.velocity, is_fast, self.wire.now())?;
            if passed < profile.end() {
                continue;
            }
            if still >= AT_REST {
                self.moving = false;
                return if is_near(step.position, target, start) {
                    turning.judge()
                } else {
                    let shown = step.position;
                    Err(End::Because(Cause::DoesNotArrive { target, shown }))
                };
            }
            if passed > profile.end() + REST {
                let shown = step.velocity;
                return Err(End::Because(Cause::DoesNotStop { shown }));
            }
        }
    }

    /// From now on cyclic set-points apply at SYNC, in a period that its SDO server keeps up with.
    fn begin_cyclic(&mut self, position: i32) -> Go<()> {
        let (least, most) = PERIOD_MS;
        let needed = u64::try_from(self.slowest.as_millis()).unwrap_or(most);
        let ms = (2 * needed).next_multiple_of(10).clamp(least, most);
        self.period = Duration::from_millis(ms);
        let value = u8::try_from(ms).unwrap_or(u8::MAX);
        self.set(PERIOD, &[value])?;
        self.set(EXPONENT, &(-3_i8).to_le_bytes())?;
        self.cyclic = Some(position);
        Ok(())
    }

    /// Writes a parameter until the end of the session; one that it does not have, or does not change, keeps its value.
    fn set(&mut self, address: Address, value: &[u8]) -> Go<()> {
        let address = address.on_axis(self.plan.axis).unwrap_or(address);
        let before = self.read_bytes(address)?;
        let Some(before) = before.filter(|before| before != value) else {
            return Ok(());
        };
        let answer = self.asker.write(&mut self.wire, address, value, false)?;
        match answer {
            Ok(()) => self.saved.push((address, before)),
            Err(refusal) if refusal.is_timeout() => {
                return Err(End::Because(Cause::Silent(refusal)));
            }
            Err(_) => {}
        }
        Ok(())
    }

    /// Its position now.
    fn steps_position(&mut self) -> Go<i32> {
        Ok(self.cycle()?.0.position)
    }

    /// Increments that a velocity covers in the time of a jog.
    fn distance(&self, jog: Jog, velocity: i32) -> Go<i32> {
        let distance = self.limits.distance(velocity, jog.time);
        distance.ok_or(End::Because(Cause::UnknownUnit))
    }

    /// Cycles at rest in a row.
    fn still(&self, step: &Step, before: u8) -> u8 {
        if self.is_still(step.velocity) {
            before.saturating_add(1)
        } else {
            0
        }
    }

    /// Whether it is slower than a fiftieth of its jog: encoders show some noise.
    fn is_still(&self, velocity: i32) -> bool {
        let jog = self.plan.jog.map_or(0, |jog| jog.velocity.unsigned_abs());
        velocity.unsigned_abs() <= (jog / 50).max(10)
    }

    pub(super) fn wait_for_rest(&mut self) -> Go<()> {
        let end = self.wire.now() + REST;
        let mut still = 0;
        loop {
            let (step, _) = self.cycle()?;
            still = self.still(&step, still);
            if still >= AT_REST {
                return Ok(());
            }
            if self.wire.now() > end {
                let shown = step.velocity;
                return Err(End::Because(Cause::DoesNotStop { shown }));
            }
        }
    }
}

/// Whether a position is within a fiftieth of the motion from its target.
const fn is_near(position: i32, target: i32, start: i32) -> bool {
    let left = position.wrapping_sub(target).unsigned_abs();
    let all = target.wrapping_sub(start).unsigned_abs();
    left <= all / 50 + 10
}
