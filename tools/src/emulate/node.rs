//! `takt emulate node`: a CANopen device of any kind on a CAN interface, from its data sheet, with process data that move.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::Context as _;
use clap::Args;
use takt_can::canopen::NodeId;
use takt_can::canopen::emulator::{Generators, GenericConfig, GenericNode, Signal, signals};
use takt_can::canopen::node::{Node, NodeQuirks};
use takt_can::linux::monotonic;
use takt_cia402::dictionary::Address;

use super::canopen;
use super::faults::{Ailing, Fault, Kind, ail_node, of_node};
use crate::Verdict;
use crate::can::sheet;
use crate::output::{say, span};

/// A CANopen device of any kind, from its data sheet (EDS) or configuration (DCF).
///
/// It has the objects, the SDO server, the PDOs, the heartbeat, NMT and LSS of the data sheet; a DCF sets its values too.
/// The objects in its enabled TPDOs move by a sine, unless --signal or --still say otherwise.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt emulate node --eds io.eds --node 5 --interface vcan0
  takt emulate node --eds io.dcf --interface vcan0 --signal 6401:01=ramp:0:500:2s
  takt emulate node --eds io.eds --node 5 --interface vcan0 --fault sdo-silent@5s+2s")]
pub(crate) struct NodeArgs {
    /// Its data sheet or configuration.
    #[arg(long, value_name = "FILE")]
    eds: PathBuf,
    /// CAN interface.
    #[arg(long, value_name = "IFACE")]
    interface: String,
    /// Node number, 1 to 127; default: that of a DCF.
    #[arg(long)]
    node: Option<u8>,
    /// Time between heartbeats; default: 1017h of the data sheet.
    #[arg(long, value_name = "TIME", value_parser = span)]
    heartbeat: Option<Duration>,
    /// Let an object move: WAVE is sine, ramp, triangle, square, constant or noise; LOW and HIGH are its ends, PERIOD its
    /// period (default 2s). May be given several times.
    #[arg(long, value_name = "OBJECT=WAVE[:LOW:HIGH[:PERIOD]]", value_parser = signal)]
    signal: Vec<Signal>,
    /// Nothing moves unless --signal says so.
    #[arg(long)]
    still: bool,
    /// Time between two values of all signals.
    #[arg(long, value_name = "TIME", default_value = "10ms", value_parser = span)]
    update: Duration,
    /// Timeout of its SDO server.
    #[arg(long, value_name = "TIME", default_value = "1s", value_parser = span)]
    sdo_timeout: Duration,
    /// Let it behave as real nodes were seen to; may be given several times: late-boot-up, slow-boot-up, slow-sdo,
    /// stale-answers, noise, cob-bits-set, cob-bits-clear, no-6502h, repeated-answers.
    #[arg(long, value_name = "NAME", value_parser = quirk)]
    quirk: Vec<String>,
    /// A fault, when it begins after the start, and for how long: off, heartbeat-off, sdo-silent, wrong-map,
    /// boot-loop[=TIME], emergency-storm[=CODE] or number=N. May be given several times.
    #[arg(long, value_name = "WHAT[@START[+LENGTH]]", value_parser = of_node)]
    fault: Vec<Fault>,
    /// End after this time; without it, at Ctrl-C.
    #[arg(long, value_name = "TIME", value_parser = span)]
    duration: Option<Duration>,
}

/// Period of a signal unless another is given.
const PERIOD: Duration = Duration::from_secs(2);

impl NodeArgs {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let eds = sheet::read(&self.eds)?;
        let id = match self.node {
            Some(raw) => Some(NodeId::new(raw).context("a node number is 1 to 127")?),
            None => eds.node,
        };
        let id = id.with_context(|| {
            format!(
                "{} names no node number\nhint: give --node N",
                self.eds.display()
            )
        })?;
        let mut all = if self.still {
            Vec::new()
        } else {
            signals(&eds, id, PERIOD).with_context(|| self.eds.display().to_string())?
        };
        all.extend(self.signal);
        let quirks = self.quirk.iter().filter_map(|name| NodeQuirks::named(name));
        let heartbeat = self.heartbeat.map(|time| u16::try_from(time.as_millis()));
        let config = GenericConfig {
            id,
            signals: all.clone(),
            update: self.update,
            heartbeat_ms: heartbeat
                .transpose()
                .context("a heartbeat is at most 65s apart")?,
            sdo_timeout: self.sdo_timeout,
            quirks: quirks.fold(NodeQuirks::default(), NodeQuirks::and),
        };
        let node = GenericNode::of_sheet(&eds, config, monotonic())
            .with_context(|| self.eds.display().to_string())?;
        let socket = canopen::open(&self.interface)?;
        let name = eds.info("DeviceInfo", "ProductName").unwrap_or("node");
        say(&format!("{name}: node {id} on {}", self.interface))?;
        for signal in &all {
            let object = eds.name(signal.address).unwrap_or_default();
            let (address, wave) = (signal.address, signal.wave);
            say(&format!(
                "{address} {object}: {wave} of {:?}",
                signal.period
            ))?;
        }
        canopen::serve("node", node, socket, &self.fault, self.duration)?;
        Ok(Verdict::Good)
    }
}

impl Ailing for Node<Generators> {
    fn ail(&mut self, kind: Kind, begins: bool, now: Duration) {
        ail_node(self, kind, begins, now);
    }
}

/// Reads the name of a quirk of the command line.
fn quirk(name: &str) -> Result<String, String> {
    let all = || NodeQuirks::NAMES[1..].join(", ");
    NodeQuirks::named(name)
        .map(|_| name.to_owned())
        .ok_or_else(|| format!("`{name}` is no quirk; those are {}", all()))
}

/// Reads `OBJECT=WAVE[:LOW:HIGH[:PERIOD]]`.
fn signal(text: &str) -> Result<Signal, String> {
    const FORM: &str = "write OBJECT=WAVE[:LOW:HIGH[:PERIOD]], as 6401:01=ramp:0:500:2s";
    let (object, wave) = text
        .split_once('=')
        .ok_or_else(|| format!("`{text}` names no signal: {FORM}"))?;
    let address: Address = object.parse().map_err(|error| format!("{error}: {FORM}"))?;
    let number = |text: &str| {
        let number = text.parse().ok().filter(|number: &f64| number.is_finite());
        number.ok_or_else(|| format!("`{text}` is no number: {FORM}"))
    };
    let parts: Vec<&str> = wave.split(':').collect();
    let (wave, range, period) = match parts.as_slice() {
        [wave] => (wave, None, PERIOD),
        [wave, low, high] => (wave, Some((number(low)?, number(high)?)), PERIOD),
        [wave, low, high, period] => (wave, Some((number(low)?, number(high)?)), span(period)?),
        _ => return Err(format!("`{text}`: {FORM}")),
    };
    Ok(Signal {
        address,
        wave: wave.parse()?,
        range,
        period,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_can::canopen::emulator::Wave;

    #[test]
    fn signal_option_is_parsed_and_checked() {
        let full = signal("6401:01=ramp:-5:500:250ms").unwrap();
        assert_eq!(full.address, Address::new(0x6401, 1));
        assert_eq!((full.wave, full.range), (Wave::Ramp, Some((-5.0, 500.0))));
        assert_eq!(full.period, Duration::from_millis(250));
        assert_eq!(signal("2000=noise").unwrap().range, None);
        for wrong in [
            "6401",
            "6401=saw",
            "6401=sine:1",
            "x=sine",
            "6401=sine:a:b",
            "6401=sine:0:1:5",
        ] {
            assert!(signal(wrong).is_err(), "{wrong}");
        }
    }
}
