//! The head of an HTTP request and what is answered to it. The only resource so far is the one
//! where WebSocket connections begin; the known client's way of asking for it is not quite that
//! of RFC 6455, which is why no library does this. Bodies are not read.

use httparse::{EMPTY_HEADER, Request, Status};
use tungstenite::handshake::derive_accept_key;

/// Most bytes of a request's head.
pub(crate) const HEAD_BYTES_MAX: usize = 16 << 10;

/// Most header lines of a request.
const HEADERS_MAX: usize = 64;

/// Where DirectIO is.
const DIRECT_IO: &str = "/DirectIO/";

/// What to do with a connection after its first request.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Answer {
    /// Send this and go on with WebSocket frames.
    Upgrade(String),
    /// Send this and close.
    Refuse(String),
}

/// Looks at what was received so far. `None`: the head is not whole yet; otherwise how many bytes
/// it has, and the answer.
pub(crate) fn answer(received: &[u8]) -> Option<(usize, Answer)> {
    let mut headers = [EMPTY_HEADER; HEADERS_MAX];
    let mut request = Request::new(&mut headers);
    match request.parse(received) {
        Ok(Status::Complete(length)) => Some((length, respond(&request))),
        Ok(Status::Partial) if received.len() <= HEAD_BYTES_MAX => None,
        Ok(Status::Partial) => Some((
            received.len(),
            refuse(
                "431 Request Header Fields Too Large",
                &format!("The head of a request has at most {HEAD_BYTES_MAX} bytes.\n"),
            ),
        )),
        Err(e) => Some((received.len(), refuse("400 Bad Request", &format!("{e}\n")))),
    }
}

/// That there are as many connections as the server takes.
pub(crate) fn too_many_connections(bound: usize) -> String {
    let text = format!("This server takes at most {bound} connections; close one first.\n");
    response("503 Service Unavailable", &text)
}

fn respond(request: &Request<'_, '_>) -> Answer {
    let path = request.path.unwrap_or_default();
    if !is_direct_io(path) {
        return refuse(
            "404 Not Found",
            "There is DirectIO at /DirectIO/ and nothing else yet.\n",
        );
    }
    let wants_websocket =
        header(request, "Upgrade").is_some_and(|u| u.eq_ignore_ascii_case("websocket"));
    let Some(key) = header(request, "Sec-WebSocket-Key").filter(|_| wants_websocket) else {
        return refuse("426 Upgrade Required", "This resource speaks WebSocket.\n");
    };
    if !header(request, "Origin").is_none_or(is_local_page) {
        let text = "Web pages of other hosts may not reach a robot through your browser.\n";
        return refuse("403 Forbidden", text);
    }
    // The known client compares the accept line byte by byte.
    Answer::Upgrade(format!(
        "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\
         Sec-WebSocket-Accept: {}\r\n\r\n",
        derive_accept_key(key.as_bytes())
    ))
}

/// Whether the path is that of DirectIO. Known clients double slashes.
fn is_direct_io(path: &str) -> bool {
    let path = path.split('?').next().unwrap_or_default();
    let names = |p: &str| {
        p.split('/')
            .filter(|n| !n.is_empty())
            .map(str::to_owned)
            .collect()
    };
    let (asked, wanted): (Vec<_>, Vec<_>) = (names(path), names(DIRECT_IO));
    asked == wanted
}

fn header<'a>(request: &Request<'_, 'a>, name: &str) -> Option<&'a str> {
    let found = request
        .headers
        .iter()
        .find(|h| h.name.eq_ignore_ascii_case(name))?;
    std::str::from_utf8(found.value).ok()
}

/// Whether a browser says that the page which connects came from this host. Browsers let any
/// page open a WebSocket to any host, also to this one.
fn is_local_page(origin: &str) -> bool {
    let host = origin.split_once("://").map_or("", |(_, rest)| rest);
    let host = if host.starts_with('[') {
        host.split_inclusive(']').next().unwrap_or_default()
    } else {
        host.split(':').next().unwrap_or_default()
    };
    matches!(host, "localhost" | "127.0.0.1" | "[::1]")
}

fn refuse(status: &str, text: &str) -> Answer {
    Answer::Refuse(response(status, text))
}

fn response(status: &str, text: &str) -> String {
    let upgrade = if status.starts_with("426") {
        "Upgrade: websocket\r\n"
    } else {
        ""
    };
    format!(
        "HTTP/1.1 {status}\r\nContent-Type: text/plain\r\nContent-Length: {}\r\n{upgrade}\
         Connection: close\r\n\r\n{text}",
        text.len()
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    const KNOWN_CLIENT: &str = "GET /DirectIO/ HTTP/1.1\r\nHost: h\r\nUpgrade: websocket\r\n\
        Connection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n";

    fn status(request: &str) -> String {
        let (_, answer) = answer(request.as_bytes()).unwrap();
        let (Answer::Upgrade(text) | Answer::Refuse(text)) = answer;
        text.lines().next().unwrap().to_owned()
    }

    #[test]
    fn known_client_is_answered_in_the_letters_it_compares() {
        let request = format!("{KNOWN_CLIENT}\r\n");
        let (length, answer) = answer(request.as_bytes()).unwrap();
        assert_eq!(length, request.len());
        let expected = "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\n\
            Connection: Upgrade\r\nSec-WebSocket-Accept: s3pPLMBiTxaQ9kYGzzhZRbK+xOo=\r\n\r\n";
        assert_eq!(answer, Answer::Upgrade(expected.to_owned()));
    }

    #[test]
    fn part_of_a_head_is_waited_for_but_not_for_ever() {
        for end in 0..KNOWN_CLIENT.len() {
            assert_eq!(answer(&KNOWN_CLIENT.as_bytes()[..end]), None, "{end}");
        }
        let endless = format!("{KNOWN_CLIENT}X: {}", "x".repeat(HEAD_BYTES_MAX));
        assert_eq!(
            status(&endless),
            "HTTP/1.1 431 Request Header Fields Too Large"
        );
    }

    #[test]
    fn other_requests_are_refused() {
        assert_eq!(status("GET / HTTP/1.1\r\n\r\n"), "HTTP/1.1 404 Not Found");
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
    fn pages_of_other_hosts_are_kept_out() {
        let with = |origin: &str| status(&format!("{KNOWN_CLIENT}Origin: {origin}\r\n\r\n"));
        for origin in [
            "http://localhost:8080",
            "http://127.0.0.1",
            "http://[::1]:8080",
        ] {
            assert_eq!(with(origin), "HTTP/1.1 101 Switching Protocols", "{origin}");
        }
        for origin in [
            "null",
            "http://example.org",
            "http://localhost.example.org",
            "",
        ] {
            assert_eq!(with(origin), "HTTP/1.1 403 Forbidden", "{origin}");
        }
    }
}
