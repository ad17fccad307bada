//! The last state, in the state directory, so that the next start can report which nets a crash interrupted. Nothing
//! is resumed from it. It is written when it changes, and not forced to the disk: it outlives the process, not a power
//! cut.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use takt_core::Controller;
use takt_core::controller::NetState;

use crate::output::complain;

/// Name of the file in the state directory.
const NAME: &str = "state.json";

/// What a controller was doing.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct LastState {
    /// Whether it was stopped, rather than broken off.
    pub(super) stopped: bool,
    /// Its process.
    pub(super) pid: u32,
    /// Nets that were running.
    pub(super) nets: Vec<LastNet>,
    /// Devices, with whether they could be commanded.
    pub(super) devices: Vec<(String, String)>,
}

/// A net that was running.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct LastNet {
    /// Its identifier.
    pub(super) net: String,
    /// What it was, for people.
    pub(super) description: String,
    /// RUNNING or CANCELLING.
    pub(super) state: String,
}

impl LastState {
    /// What a controller does now.
    pub(super) fn of(controller: &Controller) -> Self {
        let nets = controller.nets().into_iter();
        let running = nets.filter_map(|id| controller.net(id)).filter(is_running);
        let net = |net: takt_core::controller::NetInfo| LastNet {
            net: net.id.to_string(),
            state: net.state().to_string(),
            description: net.description,
        };
        let devices = controller.devices().into_iter();
        Self {
            stopped: false,
            pid: std::process::id(),
            nets: running.map(net).collect(),
            devices: devices.map(|d| (d.name, d.status.to_string())).collect(),
        }
    }

    /// The remark at the next start; `None` if it was stopped.
    pub(super) fn broken_off(&self) -> Option<String> {
        if self.stopped {
            return None;
        }
        let pid = self.pid;
        let nets: Vec<&str> = self.nets.iter().map(|net| net.net.as_str()).collect();
        Some(if nets.is_empty() {
            format!("the run before (pid {pid}) was broken off; no net was running")
        } else {
            let nets = nets.join(", ");
            format!("the run before (pid {pid}) was broken off while running {nets}")
        })
    }
}

/// Whether a net is being evaluated.
pub(super) fn is_running(net: &takt_core::controller::NetInfo) -> bool {
    matches!(net.state(), NetState::Running | NetState::Cancelling)
}

/// The file, if there is a directory for it.
#[derive(Debug)]
pub(super) struct StateFile {
    path: Option<PathBuf>,
    written: Option<LastState>,
}

impl StateFile {
    /// Takes the directory that the service manager made, and what it holds of the run before.
    pub(super) fn open(directory: Option<&Path>) -> (Self, Option<LastState>) {
        let path = directory.map(|directory| directory.join(NAME));
        let before = path
            .as_deref()
            .and_then(|path| takt_core::files::read(path, takt_core::files::TEXT_BYTES_MAX).ok());
        // A file that cannot be read is replaced.
        let before = before.and_then(|bytes| serde_json::from_slice(&bytes).ok());
        let written = None;
        (Self { path, written }, before)
    }

    /// Writes the state if it differs from what was written last. A reader sees the old or the new file, never a part.
    /// A directory that cannot be written to is reported once.
    pub(super) fn write(&mut self, state: LastState) {
        let Some(path) = self.path.clone() else {
            return;
        };
        if self.written.as_ref() == Some(&state) {
            return;
        }
        let new = path.with_extension("new");
        let written = serde_json::to_vec_pretty(&state)
            .map_err(std::io::Error::from)
            .and_then(|bytes| std::fs::write(&new, bytes))
            .and_then(|()| std::fs::rename(&new, &path));
        match written {
            Ok(()) => self.written = Some(state),
            Err(error) => {
                complain(&format!("cannot write {}: {error}", path.display()));
                self.path = None;
            }
        }
    }

    /// Notes that the controller was stopped.
    pub(super) fn close(mut self) {
        if let Some(last) = self.written.take() {
            self.write(LastState {
                stopped: true,
                nets: Vec::new(),
                ..last
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(name: &str) -> PathBuf {
        let path = std::env::temp_dir().join(format!("takt-state-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        path
    }

    fn swinging() -> LastState {
        LastState {
            pid: 7,
            nets: vec![LastNet {
                net: "rpinet3".to_owned(),
                description: "swing".to_owned(),
                state: "RUNNING".to_owned(),
            }],
            devices: vec![("left".to_owned(), "operational".to_owned())],
            ..LastState::default()
        }
    }

    #[test]
    fn state_file_after_crash_names_interrupted_nets() {
        let folder = folder("crash");
        let (mut file, before) = StateFile::open(Some(&folder));
        assert_eq!(before, None);
        file.write(swinging());
        let (_, before) = StateFile::open(Some(&folder));
        std::fs::remove_dir_all(&folder).unwrap();
        let before = before.unwrap();
        assert_eq!(before, swinging());
        let remark = before.broken_off().unwrap();
        assert!(
            remark.ends_with("broken off while running rpinet3"),
            "{remark}"
        );
    }

    #[test]
    fn state_file_after_stop_gives_no_remark() {
        let folder = folder("stop");
        let (mut file, _) = StateFile::open(Some(&folder));
        file.write(swinging());
        file.close();
        let (_, before) = StateFile::open(Some(&folder));
        std::fs::remove_dir_all(&folder).unwrap();
        let before = before.unwrap();
        assert!(before.stopped && before.nets.is_empty());
        assert_eq!(before.broken_off(), None);
    }

    #[test]
    fn state_file_missing_directory_or_damaged_is_ignored() {
        let (mut file, before) = StateFile::open(None);
        assert_eq!(before, None);
        file.write(swinging());
        file.close();
        let folder = folder("spoilt");
        std::fs::write(folder.join(NAME), "{").unwrap();
        let (_, before) = StateFile::open(Some(&folder));
        std::fs::remove_dir_all(&folder).unwrap();
        assert_eq!(before, None);
    }
}
