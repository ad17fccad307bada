//! One power base: received, driven for a moment, and set up. It judges what it receives; `takt_can::rmp::Base`, on which
//! the driver is built too, enables and commands the power base and reports why it does not follow.

use std::fmt;
use std::time::Duration;

use takt_can::Frame;
use takt_can::rmp::{
    ACCELERATION, Base, Channel, Command, Config, DriverConfig, Measurement, Message, Mode, Model,
    Motion, State, YawSign,
};

use super::port::Port;

/// Time between views.
const VIEW: Duration = Duration::from_millis(200);
/// Timeouts of a power base: until it sends, follows, and is at rest again.
const SILENT_AFTER: Duration = Duration::from_secs(1);
const FOLLOWS_WITHIN: Duration = Duration::from_secs(6);
const RESTS_WITHIN: Duration = Duration::from_secs(5);
/// Timeout of its reaction to a velocity.
const MOVES_WITHIN: Duration = Duration::from_secs(1);
/// Repetitions of a setting, as none is acknowledged.
const REPEATS: usize = 3;
/// Slower than this it is at rest, m/s and rad/s.
const AT_REST: f64 = 0.02;
/// Tolerated share of broken cycles.
const BROKEN: f64 = 0.01;
const PERIOD: Duration = Duration::from_millis(50);

/// What to do.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Plan {
    pub(super) model: Model,
    /// Which way its integrated yaw counts.
    pub(super) yaw_integral: YawSign,
    /// How long to receive; forever without it. A jog has its own duration.
    pub(super) duration: Option<Duration>,
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

/// Its state at a time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct View {
    pub(super) measured: Option<Measurement>,
    pub(super) motion: Motion,
    /// Battery of the user interface, V.
    pub(super) interface_battery: Option<f64>,
    /// Number of the firmware's build.
    pub(super) build: Option<u16>,
    /// Its user interface reports that the power base is off.
    pub(super) off: bool,
    /// Whole cycles, and those in which a message was missing.
    pub(super) cycles: u64,
    pub(super) broken: u64,
    /// Integrators that jumped.
    pub(super) jumps: u64,
    /// Commands of another host.
    pub(super) other_host: u64,
}

/// A finding.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Finding {
    /// The state that the driver reports.
    Driver(State),
    /// Messages of its cycles are missing.
    Broken(u64, u64),
    /// It reports that its batteries are low.
    Battery(f64),
    /// Another host commands it.
    OtherHost(u64),
    /// It is driven and does not move.
    DoesNotMove,
    /// It is commanded to rest and moves.
    DoesNotStop,
    /// It shows another gain schedule than was set.
    Gain(u16, u16),
    /// It was commanded to disable its motors and stays in this mode.
    StaysEnabled(Mode),
    /// Its integrated yaw counts against its yaw rate; this is the right setting.
    YawSign(YawSign),
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
            Self::OtherHost(_) => "another-host",
            Self::DoesNotMove => "does-not-move",
            Self::DoesNotStop => "does-not-stop",
            Self::Gain(..) => "gain-not-taken",
            Self::StaysEnabled(_) => "stays-enabled",
            Self::YawSign(_) => "yaw-sign",
        }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Driver(state) => state.fmt(f),
            Self::Broken(broken, all) => write!(
                f,
                "in {broken} of {all} cycles a message is missing: frames are lost\n\
                 hint: see `takt can stat`, and at the USB port the latency timer of its chip"
            ),
            Self::Battery(volts) => write!(f, "it reports that its battery is low ({volts:.1} V)\nhint: charge it"),
            Self::OtherHost(count) => write!(
                f,
                "another host commands it ({count} commands received)\nhint: stop that host"
            ),
            Self::DoesNotMove => f.write_str(
                "it follows commands and did not move\n\
                 hint: check its stored velocity scale (--set velocity=16) and its wheels",
            ),
            Self::DoesNotStop => f.write_str(
                "it was commanded to rest and still moves\nhint: switch it off at its emergency stop",
            ),
            Self::StaysEnabled(mode) => write!(
                f,
                "it was commanded to disable its motors and stays in mode {mode}\n\
                 hint: switch it off at its emergency stop; check whether another host commands it"
            ),
            Self::YawSign(sign) => write!(
                f,
                "its integrated yaw (404h) counts against its yaw rate (402h): headings turn the wrong way\n\
                 hint: set yaw_integral = \"{sign}\" in its section of cell.toml (here --yaw-integral {sign})",
                sign = sign.name()
            ),
            Self::Gain(set, shown) => write!(
                f,
                "gain schedule {set} was set, it shows {shown}: it accepts settings only at rest, in mode tractor or \
                 disabled"
            ),
        }
    }
}

