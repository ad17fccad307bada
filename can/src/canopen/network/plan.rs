//! Configuration plan of a network: its nodes, the values written to each before it runs, and its
//! PDO mapping. It is created before the start, by hand or from a DCF.

use std::time::Duration;

use takt_cia402::MasterOptions;
use takt_cia402::dictionary::{Address, Mapped};
use takt_cia402::proof::Objects;

use crate::canopen::NodeId;
use crate::canopen::pdo::{Direction, Parameters, PdoCob, Transmission};

/// A value to write before a node runs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Download {
    /// The object.
    pub address: Address,
    /// The value, little-endian.
    pub data: Vec<u8>,
    /// Whether it is read back and compared.
    pub verify: bool,
    /// Whether the object is optional.
    pub may_lack: bool,
}

impl Download {
    /// A value that is read back.
    pub fn new(index: u16, sub: u8, data: &[u8]) -> Self {
        Self {
            address: Address::new(index, sub),
            data: data.to_vec(),
            verify: true,
            may_lack: false,
        }
    }

    /// Marks the object as optional.
    #[must_use]
    pub(crate) fn where_present(self) -> Self {
        Self {
            may_lack: true,
            ..self
        }
    }

    fn unverified(self) -> Self {
        Self {
            verify: false,
            ..self
        }
    }

    /// Whether these bytes, read back, equal the value. For COB-IDs of PDOs and EMCY only the identifier and bit 31 are
    /// compared, for others every byte.
    pub fn is_taken(&self, bytes: &[u8]) -> bool {
        let cob = |bytes: &[u8]| {
            let four = <[u8; 4]>::try_from(bytes).ok()?;
            Some(PdoCob::from_raw(u32::from_le_bytes(four)))
        };
        let pdo = Direction::of(self.address.index).is_some_and(|(.., mapping)| !mapping);
        let is_cob = pdo && self.address.sub == 1 || self.address == Address::new(0x1014, 0);
        match (cob(&self.data), cob(bytes)) {
            (Some(written), Some(read)) if is_cob => written.is_same(read),
            _ => bytes == self.data.as_slice(),
        }
    }
}

/// How the master detects the loss of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Supervision {
    /// The node sends a heartbeat (1017h), at most 65 s apart; it is lost after 2.5 periods without
    /// one.
    Heartbeat(Duration),
    /// Node guarding: the master sends a request every period (100Ch); the node is lost after this
    /// many unanswered requests (100Dh).
    Guarding(Duration, u8),
    /// No monitoring.
    None,
}

/// An axis of a node: its logical device in a multi-axis drive, and its limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AxisPlan {
    /// 0 to 7.
    pub axis: u8,
    /// Timeouts and deviations of the drive from the profile.
    pub options: MasterOptions,
    /// Maximum distance of 607Ah from 6064h when the drive starts to follow, user units.
    pub jump_max: u32,
    /// Maximum consecutive SYNCs without its TPDOs before it is stopped.
    pub missing_max: u32,
    /// Timeout of a homing run.
    pub homing: Duration,
    /// 60C2h: interpolation time period, equal to the SYNC period; `None` keeps the drive's value.
    pub set_point_period: Option<Duration>,
    /// 6007h: reaction of the drive to the loss of its master (0 nothing, 1 fault, 2 disable voltage, 3 quick stop);
    /// `None` keeps the drive's value.
    pub on_link_loss: Option<i16>,
    /// 6060h of an axis that never changes its mode of operation: written before the node runs, and torques (60B2h, 6077h) are
    /// exchanged in its place by [`NodePlan::drives`]; 6061h is uploaded once a second. `None` exchanges 6060h and 6061h.
    pub mode: Option<i8>,
    /// 60A4h:01: maximum jerk of its own motions (profile position and velocity), user units/s^3; then the profile type
    /// (6086h) is the jerk-limited ramp. `None` keeps the drive's value.
    pub jerk_max: Option<u32>,
    /// 60C4h: size of the data record buffer of interpolated position, which compensates jitter; `None` keeps the
    /// drive's value.
    pub records: Option<u8>,
    /// Objects whose SDO values differ from the PDO values: the proof before power-on skips them.
    pub not_mirrored: Objects,
}

