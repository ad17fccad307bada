//! Presence of slaves. Each cycle's census (how many answered, and the OR of their states) is compared with the known
//! slaves; if they differ, all are inspected one by one, lost slaves are reported with the cable before them, and
//! slaves without address get one. The slave's own state machine then brings it back.
//!
//! ```text
//!        1 census differs            2 all inspected, count exceeds answers
//! Calm -------------------> Inspect --------------------------> Survey --> 3 Adopt: gets its address back
//!   ^ 4 as known, or pause     |                                   |
//!   +--------------------------+-----------------------------------+
//! ```

use std::time::Duration;

use super::Master;
use super::event::{Cable, Event, Fault};
use super::exchange::{Batch, Owner, Sent};
use super::scan::{Phase, Scan};
use super::transmit::context;
use super::unit::{Step, Unit};
use crate::config::Location;
use crate::register;
use crate::{Address, AlStatusCode, Command};

/// Slaves inspected in one frame.
const INSPECTED_MAX: usize = 16;
/// Cycles between rounds of inspections without a change.
const PAUSE: u8 = 16;
/// Consecutive inspections that a slave may leave unanswered while the census is complete.
const SILENT: u8 = 3;

/// The present activity.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum State {
    #[default]
    Calm,
    /// All slaves are inspected, this one next.
    Inspect(usize),
    /// All positions are read, this one next.
    Survey(u16),
    /// Give the slave at this position the address of this one.
    Adopt(u16, usize),
    /// The slave at this position is not this one after all: clear its address.
    Release(u16, usize),
}

/// Known presence of slaves.
#[derive(Debug, Default)]
pub(super) struct Presence {
    state: State,
    /// Number of unexpected slaves.
    strangers: u16,
    /// Unexpected slaves of the current survey.
    strange: u16,
    /// The last slave found in the survey.
    met: Option<usize>,
    /// The next slave to adopt.
    found: Option<(u16, usize)>,
    /// Position of each slave at start.
    homes: Vec<Option<u16>>,
    /// Consecutive unanswered inspections of each slave.
    silent: Vec<u8>,
    /// The count of the last census, and of the one before it.
    counted: u16,
    pause: u8,
    /// Slaves that a returning one turned out not to be; they are not matched again until a slave is lost.
    rejected: Vec<bool>,
    /// Slaves whose cable was reported, until they are back.
    reported: Vec<bool>,
    /// An ambiguous position was reported.
    unplaced: bool,
    /// A slave was lost in this frame.
    newly_lost: bool,
    frames_lost: u8,
    /// The ring is open before this position.
    open: Option<u16>,
}

impl Presence {
    pub(super) fn set_homes(&mut self, ring: &[usize], slaves: usize) {
        self.homes = vec![None; slaves];
        self.silent = vec![0; slaves];
        self.reported = vec![false; slaves];
        self.rejected = vec![false; slaves];
        for (position, number) in (0..).zip(ring) {
            if let Some(home) = self.homes.get_mut(*number) {
                *home = Some(position);
            }
        }
    }

    fn is_back(&mut self, slave: usize) {
        if let Some(reported) = self.reported.get_mut(slave) {
            *reported = false;
        }
    }

    /// Adds the due inspections to the frame.
    pub(super) fn send(&mut self, units: &[Unit], batch: &mut Batch<'_>) {
        match self.state {
            State::Calm => {}
            State::Inspect(from) => {
                let mut at = from;
                let mut inspected = 0;
                while let Some(unit) = units
                    .get(at)
                    .filter(|_| inspected < INSPECTED_MAX && batch.remaining() >= 6)
                {
                    let owner = Owner::Inspection(u16::try_from(at).unwrap_or(u16::MAX));
                    let address = Address::Device {
                        adp: unit.station,
                        ado: register::AL_STATUS,
                    };
                    batch.push(owner, Command::Fprd, address, &[0; 6]);
                    at += 1;
                    inspected += 1;
                }
                self.state = State::Inspect(at);
            }
            State::Survey(from) => {
                let end = self.counted.min(from.saturating_add(16));
                let mut at = from;
                while at < end && batch.remaining() >= 4 {
                    let address = Scan::position(at, register::STATION_ADDRESS);
                    batch.push(Owner::Survey(at), Command::Aprd, address, &[0; 4]);
                    at += 1;
                }
                self.state = State::Survey(at);
            }
            State::Release(position, slave) => {
                let address = Scan::position(position, register::STATION_ADDRESS);
                let owner = Owner::Release(u16::try_from(slave).unwrap_or(u16::MAX));
                batch.push(owner, Command::Apwr, address, &[0; 2]);
            }
            State::Adopt(position, slave) => {
                let Some(unit) = units.get(slave) else {
                    return;
                };
                let address = Scan::position(position, register::STATION_ADDRESS);
                let owner = Owner::Adoption(u16::try_from(slave).unwrap_or(u16::MAX));
                batch.push(owner, Command::Apwr, address, &unit.station.to_le_bytes());
            }
        }
    }
}

