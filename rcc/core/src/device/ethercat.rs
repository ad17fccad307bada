//! The driver of an EtherCAT segment: one thread that sends a frame each cycle, in phase with SYNC0, and
//! between two of them leads the arms and the inputs and outputs on it. The protocol, the profile and the
//! state of every slave are in `takt_ethercat` and `takt_cia402`.
//!
//! In a cycle the frame goes out first, with what the cycle before computed, so that its instant does not
//! depend on any computation. Its answer is waited for, for half a cycle at most; then drives are led on and
//! nets are told.

mod arm;
mod describe;
mod io;
mod news;
mod youbot;

use std::fmt;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use takt_ethercat::link::{Link, Port};
use takt_ethercat::linux::PacketLink;
use takt_ethercat::master::{Difference, Master, Phase};
use takt_rt::alloc::enter_real_time;
use takt_rt::cycle::{Cycles, Follow, Tick};
use takt_rt::interface::Medium;
use takt_rt::latest::{LatestReader, LatestWriter, latest};
use takt_rt::ring::{Consumer, Producer, ring};
use takt_rt::servo::{Estimate, Servo, ServoConfig};
use takt_rt::stats::{self, StatsReader};
use takt_rt::{Nanos, monotonic};

use crate::device::config::EthercatConfig;
use crate::device::driver::{DeviceDriver, DriverEnds, DriverThread, FAREWELL, Notice};
use crate::device::drives;
use crate::device::link_watch::{LinkErrors, LinkWatch};
use crate::error::Error;
use arm::Arm;
pub use describe::{check, describe, master_config};
use io::InOut;
use news::News;
pub use youbot::{Wait, YouBotFigures};
use youbot::{Waiting, YouBots};

/// Longest Ethernet payload.
const FRAME: usize = 1500;
/// Frames looked at for the answer of one; more are a flood that somebody else sends.
const ANSWERS: usize = 64;
/// What waits to be told.
const NEWS: usize = 256;
/// Events looked at in one cycle.
const EVENTS: usize = 32;
/// How long a segment that is not as expected is left alone before it is looked at again.
const REFUSED: Duration = Duration::from_secs(2);
/// Turn of one of two links that are both waited for.
const TURN: Duration = Duration::from_micros(20);

/// A link that a driver thread can own.
pub trait EthernetLink: Link + Send + fmt::Debug {}

impl<T: Link + Send + fmt::Debug> EthernetLink for T {}

/// A link at the end of which frames go out with this address as their source.
#[derive(Debug)]
pub struct Wire {
    /// The link.
    pub link: Box<dyn EthernetLink>,
    /// Its MAC address.
    pub source: [u8; 6],
}

/// The wires of a segment: one, or of a ring two.
#[derive(Debug)]
pub struct Wires {
    /// To the first slave.
    pub first: Wire,
    /// To the last slave.
    pub second: Option<Wire>,
}

impl From<Wire> for Wires {
    fn from(first: Wire) -> Self {
        Self {
            first,
            second: None,
        }
    }
}

/// Listened for another master before the first frame: longer than any usual cycle.
const LISTEN: Duration = Duration::from_millis(60);

/// Opens the network interfaces of a segment, for this process alone.
///
/// # Errors
/// If there is no such interface or no right to open it, another program of Takt has it, or frames of another master come.
pub fn open(config: &EthercatConfig) -> Result<Wires, Error> {
    let open = |interface: &String| {
        let link = PacketLink::open_locked(interface).and_then(|mut link| {
            link.listen_first(interface, LISTEN)?;
            Ok(link)
        });
        let link = link.map_err(|source| Error::Device {
            name: config.name.clone(),
            what: format!("open {interface}"),
            source,
        })?;
        let source = link.mac();
        Ok(Wire {
            link: Box::new(link.spinning(config.spin)),
            source,
        })
    };
    Ok(Wires {
        first: open(&config.interface)?,
        second: config.second.as_ref().map(open).transpose()?,
    })
}

