//! The driver of a KUKA arm over FRI, either generation: a thread that waits for the controller's datagram
//! and answers it at once with what the nets want at that instant of the robot's own clock. The protocols
//! themselves are in `takt_fri`; what differs between them is told by `Protocol`.

mod clock;
mod force;
pub(super) mod orders;
mod protocol;

use std::marker::PhantomData;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicI32, AtomicU64, Ordering};
use std::time::Duration;

use takt_fri::link::Link;
use takt_fri::linux::UdpLink;
use takt_fri::sunrise::wire::MESSAGE_MAX;
use takt_net::JointState;
use takt_net::device::{Interfaces, JointError, Layout};
use takt_rt::Nanos;
use takt_rt::latest::{LatestReader, LatestWriter};
use takt_rt::servo::Estimate;
use takt_rt::stats::{Recorder, RecorderReader};

use crate::device::driver::{DeviceDriver, DeviceEnd, DriverEnds, DriverThread};
use crate::device::setpoint::Joint;
use crate::device::{
    DeviceCommand, DeviceDescription, DeviceState, DeviceStatus, JointSetPoints, parts,
};
use crate::error::Error;
use clock::DatagramClock;
use force::ForceByTorques;

pub use orders::Orders;
pub use protocol::{AXES, Heard, Joints, Protocol, Totals};

/// Room for any datagram, and one byte more so that a longer one shows.
const ROOM: usize = MESSAGE_MAX + 1;
/// Set-points older than this many cycles of the driver are no longer followed.
const STALE_AFTER: i64 = 10;
/// Longest wait for a datagram, so that a stop is seen soon.
const WAIT: Duration = Duration::from_millis(20);
/// Faster than this a joint moves, rad/s.
const MOVES_FROM: f64 = 1e-3;
/// Waiting datagrams taken at most before one of them is answered.
const BACKLOG: usize = 64;

/// Figures of a driver that others read while it runs.
#[derive(Debug, Default)]
struct Shared {
    received: AtomicU64,
    lost: AtomicU64,
    malformed: AtomicU64,
    quality: AtomicI32,
    period_ns: AtomicU64,
    tracking_error_bits: AtomicU64,
    /// No number while the clock is not known.
    clock_ppb_bits: AtomicU64,
}

/// Figures of a driver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FriFigures<Q> {
    /// Measurements received.
    pub datagrams: u64,
    /// Measurements that never came.
    pub lost: u64,
    /// Datagrams that were none.
    pub malformed: u64,
    /// Quality of the connection as the controller judges it.
    pub quality: Q,
    /// Time from one measurement to the next; `None` before the first.
    pub period: Option<Duration>,
    /// Largest distance of a joint from its set-point while commanding, rad.
    pub tracking_error_rad_max: f64,
    /// How much faster than this host's the robot's clock runs, ppb; `None` while that is not known.
    pub clock_ppb: Option<f64>,
}

/// A running driver.
#[derive(Debug)]
pub struct FriArm<P> {
    address: SocketAddr,
    shared: Arc<Shared>,
    /// Time from the arrival of a measurement to the sending of its answer.
    pub answer_time: RecorderReader,
    /// Time from the instant for which a position was meant to its sending.
    pub set_point_age: RecorderReader,
    /// Time between the arrival of a measurement, early or late, and its instant on the robot's clock.
    pub phase_error: RecorderReader,
    thread: DriverThread,
    protocol: PhantomData<fn() -> P>,
}

/// How the thread of a driver is to run.
#[derive(Clone, Debug)]
pub(super) struct Settings {
    /// Where datagrams arrive.
    pub(super) listen: SocketAddr,
    /// `SCHED_FIFO` priority; `None` for an ordinary thread.
    pub(super) priority: Option<u8>,
    /// Processors; empty for any.
    pub(super) cpus: Vec<usize>,
}

/// Opens the socket at which the controller's datagrams arrive.
///
/// # Errors
/// If the address cannot be listened at.
pub(super) fn listen(name: &str, address: SocketAddr) -> Result<UdpLink, Error> {
    UdpLink::bind(address).map_err(|source| refused(name, address, source))
}

fn refused(name: &str, address: SocketAddr, source: std::io::Error) -> Error {
    Error::Device {
        name: name.to_owned(),
        what: format!("listen at {address}"),
        source,
    }
}

