//! The TCP port of an emulated gripper, which accepts one client at a time, as the real one.

use std::io::{self, ErrorKind, Read as _, Write as _};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::os::fd::AsFd as _;
use std::time::Duration;

use super::Gripper;

/// Longest wait for input: the fingers move in steps of that time.
const WAIT: Duration = Duration::from_millis(2);

/// A port and its client.
#[derive(Debug)]
pub struct Port {
    listener: TcpListener,
    stream: Option<TcpStream>,
}

impl Port {
    /// Listens at an address; port 0 selects any free one.
    ///
    /// # Errors
    /// Of the operating system.
    pub fn listen(address: SocketAddr) -> io::Result<Self> {
        let listener = TcpListener::bind(address)?;
        listener.set_nonblocking(true)?;
        Ok(Self {
            listener,
            stream: None,
        })
    }

    /// Its address.
    ///
    /// # Errors
    /// Of the operating system.
    pub fn address(&self) -> io::Result<SocketAddr> {
        self.listener.local_addr()
    }

    /// The time by which a served gripper moves.
    #[must_use]
    pub fn now() -> Duration {
        Duration::from_nanos(u64::try_from(takt_rt::monotonic().0).unwrap_or(0))
    }

    /// Ends the connection without a word, as a pulled cable does.
    pub fn cut(&mut self, gripper: &mut Gripper) {
        self.stream = None;
        gripper.handle_disconnect();
    }

    /// Serves a gripper for a moment.
    ///
    /// # Errors
    /// Of the operating system, if no client can be accepted.
    pub fn serve(&mut self, gripper: &mut Gripper) -> io::Result<()> {
        if self.stream.is_none() {
            self.stream = self.accept()?;
        }
        if self.stream.is_none() {
            // Fails only for invalid times.
            takt_rt::sleep_until(takt_rt::monotonic() + WAIT.into()).ok();
            gripper.step(Self::now());
        } else if !self.exchange(gripper) {
            self.stream = None;
        }
        Ok(())
    }

    fn accept(&self) -> io::Result<Option<TcpStream>> {
        match self.listener.accept() {
            Ok((stream, _)) => {
                stream.set_nonblocking(false)?;
                stream.set_nodelay(true)?;
                Ok(Some(stream))
            }
            Err(error) if error.kind() == ErrorKind::WouldBlock => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Receives and answers for a moment; false once the connection is closed.
    fn exchange(&mut self, gripper: &mut Gripper) -> bool {
        let Some(stream) = &mut self.stream else {
            return false;
        };
        let mut bytes = [0; 512];
        let received = match takt_rt::readable(stream.as_fd(), WAIT) {
            Ok(false) => Ok(0),
            Ok(true) => match stream.read(&mut bytes) {
                Ok(0) => Err(ErrorKind::UnexpectedEof.into()),
                received => received,
            },
            Err(error) => Err(error),
        };
        let Ok(len) = received else {
            gripper.step(Self::now());
            gripper.handle_disconnect();
            return false;
        };
        let received = bytes.get(..len).unwrap_or_default();
        let said_goodbye = gripper.handle_bytes(received, Self::now());
        let written = stream.write_all(&gripper.transmit());
        !said_goodbye && written.is_ok()
    }
}
