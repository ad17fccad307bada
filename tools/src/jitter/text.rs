//! The report for people: at most 80 columns but for warnings, the verdict last.
//!
//! It decides nothing; all figures are those of the report.

use std::fmt::Write as _;

use crate::jitter::histogram::Histogram;
use crate::jitter::report::{Broke, Compare, Report, ThreadReport, nanos};

/// Columns of the longest bar.
const BAR: f64 = 44.0;

/// The whole report but its last line, the verdict.
pub(crate) fn report(report: &Report) -> String {
    let mut text = format!("{}\n", headline(report));
    circumstances(&mut text, report);
    text.push('\n');
    let who = report.compare.as_ref().map(|_| report.tool.as_str());
    table(&mut text, who, &report.threads);
    if let Some(compare) = &report.compare {
        table(&mut text, Some(&compare.tool), &compare.threads);
        ratios(&mut text, report, compare);
    }
    text.push('\n');
    bars(&mut text, &report.pooled());
    text.push('\n');
    counts(&mut text, report);
    if let Some(broke) = &report.broke {
        breakage(&mut text, broke);
    }
    for warning in &report.warnings {
        line(&mut text, format_args!("WARN  {}", warning.text));
    }
    for fault in &report.faults {
        line(&mut text, format_args!("FAIL  {fault}"));
    }
    text
}

/// Writing to a string cannot fail.
fn line(text: &mut String, arguments: std::fmt::Arguments<'_>) {
    let _ = writeln!(text, "{arguments}");
}

/// What was measured, in a line.
pub(crate) fn headline(report: &Report) -> String {
    let mut parts = vec![report.period_ns.map_or_else(
        || "cycle of unknown period".to_owned(),
        |ns| format!("{} cycle", nanos(ns)),
    )];
    parts.push(report.priority.map_or_else(
        || "ordinary thread".to_owned(),
        |priority| format!("SCHED_FIFO {priority}"),
    ));
    if report.duration_ns > 0 {
        parts.push(nanos(report.duration_ns));
    }
    match report.load_workers {
        Some(0) => parts.push("no load of ours".to_owned()),
        Some(workers) => parts.push(format!("load {workers}")),
        None => {}
    }
    if report.interrupted {
        parts.push("interrupted".to_owned());
    }
    format!("{}: {}", report.tool, parts.join(", "))
}

fn circumstances(text: &mut String, report: &Report) {
    let host = &report.host;
    if !host.kernel.is_empty() {
        line(text, format_args!("kernel     {}", host.kernel));
    }
    if host.cpus > 0 {
        let name = if host.processor.is_empty() {
            "unnamed"
        } else {
            &host.processor
        };
        line(
            text,
            format_args!("processor  {name}, {} usable", host.cpus),
        );
    }
    if let Some((busy, steal)) = report.busy_percent.zip(report.steal_percent) {
        line(
            text,
            format_args!("machine    {busy} % busy, {steal} % stolen by its host"),
        );
    }
}

fn table(text: &mut String, who: Option<&str>, threads: &[ThreadReport]) {
    if let Some(who) = who {
        line(text, format_args!("{who}"));
    }
    line(
        text,
        format_args!(
            "{:>4} {:>10} {:>7} {:>9} {:>9} {:>9} {:>9} {:>9}",
            "CPU", "cycles", "missed", "min", "p50", "p99", "p99.9", "max"
        ),
    );
    for thread in threads {
        let (latency, q) = (&thread.latency_ns, thread.latency_ns.quantiles());
        let missed = thread
            .missed_cycles
            .map_or_else(|| "?".to_owned(), |missed| missed.to_string());
        let times = [latency.min_ns(), q.p50, q.p99, q.p999, q.max].map(nanos);
        line(
            text,
            format_args!(
                "{:>4} {:>10} {missed:>7} {}",
                thread.name(),
                thread.cycles,
                times.map(|time| format!("{time:>9}")).join(" ")
            ),
        );
    }
}

fn ratios(text: &mut String, report: &Report, compare: &Compare) {
    let Some(ratio) = &report.ratio else { return };
    let figure =
        |ratio: Option<f64>| ratio.map_or_else(|| "?".to_owned(), |ratio| format!("{ratio:.3}"));
    let figures = [ratio.p50, ratio.p99, ratio.p999, ratio.max];
    line(
        text,
        format_args!(
            "{:<33} {}",
            format!("ratio, {} slices each", compare.slices.len()),
            figures.map(|r| format!("{:>9}", figure(r))).join(" ")
        ),
    );
    line(text, format_args!("other      {}", compare.command));
}

