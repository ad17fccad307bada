//! Commands that inject faults into an emulated segment, as lines of text. The caller chooses the time.

use std::str::FromStr;
use std::time::Duration;

use takt_cia402::emulator::FaultCode;
use takt_ethercat::emulator::{
    Corrupt, EthernetFaults, STATION_AXES, Segment, SharedSegment, StationFaults,
};
use takt_ethercat::eoe::EoeResult;
use takt_ethercat::{AlState, AlStatusCode};

use super::plan::Handles;
use crate::output::span;

/// The commands.
pub(super) const HELP: &str = "\
cut SLAVE             cuts the cable before a slave
repair SLAVE          repairs it
off SLAVE, on SLAVE   switches the power of a slave
lose N                the next N frames are lost
late N TIME           the next N frames return late by a time
broken N SLAVE PORT   the next N frames are broken on the cable to a port
fall SLAVE CODE       a slave leaves OP for SAFE-OP with an AL status code, hexadecimal
fault DRIVE AXIS CODE an axis faults with a code of 603Fh, hexadecimal; drives and axes count from 0
jump SLAVE TIME       the clock of a slave jumps ahead
eoe SLAVE FAULT N     its next N Ethernet fragments are faulty: lose, swap, frame (wrong number), long (frames), deaf (frames)
eoe SLAVE CODE N      its next N answers to EoE requests are refusals with a result code, hexadecimal
axis AXIS FAULT       an axis of the test station gets a fault besides its others: open-circuit, no-index, switch-on, switch-off,
                      brake-stuck, not-ready, reversed, motor-open, offset, power-lost
axis AXIS ok          its faults are repaired";

/// A fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Fault {
    /// The cable before a slave is repaired (true) or cut.
    Cable(usize, bool),
    /// The power of a slave is on (true) or off.
    Power(usize, bool),
    /// Frames are lost.
    Lose(u32),
    /// Frames are late.
    Late(u32, Duration),
    /// Frames are broken before a port.
    Broken(Corrupt),
    /// A slave leaves OP with an AL status code.
    Fall(usize, u16),
    /// An axis of a drive faults.
    Axis(usize, usize, u16),
    /// An axis of the station gets the fault of that number, or all are repaired.
    Station(usize, Option<usize>),
    /// A clock jumps.
    Jump(usize, Duration),
    /// The Ethernet port of a slave is faulty that many times.
    Ethernet(usize, EthernetFault, u32),
}

/// A fault of an Ethernet port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum EthernetFault {
    Lose,
    Swap,
    Frame,
    Long,
    Deaf,
    Refuse(EoeResult),
}

impl FromStr for EthernetFault {
    type Err = String;

    fn from_str(word: &str) -> Result<Self, String> {
        Ok(match word {
            "lose" => Self::Lose,
            "swap" => Self::Swap,
            "frame" => Self::Frame,
            "long" => Self::Long,
            "deaf" => Self::Deaf,
            code => Self::Refuse(EoeResult(hexadecimal(code)?)),
        })
    }
}

impl EthernetFault {
    const fn apply(self, count: u32, faults: &mut EthernetFaults) {
        match self {
            Self::Lose => faults.lose = count,
            Self::Swap => faults.swap = count,
            Self::Frame => faults.wrong_frame = count,
            Self::Long => faults.too_long = count,
            Self::Deaf => faults.deaf = count,
            Self::Refuse(result) => faults.refuse = (count, result),
        }
    }
}

impl FromStr for Fault {
    type Err = String;

    fn from_str(line: &str) -> Result<Self, String> {
        let words: Vec<&str> = line.split_whitespace().collect();
        Ok(match words[..] {
            ["cut", slave] => Self::Cable(number(slave)?, false),
            ["repair", slave] => Self::Cable(number(slave)?, true),
            ["off", slave] => Self::Power(number(slave)?, false),
            ["on", slave] => Self::Power(number(slave)?, true),
            ["lose", frames] => Self::Lose(number(frames)?),
            ["late", frames, time] => Self::Late(number(frames)?, span(time)?),
            ["broken", frames, slave, port] => Self::Broken(Corrupt {
                slave: number(slave)?,
                port: number(port)?,
                frames: number(frames)?,
            }),
            ["fall", slave, code] => Self::Fall(number(slave)?, hexadecimal(code)?),
            ["fault", drive, axis, code] => {
                Self::Axis(number(drive)?, number(axis)?, hexadecimal(code)?)
            }
            ["eoe", slave, fault, count] => {
                Self::Ethernet(number(slave)?, fault.parse()?, number(count)?)
            }
            ["axis", axis, "ok"] => Self::Station(number(axis)?, None),
            ["axis", axis, name] => Self::Station(number(axis)?, Some(station_fault(name)?)),
            ["jump", slave, time] => Self::Jump(number(slave)?, span(time)?),
            _ => return Err(format!("`{line}` is not a command")),
        })
    }
}

