//! From the cell's words to a master's configuration and to devices. It opens nothing.

use takt_ethercat::axis;
use takt_ethercat::config::{ConfigError, MasterConfig, Place, SlaveSpec, SyncSpec};
use takt_ethercat::master::Master;

use super::youbot;
use crate::cell::{DriveJoint, EthercatConfig, EthercatSlave};
use crate::device::{DeviceDescription, Part, drives};

/// Datagrams for mailboxes in a cycle: nine drives of a youBot are asked at once.
const YOUBOT_ACYCLIC: u8 = 4;

/// The devices of a segment: first its arms, then its inputs and outputs, then its youBots.
#[must_use]
pub fn describe(config: &EthercatConfig) -> Vec<DeviceDescription> {
    let arms = config
        .arms
        .iter()
        .map(|arm| drives::describe(arm, "ethercat_arm"));
    let bits = |slaves: &[(String, usize)]| slaves.iter().map(|(_, bits)| bits).sum();
    let ios = config.ios.iter().map(|io| DeviceDescription {
        name: io.name.clone(),
        kind: "ethercat_io",
        limits: Vec::new(),
        model: "".into(),
        parts: vec![Part::Io {
            bool_in: bits(&io.digital_in),
            bool_out: bits(&io.digital_out),
            real_in: 0,
            real_out: 0,
        }],
    });
    arms.chain(ios).chain(youbot::describe(config)).collect()
}

/// The slave of that name.
pub(super) fn slave(config: &EthercatConfig, name: &str) -> Option<usize> {
    config.slaves.iter().position(|slave| slave.name == name)
}

/// A master for a segment.
pub(super) fn master(config: &EthercatConfig) -> Result<Master, ConfigError> {
    Master::new(MasterConfig {
        cycle: config.cycle,
        slaves: config
            .slaves
            .iter()
            .map(|slave| spec(slave, config))
            .chain(youbot::specs(config))
            .collect(),
        acyclic: if config.youbot_arms.is_empty() && config.youbot_bases.is_empty() {
            1
        } else {
            YOUBOT_ACYCLIC
        },
        ..MasterConfig::default()
    })
}

fn spec(slave: &EthercatSlave, config: &EthercatConfig) -> SlaveSpec {
    let place = slave.alias.map_or_else(
        || Place::Position(slave.position.unwrap_or_default()),
        Place::Alias,
    );
    let mut spec = SlaveSpec {
        vendor: slave.vendor,
        product: slave.product,
        watchdog: slave.watchdog,
        ..SlaveSpec::new(slave.name.clone(), place)
    };
    if slave.axes > 0 {
        let (outputs, inputs) = axis::pdos(slave.axes);
        (spec.outputs, spec.inputs) = (Some(outputs), Some(inputs));
        let interpolation = (0..slave.axes).flat_map(|a| axis::interpolation(a, config.cycle));
        spec.startup = interpolation.collect();
    }
    if slave.sync0 {
        spec.sync = Some(SyncSpec::sync0(config.cycle));
    }
    spec
}

/// What is wrong with a configuration.
///
/// # Errors
/// A text that names it.
pub fn check(config: &EthercatConfig) -> Result<(), String> {
    let name = &config.name;
    master(config).map_err(|error| format!("{name}: {error}"))?;
    for slave in &config.slaves {
        if slave.position.is_some() == slave.alias.is_some() {
            let slave = &slave.name;
            return Err(format!(
                "{name}: slave {slave} needs a position or an alias"
            ));
        }
        if slave.axes > 8 {
            return Err(format!("{name}: slave {} has at most 8 axes", slave.name));
        }
    }
    for arm in &config.arms {
        let checked = drives::check(arm, |joint| check_drive(config, joint));
        checked.map_err(|what| format!("{name}: {what}"))?;
    }
    youbot::check(config).map_err(|what| format!("{name}: {what}"))?;
    let bits = config
        .ios
        .iter()
        .flat_map(|io| io.digital_in.iter().chain(&io.digital_out));
    for (of, _) in bits {
        if slave(config, of).is_none() {
            return Err(format!("{name}: there is no slave `{of}`"));
        }
    }
    Ok(())
}

fn check_drive(config: &EthercatConfig, joint: &DriveJoint<String>) -> Result<(), String> {
    let Some(slave) = slave(config, &joint.drive).and_then(|at| config.slaves.get(at)) else {
        return Err(format!("there is no slave `{}`", joint.drive));
    };
    if joint.axis < slave.axes {
        return Ok(());
    }
    Err(format!(
        "slave {} has {} axes, counted from 0; give it `axes`",
        slave.name, slave.axes
    ))
}
