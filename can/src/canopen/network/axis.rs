//! Master side of one CiA 402 axis: cyclic command, state, and the conditions under which it
//! follows its targets. Independent of the PDO mapping.

mod command;
mod mode;

use std::time::Duration;

use takt_cia402::dictionary::{Address, Dictionary, Key, Number};
use takt_cia402::proof::{Denied, Exchanged, Object, Objects, Proof, Values};
use takt_cia402::{
    ControlWord, DriveCommand, DriveFault, Feedback, Goal, HOMING_MODE, HOMING_START, HandShake,
    Homing, Master, SetPoint, SetPointError, State, StatusWord,
};

use super::AxisFault;
use super::plan::AxisPlan;
pub use command::AxisCommand;
use mode::ConstantMode;

/// Last received state of an axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AxisState {
    /// 6041h.
    pub status: StatusWord,
    /// 6061h; `None` if it is not mapped.
    pub mode: Option<i8>,
    /// 6064h, user units.
    pub position: i32,
    /// 606Ch, user units/s.
    pub velocity: i32,
    /// 6077h, per mille of the rated torque.
    pub torque: i16,
    /// 60FDh.
    pub inputs: u32,
    /// The axis follows its targets.
    pub follows: bool,
    /// SYNCs since its last TPDO.
    pub missing: u32,
    /// Number of successful homing runs.
    pub homed: u32,
    /// Number of profile position set-points acknowledged by the drive.
    pub taken: u32,
}

/// Profile position (6060h).
const PROFILE_POSITION: i8 = 1;
/// Interpolated position (6060h), and the controlword bit that enables its data records.
const INTERPOLATED_POSITION: i8 = 7;
const ENABLE_INTERPOLATION: u16 = 1 << 4;
/// Bit 8 of the controlword: halt.
const HALT: u16 = 1 << 8;

/// Objects of an axis in the process image; `None` if not mapped.
#[derive(Clone, Copy, Debug)]
struct Keys {
    control: Option<Key<u16>>,
    mode: Option<Key<i8>>,
    position: Option<Key<i32>>,
    record: Option<Key<i32>>,
    velocity: Option<Key<i32>>,
    torque: Option<Key<i16>>,
    position_offset: Option<Key<i32>>,
    velocity_offset: Option<Key<i32>>,
    torque_offset: Option<Key<i16>>,
    status: Option<Key<u16>>,
    shown: Option<Key<i8>>,
    position_actual: Option<Key<i32>>,
    velocity_actual: Option<Key<i32>>,
    torque_actual: Option<Key<i16>>,
    inputs: Option<Key<u32>>,
}

impl Keys {
    fn new(image: &Dictionary, axis: u8) -> Self {
        fn key<T: Number>(image: &Dictionary, axis: u8, index: u16) -> Option<Key<T>> {
            let address = Address::new(index, 0).on_axis(axis)?;
            image.key(address).ok()
        }
        Self {
            control: key(image, axis, 0x6040),
            mode: key(image, axis, 0x6060),
            position: key(image, axis, 0x607A),
            record: Address::new(0x60C1, 1)
                .on_axis(axis)
                .and_then(|record| image.key(record).ok()),
            velocity: key(image, axis, 0x60FF),
            torque: key(image, axis, 0x6071),
            position_offset: key(image, axis, 0x60B0),
            velocity_offset: key(image, axis, 0x60B1),
            torque_offset: key(image, axis, 0x60B2),
            status: key(image, axis, 0x6041),
            shown: key(image, axis, 0x6061),
            position_actual: key(image, axis, 0x6064),
            velocity_actual: key(image, axis, 0x606C),
            torque_actual: key(image, axis, 0x6077),
            inputs: key(image, axis, 0x60FD),
        }
    }
}

fn get<T: Number>(image: &Dictionary, key: Option<Key<T>>) -> Option<T> {
    key.map(|key| image.get(key))
}

fn set<T: Number>(image: &mut Dictionary, key: Option<Key<T>>, value: T) {
    if let Some(key) = key {
        image.set(key, value);
    }
}

