//! One slave: which datagrams it acts on and what that adds to the working counter, its states,
//! its mailboxes, its watchdog and its SYNC0. What it is for is its [`Application`].

mod al;
mod chip;
mod eeprom;
mod faults;
mod logical;
mod mailbox;
mod sync;
mod times;

use crate::register;
use crate::{Address, AlState, AlStatusCode, Command};

use super::application::Application;
use super::clock::Clock;
use super::image::SiiImage;
use super::memory::{Memory, ecat_event};

pub use chip::{Chip, ClockUnit};
use eeprom::Eeprom;
pub use faults::SlaveFaults;
use mailbox::Post;
use times::Chance;
pub use times::{Span, Times};

/// When a frame passed the ports of a slave, segment time, ns.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Arrival {
    /// At the processing unit.
    pub(super) at: u64,
    /// At each port; `None` where nothing is plugged in.
    pub(super) ports: [Option<u64>; 4],
}

/// What a slave is like beside its SII.
#[derive(Clone, Debug)]
pub struct SlaveConfig {
    /// What its EEPROM says.
    pub sii: SiiImage,
    /// Its chip.
    pub chip: Chip,
    /// Its clock; `None` for a slave without distributed clock.
    pub clock: Option<Clock>,
    /// How long it takes for what.
    pub times: Times,
    /// How long it waits for outputs on the way to OP before it refuses, ns.
    pub op_wait: u64,
    /// Behind a message in its mailbox lies what was there before, rather than zeros.
    pub dirty_mailbox: bool,
    /// The counter of an answer in the mailbox is that of its request; what is sent unasked goes on from there.
    pub counters_follow: bool,
    /// How often it sends an Ethernet frame by its mailbox (EoE) once a master has given it an address, ns; `None` for
    /// a slave without EoE.
    pub eoe: Option<u64>,
    /// From a frame's arrival to its leaving by the next port, ns.
    pub forwarding: u64,
    /// After so many SYNC0 in a row without new outputs it leaves OP.
    pub sync_errors: u32,
    /// Whether it needs SYNC0 in OP.
    pub needs_sync0: bool,
    /// Shortest SYNC0 cycle that it accepts, ns.
    pub sync0_min: u32,
}

impl SlaveConfig {
    /// A slave with usual times, and a clock that begins at zero if the SII has one.
    #[must_use]
    pub fn new(sii: SiiImage) -> Self {
        Self {
            chip: Chip {
                clock: if sii.clock {
                    ClockUnit::Bits64
                } else {
                    ClockUnit::Absent
                },
                ..Chip::default()
            },
            clock: sii.clock.then(|| Clock::new(0, 0)),
            sii,
            times: Times::default(),
            op_wait: 200_000_000,
            dirty_mailbox: false,
            counters_follow: false,
            eoe: None,
            forwarding: 300,
            sync_errors: 4,
            needs_sync0: false,
            sync0_min: 50_000,
        }
    }

    fn memory(&self) -> Memory {
        let chip = match self.clock {
            Some(_) => self.chip,
            None => Chip {
                clock: ClockUnit::Absent,
                ..self.chip
            },
        };
        Memory::new(chip, self.times.al_read.is_some(), self.dirty_mailbox)
    }
}

/// Which SyncManagers carry process data, by their kind in the SII.
#[derive(Clone, Copy, Debug)]
struct Channels {
    kinds: [u8; 8],
}

impl Channels {
    fn new(sii: &SiiImage) -> Self {
        let mut kinds = [0; 8];
        for (kind, sm) in kinds.iter_mut().zip(sii.sync_managers()) {
            *kind = sm.kind;
        }
        Self { kinds }
    }

    fn of(self, wanted: u8) -> impl Iterator<Item = usize> {
        let kinds = self.kinds.into_iter().enumerate();
        kinds.filter_map(move |(number, kind)| (kind == wanted).then_some(number))
    }

    fn outputs(self) -> impl Iterator<Item = usize> {
        self.of(3)
    }

    fn inputs(self) -> impl Iterator<Item = usize> {
        self.of(4)
    }

    fn all(self) -> impl Iterator<Item = usize> {
        self.outputs().chain(self.inputs())
    }
}

