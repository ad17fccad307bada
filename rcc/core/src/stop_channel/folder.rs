//! Where controllers of this host put the sockets of their stop channels, so that `takt stop` finds all of them
//! without knowing a cell. Each has a file of its own, named by its process.

use std::fs::DirBuilder;
use std::io;
use std::os::unix::fs::{DirBuilderExt as _, MetadataExt as _};
use std::path::{Path, PathBuf};

/// The folder of services and of root.
const SYSTEM: &str = "/run/takt";

/// Folders in which there may be sockets that this user may use, the system's first.
#[must_use]
pub fn socket_folders() -> Vec<PathBuf> {
    let uid = own_uid();
    let of_user = std::env::var_os("XDG_RUNTIME_DIR").map(|path| Path::new(&path).join("takt"));
    let temporary = uid.map(|uid| std::env::temp_dir().join(format!("takt-{uid}")));
    let mut folders = vec![PathBuf::from(SYSTEM)];
    folders.extend(of_user);
    folders.extend(temporary);
    folders
}

/// A path for the socket of this process, in the first of the folders that it may write to.
///
/// # Errors
/// If there is none.
pub fn default_socket() -> io::Result<PathBuf> {
    let mut last = io::Error::from(io::ErrorKind::NotFound);
    for folder in socket_folders() {
        match prepare(&folder) {
            Ok(()) => return Ok(folder.join(format!("stop-{}.sock", std::process::id()))),
            Err(error) => last = error,
        }
    }
    Err(last)
}

/// Makes a folder if it is not there. One of another user would let that one put other sockets there.
fn prepare(folder: &Path) -> io::Result<()> {
    let mode = if folder == Path::new(SYSTEM) {
        0o755
    } else {
        0o700
    };
    match DirBuilder::new().mode(mode).create(folder) {
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => return Err(error),
        _ => {}
    }
    let found = std::fs::symlink_metadata(folder)?;
    if !found.is_dir() || Some(found.uid()) != own_uid() {
        return Err(io::ErrorKind::PermissionDenied.into());
    }
    Ok(())
}

fn own_uid() -> Option<u32> {
    Some(std::fs::metadata("/proc/self").ok()?.uid())
}
