//! CANopen messages by identifier (CiA 301, clause 7.3.5, pre-defined connection set). Networks
//! with other PDO identifiers need a decoder that knows their mapping.

mod words;

use std::fmt;

use crate::{Frame, Id};

use takt_cia402::error_text;

use super::sdo;

/// The number of a node, 1 to 127.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct NodeId(u8);

/// An invalid node number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0} is no node number; they are 1 to 127")]
pub struct NodeIdError(pub u8);

impl NodeId {
    /// The highest node number.
    pub const LAST: Self = Self(127);

    /// Checks a node number.
    pub const fn new(number: u8) -> Result<Self, NodeIdError> {
        if number == 0 || number > 127 {
            return Err(NodeIdError(number));
        }
        Ok(Self(number))
    }

    /// The number as an integer.
    pub const fn raw(self) -> u8 {
        self.0
    }

    /// All node numbers.
    pub fn all() -> impl Iterator<Item = Self> {
        (1..=127).map(Self)
    }

    /// The identifier of one of its messages in the pre-defined connection set: 080h, 180h, ...
    pub fn cob(self, function: u16) -> Id {
        // At most 700h + 127: always fits.
        Id::standard((function & 0x780) + u16::from(self.0)).unwrap_or(NMT)
    }
}

impl fmt::Display for NodeId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

macro_rules! fixed {
    ($($(#[$doc:meta])* $name:ident = $raw:literal;)*) => {$(
        $(#[$doc])*
        pub const $name: Id = match Id::standard($raw) {
            Ok(id) => id,
            Err(_) => unreachable!(),
        };
    )*};
}

fixed! {
    /// Network management commands.
    NMT = 0x000;
    /// SYNC, unless 1005h differs.
    SYNC = 0x080;
    /// TIME, unless 1012h differs.
    TIME = 0x100;
    /// LSS, from slaves to the master.
    LSS_SLAVE = 0x7E4;
    /// LSS, from the master to slaves.
    LSS_MASTER = 0x7E5;
}

/// Emergencies of a node: 080h and its number.
pub const EMERGENCY: u16 = 0x080;
/// The first PDO that a node sends; the others follow every 100h.
pub const TPDO1: u16 = 0x180;
/// The first PDO that a node receives; the others follow every 100h.
pub const RPDO1: u16 = 0x200;
/// SDO from the server.
pub const SDO_RESPONSE: u16 = 0x580;
/// SDO to the server.
pub const SDO_REQUEST: u16 = 0x600;
/// Heartbeat, boot-up, node guarding.
pub const HEARTBEAT: u16 = 0x700;

/// A command of network management.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum NmtCommand {
    /// To Operational.
    Start,
    /// To Stopped.
    Stop,
    /// To Pre-operational.
    EnterPreOperational,
    /// Reset the whole node.
    ResetNode,
    /// Reset communication.
    ResetCommunication,
    /// Any other code, unchanged.
    Other(u8),
}

const COMMANDS: [(NmtCommand, u8, &str); 5] = [
    (NmtCommand::Start, 1, "start"),
    (NmtCommand::Stop, 2, "stop"),
    (
        NmtCommand::EnterPreOperational,
        128,
        "enter pre-operational",
    ),
    (NmtCommand::ResetNode, 129, "reset node"),
    (NmtCommand::ResetCommunication, 130, "reset communication"),
];

impl NmtCommand {
    /// The byte on the wire.
    pub fn raw(self) -> u8 {
        if let Self::Other(raw) = self {
            return raw;
        }
        let found = COMMANDS.iter().find(|(command, ..)| *command == self);
        found.map_or(0, |(_, raw, _)| *raw)
    }

    /// From the byte on the wire.
    pub fn from_raw(raw: u8) -> Self {
        let found = COMMANDS.iter().find(|(_, known, _)| *known == raw);
        found.map_or(Self::Other(raw), |(command, ..)| *command)
    }

    /// The frame: to one node or to all.
    pub fn frame(self, node: Option<NodeId>) -> Frame {
        frame(NMT, &[self.raw(), node.map_or(0, NodeId::raw)])
    }
}

impl fmt::Display for NmtCommand {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match COMMANDS.iter().find(|(command, ..)| command == self) {
            Some((.., name)) => f.write_str(name),
            None => write!(f, "command {}", self.raw()),
        }
    }
}