/// Bounds of the bars, ns: 1, 2, 5 in each decade from 1 us to 1 s.
fn bounds() -> Vec<u64> {
    let decades = (3..9).map(|power| 10_u64.pow(power));
    let mut bounds: Vec<_> = decades
        .flat_map(|decade| [decade, 2 * decade, 5 * decade])
        .collect();
    bounds.push(1_000_000_000);
    bounds
}

/// The histogram: a bar's length goes by the logarithm of its count, so that one cycle in a million
/// is seen.
#[expect(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "bars; counts are positive"
)]
fn bars(text: &mut String, histogram: &Histogram) {
    let bounds = bounds();
    let edges: Vec<_> = bounds.iter().map(|&ns| ns as f64).collect();
    let bins = histogram.rebinned(&edges);
    let Some(first) = bins.iter().position(|&n| n > 0.0) else {
        return;
    };
    let last = bins.iter().rposition(|&n| n > 0.0).unwrap_or(first);
    let most = bins.iter().copied().fold(1.0, f64::max);
    line(
        text,
        format_args!("{:>17} {:>10}  logarithmic", "latency", "cycles"),
    );
    for bin in first..=last {
        let count = bins[bin].round();
        let share = (count + 1.0).ln() / (most + 1.0).ln();
        let bar = "#".repeat((share * BAR).round() as usize);
        let row = format!(
            "{:>7} - {:>7} {count:>10}  {bar}",
            short(bounds[bin]),
            short(bounds[bin + 1])
        );
        line(text, format_args!("{}", row.trim_end()));
    }
}

/// A round time without decimals: `20 us`.
fn short(ns: u64) -> String {
    match ns {
        0..1_000_000 => format!("{} us", ns / 1_000),
        1_000_000..1_000_000_000 => format!("{} ms", ns / 1_000_000),
        _ => format!("{} s", ns / 1_000_000_000),
    }
}

fn counts(text: &mut String, report: &Report) {
    for thread in &report.threads {
        let Some(usage) = &thread.usage else { continue };
        line(
            text,
            format_args!(
                "CPU {:<4}   page faults {} minor, {} major; switches {} own, {} forced",
                thread.name(),
                usage.page_faults_minor,
                usage.page_faults_major,
                usage.context_switches_voluntary,
                usage.context_switches_involuntary
            ),
        );
    }
    match (report.smi_count, &report.smi_unknown) {
        (Some(count), _) => line(text, format_args!("SMI        {count}")),
        (None, Some(why)) => line(text, format_args!("SMI        unknown ({why})")),
        (None, None) => {}
    }
    if let Some(allocations) = report.rt_allocations {
        line(
            text,
            format_args!("heap       {allocations} allocations in measuring threads"),
        );
    }
}

fn breakage(text: &mut String, broke: &Broke) {
    line(text, format_args!("trace      {}", broke.trace));
    line(
        text,
        format_args!("the last cycles, the latest at the end:"),
    );
    for entry in &broke.flight {
        line(text, format_args!("  {entry}"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jitter::report::tests::fixed;
    use crate::jitter::report::{Ratio, SlicePair};

    #[test]
    fn the_report_fits_a_terminal() {
        let text = report(&fixed());
        assert!(
            text.lines().all(|line| line.chars().count() <= 80),
            "{text}"
        );
        let row = "   1      10000       0   17.1 us   20.6 us   28.0 us   45.0 us    183 us";
        assert!(text.contains(row), "{text}");
    }

    #[test]
    fn every_cycle_is_under_a_bar() {
        let mut text = String::new();
        bars(&mut text, &fixed().pooled());
        let count = |line: &str| line.get(17..28).map(|n| n.trim().parse::<u64>().unwrap());
        let sum: u64 = text.lines().skip(1).filter_map(count).sum();
        assert_eq!(sum, 20_000, "{text}");
        assert!(text.lines().nth(1).unwrap().contains("10 us -   20 us"));
    }

    #[test]
    fn report_ratios_align_with_quantiles() {
        let mut both = fixed();
        let q = both.pooled().quantiles();
        both.ratio = Some(Ratio::of(&q, &q));
        both.compare = Some(Compare {
            tool: "cyclictest 2.40".into(),
            command: "cyclictest -q".into(),
            threads: both.threads.clone(),
            slices: vec![SlicePair {
                takt_ns: q,
                other_ns: q,
            }],
        });
        let text = report(&both);
        let ratio = text.lines().find(|l| l.starts_with("ratio")).unwrap();
        let head = text.lines().find(|l| l.contains("p99.9")).unwrap();
        assert_eq!(ratio.len(), head.len(), "{text}");
        assert_eq!(ratio.matches("1.000").count(), 4);
    }
}
