//! The part of a session that commands: cycles of reading and writing, up to Operation enabled, a jog, and the
//! shutdown of the drivers.

use takt_can::Frame;
use takt_can::canopen::{NmtState, SYNC};
use takt_cia402::{ControlWord, DriveFault, Feedback, Goal, Power, Shutdown, State, axis_goal};
use takt_core::device::driver::SHUTDOWN_MAX;

use super::{Cause, Duration, End, Go, PV, Session, Step, Wire, low_word};

impl<W: Wire> Session<'_, W> {
    /// One cycle: reads the drive and commands it.
    pub(super) fn cycle(&mut self) -> Go<(Step, bool)> {
        let begun = self.wire.now();
        self.beat()?;
        let step = self.observe()?;
        let state = step.status.state();
        if !self.leaving {
            self.check(state.ok())?;
        }
        let fault = state == Ok(State::Fault);
        if fault && self.plan.reset && !std::mem::replace(&mut self.resetting, true) {
            self.master.reset_fault();
        }
        let feedback = Feedback {
            status: step.status,
            mode: step.mode,
            position: step.position,
        };
        self.supervise(&step)?;
        let orders = self.master.step(&feedback, self.wire.now());
        if !matches!(state, Ok(State::OperationEnabled)) {
            self.align(step.position)?;
        }
        self.set_mode(orders.mode)?;
        let enables = orders.control.raw() == ENABLE_OPERATION;
        let bits = if enables { self.bits } else { 0 };
        self.order(ControlWord::new(orders.control.raw() | bits))?;
        self.send_sync()?;
        self.rest_of_cycle(begun)?;
        Ok((step, orders.follows))
    }

    /// Sends SYNC while it needs that: cyclic set-points apply at SYNC. Another master's SYNC is enough.
    fn send_sync(&mut self) -> Go<()> {
        if self.cyclic.is_some()
            && !self.wire.observed.foreign_sync
            && let Ok(sync) = Frame::new(SYNC, &[])
        {
            self.wire.send(&sync)?;
        }
        Ok(())
    }

    /// Checks that the motor is where its velocity can have moved it since it was enabled: at rest without a jog; with
    /// one, between its start and the farthest position at that velocity, since the ramp is the drive's own.
    fn supervise(&mut self, step: &Step) -> Go<()> {
        let modes_at_rest = [1, 3, 7, 8, 9];
        // While it stops, it keeps the power that brakes it; a timeout detects that it does not come to rest.
        let is_commanded = self.enabled && !self.leaving && !self.stopping;
        let is_commanded = is_commanded && modes_at_rest.contains(&self.plan.mode);
        let now = self.wire.now();
        let target = if is_commanded {
            let (start, since) = *self.origin.get_or_insert((step.position, now));
            let velocity = self.plan.jog.map_or(0, |jog| jog.velocity);
            let time = now.saturating_sub(since);
            let nearest = self.limits.nearest(start, step.position, velocity, time);
            // Where the unit of velocity is not known, its speed alone is bounded.
            self.cyclic.or(nearest).or(Some(step.position))
        } else {
            self.origin = None;
            None
        };
        match self.monitor.step(target, step.position, now) {
            Some(runaway) => Err(End::Because(Cause::Runaway(runaway))),
            None => Ok(()),
        }
    }

    /// Whether something else ends it.
    fn check(&self, state: Option<State>) -> Go<()> {
        if self.wire.is_stopped() {
            return Err(End::Stopped);
        }
        let observed = &self.wire.observed;
        if observed.surplus >= SURPLUS_MAX {
            return Err(End::Because(Cause::Duplicate));
        }
        if observed.boots > 0 {
            return Err(End::Because(Cause::Rebooted));
        }
        if let Some(shown) = observed
            .state
            .filter(|shown| *shown != NmtState::Operational)
        {
            return Err(End::Because(Cause::Left(shown)));
        }
        match state {
            Some(State::Fault | State::FaultReactionActive) if self.enabled => {
                Err(End::Because(Cause::Drive(DriveFault::Fault)))
            }
            Some(state) if self.enabled && state != State::OperationEnabled => {
                Err(End::Because(Cause::Dropped(state)))
            }
            Some(_) | None => Ok(()),
        }
    }

    /// Until it follows, its targets are its position: it must not jump when it is enabled.
    fn align(&mut self, position: i32) -> Go<()> {
        if self.aligned == Some(position) {
            return Ok(());
        }
        let first = self.aligned.is_none();
        // An object that it does not have cannot make it jump.
        let _ = self.write(0x607A, &position.to_le_bytes())?;
        if first {
            let _ = self.write(0x60FF, &[0; 4])?;
            let _ = self.write(0x6071, &[0; 2])?;
        }
        self.aligned = Some(position);
        Ok(())
    }

    fn set_mode(&mut self, mode: i8) -> Go<()> {
        if self.mode == Some(mode) || self.leaving {
            return Ok(());
        }
        self.mode = Some(mode);
        match self.write(0x6060, &mode.to_le_bytes())? {
            Ok(()) => Ok(()),
            Err(refusal) => Err(End::Because(Cause::Refused(refusal))),
        }
    }

    /// Writes 6040h if it changed.
    pub(super) fn order(&mut self, control: ControlWord) -> Go<()> {
        if self.control == Some(control) {
            return Ok(());
        }
        self.control = Some(control);
        match self.write(0x6040, &control.raw().to_le_bytes())? {
            Ok(()) => Ok(()),
            Err(refusal) => Err(End::Because(Cause::Refused(refusal))),
        }
    }

    /// Enables it until it follows.
    pub(super) fn enable(&mut self) -> Go<()> {
        loop {
            let (_, follows) = self.cycle()?;
            if follows {
                self.enabled = true;
                return Ok(());
            }
            match self.master.drive_fault() {
                None => {}
                // The edges of a reset take several cycles.
                Some(DriveFault::Fault) if self.plan.reset => {}
                Some(drive_fault) => return Err(End::Because(self.blame(drive_fault)?)),
            }
        }
    }

    /// A drive that ignores its controlword may hold another one.
    fn blame(&mut self, drive_fault: DriveFault) -> Go<Cause> {
        let is_stuck = matches!(drive_fault, DriveFault::Stuck { .. });
        let other = if is_stuck { self.overwritten()? } else { None };
        Ok(other.unwrap_or(Cause::Drive(drive_fault)))
    }

    /// The cause, if 6040h holds another word than was written.
    pub(super) fn overwritten(&mut self) -> Go<Option<Cause>> {
        let wrote = self.control.unwrap_or_default().raw();
        let holds = self.read(0x6040)?.map(low_word);
        let holds = holds.filter(|holds| *holds != wrote);
        Ok(holds.map(|holds| Cause::Overwritten { wrote, holds }))
    }

    pub(super) fn hold(&mut self, time: Duration) -> Go<()> {
        let end = self.wire.now() + time;
        while self.wire.now() < end {
            self.cycle()?;
        }
        Ok(())
    }

    /// Stops it by a quick stop if it moves, then removes power as the drivers do. A drive that was never commanded is
    /// left alone.
    pub(super) fn go_down(&mut self) -> Go<()> {
        let Some(control) = self.control else {
            return Ok(());
        };
        (self.leaving, self.enabled) = (true, false);
        let mut has_run_away = control == ControlWord::DISABLE_VOLTAGE;
        let mut rest = Ok(());
        if !has_run_away && self.moving {
            if !self.brakes_by_ramp() {
                self.master.set_goal(Goal::QuickStop);
            }
            rest = self.wait_for_rest();
            has_run_away = rest.is_err();
        }
        let end = self.remove_power(has_run_away)?;
        rest.and_then(|()| judge_end(end))
    }

    /// Brakes a motor that moves, before anything else.
    pub(super) fn brake(&mut self) -> Go<()> {
        if self.brakes_by_ramp() {
            return self.turn(0);
        }
        self.order(ControlWord::QUICK_STOP)
    }

    /// Whether its own ramp brakes it: by 605Ah = 0 a quick stop would let the motor coast.
    const fn brakes_by_ramp(&self) -> bool {
        self.coasts && self.plan.mode == PV
    }

    /// Removes power from a drive at rest, or from one that does not come to rest; returns its state at the end.
    fn remove_power(&mut self, has_run_away: bool) -> Go<Option<State>> {
        let begun = self.wire.now();
        let mut shutdown = Shutdown::new(begun);
        let mut state = self.steps.last().and_then(|step| step.status.state().ok());
        while self.wire.now() < begun + SHUTDOWN_MAX {
            let power = state.map_or(Power::Off, Power::from);
            let goal = shutdown.step(true, power == Power::Drives, self.wire.now());
            let goal = axis_goal(goal, power, has_run_away);
            if let Some(goal) = goal {
                self.master.set_goal(goal);
            }
            let (step, _) = self.cycle()?;
            state = step.status.state().ok();
            let off = matches!(state, Some(State::SwitchOnDisabled | State::Fault));
            if off && goal == Some(Goal::SwitchOnDisabled) {
                break;
            }
        }
        Ok(state)
    }
}

/// Whether a drive ended as it should: without power and without a fault.
pub(super) fn judge_end(state: Option<State>) -> Go<()> {
    match state {
        Some(State::Fault | State::FaultReactionActive) => {
            Err(End::Because(Cause::Drive(DriveFault::Fault)))
        }
        Some(state @ (State::SwitchedOn | State::OperationEnabled | State::QuickStopActive)) => {
            Err(End::Because(Cause::StaysPowered(state)))
        }
        Some(State::NotReadyToSwitchOn | State::SwitchOnDisabled | State::ReadyToSwitchOn)
        | None => Ok(()),
    }
}

/// Controlword of Operation enabled.
const ENABLE_OPERATION: u16 = 0x000F;
/// SDO answers beyond one per request after which several devices count as present.
const SURPLUS_MAX: u32 = 3;
