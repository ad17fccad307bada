//! The messages about one device: joints, set-points, force, signals, frames, state. Where its values come from is not known here.

use std::ops::Range;
use std::sync::Arc;

use takt_net::device::{Figure, Interfaces, Io, Kinematics, Layout};
use takt_net::{Frame, JointState};

use crate::device::{ARM_JOINTS_MAX, DeviceDescription, DeviceStatus, Place, parts};
use crate::error::Error;
use crate::record::ros2::cdr::Cdr;
use crate::record::ros2::values::{UniqueNames, identifier};
use crate::record::ros2::{Sink, Stamp, Topics, or_nan, schemas};

/// Time between two messages about a device whose state stays the same, ns.
const DIAGNOSIS_NS: i64 = 1_000_000_000;
/// Time between two messages about where a device is, ns: viewers draw no more pictures.
const TRANSFORM_NS: i64 = 10_000_000;

/// What a device reported in a cycle.
#[derive(Clone, Copy, Debug)]
pub(in crate::record) struct Reported<'a> {
    /// By joint.
    pub(in crate::record) joints: &'a [JointState],
    /// Words of its interfaces.
    pub(in crate::record) signals: &'a [u64],
    pub(in crate::record) status: DeviceStatus,
    /// Number of times that it stopped following commands.
    pub(in crate::record) faults: u64,
    /// When the cycle began, ns.
    pub(in crate::record) wall: i64,
}

/// What is known of a device when its topics are added.
#[derive(Debug)]
pub(in crate::record) struct ShownDevice<'a> {
    pub(in crate::record) name: &'a str,
    pub(in crate::record) place: &'a Place,
    /// Its interfaces in its own words.
    pub(in crate::record) own: Interfaces,
    pub(in crate::record) kinematics: Option<Arc<dyn Kinematics>>,
}

impl<'a> ShownDevice<'a> {
    /// A device of a recording.
    pub(in crate::record) fn of(place: &'a Place, description: &'a DeviceDescription) -> Self {
        Self {
            name: &description.name,
            place,
            own: parts::lay(&description.parts, place.joints, &mut Layout::default()),
            kinematics: description.model.limited(&description.limits),
        }
    }
}

/// A device as viewers see it.
#[derive(Debug)]
pub(super) struct DeviceTopics {
    pub(super) name: String,
    pub(super) number: usize,
    pub(super) joints: Range<usize>,
    joint_names: Vec<String>,
    pub(super) signals: Range<usize>,
    own: Interfaces,
    kinematics: Option<Arc<dyn Kinematics>>,
    /// Parent and child of its transform.
    frames: Option<(String, String)>,
    flange: String,
    states: Option<u16>,
    set_points: Option<u16>,
    wrench: Option<u16>,
    io: Option<Signals>,
    figures: Option<u16>,
    /// The figures of the cycle before, and the second of the last message about them.
    figured: (Vec<u64>, Option<i64>),
    /// When it was placed last, in [`TRANSFORM_NS`].
    placed: Option<i64>,
    /// Status, faults and time of the last message about it.
    shown: Option<(DeviceStatus, u64, i64)>,
}

impl DeviceTopics {
    /// Adds the topics of a device.
    pub(super) fn new(
        topics: &mut Topics,
        to: &mut impl Sink,
        number: usize,
        device: ShownDevice<'_>,
    ) -> Result<Self, Error> {
        let ShownDevice {
            name,
            place,
            own,
            kinematics,
        } = device;
        let topic = |what: &str| format!("/{}/{what}", identifier(name));
        let joints = place.first_joint..place.first_joint + place.joints;
        let frames = match (&kinematics, &own.base) {
            (Some(_), _) => Some((format!("{name}.base"), format!("{name}.flange"))),
            (None, Some(_)) => Some((format!("{name}.odometry"), name.to_owned())),
            (None, None) => None,
        };
        let has_joints = !joints.is_empty();
        let figures = Self::figures_topic(topics, to, (number, name), &own.figures)?;
        let mut of = |wanted: bool, what: &str, schema| {
            wanted
                .then(|| topics.channel(to, &topic(what), schema))
                .transpose()
        };
        Ok(Self {
            joint_names: (1..=joints.len())
                .map(|n| format!("{name}.joint_{n}"))
                .collect(),
            name: name.to_owned(),
            number,
            joints,
            signals: place.signals.clone(),
            kinematics,
            frames,
            flange: format!("{name}.flange"),
            states: of(has_joints, "joint_states", &schemas::JOINT_STATE)?,
            set_points: of(has_joints, "set_points", &schemas::JOINT_STATE)?,
            wrench: of(own.wrench.is_some(), "wrench", &schemas::WRENCH_STAMPED)?,
            io: of(own.io.is_some(), "signals", &schemas::SIGNALS)?.map(Signals::new),
            figures,
            figured: (vec![0; own.figures.len()], None),
            placed: None,
            own,
            shown: None,
        })
    }

