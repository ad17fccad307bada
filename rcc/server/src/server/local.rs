//! The Unix socket for tools of this host. The kernel reports the account of a client, so no token is needed. This
//! module reads no messages.

use std::io;
use std::os::unix::fs::{FileTypeExt as _, MetadataExt as _, PermissionsExt as _};
use std::path::{Path, PathBuf};

use takt_client::local::{NAME, SERVICE_DIRECTORY};
use tokio::net::{UnixListener, UnixStream};

use crate::error::Error;

/// Most bytes read of `/etc/group`.
const GROUPS_BYTES_MAX: u64 = 4 << 20;

/// Configuration of the Unix socket.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LocalSocket {
    /// Its path.
    pub path: PathBuf,
    /// Group, by name or number, whose accounts are admitted besides this process's own and root.
    pub group: Option<String>,
}

/// Default path for a controller of this process's account: in the runtime directory of the service manager, else
/// in that of the account's session, else in `/run/takt`.
pub fn default_path() -> PathBuf {
    let named = |name| std::env::var_os(name).filter(|value| !value.is_empty());
    if let Some(directory) = named("RUNTIME_DIRECTORY") {
        return Path::new(&directory).join(NAME);
    }
    match named("XDG_RUNTIME_DIR") {
        Some(directory) => Path::new(&directory).join("takt").join(NAME),
        None => Path::new(SERVICE_DIRECTORY).join(NAME),
    }
}

/// A listening Unix socket; dropping it removes the file.
#[derive(Debug)]
pub(super) struct Local {
    listener: UnixListener,
    path: PathBuf,
    /// Inode of the socket, to distinguish it from another controller's.
    inode: u64,
    /// Account of this process.
    uid: u32,
    /// Whether the socket's mode admits a group, which the kernel checks when a client connects.
    has_group: bool,
}

