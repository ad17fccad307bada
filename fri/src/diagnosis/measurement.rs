//! Converts measurements of both generations to the common type of the diagnosis. It decodes nothing.

use super::Measurement;
use crate::lwr::stated_period;
use crate::lwr::wire::{Msr, Quality as LwrQuality};
use crate::sunrise::PERIOD_MS;
use crate::sunrise::wire::{Monitoring, Quality};
use std::time::Duration;

/// Time stamp of FRI 1.0, if the resolution of its f32 seconds is finer than a tenth of the period.
fn stamp(msr: &Msr, period: Duration) -> Option<Duration> {
    let seconds = msr.interface.timestamp_s;
    let step = seconds * f32::EPSILON;
    (seconds >= 0.0 && step < period.as_secs_f32() / 10.0)
        .then(|| Duration::try_from_secs_f32(seconds).ok())?
}

impl Measurement {
    /// Converts a measurement of FRI 1.0.
    pub fn lwr(at: Duration, msr: &Msr) -> Self {
        let period = stated_period(msr);
        Self {
            at,
            sequence: msr.header.sequence.into(),
            reflected: msr.header.reflected.into(),
            stamp: stamp(msr, period),
            period,
            answer_every: 1,
            answer_rate: Some(msr.statistics.answer_rate.into()),
            is_good: msr.interface.quality.code() >= LwrQuality::Bad.code(),
        }
    }

    /// Converts a message of Sunrise.
    pub fn sunrise(at: Duration, message: &Monitoring) -> Self {
        let stamp = message.monitor.and_then(|data| data.stamp);
        let connection = message.connection;
        let period_ms = connection.and_then(|it| it.send_period_ms);
        let period_ms = period_ms.map_or(0, |ms| ms.clamp(*PERIOD_MS.start(), *PERIOD_MS.end()));
        let times = connection.and_then(|it| it.receive_multiplier).unwrap_or(1);
        Self {
            at,
            sequence: message.header.sequence,
            reflected: message.header.reflected,
            stamp: stamp.map(|it| {
                Duration::from_secs(it.seconds.into()) + Duration::from_nanos(it.nanoseconds.into())
            }),
            period: Duration::from_millis(period_ms.into()),
            answer_every: times.max(1),
            answer_rate: None,
            is_good: message.quality().code() >= Quality::Good.code(),
        }
    }
}
