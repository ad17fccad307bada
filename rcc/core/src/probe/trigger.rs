//! The trigger of a scope: finds the row that starts a capture and collects the rows before and after it, of all groups. It reads no
//! ring and no clock. A capture has the row of the trigger, as many rows before and after it as its times hold, as far as they exist,
//! and the number of rows that were lost among them.
//!
//! ```text
//!        ┌───────────── complete, mode auto or normal ────────────┐
//!        ▼                                                         │
//!  Armed { since } ──── condition holds (auto: or time is up) ──▶ Filling { time, cause } ── complete, mode single ──▶ Done
//! ```

use std::collections::VecDeque;

use super::{CAPTURE_BYTES_MAX, Mode, ScopeError};

/// By how much a group may be behind another in time, s.
const SKEW_S: f64 = 0.25;
/// How long a capture waits, after its end, for groups whose rows do not come, s.
const GRACE_S: f64 = 1.0;
/// Shortest time without trigger after which mode auto captures, s.
const AUTO_S_MIN: f64 = 0.5;

/// What starts a capture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Condition {
    /// The value is greater.
    Above(f64),
    /// The value is less.
    Below(f64),
    /// The value reaches the level after it was below by at least the hysteresis.
    Rising {
        /// The level.
        level: f64,
        /// The hysteresis, from 0.
        hysteresis: f64,
    },
    /// The value reaches the level after it was above by at least the hysteresis.
    Falling {
        /// The level.
        level: f64,
        /// The hysteresis, from 0.
        hysteresis: f64,
    },
    /// The value is in the window, bounds included.
    Inside {
        /// Lower bound.
        low: f64,
        /// Upper bound.
        high: f64,
    },
    /// The value is not in the window.
    Outside {
        /// Lower bound.
        low: f64,
        /// Upper bound.
        high: f64,
    },
    /// The value becomes this one, or is it at first.
    Becomes(f64),
    /// The value becomes greater than it was.
    Increases,
    /// The value becomes another one than it was.
    Changes,
    /// The value is greater than 0.
    Positive,
}

/// The history of the watched value that a condition needs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Past {
    /// The last value that was not null.
    last: Option<f64>,
    /// Whether an edge counts: the value was beyond the level on the other side.
    is_ready: bool,
}

impl Condition {
    /// Whether it holds at this value; null and values that are not numbers never fulfil it and change nothing.
    #[expect(clippy::float_cmp, reason = "numbers of states")]
    fn holds(self, value: f64, past: &mut Past) -> bool {
        if value.is_nan() {
            return false;
        }
        let before = past.last.replace(value);
        match self {
            Self::Above(level) => value > level,
            Self::Below(level) => value < level,
            Self::Inside { low, high } => (low..=high).contains(&value),
            Self::Outside { low, high } => !(low..=high).contains(&value),
            Self::Becomes(state) => value == state && before != Some(state),
            Self::Increases => before.is_some_and(|before| value > before),
            Self::Changes => before.is_some_and(|before| value != before),
            Self::Positive => value > 0.0,
            Self::Rising { level, hysteresis } => {
                let holds = past.is_ready && value >= level;
                past.is_ready &= !holds;
                past.is_ready |= value < level && value <= level - hysteresis;
                holds
            }
            Self::Falling { level, hysteresis } => {
                let holds = past.is_ready && value <= level;
                past.is_ready &= !holds;
                past.is_ready |= value > level && value >= level + hysteresis;
                holds
            }
        }
    }

    /// What happened, for a value of this name.
    fn cause(self, name: &str, value: f64) -> String {
        match self {
            Self::Above(level) => format!("{name} is {value}, above {level}"),
            Self::Below(level) => format!("{name} is {value}, below {level}"),
            Self::Rising { level, .. } => format!("{name} rose to {value}, level {level}"),
            Self::Falling { level, .. } => format!("{name} fell to {value}, level {level}"),
            Self::Inside { low, high } => format!("{name} is {value}, inside {low} to {high}"),
            Self::Outside { low, high } => format!("{name} is {value}, outside {low} to {high}"),
            Self::Becomes(_) => format!("{name} is {value}"),
            Self::Increases => format!("{name} increased to {value}"),
            Self::Changes => format!("{name} changed to {value}"),
            Self::Positive => format!("{name} is {value}"),
        }
    }
}

