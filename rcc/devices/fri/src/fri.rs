//! The driver of a KUKA arm over FRI of either generation: a thread that waits for the controller's datagram and
//! answers it at once with what nets command for that instant of the robot's own clock. The protocols are in
//! `takt_fri`; their differences are behind `Protocol`.

mod clock;
mod driver;
mod events;
mod figures;
mod force;
pub(super) mod orders;
mod protocol;
mod silence;
#[cfg(test)]
mod tests;

use std::marker::PhantomData;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::{AtomicI32, AtomicU32, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use takt_fri::diagnosis::Verdict;
use takt_fri::error::DecodeError;
use takt_fri::guard::{Guard, Violation};
use takt_fri::link::Link;
use takt_fri::linux::UdpLink;
use takt_fri::sunrise::wire::MESSAGE_MAX;
use takt_net::JointLimits;
use takt_rt::Nanos;
use takt_rt::interface::{Medium, interface_of, local_address_to};
use takt_rt::stats::{RecorderReader, StallReader, StallWriter, stalls};

use driver::Driver;
use events::{EventReceiver, advice, event_channel};
use silence::SilenceWatch;
use takt_core::Error;
use takt_core::device::DeviceDescription;
use takt_core::device::driver::{DeviceDriver, DriverEnds, DriverEvent, DriverThread};
use takt_core::device::link_watch::{LinkErrors, LinkWatch};

pub(super) use figures::figures;
pub use orders::Orders;
pub use protocol::{AXES, Joints, Protocol, Reception, RefusedOutput, Totals};

/// Buffer for any datagram, with one extra byte to detect longer ones.
const ROOM: usize = MESSAGE_MAX + 1;
/// Longest wait for a datagram, so that a stop request is noticed soon.
const WAIT: Duration = Duration::from_millis(20);
/// Shutdown time limit: the driver keeps answering until the arm is at rest. From full speed at the joints'
/// acceleration limit it needs less than half of that.
const SHUTDOWN_MAX: Duration = Duration::from_secs(2);
/// A step that takes longer than this at full speed does not belong to a stream of set-points, s.
const STEP_S: f64 = 0.2;
/// Most waiting datagrams received before one of them is answered.
const BACKLOG: usize = 64;
/// A datagram that waited this long was delayed by a stall of this thread: four cycles of the fastest robots.
const STALL: Nanos = Nanos::from_millis(4);

/// Counters of a running driver that other threads read.
#[derive(Debug, Default)]
struct Shared {
    received: AtomicU64,
    lost: AtomicU64,
    /// The IPv4 address of the robot's controller; zero before the first contact.
    robot: AtomicU32,
    malformed: AtomicU64,
    quality: AtomicI32,
    period_ns: AtomicU64,
    tracking_error_bits: AtomicU64,
    /// NaN while the clock is not known.
    clock_ppb_bits: AtomicU64,
}

/// Figures of a driver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FriFigures<Q> {
    /// Measurements received.
    pub datagrams: u64,
    /// Measurements lost.
    pub lost: u64,
    /// Malformed datagrams.
    pub malformed: u64,
    /// Quality of the connection as the controller judges it.
    pub quality: Q,
    /// Time between measurements; `None` before the first.
    pub period: Option<Duration>,
    /// Largest distance of a joint from its set-point while commanding, rad.
    pub tracking_error_rad_max: f64,
    /// Frequency offset of the robot's clock against this host's, ppb; `None` while unknown.
    pub clock_ppb: Option<f64>,
    /// Which side is late, by the last 100 to 200 measurements.
    pub verdict: Verdict,
    /// Decode error of the last malformed datagram.
    pub decode_error: Option<DecodeError>,
    /// The last command that was withheld: which joint, which limit.
    pub violation: Option<Violation>,
    /// The last output that could not be written.
    pub refused_output: Option<RefusedOutput>,
    /// Measurements of controllers other than the peer.
    pub foreign: u64,
}

/// A running driver.
#[derive(Debug)]
pub struct FriArm<P> {
    address: SocketAddr,
    shared: Arc<Shared>,
    /// Time from the arrival of a measurement to the sending of its answer.
    pub answer_time: RecorderReader,
    /// Time from the instant that a position is meant for to its sending.
    pub set_point_age: RecorderReader,
    /// Time between the arrival of a measurement and its instant on the robot's clock, either sign.
    pub phase_error: RecorderReader,
    event_receiver: Arc<EventReceiver>,
    silence: SilenceWatch,
    stalls: StallReader,
    watch: LinkWatch,
    thread: DriverThread,
    protocol: PhantomData<fn() -> P>,
}

