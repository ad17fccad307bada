//! The frame of a cycle: its datagrams and the dispatch of the answers.

use std::time::Duration;

use super::event::Event;
use super::exchange::{Owner, Received, Sent};
use super::scan::{Phase, Scanned};
use super::unit::{Answer, Context, Request};
use super::{Exchange, Master, REFERENCE_SILENT, Sample, Unit};
use crate::{Address, Command};
use crate::{dc, register};

/// Longest read of a slave's state machine: a whole mailbox.
static ZEROS: [u8; 1486] = [0; 1486];
/// Acyclic datagrams per frame while the segment starts.
const STARTING: usize = 32;
/// Period in cycles at which the watch has priority over mailboxes.
const WATCH_EACH: u64 = 8;

impl Master {
    /// The frame to send now, behind its Ethernet header, into `to` (1,500 bytes); `None` if nothing is to be sent.
    ///
    /// Once [`Self::is_exchanging`], call it once per cycle; a frame that has not returned by then is lost. Before, it
    /// may be called at any time; a pending frame is awaited.
    pub fn poll_transmit(&mut self, now: Duration, to: &mut [u8]) -> Option<usize> {
        if self.exchange.is_open() {
            let due = self.exchange.sent_at() + self.config.frame_timeout;
            if !self.is_exchanging() && now < due {
                return None;
            }
        }
        self.handle_timeout(now);
        self.advance(now);
        let len = self.fill(now);
        self.exchange.finish(len, to)
    }

    /// Whether the wait for the pending frame is over.
    pub fn handle_timeout(&mut self, now: Duration) {
        let was_open = self.exchange.is_open();
        match self.exchange.close() {
            Received::Whole => self.dispatch(now),
            Received::Nothing | Received::Half if was_open => self.lost(now),
            Received::Nothing | Received::Half => {}
        }
    }

    /// Handles a frame, without its Ethernet header, received on a port (0, or 1 with redundancy) at `now`. Returns
    /// whether the answer of the cycle is complete.
    pub fn handle_frame(&mut self, port: usize, bytes: &[u8], now: Duration) -> bool {
        let whole = self.exchange.handle(port, bytes) == Received::Whole;
        if whole {
            self.dispatch(now);
        }
        whole
    }

    /// Whether the answer to a frame is pending.
    pub const fn awaits_frame(&self) -> bool {
        self.exchange.is_open()
    }

    /// When to call [`Self::poll_transmit`] next.
    pub fn poll_timeout(&self) -> Duration {
        let sent = self.exchange.sent_at();
        if self.is_exchanging() {
            sent + self.config.cycle
        } else if self.exchange.is_open() {
            sent + self.config.frame_timeout
        } else if self.scan.phase == Phase::Running {
            self.next_census
        } else {
            sent
        }
    }

    fn fill(&mut self, now: Duration) -> usize {
        let cyclic = self.is_exchanging();
        let running = self.scan.phase == Phase::Running;
        let census = running && (cyclic || now >= self.next_census);
        if census {
            self.next_census = now + self.config.cycle;
            self.cycles += 1;
        }
        self.check_reference();
        let Self {
            exchange,
            image,
            units,
            clock,
            scan,
            presence,
            config,
            started,
            turn,
            cycles,
            ..
        } = self;
        let mut batch = exchange.begin(now);
        if let Some(unit) = clock
            .slave
            .and_then(|slave| units.get(slave))
            .filter(|u| u.clock.locked)
        {
            // Slaves that are cut off from the reference, such as those behind the other end of an open ring, get the
            // expected time; the reference inserts its own.
            let predicted = clock.predict(now).unwrap_or(0).to_le_bytes();
            let address = Address::Device {
                adp: unit.station,
                ado: register::DC_SYSTEM_TIME,
            };
            // A reference of 32 bits has no higher half; none is sent to slaves that would compare it.
            let len = usize::from(unit.info.clock_bits() / 8);
            let predicted = predicted.get(..len).unwrap_or_default();
            batch.push(Owner::Clock, Command::Frmw, address, predicted);
        }
        if cyclic {
            image.send(&mut batch);
        }
        if census {
            let address = Address::Device {
                adp: 0,
                ado: register::AL_STATUS,
            };
            batch.push(Owner::Census, Command::Brd, address, &[0; 2]);
        }
        scan.send(&mut batch);
        if census {
            presence.send(units, &mut batch);
        }
        let most = if *started && cyclic {
            usize::from(config.acyclic.max(1))
        } else {
            STARTING
        };
        let watch_first = cycles.is_multiple_of(WATCH_EACH);
        let mut left = most;
        if census && watch_first {
            left -= usize::from(one(units, turn, &mut batch, true));
        }
        for _ in 0..units.len() {
            if left == 0 {
                break;
            }
            left -= usize::from(one(units, turn, &mut batch, false));
        }
        if census && left > 0 && !watch_first {
            one(units, turn, &mut batch, true);
        }
        batch.finish()
    }

