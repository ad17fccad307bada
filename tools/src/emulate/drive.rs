//! `takt emulate drive`: a CANopen node around a CiA 402 drive on a CAN interface, with its data sheet.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::Context as _;
use clap::Args;
use takt_can::canopen::NodeId;
use takt_can::canopen::emulator::{DriveNode, DriveNodeConfig};
use takt_can::canopen::node::NodeQuirks;
use takt_can::linux::monotonic;
use takt_cia402::emulator::{DriveConfig, Quirks};

use super::canopen;
use super::faults::{Fault, of_drive};
use crate::Verdict;
use crate::output::{positive_span, save, say, span, span_of_ms};

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
    /// Time between heartbeats, 1ms to 65535ms; none without it.
    #[arg(long, value_name = "TIME", value_parser = span_of_ms(1..=65_535))]
    heartbeat: Option<Duration>,
    /// Let it behave as real nodes were seen to; may be given several times.
    ///
    /// Of the node: late-boot-up, slow-boot-up, slow-sdo, stale-answers, noise, cob-bits-set, cob-bits-clear, no-6502h,
    /// repeated-answers, serial-1. Of its axes: epos4, ax8000, ssc-5.11, el7411, halt-before-mode, mis, dm556ec,
    /// never-remote, reached-in-fault, faults-on-enable.
    #[arg(long, value_name = "NAME", value_parser = quirk)]
    quirk: Vec<String>,
    /// A fault, when it begins after the start, and for how long. May be given several times.
    ///
    /// Of the node: off, heartbeat-off, sdo-silent, wrong-map, boot-loop[=TIME], emergency-storm[=CODE], number=N. Of its
    /// axes: error[=CODE] (603Fh, hexadecimal), halt (bit 8 of 6040h by another program), local, interlock.
    #[arg(long, value_name = "WHAT[@START[+LENGTH]]", value_parser = of_drive)]
    fault: Vec<Fault>,
    /// 605Ah after a reset: 0 coasts, 1 to 4 brake and switch off, 5 to 8 brake and stay in Quick stop active.
    #[arg(long, value_name = "CODE", allow_hyphen_values = true)]
    quick_stop: Option<i16>,
    /// Interpolation time (60C2h) after a reset; without it that of SYNC, until the master writes it.
    #[arg(long, value_name = "TIME", value_parser = interpolation)]
    interpolation: Option<(u8, i8)>,
    /// Timeout of its SDO server.
    #[arg(long, value_name = "TIME", default_value = "2s", value_parser = span)]
    sdo_timeout: Duration,
    /// Write its data sheet and end.
    #[arg(long, value_name = "FILE.eds")]
    write_eds: Option<PathBuf>,
    /// End after this time; without it, at Ctrl-C.
    #[arg(long, value_name = "TIME", value_parser = positive_span)]
    duration: Option<Duration>,
}

impl DriveArgs {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let id = NodeId::new(self.node).context("a node number is 1 to 127")?;
        let heartbeat = self.heartbeat.unwrap_or_default().as_millis();
        let mut config = DriveNodeConfig {
            axes: vec![DriveConfig::default(); self.axes.into()],
            heartbeat_ms: u16::try_from(heartbeat).context("a heartbeat is at most 65s apart")?,
            sdo_timeout: self.sdo_timeout,
            ..DriveNodeConfig::new(id)
        };
        for name in &self.quirk {
            config.add_quirk(name);
        }
        for axis in &mut config.axes {
            axis.quirks.defaults.0 = self.quick_stop.unwrap_or(axis.quirks.defaults.0);
            axis.interpolation = self.interpolation;
        }
        if let Some(path) = &self.write_eds {
            save(path, config.eds().print())?;
            return Ok(Verdict::Good);
        }
        let socket = canopen::open(&self.interface)?;
        let node = DriveNode::power_on(config, monotonic())
            .context("the configuration of the drive is invalid")?;
        say(&format!("drive {} on {}", self.node, self.interface))?;
        canopen::serve("drive", node, socket, &self.fault, self.duration)?;
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

/// A time in the format of 60C2h: value and decimal exponent of seconds.
fn interpolation(text: &str) -> Result<(u8, i8), String> {
    let time = span(text)?;
    takt_can::canopen::network::time_index(time)
        .ok_or_else(|| format!("60C2h cannot hold `{text}`: at most 255 units of 1 us to 1 ms"))
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
