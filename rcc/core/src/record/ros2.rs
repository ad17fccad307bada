//! A recording as messages of ROS 2, so that viewers show it: joints, frames, forces, signals, states of devices, values and
//! events of nets, the log. They are derived from the words of each cycle after these left the net thread.

pub(super) mod cdr;
pub(super) mod schemas;
mod values;

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::io::{Seek, Write};
use std::ops::Range;
use std::sync::Arc;

use takt_net::device::{Interfaces, Io, Kinematics, Layout};
use takt_net::netcomm::{Directory, OutStatus};
use takt_net::{Frame, Nanos};

use crate::cell::CellFrames;
use crate::device::{DeviceDescription, DeviceStatus, Place, parts};
use crate::error::Error;
use crate::ids::NetId;
use crate::record::file::Writer;
use crate::record::notes::LEVEL_WARN;
use crate::record::words::{Entry, Inputs, Reader};
use cdr::Cdr;
use values::{fields, identifier, number, shown};

/// Nets whose values have a topic in one file; MCAP numbers 65,536 channels.
const NET_TOPICS_MAX: usize = 4096;
/// Time between two messages about a device whose state stays the same, ns.
const DIAGNOSIS_NS: i64 = 1_000_000_000;

/// Unix time of a message.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stamp(pub(super) u64);

impl Stamp {
    fn write(self, cdr: &mut Cdr) -> &mut Cdr {
        let Self(ns) = self;
        let seconds = i32::try_from(ns / 1_000_000_000).unwrap_or(i32::MAX);
        let rest = u32::try_from(ns % 1_000_000_000).unwrap_or(0);
        cdr.i32(seconds).u32(rest)
    }

    fn header<'a>(self, cdr: &'a mut Cdr, frame: &str) -> &'a mut Cdr {
        self.write(cdr).text(frame)
    }
}

/// A device as viewers see it.
#[derive(Debug)]
struct DeviceTopics {
    name: String,
    number: usize,
    joints: Range<usize>,
    joint_names: Vec<String>,
    signals: Range<usize>,
    own: Interfaces,
    kinematics: Option<Arc<dyn Kinematics>>,
    states: Option<u16>,
    set_points: Option<u16>,
    wrench: Option<u16>,
    io: Option<u16>,
    /// Status, faults and time of the last message about it.
    shown: Option<(DeviceStatus, u64, i64)>,
}

/// Values of a net as viewers see them.
#[derive(Debug)]
struct NetTopic {
    channel: u16,
    directory: Arc<Directory>,
}

/// The messages of a recording.
#[derive(Debug, Default)]
pub(super) struct Messages {
    cdr: Cdr,
    channels: HashMap<String, u16>,
    devices: BTreeMap<usize, DeviceTopics>,
    nets: HashMap<u32, NetTopic>,
    running: BTreeSet<u32>,
    /// Number and begin of the cycle before.
    before: Option<(u64, Nanos)>,
    is_full: bool,
}

impl Messages {
    /// The channel of a topic, which is added when it is first used.
    fn channel<W: Write + Seek>(
        &mut self,
        to: &mut Writer<W>,
        topic: &str,
        schema: &schemas::Schema,
    ) -> Result<u16, Error> {
        if let Some(known) = self.channels.get(topic) {
            return Ok(*known);
        }
        let channel = to.channel(topic, schema.name, &schema.text())?;
        self.channels.insert(topic.to_owned(), channel);
        Ok(channel)
    }

    /// A device was added.
    pub(super) fn device<W: Write + Seek>(
        &mut self,
        to: &mut Writer<W>,
        (number, place): (usize, &Place),
        description: &DeviceDescription,
    ) -> Result<(), Error> {
        let name = &description.name;
        let topic = |what: &str| format!("/{}/{what}", identifier(name));
        let joints = place.first_joint..place.first_joint + place.joints;
        let own = parts::lay(&description.parts, place.joints, &mut Layout::default());
        let has_joints = !joints.is_empty();
        let mut of = |wanted: bool, what: &str, schema| {
            wanted
                .then(|| self.channel(to, &topic(what), schema))
                .transpose()
        };
        let device = DeviceTopics {
            joint_names: (1..=place.joints)
                .map(|n| format!("{name}.joint_{n}"))
                .collect(),
            name: name.clone(),
            number,
            joints,
            signals: place.signals.clone(),
            kinematics: takt_motion::kinematics::limited(&description.model, &description.limits),
            states: of(has_joints, "joint_states", &schemas::JOINT_STATE)?,
            set_points: of(has_joints, "set_points", &schemas::JOINT_STATE)?,
            wrench: of(own.wrench.is_some(), "wrench", &schemas::WRENCH_STAMPED)?,
            io: of(own.io.is_some(), "signals", &schemas::SIGNALS)?,
            own,
            shown: None,
        };
        self.devices.insert(number, device);
        Ok(())
    }

