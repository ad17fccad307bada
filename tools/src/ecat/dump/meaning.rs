//! The meaning of a datagram: the name of its register, states and codes as text, the content of a mailbox. Unknown data
//! is shown as bytes.

use std::collections::HashMap;
use std::fmt::Write as _;

use takt_cia402::dictionary::DataType;
use takt_ethercat::coe::{Information, Sdo, Whole};
use takt_ethercat::eoe::Eoe;
use takt_ethercat::foe::Foe;
use takt_ethercat::{
    Address, AlStatus, AlStatusCode, CoeService, Command, Datagram, Emergency, MailboxError,
    MailboxHeader, MailboxKind, SyncManager, register,
};

/// Registers: first address, length in bytes, name.
const REGISTERS: [(u16, u16, &str); 37] = [
    (register::INFORMATION, 10, "controller information"),
    (register::STATION_ADDRESS, 2, "station address"),
    (register::STATION_ALIAS, 2, "station alias"),
    (register::DL_CONTROL, 4, "DL control"),
    (register::DL_STATUS, 2, "DL status"),
    (register::AL_CONTROL, 2, "AL control"),
    (register::AL_STATUS, 4, "AL status"),
    (register::AL_STATUS_CODE, 2, "AL status code"),
    (PDI_CONTROL, 2, "PDI control"),
    (register::ECAT_EVENT_MASK, 2, "event mask"),
    (register::ECAT_EVENT, 2, "event request"),
    (register::ERROR_COUNTERS, 16, "error counters"),
    (register::LOST_LINKS, 4, "lost links"),
    (register::WATCHDOG_DIVIDER, 2, "watchdog divider"),
    (0x0410, 2, "PDI watchdog"),
    (register::WATCHDOG_PROCESS_DATA, 2, "process data watchdog"),
    (register::WATCHDOG_STATUS, 4, "watchdog status"),
    (register::SII_ACCESS, 2, "SII access"),
    (register::SII_CONTROL, 2, "SII control"),
    (register::SII_ADDRESS, 4, "SII address"),
    (register::SII_DATA, 8, "SII data"),
    (register::FMMU, 256, "FMMU"),
    (register::SYNC_MANAGER, 128, "SyncManager"),
    (register::DC_RECEIVE_TIMES, 16, "receive times"),
    (register::DC_SYSTEM_TIME, 8, "system time"),
    (register::DC_RECEIVE_TIME_ECAT, 8, "receive time"),
    (register::DC_OFFSET, 8, "system time offset"),
    (register::DC_DELAY, 4, "propagation delay"),
    (register::DC_DIFFERENCE, 4, "system time difference"),
    (register::DC_SPEED_START, 4, "speed counter"),
    (register::DC_FILTERS, 2, "clock filters"),
    (register::DC_CONTROL, 2, "SYNC control"),
    (register::DC_START_TIME, 8, "SYNC0 start"),
    (register::DC_SYNC0_CYCLE, 4, "SYNC0 cycle"),
    (register::DC_SYNC1_CYCLE, 4, "SYNC1 cycle"),
    (0x0F80, 128, "user memory"),
    (register::PROCESS_DATA, 0xF000, "memory"),
];

/// PDI control (0140h) and configuration of the slave controller (0141h).
const PDI_CONTROL: u16 = 0x0140;

/// Bytes shown of unknown data.
const BYTES_MAX: usize = 16;

/// State of the decoder: the mailboxes of the slaves so far.
#[derive(Debug, Default)]
pub(super) struct Meanings {
    /// Lengths of mailboxes by station and start address, as their SyncManagers were configured.
    mailboxes: HashMap<(u16, u16), u16>,
}

/// The station that a datagram is addressed to by its configured address.
pub(super) fn station(datagram: &Datagram<'_>) -> Option<u16> {
    match (datagram.header.command, datagram.header.address) {
        (
            Command::Fprd | Command::Fpwr | Command::Fprw | Command::Frmw,
            Address::Device { adp, .. },
        ) => Some(adp),
        _ => None,
    }
}

const fn reads(command: Command) -> bool {
    matches!(
        command,
        Command::Aprd | Command::Fprd | Command::Brd | Command::Lrd
    )
}

