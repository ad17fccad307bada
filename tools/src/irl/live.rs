//! `takt irl run` on a controller: the program as a net on its arms and signals, followed and controlled from standard input.

mod bind;
mod console;

use std::time::{Duration, Instant};

use clap::Args;
use takt_irl::{BREAKPOINTS_MAX, Channel, Direction, Program};

use crate::client::Client;
use crate::irl::values::{signal_of, value_of};
use crate::net::server::Server;
use crate::output::{complain, say};
use crate::signal::Stop;
use crate::{Verdict, confirm};
use console::{Console, Request};

/// Interval at which the values of the net are read.
const EVERY: Duration = Duration::from_millis(20);
/// How long a request is kept, longer than periods of net threads.
const PULSE: Duration = Duration::from_millis(100);
/// A program that waits, as `outState` of `Irl::Program` shows it.
const PAUSED: &str = "2";

/// On which controller, and how.
#[derive(Debug, Args)]
pub(super) struct Live {
    #[command(flatten)]
    server: Server,
    /// Run on the emulated robots of this cell, inside of this process: two_lwr, iiwa, factory, lwr_wsg, lwr_table, assembly, assembly_unloaded or lola.
    #[arg(long, value_name = "CELL", conflicts_with = "connect")]
    emulated: Option<String>,
    /// Arm of a robot of the program, such as lwr=left; else the arm of the same name. May be given several times.
    #[arg(long, value_name = "ROBOT=ARM")]
    robot: Vec<String>,
    /// Input or output of a signal, such as grip=io:3, or that of its lowest bit; none is no device. Without it, the one in the
    /// system specification. Outputs without one are printed. May be given several times.
    #[arg(long, value_name = "SIGNAL=DEVICE:PORT")]
    signal: Vec<String>,
    /// Wait before this line. May be given several times.
    #[arg(long = "break", value_name = "LINE", value_parser = clap::value_parser!(u32).range(1..))]
    breakpoints: Vec<u32>,
    /// Wait before the first line.
    #[arg(long)]
    paused: bool,
    /// Part of the speed of motions, 0 to 1.
    #[arg(long = "override", value_name = "FACTOR", default_value_t = 1.0, value_parser = crate::output::share)]
    speed: f64,
    /// It is safe that the arms move; do not ask.
    #[arg(long = "yes", alias = "confirm-motion")]
    yes: bool,
}

/// What a program on a controller needs of the other options.
pub(super) struct Options<'o> {
    pub(super) name: String,
    pub(super) steps: u32,
    pub(super) inputs: &'o [String],
    /// The source text, if it is known.
    pub(super) text: Option<String>,
}

impl Live {
    /// Whether the program runs on a controller, not in virtual time.
    pub(super) const fn is_requested(&self) -> bool {
        self.server.connect.is_some() || self.emulated.is_some()
    }

    pub(super) fn run(&self, program: &Program, options: &Options<'_>) -> anyhow::Result<Verdict> {
        let too_many = self.breakpoints.len() > BREAKPOINTS_MAX;
        anyhow::ensure!(
            !too_many,
            "at most {BREAKPOINTS_MAX} breakpoints are possible"
        );
        match &self.emulated {
            Some(name) => self.run_emulated(name, program, options),
            None => self.run_on(&self.server, false, program, options),
        }
    }

    #[cfg(feature = "demo")]
    fn run_emulated(
        &self,
        name: &str,
        program: &Program,
        options: &Options<'_>,
    ) -> anyhow::Result<Verdict> {
        let cell = takt_embedded::Embedded::emulated(name)?;
        let server = Server {
            connect: Some(cell.address().to_string()),
            token_file: None,
        };
        let verdict = self.run_on(&server, true, program, options);
        cell.stop()?;
        verdict
    }

    #[cfg(not(feature = "demo"))]
    #[expect(clippy::unused_self, reason = "as with the feature")]
    fn run_emulated(&self, _: &str, _: &Program, _: &Options<'_>) -> anyhow::Result<Verdict> {
        anyhow::bail!(
            "this program was built without emulated cells\nhint: build it with --features demo"
        )
    }

