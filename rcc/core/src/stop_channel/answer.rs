//! Responses of the stop channel, written to a buffer of fixed size: a JSON object with source and time of the stop and
//! the answers of all net threads. Nothing here allocates.

use std::fmt::{self, Write};

use takt_rt::Nanos;

use super::switch::StopSwitch;

/// Bytes of a response body; eight threads take about half of it.
const BODY_BYTES: usize = 2048;
/// Bytes of a complete response.
const ANSWER_BYTES: usize = BODY_BYTES + 512;

/// Text in a buffer of fixed size; it is truncated if it does not fit.
#[derive(Debug)]
pub(super) struct Text<const N: usize> {
    bytes: [u8; N],
    length: usize,
}

impl<const N: usize> Text<N> {
    const fn new() -> Self {
        Self {
            bytes: [0; N],
            length: 0,
        }
    }

    pub(super) fn as_bytes(&self) -> &[u8] {
        self.bytes.get(..self.length).unwrap_or_default()
    }
}

impl<const N: usize> Write for Text<N> {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        let room = self.bytes.get_mut(self.length..).unwrap_or_default();
        let bytes = text.as_bytes();
        let taken = bytes.len().min(room.len());
        if let (Some(to), Some(from)) = (room.get_mut(..taken), bytes.get(..taken)) {
            to.copy_from_slice(from);
        }
        self.length += taken;
        if taken == bytes.len() {
            Ok(())
        } else {
            Err(fmt::Error)
        }
    }
}

/// A complete response.
pub(super) type Answer = Text<ANSWER_BYTES>;

/// The outcome of a request.
#[derive(Clone, Copy, Debug)]
pub(super) struct Done {
    /// Whether this request changed the state.
    pub(super) changed: bool,
    /// When it had been received.
    pub(super) received: Nanos,
    /// How long the channel waited for net threads.
    pub(super) waited: Nanos,
}

/// The state of the controller after a request. `page` is the origin of the requesting page, if any.
pub(super) fn of_state(switch: &StopSwitch, done: Done, page: Option<&str>) -> Answer {
    let mut body = Text::<BODY_BYTES>::new();
    // Eight threads at most always fit.
    let _ = write_state(&mut body, switch, done);
    http("200 OK", page, &body)
}

fn write_state(body: &mut impl Write, switch: &StopSwitch, done: Done) -> fmt::Result {
    let stopped = switch.is_stopped();
    let complete = switch.answers().all(|answer| answer.is_applied);
    write!(
        body,
        "{{\"stopped\":{stopped},\"changed\":{},\"complete\":{complete},\"received_ns\":{},\"waited_ns\":{}",
        done.changed, done.received.0, done.waited.0
    )?;
    if let Some((origin, since)) = switch.last_stop().filter(|_| stopped) {
        let for_ns = takt_rt::monotonic() - since;
        write!(
            body,
            ",\"by\":\"{origin}\",\"since_ns\":{},\"stopped_for_ns\":{}",
            since.0, for_ns.0
        )?;
    }
    body.write_str(",\"threads\":[")?;
    for (number, answer) in switch.answers().enumerate() {
        let comma = if number > 0 { "," } else { "" };
        write!(
            body,
            "{comma}{{\"period_ns\":{},\"answered\":{},\"nets\":{},\"withdrawn_at_ns\":{}}}",
            answer.period.0, answer.is_applied, answer.nets, answer.at.0
        )?;
    }
    body.write_str("]}\n")
}

/// The response to a rejected request, with the reason.
pub(super) fn refusal(status: &str, why: &str) -> Answer {
    let mut body = Text::<BODY_BYTES>::new();
    let _ = writeln!(body, "{{\"error\":\"{why}\"}}");
    http(status, None, &body)
}

fn http(status: &str, page: Option<&str>, body: &Text<BODY_BYTES>) -> Answer {
    let mut answer = Answer::new();
    let body = body.as_bytes();
    let _ = write!(
        answer,
        "HTTP/1.1 {status}\r\nContent-Type: application/json\r\nContent-Length: {}\r\n\
         Cache-Control: no-store\r\nConnection: close\r\n",
        body.len()
    );
    // Only that page may read it. It was checked to be of this host, and is shorter than a request.
    if let Some(page) = page.filter(|page| page.len() < 256) {
        let _ = write!(answer, "Access-Control-Allow-Origin: {page}\r\n");
    }
    let _ = answer.write_str("\r\n");
    let _ = answer.write_str(std::str::from_utf8(body).unwrap_or_default());
    answer
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cell::THREADS_MAX;
    use crate::stop_channel::Origin;

    #[test]
    fn longest_stop_response_fits() {
        let switch = StopSwitch::default();
        let most = Nanos(i64::MAX);
        for thread in 0..THREADS_MAX {
            switch.register(thread, most);
        }
        switch.stop(Origin::Network(
            "[2001:db8:ffff:ffff:ffff:ffff:ffff:ffff]:65535"
                .parse()
                .unwrap(),
        ));
        for thread in 0..THREADS_MAX {
            switch.answer(thread, switch.generation(), u32::MAX, most);
        }
        let done = Done {
            changed: false,
            received: most,
            waited: most,
        };
        let page = format!("http://{}", "h".repeat(240));
        let answer = of_state(&switch, done, Some(&page));
        let text = std::str::from_utf8(answer.as_bytes()).unwrap();
        let (head, body) = text.split_once("\r\n\r\n").unwrap();
        assert!(head.contains(&page), "{head}");
        let body: serde_json::Value = serde_json::from_str(body).unwrap();
        assert_eq!(body["stopped"], true);
        assert_eq!(body["complete"], true);
        assert_eq!(body["threads"].as_array().unwrap().len(), THREADS_MAX);
        assert!(body["by"].as_str().unwrap().ends_with("]:65535"));
    }
}
