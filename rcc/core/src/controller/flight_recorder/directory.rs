//! The directory of flight files. It touches no files of other names.

use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, UNIX_EPOCH};

use super::FlightInfo;
use crate::record::utc;

const PREFIX: &str = "flight-";
const SUFFIX: &str = ".mcap";
/// Maximum number of files.
const FILES_MAX: usize = 64;
/// Maximum number of letters of the subject in a name.
const SUBJECT_MAX: usize = 40;

/// Checks that files can be created.
pub(super) fn check(directory: &Path) -> io::Result<()> {
    let probe = directory.join(format!(".{PREFIX}{}", std::process::id()));
    std::fs::write(&probe, b"")?;
    std::fs::remove_file(probe)
}

/// The name of a file at that Unix time about a device, a net or a thread: names sort by time.
pub(super) fn file_name(unix: Duration, subject: &str) -> String {
    let letter = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    let subject: String = subject.chars().take(SUBJECT_MAX).map(letter).collect();
    format!("{PREFIX}{}-{subject}{SUFFIX}", utc::text(unix))
}

/// The flight files of a directory, oldest first.
pub(super) fn list(directory: &Path) -> Vec<FlightInfo> {
    let entries = std::fs::read_dir(directory).into_iter().flatten().flatten();
    let info = |entry: std::fs::DirEntry| {
        let name = entry.file_name().into_string().ok()?;
        let metadata = entry.metadata().ok()?;
        let is_ours = name.starts_with(PREFIX) && name.ends_with(SUFFIX) && metadata.is_file();
        is_ours.then(|| FlightInfo {
            name,
            path: entry.path(),
            bytes: metadata.len(),
            changed: metadata.modified().unwrap_or(UNIX_EPOCH),
            is_complete: true,
        })
    };
    let mut files: Vec<_> = entries.filter_map(info).collect();
    files.sort_by(|one, other| one.name.cmp(&other.name));
    files
}

/// Deletes the oldest files until there is room for another one, and the rest has at most so many bytes. Returns those that
/// it deleted.
pub(super) fn prune(directory: &Path, bytes_max: u64) -> Vec<PathBuf> {
    let files = list(directory);
    let mut bytes: u64 = files.iter().map(|file| file.bytes).sum();
    let mut count = files.len();
    let mut deleted = Vec::new();
    for file in files {
        if count < FILES_MAX && bytes <= bytes_max {
            break;
        }
        // One that another process deleted is gone all the same; one that cannot be deleted counts no more here, and the
        // disk says so when the next file is written.
        if std::fs::remove_file(&file.path).is_ok() {
            deleted.push(file.path);
        }
        (bytes, count) = (bytes - file.bytes, count - 1);
    }
    deleted
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flight_file_name_has_utc_and_subject() {
        let name = |seconds, subject| file_name(Duration::from_secs(seconds), subject);
        assert_eq!(name(0, "left"), "flight-19700101T000000.000Z-left.mcap");
        assert_eq!(name(951_782_399, "x"), "flight-20000228T235959.000Z-x.mcap");
        assert_eq!(name(951_782_400, "x"), "flight-20000229T000000.000Z-x.mcap");
        assert_eq!(
            name(1_795_478_400, "x"),
            "flight-20261124T000000.000Z-x.mcap"
        );
        let odd = name(0, "../Arm 2\u{e4}");
        assert_eq!(odd, "flight-19700101T000000.000Z-___Arm_2_.mcap");
        assert_eq!(
            name(0, &"a".repeat(99)).len(),
            "flight-19700101T000000.000Z-.mcap".len() + 40
        );
    }
}