impl AxisPlan {
    /// Whether 60C2h can represent this period: at most 255 units of 1 us, 10 us, 100 us or 1 ms.
    pub fn supports_period(period: Duration) -> bool {
        time_index(period).is_some()
    }

    /// Values written to the drive before it runs. 60C2h and 6007h are optional objects; the others are explicitly
    /// requested.
    fn downloads(&self) -> Vec<Download> {
        let at = |index, sub, data: &[u8]| {
            let address = Address::new(index, sub).on_axis(self.axis)?;
            Some(Download::new(address.index, address.sub, data))
        };
        let period = self.set_point_period.and_then(time_index);
        let period = period.into_iter().flat_map(|(value, exponent)| {
            // The unit first: some drives check the product of both on each write.
            [(2, exponent.to_le_bytes()), (1, value.to_le_bytes())]
        });
        let period = period.filter_map(|(sub, data)| at(0x60C2, sub, &data));
        let loss = self.on_link_loss;
        let loss = loss.and_then(|option| at(0x6007, 0, &option.to_le_bytes()));
        let optional = loss.into_iter().chain(period);
        let jerk = self.jerk_max.into_iter().flat_map(|jerk| {
            let limit = at(0x60A4, 1, &jerk.to_le_bytes());
            [limit, at(0x6086, 0, &JERK_LIMITED.to_le_bytes())]
        });
        let records = self.records.into_iter().flat_map(|capacity| {
            // Clear and disable the buffer during configuration.
            let clear = |open: u8| at(0x60C4, 6, &[open]).map(Download::unverified);
            let capacity = at(0x60C4, 2, &u32::from(capacity).to_le_bytes());
            [clear(0), capacity, at(0x60C4, 3, &[0]), clear(1)]
        });
        let mode = self
            .mode
            .and_then(|mode| at(0x6060, 0, &mode.to_le_bytes()));
        let requested = jerk.chain(records).flatten().chain(mode);
        optional
            .map(Download::where_present)
            .chain(requested)
            .collect()
    }
}

/// Profile type 6086h.
const JERK_LIMITED: i16 = 3;

/// A period in the format of 60C2h: value and decimal exponent in seconds. `None` if eight bits cannot represent it
/// exactly.
#[doc(alias = "60C2h")]
pub fn time_index(period: Duration) -> Option<(u8, i8)> {
    let nanos = period.as_nanos();
    let of_unit = |(unit, exponent): (u128, i8)| {
        let value = u8::try_from(nanos / unit).ok()?;
        (nanos.is_multiple_of(unit) && value > 0).then_some((value, exponent))
    };
    [(1_000_000, -3), (100_000, -4), (10_000, -5), (1_000, -6)]
        .into_iter()
        .find_map(of_unit)
}

impl Default for AxisPlan {
    fn default() -> Self {
        Self {
            axis: 0,
            options: MasterOptions::default(),
            jump_max: 1000,
            missing_max: 3,
            homing: Duration::from_secs(60),
            set_point_period: None,
            on_link_loss: None,
            mode: None,
            jerk_max: None,
            records: None,
            not_mirrored: Objects::default(),
        }
    }
}

/// PDO numbers per axis of a drive (CiA 402-3).
const AXIS_PDOS: u16 = 64;

/// PDOs per direction with identifiers of a node number (CiA 301, pre-defined connection set).
const IDENTIFIERS: u8 = 4;

/// Plan of one node.
#[derive(Clone, Debug)]
pub struct NodePlan {
    /// Node number.
    pub id: NodeId,
    /// 1000h; `None`: any.
    pub device_type: Option<u32>,
    /// 1018h:01 to 04; `None`: any.
    pub identity: [Option<u32>; 4],
    /// Monitoring.
    pub supervision: Supervision,
    /// Values written after the PDO configuration.
    pub downloads: Vec<Download>,
    /// The PDOs it receives, by number from 0.
    pub rpdos: Vec<(u16, Parameters)>,
    /// The PDOs it transmits, by number from 0.
    pub tpdos: Vec<(u16, Parameters)>,
    /// Its axes.
    pub axes: Vec<AxisPlan>,
    /// Maximum length of SDO values, bytes.
    pub sdo_len_max: usize,
}