impl<P: Protocol> FriArm<P> {
    /// Starts the driver thread. On the clock that it tells, zero and every whole period is the instant of
    /// a measurement.
    ///
    /// # Errors
    /// If the socket has no address or the system has no thread to give.
    pub(super) fn launch(
        session: P,
        description: DeviceDescription,
        settings: Settings,
        link: UdpLink,
        ends: DriverEnds,
    ) -> Result<Self, Error> {
        let name = description.name.clone();
        let (end, clock) = ends.only(&name)?;
        let address = link
            .local_addr()
            .map_err(|source| refused(&name, settings.listen, source))?;
        let shared = Arc::new(Shared::default());
        // Boxed, so that the thread's small stack does not hold it as it is moved there.
        let parts = (end, clock, Arc::clone(&shared));
        let mut driver = Box::new(Driver::new(session, &description, link, parts));
        let (answer_time, set_point_age) =
            (driver.answer_time.reader(), driver.set_point_age.reader());
        let phase_error = driver.phase_error.reader();
        let Settings { priority, cpus, .. } = &settings;
        let thread = DriverThread::start(&name, *priority, cpus, move |stopping| {
            let scope = takt_rt::alloc::enter_real_time();
            while !stopping.load(Ordering::Relaxed) {
                driver.serve();
            }
            drop(scope);
            driver.clock_out
        })?;
        Ok(Self {
            address,
            shared,
            answer_time,
            set_point_age,
            phase_error,
            thread,
            protocol: PhantomData,
        })
    }

    /// Where it listens.
    #[must_use]
    pub const fn address(&self) -> SocketAddr {
        self.address
    }

    /// Its figures so far.
    #[must_use]
    pub fn figures(&self) -> FriFigures<P::Quality> {
        let Shared {
            received,
            lost,
            malformed,
            quality,
            period_ns,
            tracking_error_bits,
            clock_ppb_bits,
        } = &*self.shared;
        let clock_ppb = f64::from_bits(clock_ppb_bits.load(Ordering::Relaxed));
        let period_ns = period_ns.load(Ordering::Relaxed);
        FriFigures {
            datagrams: received.load(Ordering::Relaxed),
            lost: lost.load(Ordering::Relaxed),
            malformed: malformed.load(Ordering::Relaxed),
            quality: P::quality(quality.load(Ordering::Relaxed)),
            period: (period_ns > 0).then(|| Duration::from_nanos(period_ns)),
            tracking_error_rad_max: f64::from_bits(tracking_error_bits.load(Ordering::Relaxed)),
            clock_ppb: (period_ns > 0 && !clock_ppb.is_nan()).then_some(clock_ppb),
        }
    }
}

impl<P: Protocol> DeviceDriver for FriArm<P> {
    fn thread(&self) -> &DriverThread {
        &self.thread
    }

    fn into_thread(self: Box<Self>) -> DriverThread {
        self.thread
    }

    fn figures(&self) -> Vec<(&'static str, String)> {
        let figures = self.figures();
        vec![
            ("quality", format!("{:?}", figures.quality)),
            ("lost", figures.lost.to_string()),
        ]
    }
}

/// What was last told to nets, for differences.
#[derive(Default)]
struct Published {
    state: DeviceState,
    positions: Option<[f64; AXES]>,
    velocities: Option<[f64; AXES]>,
}

struct Driver<P> {
    link: UdpLink,
    session: P,
    clock: DatagramClock,
    joints: Vec<Joint>,
    last: Published,
    /// The newest command.
    taken: DeviceCommand,
    interfaces: Interfaces,
    force: ForceByTorques,
    /// Time from one cycle of the net thread to the next.
    net_period: Nanos,
    /// The robot's cycles since the last answer. Its speed check counts in these, so the joints'
    /// limits do too, whatever its clock does.
    cycles: i64,
    state: LatestWriter<DeviceState>,
    command: LatestReader<DeviceCommand>,
    shared: Arc<Shared>,
    answer_time: Recorder,
    set_point_age: Recorder,
    phase_error: Recorder,
    clock_out: LatestWriter<Estimate>,
}

impl<P: Protocol> Driver<P> {
    fn new(
        session: P,
        description: &DeviceDescription,
        link: UdpLink,
        (end, clock_out, shared): (DeviceEnd, LatestWriter<Estimate>, Arc<Shared>),
    ) -> Self {
        let mut layout = Layout::default();
        let interfaces = parts::lay(&description.parts, AXES, &mut layout);
        Self {
            link,
            session,
            clock: DatagramClock::default(),
            joints: description.limits.iter().copied().map(Joint::new).collect(),
            last: Published {
                state: DeviceState::new(layout.signals),
                ..Published::default()
            },
            taken: DeviceCommand::new(layout.commands),
            interfaces,
            force: ForceByTorques::new(&description.model),
            net_period: end.net_period.into(),
            cycles: 0,
            state: end.state,
            command: end.command,
            shared,
            answer_time: Recorder::new(),
            set_point_age: Recorder::new(),
            phase_error: Recorder::new(),
            clock_out,
        }
    }