/// The process image, for the proof.
impl Keys {
    /// Each mapped object with its value.
    fn each(&self, image: &Dictionary) -> [(u16, Option<u32>); 14] {
        let word = |key: Option<Key<u16>>| get(image, key).map(u32::from);
        let long = |key: Option<Key<i32>>| get(image, key).map(i32::cast_unsigned);
        let short = |key: Option<Key<i16>>| {
            let value = get(image, key).map(i16::cast_unsigned);
            value.map(u32::from)
        };
        let byte = |key: Option<Key<i8>>| {
            let value = get(image, key).map(i8::cast_unsigned);
            value.map(u32::from)
        };
        [
            (0x6040, word(self.control)),
            (0x6060, byte(self.mode)),
            (0x607A, long(self.position)),
            (0x60FF, long(self.velocity)),
            (0x6071, short(self.torque)),
            (0x60B0, long(self.position_offset)),
            (0x60B1, long(self.velocity_offset)),
            (0x60B2, short(self.torque_offset)),
            (0x6041, word(self.status)),
            (0x6061, byte(self.shown)),
            (0x6064, long(self.position_actual)),
            (0x606C, long(self.velocity_actual)),
            (0x6077, short(self.torque_actual)),
            (0x60FD, get(image, self.inputs)),
        ]
    }

    /// The mapped objects.
    fn carried(&self, image: &Dictionary) -> Objects {
        let mut carried = Objects::default();
        for (index, value) in self.each(image) {
            if let (Some(object), Some(_)) = (Object::of(index), value) {
                carried.insert(object);
            }
        }
        carried
    }

    fn values(&self, image: &Dictionary) -> Values {
        let mut values = Values::default();
        for (index, value) in self.each(image) {
            values.put(index, value.unwrap_or(0));
        }
        values
    }

    /// Writes an output.
    fn put(&self, image: &mut Dictionary, values: &Values) {
        let long = |index| values.at(index).cast_signed();
        let short = |index| low_word(values.at(index)).cast_signed();
        set(image, self.control, low_word(values.at(0x6040)));
        let [mode, ..] = values.at(0x6060).to_le_bytes();
        set(image, self.mode, mode.cast_signed());
        set(image, self.position, long(0x607A));
        set(image, self.velocity, long(0x60FF));
        set(image, self.torque, short(0x6071));
        set(image, self.position_offset, long(0x60B0));
        set(image, self.velocity_offset, long(0x60B1));
        set(image, self.torque_offset, short(0x60B2));
    }
}

const fn low_word(raw: u32) -> u16 {
    let [a, b, ..] = raw.to_le_bytes();
    u16::from_le_bytes([a, b])
}

/// Master side of one axis.
#[derive(Clone, Debug)]
pub struct Axis {
    plan: AxisPlan,
    keys: Keys,
    master: Master,
    proof: Proof,
    /// 60C1h:01 while the process data are not proven: a constant record.
    parked: Option<i32>,
    command: AxisCommand,
    state: AxisState,
    goal: Goal,
    mode: i8,
    homing: Option<Homing>,
    homing_failed: Option<takt_cia402::HomingError>,
    hand_shake: HandShake,
    /// 607Ah of the last set-point of the handshake; `None` before the first one: then 607Ah is the commanded target.
    handed_over: Option<i32>,
    not_taken: Option<SetPointError>,
    constant: ConstantMode,
    /// Its TPDO was received since the last cycle.
    fresh: bool,
    /// A TPDO was received since its node runs.
    received: bool,
    /// It was lost while enabled.
    held_back: bool,
    aligned: bool,
    /// Hold position while it is enabled and does not follow. Commanding the actual position of
    /// each cycle instead would yield to any load.
    hold: Option<i32>,
    fault: Option<AxisFault>,
}

impl Axis {
    pub(super) fn new(plan: AxisPlan, image: &Dictionary) -> Self {
        let keys = Keys::new(image, plan.axis);
        Self {
            plan,
            keys,
            proof: Proof::new(plan.axis, keys.carried(image), plan.not_mirrored),
            parked: None,
            master: Master::new(plan.options),
            command: AxisCommand::default(),
            state: AxisState::default(),
            goal: Goal::SwitchOnDisabled,
            mode: 0,
            homing: None,
            homing_failed: None,
            hand_shake: HandShake::new(plan.options.state),
            handed_over: None,
            not_taken: None,
            constant: ConstantMode::new(plan.mode),
            fresh: false,
            received: false,
            held_back: false,
            aligned: false,
            hold: None,
            fault: Some(AxisFault::NodeDown),
        }
    }

