//! One cycle as words: entries with a kind, a length where it varies, and a body. The same code
//! writes them in the net thread and in a replay; nothing here allocates.

use std::ops::Range;

use takt_machine::machine::Status;
use takt_net::{JointState, Moment, Nanos};

use crate::device::DeviceStatus;
use crate::executor::machines::{Hosted, InputWords, MachineInput};
use crate::executor::{DeviceView, End, Executor, Running};

mod kind {
    pub(super) const STARTED: u64 = 1;
    pub(super) const CANCELLED: u64 = 2;
    pub(super) const ABORTED: u64 = 3;
    pub(super) const INBOX: u64 = 4;
    pub(super) const INPUTS: u64 = 5;
    pub(super) const OUTBOX: u64 = 6;
    pub(super) const ENDED: u64 = 7;
    pub(super) const OUTPUTS: u64 = 8;
    pub(super) const STOPPED: u64 = 9;
    pub(super) const TAKEOVER: u64 = 10;
    pub(super) const RAN_AWAY: u64 = 11;
    pub(super) const SUCCEEDED: u64 = 12;
    pub(super) const MACHINE_ADDED: u64 = 13;
    pub(super) const MACHINE_REMOVED: u64 = 14;
    pub(super) const SEATED: u64 = 15;
    pub(super) const SEAT_FAILED: u64 = 16;
    pub(super) const MACHINE_INPUT: u64 = 17;
    pub(super) const STEPPED: u64 = 18;
    /// In the flight recorder only.
    pub(super) const CHANGED: u64 = 19;
}

/// A cycle being written into a buffer whose capacity is its bound.
#[derive(Debug)]
pub(super) struct Words {
    buffer: Vec<u64>,
    overflow: bool,
}

impl Words {
    pub(super) const fn new(buffer: Vec<u64>) -> Self {
        Self {
            buffer,
            overflow: false,
        }
    }

    /// The words; as an error the truncated words, if not all fit.
    pub(super) fn finish(self) -> Result<Vec<u64>, Vec<u64>> {
        if self.overflow {
            Err(self.buffer)
        } else {
            Ok(self.buffer)
        }
    }

    fn push(&mut self, word: u64) {
        if self.buffer.len() < self.buffer.capacity() {
            self.buffer.push(word);
        } else {
            self.overflow = true;
        }
    }

    fn entry<const N: usize>(&mut self, words: [u64; N]) {
        for word in words {
            self.push(word);
        }
    }

    pub(super) fn started(&mut self, id: u32) {
        self.entry([kind::STARTED, id.into()]);
    }

    pub(super) fn succeeded(&mut self, id: u32) {
        self.entry([kind::SUCCEEDED, id.into()]);
    }

    pub(super) fn cancelled(&mut self, id: u32) {
        self.entry([kind::CANCELLED, id.into()]);
    }

    pub(super) fn aborted(&mut self, id: u32) {
        self.entry([kind::ABORTED, id.into()]);
    }

    pub(super) fn stopped(&mut self, id: u32) {
        self.entry([kind::STOPPED, id.into()]);
    }

    pub(super) fn ran_away(&mut self, id: u32) {
        self.entry([kind::RAN_AWAY, id.into()]);
    }

    pub(super) fn takeover(&mut self, id: u32, waits: bool) {
        self.entry([kind::TAKEOVER, id.into(), waits.into()]);
    }

    pub(super) fn machine_added(&mut self, id: u32) {
        self.entry([kind::MACHINE_ADDED, id.into()]);
    }

    pub(super) fn machine_removed(&mut self, id: u32) {
        self.entry([kind::MACHINE_REMOVED, id.into()]);
    }

    pub(super) fn seated(&mut self, net: &Running, fresh: bool) {
        self.entry([kind::SEATED, net.id.into()]);
        let seat = net.seat.as_ref();
        let (machine, component) = seat.map_or((0, 0), |seat| (seat.machine, seat.component));
        self.entry([machine.into(), component as u64, fresh.into()]);
    }

    pub(super) fn seat_failed(&mut self, machine: u32, component: usize) {
        self.entry([kind::SEAT_FAILED, machine.into(), component as u64]);
    }

    pub(super) fn machine_input(&mut self, machine: u32, input: &MachineInput) {
        self.entry([kind::MACHINE_INPUT, machine.into()]);
        self.entry(input.words());
    }

    /// The state of a machine, or of one inside, has changed.
    pub(super) fn changed(&mut self, machine: u32, number: usize, word: u64) {
        self.entry([kind::CHANGED, machine.into(), number as u64, word]);
    }