/// The value that is watched.
#[derive(Clone, Debug, PartialEq)]
pub struct Watch {
    /// Number of its group.
    pub group: usize,
    /// Number of its column there.
    pub column: usize,
    /// Its name.
    pub name: String,
    /// The names of its states, by number; empty if it is no state.
    pub states: Vec<String>,
    /// What starts a capture.
    pub condition: Condition,
}

/// Settings of an engine.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// What it watches.
    pub watch: Watch,
    /// What follows a capture.
    pub mode: Mode,
    /// Time before the trigger, s.
    pub pre_s: f64,
    /// Time after it, s.
    pub post_s: f64,
}

/// The rows of a group.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroupSize {
    /// Number of columns besides the time.
    pub columns: usize,
    /// Time between two rows, s.
    pub period_s: f64,
}

/// A trigger that was found.
#[derive(Clone, Debug, PartialEq)]
pub struct Triggered {
    /// Time of its row, s.
    pub time_s: f64,
    /// What happened.
    pub cause: String,
}

/// A complete capture.
#[derive(Clone, Debug, PartialEq)]
pub struct Capture {
    /// Its trigger.
    pub trigger: Triggered,
    /// By group.
    pub groups: Vec<CaptureRows>,
}

/// The rows of a group in a capture.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CaptureRows {
    /// Rows that were lost before its first row and between its rows.
    pub lost: u64,
    /// A time, s, and the columns, row after row.
    pub values: Vec<f64>,
}

/// The last rows of a group.
#[derive(Debug)]
struct History {
    /// Numbers in a row.
    width: usize,
    pre: usize,
    post: usize,
    /// Rows that are held at most.
    most: usize,
    values: VecDeque<f64>,
    /// By row, how many were lost before it.
    lost: VecDeque<u64>,
    /// Lost before the next row.
    lost_next: u64,
}

impl History {
    fn new(size: GroupSize, pre_s: f64, post_s: f64) -> Self {
        let rows = |seconds: f64| rows_in(seconds, size.period_s);
        let (pre, post) = (rows(pre_s), rows(post_s));
        Self {
            width: size.columns + 1,
            pre,
            post,
            most: pre + post + 1 + rows(SKEW_S + GRACE_S),
            values: VecDeque::new(),
            lost: VecDeque::new(),
            lost_next: 0,
        }
    }

    fn bytes_max(&self) -> usize {
        let row = self.width * size_of::<f64>() + size_of::<u64>();
        self.most.saturating_mul(row)
    }

    fn push(&mut self, row: &[f64]) {
        self.values.extend(row);
        self.lost.push_back(std::mem::take(&mut self.lost_next));
        while self.lost.len() > self.most {
            self.values.drain(..self.width.min(self.values.len()));
            self.lost.pop_front();
        }
    }

    fn time(&self, row: usize) -> Option<f64> {
        self.values.get(row * self.width).copied()
    }

    /// The first row that is not before that time.
    fn row_at(&self, time: f64) -> Option<usize> {
        let rows = self.lost.len();
        // Rows are in the order of time.
        let (mut low, mut high) = (0, rows);
        while low < high {
            let middle = usize::midpoint(low, high);
            if self.time(middle).is_some_and(|it| it < time) {
                low = middle + 1;
            } else {
                high = middle;
            }
        }
        (low < rows).then_some(low)
    }

    fn is_complete(&self, time: f64) -> bool {
        let row = self.row_at(time);
        row.is_some_and(|row| self.lost.len() > row + self.post)
    }

