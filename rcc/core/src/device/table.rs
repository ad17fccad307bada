//! The devices of a controller and the locations of their interfaces in the image. It starts no driver.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use takt_motion::Model;
use takt_net::device::{
    COMMAND_WORDS_MAX, Interfaces, JOINTS_MAX, Kinematics, Layout, SIGNAL_WORDS_MAX,
};
use takt_net::{ArmBinding, Devices, JointLimits};
use takt_rt::latest::{LatestReader, LatestWriter, latest};

use crate::device::continuity::Jumped;
use crate::device::last_stage::Limited;
use crate::device::rejected::Rejected;
use crate::device::{
    ARM_JOINTS_MAX, ArmDescription, DeviceCommand, DeviceDescription, DeviceState, DeviceStatus,
    Place, parts,
};
use crate::error::Error;
use crate::executor::DEVICES_MAX;
use crate::executor::flight::FlightReader;

/// Most readers of a device's state: the net threads, the table itself, and tools.
const STATE_READERS: usize = 20;

/// A device of the controller, as programs see it.
#[derive(Debug)]
pub struct Device {
    /// Its name.
    pub name: String,
    /// Its device type.
    pub kind: &'static str,
    /// Its location in the image.
    pub place: Place,
    /// Limits by joint; empty if it is no arm.
    pub limits: Arc<[JointLimits]>,
    /// Model of its kinematics, as `takt_motion::kinematics` names it; empty for none.
    pub model: Model,
    /// Kinematics of its flange.
    pub kinematics: Option<Arc<dyn Kinematics>>,
    /// Its interfaces besides joints.
    pub interfaces: Interfaces,
    /// The same interfaces in the words of its own state and commands.
    pub(crate) own: Interfaces,
    /// Its last values, once a net thread serves it.
    pub(crate) flight: OnceLock<FlightReader>,
    state: Mutex<LatestReader<DeviceState>>,
}

impl Device {
    /// The last state that its driver published.
    pub fn state(&self) -> DeviceState {
        self.read(Clone::clone)
    }

    /// Whether it is at rest, as far as it is in contact.
    pub fn is_at_rest(&self) -> bool {
        self.read(|state| state.is_at_rest(self.own.base.as_ref()))
    }

    /// Whether it can be used.
    pub fn status(&self) -> DeviceStatus {
        self.read(|state| state.status)
    }

    /// Number of position jumps, and the last one.
    pub fn jumped(&self) -> Jumped {
        self.read(|state| state.jumped)
    }

    /// Number of times that it stopped following commands, and its status.
    pub fn faults(&self) -> (u64, DeviceStatus) {
        self.read(|state| (state.faults, state.status))
    }

    /// Limit reports of the last stages of its driver.
    pub fn limited(&self) -> [Limited; ARM_JOINTS_MAX] {
        self.read(|state| state.limited)
    }

    /// Set-points that its driver rejected.
    pub fn rejected(&self) -> [Rejected; ARM_JOINTS_MAX] {
        self.read(|state| state.rejected)
    }

    fn read<R>(&self, read: impl FnOnce(&DeviceState) -> R) -> R {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        state.read_with(read)
    }

    /// Another reader of its state, for a net thread that does not command it; `None` if there are too many.
    pub fn reader(&self) -> Option<LatestReader<DeviceState>> {
        let state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        state.another()
    }

    /// Its interfaces and their parameters by the names of the client protocol.
    #[must_use]
    pub fn properties(&self) -> BTreeMap<String, BTreeMap<String, String>> {
        let none = |there: bool, name| there.then(|| (String::from(name), BTreeMap::new()));
        let counted = |pairs: &[(&str, usize)]| {
            let pair = |(name, n): &(&str, usize)| ((*name).to_owned(), n.to_string());
            pairs.iter().map(pair).collect::<BTreeMap<_, _>>()
        };
        let arm = (!self.limits.is_empty()).then(|| {
            let joints = counted(&[("jointcount", self.limits.len())]);
            ("robotarm".to_owned(), joints)
        });
        let io = self.interfaces.io.as_ref().map(|io| {
            let counts = counted(&[
                ("digin", io.bool_in.len()),
                ("digout", io.bool_out.len()),
                ("anin", io.real_in.len()),
                ("anout", io.real_out.len()),
            ]);
            ("io".to_owned(), counts)
        });
        [
            arm,
            io,
            none(self.kinematics.is_some(), "armkinematics"),
            none(self.interfaces.base.is_some(), "robotbase"),
            none(self.interfaces.cartesian.is_some(), "cartesianposition"),
        ]
        .into_iter()
        .flatten()
        .collect()
    }

