//! A bus within the process, for tests, demonstrations and machines without CAN: arbitration by identifier,
//! the time that each frame takes bit by bit, acknowledgement, error counters, bus-off and recovery as
//! ISO 11898-1 has them. Time is an argument. It models no electrical level and no CAN XL.
//!
//! What happens to a frame that a port sends:
//!
//! 1. [`Bus::send`] puts it into the port's queue, or refuses it when that is full.
//! 2. [`Bus::advance`] lets the queues' first frames arbitrate whenever the bus is idle; the lowest
//!    identifier wins.
//! 3. After its time on the wire it is received by all ports that can hear, unless something destroys it: a
//!    fault ([`Bus::inject`]), another frame of the same identifier, a port with another bit rate, or that
//!    nobody is there to acknowledge. Then counters rise and it is sent again.
//! 4. A port hears of changes of its own state by error frames, as from the kernel.

mod port;
mod station;

use std::time::Duration;

pub use port::{Port, Shared};
pub use station::Counters;
use station::Station;

use crate::bits::{Bits, Rates};
use crate::fault::{class, location, violation};
use crate::link::{LinkError, Received};
use crate::{AnyFrame, BusState, ErrorFrame, Id};

/// How a bus is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Config {
    /// Bit rates that a port has unless told otherwise.
    pub rates: Rates,
    /// Frames that wait at a port for sending, at most; real interfaces have 10 unless told otherwise.
    pub send_queue: usize,
    /// Frames that wait at a port for being read, at most.
    pub receive_queue: usize,
    /// After this time a port that is off the bus tries again; `None`: only [`Bus::restart`] does.
    pub restart: Option<Duration>,
}

impl Default for Config {
    /// 1 Mbit/s, queues of 10 and 1024 frames, no restart.
    fn default() -> Self {
        Self {
            rates: Rates::classic(1_000_000),
            send_queue: 10,
            receive_queue: 1024,
            restart: None,
        }
    }
}

/// One participant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct PortId(usize);

/// Destroys frames on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fault {
    /// Only of this sender.
    pub from: Option<PortId>,
    /// Only with this identifier.
    pub id: Option<Id>,
    /// How many; each retry counts.
    pub frames: u32,
}

/// What the bus did, since it was made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Frames that arrived.
    pub frames: u64,
    /// Frames that were destroyed.
    pub destroyed: u64,
    /// Time during which the bus was not idle.
    pub busy: Duration,
}

/// Bits of an error: flags of both sides, delimiter, intermission.
const ERROR_BITS: Bits = Bits {
    nominal: 6 + 6 + 8 + 3,
    data: 0,
};

/// What is on the wire.
#[derive(Clone, Copy, Debug)]
struct Transmission {
    from: PortId,
    frame: AnyFrame,
    ends: Duration,
    outcome: Outcome,
}

/// What becomes of a frame on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Outcome {
    Arrives,
    Destroyed,
    /// Another port sends the same identifier with other content.
    Collides,
    Unacknowledged,
}

/// The bus.
#[derive(Debug)]
pub struct Bus {
    config: Config,
    stations: Vec<Station>,
    faults: Vec<Fault>,
    wire: Option<Transmission>,
    now: Duration,
    traffic: Traffic,
}

impl Bus {
    /// A bus without participants, at time 0.
    #[must_use]
    pub const fn new(config: Config) -> Self {
        Self {
            config,
            stations: Vec::new(),
            faults: Vec::new(),
            wire: None,
            now: Duration::ZERO,
            traffic: Traffic {
                frames: 0,
                destroyed: 0,
                busy: Duration::ZERO,
            },
        }
    }

    /// One more participant.
    pub fn attach(&mut self) -> PortId {
        self.stations.push(Station::new(&self.config));
        PortId(self.stations.len() - 1)
    }

    fn station(&self, port: PortId) -> Option<&Station> {
        self.stations.get(port.0)
    }

    /// Hands a frame over for sending at time `at`. Times must not go back.
    ///
    /// # Errors
    /// [`LinkError::QueueFull`] when there is no room, [`LinkError::Kind`] for an error frame,
    /// [`LinkError::Gone`] when the port is of another bus.
    pub fn send(&mut self, port: PortId, frame: &AnyFrame, at: Duration) -> Result<(), LinkError> {
        self.advance(at);
        let station = self.stations.get_mut(port.0).ok_or(LinkError::Gone)?;
        if matches!(frame, AnyFrame::Error(_)) {
            return Err(LinkError::Kind);
        }
        station.queue(*frame)
    }

    /// What a port received, the oldest first.
    pub fn receive(&mut self, port: PortId) -> Option<Received> {
        self.stations.get_mut(port.0)?.inbox.pop_front()
    }

