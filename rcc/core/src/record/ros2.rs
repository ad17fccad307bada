//! A recording as messages of ROS 2, so that viewers show it: joints, frames, forces, signals, states of devices, values and
//! events of nets, the log. They are derived from the words of each cycle after these left the net thread.

pub(super) mod cdr;
mod device;
mod machines;
mod row;
pub(super) mod schemas;
mod values;

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;

use takt_net::netcomm::{Directory, OutStatus};
use takt_net::{JointState, Moment, Nanos};

use crate::cell::CellFrames;
use crate::error::Error;
use crate::executor::flight::NET_WORDS;
use crate::ids::NetId;
use crate::record::notes::LEVEL_WARN;
use crate::record::words::{Entry, Inputs, Reader, start};
pub use cdr::Cdr;
pub(super) use device::ShownDevice;
use device::{DeviceTopics, Reported, transform};
use machines::MachineTopic;
pub(super) use row::FlightRow;
use values::{fields, number, shown};

/// Nets whose values have a topic in one file; MCAP numbers 65,536 channels.
const NET_TOPICS_MAX: usize = 4096;

/// Unix time of a message, ns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Stamp(pub u64);

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

/// Where messages go: a file, or clients. All are of encoding `cdr`, all schemas of encoding `ros2msg`.
pub trait Sink {
    /// Adds a topic with messages of the schema of that name and text; returns its number.
    ///
    /// # Errors
    /// If it cannot be written, or no number is left.
    fn channel(&mut self, topic: &str, schema: &str, text: &str) -> Result<u16, Error>;

    /// Ends a topic, whose number may be used again.
    fn close(&mut self, _channel: u16) {}

    /// Whether messages of a topic are needed.
    fn wants(&self, _channel: u16) -> bool {
        true
    }

    /// Takes a message.
    ///
    /// # Errors
    /// If it cannot be written.
    fn message(&mut self, channel: u16, data: &[u8], at: Stamp) -> Result<(), Error>;
}

/// Topics by name, and the message that is being written.
#[derive(Debug, Default)]
struct Topics {
    cdr: Cdr,
    channels: HashMap<String, u16>,
}

impl Topics {
    /// The channel of a topic, which is added when it is first used.
    fn channel(
        &mut self,
        to: &mut impl Sink,
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

    /// Ends topics.
    fn close(&mut self, to: &mut impl Sink, ended: &[u16]) {
        self.channels.retain(|_, channel| !ended.contains(channel));
        ended.iter().for_each(|channel| to.close(*channel));
    }
}

/// Values of a net as viewers see them.
#[derive(Debug)]
struct NetTopic {
    channel: u16,
    directory: Arc<Directory>,
    /// Out values of which not all rows came yet.
    part: Vec<u64>,
}

/// The messages of a recording.
#[derive(Debug, Default)]
pub(super) struct Messages {
    topics: Topics,
    devices: BTreeMap<usize, DeviceTopics>,
    nets: HashMap<u32, NetTopic>,
    running: BTreeSet<u32>,
    machines: BTreeMap<u32, MachineTopic>,
    /// Memory for the joints of a device.
    joints: Vec<JointState>,
    /// Number and begin of the cycle before.
    before: Option<(u64, Nanos)>,
    is_full: bool,
}

impl Messages {
    /// Goes on after the messages of another file with what is between cycles.
    pub(super) fn continue_after(&mut self, before: &mut Self) {
        self.running = std::mem::take(&mut before.running);
        self.before = before.before;
    }

    /// A device was added.
    pub(super) fn device(
        &mut self,
        to: &mut impl Sink,
        number: usize,
        device: ShownDevice<'_>,
    ) -> Result<(), Error> {
        let device = DeviceTopics::new(&mut self.topics, to, number, device)?;
        self.devices.insert(number, device);
        Ok(())
    }

