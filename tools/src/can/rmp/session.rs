//! One power base: heard, driven for a moment, and set up. It judges what is heard; the driver of `takt-can` knows why
//! a power base that is led does not follow.

use std::fmt;
use std::time::Duration;

use takt_can::Frame;
use takt_can::rmp::{
    Base, Channel, Command, Config, DriverConfig, Measurement, Message, Mode, Model, Motion, State,
};

use super::port::Port;

/// Accelerations of a jog, m/s² and rad/s².
const ACCELERATION: f64 = 0.5;
const ROTATION: f64 = 1.0;
/// Time between views.
const VIEW: Duration = Duration::from_millis(200);
/// How long a power base may take until it is heard, until it follows, and until it stands again.
const HEARD: Duration = Duration::from_secs(1);
const FOLLOWS: Duration = Duration::from_secs(6);
const RESTS: Duration = Duration::from_secs(5);
/// How long it may do nothing of what it is told.
const MOVES: Duration = Duration::from_secs(1);
/// A setting is sent that often, as none is acknowledged.
const REPEATS: usize = 3;
/// Slower than this it stands, m/s and rad/s.
const STANDS: f64 = 0.02;
/// Share of cycles that may be broken.
const BROKEN: f64 = 0.01;
const PERIOD: Duration = Duration::from_millis(50);

/// What to do.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Plan {
    pub(super) model: Model,
    /// How long to look; for ever without it. A jog looks as long as it lasts.
    pub(super) look: Option<Duration>,
    pub(super) configs: Vec<Config>,
    pub(super) jog: Option<Jog>,
}

/// How to drive it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Jog {
    /// Forward, m/s, and counter-clockwise, rad/s.
    pub(super) velocity: [f64; 2],
    pub(super) time: Duration,
}

/// What is known at a time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct View {
    pub(super) measured: Option<Measurement>,
    pub(super) motion: Motion,
    /// Battery of the user interface, V.
    pub(super) interface_battery: Option<f64>,
    /// Number of the firmware's build.
    pub(super) build: Option<u16>,
    /// Its user interface says that the power base is off.
    pub(super) off: bool,
    /// Whole cycles, and those in which a message was missing.
    pub(super) cycles: u64,
    pub(super) broken: u64,
    /// Integrators that jumped.
    pub(super) jumps: u64,
    /// Commands of another host.
    pub(super) strangers: u64,
}

/// What is wrong.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Finding {
    /// As the driver says it.
    Driver(State),
    /// Something of what it sends in each cycle is missing.
    Broken(u64, u64),
    /// It says that its batteries are low.
    Battery(f64),
    /// Somebody else commands it.
    Stranger(u64),
    /// It is driven and stands.
    Stands,
    /// It is told to rest and moves.
    Moves,
    /// A gain schedule that is another than was set.
    Gain(u16, u16),
}

impl Finding {
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Driver(State::Silent) => "silent",
            Self::Driver(State::PoweredOff) => "powered-off",
            Self::Driver(State::Configuring) => "not-ready",
            Self::Driver(State::Ready) => "ready",
            Self::Driver(State::Blocked(_)) => "blocked",
            Self::Broken(..) => "broken-cycles",
            Self::Battery(_) => "battery",
            Self::Stranger(_) => "another-host",
            Self::Stands => "does-not-move",
            Self::Moves => "does-not-stop",
            Self::Gain(..) => "gain-not-taken",
        }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Driver(state) => state.fmt(f),
            Self::Broken(broken, all) => write!(
                f,
                "in {broken} of {all} cycles a message is missing: frames are lost; see takt can stat, and at the USB \
                 port the latency timer of its chip"
            ),
            Self::Battery(volts) => write!(f, "it says that its battery is low ({volts:.1} V): charge it"),
            Self::Stranger(count) => write!(
                f,
                "another host commands it ({count} commands heard): stop that one, each obeys the other's rest"
            ),
            Self::Stands => f.write_str(
                "it follows commands and does not move: is the velocity scale that it stores too low (--config \
                 velocity=16), are its wheels blocked?",
            ),
            Self::Moves => f.write_str("it was told to rest and still moves: switch it off at its emergency stop"),
            Self::Gain(set, shown) => write!(
                f,
                "gain schedule {set} was set, it shows {shown}: it takes settings only while it stands in mode tractor \
                 or disabled"
            ),
        }
    }
}

/// What came of it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Report {
    pub(super) model: Model,
    pub(super) view: View,
    /// What was set.
    pub(super) configs: Vec<Config>,
    /// Where a jog began.
    pub(super) jogged: bool,
    pub(super) stopped: bool,
    pub(super) findings: Vec<Finding>,
}

impl Report {
    pub(super) fn is_good(&self) -> bool {
        self.findings.is_empty()
    }
}

