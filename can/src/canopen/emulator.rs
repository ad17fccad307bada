//! Emulated CANopen drive (CiA 402) with up to eight axes, each with a motor. Time is an argument;
//! faults are injected by the caller.
//!
//! The motor moves in steps of 1 ms, and up to each SYNC: received set-points take effect at that
//! SYNC, and transmitted values are sampled at it.

use std::time::Duration;

use takt_cia402::dictionary::{
    AbortCode, Access, Address, DataType, Dictionary, DictionaryError, Entry, Mapped, Object,
};
use takt_cia402::emulator::{Drive, DriveConfig, FaultCode, Quirks, Step};

use super::eds::Eds;
use super::emcy::Source;
use super::lss::Identity;
use super::nmt::{Reset, State};
use super::node::{
    Application, Communication, Context, Event, Node, NodeConfig, NodeError, NodeQuirks,
};
use super::pdo::{Direction, Parameters, PdoCob, Transmission, number_at};
use super::{NodeId, RPDO1, TPDO1};

mod generic;
mod sync_period;
#[cfg(test)]
mod tests;

pub use generic::{Generators, GenericConfig, GenericError, GenericNode, Signal, Wave, signals};
use sync_period::SyncPeriod;

/// Maximum axes of a drive (CiA 402-2).
pub const AXES_MAX: usize = 8;
/// Data record of interpolated position.
const RECORD: Address = Address::new(0x60C1, 1);
/// PDO numbers per axis (CiA 402-3).
const AXIS_PDOS: u16 = 64;
const STEP: Duration = Duration::from_millis(1);
/// Maximum time to catch up in one call.
const BEHIND_MAX: Duration = Duration::from_millis(100);

/// Configuration of an emulated drive.
#[derive(Clone, Debug)]
pub struct DriveNodeConfig {
    /// Node number; without one it waits for LSS.
    pub id: Option<NodeId>,
    /// LSS address, object 1018h.
    pub identity: Identity,
    /// Axes, at most [`AXES_MAX`].
    pub axes: Vec<DriveConfig>,
    /// 1017h after a reset, ms; 0 is off.
    pub heartbeat_ms: u16,
    /// Bytes of the domain 2000h, a firmware or a recording to be transferred; 0 leaves it out.
    pub domain_len: usize,
    /// Whether it stores its own data sheet (1021h), as text (1022h is 0).
    pub stored_eds: bool,
    /// Timeout of the SDO server. In a block upload the client must take 127 segments within it.
    pub sdo_timeout: Duration,
    /// Deviations of the node from CiA 301; each axis holds its deviations from CiA 402.
    pub quirks: NodeQuirks,
}

impl DriveNodeConfig {
    /// A drive with one axis.
    pub fn new(id: NodeId) -> Self {
        Self {
            id: Some(id),
            identity: Identity {
                vendor: 0,
                product: 0x402,
                revision: 1,
                serial: id.raw().into(),
            },
            axes: vec![DriveConfig::default()],
            heartbeat_ms: 0,
            domain_len: 0,
            stored_eds: false,
            sdo_timeout: Duration::from_secs(2),
            quirks: NodeQuirks::default(),
        }
    }

    /// Adds a quirk by name: of the node ([`NodeQuirks::NAMES`]), of its axes ([`Quirks::NAMES`], replacing theirs), or
    /// one of [`Self::QUIRKS`]. Returns whether the name is known.
    pub fn add_quirk(&mut self, name: &str) -> bool {
        if let Some(quirks) = NodeQuirks::named(name) {
            self.quirks = std::mem::take(&mut self.quirks).and(quirks);
        } else if let Some(quirks) = Quirks::named(name) {
            self.axes
                .iter_mut()
                .for_each(|axis| axis.quirks = quirks.clone());
        } else {
            match name {
                "serial-1" => self.identity.serial = 1,
                "faults-on-enable" => self
                    .axes
                    .iter_mut()
                    .for_each(|axis| axis.quirks.faults_on_enable = u32::MAX),
                _ => return false,
            }
        }
        true
    }

