//! The driver of a mobile base on Segway RMP power bases: a thread that receives their state and sends what nets
//! command, every period. The protocol, the ramps and the odometry are in `takt_can::rmp`.

mod platform;
mod wire;

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use takt_can::load::{Load, LoadMeter, LoadReader};
use takt_can::rmp::{self, ACCELERATION, Model, Motion, State, YawSign};
use takt_net::device::Base;
use takt_net::value::{Frame, Rotation, Twist, Vector};

use crate::config::RmpConfig;
use platform::Led;
use takt_core::Error;
use takt_core::device::continuity::JumpPart;
use takt_core::device::driver::{BusLoad, DeviceDriver, DriverEnds, DriverEvent, DriverThread};
use takt_core::device::endpoint::Endpoint;
use takt_core::device::link_watch::{LinkErrors, LinkWatch};
use takt_core::device::parts::with_figures;
use takt_core::device::{DeviceDescription, DeviceStatus, Figure, Part};
pub use wire::Wire;

/// Largest speed that nets may command, m/s.
const VELOCITY_MAX: f64 = 1.8;
/// Largest rotation that nets may command, rad/s.
const ROTATION_MAX: f64 = 2.0;
/// Shutdown time limit: from full speed a base needs half of it to stop.
const REST_WITHIN: Duration = Duration::from_millis(3_600);
/// Longest sleep of the thread: a tenth of the power bases' cycle would be a waste, a whole one late.
const WAIT: Duration = Duration::from_millis(2);
/// Commands older than this are ignored.
const STALE: Duration = Duration::from_millis(200);
/// Most frames received from a link at once.
const BACKLOG: usize = 64;

/// Description of the base.
#[must_use]
pub fn describe(config: &RmpConfig) -> DeviceDescription {
    let (kind, wheels) = match config.links.len() {
        2 => ("segway_rmp_omni", 4),
        _ => ("segway_rmp", 2),
    };
    DeviceDescription {
        name: config.name.clone(),
        kind,
        limits: Vec::new(),
        model: "".into(),
        parts: with_figures(
            &[Part::Base {
                wheels,
                velocity_max: VELOCITY_MAX,
                rotation_max: ROTATION_MAX,
                acceleration_max: ACCELERATION[0],
                rotation_acceleration_max: ACCELERATION[1],
            }],
            figures(config.links.len()),
        ),
    }
}

/// What the driver reports about its power bases and their links.
fn figures(links: usize) -> Vec<Figure> {
    let mut all = vec![Figure::number("rmp.received"), Figure::number("rmp.failed")];
    for link in 0..links.min(2) {
        all.push(Figure::state(format!("rmp.{link}.state"), WORDS));
        all.push(Figure::with_unit(format!("rmp.{link}.bit_rate"), "bit/s"));
    }
    all
}

/// States of a power base, by [`code`].
const WORDS: [&str; 9] = [
    "none",
    "silent",
    "powered off",
    "configuring",
    "ready",
    "emergency stop",
    "fault",
    "motors disabled",
    "mode refused",
];

/// Checks a configuration.
///
/// # Errors
/// With a text that names the finding.
pub fn check(config: &RmpConfig) -> Result<(), String> {
    let name = &config.name;
    let Some(model) = Model::named(&config.model) else {
        let known = Model::ALL.map(Model::name).join(", ");
        return Err(format!(
            "{name}: there is no model `{}`; there are {known}",
            config.model
        ));
    };
    if YawSign::named(&config.yaw_integral).is_none() {
        let known = YawSign::ALL.map(YawSign::name).join(" or ");
        return Err(format!(
            "{name}: yaw_integral is `{}`; it is {known}",
            config.yaw_integral
        ));
    }
    match (config.links.len(), model) {
        (1, _) | (2, Model::Rmp50) => {}
        (2, _) => return Err(format!("{name}: a platform of two power bases is of rmp50")),
        (n, _) => {
            return Err(format!(
                "{name}: {n} links; one for a base of two wheels, two (front, back) for a platform"
            ));
        }
    }
    let range = Duration::from_millis(10)..=Duration::from_millis(300);
    if range.contains(&config.period) {
        Ok(())
    } else {
        Err(format!(
            "{name}: period is {:?}; power bases take commands every 10ms to 300ms",
            config.period
        ))
    }
}

