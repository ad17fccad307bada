//! Pictures of the examples: curves in a plane, as SVG. Without axes in parts: a grid line at each decimetre.

use std::error::Error;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

const WIDTH: f64 = 640.0;
const MARGIN: f64 = 48.0;
const COLORS: [&str; 4] = ["#c03a2b", "#2b6cb0", "#3a8a4d", "#8a5a9a"];
/// Distance of the grid lines, m.
const GRID: f64 = 0.1;

/// Where an example writes: its first argument, or the directory for temporary files.
pub(crate) fn directory() -> PathBuf {
    std::env::args_os()
        .nth(1)
        .map_or_else(std::env::temp_dir, PathBuf::from)
}

/// A named curve through points, m.
pub(crate) type Curve<'a> = (&'a str, Vec<[f64; 2]>);

/// Draws curves at one scale, both axes in m, and prints where the picture is.
pub(crate) fn draw(path: &Path, title: &str, curves: &[Curve<'_>]) -> Result<(), Box<dyn Error>> {
    let points = || curves.iter().flat_map(|(_, points)| points);
    let range = |axis: fn(&[f64; 2]) -> f64| {
        let values = || points().map(axis).filter(|value| value.is_finite());
        let min = values().fold(f64::INFINITY, f64::min);
        let max = values().fold(f64::NEG_INFINITY, f64::max);
        (min <= max).then_some((min - GRID / 4.0, max + GRID / 4.0))
    };
    let (Some(x), Some(y)) = (range(|[x, _]| *x), range(|[_, y]| *y)) else {
        return Err("there is nothing to draw".into());
    };
    let scale = (WIDTH - 2.0 * MARGIN) / (x.1 - x.0);
    let height = (y.1 - y.0).mul_add(scale, 2.0 * MARGIN);
    let at = |[a, b]: [f64; 2]| {
        [
            MARGIN + (a - x.0) * scale,
            height - MARGIN - (b - y.0) * scale,
        ]
    };
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height:.0}\" \
         font-family=\"sans-serif\" font-size=\"12\">\n<rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n\
         <text x=\"{MARGIN}\" y=\"20\">{title}</text>\n"
    );
    for line in lines(x) {
        let [left, top] = at([line, y.1]);
        let bottom = height - MARGIN;
        writeln!(
            svg,
            "<path d=\"M{left:.1} {top:.1}V{bottom:.1}\" stroke=\"#ddd\"/>"
        )?;
        let below = bottom + 16.0;
        writeln!(
            svg,
            "<text x=\"{left:.1}\" y=\"{below:.1}\" text-anchor=\"middle\">{line:.1} m</text>"
        )?;
    }
    for line in lines(y) {
        let [left, level] = at([x.0, line]);
        let right = WIDTH - MARGIN;
        writeln!(
            svg,
            "<path d=\"M{left:.1} {level:.1}H{right:.1}\" stroke=\"#ddd\"/>"
        )?;
        let before = left - 4.0;
        writeln!(
            svg,
            "<text x=\"{before:.1}\" y=\"{level:.1}\" text-anchor=\"end\">{line:.1} m</text>"
        )?;
    }
    for (number, ((name, points), color)) in curves.iter().zip(COLORS.iter().cycle()).enumerate() {
        let line: Vec<_> = points.iter().map(|point| at(*point)).collect();
        let line: Vec<_> = line.iter().map(|[x, y]| format!("{x:.1},{y:.1}")).collect();
        let line = line.join(" ");
        writeln!(
            svg,
            "<polyline points=\"{line}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"1.5\"/>"
        )?;
        let left = (number as f64).mul_add(130.0, MARGIN);
        writeln!(
            svg,
            "<text x=\"{left}\" y=\"38\" fill=\"{color}\">{name}</text>"
        )?;
    }
    svg.push_str("</svg>\n");
    std::fs::write(path, svg).map_err(|error| format!("{}: {error}", path.display()))?;
    println!("picture: {}", path.display());
    Ok(())
}

/// Multiples of the grid within a range.
fn lines((min, max): (f64, f64)) -> impl Iterator<Item = f64> {
    let first = (min / GRID).ceil();
    (0..200)
        .map(move |number| (first + f64::from(number)) * GRID)
        .take_while(move |line| *line <= max)
}