    /// Further quirks of [`Self::add_quirk`].
    pub const QUIRKS: [&'static str; 2] = ["serial-1", "faults-on-enable"];

    /// The communication objects: four PDOs per axis and direction, mapped as in CiA 402-3; PDO 1
    /// of the first axis is enabled.
    pub fn communication(&self) -> Communication {
        let count = self.axes.len().clamp(1, AXES_MAX);
        let axes = (0..8_u8).take(count);
        let several = count > 1;
        let pdos = |first, both: [u16; 4]| {
            axes.clone()
                .flat_map(|axis| default_pdos(axis, first, both))
                .collect()
        };
        Communication {
            device_type: if several { 0xFFFF_0192 } else { 0x0002_0192 },
            name: "Takt emulated drive".into(),
            identity: self.identity,
            heartbeat_ms: self.heartbeat_ms,
            rpdos: pdos(RPDO1, [0x6040, 0x6060, 0x607A, 0x60FF]),
            tpdos: pdos(TPDO1, [0x6041, 0x6061, 0x6064, 0x606C]),
            ..Communication::default()
        }
    }

    /// Its data sheet.
    pub fn eds(&self) -> Eds {
        let relative = self.communication().relative();
        Eds::of_device(self.objects(), relative, "takt-drive.eds")
    }

    /// All its objects.
    pub fn objects(&self) -> Vec<Object> {
        let mut objects = self.communication().objects();
        if self.domain_len > 0 {
            let domain = vec![0; self.domain_len];
            let domain = Entry::of("domain", DataType::Domain, Access::ReadWrite, domain);
            objects.push(Object::var(0x2000, domain));
        }
        if self.stored_eds {
            objects.extend(self.eds_objects());
        }
        for (axis, config) in (0_u8..).zip(self.axes.iter().take(AXES_MAX)) {
            objects.extend(config.objects(axis));
            let index = 0x67FF + Address::AXIS * u16::from(axis);
            let kind = Entry::number("single device type", Access::Const, 0x0002_0192_u32);
            objects.push(Object::var(index, kind));
        }
        objects
    }
}

impl DriveNodeConfig {
    /// The stored data sheet does not contain itself.
    fn eds_objects(&self) -> [Object; 2] {
        let without = Self {
            stored_eds: false,
            ..self.clone()
        };
        let text = without.eds().print().into_bytes();
        let sheet = Entry::of("store EDS", DataType::Domain, Access::ReadOnly, text);
        let format = Entry::number("store format", Access::Const, 0_u8);
        [Object::var(0x1021, sheet), Object::var(0x1022, format)]
    }
}

/// The PDOs of an axis: controlword/statusword alone; with the mode; with a position; with a
/// velocity.
fn default_pdos(axis: u8, first: u16, [word, others @ ..]: [u16; 4]) -> Vec<(u16, Parameters)> {
    let mapped = |index: u16, bits| Mapped {
        address: Address::new(index + Address::AXIS * u16::from(axis), 0),
        bits,
    };
    let with = |other: Option<u16>| {
        let bits = if other.is_some_and(|o| o & 0xFFFE == 0x6060) {
            8
        } else {
            32
        };
        let other = other.map(|other| mapped(other, bits));
        std::iter::once(mapped(word, 16)).chain(other).collect()
    };
    let [mode, position, velocity] = others;
    (0..)
        .zip([None, Some(mode), Some(position), Some(velocity)])
        .map(|(number, other)| {
            let id = if axis == 0 { first + 0x100 * number } else { 0 };
            let on = axis == 0 && number == 0;
            let id = u32::from(id) | 1 << 30;
            let cob = PdoCob::from_raw(id);
            let cob = if on { cob } else { cob.off() };
            let mut pdo = Parameters::new(cob, Transmission::EventProfile, with(other));
            if first == TPDO1 {
                pdo.inhibit = 10;
            }
            (AXIS_PDOS * u16::from(axis) + number, pdo)
        })
        .collect()
}

/// A CANopen node with an emulated drive.
pub type DriveNode = Node<Drives>;

impl DriveNode {
    /// Powers a drive on.
    pub fn power_on(config: DriveNodeConfig, now: Duration) -> Result<Self, NodeError> {
        let communication = config.communication();
        let dictionary = Dictionary::new(config.objects())?;
        let sheet = dictionary.bytes(Address::new(0x1021, 0));
        let sheet = sheet.map_or(0, <[u8]>::len);
        let node = NodeConfig {
            id: config.id,
            relative: communication.relative(),
            sdo_len_max: config.domain_len.max(256).max(sheet),
            sdo_timeout: config.sdo_timeout,
            quirks: config.quirks,
            dictionary,
        };
        let drives = Drives::new(config.axes, &node.dictionary, now)?;
        Self::new(node, drives, now)
    }
}

/// The axes of an emulated drive.
#[derive(Debug)]
pub struct Drives {
    configs: Vec<DriveConfig>,
    axes: Vec<Drive>,
    /// Time up to which the motors have moved.
    at: Duration,
    set_point: bool,
    operational: bool,
    /// Why the master counts as lost.
    heartbeat_lost: bool,
    left_operational: bool,
    pdo_late: bool,
    sync_period: SyncPeriod,
}

impl Drives {
    fn new(
        configs: Vec<DriveConfig>,
        dictionary: &Dictionary,
        now: Duration,
    ) -> Result<Self, DictionaryError> {
        let axes = (0_u8..)
            .zip(configs.iter().take(AXES_MAX))
            .map(|(axis, config)| power_on(config.clone(), axis, dictionary))
            .collect::<Result<_, _>>()?;
        Ok(Self {
            configs,
            axes,
            at: now,
            set_point: false,
            operational: false,
            heartbeat_lost: false,
            left_operational: false,
            pdo_late: false,
            sync_period: SyncPeriod::default(),
        })
    }

    /// An axis by number, from 0.
    pub fn axis(&self, axis: usize) -> Option<&Drive> {
        self.axes.get(axis)
    }

    /// An axis by number, to move it and to inject faults.
    pub fn axis_mut(&mut self, axis: usize) -> Option<&mut Drive> {
        self.axes.get_mut(axis)
    }

