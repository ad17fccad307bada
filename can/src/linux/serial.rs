//! The USB port of a Segway power base as the kernel's `ftdi_sio` shows it: a serial port that carries packets. Finding
//! the port and setting the chip's latency timer are left to udev.

use std::fs::{File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::fd::AsFd;
use std::os::unix::fs::OpenOptionsExt;
use std::time::Duration;

use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, ppoll};
use nix::sys::termios::{BaudRate, SetArg, cfmakeraw, cfsetspeed, tcgetattr, tcsetattr};
use nix::sys::time::TimeSpec;

use super::monotonic;
use crate::Frame;
use crate::rmp::{Channel, Packet, PacketReader};

/// Bytes read per system call.
const CHUNK: usize = 256;

/// The serial port of a power base.
#[derive(Debug)]
pub struct Serial {
    port: File,
    reader: PacketReader,
    bytes: [u8; CHUNK],
    next: usize,
    filled: usize,
}

impl Serial {
    /// Opens a port, such as `/dev/ttyUSB0`, with 460,800 Bd, 8N1, raw mode.
    pub fn open(path: &str) -> io::Result<Self> {
        let port = OpenOptions::new()
            .read(true)
            .write(true)
            .custom_flags(libc::O_NOCTTY | libc::O_NONBLOCK)
            .open(path)?;
        let mut settings = tcgetattr(&port)?;
        cfmakeraw(&mut settings);
        cfsetspeed(&mut settings, BaudRate::B460800)?;
        tcsetattr(&port, SetArg::TCSANOW, &settings)?;
        Ok(Self {
            port,
            reader: PacketReader::default(),
            bytes: [0; CHUNK],
            next: 0,
            filled: 0,
        })
    }

    /// Sends a frame without blocking.
    ///
    /// # Errors
    /// If the port does not accept the whole packet.
    pub fn send(&mut self, frame: &Frame) -> io::Result<()> {
        let Packet(bytes) = Packet::to_powerbase(frame);
        match self.port.write(&bytes)? {
            Packet::LEN => Ok(()),
            _ => Err(io::ErrorKind::WriteZero.into()),
        }
    }

    /// Waits at most `timeout` for a frame; returns the channel, the frame and the time of
    /// reception.
    pub fn receive(&mut self, timeout: Duration) -> io::Result<Option<(Channel, Frame, Duration)>> {
        let until = monotonic() + timeout;
        loop {
            if let Some((channel, frame)) = self.take_buffered() {
                return Ok(Some((channel, frame, monotonic())));
            }
            let left = until.saturating_sub(monotonic());
            self.fill(left)?;
            // Also after received bytes: noise must not extend the wait.
            if left.is_zero() {
                return Ok(self
                    .take_buffered()
                    .map(|(channel, frame)| (channel, frame, monotonic())));
            }
        }
    }

    fn take_buffered(&mut self) -> Option<(Channel, Frame)> {
        while let Some(byte) = self
            .bytes
            .get(self.next)
            .filter(|_| self.next < self.filled)
        {
            self.next += 1;
            if let Some(received) = self.reader.push(*byte).and_then(|packet| packet.decode()) {
                return Some(received);
            }
        }
        None
    }

    /// Reads available bytes; waits for them at most `timeout`.
    fn fill(&mut self, timeout: Duration) -> io::Result<()> {
        // Not `poll`: with its millisecond resolution the last millisecond of each wait becomes a
        // busy loop.
        let wait = TimeSpec::from_duration(timeout);
        let mut polled = [PollFd::new(self.port.as_fd(), PollFlags::POLLIN)];
        match ppoll(&mut polled, Some(wait), None) {
            Ok(0) | Err(Errno::EINTR) => return Ok(()),
            Ok(_) => {}
            Err(errno) => return Err(errno.into()),
        }
        match self.port.read(&mut self.bytes) {
            Ok(0) => Err(io::ErrorKind::UnexpectedEof.into()),
            Ok(len) => {
                (self.next, self.filled) = (0, len);
                Ok(())
            }
            Err(error)
                if matches!(
                    error.kind(),
                    io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted
                ) =>
            {
                Ok(())
            }
            Err(error) => Err(error),
        }
    }
}

#[cfg(test)]
mod tests {
    use nix::pty::openpty;

    use super::*;
    use crate::rmp::{Command, Message};

    #[test]
    fn serial_port_transfers_packets_both_directions() {
        let pty = openpty(None, None).unwrap();
        let name = nix::unistd::ttyname(&pty.slave).unwrap();
        let mut serial = Serial::open(name.to_str().unwrap()).unwrap();
        let mut other = File::from(pty.master);
        let command = Command {
            velocity: 100,
            turn: -7,
            ..Command::default()
        }
        .frame();
        serial.send(&command).unwrap();
        let mut bytes = [0; Packet::LEN];
        other.read_exact(&mut bytes).unwrap();
        assert_eq!(Packet(bytes).decode_host(), Some(command));
        let sent = Message::Wheels { left: 5, right: -5 }.frame();
        let packet = Packet::from_powerbase(Channel::B, &sent).0;
        other.write_all(&packet[3..]).unwrap();
        other.write_all(&packet).unwrap();
        let (channel, frame, _) = serial.receive(Duration::from_secs(5)).unwrap().unwrap();
        assert_eq!((channel, frame), (Channel::B, sent));
        assert_eq!(serial.receive(Duration::ZERO).unwrap(), None);
    }
}
