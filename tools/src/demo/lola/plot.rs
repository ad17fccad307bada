//! The picture: the joints over time, with the states of the machine as bands and the parts of homing between. An SVG, so that
//! browsers show it.

use std::path::Path;

use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::trace::{Span, Trace};
use crate::demo::cell::AXES;
use crate::demo::plot::{Area, COLOURS, Drawn, POINTS_MAX, SCALE, chart, font};
use crate::demo::samples::Samples;
use crate::output::save;

type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// Size of the picture, in CSS pixels.
const SIZE: (u32, u32) = (1000, 480);
/// Height of the rows of names above the curves, in degrees of the scale of positions.
const ROW: f64 = 14.0;
/// Seconds left of the start, where the name of a short first state has its place.
const BEFORE_S: f64 = 1.0;
/// Backgrounds of states, in turns.
const BANDS: [RGBColor; 2] = [RGBColor(232, 240, 248), RGBColor(250, 250, 244)];
/// Degrees between two lines of the grid.
const GRID: f64 = 30.0;
/// Widest character of a name, as a part of the size of its font.
const CHARACTER: f64 = 0.58;

/// Draws the picture.
pub(crate) fn draw(path: &Path, samples: &Samples, trace: &Trace) -> anyhow::Result<()> {
    let (width, height) = (SIZE.0 * SCALE, SIZE.1 * SCALE);
    let mut svg = String::new();
    draw_all(
        SVGBackend::with_string(&mut svg, (width, height)),
        samples,
        trace,
    )
    .map_err(|e| anyhow::anyhow!("{e}"))?;
    let fine = format!("width=\"{width}\" height=\"{height}\"");
    let shown = format!("width=\"{}\" height=\"{}\"", SIZE.0, SIZE.1);
    save(path, svg.replacen(&fine, &shown, 1))
}

fn draw_all(backend: SVGBackend<'_>, samples: &Samples, trace: &Trace) -> Drawn {
    let area = backend.into_drawing_area();
    area.fill(&WHITE)?;
    let joints = samples.joints.first().map_or(&[][..], Vec::as_slice);
    let degrees: Vec<Vec<f64>> = joints
        .iter()
        .map(|joint| joint.iter().map(|angle| angle.to_degrees()).collect())
        .collect();
    let values = || degrees.iter().flatten().copied().filter(|v| v.is_finite());
    let low = (values().fold(0.0, f64::min) / GRID).floor() * GRID;
    let high = (values().fold(0.0, f64::max) / GRID).ceil() * GRID;
    let end = samples.time_s.last().copied().unwrap_or(1.0).max(1.0);
    let top = high + 2.0 * ROW;
    let mut chart = chart(
        &area,
        "Joint positions from the encoders through the states of the machine",
        20,
    )
    .build_cartesian_2d(-BEFORE_S..end, low..top)?;
    for (number, span) in trace.states.iter().enumerate() {
        band(&mut chart, span, [low, top], BANDS[number % BANDS.len()])?;
    }
    chart
        .configure_mesh()
        .x_desc("time, s")
        .y_desc("position, degrees")
        .axis_desc_style(font(13))
        .label_style(font(12))
        .x_label_formatter(&|s| format!("{s:.0}"))
        .y_label_formatter(&|degrees| format!("{:.0}", degrees + 0.0))
        .set_all_tick_mark_size(4 * SCALE)
        .y_labels(12)
        .x_labels(12)
        .light_line_style(TRANSPARENT)
        .bold_line_style(BLACK.mix(0.10).stroke_width(SCALE))
        .axis_style(BLACK.stroke_width(SCALE))
        .draw()?;
    for span in &trace.parts {
        rule(&mut chart, span.from_s, [low, high + ROW])?;
        rule(&mut chart, span.to_s, [low, high + ROW])?;
    }
    curves(&mut chart, &samples.time_s, &degrees)?;
    for (spans, height, size) in [
        (&trace.states, high + 1.5 * ROW, 13),
        (&trace.parts, high + 0.5 * ROW, 11),
    ] {
        for span in spans {
            name(&mut chart, span, height, size, end)?;
        }
    }
    if let Some(last) = trace.parts.last() {
        let text = font(11).pos(Pos::new(HPos::Left, VPos::Center));
        let at = (last.to_s + 0.2, low + 0.5 * ROW);
        chart.draw_series([Text::new("encoders are reset", at, text)])?;
    }
    legend(&area)?;
    area.present()?;
    Ok(())
}