/// Thread settings of a driver.
#[derive(Clone, Debug)]
pub(super) struct Settings {
    /// Socket address for datagrams.
    pub(super) listen: SocketAddr,
    /// `SCHED_FIFO` priority; `None` for an ordinary thread.
    pub(super) priority: Option<u8>,
    /// Processors; empty for any.
    pub(super) cpus: Vec<usize>,
}

/// Opens the socket for the controller's datagrams.
///
/// # Errors
/// If the address cannot be bound.
pub(super) fn listen(name: &str, address: SocketAddr) -> Result<UdpLink, Error> {
    UdpLink::bind(address).map_err(|source| refused(name, address, source))
}

fn refused(name: &str, address: SocketAddr, source: std::io::Error) -> Error {
    Error::Device {
        name: name.to_owned(),
        what: format!("bind {address}"),
        source,
    }
}

impl<P: Protocol> FriArm<P> {
    /// Starts the driver thread. On the clock that it publishes, zero and every whole period is the instant of a
    /// measurement.
    ///
    /// # Errors
    /// If the socket has no address or the thread cannot be created.
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
        let (event_sender, event_receiver) = event_channel(session.observer());
        let event_receiver = Arc::new(event_receiver);
        // Boxed, so that the thread's small stack does not hold it while it is moved there.
        let parts = (end, clock, Arc::clone(&shared));
        let driver = Driver::new(session, &description, event_sender, parts);
        let (answer_time, set_point_age) =
            (driver.answer_time.reader(), driver.set_point_age.reader());
        let phase_error = driver.phase_error.reader();
        let (stall_writer, stalls) = stalls();
        // For a wildcard address, the interface is known once the robot is.
        let interface = interface_of(address.ip()).ok().flatten();
        let watch = LinkWatch::new(&address.to_string(), interface.as_deref(), Medium::Ip);
        let errors = watch.errors();
        let mut exchange = Box::new(Exchange {
            link,
            driver,
            errors,
            shared: Arc::clone(&shared),
            stalls: stall_writer,
        });
        let Settings { priority, cpus, .. } = &settings;
        let thread = DriverThread::start(&name, *priority, cpus, move |stopping| {
            let scope = takt_rt::alloc::enter_real_time();
            // A controller that was there first filled the socket while this thread was made.
            let _failed = exchange.link.discard_queued();
            while !stopping.load(Ordering::Relaxed) {
                exchange.serve();
            }
            exchange.bring_to_rest();
            drop(scope);
            exchange.driver.into_clock()
        })?;
        let events = Arc::clone(&event_receiver);
        let silence = SilenceWatch::start(&name, address, Arc::clone(&shared), events);
        Ok(Self {
            address,
            shared,
            answer_time,
            set_point_age,
            phase_error,
            event_receiver,
            silence,
            stalls,
            watch,
            thread,
            protocol: PhantomData,
        })
    }

    /// The local address.
    #[must_use]
    pub const fn address(&self) -> SocketAddr {
        self.address
    }

    /// Current figures.
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
            ..
        } = &*self.shared;
        let clock_ppb = f64::from_bits(clock_ppb_bits.load(Ordering::Relaxed));
        let period_ns = period_ns.load(Ordering::Relaxed);
        let diagnostics = self.event_receiver.diagnostics();
        FriFigures {
            datagrams: received.load(Ordering::Relaxed),
            lost: lost.load(Ordering::Relaxed),
            malformed: malformed.load(Ordering::Relaxed),
            quality: P::quality(quality.load(Ordering::Relaxed)),
            period: (period_ns > 0).then(|| Duration::from_nanos(period_ns)),
            tracking_error_rad_max: f64::from_bits(tracking_error_bits.load(Ordering::Relaxed)),
            clock_ppb: (period_ns > 0 && !clock_ppb.is_nan()).then_some(clock_ppb),
            verdict: diagnostics.verdict,
            decode_error: diagnostics.decode_error,
            violation: diagnostics.violation,
            refused_output: diagnostics.refused_output,
            foreign: diagnostics.foreign,
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
        let mut reported = vec![
            ("quality", format!("{:?}", figures.quality)),
            ("lost", figures.lost.to_string()),
            ("timing", advice(figures.verdict)),
        ];
        if let Some(decode_error) = figures.decode_error {
            reported.push((
                "refused",
                format!("{}, last: {decode_error}", figures.malformed),
            ));
        }
        if let Some(violation) = figures.violation {
            reported.push(("withheld", violation.to_string()));
        }
        if let Some(output) = figures.refused_output {
            reported.push(("output", output.to_string().replace('\n', "; ")));
        }
        if figures.foreign > 0 {
            reported.push(("foreign", figures.foreign.to_string()));
        }
        reported
    }

    fn waits_at(&self) -> Option<SocketAddr> {
        Some(self.address)
    }

    fn stalls(&self) -> Option<&StallReader> {
        Some(&self.stalls)
    }

    fn poll_event(&self) -> Option<DriverEvent> {
        // With a wildcard address, the interface is that of the route to the robot.
        let robot = self.shared.robot.load(Ordering::Relaxed);
        if robot != 0 {
            self.watch.find(|| {
                let robot = IpAddr::from(Ipv4Addr::from_bits(robot));
                interface_of(local_address_to(robot)?).ok().flatten()
            });
        }
        if let Some(event) = self.watch.poll(Instant::now()) {
            return Some(event);
        }
        let Some(event) = self.event_receiver.poll() else {
            return self.silence.poll();
        };
        let text = event.text(|code| format!("{:?}", P::quality(code)));
        Some(DriverEvent::new(event.severity(), text))
    }
}

