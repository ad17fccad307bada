//! What a datagram means: the name of its register, states and codes in clear text, what is in a mailbox. What it
//! does not know it shows as bytes.

use std::collections::HashSet;
use std::fmt::Write as _;

use takt_cia402::dictionary::DataType;
use takt_ethercat::coe::{Information, Sdo};
use takt_ethercat::{
    Address, AlStatus, AlStatusCode, CoeService, Command, Datagram, Emergency, MailboxError,
    MailboxHeader, MailboxKind, SyncManager, register,
};

/// Registers by their first address, how many bytes they have, what they are.
const REGISTERS: [(u16, u16, &str); 36] = [
    (register::INFORMATION, 10, "controller information"),
    (register::STATION_ADDRESS, 2, "station address"),
    (register::STATION_ALIAS, 2, "station alias"),
    (register::DL_CONTROL, 4, "DL control"),
    (register::DL_STATUS, 2, "DL status"),
    (register::AL_CONTROL, 2, "AL control"),
    (register::AL_STATUS, 4, "AL status"),
    (register::AL_STATUS_CODE, 2, "AL status code"),
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

/// Bytes that are shown of what is not known.
const SHOWN: usize = 16;

/// What was learnt so far of the slaves.
#[derive(Debug, Default)]
pub(super) struct Meanings {
    /// Station and start of mailboxes, as their SyncManagers were set up.
    mailboxes: HashSet<(u16, u16)>,
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
    /// What a datagram means, on its way out or back. What is asked for is only in what comes back.
    pub(super) fn of(&mut self, datagram: &Datagram<'_>, back: bool) -> String {
        let command = datagram.header.command;
        let answered = back && datagram.working_counter.raw() > 0;
        let has_data = if reads(command) {
            answered
        } else {
            !back || !writes(command)
        };
        let nobody = if back && !answered && command != Command::Nop {
            "nobody answered: "
        } else {
            ""
        };
        let meaning = match datagram.header.address {
            Address::Logical(_) if has_data => format!("process data {}", bytes(datagram.data)),
            Address::Logical(_) => "process data".to_owned(),
            Address::Device { ado, .. } => self.of_memory(datagram, ado, has_data),
        };
        format!("{nobody}{meaning}")
    }

    fn of_memory(&mut self, datagram: &Datagram<'_>, ado: u16, has_data: bool) -> String {
        let station = station(datagram);
        if ado >= register::PROCESS_DATA {
            let is_mailbox =
                station.is_some_and(|station| self.mailboxes.contains(&(station, ado)));
            let content = mailbox(datagram.data, is_mailbox).filter(|_| has_data);
            if let (Some(station), Some(_)) = (station, &content) {
                self.mailboxes.insert((station, ado));
            }
            return match (content, is_mailbox, has_data) {
                (Some(content), ..) => content,
                (None, _, true) => format!("memory {}", bytes(datagram.data)),
                (None, true, false) => "mailbox".to_owned(),
                (None, false, false) => "memory".to_owned(),
            };
        }
        if let (Some(station), true) = (station, writes(datagram.header.command)) {
            self.learn(station, ado, datagram.data);
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

    /// Mailboxes, from SyncManagers that are set up.
    fn learn(&mut self, station: u16, ado: u16, data: &[u8]) {
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
                self.mailboxes.insert((station, sync_manager.start));
            }
        }
    }
}

fn bytes(data: &[u8]) -> String {
    let more = if data.len() > SHOWN { " .." } else { "" };
    format!(
        "{}{more}",
        DataType::OctetString.show(data.get(..SHOWN).unwrap_or(data))
    )
}

/// What a register holds.
fn contents(ado: u16, data: &[u8]) -> String {
    let word = |at: usize| {
        let two = data.get(at..).and_then(|rest| rest.first_chunk());
        two.map(|two| u16::from_le_bytes(*two))
    };
    match (ado, word(0)) {
        (register::AL_CONTROL, Some(raw)) => {
            let wanted = AlStatus::from_raw(raw);
            let acknowledges = if wanted.error {
                ", error acknowledged"
            } else {
                ""
            };
            format!("-> {}{acknowledges}", wanted.state)
        }
        (register::AL_STATUS, Some(raw)) => {
            let status = AlStatus::from_raw(raw);
            let code = word(4).map(AlStatusCode).filter(|_| status.error);
            match code {
                Some(code) => format!("{status}: {code}"),
                // Several states OR-ed, as a broadcast read gives them, are no state.
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
        _ => bytes(data),
    }
}

/// Error counters that are not zero, port by port.
fn errors(data: &[u8]) -> String {
    let at = |place: usize| data.get(place).copied().unwrap_or(0);
    let mut text = String::new();
    for port in 0..4 {
        let counts = [
            ("invalid", at(2 * port)),
            ("receive", at(2 * port + 1)),
            ("forwarded", at(8 + port)),
            ("lost links", at(16 + port)),
        ];
        for (what, count) in counts.into_iter().filter(|(_, count)| *count > 0) {
            let _ = write!(text, "port {port} {what} {count}, ");
        }
    }
    for (what, count) in [("processing unit", at(12)), ("PDI", at(13))] {
        if count > 0 {
            let _ = write!(text, "{what} {count}, ");
        }
    }
    match text.strip_suffix(", ") {
        Some(text) => text.to_owned(),
        None => "all zero".to_owned(),
    }
}

/// What is in a mailbox; `None` if it is none. Where the set-up was not recorded, only CoE is taken for one.
fn mailbox(data: &[u8], known: bool) -> Option<String> {
    let (header, rest) = MailboxHeader::decode(data)?;
    if !known && (header.kind != MailboxKind::Coe || header.len < 10) {
        return None;
    }
    let counter = header.counter;
    let text = match header.kind {
        MailboxKind::Coe => coe(rest)?,
        MailboxKind::Error => MailboxError::decode(rest)?.to_string(),
        MailboxKind::Aoe
        | MailboxKind::Eoe
        | MailboxKind::Foe
        | MailboxKind::Soe
        | MailboxKind::Voe
        | MailboxKind::Other(_) => bytes(rest),
    };
    Some(format!("{} #{counter} {text}", header.kind))
}

fn coe(rest: &[u8]) -> Option<String> {
    let (service, rest) = CoeService::decode(rest)?;
    Some(match service {
        CoeService::SdoRequest => {
            let sdo = Sdo::decode_request(rest)?;
            format!("SDO {sdo}{}", data_of(&sdo))
        }
        CoeService::SdoResponse => {
            let sdo = Sdo::decode_response(rest)?;
            format!("SDO {sdo}{}", data_of(&sdo))
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
