//! A TAP: a network interface whose other end is this process. Any master on this host reaches an emulated segment
//! behind it without a second interface. It does not bring the interface up: use `ip link set NAME up`.
#![expect(unsafe_code, reason = "no crate of the workspace wraps TUNSETIFF")]

use std::fs::{File, OpenOptions};
use std::io;
use std::os::fd::{AsFd, AsRawFd};
use std::os::unix::fs::OpenOptionsExt;
use std::time::Duration;

use nix::errno::Errno;
use takt_link::linux::{monotonic, readable};

use crate::link::Link;

/// The process's side of a TAP; the interface exists as long as this value.
#[derive(Debug)]
pub struct TapLink {
    file: File,
}

impl TapLink {
    /// Makes the interface of that name (up to 15 bytes). Needs CAP_NET_ADMIN, but for a TAP that was made for this user
    /// before (`ip tuntap add NAME mode tap user USER`).
    pub fn open(name: &str) -> io::Result<Self> {
        let mut request = request(name)?;
        let with_context = |text: &str, error: io::Error| {
            io::Error::new(error.kind(), format!("{name}: {text}: {error}"))
        };
        let mut options = OpenOptions::new();
        let options = options.read(true).write(true);
        let file = options
            .custom_flags(libc::O_NONBLOCK)
            .open("/dev/net/tun")
            .map_err(|error| with_context("no /dev/net/tun (`modprobe tun`)", error))?;
        // SAFETY: the descriptor is that of /dev/net/tun, and the pointer is to a whole ifreq that lives over the call,
        // which is what TUNSETIFF reads and writes.
        let done = unsafe { libc::ioctl(file.as_raw_fd(), libc::TUNSETIFF, &raw mut request) };
        if done < 0 {
            let error = io::Error::last_os_error();
            return Err(with_context(
                "no TAP: run as root, or make it for this user",
                error,
            ));
        }
        Ok(Self { file })
    }

    fn take(&self, buf: &mut [u8]) -> io::Result<Option<(usize, Duration)>> {
        match nix::unistd::read(&self.file, buf) {
            Ok(len) => Ok(Some((len, monotonic()?))),
            // The interface is down: nothing is received, as with an unplugged cable.
            Err(Errno::EAGAIN | Errno::EINTR | Errno::EIO) => Ok(None),
            Err(error) => Err(error.into()),
        }
    }
}

/// The request: a TAP of this name, frames without a prefix.
fn request(name: &str) -> io::Result<libc::ifreq> {
    let mut ifr_name = [0; libc::IFNAMSIZ];
    let fits = !name.is_empty() && name.len() < ifr_name.len() && !name.contains('\0');
    if !fits {
        let text = format!("{name:?} is no name of an interface: write 1 to 15 bytes");
        return Err(io::Error::new(io::ErrorKind::InvalidInput, text));
    }
    for (to, from) in ifr_name.iter_mut().zip(name.bytes()) {
        *to = libc::c_char::from_ne_bytes([from]);
    }
    let flags = i16::try_from(libc::IFF_TAP | libc::IFF_NO_PI).unwrap_or_default();
    Ok(libc::ifreq {
        ifr_name,
        ifr_ifru: libc::__c_anonymous_ifr_ifru { ifru_flags: flags },
    })
}

impl Link for TapLink {
    fn send(&mut self, frame: &[u8]) -> io::Result<usize> {
        match nix::unistd::write(&self.file, frame) {
            Ok(len) => Ok(len),
            // While the interface is down, frames are dropped.
            Err(Errno::EIO) => Ok(0),
            Err(error) => Err(error.into()),
        }
    }

    fn receive(
        &mut self,
        buf: &mut [u8],
        timeout: Duration,
    ) -> io::Result<Option<(usize, Duration)>> {
        if let Some(received) = self.take(buf)? {
            return Ok(Some(received));
        }
        if timeout.is_zero() {
            return Ok(None);
        }
        if readable(self.file.as_fd(), timeout)? {
            self.take(buf)
        } else {
            Ok(None)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tap_invalid_interface_name_is_rejected() {
        for name in ["", "an-interface-too-long", "a\0b"] {
            let error = TapLink::open(name).unwrap_err().to_string();
            assert!(error.contains("is no name of an interface"), "{error}");
        }
    }
}
