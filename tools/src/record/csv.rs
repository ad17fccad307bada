//! `takt record csv`: a recording as a table, one row for each instant. The file is read twice: the columns are known only at
//! its end.

use std::collections::HashMap;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use anyhow::Context as _;
use takt_core::record::numbers;

use crate::Verdict;

/// Maximum number of columns.
const COLUMNS_MAX: usize = 16_384;

/// Columns by name, in the order in which they come first.
#[derive(Debug, Default)]
struct Columns {
    names: Vec<String>,
    places: HashMap<String, usize>,
    /// Names that were left out.
    excess: usize,
}

impl Columns {
    fn note(&mut self, name: &str, patterns: &[String]) {
        if self.places.contains_key(name) {
            return;
        }
        let is_wanted = |pattern: &String| matches(pattern, name);
        if !patterns.is_empty() && !patterns.iter().any(is_wanted) {
            return;
        }
        if self.names.len() >= COLUMNS_MAX {
            self.excess += 1;
            return;
        }
        self.places.insert(name.to_owned(), self.names.len());
        self.names.push(name.to_owned());
    }
}

pub(super) fn run(
    file: &Path,
    patterns: &[String],
    output: Option<&Path>,
) -> anyhow::Result<Verdict> {
    let mut columns = Columns::default();
    numbers(file, |_, found| {
        found
            .iter()
            .for_each(|(name, _)| columns.note(name, patterns));
        Ok(())
    })?;
    anyhow::ensure!(
        !columns.names.is_empty(),
        "{}: no value matches\nhint: without --probe all are written; `takt record info` lists the topics",
        file.display()
    );
    anyhow::ensure!(
        columns.excess == 0,
        "{}: more than {COLUMNS_MAX} values\nhint: choose some with --probe",
        file.display()
    );
    match output {
        Some(path) => {
            let to = File::create_new(path)
                .with_context(|| format!("cannot create {}", path.display()))?;
            let mut to = BufWriter::new(to);
            write(file, &columns, &mut to)?;
            to.flush()
                .with_context(|| format!("cannot write {}", path.display()))?;
        }
        None => {
            let mut to = BufWriter::new(io::stdout().lock());
            write(file, &columns, &mut to)?;
            to.flush()?;
        }
    }
    Ok(Verdict::Good)
}

/// Writes the rows: times in s since the first.
fn write(file: &Path, columns: &Columns, to: &mut impl Write) -> anyhow::Result<()> {
    let heads = columns.names.iter().map(|name| quoted(name));
    writeln!(to, "time s,{}", heads.collect::<Vec<_>>().join(","))?;
    let mut row = vec![f64::NAN; columns.names.len()];
    let (mut begin, mut at, mut is_empty) = (None, 0, true);
    let mut failed = Ok(());
    numbers(file, |time, found| {
        for (name, value) in found {
            let Some(place) = columns.places.get(name) else {
                continue;
            };
            let begin = *begin.get_or_insert(time);
            if time != at && !is_empty && failed.is_ok() {
                failed = line(to, at.saturating_sub(begin), &mut row);
            }
            (at, is_empty) = (time, false);
            if let Some(field) = row.get_mut(*place) {
                *field = *value;
            }
        }
        Ok(())
    })?;
    failed?;
    if !is_empty {
        line(to, at.saturating_sub(begin.unwrap_or(at)), &mut row)?;
    }
    Ok(())
}

fn line(to: &mut impl Write, ns: u64, row: &mut [f64]) -> io::Result<()> {
    write!(to, "{}.{:09}", ns / 1_000_000_000, ns % 1_000_000_000)?;
    for value in row.iter_mut() {
        if value.is_nan() {
            write!(to, ",")?;
        } else {
            write!(to, ",{value}")?;
        }
        *value = f64::NAN;
    }
    writeln!(to)
}

fn quoted(name: &str) -> String {
    if name.contains([',', '"']) {
        format!("\"{}\"", name.replace('"', "\"\""))
    } else {
        name.to_owned()
    }
}

/// Whether a name matches a pattern, in which * stands for any characters.
pub(super) fn matches(pattern: &str, name: &str) -> bool {
    let Some((before, after)) = pattern.split_once('*') else {
        return pattern == name;
    };
    let Some(rest) = name.strip_prefix(before) else {
        return false;
    };
    let mut ends = rest.char_indices().map(|(at, _)| at).chain([rest.len()]);
    ends.any(|at| matches(after, rest.get(at..).unwrap_or_default()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn probe_patterns_match_whole_names() {
        for (pattern, name, wanted) in [
            ("left.joint.*.measured", "left.joint.3.measured", true),
            ("left.joint.*.measured", "left.joint.3.velocity", false),
            ("left.*", "left.force.x", true),
            ("left", "left.force.x", false),
            ("*.force.*", "left.force.x", true),
            ("*", "", true),
        ] {
            assert_eq!(matches(pattern, name), wanted, "{pattern} {name}");
        }
    }
}