/// The number of a fault of the station.
fn station_fault(name: &str) -> Result<usize, String> {
    let names = StationFaults::NAMES.map(|(name, _)| name);
    let found = names.iter().position(|known| *known == name);
    found.ok_or_else(|| {
        format!(
            "`{name}` is no fault of an axis; these are {}",
            names.join(", ")
        )
    })
}

/// Injects faults into an axis of the station, or repairs them, and describes that.
fn station(handles: &Handles, axis: usize, fault: Option<usize>) -> Result<String, String> {
    let none = "the segment is not the test station; it is that of `--devices station`";
    let station = handles.station.as_ref().ok_or(none)?;
    if axis >= STATION_AXES {
        let last = STATION_AXES - 1;
        return Err(format!("there is no axis {axis}; axes are 0 to {last}"));
    }
    let Some((name, what)) = fault.and_then(|number| StationFaults::NAMES.get(number)) else {
        station.inject(axis, StationFaults::default());
        return Ok(format!("axis {axis} is repaired"));
    };
    let mut faults = station.faults(axis);
    if !faults.add(name) {
        return Err(format!("`{name}` is no fault of an axis"));
    }
    station.inject(axis, faults);
    Ok(format!("axis {axis}: {what}"))
}

fn number<T: FromStr>(text: &str) -> Result<T, String> {
    text.parse()
        .map_err(|_| format!("`{text}` is not a number"))
}

fn hexadecimal(text: &str) -> Result<u16, String> {
    let digits = text.trim_start_matches("0x").trim_end_matches('h');
    u16::from_str_radix(digits, 16)
        .map_err(|_| format!("`{text}` is not a hexadecimal code such as 8611"))
}

fn nanos(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}

/// Rejects slaves that do not exist.
fn checked(segment: &Segment, slave: usize) -> Result<(), String> {
    if slave < segment.len() {
        return Ok(());
    }
    let count = segment.len();
    Err(format!(
        "there is no slave {slave}; slaves are 0 to {}",
        count.saturating_sub(1)
    ))
}

