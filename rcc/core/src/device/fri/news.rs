//! What a driver of FRI arms tells people: who is late, what was refused and why, and what happened. Values go out of
//! the real-time thread; texts are made by who reads them. It decides nothing.

use std::net::SocketAddr;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use takt_fri::diagnosis::{Measurement, Observer, Verdict};
use takt_fri::error::DecodeError;
use takt_fri::guard::{Breach, Violation};
use takt_rt::Nanos;
use takt_rt::latest::{LatestReader, LatestWriter, latest};
use takt_rt::ring::{Consumer, Producer, ring};

use crate::device::driver::Severity;

/// Measurements after which the older of two observers is begun anew: verdicts are on one to two times as many.
const WINDOW: u32 = 100;
/// News that may wait to be read; more are lost.
const WAITING: usize = 64;
/// The same kind of news is told no more often than this.
const PAUSE: Duration = Duration::from_secs(1);
/// Kinds of [`News`].
const KINDS: usize = 6;

/// Something that happened.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum News {
    /// The controller calls the connection worse than before, and who is to blame by the last measurements.
    Quality { from: i32, to: i32, why: Verdict },
    /// A datagram was none.
    Refused(DecodeError),
    /// A command was beyond a guard and not sent.
    Withheld(Violation),
    /// Somebody else sends measurements here.
    Foreign(SocketAddr),
    /// The controller fell silent.
    Gone,
}

impl News {
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
            Self::Gone => 4,
        }
    }

    /// How much it matters.
    pub(super) const fn severity(&self) -> Severity {
        match self {
            Self::Quality { .. } | Self::Refused(_) | Self::Foreign(_) => Severity::Warning,
            Self::Withheld(_) | Self::Gone => Severity::Error,
        }
    }

    /// In words, with the names that the protocol has for qualities.
    pub(super) fn text(&self, quality: impl Fn(i32) -> String) -> String {
        match self {
            Self::Quality { from, to, why } => {
                let (from, to) = (quality(*from), quality(*to));
                format!("quality fell from {from} to {to}: {}", advice(*why))
            }
            Self::Refused(error) => format!("a datagram was refused: {error}"),
            Self::Withheld(violation) => format!(
                "a command was withheld, {}: {violation}; look for a slip in the net, or in the limits of the cell",
                consequence(violation.breach)
            ),
            Self::Foreign(from) => format!(
                "measurements of a second controller at {from} are ignored: give each robot a port of its own"
            ),
            Self::Gone => {
                "the controller fell silent: does its program run, is the cable in, is it set to this address?".to_owned()
            }
        }
    }
}

/// What becomes of a robot for which this was commanded.
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

/// A verdict with what to do about it.
pub(super) fn advice(verdict: Verdict) -> String {
    if verdict.is_good() {
        return "all in time here".to_owned();
    }
    format!("{verdict}; {}", verdict.remedy())
}

/// What is known at the moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Told {
    /// On the last measurements.
    pub(super) verdict: Verdict,
    /// Why a datagram was refused last.
    pub(super) refusal: Option<DecodeError>,
    /// Why a command was withheld last.
    pub(super) violation: Option<Violation>,
    /// Datagrams of others than the controller.
    pub(super) foreign: u64,
}

impl Default for Told {
    fn default() -> Self {
        Self {
            verdict: Verdict::Silent,
            refusal: None,
            violation: None,
            foreign: 0,
        }
    }
}

/// The end in the real-time thread: it counts and tells, without a text.
#[derive(Debug)]
pub(super) struct Herald {
    fresh: Observer,
    older: Observer,
    newer: Observer,
    count: u32,
    quality: i32,
    told: Told,
    /// Whether the last command was withheld.
    withholds: bool,
    spoke: [Option<Duration>; KINDS],
    news: Producer<News>,
    out: LatestWriter<Told>,
}

/// The end of people.
#[derive(Debug)]
pub(super) struct Listener {
    news: Mutex<Consumer<News>>,
    told: Mutex<LatestReader<Told>>,
}

/// Both ends for an arm whose protocol is observed so.
pub(super) fn herald(fresh: Observer) -> (Herald, Listener) {
    let (producer, consumer) = ring(WAITING);
    let (out, told) = latest(1, Told::default);
    let herald = Herald {
        older: fresh.clone(),
        newer: fresh.clone(),
        fresh,
        count: 0,
        quality: i32::MIN,
        told: Told::default(),
        withholds: false,
        spoke: [None; KINDS],
        news: producer,
        out,
    };
    let listener = Listener {
        news: Mutex::new(consumer),
        told: Mutex::new(told),
    };
    (herald, listener)
}

impl Listener {
    pub(super) fn news(&self) -> Option<News> {
        let mut news = self.news.lock().unwrap_or_else(PoisonError::into_inner);
        news.pop()
    }

    pub(super) fn told(&self) -> Told {
        let mut told = self.told.lock().unwrap_or_else(PoisonError::into_inner);
        told.read()
    }
}

impl Herald {
    /// Tells it, unless its kind was told a moment ago; whether it did.
    pub(super) fn tell(&mut self, news: News, now: Duration) -> bool {
        let Some(spoke) = self.spoke.get_mut(news.kind()) else {
            return false;
        };
        let is_told = spoke.is_none_or(|at| now.saturating_sub(at) >= PAUSE);
        if is_told {
            *spoke = Some(now);
            // If nobody listens, it is lost.
            let _full = self.news.push(news);
        }
        is_told
    }

    /// The controller is gone, or began anew: what was seen before says nothing of it.
    pub(super) fn begin_anew(&mut self) {
        (self.older, self.newer) = (self.fresh.clone(), self.fresh.clone());
        (self.count, self.quality) = (0, i32::MIN);
    }

    pub(super) fn note_measurement(&mut self, measurement: Measurement, quality: i32) {
        self.older.handle_measurement(measurement);
        self.newer.handle_measurement(measurement);
        // A fall that is not told now is when the pause is over, if it lasts.
        if quality >= self.quality || self.tell_fall(quality, measurement.at) {
            self.quality = quality;
        }
        self.count += 1;
        if self.count >= WINDOW {
            self.count = 0;
            self.older = std::mem::replace(&mut self.newer, self.fresh.clone());
        }
    }

    fn tell_fall(&mut self, to: i32, at: Duration) -> bool {
        let (from, why) = (self.quality, self.older.verdict());
        self.tell(News::Quality { from, to, why }, at)
    }

    pub(super) fn note_answer(&mut self, now: Nanos, sequence: u32) {
        let now = Duration::from_nanos(now.0.unsigned_abs());
        self.older.handle_answer(now, sequence);
        self.newer.handle_answer(now, sequence);
    }

    pub(super) const fn note_refusal(&mut self, error: DecodeError) {
        self.told.refusal = Some(error);
    }

    pub(super) const fn note_foreign(&mut self) {
        self.told.foreign += 1;
    }

    /// Notes whether a command was withheld; returns whether that is news.
    pub(super) fn note_violation(&mut self, violation: Option<Violation>) -> bool {
        let is_news = violation.is_some() && !self.withholds;
        self.withholds = violation.is_some();
        self.told.violation = violation.or(self.told.violation);
        is_news
    }

    /// Hands over what is known.
    pub(super) fn publish(&mut self) {
        self.told.verdict = self.older.verdict();
        self.out.write(self.told);
    }
}
