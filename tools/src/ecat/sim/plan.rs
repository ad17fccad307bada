//! The slaves of an emulated segment, from a file or from the segment of a cell. Their behaviour is not defined here.

use anyhow::{Context as _, ensure};
use serde::Deserialize;
use takt_core::CellConfig;
use takt_devices::ethercat::{AnalogueChannel, EthercatConfig, EthercatSlave};
use takt_ethercat::emulator::{
    Coupler, Io, PdoImage, Profile, Profiled, STATION_AXES, Segment, ServoConfig, ServoDrive,
    Slave, Station, StationMotor,
};
use takt_ethercat::sii;

use crate::ecat::cell;

/// What faults of motors are injected into.
#[derive(Debug, Default)]
pub(super) struct Handles {
    /// Its drives, in their order.
    pub(super) drives: Vec<ServoDrive>,
    /// The motors of the test station.
    pub(super) station: Option<Station>,
}

/// A segment to emulate, with the handles of its slaves.
#[derive(Debug)]
pub(super) struct Emulation {
    pub(super) segment: Segment,
    pub(super) handles: Handles,
    /// Terminals whose outputs are connected to their inputs.
    pub(super) loops: Vec<Io>,
}

impl Emulation {
    /// A segment without handles.
    pub(super) fn plain(segment: Segment) -> Self {
        Self {
            segment,
            handles: Handles::default(),
            loops: Vec::new(),
        }
    }

    /// The test station.
    pub(super) fn station() -> Self {
        let (segment, station) = Station::segment(StationMotor::three());
        let mut emulation = Self::plain(segment);
        emulation.handles.station = Some(station);
        emulation
    }
}

/// A segment file.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Plan {
    #[serde(default, rename = "slave")]
    slaves: Vec<SlavePlan>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
enum Kind {
    #[default]
    Coupler,
    Digital,
    Analogue,
    Drive,
    Tx90,
    /// A terminal with the channels that a cell uses.
    Mixed,
    /// A recorded real device.
    Profile(Profile),
}

impl TryFrom<String> for Kind {
    type Error = String;

    fn try_from(name: String) -> Result<Self, String> {
        Ok(match name.as_str() {
            "coupler" => Self::Coupler,
            "digital" => Self::Digital,
            "analogue" => Self::Analogue,
            "drive" => Self::Drive,
            "tx90" => Self::Tx90,
            _ => {
                let known = |error| format!("{error}, and coupler, digital, analogue, drive, tx90");
                Self::Profile(name.parse().map_err(known)?)
            }
        })
    }
}

/// A slave of a segment file.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct SlavePlan {
    kind: Kind,
    /// Channels of a terminal.
    #[serde(default = "SlavePlan::channels")]
    outputs: u8,
    #[serde(default = "SlavePlan::channels")]
    inputs: u8,
    /// Whether outputs of a terminal are connected to its inputs.
    #[serde(default)]
    looped: bool,
    /// Axes of a drive, 1 to 8.
    #[serde(default = "SlavePlan::one")]
    axes: u8,
    /// The slave and the port that its cable is connected to; default: port 1 of the previous slave.
    behind: Option<(usize, usize)>,
    alias: Option<u16>,
    vendor: Option<u32>,
    product: Option<u32>,
    /// The name in its SII.
    name: Option<String>,
    /// Whether it has FoE and BOOT; devices have them as the real ones do.
    #[serde(default)]
    files: bool,
    /// Whether it has EoE, with a station that answers ARP, ping and UDP echo.
    #[serde(default)]
    ethernet: bool,
    /// Outputs and inputs of a terminal of a cell.
    #[serde(skip)]
    channels: [Vec<(u16, u8, u8, u8)>; 2],
    /// Drift of its clock, ppm, positive if it runs fast.
    #[serde(default)]
    drift_ppm: f64,
}

impl SlavePlan {
    const fn channels() -> u8 {
        8
    }

    const fn one() -> u8 {
        1
    }

    const fn new(kind: Kind) -> Self {
        Self {
            kind,
            outputs: 8,
            inputs: 8,
            looped: false,
            axes: 1,
            behind: None,
            alias: None,
            vendor: None,
            product: None,
            name: None,
            files: false,
            ethernet: false,
            channels: [const { Vec::new() }; 2],
            drift_ppm: 0.0,
        }
    }

