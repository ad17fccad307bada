//! The picture of a plan: positions and velocities of the joints over time. An SVG, so that browsers show it.

use std::path::Path;
use std::time::Duration;

use plotters::prelude::*;
use takt_api::{Arm, Plan};

use crate::output::save;

/// In units of CSS pixels.
const SIZE: (u32, u32) = (900, 560);
/// Points of a curve; more are not distinguishable.
const POINTS: u32 = 450;
/// Colours that are distinguishable with colour blindness, in the order of joints.
const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(230, 159, 0),
    RGBColor(0, 0, 0),
];

type Drawn = Result<(), Box<dyn std::error::Error + Send + Sync>>;

/// Draws the picture.
pub(super) fn draw(path: &Path, arm: &Arm, plan: &Plan) -> anyhow::Result<()> {
    let mut svg = String::new();
    draw_all(SVGBackend::with_string(&mut svg, SIZE), arm, plan)
        .map_err(|error| anyhow::anyhow!("{error}"))?;
    save(path, svg)
}

fn draw_all(backend: SVGBackend<'_>, arm: &Arm, plan: &Plan) -> Drawn {
    let root = backend.into_drawing_area();
    root.fill(&WHITE)?;
    let (above, below) = root.split_vertically(SIZE.1 / 2);
    let name = plan.device();
    let step = plan.duration() / POINTS;
    let times: Vec<Duration> = (0..=POINTS).map(|number| step * number).collect();
    let sampled = |of: &dyn Fn(Duration) -> Vec<f64>| {
        let samples = times.iter().map(|time| (time.as_secs_f64(), of(*time)));
        samples.collect::<Vec<_>>()
    };
    let positions = sampled(&|time| {
        let joints = plan.positions(time).into_iter();
        joints.map(f64::to_degrees).collect()
    });
    let velocities = sampled(&|time| {
        let joints = plan.velocities(time).into_iter();
        let limits = arm.description().joints.iter();
        let shares = joints.zip(limits);
        shares
            .map(|(v, limit)| v / limit.velocity * 100.0)
            .collect()
    });
    curves(
        &above,
        &format!("{name}: planned joint positions"),
        "deg",
        &positions,
    )?;
    curves(
        &below,
        &format!("{name}: planned joint velocities"),
        "% of limit",
        &velocities,
    )?;
    root.present()?;
    Ok(())
}

fn curves(
    area: &DrawingArea<SVGBackend<'_>, plotters::coord::Shift>,
    caption: &str,
    unit: &str,
    samples: &[(f64, Vec<f64>)],
) -> Drawn {
    let values = || {
        samples
            .iter()
            .flat_map(|(_, joints)| joints.iter().copied())
    };
    let (low, high) = (values().fold(0.0, f64::min), values().fold(0.0, f64::max));
    let margin = f64::max((high - low) * 0.05, 0.1);
    let end = samples.last().map_or(0.0, |(time, _)| *time).max(1e-3);
    let mut chart = ChartBuilder::on(area)
        .caption(caption, ("sans-serif", 15))
        .margin(8)
        .x_label_area_size(34)
        .y_label_area_size(56)
        .build_cartesian_2d(0.0..end, low - margin..high + margin)?;
    chart
        .configure_mesh()
        .x_desc("time, s")
        .y_desc(unit)
        .x_label_formatter(&|s| format!("{s:.2}"))
        .y_label_formatter(&|value| format!("{:.1}", (value * 10.0).round() / 10.0 + 0.0))
        .light_line_style(TRANSPARENT)
        .draw()?;
    let joints = samples.first().map_or(0, |(_, joints)| joints.len());
    for (joint, colour) in (0..joints).zip(COLOURS.iter().cycle()) {
        let points = samples.iter();
        let points = points.filter_map(|(time, joints)| Some((*time, *joints.get(joint)?)));
        chart
            .draw_series(LineSeries::new(points, colour.stroke_width(2)))?
            .label(format!("joint {joint}"))
            .legend(|(x, y)| PathElement::new([(x, y), (x + 18, y)], *colour));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .background_style(WHITE.mix(0.7))
        .draw()?;
    Ok(())
}