/// Opens the links of a base.
///
/// # Errors
/// If one cannot be opened.
pub fn open(config: &RmpConfig) -> Result<Vec<Wire>, Error> {
    let open = |link: &String| {
        Wire::open(link).map_err(|source| Error::Device {
            name: config.name.clone(),
            what: format!("open {link}"),
            source,
        })
    };
    config.links.iter().map(open).collect()
}

/// Counters of a running driver that other threads read.
#[derive(Debug, Default)]
struct Shared {
    frames: AtomicU64,
    failed: AtomicU64,
    jumps: AtomicU64,
    states: [AtomicU64; 2],
}

/// A running driver.
#[derive(Debug)]
pub struct Rmp {
    shared: Arc<Shared>,
    /// One per wire.
    links: Vec<LinkWatch>,
    /// One per CAN bus.
    loads: Vec<LoadReader>,
    thread: DriverThread,
}

impl Rmp {
    /// Starts the driver thread on open links, as many as the configuration names.
    ///
    /// # Errors
    /// If the configuration is invalid or the thread cannot be created.
    pub fn start(config: &RmpConfig, wires: Vec<Wire>, ends: DriverEnds) -> Result<Self, Error> {
        check(config).map_err(Error::Cell)?;
        let (end, clock) = ends.only(&config.name)?;
        let shared = Arc::new(Shared::default());
        let wires_with_names = wires.iter().zip(&config.links);
        let links: Vec<_> = wires_with_names
            .map(|(wire, name)| wire.watch(name))
            .collect();
        let meters = wires.iter().zip(&config.links);
        let meters = meters.map(|(wire, name)| wire.meter(name).unzip());
        let (meters, loads): (Vec<_>, Vec<_>) = meters.unzip();
        let mut driver = Box::new(Driver {
            meters,
            loads: loads.clone(),
            errors: links.iter().map(LinkWatch::errors).collect(),
            wires,
            platform: Led::new(config),
            is_stopping: false,
            end: Endpoint::new(end, &describe(config).parts, 0),
            taken_at: Duration::ZERO,
            jumps: 0,
            shared: Arc::clone(&shared),
        });
        let RmpConfig {
            name,
            priority,
            cpus,
            ..
        } = config;
        let thread = DriverThread::start(name, *priority, cpus, move |stopping| {
            let scope = takt_rt::alloc::enter_real_time();
            while !stopping.load(Ordering::Relaxed) {
                driver.serve();
            }
            driver.bring_to_rest();
            drop(scope);
            clock
        })?;
        Ok(Self {
            shared,
            links,
            loads: loads.into_iter().flatten().collect(),
            thread,
        })
    }

    /// Wheel steps that odometry rejected: integrators were reset unexpectedly.
    #[must_use]
    pub fn jumps(&self) -> u64 {
        self.shared.jumps.load(Ordering::Relaxed)
    }
}

impl DeviceDriver for Rmp {
    fn thread(&self) -> &DriverThread {
        &self.thread
    }

    fn into_thread(self: Box<Self>) -> DriverThread {
        self.thread
    }

    fn figures(&self) -> Vec<(&'static str, String)> {
        let number = |figure: &AtomicU64| figure.load(Ordering::Relaxed).to_string();
        let [first, second] = &self.shared.states;
        vec![
            ("frames", number(&self.shared.frames)),
            ("failed", number(&self.shared.failed)),
            ("first", word(first).to_owned()),
            ("second", word(second).to_owned()),
        ]
    }

    fn bus_loads(&self) -> Vec<BusLoad> {
        let of = |reader: &LoadReader| {
            let Load { last, most } = reader.read()?;
            Some(BusLoad {
                bus: reader.bus().to_owned(),
                bit_rate: reader.bit_rate(),
                bits_per_s: last,
                bits_per_s_max: most,
            })
        };
        self.loads.iter().filter_map(of).collect()
    }