    pub(super) fn stepped(&mut self, hosted: &Hosted) {
        let view = hosted.view();
        let (outcome, states) = (view.outcome, &view.machines);
        self.entry([
            kind::STEPPED,
            hosted.id.into(),
            (states.len() + view.variables.len()) as u64,
        ]);
        self.entry([outcome.transitions.into(), outcome.operations as u64]);
        for state in states {
            self.push(state.word());
        }
        for value in &view.variables {
            self.push(value.word());
        }
    }

    pub(super) fn inbox(&mut self, net: &Running) {
        self.entry([kind::INBOX, net.id.into(), net.plan.inbox().words() as u64]);
        for word in net.plan.inbox_words() {
            self.push(word);
        }
    }

    pub(super) fn outbox(&mut self, net: &Running) {
        self.entry([
            kind::OUTBOX,
            net.id.into(),
            net.plan.outbox().words() as u64,
        ]);
        for word in net.plan.outbox_words() {
            self.push(word);
        }
    }

    pub(super) fn inputs(&mut self, moment: Moment, executor: &Executor) {
        let joints = executor.joints();
        self.entry([kind::INPUTS, moment.cycle]);
        self.entry([moment.time.0.cast_unsigned(), moment.wall.0.cast_unsigned()]);
        let (signals, commands) = (executor.signals(), executor.commands());
        self.entry([executor.devices.len() as u64, joints.len() as u64]);
        self.entry([signals.len() as u64, commands.len() as u64]);
        self.entry([executor.fresh().len() as u64]);
        for device in &executor.devices {
            // Jumps are in the bits above the status, which keeps the format compatible.
            let status = status_word(device.status) | device.jumps << 8;
            self.entry([status, device.faults]);
        }
        for joint in joints {
            self.entry(joint_words(&joint.state.get()));
        }
        for word in signals {
            self.push(word.get());
        }
        for range in executor.fresh() {
            self.entry([range.start as u64, range.end as u64]);
        }
    }

    pub(super) fn ended(&mut self, id: u32, end: End) {
        let (code, device) = match end {
            End::Terminated => (0, 0),
            // To nets the same.
            End::Aborted | End::Halted => (1, 0),
            End::DeviceFault(device) => (2, device as u64),
            End::Stopped => (3, 0),
            End::Runaway => (4, 0),
        };
        self.entry([kind::ENDED, id.into(), code, device]);
    }

    pub(super) fn outputs(&mut self, moment: Moment, executor: &Executor) {
        let commanded =
            |joint: &&takt_net::device::Joint| joint.command.get().cycle == moment.cycle;
        let joints = executor.joints();
        self.entry([
            kind::OUTPUTS,
            joints.iter().filter(commanded).count() as u64,
        ]);
        for (i, joint) in joints
            .iter()
            .enumerate()
            .filter(|(_, joint)| commanded(joint))
        {
            self.entry([i as u64, joint.command.get().position.to_bits()]);
        }
        let commands = executor.commands();
        self.entry([commands.len() as u64]);
        for word in commands {
            self.push(word.get());
        }
    }
}

/// Status and state of a machine from its word in [`Entry::Stepped`].
pub(super) fn machine_state(word: u64) -> (Status, Option<usize>) {
    let status = Status::ALL.into_iter().find(|it| *it as u64 == word & 0xFF);
    let state = usize::try_from(word >> 8).unwrap_or(0).checked_sub(1);
    (status.unwrap_or_default(), state)
}

const fn status_word(status: DeviceStatus) -> u64 {
    match status {
        DeviceStatus::Offline => 0,
        DeviceStatus::SafeOperational => 1,
        DeviceStatus::Operational => 2,
    }
}

pub(super) const fn status_of(word: u64) -> DeviceStatus {
    match word & 0xFF {
        1 => DeviceStatus::SafeOperational,
        2 => DeviceStatus::Operational,
        _ => DeviceStatus::Offline,
    }
}

