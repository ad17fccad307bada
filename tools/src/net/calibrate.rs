//! `takt net calibrate`: what each primitive costs at most on this host, as a table by which the
//! controller refuses nets that cannot keep their period. It needs no controller and moves no robot.

mod measure;
mod stage;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use anyhow::Context as _;
use clap::Args;
use indicatif::ProgressBar;
use serde_json::{Value, json};
use takt_core::costs::CostTable;
use takt_net::{Cost, Registry};

use crate::Verdict;
use crate::output::{complain, is_terminal, save, say, time};
use measure::Measured;

/// `SCHED_FIFO` priority of the measuring thread: above what is ordinary, below any controller.
const PRIORITY: u8 = 1;

/// Measure what each primitive costs on this host.
///
/// Every primitive is evaluated with caches that other programs have used, and with arguments that make
/// its work long; the figure is what 99 of 100 repetitions keep. Measure on a quiet host, and with the
/// controller stopped. Name the file as `costs` in the section `[controller]` of cell.toml.
#[derive(Debug, Args)]
pub(crate) struct Calibrate {
    /// Write the table into this file instead of standard output.
    #[arg(long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// How often each primitive is evaluated; fewer than 100 are not significant.
    #[arg(long, value_name = "COUNT", default_value_t = 200,
          value_parser = clap::value_parser!(u32).range(1..=100_000))]
    repetitions: u32,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

impl Calibrate {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let repetitions = self.repetitions as usize;
        let thread = takt_rt::thread::ThreadConfig {
            priority: Some(PRIORITY),
            ..takt_rt::thread::ThreadConfig::new("takt-calibrate")
        };
        let thread = takt_rt::thread::spawn(thread, move || {
            let registry = takt_core::registry();
            let measured = all(&registry, repetitions);
            (registry, measured)
        })
        .context("cannot start the measuring thread")?;
        for grant in thread.grants() {
            if grant.is_refused() {
                complain(&format!("{grant}; figures may be too high"));
            }
        }
        let Ok((registry, measured)) = thread.join() else {
            anyhow::bail!("the measuring thread has ended by a panic");
        };
        self.print(&registry, &measured)?;
        Ok(Verdict::Good)
    }

    fn print(&self, registry: &Registry, measured: &[Entry]) -> anyhow::Result<()> {
        let costs = measured.iter().filter_map(|(name, result)| {
            let measured = result.as_ref().ok()?;
            Some((name.clone(), measured.cost))
        });
        let table = CostTable::of_this_host(today(), costs);
        if let Some(path) = &self.output {
            save(path, table.text())?;
        }
        if self.json {
            return say(&json(&table, measured).to_string());
        }
        match &self.output {
            None => say(table.text().trim_end())?,
            Some(path) => {
                say(&report(registry, measured))?;
                say(&format!("written to {}", path.display()))?;
            }
        }
        for (why, names) in not_measured(measured) {
            complain(&format!(
                "not measured, keep what they declare: {}: {why}",
                names.join(", ")
            ));
        }
        Ok(())
    }
}

/// Names of those that were not measured, by the reason.
fn not_measured(measured: &[Entry]) -> BTreeMap<&str, Vec<&str>> {
    let mut reasons: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for (name, result) in measured {
        if let Err(why) = result {
            reasons.entry(why).or_default().push(name);
        }
    }
    reasons
}

/// A primitive and what was measured of it, or why nothing was.
type Entry = (String, Result<Measured, String>);

fn all(registry: &Registry, repetitions: usize) -> Vec<Entry> {
    let definitions = registry.definitions();
    let progress = if is_terminal() {
        ProgressBar::new(definitions.len() as u64)
    } else {
        ProgressBar::hidden()
    };
    let mut caches = measure::Caches::new();
    let one = |definition: &takt_net::Definition| {
        progress.inc(1);
        let measured = measure::measure(definition, registry, repetitions, &mut caches);
        (definition.name.clone(), measured)
    };
    let measured = definitions.iter().map(one).collect();
    progress.finish_and_clear();
    measured
}