    fn is_commanding(&self) -> bool {
        self.session.status() == DeviceStatus::Operational
    }

    /// Waits for one datagram and answers it.
    fn serve(&mut self) {
        let mut wait = WAIT;
        let mut newest = None;
        for _ in 0..BACKLOG {
            let mut buffer = [0; ROOM];
            let Ok(Some((len, at))) = self.link.receive(&mut buffer, wait) else {
                break;
            };
            if self.accept(&buffer[..len], at) {
                newest = Some(at);
            }
            // After a stall several wait: only the newest deserves an answer.
            if !self.clock.is_late(nanos(at)) {
                break;
            }
            wait = Duration::ZERO;
        }
        match newest {
            Some(at) => self.answer(nanos(at)),
            None => {
                if let Ok(now) = takt_fri::linux::monotonic() {
                    self.clock.handle_time(nanos(now));
                    self.publish_clock();
                    let is_gone = self.session.hear_nothing(now);
                    self.take_orders(now);
                    if is_gone {
                        self.publish(nanos(now));
                    } else {
                        self.tell();
                    }
                }
            }
        }
    }

    fn accept(&mut self, datagram: &[u8], at: Duration) -> bool {
        let Some(heard) = self.session.hear(datagram, at) else {
            // Counted by the session; a stranger's datagram is no reason to stop.
            self.count();
            return false;
        };
        if heard.is_new {
            let period = self.session.cycle().unwrap_or(Duration::from_millis(1));
            self.clock.tick(nanos(at), Nanos::from(period), heard.lost);
            self.publish_clock();
            self.phase_error
                .record((nanos(at) - self.clock.now()).abs());
            self.cycles += 1 + i64::from(heard.lost);
        }
        heard.is_new
    }

    /// Answers the newest measurement if it wants an answer, and tells what it says.
    fn answer(&mut self, at: Nanos) {
        if self.session.is_due() {
            self.reply(at);
        }
        self.publish(at);
        self.count();
    }

    fn reply(&mut self, at: Nanos) {
        self.take_orders(Duration::from_nanos(at.0.unsigned_abs()));
        let joints = self.next_positions();
        let mut buffer = [0; ROOM];
        let answer = self.session.reply(&joints, &mut buffer);
        let sent = answer.and_then(|len| self.link.send(buffer.get(..len)?).ok());
        if sent.is_none_or(|sent| sent == 0) {
            return;
        }
        let now = takt_rt::monotonic();
        self.answer_time.record(now - at);
        let moving = self.taken.joints.iter().find(|joint| joint.active);
        if let Some(set_points) = moving.filter(|_| self.is_commanding()) {
            let played = self.clock.now() - delay(set_points);
            self.set_point_age.record(now - played);
        }
    }

    /// Takes what nets command now.
    fn take_orders(&mut self, now: Duration) {
        let taken = &mut self.taken;
        self.command.read_with(|command| taken.copy_from(command));
        let moves = |joint: &Joint| joint.motion().1.abs() > MOVES_FROM;
        let orders = Orders {
            words: &self.taken.words,
            cycle: self.taken.cycle,
            is_fresh: self.is_fresh(),
            moves: self.joints.iter().any(moves),
            now,
        };
        self.session.obey(&self.interfaces, &orders);
    }

    /// Whether the net thread is alive.
    fn is_fresh(&self) -> bool {
        let stale = Nanos(self.clock.period().0 * STALE_AFTER) + self.net_period;
        self.clock.now() - self.taken.time <= stale
    }

