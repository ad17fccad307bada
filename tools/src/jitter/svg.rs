//! The picture of a measurement: both axes logarithmic, so that one late cycle in a million is seen beside the
//! million, and the figures below. Written as text, since the library of the demo's plot has neither tables nor placed
//! marks.
//!
//! It shows distributions, not their course in time.

use std::fmt::Write as _;

use crate::jitter::histogram::Histogram;
use crate::jitter::report::{Report, ThreadReport, nanos};

/// The plot within the picture, CSS pixels.
const LEFT: f64 = 72.0;
const RIGHT: f64 = 936.0;
const TOP: f64 = 92.0;
const BOTTOM: f64 = 372.0;
const WIDTH: f64 = 960.0;
/// Height of a row of the table.
const ROW: f64 = 20.0;
/// Where the table begins.
const TABLE: f64 = BOTTOM + 66.0;
/// Right edges of the table's columns after the name.
const COLUMNS: [(f64, &str); 7] = [
    (410.0, "cycles"),
    (490.0, "missed"),
    (580.0, "min"),
    (670.0, "p50"),
    (760.0, "p99"),
    (848.0, "p99.9"),
    (RIGHT, "max"),
];
/// Bins for each decade of time.
const BINS_PER_DECADE: f64 = 30.0;
/// The least count shown: a single cycle stands well above the axis.
const LEAST: f64 = 0.6;
/// More threads than this are drawn as one.
const SERIES_MAX: usize = 6;
/// Colours that are distinguishable with colour blindness.
const COLOURS: [&str; SERIES_MAX] = [
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00",
];

/// What is drawn in one colour.
struct Series {
    name: String,
    cycles: u64,
    missed: Option<u64>,
    latency: Histogram,
}

impl Series {
    fn new(name: String, threads: &[ThreadReport]) -> Self {
        let missed = threads.iter().map(|thread| thread.missed_cycles);
        Self {
            name,
            cycles: threads.iter().map(|thread| thread.cycles).sum(),
            missed: missed.sum(),
            latency: Histogram::pooled(threads.iter().map(|thread| &thread.latency_ns)),
        }
    }
}

/// The tools if there are two, otherwise the processors.
fn series(report: &Report) -> Vec<Series> {
    if let Some(compare) = &report.compare {
        return vec![
            Series::new(report.tool.clone(), &report.threads),
            Series::new(compare.tool.clone(), &compare.threads),
        ];
    }
    if report.threads.len() > SERIES_MAX {
        let name = format!("all {} CPUs", report.threads.len());
        return vec![Series::new(name, &report.threads)];
    }
    let each = report.threads.iter().map(|thread| {
        let name = thread
            .cpu
            .map_or_else(|| "any CPU".to_owned(), |cpu| format!("CPU {cpu}"));
        Series::new(name, std::slice::from_ref(thread))
    });
    each.collect()
}

/// A logarithmic axis: values from `low` to `high` between two places.
struct Axis {
    low: f64,
    high: f64,
    from: f64,
    to: f64,
}

impl Axis {
    fn at(&self, value: f64) -> f64 {
        let share =
            (value.clamp(self.low, self.high) / self.low).ln() / (self.high / self.low).ln();
        self.from + share * (self.to - self.from)
    }
}

/// Time, ns, to x.
#[expect(clippy::cast_precision_loss, reason = "a picture")]
fn time_axis(report: &Report, series: &[Series]) -> Axis {
    let min = series.iter().map(|s| s.latency.min_ns()).min();
    let max = series.iter().map(|s| s.latency.max_ns()).max();
    let max = max.max(report.budget_ns).unwrap_or(0) as f64 * 1.05;
    let min = min.unwrap_or(0).max(100) as f64 / 1.05;
    let low = rounds().rfind(|&ns| ns <= min).unwrap_or(100.0);
    let high = rounds().find(|&ns| ns >= max.max(low * 10.0));
    Axis {
        low,
        high: high.unwrap_or(1e12),
        from: LEFT,
        to: RIGHT,
    }
}

