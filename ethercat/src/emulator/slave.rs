//! One slave: execution of datagrams and working counter, states, mailboxes, watchdog and SYNC0. Its function is its
//! [`Application`].

mod al;
mod chip;
mod eeprom;
mod ethernet;
mod faults;
mod file;
mod logical;
mod mailbox;
mod sync;
mod times;

use takt_link::Random;

use crate::register;
use crate::{Address, AlState, AlStatusCode, Command};

use super::application::Application;
use super::clock::Clock;
use super::image::SiiImage;
use super::memory::{Memory, ecat_event};

pub use chip::{Chip, ClockUnit};
use eeprom::Eeprom;
use ethernet::Station;
pub use ethernet::{EthernetFaults, EthernetPort, EthernetState};
pub use faults::SlaveFaults;
use file::FileServer;
pub use file::{FileStore, Files};
use mailbox::Post;
pub use times::{Span, Times};

/// When a frame passed the ports of a slave, segment time, ns.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Arrival {
    /// At the processing unit.
    pub(super) at: u64,
    /// At each port; `None` where nothing is plugged in.
    pub(super) ports: [Option<u64>; 4],
}

/// Configuration of a slave.
#[derive(Clone, Debug)]
pub struct SlaveConfig {
    /// The content of its EEPROM.
    pub sii: SiiImage,
    /// Its chip.
    pub chip: Chip,
    /// Its clock; `None` for a slave without distributed clock.
    pub clock: Option<Clock>,
    /// Its processing times.
    pub times: Times,
    /// Timeout for outputs before it refuses OP, ns.
    pub op_wait: u64,
    /// Stale bytes rather than zeros follow a message in its mailbox.
    pub dirty_mailbox: bool,
    /// The counter of a mailbox answer is that of its request; unsolicited messages continue from there.
    pub counters_follow: bool,
    /// Period at which it sends an Ethernet frame by its mailbox (EoE) on its own, once a master has set its address, ns;
    /// `None` for a slave that does not.
    pub eoe: Option<u64>,
    /// Forwarding delay of a frame, ns.
    pub forwarding: u64,
    /// Number of consecutive SYNC0 without new outputs after which it leaves OP.
    pub sync_errors: u32,
    /// Whether it needs SYNC0 in OP.
    pub needs_sync0: bool,
    /// Shortest accepted SYNC0 cycle, ns.
    pub sync0_min: u32,
}