    /// The frame is lost, and with it the answers to all its datagrams.
    fn lost(&mut self, now: Duration) {
        let Self {
            exchange,
            units,
            config,
            image,
            out,
            clock,
            ..
        } = self;
        let cx = context(exchange, now, None, clock.slave, config, image);
        for number in 0..exchange.len() {
            let Some(Owner::Unit(unit)) = exchange.sent(number).map(|sent| sent.owner) else {
                continue;
            };
            if let Some(unit) = units.get_mut(usize::from(unit)) {
                unit.handle(Answer::Lost, &cx, out);
            }
        }
        self.frame_lost();
    }

    /// Dispatches the answers.
    fn dispatch(&mut self, now: Duration) {
        let reference = self.take_time(now);
        let mut census = None;
        for number in 0..self.exchange.len() {
            let Some(sent) = self.exchange.sent(number) else {
                continue;
            };
            match sent.owner {
                Owner::Clock => {}
                Owner::Process(group) => self.take_process(group, &sent, now),
                Owner::Census => {
                    let (data, counter) = self.exchange.answer(&sent);
                    let states = data.first().copied().unwrap_or(0);
                    census = Some((counter, states));
                    self.handle_census(counter, states);
                }
                Owner::Inspection(_)
                | Owner::Survey(_)
                | Owner::Adoption(_)
                | Owner::Release(_) => {
                    self.take_presence(&sent, census, reference, now);
                }
                Owner::Scan => {
                    let (_, counter) = self.exchange.answer(&sent);
                    let counter = self.whole(counter);
                    match self.scan.handle(counter) {
                        Scanned::On => {}
                        Scanned::Addressed => self.addressed(now),
                        Scanned::Latched => self.latched(now),
                    }
                }
                Owner::Unit(unit) => self.take_unit(unit, &sent, reference, now),
            }
        }
        self.after_frame();
    }

    /// The number of slaves that answered the scan; zero, with an event, if a ring is open between them.
    fn whole(&mut self, counter: u16) -> u16 {
        let split = self.exchange.split();
        if self.scan.phase != Phase::Count || split.is_none() {
            return counter;
        }
        if self.scan.split != split {
            self.scan.split = split;
            let position = split.unwrap_or_default();
            self.out.event(Event::StartSplit { position });
        }
        0
    }

    /// The sample of the reference clock, if this frame passed it.
    fn take_time(&mut self, now: Duration) -> Option<u64> {
        let sent = self
            .exchange
            .sent(0)
            .filter(|sent| sent.owner == Owner::Clock)?;
        let (data, counter) = self.exchange.answer(&sent);
        let reference = self.clock.slave.and_then(|slave| self.units.get(slave));
        if counter == 0 || !reference.is_some_and(Unit::is_present) {
            return None;
        }
        self.clock.silent = 0;
        let sent_at = self.exchange.sent_at();
        let system_ns = if let Some(eight) = data.first_chunk() {
            u64::from_le_bytes(*eight)
        } else {
            // The configured time, until there is a sample.
            let epoch = self.config.clocks.epoch_ns;
            let sent = u64::try_from(sent_at.as_nanos()).unwrap_or(u64::MAX);
            let near = self.clock.predict(sent_at);
            let near = near.unwrap_or_else(|| epoch.wrapping_add(sent));
            dc::extended(u32::from_le_bytes(*data.first_chunk()?), near)
        };
        self.clock.last = Some(Sample {
            sent: sent_at,
            received: now,
            system_ns,
        });
        self.clock.fresh = true;
        Some(system_ns)
    }