    /// The topic of its figures, a field for each. A device whose name gives the same topic as that of another has none.
    fn figures_topic(
        topics: &mut Topics,
        to: &mut impl Sink,
        (number, name): (usize, &str),
        figures: &[Figure],
    ) -> Result<Option<u16>, Error> {
        let topic = format!("/{}/figures", identifier(name));
        if figures.is_empty() || topics.channels.contains_key(&topic) {
            return Ok(None);
        }
        let mut names = UniqueNames::default();
        let field = |figure: &Figure| {
            let field = names.next(&figure.name);
            format!("float64 {field} # {}\n", about(figure))
        };
        let fields: String = figures.iter().map(field).collect();
        let schema = format!("takt_msgs/msg/Figures{number}");
        let channel = to.channel(&topic, &schema, &schemas::of_values(&fields))?;
        topics.channels.insert(topic, channel);
        Ok(Some(channel))
    }

    /// Whether it has a place among the frames.
    pub(super) const fn is_placed(&self) -> bool {
        self.frames.is_some()
    }

    /// Its own topics.
    pub(super) fn channels(&self) -> impl Iterator<Item = u16> {
        let all = [
            self.states,
            self.set_points,
            self.wrench,
            self.io.as_ref().map(|io| io.channel),
            self.figures,
        ];
        all.into_iter().flatten()
    }

    /// What it reported.
    pub(super) fn reported(
        &mut self,
        topics: &mut Topics,
        to: &mut impl Sink,
        reported: Reported<'_>,
        at: Stamp,
    ) -> Result<(), Error> {
        let Reported {
            joints, signals, ..
        } = reported;
        let cdr = &mut topics.cdr;
        if let Some(channel) = self.states.filter(|it| to.wants(*it)) {
            let positions = joints.iter().map(|it| or_nan(it.measured_position));
            let velocities = joints.iter().map(|it| or_nan(it.measured_velocity));
            let torques = self.own.torques.as_deref().unwrap_or_default();
            let efforts = torques.iter().map(|it| or_nan(it.measured.read(signals)));
            at.header(cdr.begin(), "")
                .texts(&self.joint_names)
                .numbers(positions)
                .numbers(velocities)
                .numbers(efforts);
            to.message(channel, cdr.bytes(), at)?;
        }
        if let (Some(channel), Some(wrench)) = (self.wrench, self.own.wrench)
            && to.wants(channel)
            && let Some(wrench) = wrench.read(signals)
        {
            let message = at.header(cdr.begin(), &self.flange);
            for value in wrench.force.iter().chain(wrench.torque.iter()) {
                message.f64(*value);
            }
            to.message(channel, cdr.bytes(), at)?;
        }
        if let (Some(topic), Some(io)) = (&mut self.io, &self.own.io) {
            topic.reported(io, reported, (cdr, to), at)?;
        }
        self.figures(topics, to, reported, at)?;
        self.transforms(topics, to, reported, at)?;
        self.diagnosis(topics, to, reported, at)
    }

