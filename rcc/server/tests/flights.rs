//! Flight files over real sockets: their list, their bytes, HEAD, and requests that get none of them.

#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

mod common;

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use common::TestServer;
use takt_client::Token;
use takt_core::controller::FlightSettings;
use takt_server::{Loopback, ServerConfig};

const TOKEN: &str = "0123456789abcdef";
/// Far longer than anything takes; expires only if a test fails.
const TIMEOUT: Duration = Duration::from_secs(60);

/// A server with a flight recorder, and the directory of that.
fn recording(name: &str, config: ServerConfig) -> (TestServer, PathBuf) {
    let directory =
        std::env::temp_dir().join(format!("takt-flights-{name}-{}", std::process::id()));
    let server = TestServer::start_with(config);
    let settings = FlightSettings {
        directory: directory.clone(),
        bytes_max: 16 << 20,
        cell: None,
    };
    server.controller.record_flights(settings).unwrap();
    (server, directory)
}

/// Head and body of the answer to a request without body.
fn answer(server: &TestServer, request: &str, more: &str) -> (String, Vec<u8>) {
    let mut stream = TcpStream::connect(server.http).unwrap();
    stream.set_read_timeout(Some(TIMEOUT)).unwrap();
    let host = server.http;
    write!(stream, "{request} HTTP/1.1\r\nHost: {host}\r\n{more}\r\n").unwrap();
    let mut bytes = Vec::new();
    stream.read_to_end(&mut bytes).unwrap();
    let end = bytes.windows(4).position(|it| it == b"\r\n\r\n").unwrap();
    let body = bytes.split_off(end + 4);
    (String::from_utf8(bytes).unwrap(), body)
}

/// The name of a complete flight file that was requested for this cause.
fn requested(server: &TestServer, cause: &str) -> String {
    let path = server.controller.request_flight(cause).unwrap();
    let until = Instant::now() + TIMEOUT;
    while !server
        .controller
        .flights()
        .iter()
        .any(|file| file.is_complete)
    {
        assert!(Instant::now() < until, "it is never complete");
        std::thread::sleep(Duration::from_millis(20));
    }
    path.file_name().unwrap().to_str().unwrap().to_owned()
}

#[test]
fn flight_list_names_causes_and_files() {
    let (server, directory) = recording("list", ServerConfig::default());
    let name = requested(&server, "gripper \"slipped\"");
    std::fs::write(
        directory.join("flight-19700101T000000.000Z-cut.mcap"),
        b"\x89MCAP",
    )
    .unwrap();
    let (_, body) = answer(&server, "GET /flights/?format=json", "");
    let list: serde_json::Value = serde_json::from_slice(&body).unwrap();
    let [cut, whole] = list["flight"].as_array().unwrap().as_slice() else {
        panic!("{list}");
    };
    assert_eq!(whole["name"], name.as_str());
    assert_eq!(whole["uri"], format!("/flights/{name}"));
    assert_eq!(whole["cause"], "gripper \"slipped\"");
    assert!(cut["error"].as_str().unwrap().contains("cut off"), "{cut}");
    std::fs::remove_dir_all(directory).unwrap();
}

#[test]
fn flight_download_has_all_bytes_and_head() {
    let (server, directory) = recording("bytes", ServerConfig::default());
    let name = requested(&server, "a test");
    // Many pieces.
    let file = directory.join("flight-20000101T000000.000Z-large.mcap");
    let large: Vec<u8> = (0..3_000_001_u32).map(|n| (n % 251) as u8).collect();
    std::fs::write(&file, &large).unwrap();
    for (name, whole) in [
        (name.as_str(), std::fs::read(directory.join(&name)).unwrap()),
        ("flight-20000101T000000.000Z-large.mcap", large),
    ] {
        let (head, body) = answer(&server, &format!("GET /flights/{name}"), "");
        assert!(head.starts_with("HTTP/1.1 200 OK\r\n"), "{head}");
        let length = format!("Content-Length: {}\r\n", whole.len());
        let save = format!("Content-Disposition: attachment; filename=\"{name}\"\r\n");
        for line in [length.as_str(), &save, "X-Content-Type-Options: nosniff"] {
            assert!(head.contains(line), "{line} is missing in {head}");
        }
        assert!(body == whole, "{} bytes of {}", body.len(), whole.len());
        let (same, nothing) = answer(&server, &format!("HEAD /flights/{name}"), "");
        assert_eq!((same, nothing.len()), (head, 0));
    }
    std::fs::remove_dir_all(directory).unwrap();
}

