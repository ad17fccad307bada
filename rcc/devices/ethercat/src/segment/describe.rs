//! Converts the cell's configuration of a segment to a master configuration and device descriptions. It opens
//! nothing.

use std::ops::RangeInclusive;
use std::time::Duration;

use takt_cia402::dictionary::{Address, Mapped};
use takt_ethercat::AlState;
use takt_ethercat::axis;
use takt_ethercat::coe::Whole;
use takt_ethercat::config::{
    ClockConfig, IMAGE_MAX, Location, MasterConfig, PdoSpec, SlaveSpec, StartupSdo, SyncSpec,
    Unlocked,
};
use takt_ethercat::encoder::CHANNELS_MAX;
use takt_ethercat::master::Master;

use super::wire::wire_figures;
use super::youbot;
use crate::config::{
    AnalogueChannel, EthercatConfig, EthercatHoming, EthercatIo, EthercatServo, EthercatSlave,
    ServoPower, SlaveGoal, SlavePdo, SlaveTimeouts, StartupObject, UnlockedPolicy,
};
use takt_core::device::parts::with_figures;
use takt_core::device::{DeviceDescription, Part, homing};
use takt_device_drives as drives;
use takt_device_drives::{DriveArm, DriveJoint, Recovery};

/// Mailbox datagrams per cycle: up to nine youBot drives are polled at once.
const YOUBOT_ACYCLIC: u8 = 4;
/// Torque offset of the first axis.
const TORQUE_OFFSET: Address = Address::new(0x60B2, 0);
/// Most bits of one device: the payload of a frame.
const BITS_MAX: usize = 8 * IMAGE_MAX;
/// Lost frames after which slaves may count as absent.
const LOST_FRAMES: RangeInclusive<u8> = 1..=250;
/// Longest watchdog: 65,535 steps of 100 us.
const WATCHDOG_MAX: Duration = Duration::from_micros(6_553_500);
/// Longest time of a brake: power is removed a second and a half after a shutdown request at the earliest.
const BRAKE_MAX: Duration = Duration::from_secs(1);
/// Largest clock window and longest SYNC1 delay.
const CLOCK_MAX: Duration = Duration::from_secs(1);

/// The devices of a segment: arms, then inputs and outputs, servo axes, youBots.
#[must_use]
pub fn describe(config: &EthercatConfig) -> Vec<DeviceDescription> {
    let arms = config
        .arms
        .iter()
        .map(|arm| drives::describe(arm, "ethercat_arm", wire_figures()));
    let ios = config.ios.iter().map(|io| DeviceDescription {
        name: io.name.clone(),
        kind: "ethercat_io",
        limits: Vec::new(),
        model: "".into(),
        parts: with_figures(&[part(io)], wire_figures()),
    });
    let servos = config.servos.iter().map(|servo| DeviceDescription {
        name: servo.name.clone(),
        kind: "ethercat_servo",
        limits: Vec::new(),
        model: "".into(),
        parts: with_figures(&AXIS_PARTS, wire_figures()),
    });
    let all = arms.chain(ios).chain(servos);
    all.chain(youbot::describe(config)).collect()
}

/// The device of inputs and outputs, as nets see it.
pub(super) fn part(io: &EthercatIo) -> Part {
    Part::Io {
        bool_in: bits(&io.digital_in).min(BITS_MAX),
        bool_out: bits(&io.digital_out).min(BITS_MAX),
        real_in: io.analogue_in.len(),
        real_out: io.analogue_out.len(),
    }
}

/// A servo axis, as nets see it.
pub(super) const AXIS_PARTS: [Part; 2] = [
    Part::Homing,
    Part::Io {
        bool_in: homing::BOOL_IN,
        bool_out: homing::BOOL_OUT,
        real_in: homing::REAL_IN,
        real_out: 0,
    },
];

/// Number of configured bits.
pub(super) fn bits(of: &[(String, usize)]) -> usize {
    of.iter()
        .fold(0, |sum: usize, (_, bits)| sum.saturating_add(*bits))
}

/// The slave with that name.
pub(super) fn slave(config: &EthercatConfig, name: &str) -> Option<usize> {
    config.slaves.iter().position(|slave| slave.name == name)
}