/// Round times from 100 ns to 1000 s: 1, 2, 5 in each decade.
fn rounds() -> impl DoubleEndedIterator<Item = f64> {
    (2..=11).flat_map(|power| [1.0, 2.0, 5.0].map(|digit| digit * 10_f64.powi(power)))
}

/// The picture, as text.
pub(crate) fn picture(report: &Report) -> String {
    let series = series(report);
    let x = time_axis(report, &series);
    let bounds = bounds(&x);
    let bins: Vec<_> = series.iter().map(|s| s.latency.rebinned(&bounds)).collect();
    let most = bins.iter().flatten().copied().fold(1.0, f64::max);
    let y = Axis {
        low: LEAST,
        high: 10_f64.powf(most.log10().ceil().max(1.0)),
        from: BOTTOM,
        to: TOP,
    };
    let rows = f64::from(u32::try_from(series.len()).unwrap_or(1));
    let mut svg = open(TABLE + ROW * rows + 16.0);
    caption(&mut svg, report);
    grid(&mut svg, &x, &y);
    for (number, bins) in bins.iter().enumerate().rev() {
        curve(&mut svg, number, &bounds, bins, &x, &y);
    }
    marks(&mut svg, report, &x);
    table(&mut svg, &series);
    svg.push_str("</svg>\n");
    svg
}

fn bounds(x: &Axis) -> Vec<f64> {
    let step = 10_f64.powf(1.0 / BINS_PER_DECADE);
    std::iter::successors(Some(x.low), |bound| {
        (*bound < x.high * 0.999).then_some(bound * step)
    })
    .collect()
}

/// Writing to a string cannot fail.
macro_rules! put {
    ($svg:expr, $($arguments:tt)*) => {{ let _ = writeln!($svg, $($arguments)*); }};
}

fn open(height: f64) -> String {
    let mut svg = String::new();
    put!(
        svg,
        r##"<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{height}" viewBox="0 0 {WIDTH} {height}" font-family="Helvetica, Arial, sans-serif" font-size="12" fill="#222">
<rect width="{WIDTH}" height="{height}" fill="#fff"/>"##
    );
    svg
}

fn caption(svg: &mut String, report: &Report) {
    let head = crate::jitter::text::headline(report);
    let cycle = head
        .split_once(": ")
        .map_or(head.as_str(), |(_, rest)| rest);
    put!(
        svg,
        r#"<text x="{LEFT}" y="30" font-size="17" font-weight="bold">Wake-up latency, {}</text>"#,
        escape(cycle)
    );
    let host = &report.host;
    let rt = if host.kernel.is_empty() || host.preempt_rt {
        ""
    } else {
        " (not PREEMPT_RT)"
    };
    let machine = host
        .virtual_machine
        .as_ref()
        .map(|name| format!("virtual machine ({name})"));
    let busy = report.busy_percent.map(|busy| format!("{busy} % busy"));
    let cpus = (host.cpus > 0).then(|| format!("{} CPUs", host.cpus));
    let parts = [Some(host.processor.clone()), cpus, machine, busy];
    let parts: Vec<_> = parts
        .into_iter()
        .flatten()
        .filter(|p| !p.is_empty())
        .collect();
    let lines = [format!("{}{rt}", host.kernel), parts.join(" · ")];
    for (y, line) in [50, 66].into_iter().zip(lines) {
        put!(
            svg,
            r##"<text x="{LEFT}" y="{y}" font-size="11" fill="#555">{}</text>"##,
            escape(&line)
        );
    }
}

