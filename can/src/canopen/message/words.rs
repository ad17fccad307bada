//! Text for values in messages: controlword and statusword of the drive profile in SDOs, LSS services. It decodes no
//! frames.

use std::fmt;

use takt_cia402::dictionary::Address;
use takt_cia402::{Command, ControlWord, StatusWord, error_text};

use crate::canopen::sdo::{Bytes, Initiate, Request, Response};

/// Meaning of the value in a response.
pub(super) fn of_response(f: &mut fmt::Formatter<'_>, response: &Response) -> fmt::Result {
    if let Response::Upload {
        address,
        data: Initiate::Expedited(data),
    } = response
    {
        return value(f, *address, data);
    }
    Ok(())
}

/// Meaning of the value in a request.
pub(super) fn of_request(f: &mut fmt::Formatter<'_>, request: &Request) -> fmt::Result {
    if let Request::Download {
        address,
        data: Initiate::Expedited(data),
    } = request
    {
        return value(f, *address, data);
    }
    Ok(())
}

/// Matches all axes of a multi-axis drive.
fn value(f: &mut fmt::Formatter<'_>, address: Address, data: &Bytes) -> fmt::Result {
    let Ok(raw) = <[u8; 2]>::try_from(data.as_slice()) else {
        return Ok(());
    };
    if address.index < 0x6000 || address.sub != 0 {
        return Ok(());
    }
    let raw = u16::from_le_bytes(raw);
    match 0x6000 + (address.index - 0x6000) % Address::AXIS {
        0x603F => write!(f, " ({})", error_text(raw)),
        0x6040 => {
            let before = ControlWord::DISABLE_VOLTAGE;
            let command = ControlWord::new(raw).command(before).map_or("", name);
            write!(f, " ({command})")
        }
        0x6041 => match StatusWord::new(raw).state() {
            Ok(state) => write!(f, " ({state})"),
            Err(_) => Ok(()),
        },
        _ => Ok(()),
    }
}

const fn name(command: Command) -> &'static str {
    match command {
        Command::DisableVoltage => "disable voltage",
        Command::QuickStop => "quick stop",
        Command::Shutdown => "shutdown",
        Command::SwitchOn => "switch on",
        Command::EnableOperation => "enable operation",
        Command::FaultReset => "fault reset",
    }
}

/// Services of LSS by their command specifier (CiA 305).
const LSS: [(u8, &str); 24] = [
    (0x04, "switch all to a mode"),
    (0x11, "configure the node number"),
    (0x13, "configure bit timing"),
    (0x15, "activate bit timing"),
    (0x17, "store the configuration"),
    (0x40, "select by vendor"),
    (0x41, "select by product"),
    (0x42, "select by revision"),
    (0x43, "select by serial number"),
    (0x44, "selected"),
    (0x46, "identify by vendor"),
    (0x47, "identify by product"),
    (0x48, "identify from revision"),
    (0x49, "identify to revision"),
    (0x4A, "identify from serial number"),
    (0x4B, "identify to serial number"),
    (0x4C, "identify those without a node number"),
    (0x4F, "identified"),
    (0x50, "identified, without a node number"),
    (0x51, "fast scan"),
    (0x5A, "inquire vendor"),
    (0x5B, "inquire product"),
    (0x5C, "inquire revision"),
    (0x5D, "inquire serial number"),
];

/// The service of that command specifier.
pub(super) fn of_lss(command: u8) -> Option<&'static str> {
    if command == 0x5E {
        return Some("inquire the node number");
    }
    let known = LSS.iter().find(|(known, _)| *known == command);
    known.map(|(_, name)| *name)
}