/// State of a node as in its heartbeat.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum NmtState {
    /// The boot-up message.
    BootUp,
    /// Only network management and error control are active.
    Stopped,
    /// PDOs and SDOs are active.
    Operational,
    /// SDOs are active, PDOs are not.
    PreOperational,
    /// Any other code, unchanged.
    Other(u8),
}

impl NmtState {
    /// The 7-bit code on the wire.
    pub const fn raw(self) -> u8 {
        match self {
            Self::BootUp => 0,
            Self::Stopped => 4,
            Self::Operational => 5,
            Self::PreOperational => 127,
            Self::Other(raw) => raw,
        }
    }

    /// Decodes the lowest seven bits.
    pub const fn from_raw(raw: u8) -> Self {
        match raw & 0x7F {
            0 => Self::BootUp,
            4 => Self::Stopped,
            5 => Self::Operational,
            127 => Self::PreOperational,
            other => Self::Other(other),
        }
    }
}

impl fmt::Display for NmtState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::BootUp => f.write_str("boot-up"),
            Self::Stopped => f.write_str("stopped"),
            Self::Operational => f.write_str("operational"),
            Self::PreOperational => f.write_str("pre-operational"),
            Self::Other(raw) => write!(f, "state {raw}"),
        }
    }
}

/// An emergency (CiA 301, clause 7.2.7).
///
/// | bytes | content |
/// |---|---|
/// | 0, 1 | error code, as object 603Fh |
/// | 2 | error register, as object 1001h |
/// | 3 to 7 | manufacturer-specific |
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Emergency {
    /// Error code; 0 is "error reset or no error".
    pub code: u16,
    /// Error register.
    pub register: u8,
    /// Manufacturer-specific.
    pub data: [u8; 5],
}

impl Emergency {
    /// From the bytes of a frame.
    pub const fn decode(bytes: &[u8; 8]) -> Self {
        let [a, b, register, data @ ..] = *bytes;
        Self {
            code: u16::from_le_bytes([a, b]),
            register,
            data,
        }
    }

    /// The bytes of the frame.
    pub const fn encode(&self) -> [u8; 8] {
        let [a, b] = self.code.to_le_bytes();
        let [c, d, e, f, g] = self.data;
        [a, b, self.register, c, d, e, f, g]
    }
}

/// A decoded CANopen message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Message {
    /// NMT command to a node, or to all nodes.
    Nmt(NmtCommand, Option<NodeId>),
    /// SYNC, with its counter if it has one.
    Sync(Option<u8>),
    /// TIME: ms since midnight, days since 1984-01-01.
    Time(u32, u16),
    /// An emergency.
    Emergency(NodeId, Emergency),
    /// TPDO 1 to 4 of a node.
    Tpdo(NodeId, u8),
    /// RPDO 1 to 4 of a node.
    Rpdo(NodeId, u8),
    /// From an SDO server.
    SdoResponse(NodeId, sdo::Message),
    /// To an SDO server.
    SdoRequest(NodeId, sdo::Message),
    /// Heartbeat or guarding response: node state and toggle bit.
    Heartbeat(NodeId, NmtState, bool),
    /// Node guarding request.
    Guard(NodeId),
    /// LSS; `true` from the master.
    Lss(bool, [u8; 8]),
    /// Not in the pre-defined connection set, or of invalid length.
    Unknown,
}

pub(super) fn frame(id: Id, data: &[u8]) -> Frame {
    // Callers in this crate pass at most eight bytes.
    Frame::new(id, data).unwrap_or_else(|_| Frame::empty(id))
}

impl Message {
    /// A decoded CANopen message.
    pub fn decode(frame: &Frame) -> Self {
        let id = frame.id();
        if id.is_extended() {
            return Self::Unknown;
        }
        let data = frame.data();
        let eight = || data.first_chunk::<8>().copied();
        if frame.is_remote() {
            return match Self::node(id, HEARTBEAT) {
                Some(node) => Self::Guard(node),
                None => Self::Unknown,
            };
        }
        match (id, data) {
            (NMT, [command, node]) => {
                return Self::Nmt(NmtCommand::from_raw(*command), NodeId::new(*node).ok());
            }
            (SYNC, []) => return Self::Sync(None),
            (SYNC, [counter]) => return Self::Sync(Some(*counter)),
            (TIME, [a, b, c, d, e, f]) => {
                let ms = u32::from_le_bytes([*a, *b, *c, *d]) & 0x0FFF_FFFF;
                return Self::Time(ms, u16::from_le_bytes([*e, *f]));
            }
            (LSS_MASTER | LSS_SLAVE, _) => {
                let master = id == LSS_MASTER;
                return eight().map_or(Self::Unknown, |bytes| Self::Lss(master, bytes));
            }
            _ => {}
        }
        Self::of_node(id, data).unwrap_or(Self::Unknown)
    }

