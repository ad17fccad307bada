//! The state machine of a slave (ETG.1000.6, clause 6.4.1): its checks for each state, and the codes of refusals.
//!
//! ```text
//!          1 IP         2 PS             3 SO
//! INIT <---------> PRE-OP <---> SAFE-OP <-----> OP        down from any to any
//!   ^ 4 IB
//!   v
//! BOOT (without FoE refused: 0013h)
//! ```

use crate::register;
use crate::{AlState, AlStatus, AlStatusCode};

use super::super::application::Setup;
use super::super::memory::{al_event, ecat_event};
use super::{Request, Slave};

/// Bits of AL control that a controller without firmware copies to AL status: state, acknowledgement, identification.
const MIRRORED: u16 = 0x003F;

impl Slave {
    /// Whether its controller answers AL control by itself (device emulation: 0141h bit 0, from SII word 0 bit 8), as
    /// those of couplers and simple terminals do. It checks nothing and refuses nothing.
    pub(super) fn mirrors(&self) -> bool {
        let [configuration] = self.memory.get(register::ESC_CONFIGURATION);
        configuration & 0x01 != 0
    }

    /// Sets AL control as left by another master.
    pub fn set_al_control(&mut self, control: u16) {
        if self
            .memory
            .write(register::AL_CONTROL, &control.to_le_bytes())
        {
            self.memory.events.al_control = false;
            self.al_control_written(self.ran);
        }
    }

    /// AL status as a master reads it.
    pub fn al_status(&self) -> u16 {
        self.memory.word(register::AL_STATUS)
    }

    /// The master wrote AL control.
    pub(super) fn al_control_written(&mut self, now: u64) {
        let control = self.memory.word(register::AL_CONTROL);
        let wanted = AlStatus::from_raw(control).state;
        if self.mirrors() {
            let refused = self.faults.refused.filter(|(state, _)| *state == wanted);
            return match refused {
                Some((_, code)) => self.show_state(code, true),
                None => self.mirror(control),
            };
        }
        let times = self.config.times;
        let read = times.al_read.map_or(0, |span| span.draw(&mut self.random));
        let delay = match wanted {
            AlState::SafeOp => times.to_safe_op,
            AlState::Op => times.to_op,
            AlState::Init | AlState::PreOp | AlState::Boot | AlState::Other(_) => times.to_pre_op,
        };
        let delay = delay.draw(&mut self.random);
        let delay = delay.max(read);
        // Firmware polls periodically and takes the present value.
        let due = self.request.filter(|_| times.al_read.is_none());
        let due = due.map_or(now + delay, |request| request.due);
        self.request = Some(Request {
            read: now + read,
            due,
            expires: now + delay + self.config.op_wait,
        });
    }

    /// Copies AL control to AL status unchanged, with code 0000h.
    fn mirror(&mut self, control: u16) {
        let wanted = AlStatus::from_raw(control).state;
        if self.state != wanted {
            self.application.leave(self.state, wanted);
        }
        if matches!(wanted, AlState::Init | AlState::PreOp) {
            self.outputs_at = None;
        }
        self.state = wanted;
        self.memory.set(register::AL_STATUS_CODE, &[0, 0]);
        let event = ecat_event::AL_STATUS;
        self.memory
            .set_with_event(register::AL_STATUS, control & MIRRORED, event);
    }

    /// Firmware reads AL control and answers later.
    pub(super) fn poll_al_control(&mut self, now: u64) {
        let Some(request) = self.request.filter(|_| !self.faults.hung) else {
            return;
        };
        if now >= request.read {
            self.memory.al_locked = false;
        }
        if now >= request.due {
            self.poll_state(&request, now);
        }
    }

    pub(super) fn show_state(&mut self, code: AlStatusCode, error: bool) {
        let state = self.state;
        self.memory
            .set(register::AL_STATUS_CODE, &code.0.to_le_bytes());
        let status = AlStatus { state, error }.raw();
        let event = ecat_event::AL_STATUS;
        self.memory
            .set_with_event(register::AL_STATUS, status, event);
    }

