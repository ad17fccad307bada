//! Finds which of network, host and controller is late: a pure function of the observed counters, and the observer that
//! collects them from live datagrams or a recording. It sends nothing and opens no socket.

use crate::sequence::{Order, Tracker};
use std::fmt;
use std::time::Duration;

mod measurement;
#[cfg(feature = "pcap")]
mod recording;
#[cfg(test)]
mod tests;
#[cfg(feature = "pcap")]
mod timeline;

#[cfg(feature = "pcap")]
pub use timeline::{Change, Timeline};

/// Counter jumps up to this width are loss, wider ones a restart.
const COUNTER_WINDOW: u16 = 50;
/// Fewer measurements than this give no verdict, if that many take no longer than [`FEW_SPAN`].
const FEW: u64 = 100;
/// This time gives a verdict even with fewer measurements, of slow controllers.
const FEW_SPAN: Duration = Duration::from_secs(2);
/// Answers in the controller's own mean of FRI 1.0: before that many it says nothing.
const ANSWER_WINDOW: u64 = 100;
/// Share of measurements or answers above which loss or lateness is reported.
const SHARE: f64 = 0.005;
/// Share of the period above which irregular arrival is reported.
const IRREGULAR: f64 = 0.2;

/// Counters of one connection, with times on this host's clock unless noted otherwise.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Observed {
    /// Measurement period as the controller states it; zero before the first measurement.
    pub period: Duration,
    /// Measurements received.
    pub measurements: u64,
    /// Measurements lost, by the controller's counter.
    pub lost: u64,
    /// Copies, and measurements overtaken by newer ones.
    pub disordered: u64,
    /// Controller restarts.
    pub restarts: u64,
    /// Answers sent.
    pub answers: u64,
    /// Answers that left later than half a command period after the arrival of the measurement that they reflect.
    pub late: u64,
    /// Measurements that were due for an answer and got none, although the next one gave this host time for it. Those
    /// before the first answer do not count.
    pub unanswered: u64,
    /// Measurements that were due for an answer and overtaken by the next one in less than half a period: they arrive in
    /// bursts.
    pub overtaken: u64,
    /// Measurements that reflect an answer of this host: the controller received it.
    pub acknowledged: u64,
    /// Measurements that reflect a new answer of another client.
    pub foreign: u64,
    /// Longest time from the arrival of a measurement to the answer that reflects it.
    pub answer_time_max: Duration,
    /// Largest number of measurements by which an answer was behind the newest one.
    pub behind_max: u32,
    /// Longest time from the arrival of a measurement, by the kernel's stamp, until the program had it: what the host adds.
    /// `None` if it is not measured, as in recordings.
    pub wake_up_max: Option<Duration>,
    /// Mean deviation of the interval between arrivals from the period, each on its own clock.
    pub arrival_jitter: Duration,
    /// The same by the controller's time stamps; `None` if they are missing or too coarse.
    pub stamp_jitter: Option<Duration>,
    /// Share of measurements answered in time by the controller's count, 0..=1; not available for Sunrise.
    pub answer_rate: Option<f64>,
    /// Whether the quality that the controller reports suffices for commands.
    pub is_good: bool,
}

/// The cause of bad timing, with the figures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Verdict {
    /// No measurement received.
    Silent,
    /// Too few measurements for a verdict.
    TooFew {
        /// Number of measurements received.
        measurements: u64,
    },
    /// No client answers the controller.
    Unanswered,
    /// Another client answers the controller too.
    SecondClient {
        /// Share of measurements that reflect an answer of another client, 0..=1.
        foreign: f64,
    },
    /// This host answers late.
    Host {
        /// Share of answers that left late, 0..=1.
        late: f64,
        /// Longest time to an answer.
        worst: Duration,
        /// Longest time of it until the program had the measurement, if it is measured.
        wake_up: Option<Duration>,
    },
    /// This host leaves measurements unanswered.
    Skipped {
        /// Share of measurements left unanswered, 0..=1.
        unanswered: f64,
    },
    /// The controller received no answer of this host.
    NotReceived,
    /// The controller sends irregularly.
    Controller {
        /// Mean deviation of its time stamps from the period.
        jitter: Duration,
    },
    /// Measurements are lost or disordered on the way to this host.
    NetworkInbound {
        /// Share of measurements lost, 0..=1.
        lost: f64,
        /// Copies and measurements overtaken.
        disordered: u64,
    },
    /// Measurements that left regularly arrive irregularly.
    NetworkJitter {
        /// Mean deviation of arrivals from the period.
        jitter: Duration,
    },
    /// Answers are lost on their way to the controller.
    NetworkOutbound {
        /// Share of answers that left in time and did not reach the controller, 0..=1.
        missing: f64,
    },
    /// Everything is in time at this host, yet the controller reports insufficient quality.
    Unexplained,
    /// No finding.
    Good,
}