/// The servo axis with that name.
pub(super) fn servo(config: &EthercatConfig, name: &str) -> Option<usize> {
    config.servos.iter().position(|servo| servo.name == name)
}

/// Configuration of the segment's master.
#[must_use]
pub fn master_config(config: &EthercatConfig) -> MasterConfig {
    let EthercatConfig { clocks, .. } = config;
    MasterConfig {
        cycle: config.cycle,
        slaves: config
            .slaves
            .iter()
            .map(|slave| spec(slave, config))
            .chain(youbot::specs(config))
            .collect(),
        redundant: config.second.is_some(),
        lost_frames: config.lost_frames,
        acyclic: if config.youbot_arms.is_empty() && config.youbot_bases.is_empty() {
            1
        } else {
            YOUBOT_ACYCLIC
        },
        clocks: ClockConfig {
            window_ns: u32::try_from(clocks.window.as_nanos()).unwrap_or(u32::MAX),
            lock: clocks.lock,
            unlocked: match clocks.unlocked {
                UnlockedPolicy::Refuse => Unlocked::Refuse,
                UnlockedPolicy::Start => Unlocked::Start,
            },
            ..ClockConfig::default()
        },
        ..MasterConfig::default()
    }
}

/// Axes of a slave to which torques are fed forward.
fn fed_forward(config: &EthercatConfig, slave: &str) -> impl Iterator<Item = u8> {
    let arms = config.arms.iter().filter(|arm| arm.feed_forward > 0.0);
    let joints = arms.flat_map(|arm| &arm.joints);
    let joints = joints.filter(move |joint| joint.drive == slave);
    joints.map(|joint| joint.axis)
}

fn spec(slave: &EthercatSlave, config: &EthercatConfig) -> SlaveSpec {
    let cycle = config.cycle;
    let mut spec = SlaveSpec {
        vendor: slave.vendor,
        product: slave.product,
        revision: slave.revision,
        optional: slave.optional,
        group: slave.group,
        goal: match slave.goal {
            SlaveGoal::PreOp => AlState::PreOp,
            SlaveGoal::SafeOp => AlState::SafeOp,
            SlaveGoal::Op => AlState::Op,
        },
        watchdog: slave.watchdog,
        complete_access: slave.complete_access,
        startup: slave.startup.iter().map(startup).collect(),
        sync: slave.sync0.then(|| sync(slave, cycle)),
        timeouts: (slave.timeouts != SlaveTimeouts::default()).then(|| slave.timeouts.for_master()),
        ..SlaveSpec::new(slave.name.clone(), location(slave))
    };
    if slave.axes > 0 {
        let (mut outputs, inputs) = axis::pdos(slave.axes);
        for axis in fed_forward(config, &slave.name) {
            let address = TORQUE_OFFSET.on_axis(axis);
            if let (Some(address), Some(pdo)) = (address, outputs.get_mut(usize::from(axis))) {
                pdo.entries.push(Mapped { address, bits: 16 });
            }
        }
        (spec.outputs, spec.inputs) = (Some(outputs), Some(inputs));
        let interpolation = (0..slave.axes).flat_map(|a| axis::interpolation(a, cycle));
        spec.startup.extend(interpolation);
    }
    let own = |pdos: &Vec<SlavePdo>| pdos.iter().map(pdo).collect();
    spec.outputs = slave.outputs.as_ref().map(own).or(spec.outputs);
    spec.inputs = slave.inputs.as_ref().map(own).or(spec.inputs);
    spec
}

fn location(slave: &EthercatSlave) -> Location {
    match (slave.alias, &slave.sii_name) {
        (Some(alias), _) => Location::Alias(alias),
        (None, Some(name)) => Location::Name(name.clone()),
        (None, None) => Location::Position(slave.position.unwrap_or_default()),
    }
}

fn sync(slave: &EthercatSlave, cycle: Duration) -> SyncSpec {
    let sync0 = SyncSpec {
        shift_ns: slave.shift,
        ..SyncSpec::sync0(cycle)
    };
    match slave.sync1 {
        Some(sync1) => SyncSpec {
            assign_activate: SyncSpec::BOTH,
            sync1,
            ..sync0
        },
        None => sync0,
    }
}

