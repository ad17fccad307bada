//! One master at an interface: a lock that all programs of Takt take before they send on it, and that names its holder.
//! It does not exclude masters of other vendors; [`super::PacketLink::listen_first`] detects those.
//!
//! The lock is a listening socket with an abstract name (unix(7)), not a file: such names belong to the network
//! namespace as the interface does, need no folder that every user may write to, vanish with the process however it
//! ends, and identify the holder by its credentials. The disadvantage: any program on this host can take the name
//! before the controller does; the error then names that program.

use std::fmt;
use std::io;
use std::os::fd::AsRawFd;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixListener};

use nix::sys::socket::{
    AddressFamily, SockFlag, SockType, UnixAddr, connect, getsockopt, socket, sockopt,
};

/// Keeps other programs of Takt from an interface as long as it lives.
#[derive(Debug)]
pub struct InterfaceLock {
    _held: UnixListener,
}

/// Who holds a lock.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Holder {
    /// Its process, if it can be seen from here.
    pub pid: Option<i32>,
    /// Its command line.
    pub command: String,
}

impl fmt::Display for Holder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.pid {
            Some(pid) => write!(f, "`{}`, process {pid}", self.command),
            None => f.write_str("a process that cannot be seen from here"),
        }
    }
}

fn name_of(interface: &str) -> Vec<u8> {
    [b"takt/ethercat/", interface.as_bytes()].concat()
}

impl InterfaceLock {
    /// Takes the lock of an interface.
    ///
    /// # Errors
    /// If another program has it (`AddrInUse`); the text names it.
    pub fn take(interface: &str) -> io::Result<Self> {
        let address = SocketAddr::from_abstract_name(name_of(interface))?;
        match UnixListener::bind_addr(&address) {
            Ok(held) => Ok(Self { _held: held }),
            Err(error) if error.kind() == io::ErrorKind::AddrInUse => {
                let holder = holder(interface);
                let text = format!(
                    "{interface}: in use by {holder}\nhint: stop it first (`systemctl stop takt` if it is the service): two \
                     masters at one segment destroy each other's frames"
                );
                Err(io::Error::new(io::ErrorKind::AddrInUse, text))
            }
            Err(error) => Err(error),
        }
    }
}

/// The process that listens there. The query never blocks; a full queue gives no answer.
fn holder(interface: &str) -> Holder {
    let pid = (|| {
        let flags = SockFlag::SOCK_NONBLOCK | SockFlag::SOCK_CLOEXEC;
        let asking = socket(AddressFamily::Unix, SockType::Stream, flags, None).ok()?;
        let address = UnixAddr::new_abstract(&name_of(interface)).ok()?;
        connect(asking.as_raw_fd(), &address).ok()?;
        let peer = getsockopt(&asking, sockopt::PeerCredentials).ok()?;
        Some(peer.pid()).filter(|pid| *pid > 0)
    })();
    let command = pid.map_or_else(String::new, |pid| {
        let line = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
        let words = line
            .split(|byte| *byte == 0)
            .filter(|word| !word.is_empty());
        let words: Vec<_> = words.map(String::from_utf8_lossy).collect();
        words.join(" ")
    });
    Holder { pid, command }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn locked_interface_is_refused_with_its_holder() {
        let interface = format!("lock{}", std::process::id());
        let held = InterfaceLock::take(&interface).unwrap();
        // More than a listening socket keeps waiting: the last ones learn nothing, and none waits.
        for number in 0..300 {
            let error = InterfaceLock::take(&interface).unwrap_err();
            assert_eq!(error.kind(), io::ErrorKind::AddrInUse);
            let text = error.to_string();
            let this = format!("process {}\nhint: stop it first", std::process::id());
            assert!(number > 0 || text.contains(&this), "{text}");
            assert!(
                text.starts_with(&format!("{interface}: in use by ")),
                "{text}"
            );
        }
        let other = InterfaceLock::take(&format!("{interface}b")).unwrap();
        drop(held);
        InterfaceLock::take(&interface).unwrap();
        drop(other);
    }
}