/// Returns the first verdict that holds, in the order of [`Verdict`]: causes nearest to this host come first because
/// they can be fixed here. The network takes precedence where more measurements are lost or disordered than answered late.
pub fn judge(observed: &Observed) -> Verdict {
    let Observed {
        period,
        measurements,
        lost,
        disordered,
        ..
    } = *observed;
    let irregular = period.mul_f64(IRREGULAR);
    if measurements == 0 {
        return Verdict::Silent;
    }
    if measurements < few(period) {
        return Verdict::TooFew { measurements };
    }
    if observed.answers == 0 {
        return Verdict::Unanswered;
    }
    if worse(observed.foreign, measurements) {
        let foreign = share(observed.foreign, measurements);
        return Verdict::SecondClient { foreign };
    }
    if is_deaf(observed) {
        return Verdict::NotReceived;
    }
    let is_hither = worse(lost, measurements + lost) || worse(disordered, measurements);
    if let Some(verdict) = judge_host(observed, is_hither) {
        return verdict;
    }
    if let Some(jitter) = observed.stamp_jitter.filter(|it| *it > irregular) {
        return Verdict::Controller { jitter };
    }
    if is_hither {
        let lost = share(lost, measurements + lost);
        return Verdict::NetworkInbound { lost, disordered };
    }
    if observed.arrival_jitter > irregular || worse(observed.overtaken, measurements) {
        let jitter = observed.arrival_jitter;
        return Verdict::NetworkJitter { jitter };
    }
    judge_answers(observed)
}

/// Measurements that a verdict needs.
fn few(period: Duration) -> u64 {
    let in_span = FEW_SPAN.as_nanos() / period.as_nanos().max(1);
    u64::try_from(in_span).unwrap_or(FEW).min(FEW)
}

/// Whether the controller receives no answer of this host, or no more.
fn is_deaf(observed: &Observed) -> bool {
    let Observed {
        answers,
        acknowledged,
        ..
    } = *observed;
    let is_enough = answers >= few(observed.period);
    is_enough && (acknowledged == 0 || (!observed.is_good && acknowledged < answers / 2))
}

/// What this host does wrong, if it does.
fn judge_host(observed: &Observed, is_hither: bool) -> Option<Verdict> {
    if worse(observed.late, observed.answers) {
        return Some(Verdict::Host {
            late: share(observed.late, observed.answers),
            worst: observed.answer_time_max,
            wake_up: observed.wake_up_max,
        });
    }
    let due = observed.answers + observed.unanswered;
    // What a network disorders may leave no time for an answer.
    let is_theirs = is_hither && observed.lost + observed.disordered > observed.unanswered;
    (worse(observed.unanswered, due) && !is_theirs).then(|| Verdict::Skipped {
        unanswered: share(observed.unanswered, due),
    })
}

fn judge_answers(observed: &Observed) -> Verdict {
    let Observed {
        late,
        unanswered,
        overtaken,
        lost,
        measurements,
        ..
    } = *observed;
    let ours = share(late + unanswered + overtaken + lost, measurements);
    let is_counted = observed.answers >= ANSWER_WINDOW;
    let rate = observed.answer_rate.filter(|_| is_counted);
    match rate.map(|rate| 1.0 - rate - ours) {
        Some(missing) if missing > 2.0 * SHARE => Verdict::NetworkOutbound { missing },
        Some(_) | None if observed.is_good => Verdict::Good,
        Some(_) | None if !is_counted => Verdict::TooFew { measurements },
        Some(_) | None => Verdict::Unexplained,
    }
}

/// Whether so many are a pattern: one is none.
fn worse(part: u64, of: u64) -> bool {
    part > 1 && share(part, of) > SHARE
}

fn share(part: u64, of: u64) -> f64 {
    part as f64 / of.max(1) as f64
}

impl Verdict {
    /// Whether there is no finding.
    pub fn is_good(&self) -> bool {
        *self == Self::Good
    }

