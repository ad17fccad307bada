//! Objects of a drive that explain its state, as text. Objects that it does not have are left out.

use takt_can::canopen::Emergency;
use takt_cia402::dictionary::Address;
use takt_cia402::emulator::FaultCode;
use takt_cia402::{ControlWord, DriveFault};

use crate::can::sdo_client::{SdoClient, number};
use crate::can::wire::Wire;

/// Modes of operation by their names (CiA 402-2, object 6060h).
pub(super) const MODES: [(&str, i8); 9] = [
    ("pp", 1),
    ("vl", 2),
    ("pv", 3),
    ("tq", 4),
    ("hm", 6),
    ("ip", 7),
    ("csp", 8),
    ("csv", 9),
    ("cst", 10),
];

/// Modes that can jog: profile position, profile velocity, cyclic synchronous position.
pub(super) const PP: i8 = 1;
pub(super) const PV: i8 = 3;
pub(super) const CSP: i8 = 8;

/// Bits of 1001h (CiA 301, clause 7.5.2.2).
const ERROR_BITS: [&str; 8] = [
    "generic",
    "current",
    "voltage",
    "temperature",
    "communication",
    "device profile",
    "reserved",
    "manufacturer",
];

/// Bits of 60FDh (CiA 402-2).
const INPUTS: [&str; 4] = [
    "negative limit switch",
    "positive limit switch",
    "home switch",
    "interlock",
];

/// Meanings of 605Ah (CiA 402-2).
const QUICK_STOP: [(i32, &str); 9] = [
    (0, "coasts, then Switch on disabled"),
    (1, "slow down ramp, then Switch on disabled"),
    (2, "quick stop ramp, then Switch on disabled"),
    (3, "current limit, then Switch on disabled"),
    (4, "voltage limit, then Switch on disabled"),
    (5, "slow down ramp, stays in Quick stop active"),
    (6, "quick stop ramp, stays in Quick stop active"),
    (7, "current limit, stays in Quick stop active"),
    (8, "voltage limit, stays in Quick stop active"),
];

/// Names of the bits that are high.
fn bits(word: u32, names: &[&str]) -> String {
    let high = names.iter().enumerate();
    let high = high.filter(|(bit, _)| word >> bit & 1 == 1);
    let high: Vec<&str> = high.map(|(_, name)| *name).collect();
    match high.is_empty() {
        true => "none".to_owned(),
        false => high.join(", "),
    }
}

/// The modes of 6502h.
pub(super) fn modes(word: u32) -> String {
    let has = |number: i8| word >> (number - 1) & 1 == 1;
    let all = MODES.iter().filter(|(_, number)| has(*number));
    let all: Vec<String> = all
        .map(|(name, number)| format!("{} ({number})", name.to_uppercase()))
        .collect();
    all.join(", ")
}

/// The objects that explain it.
fn about(drive_fault: Option<DriveFault>) -> &'static [u16] {
    match drive_fault {
        Some(DriveFault::Fault | DriveFault::ResetRefused(_) | DriveFault::EnablingFails(_)) => {
            &[0x603F, 0x1001, 0x1003]
        }
        Some(DriveFault::NoVoltage) => &[0x6079, 0x60FD],
        Some(DriveFault::Mode { .. }) => &[0x6502, 0x6040],
        Some(DriveFault::Stuck { .. }) => &[0x6040, 0x60FD, 0x603F, 0x1001],
        Some(DriveFault::QuickStopHeld) => &[0x605A],
        Some(DriveFault::NotFollowing) => &[0x6061, 0x60C2, 0x60FD],
        Some(DriveFault::Undefined(_) | DriveFault::NotRemote | DriveFault::NotProven(_)) => {
            &[0x1001]
        }
        // It is enabled and does not turn.
        None => &[
            0x6040, 0x60FD, 0x6072, 0x60E0, 0x60E1, 0x607F, 0x6080, 0x6077,
        ],
    }
}

