//! The scope over real sockets: admission, a stream, and clients that misbehave beside one that does not.

#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

mod common;

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use common::TestServer;
use nix::sys::socket::{setsockopt, sockopt};
use serde_json::{Value, json};
use takt_client::Token;
use takt_core::SessionId;
use takt_core::controller::LoadRequest;
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

/// A net with 60 clocks, running.
fn start_clocks(server: &TestServer) -> Vec<String> {
    let names = (0..60).map(|number| format!("c{number}"));
    let names: Vec<_> = names.collect();
    let clocks = names.iter().map(|name| format!("{name}=Core::Clock(),"));
    let request = LoadRequest {
        text: format!(
            "{{{}c=Cancel(),outTerminate=c.outCancel}}",
            clocks.collect::<String>()
        ),
        session: SessionId::NONE,
        description: "clocks".to_owned(),
        period: None,
    };
    let net = server.controller.load(request).unwrap();
    server.controller.start_net(net).unwrap();
    let probe = |name: &String| format!("net:clocks/{name}.outValue");
    names.iter().map(probe).collect()
}

/// A figure of `/metrics`.
fn metric(server: &TestServer, name: &str) -> u64 {
    let mut stream = TcpStream::connect(server.http).unwrap();
    let request = "GET /metrics HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n";
    stream.write_all(request.as_bytes()).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    let line = answer
        .lines()
        .find_map(|line| line.strip_prefix(name))
        .unwrap();
    line.trim().parse().unwrap()
}

#[test]
fn scope_client_that_stalls_loses_counted_samples() {
    let server = TestServer::start_with(ServerConfig::default());
    let mut good = connect(&server, "", None).unwrap();
    ask(
        &mut good,
        &json!({ "probes": ["thread:nets.cycle"], "rate_hz": 100 }),
    );
    text(&mut good);
    let mut slow = connect(&server, "", None).unwrap();
    setsockopt(slow.get_ref(), sockopt::RcvBuf, &(64 << 10)).unwrap();
    ask(&mut slow, &json!({ "probes": start_clocks(&server) }));
    assert_eq!(text(&mut slow)["scope"]["rejected"], json!([]));
    let first = frame(&mut slow).1[0];
    // Nothing is read for five seconds, while the other one gets each cycle.
    let (begin, mut rows, mut lost_by_good) = (Instant::now(), 0, 0);
    while begin.elapsed() < Duration::from_secs(5) {
        let (head, times) = frame(&mut good);
        rows += times.len();
        lost_by_good += head[3];
    }
    assert_eq!(
        (
            lost_by_good,
            metric(&server, "takt_scope_samples_lost_total")
        ),
        (0, 0)
    );
    assert!(rows > 2500, "{rows}");
    let (mut lost, mut last) = (0, first);
    while last < first + 5.5 {
        let (head, times) = frame(&mut slow);
        lost += u64::from(head[3]);
        last = *times.last().unwrap();
    }
    assert!(lost > 500, "{lost}");
    let until = Instant::now() + Duration::from_secs(20);
    while metric(&server, "takt_scope_samples_lost_total") < lost {
        assert!(Instant::now() < until);
    }
    assert_eq!(frame(&mut good).0[3], 0);
}
