//! `takt demo --cell assembly`: a program of the Robotics API assembles a workpiece with two arms, a base and a screwdriver. It is
//! that of the example `assembly`, a client like any other; the figures are from the truth of the world, which it does not know.

mod plot;
#[allow(dead_code, reason = "here a machine decides what the program does")]
#[path = "../../../rcc/api/examples/assembly/program.rs"]
mod program;
mod report;
mod supervisor;

use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use anyhow::Context as _;
use takt_api::Cell;
use takt_core::Controller;
use takt_core::record::Recorder;
use takt_core::stop_channel::StopSwitch;
use takt_embedded::{CellWorld, EmulatedCell, Fault, Faults, Machines, set_points, watch};
use takt_rt::host::{HostConfig, prepare};
use takt_server::{LogBook, ServerThreads};

use super::show::{ANY, open};
use super::{Demo, Time};
use crate::Verdict;
use crate::logging::Logging;
use crate::output::{check_writable, complain, say};
use crate::run::{Access, FleetView, print_grants, start_server, stop_channel, stop_server};
use crate::signal::Stop;
use plot::Span;
use program::{Order, Progress, Step};
use report::{Cycles, Report};
use supervisor::Supervised;

/// Its picture and its recording, unless others are named.
const SVG: &str = "assembly.svg";
const RECORDING: &str = "assembly.mcap";
/// How long the world is watched after the program has ended.
const AFTER: Duration = Duration::from_secs(2);
/// Within this time a datagram is the last one of a line that was cut.
const CUT: Duration = Duration::from_millis(10);
/// The arm whose set-points are watched, and that loses its network.
const RIGHT: &str = "right";

/// What the program has reported.
#[derive(Debug, Default)]
struct Log {
    spans: Vec<Span>,
    notes: Vec<&'static str>,
}

impl Log {
    /// Prints what the program reports, and keeps it.
    fn take(&mut self, progress: Progress<'_>, is_quiet: bool) {
        let now_s = takt_rt::monotonic().as_secs_f64();
        let mut took_s = None;
        match progress {
            Progress::Begins(name) => self.spans.push(Span {
                name,
                from_s: now_s,
                to_s: now_s,
            }),
            Progress::Ended(step) => {
                self.end(now_s);
                took_s = Some(self.took_s(self.spans.len().saturating_sub(1), step));
            }
            Progress::Note(text) => self.notes.push(text),
        }
        if !is_quiet {
            print(progress, took_s);
        }
    }

    /// How long a step took, s, by its number: in simulated time the program's clock is another.
    fn took_s(&self, number: usize, step: &Step) -> f64 {
        let span = self.spans.get(number).filter(|it| it.name == step.name);
        span.map_or(step.duration.as_secs_f64(), |span| span.to_s - span.from_s)
    }

    /// The last step ends here.
    fn end(&mut self, now_s: f64) {
        if let Some(span) = self.spans.last_mut() {
            span.to_s = now_s;
        }
    }
}

/// Prints what the program reports; a step took as long as it says, unless that is known better.
fn print(progress: Progress<'_>, took_s: Option<f64>) {
    match progress {
        Progress::Begins(_) => {}
        Progress::Ended(Step { name, duration }) => {
            let took_s = took_s.unwrap_or(duration.as_secs_f64());
            complain(&format!("{name:20} {took_s:5.1} s"));
        }
        Progress::Note(text) => complain(&format!("note: {text}")),
    }
}

