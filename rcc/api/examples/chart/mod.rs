//! Pictures of the examples: curves in a plane, as SVG.

use std::error::Error;
use std::path::{Path, PathBuf};

use takt_api::picture::Chart;

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
    let chart = Chart::new(title, "m", "m").to_scale();
    let chart = curves.iter().fold(chart, |chart, (name, points)| {
        chart.curve(name, points.iter().copied())
    });
    std::fs::write(path, chart.svg()).map_err(|error| format!("{}: {error}", path.display()))?;
    println!("picture: {}", path.display());
    Ok(())
}