/// An entry, read back.
#[derive(Debug)]
pub(super) enum Entry<'w> {
    Started(u32),
    Succeeded(u32),
    Cancelled(u32),
    Aborted(u32),
    Stopped(u32),
    RanAway(u32),
    Takeover(u32, bool),
    MachineAdded(u32),
    MachineRemoved(u32),
    /// Net, machine, component, and whether it replaces those that wait.
    Seated(u32, (u32, usize), bool),
    SeatFailed(u32, usize),
    MachineInput(u32, MachineInput),
    Inbox(u32, &'w [u64]),
    Inputs(Inputs<'w>),
    /// Values of a net for programs. A replay computes them again, as all that follows.
    Outbox(u32, &'w [u64]),
    /// A net that ended, why, and the device that failed.
    Ended(u32, u64, u64),
    /// Pairs of joint and commanded position.
    Outputs(&'w [u64]),
    /// A machine, and words of its states and then of its variables.
    Stepped(u32, &'w [u64]),
    /// A machine, the number of it or of one inside, and the word of its state.
    Changed(u32, usize, u64),
}

/// Inputs of a cycle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Inputs<'w> {
    pub(super) moment: Moment,
    devices: &'w [u64],
    joints: &'w [u64],
    signals: &'w [u64],
    /// Words of commands in use.
    commands: usize,
    /// Commands of devices that came into use: from and to.
    fresh: &'w [u64],
}

impl<'w> Inputs<'w> {
    /// Status and faults of a device.
    pub(super) fn device(&self, number: usize) -> Option<(DeviceStatus, u64)> {
        let pair = self.devices.chunks_exact(2).nth(number)?;
        let [status, faults] = pair else { return None };
        Some((status_of(*status), *faults))
    }

    /// States of joints in that range, as far as they are known.
    pub(super) fn joints(&self, range: Range<usize>) -> impl ExactSizeIterator<Item = JointState> {
        let words = self.joints;
        range.map(move |joint| {
            let at = joint * JOINT_WORDS;
            words
                .get(at..at + JOINT_WORDS)
                .and_then(joint_state)
                .unwrap_or_default()
        })
    }

    /// What a device with that range of words reported.
    pub(super) fn signals(&self, range: &Range<usize>) -> &'w [u64] {
        self.signals.get(range.clone()).unwrap_or_default()
    }

    /// Puts them before the nets.
    pub(super) fn apply(&self, executor: &mut Executor) {
        executor.devices.clear();
        executor
            .devices
            .extend(self.devices.chunks_exact(2).map(|pair| DeviceView {
                status: status_of(pair[0]),
                faults: pair[1],
                jumps: pair[0] >> 8,
            }));
        // Arms are added while a recording runs.
        executor.use_joints(self.joints.len() / JOINT_WORDS);
        let joints = executor.image.joints.iter();
        for (joint, words) in joints.zip(self.joints.chunks_exact(JOINT_WORDS)) {
            if let Some(state) = joint_state(words) {
                joint.state.set(state);
            }
        }
        executor.use_words(self.signals.len(), self.commands);
        for (cell, word) in executor.signals().iter().zip(self.signals) {
            cell.set(*word);
        }
        for range in self.fresh.chunks_exact(2) {
            let bound = |word: u64| usize::try_from(word).unwrap_or(usize::MAX);
            executor.use_commands(bound(range[0])..bound(range[1]));
        }
    }
}

/// Reads the entries of a cycle; `None` at the first damaged one.
pub(super) struct Reader<'w>(pub(super) &'w [u64]);

impl<'w> Reader<'w> {
    fn word(&mut self) -> Option<u64> {
        let (first, rest) = self.0.split_first()?;
        self.0 = rest;
        Some(*first)
    }

    fn id(&mut self) -> Option<u32> {
        u32::try_from(self.word()?).ok()
    }

    fn body(&mut self, len: u64) -> Option<&'w [u64]> {
        let (body, rest) = self.0.split_at_checked(usize::try_from(len).ok()?)?;
        self.0 = rest;
        Some(body)
    }

    /// The next entry; `Ok(None)` at the end.
    pub(super) fn next(&mut self) -> Result<Option<Entry<'w>>, ()> {
        match self.word() {
            None => Ok(None),
            Some(kind) => self.entry(kind).map(Some).ok_or(()),
        }
    }

    fn entry(&mut self, kind: u64) -> Option<Entry<'w>> {
        Some(match kind {
            kind::STARTED => Entry::Started(self.id()?),
            kind::SUCCEEDED => Entry::Succeeded(self.id()?),
            kind::CANCELLED => Entry::Cancelled(self.id()?),
            kind::ABORTED => Entry::Aborted(self.id()?),
            kind::STOPPED => Entry::Stopped(self.id()?),
            kind::RAN_AWAY => Entry::RanAway(self.id()?),
            kind::TAKEOVER => Entry::Takeover(self.id()?, self.word()? != 0),
            kind::MACHINE_ADDED => Entry::MachineAdded(self.id()?),
            kind::MACHINE_REMOVED => Entry::MachineRemoved(self.id()?),
            kind::SEATED => {
                let (net, machine) = (self.id()?, self.id()?);
                let component = usize::try_from(self.word()?).ok()?;
                Entry::Seated(net, (machine, component), self.word()? != 0)
            }
            kind::SEAT_FAILED => {
                let machine = self.id()?;
                Entry::SeatFailed(machine, usize::try_from(self.word()?).ok()?)
            }
            kind::MACHINE_INPUT => {
                let machine = self.id()?;
                let words = self.body(size_of::<InputWords>() as u64 / 8)?;
                Entry::MachineInput(machine, MachineInput::of_words(words)?)
            }
            kind::CHANGED => {
                let machine = self.id()?;
                let number = usize::try_from(self.word()?).ok()?;
                Entry::Changed(machine, number, self.word()?)
            }
            kind::STEPPED => {
                let (machine, len) = (self.id()?, self.word()?);
                let (_, states) = self.body(len.checked_add(2)?)?.split_at_checked(2)?;
                Entry::Stepped(machine, states)
            }
            kind::INBOX => {
                let (id, len) = (self.id()?, self.word()?);
                Entry::Inbox(id, self.body(len)?)
            }
            kind::INPUTS => Entry::Inputs(self.inputs()?),
            kind::OUTBOX => {
                let (id, len) = (self.id()?, self.word()?);
                Entry::Outbox(id, self.body(len)?)
            }
            kind::ENDED => Entry::Ended(self.id()?, self.word()?, self.word()?),
            kind::OUTPUTS => {
                let joints = self.word()?;
                let joints = self.body(joints.checked_mul(2)?)?;
                let commands = self.word()?;
                self.body(commands)?;
                Entry::Outputs(joints)
            }
            _ => return None,
        })
    }

    fn inputs(&mut self) -> Option<Inputs<'w>> {
        let (cycle, time, wall) = (self.word()?, self.word()?, self.word()?);
        let (devices, joints) = (self.word()?, self.word()?);
        let (signals, commands, fresh) = (self.word()?, self.word()?, self.word()?);
        let moment = Moment {
            cycle,
            time: Nanos(time.cast_signed()),
            wall: Nanos(wall.cast_signed()),
            every: 1,
            cancel: false,
            takeover: false,
            device_failed: false,
            net: 0,
        };
        let devices = self.body(devices.checked_mul(2)?)?;
        let joints = self.body(joints.checked_mul(JOINT_WORDS as u64)?)?;
        Some(Inputs {
            moment,
            devices,
            joints,
            signals: self.body(signals)?,
            commands: usize::try_from(commands).ok()?,
            fresh: self.body(fresh.checked_mul(2)?)?,
        })
    }
}

