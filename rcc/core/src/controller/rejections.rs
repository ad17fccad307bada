//! Set-points that devices or primitives reject: one line per onset with net, part, reason and figures, counters, and the end of a net
//! that is rejected continuously. The set-points are rejected in drivers and primitives, cycle by cycle.
//!
//! A primitive withdraws its command when the driver rejects it, and gives it again in the next evaluation. A rejection
//! therefore lasts until none was counted for [`QUIET`], or four periods of its net.

use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use takt_net::set_points::{SetPoints, Withheld};
use takt_rt::Nanos;

use crate::controller::device_set::DeviceSet;
use crate::controller::nets::Nets;
use crate::device::Device;
use crate::device::driver::DriverEvent;
use crate::device::rejected::{Cause, Rejection};
use crate::ids::NetId;

/// A rejection is over when none was counted for this time.
const QUIET: Nanos = Nanos::from_millis(500);
/// A set-point that was null in all evaluations for this time is reported.
const NULL_AFTER: Nanos = Nanos::from_millis(1000);
/// Maximum number of rejections kept; the oldest are dropped first.
const KEPT: usize = 256;

/// Why set-points are rejected, for counters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum RejectReason {
    /// The first one is too far from the device.
    Start,
    /// They got too far ahead of the device.
    Lost,
    /// They are not finite.
    NoNumber,
    /// They began before the device followed commands.
    Resumed,
    /// Limits of the robot itself.
    Guard,
    /// They are out of range.
    Range,
    /// Another primitive of the net commands the same.
    Concurrent,
    /// They were null since the net started.
    Null,
}

impl RejectReason {
    /// Its name in metrics and resources.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Start => "start",
            Self::Lost => "lost",
            Self::NoNumber => "no_number",
            Self::Resumed => "resumed",
            Self::Guard => "guard",
            Self::Range => "range",
            Self::Concurrent => "concurrent",
            Self::Null => "null",
        }
    }

    /// Whether it ends its net if it lasts.
    const fn ends_net(self) -> bool {
        match self {
            Self::Start
            | Self::Lost
            | Self::NoNumber
            | Self::Resumed
            | Self::Guard
            | Self::Range => true,
            // The other primitive commands; and a net may wait for its first value.
            Self::Concurrent | Self::Null => false,
        }
    }

    const fn of_driver(cause: Cause) -> Self {
        match cause {
            Cause::Start => Self::Start,
            Cause::Lost => Self::Lost,
            Cause::Finite => Self::NoNumber,
            Cause::Resumed => Self::Resumed,
            Cause::Guard => Self::Guard,
        }
    }

    const fn of_primitive(why: Withheld) -> Self {
        match why {
            Withheld::Range => Self::Range,
            Withheld::NoNumber => Self::NoNumber,
            Withheld::Concurrent => Self::Concurrent,
            Withheld::Null => Self::Null,
        }
    }
}

/// Set-points of a net that are or were rejected.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RejectedInfo {
    /// Number of the rejection, from 1.
    pub number: u64,
    /// The net; `None` if it is not known.
    pub net: Option<NetId>,
    /// The device.
    pub device: String,
    /// `joint 3`, `floor` of a base, `base`, or `pose`.
    pub part: String,
    /// Why.
    pub reason: RejectReason,
    /// The log line, with figures.
    pub text: String,
    /// When it began, on `CLOCK_MONOTONIC`.
    pub since: Nanos,
    /// How long it lasted; `None` while it lasts.
    pub lasted: Option<Duration>,
}

/// How often set-points for a part of a device began to be rejected, by device, part and reason.
pub type RejectedCounts = BTreeMap<(String, String, RejectReason), u64>;

/// Where rejections are counted.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Source {
    /// In the driver of a device, by part.
    Driver(String, usize),
    /// In a primitive of a net, by its position among those that command, and reason.
    Primitive(NetId, usize, usize),
}

/// A counter as last seen, and the rejection that lasts.
#[derive(Debug, Default)]
struct Seen {
    count: u64,
    present: Option<Present>,
}

#[derive(Debug)]
struct Present {
    number: u64,
    since: Nanos,
    last: Nanos,
    /// Time without a count after which it is over.
    quiet: Nanos,
}

/// The onset of a rejection, before it has a number.
struct Onset {
    net: Option<NetId>,
    device: String,
    part: String,
    reason: RejectReason,
    text: String,
    /// Period of the net.
    period: Nanos,
}

/// Rejections, and what was reported of them.
#[derive(Debug, Default)]
pub(super) struct Rejections {
    /// How long the set-points of a net may be rejected before it is ended; zero for ever.
    ends_after: Duration,
    seen: BTreeMap<Source, Seen>,
    recent: VecDeque<RejectedInfo>,
    counts: RejectedCounts,
    total: u64,
    /// New onsets that were not logged yet.
    lines: Vec<(String, DriverEvent)>,
}

