//! The scope over real sockets: admission, a stream, and clients that misbehave beside one that does not.

#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

mod common;

use std::net::TcpStream;
use std::time::Duration;

use common::TestServer;
use serde_json::{Value, json};
use takt_client::Token;
use takt_server::{Loopback, ServerConfig};
use tungstenite::client::IntoClientRequest as _;
use tungstenite::http::HeaderValue;
use tungstenite::{Error, Message, WebSocket};

const TOKEN: &str = "0123456789abcdef";

type Socket = WebSocket<TcpStream>;

/// A socket, or the status with which the server refused it.
fn connect(
    server: &TestServer,
    query: &str,
    header: Option<(&'static str, &str)>,
) -> Result<Socket, u16> {
    let mut request = format!("ws://{}/scope{query}", server.http)
        .into_client_request()
        .unwrap();
    if let Some((name, value)) = header {
        let value = HeaderValue::from_str(value).unwrap();
        request.headers_mut().insert(name, value);
    }
    let stream = TcpStream::connect(server.http).unwrap();
    stream
        .set_read_timeout(Some(Duration::from_secs(20)))
        .unwrap();
    match tungstenite::client(request, stream) {
        Ok((socket, _)) => Ok(socket),
        Err(tungstenite::HandshakeError::Failure(Error::Http(response))) => {
            Err(response.status().as_u16())
        }
        Err(other) => {
            assert!(
                matches!(other, tungstenite::HandshakeError::Interrupted(_)),
                "{other}"
            );
            Err(0)
        }
    }
}

fn ask(socket: &mut Socket, request: &Value) {
    socket.send(Message::text(request.to_string())).unwrap();
}

/// The next text message.
fn text(socket: &mut Socket) -> Value {
    loop {
        if let Message::Text(text) = socket.read().unwrap() {
            return serde_json::from_str(&text).unwrap();
        }
    }
}

/// Group, rows, columns and lost of the next frame, and the times of its rows.
fn frame(socket: &mut Socket) -> ([u32; 4], Vec<f64>) {
    loop {
        let Message::Binary(bytes) = socket.read().unwrap() else {
            continue;
        };
        let (head, rows) = bytes.split_at(16);
        let mut head = head.chunks_exact(4);
        let head = [0; 4].map(|_| u32::from_le_bytes(head.next().unwrap().try_into().unwrap()));
        let width = 8 * (head[2] as usize + 1);
        assert_eq!(rows.len(), width * head[1] as usize);
        let times = rows.chunks_exact(width);
        let times = times.map(|row| f64::from_le_bytes(row[..8].try_into().unwrap()));
        return (head, times.collect());
    }
}

fn latency() -> Value {
    json!({ "probes": ["thread:nets.latency", "thread:nets.execution"] })
}

#[test]
fn scope_streams_every_cycle_to_two_clients() {
    let server = TestServer::start_with(ServerConfig::default());
    let mut clients = [0; 2].map(|_| connect(&server, "", None).unwrap());
    for client in &mut clients {
        ask(client, &latency());
        let begun = text(client);
        assert_eq!(begun["scope"]["version"], 1);
        let probes = begun["scope"]["groups"][0]["probes"].as_array().unwrap();
        assert_eq!(probes[0]["unit"], "s");
    }
    for client in &mut clients {
        let mut times: Vec<f64> = Vec::new();
        while times.len() < 500 {
            let (head, rows) = frame(client);
            assert_eq!((head[0], head[2], head[3]), (0, 2, 0));
            times.extend(rows);
        }
        let mut steps = times.windows(2).map(|pair| pair[1] - pair[0]);
        assert!(steps.all(|step| step > 0.0), "in order");
    }
}

#[test]
fn scope_needs_token_and_own_origin() {
    let token = Token::new(TOKEN).unwrap();
    let server = TestServer::start_with(ServerConfig {
        token: Some(token),
        loopback: Some(Loopback::Token),
        ..ServerConfig::default()
    });
    assert_eq!(connect(&server, "", None).err(), Some(401));
    assert_eq!(connect(&server, "?token=wrong", None).err(), Some(401));
    let bearer = format!("Bearer {TOKEN}");
    let mut client = connect(&server, "", Some(("Authorization", &bearer))).unwrap();
    ask(&mut client, &latency());
    assert_eq!(text(&mut client)["scope"]["rejected"], json!([]));
    let query = format!("?token={TOKEN}");
    let foreign = connect(&server, &query, Some(("Origin", "http://evil.example")));
    assert_eq!(foreign.err(), Some(403));
}

#[test]
fn scope_client_with_bad_messages_disturbs_no_other() {
    let server = TestServer::start_with(ServerConfig::default());
    let mut good = connect(&server, "", None).unwrap();
    ask(&mut good, &latency());
    assert!(text(&mut good)["scope"].is_object());
    let mut bad = connect(&server, "", None).unwrap();
    let deep = format!("{}{}", "[".repeat(5000), "]".repeat(5000));
    for message in [
        "",
        "{",
        "null",
        "[]",
        r#"{"probes":[]}"#,
        r#"{"probes":[7]}"#,
        &deep,
    ] {
        bad.send(Message::text(message)).unwrap();
        let error = text(&mut bad);
        assert!(error["error"]["cause"].is_string(), "{message}: {error}");
    }
    ask(&mut bad, &json!({ "probes": ["thread:nets.latencies"] }));
    let rejected = text(&mut bad)["scope"]["rejected"][0].clone();
    let hint = rejected["hint"].as_str().unwrap();
    assert!(hint.contains("thread:nets.latency"), "{rejected}");
    // Larger than any request: the connection ends, and no other.
    let _ = bad.send(Message::text("x".repeat(1 << 20)));
    while bad.read().is_ok() {}
    let before = frame(&mut good).1;
    assert!(frame(&mut good).1[0] > before[0]);
}
