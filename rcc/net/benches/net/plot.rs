//! The cost of an addition by the size of the net, as an SVG: text that needs no special viewer. It
//! measures nothing.

use std::error::Error;
use std::path::Path;

use plotters::prelude::*;

use crate::{Cost, quantiles::as_f64};

/// Width and height, in CSS pixels.
const SIZE: (u32, u32) = (800, 320);
/// Colours that people with colour vision deficiency can distinguish.
const OURS: RGBColor = RGBColor(0, 114, 178);
const FLOOR: RGBColor = RGBColor(213, 94, 0);

type Figure = fn(&Cost) -> f64;

/// Draws the picture into a file.
pub(crate) fn draw(path: &Path, costs: &[Cost]) -> Result<(), Box<dyn Error>> {
    let ns_max = costs.iter().map(|c| c.ours_ns).fold(0.0, f64::max);
    let sizes = costs.iter().map(|c| as_f64(c.additions));
    let (least, most) = (
        sizes.clone().fold(f64::MAX, f64::min),
        sizes.fold(1.0, f64::max),
    );
    let root = SVGBackend::new(path, SIZE).into_drawing_area();
    root.fill(&WHITE)?;
    let mut chart = ChartBuilder::on(&root)
        .caption(
            "Chain of additions, back to back: time of one",
            ("sans-serif", 15),
        )
        .margin(12)
        .margin_right(28)
        .x_label_area_size(40)
        .y_label_area_size(48)
        .build_cartesian_2d((least..most).log_scale(), 0.0..ns_max * 1.1)?;
    chart
        .configure_mesh()
        .x_desc("additions in the net")
        .y_desc("ns")
        .x_label_formatter(&|size| format!("{size:.0}"))
        .y_label_formatter(&|ns| format!("{ns:.1}"))
        .y_labels(7)
        .light_line_style(TRANSPARENT)
        .bold_line_style(BLACK.mix(0.12))
        .draw()?;
    let series: [(&str, RGBColor, Figure); 2] = [
        ("net, with its clock reads", OURS, |cost| cost.ours_ns),
        ("bare floor", FLOOR, |cost| cost.floor_ns),
    ];
    for (name, colour, ns) in series {
        let points = costs.iter().map(|c| (as_f64(c.additions), ns(c)));
        let line = LineSeries::new(points, colour.stroke_width(2)).point_size(3);
        let key = move |(x, y)| PathElement::new([(x, y), (x + 16, y)], colour.stroke_width(2));
        chart.draw_series(line)?.label(name).legend(key);
    }
    chart
        .configure_series_labels()
        .background_style(WHITE)
        .label_font(("sans-serif", 12))
        .draw()?;
    root.present()?;
    Ok(())
}
