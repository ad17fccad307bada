//! An in-process CAN bus for tests, demonstrations and machines without CAN hardware. It models arbitration, the bit
//! time of each frame, acknowledgement, error counters, bus-off and recovery (ISO 11898-1), but no electrical levels
//! and no CAN XL. Time is an argument.
//!
//! Life of a frame that a port sends:
//!
//! 1. [`Bus::send`] puts it into the port's send queue, or returns an error when the queue is
//!    full.
//! 2. Whenever the bus is idle, [`Bus::advance`] arbitrates between the first frames of all
//!    queues; the lowest identifier wins.
//! 3. After its transmission time all active ports receive it, unless it is destroyed: by a fault ([`Bus::inject`]),
//!    by another frame with the same identifier, by a port with another bit rate, or because no port acknowledges it.
//!    Then the error counters rise and the frame is retransmitted.
//! 4. A port receives error frames when its own state changes, as the kernel sends them.

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

/// Configuration of a bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Config {
    /// Default bit rates of a port.
    pub rates: Rates,
    /// Length of a port's send queue, frames; the default of real interfaces is 10.
    pub send_queue: usize,
    /// Length of a port's receive queue, frames.
    pub receive_queue: usize,
    /// Delay of the automatic restart after bus-off; `None`: only [`Bus::restart`] restarts the
    /// port.
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

/// A port of the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct PortId(usize);

/// A fault that destroys frames on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fault {
    /// Only frames of this sender.
    pub from: Option<PortId>,
    /// Only frames with this identifier.
    pub id: Option<Id>,
    /// Number of frames to destroy; each retransmission counts.
    pub frames: u32,
}

/// Traffic counters since the bus was created.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Frames that arrived.
    pub frames: u64,
    /// Frames that were destroyed.
    pub destroyed: u64,
    /// Time in which the bus was busy.
    pub busy: Duration,
}

/// Bits of an error frame: error flags of both sides, delimiter, intermission.
const ERROR_BITS: Bits = Bits {
    nominal: 6 + 6 + 8 + 3,
    data: 0,
};

/// The frame on the wire.
#[derive(Clone, Copy, Debug)]
struct Transmission {
    from: PortId,
    frame: AnyFrame,
    ends: Duration,
    outcome: Outcome,
}

/// Outcome of a transmission.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Outcome {
    Arrives,
    Destroyed,
    /// Another port sends the same identifier with different content.
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
    /// A bus without ports, at time 0.
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

    /// Adds a port.
    pub fn attach(&mut self) -> PortId {
        self.stations.push(Station::new(&self.config));
        PortId(self.stations.len() - 1)
    }

    fn station(&self, port: PortId) -> Option<&Station> {
        self.stations.get(port.0)
    }

    /// Queues a frame for transmission at time `at`. Times must not decrease.
    ///
    /// # Errors
    /// [`LinkError::QueueFull`] when the queue is full, [`LinkError::Kind`] for an error frame,
    /// [`LinkError::Lost`] when the port belongs to another bus.
    pub fn send(&mut self, port: PortId, frame: &AnyFrame, at: Duration) -> Result<(), LinkError> {
        self.advance(at);
        let station = self.stations.get_mut(port.0).ok_or(LinkError::Lost)?;
        if matches!(frame, AnyFrame::Error(_)) {
            return Err(LinkError::Kind);
        }
        station.queue(*frame)
    }

    /// The oldest frame that a port received and has not read.
    pub fn receive(&mut self, port: PortId) -> Option<Received> {
        self.stations.get_mut(port.0)?.inbox.pop_front()
    }

    /// The current time of the bus.
    pub const fn now(&self) -> Duration {
        self.now
    }

    /// Time of the next event: the end of a transmission, or the restart of a port.
    pub fn next_event(&self) -> Option<Duration> {
        let frame = match self.wire {
            Some(transmission) => Some(transmission.ends),
            None => self.contenders().next().map(|_| self.now),
        };
        let back = self.stations.iter().filter_map(|s| s.restart_at).min();
        frame.into_iter().chain(back).min()
    }

    /// Advances time to `to`. Frames sent at exactly that time still take part in the next arbitration.
    pub fn advance(&mut self, to: Duration) {
        while self.now < to {
            self.begin();
            match self.next_event().filter(|at| *at <= to) {
                Some(at) => {
                    self.now = at.max(self.now);
                    self.end();
                    self.restart_stations();
                }
                None => self.now = to,
            }
        }
    }

    /// Ports that have a frame to send.
    fn contenders(&self) -> impl Iterator<Item = (PortId, &AnyFrame)> {
        let may = |station: &&Station| station.counters.state() != BusState::BusOff;
        let stations = self.stations.iter().enumerate();
        stations.filter_map(move |(number, station)| {
            let frame = Some(station).filter(may)?.outbox.front()?;
            Some((PortId(number), frame))
        })
    }

    /// Starts a transmission by arbitration if the bus is idle.
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
        // An error-passive port cannot destroy a frame that it fails to decode.
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

    /// Ends the transmission when its time has passed.
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
                    // A single error-passive port without acknowledgement does not count further: it never goes
                    // bus-off.
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
                station.receive(&sent.frame, self.now);
            }
        }
    }

    /// Each sender counts 8, each receiver 1.
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

    /// Restarts the ports whose restart delay has passed.
    fn restart_stations(&mut self) {
        let now = self.now;
        for station in &mut self.stations {
            if station.restart_at.is_some_and(|at| at <= now) {
                station.restart(now);
            }
        }
    }
}