    fn build(&self, strict: bool, times: u64, emulation: &mut Emulation) -> anyhow::Result<Slave> {
        let terminal = |(slave, io): (Slave, Io), emulation: &mut Emulation| {
            if self.looped {
                emulation.loops.push(io);
            }
            slave
        };
        let mut slave = match self.kind {
            Kind::Coupler => Coupler::slave(),
            Kind::Digital => terminal(Io::digital(self.outputs, self.inputs), emulation),
            Kind::Analogue => terminal(Io::analogue(self.outputs, self.inputs), emulation),
            Kind::Mixed => {
                let [outputs, inputs] = self.channels.clone();
                let rx = pdos(0x1600, 0, &outputs);
                let tx = pdos(0x1A00, 1, &inputs);
                terminal(
                    Io::terminal("TKMIX terminal".to_owned(), 0x6000, rx, tx),
                    emulation,
                )
            }
            Kind::Profile(profile) => {
                let made = profile.slave(times).context("invalid drive")?;
                let Profiled { slave, io, drive } = made;
                emulation.loops.extend(io.filter(|_| self.looped));
                emulation.handles.drives.extend(drive);
                slave
            }
            Kind::Tx90 => drive(ServoConfig::tx90(), strict, emulation)?,
            Kind::Drive => {
                ensure!(
                    (1..=8).contains(&self.axes),
                    "a drive has 1 to 8 axes, not {}",
                    self.axes
                );
                let axis = ServoConfig::default().axes;
                let axes = axis.into_iter().cycle().take(self.axes.into()).collect();
                drive(ServoConfig::with_axes(axes), strict, emulation)?
            }
        };
        if self.files {
            slave = slave.with_files();
        }
        if self.ethernet {
            slave = slave.with_ethernet();
        }
        self.customize(&mut slave);
        Ok(slave)
    }

    /// Sets the identity in its EEPROM and the drift of its clock.
    fn customize(&self, slave: &mut Slave) {
        if let Some(name) = &self.name {
            slave.rename(name);
        }
        let eeprom = slave.eeprom_mut();
        let mut put = |word: sii::Word, bytes: &[u8]| {
            let at = 2 * usize::from(word);
            if let Some(target) = eeprom.get_mut(at..at + bytes.len()) {
                target.copy_from_slice(bytes);
            }
        };
        if let Some(alias) = self.alias {
            put(sii::word::ALIAS, &alias.to_le_bytes());
        }
        if let Some(vendor) = self.vendor {
            put(sii::word::IDENTITY, &vendor.to_le_bytes());
        }
        if let Some(product) = self.product {
            put(sii::word::IDENTITY + 2, &product.to_le_bytes());
        }
        let sum = eeprom.get(..14).map_or(0, sii::checksum);
        if let Some(checksum) = eeprom.get_mut(14) {
            *checksum = sum;
        }
        slave.power_on(0);
        if let Some(clock) = slave.clock() {
            #[expect(clippy::cast_possible_truncation, reason = "saturates, and is bounded")]
            clock.set_drift((self.drift_ppm * 1e3).clamp(-1e6, 1e6) as i64, 0);
        }
    }
}

fn drive(
    mut config: ServoConfig,
    strict: bool,
    emulation: &mut Emulation,
) -> anyhow::Result<Slave> {
    if !strict {
        for axis in &mut config.axes {
            axis.quirks.missing_set_points = None;
        }
    }
    let (slave, drive) = ServoDrive::slave(config).context("invalid drive")?;
    emulation.handles.drives.push(drive);
    Ok(slave)
}

impl Plan {
    /// Devices by name, in a line: `ek1100,el1004`; `None` if a name is unknown.
    pub(super) fn of_devices(text: &str) -> Option<Self> {
        let named = |name: &str| name.trim().parse().ok().map(Kind::Profile);
        let kinds: Option<Vec<Kind>> = text.split(',').map(named).collect();
        let slaves = kinds?.into_iter().map(SlavePlan::new).collect();
        Some(Self { slaves })
    }

