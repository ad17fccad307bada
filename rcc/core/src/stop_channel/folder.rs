//! Directories of the stop channels' sockets on this host, so that `takt stop` finds all controllers
//! without a cell file. Each controller has its own socket, named by its process id.

use std::fs::DirBuilder;
use std::io;
use std::os::unix::fs::{DirBuilderExt as _, MetadataExt as _};
use std::path::{Path, PathBuf};

/// The directory for services and root.
const SYSTEM: &str = "/run/takt";

/// Directories with sockets that this user may use, the system's first.
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

/// Path of this process's socket, in the first writable directory.
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

/// Creates a directory if necessary. In one owned by another user, that user could place other sockets.
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