impl SlaveConfig {
    /// A slave with typical times, and a clock that starts at zero if the SII has one.
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

/// A request in AL control in progress, times in ns.
#[derive(Clone, Copy, Debug)]
struct Request {
    /// When the firmware reads it, so that AL control accepts the next.
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
    /// `None` for a slave without FoE, which has no BOOT either.
    files: Option<FileServer>,
    /// `None` for a slave without EoE.
    station: Option<Station>,
    random: Random,
    channels: Channels,
    /// Time of the last outputs; `None` before the first.
    outputs_at: Option<u64>,
    /// The watchdog of the process data has expired.
    expired: bool,
    /// Time at which the application last ran.
    ran: u64,
    fresh: bool,
    /// Consecutive SYNC0 without outputs.
    missed: u32,
    /// DC activation at the last check.
    activation: u8,
    inputs: Vec<u8>,
    /// Buffer for the outputs of the application.
    outputs: Vec<u8>,
    scratch: Vec<u8>,
}

impl Slave {
    /// A slave after power-on.
    pub fn new(config: SlaveConfig, application: Box<dyn Application>) -> Self {
        let files = config.sii.speaks_foe().then(FileServer::default);
        let station = config.sii.speaks_eoe().then(Station::default);
        let mut slave = Self {
            eeprom: Eeprom::new(config.sii.encode()),
            memory: config.memory(),
            random: Random::new(config.sii.identity.product.into()),
            channels: Channels::new(&config.sii),
            expired: false,
            clock: config.clock.clone(),
            config,
            application,
            state: AlState::Init,
            request: None,
            faults: SlaveFaults::default(),
            post: Post::default(),
            files,
            station,
            outputs_at: None,
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

    /// Power cycle: all registers have their defaults, the clock restarts.
    pub fn power_on(&mut self, now: u64) {
        self.memory = self.config.memory();
        self.clock.clone_from(&self.config.clock);
        if let Some(clock) = &mut self.clock {
            clock.restart(now);
        }
        self.state = AlState::Init;
        self.request = None;
        self.post.reset();
        if let Some(station) = &mut self.station {
            station.power_on();
        }
        self.eeprom.reset();
        (self.fresh, self.missed, self.activation) = (false, 0, 0);
        (self.outputs_at, self.ran, self.expired) = (None, now, false);
        self.application.reset();
        self.set_registers();
        self.leave(AlState::Init);
        self.show_state(AlStatusCode(0), false);
    }

    /// Sets registers to their defaults and to the SII.
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

    /// Its configuration.
    pub const fn config(&self) -> &SlaveConfig {
        &self.config
    }

    /// Its faults.
    pub const fn faults(&mut self) -> &mut SlaveFaults {
        &mut self.faults
    }

    /// Makes it refuse a state with a code from now on, or ends that.
    pub const fn refuse(&mut self, refused: Option<(AlState, AlStatusCode)>) {
        self.faults.refused = refused;
    }

    /// The content of its EEPROM; writes of the master change it.
    pub fn eeprom(&self) -> &[u8] {
        self.eeprom.bytes()
    }

    /// Changes its EEPROM: a wrong identity, a broken checksum. Values that are loaded at power-on or reload change
    /// then.
    pub const fn eeprom_mut(&mut self) -> &mut Vec<u8> {
        self.eeprom.bytes_mut()
    }

    /// The same with firmware of its own, that checks state requests and answers AL control; couplers and terminals
    /// have none by default.
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

    /// The same with FoE, BOOT and mailboxes of other lengths there. Its EEPROM is reset.
    #[must_use]
    pub fn with_files(mut self) -> Self {
        self.config.sii.files = true;
        *self.eeprom.bytes_mut() = self.config.sii.encode();
        self.files = Some(FileServer::default());
        self.power_on(0);
        self
    }

    /// Its files; `None` without FoE.
    pub fn files(&self) -> Option<Files> {
        self.files.as_ref().map(|server| server.files.clone())
    }

    /// The same with EoE: an Ethernet port that answers ARP, ping and UDP echo (port 7) once a master has set its
    /// addresses. Its EEPROM is reset.
    #[must_use]
    pub fn with_ethernet(mut self) -> Self {
        self.config.sii.ethernet = true;
        *self.eeprom.bytes_mut() = self.config.sii.encode();
        self.station = Some(Station::default());
        self.power_on(0);
        self
    }

    /// Its Ethernet port; `None` without EoE.
    pub fn ethernet(&self) -> Option<EthernetPort> {
        self.station.as_ref().map(|station| station.port.clone())
    }

    /// Gives it another name, whose first word is its order code. Its EEPROM is reset; the change takes effect at the
    /// next power-on.
    pub fn rename(&mut self, name: &str) {
        let sii = &mut self.config.sii;
        name.clone_into(&mut sii.name);
        name.split(' ')
            .next()
            .unwrap_or_default()
            .clone_into(&mut sii.order);
        *self.eeprom.bytes_mut() = sii.encode();
    }

    /// Makes it fall back to a state with a code, as an internal error does.
    pub fn fall(&mut self, state: AlState, code: AlStatusCode) {
        self.leave(state);
        if !self.mirrors() {
            for channel in self.channels.outputs() {
                self.memory.disable(channel, true);
            }
        }
        self.state = state;
        self.show_state(code, true);
    }

    const fn has_no_lrw(&self) -> bool {
        self.config.sii.flags & 0x02 != 0
    }

    /// Whether a loop is closed by DL control: nothing is sent by that port.
    pub(super) fn is_closed(&self, port: usize) -> bool {
        let [_, loops, ..] = self.memory.get::<4>(register::DL_CONTROL);
        loops >> (2 * port) & 3 == 3
    }

    /// Sets which ports have a link, and which loops are closed; all others have no link.
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
        self.memory
            .set_with_event(register::DL_STATUS, status, event);
    }

    /// Sets the port types: 3 MII, 2 E-bus, 0 none.
    pub(super) fn set_ports(&mut self, ports: u8) {
        let ports = self.config.chip.ports.unwrap_or(ports);
        self.memory.set(0x0007, &[ports]);
    }

    /// A corrupted frame was received at a port.
    pub(super) fn count_bad_frame(&mut self, port: u16, forwarded: bool) {
        let at = if forwarded {
            0x0308 + port
        } else {
            0x0300 + 2 * port
        };
        self.memory.count(at);
    }

    /// A frame had inconsistent lengths.
    pub(super) fn count_bad_length(&mut self) {
        self.memory.count(0x030C);
    }

    /// A link at a port was lost.
    pub(super) fn count_lost_link(&mut self, port: u16) {
        self.memory.count(register::LOST_LINKS + port);
    }

    /// Executes a datagram; returns the increment of its working counter.
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
            // The received data is written, the previous content is returned.
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

    /// Immediate effects of a datagram's writes.
    fn act(&mut self, arrival: &Arrival) {
        let events = std::mem::take(&mut self.memory.events);
        if events.al_control {
            self.al_control_written(arrival.at);
        }
        if events.sii {
            self.begin_sii(arrival.at);
        }
        if events.outputs {
            self.outputs_at = Some(arrival.at);
            self.fresh = true;
        }
        if events.repeat && !self.faults.no_repeat {
            self.memory.repeat(1);
        }
        self.clock_written(&events, arrival);
    }

    /// Runs the firmware between frames. Call it before each frame.
    pub(super) fn poll(&mut self, now: u64) {
        self.poll_al_control(now);
        self.poll_sii(now);
        if !matches!(self.state, AlState::Init | AlState::Other(_)) {
            self.poll_mailbox(now);
        }
        match self.state {
            AlState::SafeOp | AlState::Op => self.poll_process_data(now),
            AlState::Init | AlState::PreOp | AlState::Boot | AlState::Other(_) => self.idle(now),
        }
    }
}