    /// How far time has gone.
    #[must_use]
    pub const fn now(&self) -> Duration {
        self.now
    }

    /// When the next thing happens that nobody has to ask for: a frame is over, or a port comes back.
    #[must_use]
    pub fn next_event(&self) -> Option<Duration> {
        let frame = match self.wire {
            Some(transmission) => Some(transmission.ends),
            None => self.contenders().next().map(|_| self.now),
        };
        let back = self.stations.iter().filter_map(|s| s.restart_at).min();
        frame.into_iter().chain(back).min()
    }

    /// Lets time go on to `to`. What is sent at that very time is still part of the next arbitration.
    pub fn advance(&mut self, to: Duration) {
        while self.now < to {
            self.begin();
            match self.next_event().filter(|at| *at <= to) {
                Some(at) => {
                    self.now = at.max(self.now);
                    self.end();
                    self.come_back();
                }
                None => self.now = to,
            }
        }
    }

    /// Those who have something to send.
    fn contenders(&self) -> impl Iterator<Item = (PortId, &AnyFrame)> {
        let may = |station: &&Station| station.counters.state() != BusState::BusOff;
        let stations = self.stations.iter().enumerate();
        stations.filter_map(move |(number, station)| {
            let frame = Some(station).filter(may)?.outbox.front()?;
            Some((PortId(number), frame))
        })
    }

    /// Arbitration, if the bus is idle.
    fn begin(&mut self) {
        if self.wire.is_some() {
            return;
        }
        let winner = self
            .contenders()
            .min_by_key(|(_, frame)| arbitration(frame));
        let Some((from, frame)) = winner.map(|(from, frame)| (from, *frame)) else {
            return;
        };
        let outcome = self.outcome(from, &frame);
        let rates = self.station(from).map_or(self.config.rates, |s| s.rates);
        let errors = match outcome {
            Outcome::Arrives => Duration::ZERO,
            Outcome::Destroyed | Outcome::Collides | Outcome::Unacknowledged => {
                ERROR_BITS.time(rates)
            }
        };
        let ends = self.now + Bits::of(&frame).time(rates) + errors;
        self.wire = Some(Transmission {
            from,
            frame,
            ends,
            outcome,
        });
    }

    fn outcome(&mut self, from: PortId, frame: &AnyFrame) -> Outcome {
        let same = |other: &AnyFrame| arbitration(other) == arbitration(frame) && other != frame;
        if self
            .contenders()
            .any(|(port, other)| port != from && same(other))
        {
            return Outcome::Collides;
        }
        let rates = self.station(from).map(|station| station.rates);
        let others = || {
            let others = self.stations.iter().enumerate();
            others.filter_map(|(number, other)| (number != from.0).then_some(other))
        };
        // An error-passive port that understands nothing does not disturb those who do.
        if others().any(|other| Some(other.rates) != rates && other.may_destroy()) {
            return Outcome::Destroyed;
        }
        if !others().any(|other| Some(other.rates) == rates && other.acknowledges()) {
            return Outcome::Unacknowledged;
        }
        let hits = |fault: &&mut Fault| {
            fault.frames > 0
                && fault.from.is_none_or(|port| port == from)
                && fault.id.is_none_or(|id| Some(id) == frame.id())
        };
        match self.faults.iter_mut().find(hits) {
            Some(fault) => {
                fault.frames -= 1;
                Outcome::Destroyed
            }
            None => Outcome::Arrives,
        }
    }

    /// The frame on the wire is over, if it is time.
    fn end(&mut self) {
        let Some(sent) = self.wire.take_if(|wire| wire.ends <= self.now) else {
            return;
        };
        let bits = Bits::of(&sent.frame).time(self.config.rates);
        self.traffic.busy += match sent.outcome {
            Outcome::Arrives => bits,
            Outcome::Destroyed | Outcome::Collides | Outcome::Unacknowledged => {
                bits + ERROR_BITS.time(self.config.rates)
            }
        };
        match sent.outcome {
            Outcome::Arrives => self.deliver(&sent),
            Outcome::Destroyed => self.destroy(&sent, false),
            Outcome::Collides => self.destroy(&sent, true),
            Outcome::Unacknowledged => {
                self.traffic.destroyed += 1;
                let report = ErrorFrame::new(
                    class::NO_ACK | class::PROTOCOL | class::BUS_ERROR,
                    [
                        0,
                        0,
                        violation::TRANSMITTING,
                        location::ACK_SLOT,
                        0,
                        0,
                        0,
                        0,
                    ],
                );
                let (now, restart) = (self.now, self.config.restart);
                if let Some(station) = self.stations.get_mut(sent.from.0) {
                    // A lone port that is error-passive does not count on: it never goes off the bus.
                    let counts = station.counters.state() < BusState::ErrorPassive;
                    station.fail(if counts { 8 } else { 0 }, 0, report, now, restart);
                }
            }
        }
    }

