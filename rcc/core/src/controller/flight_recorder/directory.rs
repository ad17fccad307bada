//! The directory of flight files. It touches no files of other names.

use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, UNIX_EPOCH};

use super::FlightInfo;

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
    let (seconds, ms) = (unix.as_secs(), unix.subsec_millis());
    let (days, of_day) = (seconds / 86_400, seconds % 86_400);
    let (year, month, day) = date(days);
    let (hour, minute, second) = (of_day / 3600, of_day / 60 % 60, of_day % 60);
    let letter = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    let subject: String = subject.chars().take(SUBJECT_MAX).map(letter).collect();
    format!(
        "{PREFIX}{year:04}{month:02}{day:02}T{hour:02}{minute:02}{second:02}.{ms:03}Z-{subject}{SUFFIX}"
    )
}

/// Year, month and day of the Gregorian calendar, so many days after 1970-01-01.
const fn date(days: u64) -> (u64, u64, u64) {
    // Years from March on, in eras of 400 years: the leap day is the last of its year.
    let days = days + 719_468;
    let (era, of_era) = (days / 146_097, days % 146_097);
    let year = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year + year / 4 - year / 100);
    let shifted = (5 * of_year + 2) / 153;
    let day = of_year - (153 * shifted + 2) / 5 + 1;
    let month = if shifted < 10 {
        shifted + 3
    } else {
        shifted - 9
    };
    let first = if month <= 2 { 1 } else { 0 };
    (year + era * 400 + first, month, day)
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