    /// Its figures: when one that is no time changes, and in the first cycle of each second of the host's clock. Times change in
    /// each cycle, and a message in each would be a tenth of a recording.
    fn figures(
        &mut self,
        topics: &mut Topics,
        to: &mut impl Sink,
        reported: Reported<'_>,
        at: Stamp,
    ) -> Result<(), Error> {
        let Some(channel) = self.figures else {
            return Ok(());
        };
        let now = Some(reported.wall.div_euclid(DIAGNOSIS_NS));
        let (before, second) = &mut self.figured;
        let mut is_due = std::mem::replace(second, now) != now;
        for (figure, before) in self.own.figures.iter().zip(before.iter_mut()) {
            let value = or_nan(figure.place.read(reported.signals)).to_bits();
            is_due |= std::mem::replace(before, value) != value && &*figure.unit != "s";
        }
        if !is_due || !to.wants(channel) {
            return Ok(());
        }
        let message = at.write(topics.cdr.begin());
        for value in before.iter() {
            message.f64(f64::from_bits(*value));
        }
        to.message(channel, topics.cdr.bytes(), at)
    }

    /// What nets commanded, by joint; not a number where they commanded nothing.
    pub(super) fn commanded(
        &self,
        topics: &mut Topics,
        to: &mut impl Sink,
        positions: impl ExactSizeIterator<Item = f64> + Clone,
        at: Stamp,
    ) -> Result<(), Error> {
        let Some(channel) = self.set_points.filter(|it| to.wants(*it)) else {
            return Ok(());
        };
        if positions.clone().all(f64::is_nan) {
            return Ok(());
        }
        let none = || std::iter::empty::<f64>();
        at.header(topics.cdr.begin(), "")
            .texts(&self.joint_names)
            .numbers(positions)
            .numbers(none())
            .numbers(none());
        to.message(channel, topics.cdr.bytes(), at)
    }

    /// Where its flange is, or where it is itself, in the first cycle of each hundredth of a second of the host's clock.
    fn transforms(
        &mut self,
        topics: &mut Topics,
        to: &mut impl Sink,
        reported: Reported<'_>,
        at: Stamp,
    ) -> Result<(), Error> {
        let Some((parent, child)) = &self.frames else {
            return Ok(());
        };
        let now = Some(reported.wall.div_euclid(TRANSFORM_NS));
        if std::mem::replace(&mut self.placed, now) == now {
            return Ok(());
        }
        let Reported {
            joints, signals, ..
        } = reported;
        let channel = topics.channel(to, "/tf", &schemas::TRANSFORMS)?;
        if !to.wants(channel) {
            return Ok(());
        }
        let placed = if let Some(arm) = &self.kinematics {
            let mut positions = [0.0; ARM_JOINTS_MAX];
            let mut known = joints.iter().zip(&mut positions);
            let is_known = known.all(|(state, position)| {
                *position = or_nan(state.measured_position);
                !position.is_nan()
            });
            let positions = positions.get(..joints.len()).filter(|_| is_known);
            positions.map(|joints| arm.forward(joints))
        } else {
            let base = self.own.base.as_ref();
            base.and_then(|base| base.pose.read(signals))
        };
        let Some(frame) = placed else {
            return Ok(());
        };
        topics.cdr.begin().count(1);
        transform(&mut topics.cdr, at, (parent, child), &frame);
        to.message(channel, topics.cdr.bytes(), at)
    }

    /// Its state, when it changes and in the first cycle of each second of the host's clock, so that a recording and live data
    /// have the same messages, whenever they began.
    fn diagnosis(
        &mut self,
        topics: &mut Topics,
        to: &mut impl Sink,
        reported: Reported<'_>,
        at: Stamp,
    ) -> Result<(), Error> {
        let (status, faults) = (reported.status, reported.faults);
        let now = reported.wall.div_euclid(DIAGNOSIS_NS);
        let is_due = self.shown.is_none_or(|(shown, counted, since)| {
            (shown, counted) != (status, faults) || now != since
        });
        if !is_due {
            return Ok(());
        }
        let channel = topics.channel(to, "/diagnostics", &schemas::DIAGNOSTICS)?;
        self.shown = Some((status, faults, now));
        if !to.wants(channel) {
            return Ok(());
        }
        let (level, text) = match status {
            DeviceStatus::Operational => (0, "operational"),
            DeviceStatus::SafeOperational => (1, "safe-operational: it follows no commands"),
            DeviceStatus::Offline => (2, "offline: no contact"),
        };
        at.header(topics.cdr.begin(), "")
            .count(1)
            .u8(level)
            .text(&self.name)
            .text(text)
            .text(&self.name)
            .count(1)
            .text("faults")
            .text(&faults.to_string());
        to.message(channel, topics.cdr.bytes(), at)
    }
}

