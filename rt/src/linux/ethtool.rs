//! Settings and capabilities of a network adapter: interrupt coalescing, receive offloads, energy saving,
//! flow control, time stamping. They affect latency on a field bus as much as the scheduler does, and
//! sysfs shows none of them.
//!
//! It never changes settings: a reconfigured adapter may drop its link, so that decision is the user's.
#![expect(unsafe_code, reason = "the ioctl SIOCETHTOOL has no safe wrapper")]

use std::{
    ffi::c_char,
    io,
    os::fd::{AsRawFd as _, OwnedFd},
};

use nix::errno::Errno;

use super::interface;

/// Commands of `linux/ethtool.h`; each answer is a structure of 32-bit words that begins with the command.
mod command {
    pub(super) const COALESCING: u32 = 0x0e;
    pub(super) const PAUSE: u32 = 0x12;
    pub(super) const FLAGS: u32 = 0x25;
    pub(super) const GRO: u32 = 0x2b;
    pub(super) const TIME_STAMPING: u32 = 0x41;
    pub(super) const EEE: u32 = 0x44;
}

/// Bit of large receive offload in the answer of the flags.
const FLAG_LRO: u32 = 1 << 15;

/// Size of an answer in 32-bit words. The longest of the commands above, coalescing, needs 23.
const WORDS: usize = 64;

/// One network interface. Each query is a system call; drivers reject unsupported ones (`EOPNOTSUPP`).
#[derive(Debug)]
pub struct Ethtool {
    socket: OwnedFd,
    name: [c_char; libc::IFNAMSIZ],
}

/// Interrupt coalescing: delay and number of frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Coalescing {
    /// Longest delay after a received frame, in µs; 0 for none.
    pub rx_usecs: u32,
    /// Received frames that end the delay; 0 if only time does, 1 for an interrupt each.
    pub rx_frames: u32,
    /// Longest delay after a sent frame, in µs; 0 for none.
    pub tx_usecs: u32,
    /// Whether the driver adapts the values for reception.
    pub adaptive_rx: bool,
    /// Whether the driver adapts the values for transmission.
    pub adaptive_tx: bool,
}

/// Energy-efficient Ethernet (IEEE 802.3az): the link sleeps between frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EnergyEfficient {
    /// Enabled on this host.
    pub enabled: bool,
    /// Active: the link partner supports it too.
    pub active: bool,
}

/// Flow control (IEEE 802.3x): sending and honouring pause frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pause {
    /// Honours received pause frames.
    pub rx: bool,
    /// Sends pause frames.
    pub tx: bool,
}

/// Time stamps available by `SO_TIMESTAMPING`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TimeStamping {
    /// By the kernel, when it passes a frame to the adapter.
    pub software_transmit: bool,
    /// By the kernel, on reception of a frame.
    pub software_receive: bool,
    /// By the adapter, on the wire.
    pub hardware_transmit: bool,
    /// By the adapter, on the wire.
    pub hardware_receive: bool,
    /// Number of the adapter's clock, as in `/dev/ptp0`.
    pub clock: Option<u32>,
}

impl Ethtool {
    /// Opens a query socket for an interface; the first query shows whether the interface exists.
    ///
    /// # Errors
    /// If the name is longer than 15 bytes or contains a zero byte, or no socket can be opened.
    pub fn open(interface: &str) -> io::Result<Self> {
        Ok(Self {
            name: interface::packed(interface)?,
            socket: interface::question_socket()?,
        })
    }

    /// Interrupt coalescing.
    pub fn coalescing(&self) -> io::Result<Coalescing> {
        let words = self.ask(command::COALESCING)?;
        Ok(Coalescing {
            rx_usecs: words[1],
            rx_frames: words[2],
            tx_usecs: words[5],
            adaptive_rx: words[10] != 0,
            adaptive_tx: words[11] != 0,
        })
    }