const fn writes(command: Command) -> bool {
    matches!(
        command,
        Command::Apwr | Command::Fpwr | Command::Bwr | Command::Lwr
    )
}

impl Meanings {
    /// The meaning of a datagram, outgoing or returned. Only a returned datagram has the data of a read.
    pub(super) fn of(&mut self, datagram: &Datagram<'_>, returned: bool) -> String {
        let command = datagram.header.command;
        let answered = returned && datagram.working_counter.raw() > 0;
        let has_data = if reads(command) {
            answered
        } else {
            !returned || !writes(command)
        };
        let prefix = if returned && !answered && command != Command::Nop {
            "no answer: "
        } else {
            ""
        };
        let meaning = match datagram.header.address {
            Address::Logical(_) if has_data => format!("process data {}", bytes(datagram.data)),
            Address::Logical(_) => "process data".to_owned(),
            Address::Device { ado, .. } => self.of_memory(datagram, ado, has_data),
        };
        format!("{prefix}{meaning}")
    }

    fn of_memory(&mut self, datagram: &Datagram<'_>, ado: u16, has_data: bool) -> String {
        let station = station(datagram);
        if ado >= register::PROCESS_DATA {
            return self.of_process_memory(datagram, station, ado, has_data);
        }
        if let (Some(station), true) = (station, writes(datagram.header.command)) {
            self.handle_sync_managers(station, ado, datagram.data);
        }
        let Some((start, _, name)) = REGISTERS
            .iter()
            .find(|(start, len, _)| (*start..start.saturating_add(*len)).contains(&ado))
        else {
            return if has_data {
                bytes(datagram.data)
            } else {
                String::new()
            };
        };
        let number = match *start {
            register::FMMU => format!(" {}", (ado - start) / 16),
            register::SYNC_MANAGER => format!(" {}", (ado - start) / 8),
            _ => String::new(),
        };
        if has_data {
            format!("{name}{number} {}", contents(ado, datagram.data))
        } else {
            format!("{name}{number}")
        }
    }

    /// Mailboxes, whole or in part, and other memory.
    fn of_process_memory(
        &mut self,
        datagram: &Datagram<'_>,
        station: Option<u16>,
        ado: u16,
        has_data: bool,
    ) -> String {
        let known = station.and_then(|station| self.mailbox_at(station, ado));
        let (data, begins) = (datagram.data, known.is_none_or(|(start, _)| start == ado));
        let content = mailbox(data, known.is_some()).filter(|_| has_data && begins);
        if let (Some(station), Some(_)) = (station, &content) {
            let len = datagram.header.len;
            let known = self.mailboxes.entry((station, ado)).or_insert(len);
            *known = len.max(*known);
        }
        let part = known.and_then(|(start, len)| part(ado - start, datagram.header.len, len));
        let part = part.map_or_else(String::new, |part| format!(" ({part})"));
        match (content, known, has_data) {
            (Some(content), ..) => format!("{content}{part}"),
            (None, Some(_), true) => format!("mailbox{part} {}", bytes(data)),
            (None, Some(_), false) => format!("mailbox{part}"),
            (None, None, true) => format!("memory {}", bytes(data)),
            (None, None, false) => "memory".to_owned(),
        }
    }

    /// Start and length of the mailbox at an address of a station.
    fn mailbox_at(&self, station: u16, ado: u16) -> Option<(u16, u16)> {
        let mailboxes = self.mailboxes.iter();
        let mut matching = mailboxes.filter(|((other, start), len)| {
            *other == station && (*start..start.saturating_add(**len)).contains(&ado)
        });
        matching.next().map(|((_, start), len)| (*start, *len))
    }

    /// Stores the mailboxes of SyncManagers that are configured.
    fn handle_sync_managers(&mut self, station: u16, ado: u16, data: &[u8]) {
        let is_first = |at: u16| (at - register::SYNC_MANAGER).is_multiple_of(8);
        if !(register::SYNC_MANAGER..register::SYNC_MANAGER + 128).contains(&ado) || !is_first(ado)
        {
            return;
        }
        for block in data.chunks_exact(SyncManager::LEN) {
            let Some(block) = block.first_chunk() else {
                continue;
            };
            let sync_manager = SyncManager::decode(block);
            if sync_manager.is_mailbox() && sync_manager.is_enabled() {
                self.mailboxes
                    .insert((station, sync_manager.start), sync_manager.len);
            }
        }
    }
}

