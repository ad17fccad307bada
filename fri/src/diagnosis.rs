//! Who is late: the network, this host or the controller. A pure judgement of what was observed, and the observer that counts it
//! from live datagrams or a recording. It sends nothing and knows no socket.

use crate::sequence::{Order, Tracker};
use std::fmt;
use std::time::Duration;

mod measurement;
#[cfg(feature = "pcap")]
mod recording;
#[cfg(test)]
mod tests;

/// Jumps of a counter up to this width are loss, wider ones a restart.
const COUNTER_WINDOW: u16 = 50;
/// Measurements below which nothing can be said.
const FEW: u64 = 100;
/// Share of measurements or answers above which loss or lateness is named.
const SHARE: f64 = 0.005;
/// Share of the period above which irregular arrival is named.
const IRREGULAR: f64 = 0.2;

/// What was seen of one connection, with times on this host's clock unless said otherwise.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Observed {
    /// Period of measurements as the controller states it; zero if it was never told.
    pub period: Duration,
    /// Measurements that came.
    pub measurements: u64,
    /// Measurements that did not come, by the controller's counter.
    pub lost: u64,
    /// Copies, and measurements overtaken by newer ones.
    pub disordered: u64,
    /// Times the controller started again.
    pub restarts: u64,
    /// Answers sent.
    pub answers: u64,
    /// Measurements that were answered later than half a period after they came, or not at all although one was due.
    pub late: u64,
    /// Measurements that reflect an answer of this host: the controller heard it.
    pub heard: u64,
    /// Measurements that reflect a new answer which this host did not send.
    pub strange: u64,
    /// Longest time from a measurement to its answer.
    pub answer_time_max: Duration,
    /// Mean deviation of the time between measurements from the period, each side by its own clock: arrival here.
    pub arrival_jitter: Duration,
    /// The same by the time stamps in the measurements; `None` if they carry none fine enough.
    pub stamp_jitter: Option<Duration>,
    /// Share of measurements answered in time as the controller counts, 0..=1; Sunrise does not tell.
    pub answer_rate: Option<f64>,
    /// Whether the controller's quality suffices for commands.
    pub is_good: bool,
}

/// Who is to blame, with the figures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Verdict {
    /// No measurement came.
    Silent,
    /// Too few measurements to judge.
    TooFew {
        /// How many came.
        measurements: u64,
    },
    /// Nobody answers the controller.
    Unanswered,
    /// Another client answers the controller too.
    SecondClient {
        /// Share of measurements that reflect an answer of another client, 0..=1.
        strange: f64,
    },
    /// This host answers late.
    Host {
        /// Share of measurements answered late or never, 0..=1.
        late: f64,
        /// Longest time to an answer.
        worst: Duration,
    },
    /// The controller heard no answer of this host.
    Unheard,
    /// The controller sends irregularly.
    Controller {
        /// Mean deviation of its own time stamps from its period.
        jitter: Duration,
    },
    /// Measurements are lost or disordered on their way here.
    NetworkHither {
        /// Share of measurements lost, 0..=1.
        lost: f64,
        /// Copies and measurements overtaken.
        disordered: u64,
    },
    /// Measurements arrive irregularly that left regularly.
    NetworkJitter {
        /// Mean deviation of arrivals from the period.
        jitter: Duration,
    },
    /// Answers are lost on their way to the controller.
    NetworkThither {
        /// Share of answers that left in time and that the controller misses, 0..=1.
        missing: f64,
    },
    /// All in time as seen from here, and the controller disagrees without saying why.
    Unexplained,
    /// Nothing to complain about.
    Good,
}

/// Judges what was observed. The first of the verdicts that holds, in the order of [`Verdict`]: what is nearest to this host first,
/// for it can be mended here; but where more measurements are lost or disordered than answered late, the network.
#[must_use]
pub fn judge(observed: &Observed) -> Verdict {
    let Observed {
        period,
        measurements,
        lost,
        disordered,
        ..
    } = *observed;
    let irregular = period.mul_f64(IRREGULAR);
    let worse = |part: u64, of: u64| share(part, of) > SHARE;
    if measurements == 0 {
        return Verdict::Silent;
    }
    if measurements < FEW {
        return Verdict::TooFew { measurements };
    }
    if observed.answers == 0 {
        return Verdict::Unanswered;
    }
    if worse(observed.strange, measurements) {
        let strange = share(observed.strange, measurements);
        return Verdict::SecondClient { strange };
    }
    let is_hither = worse(lost, measurements + lost) || worse(disordered, measurements);
    // Of a measurement that is overtaken at once the host cannot help the lateness.
    let is_theirs = is_hither && lost + disordered > observed.late;
    if worse(observed.late, measurements) && !is_theirs {
        let late = share(observed.late, measurements);
        let worst = observed.answer_time_max;
        return Verdict::Host { late, worst };
    }
    if observed.heard == 0 && observed.answers >= FEW {
        return Verdict::Unheard;
    }
    if let Some(jitter) = observed.stamp_jitter.filter(|it| *it > irregular) {
        return Verdict::Controller { jitter };
    }
    if is_hither {
        let lost = share(lost, measurements + lost);
        return Verdict::NetworkHither { lost, disordered };
    }
    if observed.arrival_jitter > irregular {
        let jitter = observed.arrival_jitter;
        return Verdict::NetworkJitter { jitter };
    }
    judge_answers(observed)
}

