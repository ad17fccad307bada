//! One slave of a recording: its states, the error counters of its ports, its clock, as far as the recorded master read
//! them.

use std::time::Duration;

use takt_ethercat::{AlState, AlStatus, AlStatusCode, Command, register};

use crate::ecat::difference::Range;

/// Registers from 0300h to 0313h.
const COUNTERS: usize = 20;

/// A slave in a recording.
#[derive(Clone, Debug, Default)]
pub(super) struct RecordedSlave {
    /// Position from 0; `None` if the recording begins after the addressing.
    pub(super) position: Option<u16>,
    /// Number of answered datagrams.
    pub(super) answered: u64,
    /// Times of unanswered datagrams.
    pub(super) silent: Vec<Duration>,
    /// The state as last read, and the code.
    pub(super) al: Option<(AlStatus, AlStatusCode)>,
    /// AL control (0120h) as last written.
    control: Option<u16>,
    /// An error whose code was not read yet.
    pending_error: Option<(Duration, AlStatus)>,
    /// Times of state changes.
    states: Vec<(Duration, AlStatus)>,
    /// Times of errors, with state and code.
    pub(super) falls: Vec<(Duration, AlStatus, AlStatusCode)>,
    /// DL status (0110h).
    pub(super) dl_status: Option<u16>,
    last: Option<[u8; COUNTERS]>,
    gained: [u64; COUNTERS],
    /// Whether error counters were read.
    pub(super) counted: bool,
    /// 092Ch, ns.
    pub(super) difference: Option<Range>,
    /// 0928h, ns.
    pub(super) delay_ns: Option<u32>,
    /// 0990h and 09A0h, ns.
    pub(super) sync0_start_ns: Option<u64>,
    pub(super) sync0_cycle_ns: Option<u32>,
}

/// Whether each slave answers access to a register at any time. Empty or full mailboxes, missing clocks, and AL control
/// that the firmware has not read yet may stay unanswered.
const fn always_answers(command: Command, ado: u16) -> bool {
    let is_control = matches!(command, Command::Fpwr) && ado == register::AL_CONTROL;
    ado < register::DC_RECEIVE_TIMES && !is_control
}

fn u32_at(data: &[u8], at: usize) -> Option<u32> {
    let four = data.get(at..)?.first_chunk()?;
    Some(u32::from_le_bytes(*four))
}

impl RecordedSlave {
    /// Handles a returned datagram.
    pub(super) fn take(
        &mut self,
        at: Duration,
        command: Command,
        ado: u16,
        counter: u16,
        data: &[u8],
    ) {
        if counter == 0 {
            if always_answers(command, ado) {
                self.silent.push(at);
            }
            return;
        }
        self.answered += 1;
        // A datagram may carry several consecutive registers.
        let from = |register: u16| {
            let skip = usize::from(register.checked_sub(ado)?);
            data.get(skip..).filter(|rest| !rest.is_empty())
        };
        let reads = command == Command::Fprd;
        if command == Command::Fpwr && ado == register::AL_CONTROL {
            self.take_control(data);
        }
        if reads && let Some([a, b, rest @ ..]) = from(register::AL_STATUS) {
            let code = match rest {
                [_, _, c, d, ..] => Some(AlStatusCode(u16::from_le_bytes([*c, *d]))),
                _ => None,
            };
            self.take_state(at, u16::from_le_bytes([*a, *b]), code);
        } else if reads && let Some([a, b, ..]) = from(register::AL_STATUS_CODE) {
            self.take_code(AlStatusCode(u16::from_le_bytes([*a, *b])));
        }
        if reads && let Some([a, b, ..]) = from(register::DL_STATUS) {
            self.dl_status = Some(u16::from_le_bytes([*a, *b]));
        }
        if let Some(block) = from(register::ERROR_COUNTERS).and_then(|block| block.first_chunk()) {
            self.take_counters(reads, *block);
        }
        if reads && let Some(raw) = from(register::DC_DIFFERENCE).and_then(|rest| u32_at(rest, 0)) {
            self.take_difference(raw);
        }
        self.take_clock(&from);
    }

