//! Output of subcommands: text to standard output, messages to standard error. A reader that closes the pipe is no
//! error.

use std::ffi::OsStr;
use std::fs::{self, File};
use std::io::{self, IsTerminal as _, Write as _};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Context as _;

/// Writes a line to standard output.
pub(crate) fn say(line: &str) -> anyhow::Result<()> {
    print(format!("{line}\n").as_bytes())
}

/// Writes bytes to standard output.
pub(crate) fn print(bytes: &[u8]) -> anyhow::Result<()> {
    let mut out = io::stdout().lock();
    let written = out.write_all(bytes).and_then(|()| out.flush());
    written.map_err(|error| {
        if error.kind() == io::ErrorKind::BrokenPipe {
            ClosedOutput.into()
        } else {
            error.into()
        }
    })
}

/// The reader of standard output has closed it. A connection that breaks is another error, and none that a user wants.
#[derive(Debug, thiserror::Error)]
#[error("standard output is closed")]
struct ClosedOutput;

/// Writes a line to standard error; a failure of that cannot be reported.
pub(crate) fn complain(line: &str) {
    let _ = writeln!(io::stderr().lock(), "{line}");
}

/// Writes a file whole or not at all: to a second file first, so that the old file is kept if the disk is full.
/// Special files, such as a terminal, are written directly.
pub(crate) fn save(path: &Path, bytes: impl AsRef<[u8]>) -> anyhow::Result<()> {
    let target = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let result = write_whole(&target, bytes.as_ref());
    result
        .map_err(hinted)
        .with_context(|| format!("cannot write {}", path.display()))
}

/// Checks that [`save`] can write this file, so that a long run does not end without its picture.
pub(crate) fn check_writable(path: &Path) -> anyhow::Result<()> {
    let target = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let checked = match (fs::metadata(&target), target.file_name()) {
        (Ok(there), _) if there.is_dir() => Err(io::ErrorKind::IsADirectory.into()),
        (Ok(_), _) => File::options().write(true).open(&target).map(drop),
        (Err(_), Some(name)) => {
            let beside = beside(&target, name);
            File::create_new(&beside).and_then(|_| fs::remove_file(&beside))
        }
        (Err(error), None) => Err(error),
    };
    checked.with_context(|| format!("cannot write {}", path.display()))
}

/// The file that becomes the target when it is complete.
fn beside(target: &Path, name: &OsStr) -> PathBuf {
    target.with_file_name(format!(".{}.{}.new", name.display(), std::process::id()))
}

fn write_whole(target: &Path, bytes: &[u8]) -> io::Result<()> {
    let before = fs::metadata(target).ok();
    let (true, Some(name)) = (
        before.as_ref().is_none_or(fs::Metadata::is_file),
        target.file_name(),
    ) else {
        return fs::write(target, bytes);
    };
    let beside = beside(target, name);
    let mut file = match File::create_new(&beside) {
        Ok(file) => file,
        // A folder in which nothing may be made, with a file that may be changed.
        Err(error) if error.kind() == io::ErrorKind::PermissionDenied && before.is_some() => {
            return fs::write(target, bytes);
        }
        Err(error) => return Err(error),
    };
    let written = file
        .write_all(bytes)
        .and_then(|()| file.sync_all())
        .and_then(|()| before.map_or(Ok(()), |before| file.set_permissions(before.permissions())))
        .and_then(|()| fs::rename(&beside, target));
    if written.is_err() {
        // The error of the write is the cause.
        let _ = fs::remove_file(&beside);
    }
    written
}

/// An error of a file, with the remedy where there is one.
fn hinted(error: io::Error) -> anyhow::Error {
    let is_full = matches!(
        error.kind(),
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded
    );
    if is_full {
        anyhow::anyhow!("{error}\nhint: make room on that disk (`df -h`), or write elsewhere")
    } else {
        error.into()
    }
}

/// Whether progress may be shown.
pub(crate) fn is_terminal() -> bool {
    io::stderr().is_terminal()
}

/// Whether an error is only that nothing reads standard output any more.
pub(crate) fn is_closed_output(error: &anyhow::Error) -> bool {
    error.is::<ClosedOutput>()
}