/// A session with one power base.
#[derive(Debug)]
pub(super) struct Session<'p, P> {
    port: &'p mut P,
    plan: Plan,
    base: Base,
    view: View,
    next_view: Duration,
    findings: Vec<Finding>,
}

/// Shows a view to the user.
type Show<'s> = &'s mut dyn FnMut(&View);

impl<'p, P: Port> Session<'p, P> {
    pub(super) fn new(port: &'p mut P, plan: Plan) -> Self {
        let config = DriverConfig {
            model: plan.model,
            period: PERIOD,
            ..DriverConfig::default()
        };
        Self {
            next_view: port.now() + VIEW,
            port,
            plan,
            base: Base::new(config, ACCELERATION, ROTATION),
            view: View::default(),
            findings: Vec::new(),
        }
    }

    pub(super) fn run(mut self, show: Show<'_>) -> anyhow::Result<Report> {
        match self.plan.jog {
            Some(jog) => self.jog(jog, show)?,
            None => self.look(show)?,
        }
        let configs = std::mem::take(&mut self.plan.configs);
        if self.view.measured.is_some() {
            self.configure(&configs, show)?;
        }
        self.judge();
        Ok(Report {
            model: self.plan.model,
            view: self.view,
            configs,
            jogged: self.plan.jog.is_some(),
            stopped: self.port.is_stopped(),
            findings: self.findings,
        })
    }

    /// Takes what comes until then.
    fn hear(&mut self, until: Duration, show: Show<'_>) -> anyhow::Result<()> {
        loop {
            let left = until.saturating_sub(self.port.now());
            if let Some((channel, frame)) = self.port.receive(left)? {
                self.take(channel, &frame);
            } else if left.is_zero() {
                return Ok(());
            }
            let now = self.port.now();
            if now >= self.next_view {
                self.next_view = now + VIEW;
                show(&self.view);
            }
            if now >= until {
                return Ok(());
            }
        }
    }

    fn take(&mut self, channel: Channel, frame: &Frame) {
        let view = &mut self.view;
        match Message::decode(frame) {
            Some(Message::Build { build, .. }) => view.build = Some(build),
            Some(Message::Operation { ui_battery, .. }) => {
                view.interface_battery = Some(1.4 + 0.0125 * f64::from(ui_battery));
            }
            Some(Message::PowerbaseOff { .. }) => view.off = true,
            Some(Message::Command(_)) => view.strangers += 1,
            Some(
                Message::Attitude { .. }
                | Message::Speed { .. }
                | Message::Wheels { .. }
                | Message::Travel { .. }
                | Message::Torque { .. }
                | Message::Echo { .. }
                | Message::ControlUnit(_)
                | Message::Heartbeat { .. }
                | Message::Interface(_)
                | Message::Shutdown,
            )
            | None => {}
        }
        if self.base.handle_frame(channel, frame, self.port.now()) {
            view.cycles += 1;
            view.off = false;
        }
        view.measured = self.base.driver().measurement().copied();
        view.motion = *self.base.motion();
        view.broken = self.base.driver().broken();
        view.jumps = self.base.jumps();
    }

    /// Listens only.
    fn look(&mut self, show: Show<'_>) -> anyhow::Result<()> {
        let begun = self.port.now();
        let heard = begun + HEARD;
        let end = self.plan.look.map(|look| begun + look);
        while !self.port.is_stopped() {
            let now = self.port.now();
            let silent = self.view.cycles == 0 && now >= heard;
            if end.is_some_and(|end| now >= end) || silent && !self.plan.configs.is_empty() {
                break;
            }
            let until = end.unwrap_or(Duration::MAX).min(now + PERIOD);
            self.hear(until, show)?;
        }
        Ok(())
    }

    /// One period of a host that asks for that motion.
    fn turn(&mut self, wanted: Option<[f64; 2]>, show: Show<'_>) -> anyhow::Result<()> {
        if let Some(frame) = self.base.poll_transmit(wanted, self.port.now()) {
            self.port.send(&frame)?;
        }
        let until = self.base.poll_timeout();
        self.hear(until, show)
    }

    fn follows(&self) -> bool {
        self.base.driver().follows()
    }

    fn speed(&self) -> f64 {
        let [forward, _, rotation] = self.view.motion.velocity;
        forward.abs().max(rotation.abs())
    }

    /// Makes it ready, drives it, brings it to rest, and disables it again.
    fn jog(&mut self, jog: Jog, show: Show<'_>) -> anyhow::Result<()> {
        let end = self.port.now() + FOLLOWS;
        while !self.follows() && self.port.now() < end && !self.port.is_stopped() {
            self.turn(None, show)?;
        }
        if self.follows() {
            self.drive(jog, show)?;
        }
        let state = self.base.driver().state();
        if state != State::Ready && !self.port.is_stopped() {
            self.findings.push(Finding::Driver(state));
        }
        self.rest(show)?;
        let disable = Config::Mode(Mode::Disabled);
        self.set(disable, show)
    }

