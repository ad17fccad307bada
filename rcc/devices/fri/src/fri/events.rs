//! Events and diagnostics of the FRI driver: late sides, rejected datagrams and commands. The real-time thread sends
//! values; the reader formats them.

use std::net::SocketAddr;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use takt_fri::diagnosis::{Measurement, Observer, Verdict};
use takt_fri::error::DecodeError;
use takt_fri::guard::{Breach, Violation};
use takt_rt::Nanos;
use takt_rt::latest::{LatestReader, LatestWriter, latest};
use takt_rt::ring::{Consumer, Producer, ring};

use super::RefusedOutput;
use takt_core::device::driver::Severity;

/// Measurements after which the older of two observers is restarted: verdicts cover one to two windows.
const WINDOW: u32 = 100;
/// Capacity of the event queue; more events are dropped.
const WAITING: usize = 64;
/// Shortest time between two events of one kind.
const PAUSE: Duration = Duration::from_secs(1);
/// A rejected datagram, or another controller, that was absent for this long is a new onset.
const ONSET: Duration = Duration::from_secs(10);
/// Number of event kinds.
const KINDS: usize = 7;

/// An event on the connection.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Event {
    /// The controller rates the connection worse than before; `why` is the verdict on the last measurements.
    Quality { from: i32, to: i32, why: Verdict },
    /// A malformed datagram.
    Refused(DecodeError),
    /// A command that a guard withheld.
    Withheld(Violation),
    /// Measurements of a second controller.
    Foreign(SocketAddr),
    /// The controller was lost.
    Lost,
    /// An output that cannot be written as nets command it.
    Output(RefusedOutput),
}

impl Event {
    const fn kind(&self) -> usize {
        match self {
            Self::Quality { .. } => 0,
            Self::Refused(_) => 1,
            Self::Withheld(violation) => match violation.breach {
                Breach::Torque { .. } | Breach::Wrench { .. } => 5,
                Breach::NotFinite
                | Breach::Position { .. }
                | Breach::Step { .. }
                | Breach::Speed { .. }
                | Breach::Stop { .. } => 2,
            },
            Self::Foreign(_) => 3,
            Self::Lost => 4,
            Self::Output(_) => 6,
        }
    }

    /// Severity.
    pub(super) const fn severity(&self) -> Severity {
        match self {
            Self::Quality { .. } | Self::Refused(_) | Self::Foreign(_) => Severity::Warning,
            Self::Withheld(_) | Self::Lost | Self::Output(_) => Severity::Error,
        }
    }

    /// Text, with the protocol's names of qualities.
    pub(super) fn text(&self, quality: impl Fn(i32) -> String) -> String {
        match self {
            Self::Quality { from, to, why } => {
                let (from, to) = (quality(*from), quality(*to));
                format!("quality fell from {from} to {to}: {}", advice(*why))
            }
            Self::Refused(error) => format!("malformed datagram: {error}"),
            Self::Withheld(violation) => format!(
                "command withheld, {}: {violation}\nhint: check the net and the limits of the cell",
                consequence(violation.breach)
            ),
            Self::Foreign(from) => format!(
                "measurements of a second controller at {from} are ignored\nhint: give each robot its own port"
            ),
            Self::Lost => {
                "the controller stopped sending\nhint: check its program, its cable, and the address that it sends to".to_owned()
            }
            Self::Output(output) => output.to_string(),
        }
    }
}

/// The consequence of a withheld command.
const fn consequence(breach: Breach) -> &'static str {
    match breach {
        Breach::Position { .. }
        | Breach::Step { .. }
        | Breach::Speed { .. }
        | Breach::Stop { .. } => "the robot brakes and is held",
        Breach::Torque { .. } | Breach::Wrench { .. } => "nothing is added",
        Breach::NotFinite => "nothing of it was sent",
    }
}

/// A verdict with its remedy.
pub(super) fn advice(verdict: Verdict) -> String {
    if verdict.is_good() {
        return "no delay observed here".to_owned();
    }
    format!("{verdict}; {}", verdict.remedy())
}

/// Current diagnostics.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Diagnostics {
    /// Verdict on the last measurements.
    pub(super) verdict: Verdict,
    /// Decode error of the last malformed datagram.
    pub(super) decode_error: Option<DecodeError>,
    /// The last command that was withheld.
    pub(super) violation: Option<Violation>,
    /// The last output that could not be written.
    pub(super) refused_output: Option<RefusedOutput>,
    /// Datagrams of peers other than the controller.
    pub(super) foreign: u64,
}

impl Default for Diagnostics {
    fn default() -> Self {
        Self {
            verdict: Verdict::Silent,
            decode_error: None,
            violation: None,
            refused_output: None,
            foreign: 0,
        }
    }
}

/// The endpoint in the real-time thread: counts and sends, but formats no text.
#[derive(Debug)]
pub(super) struct EventSender {
    fresh: Observer,
    older: Observer,
    newer: Observer,
    count: u32,
    quality: i32,
    diagnostics: Diagnostics,
    /// Whether the last command was withheld.
    withholds: bool,
    last_sent: [Option<Duration>; KINDS],
    /// What comes with each datagram of a peer, and when it came last: reported at its onset only.
    recurring: [Option<(Event, Duration)>; KINDS],
    events: Producer<Event>,
    sent: u64,
    out: LatestWriter<Diagnostics>,
}