/// Figures of a segment that others read while it runs.
#[derive(Debug, Default)]
struct Shared {
    cycles: AtomicU64,
    lost: AtomicU64,
    events: AtomicU64,
    operational: AtomicBool,
    unproven: AtomicU64,
    /// In the order of the fields of [`YouBotFigures`].
    youbots: [AtomicU64; 4],
}

/// Figures of a segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EthercatFigures {
    /// Time from one frame to the next.
    pub period: Duration,
    /// Frames with process data.
    pub cycles: u64,
    /// Frames whose answer did not come in its cycle.
    pub lost: u64,
    /// What happened on the segment: slaves reached, lost, returned, cables.
    pub events: u64,
    /// Whether all slaves are where they are wanted.
    pub operational: bool,
    /// What happened to the drives of youBots.
    pub youbots: YouBotFigures,
}

/// A running driver.
#[derive(Debug)]
pub struct Ethercat {
    devices: Vec<String>,
    on_restart: Vec<String>,
    period: Duration,
    shared: Arc<Shared>,
    /// Names of its slaves, and the drive of a youBot that is waited for.
    slaves: Vec<String>,
    waiting: Mutex<LatestReader<Option<Waiting>>>,
    news: Mutex<Consumer<News>>,
    /// One for each wire.
    links: Vec<LinkWatch>,
    /// How the cycle keeps its time; its phase error is that to SYNC0.
    pub stats: StatsReader,
    thread: DriverThread,
}

impl Ethercat {
    /// Starts the driver thread. The ends are those of the devices of [`describe`], in that order.
    ///
    /// # Errors
    /// If the configuration makes no sense or the system has no thread to give.
    pub fn start(
        config: &EthercatConfig,
        wires: impl Into<Wires>,
        ends: DriverEnds,
    ) -> Result<Self, Error> {
        check(config).map_err(Error::Cell)?;
        drives::report_quirks(&config.name, &config.arms);
        let master = Master::new(master_config(config)).map_err(|e| Error::Cell(e.to_string()))?;
        let Wires { first, second } = wires.into();
        let links = watched(&config.name, &first, second.as_ref());
        let errors = links.iter().map(LinkWatch::errors).collect();
        let port = |wire: Wire| Port::new(wire.link, wire.source);
        let descriptions = describe(config);
        let devices = descriptions.iter().map(|d| d.name.clone()).collect();
        let mut given = ends.devices.into_iter();
        let arms = config.arms.iter().zip(&mut given);
        let arms = arms.map(|(arm, end)| Arm::new(config, arm, end)).collect();
        let ios = config.ios.iter().zip(&mut given);
        let ios = ios.map(|(io, end)| InOut::new(config, io, end)).collect();
        let youbots = YouBots::new(config, &mut given);
        let shared = Arc::new(Shared::default());
        let (own_clock, followed) = latest(1, Estimate::default);
        let (own_waiting, waiting) = latest(1, || None);
        let slaves = slave_names(&master);
        let (mut recorded, stats) = stats::pair();
        let (own_news, news) = ring(NEWS);
        let phase = config.phase.unwrap_or(config.cycle / 2);
        let mut driver = Box::new(Driver {
            master,
            ports: [first].into_iter().chain(second).map(port).collect(),
            errors,
            servo: Servo::new(&ServoConfig::new(config.cycle)),
            cycle: config.cycle,
            arms,
            ios,
            youbots,
            buffer: [0; FRAME],
            clocks: [own_clock, ends.clock],
            shared: Arc::clone(&shared),
            waiting: own_waiting,
            news: own_news,
            refused: Refused::default(),
            farewell: None,
        });
        let period = config.cycle;
        let (name, cpus) = (&config.name, &config.cpus);
        let thread = DriverThread::start(name, config.priority, cpus, move |stopping| {
            let cycles = Cycles {
                follow: Some(Follow::new(followed, phase.into())),
                ..Cycles::every(period)
            };
            let mut scope = None;
            cycles.run(&mut recorded, |tick| {
                // To enter and to leave locks: once for each time that the segment runs. Until then a cycle allocates, as
                // what a scan finds must lie somewhere.
                let runs = driver.master.is_exchanging();
                if runs != scope.is_some() {
                    scope = runs.then(enter_real_time);
                }
                driver.cycle(tick, stopping.load(Ordering::Relaxed))
            });
            drop(scope);
            let [_, clock] = driver.clocks;
            clock
        })?;
        Ok(Self {
            devices,
            on_restart: config.on_restart(),
            period,
            shared,
            slaves,
            waiting: Mutex::new(waiting),
            news: Mutex::new(news),
            links,
            stats,
            thread,
        })
    }