/// A request in AL control that is being worked on, times in ns.
#[derive(Clone, Copy, Debug)]
struct Request {
    /// When the firmware reads it, so that AL control takes the next.
    read: u64,
    due: u64,
    expires: u64,
}

/// An emulated slave.
#[derive(Debug)]
pub struct Slave {
    config: SlaveConfig,
    application: Box<dyn Application>,
    memory: Memory,
    eeprom: Eeprom,
    clock: Option<Clock>,
    state: AlState,
    request: Option<Request>,
    faults: SlaveFaults,
    post: Post,
    chance: Chance,
    channels: Channels,
    /// When outputs last came; `None` before the first.
    heard: Option<u64>,
    /// The watchdog of the process data has expired.
    expired: bool,
    /// When the application last ran.
    ran: u64,
    fresh: bool,
    /// SYNC0 without outputs in a row.
    missed: u32,
    /// DC activation as it was when it was last looked at.
    activation: u8,
    inputs: Vec<u8>,
    /// Outputs that the application takes, whole.
    outputs: Vec<u8>,
    scratch: Vec<u8>,
}

impl Slave {
    /// A slave whose power has just come on.
    #[must_use]
    pub fn new(config: SlaveConfig, application: Box<dyn Application>) -> Self {
        let mut slave = Self {
            eeprom: Eeprom::new(config.sii.encode()),
            memory: config.memory(),
            chance: Chance(u64::from(config.sii.identity.product)),
            channels: Channels::new(&config.sii),
            expired: false,
            clock: config.clock.clone(),
            config,
            application,
            state: AlState::Init,
            request: None,
            faults: SlaveFaults::default(),
            post: Post::default(),
            heard: None,
            ran: 0,
            fresh: false,
            missed: 0,
            activation: 0,
            inputs: Vec::new(),
            outputs: Vec::new(),
            scratch: Vec::new(),
        };
        slave.power_on(0);
        slave
    }

    /// Power goes off and on: all registers are as from the factory, the clock begins anew.
    pub fn power_on(&mut self, now: u64) {
        self.memory = self.config.memory();
        self.clock.clone_from(&self.config.clock);
        if let Some(clock) = &mut self.clock {
            clock.restart(now);
        }
        self.state = AlState::Init;
        self.request = None;
        self.post.restart();
        self.eeprom.reset();
        (self.fresh, self.missed, self.activation) = (false, 0, 0);
        (self.heard, self.ran, self.expired) = (None, now, false);
        self.application.reset();
        self.set_registers();
        self.leave(AlState::Init);
        self.tell_state(AlStatusCode(0), false);
    }

    /// Registers as the factory and the SII say.
    fn set_registers(&mut self) {
        let chip = &self.config.chip;
        let dc = self.config.clock.is_some();
        let [low, high] = chip.feature_bits(!self.has_no_lrw()).to_le_bytes();
        let [build, build_high] = chip.build.to_le_bytes();
        let information = [
            chip.kind,
            chip.revision,
            build,
            build_high,
            chip.fmmus,
            chip.sync_managers,
            chip.ram_kib,
            chip.ports.unwrap_or(0x0F),
            low,
            high,
        ];
        self.memory.set(register::INFORMATION, &information);
        for (port, unused) in (0..).zip(chip.unused_times.chunks(1).cycle().take(16)) {
            self.memory.set(register::DC_RECEIVE_TIMES + port, unused);
        }
        let words = [
            (register::WATCHDOG_DIVIDER, 0x09C2_u16),
            (0x0410, 1000),
            (register::WATCHDOG_PROCESS_DATA, 1000),
            (register::WATCHDOG_STATUS, 1),
        ];
        for (at, word) in words {
            self.memory.set(at, &word.to_le_bytes());
        }
        if dc {
            self.memory
                .set(register::DC_SPEED_START, &0x1000_u16.to_le_bytes());
            self.memory.set(register::DC_FILTERS, &[4, 12]);
        }
        self.load_configuration();
    }

    /// Its state.
    #[must_use]
    pub const fn state(&self) -> AlState {
        self.state
    }

    /// Its firmware.
    #[must_use]
    pub fn application(&mut self) -> &mut dyn Application {
        &mut *self.application
    }