    /// Builds the slaves, in a line except where a slave sets `behind`.
    pub(super) fn build(&self, strict: bool, times: u64) -> anyhow::Result<Emulation> {
        ensure!(!self.slaves.is_empty(), "no [[slave]]");
        let mut emulation = Emulation::plain(Segment::default());
        let mut taken: Vec<(usize, usize)> = Vec::new();
        for (number, plan) in self.slaves.iter().enumerate() {
            let slave = plan
                .build(strict, times, &mut emulation)
                .with_context(|| format!("slave {number}"))?;
            let previous = number.checked_sub(1).map(|last| (last, 1));
            let parent = plan.behind.or(previous);
            if let Some((above, port)) = parent {
                ensure!(
                    above < number && (1..=3).contains(&port) && !taken.contains(&(above, port)),
                    "slave {number} cannot be behind slave {above} port {port}\nhint: name an earlier slave and \
                     a free port, 1 to 3"
                );
                taken.push((above, port));
            }
            emulation.segment.add(slave, parent);
        }
        Ok(emulation)
    }
}

/// The slaves that a segment of a cell expects.
pub(super) fn of_cell(
    cell: &CellConfig,
    name: Option<&str>,
    strict: bool,
) -> anyhow::Result<Emulation> {
    let config = cell::segment(cell, name)?;
    if !config.servos.is_empty() {
        let is_station = config.servos.len() == STATION_AXES
            && config.slaves.len() == Station::ENCODER + STATION_AXES;
        ensure!(
            is_station,
            "{} has servo axes of terminals; only the test station of three is emulated\nhint: `--devices station`, or a file of \
             slaves",
            config.name
        );
        return Ok(Emulation::station());
    }
    let mut free: Vec<&EthercatSlave> = config.slaves.iter().collect();
    let mut slaves = Vec::new();
    while !free.is_empty() {
        let here = free
            .iter()
            .position(|slave| slave.position.map(usize::from) == Some(slaves.len()));
        // Slaves with an alias may be at any position: they fill the others.
        let here = here.or_else(|| free.iter().position(|slave| slave.position.is_none()));
        match here {
            Some(at) => slaves.push(expected(config, free.remove(at))),
            None => slaves.push(SlavePlan::new(Kind::Coupler)),
        }
        ensure!(
            slaves.len() <= takt_ethercat::config::SLAVES_MAX,
            "{}: a position beyond the largest of a segment",
            config.name
        );
    }
    Plan { slaves }.build(strict, 1)
}

fn expected(config: &EthercatConfig, slave: &EthercatSlave) -> SlavePlan {
    let channels = [true, false].map(|outputs| channels(config, &slave.name, outputs));
    let is_tx90 = slave.axes == 6
        && config.arms.iter().any(|arm| {
            arm.model.name().contains("tx90")
                && arm.joints.iter().any(|joint| joint.drive == slave.name)
        });
    let kind = match slave.axes {
        0 if channels.iter().any(|channels| !channels.is_empty()) => Kind::Mixed,
        0 => Kind::Coupler,
        _ if is_tx90 => Kind::Tx90,
        _ => Kind::Drive,
    };
    SlavePlan {
        axes: slave.axes,
        alias: slave.alias,
        vendor: slave.vendor,
        product: slave.product,
        name: slave.sii_name.clone(),
        channels,
        ..SlavePlan::new(kind)
    }
}

