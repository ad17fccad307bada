//! Samples of probes as JSON in UDP datagrams, one for each cycle: `{"timestamp":12.345,"left.joint.1.measured":0.5}`. The time
//! is in s since the controller's start. A datagram fits a frame of Ethernet; it is sent once, and nothing is listened for.

use std::fmt::Write as _;
use std::net::{SocketAddr, UdpSocket};
use std::sync::Arc;
use std::time::{Duration, Instant};

use takt_core::Controller;
use takt_core::probe::{Scope, ScopeEvent, ScopeRequest};

use crate::error::Error;
use crate::live::drain::{Loss, Task};
use crate::site::Counters;

/// Most bytes of a datagram: an Ethernet frame without the heads of IPv6 and UDP.
const BYTES_MAX: usize = 1452;
/// Time after which probes that did not exist are tried again.
const RETRY: Duration = Duration::from_secs(1);

/// Sends the samples of some probes.
#[derive(Debug)]
pub(crate) struct Datagrams {
    controller: Controller,
    socket: UdpSocket,
    to: SocketAddr,
    request: ScopeRequest,
    scope: Option<Scope>,
    /// When the scope was made, or tried.
    tried: Option<Instant>,
    begin: Instant,
    /// Whether it is incomplete: some probes do not exist yet.
    is_incomplete: bool,
    /// Whether a probe of the scope ended.
    has_ended: bool,
    counters: Arc<Counters>,
    failed: Loss,
    lost: Loss,
    last_error: Option<String>,
}

impl Datagrams {
    /// Binds a socket.
    pub(crate) fn new(
        controller: Controller,
        to: SocketAddr,
        (probes, every): (&[String], u64),
        counters: Arc<Counters>,
    ) -> Result<Self, Error> {
        let any: SocketAddr = if to.is_ipv4() {
            ([0, 0, 0, 0], 0).into()
        } else {
            ([0_u16; 8], 0).into()
        };
        let bound = UdpSocket::bind(any).and_then(|socket| {
            socket.set_nonblocking(true)?;
            Ok(socket)
        });
        let socket = bound.map_err(|source| Error::Listen {
            address: any,
            source,
        })?;
        let names: Vec<_> = probes.iter().map(String::as_str).collect();
        let request = ScopeRequest {
            every: every.max(1),
            ..ScopeRequest::of(&names)
        };
        Ok(Self {
            controller,
            socket,
            to,
            request,
            scope: None,
            tried: None,
            begin: Instant::now(),
            is_incomplete: true,
            has_ended: false,
            counters,
            failed: Loss::default(),
            lost: Loss::default(),
            last_error: None,
        })
    }

    /// Sends the samples since the last call.
    fn send_samples(&mut self, now: Instant) {
        let is_due = self
            .tried
            .is_none_or(|tried| now.saturating_duration_since(tried) >= RETRY);
        if self.is_incomplete && is_due {
            self.tried = Some(now);
            self.begin_scope();
        }
        let Some(mut scope) = self.scope.take() else {
            return;
        };
        scope.read(now.saturating_duration_since(self.begin));
        while let Some(event) = scope.poll_event() {
            match event {
                ScopeEvent::Frame(frame) => {
                    self.note_loss(frame.lost, now);
                    let names = scope.groups().get(frame.group);
                    for (time, values) in frame.iter() {
                        let names = names.iter().flat_map(|group| &group.probes);
                        let pairs = names
                            .map(|probe| probe.0.as_str())
                            .zip(values.iter().copied());
                        for datagram in datagrams(time, pairs) {
                            self.send(datagram.as_bytes(), now);
                        }
                    }
                }
                // A net that ended may be loaded again.
                ScopeEvent::Ended { .. } => (self.is_incomplete, self.has_ended) = (true, true),
                ScopeEvent::Lost { samples, .. } => self.note_loss(samples, now),
                ScopeEvent::Triggered { .. } => {}
            }
        }
        self.scope = Some(scope);
    }

