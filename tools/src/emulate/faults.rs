//! Faults of an emulated CANopen node as options: what, from when on, and for how long. What each does is in `takt-can` and
//! `takt-cia402`.

use std::str::FromStr;
use std::time::Duration;

use takt_can::canopen::emulator::DriveNode;
use takt_can::canopen::node::{Application, Node};
use takt_can::canopen::{Emergency, NodeId};
use takt_cia402::emulator::{Drive, FaultCode};

use crate::output::span;

/// Time between two starts of a boot loop, and between two emergencies of a storm.
const BOOT_LOOP: Duration = Duration::from_millis(500);
const STORM: Duration = Duration::from_millis(10);
/// Code of a storm unless another is given: device too hot.
const STORM_CODE: u16 = 0x4210;
/// Fault of a drive unless another is given: following error.
const ERROR_CODE: u16 = 0x8611;

/// A fault of a node, or of the axes of a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Off,
    HeartbeatOff,
    SdoSilent,
    WrongMap,
    BootLoop(Duration),
    EmergencyStorm(u16),
    Number(NodeId),
    Error(u16),
    Halt,
    Local,
    Interlock,
}

/// A fault, when it begins after the start, and how long it lasts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Fault {
    kind: Kind,
    begin: Duration,
    lasts: Option<Duration>,
}

/// Faults of every node.
const NODE: &str =
    "off, heartbeat-off, sdo-silent, wrong-map, boot-loop[=TIME], emergency-storm[=CODE], number=N";
/// Faults of drives.
const AXES: &str = "error[=CODE], halt, local, interlock";

fn code(text: &str) -> Result<u16, String> {
    let digits = text.trim_end_matches(['h', 'H']);
    u16::from_str_radix(digits, 16)
        .map_err(|_| format!("`{text}` is no error code: write four hexadecimal digits, as 8611"))
}

impl Kind {
    fn parse(name: &str, value: Option<&str>) -> Result<Self, String> {
        let plain = match name {
            "off" => Some(Self::Off),
            "heartbeat-off" => Some(Self::HeartbeatOff),
            "sdo-silent" => Some(Self::SdoSilent),
            "wrong-map" => Some(Self::WrongMap),
            "halt" => Some(Self::Halt),
            "local" => Some(Self::Local),
            "interlock" => Some(Self::Interlock),
            _ => None,
        };
        match (name, value, plain) {
            (_, None, Some(plain)) => Ok(plain),
            (_, Some(value), Some(_)) => Err(format!("{name} has no value, `{value}` was given")),
            ("boot-loop", value, None) => Ok(Self::BootLoop(value.map_or(Ok(BOOT_LOOP), span)?)),
            ("emergency-storm", value, None) => {
                Ok(Self::EmergencyStorm(value.map_or(Ok(STORM_CODE), code)?))
            }
            ("error", value, None) => Ok(Self::Error(value.map_or(Ok(ERROR_CODE), code)?)),
            ("number", Some(value), None) => {
                let node = value.parse().ok().and_then(|raw| NodeId::new(raw).ok());
                let node = node.ok_or_else(|| format!("`{value}` is no node number, 1 to 127"))?;
                Ok(Self::Number(node))
            }
            _ => Err(format!(
                "`{name}` is no fault; those of nodes are {NODE}; of drives also {AXES}"
            )),
        }
    }

    const fn is_of_axes(self) -> bool {
        matches!(
            self,
            Self::Error(_) | Self::Halt | Self::Local | Self::Interlock
        )
    }
}

impl FromStr for Fault {
    type Err = String;

    /// `WHAT[=VALUE][@START[+LENGTH]]`
    fn from_str(text: &str) -> Result<Self, String> {
        let (what, when) = text
            .split_once('@')
            .map_or((text, None), |(a, b)| (a, Some(b)));
        let (name, value) = what
            .split_once('=')
            .map_or((what, None), |(a, b)| (a, Some(b)));
        let (begin, lasts) = match when.map(|when| when.split_once('+').unwrap_or((when, ""))) {
            None => (Duration::ZERO, None),
            Some((begin, "")) => (span(begin)?, None),
            Some((begin, lasts)) => (span(begin)?, Some(span(lasts)?)),
        };
        Ok(Self {
            kind: Kind::parse(name, value)?,
            begin,
            lasts,
        })
    }
}

/// Reads a fault of a drive.
pub(super) fn of_drive(text: &str) -> Result<Fault, String> {
    text.parse()
}

/// Reads a fault of any node.
pub(super) fn of_node(text: &str) -> Result<Fault, String> {
    let fault: Fault = text.parse()?;
    match fault.kind.is_of_axes() {
        true => Err(format!(
            "`{text}` is a fault of drives; those of nodes are {NODE}"
        )),
        false => Ok(fault),
    }
}

/// What has faults.
pub(super) trait Ailing {
    /// Begins or ends a fault at `now`.
    fn ail(&mut self, kind: Kind, begins: bool, now: Duration);
}