impl NodePlan {
    /// A node without PDOs that sends a heartbeat every 100 ms.
    pub const fn new(id: NodeId) -> Self {
        Self {
            id,
            device_type: None,
            identity: [None; 4],
            supervision: Supervision::Heartbeat(Duration::from_millis(100)),
            downloads: Vec::new(),
            rpdos: Vec::new(),
            tpdos: Vec::new(),
            axes: Vec::new(),
            sdo_len_max: 4096,
        }
    }

    /// A drive with one axis whose position, velocity and torque are exchanged with every SYNC.
    ///
    /// | PDO | objects |
    /// |---|---|
    /// | RPDO 1 | 6040h, 6060h, 607Ah |
    /// | RPDO 2 | 60FFh, 6071h |
    /// | TPDO 1 | 6041h, 6061h, 6064h |
    /// | TPDO 2 | 606Ch, 6077h |
    pub fn drive(id: NodeId, axis: AxisPlan) -> Self {
        let entry = |(index, bits): &(u16, u8)| Mapped {
            address: Address::new(index + Address::AXIS * u16::from(axis.axis), 0),
            bits: *bits,
        };
        let pdo = |function: u16, entries: &[(u16, u8)]| {
            let mapping = entries.iter().map(entry).collect();
            Parameters::new(
                PdoCob::new(id.cob(function)),
                Transmission::Sync(1),
                mapping,
            )
        };
        Self {
            rpdos: vec![
                (0, pdo(0x200, &[(0x6040, 16), (0x6060, 8), (0x607A, 32)])),
                (1, pdo(0x300, &[(0x60FF, 32), (0x6071, 16)])),
            ],
            tpdos: vec![
                (0, pdo(0x180, &[(0x6041, 16), (0x6061, 8), (0x6064, 32)])),
                (1, pdo(0x280, &[(0x606C, 32), (0x6077, 16)])),
            ],
            axes: vec![axis],
            ..Self::new(id)
        }
    }

    /// A drive with several axes whose positions are exchanged with every SYNC by one PDO per axis and direction:
    /// 6040h, 6060h and 607Ah to it, 6041h, 6061h and 6064h from it. An axis with a constant [`mode`](AxisPlan::mode) exchanges
    /// torques instead of it: 6040h, 607Ah and 60B2h, 6041h, 6064h and 6077h. Each axis has its own 64 PDO numbers (CiA 402-3).
    /// The first four axes use the identifiers of the node's PDOs 1 to 4, further axes those of the next node number,
    /// which no other node of the network may then use. `None` without axes, with more than [`Self::AXES_MAX`], or if
    /// there is no next number.
    pub fn drives(id: NodeId, axes: &[AxisPlan]) -> Option<Self> {
        if axes.is_empty() || axes.len() > Self::AXES_MAX {
            return None;
        }
        let mut all = Self::new(id);
        for (slot, axis) in (0_u8..).zip(axes) {
            let one = Self::drive(id, *axis);
            let number = AXIS_PDOS * u16::from(axis.axis);
            let of = NodeId::new(id.raw() + slot / IDENTIFIERS).ok()?;
            let function = 0x100 * u16::from(slot % IDENTIFIERS);
            let of_axis = |pdos: Vec<(u16, Parameters)>, first: u16, torque: u16| {
                let (_, mut pdo) = pdos.into_iter().next()?;
                pdo.cob = PdoCob::new(of.cob(first + function));
                if axis.mode.is_some() {
                    pdo.mapping.retain(|entry| entry.bits > 8);
                    let address = Address::new(torque, 0).on_axis(axis.axis)?;
                    pdo.mapping.push(Mapped { address, bits: 16 });
                }
                Some((number, pdo))
            };
            all.rpdos.extend(of_axis(one.rpdos, 0x200, 0x60B2));
            all.tpdos.extend(of_axis(one.tpdos, 0x180, 0x6077));
            all.axes.push(*axis);
        }
        Some(all)
    }

