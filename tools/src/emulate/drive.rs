//! `takt emulate drive`: a CANopen node around a CiA 402 drive on a CAN interface, with its data sheet.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::Context as _;
use clap::Args;
use takt_can::canopen::NodeId;
use takt_can::canopen::emulator::{DriveNode, DriveNodeConfig};
use takt_can::canopen::node::NodeQuirks;
use takt_can::link::{Link as _, LinkError};
use takt_can::linux::{Options, SocketCan, monotonic};
use takt_cia402::emulator::{DriveConfig, Quirks};

use super::service::Service;
use crate::Verdict;
use crate::output::{save, say, span};
use crate::run::until_stopped;

/// Longest wait for a frame: the motor's step.
const WAIT: Duration = Duration::from_millis(1);

/// A CANopen drive.
#[derive(Debug, Args)]
pub(crate) struct DriveArgs {
    /// CAN interface.
    #[arg(long, value_name = "IFACE")]
    interface: String,
    /// Node number, 1 to 127.
    #[arg(long, default_value_t = 1)]
    node: u8,
    /// Axes, 1 to 8.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=8))]
    axes: u8,
    /// Time between heartbeats; none without it.
    #[arg(long, value_name = "TIME", value_parser = span)]
    heartbeat: Option<Duration>,
    /// Let it behave as real nodes were seen to; may be given several times.
    ///
    /// Of the node: late-boot-up, slow-boot-up, slow-sdo, stale-answers, noise, cob-bits-set, cob-bits-clear, no-6502h,
    /// repeated-answers, serial-1. Of its axes: epos4, ax8000, ssc-5.11, el7411, halt-before-mode, mis, dm556ec,
    /// never-remote, reached-in-fault, faults-on-enable.
    #[arg(long, value_name = "NAME", value_parser = quirk)]
    quirk: Vec<String>,
    /// Write its data sheet and end.
    #[arg(long, value_name = "FILE.eds")]
    write_eds: Option<PathBuf>,
    /// End after this time; without it, at Ctrl-C.
    #[arg(long, value_name = "TIME", value_parser = span)]
    duration: Option<Duration>,
}

impl DriveArgs {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let id = NodeId::new(self.node).context("a node number is 1 to 127")?;
        let heartbeat = self.heartbeat.unwrap_or_default().as_millis();
        let mut config = DriveNodeConfig {
            axes: vec![DriveConfig::default(); self.axes.into()],
            heartbeat_ms: u16::try_from(heartbeat).context("a heartbeat is at most 65s apart")?,
            ..DriveNodeConfig::new(id)
        };
        for name in &self.quirk {
            config.add_quirk(name);
        }
        if let Some(path) = &self.write_eds {
            save(path, config.eds().print())?;
            return Ok(Verdict::Good);
        }
        let mut socket = SocketCan::open(&self.interface, &Options::default())
            .with_context(|| format!("cannot open {}; is it a CAN interface?", self.interface))?;
        let node = DriveNode::power_on(config, monotonic())
            .context("the configuration of the drive is invalid")?;
        say(&format!("drive {} on {}", self.node, self.interface))?;
        let service = Service::start("drive", node, move |node| {
            turn(node, &mut socket).context("the interface failed")
        })?;
        until_stopped(self.duration, || service.check())?;
        let node = service.stop()?;
        say(&format!("ended {:?}", node.state()))?;
        Ok(Verdict::Good)
    }
}

/// Reads the name of a quirk of the command line.
fn quirk(name: &str) -> Result<String, String> {
    let known = DriveNodeConfig::new(NodeId::LAST).add_quirk(name);
    let all = [
        &NodeQuirks::NAMES[1..],
        &DriveNodeConfig::QUIRKS,
        &Quirks::NAMES[1..],
    ];
    let all = || all.concat().join(", ");
    known
        .then(|| name.to_owned())
        .ok_or_else(|| format!("`{name}` is no quirk; those are {}", all()))
}

fn turn(node: &mut DriveNode, socket: &mut SocketCan) -> Result<(), LinkError> {
    if let Some(received) = socket.receive(WAIT)?
        && let Some(frame) = received.frame.classic()
    {
        node.handle_frame(frame, monotonic());
    }
    while let Some(frame) = node.poll_transmit(monotonic()) {
        match socket.send(&frame.into()) {
            Ok(()) | Err(LinkError::QueueFull) => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use clap::Args as _;

    use super::*;

    #[test]
    fn quirk_names_are_all_in_the_help() {
        let mut command = DriveArgs::augment_args(clap::Command::new("drive"));
        let help = command.render_long_help().to_string().replace('\n', " ");
        for name in NodeQuirks::NAMES.into_iter().chain(Quirks::NAMES) {
            let plain = matches!(name, "none" | "profile");
            assert!(plain || help.contains(name), "{name}");
            assert!(quirk(name).is_ok());
        }
        for name in DriveNodeConfig::QUIRKS {
            assert!(help.contains(name) && quirk(name).is_ok(), "{name}");
        }
        assert!(quirk("nonsense").unwrap_err().contains("late-boot-up"));
    }
}
