//! Replays the transcripts in this directory against a real server over loopback sockets and
//! compares line by line. `transcripts/README.md` describes the format.

#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "tests and their helpers fail by panicking"
)]

mod common;
#[path = "common/replay.rs"]
mod replay;

use replay::{Transport, fits, replay};

#[test]
fn handshake_of_the_known_client() {
    let text = include_str!("transcripts/websocket.txt");
    replay("websocket.txt", text, Transport::WebSocket, None);
}

#[test]
fn exchanges_over_websocket() {
    let text = include_str!("transcripts/exchanges.txt");
    replay("exchanges.txt", text, Transport::WebSocket, None);
}

#[test]
fn exchanges_over_plain_tcp() {
    let text = include_str!("transcripts/exchanges.txt");
    replay("exchanges.txt", text, Transport::Tcp, None);
}

#[test]
fn pace_over_websocket() {
    let text = include_str!("transcripts/pace.txt");
    replay("pace.txt", text, Transport::WebSocket, None);
}

#[test]
fn pace_over_plain_tcp() {
    let text = include_str!("transcripts/pace.txt");
    replay("pace.txt", text, Transport::Tcp, None);
}

#[test]
fn resources_over_http() {
    let text = include_str!("transcripts/http.txt");
    replay("http.txt", text, Transport::Tcp, None);
}

#[test]
fn tokens_over_every_transport() {
    let text = include_str!("transcripts/token.txt");
    replay("token.txt", text, Transport::Tcp, Some("0123456789abcdef"));
}

#[test]
fn patterns_match_as_documented() {
    assert!(fits("a=<number>!", "a=-1.5e-3!"));
    assert!(!fits("a=<number>!", "a=!"));
    assert!(!fits("a=<number>", "a=1x"));
    assert!(fits("a[?,b:<number>?]}", "a}") && fits("a[?,b:<number>?]}", "a,b:2}"));
    assert!(!fits("a[?,b?]}", "a,c}"));
    assert!(fits("<text>c", "abc") && fits("<text>", "") && !fits("<text>c", "ab"));
}