    /// Its clock.
    pub const fn clock(&mut self) -> Option<&mut Clock> {
        self.clock.as_mut()
    }

    /// How it is.
    #[must_use]
    pub const fn config(&self) -> &SlaveConfig {
        &self.config
    }

    /// What is wrong with it.
    pub const fn faults(&mut self) -> &mut SlaveFaults {
        &mut self.faults
    }

    /// Makes it refuse a state with a code from now on, or no longer.
    pub const fn refuse(&mut self, refused: Option<(AlState, AlStatusCode)>) {
        self.faults.refused = refused;
    }

    /// What its EEPROM holds; writes of the master change it.
    #[must_use]
    pub fn eeprom(&self) -> &[u8] {
        self.eeprom.bytes()
    }

    /// Changes its EEPROM: a wrong identity, a broken checksum. The change holds from the next
    /// power-on or reload on for what is loaded then.
    pub const fn eeprom_mut(&mut self) -> &mut Vec<u8> {
        self.eeprom.bytes_mut()
    }

    /// The same with firmware of its own, that checks what is asked of it and answers AL control; couplers and terminals
    /// have none unless they get it.
    #[must_use]
    pub fn with_firmware(mut self) -> Self {
        self.config.sii.device_emulation = false;
        if let Some(layout) = &mut self.config.sii.layout {
            layout.configuration &= !0x0100;
        }
        *self.eeprom.bytes_mut() = self.config.sii.encode();
        self.power_on(0);
        self
    }

    /// Gives it another name, whose first word is its order code. Its EEPROM is as new; the change holds from the next
    /// power-on on.
    pub fn rename(&mut self, name: &str) {
        let sii = &mut self.config.sii;
        name.clone_into(&mut sii.name);
        name.split(' ')
            .next()
            .unwrap_or_default()
            .clone_into(&mut sii.order);
        *self.eeprom.bytes_mut() = sii.encode();
    }

    /// Makes it fall back to a state with a code, as an error of its own does.
    pub fn fall(&mut self, state: AlState, code: AlStatusCode) {
        self.leave(state);
        if !self.mirrors() {
            for channel in self.channels.outputs() {
                self.memory.disable(channel, true);
            }
        }
        self.state = state;
        self.tell_state(code, true);
    }

    const fn has_no_lrw(&self) -> bool {
        self.config.sii.flags & 0x02 != 0
    }

    /// Whether a loop is closed by hand (DL control): nothing goes out by that port.
    pub(super) fn is_closed(&self, port: usize) -> bool {
        let [_, loops, ..] = self.memory.get::<4>(register::DL_CONTROL);
        loops >> (2 * port) & 3 == 3
    }

    /// Says which ports have a link, and which loops are closed; all others have nothing.
    pub(super) fn set_links(&mut self, links: [bool; 4]) {
        let mut status = u16::from(self.config.chip.dl_status);
        for (port, link) in links.into_iter().enumerate() {
            status |= u16::from(link) << (4 + port);
            let closed = 8 + 2 * port;
            status |= 1
                << if link && !self.is_closed(port) {
                    closed + 1
                } else {
                    closed
                };
        }
        let event = ecat_event::DL_STATUS;
        self.memory.set_told(register::DL_STATUS, status, event);
    }

    /// Says which ports there are, as types: 3 MII, 2 E-bus, 0 none.
    pub(super) fn set_ports(&mut self, ports: u8) {
        let ports = self.config.chip.ports.unwrap_or(ports);
        self.memory.set(0x0007, &[ports]);
    }

    /// A frame was broken at a port.
    pub(super) fn count_bad_frame(&mut self, port: u16, forwarded: bool) {
        let at = if forwarded {
            0x0308 + port
        } else {
            0x0300 + 2 * port
        };
        self.memory.count(at);
    }

    /// A frame's lengths contradicted each other.
    pub(super) fn count_bad_length(&mut self) {
        self.memory.count(0x030C);
    }

    /// A link at a port was lost.
    pub(super) fn count_lost_link(&mut self, port: u16) {
        self.memory.count(register::LOST_LINKS + port);
    }