    /// All its interfaces with their parameters. Known clients of the protocol get [`Self::properties`] only.
    #[must_use]
    pub fn abilities(&self) -> BTreeMap<String, BTreeMap<String, String>> {
        let has = &self.interfaces;
        let with = |pairs: &[(&str, f64)]| {
            let pair = |(name, value): &(&str, f64)| ((*name).to_owned(), value.to_string());
            Some(pairs.iter().map(pair).collect::<BTreeMap<_, _>>())
        };
        let plain = |is_there: bool| is_there.then(BTreeMap::new);
        let base = has.base.as_ref().and_then(|base| {
            let mut limits = with(&[
                ("velocity_max", base.velocity_max),
                ("rotation_max", base.rotation_max),
                ("acceleration_max", base.acceleration_max),
                ("rotation_acceleration_max", base.rotation_acceleration_max),
            ])?;
            limits.insert("wheels".to_owned(), base.wheels.len().to_string());
            Some(limits)
        });
        let gripper = has.gripper.as_ref();
        let gripper = gripper.and_then(|gripper| with(&[("width_max", gripper.distance_max)]));
        let drives = has
            .drives
            .as_ref()
            .map(|drives| BTreeMap::from([("drivecount".to_owned(), drives.len().to_string())]));
        let more = [
            ("robotbase", base),
            ("gripper", gripper),
            ("servogripper", plain(has.servo_gripper.is_some())),
            ("homing", plain(has.homing.is_some())),
            ("tool", plain(has.tool.is_some())),
            ("strategy", plain(has.strategy.is_some())),
            ("jointimpedance", plain(has.joint_impedance.is_some())),
            (
                "cartesianimpedance",
                plain(has.cartesian_impedance.is_some()),
            ),
            ("cartesiansine", plain(has.cartesian_sine.is_some())),
            ("torques", plain(has.torques.is_some())),
            ("wrench", plain(has.wrench.is_some())),
            ("drives", drives),
        ];
        let mut all = self.properties();
        let more = more.into_iter();
        all.extend(more.filter_map(|(name, parameters)| Some((name.to_owned(), parameters?))));
        all
    }
}

/// Endpoints of a device's latest-value cells.
#[derive(Debug)]
pub struct DevicePorts {
    /// For the net thread that commands it: reads the state.
    pub state: LatestReader<DeviceState>,
    /// For the net thread that commands it: writes commands.
    pub command: LatestWriter<DeviceCommand>,
    /// For the driver: writes the state.
    pub driver_state: LatestWriter<DeviceState>,
    /// For the driver: reads commands.
    pub driver_command: LatestReader<DeviceCommand>,
}

/// The devices of a controller. A device keeps its number until it is removed; a new one may reuse the number of a
/// removed one.
#[derive(Clone, Debug, Default)]
pub struct DeviceTable {
    devices: Vec<Option<Arc<Device>>>,
}

impl DeviceTable {
    /// Adds an arm without parts besides joints.
    ///
    /// # Errors
    /// If the name is taken or the image is full.
    pub fn add_arm(&mut self, arm: ArmDescription) -> Result<(usize, DevicePorts), Error> {
        self.add(arm.with(&[]))
    }

    /// Adds a device and creates its cells; returns its number.
    ///
    /// # Errors
    /// If the name is taken or the image is full.
    pub fn add(&mut self, device: DeviceDescription) -> Result<(usize, DevicePorts), Error> {
        if self.find(&device.name).is_some() {
            return Err(Error::DeviceTwice { name: device.name });
        }
        let number = self
            .devices
            .iter()
            .position(Option::is_none)
            .unwrap_or(self.devices.len());
        if number >= DEVICES_MAX {
            return Err(Error::TooMany {
                item: "devices",
                bound: DEVICES_MAX,
            });
        }
        let place = self.place_for(&device)?;
        self.add_at(number, place, device)
    }

