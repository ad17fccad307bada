//! Who listens at a Unix socket, for errors: a path that is taken names its owner, as a taken port does. It opens no socket.

use std::io;
use std::os::fd::AsFd;

use nix::sys::socket::{getsockopt, sockopt::PeerCredentials};

/// The error of a socket whose path is taken, by the process that answers at `connected`.
pub fn taken(connected: &impl AsFd) -> io::Error {
    let owner = getsockopt(connected, PeerCredentials).ok();
    // Processes of another namespace have no number here.
    let pid = owner.and_then(|owner| u32::try_from(owner.pid()).ok().filter(|pid| *pid > 0));
    let text = match pid {
        Some(pid) if pid == std::process::id() => "taken by this process".to_owned(),
        Some(pid) => {
            let name = std::fs::read_to_string(format!("/proc/{pid}/comm"));
            let name = name.as_deref().unwrap_or("?").trim_end();
            format!("taken by `{name}` (process {pid})")
        }
        None => "taken by another process".to_owned(),
    };
    io::Error::new(io::ErrorKind::AddrInUse, text)
}

#[cfg(test)]
mod tests {
    use std::os::unix::net::UnixStream;

    use super::*;

    #[test]
    fn taken_socket_of_this_process_says_so() {
        let (ours, _) = UnixStream::pair().unwrap();
        let error = taken(&ours);
        assert_eq!(error.kind(), io::ErrorKind::AddrInUse);
        assert_eq!(error.to_string(), "taken by this process");
        let file = std::fs::File::open("/proc/self/comm").unwrap();
        assert_eq!(taken(&file).to_string(), "taken by another process");
    }
}