    /// Acts on a datagram; returns what its working counter gains.
    pub(super) fn execute(
        &mut self,
        command: Command,
        address: &mut Address,
        irq: &mut u16,
        data: &mut [u8],
        arrival: &Arrival,
    ) -> u16 {
        let gained = match address {
            Address::Logical(logical) => match command {
                Command::Lrd => self.logical(*logical, data, true, false),
                Command::Lwr => self.logical(*logical, data, false, true),
                Command::Lrw if !self.has_no_lrw() => self.logical(*logical, data, true, true),
                Command::Lrw
                | Command::Nop
                | Command::Aprd
                | Command::Apwr
                | Command::Aprw
                | Command::Fprd
                | Command::Fpwr
                | Command::Fprw
                | Command::Brd
                | Command::Bwr
                | Command::Brw
                | Command::Armw
                | Command::Frmw
                | Command::Other(_) => 0,
            },
            Address::Device { adp, ado } => {
                let here = *adp == 0;
                let known = self.is_addressed(*adp);
                let (reads, writes) = match command {
                    Command::Aprd => (here, false),
                    Command::Apwr => (false, here),
                    Command::Aprw => (here, here),
                    Command::Fprd => (known, false),
                    Command::Fpwr => (false, known),
                    Command::Fprw => (known, known),
                    Command::Brd => (true, false),
                    Command::Bwr => (false, true),
                    Command::Brw => (true, true),
                    Command::Armw => (here, !here),
                    Command::Frmw => (known, !known),
                    Command::Nop
                    | Command::Lrd
                    | Command::Lwr
                    | Command::Lrw
                    | Command::Other(_) => (false, false),
                };
                let broad = matches!(command, Command::Brd | Command::Brw);
                let gained = self.physical(*ado, data, reads, writes, broad, arrival);
                if command.is_positional() {
                    *adp = adp.wrapping_add(1);
                }
                gained
            }
        };
        self.act(arrival);
        *irq |= self.memory.irq();
        gained
    }

    fn is_addressed(&self, adp: u16) -> bool {
        let aliased = self.memory.get::<4>(register::DL_CONTROL)[3] & 1 != 0;
        adp == self.memory.word(register::STATION_ADDRESS)
            || (aliased && adp == self.memory.word(register::STATION_ALIAS))
    }

    fn physical(
        &mut self,
        at: u16,
        data: &mut [u8],
        reads: bool,
        writes: bool,
        broad: bool,
        arrival: &Arrival,
    ) -> u16 {
        if !reads && !writes {
            return 0;
        }
        self.refresh(at, data.len(), arrival);
        let mut gained = 0;
        let mut scratch = std::mem::take(&mut self.scratch);
        scratch.clear();
        scratch.extend_from_slice(data);
        if reads {
            let (found, incoming) = (data, &mut scratch);
            // What came in is written, what was there goes out.
            if self.memory.read(at, found) {
                gained += 1;
                if broad {
                    for (to, from) in found.iter_mut().zip(incoming.iter()) {
                        *to |= from;
                    }
                }
            }
        }
        if writes && self.memory.write(at, &scratch) {
            gained += if reads { 2 } else { 1 };
        }
        self.scratch = scratch;
        gained
    }

    /// What follows at once from what a datagram wrote.
    fn act(&mut self, arrival: &Arrival) {
        let events = std::mem::take(&mut self.memory.events);
        if events.al_control {
            self.al_control_written(arrival.at);
        }
        if events.sii {
            self.begin_sii(arrival.at);
        }
        if events.outputs {
            self.heard = Some(arrival.at);
            self.fresh = true;
        }
        if events.repeat && !self.faults.no_repeat {
            self.memory.repeat(1);
        }
        self.clock_written(&events, arrival);
    }

    /// What the firmware does between frames. To be called before each frame.
    pub(super) fn poll(&mut self, now: u64) {
        self.poll_al_control(now);
        self.poll_sii(now);
        if matches!(self.state, AlState::PreOp | AlState::SafeOp | AlState::Op) {
            self.poll_mailbox(now);
        }
        match self.state {
            AlState::SafeOp | AlState::Op => self.poll_process_data(now),
            AlState::Init | AlState::PreOp | AlState::Boot | AlState::Other(_) => self.idle(now),
        }
    }
}
