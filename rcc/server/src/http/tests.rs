//! Valid and invalid requests as received over the wire.

use super::*;

const KNOWN_CLIENT: &str = "GET /DirectIO/ HTTP/1.1\r\nHost: h\r\nUpgrade: websocket\r\n\
    Connection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n";

mod access;
mod ethercat;
mod geometry;
mod machines;
mod metrics;
mod page;
mod page_cell;
mod page_meshes;
mod page_nets;
mod page_plots;
mod resources;

/// Parses a request for a server without a token.
fn parse(received: &[u8], continued: bool) -> Option<(usize, Action)> {
    let origins = Origins {
        hosts: vec!["h".to_owned()],
        origins: vec!["http://listed:3000".to_owned()],
        ..Origins::default()
    };
    let policy = AccessPolicy {
        check_token: &|_| Admission::Admitted(Credential::Loopback),
        origins: &origins,
        reached: None,
    };
    super::parse(received, continued, policy)
}

/// The first line of the response to a request.
fn status(request: &str) -> String {
    let (_, answer) = parse(request.as_bytes(), false).unwrap();
    let text = match answer {
        Action::Upgrade(upgrade) => upgrade.response,
        Action::ReadBody { interim, .. } => interim.to_owned(),
        Action::Reject(response) => response.to_string(),
        Action::Serve(request) => format!("{:?}", request.path),
    };
    text.lines().next().unwrap().to_owned()
}

#[test]
fn known_client_handshake_response_is_exact() {
    let request = format!("{KNOWN_CLIENT}\r\n");
    let (length, answer) = parse(request.as_bytes(), false).unwrap();
    assert_eq!(length, request.len());
    let expected = "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\n\
        Connection: Upgrade\r\nSec-WebSocket-Accept: s3pPLMBiTxaQ9kYGzzhZRbK+xOo=\r\n\r\n";
    let upgrade = Upgrade {
        response: expected.to_owned(),
        credential: Credential::Loopback,
        is_versioned: false,
        is_scope: false,
    };
    assert_eq!(answer, Action::Upgrade(upgrade));
}

#[test]
fn partial_head_waits_up_to_bound() {
    for end in 0..KNOWN_CLIENT.len() {
        assert_eq!(parse(&KNOWN_CLIENT.as_bytes()[..end], false), None, "{end}");
    }
    let endless = format!("{KNOWN_CLIENT}X: {}", "x".repeat(HEAD_BYTES_MAX));
    assert_eq!(
        status(&endless),
        "HTTP/1.1 431 Request Header Fields Too Large"
    );
}

#[test]
fn unsupported_requests_are_rejected() {
    assert_eq!(
        status("PUT /nets/ HTTP/1.1\r\n\r\n"),
        "HTTP/1.1 405 Method Not Allowed"
    );
    assert_eq!(
        status("GET /DirectIO/ HTTP/1.1\r\n\r\n"),
        "HTTP/1.1 426 Upgrade Required"
    );
    assert_eq!(status("what?\0\r\n\r\n"), "HTTP/1.1 400 Bad Request");
    let many = "A: b\r\n".repeat(HEADERS_MAX + 1);
    assert_eq!(
        status(&format!("GET / HTTP/1.1\r\n{many}\r\n")),
        "HTTP/1.1 400 Bad Request"
    );
}

#[test]
fn doubled_slashes_count_as_one() {
    let request = KNOWN_CLIENT.replace("/DirectIO/", "//DirectIO");
    assert_eq!(
        status(&format!("{request}\r\n")),
        "HTTP/1.1 101 Switching Protocols"
    );
}

#[test]
fn websocket_from_other_origin_is_rejected() {
    let with = |origin: &str| status(&format!("{KNOWN_CLIENT}Origin: {origin}\r\n\r\n"));
    for origin in ["http://h", "http://listed:3000"] {
        assert_eq!(with(origin), "HTTP/1.1 101 Switching Protocols", "{origin}");
    }
    for origin in [
        "null",
        "http://example.org",
        "http://localhost.example.org",
        "http://localhost:8080",
        "http://h:3000",
        "",
    ] {
        assert_eq!(with(origin), "HTTP/1.1 403 Forbidden", "{origin}");
    }
}