/// The endpoint of the reader.
#[derive(Debug)]
pub(super) struct EventReceiver {
    events: Mutex<Consumer<Event>>,
    diagnostics: Mutex<LatestReader<Diagnostics>>,
}

/// Both endpoints, for an arm with this observer.
pub(super) fn event_channel(fresh: Observer) -> (EventSender, EventReceiver) {
    let (producer, consumer) = ring(WAITING);
    let (out, diagnostics) = latest(1, Diagnostics::default);
    let event_sender = EventSender {
        older: fresh.clone(),
        newer: fresh.clone(),
        fresh,
        count: 0,
        quality: i32::MIN,
        diagnostics: Diagnostics::default(),
        withholds: false,
        last_sent: [None; KINDS],
        recurring: [None; KINDS],
        events: producer,
        sent: 0,
        out,
    };
    let event_receiver = EventReceiver {
        events: Mutex::new(consumer),
        diagnostics: Mutex::new(diagnostics),
    };
    (event_sender, event_receiver)
}

impl EventReceiver {
    pub(super) fn poll(&self) -> Option<Event> {
        let mut events = self.events.lock().unwrap_or_else(PoisonError::into_inner);
        events.pop()
    }

    pub(super) fn diagnostics(&self) -> Diagnostics {
        let mut diagnostics = self
            .diagnostics
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        diagnostics.read()
    }
}

impl EventSender {
    /// Sends an event, unless one of its kind was sent a moment ago, or the same one recurs; returns whether it was sent.
    pub(super) fn send(&mut self, event: Event, now: Duration) -> bool {
        if self.recurs(&event, now) {
            return false;
        }
        let is_sent = self.push(event, now);
        if is_sent && let Some(recurring) = self.recurring.get_mut(event.kind()) {
            *recurring = Some((event, now));
        }
        is_sent
    }

    /// Whether an event that comes with every datagram of a peer was reported and has not ended since.
    fn recurs(&mut self, event: &Event, now: Duration) -> bool {
        let may_recur = match event {
            Event::Refused(_) | Event::Foreign(_) => true,
            Event::Quality { .. } | Event::Withheld(_) | Event::Lost | Event::Output(_) => false,
        };
        let recurring = self
            .recurring
            .get_mut(event.kind())
            .and_then(Option::as_mut);
        match recurring.filter(|(before, _)| may_recur && before == event) {
            Some((_, last)) => now.saturating_sub(std::mem::replace(last, now)) < ONSET,
            None => false,
        }
    }

    fn push(&mut self, event: Event, now: Duration) -> bool {
        let Some(last_sent) = self.last_sent.get_mut(event.kind()) else {
            return false;
        };
        let is_due = last_sent.is_none_or(|at| now.saturating_sub(at) >= PAUSE);
        if is_due {
            *last_sent = Some(now);
            self.sent += 1;
            // A full queue drops it.
            let _full = self.events.push(event);
        }
        is_due
    }

    /// The controller was lost or restarted: earlier observations do not apply to it.
    pub(super) fn restart(&mut self) {
        (self.older, self.newer) = (self.fresh.clone(), self.fresh.clone());
        (self.count, self.quality) = (0, i32::MIN);
    }

    pub(super) fn note_measurement(&mut self, measurement: Measurement, quality: i32) {
        self.older.handle_measurement(measurement);
        self.newer.handle_measurement(measurement);
        // A quality loss that is not reported now is reported after the pause, if it persists.
        if quality >= self.quality || self.send_quality_loss(quality, measurement.at) {
            self.quality = quality;
        }
        self.count += 1;
        if self.count >= WINDOW {
            self.count = 0;
            self.older = std::mem::replace(&mut self.newer, self.fresh.clone());
        }
    }

    fn send_quality_loss(&mut self, to: i32, at: Duration) -> bool {
        let (from, why) = (self.quality, self.older.verdict());
        self.send(Event::Quality { from, to, why }, at)
    }

    pub(super) fn note_answer(&mut self, now: Nanos, sequence: u32) {
        let now = Duration::from_nanos(now.0.unsigned_abs());
        self.older.handle_answer(now, sequence);
        self.newer.handle_answer(now, sequence);
    }

    pub(super) fn note_wake_up(&mut self, delay: Duration) {
        self.older.handle_wake_up(delay);
        self.newer.handle_wake_up(delay);
    }

    pub(super) const fn note_decode_error(&mut self, error: DecodeError) {
        self.diagnostics.decode_error = Some(error);
    }

    pub(super) const fn note_refused_output(&mut self, output: RefusedOutput) {
        self.diagnostics.refused_output = Some(output);
    }

    pub(super) const fn note_foreign(&mut self) {
        self.diagnostics.foreign += 1;
    }

    /// Notes whether a command was withheld; returns whether it is the first of a series.
    pub(super) fn note_violation(&mut self, violation: Option<Violation>) -> bool {
        let is_new = violation.is_some() && !self.withholds;
        self.withholds = violation.is_some();
        self.diagnostics.violation = violation.or(self.diagnostics.violation);
        is_new
    }

    /// Number of events so far.
    pub(super) const fn sent(&self) -> u64 {
        self.sent
    }

    /// Publishes the diagnostics.
    pub(super) fn publish(&mut self) {
        self.diagnostics.verdict = self.older.verdict();
        self.out.write(self.diagnostics);
    }
}