/// Name, unit and states of a figure, in one line.
fn about(figure: &Figure) -> String {
    let mut text = figure.name.to_string();
    if !figure.unit.is_empty() {
        text.push_str(&format!(", {}", figure.unit));
    }
    for (number, state) in figure.states.iter().enumerate() {
        text.push_str(&format!(", {number} {state}"));
    }
    text.chars().filter(|c| !c.is_control()).collect()
}

/// The topic of the inputs and outputs of a device.
#[derive(Debug)]
struct Signals {
    channel: u16,
    /// Values of this cycle and of the one before.
    values: Vec<f64>,
    before: Vec<f64>,
    /// The cycle before, if it has no message.
    skipped: Option<Stamp>,
    /// The second of the last message.
    second: Option<i64>,
}

impl Signals {
    const fn new(channel: u16) -> Self {
        Self {
            channel,
            values: Vec::new(),
            before: Vec::new(),
            skipped: None,
            second: None,
        }
    }

    /// A message when one of them changes, after one with the values of the cycle before, so that a line through them is a step; and in
    /// the first cycle of each second of the host's clock.
    fn reported(
        &mut self,
        io: &Io,
        Reported { signals, wall, .. }: Reported<'_>,
        (cdr, to): (&mut Cdr, &mut impl Sink),
        at: Stamp,
    ) -> Result<(), Error> {
        std::mem::swap(&mut self.values, &mut self.before);
        let bit = |value: Option<bool>| or_nan(value.map(|on| f64::from(u8::from(on))));
        let bool_in = io.bool_in.iter().map(|it| bit(it.read(signals)));
        let bool_out = io.bool_out.iter().map(|it| bit(it.state.read(signals)));
        let real_in = io.real_in.iter().map(|it| or_nan(it.read(signals)));
        let real_out = io.real_out.iter().map(|it| or_nan(it.state.read(signals)));
        self.values.clear();
        self.values
            .extend(bool_in.chain(bool_out).chain(real_in).chain(real_out));
        let bits = |value: &f64| value.to_bits();
        let before = self.before.iter().map(bits);
        let has_changed = !self.values.iter().map(bits).eq(before);
        let second = Some(wall.div_euclid(DIAGNOSIS_NS));
        let is_due = std::mem::replace(&mut self.second, second) != second || has_changed;
        let skipped = std::mem::replace(&mut self.skipped, (!is_due).then_some(at));
        if !is_due || !to.wants(self.channel) {
            return Ok(());
        }
        if let Some(skipped) = skipped.filter(|_| has_changed) {
            Self::write(cdr, io, &self.before, skipped);
            to.message(self.channel, cdr.bytes(), skipped)?;
        }
        Self::write(cdr, io, &self.values, at);
        to.message(self.channel, cdr.bytes(), at)
    }

    fn write(cdr: &mut Cdr, io: &Io, mut values: &[f64], at: Stamp) {
        at.write(cdr.begin());
        let counts = [
            io.bool_in.len(),
            io.bool_out.len(),
            io.real_in.len(),
            io.real_out.len(),
        ];
        for count in counts {
            let (group, rest) = values.split_at(count.min(values.len()));
            cdr.numbers(group.iter().copied());
            values = rest;
        }
    }
}

pub(super) fn transform(cdr: &mut Cdr, at: Stamp, (parent, child): (&str, &str), frame: &Frame) {
    let cdr = at.header(cdr, parent).text(child);
    for value in frame.translation.vector.iter() {
        cdr.f64(*value);
    }
    let turn = &frame.rotation;
    cdr.f64(turn.i).f64(turn.j).f64(turn.k).f64(turn.w);
}
