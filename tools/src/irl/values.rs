//! Values of signals, as options and requests give them.

use anyhow::Context as _;
use takt_irl::{Program, Signal, SignalKind};

/// Splits `name=value`.
pub(super) fn assignment<'t>(text: &'t str, form: &str) -> anyhow::Result<(&'t str, &'t str)> {
    let parts = text.split_once('=');
    parts.with_context(|| format!("`{text}` is not {form}"))
}

/// The number of a signal.
pub(super) fn signal_of(program: &Program, name: &str) -> anyhow::Result<usize> {
    let signals = &program.system.signals;
    let found = signals
        .iter()
        .position(|s| s.name.eq_ignore_ascii_case(name));
    found.with_context(|| {
        let known: Vec<_> = signals.iter().map(|s| s.name.as_str()).collect();
        let known = if known.is_empty() {
            "it has none".to_owned()
        } else {
            format!("its signals are {}", known.join(", "))
        };
        format!("the program has no signal `{name}`\nhint: {known}")
    })
}

/// A value of a signal as texts of nets have it.
pub(super) fn value_of(signal: &Signal, text: &str) -> anyhow::Result<String> {
    let whole = || {
        let number = text.parse::<i32>().ok();
        let fits = |number: &i32| signal.bits == 0 || i64::from(*number) >> signal.bits == 0;
        number.filter(fits).map(|number| number.to_string())
    };
    let real = || text.parse::<f64>().ok().filter(|number| number.is_finite());
    let (value, wanted) = match (signal.kind, text) {
        (SignalKind::Digital, "1" | "true") => (Some("true".to_owned()), ""),
        (SignalKind::Digital, "0" | "false") => (Some("false".to_owned()), ""),
        (SignalKind::Digital, _) => (None, "0 or 1"),
        (SignalKind::Analog, _) => (real().map(|number| number.to_string()), "a number"),
        (SignalKind::Binary, _) => (whole(), "a whole number within its bits"),
    };
    value.with_context(|| {
        format!(
            "`{text}` is not a value of signal `{}`: give {wanted}",
            signal.name
        )
    })
}
