//! The picture of a demo: joints over time, and how late cycles began. An SVG, so that browsers show it.

use std::path::Path;

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use takt_rt::stats::Snapshot;

use super::cell::Arm;
use crate::demo::samples::Samples;
use crate::output::{save, time};

pub(super) type Drawn = Result<(), Box<dyn std::error::Error + Send + Sync>>;
pub(super) type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;

/// Width of the picture and height of each of its parts, in units of CSS pixels.
const SIZE: (u32, u32) = (900, 260);
/// The library draws on whole numbers, which makes steps of slow curves: so they are fractions of
/// a pixel.
pub(super) const SCALE: u32 = 8;
/// From the line of a legend's entry to its text.
const LEGEND_TEXT: u32 = 24;
/// Points of a curve; more are not distinguishable.
pub(super) const POINTS_MAX: usize = 900;

/// Colours that are distinguishable with colour blindness, in the order of joints.
pub(crate) const COLOURS: [RGBColor; takt_fri::lwr::AXES] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(230, 159, 0),
    RGBColor(0, 0, 0),
];

/// Draws the picture.
pub(super) fn draw(
    path: &Path,
    arms: &[Arm],
    samples: &Samples,
    stats: &Snapshot,
) -> anyhow::Result<()> {
    let parts = u32::try_from(arms.len() + 1).unwrap_or(1);
    let (width, height) = (SIZE.0, SIZE.1 * parts);
    let (fine_width, fine_height) = (width * SCALE, height * SCALE);
    let mut svg = String::new();
    draw_parts(
        SVGBackend::with_string(&mut svg, (fine_width, fine_height)),
        arms,
        samples,
        stats,
    )
    .map_err(|e| anyhow::anyhow!("{e}"))?;
    let fine = format!("width=\"{fine_width}\" height=\"{fine_height}\"");
    let shown = format!("width=\"{width}\" height=\"{height}\"");
    save(path, svg.replacen(&fine, &shown, 1))
}

fn draw_parts(backend: SVGBackend<'_>, arms: &[Arm], samples: &Samples, stats: &Snapshot) -> Drawn {
    let root = backend.into_drawing_area();
    root.fill(&WHITE)?;
    let areas = root.split_evenly((arms.len() + 1, 1));
    for ((area, arm), joints) in areas.iter().zip(arms).zip(&samples.joints) {
        curves(area, *arm, &samples.time_s, joints, legend_width(arms))?;
    }
    if let Some(area) = areas.last() {
        latencies(area, stats, legend_width(arms))?;
    }
    root.present()?;
    Ok(())
}

pub(super) fn font(size: u32) -> TextStyle<'static> {
    ("sans-serif", size * SCALE).into_font().color(&BLACK)
}

/// Width of the legend, in which the longest name of a joint fits; all parts have the same, so that their curves line up.
fn legend_width(arms: &[Arm]) -> u32 {
    let names = arms.iter().flat_map(|arm| arm.joints);
    let longest = names.map(|name| name.chars().count()).max().unwrap_or(0);
    let characters = u32::try_from(longest).unwrap_or(0);
    (LEGEND_TEXT + 7 * characters + 16).max(64)
}

pub(super) fn chart<'a, 'b>(
    area: &'a Area<'b>,
    caption: &str,
    legend: u32,
) -> ChartBuilder<'a, 'b, SVGBackend<'b>> {
    let mut chart = ChartBuilder::on(area);
    chart
        .caption(caption, font(15))
        .margin(8 * SCALE)
        .margin_right(legend * SCALE)
        .x_label_area_size(34 * SCALE)
        .y_label_area_size(56 * SCALE);
    chart
}

fn curves(area: &Area<'_>, arm: Arm, time_s: &[f64], joints: &[Vec<f64>], width: u32) -> Drawn {
    let values = || joints.iter().flatten().copied().filter(|v| v.is_finite());
    let (low, high) = (values().fold(0.0, f64::min), values().fold(0.0, f64::max));
    let end = time_s.last().copied().unwrap_or(1.0);
    let mut chart = chart(
        area,
        &format!("{}: measured joint positions", arm.name),
        width,
    )
    .build_cartesian_2d(0.0..end, low - 0.1..high + 0.1)?;
    chart
        .configure_mesh()
        .x_desc("time, s")
        .y_desc("position, rad")
        .axis_desc_style(font(12))
        .label_style(font(11))
        .x_label_formatter(&|s| format!("{s:.1}"))
        // The negative zero of the library's ticks becomes a plain one.
        .y_label_formatter(&|rad| format!("{:.2}", (rad * 100.0).round() / 100.0 + 0.0))
        .set_all_tick_mark_size(4 * SCALE)
        .y_labels(7)
        .light_line_style(TRANSPARENT)
        .bold_line_style(BLACK.mix(0.12).stroke_width(SCALE))
        .axis_style(BLACK.stroke_width(SCALE))
        .draw()?;
    let every = time_s.len().div_ceil(POINTS_MAX).max(1);
    for (number, (positions, name)) in joints.iter().zip(arm.joints).enumerate() {
        let line = COLOURS[number % COLOURS.len()].stroke_width(SCALE * 3 / 2);
        let points = time_s.iter().copied().zip(positions.iter().copied());
        let points = points.filter(|(_, p)| p.is_finite()).step_by(every);
        chart.draw_series(LineSeries::new(points, line))?;
        legend(area, width, number, name, line)?;
    }
    Ok(())
}

