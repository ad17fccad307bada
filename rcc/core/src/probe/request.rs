//! What a client requests of a scope, as it is on the wire. Names are resolved elsewhere.

use serde::Deserialize;

use super::{EVERY_MAX, NAME_CHARS_MAX, PROBES_MAX, RATE_HZ_MAX, ScopeError, WINDOW_S_MAX};

/// A scope: which probes, how often, and what starts a capture.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ScopeRequest {
    /// Names of probes, 1 to [`PROBES_MAX`].
    pub probes: Vec<String>,
    /// Every how many cycles a sample is taken, 1 to [`EVERY_MAX`].
    pub every: u64,
    /// What starts a capture; without it samples are streamed.
    pub trigger: Option<TriggerRequest>,
    /// Time before the trigger, s, 0 to [`WINDOW_S_MAX`].
    pub pre_s: f64,
    /// Time after the trigger, s, 0 to [`WINDOW_S_MAX`].
    pub post_s: f64,
    /// What follows a capture.
    pub mode: Mode,
    /// Maximum number of frames per second, 0.1 to [`RATE_HZ_MAX`].
    pub rate_hz: f64,
}

impl Default for ScopeRequest {
    fn default() -> Self {
        Self {
            probes: Vec::new(),
            every: 1,
            trigger: None,
            pre_s: 0.5,
            post_s: 1.5,
            mode: Mode::Auto,
            rate_hz: 30.0,
        }
    }
}

/// What follows a capture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// The next one, also without a trigger if none comes for a while.
    #[default]
    Auto,
    /// The next one, at the next trigger.
    Normal,
    /// Nothing.
    Single,
}

/// A trigger as requested.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TriggerRequest {
    /// Its kind.
    pub on: TriggerKind,
    /// The probe that it watches; for `fault` a device, for `event` a device, machine or net, for `overrun` a thread.
    #[serde(default)]
    pub probe: Option<String>,
    /// Of `above`, `below`, `rising` and `falling`, in the unit of the probe.
    #[serde(default)]
    pub level: Option<f64>,
    /// Of `rising` and `falling`: by how much the value must be beyond the level on the other side before an edge counts, from 0;
    /// 0 by default.
    #[serde(default)]
    pub hysteresis: Option<f64>,
    /// Lower bound of `inside` and `outside`.
    #[serde(default)]
    pub low: Option<f64>,
    /// Upper bound of `inside` and `outside`.
    #[serde(default)]
    pub high: Option<f64>,
    /// Name or number of a state.
    #[serde(default)]
    pub equals: Option<String>,
}

/// Kinds of triggers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TriggerKind {
    /// The value is greater than the level.
    Above,
    /// The value is less than the level.
    Below,
    /// The value reaches the level from below.
    Rising,
    /// The value reaches the level from above.
    Falling,
    /// The value is from low to high.
    Inside,
    /// The value is less than low or greater than high.
    Outside,
    /// A net, machine or device enters a state.
    State,
    /// A device stops following commands.
    Fault,
    /// A driver reports an event, or a machine or a net enters another state.
    Event,
    /// A thread misses cycles.
    Overrun,
}

impl TriggerKind {
    /// Its name on the wire.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Above => "above",
            Self::Below => "below",
            Self::Rising => "rising",
            Self::Falling => "falling",
            Self::Inside => "inside",
            Self::Outside => "outside",
            Self::State => "state",
            Self::Fault => "fault",
            Self::Event => "event",
            Self::Overrun => "overrun",
        }
    }
}

impl ScopeRequest {
    /// A stream of these probes at the full rate.
    #[must_use]
    pub fn of(probes: &[&str]) -> Self {
        Self {
            probes: probes.iter().map(|&name| name.to_owned()).collect(),
            ..Self::default()
        }
    }

    /// Checks its bounds.
    ///
    /// # Errors
    /// With the field that is out of range.
    pub fn check(&self) -> Result<(), ScopeError> {
        let count = |field, value: usize, from: usize, to: usize| {
            if (from..=to).contains(&value) {
                return Ok(());
            }
            Err(out_of_range(field, value, from, to))
        };
        count("the number of probes", self.probes.len(), 1, PROBES_MAX)?;
        let trigger = self.trigger.as_ref();
        let watched = trigger.and_then(|trigger| trigger.probe.as_ref());
        for name in self.probes.iter().chain(watched) {
            let chars = name.chars().count();
            count("the length of a probe's name", chars, 1, NAME_CHARS_MAX)?;
        }
        if !(1..=EVERY_MAX).contains(&self.every) {
            return Err(out_of_range("every", self.every, 1, EVERY_MAX));
        }
        number("pre_s", self.pre_s, 0.0, WINDOW_S_MAX)?;
        number("post_s", self.post_s, 0.0, WINDOW_S_MAX)?;
        number("rate_hz", self.rate_hz, 0.1, RATE_HZ_MAX)?;
        trigger.map_or(Ok(()), TriggerRequest::check)
    }
}

fn out_of_range(
    field: &'static str,
    value: impl ToString,
    from: impl ToString,
    to: impl ToString,
) -> ScopeError {
    ScopeError::Range {
        field,
        value: value.to_string(),
        from: from.to_string(),
        to: to.to_string(),
    }
}

fn number(field: &'static str, value: f64, from: f64, to: f64) -> Result<(), ScopeError> {
    if (from..=to).contains(&value) {
        return Ok(());
    }
    Err(out_of_range(field, value, from, to))
}

impl TriggerRequest {
    /// The value of a field that this kind of trigger needs.
    fn need(&self, field: &'static str, value: Option<f64>) -> Result<f64, ScopeError> {
        let value = value.ok_or_else(|| ScopeError::Missing {
            on: self.on.word(),
            field,
            hint: "give a number in the unit of the probe",
        })?;
        number(field, value, f64::MIN, f64::MAX)?;
        Ok(value)
    }

    /// Level and hysteresis.
    pub(super) fn edge(&self) -> Result<(f64, f64), ScopeError> {
        let level = self.need("level", self.level)?;
        let hysteresis = self.hysteresis.unwrap_or(0.0);
        number("hysteresis", hysteresis, 0.0, f64::MAX)?;
        Ok((level, hysteresis))
    }

    /// Low and high.
    pub(super) fn window(&self) -> Result<(f64, f64), ScopeError> {
        let low = self.need("low", self.low)?;
        let high = self.need("high", self.high)?;
        number("high", high, low, f64::MAX)?;
        Ok((low, high))
    }

    fn check(&self) -> Result<(), ScopeError> {
        let missing = |field, hint| ScopeError::Missing {
            on: self.on.word(),
            field,
            hint,
        };
        let is_edge = matches!(self.on, TriggerKind::Rising | TriggerKind::Falling);
        if self.hysteresis.is_some() && !is_edge {
            return Err(ScopeError::Hysteresis { on: self.on.word() });
        }
        match self.on {
            TriggerKind::Above
            | TriggerKind::Below
            | TriggerKind::Rising
            | TriggerKind::Falling => {
                self.edge()?;
            }
            TriggerKind::Inside | TriggerKind::Outside => {
                self.window()?;
            }
            TriggerKind::State => {
                if self.equals.is_none() {
                    return Err(missing("equals", "give the name of a state"));
                }
            }
            TriggerKind::Fault | TriggerKind::Event => {}
            // By default the first net thread.
            TriggerKind::Overrun => return Ok(()),
        }
        if self.probe.is_none() {
            return Err(missing("probe", "give the name of a probe of `/probes/`"));
        }
        Ok(())
    }
}