    fn poll_event(&self) -> Option<DriverEvent> {
        let now = Instant::now();
        self.links.iter().find_map(|link| link.poll(now))
    }
}

/// States as numbers for an atomic, and back as words.
const fn code(state: State) -> u64 {
    match state {
        State::Silent => 1,
        State::PoweredOff => 2,
        State::Configuring => 3,
        State::Ready => 4,
        State::Blocked(rmp::Hindrance::EmergencyStop) => 5,
        State::Blocked(rmp::Hindrance::Fault(_)) => 6,
        State::Blocked(rmp::Hindrance::MotorsDisabled) => 7,
        State::Blocked(rmp::Hindrance::ModeRefused(_)) => 8,
    }
}

fn word(state: &AtomicU64) -> &'static str {
    let code = state.load(Ordering::Relaxed);
    let index = usize::try_from(code).unwrap_or_default();
    WORDS.get(index).copied().unwrap_or_default()
}

struct Driver {
    wires: Vec<Wire>,
    /// One per wire; `None` of a serial port.
    meters: Vec<Option<LoadMeter>>,
    /// Their readers.
    loads: Vec<Option<LoadReader>>,
    /// One per wire.
    errors: Vec<Arc<LinkErrors>>,
    platform: Led,
    /// Whether the thread is stopping: no command is followed.
    is_stopping: bool,
    end: Endpoint,
    taken_at: Duration,
    /// Number of rejected wheel steps at that time.
    jumps: u64,
    shared: Arc<Shared>,
}

impl Driver {
    /// Receives for a moment, then sends what is due and publishes the state.
    fn serve(&mut self) {
        self.receive();
        self.lead(takt_can::linux::monotonic());
    }

    fn receive(&mut self) {
        let mut wait = WAIT;
        for part in 0..self.wires.len() {
            for _ in 0..BACKLOG {
                let received = self.wires[part].receive(wait, &self.errors[part]);
                let Ok(Some((channel, frame, at))) = received else {
                    if received.is_err() {
                        pause(wait);
                    }
                    break;
                };
                wait = Duration::ZERO;
                if let Some(meter) = &mut self.meters[part] {
                    meter.add(&frame.into());
                }
                self.shared.frames.fetch_add(1, Ordering::Relaxed);
                self.platform.handle(part, channel, &frame, at);
            }
        }
    }

    fn lead(&mut self, now: Duration) {
        let wanted = self.wanted(now).filter(|_| !self.is_stopping);
        let frames = self.platform.command(wanted, now);
        let wires = self.wires.iter_mut().zip(&self.errors);
        for ((frame, (wire, errors)), meter) in frames.iter().zip(wires).zip(&mut self.meters) {
            let is_sent = frame.as_ref().map(|frame| wire.send(frame, errors));
            if is_sent == Some(false) {
                self.shared.failed.fetch_add(1, Ordering::Relaxed);
            }
            if let Some(meter) = meter {
                if let Some(frame) = frame.filter(|_| is_sent == Some(true)) {
                    meter.add(&frame.into());
                }
                meter.poll(now);
            }
        }
        self.publish(wanted);
    }

    /// The velocity that nets command, if fresh.
    fn wanted(&mut self, now: Duration) -> Option<[f64; 3]> {
        let before = self.end.taken.cycle;
        self.end.take();
        if self.end.taken.cycle != before {
            self.taken_at = now;
        }
        let base = self.end.interfaces.base.as_ref()?;
        let given = base.command.read(&self.end.taken.words)?;
        let fresh = now.saturating_sub(self.taken_at) <= STALE;
        let Twist { vel, rot } = given.value;
        (fresh && given.is_in_force(self.end.taken.cycle)).then_some([vel.x, vel.y, rot.z])
    }

