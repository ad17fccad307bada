//! `/nets/<n>/debug` and `/nets/<n>/debugstream`: records of the debug taps of a net, one line per cycle. Recording
//! starts with the first request, which waits only briefly for records.

use std::time::{Duration, Instant};

use serde_json::json;
use takt_core::controller::{NetState, Taps};
use takt_core::{Controller, NetId};

use super::super::element::of_value;
use super::super::{Request, Response};
use super::{Handler, Outcome};

/// Most concurrent debug streams.
pub(crate) const DEBUG_STREAMS_MAX: usize = 8;

/// How long the first request waits for the first record of a running net.
const FIRST_RECORD_TIMEOUT: Duration = Duration::from_millis(200);

/// Polling interval meanwhile.
const POLL_INTERVAL: Duration = Duration::from_millis(5);

impl Handler<'_> {
    /// The records as tab-separated lines, or as JSON.
    pub(super) fn debug(&self, name: &str) -> Outcome {
        let (id, _) = self.find_net(name)?;
        let until = Instant::now() + FIRST_RECORD_TIMEOUT;
        let mut taps = read_taps(self.controller, id, 0)?;
        while taps.records.is_empty()
            && !taps.taps.is_empty()
            && runs(self.controller, id)
            && Instant::now() < until
        {
            std::thread::sleep(POLL_INTERVAL);
            taps = read_taps(self.controller, id, 0)?;
        }
        if self.request.json {
            return Ok(Response::of_kind("application/json", in_json(&taps)));
        }
        let text = header(&taps) + &lines(&taps);
        let kind = "text/tab-separated-values; charset=utf-8";
        Ok(Response::of_kind(kind, text))
    }
}

fn read_taps(controller: &Controller, id: NetId, from: u64) -> Result<Taps, Response> {
    let taps = controller.taps(id, from).map_err(Response::too_many)?;
    taps.ok_or_else(|| Response::conflict("the net is not ready and records nothing"))
}

fn runs(controller: &Controller, id: NetId) -> bool {
    let runs = |state| matches!(state, NetState::Running | NetState::Cancelling);
    controller.net(id).is_some_and(|net| runs(net.state()))
}

/// Column names: logical time in s, then the tapped ports.
fn header(taps: &Taps) -> String {
    let names = taps.taps.iter().map(|tap| format!("\t{}", tap.name));
    let names: String = names.collect();
    format!("time{names}\n")
}

/// One line per record; null is an empty field.
fn lines(taps: &Taps) -> String {
    let mut out = String::new();
    for record in &taps.records {
        out.push_str(&seconds(record.time().0));
        for tap in taps.taps.iter() {
            out.push('\t');
            out.push_str(&record.text(tap).unwrap_or_default());
        }
        out.push('\n');
    }
    out
}

/// Nanoseconds as seconds, exactly.
fn seconds(ns: i64) -> String {
    let (sign, ns) = (if ns < 0 { "-" } else { "" }, ns.unsigned_abs());
    format!("{sign}{}.{:09}", ns / 1_000_000_000, ns % 1_000_000_000)
}

fn in_json(taps: &Taps) -> String {
    let time = taps.records.iter().map(|record| record.time().0);
    let ports = taps.taps.iter().map(|tap| {
        let values = taps.records.iter().map(|record| record.text(tap));
        let values = values.map(|text| text.map(|text| of_value(&text)));
        json!({
            "name": tap.name,
            "type": tap.ty.to_string(),
            "values": values.collect::<Vec<_>>(),
        })
    });
    let ports: Vec<_> = ports.collect();
    json!({"time_ns": time.collect::<Vec<_>>(), "ports": ports}).to_string()
}

/// The live records of a net's taps for one client.
#[derive(Debug)]
pub(crate) struct DebugStream {
    controller: Controller,
    net: NetId,
    /// Number of the next record to send.
    next: u64,
    header_sent: bool,
    done: bool,
}

impl DebugStream {
    /// Head of the response.
    pub(crate) const HEAD: &str = "HTTP/1.1 200 OK\r\n\
        Content-Type: text/tab-separated-values; charset=utf-8\r\nTransfer-Encoding: chunked\r\n\
        Cache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\nConnection: close\r\n\r\n";

    /// The stream that a request asks for; `None` for other requests.
    pub(crate) fn from_request(
        controller: &Controller,
        request: &Request,
    ) -> Option<Result<Self, Response>> {
        let path: Vec<_> = request.path.iter().map(String::as_str).collect();
        let ["nets", name, "debugstream"] = *path.as_slice() else {
            return None;
        };
        if request.post || request.is_head {
            let refused = Response::text("405 Method Not Allowed", "Use GET.\n");
            return Some(Err(if request.is_head {
                refused.without_body()
            } else {
                refused
            }));
        }
        let net: Option<NetId> = name.parse().ok();
        let Some(net) = net.filter(|net| controller.net(*net).is_some()) else {
            return Some(Err(Response::not_found("there is no such net")));
        };
        Some(read_taps(controller, net, u64::MAX).map(|_| Self {
            controller: controller.clone(),
            net,
            next: 0,
            header_sent: false,
            done: false,
        }))
    }

    /// The response when the bound on streams is reached.
    pub(crate) fn too_many() -> Response {
        let why =
            format!("at most {DEBUG_STREAMS_MAX} debug streams are served at once; close one");
        Response::too_many(why)
    }

    /// The records since the last chunk; `None` once the net has ended and everything was sent. The first chunk begins
    /// with the column names.
    pub(crate) fn poll(&mut self) -> Option<String> {
        if self.done {
            return None;
        }
        let state = self.controller.net(self.net).map(|net| net.state());
        let ended = matches!(
            state,
            None | Some(NetState::Terminated | NetState::Unloaded)
        );
        let Ok(Some(taps)) = self.controller.taps(self.net, self.next) else {
            return None;
        };
        self.done = ended;
        let mut chunk = String::new();
        if !std::mem::replace(&mut self.header_sent, true) {
            chunk = header(&taps);
        }
        chunk.push_str(&lines(&taps));
        if let Some(last) = taps.records.last() {
            self.next = last.number + 1;
        }
        Some(chunk)
    }
}

#[cfg(test)]
mod tests {
    use super::seconds;

    #[test]
    fn times_are_exact() {
        for (ns, text) in [
            (0, "0.000000000"),
            (1_500_000_000, "1.500000000"),
            (-1, "-0.000000001"),
            (i64::MAX, "9223372036.854775807"),
            (i64::MIN, "-9223372036.854775808"),
        ] {
            assert_eq!(seconds(ns), text);
        }
    }
}
