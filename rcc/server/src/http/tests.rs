//! Requests as they come over the wire, good and bad.

use super::*;

const KNOWN_CLIENT: &str = "GET /DirectIO/ HTTP/1.1\r\nHost: h\r\nUpgrade: websocket\r\n\
    Connection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n";

mod access;
mod metrics;
mod resources;

/// What a server that asks for no token answers.
fn answer(received: &[u8], continued: bool) -> Option<(usize, Answer)> {
    let origins = Origins {
        hosts: vec!["h".to_owned()],
        origins: vec!["http://listed:3000".to_owned()],
    };
    let guard = Guard {
        token: &|_| Admission::Admitted(Credential::Loopback),
        origins: &origins,
        reached: None,
    };
    super::answer(received, continued, guard)
}

/// The first line of what a request is answered.
fn status(request: &str) -> String {
    let (_, answer) = answer(request.as_bytes(), false).unwrap();
    let text = match answer {
        Answer::Upgrade(upgrade) => upgrade.response,
        Answer::Body { ask, .. } => ask.to_owned(),
        Answer::Refuse(response) => response.to_string(),
        Answer::Serve(request) => format!("{:?}", request.path),
    };
    text.lines().next().unwrap().to_owned()
}

#[test]
fn known_client_is_answered_in_the_letters_it_compares() {
    let request = format!("{KNOWN_CLIENT}\r\n");
    let (length, answer) = answer(request.as_bytes(), false).unwrap();
    assert_eq!(length, request.len());
    let expected = "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\n\
        Connection: Upgrade\r\nSec-WebSocket-Accept: s3pPLMBiTxaQ9kYGzzhZRbK+xOo=\r\n\r\n";
    let upgrade = Upgrade {
        response: expected.to_owned(),
        credential: Credential::Loopback,
        is_versioned: false,
    };
    assert_eq!(answer, Answer::Upgrade(upgrade));
}

#[test]
fn part_of_a_head_is_waited_for_but_not_for_ever() {
    for end in 0..KNOWN_CLIENT.len() {
        assert_eq!(
            answer(&KNOWN_CLIENT.as_bytes()[..end], false),
            None,
            "{end}"
        );
    }
    let endless = format!("{KNOWN_CLIENT}X: {}", "x".repeat(HEAD_BYTES_MAX));
    assert_eq!(
        status(&endless),
        "HTTP/1.1 431 Request Header Fields Too Large"
    );
}

#[test]
fn other_requests_are_refused() {
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
fn doubled_slashes_are_one() {
    let request = KNOWN_CLIENT.replace("/DirectIO/", "//DirectIO");
    assert_eq!(
        status(&format!("{request}\r\n")),
        "HTTP/1.1 101 Switching Protocols"
    );
}

#[test]
fn websocket_of_page_of_other_origin_is_refused() {
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
fn request_to_foreign_host_is_refused() {
    let get = |host: &str| status(&format!("GET /log/ HTTP/1.1\r\nHost: {host}\r\n\r\n"));
    for host in ["h", "h:8080", "localhost:8080", "127.0.0.1:8080", "[::1]"] {
        assert_eq!(get(host), r#"["log"]"#, "{host}");
    }
    for host in ["rebound.example:8080", "192.0.2.1", ""] {
        assert_eq!(get(host), "HTTP/1.1 421 Misdirected Request", "{host}");
    }
    assert_eq!(get("h\r\nHost: h"), "HTTP/1.1 400 Bad Request");
    // A browser's handshake has a version; the known client's has none and may name any host.
    let handshake = KNOWN_CLIENT.replace("Host: h", "Host: rebound.example");
    assert!(is_upgrade(&format!("{handshake}\r\n")));
    let versioned = format!("{handshake}Sec-WebSocket-Version: 13\r\n\r\n");
    assert_eq!(status(&versioned), "HTTP/1.1 421 Misdirected Request");
}

#[test]
fn head_beyond_its_bound_is_refused_when_it_comes_at_once() {
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
        assert_eq!(answer(&request.as_bytes()[..end], true), None, "{end}");
    }
    let expected = Request {
        credential: Credential::Loopback,
        post: true,
        path: vec!["nets".to_owned()],
        query: Vec::new(),
        form: vec![("desc".to_owned(), "ab".to_owned())],
        json: false,
    };
    let more = format!("{request}POST");
    let served = Some((request.len(), Answer::Serve(expected)));
    assert_eq!(answer(more.as_bytes(), false), served);
}

#[test]
fn length_of_a_body_must_be_sure_and_is_bounded() {
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
fn client_that_waits_to_be_asked_for_the_body_is_asked_once() {
    let request = post("Content-Length: 3\r\nExpect: 100-continue\r\n", "");
    assert_eq!(status(&request), "HTTP/1.1 100 Continue");
    assert_eq!(answer(request.as_bytes(), true), None);
    assert_eq!(status(&format!("{request}a=b")), r#"["nets"]"#);
}

#[test]
fn json_is_given_to_those_who_ask() {
    let json = |target: &str, accept: &str| {
        let request = format!("GET {target} HTTP/1.1\r\nAccept: {accept}\r\n\r\n");
        match answer(request.as_bytes(), false) {
            Some((_, Answer::Serve(request))) => request.json,
            other => panic!("{other:?}"),
        }
    };
    assert!(json("/nets/", "application/json"));
    assert!(json("/nets/?format=json", "*/*"));
    assert!(!json("/nets/?format=xml", "application/json"));
    assert!(!json("/nets/", "text/html,*/*"));
}

#[test]
fn forms_of_pages_of_other_hosts_are_kept_out() {
    let request = post("Origin: http://example.org\r\nContent-Length: 0\r\n", "");
    assert_eq!(status(&request), "HTTP/1.1 403 Forbidden");
}

#[test]
fn parts_of_a_path_are_decoded() {
    let request = "GET //modules/Core%3A%3AClock%2f/ HTTP/1.1\r\n\r\n";
    assert_eq!(status(request), r#"["modules", "Core::Clock/"]"#);
}

/// Whether an open server goes on with WebSocket frames.
fn is_upgrade(request: &str) -> bool {
    matches!(
        answer(request.as_bytes(), false),
        Some((_, Answer::Upgrade(_)))
    )
}
