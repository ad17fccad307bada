//! `takt demo`: a whole cell in one process. Emulated robots speak FRI over UDP on loopback and EtherCAT over a cable
//! in memory; a client sends nets as text over TCP; the report gives the result. All parts are the code that runs
//! against real robots.

mod assembly;
mod cell;
mod lola;
mod motion;
pub(crate) mod plot;
mod recovery;
mod report;
mod samples;
mod show;

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::Context as _;
use clap::{Args, ValueEnum};
use takt_core::Controller;
use takt_core::device::driver::DeviceDriver as _;
use takt_core::record::Recorder;
use takt_core::stop_channel::StopSwitch;
use takt_devices::ethercat::Ethercat;
use takt_embedded::{EmulatedCell, Fault, Machines};
use takt_rt::host::{HostConfig, prepare};
use takt_server::LogBook;

use crate::Verdict;
use crate::client::Client;
use crate::logging::Logging;
use crate::output::{check_writable, complain, is_terminal, positive_span, say, share};
use crate::run::{Access, FleetView, print_grants, start_server, stop_channel, stop_server};
use crate::signal::Stop;
use cell::Kind;
use lola::Trace;
use recovery::{Outcome, Parts};
use report::{Baseline, Report};
use samples::{SAMPLE_EVERY, Samples};

/// How long a robot may take to come into command mode, or to find its stops.
const READY_WITHIN: Duration = Duration::from_mins(1);

/// A time that emulated robots run in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Time {
    // No texts: with them, the help of all options takes twice the lines.
    Simulated,
    Real,
}

/// How long simulated time has waited so far, ms; `None` in real time.
fn time_waited_ms() -> Option<f64> {
    takt_rt::simulated::waited().map(|waited| waited.as_secs_f64() * 1e3)
}

/// The line about it in a report; latencies are those of the host only in real time.
fn time_line(waited_ms: Option<f64>) -> String {
    waited_ms.map_or_else(String::new, |waited_ms| {
        format!(
            "time       simulated; it waited {waited_ms:.0} ms for threads that the host ran late\n"
        )
    })
}

/// Move emulated robots with nets.
#[derive(Debug, Args)]
pub(crate) struct Demo {
    /// Which robots: two LWRs, these beside a TX90 and a youBot on EtherCAT, `assembly`, where a program assembles a workpiece with two
    /// arms, a base and a screwdriver, or `lola`, a test station of three servomotors whose machine calibrates, homes and moves it.
    #[arg(long, alias = "cell", value_enum, default_value_t = Kind::Pair)]
    robots: Kind,
    /// How long the motion takes; those of `assembly` and `lola` take as long as their programs.
    #[arg(long, value_name = "TIME", default_value = "10s", value_parser = positive_span)]
    duration: Duration,
    /// Print one JSON object instead of the report.
    #[arg(long)]
    json: bool,
    /// The time of robots and controller: that of the host, or one that waits for threads which the host runs late [default: simulated
    /// for `assembly`, else real].
    #[arg(long, value_enum, value_name = "TIME", conflicts_with_all = ["from", "print_net"])]
    time: Option<Time>,
    /// How fast simulated time runs while the host keeps up, in parts of the host's [default: 1].
    #[arg(long, value_name = "FACTOR", conflicts_with_all = ["from", "print_net"])]
    real_time_factor: Option<f64>,
    /// File of the plot [default: takt-demo.svg, or assembly.svg].
    #[arg(long, value_name = "FILE.svg")]
    svg: Option<PathBuf>,
    /// Lose this share of datagrams in each direction, 0 to 1.
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, value_parser = share)]
    drop: f64,
    /// Record everything that enters and leaves the net thread; `assembly` always does, to assembly.mcap.
    #[arg(long, value_name = "FILE.mcap", conflicts_with = "from")]
    record: Option<PathBuf>,
    /// Replay a recording instead, and compare the output byte for byte.
    #[arg(long, alias = "replay", value_name = "FILE.mcap")]
    from: Option<PathBuf>,
    /// Serve the page of its controller, open it in a browser, and move until Ctrl-C, in rounds of --duration.
    #[arg(long, conflicts_with_all = ["json", "record", "from", "print_net"])]
    open: bool,
    /// Print the nets and end.
    #[arg(long)]
    print_net: bool,
    /// End the process at the first allocation in a real-time thread.
    #[arg(long)]
    guard: bool,
    /// Switch a fault of `assembly` on, such as `docks-beside`; several that it overcomes may be given.
    #[arg(long, value_name = "FAULT", value_delimiter = ',')]
    fault: Vec<Fault>,
    /// Where the parts of `assembly` lie, and where its base docks.
    #[arg(long, value_name = "NUMBER", default_value_t = 1)]
    seed: u64,
    /// Assemble without blending: each motion ends at rest.
    #[arg(long)]
    stopping: bool,
    /// Begin the assembly with both boxes on the bench.
    #[arg(long)]
    unloaded: bool,
    /// Only the program of `assembly`, at the controller of another demo.
    #[arg(long, value_name = "ADDRESS", hide = true)]
    program: Option<String>,
}