/// Outputs or inputs of a slave in a cell, in the order of their bits: index, sub-index, bits, type. Digital channels are
/// first; analogue channels are at the bit that the cell gives, or follow.
fn channels(config: &EthercatConfig, slave: &str, outputs: bool) -> Vec<(u16, u8, u8, u8)> {
    const BOOL: u8 = 1;
    const INTEGER16: u8 = 3;
    let first = if outputs { 0x7000_u16 } else { 0x6000 };
    let digital = config.ios.iter().map(|io| {
        let all = if outputs {
            &io.digital_out
        } else {
            &io.digital_in
        };
        let own = all.iter().filter(|(name, _)| name == slave);
        own.map(|(_, bits)| *bits).sum::<usize>()
    });
    let digital = u16::try_from(digital.max().unwrap_or(0)).unwrap_or(u16::MAX);
    let mut entries: Vec<_> = (0..digital)
        .map(|n| (first.wrapping_add(0x10_u16.wrapping_mul(n)), 1, 1, BOOL))
        .collect();
    let analogue = config.ios.iter().flat_map(|io| {
        if outputs {
            &io.analogue_out
        } else {
            &io.analogue_in
        }
    });
    let mut analogue: Vec<&AnalogueChannel> =
        analogue.filter(|channel| channel.slave == slave).collect();
    // Channels by object have no bit: they follow the others.
    analogue.sort_by_key(|channel| channel.bit.unwrap_or(usize::MAX));
    let mut bits = usize::from(digital);
    for (n, channel) in (0_u16..).zip(analogue) {
        let at = channel.bit.unwrap_or(bits);
        while bits < at {
            let gap = u8::try_from(at - bits).unwrap_or(u8::MAX);
            entries.push((0, 0, gap, 0));
            bits += usize::from(gap);
        }
        let by_number = first
            .wrapping_add(0x800)
            .wrapping_add(0x10_u16.wrapping_mul(n));
        let (index, sub) = channel.object.unwrap_or((by_number, 0x11));
        entries.push((index, sub, channel.bits, INTEGER16));
        bits += usize::from(channel.bits);
    }
    entries
}

