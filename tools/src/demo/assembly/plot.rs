//! The picture of an assembly: forces, distances and torque over time, with the steps of the program as bands. From the truth of the
//! world; what the robots measure has noise and delay. An SVG, so that browsers show it.

use std::path::Path;

use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use takt_embedded::{Moment, Record};

use crate::demo::plot::{Area, COLOURS, Drawn, SCALE, chart, font};
use crate::output::save;

type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// Size of the picture, in CSS pixels, and height of its first part.
const SIZE: (u32, u32) = (1000, 800);
const FIRST: u32 = 290;
/// Points of a curve; peaks are kept.
const POINTS_MAX: usize = 1500;
/// Backgrounds of steps, in turns.
const BANDS: [RGBColor; 2] = [RGBColor(232, 240, 248), RGBColor(250, 250, 244)];
/// Widest character of a name, as a part of the size of its font.
const CHARACTER: f64 = 0.55;

/// Width of an entry of the legend.
const ENTRY: u32 = 112;

/// A step of the program in the picture, s on the clock of the world.
#[derive(Debug)]
pub(super) struct Span {
    pub(super) name: &'static str,
    pub(super) from_s: f64,
    pub(super) to_s: f64,
}

/// A curve: its name, and its value at a moment.
type Curve = (&'static str, fn(&Moment) -> f64);

/// A part of the picture.
struct Panel {
    caption: &'static str,
    unit: &'static str,
    curves: &'static [Curve],
    /// What has to be seen at least.
    range: [f64; 2],
    /// A limit, drawn as a line.
    limits: &'static [f64],
}

const PANELS: [Panel; 3] = [
    Panel {
        caption: "Forces",
        unit: "N",
        curves: &[
            ("left arm", |it| it.flanges_n[0]),
            ("right arm", |it| it.flanges_n[1]),
            ("in the box", |it| it.internal_n.abs()),
            ("on the peg", |it| it.peg_n),
        ],
        range: [0.0, 27.0],
        limits: &[15.0, 25.0],
    },
    Panel {
        caption: "Distance of the hands on a box",
        unit: "mm",
        curves: &[("since the grasp", |it| it.grasp_mm)],
        range: [-0.25, 0.25],
        limits: &[-0.2, 0.2],
    },
    Panel {
        caption: "Peg and screw",
        unit: "mm, 0.1 Nm",
        curves: &[
            ("depth, mm", |it| it.depth_mm),
            ("torque, 0.1 Nm", |it| it.torque_nm * 10.0),
        ],
        range: [0.0, 32.0],
        limits: &[],
    },
];

/// Draws the picture.
pub(super) fn draw(path: &Path, seen: &Record, spans: &[Span]) -> anyhow::Result<()> {
    let (width, height) = (SIZE.0 * SCALE, SIZE.1 * SCALE);
    let mut svg = String::new();
    let backend = SVGBackend::with_string(&mut svg, (width, height));
    draw_all(backend, &seen.moments, spans).map_err(|e| anyhow::anyhow!("{e}"))?;
    let fine = format!("width=\"{width}\" height=\"{height}\"");
    let shown = format!("width=\"{}\" height=\"{}\"", SIZE.0, SIZE.1);
    save(path, svg.replacen(&fine, &shown, 1))
}

fn draw_all(backend: SVGBackend<'_>, moments: &[Moment], spans: &[Span]) -> Drawn {
    let root = backend.into_drawing_area();
    root.fill(&WHITE)?;
    let begin = moments.first().map_or(0.0, |moment| moment.at_s);
    let begin = spans.first().map_or(begin, |span| span.from_s);
    let end = moments.last().map_or(1.0, |moment| moment.at_s - begin);
    let (first, rest) = root.split_vertically(FIRST * SCALE);
    let rest = rest.split_evenly((2, 1));
    for (number, (area, panel)) in [first].iter().chain(&rest).zip(&PANELS).enumerate() {
        draw_panel(
            area,
            panel,
            moments,
            spans,
            (begin, end.max(1.0)),
            number == 0,
        )?;
    }
    root.present()?;
    Ok(())
}

fn draw_panel(
    area: &Area<'_>,
    panel: &Panel,
    moments: &[Moment],
    spans: &[Span],
    (begin, end): (f64, f64),
    has_names: bool,
) -> Drawn {
    let values = || {
        let of = |curve: &Curve| moments.iter().map(curve.1).collect::<Vec<_>>();
        panel.curves.iter().flat_map(of).filter(|it| it.is_finite())
    };
    let [low, high] = panel.range;
    let (low, high) = (values().fold(low, f64::min), values().fold(high, f64::max));
    let margin = (high - low) * 0.06;
    let low = if low < 0.0 { low - margin } else { low };
    // Room for the names of steps, and for the legend.
    let high = high + margin + if has_names { (high - low) * 0.3 } else { 0.0 };
    let mut chart = chart(area, panel.caption, 16).build_cartesian_2d(0.0..end, low..high)?;
    for (number, span) in spans.iter().enumerate() {
        let corners = [(span.from_s - begin, low), (span.to_s - begin, high)];
        let colour = BANDS[number % BANDS.len()].filled();
        chart.draw_series([Rectangle::new(corners, colour)])?;
    }
    chart
        .configure_mesh()
        .x_desc("time, s")
        .y_desc(panel.unit)
        .axis_desc_style(font(12))
        .label_style(font(11))
        .x_label_formatter(&|s| format!("{s:.0}"))
        .y_label_formatter(&|value| label(*value))
        .set_all_tick_mark_size(4 * SCALE)
        .x_labels(14)
        .y_labels(8)
        .light_line_style(TRANSPARENT)
        .bold_line_style(BLACK.mix(0.10).stroke_width(SCALE))
        .axis_style(BLACK.stroke_width(SCALE))
        .draw()?;
    for limit in panel.limits {
        let line = COLOURS[1].mix(0.5).stroke_width(SCALE / 2);
        chart.draw_series([PathElement::new([(0.0, *limit), (end, *limit)], line)])?;
    }
    for (number, (name, value)) in panel.curves.iter().enumerate() {
        let line = COLOURS[number * 2].stroke_width(SCALE * 3 / 2);
        for run in runs(moments, *value) {
            let points = run.into_iter().map(|(at, value)| (at - begin, value));
            chart.draw_series(LineSeries::new(points, line))?;
        }
        legend(area, panel.curves.len() - number, name, line)?;
    }
    if has_names {
        for span in spans {
            let middle = f64::midpoint(span.from_s, span.to_s) - begin;
            let width = (span.to_s - span.from_s) / end;
            write_name(&mut chart, span.name, (middle, high - margin * 0.5), width)?;
        }
    }
    Ok(())
}

/// A tick without the negative zero of the library.
fn label(value: f64) -> String {
    let text = format!("{:.2}", (value * 100.0).round() / 100.0 + 0.0);
    let text = text.trim_end_matches('0').trim_end_matches('.');
    text.to_owned()
}

/// Parts of a curve without gaps. Of several samples for one point the one of the largest magnitude is kept.
fn runs(moments: &[Moment], value: fn(&Moment) -> f64) -> Vec<Vec<(f64, f64)>> {
    let every = moments.len().div_ceil(POINTS_MAX).max(1);
    let peak = |chunk: &[Moment]| {
        let known = chunk.iter().map(|it| (it.at_s, value(it)));
        let known = known.filter(|(_, value)| value.is_finite());
        known.max_by(|(_, a), (_, b)| a.abs().total_cmp(&b.abs()))
    };
    let points: Vec<_> = moments.chunks(every).map(peak).collect();
    let runs = points.split(Option::is_none);
    let runs = runs.map(|run| run.iter().flatten().copied().collect::<Vec<_>>());
    runs.filter(|run| run.len() > 1).collect()
}

/// An entry of the legend, in the row of the caption; the last one has place 1, on the right.
fn legend(area: &Area<'_>, place: usize, name: &str, line: ShapeStyle) -> Drawn {
    let pixels = |n: u32| i32::try_from(n * SCALE).unwrap_or(0);
    let place = u32::try_from(place).unwrap_or(0);
    let (x, y) = (pixels(SIZE.0 - 16 - ENTRY * place), pixels(12));
    area.draw(&PathElement::new([(x, y), (x + pixels(18), y)], line))?;
    let text = font(11).pos(Pos::new(HPos::Left, VPos::Center));
    area.draw(&Text::new(name.to_owned(), (x + pixels(24), y), text))?;
    Ok(())
}

/// The name of a step below the top of its band; upright where it is too narrow.
fn write_name(chart: &mut Chart<'_, '_>, name: &str, at: (f64, f64), width: f64) -> Drawn {
    let letters = name.chars().fold(0.0, |sum, _| sum + CHARACTER * 12.0);
    let style = if width * f64::from(SIZE.0 - 90) >= letters {
        font(12).pos(Pos::new(HPos::Center, VPos::Top))
    } else {
        let upright = FontTransform::Rotate270;
        font(11)
            .transform(upright)
            .pos(Pos::new(HPos::Right, VPos::Center))
    };
    chart.draw_series([Text::new(name.to_owned(), at, style)])?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curve_with_gap_is_drawn_in_two_runs() {
        let values = [0.0, 1.0, f64::NAN, 3.0, 2.0, f64::NAN];
        let moment = |(at, depth_mm)| Moment {
            at_s: at,
            depth_mm,
            ..Moment::default()
        };
        let moments: Vec<_> = (0..).map(f64::from).zip(values).map(moment).collect();
        let expected = [vec![(0.0, 0.0), (1.0, 1.0)], vec![(3.0, 3.0), (4.0, 2.0)]];
        assert_eq!(runs(&moments, |it| it.depth_mm), expected);
    }

    #[test]
    fn tick_label_has_no_negative_zero() {
        assert_eq!([-0.0, 0.25, 10.0].map(label), ["0", "0.25", "10"]);
    }
}
