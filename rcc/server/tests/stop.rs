//! The page's two paths to a stop: port and key of the stop channel, and the stop request to the server.

#![expect(
    clippy::unwrap_used,
    reason = "tests and their helpers fail by panicking"
)]

mod common;

use std::io::{Read as _, Write as _};
use std::net::TcpStream;

use common::TestServer;
use takt_client::Token;
use takt_server::{ServerConfig, StopPort};

fn http(server: &TestServer, method: &str, target: &str, header: &str) -> String {
    let mut stream = TcpStream::connect(server.http).unwrap();
    let host = server.http;
    let request = format!(
        "{method} {target} HTTP/1.1\r\nHost: {host}\r\nAccept: application/json\r\nContent-Length: 0\r\n{header}\r\n"
    );
    stream.write_all(request.as_bytes()).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

#[test]
fn page_finds_the_stop_port_and_its_key() {
    let server = TestServer::start_with(ServerConfig {
        stop: Some(StopPort::new(4711, "page-key")),
        ..ServerConfig::default()
    });
    let page = http(&server, "GET", "/", "");
    assert!(page.contains("connect-src 'self' http://*:4711;"), "{page}");
    assert!(page.contains("id=\"stop\""));
    let state = http(&server, "GET", "/stop/", "");
    let (_, body) = state.split_once("\r\n\r\n").unwrap();
    for part in ["\"stopped\":false", "\"port\":4711", "\"key\":\"page-key\""] {
        assert!(body.contains(part), "{body}");
    }
}

#[test]
fn server_stop_request_stops_controller() {
    let server = TestServer::start_with(ServerConfig::default());
    let stopped = http(&server, "POST", "/stop/", "");
    assert!(stopped.contains("\"stopped\":true"), "{stopped}");
    assert!(
        stopped.contains("\"by\":\"a client of the server\""),
        "{stopped}"
    );
    assert!(server.controller.stop_switch().is_stopped());
    let released = http(&server, "POST", "/stop/release", "");
    assert!(released.contains("\"stopped\":false"), "{released}");
    let foreign = http(&server, "POST", "/stop/", "Origin: http://evil.example\r\n");
    assert!(foreign.starts_with("HTTP/1.1 403"), "{foreign}");
    assert!(!server.controller.stop_switch().is_stopped());
}

#[test]
fn stop_key_requires_token() {
    let server = TestServer::start_with(ServerConfig {
        token: Some(Token::new("0123456789abcdef").unwrap()),
        stop: Some(StopPort::new(4711, "page-key")),
        ..ServerConfig::default()
    });
    let answer = http(&server, "GET", "/stop/", "");
    assert!(answer.starts_with("HTTP/1.1 401"), "{answer}");
    assert!(!answer.contains("page-key"));
}