/// An error and its causes in one line. Causes that the text contains already are not repeated.
pub(crate) fn chain(error: &anyhow::Error) -> String {
    error
        .chain()
        .map(ToString::to_string)
        .fold(String::new(), |text, cause| {
            if text.is_empty() {
                cause
            } else if text.contains(&cause) {
                text
            } else {
                format!("{text}: {cause}")
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

/// Reads a duration for which nothing must not stand: how long to run, or how often.
pub(crate) fn positive_span(text: &str) -> Result<Duration, String> {
    let span = span(text)?;
    if span.is_zero() {
        return Err("must be above 0, such as 1ms or 10s".to_owned());
    }
    Ok(span)
}

/// Reads a duration with bounds, in ms.
pub(crate) fn span_of_ms(
    bounds: RangeInclusive<u64>,
) -> impl Fn(&str) -> Result<Duration, String> + Clone + Send + Sync + 'static {
    move |text| {
        let (low, high) = (bounds.start(), bounds.end());
        let span = span(text)?;
        if span < Duration::from_millis(*low) || span > Duration::from_millis(*high) {
            return Err(format!("must be {low}ms to {high}ms"));
        }
        Ok(span)
    }
}

/// A value of a net as JSON: numbers are numbers.
pub(crate) fn json_of(text: &str) -> serde_json::Value {
    let json = takt_net::value::text::to_json(text);
    let json = json.and_then(|json| serde_json::from_str(&json).ok());
    json.unwrap_or_else(|| text.into())
}

/// The text in lines of at most `width` less `indent` characters, broken between words. Several blanks in a row,
/// as before a comment, stay.
pub(crate) fn wrapped(
    text: &str,
    indent: usize,
    width: usize,
) -> impl Iterator<Item = String> + use<> {
    let available = width.saturating_sub(indent).max(20);
    let mut lines: Vec<String> = vec![String::new()];
    for word in text.split(' ') {
        if let Some(line) = lines.last_mut() {
            let first = line.is_empty();
            if first || line.chars().count() + 1 + word.chars().count() <= available {
                if !first {
                    line.push(' ');
                }
                line.push_str(word);
                continue;
            }
        }
        lines.push(word.to_owned());
    }
    lines.into_iter().map(|line| line.trim_end().to_owned())
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
    use std::fs;

    use std::time::Duration;

    use super::{
        ClosedOutput, chain, check_writable, is_closed_output, positive_span, save, share,
        span_of_ms, time,
    };

    #[test]
    fn save_replaces_existing_file() {
        let folder = std::env::temp_dir().join(format!("takt-save-{}", std::process::id()));
        fs::create_dir(&folder).unwrap();
        let path = folder.join("plot.svg");
        for text in ["one", "another"] {
            save(&path, text).unwrap();
            assert_eq!(fs::read_to_string(&path).unwrap(), text);
        }
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 1);
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn check_writable_leaves_nothing_and_names_cause() {
        let folder = std::env::temp_dir().join(format!("takt-check-{}", std::process::id()));
        fs::create_dir(&folder).unwrap();
        check_writable(&folder.join("plot.svg")).unwrap();
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 0);
        save(&folder.join("plot.svg"), "old").unwrap();
        check_writable(&folder.join("plot.svg")).unwrap();
        assert_eq!(fs::read_to_string(folder.join("plot.svg")).unwrap(), "old");
        for (path, cause) in [
            (folder.join("none/plot.svg"), "No such file or directory"),
            (folder.clone(), "is a directory"),
        ] {
            let text = chain(&check_writable(&path).unwrap_err());
            assert!(
                text.starts_with(&format!("cannot write {}: ", path.display()))
                    && text.contains(cause),
                "{text}"
            );
        }
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn save_full_disk_reports_hint() {
        let error = save("/dev/full".as_ref(), "text").unwrap_err();
        let text = chain(&error);
        assert!(
            text.starts_with("cannot write /dev/full: No space left"),
            "{text}"
        );
        assert!(
            text.ends_with("hint: make room on that disk (`df -h`), or write elsewhere"),
            "{text}"
        );
    }

    #[test]
    fn chain_prints_each_cause_once() {
        let error = anyhow::anyhow!("no such file").context("a.toml: no such file");
        assert_eq!(chain(&error), "a.toml: no such file");
        let error = anyhow::anyhow!("no such file").context("cannot read a.toml");
        assert_eq!(chain(&error), "cannot read a.toml: no such file");
    }

    #[test]
    fn broken_connection_is_no_closed_output() {
        let broken = std::io::Error::from(std::io::ErrorKind::BrokenPipe);
        assert!(!is_closed_output(&anyhow::Error::from(broken)));
        let closed = anyhow::Error::from(ClosedOutput).context("cannot print");
        assert!(is_closed_output(&closed));
    }

    #[test]
    fn shares_are_bounded() {
        assert_eq!(share("0.05"), Ok(0.05));
        for wrong in ["1.5", "-0.1", "NaN", "5 %", ""] {
            assert!(share(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn spans_out_of_bounds_are_rejected() {
        for (text, good) in [("1ms", true), ("0s", false), ("0.1ns", false), ("1", false)] {
            assert_eq!(positive_span(text).is_ok(), good, "{text}");
        }
        let period = span_of_ms(1..=100);
        assert_eq!(period("100ms"), Ok(Duration::from_millis(100)));
        for text in ["500us", "0s", "100.1ms"] {
            assert_eq!(
                period(text),
                Err("must be 1ms to 100ms".to_owned()),
                "{text}"
            );
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