    /// Its plan.
    pub const fn plan(&self) -> &AxisPlan {
        &self.plan
    }

    /// Sets the goal and the mode of operation (6060h). Releases an axis that was held back. An axis whose plan has a constant
    /// mode is not enabled in another one, with [`AxisFault::ConstantMode`].
    pub fn set_goal(&mut self, goal: Goal, mode: i8) {
        // Without power the mode is of no interest: power can always be taken.
        let constant = self.plan.mode.filter(|_| goal != Goal::OperationEnabled);
        let mode = constant.unwrap_or(mode);
        if !self.constant.takes(mode) {
            return;
        }
        self.held_back = false;
        self.homing_failed = None;
        if (goal, mode) != (self.goal, self.mode) {
            self.discard_set_points();
        }
        (self.goal, self.mode) = (goal, mode);
        if self.homing.is_none() || goal != Goal::OperationEnabled {
            self.homing = None;
            self.master.set_mode(mode);
        }
        self.master.set_goal(goal);
    }

    /// Its goal.
    pub const fn goal(&self) -> Goal {
        self.goal
    }

    /// Command from the next cycle on.
    pub const fn command(&mut self, command: AxisCommand) {
        self.command = command;
    }

    /// Its command.
    pub const fn commanded(&self) -> AxisCommand {
        self.command
    }

    /// Its last received state.
    pub const fn state(&self) -> &AxisState {
        &self.state
    }

    /// Sends a profile position set-point by the handshake of the profile; replaces one that the drive has not
    /// acknowledged. It applies in profile position mode while the axis follows; then the handshake drives 607Ah and
    /// controlword bits 4, 5, 6 and 9, and only halt is taken from the command.
    pub const fn move_to(&mut self, set_point: SetPoint) {
        if self.handed_over.is_none() {
            self.handed_over = Some(self.state.position);
        }
        self.not_taken = None;
        self.hand_shake.offer(set_point);
    }

    /// Whether a set-point handshake is running.
    pub fn is_handing_over(&self) -> bool {
        !self.hand_shake.is_idle()
    }

    const fn discard_set_points(&mut self) {
        self.hand_shake = HandShake::new(self.plan.options.state);
        (self.handed_over, self.not_taken) = (None, None);
    }

    /// Enables homing mode and runs the method in 6098h; afterwards it restores the mode of
    /// operation and holds the new position until the target is close to it. An axis whose plan has a constant mode does not
    /// home, with [`AxisFault::ConstantMode`].
    pub fn home(&mut self) {
        if !self.constant.takes(HOMING_MODE) {
            return;
        }
        self.held_back = false;
        self.homing_failed = None;
        self.homing = Some(Homing::new(self.plan.homing));
        self.goal = Goal::OperationEnabled;
        self.master.set_mode(HOMING_MODE);
        self.master.set_goal(Goal::OperationEnabled);
    }

    /// Whether a homing run is active.
    pub(crate) const fn is_homing(&self) -> bool {
        self.homing.is_some()
    }

    /// Resets a fault by an edge of controlword bit 7.
    pub const fn reset_fault(&mut self) {
        self.master.reset_fault();
    }

    /// Why it does not follow its commands.
    pub const fn fault(&self) -> Option<AxisFault> {
        self.fault
    }

    /// The proof of its process data.
    pub const fn proof(&self) -> &Proof {
        &self.proof
    }

    /// Whether an upload is due.
    pub(super) fn has_upload(&self) -> bool {
        self.proof.has_upload() || self.constant.is_due()
    }

    /// The next object to upload, for the proof or the watch of its mode.
    pub(super) fn poll_upload(&mut self) -> Option<Address> {
        let proof = self.proof.poll_upload();
        if proof.is_some() || !self.constant.take() {
            return proof;
        }
        Address::new(0x6061, 0).on_axis(self.plan.axis)
    }

    pub(super) fn handle_upload(&mut self, answer: Result<&[u8], Denied>, now: Duration) {
        let shown = answer.ok().and_then(|bytes| bytes.first());
        if !self
            .constant
            .answered(shown.map(|mode| mode.cast_signed()), now)
        {
            self.proof.handle_upload(answer, now);
        }
    }

