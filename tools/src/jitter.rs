//! `takt jitter`: latency of cycles on this host, measured with the thread, sleep and statistics of the controller;
//! optionally compared with cyclictest and with a budget.
//!
//! It changes only the settings that the controller changes, and finds no causes: `takt doctor` checks the host.

mod cyclictest;
mod histogram;
mod host;
mod load;
mod measure;
mod report;
mod session;
mod svg;
mod text;
mod trace;
mod view;
mod warning;

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Context as _;
use clap::{Args, ValueEnum};

use crate::Verdict;
use crate::output::{check_writable, positive_span, save, say};
use measure::Plan;
use report::{Judgement, Report};

pub(crate) use histogram::Histogram;
pub(crate) use session::Interrupt;
pub(crate) use view::bars;

/// Measure how late cycles begin on this host.
///
/// Exit status: 0 within the budget, or none was stated; 1 later than the budget, or broken off by
/// --break; 2 wrong usage or environment. Ctrl-C ends a run early and keeps what was measured.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt jitter --cpu all --load 4 --duration 1h --budget 100us --svg jitter.svg
  takt jitter --cpu 1 --break 200us            with a trace running: stop and mark it
  takt jitter --cpu 1 --compare cyclictest --duration 30s
  takt jitter --from jitter.json --svg jitter.svg")]
pub(crate) struct Jitter {
    /// From one cycle to the next.
    #[arg(long, value_name = "TIME", default_value = "1ms", value_parser = positive_span)]
    period: Duration,
    /// SCHED_FIFO priority, 1 to 98; 0 for an ordinary thread.
    #[arg(long, value_name = "N", default_value_t = 80, value_parser = clap::value_parser!(u8).range(..=98))]
    priority: u8,
    /// Processors, one thread each: 1, 0-3, 0,2 or all. By default one thread on any.
    #[arg(long, value_name = "LIST", value_parser = cpu_choice)]
    cpu: Option<CpuChoice>,
    /// How long to measure; when comparing, with each tool.
    #[arg(long, value_name = "TIME", default_value = "10s", value_parser = positive_span)]
    duration: Duration,
    /// Processes that keep processors, memory, files and pipes busy meanwhile.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(..=256))]
    load: u32,
    /// The longest latency allowed; without it there is no verdict.
    #[arg(long, value_name = "TIME", value_parser = positive_span)]
    budget: Option<Duration>,
    /// End at a latency above this, mark and stop the kernel's trace, print the last cycles.
    #[arg(long = "break", value_name = "TIME", value_parser = positive_span, conflicts_with = "compare")]
    break_at: Option<Duration>,
    /// Write the histogram as a picture.
    #[arg(long, value_name = "FILE.svg")]
    svg: Option<PathBuf>,
    /// Print one JSON object instead of the report.
    #[arg(long)]
    json: bool,
    /// Print the verdict only.
    #[arg(long, conflicts_with = "json")]
    quiet: bool,
    /// Measure nothing, read a report of --json, or what cyclictest wrote with --json or -h.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["compare", "break_at", "load", "cpu"])]
    from: Option<PathBuf>,
    /// Alternate with this tool, and give the ratios of the latencies.
    #[arg(long, value_name = "TOOL")]
    compare: Option<Tool>,
    /// Slices of each tool. By default each lasts 250 ms, or 100 cycles if that is longer.
    #[arg(long, value_name = "N", requires = "compare", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    slices: Option<u32>,
    /// Be one process of the load.
    #[arg(long, hide = true)]
    load_worker: bool,
}

/// What to compare with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Tool {
    /// cyclictest of rt-tests.
    Cyclictest,
}

/// Which processors.
#[derive(Clone, Debug, PartialEq, Eq)]
enum CpuChoice {
    All,
    List(Vec<usize>),
}

fn cpu_choice(text: &str) -> Result<CpuChoice, String> {
    if text == "all" {
        return Ok(CpuChoice::All);
    }
    host::cpu_list(text).map(CpuChoice::List)
}

impl Jitter {
    pub(crate) fn run(self) -> anyhow::Result<Verdict> {
        if self.load_worker {
            load::work()?;
            return Ok(Verdict::Good);
        }
        self.svg.as_deref().map_or(Ok(()), check_writable)?;
        let mut report = match &self.from {
            Some(path) => read(path)?,
            None => session::measure(&self)?,
        };
        anyhow::ensure!(
            report.cycles() > 0,
            "no cycle ran\nhint: give a longer --duration"
        );
        let stored = report.budget_ns.map(Duration::from_nanos);
        report.judge(self.budget.or(stored));
        let picture = self.svg.as_ref();
        let drawn = picture.map_or(Ok(()), |path| save(path, svg::picture(&report)));
        self.print(&report)?;
        // The result is printed even if its picture cannot be written.
        drawn?;
        Ok(match report.verdict {
            Judgement::Fail => Verdict::Failed,
            Judgement::Pass | Judgement::None => Verdict::Good,
        })
    }

    fn print(&self, report: &Report) -> anyhow::Result<()> {
        if self.json {
            return say(&serde_json::to_string(report)?);
        }
        if !self.quiet {
            say(text::report(report).trim_end())?;
            if let Some(path) = &self.svg {
                say(&format!("plot       {}", path.display()))?;
            }
        }
        say(&report.verdict_line())
    }

    /// What to measure, if that is possible here.
    fn plan(&self) -> anyhow::Result<Plan> {
        const SHORTEST: Duration = Duration::from_micros(20);
        anyhow::ensure!(
            self.period >= SHORTEST,
            "a period below {SHORTEST:?} leaves no time to sleep\nhint: --period 1ms"
        );
        anyhow::ensure!(
            self.duration >= self.period,
            "the duration is shorter than one period\nhint: --duration 10s"
        );
        Ok(Plan {
            period: self.period,
            priority: (self.priority > 0).then_some(self.priority),
            cpus: self.cpus()?,
            duration: self.duration,
            break_at: self.break_at,
            tracer: None,
        })
    }

    fn cpus(&self) -> anyhow::Result<Vec<Option<usize>>> {
        let usable = host::usable_cpus();
        let chosen = match &self.cpu {
            Some(CpuChoice::All) => usable,
            Some(CpuChoice::List(list)) => {
                let wrong = list.iter().find(|cpu| !usable.contains(cpu));
                if let Some(cpu) = wrong {
                    anyhow::bail!(
                        "CPU {cpu} cannot be used here\nhint: those that can are {usable:?}"
                    );
                }
                list.clone()
            }
            // cyclictest always pins its thread to one processor; so both are given the same.
            None if self.compare.is_some() => usable.into_iter().take(1).collect(),
            None => return Ok(vec![None]),
        };
        anyhow::ensure!(
            !chosen.is_empty(),
            "cannot determine which CPUs can be used here"
        );
        Ok(chosen.into_iter().map(Some).collect())
    }
}

/// Reads a report back, ours or cyclictest's.
fn read(path: &Path) -> anyhow::Result<Report> {
    let name = path.display();
    let text = takt_core::files::read_text(path, takt_core::files::TEXT_BYTES_MAX)
        .with_context(|| format!("cannot read {name}"))?;
    let report = if cyclictest::is_output(&text) {
        cyclictest::import(&text)
    } else {
        Report::from_json(text.trim()).context(
            "no report of `takt jitter --json`, and no output of cyclictest with --json or -h",
        )
    };
    report.with_context(|| name.to_string())
}