    /// A device was removed.
    pub(super) fn device_gone(&mut self, name: &str) {
        self.devices.retain(|_, device| device.name != name);
    }

    /// A net was loaded.
    pub(super) fn net<W: Write + Seek>(
        &mut self,
        to: &mut Writer<W>,
        (id, directory): (u32, &Arc<Directory>),
        at: Stamp,
    ) -> Result<(), Error> {
        if shown(directory).next().is_none() {
            return Ok(());
        }
        if self.nets.len() >= NET_TOPICS_MAX {
            if !std::mem::replace(&mut self.is_full, true) {
                let text = format!(
                    "values of nets after {} have no topic in this file, their words are in /takt/cycles\nhint: record \
                     shorter runs",
                    NetId(id)
                );
                self.log(to, (LEVEL_WARN, "takt_core::record", &text), at)?;
            }
            return Ok(());
        }
        let name = NetId(id).to_string();
        let schema = format!("takt_msgs/msg/Values{id}");
        let text = schemas::of_net(&fields(directory));
        let channel = to.channel(&format!("/takt/nets/{name}"), &schema, &text)?;
        let directory = Arc::clone(directory);
        self.nets.insert(id, NetTopic { channel, directory });
        Ok(())
    }

    /// A line was logged.
    pub(super) fn log<W: Write + Seek>(
        &mut self,
        to: &mut Writer<W>,
        (level, name, text): (u8, &str, &str),
        at: Stamp,
    ) -> Result<(), Error> {
        let channel = self.channel(to, "/rosout", &schemas::LOG)?;
        let cdr = at.write(self.cdr.begin()).u8(level);
        cdr.text(name).text(text).text("").text("").u32(0);
        to.message(channel, self.cdr.bytes(), at)
    }

    /// Frames of the cell that do not move.
    pub(super) fn frames<W: Write + Seek>(
        &mut self,
        to: &mut Writer<W>,
        frames: &CellFrames,
        at: Stamp,
    ) -> Result<(), Error> {
        let of_frames = frames.frames.iter().map(|it| {
            let name = it.name.clone();
            (it.parent.clone(), name, it.placement().frame())
        });
        let of_bases = frames.bases.iter().map(|it| {
            let name = format!("{}.base", it.device);
            (it.parent.clone(), name, it.placement().frame())
        });
        let of_tools = frames.tools.iter().map(|it| {
            let name = format!("{}.{}", it.device, it.name);
            (
                format!("{}.flange", it.device),
                name,
                it.placement().frame(),
            )
        });
        let all: Vec<_> = of_frames.chain(of_bases).chain(of_tools).collect();
        if all.is_empty() {
            return Ok(());
        }
        let channel = self.channel(to, "/tf_static", &schemas::TRANSFORMS)?;
        self.cdr.begin().count(all.len());
        for (parent, child, frame) in &all {
            transform(&mut self.cdr, at, (parent, child), frame);
        }
        to.message(channel, self.cdr.bytes(), at)
    }

    /// The messages of a cycle with these words.
    pub(super) fn cycle<W: Write + Seek>(
        &mut self,
        to: &mut Writer<W>,
        words: &[u64],
        at: Stamp,
    ) -> Result<(), Error> {
        let mut reader = Reader(words);
        let mut cycle = self.before.map_or(0, |(cycle, _)| cycle + 1);
        // Words of the thread are whole; what follows a damaged entry would be guessed.
        while let Ok(Some(entry)) = reader.next() {
            let (net, event, cause) = match entry {
                Entry::Inputs(inputs) => {
                    cycle = inputs.moment.cycle;
                    self.inputs(to, &inputs, at)?;
                    continue;
                }
                Entry::Outputs(joints) => {
                    self.set_points(to, joints, at)?;
                    continue;
                }
                Entry::Outbox(net, words) => {
                    self.values(to, net, words, at)?;
                    continue;
                }
                Entry::Started(net) | Entry::Seated(net, ..) => (net, "started", String::new()),
                Entry::Succeeded(net) => (net, "started", "by a rule".to_owned()),
                Entry::Cancelled(net) => (net, "cancel requested", String::new()),
                Entry::Takeover(net, true) => (net, "successor waits", String::new()),
                Entry::Takeover(net, false) => (net, "successor withdrawn", String::new()),
                Entry::Ended(net, code, device) => (net, "ended", self.cause(code, device)),
                Entry::Aborted(_)
                | Entry::Stopped(_)
                | Entry::RanAway(_)
                | Entry::MachineAdded(_)
                | Entry::MachineRemoved(_)
                | Entry::SeatFailed(..)
                | Entry::MachineInput(..)
                | Entry::Inbox(..)
                | Entry::Stepped => continue,
            };
            match event {
                "started" => self.running.insert(net),
                "ended" => self.running.remove(&net),
                _ => false,
            };
            let channel = self.channel(to, "/takt/net_events", &schemas::NET_EVENT)?;
            let cdr = at.write(self.cdr.begin()).u64(cycle);
            cdr.text(&NetId(net).to_string()).text(event).text(&cause);
            to.message(channel, self.cdr.bytes(), at)?;
        }
        Ok(())
    }