    fn prove(&mut self, image: &Dictionary, fresh: bool, now: Duration) {
        let powers = !matches!(self.goal, Goal::SwitchOnDisabled | Goal::QuickStop);
        let values = self.keys.values(image);
        let exchanged = Exchanged {
            received: values,
            sent: values,
            fresh,
            state: self.master.state(self.state.status).ok(),
            wanted: powers,
            mode: self.master.mode(),
        };
        self.proof.step(&exchanged, now);
        self.master.set_ceiling(self.proof.ceiling());
    }

    /// The TPDO with its statusword was received.
    pub(super) const fn received(&mut self) {
        (self.fresh, self.received) = (true, true);
    }

    fn read(&mut self, image: &Dictionary) {
        let (k, state) = (&self.keys, &mut self.state);
        state.status = StatusWord::new(get(image, k.status).unwrap_or(0));
        state.mode = get(image, k.shown).or_else(|| self.constant.other());
        state.position = get(image, k.position_actual).unwrap_or(0);
        state.velocity = get(image, k.velocity_actual).unwrap_or(0);
        state.torque = get(image, k.torque_actual).unwrap_or(0);
        state.inputs = get(image, k.inputs).unwrap_or(0);
    }

    /// Its node no longer runs.
    pub(super) fn lost(&mut self) {
        let wanted = self.goal == Goal::OperationEnabled;
        self.held_back |= wanted;
        self.received = false;
        self.homing = None;
        self.constant.restart();
        self.discard_set_points();
        self.goal = Goal::SwitchOnDisabled;
        self.proof.restart();
        self.parked = None;
        self.master = Master::new(self.plan.options);
        self.master.set_mode(self.mode);
        self.aligned = false;
        self.state.follows = false;
        self.fault = Some(AxisFault::NodeDown);
    }

    /// Writes a quick stop into the image when its node is given up.
    pub(super) fn write_quick_stop(&self, image: &mut Dictionary) {
        self.write(image, ControlWord::QUICK_STOP, false);
    }

    /// One cycle: writes the command into the image. Returns whether its TPDOs have just exceeded
    /// the limit of missing cycles.
    pub(super) fn cycle(&mut self, image: &mut Dictionary, now: Duration) -> bool {
        if !self.received {
            self.write(image, ControlWord::DISABLE_VOLTAGE, false);
            return false;
        }
        self.read(image);
        let is_enabled = self.state.status.state() == Ok(State::OperationEnabled);
        self.constant.step(is_enabled, now);
        self.parked = self.parked.or(Some(self.state.position));
        let fresh = std::mem::take(&mut self.fresh);
        self.state.missing = if fresh {
            0
        } else {
            self.state.missing.saturating_add(1)
        };
        let missing = self.state.missing > self.plan.missing_max;
        let newly = missing && !self.held_back && self.goal == Goal::OperationEnabled;
        if newly {
            (self.held_back, self.goal) = (true, Goal::QuickStop);
            self.homing = None;
            self.master.set_goal(Goal::QuickStop);
        }
        self.prove(image, fresh, now);
        let drive_command = self.drive_command(now);
        self.latch(drive_command.follows);
        self.write(image, drive_command.control, drive_command.follows);
        newly
    }

    fn drive_command(&mut self, now: Duration) -> DriveCommand {
        let feedback = Feedback {
            status: self.state.status,
            mode: self.state.mode,
            position: self.state.position,
        };
        let mut drive_command = self.master.step(&feedback, now);
        let not_proven = self.proof.fault().map(DriveFault::NotProven);
        let drive_fault = not_proven.or_else(|| self.master.drive_fault());
        self.fault = drive_fault.map(AxisFault::Drive);
        // In the cycle in which homing ends the targets are still in the old coordinates.
        let homing = self.homing.is_some();
        let start = self.run_homing(&drive_command, now);
        let bits = if start { HOMING_START } else { 0 };
        drive_command.follows &= !homing;
        self.align(&mut drive_command);
        let handed = self.hand_over(&drive_command, now);
        let bits = match handed {
            Some(handed) => self.command.mode_bits & HALT | handed,
            None if drive_command.follows && drive_command.mode == INTERPOLATED_POSITION => {
                self.command.mode_bits & 0x0370 | ENABLE_INTERPOLATION
            }
            None if drive_command.follows => self.command.mode_bits & 0x0370,
            None => bits,
        };
        drive_command.control = ControlWord::new(drive_command.control.raw() | bits);
        self.state.follows = drive_command.follows;
        if self.held_back {
            self.fault = Some(AxisFault::HeldBack);
        } else if let Some(error) = self.homing_failed
            && matches!(self.fault, None | Some(AxisFault::NotAligned { .. }))
        {
            // The misalignment is a consequence of the failed homing.
            self.fault = Some(AxisFault::Homing(error));
        } else if let Some(error) = self.not_taken {
            self.fault = self.fault.or(Some(AxisFault::SetPoint(error)));
        }
        self.fault = self.fault.or_else(|| self.constant.refused());
        drive_command
    }