/// The result.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Report {
    pub(super) model: Model,
    pub(super) view: View,
    /// Settings that were sent.
    pub(super) configs: Vec<Config>,
    /// Whether it was jogged.
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
            yaw_integral: plan.yaw_integral,
            period: PERIOD,
            ..DriverConfig::default()
        };
        let [linear, angular] = ACCELERATION;
        Self {
            next_view: port.now() + VIEW,
            port,
            plan,
            base: Base::new(config, linear, angular),
            view: View::default(),
            findings: Vec::new(),
        }
    }

    pub(super) fn run(mut self, show: Show<'_>) -> anyhow::Result<Report> {
        match self.plan.jog {
            Some(jog) => self.jog(jog, show)?,
            None => self.watch(show)?,
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

    /// Receives until then.
    fn receive(&mut self, until: Duration, show: Show<'_>) -> anyhow::Result<()> {
        loop {
            let left = until.saturating_sub(self.port.now());
            if let Some((channel, frame)) = self.port.receive(left)? {
                self.handle_frame(channel, &frame);
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

    fn handle_frame(&mut self, channel: Channel, frame: &Frame) {
        let view = &mut self.view;
        match Message::decode(frame) {
            Some(Message::Build { build, .. }) => view.build = Some(build),
            Some(Message::Operation { ui_battery, .. }) => {
                view.interface_battery = Some(1.4 + 0.0125 * f64::from(ui_battery));
            }
            Some(Message::PowerbaseOff { .. }) => view.off = true,
            Some(Message::Command(_)) => view.other_host += 1,
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

    /// Receives only.
    fn watch(&mut self, show: Show<'_>) -> anyhow::Result<()> {
        let begun = self.port.now();
        let silent_at = begun + SILENT_AFTER;
        let end = self.plan.duration.map(|duration| begun + duration);
        while !self.port.is_stopped() {
            let now = self.port.now();
            let silent = self.view.cycles == 0 && now >= silent_at;
            if end.is_some_and(|end| now >= end) || silent && !self.plan.configs.is_empty() {
                break;
            }
            let until = end.unwrap_or(Duration::MAX).min(now + PERIOD);
            self.receive(until, show)?;
        }
        Ok(())
    }

    /// One period with that velocity.
    fn command(&mut self, wanted: Option<[f64; 2]>, show: Show<'_>) -> anyhow::Result<()> {
        if let Some(frame) = self.base.poll_transmit(wanted, self.port.now()) {
            self.port.send(&frame)?;
        }
        let until = self.base.poll_timeout();
        self.receive(until, show)
    }

    fn follows(&self) -> bool {
        self.base.driver().follows()
    }

    fn speed(&self) -> f64 {
        let [forward, _, rotation] = self.view.motion.velocity;
        forward.abs().max(rotation.abs())
    }

    /// Enables it, drives it, brings it to rest, and disables it again.
    fn jog(&mut self, jog: Jog, show: Show<'_>) -> anyhow::Result<()> {
        let end = self.port.now() + FOLLOWS_WITHIN;
        while !self.follows() && self.port.now() < end && !self.port.is_stopped() {
            self.command(None, show)?;
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
        self.set(disable, show)?;
        let mode = self.view.measured.map(|measured| measured.mode);
        if let Some(mode) = mode.filter(|mode| *mode != Mode::Disabled && self.is_recent()) {
            self.findings.push(Finding::StaysEnabled(mode));
        }
        if self.base.yaw_contradicts() {
            let right = self.plan.yaw_integral.other();
            self.findings.push(Finding::YawSign(right));
        }
        Ok(())
    }

    /// Whether it still sends: a silent power base shows its last values forever.
    fn is_recent(&self) -> bool {
        self.port.now().saturating_sub(self.view.motion.stamp) < SILENT_AFTER
    }

    fn drive(&mut self, jog: Jog, show: Show<'_>) -> anyhow::Result<()> {
        let begun = self.port.now();
        let wanted = jog
            .velocity
            .iter()
            .fold(0.0, |most: f64, rate| most.max(rate.abs()));
        let (mut moved, mut fastest) = (begun, 0.0_f64);
        while self.port.now() < begun + jog.time && !self.port.is_stopped() && self.follows() {
            self.command(Some(jog.velocity), show)?;
            fastest = fastest.max(self.speed());
            if self.speed() > wanted / 20.0 {
                moved = self.port.now();
            }
            if wanted > AT_REST && self.port.now() > moved + MOVES_WITHIN {
                self.findings.push(Finding::DoesNotMove);
                return Ok(());
            }
        }
        // A jog shorter than the timeout is judged at its end.
        let is_complete = self.follows() && !self.port.is_stopped();
        if is_complete && wanted > AT_REST && fastest <= wanted / 20.0 {
            self.findings.push(Finding::DoesNotMove);
        }
        Ok(())
    }

    fn rest(&mut self, show: Show<'_>) -> anyhow::Result<()> {
        let end = self.port.now() + RESTS_WITHIN;
        self.command(None, show)?;
        while self.speed() > AT_REST && self.port.now() < end {
            self.command(None, show)?;
        }
        if self.speed() > AT_REST && self.is_recent() {
            self.findings.push(Finding::DoesNotStop);
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
            self.receive(self.port.now() + PERIOD, show)?;
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

    /// Adds findings on what keeps it from moving, or will soon.
    fn judge(&mut self) {
        let view = &self.view;
        let mut found = Vec::new();
        match view.measured {
            None if view.off => found.push(Finding::Driver(State::PoweredOff)),
            None => found.push(Finding::Driver(State::Silent)),
            Some(measured) if self.port.now().saturating_sub(measured.stamp) > SILENT_AFTER => {
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
        if view.other_host > 0 {
            found.push(Finding::OtherHost(view.other_host));
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
        // One cause is enough; the driver's is less precise.
        if silent {
            self.findings
                .retain(|finding| !matches!(finding, Finding::Driver(_)));
        }
        self.findings.extend(found);
    }
}

/// What keeps it from moving, by a measurement. Disabled motors are no finding: they are so unless it is driven.
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
