//! What subcommands say: text to standard output, complaints to standard error. A reader that has
//! seen enough and closes the pipe is no failure.

use std::io::{self, IsTerminal as _, Write as _};
use std::time::Duration;

/// Writes a line to standard output.
pub(crate) fn say(line: &str) -> anyhow::Result<()> {
    let mut out = io::stdout().lock();
    out.write_all(line.as_bytes())?;
    out.write_all(b"\n")?;
    Ok(out.flush()?)
}

/// Writes a line to standard error; there is nobody to tell if that fails.
pub(crate) fn complain(line: &str) {
    let _ = writeln!(io::stderr().lock(), "{line}");
}

/// Whether progress may be shown.
pub(crate) fn is_terminal() -> bool {
    io::stderr().is_terminal()
}

/// Whether an error is only that the reader has gone.
pub(crate) fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error
        .chain()
        .filter_map(|cause| cause.downcast_ref::<io::Error>())
        .any(|cause| cause.kind() == io::ErrorKind::BrokenPipe)
}

/// An error and its causes in one line. Causes that are already told are not told again.
pub(crate) fn chain(error: &anyhow::Error) -> String {
    error
        .chain()
        .map(ToString::to_string)
        .fold(String::new(), |told, cause| {
            if told.is_empty() {
                cause
            } else if told.contains(&cause) {
                told
            } else {
                format!("{told}: {cause}")
            }
        })
}

/// Reads a share of the command line, 0 to 1.
pub(crate) fn share(text: &str) -> Result<f64, String> {
    let share: f64 = text.parse().map_err(|_| format!("`{text}` is no number"))?;
    if (0.0..=1.0).contains(&share) {
        Ok(share)
    } else {
        Err("must be 0 to 1".to_owned())
    }
}

/// Reads a duration of the command line.
pub(crate) fn span(text: &str) -> Result<Duration, String> {
    takt_core::span::parse(text).map_err(|e| e.to_string())
}

/// A time in the unit that suits it, at most 8 characters: `17 us`, `1.25 ms`.
pub(crate) fn time(ns: i64) -> String {
    #[expect(clippy::cast_precision_loss, reason = "shown with three digits")]
    let value = ns as f64;
    let (value, unit) = match ns.abs() {
        0..1_000 => (value, "ns"),
        1_000..1_000_000 => (value / 1e3, "us"),
        1_000_000..1_000_000_000 => (value / 1e6, "ms"),
        _ => (value / 1e9, "s"),
    };
    let digits = if unit == "ns" || value.abs() >= 100.0 {
        0
    } else {
        1
    };
    format!("{value:.digits$} {unit}")
}

#[cfg(test)]
mod tests {
    use super::{chain, share, time};

    #[test]
    fn causes_are_told_once() {
        let error = anyhow::anyhow!("no such file").context("a.toml: no such file");
        assert_eq!(chain(&error), "a.toml: no such file");
        let error = anyhow::anyhow!("no such file").context("cannot read a.toml");
        assert_eq!(chain(&error), "cannot read a.toml: no such file");
    }

    #[test]
    fn shares_are_bounded() {
        assert_eq!(share("0.05"), Ok(0.05));
        for wrong in ["1.5", "-0.1", "NaN", "5 %", ""] {
            assert!(share(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn times_take_a_fitting_unit() {
        assert_eq!(time(17), "17 ns");
        assert_eq!(time(17_400), "17.4 us");
        assert_eq!(time(250_000), "250 us");
        assert_eq!(time(-1_250_000), "-1.2 ms");
        assert_eq!(time(60_000_000_000), "60.0 s");
    }
}