/// How a joint's state is laid out in a recording: error, then six values with a word before each
/// that is 1 if it is known.
const JOINT_WORDS: usize = 13;

/// Writes a joint's state as words.
fn joint_words(state: &JointState) -> [u64; JOINT_WORDS] {
    let values = [
        state.commanded_position,
        state.commanded_velocity,
        state.commanded_acceleration,
        state.measured_position,
        state.measured_velocity,
        state.measured_acceleration,
    ];
    let mut words = [0; JOINT_WORDS];
    words[0] = u64::from(state.error.cast_unsigned());
    for (pair, value) in words[1..].chunks_exact_mut(2).zip(values) {
        pair[0] = u64::from(value.is_some());
        pair[1] = value.unwrap_or(0.0).to_bits();
    }
    words
}

/// Reads a joint's state back.
fn joint_state(words: &[u64]) -> Option<JointState> {
    let value = |i: usize| {
        let pair = words.get(1 + 2 * i..3 + 2 * i)?;
        Some((pair[0] != 0).then(|| f64::from_bits(pair[1])))
    };
    Some(JointState {
        error: u32::try_from(*words.first()?).ok()?.cast_signed(),
        commanded_position: value(0)?,
        commanded_velocity: value(1)?,
        commanded_acceleration: value(2)?,
        measured_position: value(3)?,
        measured_velocity: value(4)?,
        measured_acceleration: value(5)?,
    })
}

/// The number of a recorded cycle and when it started, on the host's monotonic clock; `None` without inputs.
pub(super) fn start(words: &[u64]) -> Option<Moment> {
    let mut reader = Reader(words);
    while let Ok(Some(entry)) = reader.next() {
        if let Entry::Inputs(inputs) = entry {
            return Some(inputs.moment);
        }
    }
    None
}