fn pdo(pdo: &SlavePdo) -> PdoSpec {
    let entry = |(index, sub, bits): &(u16, u8, u8)| Mapped {
        address: Address::new(*index, *sub),
        bits: *bits,
    };
    PdoSpec {
        index: pdo.pdo,
        entries: pdo.entries.iter().map(entry).collect(),
    }
}

fn startup(object: &StartupObject) -> StartupSdo {
    let whole = if object.complete {
        Whole::Object
    } else {
        Whole::Entry
    };
    StartupSdo {
        whole,
        may_fail: object.may_fail,
        ..StartupSdo::entry(Address::new(object.index, object.sub), object.value.bytes())
    }
}

/// Checks a configuration.
///
/// # Errors
/// With a text that names the finding.
pub fn check(config: &EthercatConfig) -> Result<(), String> {
    let named = |what: String| format!("{}: {what}", config.name);
    check_segment(config).map_err(named)?;
    Master::new(master_config(config)).map_err(|error| named(error.to_string()))?;
    for slave in &config.slaves {
        check_slave(slave, config)
            .map_err(|what| named(format!("slave {}: {what}", slave.name)))?;
    }
    for arm in &config.arms {
        drives::check(arm, |joint| check_drive(config, joint)).map_err(named)?;
    }
    for servo in &config.servos {
        check_servo(config, servo)
            .map_err(|what| named(format!("servo {}: {what}", servo.name)))?;
    }
    youbot::check(config).map_err(named)?;
    for io in &config.ios {
        check_io(config, io).map_err(|what| named(format!("io {}: {what}", io.name)))?;
    }
    Ok(())
}

fn check_segment(config: &EthercatConfig) -> Result<(), String> {
    if config.second.as_ref() == Some(&config.interface) {
        return Err(format!(
            "`second` is {}, as `interface` is; a ring needs two interfaces",
            config.interface
        ));
    }
    if config.spin > config.cycle / 2 {
        let half = config.cycle / 2;
        return Err(format!(
            "`spin` is {:?}; it must be at most half a cycle, {half:?}",
            config.spin
        ));
    }
    if !LOST_FRAMES.contains(&config.lost_frames) {
        return Err(format!(
            "`lost_frames` is {}; it must be from {} to {}",
            config.lost_frames,
            LOST_FRAMES.start(),
            LOST_FRAMES.end()
        ));
    }
    if config.clocks.window > CLOCK_MAX {
        let window = config.clocks.window;
        return Err(format!(
            "clocks.window is {window:?}; it must be at most 1s"
        ));
    }
    Ok(())
}

fn check_slave(slave: &EthercatSlave, config: &EthercatConfig) -> Result<(), String> {
    let cycle = config.cycle;
    let places = [
        slave.position.is_some(),
        slave.alias.is_some(),
        slave.sii_name.is_some(),
    ];
    if slave.name.is_empty() {
        return Err("it has no name".to_owned());
    }
    if places.into_iter().filter(|given| *given).count() != 1 {
        return Err("it needs one of `position`, `alias` and `sii_name`".to_owned());
    }
    if slave.axes > 8 {
        return Err(format!("it has at most 8 axes, not {}", slave.axes));
    }
    if !slave.sync0 && (slave.sync1.is_some() || slave.shift != 0) {
        return Err("`sync1` and `shift` need `sync0 = true`".to_owned());
    }
    if u128::from(slave.shift.unsigned_abs()) >= cycle.as_nanos() {
        return Err(format!(
            "`shift` is {} ns; it must be less than the cycle of {cycle:?}",
            slave.shift
        ));
    }
    if slave
        .sync1
        .is_some_and(|sync1| sync1.is_zero() || sync1 > CLOCK_MAX)
    {
        return Err("`sync1` must be more than nothing and at most 1s".to_owned());
    }
    if slave.watchdog.is_some_and(|time| time > WATCHDOG_MAX) {
        return Err(format!("`watchdog` must be at most {WATCHDOG_MAX:?}"));
    }
    if let Some(key) = slave.timeouts.out_of_range() {
        return Err(format!("`timeouts.{key}` must be from 1ms to 10min"));
    }
    check_axes(slave, config)
}