    fn deliver(&mut self, sent: &Transmission) {
        self.traffic.frames += 1;
        let rates = self.station(sent.from).map(|station| station.rates);
        for (number, station) in self.stations.iter_mut().enumerate() {
            if number == sent.from.0 {
                station.sent(self.now);
            } else if Some(station.rates) == rates {
                station.hear(&sent.frame, self.now);
            }
        }
    }

    /// All who send it count 8, all who hear it 1.
    fn destroy(&mut self, sent: &Transmission, collision: bool) {
        self.traffic.destroyed += 1;
        let senders: Vec<usize> = match collision {
            false => vec![sent.from.0],
            true => {
                let key = arbitration(&sent.frame);
                let same = self
                    .contenders()
                    .filter(|(_, frame)| arbitration(frame) == key);
                same.map(|(port, _)| port.0).collect()
            }
        };
        let (now, restart) = (self.now, self.config.restart);
        for (number, station) in self.stations.iter_mut().enumerate() {
            let is_sender = senders.contains(&number);
            let (kind, transmit, receive) = match is_sender {
                true => (violation::BIT | violation::TRANSMITTING, 8, 0),
                false => (violation::STUFF, 0, 1),
            };
            let report = ErrorFrame::new(
                class::PROTOCOL | class::BUS_ERROR,
                [0, 0, kind, 0, 0, 0, 0, 0],
            );
            station.fail(transmit, receive, report, now, restart);
        }
    }

    /// Ports that waited long enough are back.
    fn come_back(&mut self) {
        let now = self.now;
        for station in &mut self.stations {
            if station.restart_at.is_some_and(|at| at <= now) {
                station.restart(now);
            }
        }
    }
}

/// What can be done to a bus, and asked of it.
impl Bus {
    /// Lets frames be destroyed.
    pub fn inject(&mut self, fault: Fault) {
        self.faults.retain(|fault| fault.frames > 0);
        self.faults.push(fault);
    }

    /// Gives a port bit rates of its own; if they differ from the others', nothing gets through.
    pub fn set_rates(&mut self, port: PortId, rates: Rates) {
        if let Some(station) = self.stations.get_mut(port.0) {
            station.rates = rates;
        }
    }

    /// A port that only listens: it neither acknowledges nor destroys.
    pub fn set_listen_only(&mut self, port: PortId, on: bool) {
        if let Some(station) = self.stations.get_mut(port.0) {
            station.listen_only = on;
        }
    }

    /// Whether a port receives its own frames when they were sent.
    pub fn set_echo(&mut self, port: PortId, on: bool) {
        if let Some(station) = self.stations.get_mut(port.0) {
            station.echo = on;
        }
    }

    /// Sets the error counters of a port; it hears of the state that follows.
    pub fn set_counters(&mut self, port: PortId, counters: Counters) {
        let (now, restart) = (self.now, self.config.restart);
        if let Some(station) = self.stations.get_mut(port.0) {
            station.set_counters(counters, now, restart);
        }
    }

    /// Brings a port that is off the bus back.
    pub fn restart(&mut self, port: PortId) {
        let now = self.now;
        if let Some(station) = self.stations.get_mut(port.0) {
            station.restart(now);
        }
    }

    /// Error counters of a port.
    #[must_use]
    pub fn counters(&self, port: PortId) -> Counters {
        self.station(port).map(|s| s.counters).unwrap_or_default()
    }

    /// State of a port.
    #[must_use]
    pub fn state(&self, port: PortId) -> BusState {
        self.counters(port).state()
    }

    /// Frames that wait at a port for sending.
    #[must_use]
    pub fn waiting(&self, port: PortId) -> usize {
        self.station(port).map_or(0, |station| station.outbox.len())
    }

    /// What went over the bus.
    #[must_use]
    pub const fn traffic(&self) -> Traffic {
        self.traffic
    }
}

/// The bits that decide, as a number: the lowest wins.
fn arbitration(frame: &AnyFrame) -> u32 {
    let remote = match frame {
        AnyFrame::Classic(frame) => u32::from(frame.is_remote()),
        AnyFrame::Fd(_) | AnyFrame::Error(_) => 0,
    };
    match frame.id() {
        // 11 bits, then the bit of remote frames, then a dominant bit that says there are no more.
        Some(id) if !id.is_extended() => id.raw() << 21 | remote << 20,
        // 11 bits, two recessive bits, 18 bits, the bit of remote frames.
        Some(id) => id.raw() >> 18 << 21 | 0b11 << 19 | (id.raw() & 0x3_FFFF) << 1 | remote,
        None => u32::MAX,
    }
}

#[cfg(test)]
mod tests;