    /// Handles a due request in AL control.
    fn poll_state(&mut self, request: &Request, now: u64) {
        let control = self.memory.word(register::AL_CONTROL);
        let wanted = AlStatus::from_raw(control).state;
        let to_op = wanted == AlState::Op && self.state == AlState::SafeOp;
        if to_op && self.lacks_outputs() && now < request.expires {
            return;
        }
        self.request = None;
        self.memory.acknowledge(al_event::AL_CONTROL);
        self.change_state(control);
    }

    /// Answers a request in AL control.
    fn change_state(&mut self, control: u16) {
        let wanted = AlStatus::from_raw(control);
        let now = AlStatus::from_raw(self.memory.word(register::AL_STATUS));
        if now.error && !wanted.error && wanted.state != AlState::Init {
            return;
        }
        match self.check(wanted.state) {
            Ok(()) => {
                self.leave(wanted.state);
                self.state = wanted.state;
                if matches!(self.state, AlState::SafeOp | AlState::Op) {
                    self.channels.all().for_each(|channel| self.open(channel));
                }
                self.show_state(AlStatusCode(0), false);
            }
            Err(code) => self.show_state(code, true),
        }
    }

    /// Switches a SyncManager on from the slave's side, if it is off.
    fn open(&mut self, channel: usize) {
        if self.memory.sync_manager(channel).pdi & 1 != 0 {
            self.memory.disable(channel, false);
        }
    }

    /// Whether a state can be entered from the present one.
    fn check(&mut self, wanted: AlState) -> Result<(), AlStatusCode> {
        let level = |state: AlState| match state {
            AlState::Init => Some(0),
            AlState::PreOp => Some(1),
            AlState::SafeOp => Some(2),
            AlState::Op => Some(3),
            AlState::Boot | AlState::Other(_) => None,
        };
        if wanted == AlState::Boot {
            return self.check_boot();
        }
        if self.state == AlState::Boot && wanted != AlState::Init {
            return Err(AlStatusCode(0x0011));
        }
        if self.state == AlState::Boot {
            return Ok(());
        }
        let (Some(to), Some(from)) = (level(wanted), level(self.state)) else {
            return Err(AlStatusCode(0x0012));
        };
        let refused = self.faults.refused;
        if let Some((_, code)) = refused.filter(|(state, _)| *state == wanted) {
            return Err(code);
        }
        if to <= from {
            return Ok(());
        }
        if to > from + 1 {
            return Err(AlStatusCode(0x0011));
        }
        match wanted {
            AlState::PreOp => self.check_firmware().and_then(|()| self.check_mailboxes()),
            AlState::SafeOp => self.check_process_data(),
            AlState::Op => self.check_running(),
            AlState::Init | AlState::Boot | AlState::Other(_) => Ok(()),
        }?;
        self.application.enter(wanted, &self.setup())
    }

    /// The set-up by the master.
    fn setup(&self) -> Setup {
        let len = |number: usize| {
            let sm = self.memory.sync_manager(number);
            if sm.activate & 1 == 1 { sm.len } else { 0 }
        };
        let cycle = u32::from_le_bytes(self.memory.get(register::DC_SYNC0_CYCLE));
        let active = |bits: u8| self.clock.is_some() && self.activation & bits == bits;
        Setup {
            outputs: self.channels.outputs().map(len).sum(),
            inputs: self.channels.inputs().map(len).sum(),
            sync0: active(0x03).then_some(cycle),
            sync1: active(0x05),
        }
    }

    /// BOOT is entered from INIT, with the mailboxes for it.
    fn check_boot(&self) -> Result<(), AlStatusCode> {
        if self.files.is_none() {
            return Err(AlStatusCode(0x0013));
        }
        if let Some((_, code)) = self.faults.refused.filter(|(it, _)| *it == AlState::Boot) {
            return Err(code);
        }
        if !matches!(self.state, AlState::Init | AlState::Boot) {
            return Err(AlStatusCode(0x0011));
        }
        let own = self.config.sii.boot_mailbox();
        let own = [(own.receive, own.receive_len), (own.send, own.send_len)];
        for (number, own) in own.into_iter().enumerate() {
            let set = self.memory.sync_manager(number);
            if (set.start, set.len) != own || set.activate & 0x01 == 0 {
                return Err(AlStatusCode(0x0015));
            }
        }
        Ok(())
    }