impl Rejections {
    /// None yet; nets are ended after so long, or never if it is zero.
    pub(super) fn ending_after(ends_after: Duration) -> Self {
        Self {
            ends_after,
            ..Self::default()
        }
    }

    /// Reads all counters; returns whether a rejection began or ended.
    pub(super) fn poll(&mut self, devices: &DeviceSet, nets: &Nets, now: Nanos) -> bool {
        let known = self.lines.len();
        self.seen.retain(|source, seen| {
            let is_known = match source {
                Source::Driver(device, _) => devices.table.find(device).is_some(),
                Source::Primitive(net, ..) => nets.get(*net).is_some_and(|net| net.runs()),
            };
            if let (false, Some(present)) = (is_known, &seen.present) {
                close(&mut self.recent, present, now);
            }
            is_known
        });
        for (_, device) in devices.table.all() {
            self.poll_driver(device, nets, now);
        }
        for (id, net) in nets.iter().filter(|(_, net)| net.runs()) {
            let Some(counted) = net.counted() else {
                continue;
            };
            let period = counted.period.into();
            for (index, set_points) in counted.set_points.iter().enumerate() {
                self.poll_primitive((id, index), set_points, period, now);
            }
        }
        let before = self.recent.iter().filter(|it| it.lasted.is_none()).count();
        for seen in self.seen.values_mut() {
            let over = seen.present.take_if(|it| now - it.last > it.quiet);
            if let Some(present) = over {
                close(&mut self.recent, &present, present.last);
            }
        }
        let after = self.recent.iter().filter(|it| it.lasted.is_none()).count();
        self.lines.len() > known || before != after
    }

    fn poll_driver(&mut self, device: &Device, nets: &Nets, now: Nanos) {
        for (part, rejected) in device.rejected().iter().enumerate() {
            if rejected.cycles == 0 {
                continue;
            }
            let source = Source::Driver(device.name.clone(), part);
            self.note(source, rejected.cycles, now, || {
                let rejection = rejected.last?;
                Some(onset_of(device, part, &rejection, nets))
            });
        }
    }

    fn poll_primitive(
        &mut self,
        (net, index): (NetId, usize),
        set_points: &SetPoints,
        period: Nanos,
        now: Nanos,
    ) {
        let counts = set_points.counters.read();
        for (why, count) in Withheld::ALL.into_iter().zip(counts.withheld) {
            let null = why == Withheld::Null;
            let enough = NULL_AFTER.0 / period.0.max(1);
            let waits = null && (counts.given > 0 || count.cast_signed() < enough);
            if count == 0 || waits {
                continue;
            }
            let source = Source::Primitive(net, index, why as usize);
            self.note(source, count, now, || {
                Some(Onset {
                    net: Some(net),
                    device: set_points.device.clone(),
                    part: set_points.part.clone(),
                    reason: RejectReason::of_primitive(why),
                    text: text_of(net, set_points, why, counts.value),
                    period,
                })
            });
        }
    }

    /// Compares a counter with what was seen of it.
    fn note(
        &mut self,
        source: Source,
        count: u64,
        now: Nanos,
        onset: impl FnOnce() -> Option<Onset>,
    ) {
        let seen = self.seen.entry(source).or_default();
        if count == seen.count {
            return;
        }
        // A smaller one is that of another device under that name.
        seen.count = count;
        if let Some(present) = &mut seen.present {
            present.last = now;
            return;
        }
        let Some(onset) = onset() else { return };
        self.total += 1;
        seen.present = Some(Present {
            number: self.total,
            since: now,
            last: now,
            quiet: QUIET.max(Nanos(onset.period.0.saturating_mul(4))),
        });
        let key = (onset.device.clone(), onset.part.clone(), onset.reason);
        *self.counts.entry(key).or_default() += 1;
        let event = DriverEvent::warning(onset.text.clone());
        self.lines.push((onset.device.clone(), event));
        self.recent.push_back(RejectedInfo {
            number: self.total,
            net: onset.net,
            device: onset.device,
            part: onset.part,
            reason: onset.reason,
            text: onset.text,
            since: now,
            lasted: None,
        });
        if self.recent.len() > KEPT {
            self.recent.pop_front();
        }
    }

    /// New onsets as log lines, with the names of devices.
    pub(super) fn take_lines(&mut self) -> Vec<(String, DriverEvent)> {
        std::mem::take(&mut self.lines)
    }