    fn take_clock<'a>(&mut self, from: &impl Fn(u16) -> Option<&'a [u8]>) {
        let double = |register| from(register).and_then(|rest| u32_at(rest, 0));
        if let Some(delay) = double(register::DC_DELAY) {
            self.delay_ns = Some(delay);
        }
        if let Some(start) = from(register::DC_START_TIME).and_then(|rest| rest.first_chunk()) {
            self.sync0_start_ns = Some(u64::from_le_bytes(*start));
        }
        if let Some(cycle) = double(register::DC_SYNC0_CYCLE).filter(|cycle| *cycle > 0) {
            self.sync0_cycle_ns = Some(cycle);
        }
    }

    /// AL control was written.
    pub(super) fn take_control(&mut self, data: &[u8]) {
        if let Some(two) = data.first_chunk() {
            self.control = Some(u16::from_le_bytes(*two));
        }
    }

    /// The state was read, with or without the code. A slave with device emulation (0141h bit 0) mirrors AL control with
    /// the acknowledgement bit, which is no error; nor is code 0.
    fn take_state(&mut self, at: Duration, raw: u16, code: Option<AlStatusCode>) {
        const STATE_AND_ERROR: u16 = 0x1F;
        let mut al = AlStatus::from_raw(raw);
        let is_mirrored = self
            .control
            .is_some_and(|control| (control ^ raw) & STATE_AND_ERROR == 0);
        al.error &= code.map_or(!is_mirrored, |code| code != AlStatusCode::default());
        let before = self.al.map(|(before, _)| before);
        if before != Some(al) {
            self.states.push((at, al));
        }
        let is_new_error = al.error && before.is_none_or(|before| !before.error);
        match code {
            Some(code) if is_new_error => self.falls.push((at, al, code)),
            None if is_new_error => self.pending_error = Some((at, al)),
            Some(_) | None => {}
        }
        self.al = Some((al, code.unwrap_or_default()));
    }

    /// The code of an earlier error was read.
    fn take_code(&mut self, code: AlStatusCode) {
        let Some((at, al)) = self.pending_error.take() else {
            return;
        };
        if code != AlStatusCode::default() {
            self.falls.push((at, al, code));
            return;
        }
        self.states.retain(|(since, _)| *since != at);
        if let Some((al, _)) = &mut self.al {
            al.error = false;
        }
    }

    /// Keeps an error whose code was never read.
    pub(super) fn finish(&mut self) {
        if let Some((at, al)) = self.pending_error.take() {
            self.falls.push((at, al, AlStatusCode::default()));
        }
    }

    /// A register that decreased was cleared in between; its value counts from then on.
    fn take_counters(&mut self, reads: bool, block: [u8; COUNTERS]) {
        let last = self.last.replace(block);
        let (true, Some(last)) = (reads, last) else {
            return;
        };
        self.counted = true;
        for (gained, (now, before)) in self.gained.iter_mut().zip(block.iter().zip(last)) {
            *gained += u64::from(now.checked_sub(before).unwrap_or(*now));
        }
    }

    /// Bit 31 is the sign.
    fn take_difference(&mut self, raw: u32) {
        let size = (raw & 0x7FFF_FFFF).cast_signed();
        // Set: its clock is ahead of the received time.
        let ns = if raw & 0x8000_0000 == 0 { -size } else { size };
        let Range { least, most, .. } = self.difference.unwrap_or(Range {
            least: ns,
            most: ns,
            last: ns,
        });
        self.difference = Some(Range {
            least: least.min(ns),
            most: most.max(ns),
            last: ns,
        });
    }

    fn gained(&self, at: usize) -> u64 {
        self.gained.get(at).copied().unwrap_or(0)
    }

    /// Invalid frames, receive errors, forwarded errors and lost links of a port since the recording began.
    pub(super) fn at_port(&self, port: usize) -> [u64; 4] {
        [
            self.gained(2 * port),
            self.gained(2 * port + 1),
            self.gained(8 + port),
            self.gained(16 + port),
        ]
    }

    /// Errors between its firmware and its controller (030Dh).
    pub(super) fn controller_errors(&self) -> u64 {
        self.gained(13)
    }

    /// The open ports; `None` if DL status was not read.
    pub(super) fn open(&self) -> Option<[bool; 4]> {
        let status = self.dl_status?;
        Some(std::array::from_fn(|port| {
            status >> (8 + 2 * port) & 3 == 2
        }))
    }

    /// Whether it was not in OP at a time, as far as the recording shows.
    pub(super) fn was_down(&self, at: Duration) -> bool {
        let before = self.states.iter().rev().find(|(since, _)| *since <= at);
        before.is_some_and(|(_, al)| al.error || al.state != AlState::Op)
    }
}