/// The part of a mailbox that is written or read; `None` for all of it. Access to its last byte completes the transfer.
fn part(from: u16, len: u16, whole: u16) -> Option<String> {
    let to = from.saturating_add(len);
    match (from, to) {
        (0, to) if to >= whole => None,
        (from, to) if to >= whole && len == 1 => Some(format!("its last byte, {from}")),
        (_, to) if to >= whole => Some(format!("its last {len} bytes")),
        (0, _) => Some(format!("first {len} of {whole} bytes")),
        (from, to) => Some(format!(
            "bytes {from} to {} of {whole}",
            to.saturating_sub(1)
        )),
    }
}

fn bytes(data: &[u8]) -> String {
    let more = if data.len() > BYTES_MAX { " .." } else { "" };
    format!(
        "{}{more}",
        DataType::OctetString.show(data.get(..BYTES_MAX).unwrap_or(data))
    )
}

/// The content of a register as text.
fn contents(ado: u16, data: &[u8]) -> String {
    let word = |at: usize| {
        let two = data.get(at..).and_then(|rest| rest.first_chunk());
        two.map(|two| u16::from_le_bytes(*two))
    };
    match (ado, word(0)) {
        (register::AL_CONTROL, Some(raw)) => {
            let requested = AlStatus::from_raw(raw);
            let acknowledges = if requested.error {
                ", error acknowledged"
            } else {
                ""
            };
            format!("-> {}{acknowledges}", requested.state)
        }
        (register::AL_STATUS, Some(raw)) => {
            let status = AlStatus::from_raw(raw);
            let code = word(4).map(AlStatusCode).filter(|_| status.error);
            match code {
                Some(code) => format!("{status}: {code}"),
                // A broadcast read returns the states of all slaves OR-ed, which may be no valid state.
                None => format!("{status} ({raw:04X}h)"),
            }
        }
        (register::AL_STATUS_CODE, Some(raw)) => AlStatusCode(raw).to_string(),
        (register::STATION_ADDRESS | register::STATION_ALIAS, Some(raw)) => format!("{raw:04X}h"),
        (register::DC_SYSTEM_TIME, Some(_)) if data.len() >= 8 => {
            let time = data
                .first_chunk()
                .map_or(0, |eight| u64::from_le_bytes(*eight));
            format!("{time} ns")
        }
        (register::DC_DIFFERENCE, Some(_)) if data.len() >= 4 => {
            let raw = data
                .first_chunk()
                .map_or(0, |four| u32::from_le_bytes(*four));
            let sign = if raw >> 31 == 1 { "+" } else { "-" };
            format!("{sign}{} ns", raw & 0x7FFF_FFFF)
        }
        (register::ERROR_COUNTERS, Some(_)) if data.len() >= 20 => errors(data),
        (register::SII_CONTROL, Some(raw)) => sii_control(raw),
        (PDI_CONTROL, Some(raw)) => pdi_control(raw),
        _ => bytes(data),
    }
}