    /// Controlword bits of the profile position handshake.
    fn hand_over(&mut self, drive_command: &DriveCommand, now: Duration) -> Option<u16> {
        self.handed_over?;
        let ready = drive_command.follows && drive_command.mode == PROFILE_POSITION;
        let offer = self.hand_shake.step(self.state.status, ready, now);
        self.handed_over = offer.target.or(self.handed_over);
        match offer.outcome {
            Some(Ok(())) => self.state.taken = self.state.taken.wrapping_add(1),
            Some(Err(error)) => self.not_taken = Some(error),
            None => {}
        }
        ready.then_some(offer.bits)
    }

    /// Controlword bit 4 during homing; ends the run.
    fn run_homing(&mut self, drive_command: &DriveCommand, now: Duration) -> bool {
        let Some(homing) = &mut self.homing else {
            return false;
        };
        let shown = self.state.mode.is_none_or(|mode| mode == HOMING_MODE);
        let (start, outcome) = homing.step(self.state.status, drive_command.follows && shown, now);
        if let Some(outcome) = outcome {
            self.homing = None;
            self.homing_failed = outcome.err();
            if outcome.is_ok() {
                self.state.homed = self.state.homed.wrapping_add(1);
            }
            self.master.set_mode(self.mode);
            self.aligned = false;
        }
        start
    }

    /// In position modes it follows only after its target was close to its position.
    fn align(&mut self, drive_command: &mut DriveCommand) {
        if !drive_command.follows {
            self.aligned = false;
            return;
        }
        let (target, actual) = (self.command.position, self.state.position);
        let positions = matches!(drive_command.mode, 1 | 7 | 8);
        let far = target.wrapping_sub(actual).unsigned_abs() > self.plan.jump_max;
        // A profile position target may be far away; the handshake starts the motion.
        if positions && drive_command.mode != 1 && far && !self.aligned {
            drive_command.follows = false;
            self.fault = Some(AxisFault::NotAligned { target, actual });
            return;
        }
        self.aligned = true;
    }

    fn latch(&mut self, follows: bool) {
        let enabled = self.state.status.state() == Ok(State::OperationEnabled);
        let homing = self.state.mode == Some(HOMING_MODE);
        self.hold = if enabled && !follows && !homing {
            self.hold.or(Some(self.state.position))
        } else {
            None
        };
    }

    fn write(&self, image: &mut Dictionary, control: ControlWord, follows: bool) {
        if let Some(instead) = self.proof.instead() {
            self.keys.put(image, instead);
            set(image, self.keys.record, self.parked.unwrap_or(0));
            return;
        }
        let (k, c) = (&self.keys, &self.command);
        let mode = if self.homing.is_some() {
            HOMING_MODE
        } else {
            self.mode
        };
        let zero_or = |value| if follows { value } else { 0 };
        let hold = self.hold.unwrap_or(self.state.position);
        let handed_over = self.handed_over.filter(|_| self.mode == PROFILE_POSITION);
        let position = match handed_over {
            Some(target) if follows => target,
            None if follows => c.position,
            Some(_) | None => hold,
        };
        set(image, k.control, control.raw());
        set(image, k.mode, mode);
        set(image, k.position, position);
        set(image, k.record, position);
        set(image, k.velocity, zero_or(c.velocity));
        set(image, k.torque, if follows { c.torque } else { 0 });
        set(image, k.position_offset, zero_or(c.position_offset));
        set(image, k.velocity_offset, zero_or(c.velocity_offset));
        set(
            image,
            k.torque_offset,
            if follows { c.torque_offset } else { 0 },
        );
    }
}
