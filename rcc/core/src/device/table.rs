//! The devices of a controller and where their interfaces lie in the image. It starts no driver.

use std::sync::{Arc, Mutex, PoisonError};

use takt_net::device::JOINTS_MAX;
use takt_net::{ArmBinding, Devices, JointLimits};
use takt_rt::latest::{LatestReader, LatestWriter, latest};

use crate::device::{ArmCommand, ArmDescription, ArmState, DeviceStatus};
use crate::error::Error;

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

/// The devices of a controller.
#[derive(Clone, Debug, Default)]
pub struct DeviceTable {
    arms: Vec<Arc<Arm>>,
    joints: usize,
}

impl DeviceTable {
    /// Adds an arm and makes its cells.
    ///
    /// # Errors
    /// If the name is taken or the image is full.
    pub fn add_arm(&mut self, description: ArmDescription) -> Result<ArmPorts, Error> {
        let ArmDescription { name, kind, limits } = description;
        if self.find(&name).is_some() {
            return Err(Error::DeviceTwice { name });
        }
        let joints = self.joints + limits.len();
        if joints > JOINTS_MAX || limits.len() > crate::device::ARM_JOINTS_MAX {
            return Err(Error::TooManyJoints {
                name,
                bound: JOINTS_MAX,
            });
        }
        let (driver_state, state) = latest(STATE_READERS, ArmState::default);
        let (command, driver_command) = latest(1, ArmCommand::default);
        let for_table = state.another().ok_or(Error::TooManyJoints {
            name: name.clone(),
            bound: JOINTS_MAX,
        })?;
        self.arms.push(Arc::new(Arm {
            name,
            kind,
            first_joint: self.joints,
            limits: limits.into(),
            state: Mutex::new(for_table),
        }));
        self.joints = joints;
        Ok(ArmPorts {
            state,
            command,
            driver_state,
            driver_command,
        })
    }

    /// The arms in the order they were added.
    #[must_use]
    pub fn arms(&self) -> &[Arc<Arm>] {
        &self.arms
    }

    /// The arm of that name.
    #[must_use]
    pub fn find(&self, name: &str) -> Option<&Arc<Arm>> {
        self.arms.iter().find(|a| a.name == name)
    }

    /// Number of the device of that name.
    #[must_use]
    pub fn number(&self, name: &str) -> Option<usize> {
        self.arms.iter().position(|a| a.name == name)
    }
}

impl Devices for DeviceTable {
    fn arm(&self, name: &str) -> Option<ArmBinding> {
        let arm = self.find(name)?;
        Some(ArmBinding {
            first_joint: arm.first_joint,
            limits: Arc::clone(&arm.limits),
            kinematics: None,
        })
    }

    fn names(&self) -> Vec<String> {
        self.arms.iter().map(|a| a.name.clone()).collect()
    }
}