    /// Adds a device at its location in a recording.
    ///
    /// # Errors
    /// If the name is taken, or number or location are invalid.
    pub fn add_at(
        &mut self,
        number: usize,
        place: Place,
        device: DeviceDescription,
    ) -> Result<(usize, DevicePorts), Error> {
        let joints = device.limits.len();
        let mut layout = Layout {
            signals: place.signals.start,
            commands: place.commands.start,
        };
        let interfaces = parts::lay(&device.parts, joints, &mut layout);
        let fits = layout.signals == place.signals.end
            && layout.commands == place.commands.end
            && place.signals.end <= SIGNAL_WORDS_MAX
            && place.commands.end <= COMMAND_WORDS_MAX
            && joints == place.joints
            && joints <= ARM_JOINTS_MAX
            && place.first_joint.saturating_add(joints) <= JOINTS_MAX
            && number < DEVICES_MAX;
        if !fits || self.find(&device.name).is_some() {
            return Err(Error::DeviceTwice { name: device.name });
        }
        let (signals, commands) = (place.signals.len(), place.commands.len());
        let (driver_state, state) = latest(STATE_READERS, || DeviceState::new(signals));
        let (command, driver_command) = latest(1, || DeviceCommand::new(commands));
        let for_table = state.another().ok_or(Error::TooMany {
            item: "readers of a device",
            bound: STATE_READERS,
        })?;
        let kinematics = device.model.limited(&device.limits);
        if number >= self.devices.len() {
            self.devices.resize_with(number + 1, || None);
        }
        self.devices[number] = Some(Arc::new(Device {
            name: device.name,
            kind: device.kind,
            place,
            limits: device.limits.into(),
            model: device.model,
            kinematics,
            interfaces,
            own: parts::lay(&device.parts, joints, &mut Layout::default()),
            flight: OnceLock::new(),
            state: Mutex::new(for_table),
        }));
        Ok((
            number,
            DevicePorts {
                state,
                command,
                driver_state,
                driver_command,
            },
        ))
    }

    /// The location of a new device: the first sufficiently large gaps.
    fn place_for(&self, device: &DeviceDescription) -> Result<Place, Error> {
        let joints = device.limits.len();
        let mut size = Layout::default();
        // Only occupied ranges matter here.
        let _ = parts::lay(&device.parts, joints, &mut size);
        let used = |range: fn(&Place) -> Range<usize>| {
            let mut used: Vec<_> = self.all().map(|(_, d)| range(&d.place)).collect();
            used.sort_unstable_by_key(|range| range.start);
            used
        };
        let of_joints = used(|place| place.first_joint..place.first_joint + place.joints);
        let first_joint = gap(&of_joints, joints, JOINTS_MAX)
            .filter(|_| joints <= ARM_JOINTS_MAX)
            .ok_or_else(|| Error::TooManyJoints {
                name: device.name.clone(),
                bound: JOINTS_MAX,
            })?;
        let full = |bound| Error::TooManyValues {
            name: device.name.clone(),
            bound,
        };
        let signals = gap(
            &used(|place| place.signals.clone()),
            size.signals,
            SIGNAL_WORDS_MAX,
        );
        let signals = signals.ok_or_else(|| full(SIGNAL_WORDS_MAX))?;
        let commands = gap(
            &used(|place| place.commands.clone()),
            size.commands,
            COMMAND_WORDS_MAX,
        );
        let commands = commands.ok_or_else(|| full(COMMAND_WORDS_MAX))?;
        Ok(Place {
            first_joint,
            joints,
            signals: signals..signals + size.signals,
            commands: commands..commands + size.commands,
        })
    }

    /// Removes a device; returns its number.
    pub fn remove(&mut self, name: &str) -> Option<usize> {
        let number = self.number(name)?;
        self.devices[number] = None;
        Some(number)
    }

