//! `takt emulate wsg`: a Schunk WSG gripper that accepts one client over TCP. The gripper is in `takt-device-wsg`.

use std::net::SocketAddr;
use std::time::Duration;

use anyhow::Context as _;
use clap::Args;
use takt_devices::wsg::emulator::{Gripper, GripperConfig, Port};

use super::service::Service;
use crate::Verdict;
use crate::output::{say, span};
use crate::run::until_stopped;

/// A Schunk WSG gripper.
#[derive(Debug, Args)]
pub(crate) struct Wsg {
    /// Address of its command interface.
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:1000")]
    listen: SocketAddr,
    /// Width of the part between the fingers, mm; without it, there is none.
    #[arg(long, value_name = "MM")]
    part: Option<f64>,
    /// It answers nothing.
    #[arg(long)]
    silent: bool,
    /// The checksums of its answers are wrong.
    #[arg(long)]
    bad_checksum: bool,
    /// It reports a temperature fault.
    #[arg(long)]
    fault: bool,
    /// A lost connection does not stop it.
    #[arg(long)]
    ignore_disconnect: bool,
    /// End after this time; without it, at Ctrl-C.
    #[arg(long, value_name = "TIME", value_parser = span)]
    duration: Option<Duration>,
}

impl Wsg {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let mut port = Port::listen(self.listen).with_context(|| {
            format!(
                "cannot listen at {}; is another program there? `--listen` takes another address",
                self.listen
            )
        })?;
        say(&format!("gripper at {}", port.address()?))?;
        let mut gripper = Gripper::new(GripperConfig::default(), Port::now());
        gripper.knobs.part = self.part;
        gripper.knobs.silent = self.silent;
        gripper.knobs.bad_checksum = self.bad_checksum;
        gripper.knobs.faults = if self.fault { 1 << 14 } else { 0 };
        gripper.knobs.ignores_disconnect = self.ignore_disconnect;
        let service = Service::start("wsg", gripper, move |gripper| {
            port.serve(gripper).context("the port failed")
        })?;
        until_stopped(self.duration, || service.check())?;
        let gripper = service.stop()?;
        say(&format!("stopped at a width of {:.1} mm", gripper.width()))?;
        Ok(Verdict::Good)
    }
}