    /// The drive of a youBot that is waited for, and why; `None` if all follow, or there is no youBot.
    #[must_use]
    pub fn waits_for(&self) -> Option<String> {
        let mut waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        let Waiting { slave, why } = waiting.read()?;
        let name = self.slaves.get(slave).map_or("", String::as_str);
        Some(format!("{name}: {why}"))
    }

    /// Its figures so far.
    #[must_use]
    pub fn figures(&self) -> EthercatFigures {
        let Shared {
            cycles,
            lost,
            events,
            operational,
            youbots,
            ..
        } = &*self.shared;
        let [timeouts, i2t, clamped, repeats] = youbots
            .each_ref()
            .map(|count| count.load(Ordering::Relaxed));
        EthercatFigures {
            period: self.period,
            cycles: cycles.load(Ordering::Relaxed),
            lost: lost.load(Ordering::Relaxed),
            events: events.load(Ordering::Relaxed),
            operational: operational.load(Ordering::Relaxed),
            youbots: YouBotFigures {
                timeouts,
                i2t,
                clamped,
                repeats,
            },
        }
    }
}

/// Watches the link of each wire.
fn watched(name: &str, first: &Wire, second: Option<&Wire>) -> Vec<LinkWatch> {
    let watch = |wire: &Wire| LinkWatch::new(name, wire.link.interface(), Medium::Ethernet);
    std::iter::once(first).chain(second).map(watch).collect()
}

impl DeviceDriver for Ethercat {
    fn thread(&self) -> &DriverThread {
        &self.thread
    }

    fn into_thread(self: Box<Self>) -> DriverThread {
        self.thread
    }

    fn drives(&self, device: &str) -> bool {
        self.devices.iter().any(|name| name == device)
    }

    fn figures(&self) -> Vec<(&'static str, String)> {
        let figures = self.figures();
        let mut told = vec![
            ("cycles", figures.cycles.to_string()),
            ("lost", figures.lost.to_string()),
            ("events", figures.events.to_string()),
        ];
        let failed: u64 = self.links.iter().map(LinkWatch::failed).sum();
        if failed > 0 {
            told.push(("not sent", failed.to_string()));
        }
        let unproven = self.shared.unproven.load(Ordering::Relaxed);
        if unproven > 0 {
            told.push(("axes not proven", unproven.to_string()));
        }
        let YouBotFigures { timeouts, i2t, .. } = figures.youbots;
        if timeouts + i2t > 0 {
            told.push(("youbot timeouts", timeouts.to_string()));
            told.push(("youbot i2t", i2t.to_string()));
        }
        told.extend(self.waits_for().map(|why| ("waits for", why)));
        told
    }

    fn is_held_after_faults(&self, device: &str) -> bool {
        self.on_restart.iter().any(|name| name == device)
    }

    fn stalls(&self) -> Option<&stats::StallReader> {
        Some(self.stats.stalls())
    }

    fn news(&self) -> Option<Notice> {
        let now = Instant::now();
        if let Some(notice) = self.links.iter().find_map(|link| link.poll(now)) {
            return Some(notice);
        }
        let mut news = self.news.lock().unwrap_or_else(PoisonError::into_inner);
        news.pop().map(|news| news.notice())
    }
}

/// A segment that is not as expected.
#[derive(Debug, Default)]
struct Refused {
    since: Option<Nanos>,
    /// What was told last, so that it is told again only if it changes.
    differences: Vec<Difference>,
    too_large: Option<usize>,
}