/// The heaviest primitives, and those that cost more than they declare.
fn report(registry: &Registry, measured: &[Entry]) -> String {
    const SHOWN: usize = 10;
    let mut rows: Vec<_> = measured
        .iter()
        .filter_map(|(name, result)| Some((name, result.as_ref().ok()?)))
        .collect();
    rows.sort_by(|(_, a), (_, b)| b.cost.ns.total_cmp(&a.cost.ns));
    let shown = |ns: f64| time(whole(ns));
    let mut text = format!(
        "{:<36} {:>9} {:>9} {:>9} {:>9}\n",
        "heaviest primitives, a cycle at most", "each", "+ first", "+ element", "usually"
    );
    for (name, Measured { cost, usual_ns }) in rows.iter().take(SHOWN) {
        text += &format!(
            "{name:<36} {:>9} {:>9} {:>9} {:>9}\n",
            shown(cost.ns),
            shown(cost.first_ns),
            format!("{:.1} ns", cost.element_ns),
            shown(*usual_ns),
        );
    }
    let above = rows.iter().filter(|(name, measured)| {
        let declared = registry.find(name).map(|definition| definition.cost);
        declared.is_some_and(|declared| measured.cost.ns > declared.ns)
    });
    let above = above.count();
    format!(
        "{text}{} of {} primitives measured; {above} cost more here than they declare",
        rows.len(),
        measured.len()
    )
}

fn whole(ns: f64) -> i64 {
    #[expect(clippy::cast_possible_truncation, reason = "saturates; shown only")]
    let whole = ns.round() as i64;
    whole
}

fn json(table: &CostTable, measured: &[Entry]) -> Value {
    let primitives = measured.iter().filter_map(|(name, result)| {
        let Measured { cost, usual_ns } = result.as_ref().ok()?;
        let Cost {
            first_ns,
            ns,
            element_ns,
        } = cost;
        Some(json!({
            "name": name, "first_ns": first_ns, "ns": ns, "element_ns": element_ns,
            "usual_ns": usual_ns,
        }))
    });
    let skipped = measured.iter().filter_map(|(name, result)| {
        let why = result.as_ref().err()?;
        Some(json!({"name": name, "why": why}))
    });
    json!({
        "version": 1, "host": table.host, "cpu": table.cpu, "kernel": table.kernel,
        "date": table.date, "primitives": primitives.collect::<Vec<_>>(),
        "not_measured": skipped.collect::<Vec<_>>(),
    })
}

/// Today's date, UTC.
fn today() -> String {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    date(since.unwrap_or(Duration::ZERO).as_secs() / 86_400)
}

/// The date so many days after 1 January 1970. One date in one file is too little for a library.
fn date(mut days: u64) -> String {
    let is_leap = |year: u64| {
        year.is_multiple_of(4) && (!year.is_multiple_of(100) || year.is_multiple_of(400))
    };
    let mut year = 1970;
    while days >= 365 + u64::from(is_leap(year)) {
        days -= 365 + u64::from(is_leap(year));
        year += 1;
    }
    let february = 28 + u64::from(is_leap(year));
    let mut month = 1;
    for length in [31, february, 31, 30, 31, 30, 31, 31, 30, 31, 30] {
        if days < length {
            break;
        }
        days -= length;
        month += 1;
    }
    format!("{year}-{month:02}-{:02}", days + 1)
}

#[cfg(test)]
mod tests {
    use super::date;

    #[test]
    fn dates_count_leap_years() {
        for (days, expected) in [
            (0, "1970-01-01"),
            (364, "1970-12-31"),
            (11_016, "2000-02-29"),
            (11_017, "2000-03-01"),
            (20_778, "2026-11-21"),
        ] {
            assert_eq!(date(days), expected);
        }
    }
}