    /// Maximum axes of a multi-axis drive (CiA 402-3).
    pub const AXES_MAX: usize = 8;

    /// All values written before it runs: monitoring, PDO configuration, axes, its own values.
    pub fn all_downloads(&self, master: Option<(NodeId, Duration)>) -> Vec<Download> {
        let mut all = Vec::new();
        match self.supervision {
            Supervision::Heartbeat(period) => {
                all.push(Download::new(0x1017, 0, &ms16(period).to_le_bytes()));
            }
            Supervision::Guarding(period, factor) => {
                all.push(Download::new(0x1017, 0, &[0, 0]));
                all.push(Download::new(0x100C, 0, &ms16(period).to_le_bytes()));
                all.push(Download::new(0x100D, 0, &[factor]));
            }
            Supervision::None => {}
        }
        if let Some((master, period)) = master {
            let time = u32::from(ms16(period * 5 / 2)) | u32::from(master.raw()) << 16;
            all.push(Download::new(0x1016, 1, &time.to_le_bytes()));
        }
        all.extend(self.others_off(Direction::Receive, 0x200, &self.rpdos));
        all.extend(self.others_off(Direction::Transmit, 0x180, &self.tpdos));
        let receive = self.rpdos.iter().map(|pdo| (Direction::Receive, pdo));
        let transmit = self.tpdos.iter().map(|pdo| (Direction::Transmit, pdo));
        for (direction, (number, parameters)) in receive.chain(transmit) {
            all.extend(pdo_downloads(direction, *number, parameters));
        }
        all.extend(self.axes.iter().flat_map(AxisPlan::downloads));
        all.extend(self.downloads.iter().cloned());
        all
    }

    /// Disables PDOs 1 to 4 if they are not planned but another PDO uses their identifier: left enabled by default or
    /// stored settings, they would receive its frames and enable an axis that was not commanded.
    fn others_off<'a>(
        &'a self,
        direction: Direction,
        first: u16,
        pdos: &'a [(u16, Parameters)],
    ) -> impl Iterator<Item = Download> + 'a {
        let functions = (0..4_u16).zip((first..).step_by(0x100));
        functions.filter_map(move |(number, function)| {
            let cob = PdoCob::new(self.id.cob(function));
            let planned = pdos.iter().any(|(n, _)| *n == number);
            let taken = pdos.iter().any(|(_, pdo)| pdo.cob.id() == cob.id());
            let off = cob.off().raw().to_le_bytes();
            let off = Download::new(direction.communication() + number, 1, &off);
            (taken && !planned).then(|| off.unverified().where_present())
        })
    }
}

fn ms16(time: Duration) -> u16 {
    u16::try_from(time.as_millis()).unwrap_or(u16::MAX)
}

/// The PDO mapping procedure of CiA 301 (clause 7.5.2.36): disable, times, count 0, entries, count,
/// enable.
fn pdo_downloads(direction: Direction, number: u16, pdo: &Parameters) -> Vec<Download> {
    let (index, mapping) = (
        direction.communication() + number,
        direction.mapping() + number,
    );
    let cob = |cob: PdoCob| Download::new(index, 1, &cob.raw().to_le_bytes());
    let mut all = vec![
        cob(pdo.cob.off()).unverified(),
        Download::new(index, 2, &[pdo.transmission.raw()]),
    ];
    if pdo.inhibit > 0 {
        all.push(Download::new(index, 3, &pdo.inhibit.to_le_bytes()));
    }
    if pdo.event > 0 {
        all.push(Download::new(index, 5, &pdo.event.to_le_bytes()));
    }
    if pdo.sync_start > 0 {
        all.push(Download::new(index, 6, &[pdo.sync_start]));
    }
    all.push(Download::new(mapping, 0, &[0]).unverified());
    for (sub, entry) in (1_u8..).zip(&pdo.mapping) {
        all.push(Download::new(mapping, sub, &entry.raw().to_le_bytes()));
    }
    let count = u8::try_from(pdo.mapping.len()).unwrap_or(u8::MAX);
    all.push(Download::new(mapping, 0, &[count]));
    all.push(cob(pdo.cob));
    all
}