    /// Adds the topics that a file has from their first message on: clients subscribe before there is one.
    pub(super) fn announce(&mut self, to: &mut impl Sink) -> Result<(), Error> {
        let places = self.devices.values().any(DeviceTopics::is_placed);
        let all = [
            ("/takt/thread", schemas::CYCLE, true),
            (
                "/takt/machine_events",
                schemas::MACHINE_EVENT,
                !self.machines.is_empty(),
            ),
            ("/takt/net_events", schemas::NET_EVENT, true),
            ("/rosout", schemas::LOG, true),
            (
                "/diagnostics",
                schemas::DIAGNOSTICS,
                !self.devices.is_empty(),
            ),
            ("/tf", schemas::TRANSFORMS, places),
        ];
        for (topic, schema, _) in all.iter().filter(|(.., is_used)| *is_used) {
            self.topics.channel(to, topic, schema)?;
        }
        Ok(())
    }

    /// A device was removed.
    pub(super) fn device_gone(&mut self, to: &mut impl Sink, name: &str) {
        let (topics, mut ended) = (&mut self.topics, Vec::new());
        self.devices.retain(|_, device| {
            let stays = device.name != name;
            if !stays {
                ended.extend(device.channels());
            }
            stays
        });
        // Names that differ only in what identifiers lack share topics.
        let in_use = |channel: &u16| {
            self.devices
                .values()
                .any(|it| it.channels().any(|it| it == *channel))
        };
        ended.retain(|channel| !in_use(channel));
        topics.close(to, &ended);
    }

    /// A net was loaded.
    pub(super) fn net(
        &mut self,
        to: &mut impl Sink,
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
        let text = schemas::of_values(&fields(directory));
        let channel = to.channel(&format!("/takt/nets/{name}"), &schema, &text)?;
        let directory = Arc::clone(directory);
        self.nets.insert(id, {
            NetTopic {
                channel,
                directory,
                part: Vec::new(),
            }
        });
        Ok(())
    }

    /// A net runs already.
    pub(super) fn net_runs(&mut self, id: u32) {
        self.running.insert(id);
    }

    /// The cycle before the next one that is shown: number and begin.
    pub(super) fn goes_on_after(&mut self, cycle: u64, begin: Nanos) {
        self.before = Some((cycle, begin));
    }

    /// A net was unloaded.
    pub(super) fn net_gone(&mut self, to: &mut impl Sink, id: u32) {
        self.running.remove(&id);
        if let Some(net) = self.nets.remove(&id) {
            to.close(net.channel);
            self.is_full = false;
        }
    }

    /// A line was logged.
    pub(super) fn log(
        &mut self,
        to: &mut impl Sink,
        (level, name, text): (u8, &str, &str),
        at: Stamp,
    ) -> Result<(), Error> {
        let channel = self.topics.channel(to, "/rosout", &schemas::LOG)?;
        if !to.wants(channel) {
            return Ok(());
        }
        let cdr = at.write(self.topics.cdr.begin()).u8(level);
        cdr.text(name).text(text).text("").text("").u32(0);
        to.message(channel, self.topics.cdr.bytes(), at)
    }

    /// Frames of the cell that do not move.
    pub(super) fn frames(
        &mut self,
        to: &mut impl Sink,
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
        let channel = self
            .topics
            .channel(to, "/tf_static", &schemas::TRANSFORMS)?;
        self.topics.cdr.begin().count(all.len());
        for (parent, child, frame) in &all {
            transform(&mut self.topics.cdr, at, (parent, child), frame);
        }
        to.message(channel, self.topics.cdr.bytes(), at)
    }

    /// The messages of a cycle with these words.
    pub(super) fn cycle(
        &mut self,
        to: &mut impl Sink,
        words: &[u64],
        at: Stamp,
    ) -> Result<(), Error> {
        let mut reader = Reader(words);
        let next = self.before.map_or(0, |(cycle, _)| cycle + 1);
        let cycle = start(words).map_or(next, |moment| moment.cycle);
        // Words of the thread are whole; what follows a damaged entry would be guessed.
        while let Ok(Some(entry)) = reader.next() {
            self.entry(to, (cycle, entry), at)?;
        }
        Ok(())
    }

