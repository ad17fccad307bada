//! Cell file configuration of devices: plain data, read by `cell` and used by drivers.

mod on_end;
mod robot;
mod segment;
mod slave;
mod youbot;

pub use on_end::{OnEnd, OutputsOnEnd};
pub use robot::{IiwaConfig, IiwaIo, IiwaModel, LwrConfig, RmpConfig};
pub use segment::{CanopenConfig, DriveArm, DriveJoint, EthercatConfig, LinkLoss, Recovery};
pub use slave::{
    AnalogueChannel, EthercatClocks, EthercatIo, EthercatSlave, LostPolicy, SlaveGoal, SlavePdo,
    SlaveTimeouts, StartupObject, StartupValue, UnlockedPolicy,
};
pub use youbot::{YouBotArm, YouBotBase, YouBotControl};