    fn run_on(
        &self,
        server: &Server,
        is_emulated: bool,
        program: &Program,
        options: &Options<'_>,
    ) -> anyhow::Result<Verdict> {
        let (binding, kinds) = bind::binding(self, server, program, options)?;
        let net = takt_irl::net::net(program, &binding)?;
        let is_simulated = |kind: &String| takt_core::device::sim::kinds().contains(&kind.as_str());
        let is_safe = self.yes || is_emulated || kinds.iter().all(is_simulated);
        confirm::motion(&format!("moving {}", binding.arms.join(", ")), is_safe)?;
        let stop = Stop::listen()?;
        let mut client = server.connect()?;
        client.open_session(&format!("takt irl run {}", options.name))?;
        let net = client.load(&net, &format!("program {}", program.name))?;
        let faults = client.faults(&net)?;
        if !faults.is_empty() {
            faults.iter().for_each(|fault| complain(fault));
            return Ok(Verdict::Failed);
        }
        client.command("nest", &net)?;
        let mut run = Run {
            client,
            net,
            program,
            text: options.text.as_deref(),
            lines: binding.breakpoints,
            watch: binding.watch,
            channels: binding.channels,
            shown: Shown::default(),
            pulse: Some((true, Instant::now())),
            begin: Instant::now(),
        };
        let verdict = run.follow(&stop, &options.name);
        let ended = run.client.end_session();
        let verdict = verdict?;
        ended?;
        Ok(verdict)
    }
}

/// What was printed last.
#[derive(Debug, Default, PartialEq)]
struct Shown {
    state: String,
    line: String,
    outputs: Vec<(String, String)>,
}

/// A program that runs.
struct Run<'p> {
    client: Client,
    net: String,
    program: &'p Program,
    text: Option<&'p str>,
    lines: Vec<u32>,
    watch: Vec<String>,
    /// Devices of the signals.
    channels: Vec<Option<Channel>>,
    shown: Shown,
    /// Whether `continue` or `step` is true, or false again, and since when.
    pulse: Option<(bool, Instant)>,
    begin: Instant,
}