/// Names of the bits that are set, or `none`.
fn bits(raw: u16, names: &[(u16, &'static str)], none: &'static str) -> String {
    let set = names.iter().filter(|(bit, _)| raw & bit != 0);
    let set: Vec<&str> = set.map(|(_, name)| *name).collect();
    if set.is_empty() {
        none.to_owned()
    } else {
        set.join(", ")
    }
}

/// Access to the EEPROM (0502h, ETG.1000.4 clause 6.4): command, progress, and properties of the chip.
fn sii_control(raw: u16) -> String {
    const BITS: [(u16, &str); 12] = [
        (0x8000, "busy"),
        (0x0100, "read"),
        (0x0200, "write"),
        (0x0400, "reload"),
        (0x0800, "checksum wrong"),
        (0x1000, "not loaded"),
        (0x2000, "no acknowledge"),
        (0x4000, "write not enabled"),
        (0x0001, "write enabled"),
        (0x0020, "emulated by firmware"),
        (0x0040, "8 bytes a read"),
        (0x0080, "2 address bytes"),
    ];
    format!("{raw:04X}h: {}", bits(raw, &BITS, "idle"))
}

/// Interface to the firmware (0140h) and configuration of the controller (0141h).
fn pdi_control(raw: u16) -> String {
    const BITS: [(u16, &str); 4] = [
        (0x0100, "device emulation"),
        (0x0200, "enhanced link detection"),
        (0x0400, "DC SYNC unit"),
        (0x0800, "DC latch unit"),
    ];
    let kind = match raw & 0xFF {
        0x00 => "none",
        0x01 => "4 digital inputs",
        0x02 => "4 digital outputs",
        0x03 => "2 digital inputs, 2 outputs",
        0x04 => "digital I/O",
        0x05 => "SPI",
        0x07 => "EtherCAT bridge",
        0x08 => "16 bit microcontroller, asynchronous",
        0x09 => "8 bit microcontroller, asynchronous",
        0x0A => "16 bit microcontroller, synchronous",
        0x0B => "8 bit microcontroller, synchronous",
        0x80 => "on-chip bus",
        _ => "other",
    };
    format!("{raw:04X}h: {kind}; {}", bits(raw, &BITS, "nothing more"))
}

/// Error counters that are not zero, port by port.
fn errors(data: &[u8]) -> String {
    let at = |offset: usize| data.get(offset).copied().unwrap_or(0);
    let mut text = String::new();
    for port in 0..4 {
        let counts = [
            ("invalid", at(2 * port)),
            ("receive", at(2 * port + 1)),
            ("forwarded", at(8 + port)),
            ("lost links", at(16 + port)),
        ];
        for (kind, count) in counts.into_iter().filter(|(_, count)| *count > 0) {
            let _ = write!(text, "port {port} {kind} {count}, ");
        }
    }
    for (kind, count) in [("processing unit", at(12)), ("PDI", at(13))] {
        if count > 0 {
            let _ = write!(text, "{kind} {count}, ");
        }
    }
    match text.strip_suffix(", ") {
        Some(text) => text.to_owned(),
        None => "all zero".to_owned(),
    }
}

/// The content of a mailbox; `None` if the data is not a mailbox. If the SyncManagers were not recorded, only CoE is
/// recognized.
fn mailbox(data: &[u8], known: bool) -> Option<String> {
    let (header, rest) = MailboxHeader::decode(data)?;
    if !known && (header.kind != MailboxKind::Coe || header.len < 10) {
        return None;
    }
    let counter = header.counter;
    let text = match header.kind {
        MailboxKind::Coe => coe(rest)?,
        MailboxKind::Error => MailboxError::decode(rest)?.to_string(),
        MailboxKind::Foe => Foe::decode(rest)?.to_string(),
        MailboxKind::Eoe => Eoe::decode(rest)?.to_string(),
        MailboxKind::Aoe | MailboxKind::Soe | MailboxKind::Voe | MailboxKind::Other(_) => {
            bytes(rest)
        }
    };
    Some(format!("{} #{counter} {text}", header.kind))
}

fn coe(rest: &[u8]) -> Option<String> {
    let (service, rest) = CoeService::decode(rest)?;
    Some(match service {
        CoeService::SdoRequest => {
            let sdo = Sdo::decode_request(rest)?;
            format!("SDO {sdo}{}{}", access(&sdo), data_of(&sdo))
        }
        CoeService::SdoResponse => {
            let sdo = Sdo::decode_response(rest)?;
            format!("SDO {sdo}{}{}", access(&sdo), data_of(&sdo))
        }
        CoeService::Emergency => {
            let Emergency {
                code,
                register,
                data,
            } = Emergency::decode(rest)?;
            let data = DataType::OctetString.show(&data);
            format!("emergency {code:04X}h, register {register:02X}h, {data}")
        }
        CoeService::SdoInformation => {
            let (header, rest) = Information::decode(rest)?;
            format!("information {}{}", operation(header.operation), index(rest))
        }
        CoeService::Pdo(number) => format!("PDO by mailbox ({number}) {}", bytes(rest)),
        CoeService::Other(_) => return None,
    })
}

/// Marks complete access.
const fn access(sdo: &Sdo<'_>) -> &'static str {
    match sdo {
        Sdo::Download { whole, .. }
        | Sdo::Upload { whole, .. }
        | Sdo::Downloaded { whole, .. }
        | Sdo::Uploaded { whole, .. } => match whole {
            Whole::Entry => "",
            Whole::Object => " (complete access)",
        },
        Sdo::DownloadSegment { .. }
        | Sdo::UploadSegment { .. }
        | Sdo::DownloadedSegment { .. }
        | Sdo::UploadedSegment { .. }
        | Sdo::Abort { .. } => "",
    }
}

/// The data of an SDO message that carries some.
fn data_of(sdo: &Sdo<'_>) -> String {
    match sdo {
        Sdo::Download { data, .. }
        | Sdo::DownloadSegment { data, .. }
        | Sdo::Uploaded { data, .. }
        | Sdo::UploadedSegment { data, .. } => format!(": {}", bytes(data)),
        Sdo::Upload { .. }
        | Sdo::UploadSegment { .. }
        | Sdo::Downloaded { .. }
        | Sdo::DownloadedSegment { .. }
        | Sdo::Abort { .. } => String::new(),
    }
}

fn operation(operation: u8) -> &'static str {
    match operation {
        1 => "list?",
        2 => "list",
        3 => "object?",
        4 => "object",
        5 => "entry?",
        6 => "entry",
        7 => "refused",
        _ => "unknown",
    }
}

fn index(rest: &[u8]) -> String {
    let two = rest.first_chunk().map(|two| u16::from_le_bytes(*two));
    two.map_or_else(String::new, |index| format!(" {index:04X}h"))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A message of the mailbox protocol EoE, decoded.
    fn decoded(message: &[u8], known: bool) -> Option<String> {
        let header = MailboxHeader {
            len: u16::try_from(message.len()).unwrap(),
            address: 0,
            kind: MailboxKind::Eoe,
            counter: 3,
        };
        let mut bytes = header.encode().to_vec();
        bytes.extend_from_slice(message);
        // What follows in the mailbox is of an earlier message.
        bytes.extend_from_slice(&[0xAA; 20]);
        mailbox(&bytes, known)
    }

    #[test]
    fn eoe_messages_of_each_type_are_decoded() {
        let fragment = [&[0x00, 0x00, 0x42, 0x70][..], &[0x55; 40]].concat();
        let last = [&[0x00, 0x01, 0x05, 0x70][..], &[0x55; 28]].concat();
        let messages: [(&[u8], &str); 10] = [
            (&fragment, "Ethernet frame 7, fragment 2, 40 bytes"),
            (&last, "Ethernet frame 7, fragment 5, last, 28 bytes"),
            (
                &[2, 1, 0, 0, 3, 0, 0, 0, 2, 0, 0, 0, 0, 7, 2, 7, 168, 192],
                "set address: MAC 02:00:00:00:00:07, IP 192.168.7.2",
            ),
            (&[2, 1, 0, 0, 1, 2], "set address: truncated"),
            (&[3, 1, 0, 0], "address set: done (EoE 0000h)"),
            (&[3, 1, 1, 2], "address set: it has no IP (EoE 0201h)"),
            (&[4, 1, 0, 0], "set filter: truncated"),
            (
                &[5, 1, 1, 4],
                "filter set: it has no address filter (EoE 0401h)",
            ),
            (&[6, 1, 0, 0], "read address"),
            (&[7, 1, 0, 0, 0, 0, 0, 0], "address: none"),
        ];
        for (message, text) in messages {
            let line = decoded(message, true);
            assert_eq!(line.as_deref(), Some(&*format!("EoE #3 {text}")));
        }
        assert_eq!(decoded(&[0, 1, 0], true), None, "truncated");
        // Without the SyncManagers on record, other memory may begin with such bytes.
        assert_eq!(decoded(&last, false), None);
    }
}