    /// Whether it can hold no more rows without loss for a capture at that time.
    fn is_full(&self, time: f64) -> bool {
        let first = self
            .row_at(time)
            .map_or(0, |row| row.saturating_sub(self.pre));
        self.lost.len() >= self.most && first == 0
    }

    fn capture(&self, time: f64) -> CaptureRows {
        let rows = self.lost.len();
        let at = self.row_at(time).unwrap_or(rows);
        let first = at.saturating_sub(self.pre);
        let last = rows.min(at + self.post + 1);
        let values = self.values.range(first * self.width..last * self.width);
        CaptureRows {
            lost: self.lost.range(first..last).sum(),
            values: values.copied().collect(),
        }
    }
}

/// Number of whole periods in a time.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a float to integer cast saturates, and a negative one is 0"
)]
fn rows_in(seconds: f64, period_s: f64) -> usize {
    // So that 0.5 s has 500 rows of 1 ms.
    (seconds / period_s + 1e-6).floor() as usize
}

#[derive(Clone, Debug, PartialEq)]
enum State {
    /// The trigger is searched; `since` is when that began.
    Armed { since: Option<f64> },
    /// The rows after it are collected; `until` is when that is given up.
    Filling { trigger: Triggered, until: f64 },
    /// Mode single has its capture.
    Done,
}

/// A trigger engine. `now` is a time that does not go back, s; it need not be that of the rows.
#[derive(Debug)]
pub struct Engine {
    settings: Settings,
    groups: Vec<History>,
    state: State,
    past: Past,
    /// Triggers and captures that were not taken.
    found: VecDeque<Found>,
}

/// An output of an engine.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Found {
    Trigger(Triggered),
    Capture(Capture),
}

impl Engine {
    /// An engine for groups of these sizes, armed.
    ///
    /// # Errors
    /// If its captures could take more than [`CAPTURE_BYTES_MAX`].
    pub fn new(settings: Settings, groups: &[GroupSize]) -> Result<Self, ScopeError> {
        let (pre_s, post_s) = (settings.pre_s, settings.post_s);
        let histories = groups.iter().map(|size| History::new(*size, pre_s, post_s));
        let histories: Vec<_> = histories.collect();
        let bytes = histories.iter().map(History::bytes_max);
        let bytes = bytes.fold(0, usize::saturating_add);
        if bytes > CAPTURE_BYTES_MAX {
            return Err(ScopeError::Memory {
                probes: groups.iter().map(|group| group.columns).sum(),
                pre_s,
                post_s,
                bytes,
            });
        }
        Ok(Self {
            settings,
            groups: histories,
            state: State::Armed { since: None },
            past: Past::default(),
            found: VecDeque::new(),
        })
    }

    /// Whether mode single has its capture.
    #[must_use]
    pub fn is_done(&self) -> bool {
        self.state == State::Done
    }

    /// Takes new rows: by group, how many were lost before the first and the rows, each a time, s, and the columns. Rows of all
    /// groups are taken in the order of their times.
    pub fn handle_rows(&mut self, batches: &[(u64, &[f64])], now: f64) {
        for (history, (lost, _)) in self.groups.iter_mut().zip(batches) {
            history.lost_next += lost;
        }
        let mut next = vec![0; self.groups.len()];
        loop {
            let firsts = batches.iter().zip(&next).zip(&self.groups).enumerate();
            let firsts = firsts.filter_map(|(group, (((_, rows), next), history))| {
                let row = rows.get(*next..*next + history.width)?;
                Some((group, *row.first()?, row))
            });
            let Some((group, _, row)) = firsts.min_by(|a, b| a.1.total_cmp(&b.1)) else {
                break;
            };
            if let (Some(next), Some(history)) = (next.get_mut(group), self.groups.get(group)) {
                *next += history.width;
            }
            self.handle_row(group, row, now);
        }
        self.poll(now);
    }