impl Demo {
    /// Before the first thread that has cycles; `usual` unless another is given.
    fn begin_time(&self, usual: Time) -> anyhow::Result<()> {
        if self.time.unwrap_or(usual) == Time::Simulated {
            takt_embedded::simulate_time(self.real_time_factor.unwrap_or(1.0))?;
        } else if let Some(factor) = self.real_time_factor {
            anyhow::bail!(
                "--real-time-factor {factor} in real time, whose factor is 1\nhint: add --time simulated"
            );
        }
        Ok(())
    }

    pub(crate) fn run(self) -> anyhow::Result<Verdict> {
        let nets = self.robots.nets(self.duration);
        if let Some(verdict) = self.run_without_nets(&nets)? {
            return Ok(verdict);
        }
        let emulated = EmulatedCell::named(self.robots.cell())?;
        let cell = emulated.config.clone();
        let svg = self.svg_or("takt-demo.svg");
        check_writable(&svg)?;
        let stop = Stop::listen()?;
        let host = prepare(&HostConfig::default());
        let book = LogBook::default();
        let logging = Logging::keep(&book)?;
        let switch = StopSwitch::default();
        let channel = stop_channel(&cell, None, &switch)?;
        if self.guard {
            takt_rt::alloc::set_guard(takt_rt::alloc::Guard::Abort);
        }
        self.begin_time(Time::Real)?;
        let recording = self.record.as_deref().map(Recorder::start).transpose()?;
        if let Some((recorder, _)) = &recording {
            logging.record_in(recorder);
        }
        let controller = Controller::start_under(&cell, recording, switch)?;
        if !self.json {
            print_grants(&host, &controller);
        }
        let server = start_server(
            &cell,
            &controller,
            Access::default(),
            book,
            Some(&channel),
            FleetView::default(),
        )?;
        let machines = Machines::start(&controller, emulated, self.drop)?;
        self.wait_until_ready(&controller, &machines, &stop)?;
        let address = server.tcp_address().context("the server does not listen")?;
        let baseline = Baseline::take(&controller, machines.krcs());
        let ended = self.drive(&controller, &machines, address, &nets, &stop);
        let recorded = controller.finish_recording();
        let (samples, outcome, trace) = ended?;
        let arms = self.robots.moved();
        let moved: Vec<_> = arms.iter().copied().zip(samples.moved()).collect();
        let followed = cell.controller.follow.unwrap_or_default();
        let krcs = machines.krcs();
        let mut report = Report::collect(
            &controller,
            &host,
            krcs,
            &moved,
            &followed,
            (&baseline, outcome),
        );
        let drawn = match &trace {
            Some(trace) => {
                report.set_states(trace.states());
                lola::draw(&svg, &samples, trace)
            }
            None => plot::draw(&svg, arms, &samples, &controller.stats()),
        };
        stop_server(server);
        // Before its robots, so that their end is no fault.
        drop(controller);
        machines.stop()?;
        // The report is printed even if its recording or picture failed.
        let (cycles, failed) = match recorded {
            Ok(cycles) => (cycles, None),
            Err(error) => (None, Some(error)),
        };
        let verdict = self.print(&report, cycles, drawn.is_ok().then_some(&svg))?;
        drawn?;
        failed.map_or(Ok(verdict), |error| Err(error.into()))
    }

