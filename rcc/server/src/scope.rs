//! `/scope`: one client of the scope, from its messages to frames. It moves no bytes and keeps no queue: what a slow client does not
//! take stays in the rings of the controller, which go on; samples that are lost there are counted in its stream.
//!
//! Messages and frames: the section "The scope" of the crate's README.

use std::time::Duration;

use serde_json::{Value, json};
use takt_core::Controller;
use takt_core::probe::{Frame, GroupInfo, ProbeError, Scope, ScopeError, ScopeEvent, ScopeRequest};
use tungstenite::protocol::frame::coding::{Data, OpCode};

use crate::websocket::write_frame;

/// Version of the messages.
const VERSION: u32 = 1;

/// Most clients of the scope at once.
pub const SCOPES_MAX: usize = 32;

/// Most bytes of a client's message.
pub(crate) const REQUEST_BYTES_MAX: usize = 64 << 10;

/// A client of the scope. `now` is the time since its connection was accepted.
#[derive(Debug)]
pub(crate) struct ScopeClient {
    controller: Controller,
    scope: Option<Scope>,
    /// Time between two frames.
    interval: Duration,
    due: Duration,
    /// Samples that it lost since [`Self::take_lost`].
    lost: u64,
}

impl ScopeClient {
    pub(crate) const fn new(controller: Controller) -> Self {
        Self {
            controller,
            scope: None,
            interval: Duration::ZERO,
            due: Duration::ZERO,
            lost: 0,
        }
    }

    /// Samples that it lost since the last call.
    pub(crate) const fn take_lost(&mut self) -> u64 {
        std::mem::replace(&mut self.lost, 0)
    }

    /// Whether nothing is sampled.
    pub(crate) const fn is_idle(&self) -> bool {
        self.scope.is_none()
    }

    /// When to poll; `None` while nothing is sampled.
    pub(crate) fn poll_timeout(&self) -> Option<Duration> {
        self.scope.as_ref().map(|_| self.due)
    }

    /// Handles a message, which replaces the scope; one that is refused leaves it as it is. Returns the bytes to send.
    pub(crate) fn handle_text(&mut self, text: &str, now: Duration) -> Vec<u8> {
        let mut out = Vec::new();
        let made = self.begin(text);
        let made = match made {
            // The samplers of the present scope may take the place of those of the new one.
            Ok((scope, _)) if !scope.rejected().is_empty() && self.scope.is_some() => {
                drop(scope);
                self.scope = None;
                self.begin(text)
            }
            made => made,
        };
        match made {
            Ok((scope, rate_hz)) => {
                write_text(&begun(&scope), &mut out);
                self.interval = Duration::from_secs_f64(1.0 / rate_hz);
                self.due = now + self.interval;
                self.scope = Some(scope);
            }
            Err(error) => write_text(&error, &mut out),
        }
        out
    }

    fn begin(&self, text: &str) -> Result<(Scope, f64), Value> {
        let request = parse(text).map_err(|why| {
            let hint = "send such as {\"probes\": [\"thread:nets.latency\"], \"rate_hz\": 30}";
            json!({"error": {"cause": format!("the message is no request: {why}"), "hint": hint}})
        })?;
        let scope = self.controller.scope(&request).map_err(|e| refused(&e))?;
        Ok((scope, request.rate_hz))
    }

    /// The bytes of what came since the last call.
    pub(crate) fn poll(&mut self, now: Duration) -> Vec<u8> {
        let mut out = Vec::new();
        // A client that reads slowly is not sent more often later.
        self.due = now + self.interval;
        let Some(scope) = &mut self.scope else {
            return out;
        };
        scope.read(now);
        while let Some(event) = scope.poll_event() {
            self.lost += match &event {
                ScopeEvent::Frame(frame) => frame.lost,
                ScopeEvent::Lost { samples, .. } => *samples,
                ScopeEvent::Triggered { .. } | ScopeEvent::Ended { .. } => 0,
            };
            write_event(&event, &mut out);
        }
        if scope.is_done() {
            self.scope = None;
            write_text(
                &json!({"done": {"cause": "mode single has its capture"}}),
                &mut out,
            );
        }
        out
    }
}