impl Master {
    /// A returning slave is not the one it was matched with.
    fn reject(&mut self) {
        let wrong = |unit: &&Unit| {
            let other_identity = matches!(unit.recovery.fault, Some(Fault::Identity { .. }));
            other_identity && unit.step() == Step::Failed
        };
        let found = self
            .units
            .iter()
            .find(wrong)
            .and_then(|unit| Some((unit.position?, unit.number)));
        if let Some((position, slave)) = found {
            self.presence.state = State::Release(position, slave);
        }
    }

    fn released(&mut self, slave: usize) {
        self.presence.state = State::Calm;
        if let (Some(unit), Some(rejected)) = (
            self.units.get_mut(slave),
            self.presence.rejected.get_mut(slave),
        ) {
            unit.release();
            *rejected = true;
        }
    }

    /// Handles the census: how many answered, and the OR of their states.
    pub(super) fn handle_census(&mut self, count: u16, states: u8) {
        self.presence.counted = count;
        if self.presence.state != State::Calm {
            return;
        }
        let present = || self.units.iter().filter(|unit| unit.is_present());
        let strangers = self.presence.strangers;
        let known = present().count() + usize::from(strangers);
        let expected = present()
            .map(|unit| unit.status.shown)
            .fold(u8::from(strangers > 0), |or, state| or | state);
        if usize::from(count) == known && states & 0x1F == expected {
            self.presence.pause = 0;
            self.presence.unplaced &= strangers > 0;
            return;
        }
        // Fewer than known is urgent; an unchanged count is checked only once in a while.
        let fewer = usize::from(count) < known;
        if fewer {
            self.presence.rejected.fill(false);
        }
        if self.presence.pause > 0 && !fewer {
            self.presence.pause -= 1;
            return;
        }
        self.presence.state = State::Inspect(0);
    }

    /// Handles the answer to a datagram of [`Presence::send`].
    pub(super) fn take_presence(
        &mut self,
        sent: &Sent,
        census: Option<(u16, u8)>,
        reference: Option<u64>,
        now: Duration,
    ) {
        let (data, counter) = self.exchange.answer(sent);
        let mut four = [0; 6];
        for (to, from) in four.iter_mut().zip(data) {
            *to = *from;
        }
        match sent.owner {
            Owner::Inspection(slave) => {
                self.inspected(slave.into(), counter, four, census, reference, now);
            }
            Owner::Survey(position) if counter > 0 => self.surveyed(position, four),
            Owner::Adoption(slave) => self.adopted(slave.into(), counter, reference, now),
            Owner::Release(slave) => self.released(slave.into()),
            Owner::Survey(_)
            | Owner::Clock
            | Owner::Process(_)
            | Owner::Census
            | Owner::Scan
            | Owner::Unit(_) => {}
        }
    }

    fn inspected(
        &mut self,
        slave: usize,
        counter: u16,
        bytes: [u8; 6],
        census: Option<(u16, u8)>,
        reference: Option<u64>,
        now: Duration,
    ) {
        let Self {
            exchange,
            units,
            config,
            image,
            out,
            clock,
            presence,
            ..
        } = self;
        let cx = context(exchange, now, reference, clock.slave, config, image);
        let present = units.iter().filter(|unit| unit.is_present()).count();
        let (Some(unit), Some(silent)) = (units.get_mut(slave), presence.silent.get_mut(slave))
        else {
            return;
        };
        if counter > 0 {
            *silent = 0;
            let [a, b, _, _, c, d] = bytes;
            let code = AlStatusCode(u16::from_le_bytes([c, d]));
            if unit.is_present() {
                unit.seen(u16::from_le_bytes([a, b]), code, &cx, out);
            } else if let Some(home) = presence.homes.get(slave).copied().flatten() {
                presence.is_back(slave);
                unit.returned(home, &cx, out);
            }
            return;
        }
        if !unit.is_present() {
            return;
        }
        *silent += 1;
        // If the census confirms the loss, once is enough; else the slave may have lost only its address.
        let fewer = census.is_some_and(|(count, _)| {
            usize::from(count) < present + usize::from(presence.strangers)
        });
        if fewer || *silent >= SILENT {
            *silent = 0;
            unit.lose(out);
            // A slave that only lost its address had a power interruption; its cables are good.
            presence.newly_lost |= fewer;
        }
    }