    /// How to fix it.
    pub fn remedy(&self) -> &'static str {
        match self {
            Self::Silent => {
                "check that the robot program opened FRI, the address and port it sends to, the netmask and this host's firewall"
            }
            Self::TooFew { .. } => "observe for longer",
            Self::Unanswered => "start the driver, or check which other program uses the port",
            Self::SecondClient { .. } => {
                "find the other client and stop it: an old driver still running, or a PC with this host's address"
            }
            Self::NotReceived => {
                "check this host's route and netmask towards the controller, firewalls on both sides, and that the controller expects its answers from this address and port"
            }
            Self::Host { .. } | Self::Skipped { .. } => {
                "give the driver real-time priority and a processor of its own, see `takt doctor`; lengthen the period if that does not suffice"
            }
            Self::Controller { .. } => {
                "check the controller for other load: another option package, a debugger, a full log"
            }
            Self::NetworkInbound { .. } | Self::NetworkOutbound { .. } => {
                "use a cable of your own between robot and host, no switch, no wireless; replace it and check `ip -s link`"
            }
            Self::NetworkJitter { .. } => {
                "take other traffic off this link, and turn interrupt coalescing off: `ethtool -C`"
            }
            Self::Unexplained => {
                "compare the period with what the controller expects, and check for a second client"
            }
            Self::Good => "nothing",
        }
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let percent = |share: f64| share * 100.0;
        match *self {
            Self::Silent => write!(f, "no measurement received"),
            Self::TooFew { measurements } => write!(f, "only {measurements} measurements received"),
            Self::Unanswered => write!(f, "no client answers the controller"),
            Self::SecondClient { foreign } => {
                write!(f, "another client answers the controller too: ")?;
                write!(f, "{:.1} % of the answers it received", percent(foreign))
            }
            Self::NotReceived => write!(f, "the controller does not receive this host's answers"),
            Self::Host {
                late,
                worst,
                wake_up,
            } => {
                write!(f, "this host answers late: {:.1} % of ", percent(late))?;
                write!(f, "answers, the worst after {worst:.1?}")?;
                wake_up.map_or(Ok(()), |wake_up| {
                    write!(f, "; the driver woke up as late as {wake_up:.1?}")
                })
            }
            Self::Skipped { unanswered } => {
                let unanswered = percent(unanswered);
                write!(
                    f,
                    "this host leaves {unanswered:.1} % of measurements unanswered"
                )
            }
            Self::Controller { jitter } => {
                write!(
                    f,
                    "the controller is irregular: {jitter:.1?} by its own stamps"
                )
            }
            Self::NetworkInbound { lost, disordered } => {
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
            Self::NetworkOutbound { missing } => {
                write!(f, "the network loses answers: {:.1} %", percent(missing))
            }
            Self::Unexplained => write!(
                f,
                "all answers in time, but the controller reports insufficient quality"
            ),
            Self::Good => write!(f, "good"),
        }
    }
}

/// One measurement of either generation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measurement {
    /// Time of arrival.
    pub at: Duration,
    /// The controller's counter.
    pub sequence: u32,
    /// Counter of the last answer that the controller received.
    pub reflected: u32,
    /// The controller's time stamp, if it is finer than a tenth of the period.
    pub stamp: Option<Duration>,
    /// Stated period.
    pub period: Duration,
    /// Measurements per answer that the controller expects, from 1 (`receiveMultiplier`).
    pub answer_every: u32,
    /// As in [`Observed::answer_rate`].
    pub answer_rate: Option<f64>,
    /// Whether the quality suffices for commands.
    pub is_good: bool,
}

/// Counts the events of one connection. It does not allocate, so that a driver may own one.
#[derive(Debug, Clone)]
pub struct Observer {
    tracker: Tracker,
    observed: Observed,
    last: Option<Measurement>,
    /// The measurement whose answer is due and not yet sent.
    waiting: Option<Waiting>,
    /// Counter of the measurement that the newest answer reflects.
    answered: Option<u32>,
    /// Counter of the newest answer.
    sent: Option<u32>,
    /// The counter that the controller reflected before the first answer: no proof that it received one, even if it is
    /// near ours, because clients and controllers begin at zero.
    before: Option<u32>,
    arrivals: Deviation,
    stamps: Deviation,
}

/// A measurement without its answer yet.
#[derive(Debug, Clone, Copy)]
struct Waiting {
    arrival: Duration,
    sequence: u32,
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
    pub fn lwr() -> Self {
        Self::new(Tracker::new(COUNTER_WINDOW))
    }

