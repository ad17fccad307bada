//! What a segment drives: arms, inputs and outputs, servo axes, youBots. The cycle that steps them is the segment's.

use takt_core::device::driver::DeviceEnd;

use super::arm::Arm;
use super::io::InOut;
use super::servo::ServoAxis;
use super::wire::WireValues;
use super::youbot::YouBots;
use crate::config::EthercatConfig;

/// What a segment drives, each with its end of a device.
pub(super) struct Units {
    pub(super) arms: Vec<Arm>,
    pub(super) ios: Vec<InOut>,
    pub(super) servos: Vec<ServoAxis>,
    pub(super) youbots: YouBots,
}

impl Units {
    /// In the order of [`describe`](super::describe()).
    pub(super) fn new(config: &EthercatConfig, ends: Vec<DeviceEnd>) -> Self {
        let mut ends = ends.into_iter();
        let arms = config.arms.iter().zip(&mut ends);
        let arms = arms.map(|(arm, end)| Arm::new(config, arm, end)).collect();
        let ios = config.ios.iter().zip(&mut ends);
        let ios = ios.map(|(io, end)| InOut::new(config, io, end)).collect();
        let servos = config.servos.iter().zip(&mut ends);
        let servos = servos.map(|(servo, end)| ServoAxis::new(config, servo, end));
        Self {
            arms,
            ios,
            servos: servos.collect(),
            youbots: YouBots::new(config, &mut ends),
        }
    }

    /// Reports the figures of the wire with the next cycle of each device.
    pub(super) fn report_wire(&mut self, values: &WireValues) {
        self.arms.iter_mut().for_each(|arm| arm.report_wire(values));
        self.ios.iter_mut().for_each(|io| io.report_wire(values));
        for servo in &mut self.servos {
            servo.report_wire(values);
        }
        self.youbots.report_wire(values);
    }
}