struct Driver {
    master: Master,
    /// One, or of a ring two.
    ports: Vec<Port<Box<dyn EthernetLink>>>,
    /// Of each of them.
    errors: Vec<Arc<LinkErrors>>,
    servo: Servo,
    cycle: Duration,
    arms: Vec<Arm>,
    ios: Vec<InOut>,
    youbots: YouBots,
    buffer: [u8; FRAME],
    /// Where the segment's clock is told: to this thread, and to the controller.
    clocks: [LatestWriter<Estimate>; 2],
    shared: Arc<Shared>,
    waiting: LatestWriter<Option<Waiting>>,
    /// What is told; if nobody takes it, it is lost.
    news: Producer<News>,
    refused: Refused,
    /// When it ends at the latest, once it is to stop.
    farewell: Option<Nanos>,
}

impl Driver {
    /// One cycle.
    fn cycle(&mut self, tick: &Tick, stopping: bool) -> ControlFlow<()> {
        let until = tick.scheduled + Nanos::from(self.cycle / 2);
        if self.master.is_exchanging() {
            self.exchange(until);
        } else {
            while self.exchange(until) && !self.master.is_exchanging() {}
            self.start_up(tick);
        }
        self.lead(tick, stopping);
        self.end(tick, stopping)
    }

    /// Tells what differs from what is expected, and looks again after a while: a slave whose power was not there may
    /// have it now.
    fn start_up(&mut self, tick: &Tick) {
        if self.master.is_exchanging() {
            (self.refused.since, self.refused.too_large) = (None, None);
            if !std::mem::take(&mut self.refused.differences).is_empty() {
                self.tell(News::AsExpected);
            }
            let lacks: Vec<_> = self
                .ios
                .iter_mut()
                .flat_map(|io| io.find(&self.master))
                .collect();
            for lack in lacks {
                self.tell(News::Lack(lack));
            }
            return;
        }
        if self.master.phase() != Phase::Refused {
            return;
        }
        let since = *self.refused.since.get_or_insert(tick.scheduled);
        if self.refused.differences != self.master.differences() {
            self.refused.differences = self.master.differences().to_vec();
            for difference in self.refused.differences.clone() {
                self.tell(News::Difference(difference));
            }
        }
        let too_large = self.master.image_too_large();
        if self.refused.too_large != too_large {
            self.refused.too_large = too_large;
            if let Some(bytes) = too_large {
                self.tell(News::TooLarge(bytes));
            }
        }
        if tick.scheduled - since > Nanos::from(REFUSED) {
            self.refused.since = None;
            self.master.restart();
        }
    }

    fn tell(&mut self, news: News) {
        self.news.push(news).ok();
    }

    /// Sends the frame that is due and waits for its answer, or for that of a frame that is under way still; false if
    /// there is neither or no time for more.
    fn exchange(&mut self, until: Nanos) -> bool {
        let now = since_start(monotonic());
        if let Some(len) = self.master.poll_transmit(now, &mut self.buffer) {
            let mut sent = false;
            for (port, errors) in self.ports.iter_mut().zip(&self.errors) {
                match port.send(&self.buffer[..len]) {
                    Ok(()) => sent = true,
                    Err(error) => errors.note_io(&error),
                }
            }
            return sent && self.answered(until);
        }
        // The last frame of a burst comes back after the burst: unread, it would count as lost and be sent again.
        self.master.awaits_frame() && self.answered(until)
    }

    /// Waits for the answer, of a ring by both of its ends in turn; false if it did not come, or no time is left.
    fn answered(&mut self, until: Nanos) -> bool {
        let both = self.ports.len() > 1;
        let mut looked = 0;
        while looked < ANSWERS {
            let left = since_start(until - monotonic());
            let wait = if both { left.min(TURN) } else { left };
            let mut deaf = 0;
            for (number, port) in self.ports.iter_mut().enumerate() {
                match port.receive(wait) {
                    Ok(Some((frame, at))) => {
                        looked += 1;
                        if self.master.handle_frame(number, frame, at) {
                            return !left.is_zero();
                        }
                    }
                    Ok(None) => {}
                    Err(error) => {
                        deaf += 1;
                        if let Some(errors) = self.errors.get(number) {
                            errors.note_io(&error);
                        }
                    }
                }
            }
            if deaf == self.ports.len() || left.is_zero() {
                return false;
            }
        }
        false
    }

