//! `takt emulate rmp`: a Segway power base on a CAN interface, or at a pseudo-terminal in place of its USB port. Its
//! position is printed at the end.

use std::fs::File;
use std::io::{ErrorKind, Read as _, Write as _};
use std::os::fd::{AsFd as _, OwnedFd};
use std::os::unix::fs::OpenOptionsExt as _;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use anyhow::Context as _;
use clap::Args;
use nix::fcntl::OFlag;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::pty::{grantpt, posix_openpt, ptsname_r, unlockpt};
use nix::sys::termios::{FlushArg, tcflush};
use takt_can::linux::{Options, SocketCan, monotonic};
use takt_can::rmp::emulator::{Powerbase, PowerbaseConfig, serve};
use takt_can::rmp::{Channel, Model, Packet, PacketReader, YawSign};

use super::service::Service;
use crate::Verdict;
use crate::output::{complain, positive_span, say};
use crate::run::until_stopped;

/// A Segway power base.
#[derive(Debug, Args)]
pub(crate) struct Rmp {
    /// CAN interface; without it, a pseudo-terminal whose name is printed replaces the USB port.
    #[arg(long, value_name = "IFACE")]
    interface: Option<String>,
    /// `rmp50`, `rmp100`, `rmp200` or `rmp400`.
    #[arg(long, default_value = "rmp200", value_parser = model)]
    model: Model,
    /// The velocity scale that it has stored, 0 to 16.
    #[arg(long, value_name = "SIXTEENTHS", default_value_t = 12)]
    stored_scale: u8,
    /// Which way its integrated yaw (404h) counts: clockwise, or counter_clockwise.
    #[arg(long, value_name = "SIGN", default_value = "clockwise", value_parser = yaw_sign)]
    yaw_integral: YawSign,
    /// Its emergency stop is open.
    #[arg(long)]
    emergency_stop: bool,
    /// End after this time; without it, at Ctrl-C.
    #[arg(long, value_name = "TIME", value_parser = positive_span)]
    duration: Option<Duration>,
}

fn model(text: &str) -> Result<Model, String> {
    Model::named(text).ok_or_else(|| {
        let known = Model::ALL.map(Model::name).join(", ");
        format!("there is no such model; there are {known}")
    })
}

fn yaw_sign(text: &str) -> Result<YawSign, String> {
    YawSign::named(text).ok_or_else(|| {
        let known = YawSign::ALL.map(YawSign::name).join(" or ");
        format!("`{text}` is no sign: write {known}")
    })
}

impl Rmp {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let mut powerbase = Powerbase::new(PowerbaseConfig {
            model: self.model,
            start: monotonic(),
            yaw_integral: self.yaw_integral,
            ..PowerbaseConfig::default()
        });
        powerbase.store_scale(self.stored_scale);
        powerbase.faults.emergency_stop = self.emergency_stop;
        let dropped = Arc::new(AtomicU64::new(0));
        let service = match &self.interface {
            Some(name) => on_can(name, powerbase)?,
            None => on_terminal(powerbase, Arc::clone(&dropped))?,
        };
        until_stopped(self.duration, || service.check())?;
        let powerbase = service.stop()?;
        let pose = powerbase.truth();
        say(&format!(
            "stopped at {:.3} m, {:.3} m, turned by {:.3} rad",
            pose.x, pose.y, pose.heading
        ))?;
        let dropped = dropped.load(Ordering::Relaxed);
        if dropped > 0 {
            complain(&format!(
                "no program read the port: dropped its old packets {dropped} times"
            ));
        }
        Ok(Verdict::Good)
    }
}

fn on_can(name: &str, powerbase: Powerbase) -> anyhow::Result<Service<Powerbase>> {
    let mut socket = SocketCan::open(name, &Options::default()).with_context(|| {
        format!("cannot open {name}; is it a CAN interface? `ip link add {name} type vcan` makes one for a lab")
    })?;
    say(&format!("power base on {name}"))?;
    Service::start("rmp", powerbase, move |powerbase| {
        serve(powerbase, &mut socket, monotonic).context("the interface failed")
    })
}

/// Serves it at a pseudo-terminal. Old packets that no program reads are dropped, and that is counted.
fn on_terminal(
    powerbase: Powerbase,
    dropped: Arc<AtomicU64>,
) -> anyhow::Result<Service<Powerbase>> {
    let flags = OFlag::O_RDWR | OFlag::O_NOCTTY | OFlag::O_NONBLOCK;
    let master = posix_openpt(flags).context("cannot make a pseudo-terminal")?;
    grantpt(&master)
        .and_then(|()| unlockpt(&master))
        .context("cannot open the pseudo-terminal")?;
    let name = ptsname_r(&master).context("the pseudo-terminal has no name")?;
    // Held open: a pseudo-terminal whose slave is closed reports errors.
    let slave = File::options()
        .read(true)
        .write(true)
        .custom_flags(OFlag::O_NOCTTY.bits())
        .open(&name)
        .with_context(|| format!("cannot open {name}"))?;
    say(&format!("power base at {name}"))?;
    let mut port = File::from(OwnedFd::from(master));
    let mut reader = PacketReader::default();
    Service::start("rmp", powerbase, move |powerbase| {
        receive(&mut port, &mut reader, powerbase)?;
        while let Some((channel, frame)) = powerbase.poll_transmit(monotonic()) {
            let Packet(bytes) = Packet::from_powerbase(channel, &frame);
            if channel == Channel::A {
                match port.write_all(&bytes) {
                    Err(error) if error.kind() == ErrorKind::WouldBlock => {
                        dropped.fetch_add(1, Ordering::Relaxed);
                        // A program that reads later gets the present state, not the oldest one.
                        tcflush(&slave, FlushArg::TCIFLUSH).context("the terminal failed")?;
                    }
                    written => written.context("the terminal failed")?,
                }
            }
        }
        Ok(())
    })
}

fn receive(
    port: &mut File,
    reader: &mut PacketReader,
    powerbase: &mut Powerbase,
) -> anyhow::Result<()> {
    let mut polled = [PollFd::new(port.as_fd(), PollFlags::POLLIN)];
    let ready = poll(&mut polled, PollTimeout::from(1_u8)).context("cannot wait")?;
    if ready == 0 {
        return Ok(());
    }
    let mut bytes = [0; 256];
    let len = port.read(&mut bytes).context("the terminal failed")?;
    for byte in &bytes[..len] {
        let packet = reader.push(*byte);
        if let Some(frame) = packet.and_then(|packet| packet.decode_host()) {
            powerbase.handle_frame(&frame, monotonic());
        }
    }
    Ok(())
}