/// The entries in PDOs of at most 255 entries.
fn pdos(first: u16, sync_manager: u8, entries: &[(u16, u8, u8, u8)]) -> Vec<PdoImage> {
    let image = |(entries, index): (&[_], u16)| PdoImage {
        index,
        sync_manager,
        name: "channels".to_owned(),
        entries: entries.to_vec(),
    };
    entries.chunks(255).zip(first..).map(image).collect()
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use takt_cia402::dictionary::Address;
    use takt_ethercat::AlState;

    use super::*;
    use crate::ecat::scan;
    use crate::ecat::tests::{CYCLE, session, up};

    /// A drive of two axes behind a slave that is not in the cell, and a terminal with an alias.
    const CELL: &str = "[[ethercat]]\nname = 'line'\ninterface = 'eth1'\n\
        [[ethercat.slave]]\nname = 'drive'\nposition = 1\naxes = 2\nproduct = 5\n\
        [[ethercat.slave]]\nname = 'valves'\nalias = 40\n\
        [[ethercat.io]]\nname = 'io'\ndigital_out = [['valves', 3]]\n";

    #[test]
    fn sim_of_cell_builds_its_slaves() {
        let path = std::env::temp_dir().join(format!("takt-sim-{}.toml", std::process::id()));
        std::fs::write(&path, CELL).unwrap();
        let cell = takt_devices::read_cell(&path).unwrap();
        std::fs::remove_file(&path).unwrap();
        let emulation = of_cell(&cell, None, true).unwrap();
        assert_eq!(
            (emulation.segment.len(), emulation.handles.drives.len()),
            (2, 1)
        );
        let text = scanned(emulation);
        for part in [
            "   0  o TKMIX terminal",
            "   1  o TK4121",
            "00007A87  00000005",
        ] {
            assert!(text.contains(part), "{part}\n{text}");
        }
        let error = of_cell(&cell, Some("other"), true).unwrap_err().to_string();
        assert!(error.contains("no segment `other`; it has line"), "{error}");
    }

    #[test]
    fn sim_of_cell_has_its_names_and_channels() {
        let text = "[[ethercat]]\nname = 'line'\ninterface = 'eth1'\n\
            [[ethercat.slave]]\nname = 'drive'\nsii_name = 'AX5000 drive'\naxes = 1\n\
            [[ethercat.slave]]\nname = 'volts'\nsii_name = 'EL3102'\n\
            [[ethercat.io]]\nname = 'io'\ndigital_in = [['volts', 2]]\n\
            analogue_in = [{ slave = 'volts', bit = 16, bits = 12 }, \
            { slave = 'volts', object = [0x6010, 0x11] }]\n\
            analogue_out = [{ slave = 'volts', bit = 0 }]\n";
        let cell = takt_devices::parse_cell(text).unwrap();
        let segment = of_cell(&cell, None, true).unwrap().segment;
        let mut session = session(segment, AlState::SafeOp);
        let expected = cell::master(cell.of_kind().next().unwrap(), CYCLE, AlState::SafeOp);
        session.restart(expected).unwrap();
        session.bring_up(Duration::from_secs(10)).unwrap();
        assert!(
            session.master().is_operational(),
            "{}",
            scan::text(&session)
        );
        let slave = session.master().slave(1).unwrap();
        let (found, process) = (slave.info(), slave.process());
        assert_eq!(found.name, "EL3102");
        assert_eq!((process.inputs_len(), process.outputs_len()), (6, 2));
        let by_object = process.locate(Address::new(0x6010, 0x11), false).unwrap();
        assert_eq!((by_object.bit, by_object.bits), (28, 16));
    }

    fn scanned(emulation: Emulation) -> String {
        scan::text(&up(emulation.segment, AlState::PreOp))
    }

    #[test]
    fn sim_file_builds_tree_with_identities() {
        let text = "[[slave]]\nkind = 'coupler'\n\
            [[slave]]\nkind = 'digital'\noutputs = 4\ninputs = 2\nlooped = true\nbehind = [0, 3]\n\
            [[slave]]\nkind = 'drive'\naxes = 2\nbehind = [0, 1]\nvendor = 9\nproduct = 0xAB\nalias = 7\n\
            [[slave]]\nkind = 'tx90'\ndrift_ppm = 50.0\n";
        let plan: Plan = toml::from_str(text).unwrap();
        let emulation = plan.build(true, 1).unwrap();
        assert_eq!(
            (emulation.handles.drives.len(), emulation.loops.len()),
            (2, 1)
        );
        let text = scanned(emulation);
        for part in ["| o TK0402", "0:3", "00000009  000000AB", "TKTX90"] {
            assert!(text.contains(part), "{part}\n{text}");
        }
    }

    #[test]
    fn sim_devices_are_found_within_three_seconds() {
        for times in [1, 2] {
            let plan = Plan::of_devices("ek1100,el1004,el2004,el2889,el3004,akd").unwrap();
            let segment = plan.build(true, times).unwrap().segment;
            let mut session = session(segment, AlState::PreOp);
            session.bring_up(Duration::from_secs(3)).unwrap();
            let text = scan::text(&session);
            assert_eq!(
                scan::verdict(session.master()),
                crate::Verdict::Good,
                "{text}"
            );
        }
    }

    #[test]
    fn sim_devices_by_name_form_a_line() {
        let plan = Plan::of_devices("ek1100, el1004,akd").unwrap();
        let text = scanned(plan.build(true, 2).unwrap());
        for part in [
            "   0  o EK1100 EtherCAT coupler",
            "   1  o EL1004 4 digital inputs",
            "   2  o AKD servo drive",
            "00000002  044C2C52",
            "0000006A  00414B44",
        ] {
            assert!(text.contains(part), "{part}\n{text}");
        }
        assert!(!text.contains('!'), "{text}");
        assert!(Plan::of_devices("ek1100,line.toml").is_none());
        let text = "[[slave]]\nkind = 'el2889'\nlooped = true\n";
        let plan: Plan = toml::from_str(text).unwrap();
        assert_eq!(plan.build(true, 1).unwrap().loops.len(), 1);
        let unknown = toml::from_str::<Plan>("[[slave]]\nkind = 'el9999'\n");
        let text = unknown.unwrap_err().to_string();
        assert!(
            text.contains("unknown device `el9999`; known are ek1100"),
            "{text}"
        );
    }

    #[test]
    fn invalid_sim_file_is_rejected_with_cause() {
        for (text, cause) in [
            ("", "no [[slave]]"),
            (
                "[[slave]]\nkind = 'drive'\naxes = 9\n",
                "1 to 8 axes, not 9",
            ),
            (
                "[[slave]]\nkind = 'coupler'\nbehind = [0, 1]\n",
                "cannot be behind slave 0 port 1",
            ),
        ] {
            let plan: Plan = toml::from_str(text).unwrap();
            let error = format!("{:#}", plan.build(false, 1).unwrap_err());
            assert!(error.contains(cause), "{error}");
        }
        assert!(toml::from_str::<Plan>("[[slave]]\nkind = 'robot'\n").is_err());
    }
}