    fn note_loss(&mut self, samples: u64, now: Instant) {
        Counters::add(&self.counters.datagrams_lost, samples);
        if self.lost.add(samples, now) {
            tracing::warn!(
                "live data: {samples} samples are missing in datagrams: this host stalled; {} in all",
                self.lost.total
            );
        }
    }

    /// Begins a scope of all probes that exist by now; one that has no more than the present one does not replace it.
    fn begin_scope(&mut self) {
        let made = self.controller.scope(&self.request);
        let (scope, error) = match made {
            Ok(scope) => {
                let rejected = scope.rejected().first();
                let error =
                    rejected.map(|it| format!("{}: {}\nhint: {}", it.probe, it.cause, it.hint));
                (Some(scope), error)
            }
            Err(error) => (None, Some(error.to_string())),
        };
        self.is_incomplete = error.is_some();
        if let Some(error) = &error
            && Some(error) != self.last_error.as_ref()
        {
            tracing::warn!("live data: no datagrams of a probe: {error}");
        }
        self.last_error = error;
        let names = |scope: &Scope| -> Vec<String> {
            let rejected = scope.rejected().iter();
            rejected.map(|it| it.probe.clone()).collect()
        };
        let same = self.scope.as_ref().map(names) == scope.as_ref().map(names);
        if !same || self.has_ended {
            self.scope = scope;
            self.has_ended = false;
        }
    }

    fn send(&mut self, datagram: &[u8], now: Instant) {
        let Err(error) = self.socket.send_to(datagram, self.to) else {
            return;
        };
        Counters::add(&self.counters.datagrams_failed, 1);
        if self.failed.add(1, now) {
            tracing::warn!(
                "live data: cannot send a datagram to {}: {error}; {} failed in all\nhint: check udp under [live] of cell.toml, and \
                 that a program listens there",
                self.to,
                self.failed.total
            );
        }
    }
}

impl Task for Datagrams {
    fn poll(&mut self, now: Instant) {
        self.send_samples(now);
    }
}

/// A sample as datagrams, each with the time; values that are not finite are left out.
fn datagrams<'a>(time: f64, values: impl Iterator<Item = (&'a str, f64)>) -> Vec<String> {
    let begin = format!("{{\"timestamp\":{time:.9}");
    let (mut all, mut text) = (Vec::new(), begin.clone());
    for (name, value) in values.filter(|(_, value)| value.is_finite()) {
        let before = text.len();
        // Formatting into a string cannot fail.
        let _ = write!(text, ",{}:{value}", serde_json::Value::from(name));
        if text.len() >= BYTES_MAX && before > begin.len() {
            let pair = text.split_off(before);
            text.push('}');
            all.push(std::mem::replace(&mut text, begin.clone()));
            text.push_str(&pair);
        }
    }
    if text.len() > begin.len() {
        text.push('}');
        all.push(text);
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn datagram_is_json_with_its_time() {
        let values = [("a", 1.5), ("b.\"x", -2.0), ("c", f64::NAN)];
        let all = datagrams(12.25, values.into_iter());
        assert_eq!(
            all,
            ["{\"timestamp\":12.250000000,\"a\":1.5,\"b.\\\"x\":-2}"]
        );
        assert!(datagrams(1.0, [("a", f64::NAN)].into_iter()).is_empty());
    }

    #[test]
    fn sample_too_long_is_several_datagrams() {
        let names: Vec<_> = (0..64).map(|n| format!("{n}{}", "x".repeat(254))).collect();
        let all = datagrams(1.0, names.iter().map(|name| (name.as_str(), 0.1)));
        assert!(all.len() > 8, "{}", all.len());
        let mut found = 0;
        for datagram in &all {
            assert!(datagram.len() <= BYTES_MAX, "{}", datagram.len());
            let json: serde_json::Value = serde_json::from_str(datagram).unwrap();
            assert_eq!(json["timestamp"], 1.0);
            found += json.as_object().unwrap().len() - 1;
        }
        assert_eq!(found, 64);
    }
}