    /// An entry of that cycle.
    pub(super) fn entry(
        &mut self,
        to: &mut impl Sink,
        (cycle, entry): (u64, Entry<'_>),
        at: Stamp,
    ) -> Result<(), Error> {
        let (net, event, cause) = match entry {
            Entry::Inputs(inputs) => return self.inputs(to, &inputs, at),
            Entry::Outputs(joints) => return self.set_points(to, joints, at),
            Entry::Outbox(net, words) => return self.values(to, net, words, at),
            Entry::Stepped(machine, states) => {
                return self.stepped(to, (cycle, machine), states, at);
            }
            Entry::Changed(machine, number, word) => {
                return self.changed(to, (cycle, machine), (number, word), at);
            }
            Entry::MachineAdded(machine) => {
                return self.machine_event(to, (cycle, machine), "added", at);
            }
            Entry::MachineRemoved(machine) => {
                return self.machine_event(to, (cycle, machine), "removed", at);
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
            | Entry::SeatFailed(..)
            | Entry::MachineInput(..)
            | Entry::Inbox(..) => return Ok(()),
        };
        self.net_event(to, (cycle, net), (event, &cause), at)
    }

    /// Something happened to a net.
    fn net_event(
        &mut self,
        to: &mut impl Sink,
        (cycle, net): (u64, u32),
        (event, cause): (&str, &str),
        at: Stamp,
    ) -> Result<(), Error> {
        match event {
            "started" => self.running.insert(net),
            "ended" => self.running.remove(&net),
            _ => false,
        };
        let channel = self
            .topics
            .channel(to, "/takt/net_events", &schemas::NET_EVENT)?;
        if !to.wants(channel) {
            return Ok(());
        }
        let cdr = at.write(self.topics.cdr.begin()).u64(cycle);
        cdr.text(&NetId(net).to_string()).text(event).text(cause);
        to.message(channel, self.topics.cdr.bytes(), at)
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

    fn inputs(&mut self, to: &mut impl Sink, inputs: &Inputs<'_>, at: Stamp) -> Result<(), Error> {
        let Moment { cycle, wall, .. } = inputs.moment;
        self.thread(to, (cycle, wall), at)?;
        let Self {
            topics, devices, ..
        } = self;
        for device in devices.values_mut() {
            let Some((status, faults)) = inputs.device(device.number) else {
                continue;
            };
            self.joints.clear();
            self.joints.extend(inputs.joints(device.joints.clone()));
            let reported = Reported {
                joints: &self.joints,
                signals: inputs.signals(&device.signals),
                status,
                faults,
                wall: wall.0,
            };
            device.reported(topics, to, reported, at)?;
        }
        Ok(())
    }

    /// A cycle of a net thread of that topic, after the one `before`: number and begin, ns.
    #[expect(clippy::cast_precision_loss, reason = "less than a day")]
    pub(super) fn thread_cycle(
        &mut self,
        to: &mut impl Sink,
        (topic, before): (&str, Option<(u64, i64)>),
        (cycle, begin): (u64, i64),
        at: Stamp,
    ) -> Result<(), Error> {
        let (interval, missed) = before.map_or((f64::NAN, 0), |(last, before)| {
            let interval = begin.saturating_sub(before);
            (interval as f64 * 1e-3, cycle.saturating_sub(last + 1))
        });
        let channel = self.topics.channel(to, topic, &schemas::THREAD_CYCLE)?;
        let cdr = at.write(self.topics.cdr.begin()).u64(cycle);
        cdr.f64(interval).u64(missed);
        to.message(channel, self.topics.cdr.bytes(), at)
    }

    /// A row of the flight recorder: what a device reported in a cycle, and what nets commanded to it.
    pub(super) fn row(
        &mut self,
        to: &mut impl Sink,
        number: usize,
        row: &FlightRow<'_>,
        at: Stamp,
    ) -> Result<(), Error> {
        let Some(device) = self.devices.get_mut(&number) else {
            return Ok(());
        };
        self.joints.clear();
        self.joints.extend(row.joints().map(|joint| joint.state));
        let reported = Reported {
            joints: &self.joints,
            signals: row.signals,
            status: row.status,
            faults: row.faults,
            wall: row.woken.0,
        };
        device.reported(&mut self.topics, to, reported, at)?;
        let set_points = row.joints().map(|joint| joint.set_point);
        device.commanded(&mut self.topics, to, set_points, at)
    }

    /// A cycle of the net thread that began then.
    #[expect(clippy::cast_precision_loss, reason = "less than a day")]
    pub(super) fn thread(
        &mut self,
        to: &mut impl Sink,
        (cycle, wall): (u64, Nanos),
        at: Stamp,
    ) -> Result<(), Error> {
        let before = self.before.replace((cycle, wall));
        let (interval, missed) = before.map_or((f64::NAN, 0), |(last, begin)| {
            let interval = wall.0.saturating_sub(begin.0);
            (interval as f64 * 1e-3, cycle.saturating_sub(last + 1))
        });
        let channel = self.topics.channel(to, "/takt/thread", &schemas::CYCLE)?;
        if !to.wants(channel) {
            return Ok(());
        }
        let cdr = at.write(self.topics.cdr.begin()).u64(cycle);
        cdr.f64(interval).u64(missed).count(self.running.len());
        to.message(channel, self.topics.cdr.bytes(), at)
    }

    /// What nets commanded.
    fn set_points(
        &mut self,
        to: &mut impl Sink,
        commanded: &[u64],
        at: Stamp,
    ) -> Result<(), Error> {
        for device in self.devices.values() {
            // They are in the order of joints.
            let (pairs, _) = commanded.as_chunks::<2>();
            let position = |joint: usize| {
                let found = pairs.binary_search_by_key(&(joint as u64), |[joint, _]| *joint);
                let pair = found.ok().and_then(|at| pairs.get(at));
                pair.map_or(f64::NAN, |[_, bits]| f64::from_bits(*bits))
            };
            let positions = device.joints.clone().map(position);
            device.commanded(&mut self.topics, to, positions, at)?;
        }
        Ok(())
    }

    /// A row of the flight recorder with out values of a net: its head and words.
    pub(super) fn values_row(
        &mut self,
        to: &mut impl Sink,
        net: u32,
        row: &[u64],
        at: Stamp,
    ) -> Result<(), Error> {
        let ([_, source, _, words @ ..], Some(topic)) = (row, self.nets.get_mut(&net)) else {
            return Ok(());
        };
        let (part, wanted) = (source & u64::from(u32::MAX), topic.directory.words());
        let words = words.get(..NET_WORDS).unwrap_or(words);
        if part == 0 {
            topic.part.clear();
        }
        // The first rows of these values are lost.
        if topic.part.len() as u64 != part * NET_WORDS as u64 {
            return Ok(());
        }
        let left = wanted.saturating_sub(topic.part.len());
        topic.part.extend(words.iter().take(left));
        if topic.part.len() < wanted {
            return Ok(());
        }
        let words = std::mem::take(&mut topic.part);
        let result = self.values(to, net, &words, at);
        if let Some(topic) = self.nets.get_mut(&net) {
            topic.part = words;
        }
        result
    }

    /// Values of a net that changed.
    fn values(
        &mut self,
        to: &mut impl Sink,
        net: u32,
        words: &[u64],
        at: Stamp,
    ) -> Result<(), Error> {
        let Some(NetTopic {
            channel, directory, ..
        }) = self.nets.get(&net)
        else {
            return Ok(());
        };
        if !to.wants(*channel) {
            return Ok(());
        }
        let cdr = at.write(self.topics.cdr.begin());
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
        to.message(*channel, self.topics.cdr.bytes(), at)
    }
}

fn or_nan(value: Option<f64>) -> f64 {
    value.unwrap_or(f64::NAN)
}
