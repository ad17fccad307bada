//! The master of a segment: sans-I/O, one thread, one frame at a time. Its owner gets a frame each cycle
//! ([`Master::poll_transmit`]), sends it, passes received frames to [`Master::handle_frame`], and reads and writes
//! process data in between. It reads no clock, opens no socket, and once the segment runs it allocates nothing.
//!
//! ```text
//! frame of a cycle: FRMW 0910h | LRW (or LWR, LRD) of each group | BRD 0130h | mailbox or diagnosis, one
//!                   clock        process data                      census      in turn
//!
//! Scan (count, address, identify, compare, process image)       scan.rs
//!   Unit, one for each slave: INIT -> PRE-OP -> SAFE-OP -> OP    unit/steps.rs
//!     Mailbox, Transfer: CoE                                     unit/mailbox.rs, unit/transfer.rs
//! Presence: lost and returning slaves, fallen states, cables     presence.rs
//! ```
//!
//! The census (how many answer, and the OR of their states) is in every frame: a slave that is lost or leaves its state
//! is detected in that very cycle, and only then each slave is inspected.

mod compare;
mod diagnosis;
mod event;
mod exchange;
mod image;
mod job;
mod presence;
mod process;
mod scan;
mod transmit;
mod unit;
mod view;

#[cfg(test)]
pub(crate) mod tests;

use std::time::Duration;

use crate::AlState;
use crate::config::{ConfigError, Location, MasterConfig, SlaveSpec};
use crate::dc::{self, Sample};
use crate::topology::Topology;

pub use compare::Difference;
pub use diagnosis::Suspect;
pub use event::{Cable, EmergencyReport, Event, Fault, JobError};
pub use exchange::FrameCounters;
pub use image::Group;
pub use job::{EntryDescription, EthernetJob, Job, JobKind, ObjectDescription, Reply};
pub use process::{Channel, Located, Pdo, ProcessData};
pub use scan::Phase;
pub use unit::{EthernetCounters, PortCounters, PortState, SlaveInfo};
pub use view::SlaveView;

use event::{Outbox, QUEUE_MAX};
use exchange::Exchange;
use image::{Image, Need};
use presence::Presence;
use scan::{STATION_FIRST, Scan};
use unit::{Context, Gate, Step, Unit};

/// A master.
#[derive(Debug)]
pub struct Master {
    config: MasterConfig,
    exchange: Exchange,
    scan: Scan,
    units: Vec<Unit>,
    image: Image,
    topology: Topology,
    /// The slave at each position of the ring, as it was at start.
    ring: Vec<usize>,
    differences: Vec<Difference>,
    presence: Presence,
    clock: ReferenceClock,
    out: Outbox,
    /// Number of pending jobs.
    jobs: usize,
    /// The slave whose turn it is to send an acyclic datagram.
    turn: usize,
    /// Frames of the running segment.
    cycles: u64,
    next_census: Duration,
    /// All slaves have reached their goals once.
    started: bool,
    too_large: Option<usize>,
}

/// The reference clock.
#[derive(Clone, Copy, Debug, Default)]
struct ReferenceClock {
    slave: Option<usize>,
    /// The newest sample.
    last: Option<Sample>,
    /// The sample was not fetched yet.
    fresh: bool,
    /// Consecutive frames without an answer of the reference.
    silent: u8,
}

/// Frames without an answer of the reference after which another clock replaces it.
const REFERENCE_SILENT: u8 = 20;

impl ReferenceClock {
    /// System time at a time of the master, by the newest sample, ns.
    fn predict(&self, now: Duration) -> Option<u64> {
        let last = self.last?;
        let passed = u64::try_from(now.saturating_sub(last.sent).as_nanos()).unwrap_or(u64::MAX);
        Some(last.system_ns.wrapping_add(passed))
    }
}

impl Master {
    /// A master that has not scanned its segment yet.
    pub fn new(config: MasterConfig) -> Result<Self, ConfigError> {
        config.check()?;
        Ok(Self {
            exchange: Exchange::new(config.redundant),
            scan: Scan::new(),
            units: Vec::new(),
            image: Image::default(),
            topology: Topology::default(),
            ring: Vec::new(),
            differences: Vec::new(),
            presence: Presence::default(),
            clock: ReferenceClock::default(),
            out: Outbox::new(),
            jobs: 0,
            turn: 0,
            cycles: 0,
            next_census: Duration::ZERO,
            started: false,
            too_large: None,
            config,
        })
    }

    /// Drops the segment and restarts the scan; outputs are no longer sent, so that the watchdogs of the slaves expire.
    pub fn restart(&mut self) {
        let frames = self.exchange.counters();
        let running = self.scan.phase == Phase::Running;
        for unit in &mut self.units {
            // A slave that never ran is not lost.
            if running {
                unit.lose(&mut self.out);
            } else {
                unit.abandon(&mut self.out);
            }
        }
        self.exchange = Exchange::new(self.config.redundant);
        self.exchange.keep(frames);
        (self.scan, self.units, self.image) = (Scan::new(), Vec::new(), Image::default());
        (self.differences, self.too_large) = (Vec::new(), None);
        (self.presence, self.clock) = (Presence::default(), ReferenceClock::default());
        (self.started, self.turn) = (false, 0);
    }