    /// A reference that stopped answering is replaced after a while; one that was never present, as soon as it fails.
    fn check_reference(&mut self) {
        if self.scan.phase != Phase::Running {
            return;
        }
        if self.clock.last.is_some() {
            self.clock.silent = self.clock.silent.saturating_add(1);
            if self.clock.silent < REFERENCE_SILENT {
                return;
            }
        }
        let config = &self.config;
        let leads = |unit: &Unit| unit.can_lead(config);
        let slave = self.clock.slave.and_then(|slave| self.units.get(slave));
        if self.clock.last.is_some() || !slave.is_some_and(leads) {
            self.change_reference();
        }
    }

    /// The reference is lost: the next clock in the ring that still follows it becomes the reference. The followers
    /// then have the offset between the two, some microseconds. If no clock follows, none can be disturbed, and the
    /// first suitable clock becomes the reference.
    fn change_reference(&mut self) {
        let Self {
            config,
            units,
            ring,
            clock,
            out,
            ..
        } = self;
        let find = |holds: &dyn Fn(&Unit) -> bool| {
            let mut numbers = ring.iter().copied();
            numbers.find(|number| units.get(*number).is_some_and(holds))
        };
        let locked = find(&|unit| unit.is_running() && unit.clock.locked);
        let first = || find(&|unit| unit.can_lead(config));
        let Some(next) = locked.or_else(first) else {
            return;
        };
        if let Some(unit) = units.get_mut(next) {
            // A running clock is not set up again: its time is used unchanged.
            unit.clock.locked |= unit.is_running();
        }
        clock.silent = 0;
        if clock.slave != Some(next) {
            clock.slave = Some(next);
            out.event(Event::Reference { slave: next });
        }
    }

    fn take_process(&mut self, group: u8, sent: &Sent, now: Duration) {
        let Self {
            exchange,
            image,
            units,
            ..
        } = self;
        let (data, counter) = exchange.answer(sent);
        if !image.receive(group, sent.command, data, counter) {
            return;
        }
        let whole = image.settle(group, |slave, lrw| {
            units
                .get(slave)
                .map_or((0, 0), |unit| unit.contribution(lrw, now))
        });
        if whole {
            for unit in units.iter_mut().filter(|unit| unit.spec.group == group) {
                unit.take_part();
            }
        }
    }

    fn take_unit(&mut self, number: u16, sent: &Sent, reference: Option<u64>, now: Duration) {
        let Self {
            exchange,
            units,
            config,
            image,
            out,
            clock,
            ..
        } = self;
        let cx = context(exchange, now, reference, clock.slave, config, image);
        let (data, counter) = exchange.answer(sent);
        if let Some(unit) = units.get_mut(usize::from(number)) {
            unit.handle(Answer::Data { counter, data }, &cx, out);
        }
    }
}

pub(super) const fn context<'a>(
    exchange: &Exchange,
    now: Duration,
    reference_ns: Option<u64>,
    reference: Option<usize>,
    config: &'a super::MasterConfig,
    image: &'a super::Image,
) -> Context<'a> {
    Context {
        now,
        sent_at: exchange.sent_at(),
        reference_ns,
        reference,
        config,
        image,
    }
}

/// Adds the datagram of the next slave that has one to the frame; returns whether there was one.
fn one(
    units: &mut [Unit],
    turn: &mut usize,
    batch: &mut super::exchange::Batch<'_>,
    watch: bool,
) -> bool {
    for _ in 0..units.len() {
        *turn = (*turn + 1) % units.len().max(1);
        let Some(unit) = units.get_mut(*turn).filter(|unit| watch || unit.is_busy()) else {
            continue;
        };
        let (number, station, remaining) = (unit.number, unit.station, batch.remaining());
        let owner = Owner::Unit(u16::try_from(number).unwrap_or(u16::MAX));
        let (command, at, data) = match unit.request(watch) {
            Some(Request::Read { at, len }) => (
                Command::Fprd,
                at,
                ZEROS.get(..len.into()).unwrap_or_default(),
            ),
            Some(Request::Write { at, data }) => (Command::Fpwr, at, data),
            None => continue,
        };
        if data.len() > remaining {
            // It is sent in the next frame.
            continue;
        }
        let address = Address::Device {
            adp: station,
            ado: at,
        };
        if batch.push(owner, command, address, data) {
            unit.sent();
            return true;
        }
    }
    false
}