fn judge_answers(observed: &Observed) -> Verdict {
    let ours =
        share(observed.late, observed.measurements) + share(observed.lost, observed.measurements);
    match observed.answer_rate.map(|rate| 1.0 - rate - ours) {
        Some(missing) if missing > 2.0 * SHARE => Verdict::NetworkThither { missing },
        Some(_) | None if observed.is_good => Verdict::Good,
        Some(_) | None => Verdict::Unexplained,
    }
}

#[expect(clippy::cast_precision_loss, reason = "a share, not a count")]
fn share(part: u64, of: u64) -> f64 {
    part as f64 / of.max(1) as f64
}

impl Verdict {
    /// Whether there is nothing to complain about.
    #[must_use]
    pub fn is_good(&self) -> bool {
        *self == Self::Good
    }

    /// What to do.
    #[must_use]
    pub fn remedy(&self) -> &'static str {
        match self {
            Self::Silent => {
                "check that the robot program opened FRI, the address and port it sends to, the netmask and this host's firewall"
            }
            Self::TooFew { .. } => "observe for longer",
            Self::Unanswered => "start the driver, or look for another program that took the port",
            Self::SecondClient { .. } => {
                "find the other client and stop it: an old driver still running, or a PC with this host's address"
            }
            Self::Unheard => {
                "check this host's route and netmask towards the controller, firewalls on the way, and that the controller is set to this very address"
            }
            Self::Host { .. } => {
                "give the driver real-time priority and a processor of its own, see `takt doctor`; lengthen the period if that does not suffice"
            }
            Self::Controller { .. } => {
                "look for other work on the controller: another option package, a debugger, a full log"
            }
            Self::NetworkHither { .. } | Self::NetworkThither { .. } => {
                "use a cable of your own between robot and host, no switch, no wireless; replace it and look at `ip -s link`"
            }
            Self::NetworkJitter { .. } => {
                "take other traffic off this link, and turn interrupt coalescing off: `ethtool -C`"
            }
            Self::Unexplained => {
                "compare the period with what the controller expects, and look for a second client that answers too"
            }
            Self::Good => "nothing",
        }
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let percent = |share: f64| share * 100.0;
        match *self {
            Self::Silent => write!(f, "no measurement came"),
            Self::TooFew { measurements } => write!(f, "only {measurements} measurements came"),
            Self::Unanswered => write!(f, "nobody answers the controller"),
            Self::SecondClient { strange } => {
                write!(f, "another client answers the controller too: ")?;
                write!(f, "{:.1} % of what it heard", percent(strange))
            }
            Self::Unheard => write!(f, "the controller hears no answer of this host"),
            Self::Host { late, worst } => {
                write!(f, "this host is late: {:.1} % of answers, ", percent(late))?;
                write!(f, "the worst after {worst:.1?}")
            }
            Self::Controller { jitter } => {
                write!(
                    f,
                    "the controller is irregular: {jitter:.1?} by its own stamps"
                )
            }
            Self::NetworkHither { lost, disordered } => {
                write!(
                    f,
                    "the network loses measurements: {:.1} %, ",
                    percent(lost)
                )?;
                write!(f, "{disordered} out of order")
            }
            Self::NetworkJitter { jitter } => {
                write!(f, "the network is irregular: {jitter:.1?} on arrival")
            }
            Self::NetworkThither { missing } => {
                write!(f, "the network loses answers: {:.1} %", percent(missing))
            }
            Self::Unexplained => write!(f, "all in time here, but quality does not suffice"),
            Self::Good => write!(f, "good"),
        }
    }
}

/// One measurement, whatever its generation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measurement {
    /// When it came.
    pub at: Duration,
    /// The controller's counter.
    pub sequence: u32,
    /// Counter of the answer that the controller heard last.
    pub reflected: u32,
    /// The controller's time stamp, if it is finer than a tenth of the period.
    pub stamp: Option<Duration>,
    /// Period as stated.
    pub period: Duration,
    /// Whether it wants an answer: every one, or every `receiveMultiplier`-th.
    pub is_due: bool,
    /// As in [`Observed::answer_rate`].
    pub answer_rate: Option<f64>,
    /// Whether quality suffices for commands.
    pub is_good: bool,
}