/// A driver and its socket.
struct Exchange<P> {
    link: UdpLink,
    driver: Driver<P>,
    stalls: StallWriter,
    errors: Arc<LinkErrors>,
    shared: Arc<Shared>,
}

impl<P: Protocol> Exchange<P> {
    /// Waits for one datagram and answers it.
    fn serve(&mut self) {
        let mut wait = WAIT;
        let mut newest = None;
        for number in 0..BACKLOG {
            let mut buffer = [0; ROOM];
            let (len, at) = match self.link.receive(&mut buffer, wait) {
                Ok(Some(received)) => received,
                Ok(None) => break,
                Err(error) => {
                    self.errors.note_io(&error);
                    break;
                }
            };
            if number == 0 {
                self.note_wake_up(at.into());
            }
            let Some(from) = self.link.peer() else {
                break;
            };
            if self.driver.accept(from, &buffer[..len], at) {
                newest = Some(at);
            }
            // After a stall several are waiting: only the newest is answered.
            if !self.driver.is_late(takt_rt::monotonic()) {
                break;
            }
            wait = Duration::ZERO;
        }
        match newest {
            Some(at) => self.answer(at.into()),
            None => {
                if let Ok(now) = takt_fri::linux::monotonic() {
                    self.driver.handle_silence(now);
                }
            }
        }
    }

    /// How long this thread left a datagram waiting that arrived `at`, by the kernel's stamp.
    fn note_wake_up(&mut self, at: Nanos) {
        let now = takt_rt::monotonic();
        self.driver.note_wake_up(now - at);
        if now - at >= STALL {
            self.stalls.note(now, now - at);
        }
    }

    /// Answers before anything else.
    fn answer(&mut self, at: Nanos) {
        let mut buffer = [0; ROOM];
        let answer = self.driver.answer(at, &mut buffer);
        if let Some(peer) = self.driver.peer() {
            self.link.answer_to(peer);
            if let IpAddr::V4(robot) = peer.ip() {
                self.shared.robot.store(robot.to_bits(), Ordering::Relaxed);
            }
        }
        let answer = answer.and_then(|len| buffer.get(..len));
        let sent = answer.map_or(Ok(0), |answer| self.link.send(answer));
        if let Err(error) = &sent {
            self.errors.note_io(error);
        }
        if sent.is_ok_and(|sent| sent > 0) {
            self.driver.handle_sent(at, takt_rt::monotonic());
        }
        self.driver.finish(at);
    }

    /// Keeps answering until the arm is at rest: the controller would stop a moving arm hard.
    fn bring_to_rest(&mut self) {
        self.driver.begin_stop();
        let until = takt_rt::monotonic() + SHUTDOWN_MAX.into();
        while !self.driver.is_at_rest() && takt_rt::monotonic() < until {
            self.serve();
        }
    }
}

/// The guard against any command beyond the limits of the joints, whatever its cause. `torque_nm` and `wrench` are
/// the largest that may be added.
pub(super) fn guard(
    names: [&'static str; AXES],
    limits: &[JointLimits],
    torque_nm: Joints,
    wrench: [f64; 6],
) -> Guard {
    let mut guard = Guard {
        torque_nm,
        wrench,
        ..Guard::open(names)
    };
    for (joint, limits) in limits.iter().enumerate().take(AXES) {
        guard.position_rad[joint] = [limits.position_min, limits.position_max];
        guard.speed_rad_per_s[joint] = limits.velocity_max;
        guard.step_rad[joint] = limits.velocity_max * STEP_S;
        guard.deceleration_rad_per_s2[joint] = limits.acceleration_max;
    }
    guard
}
