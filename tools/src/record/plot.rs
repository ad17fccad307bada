//! `takt record plot`: values of a recording over time as a picture, drawn as `takt scope` does.

use std::path::Path;

use takt_core::record::numbers;

use super::csv::matches;
use crate::Verdict;
use crate::output::{save, say};
use crate::scope::Picture;

/// Maximum number of values in a picture.
const CURVES_MAX: usize = 32;

pub(super) fn run(file: &Path, patterns: &[String], svg: &Path) -> anyhow::Result<Verdict> {
    let is_wanted = |name: &str| patterns.iter().any(|pattern| matches(pattern, name));
    let mut picture = Picture::default();
    let (mut begin, mut excess) = (None, 0_usize);
    numbers(file, |time, found| {
        let begin = *begin.get_or_insert(time);
        // A table of ns since the first message is exact enough as a picture.
        let at = std::time::Duration::from_nanos(time.saturating_sub(begin)).as_secs_f64();
        for (name, value) in found.iter().filter(|(name, _)| is_wanted(name)) {
            let has_place = picture.has(name) || picture.len() < CURVES_MAX;
            if has_place {
                picture.add(name, unit(name), (at, *value));
            } else {
                excess += 1;
            }
        }
        Ok(())
    })?;
    anyhow::ensure!(
        picture.len() > 0,
        "{}: no value matches\nhint: `takt record csv` writes all values by name",
        file.display()
    );
    anyhow::ensure!(
        excess == 0,
        "{}: more than {CURVES_MAX} values match\nhint: choose fewer with --probe",
        file.display()
    );
    save(svg, picture.svg()?)?;
    say(&format!("{}: {} values", svg.display(), picture.len()))?;
    Ok(Verdict::Good)
}

/// The unit of a value by the last part of its name, as probes have it; empty for others.
fn unit(name: &str) -> &'static str {
    let last = name.rsplit('.').next().unwrap_or_default();
    match last {
        "set_point" | "commanded" | "measured" | "following_error" => "rad",
        "velocity" => "rad/s",
        "torque" => "Nm",
        "x" | "y" | "z" if name.contains(".force.") => "N",
        "rx" | "ry" | "rz" if name.contains(".force.") => "Nm",
        "interval_us" | "execution_us" | "latency_us" => "us",
        _ => "",
    }
}
