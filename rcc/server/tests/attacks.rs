//! Attacks on a real server over loopback sockets, by web pages and by clients that use up resources. A bound or a
//! rejection limits each, and legitimate clients are still served.

#![expect(
    clippy::unwrap_used,
    reason = "tests and their helpers fail by panicking"
)]

mod common;

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::PathBuf;
use std::time::Duration;

use common::TestServer;
use takt_client::{Client, Token};
use takt_server::server::{CONNECTIONS_MAX, WAITING_PER_ADDRESS};
use takt_server::{LocalSocket, Loopback, ServerConfig};

/// Far longer than any test takes; expires only if a test fails.
const TIMEOUT: Duration = Duration::from_secs(20);

const TOKEN: &str = "0123456789abcdef";

const NET: &str = "{x=Cancel(),outTerminate=x.outCancel}";

fn token() -> Token {
    Token::new(TOKEN).unwrap()
}

/// A server that requires a token, on loopback too.
fn guarded() -> TestServer {
    TestServer::start_with(ServerConfig {
        token: Some(token()),
        ..ServerConfig::default()
    })
}

/// A server with a Unix socket, and the path of that.
fn with_socket(name: &str, config: ServerConfig) -> (TestServer, PathBuf) {
    let folder = std::env::temp_dir().join(format!("takt-attacks-{name}-{}", std::process::id()));
    let path = folder.join("takt.sock");
    let local = LocalSocket {
        path: path.clone(),
        group: None,
    };
    let local = Some(local);
    (
        TestServer::start_with(ServerConfig { local, ..config }),
        path,
    )
}

/// Sends bytes and returns all bytes received until the server closes.
fn exchange(address: SocketAddr, bytes: &[u8]) -> String {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(TIMEOUT)).unwrap();
    // The server may close before everything is sent; its answer may be lost then.
    let _ = stream.write_all(bytes);
    let mut answer = Vec::new();
    let _ = stream.read_to_end(&mut answer);
    String::from_utf8_lossy(&answer).into_owned()
}

#[test]
fn browser_post_to_line_port_executes_nothing() {
    let server = TestServer::start_with(ServerConfig::default());
    let body = format!("a=ver(\"2.0\")\r\nb=nene(\"{NET}\")\r\nc=nest(\"rpinet0\")\r\n");
    let length = body.len();
    let post = format!(
        "POST / HTTP/1.1\r\nHost: 127.0.0.1:8081\r\nUser-Agent: Mozilla/5.0\r\nAccept: */*\r\n\
         Origin: http://evil.example\r\nContent-Type: text/plain;charset=UTF-8\r\n\
         Content-Length: {length}\r\n\r\n{body}"
    );
    let hello = [&b"\x16\x03\x01\x02\x00\x01\x00\n"[..], body.as_bytes()].concat();
    let get = format!("GET /a=ver(\"2.0\") HTTP/1.1\r\n{body}");
    let first_bad = format!("a=nse(\"x\")\n{body}");
    let wrong_version = format!("a=ver(\"1.0\")\n{body}");
    for bytes in [
        post.as_bytes(),
        &hello,
        get.as_bytes(),
        first_bad.as_bytes(),
        wrong_version.as_bytes(),
    ] {
        let answer = exchange(server.tcp, bytes);
        let text = String::from_utf8_lossy(bytes);
        assert!(!answer.contains("=ok("), "{text}: {answer}");
        assert_eq!(server.controller.nets(), [], "{text}");
    }
    // The first bytes are sufficient.
    let answer = exchange(server.tcp, b"POST /");
    assert!(answer.contains("tag=ver("), "{answer}");
}