#[test]
fn request_with_foreign_host_is_rejected() {
    let get = |host: &str| status(&format!("GET /log/ HTTP/1.1\r\nHost: {host}\r\n\r\n"));
    for host in ["h", "h:8080", "localhost:8080", "127.0.0.1:8080", "[::1]"] {
        assert_eq!(get(host), r#"["log"]"#, "{host}");
    }
    for host in ["rebound.example:8080", "192.0.2.1", ""] {
        assert_eq!(get(host), "HTTP/1.1 421 Misdirected Request", "{host}");
    }
    assert_eq!(get("h\r\nHost: h"), "HTTP/1.1 400 Bad Request");
    // The handshake of a browser has a version; that of the known client has none and may name any host.
    let handshake = KNOWN_CLIENT.replace("Host: h", "Host: rebound.example");
    assert!(is_upgrade(&format!("{handshake}\r\n")));
    let versioned = format!("{handshake}Sec-WebSocket-Version: 13\r\n\r\n");
    assert_eq!(status(&versioned), "HTTP/1.1 421 Misdirected Request");
}

#[test]
fn head_beyond_bound_is_rejected_at_once() {
    let head = |bytes: usize| format!("GET /log/ HTTP/1.1\r\nX: {}\r\n\r\n", "x".repeat(bytes));
    let most = HEAD_BYTES_MAX - head(0).len();
    assert_eq!(status(&head(most)), r#"["log"]"#);
    for bytes in [most + 1, 40_000] {
        let refused = status(&head(bytes));
        assert_eq!(refused, "HTTP/1.1 431 Request Header Fields Too Large");
    }
}

fn post(headers: &str, body: &str) -> String {
    format!("POST //nets/ HTTP/1.1\r\nHost: h\r\n{headers}\r\n{body}")
}

#[test]
fn body_is_read_to_its_length() {
    let request = post("content-length: 7\r\n", "desc=ab");
    for end in 0..request.len() {
        assert_eq!(parse(&request.as_bytes()[..end], true), None, "{end}");
    }
    let expected = Request {
        credential: Credential::Loopback,
        post: true,
        is_head: false,
        path: vec!["nets".to_owned()],
        query: Vec::new(),
        form: vec![("desc".to_owned(), "ab".to_owned())],
        json: false,
    };
    let more = format!("{request}POST");
    let served = Some((request.len(), Action::Serve(expected)));
    assert_eq!(parse(more.as_bytes(), false), served);
}

#[test]
fn body_length_must_be_unambiguous_and_bounded() {
    for (headers, expected) in [
        ("", "411 Length Required"),
        (
            "Content-Length: 1\r\nContent-Length: 1\r\n",
            "400 Bad Request",
        ),
        ("Content-Length: +1\r\n", "400 Bad Request"),
        ("Content-Length: -1\r\n", "400 Bad Request"),
        ("Content-Length: \r\n", "400 Bad Request"),
        ("Content-Length: 8388609\r\n", "413 Content Too Large"),
        (
            "Content-Length: 99999999999999999999999\r\n",
            "413 Content Too Large",
        ),
        ("Transfer-Encoding: chunked\r\n", "501 Not Implemented"),
        (
            "Content-Length: 1\r\nTransfer-Encoding: chunked\r\n",
            "501 Not Implemented",
        ),
    ] {
        let status = status(&post(headers, ""));
        assert_eq!(status, format!("HTTP/1.1 {expected}"), "{headers}");
    }
}

#[test]
fn expect_continue_is_answered_once() {
    let request = post("Content-Length: 3\r\nExpect: 100-continue\r\n", "");
    assert_eq!(status(&request), "HTTP/1.1 100 Continue");
    assert_eq!(parse(request.as_bytes(), true), None);
    assert_eq!(status(&format!("{request}a=b")), r#"["nets"]"#);
}

#[test]
fn json_is_selected_by_accept_or_query() {
    let json = |target: &str, accept: &str| {
        let request = format!("GET {target} HTTP/1.1\r\nAccept: {accept}\r\n\r\n");
        match parse(request.as_bytes(), false) {
            Some((_, Action::Serve(request))) => request.json,
            other => panic!("{other:?}"),
        }
    };
    assert!(json("/nets/", "application/json"));
    assert!(json("/nets/?format=json", "*/*"));
    assert!(!json("/nets/?format=xml", "application/json"));
    assert!(!json("/nets/", "text/html,*/*"));
}

#[test]
fn form_from_other_origin_is_rejected() {
    let request = post("Origin: http://example.org\r\nContent-Length: 0\r\n", "");
    assert_eq!(status(&request), "HTTP/1.1 403 Forbidden");
}

#[test]
fn path_segments_are_decoded() {
    let request = "GET //modules/Core%3A%3AClock%2f/ HTTP/1.1\r\n\r\n";
    assert_eq!(status(request), r#"["modules", "Core::Clock/"]"#);
}

/// Whether a server without a token accepts the WebSocket handshake.
fn is_upgrade(request: &str) -> bool {
    matches!(
        parse(request.as_bytes(), false),
        Some((_, Action::Upgrade(_)))
    )
}