/// An entry of the legend, right of the curves.
fn legend(area: &Area<'_>, width: u32, number: usize, name: &str, line: ShapeStyle) -> Drawn {
    let pixels = |n: u32| i32::try_from(n * SCALE).unwrap_or(0);
    let row = u32::try_from(number).unwrap_or(0);
    let (x, y) = (pixels(SIZE.0 - width + 10), pixels(44 + 20 * row));
    let text = font(12).pos(Pos::new(HPos::Left, VPos::Center));
    area.draw(&PathElement::new([(x, y), (x + pixels(18), y)], line))?;
    area.draw(&Text::new(
        name.to_owned(),
        (x + pixels(LEGEND_TEXT), y),
        text,
    ))?;
    Ok(())
}

/// Latencies from 1 us to 100 ms; shorter and longer ones are counted in the first and last bar.
const EDGES_US: (f64, f64) = (1.0, 100_000.0);
/// Bars for each decade of latency.
const BARS_PER_DECADE: f64 = 20.0;
/// Bars over all decades.
const BARS: usize = 100;

fn latencies(area: &Area<'_>, stats: &Snapshot, width: u32) -> Drawn {
    let bars = bars(stats);
    let most = bars.iter().copied().fold(1.0, f64::max);
    let caption = format!(
        "latency of the 1 ms cycle: {} cycles, {} overruns, p50 {}, p99 {}, max {}",
        stats.cycles,
        stats.overruns,
        time(stats.latency.p50.0),
        time(stats.latency.p99.0),
        time(stats.latency.max.0)
    );
    let mut chart = chart(area, &caption, width).build_cartesian_2d(
        (EDGES_US.0..EDGES_US.1).log_scale(),
        (0.5..most * 2.0).log_scale(),
    )?;
    chart
        .configure_mesh()
        .x_desc("latency, us")
        .y_desc("cycles")
        .axis_desc_style(font(12))
        .label_style(font(11))
        .x_label_formatter(&|us| format!("{us:.0}"))
        .y_label_formatter(&|count| format!("{count:.0}"))
        .set_all_tick_mark_size(4 * SCALE)
        .light_line_style(TRANSPARENT)
        .bold_line_style(BLACK.mix(0.12).stroke_width(SCALE))
        .axis_style(BLACK.stroke_width(SCALE))
        .draw()?;
    let mut left = EDGES_US.0;
    for count in bars {
        let right = left * 10_f64.powf(1.0 / BARS_PER_DECADE);
        if count > 0.0 {
            let bar = Rectangle::new([(left, 0.5), (right, count)], COLOURS[0].filled());
            chart.draw_series([bar])?;
        }
        left = right;
    }
    Ok(())
}

/// Cycles by bar.
#[expect(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a picture; clamped"
)]
fn bars(stats: &Snapshot) -> [f64; BARS] {
    let mut bars = [0.0; BARS];
    for (bound, count) in stats.latency_buckets() {
        let us = (bound.0 as f64 / 1e3).clamp(EDGES_US.0, EDGES_US.1);
        let bar = (us.log10() * BARS_PER_DECADE) as usize;
        bars[bar.min(BARS - 1)] += count as f64;
    }
    bars
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::demo::cell::Kind;

    #[test]
    fn legend_fits_longest_joint_name() {
        let arms = Kind::Factory.moved();
        let (mut svg, parts) = (String::new(), u32::try_from(arms.len()).unwrap() + 1);
        let backend = SVGBackend::with_string(&mut svg, (SIZE.0 * SCALE, SIZE.1 * parts * SCALE));
        let (_, stats) = takt_rt::stats::pair();
        draw_parts(backend, arms, &Samples::of(arms), &stats.snapshot()).unwrap();
        for name in arms.iter().flat_map(|arm| arm.joints) {
            let (before, _) = svg.split_once(&format!("\n{name}\n")).unwrap();
            let element = before.rsplit_once("<text x=\"").unwrap().1;
            let x: u32 = element.split('"').next().unwrap().parse().unwrap();
            // Letters of 12 pixels are 7 wide on average.
            let end = x / SCALE + 7 * u32::try_from(name.len()).unwrap();
            assert!(end <= SIZE.0, "{name} ends at {end}");
        }
    }
}