    /// The node number of an identifier of a function code.
    fn node(id: Id, function: u16) -> Option<NodeId> {
        let raw = u16::try_from(id.raw()).ok()?;
        let [number, _] = (raw & 0x7F).to_le_bytes();
        (raw & 0x780 == function).then(|| NodeId::new(number).ok())?
    }

    fn of_node(id: Id, data: &[u8]) -> Option<Self> {
        let eight = || data.first_chunk::<8>().copied();
        let raw = u16::try_from(id.raw()).ok()?;
        let function = raw & 0x780;
        let node = Self::node(id, function)?;
        let [_, hundreds] = function.to_le_bytes();
        Some(match function {
            EMERGENCY => Self::Emergency(node, Emergency::decode(&eight()?)),
            SDO_RESPONSE => Self::SdoResponse(node, eight()?),
            SDO_REQUEST => Self::SdoRequest(node, eight()?),
            HEARTBEAT => match data {
                [state] => Self::Heartbeat(node, NmtState::from_raw(*state), state & 0x80 != 0),
                _ => return None,
            },
            0x180 | 0x280 | 0x380 | 0x480 => Self::Tpdo(node, hundreds),
            0x200 | 0x300 | 0x400 | 0x500 => Self::Rpdo(node, hundreds - 1),
            _ => return None,
        })
    }
}

/// SYNC, with counter if 1019h requires one.
pub fn sync(counter: Option<u8>) -> Frame {
    match counter {
        Some(counter) => frame(SYNC, &[counter]),
        None => frame(SYNC, &[]),
    }
}

/// A heartbeat or, in [`NmtState::BootUp`], a boot-up message.
pub fn heartbeat(node: NodeId, state: NmtState) -> Frame {
    frame(node.cob(HEARTBEAT), &[state.raw()])
}

/// An emergency of a node.
pub fn emergency(node: NodeId, emergency: &Emergency) -> Frame {
    frame(node.cob(EMERGENCY), &emergency.encode())
}

