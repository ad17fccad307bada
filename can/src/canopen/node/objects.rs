//! The communication objects 1000h to 1FFFh of a node, built from the few parameters in which nodes
//! differ.

use std::borrow::Cow;

use takt_cia402::dictionary::{Access, Address, Entry, Object};

use crate::canopen::lss::Identity;
use crate::canopen::pdo::{Direction, Parameters};

/// Communication parameters of a device.
#[derive(Clone, Debug)]
pub struct Communication {
    /// 1000h: profile in the low word.
    pub device_type: u32,
    /// 1008h
    pub name: String,
    /// 1009h
    pub hardware: String,
    /// 100Ah
    pub software: String,
    /// 1018h
    pub identity: Identity,
    /// Number of monitored heartbeats, 1016h.
    pub consumers: u8,
    /// 1017h, ms; 0: off.
    pub heartbeat_ms: u16,
    /// RPDOs by number (from 0); identifiers exclude the node number, which is added.
    pub rpdos: Vec<(u16, Parameters)>,
    /// TPDOs, likewise.
    pub tpdos: Vec<(u16, Parameters)>,
    /// Maximum mapped entries of a PDO.
    pub mapped_max: u8,
}

impl Default for Communication {
    fn default() -> Self {
        Self {
            device_type: 0,
            name: "node".into(),
            hardware: "emulated".into(),
            software: env!("CARGO_PKG_VERSION").into(),
            identity: Identity::default(),
            consumers: 4,
            heartbeat_ms: 0,
            rpdos: Vec::new(),
            tpdos: Vec::new(),
            mapped_max: 8,
        }
    }
}

/// The entries of 1010h and 1011h: each executes on command (bit 0).
fn groups(all: &'static str, what: &str) -> Vec<Entry> {
    let entry = |name: Cow<'static, str>| Entry {
        name,
        ..Entry::number("", Access::ReadWrite, 1_u32)
    };
    let groups = ["communication", "application", "manufacturer"];
    let groups = groups.map(|group| entry(format!("{what} {group} parameters").into()));
    std::iter::once(entry(all.into())).chain(groups).collect()
}

impl Communication {
    /// The objects. COB-IDs exclude the node number; see [`Self::relative`].
    #[expect(clippy::too_many_lines, reason = "a table of objects")]
    pub fn objects(&self) -> Vec<Object> {
        let (ro, rw, constant) = (Access::ReadOnly, Access::ReadWrite, Access::Const);
        let mut history = Object::array(
            0x1003,
            "pre-defined error field",
            vec![Entry::number("standard error field", ro, 0_u32); 8],
        );
        history.entries[0].1 = Entry::number("number of errors", rw, 0_u8);
        let identity = self.identity.numbers();
        let names = [
            "vendor-ID",
            "product code",
            "revision number",
            "serial number",
        ];
        let identity = names.into_iter().zip(identity);
        let var = Object::var;
        let mut objects = vec![
            var(
                0x1000,
                Entry::number("device type", constant, self.device_type),
            ),
            var(0x1001, Entry::number("error register", ro, 0_u8)),
            history,
            var(0x1005, Entry::number("COB-ID SYNC", rw, 0x80_u32)),
            var(
                0x1006,
                Entry::number("communication cycle period", rw, 0_u32),
            ),
            var(
                0x1007,
                Entry::number("synchronous window length", rw, 0_u32),
            ),
            var(0x1008, Entry::text("manufacturer device name", &self.name)),
            var(
                0x1009,
                Entry::text("manufacturer hardware version", &self.hardware),
            ),
            var(
                0x100A,
                Entry::text("manufacturer software version", &self.software),
            ),
            var(0x100C, Entry::number("guard time", rw, 0_u16)),
            var(0x100D, Entry::number("life time factor", rw, 0_u8)),
            Object::array(
                0x1010,
                "store parameters",
                groups("save all parameters", "save"),
            ),
            Object::array(
                0x1011,
                "restore default parameters",
                groups("restore all default parameters", "restore"),
            ),
            var(
                0x1012,
                Entry::number("COB-ID time stamp", rw, 0x8000_0100_u32),
            ),
            var(0x1014, Entry::number("COB-ID EMCY", rw, 0x80_u32)),
            var(0x1015, Entry::number("inhibit time EMCY", rw, 0_u16)),
            Object::array(
                0x1016,
                "consumer heartbeat time",
                vec![Entry::number("consumer heartbeat time", rw, 0_u32); self.consumers.into()],
            ),
            var(
                0x1017,
                Entry::number("producer heartbeat time", rw, self.heartbeat_ms),
            ),
            Object::record(
                0x1018,
                "identity object",
                identity
                    .map(|(name, value)| Entry::number(name, constant, value))
                    .collect(),
            ),
            var(
                0x1019,
                Entry::number("synchronous counter overflow value", rw, 0_u8),
            ),
            Object::array(
                0x1029,
                "error behaviour",
                vec![Entry::number("communication error", rw, 0_u8)],
            ),
            Object::record(
                0x1200,
                "SDO server parameter",
                vec![
                    Entry::number("COB-ID client to server", ro, 0x600_u32),
                    Entry::number("COB-ID server to client", ro, 0x580_u32),
                ],
            ),
        ];
        for (direction, number, pdo) in self.pdos() {
            objects.extend(pdo.objects(direction, number, self.mapped_max));
        }
        objects
    }

    fn pdos(&self) -> impl Iterator<Item = (Direction, u16, &Parameters)> {
        let of = |direction| move |(number, pdo)| (direction, number, pdo);
        let receive = self.rpdos.iter().map(|(number, pdo)| (*number, pdo));
        let transmit = self.tpdos.iter().map(|(number, pdo)| (*number, pdo));
        receive
            .map(of(Direction::Receive))
            .chain(transmit.map(of(Direction::Transmit)))
    }

    /// The entries whose default is relative to the node number.
    pub fn relative(&self) -> Vec<Address> {
        let fixed = [(0x1014, 0), (0x1200, 1), (0x1200, 2)];
        let fixed = fixed.map(|(index, sub)| Address::new(index, sub));
        let pdos = self
            .pdos()
            .map(|(direction, number, _)| Address::new(direction.communication() + number, 1));
        fixed.into_iter().chain(pdos).collect()
    }
}