/// Faults of a node without axes.
pub(super) fn ail_node<A: Application>(
    node: &mut Node<A>,
    kind: Kind,
    begins: bool,
    now: Duration,
) {
    let faults = node.malfunctions_mut();
    match kind {
        Kind::Off => faults.off = begins,
        Kind::HeartbeatOff => faults.no_heartbeat = begins,
        Kind::SdoSilent => faults.no_sdo = begins,
        Kind::WrongMap => faults.wrong_map = begins,
        Kind::BootLoop(every) => faults.boot_loop = begins.then_some(every),
        Kind::EmergencyStorm(code) => {
            let emergency = Emergency {
                code,
                register: FaultCode(code).register(),
                data: [0; 5],
            };
            faults.emergency_storm = begins.then_some((emergency, STORM));
        }
        Kind::Number(id) if begins => node.renumber(id, now),
        // It keeps the number, as a switch stays where it was turned.
        Kind::Number(_) | Kind::Error(_) | Kind::Halt | Kind::Local | Kind::Interlock => {}
    }
}

impl Ailing for DriveNode {
    fn ail(&mut self, kind: Kind, begins: bool, now: Duration) {
        if !kind.is_of_axes() {
            return ail_node(self, kind, begins, now);
        }
        let drives = self.application_mut();
        let mut axis = 0;
        while let Some(drive) = drives.axis_mut(axis) {
            ail_axis(drive, kind, begins);
            axis += 1;
        }
    }
}

fn ail_axis(drive: &mut Drive, kind: Kind, begins: bool) {
    match kind {
        Kind::Error(code) if begins => drive.fault(FaultCode(code)),
        Kind::Error(_) => drive.clear_cause(),
        Kind::Halt => drive.halted = begins,
        Kind::Local => drive.local = begins,
        Kind::Interlock => drive.interlock = begins,
        Kind::Off
        | Kind::HeartbeatOff
        | Kind::SdoSilent
        | Kind::WrongMap
        | Kind::BootLoop(_)
        | Kind::EmergencyStorm(_)
        | Kind::Number(_) => {}
    }
}

/// Faults in the order of the command line, and how far each is.
#[derive(Clone, Debug)]
pub(super) struct Schedule {
    begun: Duration,
    faults: Vec<(Fault, Phase)>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Waiting,
    Present,
    Over,
}

impl Schedule {
    /// Times count from `now`.
    pub(super) fn new(faults: &[Fault], now: Duration) -> Self {
        let faults = faults.iter().map(|fault| (*fault, Phase::Waiting));
        Self {
            begun: now,
            faults: faults.collect(),
        }
    }

    /// Begins and ends what is due.
    pub(super) fn step(&mut self, node: &mut impl Ailing, now: Duration) {
        let passed = now.saturating_sub(self.begun);
        for (fault, phase) in &mut self.faults {
            let end = fault.lasts.map(|lasts| fault.begin + lasts);
            if *phase == Phase::Waiting && passed >= fault.begin {
                *phase = Phase::Present;
                node.ail(fault.kind, true, now);
            }
            if *phase == Phase::Present && end.is_some_and(|end| passed >= end) {
                *phase = Phase::Over;
                node.ail(fault.kind, false, now);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_can::canopen::emulator::DriveNodeConfig;

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn fault_option_is_parsed_and_checked() {
        let fault = |text: &str| text.parse::<Fault>();
        let of = |kind, begin, lasts| Ok(Fault { kind, begin, lasts });
        assert_eq!(fault("halt"), of(Kind::Halt, Duration::ZERO, None));
        assert_eq!(
            fault("heartbeat-off@2s+500ms"),
            of(Kind::HeartbeatOff, 2000 * MS, Some(500 * MS))
        );
        assert_eq!(
            fault("error=2320h@1s"),
            of(Kind::Error(0x2320), 1000 * MS, None)
        );
        assert_eq!(
            fault("boot-loop=1s"),
            of(Kind::BootLoop(1000 * MS), Duration::ZERO, None)
        );
        for wrong in [
            "",
            "of",
            "off=1",
            "number",
            "number=128",
            "off@5",
            "error=xyz",
            "halt@1s+",
        ] {
            let is_wrong = fault(wrong).is_err() || wrong.ends_with('+');
            assert!(is_wrong, "{wrong}");
        }
        assert!(of_node("halt").unwrap_err().contains("sdo-silent"));
        assert!(of_drive("halt").is_ok());
    }

    #[test]
    fn fault_schedule_begins_and_ends_each() {
        let config = DriveNodeConfig {
            heartbeat_ms: 10,
            ..DriveNodeConfig::new(NodeId::LAST)
        };
        let mut node = DriveNode::power_on(config, Duration::ZERO).unwrap();
        let faults =
            ["heartbeat-off@100ms+100ms", "error=7305@200ms"].map(|text| text.parse().unwrap());
        let mut schedule = Schedule::new(&faults, Duration::ZERO);
        let mut beats = [0; 3];
        for ms in 0..300_u32 {
            schedule.step(&mut node, ms * MS);
            while let Some(frame) = node.poll_transmit(ms * MS) {
                if frame.data() == [0x7F] {
                    beats[usize::try_from(ms / 100).unwrap()] += 1;
                }
            }
        }
        assert!(beats[0] >= 9 && beats[1] == 0 && beats[2] >= 9, "{beats:?}");
        let axis = node.application().axis(0).unwrap();
        assert_eq!(axis.state(), takt_cia402::State::Fault);
    }
}