    /// Advances the start of the segment from one phase to the next.
    fn advance(&mut self, now: Duration) {
        match self.scan.phase {
            Phase::Count | Phase::Quiet | Phase::Address | Phase::Refused | Phase::Latch => {}
            Phase::Identify => {
                let known = |unit: &Unit| unit.step() == Step::Identified || unit.has_failed();
                if self.units.iter().all(known) {
                    self.identified();
                }
            }
            Phase::Process => {
                let ready = |unit: &Unit| unit.mapped || unit.has_failed() || !unit.is_present();
                if self.units.iter().all(ready) {
                    self.lay_out(now);
                }
            }
            Phase::Running => {
                let config = &self.config;
                let at_goal =
                    |unit: &Unit| unit.is_running() || (unit.spec.optional && !unit.is_present());
                self.started |= !config.cycle.is_zero() && self.units.iter().all(at_goal);
            }
        }
        let Self {
            config,
            image,
            units,
            out,
            clock,
            ..
        } = self;
        let cx = Context {
            now,
            sent_at: now,
            reference_ns: clock.predict(now),
            reference: clock.slave,
            config,
            image,
        };
        for unit in units {
            unit.poll(&cx, out);
        }
    }

    /// All addresses are set: creates the state machines of the slaves.
    fn addressed(&mut self, cx_now: Duration) {
        let Self {
            config,
            image,
            units,
            out,
            scan,
            ..
        } = self;
        let cx = Context {
            now: cx_now,
            sent_at: cx_now,
            reference_ns: None,
            reference: None,
            config,
            image,
        };
        for position in 0..scan.count() {
            let number = usize::from(position);
            let spec = SlaveSpec::new(format!("slave {position}"), Location::Position(position));
            let mut unit = Unit::new(number, STATION_FIRST + position, spec, config);
            unit.position = Some(position);
            unit.begin(&cx, out);
            units.push(unit);
        }
    }

    /// All slaves are identified: compares them with the configuration and determines the topology.
    fn identified(&mut self) {
        let ports: Vec<_> = self
            .units
            .iter()
            .map(|unit| unit.info.ports().map(|port| port.open))
            .collect();
        self.topology = Topology::new(&ports);
        if !self.config.slaves.is_empty() {
            let found: Vec<_> = self.units.iter().map(|unit| &unit.info).collect();
            let (matched, differences) = compare::compare(&self.config.slaves, &found);
            self.differences = differences;
            if !self.differences.is_empty() {
                self.scan.phase = Phase::Refused;
                return;
            }
            self.arrange(&matched);
        }
        let mut ring: Vec<_> = self
            .units
            .iter()
            .filter_map(|unit| Some((unit.position?, unit.number)))
            .collect();
        ring.sort_unstable();
        self.ring = ring.into_iter().map(|(_, number)| number).collect();
        self.presence.set_homes(&self.ring, self.units.len());
        // With the first cable cut, the loop at the end is the only entry.
        let (_, received) = self.exchange.halves();
        let whole = self.config.redundant && received == [true, true];
        let last = self
            .ring
            .len()
            .checked_sub(1)
            .filter(|last| whole && self.topology.ports(*last)[1]);
        self.scan
            .begin_latch(last.and_then(|last| u16::try_from(last).ok()));
    }

    /// Sorts slaves in the order of the configuration, including those that may appear later.
    fn arrange(&mut self, matched: &[Option<usize>]) {
        let mut found: Vec<_> = std::mem::take(&mut self.units)
            .into_iter()
            .map(Some)
            .collect();
        let count = u16::try_from(found.len()).unwrap_or(u16::MAX);
        for (number, (spec, position)) in self.config.slaves.iter().zip(matched).enumerate() {
            let unit = position.and_then(|position| found.get_mut(position)?.take());
            let unit = unit.map_or_else(
                || {
                    let later = STATION_FIRST + count + u16::try_from(number).unwrap_or(0);
                    let mut unit = Unit::new(number, later, spec.clone(), &self.config);
                    unit.gate = Gate::Goal;
                    // The contents of its future region in the image, so that its objects can be located.
                    unit.process = ProcessData::from_spec(&unit.spec).unwrap_or_default();
                    unit
                },
                |mut unit| {
                    unit.assign(number, spec.clone());
                    unit
                },
            );
            self.units.push(unit);
        }
    }

    /// Receive times are latched: each slave reads its own and configures its process data.
    fn latched(&mut self, now: Duration) {
        self.scan.phase = Phase::Process;
        let Self {
            config,
            image,
            units,
            out,
            ..
        } = self;
        let cx = Context {
            now,
            sent_at: now,
            reference_ns: None,
            reference: None,
            config,
            image,
        };
        for unit in units.iter_mut().filter(|unit| unit.is_present()) {
            unit.plan(&cx, out);
        }
    }