/// PDOs that replace those of the axes must carry the objects for position control.
fn check_axes(slave: &EthercatSlave, config: &EthercatConfig) -> Result<(), String> {
    let lacks = |pdos: &Option<Vec<SlavePdo>>, index: u16, axis: u8| {
        let pdos = pdos.as_ref()?;
        let address = Address::new(index, 0).on_axis(axis)?;
        // The content of a PDO that keeps its mapping is unknown here.
        let kept = pdos.iter().any(|pdo| pdo.entries.is_empty());
        let mut entries = pdos.iter().flat_map(|pdo| &pdo.entries);
        let mapped = entries.any(|(index, sub, _)| Address::new(*index, *sub) == address);
        (!kept && !mapped).then_some(address)
    };
    for axis in fed_forward(config, &slave.name) {
        if let Some(address) = lacks(&slave.outputs, TORQUE_OFFSET.index, axis) {
            return Err(format!(
                "axis {axis} of an arm with `feed_forward` has no {address}; map it, 16 bits, or omit `outputs`"
            ));
        }
    }
    for axis in 0..slave.axes {
        let outputs = [0x6040, 0x607A].map(|index| lacks(&slave.outputs, index, axis));
        let inputs = [0x6041, 0x6064].map(|index| lacks(&slave.inputs, index, axis));
        if let Some(address) = outputs.into_iter().chain(inputs).flatten().next() {
            return Err(format!(
                "axis {axis} cannot be controlled without {address}; map it, or omit `outputs` and `inputs`"
            ));
        }
    }
    Ok(())
}

fn check_io(config: &EthercatConfig, io: &EthercatIo) -> Result<(), String> {
    if io.name.is_empty() {
        return Err("it has no name".to_owned());
    }
    let missing = |name: &str| format!("there is no slave `{name}`");
    for named in [&io.digital_in, &io.digital_out] {
        if let Some((name, _)) = named.iter().find(|(name, _)| slave(config, name).is_none()) {
            return Err(missing(name));
        }
        let count = bits(named);
        if count > BITS_MAX {
            return Err(format!(
                "{count} bits are more than the {BITS_MAX} that a frame can carry"
            ));
        }
    }
    for channel in io.analogue_in.iter().chain(&io.analogue_out) {
        let name = &channel.slave;
        if slave(config, name).is_none() {
            return Err(missing(name));
        }
        check_channel(channel).map_err(|what| format!("analogue channel of `{name}`: {what}"))?;
    }
    if io.analogue_in.len().max(io.analogue_out.len()) > IMAGE_MAX {
        return Err(format!("at most {IMAGE_MAX} analogue channels fit a frame"));
    }
    io.on_end
        .check(bits(&io.digital_out), io.analogue_out.len())
}

fn check_channel(channel: &AnalogueChannel) -> Result<(), String> {
    if channel.object.is_some() == channel.bit.is_some() {
        return Err("give either `object` or `bit`".to_owned());
    }
    if channel.bit.is_some_and(|bit| bit >= BITS_MAX) {
        return Err(format!("`bit` must be less than {BITS_MAX}"));
    }
    if !(1..=32).contains(&channel.bits) {
        return Err(format!(
            "it has {} bits; 1 to 32 are possible",
            channel.bits
        ));
    }
    if !channel.scale.is_normal() || !channel.offset.is_finite() {
        return Err("`scale` and `offset` must be numbers, and `scale` not zero".to_owned());
    }
    Ok(())
}