    /// Handles the address of the slave at a position.
    fn surveyed(&mut self, position: u16, bytes: [u8; 6]) {
        let [a, b, c, d, _, _] = bytes;
        let (station, alias) = (u16::from_le_bytes([a, b]), u16::from_le_bytes([c, d]));
        let known = self.units.iter_mut().find(|unit| unit.station == station);
        if let Some(unit) = known {
            self.presence.met = Some(unit.number);
            if unit.is_present() {
                unit.position = Some(position);
            }
            return;
        }
        match self.missing_at(alias) {
            Some(slave) if self.is_unclear(slave, alias) => {
                self.presence.strange += 1;
                self.unplaced(false);
            }
            Some(slave) if self.presence.found.is_none() => {
                self.presence.found = Some((position, slave));
            }
            // The next survey finds its position.
            Some(_) => {}
            None => {
                self.presence.strange += 1;
                if self.presence.strange > self.presence.strangers {
                    self.out.event(Event::UnexpectedSlave { position });
                }
            }
        }
    }

    /// Whether the detected slave may also be another missing one: of the same kind, without a distinct alias, and not
    /// all slaves are back, so that the order of the ring does not distinguish them. In a line the order is sufficient,
    /// as nothing behind a missing slave is reachable.
    fn is_unclear(&self, slave: usize, alias: u16) -> bool {
        let Some(unit) = self.units.get(slave) else {
            return false;
        };
        let known_by_alias = alias != 0
            && (unit.spec.location == Location::Alias(alias) || unit.info.alias == alias);
        let missing = || self.units.iter().filter(|unit| !unit.is_present());
        let alike = missing().filter(|other| kind(other) == kind(unit)).count();
        // Slaves of another kind that were never present are not awaited.
        let never = missing()
            .filter(|other| other.spec.optional && !other.is_known() && kind(other) != kind(unit))
            .count();
        let all_back = usize::from(self.presence.counted) + never >= self.units.len();
        let is_line = || {
            (1..self.topology.len())
                .all(|number| self.topology.parent(number) == Some((number - 1, 1)))
        };
        !known_by_alias && alike > 1 && !all_back && (self.config.redundant || !is_line())
    }

    /// Reports, once, that the position of a slave is ambiguous.
    fn unplaced(&mut self, ring: bool) {
        if !std::mem::replace(&mut self.presence.unplaced, true) {
            self.out.event(Event::Unplaced { ring });
        }
    }

    /// The missing slave that most likely matches one without address: by alias, or the next in the order of the ring.
    fn missing_at(&self, alias: u16) -> Option<usize> {
        let rejected = |unit: &Unit| self.presence.rejected.get(unit.number) == Some(&true);
        let missing = || {
            self.units
                .iter()
                .filter(|unit| !unit.is_present() && !rejected(unit))
        };
        let aliased = |unit: &&Unit| {
            alias != 0 && (unit.spec.location == Location::Alias(alias) || unit.info.alias == alias)
        };
        let after = self
            .presence
            .met
            .and_then(|met| self.presence.homes.get(met).copied().flatten());
        let home = |unit: &Unit| self.presence.homes.get(unit.number).copied().flatten();
        let plain = |unit: &&Unit| !matches!(unit.spec.location, Location::Alias(_));
        let next = || {
            missing()
                .filter(plain)
                .filter(|unit| home(unit) > after)
                .min_by_key(|unit| home(unit))
        };
        let any = || missing().find(plain);
        missing()
            .find(aliased)
            .or_else(next)
            .or_else(any)
            .map(|unit| unit.number)
    }

    /// A slave received its address again.
    fn adopted(&mut self, slave: usize, counter: u16, reference: Option<u64>, now: Duration) {
        let State::Adopt(position, _) = self.presence.state else {
            return;
        };
        self.presence.state = State::Calm;
        if counter == 0 {
            return;
        }
        let Self {
            exchange,
            units,
            config,
            image,
            out,
            clock,
            presence,
            ..
        } = self;
        let cx = context(exchange, now, reference, clock.slave, config, image);
        if let Some(unit) = units.get_mut(slave) {
            presence.is_back(slave);
            unit.returned(position, &cx, out);
        }
    }

    /// All answers of a frame are handled.
    pub(super) fn after_frame(&mut self) {
        // Also of a frame without census: losses with an answer in between are not consecutive.
        self.presence.frames_lost = 0;
        if self.scan.phase != Phase::Running {
            return;
        }
        self.go_on();
        if std::mem::take(&mut self.presence.newly_lost) {
            self.report_cables();
        }
        self.watch_ring();
    }