fn band(chart: &mut Chart<'_, '_>, span: &Span, [low, top]: [f64; 2], colour: RGBColor) -> Drawn {
    let area = [(span.from_s, low), (span.to_s, top)];
    chart.draw_series([Rectangle::new(area, colour.filled())])?;
    Ok(())
}

/// A thin line upwards.
fn rule(chart: &mut Chart<'_, '_>, at_s: f64, [low, top]: [f64; 2]) -> Drawn {
    let line = BLACK.mix(0.25).stroke_width(SCALE / 2);
    chart.draw_series([PathElement::new([(at_s, low), (at_s, top)], line)])?;
    Ok(())
}

fn curves(chart: &mut Chart<'_, '_>, time_s: &[f64], joints: &[Vec<f64>]) -> Drawn {
    let every = time_s.len().div_ceil(2 * POINTS_MAX).max(1);
    for (number, positions) in joints.iter().enumerate() {
        let line = COLOURS[number % COLOURS.len()].stroke_width(SCALE * 2);
        let points = time_s.iter().copied().zip(positions.iter().copied());
        let points = points.filter(|(_, p)| p.is_finite()).step_by(every);
        chart.draw_series(LineSeries::new(points, line))?;
    }
    Ok(())
}

/// Words of a name of a state: `CalibrateOffsets` is `Calibrate Offsets`.
fn words(name: &str) -> String {
    let mut text = String::new();
    for character in name.chars() {
        if character.is_uppercase() && !text.is_empty() && !text.ends_with(' ') {
            text.push(' ');
        }
        text.push(character);
    }
    text
}

/// The name of a span in its middle; upwards where it is too short for its name.
fn name(chart: &mut Chart<'_, '_>, span: &Span, height: f64, size: u32, end: f64) -> Drawn {
    let text = words(&span.name);
    let pixels = (span.to_s - span.from_s) / end * f64::from(SIZE.0 - 90);
    let needed = text
        .chars()
        .fold(0.0, |width, _| width + CHARACTER * f64::from(size));
    let middle = f64::midpoint(span.from_s, span.to_s);
    let pos = Pos::new(HPos::Center, VPos::Center);
    let style = if pixels >= needed {
        font(size).pos(pos)
    } else {
        let upright = FontTransform::Rotate270;
        font(size - 1)
            .transform(upright)
            .pos(Pos::new(HPos::Right, VPos::Center))
    };
    let height = if pixels >= needed {
        height
    } else {
        height + 0.5 * ROW
    };
    chart.draw_series([Text::new(text, (middle, height), style)])?;
    Ok(())
}

fn legend(area: &Area<'_>) -> Drawn {
    let pixels = |n: u32| i32::try_from(n * SCALE).unwrap_or(0);
    for number in 0..AXES.len() {
        let row = u32::try_from(number).unwrap_or(0);
        let (x, y) = (pixels(SIZE.0 - 300 + 95 * row), pixels(SIZE.1 - 14));
        let line = COLOURS[number % COLOURS.len()].stroke_width(SCALE * 2);
        area.draw(&PathElement::new([(x, y), (x + pixels(20), y)], line))?;
        let text = font(12).pos(Pos::new(HPos::Left, VPos::Center));
        area.draw(&Text::new(
            format!("joint {}", number + 1),
            (x + pixels(26), y),
            text,
        ))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn state_name_is_drawn_in_words() {
        assert_eq!(words("CalibrateOffsets"), "Calibrate Offsets");
        assert_eq!(words("to the sensors"), "to the sensors");
    }
}