impl Demo {
    /// Assembles a workpiece.
    #[expect(
        clippy::too_many_lines,
        reason = "the order in which a cell starts and ends, in one place"
    )]
    pub(super) fn assemble(&self) -> anyhow::Result<Verdict> {
        if let Some(address) = &self.program {
            return self.only_program(address);
        }
        let mut emulated = EmulatedCell::named(self.robots.cell())?;
        let around = if self.unloaded {
            CellWorld::assembly_unloaded(&emulated.config, self.seed)?
        } else {
            CellWorld::assembly(&emulated.config, self.seed)?
        };
        let world = around.world.clone();
        emulated.world = Some(around);
        if self.open {
            emulated.config.controller.websocket = Some(ANY);
        }
        let svg = self.svg_or(SVG);
        let record = self.record.clone().unwrap_or_else(|| RECORDING.into());
        check_writable(&svg)?;
        let mut faults = Faults::new(&world, &self.fault);
        let stop = Stop::listen()?;
        let host = prepare(&HostConfig::default());
        let book = LogBook::default();
        let logging = Logging::keep(&book)?;
        let switch = StopSwitch::default();
        let channel = stop_channel(&emulated.config, None, &switch)?;
        if self.guard {
            takt_rt::alloc::set_guard(takt_rt::alloc::Guard::Abort);
        }
        self.begin_time(Time::Simulated)?;
        let recording = Recorder::start(&record)?;
        logging.record_in(&recording.0);
        let controller = Controller::start_under(&emulated.config, Some(recording), switch)?;
        if !self.json {
            print_grants(&host, &controller);
        }
        let server = start_server(
            &emulated.config,
            &controller,
            Access::default(),
            book,
            Some(&channel),
            FleetView::default(),
        )?;
        let machines = Machines::start(&controller, emulated, self.drop)?;
        self.wait_until_ready(&controller, &machines, &stop)?;
        if let Some(page) = server.http_address().filter(|_| self.open) {
            let page = format!("http://{page}/#cell");
            say(&format!("page       {page}"))?;
            open(&page);
        }
        let address = server.tcp_address().context("the server does not listen")?;
        let inserts = set_points(&controller, RIGHT)?;
        // Until they are killed.
        let alive = Mutex::new(Some((server, controller)));
        let (log, child, mut killed) = (Mutex::new(Log::default()), Mutex::new(None), None);
        let work = || {
            let ended = self.work(&address.to_string(), &log, &child, &stop);
            lock(&log).end(takt_rt::monotonic().as_secs_f64());
            std::thread::sleep(AFTER);
            ended
        };
        let (ended, seen) = watch(&world, inserts, work, |truth| match faults.poll(truth) {
            Some(Fault::ArmLost) => cut(&machines, |name| name == RIGHT),
            Some(Fault::ProgramKilled) => kill(&child),
            Some(Fault::ControllerKilled) => {
                cut(&machines, |_| true);
                std::thread::sleep(CUT);
                if let Some(parts) = lock(&alive).take() {
                    killed = Some(Cycles::of(&parts.1));
                    end(parts);
                }
            }
            _ => {}
        });
        let truth = world.truth();
        let log = log.into_inner().unwrap_or_else(PoisonError::into_inner);
        let mut report = Report::new(
            (self.seed, self.stopping),
            &self.fault,
            (ended, &log),
            &seen,
            &truth,
        );
        let drawn = plot::draw(&svg, &seen, &log.spans);
        let alive = alive.into_inner().unwrap_or_else(PoisonError::into_inner);
        let mut recorded = None;
        let cycles = alive.as_ref().map(|(_, controller)| Cycles::of(controller));
        cycles
            .or(killed)
            .into_iter()
            .for_each(|cycles| report.take_controller(cycles));
        if let Some((server, controller)) = alive {
            match controller.finish_recording() {
                Ok(cycles) => recorded = cycles,
                Err(error) => report.fail(error.to_string()),
            }
            if self.open {
                self.print_report(&report, drawn.is_ok().then_some(&svg), recorded, &record)?;
                self.stay(&stop)?;
            }
            end((server, controller));
        }
        machines.stop()?;
        if !self.open {
            self.print_report(&report, drawn.is_ok().then_some(&svg), recorded, &record)?;
        }
        drawn?;
        Ok(report.verdict())
    }

    const fn order(&self) -> Order {
        Order {
            is_stopping: self.stopping,
            is_unloaded: self.unloaded,
        }
    }

    /// Runs the program here, or as a process of its own that can be killed.
    fn work(
        &self,
        address: &str,
        log: &Mutex<Log>,
        child: &Mutex<Option<Child>>,
        stop: &Stop,
    ) -> Supervised {
        if self.fault.contains(&Fault::ProgramKilled) {
            return match self.run_process(address, child) {
                Ok(status) => Supervised::failed(format!("the program ended: {status}")),
                Err(error) => Supervised::failed(format!("{error:#}")),
            };
        }
        let cell = match Cell::connect(address) {
            Ok(cell) => cell,
            Err(error) => return Supervised::failed(error.to_string()),
        };
        let report = |progress: Progress<'_>| lock(log).take(progress, self.json);
        std::thread::scope(|scope| {
            let work = scope.spawn(|| supervisor::run(&cell, address, self.order(), &report));
            while !work.is_finished() {
                if stop.is_requested() {
                    // Everything brakes, and the program ends with an error.
                    let _ = cell.stop();
                }
                std::thread::sleep(super::SAMPLE_EVERY);
            }
            let panicked = |_| Supervised::failed("the program ended by a panic".to_owned());
            work.join().unwrap_or_else(panicked)
        })
    }

    fn run_process(
        &self,
        address: &str,
        child: &Mutex<Option<Child>>,
    ) -> anyhow::Result<ExitStatus> {
        let mut command = Command::new(std::env::current_exe()?);
        command.args(["demo", "--cell", "assembly", "--program", address]);
        for (is_on, option) in [
            (self.json, "--json"),
            (self.stopping, "--stopping"),
            (self.unloaded, "--unloaded"),
        ] {
            command.args(is_on.then_some(option));
        }
        *lock(child) = Some(command.spawn()?);
        loop {
            let ended = match &mut *lock(child) {
                Some(child) => child.try_wait()?,
                None => None,
            };
            if let Some(status) = ended {
                return Ok(status);
            }
            std::thread::sleep(super::SAMPLE_EVERY);
        }
    }

    /// The program alone, for a controller that another process runs.
    fn only_program(&self, address: &str) -> anyhow::Result<Verdict> {
        let cell = Cell::connect(address)?;
        let report = |progress: Progress<'_>| {
            if !self.json {
                print(progress, None);
            }
        };
        let ended = supervisor::run(&cell, address, self.order(), &report);
        ended
            .error
            .map_or(Ok(Verdict::Good), |error| anyhow::bail!("{error}"))
    }

    fn print_report(
        &self,
        report: &Report,
        svg: Option<&PathBuf>,
        recorded: Option<u64>,
        record: &Path,
    ) -> anyhow::Result<()> {
        if self.json {
            return say(&serde_json::to_string(report)?);
        }
        say(report.text().trim_end())?;
        if let Some(svg) = svg {
            say(&format!("plot       {}", svg.display()))?;
        }
        if let Some(cycles) = recorded {
            say(&format!("recording  {}, {cycles} cycles", record.display()))?;
        }
        Ok(())
    }

    /// The page stays until a signal.
    fn stay(&self, stop: &Stop) -> anyhow::Result<()> {
        say("Ctrl-C ends the demo")?;
        while !stop.is_requested() {
            std::thread::sleep(super::SAMPLE_EVERY);
        }
        Ok(())
    }
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Loses all datagrams of arms from now on.
fn cut(machines: &Machines, which: impl Fn(&str) -> bool) {
    let arms = machines.krcs().iter().filter(|(name, _)| which(name));
    arms.for_each(|(_, robot)| robot.status().set_drop(1.0));
}

fn kill(child: &Mutex<Option<Child>>) {
    if let Some(child) = &mut *lock(child) {
        // Fails only if it has ended.
        let _ = child.kill();
    }
}

fn end((server, controller): (ServerThreads, Controller)) {
    stop_server(server);
    // Before its robots, so that their end is no fault.
    drop(controller);
}
