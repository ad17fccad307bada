//! `takt top`: how a running controller is, on one screen: findings, threads, devices, nets and machines, the worst first. It
//! reads the controller's HTTP resources and commands nothing.

pub(crate) mod finding;
mod poll;
pub(crate) mod report;
mod table;
mod text;
mod view;

use std::time::Duration;

use clap::Args;

use crate::Verdict;
use crate::http::Site;
use crate::output::{say, span_of_ms};
use poll::Poller;
use report::Report;
use table::{Order, sections};

/// How long the controller may take to answer.
const TIMEOUT: Duration = Duration::from_secs(3);

/// Columns of the page of `--once`.
const COLUMNS: usize = 80;

/// Show how a running controller is: what is wrong and what to do, threads, devices, nets, machines, live.
///
/// The worst comes first. Keys: q ends it, s changes the order, Tab shows one table in full, the arrows scroll it, Space
/// pauses, ? explains.
///
/// Exit status of --once and --json: 0 no FAIL; 1 something fails; 2 no controller answers.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt top
  takt top --connect robot:8080 --token-file token
  takt top --once | grep FAIL
  takt top --json | jq '.threads[].missed'")]
pub(crate) struct Top {
    /// Print one page of plain text and end; so it does if standard output is no terminal.
    #[arg(long)]
    once: bool,
    /// Print one JSON object and end.
    #[arg(long, conflicts_with = "once")]
    json: bool,
    /// How often the controller is read, 100ms to 60s.
    #[arg(long, value_name = "TIME", default_value = "1s", value_parser = span_of_ms(100..=60_000))]
    interval: Duration,
    #[command(flatten)]
    site: Site,
}

impl Top {
    pub(crate) fn run(self) -> anyhow::Result<Verdict> {
        let http = self.site.client(TIMEOUT)?;
        if self.json || self.once {
            return self.print(&Report::read(&http, None)?);
        }
        let Some(screen) = crate::screen::Screen::open(true) else {
            return self.print(&Report::read(&http, None)?);
        };
        let address = http.address().to_owned();
        view::show(screen, &address, Poller::start(http, self.interval))?;
        Ok(Verdict::Good)
    }

    fn print(&self, report: &Report) -> anyhow::Result<Verdict> {
        if self.json {
            say(&serde_json::to_string(report)?)?;
        } else {
            let head = text::head(report, &self.site.connect);
            let sections = sections(report, Order::Worst, COLUMNS);
            say(text::page(&head, &sections).trim_end())?;
        }
        Ok(if report.fails() {
            Verdict::Failed
        } else {
            Verdict::Good
        })
    }
}