#[test]
fn flight_download_beyond_list_finds_nothing() {
    let (server, directory) = recording("beyond", ServerConfig::default());
    let secret = directory.join("secret.mcap");
    std::fs::write(&secret, "secret").unwrap();
    let link = "flight-20000101T000000.000Z-link.mcap";
    std::os::unix::fs::symlink(&secret, directory.join(link)).unwrap();
    let outside = secret.display().to_string().replace('/', "%2f");
    for path in [
        "secret.mcap",
        "../secret.mcap",
        "..%2f..%2fetc%2fpasswd",
        "flight-%2f..%2fsecret.mcap",
        "flight-..%2fsecret.mcap%00.mcap",
        "%00",
        "flight-.mcap",
        link,
        &outside,
        &format!("x/{link}"),
    ] {
        for method in ["GET", "HEAD"] {
            let (head, body) = answer(&server, &format!("{method} /flights/{path}"), "");
            assert!(head.starts_with("HTTP/1.1 404"), "{path}: {head}");
            assert!(!String::from_utf8_lossy(&body).contains("secret\n"));
            assert_eq!(body.is_empty(), method == "HEAD");
        }
    }
    // One that is being written has no end yet.
    let path = server.controller.request_flight("now").unwrap();
    let name = path.file_name().unwrap().to_str().unwrap();
    let until = Instant::now() + TIMEOUT;
    while !path.exists() {
        assert!(Instant::now() < until, "it is never begun");
    }
    let (head, body) = answer(&server, &format!("GET /flights/{name}"), "");
    let body = String::from_utf8(body).unwrap();
    assert!(
        head.starts_with("HTTP/1.1 409") && body.contains("hint: "),
        "{head} {body}"
    );
    std::fs::remove_dir_all(directory).unwrap();
}

#[test]
fn flight_download_keeps_token_and_origin_rules() {
    let guarded = ServerConfig {
        token: Some(Token::new(TOKEN).unwrap()),
        loopback: Some(Loopback::Token),
        ..ServerConfig::default()
    };
    let (server, directory) = recording("rules", guarded);
    let name = requested(&server, "a test");
    let bytes = std::fs::read(directory.join(&name)).unwrap();
    let foreign = "Origin: http://evil.example\r\n";
    let bearer = format!("Authorization: Bearer {TOKEN}\r\n");
    for (more, status) in [
        (String::new(), "401"),
        ("Cookie: takt_token=fedcba9876543210\r\n".to_owned(), "401"),
        (format!("{foreign}{bearer}"), "403"),
        (format!("Sec-Fetch-Site: cross-site\r\n{bearer}"), "403"),
        (bearer.clone(), "200"),
        (format!("Cookie: takt_token={TOKEN}\r\n"), "200"),
    ] {
        for method in ["GET", "HEAD"] {
            let (head, body) = answer(&server, &format!("{method} /flights/{name}"), &more);
            assert!(
                head.starts_with(&format!("HTTP/1.1 {status}")),
                "{more}: {head}"
            );
            assert_eq!(body == bytes, method == "GET" && status == "200");
            assert_eq!(body.is_empty(), method == "HEAD");
        }
    }
    std::fs::remove_dir_all(directory).unwrap();
}

#[test]
fn flight_download_survives_deletion_and_client_loss() {
    let (mut server, directory) = recording("loss", ServerConfig::default());
    let name = "flight-20000101T000000.000Z-large.mcap";
    let whole = vec![7; 8 << 20];
    std::fs::write(directory.join(name), &whole).unwrap();
    let begin = |server: &TestServer| {
        let mut stream = TcpStream::connect(server.http).unwrap();
        stream.set_read_timeout(Some(TIMEOUT)).unwrap();
        write!(
            stream,
            "GET /flights/{name} HTTP/1.1\r\nHost: {}\r\n\r\n",
            server.http
        )
        .unwrap();
        let mut first = [0; 1000];
        stream.read_exact(&mut first).unwrap();
        stream
    };
    // A client that is lost takes nothing with it; one that began gets all of a file that is deleted meanwhile.
    drop(begin(&server));
    let mut stream = begin(&server);
    std::fs::remove_file(directory.join(name)).unwrap();
    let mut rest = Vec::new();
    stream.read_to_end(&mut rest).unwrap();
    assert!(rest.len() + 1000 > whole.len(), "{} bytes", rest.len());
    let (head, _) = answer(&server, &format!("GET /flights/{name}"), "");
    assert!(head.starts_with("HTTP/1.1 404"), "{head}");
    // A client that does not read holds up no end of the server.
    std::fs::write(directory.join(name), &whole).unwrap();
    let _stalled = begin(&server);
    server.stop();
    std::fs::remove_dir_all(directory).unwrap();
}
