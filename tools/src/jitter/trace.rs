//! A mark in the kernel's trace where a latency was too long, and an end to tracing right after it, so
//! that the trace holds what led there.
//!
//! It starts no tracer: the engineer chooses the events.

use std::fs::{self, File, OpenOptions};
use std::io::Write as _;
use std::path::Path;

use takt_rt::Nanos;

/// Where tracefs is mounted, the current folder before the old one.
const FOLDERS: [&str; 2] = ["/sys/kernel/tracing", "/sys/kernel/debug/tracing"];

/// The kernel's trace, open for a mark.
#[derive(Debug)]
pub(crate) struct Tracer {
    marker: File,
    switch: File,
}

impl Tracer {
    /// Opens it where it is usually found.
    ///
    /// # Errors If no mark can be made, with cause and remedy.
    pub(crate) fn open() -> Result<Self, String> {
        let mounted = FOLDERS
            .iter()
            .map(Path::new)
            .find(|folder| folder.join("trace_marker").exists());
        match mounted {
            Some(folder) => Self::open_at(folder),
            None => Err(format!(
                "no trace_marker in {}; mount -t tracefs nodev {}",
                FOLDERS[0], FOLDERS[0]
            )),
        }
    }

    fn open_at(folder: &Path) -> Result<Self, String> {
        let open = |name: &str| {
            let path = folder.join(name);
            let file = OpenOptions::new().write(true).open(&path);
            file.map_err(|e| format!("{}: {e}; run as root", path.display()))
        };
        let switch = folder.join("tracing_on");
        if fs::read_to_string(&switch).is_ok_and(|on| on.trim() == "0") {
            let how = "choose events there, then echo 1 to it";
            return Err(format!("no tracer runs: {} is 0; {how}", switch.display()));
        }
        Ok(Self {
            marker: open("trace_marker")?,
            switch: open("tracing_on")?,
        })
    }

    /// Makes the mark and ends tracing; whether both went well. Allocates nothing: the cycle thread
    /// calls it.
    pub(crate) fn mark(&self, cycle: u64, latency: Nanos) -> bool {
        let mut line = [0_u8; 96];
        let mut rest = &mut line[..];
        let us = latency.0 / 1000;
        // Cannot fail: the longest line is shorter.
        let _ = writeln!(rest, "takt jitter: cycle {cycle} woke {us} us late");
        let left = rest.len();
        let (text, _) = line.split_at(line.len() - left);
        let marked = (&self.marker).write_all(text).is_ok();
        (&self.switch).write_all(b"0").is_ok() && marked
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A folder that looks like tracefs.
    fn tracefs(on: &str) -> std::path::PathBuf {
        let name = format!("takt-trace-{}-{}", std::process::id(), on.trim());
        let folder = std::env::temp_dir().join(name);
        fs::create_dir_all(&folder).unwrap();
        fs::write(folder.join("trace_marker"), "").unwrap();
        fs::write(folder.join("tracing_on"), on).unwrap();
        folder
    }

    #[test]
    fn trace_mark_is_written_and_tracing_ends() {
        let folder = tracefs("1\n");
        let tracer = Tracer::open_at(&folder).unwrap();
        assert!(tracer.mark(u64::MAX, Nanos::MAX));
        let mark = fs::read_to_string(folder.join("trace_marker")).unwrap();
        assert_eq!(
            mark,
            "takt jitter: cycle 18446744073709551615 woke 9223372036854775 us late\n"
        );
        let switch = fs::read_to_string(folder.join("tracing_on")).unwrap();
        assert!(switch.starts_with('0'));
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn trace_switched_off_is_reported() {
        let folder = tracefs("0\n");
        let error = Tracer::open_at(&folder).unwrap_err();
        assert!(error.contains("no tracer runs"), "{error}");
        fs::remove_dir_all(&folder).unwrap();
        let error = Tracer::open_at(&folder).unwrap_err();
        assert!(
            error.contains("trace_marker") && error.contains("root"),
            "{error}"
        );
    }
}