    /// For the 32-bit counters of Sunrise.
    pub fn sunrise() -> Self {
        Self::new(Tracker::wide(COUNTER_WINDOW))
    }

    fn new(tracker: Tracker) -> Self {
        Self {
            tracker,
            observed: Observed::default(),
            last: None,
            waiting: None,
            answered: None,
            sent: None,
            before: None,
            arrivals: Deviation::default(),
            stamps: Deviation::default(),
        }
    }

    /// Counts a received measurement.
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
        self.await_answer(&measurement);
        self.last = Some(measurement);
    }

    /// Waits for the answer to a measurement, if it is due. That to the one before cannot come any more.
    fn await_answer(&mut self, measurement: &Measurement) {
        let every = measurement.answer_every.max(1);
        let sequence = measurement.sequence;
        let apart = |from: u32| self.tracker.distance(from, sequence);
        let next = Waiting {
            arrival: measurement.at,
            sequence,
        };
        if let Some(waiting) = self.waiting {
            if apart(waiting.sequence) < every {
                return;
            }
            let span = measurement.at.saturating_sub(waiting.arrival);
            let has_begun = self.sent.is_some();
            let is_burst = span < measurement.period / 2;
            self.observed.overtaken += u64::from(has_begun && is_burst);
            self.observed.unanswered += u64::from(has_begun && !is_burst);
            self.waiting = Some(next);
        } else if self.answered.is_none_or(|last| apart(last) >= every) {
            self.waiting = Some(next);
        }
    }

    fn compare(&mut self, last: &Measurement, next: &Measurement, cycles: u32) {
        let expected = next.period.saturating_mul(cycles);
        self.arrivals.add(next.at.saturating_sub(last.at), expected);
        if let (Some(from), Some(to)) = (last.stamp, next.stamp) {
            self.stamps.add(to.saturating_sub(from), expected);
        }
    }

    /// The reflected counter belongs to a recent answer of this host, is unchanged, or belongs to another client.
    fn handle_reflection(&mut self, reflected: u32) {
        let Some(sent) = self.sent else {
            self.before = Some(reflected);
            return;
        };
        if self.before == Some(reflected) {
            return;
        }
        self.before = None;
        // A counter newer than the newest answer is ours, too: a recording may miss answers.
        let tracker = &self.tracker;
        let apart = tracker
            .distance(reflected, sent)
            .min(tracker.distance(sent, reflected));
        if apart <= u32::from(COUNTER_WINDOW) {
            self.observed.acknowledged += 1;
        } else if self.last.is_some_and(|last| last.reflected != reflected) {
            self.observed.foreign += 1;
        }
    }

    /// Notes how long after its arrival the program had the newest measurement.
    pub fn handle_wake_up(&mut self, delay: Duration) {
        let worst = &mut self.observed.wake_up_max;
        *worst = Some(worst.unwrap_or_default().max(delay));
    }

    /// Counts an answer to the newest measurement, sent `at`, with its counter.
    pub fn handle_answer(&mut self, at: Duration, sequence: u32) {
        let newest = self.last.map_or(0, |last| last.sequence);
        self.handle_answer_to(newest, at, sequence);
    }

    /// Counts an answer with its counter, sent `at`; `reflected` is the counter of the measurement that it answers.
    pub fn handle_answer_to(&mut self, reflected: u32, at: Duration, sequence: u32) {
        self.observed.answers += 1;
        self.sent = Some(sequence);
        self.answered = Some(reflected);
        let Some(newest) = self.last else {
            return;
        };
        let behind = self.tracker.behind(reflected, newest.sequence);
        let is_due = self.waiting.take().is_some();
        if !is_due && behind == 0 {
            return;
        }
        let since = newest.period.saturating_mul(behind);
        let took = at.saturating_sub(newest.at).saturating_add(since);
        let observed = &mut self.observed;
        observed.behind_max = observed.behind_max.max(behind);
        observed.answer_time_max = observed.answer_time_max.max(took);
        let command_period = newest.period.saturating_mul(newest.answer_every.max(1));
        observed.late += u64::from(took > command_period / 2);
    }

    /// Counters so far.
    pub fn observed(&self) -> Observed {
        Observed {
            arrival_jitter: self.arrivals.mean().unwrap_or_default(),
            stamp_jitter: self.stamps.mean(),
            ..self.observed
        }
    }

    /// Verdict on the counters so far.
    pub fn verdict(&self) -> Verdict {
        judge(&self.observed())
    }
}