/// The objects that explain a drive fault or, without one, that it does not turn. One line each.
pub(super) fn facts<W: Wire>(
    wire: &mut W,
    asker: &mut SdoClient,
    axis: u8,
    drive_fault: Option<DriveFault>,
) -> anyhow::Result<Vec<String>> {
    let mut facts = Vec::new();
    for index in about(drive_fault) {
        let sub = u8::from(matches!(index, 0x1003 | 0x60C2));
        let address = Address::new(*index, sub);
        let address = address.on_axis(axis).unwrap_or(address);
        match asker.read(wire, address, false)? {
            Ok(bytes) => facts.push(format!("{address} {}", describe(*index, &bytes))),
            // It has no more answers now.
            Err(refusal) if refusal.is_timeout() => break,
            Err(_) => {}
        }
    }
    Ok(facts)
}

/// An emergency as text.
pub(super) fn emergency(emergency: &Emergency) -> String {
    let register = emergency.register;
    let bits = bits(register.into(), &ERROR_BITS);
    let code = FaultCode(emergency.code);
    format!("emergency: {code}, error register {register:02X}h: {bits}")
}

/// An object as text.
fn describe(index: u16, bytes: &[u8]) -> String {
    let raw = number(bytes).unwrap_or(0);
    let [a, b, ..] = raw.to_le_bytes();
    let short = u16::from_le_bytes([a, b]);
    match index {
        0x603F => format!("error code: {}", FaultCode(short)),
        0x1001 => format!("error register {a:02X}h: {}", bits(raw, &ERROR_BITS)),
        0x1003 => format!("last error: {}", FaultCode(short)),
        0x6079 => format!("DC link: {:.1} V", f64::from(raw) / 1000.0),
        0x60FD => format!("digital inputs {raw:08X}h: {}", bits(raw & 0xF, &INPUTS)),
        0x6502 => format!("has the modes {}", modes(raw)),
        0x6040 => format!("controlword as it holds it: {}", ControlWord::new(short)),
        0x605A => {
            let code = i32::from(short.cast_signed());
            let known = QUICK_STOP.iter().find(|(known, _)| *known == code);
            let text = known.map_or("of the manufacturer", |(_, text)| *text);
            format!("quick stop option {code}: {text}")
        }
        0x6061 => format!("mode of operation {}", a.cast_signed()),
        0x60C2 => format!("interpolation time {a}"),
        0x6072 => format!("max torque {:.1} % of rated", f64::from(short) / 10.0),
        0x60E0 => format!("positive torque limit {:.1} %", f64::from(short) / 10.0),
        0x60E1 => format!("negative torque limit {:.1} %", f64::from(short) / 10.0),
        0x6077 => format!("torque now {:.1} %", f64::from(short.cast_signed()) / 10.0),
        0x607F => format!("max profile velocity {raw}"),
        0x6080 => format!("max motor speed {raw} rpm"),
        _ => format!("{raw}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drive_objects_are_described() {
        for (index, bytes, words) in [
            (0x603F, &[0x20, 0x32][..], "DC link under-voltage (3220h)"),
            (0x1001, &[0x11], "11h: generic, communication"),
            (0x1001, &[0], "00h: none"),
            (0x6079, &[0x80, 0xBB, 0, 0], "48.0 V"),
            (0x60FD, &[0x0A, 0, 0, 0], "positive limit switch, interlock"),
            (0x605A, &[6, 0], "stays in Quick stop active"),
            (0x605A, &[0xFF, 0xFF], "-1: of the manufacturer"),
            (
                0x6502,
                &[0xA5, 3, 0, 0],
                "PP (1), PV (3), HM (6), CSP (8), CSV (9), CST (10)",
            ),
            (0x6072, &[0xE8, 3], "100.0 %"),
        ] {
            let text = describe(index, bytes);
            assert!(text.contains(words), "{index:04X}h: {text}");
        }
    }
}
