//! A picture of the samples: one plot for each unit, over the same time. SVG, so that browsers show it.

use plotters::coord::Shift;
use plotters::prelude::*;

use crate::demo::plot::COLOURS;

use super::store::{Curve, Store, thinned};

/// Width of the picture, and height of a plot, in CSS pixels.
const SIZE: (u32, u32) = (1000, 260);
/// Most points of a curve.
const POINTS_MAX: usize = 2_000;

type Drawn = Result<(), Box<dyn std::error::Error>>;
type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// Curves by unit, in the order of the first of each.
pub(super) fn by_unit(curves: &[Curve]) -> Vec<(String, Vec<&Curve>)> {
    let mut plots: Vec<(String, Vec<&Curve>)> = Vec::new();
    for curve in curves {
        match plots.iter_mut().find(|(unit, _)| *unit == curve.unit) {
            Some((_, plot)) => plot.push(curve),
            None => plots.push((curve.unit.clone(), vec![curve])),
        }
    }
    plots
}

/// The picture of what is in the store.
pub(super) fn svg(store: &Store) -> anyhow::Result<String> {
    let plots = by_unit(&store.curves);
    let count = u32::try_from(plots.len().max(1))?;
    let mut svg = String::new();
    draw(
        &SVGBackend::with_string(&mut svg, (SIZE.0, SIZE.1.saturating_mul(count)))
            .into_drawing_area(),
        store,
        &plots,
    )
    .map_err(|why| anyhow::anyhow!("{why}"))?;
    Ok(svg)
}

fn draw(area: &Area<'_>, store: &Store, plots: &[(String, Vec<&Curve>)]) -> Drawn {
    area.fill(&WHITE)?;
    for ((unit, curves), part) in plots.iter().zip(area.split_evenly((plots.len().max(1), 1))) {
        plot(&part, store, unit, curves)?;
    }
    area.present()?;
    Ok(())
}

fn plot(area: &Area<'_>, store: &Store, unit: &str, curves: &[&Curve]) -> Drawn {
    let (from, to) = store.span();
    // The time of a capture begins at its trigger.
    let zero = store.trigger.as_ref().map_or(from, |it| it.time_s);
    let pieces: Vec<_> = curves
        .iter()
        .map(|curve| store.pieces(curve, from, to))
        .collect();
    let values = pieces.iter().flatten().flatten().map(|(_, value)| *value);
    let (low, high) = bounds(values);
    let mut chart = ChartBuilder::on(area)
        .margin(8)
        .x_label_area_size(32)
        .y_label_area_size(64)
        .build_cartesian_2d(
            (from - zero)..(to - zero).max(from - zero + 1e-3),
            low..high,
        )?;
    let unit = if unit.is_empty() { "-" } else { unit };
    chart
        .configure_mesh()
        .x_desc("time, s")
        .y_desc(unit)
        .light_line_style(TRANSPARENT)
        .bold_line_style(BLACK.mix(0.12))
        .y_label_formatter(&|value| format!("{value:.4}"))
        .draw()?;
    if store.trigger.is_some() {
        chart.draw_series(LineSeries::new([(0.0, low), (0.0, high)], BLACK.mix(0.5)))?;
    }
    for ((curve, pieces), colour) in curves.iter().zip(pieces).zip(COLOURS.into_iter().cycle()) {
        for (number, piece) in pieces.iter().enumerate() {
            let points = thinned(piece, POINTS_MAX);
            let points = points.into_iter().map(|(time, value)| (time - zero, value));
            let drawn = chart.draw_series(LineSeries::new(points, colour))?;
            if number == 0 {
                drawn
                    .label(curve.name.as_str())
                    .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], colour));
            }
        }
    }
    chart
        .configure_series_labels()
        .background_style(WHITE.mix(0.8))
        .border_style(BLACK.mix(0.2))
        .draw()?;
    Ok(())
}

/// A range that shows all these values, with a margin.
pub(super) fn bounds(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
        (low.min(value), high.max(value))
    });
    if low > high {
        return (-1.0, 1.0);
    }
    let size = low.abs().max(high.abs());
    let margin = if low < high {
        (high - low) * 0.05
    } else {
        (size * 0.05).max(1e-3)
    };
    (low - margin, high + margin)
}

#[cfg(test)]
mod tests {
    use super::super::store::tests::setup;
    use super::super::wire::{Event, Frame, Triggered};
    use super::*;

    #[test]
    fn svg_has_a_plot_for_each_unit() {
        let mut store = Store::default();
        let probes = [("left.a", "rad"), ("left.b", "rad"), ("left.<f>", "N")];
        store.handle(&Event::Setup(setup(&[&probes])));
        let (time_s, cause) = (1.5, "above".to_owned());
        store.handle(&Event::Triggered(Triggered { time_s, cause }));
        let rows = [1.0, 0.0, 1.0, f64::NAN, 2.0, 0.5, 1.0, 20.0];
        store.handle(&Event::Frame(Frame::of(0, 3, &rows)));
        let svg = svg(&store).unwrap();
        assert!(svg.contains("height=\"520\""), "{svg}");
        for part in [
            "left.a",
            "left.b",
            "left.&lt;f&gt;",
            "time, s",
            "rad",
            ">\nN\n<",
        ] {
            assert!(svg.contains(part), "{part}\n{svg}");
        }
        // Nothing to show is no error.
        assert!(super::svg(&Store::default()).is_ok());
    }
}