    /// Why a net ended, from the codes of its entry.
    fn cause(&self, code: u64, device: u64) -> String {
        let text = match code {
            0 => "terminated",
            1 => "aborted",
            2 => {
                let number = usize::try_from(device).unwrap_or(usize::MAX);
                let name = self.devices.get(&number).map(|device| device.name.as_str());
                return format!("fault of {}", name.unwrap_or("a device that was removed"));
            }
            3 => "a rule",
            _ => "it exceeded its time",
        };
        text.to_owned()
    }

    fn inputs<W: Write + Seek>(
        &mut self,
        to: &mut Writer<W>,
        inputs: &Inputs<'_>,
        at: Stamp,
    ) -> Result<(), Error> {
        self.thread(to, inputs, at)?;
        let mut devices = std::mem::take(&mut self.devices);
        let mut all = devices.values_mut();
        let result = all.try_for_each(|device| self.reported(to, device, inputs, at));
        self.devices = devices;
        result
    }

    #[expect(clippy::cast_precision_loss, reason = "less than a day")]
    fn thread<W: Write + Seek>(
        &mut self,
        to: &mut Writer<W>,
        inputs: &Inputs<'_>,
        at: Stamp,
    ) -> Result<(), Error> {
        let (cycle, wall) = (inputs.moment.cycle, inputs.moment.wall);
        let before = self.before.replace((cycle, wall));
        let (interval, missed) = before.map_or((f64::NAN, 0), |(last, begin)| {
            let interval = wall.0.saturating_sub(begin.0);
            (interval as f64 * 1e-3, cycle.saturating_sub(last + 1))
        });
        let channel = self.channel(to, "/takt/thread", &schemas::CYCLE)?;
        let cdr = at.write(self.cdr.begin()).u64(cycle);
        cdr.f64(interval).u64(missed).count(self.running.len());
        to.message(channel, self.cdr.bytes(), at)
    }

    /// What a device reported.
    fn reported<W: Write + Seek>(
        &mut self,
        to: &mut Writer<W>,
        device: &mut DeviceTopics,
        inputs: &Inputs<'_>,
        at: Stamp,
    ) -> Result<(), Error> {
        let joints = || inputs.joints(device.joints.clone());
        let signals = inputs.signals(&device.signals);
        if let Some(channel) = device.states {
            let positions = joints().map(|it| or_nan(it.measured_position));
            let velocities = joints().map(|it| or_nan(it.measured_velocity));
            let torques = device.own.torques.as_deref().unwrap_or_default();
            let efforts = torques.iter().map(|it| or_nan(it.measured.read(signals)));
            let cdr = at.header(self.cdr.begin(), "").texts(&device.joint_names);
            cdr.numbers(positions).numbers(velocities).numbers(efforts);
            to.message(channel, self.cdr.bytes(), at)?;
        }
        if let (Some(channel), Some(wrench)) = (device.wrench, device.own.wrench)
            && let Some(wrench) = wrench.read(signals)
        {
            let cdr = at.header(self.cdr.begin(), &format!("{}.flange", device.name));
            for value in wrench.force.iter().chain(wrench.torque.iter()) {
                cdr.f64(*value);
            }
            to.message(channel, self.cdr.bytes(), at)?;
        }
        if let (Some(channel), Some(io)) = (device.io, &device.own.io) {
            io_message(at.write(self.cdr.begin()), io, signals);
            to.message(channel, self.cdr.bytes(), at)?;
        }
        self.transforms(to, device, inputs, at)?;
        self.diagnosis(to, device, inputs, at)
    }

    /// Where its flange is, or where it is itself.
    fn transforms<W: Write + Seek>(
        &mut self,
        to: &mut Writer<W>,
        device: &DeviceTopics,
        inputs: &Inputs<'_>,
        at: Stamp,
    ) -> Result<(), Error> {
        let (name, of_device) = (&device.name, |what| format!("{}.{what}", device.name));
        let placed = if let Some(arm) = &device.kinematics {
            let joints = inputs.joints(device.joints.clone());
            let positions: Option<Vec<_>> = joints.map(|it| it.measured_position).collect();
            let frame = positions.map(|joints| arm.forward(&joints));
            frame.map(|frame| (of_device("base"), of_device("flange"), frame))
        } else if let Some(base) = &device.own.base {
            let pose = base.pose.read(inputs.signals(&device.signals));
            pose.map(|frame| (of_device("odometry"), name.clone(), frame))
        } else {
            None
        };
        let Some((parent, child, frame)) = placed else {
            return Ok(());
        };
        let channel = self.channel(to, "/tf", &schemas::TRANSFORMS)?;
        self.cdr.begin().count(1);
        transform(&mut self.cdr, at, (&parent, &child), &frame);
        to.message(channel, self.cdr.bytes(), at)
    }