impl Local {
    /// Starts listening. A stale socket is replaced; one at which a process listens is not.
    pub(super) async fn bind(socket: &LocalSocket) -> Result<Self, Error> {
        let path = &socket.path;
        let failed = |source| Error::Local {
            path: path.display().to_string(),
            source,
        };
        let gid = socket.group.as_deref().map(group_id).transpose();
        let gid = gid.map_err(failed)?;
        make_directory(path, gid).map_err(failed)?;
        remove_stale_socket(path).await.map_err(failed)?;
        // The socket gets its final name only after its mode, so that no client connects earlier.
        let mut temporary = path.clone().into_os_string();
        temporary.push(format!(".{}", std::process::id()));
        let temporary = PathBuf::from(temporary);
        let _ = std::fs::remove_file(&temporary);
        let listener = UnixListener::bind(&temporary).map_err(failed)?;
        let (uid, inode) = prepare(&temporary, path, gid).map_err(|error| {
            let _ = std::fs::remove_file(&temporary);
            failed(error)
        })?;
        Ok(Self {
            listener,
            path: path.clone(),
            inode,
            uid,
            has_group: gid.is_some(),
        })
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    pub(super) async fn accept(&self) -> io::Result<UnixStream> {
        Ok(self.listener.accept().await?.0)
    }

    /// Whether the account of a client is admitted: this process's own, root, or one of the group.
    pub(super) fn admits(&self, stream: &UnixStream) -> bool {
        let account = stream.peer_cred();
        account.is_ok_and(|a| a.uid() == self.uid || a.uid() == 0 || self.has_group)
    }
}

impl Drop for Local {
    fn drop(&mut self) {
        // Another controller may have replaced the file with its own socket.
        let found = std::fs::symlink_metadata(&self.path);
        if found.is_ok_and(|found| found.ino() == self.inode) {
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

/// Sets mode, owner and final name of the socket; returns its account and inode.
fn prepare(temporary: &Path, path: &Path, gid: Option<u32>) -> io::Result<(u32, u64)> {
    let mode = if gid.is_some() { 0o660 } else { 0o600 };
    std::fs::set_permissions(temporary, std::fs::Permissions::from_mode(mode))?;
    if gid.is_some() {
        std::os::unix::fs::chown(temporary, None, gid)?;
    }
    let made = std::fs::metadata(temporary)?;
    std::fs::rename(temporary, path)?;
    Ok((made.uid(), made.ino()))
}

/// Creates the directory of the socket for this account and the group, if it does not exist.
fn make_directory(path: &Path, gid: Option<u32>) -> io::Result<()> {
    let Some(directory) = path.parent().filter(|d| !d.exists()) else {
        return Ok(());
    };
    std::fs::create_dir(directory)?;
    let mode = if gid.is_some() { 0o750 } else { 0o700 };
    if gid.is_some() {
        std::os::unix::fs::chown(directory, None, gid)?;
    }
    std::fs::set_permissions(directory, std::fs::Permissions::from_mode(mode))
}

async fn remove_stale_socket(path: &Path) -> io::Result<()> {
    let Ok(found) = std::fs::symlink_metadata(path) else {
        return Ok(());
    };
    if !found.file_type().is_socket() {
        let text = "a file with this name exists and is not a socket";
        return Err(io::Error::new(io::ErrorKind::AlreadyExists, text));
    }
    match UnixStream::connect(path).await {
        Ok(owner) => Err(takt_core::local_socket::taken(&owner)),
        Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => {
            std::fs::remove_file(path)
        }
        Err(error) => Err(error),
    }
}

/// Id of a group, read from `/etc/group`.
fn group_id(group: &str) -> io::Result<u32> {
    if let Ok(number) = group.parse() {
        return Ok(number);
    }
    let mut text = String::new();
    let file = std::fs::File::open("/etc/group")?;
    io::Read::read_to_string(&mut io::Read::take(file, GROUPS_BYTES_MAX), &mut text)?;
    let number = text.lines().find_map(|line| {
        let mut fields = line.split(':');
        (fields.next() == Some(group)).then(|| fields.nth(1)?.parse().ok())?
    });
    number.ok_or_else(|| {
        let text = format!("/etc/group has no group `{group}`\nhint: give its number");
        io::Error::new(io::ErrorKind::NotFound, text)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn socket(name: &str) -> LocalSocket {
        let folder = std::env::temp_dir().join(format!("takt-{name}-{}", std::process::id()));
        LocalSocket {
            path: folder.join(NAME),
            group: None,
        }
    }

    #[tokio::test]
    async fn socket_is_private_and_admits_own_account() {
        let socket = socket("private");
        let local = Local::bind(&socket).await.unwrap();
        let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode() & 0o777;
        assert_eq!(mode(&socket.path), 0o600);
        assert_eq!(mode(socket.path.parent().unwrap()), 0o700);
        let (client, accepted) = tokio::join!(UnixStream::connect(&socket.path), local.accept());
        assert!(client.is_ok() && local.admits(&accepted.unwrap()));
        let error = Local::bind(&socket).await.unwrap_err().to_string();
        assert!(error.contains("taken by this process"), "{error}");
        drop(local);
        assert!(!socket.path.exists());
        std::fs::remove_dir(socket.path.parent().unwrap()).unwrap();
    }

    #[tokio::test]
    async fn stale_socket_is_replaced_other_file_kept() {
        let socket = socket("left");
        std::fs::create_dir(socket.path.parent().unwrap()).unwrap();
        drop(std::os::unix::net::UnixListener::bind(&socket.path).unwrap());
        drop(Local::bind(&socket).await.unwrap());
        std::fs::write(&socket.path, "precious").unwrap();
        let error = Local::bind(&socket).await.unwrap_err().to_string();
        assert!(error.contains("not a socket"), "{error}");
        assert_eq!(std::fs::read(&socket.path).unwrap(), b"precious");
        std::fs::remove_dir_all(socket.path.parent().unwrap()).unwrap();
    }

    #[test]
    fn group_id_reads_name_and_number() {
        assert_eq!(group_id("root").unwrap(), 0);
        assert_eq!(group_id("4711").unwrap(), 4711);
        let error = group_id("no such group").unwrap_err().to_string();
        assert!(error.contains("give its number"), "{error}");
    }
}