impl Fault {
    /// Injects the fault at `now`, ns of the segment's clock, and describes it.
    pub(super) fn inject(
        self,
        segment: &SharedSegment,
        handles: &Handles,
        now: u64,
    ) -> Result<String, String> {
        let mut segment = segment.lock();
        match self {
            Self::Station(axis, fault) => station(handles, axis, fault),
            Self::Cable(slave, whole) => {
                checked(&segment, slave)?;
                segment.set_link(slave, whole);
                let state = if whole { "repaired" } else { "cut" };
                Ok(format!("the cable before slave {slave} is {state}"))
            }
            Self::Power(slave, on) => {
                checked(&segment, slave)?;
                segment.set_power(slave, on);
                let state = if on { "on" } else { "off" };
                Ok(format!("slave {slave} is {state}"))
            }
            Self::Lose(frames) => {
                segment.faults.lose = frames;
                Ok(format!("{frames} frames will be lost"))
            }
            Self::Late(frames, time) => {
                segment.faults.late = Some((frames, nanos(time)));
                Ok(format!("{frames} frames will be late by {time:?}"))
            }
            Self::Broken(corrupt) => {
                checked(&segment, corrupt.slave)?;
                segment.faults.corrupt = Some(corrupt);
                let Corrupt {
                    slave,
                    port,
                    frames,
                } = corrupt;
                Ok(format!(
                    "{frames} frames will be broken before slave {slave} port {port}"
                ))
            }
            Self::Fall(number, code) => {
                let slave = segment.slave(number);
                let slave = slave.ok_or_else(|| format!("there is no slave {number}"))?;
                let code = AlStatusCode(code);
                slave.fall(AlState::SafeOp, code);
                Ok(format!("slave {number} left OP: {code}"))
            }
            Self::Axis(number, axis, code) => {
                let drive = handles.drives.get(number);
                let drive = drive.ok_or_else(|| format!("there is no drive {number}"))?;
                drive
                    .axis(axis, |axis| axis.fault(FaultCode(code)))
                    .ok_or_else(|| format!("drive {number} has no axis {axis}"))?;
                Ok(format!(
                    "drive {number} axis {axis} faults with {code:04X}h"
                ))
            }
            Self::Ethernet(number, fault, count) => {
                let slave = segment.slave(number);
                let slave = slave.ok_or_else(|| format!("there is no slave {number}"))?;
                let port = slave.ethernet();
                let port = port.ok_or_else(|| format!("slave {number} has no EoE"))?;
                fault.apply(count, &mut port.lock().faults);
                Ok(format!(
                    "the Ethernet port of slave {number} is faulty {count} times"
                ))
            }
            Self::Jump(number, time) => {
                let slave = segment.slave(number);
                let clock = slave.and_then(|slave| slave.clock());
                let clock = clock.ok_or_else(|| format!("slave {number} has no clock"))?;
                clock.jump(i64::try_from(nanos(time)).unwrap_or(i64::MAX), now);
                Ok(format!("the clock of slave {number} jumped by {time:?}"))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use takt_ethercat::emulator::{Coupler, ServoConfig, ServoDrive, Station, StationMotor};

    use super::*;

    fn segment() -> (SharedSegment, Handles) {
        let (slave, drive) = ServoDrive::slave(ServoConfig::default()).unwrap();
        let segment = Segment::line([Coupler::slave(), slave.with_ethernet()]);
        let handles = Handles {
            drives: vec![drive],
            station: None,
        };
        (SharedSegment::new(segment), handles)
    }

    fn execute(line: &str) -> Result<String, String> {
        let (segment, handles) = segment();
        line.parse::<Fault>()?.inject(&segment, &handles, 0)
    }

    #[test]
    fn station_faults_are_injected_and_repaired_by_name() {
        let (segment, station) = Station::segment(StationMotor::three());
        let segment = SharedSegment::new(segment);
        let handles = Handles {
            station: Some(station.clone()),
            ..Handles::default()
        };
        let execute = |line: &str| line.parse::<Fault>()?.inject(&segment, &handles, 0);
        for (name, what) in StationFaults::NAMES {
            assert!(HELP.contains(name), "{name}");
            let before = station.faults(1);
            assert_eq!(
                execute(&format!("axis 1 {name}")),
                Ok(format!("axis 1: {what}"))
            );
            assert_ne!(station.faults(1), before, "{name}");
        }
        assert_eq!(execute("axis 1 ok").as_deref(), Ok("axis 1 is repaired"));
        assert_eq!(station.faults(1), StationFaults::default());
        assert!(
            execute("axis 3 offset")
                .unwrap_err()
                .contains("axes are 0 to 2")
        );
    }

    #[test]
    fn fault_commands_of_the_help_are_executed() {
        for (line, text) in [
            ("cut 1", "the cable before slave 1 is cut"),
            ("repair 1", "the cable before slave 1 is repaired"),
            ("off 0", "slave 0 is off"),
            ("on 0", "slave 0 is on"),
            ("lose 3", "3 frames will be lost"),
            ("late 2 1ms", "2 frames will be late by 1ms"),
            (
                "broken 5 1 0",
                "5 frames will be broken before slave 1 port 0",
            ),
            ("fault 0 0 8611h", "drive 0 axis 0 faults with 8611h"),
            (
                "eoe 1 lose 2",
                "the Ethernet port of slave 1 is faulty 2 times",
            ),
            (
                "eoe 1 0201h 1",
                "the Ethernet port of slave 1 is faulty 1 times",
            ),
            ("jump 0 5us", "the clock of slave 0 jumped by 5µs"),
        ] {
            assert_eq!(execute(line).as_deref(), Ok(text), "{line}");
            let word = line.split(' ').next().unwrap();
            assert!(HELP.contains(word), "{word}");
        }
        let text = execute("fall 1 0x001B").unwrap();
        assert!(text.starts_with("slave 1 left OP: "), "{text}");
    }

    #[test]
    fn invalid_fault_command_is_rejected_with_cause() {
        for (line, cause) in [
            ("cut", "`cut` is not a command"),
            ("cut 2", "there is no slave 2; slaves are 0 to 1"),
            ("late 1 5", "write a number and a unit"),
            ("lose -1", "`-1` is not a number"),
            ("fault 1 0 8611", "there is no drive 1"),
            ("fault 0 1 8611", "drive 0 has no axis 1"),
            ("fall 9 1B", "there is no slave 9"),
            ("axis 0 offset", "the segment is not the test station"),
            (
                "axis 0 slow",
                "`slow` is no fault of an axis; these are open-circuit",
            ),
            ("eoe 0 lose 1", "slave 0 has no EoE"),
            ("eoe 1 all 1", "`all` is not a hexadecimal code"),
        ] {
            let error = execute(line).unwrap_err();
            assert!(error.contains(cause), "{error}");
        }
    }
}