    /// Its state, when it changes and once a second.
    fn diagnosis<W: Write + Seek>(
        &mut self,
        to: &mut Writer<W>,
        device: &mut DeviceTopics,
        inputs: &Inputs<'_>,
        at: Stamp,
    ) -> Result<(), Error> {
        let Some((status, faults)) = inputs.device(device.number) else {
            return Ok(());
        };
        let now = inputs.moment.wall.0;
        let is_due = device.shown.is_none_or(|(shown, counted, since)| {
            (shown, counted) != (status, faults) || now - since >= DIAGNOSIS_NS
        });
        if !is_due {
            return Ok(());
        }
        device.shown = Some((status, faults, now));
        let (level, text) = match status {
            DeviceStatus::Operational => (0, "operational"),
            DeviceStatus::SafeOperational => (1, "safe-operational: it follows no commands"),
            DeviceStatus::Offline => (2, "offline: no contact"),
        };
        let channel = self.channel(to, "/diagnostics", &schemas::DIAGNOSTICS)?;
        let cdr = at.header(self.cdr.begin(), "").count(1).u8(level);
        cdr.text(&device.name).text(text).text(&device.name);
        cdr.count(1).text("faults").text(&faults.to_string());
        to.message(channel, self.cdr.bytes(), at)
    }

    /// What nets commanded.
    fn set_points<W: Write + Seek>(
        &mut self,
        to: &mut Writer<W>,
        commanded: &[u64],
        at: Stamp,
    ) -> Result<(), Error> {
        for device in self.devices.values() {
            let Some(channel) = device.set_points else {
                continue;
            };
            let position = |joint: usize| {
                let mut pairs = commanded.chunks_exact(2);
                let pair = pairs.find(|pair| pair.first() == Some(&(joint as u64)));
                pair.and_then(|pair| pair.get(1))
                    .map(|bits| f64::from_bits(*bits))
            };
            if !device.joints.clone().any(|joint| position(joint).is_some()) {
                continue;
            }
            let positions = device.joints.clone().map(|joint| or_nan(position(joint)));
            let cdr = at.header(self.cdr.begin(), "").texts(&device.joint_names);
            let none = || std::iter::empty::<f64>();
            cdr.numbers(positions).numbers(none()).numbers(none());
            to.message(channel, self.cdr.bytes(), at)?;
        }
        Ok(())
    }

    /// Values of a net that changed.
    fn values<W: Write + Seek>(
        &mut self,
        to: &mut Writer<W>,
        net: u32,
        words: &[u64],
        at: Stamp,
    ) -> Result<(), Error> {
        let Some(NetTopic { channel, directory }) = self.nets.get(&net) else {
            return Ok(());
        };
        let cdr = at.write(self.cdr.begin());
        for value in shown(directory) {
            let is_known = value.status(words) == OutStatus::Current;
            let numbers = value.value(words).iter().map(|word| {
                let number = number(value.ty.element, *word);
                if is_known { number } else { f64::NAN }
            });
            if value.ty.array {
                cdr.numbers(numbers);
            } else {
                for number in numbers {
                    cdr.f64(number);
                }
            }
        }
        to.message(*channel, self.cdr.bytes(), at)
    }
}

fn or_nan(value: Option<f64>) -> f64 {
    value.unwrap_or(f64::NAN)
}

fn io_message(cdr: &mut Cdr, io: &Io, signals: &[u64]) {
    let bit = |value: Option<bool>| or_nan(value.map(|on| f64::from(u8::from(on))));
    cdr.numbers(io.bool_in.iter().map(|it| bit(it.read(signals))));
    cdr.numbers(io.bool_out.iter().map(|it| bit(it.state.read(signals))));
    cdr.numbers(io.real_in.iter().map(|it| or_nan(it.read(signals))));
    cdr.numbers(io.real_out.iter().map(|it| or_nan(it.state.read(signals))));
}

fn transform(cdr: &mut Cdr, at: Stamp, (parent, child): (&str, &str), frame: &Frame) {
    let cdr = at.header(cdr, parent).text(child);
    for value in frame.translation.vector.iter() {
        cdr.f64(*value);
    }
    let turn = &frame.rotation;
    cdr.f64(turn.i).f64(turn.j).f64(turn.k).f64(turn.w);
}