    fn drive(&mut self, jog: Jog, show: Show<'_>) -> anyhow::Result<()> {
        let begun = self.port.now();
        let wanted = jog
            .velocity
            .iter()
            .fold(0.0, |most: f64, rate| most.max(rate.abs()));
        let (mut moved, mut fastest) = (begun, 0.0_f64);
        while self.port.now() < begun + jog.time && !self.port.is_stopped() && self.follows() {
            self.turn(Some(jog.velocity), show)?;
            fastest = fastest.max(self.speed());
            if self.speed() > wanted / 20.0 {
                moved = self.port.now();
            }
            if wanted > STANDS && self.port.now() > moved + MOVES {
                self.findings.push(Finding::Stands);
                return Ok(());
            }
        }
        // A jog too short to wait for it is judged at its end.
        let is_whole = self.follows() && !self.port.is_stopped();
        if is_whole && wanted > STANDS && fastest <= wanted / 20.0 {
            self.findings.push(Finding::Stands);
        }
        Ok(())
    }

    fn rest(&mut self, show: Show<'_>) -> anyhow::Result<()> {
        let end = self.port.now() + RESTS;
        self.turn(None, show)?;
        while self.speed() > STANDS && self.port.now() < end {
            self.turn(None, show)?;
        }
        // What is silent shows its last speed for ever.
        let heard = self.port.now().saturating_sub(self.view.motion.stamp) < HEARD;
        if self.speed() > STANDS && heard {
            self.findings.push(Finding::Moves);
        }
        Ok(())
    }

    fn set(&mut self, config: Config, show: Show<'_>) -> anyhow::Result<()> {
        let command = Command {
            config,
            ..Command::default()
        };
        for _ in 0..REPEATS {
            self.port.send(&command.frame())?;
            self.hear(self.port.now() + PERIOD, show)?;
        }
        Ok(())
    }

    fn configure(&mut self, configs: &[Config], show: Show<'_>) -> anyhow::Result<()> {
        for config in configs {
            self.set(*config, show)?;
            let shown = self.view.measured.map(|measured| measured.gain);
            if let (Config::Gain(set), Some(shown)) = (config, shown)
                && *set != shown
            {
                self.findings.push(Finding::Gain(set.raw(), shown.raw()));
            }
        }
        Ok(())
    }

    /// What is heard that keeps it from moving, or will soon.
    fn judge(&mut self) {
        let view = &self.view;
        let mut found = Vec::new();
        match view.measured {
            None if view.off => found.push(Finding::Driver(State::PoweredOff)),
            None => found.push(Finding::Driver(State::Silent)),
            Some(measured) if self.port.now().saturating_sub(measured.stamp) > HEARD => {
                found.push(Finding::Driver(State::Silent));
            }
            Some(measured) => {
                found.extend(hindrance(&measured));
                let words = measured
                    .unit
                    .word1
                    .names()
                    .chain(measured.unit.word2.names());
                if words.into_iter().any(|name| name.contains("battery")) {
                    found.push(Finding::Battery(measured.battery));
                }
            }
        }
        let all = view.cycles + view.broken;
        #[expect(clippy::cast_precision_loss, reason = "a share")]
        if view.broken > 1 && view.broken as f64 > BROKEN * all as f64 {
            found.push(Finding::Broken(view.broken, all));
        }
        if view.strangers > 0 {
            found.push(Finding::Stranger(view.strangers));
        }
        let new = |finding: &Finding| {
            !self
                .findings
                .iter()
                .any(|known| known.name() == finding.name())
        };
        found.retain(new);
        let silent = matches!(
            found.first(),
            Some(Finding::Driver(State::Silent | State::PoweredOff))
        );
        // One cause is enough: what a driver says of the same, it says worse.
        if silent {
            self.findings
                .retain(|finding| !matches!(finding, Finding::Driver(_)));
        }
        self.findings.extend(found);
    }
}

/// What a measurement shows that keeps it from moving. That its motors are disabled is as it should be while nobody
/// drives it.
fn hindrance(measured: &Measurement) -> Option<Finding> {
    use takt_can::rmp::Hindrance;
    let unit = &measured.unit;
    let blocked = |hindrance| Some(Finding::Driver(State::Blocked(hindrance)));
    if unit.word2.emergency_stop() {
        return blocked(Hindrance::EmergencyStop);
    }
    if unit.word1.faults().next().is_some() {
        return blocked(Hindrance::Fault(unit.word1));
    }
    None
}