    fn go_on(&mut self) {
        let present = self.units.iter().filter(|unit| unit.is_present()).count();
        let count = self.presence.counted;
        match self.presence.state {
            State::Inspect(at) if at >= self.units.len() => {
                let unclear = self.presence.silent.iter().any(|silent| *silent > 0);
                self.presence.pause = if unclear { 0 } else { PAUSE };
                let more = usize::from(count) > present + usize::from(self.presence.strangers);
                if more && self.exchange.split().is_some() {
                    self.presence.state = State::Calm;
                    self.unplaced(true);
                } else if more {
                    (self.presence.state, self.presence.strange) = (State::Survey(0), 0);
                    (self.presence.met, self.presence.found) = (None, None);
                } else {
                    self.presence.state = State::Calm;
                    let left = usize::from(count).saturating_sub(present);
                    self.presence.strangers = self
                        .presence
                        .strangers
                        .min(u16::try_from(left).unwrap_or(0));
                }
            }
            State::Survey(at) if at >= count => {
                self.presence.strangers = self.presence.strange;
                let found = self.presence.found.take();
                self.presence.state = found.map_or(State::Calm, |(position, slave)| {
                    State::Adopt(position, slave)
                });
            }
            State::Calm => self.reject(),
            State::Inspect(_) | State::Survey(_) | State::Adopt(..) | State::Release(..) => {}
        }
    }

    /// Reports the cables before lost slaves whose parents are present.
    fn report_cables(&mut self) {
        for (position, number) in self.ring.iter().enumerate() {
            let lost = |number: usize| {
                self.units
                    .get(number)
                    .is_some_and(|unit| !unit.is_present())
            };
            let from = self.topology.parent(position);
            let above = from.and_then(|(parent, port)| Some((*self.ring.get(parent)?, port)));
            if !lost(*number) || above.is_some_and(|(parent, _)| lost(parent)) {
                continue;
            }
            let port = |port: usize| u8::try_from(port).unwrap_or(0);
            let cable = Cable {
                from: above.map(|(parent, at)| (parent, port(at))),
                to: Some(*number),
            };
            if let Some(reported @ false) = self.presence.reported.get_mut(*number) {
                *reported = true;
                self.out.event(Event::CableCut { cable });
            }
        }
    }

    /// A frame was lost.
    pub(super) fn frame_lost(&mut self) {
        self.presence.frames_lost = self.presence.frames_lost.saturating_add(1);
        // Its inspections are repeated.
        if self.scan.phase == Phase::Running {
            self.presence.state = State::Calm;
        }
        // More than that if the last phase of the start was silent too.
        if self.presence.frames_lost < self.config.lost_frames.max(1)
            || self.scan.phase != Phase::Running
        {
            return;
        }
        for unit in self.units.iter_mut().filter(|unit| unit.is_present()) {
            unit.lose(&mut self.out);
        }
        self.report_cables();
    }

    /// The cable at which a ring of two ports is open.
    fn watch_ring(&mut self) {
        if !self.config.redundant {
            return;
        }
        let (halves, [first, last]) = self.exchange.halves();
        let all = u16::try_from(self.ring.len()).unwrap_or(u16::MAX);
        let open = match (first, last) {
            (true, true) if self.exchange.is_complete() => (halves[0] > 0).then_some(halves[0]),
            (true, false) => Some(all),
            (false, true) => Some(0),
            (true, true) | (false, false) => return,
        };
        if open == self.presence.open {
            return;
        }
        self.presence.open = open;
        let event = self
            .ring_gap()
            .map_or(Event::RingClosed, |cable| Event::RingOpen { cable });
        self.out.event(event);
    }

    /// The cable at which a ring of two ports is open; `None` while it is whole.
    pub fn ring_gap(&self) -> Option<Cable> {
        let position = self.presence.open?;
        let at = |position: u16| self.ring.get(usize::from(position)).copied();
        let before = position.checked_sub(1).and_then(at);
        Some(Cable {
            from: before.map(|number| (number, 1)),
            to: at(position),
        })
    }

    /// The position before which a ring of two ports is open; `None` while it is whole.
    pub const fn ring_open(&self) -> Option<u16> {
        self.presence.open
    }

    /// The position before which a ring of two ports is open at start, while the master waits for it; `None` once
    /// slaves have their addresses.
    pub fn ring_split(&self) -> Option<u16> {
        self.scan.split.filter(|_| self.scan.phase == Phase::Count)
    }

    /// Number of unexpected slaves.
    pub const fn strangers(&self) -> u16 {
        self.presence.strangers
    }
}

/// The kind of a slave; if its SII was never read, its configured location.
fn kind(unit: &Unit) -> (u32, u32, Option<&Location>) {
    let read = &unit.info.identity;
    if unit.is_known() {
        (read.vendor, read.product, None)
    } else {
        (0, 0, Some(&unit.spec.location))
    }
}
