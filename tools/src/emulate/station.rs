//! `takt emulate station`: three servomotors at EtherCAT terminals, at a network interface, for Takt or any other master at the
//! other end of its cable. What they do is in `takt_ethercat::emulator`.

use std::time::Duration;

use clap::Args;
use takt_ethercat::emulator::{STATION_AXES, SharedSegment, Station, StationFaults, StationMotor};

use super::segment::{Ends, serve};
use crate::Verdict;
use crate::output::positive_span;

/// A test station: three servomotors with encoders, brakes and proximity switches, at terminals.
///
/// `takt ecat sim IFACE --devices station` is the same, and injects and repairs faults while it runs.
#[derive(Debug, Args)]
pub(crate) struct StationArgs {
    /// Network interface; the master is at the other end of its cable (`ip link add near type veth peer name far`).
    #[arg(long, value_name = "IFACE")]
    interface: String,
    /// A fault of an axis, 0 to 2; may be given several times. Faults: open-circuit, no-index, switch-on, switch-off,
    /// brake-stuck, not-ready, reversed, motor-open, offset, power-lost.
    #[arg(long, value_name = "AXIS=FAULT", value_parser = fault)]
    fault: Vec<(usize, &'static str)>,
    /// End after this time; without it, at Ctrl-C.
    #[arg(long, value_name = "TIME", value_parser = positive_span)]
    duration: Option<Duration>,
}

fn fault(text: &str) -> Result<(usize, &'static str), String> {
    let expected = || format!("`{text}` is not AXIS=FAULT with an axis from 0 to 2");
    let (axis, name) = text.split_once('=').ok_or_else(expected)?;
    let axis = axis.parse().ok().filter(|axis| *axis < STATION_AXES);
    let axis = axis.ok_or_else(expected)?;
    let names = StationFaults::NAMES.map(|(name, _)| name);
    let found = names.into_iter().find(|known| *known == name);
    let unknown = || {
        format!(
            "`{name}` is no fault of an axis; these are {}",
            names.join(", ")
        )
    };
    Ok((axis, found.ok_or_else(unknown)?))
}

impl StationArgs {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let (segment, station) = Station::segment(StationMotor::three());
        for (axis, name) in self.fault {
            let mut faults = station.faults(axis);
            anyhow::ensure!(faults.add(name), "`{name}` is no fault of an axis");
            station.inject(axis, faults);
        }
        let segment = SharedSegment::new(segment);
        let ends = Ends::line(&self.interface);
        serve(&segment, ends, self.duration, || {}, || Ok(()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn station_fault_argument_names_axis_and_fault() {
        assert_eq!(fault("2=no-index"), Ok((2, "no-index")));
        for (text, cause) in [
            ("no-index", "is not AXIS=FAULT"),
            ("3=no-index", "an axis from 0 to 2"),
            ("0=slow", "these are open-circuit, no-index"),
        ] {
            let error = fault(text).unwrap_err();
            assert!(error.contains(cause), "{error}");
        }
    }
}
