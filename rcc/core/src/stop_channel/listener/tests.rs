//! The channel over real sockets, with net threads played by the test. How fast it is is not asked here.

use std::io::{Read as _, Write as _};
use std::sync::atomic::{AtomicU32, Ordering};

use super::*;

const TOKEN: &str = "0123456789abcdef";

/// A channel on a socket and a port of its own.
fn channel() -> (StopChannel, StopSwitch) {
    static NUMBER: AtomicU32 = AtomicU32::new(0);
    let number = NUMBER.fetch_add(1, Ordering::Relaxed);
    let name = format!("takt-stop-{}-{number}.sock", std::process::id());
    let switch = StopSwitch::default();
    let config = StopChannelConfig {
        socket: Some(std::env::temp_dir().join(name)),
        tcp: Some(SocketAddr::from(([127, 0, 0, 1], 0))),
        token: Some(TOKEN.to_owned()),
        priority: None,
    };
    (StopChannel::start(config, switch.clone()).unwrap(), switch)
}

fn local(channel: &StopChannel, request: &str) -> String {
    let mut stream = UnixStream::connect(channel.socket().unwrap()).unwrap();
    stream.write_all(request.as_bytes()).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

fn remote(channel: &StopChannel, head: &str) -> String {
    let mut stream = TcpStream::connect(channel.tcp_address().unwrap()).unwrap();
    let request = format!("{head} HTTP/1.1\r\nHost: 127.0.0.1:8082\r\n");
    stream.write_all(request.as_bytes()).unwrap();
    stream.write_all(b"\r\n").unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

#[test]
fn socket_stops_and_releases() {
    let (channel, switch) = channel();
    let answer = local(&channel, "POST /stop HTTP/1.1\r\n\r\n");
    assert!(answer.starts_with("HTTP/1.1 200 OK"), "{answer}");
    assert!(answer.contains("\"stopped\":true,\"changed\":true,\"complete\":true"));
    let (origin, _) = switch.last_stop().unwrap();
    assert!(matches!(origin, Origin::Process { pid, .. } if pid == std::process::id()));
    let again = local(&channel, "POST /stop HTTP/1.1\r\n\r\n");
    assert!(again.contains("\"stopped\":true,\"changed\":false"));
    assert!(again.contains(&format!("\"by\":\"{origin}\"")), "{again}");
    let shown = local(&channel, "GET /stop HTTP/1.1\r\n\r\n");
    assert!(shown.contains("\"stopped\":true"));
    let released = local(&channel, "POST /stop/release HTTP/1.1\r\n\r\n");
    assert!(released.contains("\"stopped\":false,\"changed\":true"));
    assert!(!switch.is_stopped());
}

#[test]
fn stop_port_requires_token_on_loopback() {
    let (channel, switch) = channel();
    for (request, status) in [
        ("POST /stop".to_owned(), "401"),
        (format!("POST /stop?key={TOKEN}x"), "401"),
        (format!("POST /stop?key={}", &TOKEN[1..]), "401"),
        ("POST /stop?key=".to_owned(), "401"),
    ] {
        let answer = remote(&channel, &request);
        assert!(
            answer.starts_with(&format!("HTTP/1.1 {status}")),
            "{answer}"
        );
    }
    assert!(!switch.is_stopped());
    assert_eq!(switch.refused(), 4);
    let answer = remote(&channel, &format!("POST /stop?key={TOKEN}"));
    assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
    assert!(switch.is_stopped() && switch.release());
    let answer = remote(&channel, &format!("POST /stop?key={}", channel.key()));
    assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
    assert!(switch.is_stopped());
}

#[test]
fn foreign_page_with_key_is_rejected() {
    let (channel, switch) = channel();
    let send = |origin: &str| {
        let mut stream = TcpStream::connect(channel.tcp_address().unwrap()).unwrap();
        let request = format!(
            "POST /stop?key={TOKEN} HTTP/1.1\r\nHost: 127.0.0.1:8082\r\nOrigin: {origin}\r\n\r\n"
        );
        stream.write_all(request.as_bytes()).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        answer
    };
    assert!(send("http://evil.example").starts_with("HTTP/1.1 403"));
    assert!(!switch.is_stopped());
    let answer = send("http://127.0.0.1:8080");
    assert!(answer.contains("Access-Control-Allow-Origin: http://127.0.0.1:8080\r\n"));
    assert!(switch.is_stopped());
}

#[test]
fn silent_connections_do_not_block_stop() {
    let (channel, switch) = channel();
    let silent: Vec<_> = (0..60)
        .map(|_| {
            let tcp = TcpStream::connect(channel.tcp_address().unwrap()).unwrap();
            let mut unix = UnixStream::connect(channel.socket().unwrap()).unwrap();
            unix.write_all(b"POST /stop").unwrap();
            (tcp, unix)
        })
        .collect();
    let answer = remote(&channel, &format!("POST /stop?key={TOKEN}"));
    assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
    assert!(switch.is_stopped());
    let answer = local(&channel, "POST /stop/release HTTP/1.1\r\n\r\n");
    assert!(answer.contains("\"stopped\":false"), "{answer}");
    drop(silent);
}

#[test]
fn split_stop_request_is_accepted() {
    let (channel, switch) = channel();
    let mut stream = UnixStream::connect(channel.socket().unwrap()).unwrap();
    for byte in b"POST /stop HTTP/1.1\r\n\r\n" {
        stream.write_all(&[*byte]).unwrap();
    }
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
    assert!(switch.is_stopped());
}

#[test]
fn hanging_net_thread_is_reported() {
    let (channel, switch) = channel();
    switch.register(0, Nanos::from_millis(1));
    let answer = local(&channel, "POST /stop HTTP/1.1\r\n\r\n");
    assert!(answer.contains("\"complete\":false"), "{answer}");
    assert!(answer.contains("\"answered\":false"), "{answer}");
    assert!(switch.is_stopped());
}

#[test]
fn second_controller_at_one_socket_is_rejected() {
    let (channel, _) = channel();
    let config = StopChannelConfig {
        socket: channel.socket().map(Path::to_owned),
        ..StopChannelConfig::default()
    };
    let error = StopChannel::start(config.clone(), StopSwitch::default()).unwrap_err();
    assert!(error.to_string().contains("stop_socket"), "{error}");
    drop(channel);
    assert!(!config.socket.as_ref().unwrap().exists());
    // What a controller left that ended without a chance to is removed.
    drop(UnixListener::bind(config.socket.as_ref().unwrap()).unwrap());
    assert!(StopChannel::start(config, StopSwitch::default()).is_ok());
}