    fn handle_row(&mut self, group: usize, row: &[f64], now: f64) {
        if let State::Filling { trigger, .. } = &self.state {
            let time = trigger.time_s;
            if self.groups.get(group).is_some_and(|it| it.is_full(time)) {
                self.complete(now);
            }
        }
        if let Some(history) = self.groups.get_mut(group) {
            history.push(row);
        }
        let watch = &self.settings.watch;
        if watch.group == group
            && let [time, columns @ ..] = row
            && let Some(value) = columns.get(watch.column)
        {
            self.handle_value(*time, *value, now);
        }
        self.complete_if_whole(now);
    }

    /// Takes a value of what is watched that has no row, such as the state of a net that has ended.
    pub fn handle_value(&mut self, time_s: f64, value: f64, now: f64) {
        let watch = &self.settings.watch;
        let holds = watch.condition.holds(value, &mut self.past);
        if !holds || !matches!(self.state, State::Armed { .. }) {
            return;
        }
        let state = watch.states.iter().enumerate();
        let state = state.filter(|(number, _)| is_state(value, *number));
        let cause = match state.map(|(_, name)| name).next() {
            Some(name) => format!("{} is {name}", watch.name),
            None => watch.condition.cause(&watch.name, value),
        };
        self.trigger(Triggered { time_s, cause }, now);
    }

    fn trigger(&mut self, trigger: Triggered, now: f64) {
        self.found.push_back(Found::Trigger(trigger.clone()));
        let until = now + self.settings.post_s + GRACE_S;
        self.state = State::Filling { trigger, until };
    }

    fn complete_if_whole(&mut self, now: f64) {
        if let State::Filling { trigger, .. } = &self.state {
            let time = trigger.time_s;
            if self.groups.iter().all(|group| group.is_complete(time)) {
                self.complete(now);
            }
        }
    }

    /// Ends the capture as it is.
    fn complete(&mut self, now: f64) {
        let next = match self.settings.mode {
            Mode::Single => State::Done,
            Mode::Auto | Mode::Normal => State::Armed { since: Some(now) },
        };
        if let State::Filling { trigger, .. } = std::mem::replace(&mut self.state, next) {
            let groups = self.groups.iter().map(|it| it.capture(trigger.time_s));
            let groups = groups.collect();
            self.found
                .push_back(Found::Capture(Capture { trigger, groups }));
        }
    }

    /// Does what is due by time: gives up a capture whose rows do not come, and triggers in mode auto.
    pub fn poll(&mut self, now: f64) {
        match &mut self.state {
            State::Done => {}
            State::Filling { until, .. } => {
                if now > *until {
                    self.complete(now);
                }
            }
            State::Armed { since } => {
                let since = *since.get_or_insert(now);
                let Settings { pre_s, post_s, .. } = self.settings;
                let timeout = (pre_s + post_s).max(AUTO_S_MIN);
                let watched = self.groups.get(self.settings.watch.group);
                let last = watched.and_then(|group| {
                    let row = group.lost.len().checked_sub(group.post + 1)?;
                    group.time(row)
                });
                if let (Mode::Auto, Some(time_s), true) =
                    (self.settings.mode, last, now - since >= timeout)
                {
                    let cause = format!("no trigger within {timeout} s");
                    self.trigger(Triggered { time_s, cause }, now);
                    self.complete_if_whole(now);
                }
            }
        }
    }

    /// The next output.
    pub(super) fn poll_found(&mut self) -> Option<Found> {
        self.found.pop_front()
    }

    /// The next capture; triggers alone are skipped.
    pub fn poll_capture(&mut self) -> Option<Capture> {
        loop {
            if let Found::Capture(capture) = self.found.pop_front()? {
                return Some(capture);
            }
        }
    }
}

#[expect(
    clippy::cast_precision_loss,
    clippy::float_cmp,
    reason = "numbers of states"
)]
fn is_state(value: f64, number: usize) -> bool {
    value == number as f64
}