    /// The nets whose set-points were rejected for too long without a pause, each with the reason of its end.
    pub(super) fn overdue(&self) -> Vec<(NetId, String)> {
        let after = self.ends_after;
        if after.is_zero() {
            return Vec::new();
        }
        let lasts = self.seen.values().filter_map(|seen| seen.present.as_ref());
        let long = lasts.filter(|it| it.last - it.since >= Nanos::from(after));
        let infos = long.filter_map(|it| self.recent.iter().find(|info| info.number == it.number));
        let ending = infos.filter(|info| info.reason.ends_net());
        ending
            .filter_map(|info| {
                let cause = info.text.split('\n').next().unwrap_or_default();
                Some((info.net?, format!("rejected for {after:?}: {cause}")))
            })
            .collect()
    }

    /// The last rejections, oldest first.
    pub(super) fn recent(&self) -> impl Iterator<Item = &RejectedInfo> {
        self.recent.iter()
    }

    /// Onsets by device, part and reason.
    pub(super) const fn counts(&self) -> &RejectedCounts {
        &self.counts
    }
}

fn close(recent: &mut VecDeque<RejectedInfo>, present: &Present, at: Nanos) {
    if let Some(info) = recent.iter_mut().find(|it| it.number == present.number) {
        info.lasted = Duration::try_from(at - present.since).ok();
    }
}

/// The rejection of a driver, with the net that holds that part of the device.
fn onset_of(device: &Device, part: usize, rejection: &Rejection, nets: &Nets) -> Onset {
    let name = &device.name;
    let (net, shown, unit) = if device.limits.is_empty() {
        let base = nets.holder(&format!("{name}_Base"));
        let net = base.or_else(|| nets.holder(&format!("{name}_CartesianPosition")));
        (net, "pose".to_owned(), "m or rad")
    } else {
        let net = nets.holder(&format!("{name}_Joint_{part}"));
        (net, format!("joint {part}"), "rad")
    };
    let period = net.and_then(|net| Some(nets.get(net)?.counted()?.period));
    Onset {
        net,
        text: text_of_driver(name, &shown, unit, net, rejection),
        device: name.clone(),
        part: shown,
        reason: RejectReason::of_driver(rejection.cause),
        period: period.unwrap_or_default().into(),
    }
}

fn of_net(net: Option<NetId>) -> String {
    net.map_or_else(String::new, |net| format!(" of {net}"))
}

fn text_of_driver(
    device: &str,
    part: &str,
    unit: &str,
    net: Option<NetId>,
    rejection: &Rejection,
) -> String {
    let Rejection {
        cause,
        wanted,
        actual,
        allowed,
    } = *rejection;
    let (off, net) = ((wanted - actual).abs(), of_net(net));
    let of_joint = if part == "pose" {
        "where the base is".to_owned()
    } else {
        format!("the measured {actual:.4}")
    };
    let (why, hint) = match cause {
        Cause::Start => (
            format!("the first is {off:.4} {unit} from {of_joint}, {allowed:.4} allowed"),
            "begin the motion where the device is, as its monitor primitive reports it",
        ),
        Cause::Lost => (
            format!("they are {off:.4} {unit} ahead of {of_joint}, {allowed:.4} allowed"),
            "slow the motion, or limit what the net integrates while the device is held",
        ),
        Cause::Finite => (
            "they are no finite numbers, or not in the plane".to_owned(),
            "look for a division by zero in the net",
        ),
        Cause::Resumed => (
            "they began before the device followed commands".to_owned(),
            "end the motion and start it again, so that nothing moves by itself",
        ),
        Cause::Guard => (
            "they exceed the limits of the robot's controller".to_owned(),
            "slow the motion; the driver reported the limit",
        ),
    };
    format!("{device} {part} rejects set-points{net}: {why}\nhint: {hint}")
}

fn text_of(net: NetId, set_points: &SetPoints, why: Withheld, value: f64) -> String {
    let SetPoints {
        primitive,
        device,
        part,
        unit,
        range: [low, high],
        ..
    } = set_points;
    let rejects = format!("{device} {part} rejects set-points of {net}");
    match why {
        Withheld::Range => {
            let radians = value.to_radians();
            let hint = if *unit == "rad" && (*low..=*high).contains(&radians) {
                format!("positions are in rad: {value:.2} degrees are {radians:.4} rad")
            } else {
                format!("limit what `{primitive}` is given")
            };
            format!(
                "{rejects}: `{primitive}` is given {value:.4} {unit}, outside of {low:.4} to {high:.4}\nhint: {hint}"
            )
        }
        Withheld::NoNumber => format!(
            "{rejects}: `{primitive}` is given no finite number\nhint: look for a division by zero in the net"
        ),
        Withheld::Concurrent => format!(
            "{rejects}: another primitive commands it in the same cycle, before `{primitive}`\nhint: command each \
             joint by one primitive"
        ),
        Withheld::Null => format!(
            "{device} {part} gets no set-points of {net}: what `{primitive}` is given was null since the net started\n\
             hint: a loop over `Pre` needs a first value; `takt net check` names inputs that are always null"
        ),
    }
}