    /// Where the joints are to be now.
    fn next_positions(&mut self) -> [f64; AXES] {
        let is_commanding = self.is_commanding();
        let command = &self.taken;
        let mut positions = self.session.rest();
        if !is_commanding {
            self.cycles = 0;
            for ((joint, position), set_points) in
                self.joints.iter_mut().zip(positions).zip(&command.joints)
            {
                joint.rest_at(position, set_points);
            }
            return positions;
        }
        let (period, fresh) = (self.clock.period(), self.is_fresh());
        #[expect(
            clippy::cast_precision_loss,
            reason = "spans of milliseconds are exact"
        )]
        let dt_s = (std::mem::take(&mut self.cycles) * period.0) as f64 * 1e-9;
        for ((joint, position), set_points) in self
            .joints
            .iter_mut()
            .zip(&mut positions)
            .zip(&command.joints)
        {
            let play = self.clock.now() - delay(set_points);
            *position = joint.sample(set_points, fresh, play, dt_s);
        }
        positions
    }

    /// Tells nets how the arm is.
    fn publish(&mut self, at: Nanos) {
        let status = self.session.status();
        let state = &mut self.last.state;
        state.enter(status, at);
        let measured = self.session.measured();
        let velocities = rates(measured, self.last.positions, self.clock.elapsed());
        let accelerations = rates(velocities, self.last.velocities, self.clock.elapsed());
        (self.last.positions, self.last.velocities) = (measured, velocities);
        for (i, told) in state.joints.iter_mut().enumerate().take(AXES) {
            let (position, velocity, acceleration) = self.joints[i].motion();
            let error = match status {
                DeviceStatus::Offline => JointError::Offline,
                DeviceStatus::SafeOperational => JointError::NotEnabled,
                DeviceStatus::Operational => self.joints[i].error(),
            };
            *told = JointState {
                commanded_position: Some(position),
                commanded_velocity: Some(velocity),
                commanded_acceleration: Some(acceleration),
                measured_position: measured.map(|m| m[i]),
                measured_velocity: velocities.map(|v| v[i]),
                measured_acceleration: accelerations.map(|a| a[i]),
                error: error as i32,
            };
        }
        self.tell_torques();
        self.tell();
    }

    /// Hands over what is known, with what became of orders.
    fn tell(&mut self) {
        let signals = &mut self.last.state.signals;
        self.session.report(&self.interfaces, signals);
        let told = &self.last.state;
        self.state.write_with(|state| state.copy_from(told));
    }

    /// Tells what the robot's sensors say of torques and forces; nothing while it is silent.
    fn tell_torques(&mut self) {
        let silent = self.last.state.status == DeviceStatus::Offline;
        let heard = Some(&self.session).filter(|_| !silent);
        let estimated = heard.and_then(P::external_torques);
        let measured = heard.and_then(P::measured_torques);
        let signals = &mut self.last.state.signals;
        let places = self.interfaces.torques.iter().flat_map(|t| t.iter());
        for (axis, place) in places.enumerate() {
            let of_axis = |values: Joints| values.get(axis).copied();
            place.estimated.tell(signals, estimated.and_then(of_axis));
            place.measured.tell(signals, measured.and_then(of_axis));
        }
        if let Some(place) = &self.interfaces.wrench {
            let felt = || heard.and_then(P::measured).zip(estimated);
            let wrench = heard.and_then(P::wrench).or_else(|| {
                felt().and_then(|(joints, torques)| self.force.estimate(&joints, &torques))
            });
            place.tell(signals, wrench);
        }
    }

    fn publish_clock(&mut self) {
        let clock = self.clock.estimate();
        self.clock_out.write(clock);
        let ppb = if clock.state.is_followed() {
            clock.frequency_ppb
        } else {
            f64::NAN
        };
        let bits = &self.shared.clock_ppb_bits;
        bits.store(ppb.to_bits(), Ordering::Relaxed);
    }

    fn count(&self) {
        let totals = self.session.totals();
        let shared = &self.shared;
        shared.received.store(totals.received, Ordering::Relaxed);
        shared.lost.store(totals.lost, Ordering::Relaxed);
        shared.malformed.store(totals.malformed, Ordering::Relaxed);
        let quality = self.session.quality_code();
        shared.quality.store(quality, Ordering::Relaxed);
        let period_ns = self.clock.period().0.unsigned_abs();
        shared.period_ns.store(period_ns, Ordering::Relaxed);
        let pair = self.session.set_point().zip(self.session.measured());
        if let Some((wanted, measured)) = pair.filter(|_| self.is_commanding()) {
            let distances = wanted.into_iter().zip(measured);
            let error = distances.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            let bits = &shared.tracking_error_bits;
            let worst = f64::from_bits(bits.load(Ordering::Relaxed)).max(error);
            bits.store(worst.to_bits(), Ordering::Relaxed);
        }
    }
}

/// How far behind the robot's clock set-points are played: one and a half times what lies between
/// two of them, so that the two around that instant are there even if the net is half of it late.
const fn delay(set_points: &JointSetPoints) -> Nanos {
    Nanos(set_points.period.0 * 3 / 2)
}

/// Change of each value per second; `None` while there is no earlier value or no time has passed.
fn rates(
    now: Option<[f64; AXES]>,
    before: Option<[f64; AXES]>,
    span: Nanos,
) -> Option<[f64; AXES]> {
    let (now, before) = now.zip(before).filter(|_| span.0 > 0)?;
    #[expect(
        clippy::cast_precision_loss,
        reason = "spans of milliseconds are exact"
    )]
    let span_s = span.0 as f64 * 1e-9;
    Some(std::array::from_fn(|i| (now[i] - before[i]) / span_s))
}

fn nanos(time: Duration) -> Nanos {
    Nanos::from(time)
}