fn grid(svg: &mut String, x: &Axis, y: &Axis) {
    put!(svg, r##"<g stroke="#e4e4e4">"##);
    let times: Vec<_> = rounds().filter(|&ns| ns >= x.low && ns <= x.high).collect();
    let decades = (0..=12).map(|power| 10_f64.powi(power));
    let counts: Vec<_> = decades.filter(|&count| count <= y.high).collect();
    for &ns in &times {
        put!(svg, r#"<path d="M{:.1} {TOP}V{BOTTOM}"/>"#, x.at(ns));
    }
    for &count in &counts {
        put!(svg, r#"<path d="M{LEFT} {:.1}H{RIGHT}"/>"#, y.at(count));
    }
    put!(svg, "</g>\n<g font-size=\"11\">");
    for &ns in &times {
        let (at, label) = (x.at(ns), round_label(ns));
        put!(
            svg,
            r#"<text x="{at:.1}" y="{}" text-anchor="middle">{label}</text>"#,
            BOTTOM + 16.0
        );
    }
    for &count in &counts {
        let (at, label) = (y.at(count) + 4.0, grouped(count));
        put!(
            svg,
            r#"<text x="{}" y="{at:.1}" text-anchor="end">{label}</text>"#,
            LEFT - 8.0
        );
    }
    put!(
        svg,
        r##"</g>
<path d="M{LEFT} {TOP}V{BOTTOM}H{RIGHT}" fill="none" stroke="#222"/>
<text x="{}" y="{}" text-anchor="middle">from when a cycle was due to when its thread ran</text>
<text transform="translate(18 {}) rotate(-90)" text-anchor="middle">cycles</text>"##,
        f64::midpoint(LEFT, RIGHT),
        BOTTOM + 36.0,
        f64::midpoint(TOP, BOTTOM)
    );
}

/// A round time: `20 us`.
fn round_label(ns: f64) -> String {
    match ns {
        ns if ns < 1e3 => format!("{ns:.0} ns"),
        ns if ns < 1e6 => format!("{:.0} us", ns / 1e3),
        ns if ns < 1e9 => format!("{:.0} ms", ns / 1e6),
        ns => format!("{:.0} s", ns / 1e9),
    }
}

/// A count with its thousands apart.
fn grouped(count: f64) -> String {
    let digits = format!("{count:.0}");
    let mut text = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i) % 3 == 0 {
            text.push('\u{2009}');
        }
        text.push(digit);
    }
    text
}

/// Bars without their inner edges; the first series filled, the others over it as lines.
fn curve(svg: &mut String, number: usize, bounds: &[f64], bins: &[f64], x: &Axis, y: &Axis) {
    let colour = COLOURS[number % COLOURS.len()];
    let mut path = String::new();
    let mut is_up = false;
    for (edges, &count) in bounds.windows(2).zip(bins) {
        let (left, right) = (x.at(edges[0]), x.at(edges[1]));
        if count < LEAST {
            if is_up {
                let _ = write!(path, "V{BOTTOM}");
            }
            is_up = false;
            continue;
        }
        if !is_up {
            let _ = write!(path, "M{left:.1} {BOTTOM}");
        }
        is_up = true;
        let _ = write!(path, "V{:.1}H{right:.1}", y.at(count));
    }
    if is_up {
        let _ = write!(path, "V{BOTTOM}");
    }
    let opacity = if number == 0 { "0.3" } else { "0.08" };
    put!(
        svg,
        r#"<path d="{path}" fill="{colour}" fill-opacity="{opacity}" stroke="{colour}" stroke-width="1.4"/>"#
    );
}

/// Quantiles of all our threads together and the budget, as lines from top to bottom.
#[expect(clippy::cast_precision_loss, reason = "a picture")]
fn marks(svg: &mut String, report: &Report, x: &Axis) {
    let q = report.pooled().quantiles();
    let quantiles = [
        ("p50", q.p50),
        ("p99", q.p99),
        ("p99.9", q.p999),
        ("max", q.max),
    ];
    let mut row = TOP + 12.0;
    for (name, ns) in quantiles {
        let line = r##"stroke="#444" stroke-dasharray="3 3""##;
        mark(
            svg,
            x.at(ns as f64),
            row,
            &format!("{name} {}", nanos(ns)),
            line,
            "#222",
        );
        row += 15.0;
    }
    if let Some(budget) = report.budget_ns {
        let line = r##"stroke="#c00" stroke-width="1.6""##;
        let text = format!("budget {}", nanos(budget));
        mark(svg, x.at(budget as f64), row, &text, line, "#c00");
    }
}

/// A line and its name. The name stands twice: first in thick white, which keeps it legible on bars, since
/// not every program that shows pictures knows `paint-order`.
fn mark(svg: &mut String, x: f64, y: f64, text: &str, line: &str, colour: &str) {
    let (at, anchor) = if x > RIGHT - 110.0 {
        (x - 5.0, "end")
    } else {
        (x + 5.0, "start")
    };
    let place = format!(r#"x="{at:.1}" y="{y}" text-anchor="{anchor}" font-size="11""#);
    put!(
        svg,
        r##"<path d="M{x:.1} {TOP}V{BOTTOM}" {line}/>
<text {place} fill="#fff" stroke="#fff" stroke-width="3">{text}</text>
<text {place} fill="{colour}">{text}</text>"##
    );
}

fn table(svg: &mut String, series: &[Series]) {
    put!(svg, r##"<g text-anchor="end" fill="#555">"##);
    for (right, head) in COLUMNS {
        put!(svg, r#"<text x="{right}" y="{TABLE}">{head}</text>"#);
    }
    put!(svg, "</g>");
    let mut y = TABLE;
    for (number, s) in series.iter().enumerate() {
        y += ROW;
        let q = s.latency.quantiles();
        let missed = s
            .missed
            .map_or_else(|| "?".to_owned(), |missed| missed.to_string());
        #[expect(clippy::cast_precision_loss, reason = "a label")]
        let mut cells = vec![grouped(s.cycles as f64), missed];
        cells.extend([s.latency.min_ns(), q.p50, q.p99, q.p999, q.max].map(nanos));
        put!(
            svg,
            r#"<rect x="{LEFT}" y="{}" width="14" height="10" fill="{}"/><text x="{}" y="{y}">{}</text>"#,
            y - 9.0,
            COLOURS[number % COLOURS.len()],
            LEFT + 22.0,
            escape(&s.name)
        );
        for ((right, _), cell) in COLUMNS.iter().zip(cells) {
            put!(
                svg,
                r#"<text x="{right}" y="{y}" text-anchor="end">{cell}</text>"#
            );
        }
    }
}

/// Escapes names from the host.
fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jitter::report::tests::fixed;

    #[test]
    fn svg_draws_and_names_all_processors() {
        let mut report = fixed();
        report.host.processor = "<A & B>".into();
        report.judge(Some(std::time::Duration::from_micros(200)));
        let svg = picture(&report);
        assert_eq!(svg.matches("stroke-width=\"1.4\"").count(), 2);
        for text in [
            "SCHED_FIFO 80",
            "&lt;A &amp; B&gt;",
            ">CPU 1<",
            ">budget 200 us<",
            ">10\u{2009}000<",
        ] {
            assert!(svg.contains(text), "{text}");
        }
        assert!(!svg.contains("NaN") && !svg.contains("inf"));
    }

    #[test]
    fn many_processors_are_drawn_as_one() {
        let mut report = fixed();
        report.threads = vec![report.threads[0].clone(); SERIES_MAX + 1];
        let svg = picture(&report);
        assert!(svg.contains("all 7 CPUs") && svg.contains("70\u{2009}000"));
    }

    #[test]
    fn the_axis_holds_every_time() {
        let report = fixed();
        let x = time_axis(&report, &series(&report));
        assert!((x.low - 10_000.0).abs() < 1e-6 && (x.high - 200_000.0).abs() < 1e-6);
        assert!((x.at(x.low) - LEFT).abs() < 1e-9 && (x.at(x.high) - RIGHT).abs() < 1e-9);
        let empty = Report::new(String::new());
        assert!(picture(&empty).ends_with("</svg>\n"));
    }
}
