//! The Unix socket by which tools of this host reach the controller: the kernel says which account a client
//! is, so no token is needed. It reads no messages.

use std::io;
use std::os::unix::fs::{FileTypeExt as _, MetadataExt as _, PermissionsExt as _};
use std::path::{Path, PathBuf};

use tokio::net::{UnixListener, UnixStream};

use crate::error::Error;

/// Name of the socket in the directory of takt.
const NAME: &str = "takt.sock";

/// Where the service manager puts what exists only while a service runs.
const SERVICE_DIRECTORY: &str = "/run/takt";

/// Most bytes read of `/etc/group`.
const GROUPS_BYTES_MAX: u64 = 4 << 20;

/// A Unix socket to listen at.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LocalSocket {
    /// Where it is.
    pub path: PathBuf,
    /// Group, by name or number, whose accounts are admitted beside this process's own and root.
    pub group: Option<String>,
}

/// Where a controller of this process's account listens unless it is configured: in the directory that the
/// service manager made, else in that of the account's session, else in `/run/takt`.
#[must_use]
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

/// Where tools look for a controller: first one of the same account's session, then the service.
#[must_use]
pub fn client_paths() -> Vec<PathBuf> {
    let session = std::env::var_os("XDG_RUNTIME_DIR").filter(|value| !value.is_empty());
    let session = session.map(|directory| Path::new(&directory).join("takt").join(NAME));
    let service = Path::new(SERVICE_DIRECTORY).join(NAME);
    session.into_iter().chain([service]).collect()
}

/// A Unix socket that is listened at; its file goes with it.
#[derive(Debug)]
pub(super) struct Local {
    listener: UnixListener,
    path: PathBuf,
    /// Number of the socket's file, to know it from another controller's.
    inode: u64,
    /// Account of this process.
    uid: u32,
    /// Whether the socket's mode lets a group in, which the kernel checks when a client connects.
    has_group: bool,
}

impl Local {
    /// Begins to listen. A file that another controller left behind is replaced; one that somebody listens
    /// at is not.
    pub(super) async fn bind(socket: &LocalSocket) -> Result<Self, Error> {
        let path = &socket.path;
        let failed = |source| Error::Local {
            path: path.display().to_string(),
            source,
        };
        let gid = socket.group.as_deref().map(group_id).transpose();
        let gid = gid.map_err(failed)?;
        make_directory(path, gid).map_err(failed)?;
        remove_left_over(path).await.map_err(failed)?;
        // Nobody can connect by the right name before the mode is right.
        let mut fresh = path.clone().into_os_string();
        fresh.push(format!(".{}", std::process::id()));
        let fresh = PathBuf::from(fresh);
        let _ = std::fs::remove_file(&fresh);
        let listener = UnixListener::bind(&fresh).map_err(failed)?;
        let (uid, inode) = prepare(&fresh, path, gid).map_err(|error| {
            let _ = std::fs::remove_file(&fresh);
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

    /// Whether the account of a client is one that is admitted: this process's own, root, or of the group.
    pub(super) fn admits(&self, stream: &UnixStream) -> bool {
        let account = stream.peer_cred();
        account.is_ok_and(|a| a.uid() == self.uid || a.uid() == 0 || self.has_group)
    }
}

impl Drop for Local {
    fn drop(&mut self) {
        // Another controller that began at the same moment may have its own there.
        let found = std::fs::symlink_metadata(&self.path);
        if found.is_ok_and(|found| found.ino() == self.inode) {
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

/// Gives the socket its mode, owner and name; returns the account that it belongs to, and its file's number.
fn prepare(fresh: &Path, path: &Path, gid: Option<u32>) -> io::Result<(u32, u64)> {
    let mode = if gid.is_some() { 0o660 } else { 0o600 };
    std::fs::set_permissions(fresh, std::fs::Permissions::from_mode(mode))?;
    if gid.is_some() {
        std::os::unix::fs::chown(fresh, None, gid)?;
    }
    let made = std::fs::metadata(fresh)?;
    std::fs::rename(fresh, path)?;
    Ok((made.uid(), made.ino()))
}

/// Makes the directory of the socket, for this account and the group alone, if there is none.
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

async fn remove_left_over(path: &Path) -> io::Result<()> {
    let Ok(found) = std::fs::symlink_metadata(path) else {
        return Ok(());
    };
    if !found.file_type().is_socket() {
        let what = "there is a file of that name that is no socket";
        return Err(io::Error::new(io::ErrorKind::AlreadyExists, what));
    }
    match UnixStream::connect(path).await {
        Ok(_) => Err(io::Error::new(
            io::ErrorKind::AddrInUse,
            "another controller listens there",
        )),
        Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => {
            std::fs::remove_file(path)
        }
        Err(error) => Err(error),
    }
}

/// Number of a group of `/etc/group`.
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
    async fn socket_is_private_and_admits_its_account() {
        let socket = socket("private");
        let local = Local::bind(&socket).await.unwrap();
        let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode() & 0o777;
        assert_eq!(mode(&socket.path), 0o600);
        assert_eq!(mode(socket.path.parent().unwrap()), 0o700);
        let (client, accepted) = tokio::join!(UnixStream::connect(&socket.path), local.accept());
        assert!(client.is_ok() && local.admits(&accepted.unwrap()));
        let error = Local::bind(&socket).await.unwrap_err().to_string();
        assert!(error.contains("another controller listens"), "{error}");
        drop(local);
        assert!(!socket.path.exists());
        std::fs::remove_dir(socket.path.parent().unwrap()).unwrap();
    }

    #[tokio::test]
    async fn left_over_socket_is_replaced_but_no_other_file() {
        let socket = socket("left");
        std::fs::create_dir(socket.path.parent().unwrap()).unwrap();
        drop(std::os::unix::net::UnixListener::bind(&socket.path).unwrap());
        drop(Local::bind(&socket).await.unwrap());
        std::fs::write(&socket.path, "precious").unwrap();
        let error = Local::bind(&socket).await.unwrap_err().to_string();
        assert!(error.contains("no socket"), "{error}");
        assert_eq!(std::fs::read(&socket.path).unwrap(), b"precious");
        std::fs::remove_dir_all(socket.path.parent().unwrap()).unwrap();
    }

    #[test]
    fn groups_have_names_and_numbers() {
        assert_eq!(group_id("root").unwrap(), 0);
        assert_eq!(group_id("4711").unwrap(), 4711);
        let error = group_id("no such group").unwrap_err().to_string();
        assert!(error.contains("give its number"), "{error}");
    }
}