/// Counts what one connection does; no allocation, so that a driver may hold one.
#[derive(Debug, Clone)]
pub struct Observer {
    tracker: Tracker,
    observed: Observed,
    last: Option<Measurement>,
    /// When the last measurement came that wants an answer and has none.
    waiting: Option<Duration>,
    /// Counter of the newest answer.
    sent: Option<u32>,
    arrivals: Deviation,
    stamps: Deviation,
}

/// Sum and number of deviations from a period.
#[derive(Debug, Clone, Copy, Default)]
struct Deviation {
    sum: Duration,
    count: u32,
}

impl Deviation {
    fn add(&mut self, interval: Duration, expected: Duration) {
        self.sum = self.sum.saturating_add(interval.abs_diff(expected));
        self.count = self.count.saturating_add(1);
    }

    fn mean(self) -> Option<Duration> {
        self.sum.checked_div(self.count)
    }
}

impl Observer {
    /// For the 16-bit counters of FRI 1.0.
    #[must_use]
    pub fn lwr() -> Self {
        Self::new(Tracker::new(COUNTER_WINDOW))
    }

    /// For the 32-bit counters of Sunrise.
    #[must_use]
    pub fn sunrise() -> Self {
        Self::new(Tracker::wide(COUNTER_WINDOW))
    }

    fn new(tracker: Tracker) -> Self {
        Self {
            tracker,
            observed: Observed::default(),
            last: None,
            waiting: None,
            sent: None,
            arrivals: Deviation::default(),
            stamps: Deviation::default(),
        }
    }

    /// Takes a measurement that came.
    pub fn handle_measurement(&mut self, measurement: Measurement) {
        let observed = &mut self.observed;
        observed.measurements += 1;
        let cycles = match self.tracker.accept(measurement.sequence) {
            Order::First => None,
            Order::Next { lost } => {
                observed.lost += u64::from(lost);
                Some(u32::from(lost) + 1)
            }
            Order::Duplicate | Order::Old => {
                observed.disordered += 1;
                return;
            }
            Order::Restart => {
                observed.restarts += 1;
                None
            }
        };
        observed.period = measurement.period;
        observed.answer_rate = measurement.answer_rate;
        observed.is_good = measurement.is_good;
        self.handle_reflection(measurement.reflected);
        if let (Some(cycles), Some(last)) = (cycles, self.last) {
            self.compare(&last, &measurement, cycles);
        }
        if self.waiting.take().is_some() {
            self.observed.late += 1;
        }
        self.waiting = measurement.is_due.then_some(measurement.at);
        self.last = Some(measurement);
    }

    fn compare(&mut self, last: &Measurement, next: &Measurement, cycles: u32) {
        let expected = next.period.saturating_mul(cycles);
        self.arrivals.add(next.at.saturating_sub(last.at), expected);
        if let (Some(from), Some(to)) = (last.stamp, next.stamp) {
            self.stamps.add(to.saturating_sub(from), expected);
        }
    }

    /// What the controller heard last is one of our last answers, or the one it heard before, or a stranger's.
    fn handle_reflection(&mut self, reflected: u32) {
        let Some(sent) = self.sent else {
            return;
        };
        // Newer than the newest, too: a recording may miss answers.
        let tracker = &self.tracker;
        let apart = tracker
            .distance(reflected, sent)
            .min(tracker.distance(sent, reflected));
        if apart <= u32::from(COUNTER_WINDOW) {
            self.observed.heard += 1;
        } else if self.last.is_some_and(|last| last.reflected != reflected) {
            self.observed.strange += 1;
        }
    }

    /// Takes an answer that was sent, with its counter.
    pub fn handle_answer(&mut self, at: Duration, sequence: u32) {
        self.observed.answers += 1;
        self.sent = Some(sequence);
        let Some(came) = self.waiting.take() else {
            return;
        };
        let took = at.saturating_sub(came);
        self.observed.answer_time_max = self.observed.answer_time_max.max(took);
        self.observed.late += u64::from(took > self.observed.period / 2);
    }

    /// What was seen so far.
    #[must_use]
    pub fn observed(&self) -> Observed {
        Observed {
            arrival_jitter: self.arrivals.mean().unwrap_or_default(),
            stamp_jitter: self.stamps.mean(),
            ..self.observed
        }
    }

    /// The verdict on what was seen so far.
    #[must_use]
    pub fn verdict(&self) -> Verdict {
        judge(&self.observed())
    }
}