    fn step(&mut self, dt: Duration, context: &mut Context<'_>) {
        let step = Step {
            dt,
            set_point: std::mem::take(&mut self.set_point),
            link_lost: self.heartbeat_lost || self.left_operational || self.pdo_late,
        };
        self.at += dt;
        for (axis, drive) in (0_u8..).zip(&mut self.axes) {
            let from = Source::Device(axis);
            match drive.step(context.dictionary, &step).emergency {
                None => {}
                Some(FaultCode::NONE) => context.errors.clear_all(from),
                Some(code) => {
                    let bits = code.register();
                    context.errors.raise(from, code.0, bits, [axis, 0, 0, 0, 0]);
                }
            }
        }
    }

    /// Restarts the electronics; the motors keep their position.
    fn reset(&mut self, context: &Context<'_>) {
        for (axis, (drive, config)) in (0_u8..).zip(self.axes.iter_mut().zip(&self.configs)) {
            let mut config = config.clone();
            config.position = drive.motor().position;
            if let Ok(new) = power_on(config, axis, context.dictionary) {
                *drive = new;
            }
        }
        self.sync_period = SyncPeriod::default();
    }

    /// Handles data records of interpolated position from an RPDO.
    fn take_records(&mut self, rpdo: u16, dictionary: &Dictionary) {
        for sub in 1..=8 {
            let mapping = Address::new(Direction::Receive.mapping() + rpdo, sub);
            let mapped = number_at(dictionary, mapping).map(|raw| Mapped::from_raw(raw).address);
            for (axis, drive) in (0_u8..).zip(&mut self.axes) {
                let here = RECORD.on_axis(axis).filter(|here| mapped == Some(*here));
                if let Some(record) = here.and_then(|here| number_at(dictionary, here)) {
                    // A PDO has no response: excess records are lost.
                    let _ = drive.take_record(dictionary, record.cast_signed());
                }
            }
        }
    }

    const fn entered(&mut self, state: State) {
        let operational = matches!(state, State::Operational);
        self.left_operational = !operational && (self.operational || self.left_operational);
        self.operational = operational;
    }
}

/// An axis that takes 60C2h from SYNC until its master writes it.
fn power_on(
    config: DriveConfig,
    axis: u8,
    dictionary: &Dictionary,
) -> Result<Drive, DictionaryError> {
    let is_set = config.interpolation.is_some();
    let mut drive = Drive::new(config, axis, dictionary)?;
    if !is_set {
        drive.expect_sync_period(dictionary);
    }
    Ok(drive)
}

impl Application for Drives {
    fn after_download(&mut self, _: &mut Dictionary, address: Address) {
        self.axes
            .iter_mut()
            .for_each(|drive| drive.after_download(address));
    }

    fn before_upload(&mut self, d: &mut Dictionary, address: Address) -> Result<(), AbortCode> {
        for drive in &self.axes {
            drive.before_upload(d, address)?;
        }
        Ok(())
    }

    fn check_download(
        &mut self,
        dictionary: &Dictionary,
        address: Address,
        data: &[u8],
    ) -> Result<(), AbortCode> {
        for (axis, drive) in (0_u8..).zip(&mut self.axes) {
            drive.check_download(dictionary, address, data)?;
            if let (true, Some(record)) =
                (RECORD.on_axis(axis) == Some(address), data.first_chunk())
                && !drive.take_record(dictionary, i32::from_le_bytes(*record))
            {
                return Err(AbortCode::DeviceState);
            }
        }
        Ok(())
    }

    fn handle(&mut self, event: Event, context: &mut Context<'_>) {
        match event {
            Event::Sync => {
                let rest = context.now.saturating_sub(self.at);
                if !rest.is_zero() {
                    self.step(rest, context);
                }
                self.set_point = true;
                if let Some((value, exponent)) = self.sync_period.handle(context.now) {
                    self.axes
                        .iter_mut()
                        .for_each(|drive| drive.follow_sync(context.dictionary, value, exponent));
                }
            }
            Event::Received(number) => {
                self.set_point = true;
                self.take_records(number, context.dictionary);
            }
            Event::Late(_) => self.pdo_late = true,
            Event::InTime(_) => self.pdo_late = false,
            Event::Lost => self.heartbeat_lost = true,
            Event::Back => self.heartbeat_lost = false,
            Event::State(state) => self.entered(state),
            Event::Reset(Reset::Node) => {
                self.reset(context);
                (self.operational, self.left_operational) = (false, false);
                (self.heartbeat_lost, self.pdo_late) = (false, false);
            }
            Event::Reset(Reset::Communication) => {
                self.entered(State::Initialising);
                (self.heartbeat_lost, self.pdo_late) = (false, false);
            }
            Event::Time(_) | Event::Lss(_) => {}
        }
    }

    fn poll(&mut self, context: &mut Context<'_>) {
        let behind = context.now.saturating_sub(self.at);
        if behind > BEHIND_MAX {
            self.at = context.now - BEHIND_MAX;
        }
        while context.now.saturating_sub(self.at) >= STEP {
            self.step(STEP, context);
        }
    }

    fn poll_timeout(&self) -> Option<Duration> {
        Some(self.at + STEP)
    }
}
