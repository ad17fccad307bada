#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod config;
mod driver;
#[cfg(test)]
#[path = "../../tests/plant/mod.rs"]
mod plant;
mod segment;

pub use config::{
    AnalogueChannel, EthercatClocks, EthercatConfig, EthercatHoming, EthercatIo, EthercatServo,
    EthercatSlave, LostPolicy, ServoPower, SlaveGoal, SlavePdo, SlaveTimeouts, StartupObject,
    StartupValue, UnlockedPolicy, YouBotArm, YouBotBase, YouBotControl, YouBotZero,
};
pub use segment::{
    Ethercat, EthercatFigures, EthernetLink, Wait, Wire, Wires, YouBotFigures, check, describe,
    master_config, open,
};