fn check_servo(config: &EthercatConfig, servo: &EthercatServo) -> Result<(), String> {
    if servo.name.is_empty() {
        return Err("it has no name".to_owned());
    }
    let same = config.servos.iter().filter(|it| it.name == servo.name);
    if same.count() > 1 || slave(config, &servo.name).is_some() {
        return Err("another servo axis or slave has the same name".to_owned());
    }
    let joints = config.arms.iter().flat_map(|arm| &arm.joints);
    let joints = joints.filter(|joint| joint.drive == servo.name).count();
    if joints != 1 {
        return Err(format!(
            "it moves {joints} joints; name it in `slave` of one [[ethercat.arm.joint]]"
        ));
    }
    let slaves = [&servo.encoder, &servo.output.slave];
    let slaves = slaves
        .into_iter()
        .chain(servo.bits().map(|(_, (name, _), _)| name));
    if let Some(name) = slaves
        .into_iter()
        .find(|name| slave(config, name).is_none())
    {
        return Err(format!("there is no slave `{name}`"));
    }
    if let Some((key, ..)) = servo.bits().find(|(_, (_, bit), _)| *bit >= BITS_MAX) {
        return Err(format!("the bit of `{key}` must be less than {BITS_MAX}"));
    }
    if servo.channel >= CHANNELS_MAX {
        return Err(format!("`channel` must be less than {CHANNELS_MAX}"));
    }
    check_channel(&servo.output).map_err(|what| format!("`output`: {what}"))?;
    if !servo.velocity_10v.is_normal() || servo.velocity_10v.abs() > 1e9 {
        return Err("`velocity_10v` must be a number up to 1e9 and not 0".to_owned());
    }
    if !(0.1..=1000.0).contains(&servo.gain) {
        return Err("`gain` must be from 0.1 to 1000".to_owned());
    }
    if !(0.0..=10.0).contains(&servo.offset_max) {
        return Err("`offset_max` must be from 0 to 10".to_owned());
    }
    let moves = |arm: &&DriveArm<String>| arm.joints.iter().any(|j| j.drive == servo.name);
    let on_restart = |arm: &DriveArm<String>| arm.recovery == Recovery::OnRestart;
    if servo.power == ServoPower::OnRequest
        && config.arms.iter().find(moves).is_some_and(on_restart)
    {
        return Err(
            "`power = \"on_request\"` needs an arm with `recovery = \"automatic\"`: an end of the request in motion is a fault of it"
                .to_owned(),
        );
    }
    if servo.brake_time > BRAKE_MAX {
        return Err("`brake_time` must be at most 1s".to_owned());
    }
    match &servo.homing {
        Some(_) if servo.proximity.is_none() => Err("`homing` needs `proximity`".to_owned()),
        Some(homing) => check_homing(homing),
        None => Ok(()),
    }
}

fn check_homing(homing: &EthercatHoming) -> Result<(), String> {
    let wrong = |key: &str, what: &str| Err(format!("`homing.{key}` must be {what}"));
    let above_zero = |value: f64| (1e-6..=1e9).contains(&value);
    if !above_zero(homing.velocity.abs()) {
        return wrong("velocity", "a number other than 0");
    }
    for (key, value) in [
        ("index_velocity", Some(homing.index_velocity)),
        ("index_every", Some(homing.index_every)),
        ("travel_max", homing.travel_max),
    ] {
        if value.is_some_and(|value| !above_zero(value)) {
            return wrong(key, "above 0");
        }
    }
    for (key, value) in [
        ("index_position", homing.index_position),
        ("start", homing.start.unwrap_or_default()),
    ] {
        if !value.is_finite() || value.abs() > 1e6 {
            return wrong(key, "an angle up to 1e6 degrees");
        }
    }
    if homing.timeout.is_zero() || homing.timeout > Duration::from_hours(1) {
        return wrong("timeout", "above 0 and at most 1h");
    }
    Ok(())
}

fn check_drive(config: &EthercatConfig, joint: &DriveJoint<String>) -> Result<(), String> {
    if servo(config, &joint.drive).is_some() {
        if joint.rated_torque.is_some() {
            return Err(format!(
                "servo axis {} measures no torque and takes none: leave out `rated_torque`",
                joint.drive
            ));
        }
        return if joint.axis == 0 {
            Ok(())
        } else {
            Err(format!(
                "servo axis {} has no axis {}",
                joint.drive, joint.axis
            ))
        };
    }
    let Some(slave) = slave(config, &joint.drive).and_then(|at| config.slaves.get(at)) else {
        return Err(format!("there is no slave or servo axis `{}`", joint.drive));
    };
    if joint.axis < slave.axes {
        return Ok(());
    }
    Err(format!(
        "slave {} has {} axes, counted from 0; give it `axes`",
        slave.name, slave.axes
    ))
}