impl Run<'_> {
    fn follow(&mut self, stop: &Stop, name: &str) -> anyhow::Result<Verdict> {
        let console = Console::listen();
        let mut is_stopping = false;
        loop {
            let has_ended = self.client.has_ended(&self.net)?;
            self.show()?;
            if has_ended {
                return self.report(name);
            }
            if stop.is_requested() && !is_stopping {
                is_stopping = true;
                complain("stopped: waiting for rest");
                self.write("stop", "true")?;
            }
            anyhow::ensure!(
                stop.requests() < 2,
                "ended before the robots were at rest: the controller brakes them"
            );
            if !self.is_ready()? {
                std::thread::sleep(EVERY);
                continue;
            }
            match console.next(EVERY) {
                Some(Ok(request)) => self.handle(request)?,
                Some(Err(why)) => complain(&why),
                None => {}
            }
        }
    }

    /// Whether the next request can be made: `continue` and `step` count when they become true, and each value is kept for
    /// [`PULSE`], so that the net sees it.
    fn is_ready(&mut self) -> anyhow::Result<bool> {
        let Some((is_high, since)) = self.pulse else {
            return Ok(true);
        };
        if since.elapsed() < PULSE {
            return Ok(false);
        }
        self.pulse = is_high.then(|| (false, Instant::now()));
        if is_high {
            self.write("continue", "false")?;
            self.write("step", "false")?;
        }
        Ok(!is_high)
    }

    fn raise(&mut self, key: &str) -> anyhow::Result<()> {
        self.write("pause", "false")?;
        self.pulse = Some((true, Instant::now()));
        self.write(key, "true")
    }

    fn write(&mut self, key: &str, value: &str) -> anyhow::Result<()> {
        let values = [(format!("in{key}"), value.to_owned())].into();
        self.client.write(&self.net, values)
    }

    /// Prints line, state and outputs that changed.
    fn show(&mut self) -> anyhow::Result<()> {
        let [_, values] = self.client.values(&self.net)?;
        let value = |key: &str| values.get(&format!("out{key}")).cloned();
        let outputs = values.iter().filter_map(|(key, value)| {
            let name = key.strip_prefix("outsignal_")?;
            Some((name.to_owned(), value.clone()))
        });
        let now = Shown {
            state: value("state").unwrap_or_default(),
            line: value("line").unwrap_or_default(),
            outputs: outputs.collect(),
        };
        for output in &now.outputs {
            if self.shown.outputs.contains(output) || self.shown == Shown::default() {
                continue;
            }
            say(&format!("{} = {}", output.0, output.1))?;
        }
        let is_running = ["1", PAUSED].contains(&now.state.as_str());
        if is_running && (now.line != self.shown.line || now.state != self.shown.state) {
            let paused = if now.state == PAUSED {
                "paused at "
            } else {
                ""
            };
            let text = self.line_of_source(&now.line);
            say(&format!("{paused}{}: {text}", now.line))?;
        }
        self.shown = now;
        Ok(())
    }

    fn line_of_source(&self, line: &str) -> &str {
        let number = line.parse::<usize>().unwrap_or(0);
        let line = self
            .text
            .and_then(|text| text.lines().nth(number.checked_sub(1)?));
        line.map_or("", str::trim)
    }

    fn handle(&mut self, request: Request) -> anyhow::Result<()> {
        match request {
            Request::Pause => self.write("pause", "true"),
            Request::Continue => self.raise("continue"),
            Request::Step => self.raise("step"),
            Request::Stop => self.write("stop", "true"),
            Request::Override(part) => self.write("override", &part.to_string()),
            Request::Break(line) => {
                if self.lines.contains(&line) {
                    return Ok(());
                }
                if self.lines.len() >= BREAKPOINTS_MAX {
                    complain(&format!(
                        "at most {BREAKPOINTS_MAX} breakpoints are possible\nhint: `clear LINE` removes one"
                    ));
                    return Ok(());
                }
                self.lines.push(line);
                self.write_breakpoints()
            }
            Request::Clear(line) => {
                self.lines.retain(|known| *known != line);
                self.write_breakpoints()
            }
            Request::Set(signal, value) => {
                if let Err(error) = self.set(&signal, &value) {
                    complain(&format!("cannot set {signal}: {error:#}"));
                }
                Ok(())
            }
            Request::Print(name) => self.print(&name),
        }
    }

    /// Writes an input that no device has.
    fn set(&mut self, name: &str, value: &str) -> anyhow::Result<()> {
        let number = signal_of(self.program, name)?;
        let signal = &self.program.system.signals[number];
        anyhow::ensure!(signal.direction == Direction::In, "it is an output");
        if let Some(channel) = &self.channels[number] {
            anyhow::bail!("its value comes from {channel}");
        }
        let value = value_of(signal, value)?;
        self.write(&takt_irl::net::signal_key(name), &value)
    }

    fn write_breakpoints(&mut self) -> anyhow::Result<()> {
        let given = self.lines.iter().map(u32::to_string);
        let lines = given.chain(std::iter::repeat("0".to_owned()));
        let lines: Vec<_> = lines.take(BREAKPOINTS_MAX).collect();
        self.write("breakpoints", &format!("[{}]", lines.join(",")))
    }

    /// Prints variables: those of that name, its components, or all.
    fn print(&mut self, name: &str) -> anyhow::Result<()> {
        let [_, values] = self.client.values(&self.net)?;
        let values = values.get("outwatch").map_or("", String::as_str);
        let values = values.trim_matches(['[', ']']).split(',').map(str::trim);
        let components = [format!("{name}."), format!("{name}[")];
        let mut is_known = false;
        for (variable, value) in self.watch.iter().zip(values) {
            let is_part = || components.iter().any(|part| variable.starts_with(part));
            if name.is_empty() || variable == name || is_part() {
                is_known = true;
                say(&format!("{variable} = {value}"))?;
            }
        }
        if !is_known {
            complain(&format!(
                "no variable {name} is watched\nhint: `print` alone shows all that are"
            ));
        }
        Ok(())
    }

    fn report(&mut self, name: &str) -> anyhow::Result<Verdict> {
        let end = self.client.end_of(&self.net)?;
        let failed = self.client.values(&self.net)?;
        let has_failed = failed[1]
            .get("outfailed")
            .is_some_and(|value| value == "true");
        for line in self.client.rejected(&self.net)? {
            complain(&line);
        }
        let seconds = self.begin.elapsed().as_secs_f64();
        match end {
            Some(end) => {
                complain(&format!("{name}: {}", end.why));
                Ok(Verdict::Failed)
            }
            None if has_failed => {
                complain(&format!(
                    "{name}: an arm did not take the set-points of program {}\nhint: `takt net list` and the log of the \
                     controller have the cause",
                    self.program.name
                ));
                Ok(Verdict::Failed)
            }
            None => {
                say(&format!("{name}: ended after {seconds:.1} s"))?;
                Ok(Verdict::Good)
            }
        }
    }
}