impl fmt::Display for Message {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Nmt(command, Some(node)) => write!(f, "NMT {command}, node {node}"),
            Self::Nmt(command, None) => write!(f, "NMT {command}, all nodes"),
            Self::Sync(Some(counter)) => write!(f, "SYNC {counter}"),
            Self::Sync(None) => f.write_str("SYNC"),
            Self::Time(ms, days) => write!(f, "TIME day {days} + {ms} ms"),
            Self::Emergency(node, emergency) => {
                let Emergency { code, register, .. } = emergency;
                let text = error_text(*code);
                write!(
                    f,
                    "node {node} EMCY {code:04X}h {text}, register {register:02X}h"
                )
            }
            Self::Tpdo(node, number) => write!(f, "node {node} TPDO{number}"),
            Self::Rpdo(node, number) => write!(f, "node {node} RPDO{number}"),
            Self::SdoResponse(node, message) => match sdo::Response::decode(message) {
                Some(response) => {
                    write!(f, "node {node} SDO < {response}")?;
                    words::of_response(f, &response)
                }
                None => write!(f, "node {node} SDO < unknown command {:02X}h", message[0]),
            },
            Self::SdoRequest(node, message) => match sdo::Request::decode(message) {
                Some(request) => {
                    write!(f, "node {node} SDO > {request}")?;
                    words::of_request(f, &request)
                }
                None => write!(f, "node {node} SDO > unknown command {:02X}h", message[0]),
            },
            Self::Heartbeat(node, state, _) => write!(f, "node {node} {state}"),
            Self::Guard(node) => write!(f, "node {node} guard"),
            Self::Lss(master, [command, ..]) => {
                let arrow = if *master { '>' } else { '<' };
                match words::of_lss(*command) {
                    Some(name) => write!(f, "LSS {arrow} {name}"),
                    None => write!(f, "LSS {arrow} command {command}"),
                }
            }
            Self::Unknown => f.write_str("-"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::LogLine;

    /// Frames in cansend syntax and their decoded text.
    #[test]
    fn message_golden_frames_are_decoded() {
        for (text, meaning) in [
            ("000#0105", "NMT start, node 5"),
            ("000#8000", "NMT enter pre-operational, all nodes"),
            ("000#8205", "NMT reset communication, node 5"),
            ("080#", "SYNC"),
            ("080#07", "SYNC 7"),
            (
                "085#1186210102030405",
                "node 5 EMCY 8611h following error, register 21h",
            ),
            ("100#010000000200", "TIME day 2 + 1 ms"),
            ("185#3706", "node 5 TPDO1"),
            ("485#3706", "node 5 TPDO4"),
            ("205#0600", "node 5 RPDO1"),
            ("505#0600", "node 5 RPDO4"),
            ("605#4041600000000000", "node 5 SDO > read 6041h:00"),
            (
                "605#2B40600006000000",
                "node 5 SDO > write 6040h:00 = 06 00 (shutdown)",
            ),
            (
                "585#4B41600037020000",
                "node 5 SDO < 6041h:00 = 37 02 (operation enabled)",
            ),
            (
                "585#4B41680018020000",
                "node 5 SDO < 6841h:00 = 18 02 (fault)",
            ),
            (
                "585#4B40600006008FAF",
                "node 5 SDO < 6040h:00 = 06 00 (shutdown)",
            ),
            (
                "585#4B3F600011860000",
                "node 5 SDO < 603Fh:00 = 11 86 (following error)",
            ),
            ("585#4B41600001000000", "node 5 SDO < 6041h:00 = 01 00"),
            ("585#FF41600037020000", "node 5 SDO < unknown command FFh"),
            ("705#00", "node 5 boot-up"),
            ("705#7F", "node 5 pre-operational"),
            ("705#05", "node 5 operational"),
            ("705#R", "node 5 guard"),
            ("7E5#0401000000000000", "LSS > switch all to a mode"),
            (
                "7E5#4C00000000000000",
                "LSS > identify those without a node number",
            ),
            (
                "7E4#5000000000000000",
                "LSS < identified, without a node number",
            ),
            ("7E5#0300000000000000", "LSS > command 3"),
            ("700#05", "-"),
            ("605#40", "-"),
            ("00000605#4041600000000000", "-"),
        ] {
            let line = format!("(1.000000) can0 {text}");
            let line = LogLine::parse(&line).unwrap();
            assert_eq!(Message::decode(&line.frame).to_string(), meaning, "{text}");
        }
    }

    #[test]
    fn message_frames_survive_round_trip() {
        let node = NodeId::new(5).unwrap();
        let command = NmtCommand::ResetNode;
        let built = Message::decode(&command.frame(Some(node)));
        assert_eq!(built, Message::Nmt(command, Some(node)));
        assert_eq!(
            Message::decode(&command.frame(None)),
            Message::Nmt(command, None)
        );
        assert_eq!(Message::decode(&sync(Some(3))), Message::Sync(Some(3)));
        let beat = heartbeat(node, NmtState::Operational);
        assert_eq!(
            Message::decode(&beat),
            Message::Heartbeat(node, NmtState::Operational, false)
        );
        let sent = Emergency {
            code: 0x8130,
            register: 0x11,
            data: [1, 2, 3, 4, 5],
        };
        assert_eq!(
            Message::decode(&emergency(node, &sent)),
            Message::Emergency(node, sent)
        );
        for raw in 0..=u8::MAX {
            assert_eq!(NmtCommand::from_raw(raw).raw(), raw);
            assert_eq!(NmtState::from_raw(raw).raw(), raw & 0x7F);
            assert_eq!(NodeId::new(raw).is_ok(), (1..=127).contains(&raw));
        }
        assert_eq!(NodeId::all().count(), 127);
    }

    #[test]
    fn message_every_identifier_decodes() {
        for raw in 0..=0x7FF {
            let id = Id::standard(raw).unwrap();
            for len in 0..=8 {
                let frame = Frame::new(id, &[0x7F; 8][..len]).unwrap();
                let _ = Message::decode(&frame).to_string();
            }
        }
    }
}