    /// An update that did not end leaves nothing to start.
    fn check_firmware(&self) -> Result<(), AlStatusCode> {
        let server = self.files.as_ref();
        if server.is_some_and(|server| server.files.lock().incomplete) {
            return Err(AlStatusCode(0x0014));
        }
        Ok(())
    }

    /// SyncManagers 0 and 1 must match the SII.
    fn check_mailboxes(&self) -> Result<(), AlStatusCode> {
        if self.config.sii.mailbox_len == 0 {
            return Ok(());
        }
        let own = self.config.sii.sync_managers();
        for (number, own) in own.iter().take(2).enumerate() {
            let set = self.memory.sync_manager(number);
            // Direction and mode must match; the master chooses the events.
            let same = set.start == own.start
                && set.len == own.len
                && set.control & 0x0F == own.control & 0x0F
                && set.activate & 0x01 == 1;
            if !same {
                return Err(AlStatusCode(0x0016));
            }
        }
        Ok(())
    }

    fn check_process_data(&self) -> Result<(), AlStatusCode> {
        let own = self.config.sii.sync_managers();
        let outputs = self.channels.outputs().map(|number| (number, 0x001D));
        let inputs = self.channels.inputs().map(|number| (number, 0x001E));
        for (number, code) in outputs.chain(inputs) {
            let set = self.memory.sync_manager(number);
            let Some(own) = own.get(number) else {
                continue;
            };
            let enabled = set.activate & 0x01 == 1;
            let used = enabled && set.len > 0;
            // Without a mailbox the mapping is fixed.
            let len = if used { set.len } else { 0 };
            let fixed = self.config.sii.mailbox_len == 0 && len != own.len;
            let wrong = set.start != own.start || set.control & 0x0F != own.control & 0x0F;
            if (used && wrong) || fixed {
                return Err(AlStatusCode(code));
            }
        }
        self.check_sync()
    }

    fn check_sync(&self) -> Result<(), AlStatusCode> {
        let setup = self.setup();
        match setup.sync0 {
            None if self.config.needs_sync0 || self.activation & 0x06 != 0 => {
                Err(AlStatusCode(0x0030))
            }
            Some(cycle) if cycle < self.config.sync0_min => Err(AlStatusCode(0x0036)),
            _ => Ok(()),
        }
    }

    fn lacks_outputs(&self) -> bool {
        self.channels.outputs().any(|channel| {
            let outputs = self.memory.sync_manager(channel);
            outputs.is_enabled() && self.memory.outputs(channel).is_none()
        })
    }

    /// Outputs must have been received, and SYNC0 must be armed.
    fn check_running(&self) -> Result<(), AlStatusCode> {
        if self.lacks_outputs() {
            return Err(AlStatusCode(0x0019));
        }
        let pending = self.clock.as_ref().and_then(super::Clock::next_sync0);
        if self.activation & 0x03 == 0x03 && pending.is_none() {
            return Err(AlStatusCode(0x002D));
        }
        Ok(())
    }

    /// Ends the activities of the present state.
    pub(super) fn leave(&mut self, to: AlState) {
        if matches!(to, AlState::Init | AlState::PreOp) && !self.mirrors() {
            for channel in self.channels.all() {
                self.memory.disable(channel, true);
            }
            self.outputs_at = None;
        }
        if to == AlState::Init {
            self.post.reset();
            if let Some(files) = &mut self.files {
                files.reset();
            }
        }
        if to != AlState::Op {
            self.missed = 0;
        }
        if self.state != to {
            self.application.leave(self.state, to);
        }
    }
}