#[test]
fn foreign_or_rebound_page_gets_nothing() {
    let server = TestServer::start_with(ServerConfig::default());
    let port = server.http.port();
    let here = format!("127.0.0.1:{port}");
    let body = format!("dionet={NET}");
    let length = body.len();
    let head = |first: &str, host: &str, more: &str| {
        let request = format!("{first} HTTP/1.1\r\nHost: {host}\r\n{more}\r\n");
        let request = format!(
            "{request}{}",
            if first.starts_with("POST") { &body } else { "" }
        );
        let answer = exchange(server.http, request.as_bytes());
        answer.lines().next().unwrap_or_default().to_owned()
    };
    for path in ["/", "/nets/", "/log/", "/devices/", "/status/", "/metrics"] {
        let get = format!("GET {path}");
        let rebound = head(&get, "rebound.example:8080", "");
        assert!(rebound.starts_with("HTTP/1.1 421 "), "{path}: {rebound}");
        let foreign = head(&get, &here, "Origin: http://evil.example\r\n");
        assert!(foreign.starts_with("HTTP/1.1 403 "), "{path}: {foreign}");
        assert!(head(&get, &here, "").starts_with("HTTP/1.1 200 "), "{path}");
    }
    let length = format!("Content-Length: {length}\r\n");
    for origin in ["http://127.0.0.1:3000", "http://localhost:3000", "null"] {
        let more = format!("Origin: {origin}\r\n{length}");
        let posted = head("POST /nets/", &here, &more);
        assert!(posted.starts_with("HTTP/1.1 403 "), "{origin}: {posted}");
        let upgrade = format!(
            "Origin: {origin}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\
             Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
        );
        for path in ["/DirectIO/", "/scope"] {
            let socket = head(&format!("GET {path}"), &here, &upgrade);
            assert!(socket.starts_with("HTTP/1.1 403 "), "{origin}: {socket}");
        }
    }
    assert_eq!(server.controller.nets(), []);
    let own = format!("Origin: http://{here}\r\n{length}");
    assert!(head("POST /nets/", &here, &own).starts_with("HTTP/1.1 302 "));
}

#[test]
fn silent_sockets_keep_no_token_holder_out() {
    let server = guarded();
    let silent = |count: usize| -> Vec<_> {
        (0..count)
            .flat_map(|_| [server.tcp, server.http])
            .map(|address| TcpStream::connect(address).unwrap())
            .collect()
    };
    // More than may wait, so that some are evicted.
    let mut attack = silent(80);
    let mut honest = Vec::new();
    for _ in 0..44 {
        let client = Client::connect_with(&server.tcp.to_string(), Some(&token()));
        honest.push(client.unwrap());
        attack.extend(silent(1));
    }
    assert!(attack.len() > WAITING_PER_ADDRESS);
    let request = format!("GET /nets/?token={TOKEN} HTTP/1.1\r\n\r\n");
    let answer = exchange(server.http, request.as_bytes());
    assert!(answer.starts_with("HTTP/1.1 200 "), "{answer}");
    for client in &mut honest {
        client.call("nin", [""; 0]).unwrap();
    }
}

#[test]
fn idle_loopback_clients_leave_slots_for_others() {
    let config = ServerConfig {
        token: Some(token()),
        loopback: Some(Loopback::Open),
        ..ServerConfig::default()
    };
    let (server, path) = with_socket("idle", config);
    let address = server.tcp.to_string();
    let idle: Vec<_> = (0..CONNECTIONS_MAX)
        .map(|_| Client::connect(&address).unwrap())
        .collect();
    let error = Client::connect(&address).unwrap_err().to_string();
    assert!(
        error.contains("too many connections: at most 64"),
        "{error}"
    );
    // Authenticated clients have slots of their own, and so have requests.
    let by_socket = Client::connect(path.to_str().unwrap());
    by_socket.unwrap().call("nse", ["local"]).unwrap();
    let by_token = Client::connect_with(&address, Some(&token()));
    by_token.unwrap().call("nse", ["token"]).unwrap();
    let answer = exchange(server.http, b"GET /status/ HTTP/1.1\r\n\r\n");
    assert!(answer.starts_with("HTTP/1.1 200 "), "{answer}");
    drop(idle);
}