    /// The devices with their numbers.
    pub fn all(&self) -> impl Iterator<Item = (usize, &Arc<Device>)> {
        let devices = self.devices.iter().enumerate();
        devices.filter_map(|(number, device)| Some((number, device.as_ref()?)))
    }

    /// The arms among the devices.
    pub fn arms(&self) -> impl Iterator<Item = (usize, &Arc<Device>)> {
        self.all().filter(|(_, device)| !device.limits.is_empty())
    }

    /// The device of that number.
    #[must_use]
    pub fn get(&self, number: usize) -> Option<&Arc<Device>> {
        self.devices.get(number)?.as_ref()
    }

    /// The device of that name.
    #[must_use]
    pub fn find(&self, name: &str) -> Option<&Arc<Device>> {
        self.all().map(|(_, d)| d).find(|d| d.name == name)
    }

    /// Number of the device of that name.
    #[must_use]
    pub fn number(&self, name: &str) -> Option<usize> {
        self.all()
            .find(|(_, device)| device.name == name)
            .map(|(number, _)| number)
    }
}

/// The start of the first gap of `len` below `bound` between these ranges, which are sorted by start.
fn gap(used: &[Range<usize>], len: usize, bound: usize) -> Option<usize> {
    let mut first = 0;
    for range in used.iter().filter(|range| !range.is_empty()) {
        if range.start >= first + len {
            break;
        }
        first = range.end;
    }
    (first + len <= bound).then_some(first)
}

impl Devices for DeviceTable {
    fn arm(&self, name: &str) -> Option<ArmBinding> {
        let device = self.find(name).filter(|d| !d.limits.is_empty())?;
        Some(ArmBinding {
            first_joint: device.place.first_joint,
            limits: Arc::clone(&device.limits),
            kinematics: device.kinematics.clone(),
        })
    }

    fn interfaces(&self, name: &str) -> Option<Interfaces> {
        self.find(name).map(|device| device.interfaces.clone())
    }

    fn names(&self) -> Vec<String> {
        self.all().map(|(_, device)| device.name.clone()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::Part;

    fn io(name: &str, outputs: usize) -> DeviceDescription {
        let part = Part::Io {
            bool_in: 0,
            bool_out: outputs,
            real_in: 0,
            real_out: 0,
        };
        DeviceDescription {
            name: name.to_owned(),
            kind: "test",
            limits: Vec::new(),
            model: "".into(),
            parts: vec![part],
        }
    }

    #[test]
    fn device_table_locations_never_overlap_reuse_gaps() {
        let mut table = DeviceTable::default();
        for (name, outputs) in [("a", 4), ("b", 8), ("c", 2)] {
            table.add(io(name, outputs)).unwrap();
        }
        let place = |table: &DeviceTable, name| table.find(name).unwrap().place.clone();
        assert_eq!(
            place(&table, "b").commands.start,
            place(&table, "a").commands.end
        );
        let gap = place(&table, "b");
        assert_eq!(table.remove("b"), Some(1));
        table.add(io("d", 9)).unwrap();
        assert_eq!(
            place(&table, "d").commands.start,
            place(&table, "c").commands.end
        );
        table.add(io("e", 8)).unwrap();
        assert_eq!(place(&table, "e"), gap);
    }

    #[test]
    fn device_table_rejects_excess_with_bound() {
        let mut table = DeviceTable::default();
        let error = table
            .add(io("a", COMMAND_WORDS_MAX))
            .unwrap_err()
            .to_string();
        assert!(error.contains(&COMMAND_WORDS_MAX.to_string()), "{error}");
        table.add(io("a", 1)).unwrap();
        let error = table.add(io("a", 1)).unwrap_err().to_string();
        assert!(error.contains("`a` exists already"), "{error}");
    }

    #[test]
    fn device_table_lists_only_existing_interfaces() {
        let mut table = DeviceTable::default();
        table.add(io("a", 1)).unwrap();
        assert!(table.arm("a").is_none());
        let has = table.interfaces("a").unwrap();
        assert!(has.io.is_some() && has.base.is_none());
        let properties = &table.find("a").unwrap().properties();
        assert_eq!(properties["io"]["digout"], "1");
        assert_eq!(properties.len(), 1);
    }
}