    fn lead(&mut self, tick: &Tick, stopping: bool) {
        self.take_samples();
        let mut happened = 0;
        while happened < EVENTS
            && let Some(event) = self.master.poll_event()
        {
            happened += 1;
            self.news.push(News::Event(event)).ok();
        }
        while let Some(emergency) = self.master.poll_emergency() {
            self.news.push(News::Emergency(emergency)).ok();
        }
        for (number, arm) in self.arms.iter_mut().enumerate() {
            arm.cycle(&mut self.master, tick, stopping);
            while let Some((slave, axis, news)) = arm.poll_news() {
                self.news.push(News::Axis(slave, axis, news)).ok();
            }
            while let Some((joint, news)) = arm.poll_joint() {
                self.news.push(News::Joint(number, joint, news)).ok();
            }
        }
        let unproven = self.arms.iter().map(Arm::unproven).sum();
        self.shared.unproven.store(unproven, Ordering::Relaxed);
        for io in &mut self.ios {
            io.cycle(&mut self.master, tick);
        }
        while let Some(reply) = self.master.poll_reply() {
            let mut arms = self.arms.iter_mut();
            let other = arms.try_fold(reply, |reply, arm| arm.handle_reply(reply, tick).err());
            if let Some(reply) = other {
                self.youbots.handle_reply(reply, tick);
            }
        }
        self.youbots.cycle(&mut self.master, tick, stopping);
        let frames = self.master.frames();
        let shared = &self.shared;
        shared.cycles.store(self.master.cycles(), Ordering::Relaxed);
        shared.lost.store(frames.lost, Ordering::Relaxed);
        shared.events.fetch_add(happened as u64, Ordering::Relaxed);
        let YouBotFigures {
            timeouts,
            i2t,
            clamped,
            repeats,
        } = self.youbots.figures();
        for (to, count) in shared.youbots.iter().zip([timeouts, i2t, clamped, repeats]) {
            to.store(count, Ordering::Relaxed);
        }
        self.waiting.write(self.youbots.waits_for());
        let operational = self.master.is_operational();
        shared.operational.store(operational, Ordering::Relaxed);
    }

    /// Tells the servo how the reference clock stood in the middle of the frame's way.
    fn take_samples(&mut self) {
        while let Some(sample) = self.master.poll_sample() {
            let way = sample.received.saturating_sub(sample.sent);
            let local = Nanos::from(sample.sent + way / 2);
            let remote = i64::try_from(sample.system_ns).unwrap_or(i64::MAX);
            self.servo.handle_sample(local, Nanos(remote));
        }
        self.servo.handle_time(monotonic());
        let estimate = self.servo.estimate();
        for clock in &mut self.clocks {
            clock.write(estimate);
        }
    }

    fn end(&mut self, tick: &Tick, stopping: bool) -> ControlFlow<()> {
        if !stopping {
            return ControlFlow::Continue(());
        }
        let now = tick.scheduled;
        let latest = now + FAREWELL.into();
        let end = *self.farewell.get_or_insert(latest);
        let off = self.arms.iter().all(Arm::is_off) && self.youbots.rest();
        if off || now >= end || !self.master.is_exchanging() {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    }
}

fn slave_names(master: &Master) -> Vec<String> {
    let slaves = master.config().slaves.iter();
    slaves.map(|slave| slave.name.clone()).collect()
}

/// Time on the monotonic clock as the protocol counts it; zero before its start.
fn since_start(time: Nanos) -> Duration {
    Duration::from_nanos(u64::try_from(time.0).unwrap_or_default())
}

#[cfg(test)]
mod recovery_tests;
#[cfg(test)]
mod wire_tests;