    /// All that a demo does but to run nets to their end once: prints them, replays, assembles, or shows the page.
    fn run_without_nets(&self, nets: &[String]) -> anyhow::Result<Option<Verdict>> {
        if self.print_net {
            anyhow::ensure!(
                self.robots != Kind::Assembly,
                "the program of `assembly` makes its nets while it runs\nhint: `takt record info assembly.mcap` lists those of a run"
            );
            nets.iter().try_for_each(|net| say(net.trim_end()))?;
            return Ok(Some(Verdict::Good));
        }
        if let Some(recording) = &self.from {
            return replay(recording).map(Some);
        }
        if self.robots == Kind::Assembly {
            return self.assemble().map(Some);
        }
        anyhow::ensure!(
            self.fault.is_empty() && !self.stopping && !self.unloaded && self.program.is_none(),
            "only `assembly` has faults to switch on and blending to switch off\nhint: add --cell assembly"
        );
        if self.open {
            return self.show().map(Some);
        }
        Ok(None)
    }

    fn svg_or(&self, default: &str) -> PathBuf {
        self.svg.clone().unwrap_or_else(|| default.into())
    }

    /// Sends the machine of the station, starts it, and follows it to its end.
    fn run_machine(
        &self,
        controller: &Controller,
        machines: &Machines,
        address: SocketAddr,
        stop: &Stop,
    ) -> anyhow::Result<(Samples, Outcome, Option<Trace>)> {
        let mut client = Client::connect(Some(&address.to_string()), None)?;
        client.open_session("takt demo")?;
        let ended = lola::follow(controller, machines, &mut client, stop, self.json)?;
        client.end_session()?;
        let outcome = Outcome {
            failures: ended.failures,
            ..Outcome::default()
        };
        Ok((ended.samples, outcome, Some(ended.trace)))
    }

    /// Sends the nets, starts them, and follows them to their end, over the faults of devices.
    fn drive(
        &self,
        controller: &Controller,
        machines: &Machines,
        address: SocketAddr,
        nets: &[String],
        stop: &Stop,
    ) -> anyhow::Result<(Samples, Outcome, Option<Trace>)> {
        if self.robots == Kind::Lola {
            return self.run_machine(controller, machines, address, stop);
        }
        let mut client = Client::connect(Some(&address.to_string()), None)?;
        client.open_session("takt demo")?;
        let mut ids = Vec::new();
        for net in nets {
            ids.push(recovery::load(&mut client, net)?);
        }
        let parts = self.robots.parts().iter().copied().zip(ids.iter().cloned());
        let mut parts = Parts::new(controller, parts, self.duration);
        for id in &ids {
            // On a host that stalled a device may be lost again by now; it recovers.
            if client.command("nest", id).is_err() {
                self.wait_until_ready(controller, machines, stop)?;
                client.command("nest", id)?;
            }
        }
        complain(&format!("the motion begins and takes {:?}", self.duration));
        let samples = self.follow(controller, machines, &mut client, &mut parts, stop)?;
        client.end_session()?;
        Ok((samples, parts.finish(stop.is_requested()), None))
    }

    /// Notes how the arms move until all parts of the cell have come to their end, or one does not come back.
    fn follow(
        &self,
        controller: &Controller,
        machines: &Machines,
        client: &mut Client,
        parts: &mut Parts<'_>,
        stop: &Stop,
    ) -> anyhow::Result<Samples> {
        let begin = Instant::now();
        let bar = self.progress();
        let arms = self.robots.moved();
        let mut samples = Samples::of(arms);
        // A device that is lost near the end gets as long to come back as one at the start.
        let latest = self.duration + READY_WITHIN;
        while !parts.are_done() && !stop.is_requested() && begin.elapsed() < latest {
            let push = client.next_push(SAMPLE_EVERY)?;
            let ended = |push: &takt_client::Message| {
                push.command == "ns"
                    && push.args.first().and_then(|v| v.as_str()) == Some("TERMINATED")
            };
            bar.suspend(|| parts.poll(client, push.as_ref().is_some_and(ended)))?;
            samples.take(controller, machines, arms, begin.elapsed());
            bar.set_position(u64::try_from(begin.elapsed().as_millis()).unwrap_or(u64::MAX));
        }
        bar.finish_and_clear();
        Ok(samples)
    }