/// The request of a message.
fn parse(text: &str) -> Result<ScopeRequest, String> {
    if text.len() > REQUEST_BYTES_MAX {
        return Err(format!("it has more than {REQUEST_BYTES_MAX} bytes"));
    }
    serde_json::from_str(text).map_err(|error| error.to_string())
}

/// Feeds any bytes to the parser of requests, and checks what it accepts.
///
/// # Panics
/// If a request within its bounds has numbers beyond them.
#[doc(hidden)]
pub fn fuzz(data: &[u8]) {
    let text = String::from_utf8_lossy(data);
    if let Ok(request) = parse(&text)
        && request.check().is_ok()
    {
        assert!((0.1..=100.0).contains(&request.rate_hz), "{request:?}");
        assert!((1..=64).contains(&request.probes.len()), "{request:?}");
    }
}

fn refused(error: &ScopeError) -> Value {
    let text = error.to_string();
    let (cause, hint) = text.split_once("\nhint: ").unwrap_or((&text, ""));
    json!({"error": {"cause": cause, "hint": hint}})
}

/// The first answer: the groups, whose numbers are those of frames.
fn begun(scope: &Scope) -> Value {
    let group = |info: &GroupInfo| {
        let probes = info.probes.iter().map(|(name, unit, states)| {
            let mut probe = json!({"name": name, "unit": unit});
            if !states.is_empty()
                && let Value::Object(probe) = &mut probe
            {
                probe.insert("states".to_owned(), json!(&states[..]));
            }
            probe
        });
        json!({
            "thread": info.thread,
            "period_s": info.period.as_secs_f64(),
            "probes": probes.collect::<Vec<_>>(),
        })
    };
    let rejected = |error: &ProbeError| json!({"probe": error.probe, "cause": error.cause, "hint": error.hint});
    json!({"scope": {
        "version": VERSION,
        "groups": scope.groups().iter().map(group).collect::<Vec<_>>(),
        "rejected": scope.rejected().iter().map(rejected).collect::<Vec<_>>(),
    }})
}

fn write_text(message: &Value, out: &mut Vec<u8>) {
    write_frame(
        OpCode::Data(Data::Text),
        message.to_string().as_bytes(),
        out,
    );
}

fn write_event(event: &ScopeEvent, out: &mut Vec<u8>) {
    let message = match event {
        ScopeEvent::Frame(frame) => {
            return write_frame(OpCode::Data(Data::Binary), &encode(frame), out);
        }
        ScopeEvent::Triggered { time_s, cause } => {
            json!({"triggered": {"time_s": time_s, "cause": cause}})
        }
        ScopeEvent::Ended { probe, cause } => json!({"ended": {"probe": probe, "cause": cause}}),
        ScopeEvent::Lost { group, samples } => {
            json!({"lost": {"group": group, "samples": samples}})
        }
    };
    write_text(&message, out);
}

/// A frame: group, rows, columns and lost samples as u32, then the rows, all little-endian.
fn encode(frame: &Frame) -> Vec<u8> {
    let number = |number: usize| u32::try_from(number).unwrap_or(u32::MAX).to_le_bytes();
    let lost = u32::try_from(frame.lost).unwrap_or(u32::MAX);
    let mut bytes = Vec::with_capacity(16 + frame.values.len() * size_of::<f64>());
    bytes.extend(number(frame.group));
    bytes.extend(number(frame.rows()));
    bytes.extend(number(frame.columns));
    bytes.extend(lost.to_le_bytes());
    bytes.extend(frame.values.iter().flat_map(|value| value.to_le_bytes()));
    bytes
}

#[cfg(test)]
mod tests;
