//! Tests that cannot run on this machine report it. Each test decides that itself.

#![expect(
    clippy::unwrap_used,
    clippy::print_stderr,
    reason = "test support, which may fail anywhere with a message"
)]

use std::fs::OpenOptions;
use std::io::Write as _;
use std::path::Path;

/// Notes that `test` cannot run here; `why` begins with "needs". The test returns afterwards.
///
/// # Panics
/// If the runner asked for such notes and its file cannot be written: the note would be lost.
pub fn skip(test: &str, why: &str) {
    eprintln!("skipped: {why}");
    if let Some(path) = std::env::var_os("TAKT_SKIPS") {
        note(&path, test, why).unwrap();
    }
}

/// The virtual CAN interface of this host, `vcan0` unless `TAKT_VCAN` names another one. `None` if
/// there is none, which is noted for `test`.
#[must_use]
pub fn vcan(test: &str) -> Option<String> {
    let name = std::env::var("TAKT_VCAN").unwrap_or_else(|_| "vcan0".to_owned());
    if Path::new("/sys/class/net").join(&name).exists() {
        return Some(name);
    }
    skip(test, "needs vcan");
    None
}

fn note(path: &std::ffi::OsStr, test: &str, why: &str) -> std::io::Result<()> {
    let mut skips = OpenOptions::new().append(true).open(path)?;
    // In one write: tests of several threads append to the file.
    skips.write_all(format!("{test}: {why}\n").as_bytes())
}

#[cfg(test)]
mod tests {
    use super::note;

    #[test]
    fn skip_note_goes_to_runner_file() {
        let path = std::env::temp_dir().join(format!("takt-skips-{}", std::process::id()));
        std::fs::write(&path, "first: needs a bus\n").unwrap();
        note(path.as_os_str(), "second", "needs a robot").unwrap();
        let notes = std::fs::read_to_string(&path).unwrap();
        std::fs::remove_file(&path).unwrap();
        assert_eq!(notes, "first: needs a bus\nsecond: needs a robot\n");
        assert!(
            note(path.as_os_str(), "third", "needs a bus").is_err(),
            "no runner made the file"
        );
    }
}
