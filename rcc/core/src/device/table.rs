//! The devices of a controller and where their interfaces lie in the image. It starts no driver.

use std::sync::{Arc, Mutex, PoisonError};

use takt_net::device::{JOINTS_MAX, Kinematics};
use takt_net::{ArmBinding, Devices, JointLimits};
use takt_rt::latest::{LatestReader, LatestWriter, latest};

use crate::device::{ArmCommand, ArmDescription, ArmState, DeviceStatus};
use crate::error::Error;
use crate::executor::DEVICES_MAX;

/// Readers of an arm's state: the net thread, the table itself, and room for drivers' tools.
const STATE_READERS: usize = 4;

/// A robot arm of the controller, as programs see it.
#[derive(Debug)]
pub struct Arm {
    /// Its name.
    pub name: String,
    /// Its device type.
    pub kind: &'static str,
    /// Number of its first joint in the image.
    pub first_joint: usize,
    /// Limits by joint.
    pub limits: Arc<[JointLimits]>,
    /// Where its flange is, and how to get it there.
    pub kinematics: Option<Arc<dyn Kinematics>>,
    state: Mutex<LatestReader<ArmState>>,
}

impl Arm {
    /// The last state its driver told.
    pub fn state(&self) -> ArmState {
        self.state
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .read()
    }

    /// Whether it can be used.
    pub fn status(&self) -> DeviceStatus {
        self.state().status
    }
}

/// The ends of an arm's cells.
#[derive(Debug)]
pub struct ArmPorts {
    /// For the net thread: reads the state.
    pub state: LatestReader<ArmState>,
    /// For the net thread: writes commands.
    pub command: LatestWriter<ArmCommand>,
    /// For the driver: writes the state.
    pub driver_state: LatestWriter<ArmState>,
    /// For the driver: reads commands.
    pub driver_command: LatestReader<ArmCommand>,
}

/// The devices of a controller. A device keeps its number until it is removed; a new one may get
/// the number of one that is gone.
#[derive(Clone, Debug, Default)]
pub struct DeviceTable {
    arms: Vec<Option<Arc<Arm>>>,
}

impl DeviceTable {
    /// Adds an arm and makes its cells; returns its number.
    ///
    /// # Errors
    /// If the name is taken or there is no room.
    pub fn add_arm(&mut self, description: ArmDescription) -> Result<(usize, ArmPorts), Error> {
        let ArmDescription {
            name,
            kind,
            limits,
            model,
        } = description;
        if self.find(&name).is_some() {
            return Err(Error::DeviceTwice { name });
        }
        let full = || Error::TooManyJoints {
            name: name.clone(),
            bound: JOINTS_MAX,
        };
        let first_joint = self.room_for(limits.len()).ok_or_else(full)?;
        let number = self
            .arms
            .iter()
            .position(Option::is_none)
            .unwrap_or(self.arms.len());
        if number >= DEVICES_MAX {
            return Err(Error::TooMany {
                what: "devices",
                bound: DEVICES_MAX,
            });
        }
        let (driver_state, state) = latest(STATE_READERS, ArmState::default);
        let (command, driver_command) = latest(1, ArmCommand::default);
        let for_table = state.another().ok_or_else(full)?;
        let kinematics = takt_motion::kinematics::limited(&model, &limits);
        let limits = limits.into();
        let state_of_table = Mutex::new(for_table);
        let arm = Arm {
            name,
            kind,
            first_joint,
            limits,
            kinematics,
            state: state_of_table,
        };
        if number == self.arms.len() {
            self.arms.push(None);
        }
        self.arms[number] = Some(Arc::new(arm));
        Ok((
            number,
            ArmPorts {
                state,
                command,
                driver_state,
                driver_command,
            },
        ))
    }

    /// The first of so many joints in a row that no arm uses.
    fn room_for(&self, joints: usize) -> Option<usize> {
        let mut first = 0;
        let mut used: Vec<_> = self
            .arms()
            .map(|(_, arm)| (arm.first_joint, arm.limits.len()))
            .collect();
        used.sort_unstable();
        for (start, len) in used {
            if start >= first + joints {
                break;
            }
            first = start + len;
        }
        let fits = first + joints <= JOINTS_MAX && joints <= crate::device::ARM_JOINTS_MAX;
        fits.then_some(first)
    }

    /// Forgets a device; returns its number.
    pub fn remove(&mut self, name: &str) -> Option<usize> {
        let number = self.number(name)?;
        self.arms[number] = None;
        Some(number)
    }

    /// The arms with their numbers.
    pub fn arms(&self) -> impl Iterator<Item = (usize, &Arc<Arm>)> {
        let arms = self.arms.iter().enumerate();
        arms.filter_map(|(number, arm)| Some((number, arm.as_ref()?)))
    }

    /// The arm of that number.
    #[must_use]
    pub fn get(&self, number: usize) -> Option<&Arc<Arm>> {
        self.arms.get(number)?.as_ref()
    }

    /// The arm of that name.
    #[must_use]
    pub fn find(&self, name: &str) -> Option<&Arc<Arm>> {
        self.arms().map(|(_, arm)| arm).find(|arm| arm.name == name)
    }

    /// Number of the device of that name.
    #[must_use]
    pub fn number(&self, name: &str) -> Option<usize> {
        self.arms()
            .find(|(_, arm)| arm.name == name)
            .map(|(number, _)| number)
    }
}

impl Devices for DeviceTable {
    fn arm(&self, name: &str) -> Option<ArmBinding> {
        let arm = self.find(name)?;
        Some(ArmBinding {
            first_joint: arm.first_joint,
            limits: Arc::clone(&arm.limits),
            kinematics: arm.kinematics.clone(),
        })
    }

    fn names(&self) -> Vec<String> {
        self.arms().map(|(_, arm)| arm.name.clone()).collect()
    }
}
