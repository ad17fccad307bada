//! Measurements and answers out of decoded datagrams, so that a recording is judged as a live connection is. It opens no
//! file.

use super::{Measurement, Observer};
use crate::capture::{Datagram, Decoded};
use crate::lwr::wire::{Msr, Quality as LwrQuality};
use crate::sunrise::wire::{Monitoring, Quality};
use std::time::Duration;

/// Resolution of an f32 of seconds: the stamps of FRI 1.0 are useless when it is coarser than a tenth of the period.
fn stamp(msr: &Msr, period: Duration) -> Option<Duration> {
    let seconds = msr.interface.timestamp_s;
    let step = seconds * f32::EPSILON;
    (seconds >= 0.0 && step < period.as_secs_f32() / 10.0)
        .then(|| Duration::try_from_secs_f32(seconds).ok())?
}

fn of_lwr(at: Duration, msr: &Msr) -> Measurement {
    let period = Duration::try_from_secs_f32(msr.interface.msr_period_s).unwrap_or_default();
    Measurement {
        at,
        sequence: msr.header.sequence.into(),
        stamp: stamp(msr, period),
        period,
        is_due: true,
        answer_rate: Some(msr.statistics.answer_rate.into()),
        is_good: msr.interface.quality.code() >= LwrQuality::Bad.code(),
    }
}

fn of_sunrise(at: Duration, message: &Monitoring) -> Measurement {
    let stamp = message.monitor.and_then(|data| data.stamp);
    let connection = message.connection;
    let period_ms = connection.and_then(|it| it.send_period_ms).unwrap_or(0);
    let times = connection.and_then(|it| it.receive_multiplier).unwrap_or(1);
    Measurement {
        at,
        sequence: message.header.sequence,
        stamp: stamp.map(|it| {
            Duration::from_secs(it.seconds.into()) + Duration::from_nanos(it.nanoseconds.into())
        }),
        period: Duration::from_millis(period_ms.into()),
        is_due: times <= 1,
        answer_rate: None,
        is_good: message.quality().code() >= Quality::Good.code(),
    }
}

impl Observer {
    /// For the generation of a recording's first FRI datagram; `None` if it is none.
    #[must_use]
    pub fn of(decoded: &Decoded) -> Option<Self> {
        match decoded {
            Decoded::LwrMeasurement(_) | Decoded::LwrCommand(_) => Some(Self::lwr()),
            Decoded::SunriseMonitoring { .. } | Decoded::SunriseCommand { .. } => {
                Some(Self::sunrise())
            }
            Decoded::Foreign { .. } | Decoded::Refused(_) => None,
        }
    }

    /// Takes a datagram of a recording made at this host: measurements when they come, answers when they leave.
    pub fn handle_datagram(&mut self, datagram: &Datagram) {
        match Decoded::of(&datagram.bytes) {
            Decoded::LwrMeasurement(msr) => self.handle_measurement(of_lwr(datagram.at, &msr)),
            Decoded::SunriseMonitoring { message, .. } => {
                self.handle_measurement(of_sunrise(datagram.at, &message));
            }
            Decoded::LwrCommand(_) | Decoded::SunriseCommand { .. } => {
                self.handle_answer(datagram.at);
            }
            Decoded::Foreign { .. } | Decoded::Refused(_) => {}
        }
    }
}
