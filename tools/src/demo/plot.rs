//! The picture of a demo: joints over time, and how late cycles began. An SVG, so that it is text
//! and needs no viewer of its own.

use std::path::Path;

use plotters::prelude::*;
use takt_rt::stats::Snapshot;

use crate::demo::Samples;
use crate::output::time;

type Drawn = Result<(), Box<dyn std::error::Error + Send + Sync>>;

/// Draws the picture.
pub(super) fn draw(
    path: &Path,
    robots: &[&str],
    samples: &Samples,
    stats: &Snapshot,
) -> anyhow::Result<()> {
    try_draw(path, robots, samples, stats).map_err(|e| anyhow::anyhow!("{e}"))
}

fn try_draw(path: &Path, robots: &[&str], samples: &Samples, stats: &Snapshot) -> Drawn {
    let height = 260 * u32::try_from(robots.len() + 1).unwrap_or(3);
    let root = SVGBackend::new(path, (900, height)).into_drawing_area();
    root.fill(&WHITE)?;
    let areas = root.split_evenly((robots.len() + 1, 1));
    for ((area, robot), joints) in areas.iter().zip(robots).zip(&samples.joints) {
        curves(area, robot, &samples.time_s, joints)?;
    }
    if let Some(area) = areas.last() {
        latencies(area, stats)?;
    }
    root.present()?;
    Ok(())
}

type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;

fn curves(area: &Area<'_>, robot: &str, time_s: &[f64], joints: &[Vec<f64>]) -> Drawn {
    let values = || joints.iter().flatten().copied().filter(|v| v.is_finite());
    let (low, high) = (values().fold(0.0, f64::min), values().fold(0.0, f64::max));
    let end = time_s.last().copied().unwrap_or(1.0);
    let mut chart = ChartBuilder::on(area)
        .caption(
            format!("{robot}: measured joint positions"),
            ("sans-serif", 16),
        )
        .margin(8)
        .x_label_area_size(32)
        .y_label_area_size(48)
        .build_cartesian_2d(0.0..end, low - 0.1..high + 0.1)?;
    chart
        .configure_mesh()
        .x_desc("time, s")
        .y_desc("rad")
        .light_line_style(WHITE)
        .draw()?;
    for (i, (positions, name)) in joints.iter().zip(takt_fri::lwr::JOINT_NAMES).enumerate() {
        let colour = Palette99::pick(i).to_rgba();
        let points = time_s.iter().copied().zip(positions.iter().copied());
        chart
            .draw_series(LineSeries::new(
                points.filter(|(_, p)| p.is_finite()),
                colour,
            ))?
            .label(name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 14, y)], colour));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .background_style(WHITE.mix(0.8))
        .draw()?;
    Ok(())
}

/// Latencies from 1 us to 100 ms; what is shorter or longer stands at the edge.
const EDGES_US: (f64, f64) = (1.0, 100_000.0);

fn latencies(area: &Area<'_>, stats: &Snapshot) -> Drawn {
    #[expect(clippy::cast_precision_loss, reason = "a picture")]
    let bars: Vec<(f64, f64)> = stats
        .latency_buckets()
        .map(|(bound, count)| (bound.0 as f64 / 1e3, count as f64))
        .collect();
    let most = bars.iter().map(|(_, count)| *count).fold(1.0, f64::max);
    let caption = format!(
        "latency of the 1 ms cycle: {} cycles, {} overruns, p50 {}, p99 {}, max {}",
        stats.cycles,
        stats.overruns,
        time(stats.latency.p50.0),
        time(stats.latency.p99.0),
        time(stats.latency.max.0)
    );
    let mut chart = ChartBuilder::on(area)
        .caption(caption, ("sans-serif", 16))
        .margin(8)
        .x_label_area_size(32)
        .y_label_area_size(48)
        .build_cartesian_2d(
            (EDGES_US.0..EDGES_US.1).log_scale(),
            (0.5..most * 2.0).log_scale(),
        )?;
    chart
        .configure_mesh()
        .x_desc("latency, us")
        .y_desc("cycles")
        .light_line_style(WHITE)
        .draw()?;
    let clip = |us: f64| us.clamp(EDGES_US.0, EDGES_US.1);
    // Buckets of the histogram are about 1.6 % wide.
    chart.draw_series(bars.into_iter().map(|(us, count)| {
        Rectangle::new([(clip(us / 1.016), 0.5), (clip(us), count)], BLUE.filled())
    }))?;
    Ok(())
}