/// Fault injection and state of the ports.
impl Bus {
    /// Injects a fault that destroys frames.
    pub fn inject(&mut self, fault: Fault) {
        self.faults.retain(|fault| fault.frames > 0);
        self.faults.push(fault);
    }

    /// The default bit rates of its ports.
    pub const fn rates(&self) -> Rates {
        self.config.rates
    }

    /// Sets the bit rates of a port; if they differ from those of the other ports, every frame is
    /// destroyed.
    pub fn set_rates(&mut self, port: PortId, rates: Rates) {
        if let Some(station) = self.stations.get_mut(port.0) {
            station.rates = rates;
        }
    }

    /// Switches listen-only mode: the port neither acknowledges nor destroys frames.
    pub fn set_listen_only(&mut self, port: PortId, on: bool) {
        if let Some(station) = self.stations.get_mut(port.0) {
            station.listen_only = on;
        }
    }

    /// Whether a port receives its own frames after transmission.
    pub fn set_echo(&mut self, port: PortId, on: bool) {
        if let Some(station) = self.stations.get_mut(port.0) {
            station.echo = on;
        }
    }

    /// Sets the error counters of a port; the port receives an error frame if its state changes.
    pub fn set_counters(&mut self, port: PortId, counters: Counters) {
        let (now, restart) = (self.now, self.config.restart);
        if let Some(station) = self.stations.get_mut(port.0) {
            station.set_counters(counters, now, restart);
        }
    }

    /// Restarts a port that is bus-off.
    pub fn restart(&mut self, port: PortId) {
        let now = self.now;
        if let Some(station) = self.stations.get_mut(port.0) {
            station.restart(now);
        }
    }

    /// Error counters of a port.
    pub fn counters(&self, port: PortId) -> Counters {
        self.station(port).map(|s| s.counters).unwrap_or_default()
    }

    /// State of a port.
    pub fn state(&self, port: PortId) -> BusState {
        self.counters(port).state()
    }

    /// Number of frames in the send queue of a port.
    pub fn waiting(&self, port: PortId) -> usize {
        self.station(port).map_or(0, |station| station.outbox.len())
    }

    /// Traffic counters.
    pub const fn traffic(&self) -> Traffic {
        self.traffic
    }
}

/// The arbitration field as a number: the lowest wins.
fn arbitration(frame: &AnyFrame) -> u32 {
    let remote = match frame {
        AnyFrame::Classic(frame) => u32::from(frame.is_remote()),
        AnyFrame::Fd(_) | AnyFrame::Error(_) => 0,
    };
    match frame.id() {
        // 11 bits, RTR, dominant IDE.
        Some(id) if !id.is_extended() => id.raw() << 21 | remote << 20,
        // 11 bits, recessive SRR and IDE, 18 bits, RTR.
        Some(id) => id.raw() >> 18 << 21 | 0b11 << 19 | (id.raw() & 0x3_FFFF) << 1 | remote,
        None => u32::MAX,
    }
}

#[cfg(test)]
mod tests;