    /// Waits for all robots, and prints for which: a youBot searches its stops first, which takes some seconds.
    fn wait_until_ready(
        &self,
        controller: &Controller,
        machines: &Machines,
        stop: &Stop,
    ) -> anyhow::Result<()> {
        let until = Instant::now() + READY_WITHIN;
        let waiting = indicatif::ProgressBar::new_spinner();
        if self.json || !is_terminal() {
            waiting.set_draw_target(indicatif::ProgressDrawTarget::hidden());
        }
        loop {
            let devices = controller.devices();
            let late = devices
                .iter()
                .find(|d| !machines.is_ready(&d.name, d.status));
            let Some(device) = late else {
                waiting.finish_and_clear();
                return Ok(());
            };
            let why = waits_for(controller, &device.name);
            anyhow::ensure!(!stop.is_requested(), "stopped before the motion began");
            if Instant::now() > until {
                let why = why.unwrap_or_else(|| {
                    "this host does not answer it in time; check how busy it is".to_owned()
                });
                anyhow::bail!(
                    "{} is still {} after {READY_WITHIN:?}: {why}",
                    device.name,
                    device.status
                );
            }
            let why = why.map(|why| format!(" ({why})")).unwrap_or_default();
            waiting.set_message(format!("waiting for {}{why}", device.name));
            waiting.tick();
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    fn progress(&self) -> indicatif::ProgressBar {
        if self.json || !is_terminal() {
            return indicatif::ProgressBar::hidden();
        }
        let length = u64::try_from(self.duration.as_millis()).unwrap_or(u64::MAX);
        let style = indicatif::ProgressStyle::with_template("moving {wide_bar} {percent}%");
        let bar = indicatif::ProgressBar::new(length);
        style
            .map(|style| bar.clone().with_style(style))
            .unwrap_or(bar)
    }

    fn print(
        &self,
        report: &Report,
        recorded: Option<u64>,
        svg: Option<&PathBuf>,
    ) -> anyhow::Result<Verdict> {
        if self.json {
            say(&serde_json::to_string(report)?)?;
        } else {
            say(report.text().trim_end())?;
            if let Some(svg) = svg {
                say(&format!("plot       {}", svg.display()))?;
            }
            if let (Some(cycles), Some(path)) = (recorded, &self.record) {
                say(&format!("recording  {}, {cycles} cycles", path.display()))?;
            }
        }
        Ok(if report.ok {
            Verdict::Good
        } else {
            Verdict::Failed
        })
    }
}

/// What the segment of a device waits for, if it reports it.
fn waits_for(controller: &Controller, device: &str) -> Option<String> {
    let of = |segment: &Ethercat| segment.waits_for().filter(|_| segment.drives(device));
    let all = controller.with_drivers(of);
    all.into_iter().flatten().next()
}

fn replay(path: &Path) -> anyhow::Result<Verdict> {
    let outcome = takt_core::record::replay(path)?;
    if let Some(cycle) = outcome.differs {
        complain(&format!(
            "{}: cycle {cycle} gives other outputs than recorded",
            path.display()
        ));
        return Ok(Verdict::Failed);
    }
    if outcome.is_cut {
        complain(&format!(
            "note: {}: the recording is cut off; what is whole in it is replayed",
            path.display()
        ));
    }
    say(&format!(
        "{}: {} cycles, {} bytes: every byte as recorded",
        path.display(),
        outcome.cycles,
        outcome.bytes
    ))?;
    Ok(Verdict::Good)
}