#[test]
fn wrong_image_tokens_lock_no_client_out() {
    let server = guarded();
    for number in 0..20 {
        let image = format!(
            "GET /?token=wrong-{number} HTTP/1.1\r\nHost: 127.0.0.1\r\nSec-Fetch-Site: cross-site\r\n\
             Sec-Fetch-Mode: no-cors\r\nSec-Fetch-Dest: image\r\n\r\n"
        );
        let answer = exchange(server.http, image.as_bytes());
        assert!(answer.starts_with("HTTP/1.1 403 "), "{answer}");
    }
    // Without fetch metadata, wrong tokens are counted; the right one is admitted all the same.
    let guess = |number: u32| {
        let request = format!("GET /?token=wrong-{number} HTTP/1.1\r\n\r\n");
        exchange(server.http, request.as_bytes())
    };
    for number in 0..5 {
        let answer = guess(number);
        assert!(answer.starts_with("HTTP/1.1 401 "), "{answer}");
    }
    assert!(guess(5).starts_with("HTTP/1.1 429 "));
    let request = format!("GET /nets/ HTTP/1.1\r\nAuthorization: Bearer {TOKEN}\r\n\r\n");
    let answer = exchange(server.http, request.as_bytes());
    assert!(answer.starts_with("HTTP/1.1 200 "), "{answer}");
    assert!(Client::connect_with(&server.tcp.to_string(), Some(&token())).is_ok());
}

/// Opens sessions until an error; returns how many.
fn open_sessions(client: &Client, most: usize) -> usize {
    (0..most)
        .take_while(|_| client.call("nse", ["leaked", "keep"]).is_ok())
        .count()
}

#[test]
fn leaked_sessions_are_ended_for_new_clients() {
    let server = TestServer::start_with(ServerConfig::default());
    let address = server.tcp.to_string();
    let mut opened = 0;
    while opened < 256 {
        let lost = Client::connect(&address).unwrap();
        let count = open_sessions(&lost, 64);
        // The server may not have detected the loss of the previous connection yet.
        opened += count;
        if count == 0 {
            std::thread::sleep(Duration::from_millis(1));
        }
    }
    let honest = Client::connect(&address).unwrap();
    let mut refused = 0;
    while honest.call("nse", ["honest"]).is_err() {
        refused += 1;
        assert!(refused < 10_000, "no session is opened");
        std::thread::sleep(Duration::from_millis(1));
    }
}

#[test]
fn one_client_cannot_take_all_sessions() {
    let (server, path) = with_socket("sessions", ServerConfig::default());
    let address = server.tcp.to_string();
    let mut greedy: Vec<_> = (0..4).map(|_| Client::connect(&address).unwrap()).collect();
    let opened: Vec<_> = greedy.iter_mut().map(|c| open_sessions(c, 100)).collect();
    assert_eq!(opened, [64, 64, 64, 0]);
    let error = greedy[0].call("nse", ["more"]).unwrap_err().to_string();
    assert!(error.contains("a connection has at most 64"), "{error}");
    let error = greedy[3].call("nse", ["more"]).unwrap_err().to_string();
    assert!(error.contains("clients without token"), "{error}");
    let by_socket = Client::connect(path.to_str().unwrap());
    by_socket.unwrap().call("nse", ["local"]).unwrap();
}

#[test]
fn unix_socket_needs_no_token() {
    let config = ServerConfig {
        token: Some(token()),
        ..ServerConfig::default()
    };
    let (server, path) = with_socket("socket", config);
    let path = path.to_str().unwrap();
    let client = Client::connect(path).unwrap();
    let net = client.call("nene", [NET]).unwrap();
    client.call("nest", [net.text().unwrap()]).unwrap();
    assert_eq!(server.controller.nets().len(), 1);
    assert!(Client::connect(&server.tcp.to_string()).is_err());
    drop(client);
    drop(server);
    assert!(!std::path::Path::new(path).exists());
}
