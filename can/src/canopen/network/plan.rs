//! What a network is to be: its nodes, what each is told before it runs, and which of its objects
//! go in PDOs. It is made before anything runs, by hand or from a DCF.

use std::time::Duration;

use takt_cia402::Patience;
use takt_cia402::dictionary::{Address, Mapped};
use takt_cia402::proof::Objects;

use crate::canopen::NodeId;
use crate::canopen::pdo::{Direction, Parameters, PdoCob, Transmission};

/// A value to be written before a node runs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Download {
    /// Where.
    pub address: Address,
    /// What, little-endian.
    pub data: Vec<u8>,
    /// Whether it is read back and compared.
    pub verify: bool,
    /// Whether a device may do without the object.
    pub may_lack: bool,
}

impl Download {
    /// A value that is read back.
    #[must_use]
    pub fn new(index: u16, sub: u8, data: &[u8]) -> Self {
        Self {
            address: Address::new(index, sub),
            data: data.to_vec(),
            verify: true,
            may_lack: false,
        }
    }

    /// The same, of an object that a device need not have.
    #[must_use]
    pub fn where_present(self) -> Self {
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

    /// Whether a device that shows these bytes took the value. Of the COB-ID of a PDO or of emergencies only the
    /// identifier and bit 31 count; all else is compared byte by byte.
    #[must_use]
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

/// How the master notices that a node is gone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Supervision {
    /// The node sends a heartbeat (1017h), at most 65 s apart; it is lost after 2.5 times that.
    Heartbeat(Duration),
    /// The master asks: every so often (100Ch), and so many questions may stay open (100Dh).
    Guarding(Duration, u8),
    /// It does not.
    None,
}

/// An axis of a node: which logical device of a multi-axis drive it is, and how it is led.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AxisPlan {
    /// 0 to 7.
    pub axis: u8,
    /// How the drive departs from the profile.
    pub patience: Patience,
    /// Farthest that 607Ah may be from 6064h when the drive begins to follow, user units.
    pub jump_max: u32,
    /// SYNCs that its TPDOs may be missing before it is stopped.
    pub missing_max: u32,
    /// Longest time for a homing run.
    pub homing: Duration,
    /// 60C2h: time from one set-point to the next, which is that of SYNC; `None` leaves what the drive has.
    pub set_point_period: Option<Duration>,
    /// 6007h: what the drive does when it loses its master (0 nothing, 1 fault, 2 disable voltage, 3
    /// quick stop); `None` leaves what it has.
    pub on_link_loss: Option<i16>,
    /// 60A4h:01: largest jerk of its own motions (profile position and velocity), user units/s^3; then the profile
    /// type (6086h) is the jerk-limited ramp. `None` leaves what the drive has.
    pub jerk_max: Option<u32>,
    /// 60C4h: interpolated position goes through a queue of so many data records, which evens out when they come;
    /// `None` leaves what the drive has.
    pub records: Option<u8>,
    /// Objects whose SDO server does not show what PDOs carry: they are not compared before it gets power.
    pub not_mirrored: Objects,
}

impl AxisPlan {
    /// Whether a drive can be told that set-points come so far apart: at most 255 of 1 us, 10 us, 100 us or
    /// 1 ms (60C2h).
    #[must_use]
    pub fn can_be_told(period: Duration) -> bool {
        time_index(period).is_some()
    }

    /// What its drive is told before it runs. 60C2h and 6007h are optional objects that a drive may do without; the
    /// others are asked for on purpose.
    fn downloads(&self) -> Vec<Download> {
        let at = |index, sub, data: &[u8]| {
            let address = Address::new(index, sub).on_axis(self.axis)?;
            Some(Download::new(address.index, address.sub, data))
        };
        let period = self.set_point_period.and_then(time_index);
        let period = period.into_iter().flat_map(|(value, exponent)| {
            // The unit first: some drives check the product of both with each write.
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
        let records = self.records.into_iter().flat_map(|places| {
            // Empty and closed while it is set up.
            let clear = |open: u8| at(0x60C4, 6, &[open]).map(Download::unverified);
            let places = at(0x60C4, 2, &u32::from(places).to_le_bytes());
            [clear(0), places, at(0x60C4, 3, &[0]), clear(1)]
        });
        let asked = jerk.chain(records).flatten();
        optional.map(Download::where_present).chain(asked).collect()
    }
}

/// Profile type 6086h.
const JERK_LIMITED: i16 = 3;

/// A time as 60C2h has it: a number and the power of ten of its unit in seconds. `None` for one that
/// eight bits do not hold to the microsecond.
fn time_index(period: Duration) -> Option<(u8, i8)> {
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
            patience: Patience::default(),
            jump_max: 1000,
            missing_max: 3,
            homing: Duration::from_secs(60),
            set_point_period: None,
            on_link_loss: None,
            jerk_max: None,
            records: None,
            not_mirrored: Objects::default(),
        }
    }
}