    fn publish(&mut self, wanted: Option<[f64; 3]>) {
        let status = self.platform.status();
        let jumps = self.platform.jumps();
        let jumped = jumps > std::mem::replace(&mut self.jumps, jumps);
        let followed = self.end.reported.status == DeviceStatus::Operational;
        if let Some(jump) = self.platform.jump().filter(|_| jumped && followed) {
            let part = if jump.is_turn {
                JumpPart::Turning
            } else {
                JumpPart::Floor
            };
            self.end.reported.jumped.add(part, jump.by, jump.most);
        }
        for (limited, held_back) in self
            .end
            .reported
            .limited
            .iter_mut()
            .zip(self.platform.limited())
        {
            *limited = *held_back;
        }
        let motion = *self.platform.motion();
        self.end.reported.enter(status, motion.stamp.into());
        if let Some(base) = &self.end.interfaces.base {
            let follows = self.platform.follows() || wanted.is_none();
            report_base(
                base,
                &mut self.end.reported.signals,
                &motion,
                wanted,
                follows,
            );
            let (angles, rates) = self.platform.wheels();
            for ((wheel, angle), rate) in base.wheels.iter().zip(angles).zip(rates) {
                wheel
                    .position
                    .report(&mut self.end.reported.signals, Some(angle));
                wheel
                    .velocity
                    .report(&mut self.end.reported.signals, Some(rate));
            }
        }
        self.report_figures();
        self.end.publish();
        self.shared
            .jumps
            .store(self.platform.jumps(), Ordering::Relaxed);
        for (state, to) in self.platform.states().into_iter().zip(&self.shared.states) {
            to.store(state.map_or(0, code), Ordering::Relaxed);
        }
    }

    fn report_figures(&mut self) {
        let count = |count: &AtomicU64| Some(Figure::count(count.load(Ordering::Relaxed)));
        let counted = [&self.shared.frames, &self.shared.failed].map(count);
        self.end.report_figures(0, counted);
        let states = self.platform.states().into_iter();
        let loads = self.loads.iter();
        for (link, (state, load)) in states.zip(loads).enumerate() {
            let bits = load.as_ref().and_then(LoadReader::read);
            let values = [
                Some(Figure::count(state.map_or(0, code))),
                bits.map(|load| f64::from(load.last)),
            ];
            self.end.report_figures(2 + 2 * link, values);
        }
    }

    /// Brakes the base as when commands end, then disables it: power bases stop later by themselves.
    fn bring_to_rest(&mut self) {
        self.is_stopping = true;
        let until = takt_can::linux::monotonic() + REST_WITHIN;
        while self.platform.follows() && !self.platform.rests() {
            if takt_can::linux::monotonic() >= until {
                break;
            }
            self.serve();
        }
        let frame = rmp::Command::default().frame();
        for (wire, errors) in self.wires.iter_mut().zip(&self.errors) {
            wire.send(&frame, errors);
        }
    }
}

/// A lost link fails at once: sleeps instead of waiting for it.
fn pause(wait: Duration) {
    let until = takt_rt::monotonic() + wait.into();
    // Fails only for invalid times.
    takt_rt::sleep_until(until).ok();
}

fn report_base(
    base: &Base,
    signals: &mut [u64],
    motion: &Motion,
    wanted: Option<[f64; 3]>,
    follows: bool,
) {
    let twist = |[x, y, turn]: [f64; 3]| Twist {
        vel: Vector::new(x, y, 0.0),
        rot: Vector::new(0.0, 0.0, turn),
    };
    let pose = motion.pose;
    let rotation = Rotation::from_axis_angle(&Vector::z_axis(), pose.heading);
    let place = Frame::from_parts([pose.x, pose.y, 0.0].into(), rotation);
    let error = if follows {
        takt_net::device::JointError::None
    } else {
        takt_net::device::JointError::NotEnabled
    };
    base.error.report(signals, Some(error as i32));
    base.commanded.report(signals, wanted.map(twist));
    base.velocity.report(signals, Some(twist(motion.velocity)));
    base.pose.report(signals, Some(place));
}

#[cfg(test)]
mod ends_tests;
#[cfg(test)]
mod tests;
