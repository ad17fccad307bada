//! Requests over the stop channel: one HTTP request per connection, read from a fixed buffer without allocation. It
//! does not decide who may stop.

use httparse::{EMPTY_HEADER, Status};

/// Maximum bytes of a request head; a browser's is about a third of it.
pub(super) const REQUEST_BYTES_MAX: usize = 4096;
/// Maximum number of header lines.
const HEADERS_MAX: usize = 48;

/// The requested action.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Order {
    Stop,
    Release,
    /// Only the state.
    Show,
}

/// A complete request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Request<'b> {
    pub(super) order: Order,
    /// The token or key that it carries.
    pub(super) key: Option<&'b str>,
    /// The page that sends it, from the browser's Origin header.
    pub(super) origin: Option<&'b str>,
    /// The addressed host, from the Host header.
    host: Option<&'b str>,
}

/// Result of parsing the bytes received so far.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Read<'b> {
    /// Incomplete.
    Partial,
    /// A request.
    Whole(Request<'b>),
    /// Not a request of this channel: status line and cause.
    Bad(&'static str, &'static str),
}

/// Parses the bytes received so far.
pub(super) fn read(bytes: &[u8]) -> Read<'_> {
    let mut headers = [EMPTY_HEADER; HEADERS_MAX];
    let mut head = httparse::Request::new(&mut headers);
    match head.parse(bytes) {
        Ok(Status::Partial) if bytes.len() < REQUEST_BYTES_MAX => return Read::Partial,
        Ok(Status::Partial) => {
            return Read::Bad(
                "431 Request Header Fields Too Large",
                "a request has at most 4096 bytes",
            );
        }
        Err(_) => return Read::Bad("400 Bad Request", "this is not an HTTP request"),
        Ok(Status::Complete(_)) => {}
    }
    let target = head.path.unwrap_or_default();
    let (path, query) = target.split_once('?').unwrap_or((target, ""));
    let order = match (head.method, path.trim_end_matches('/')) {
        (Some("POST"), "/stop") => Order::Stop,
        (Some("POST"), "/stop/release") => Order::Release,
        (Some("GET"), "/stop") => Order::Show,
        _ => {
            return Read::Bad(
                "404 Not Found",
                "this channel takes POST /stop, POST /stop/release and GET /stop",
            );
        }
    };
    let field = |name: &str| {
        let header = head
            .headers
            .iter()
            .find(|h| h.name.eq_ignore_ascii_case(name));
        header.map(|h| std::str::from_utf8(h.value).unwrap_or("?"))
    };
    let bearer = field("Authorization").and_then(|value| {
        let (scheme, token) = value.split_once(' ')?;
        scheme.eq_ignore_ascii_case("bearer").then(|| token.trim())
    });
    let asked = || query.split('&').find_map(|pair| pair.strip_prefix("key="));
    Read::Whole(Request {
        order,
        key: bearer.or_else(asked),
        origin: field("Origin"),
        host: field("Host"),
    })
}

impl Request<'_> {
    /// Whether it comes from no page, or from a page of the addressed host: the
    /// controller's own page has the same host and another port.
    pub(super) fn is_of_own_page(&self) -> bool {
        let Some(origin) = self.origin else {
            return true;
        };
        let page = origin.split_once("://").map(|(_, rest)| without_port(rest));
        page.is_some() && page == self.host.map(without_port)
    }
}

fn without_port(host: &str) -> &str {
    match host.rsplit_once(':') {
        Some((name, port)) if !port.contains(']') => name,
        _ => host,
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn whole(text: &str) -> Request<'_> {
        match read(text.as_bytes()) {
            Read::Whole(request) => request,
            other @ (Read::Partial | Read::Bad(..)) => panic!("{text}: {other:?}"),
        }
    }

    #[test]
    fn key_comes_by_header_or_query() {
        let by_header = whole("POST /stop HTTP/1.1\r\nauthorization: bearer  abc \r\n\r\n");
        assert_eq!((by_header.order, by_header.key), (Order::Stop, Some("abc")));
        let by_query = whole("POST /stop/release?x=1&key=abc HTTP/1.1\r\n\r\n");
        assert_eq!(
            (by_query.order, by_query.key),
            (Order::Release, Some("abc"))
        );
        assert_eq!(whole("GET /stop/ HTTP/1.0\r\n\r\n").key, None);
    }

    #[test]
    fn foreign_page_is_recognised() {
        let of = |origin: &str, host: &str| {
            let text = format!("POST /stop HTTP/1.1\r\nHost: {host}\r\nOrigin: {origin}\r\n\r\n");
            whole(&text).is_of_own_page()
        };
        assert!(of("http://127.0.0.1:8080", "127.0.0.1:8082"));
        assert!(of("http://[::1]:8080", "[::1]:8082"));
        assert!(of("https://robot.example", "robot.example:8082"));
        for foreign in ["http://evil.example", "null", "http://127.0.0.1.evil:8080"] {
            assert!(!of(foreign, "127.0.0.1:8082"), "{foreign}");
        }
        assert!(whole("POST /stop HTTP/1.1\r\n\r\n").is_of_own_page());
    }

    #[test]
    fn other_stop_requests_are_rejected() {
        for text in [
            "GET /stop/release HTTP/1.1\r\n\r\n",
            "POST / HTTP/1.1\r\n\r\n",
            "\u{16}\u{3}\u{1}",
            "ver(2.0)\n",
        ] {
            assert!(matches!(read(text.as_bytes()), Read::Bad(..)), "{text}");
        }
        assert_eq!(read(b"POST /stop HTTP/1.1\r\n"), Read::Partial);
        let long = [b'a'; REQUEST_BYTES_MAX];
        let mut endless = b"POST /stop HTTP/1.1\r\nX: ".to_vec();
        endless.extend_from_slice(&long[..REQUEST_BYTES_MAX - endless.len()]);
        assert!(matches!(read(&endless), Read::Bad(status, _) if status.starts_with("431")));
    }

    proptest! {
        #[test]
        fn any_bytes_are_read_without_panic(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
            let _ = read(&bytes);
            let mut request = b"POST /stop HTTP/1.1\r\nHost: ".to_vec();
            request.extend(&bytes);
            request.extend(b"\r\nOrigin: ");
            request.extend(&bytes);
            request.extend(b"\r\n\r\n");
            if let Read::Whole(request) = read(&request) {
                let _ = request.is_of_own_page();
            }
        }
    }
}