/// PDOs that each axis of a drive has room for (CiA 402-3).
const AXIS_PDOS: u16 = 64;

/// PDOs each way for which a node number has identifiers (CiA 301, predefined connection set).
const IDENTIFIERS: u8 = 4;

/// What one node is to be.
#[derive(Clone, Debug)]
pub struct NodePlan {
    /// Its number.
    pub id: NodeId,
    /// 1000h; `None`: any.
    pub device_type: Option<u32>,
    /// 1018h:01 to 04; `None`: any.
    pub identity: [Option<u32>; 4],
    /// How it is watched.
    pub supervision: Supervision,
    /// What it is told, after its PDOs.
    pub downloads: Vec<Download>,
    /// The PDOs it receives, by number from 0.
    pub rpdos: Vec<(u16, Parameters)>,
    /// The PDOs it transmits, by number from 0.
    pub tpdos: Vec<(u16, Parameters)>,
    /// Its axes.
    pub axes: Vec<AxisPlan>,
    /// Longest value read from or written to it, bytes.
    pub sdo_len_max: usize,
}

impl NodePlan {
    /// A node without PDOs that sends a heartbeat every 100 ms.
    #[must_use]
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

    /// A drive with one axis whose position, or velocity and torque too, go with every SYNC.
    ///
    /// | PDO | objects |
    /// |---|---|
    /// | RPDO 1 | 6040h, 6060h, 607Ah |
    /// | RPDO 2 | 60FFh, 6071h |
    /// | TPDO 1 | 6041h, 6061h, 6064h |
    /// | TPDO 2 | 606Ch, 6077h |
    #[must_use]
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

    /// A drive with several axes whose positions go with every SYNC, each by one PDO each way: 6040h, 6060h and
    /// 607Ah to it, 6041h, 6061h and 6064h from it. Each axis has 64 PDOs of its own (CiA 402-3); their identifiers
    /// are those of the first four PDOs of the node, and from the fifth axis on those of the next node number, which
    /// no other node of the network may then have. `None` for no axis, for more than [`Self::AXES_MAX`], and if there
    /// is no next number.
    #[must_use]
    pub fn drives(id: NodeId, axes: &[AxisPlan]) -> Option<Self> {
        if axes.is_empty() || axes.len() > Self::AXES_MAX {
            return None;
        }
        let mut all = Self::new(id);
        for (place, axis) in (0_u8..).zip(axes) {
            let one = Self::drive(id, *axis);
            let number = AXIS_PDOS * u16::from(axis.axis);
            let of = NodeId::new(id.raw() + place / IDENTIFIERS).ok()?;
            let function = 0x100 * u16::from(place % IDENTIFIERS);
            let of_axis = |pdos: Vec<(u16, Parameters)>, first: u16| {
                let pdo = pdos.into_iter().next().map(|(_, pdo)| pdo);
                let cob = PdoCob::new(of.cob(first + function));
                pdo.map(|pdo| (number, Parameters { cob, ..pdo }))
            };
            all.rpdos.extend(of_axis(one.rpdos, 0x200));
            all.tpdos.extend(of_axis(one.tpdos, 0x180));
            all.axes.push(*axis);
        }
        Some(all)
    }

    /// Axes of a multi-axis drive (CiA 402-3).
    pub const AXES_MAX: usize = 8;

    /// All that is written before it runs: supervision, PDOs by the procedure, its own values.
    #[must_use]
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

    /// PDOs 1 to 4, if they are not planned and another one gets their identifier: what is on from the factory
    /// or was stored would take its frames, and an axis that nobody asked would be enabled by them.
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

/// The procedure of CiA 301 (clause 7.5.2.36): off, times, count 0, entries, count, on.
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