    /// Generic receive offload: whether the kernel merges frames before a program sees them.
    pub fn generic_receive_offload(&self) -> io::Result<bool> {
        Ok(self.ask(command::GRO)?[1] != 0)
    }

    /// Large receive offload: whether the adapter merges frames.
    pub fn large_receive_offload(&self) -> io::Result<bool> {
        Ok(self.ask(command::FLAGS)?[1] & FLAG_LRO != 0)
    }

    /// Energy-efficient Ethernet.
    pub fn energy_efficient(&self) -> io::Result<EnergyEfficient> {
        let words = self.ask(command::EEE)?;
        Ok(EnergyEfficient {
            active: words[4] != 0,
            enabled: words[5] != 0,
        })
    }

    /// Flow control.
    pub fn pause(&self) -> io::Result<Pause> {
        let words = self.ask(command::PAUSE)?;
        Ok(Pause {
            rx: words[2] != 0,
            tx: words[3] != 0,
        })
    }

    /// Available time stamps.
    pub fn time_stamping(&self) -> io::Result<TimeStamping> {
        Ok(time_stamping(&self.ask(command::TIME_STAMPING)?))
    }

    fn ask(&self, command: u32) -> io::Result<[u32; WORDS]> {
        let mut words = [0; WORDS];
        words[0] = command;
        let mut request = libc::ifreq {
            ifr_name: self.name,
            ifr_ifru: libc::__c_anonymous_ifr_ifru {
                ifru_data: words.as_mut_ptr().cast::<c_char>(),
            },
        };
        // SAFETY: the request is live and refers to a live buffer; the kernel writes the answer of a
        // command at its fixed length, which for all of `command` is below that of `words`.
        let status =
            unsafe { libc::ioctl(self.socket.as_raw_fd(), libc::SIOCETHTOOL, &raw mut request) };
        Errno::result(status)?;
        Ok(words)
    }
}

/// Word 1 is a set of `SOF_TIMESTAMPING_*`, word 2 the clock's number or -1.
fn time_stamping(words: &[u32; WORDS]) -> TimeStamping {
    let has = |bit: u32| words[1] & bit != 0;
    let clock = i32::from_ne_bytes(words[2].to_ne_bytes());
    TimeStamping {
        hardware_transmit: has(libc::SOF_TIMESTAMPING_TX_HARDWARE),
        software_transmit: has(libc::SOF_TIMESTAMPING_TX_SOFTWARE),
        hardware_receive: has(libc::SOF_TIMESTAMPING_RX_HARDWARE),
        software_receive: has(libc::SOF_TIMESTAMPING_RX_SOFTWARE),
        clock: u32::try_from(clock).ok(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ethtool_loopback_stamps_in_software_only() {
        let stamping = Ethtool::open("lo").unwrap().time_stamping().unwrap();
        assert!(stamping.software_receive && !stamping.hardware_receive);
        assert_eq!(stamping.clock, None);
    }

    #[test]
    fn ethtool_missing_interface_is_an_error() {
        let nowhere = Ethtool::open("nowhere0").unwrap();
        let error = nowhere.coalescing().unwrap_err();
        assert_eq!(error.raw_os_error(), Some(libc::ENODEV));
        assert!(Ethtool::open("a-name-of-sixteen").is_err());
        assert!(Ethtool::open("a\0b").is_err());
    }

    #[test]
    fn ethtool_adapter_clock_is_read() {
        let mut words = [0; WORDS];
        words[1] = libc::SOF_TIMESTAMPING_TX_HARDWARE | libc::SOF_TIMESTAMPING_RX_HARDWARE;
        let stamping = time_stamping(&words);
        assert!(stamping.hardware_transmit && stamping.hardware_receive);
        assert!(!stamping.software_transmit);
        assert_eq!(stamping.clock, Some(0));
        words[2] = u32::MAX;
        assert_eq!(time_stamping(&words).clock, None);
    }
}