    /// All process data is known: computes delays, the process image, the reference clock.
    fn lay_out(&mut self, now: Duration) {
        let times: Vec<_> = self
            .ring
            .iter()
            .map(|number| {
                self.units
                    .get(*number)
                    .filter(|unit| unit.clock.latched)
                    .map(|unit| unit.clock.times)
            })
            .collect();
        let delays = dc::delays(&self.topology, &times);
        let leads = |number: &usize| {
            let unit = self.units.get(*number);
            unit.is_some_and(|unit| unit.can_lead(&self.config))
        };
        let has_clock = |number: &usize| {
            let unit = self.units.get(*number);
            unit.is_some_and(|unit| unit.info.has_clock())
        };
        let known = || self.ring.iter().position(has_clock);
        let first = self.ring.iter().position(leads).or_else(known);
        let base = first.and_then(|at| delays.get(at)).copied().unwrap_or(0);
        for (number, delay) in self.ring.iter().zip(&delays) {
            if let Some(unit) = self.units.get_mut(*number) {
                unit.clock.delay_ns = delay.saturating_sub(base);
            }
        }
        self.clock.slave = first.and_then(|at| self.ring.get(at)).copied();
        if let Some(slave) = self.clock.slave {
            self.out.event(Event::Reference { slave });
        }
        match Image::new(&self.units.iter().map(need).collect::<Vec<_>>()) {
            Ok(image) => self.image = image,
            Err(too_large) => {
                self.too_large = Some(too_large.bytes);
                self.scan.phase = Phase::Refused;
                return;
            }
        }
        let capacity = self.image.mailbox_capacity();
        for unit in &mut self.units {
            unit.gate = Gate::Goal;
            let (slave, size) = (unit.number, unit.mailbox_size());
            if size > capacity && self.config.goal != AlState::PreOp {
                self.out.event(Event::MailboxTooLong {
                    slave,
                    size,
                    capacity,
                });
            }
        }
        self.scan.phase = Phase::Running;
        self.next_census = now;
    }

    /// Whether process data is exchanged: one frame each cycle.
    pub fn is_exchanging(&self) -> bool {
        self.scan.phase == Phase::Running && self.config.goal != AlState::PreOp
    }

    /// Queues a job for a slave; [`Self::poll_reply`] returns its reply. A job that cannot be queued is returned at
    /// once.
    pub fn submit(&mut self, job: Job) -> Result<(), Reply> {
        if self.jobs >= QUEUE_MAX {
            return Err(Reply {
                job,
                result: Err(JobError::Busy(QUEUE_MAX)),
            });
        }
        let Some(unit) = self.units.get_mut(job.slave) else {
            let error = JobError::NoSlave(job.slave);
            return Err(Reply {
                job,
                result: Err(error),
            });
        };
        unit.submit(job)?;
        self.jobs += 1;
        Ok(())
    }

    /// The next reply to a job.
    pub fn poll_reply(&mut self) -> Option<Reply> {
        let reply = self.out.replies.pop_front()?;
        self.jobs = self.jobs.saturating_sub(1);
        Some(reply)
    }

    /// Copies the oldest Ethernet frame that a slave sent (EoE) to `to`, which 1518 bytes always fit; returns its length.
    pub fn poll_ethernet(&mut self, slave: usize, to: &mut [u8]) -> Option<usize> {
        self.units.get_mut(slave)?.fetch_ethernet(to)
    }

    /// The next event.
    pub fn poll_event(&mut self) -> Option<Event> {
        self.out.events.pop_front()
    }

    /// The next emergency.
    pub fn poll_emergency(&mut self) -> Option<EmergencyReport> {
        self.out.emergencies.pop_front()
    }

    /// The newest sample of the reference clock, once.
    pub fn poll_sample(&mut self) -> Option<Sample> {
        std::mem::take(&mut self.clock.fresh)
            .then_some(self.clock.last)
            .flatten()
    }

    /// Outputs of a slave, to be written before [`Self::poll_transmit`]; empty before the process image is laid out.
    pub fn outputs_mut(&mut self, slave: usize) -> &mut [u8] {
        self.image.outputs_mut(slave)
    }

    /// Inputs of a slave as last read, and how many cycles ago that was; `u32::MAX` for never.
    pub fn inputs(&self, slave: usize) -> (&[u8], u32) {
        self.image.inputs(slave)
    }

    /// Whether inputs of that age, cycles, still count; a slave whose inputs are older is offline. One cycle more than
    /// frames may be lost in a row.
    pub fn is_online(&self, age: u32) -> bool {
        age <= u32::from(self.config.lost_frames.max(1)) + 1
    }
}

/// The requirement of a slave in the image; `None` if not known.
fn need(unit: &Unit) -> Option<Need> {
    let lrw = !unit.info.no_lrw();
    if unit.mapped {
        return Some(Need::new(unit.spec.group, &unit.process, lrw));
    }
    let process = ProcessData::from_spec(&unit.spec)?;
    Some(Need::new(unit.spec.group, &process, lrw))
}
