//! Requests to a server that requires a token.

use super::super::*;
use super::KNOWN_CLIENT;

const TOKEN: &str = "0123456789abcdef";

/// The error response of a server with this token; empty if the request is admitted.
fn response(request: &str) -> String {
    let admit = |given: Option<&str>| match given {
        None => Admission::Missing,
        Some(TOKEN) => Admission::Admitted(Credential::Token),
        Some("often") => Admission::TooMany,
        Some(_) => Admission::Wrong,
    };
    let policy = AccessPolicy {
        check_token: &admit,
        origins: &Origins::default(),
        reached: None,
    };
    match parse(request.as_bytes(), false, policy) {
        Some((_, Action::Reject(response))) => response.to_string(),
        Some((_, Action::Serve(_) | Action::Upgrade(_))) => String::new(),
        other => panic!("{other:?}"),
    }
}

fn get(target: &str, header: &str) -> String {
    response(&format!("GET {target} HTTP/1.1\r\n{header}\r\n"))
}

#[test]
fn token_is_read_from_header_query_cookie() {
    assert_eq!(
        get("/nets/", &format!("Authorization: Bearer {TOKEN}\r\n")),
        ""
    );
    assert_eq!(
        get("/nets/", &format!("authorization: bearer {TOKEN}\r\n")),
        ""
    );
    assert_eq!(get(&format!("/nets/?format=json&token={TOKEN}"), ""), "");
    let cookie = format!("Cookie: a=b; takt_token={TOKEN}\r\n");
    assert_eq!(get("/nets/", &cookie), "");
    let websocket = KNOWN_CLIENT.replace("/DirectIO/", &format!("/DirectIO/?token={TOKEN}"));
    assert_eq!(response(&format!("{websocket}\r\n")), "");
    assert_eq!(response(&format!("{KNOWN_CLIENT}{cookie}\r\n")), "");
}

#[test]
fn request_without_token_is_rejected() {
    let denied = [
        get("/nets/", ""),
        get("/nowhere/", ""),
        get("/?token=wrong", ""),
        get("/nets/", "Authorization: Basic abc\r\n"),
        get("/nets/", "Authorization: Bearer \r\n"),
        get("/nets/", "Cookie: takt_tokens=0123456789abcdef\r\n"),
        response(&format!("{KNOWN_CLIENT}\r\n")),
        response("PUT /nets/ HTTP/1.1\r\n\r\n"),
    ];
    for response in denied {
        assert!(
            response.starts_with("HTTP/1.1 401 Unauthorized\r\n"),
            "{response}"
        );
        assert!(response.contains("WWW-Authenticate: Bearer"), "{response}");
    }
    let often = get("/nets/", "Authorization: Bearer often\r\n");
    assert!(often.starts_with("HTTP/1.1 429 "), "{often}");
    assert!(
        often.contains("more than 5 wrong ones within 60 s"),
        "{often}"
    );
}

#[test]
fn query_token_is_moved_to_cookie() {
    let answer = get(&format!("/?token={TOKEN}"), "");
    assert!(answer.starts_with("HTTP/1.1 303 "), "{answer}");
    assert!(answer.contains("Location: /\r\n"), "{answer}");
    let cookie = format!("Set-Cookie: takt_token={TOKEN}; Path=/; HttpOnly; SameSite=Strict\r\n");
    assert!(answer.contains(&cookie), "{answer}");
}

#[test]
fn own_page_with_token_is_admitted() {
    let page = |origin: &str| {
        let headers =
            format!("Host: robot:8080\r\nOrigin: {origin}\r\nAuthorization: Bearer {TOKEN}\r\n");
        get("/nets/", &headers)
    };
    assert_eq!(page("http://robot:8080"), "");
    assert!(page("http://elsewhere:8080").starts_with("HTTP/1.1 403 "));
    // Without a token, an unlisted name is rejected: it may be a rebound one.
    let open = "GET /nets/ HTTP/1.1\r\nHost: robot:8080\r\nOrigin: http://robot:8080\r\n\r\n";
    let (_, answer) = super::parse(open.as_bytes(), false).unwrap();
    assert!(matches!(answer, Action::Reject(_)), "{answer:?}");
}

#[test]
fn foreign_page_is_rejected_before_token_check() {
    let checks = std::cell::Cell::new(0);
    let admit = |_: Option<&str>| {
        checks.set(checks.get() + 1);
        Admission::Wrong
    };
    let policy = AccessPolicy {
        check_token: &admit,
        origins: &Origins::default(),
        reached: None,
    };
    let image = "GET /?token=guess HTTP/1.1\r\nHost: robot\r\nSec-Fetch-Site: cross-site\r\n\
        Sec-Fetch-Mode: no-cors\r\nSec-Fetch-Dest: image\r\n\r\n";
    let form = "POST /?token=guess HTTP/1.1\r\nHost: robot\r\nOrigin: http://evil.example\r\n\
        Content-Length: 0\r\n\r\n";
    for request in [image, form] {
        let (_, answer) = parse(request.as_bytes(), false, policy).unwrap();
        let Action::Reject(response) = answer else {
            panic!("{answer:?}");
        };
        assert!(response.status().starts_with("403 "));
    }
    assert_eq!(checks.get(), 0);
}

#[test]
fn body_without_token_is_not_read() {
    let head = "POST /nets/ HTTP/1.1\r\nContent-Length: 8000000\r\n\r\n";
    assert!(response(head).starts_with("HTTP/1.1 401 "));
}
