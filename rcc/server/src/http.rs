//! HTTP requests: parses bytes to a request with its form, and decides what to do with the connection. The
//! WebSocket handshake of the known client deviates from RFC 6455 and its forms from HTML, which is why no library
//! is used. A connection carries one request.

mod element;
mod form;
mod page;
mod resources;
mod response;

#[cfg(test)]
mod tests;

use httparse::{EMPTY_HEADER, Status};
use percent_encoding::percent_decode_str;
use takt_client::wire::MESSAGE_BYTES_MAX;
use tungstenite::handshake::derive_accept_key;

use std::net::IpAddr;

use crate::access::origin::{Origins, Sender};
use crate::access::{Admission, Credential, WRONG_MAX, WRONG_WINDOW};
use crate::live::wire::SUBPROTOCOLS;
use crate::site::Site;
pub(crate) use resources::debug::{DEBUG_STREAMS_MAX, DebugStream};
pub(crate) use resources::respond;
pub(crate) use response::{Download, Response};

/// Most bytes of a request's head.
pub(crate) const HEAD_BYTES_MAX: usize = 16 << 10;

/// Most bytes of a request's body: the same as of a message.
pub(crate) const BODY_BYTES_MAX: usize = MESSAGE_BYTES_MAX;

/// Most header lines of a request.
const HEADERS_MAX: usize = 64;

/// Name of the cookie that holds the token in browsers.
const COOKIE: &str = "takt_token";

/// Path of the DirectIO WebSocket.
const DIRECT_IO: &str = "DirectIO";

/// Path of the scope's WebSocket.
const SCOPE: &str = "scope";

/// Keys and values of a form or query, in order.
type Form = Vec<(String, String)>;

/// What to do with a connection after a request.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Action {
    /// Continue with WebSocket frames.
    Upgrade(Upgrade),
    /// The head is admitted: send the interim response, if any, and read the body.
    ReadBody {
        credential: Credential,
        interim: &'static str,
    },
    /// Execute the request, send the response and close.
    Serve(Request),
    /// Send this response and close.
    Reject(Response),
}

/// A WebSocket handshake.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Upgrade {
    /// The response.
    pub(crate) response: String,
    /// On which grounds the client was admitted.
    pub(crate) credential: Credential,
    /// Whether it names a version, which RFC 6455 demands and the known client omits.
    pub(crate) is_versioned: bool,
    /// Whether it is for the scope rather than for DirectIO.
    pub(crate) is_scope: bool,
}

/// Which requests are admitted.
#[derive(Clone, Copy)]
pub(crate) struct AccessPolicy<'a> {
    /// Checks a token, or its absence.
    pub(crate) check_token: &'a dyn Fn(Option<&str>) -> Admission,
    /// Page origins and host names that are accepted.
    pub(crate) origins: &'a Origins,
    /// The local address of the connection.
    pub(crate) reached: Option<IpAddr>,
}

/// A request for a resource.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Request {
    /// On which grounds the client was admitted.
    pub(crate) credential: Credential,
    /// Whether the method is POST.
    pub(crate) post: bool,
    /// Whether the method is HEAD: as GET, but the response has no body.
    pub(crate) is_head: bool,
    /// The path segments, decoded.
    pub(crate) path: Vec<String>,
    /// The query string.
    pub(crate) query: Form,
    /// The body.
    pub(crate) form: Form,
    /// Whether JSON is requested rather than XML.
    pub(crate) json: bool,
}

/// Parses the bytes received so far; `continued` states whether [`Action::ReadBody`] was returned before. Returns the
/// length of the request and the action, or `None` while the request is incomplete.
pub(crate) fn parse(
    received: &[u8],
    continued: bool,
    policy: AccessPolicy<'_>,
) -> Option<(usize, Action)> {
    let mut headers = [EMPTY_HEADER; HEADERS_MAX];
    let mut head = httparse::Request::new(&mut headers);
    let all = received.len();
    // Bytes beyond the bound are not parsed, even if they arrived at once.
    let bounded = received.get(..HEAD_BYTES_MAX).unwrap_or(received);
    let parsed = head.parse(bounded);
    let is_head = head.method == Some("HEAD");
    let reject = |response: Response| {
        Action::Reject(if is_head {
            response.without_body()
        } else {
            response
        })
    };
    let (length, read) = match parsed {
        Ok(Status::Complete(length)) => (length, Head::admitted(&head, policy)),
        Ok(Status::Partial) if all <= HEAD_BYTES_MAX => return None,
        Ok(Status::Partial) => {
            let text = format!("The head of a request has at most {HEAD_BYTES_MAX} bytes.\n");
            let status = "431 Request Header Fields Too Large";
            return Some((all, Action::Reject(Response::text(status, text))));
        }
        Err(e) => (all, Err(Response::bad_request(e))),
    };
    let head = match read {
        Ok(head) if head.path == [DIRECT_IO] || head.path == [SCOPE] => {
            let action = match head.upgrade() {
                Action::Reject(response) => reject(response),
                action @ (Action::Upgrade(_) | Action::ReadBody { .. } | Action::Serve(_)) => {
                    action
                }
            };
            return Some((length, action));
        }
        Ok(head) => head,
        Err(response) => return Some((length, reject(response))),
    };
    match received.get(length..length + head.body_bytes) {
        Some(body) => Some((length + head.body_bytes, Action::Serve(head.request(body)))),
        None if !continued => {
            let interim = if head.expects_continue {
                "HTTP/1.1 100 Continue\r\n\r\n"
            } else {
                ""
            };
            let credential = head.credential;
            Some((
                0,
                Action::ReadBody {
                    credential,
                    interim,
                },
            ))
        }
        None => None,
    }
}

/// Parses the handshake of a client of live data, of any path; `None` while it is incomplete.
pub(crate) fn parse_live(
    received: &[u8],
    policy: AccessPolicy<'_>,
) -> Option<(usize, Result<Upgrade, Response>)> {
    let mut headers = [EMPTY_HEADER; HEADERS_MAX];
    let mut head = httparse::Request::new(&mut headers);
    let bounded = received.get(..HEAD_BYTES_MAX).unwrap_or(received);
    match head.parse(bounded) {
        Ok(Status::Complete(length)) => Some((length, live_upgrade(&head, policy))),
        Ok(Status::Partial) if received.len() <= HEAD_BYTES_MAX => None,
        Ok(Status::Partial) => {
            let text = format!("The head of a request has at most {HEAD_BYTES_MAX} bytes.\n");
            let response = Response::text("431 Request Header Fields Too Large", text);
            Some((received.len(), Err(response)))
        }
        Err(e) => Some((received.len(), Err(Response::bad_request(e)))),
    }
}

fn live_upgrade(
    request: &httparse::Request<'_, '_>,
    policy: AccessPolicy<'_>,
) -> Result<Upgrade, Response> {
    let head = Head::admitted(request, policy)?;
    let offered = || {
        headers(request, "Sec-WebSocket-Protocol")
            .flat_map(|line| line.split(','))
            .map(str::trim)
    };
    let spoken = SUBPROTOCOLS
        .into_iter()
        .find(|it| offered().any(|offer| offer == *it));
    let Some(spoken) = spoken else {
        let text = format!(
            "This port is a WebSocket with the subprotocol {}.\nhint: open ws://HOST:PORT in Foxglove, Lichtblick or \
             PlotJuggler's Foxglove bridge; the page of this controller has a port of its own.\n",
            SUBPROTOCOLS.join(" or ")
        );
        return Err(Response::bad_request(text.trim_end()));
    };
    match head.upgrade() {
        Action::Upgrade(mut upgrade) => {
            let line = format!("\r\nSec-WebSocket-Protocol: {spoken}\r\n\r\n");
            upgrade.response.truncate(upgrade.response.trim_end().len());
            upgrade.response.push_str(&line);
            Ok(upgrade)
        }
        Action::Reject(response) => Err(response),
        Action::ReadBody { .. } | Action::Serve(_) => Err(Response::upgrade_required()),
    }
}

/// The response to a request without the right token.
fn denied(admission: Admission) -> Option<Response> {
    let why = match admission {
        Admission::Admitted(_) => return None,
        Admission::Missing => {
            "A token is required.\nhint: send it as `Authorization: Bearer …`, `?token=…` or the cookie takt_token.\n"
        }
        Admission::Wrong => "The token is wrong.\n",
        Admission::TooMany => {
            let seconds = WRONG_WINDOW.as_secs();
            let text = format!(
                "The token is wrong. After more than {WRONG_MAX} wrong ones within {seconds} s, answers to the address are delayed.\n"
            );
            return Some(Response::text("429 Too Many Requests", text));
        }
    };
    Some(Response::unauthorized(why))
}

/// The response when all connection slots are in use.
pub(crate) fn too_many_connections(bound: usize) -> Response {
    let text = format!(
        "All connection slots of this kind are in use: at most {bound}.\nhint: close a connection first.\n"
    );
    Response::text("503 Service Unavailable", text)
}

/// The head of a valid request.
struct Head {
    credential: Credential,
    post: bool,
    is_head: bool,
    path: Vec<String>,
    query: Form,
    json: bool,
    body_bytes: usize,
    expects_continue: bool,
    /// The key of a WebSocket handshake.
    websocket: Option<String>,
    is_versioned: bool,
}

impl Head {
    /// Checks and reads the head of a request. Foreign pages are rejected before their tokens are checked, so that
    /// none of them can make this host exceed the bound on wrong tokens.
    fn admitted(
        request: &httparse::Request<'_, '_>,
        policy: AccessPolicy<'_>,
    ) -> Result<Self, Response> {
        if headers(request, "Host").nth(1).is_some() {
            return Err(Response::bad_request("the request has two Host headers"));
        }
        let sender = sender(request);
        if !policy.origins.admit_page(&sender) {
            let text = format!(
                "Web pages of other origins are rejected, so that none can command a robot through your browser.\n\
                 hint: list the page's origin as origins under {} of cell.toml.\n",
                policy.origins.section
            );
            return Err(Response::text("403 Forbidden", text));
        }
        let target = request.path.unwrap_or_default();
        let (path, query) = target.split_once('?').unwrap_or((target, ""));
        let mut query = form::decode(query.as_bytes());
        let query_token = query.iter().position(|(key, _)| key == "token");
        let query_token = query_token.map(|at| query.remove(at).1);
        let token = bearer(request)
            .or(query_token.as_deref())
            .or_else(|| cookie(request));
        let admission = (policy.check_token)(token);
        let Admission::Admitted(credential) = admission else {
            return Err(denied(admission).unwrap_or_else(|| Response::unauthorized("")));
        };
        let head = Self::read(request, segments(path), query, credential)?;
        // The holder of the token may use any host name. No browser sends a handshake without a version.
        let is_browser = head.websocket.is_none() || head.is_versioned;
        if credential != Credential::Token
            && is_browser
            && !policy.origins.admit_host(sender.host, policy.reached)
        {
            let text = "This host name is not accepted.\n\
                hint: use http://localhost or an address, or list the name as hosts under [controller] of \
                cell.toml.\n";
            return Err(Response::text("421 Misdirected Request", text));
        }
        let is_page = head.path.is_empty() && head.websocket.is_none();
        if let (Credential::Token, Some(token), true) = (credential, &query_token, is_page) {
            return Err(Response::with_cookie(COOKIE, token));
        }
        Ok(head)
    }

    fn read(
        request: &httparse::Request<'_, '_>,
        path: Vec<String>,
        query: Form,
        credential: Credential,
    ) -> Result<Self, Response> {
        let (post, is_head) = match request.method {
            Some("GET") => (false, false),
            Some("HEAD") => (false, true),
            Some("POST") => (true, false),
            _ => {
                return Err(Response::text(
                    "405 Method Not Allowed",
                    "Only GET, HEAD and POST are supported.\n",
                ));
            }
        };
        let accepts = header(request, "Accept").unwrap_or_default();
        let format = query.iter().find(|(key, _)| key == "format");
        let json = format.map_or_else(
            || accepts.contains("application/json"),
            |(_, value)| value == "json",
        );
        let upgrades =
            header(request, "Upgrade").is_some_and(|u| u.eq_ignore_ascii_case("websocket"));
        let key = header(request, "Sec-WebSocket-Key").filter(|_| upgrades && !is_head);
        let expect = header(request, "Expect").unwrap_or_default();
        Ok(Self {
            credential,
            post,
            is_head,
            path,
            query,
            json,
            body_bytes: if post { body_bytes(request)? } else { 0 },
            expects_continue: expect.eq_ignore_ascii_case("100-continue"),
            websocket: key.map(str::to_owned),
            is_versioned: header(request, "Sec-WebSocket-Version").is_some(),
        })
    }

    fn upgrade(&self) -> Action {
        let Some(key) = &self.websocket else {
            return Action::Reject(Response::upgrade_required());
        };
        // The known client compares the line Sec-WebSocket-Accept byte by byte.
        let response = format!(
            "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\
             Sec-WebSocket-Accept: {}\r\n\r\n",
            derive_accept_key(key.as_bytes())
        );
        Action::Upgrade(Upgrade {
            response,
            credential: self.credential,
            is_versioned: self.is_versioned,
            is_scope: self.path == [SCOPE],
        })
    }

    fn request(self, body: &[u8]) -> Request {
        let Self {
            credential,
            post,
            is_head,
            path,
            query,
            json,
            ..
        } = self;
        Request {
            credential,
            post,
            is_head,
            path,
            query,
            form: form::decode(body),
            json,
        }
    }
}

/// Length of the body. Requires exactly one length: anything else could be parsed differently by a proxy.
fn body_bytes(request: &httparse::Request<'_, '_>) -> Result<usize, Response> {
    let mut lengths = headers(request, "Content-Length");
    let (first, second) = (lengths.next(), lengths.next());
    if header(request, "Transfer-Encoding").is_some() {
        let text = "Transfer-Encoding is not supported; send the body with its Content-Length.\n";
        return Err(Response::text("501 Not Implemented", text));
    }
    let Some(length) = first else {
        let text = "A POST request requires a Content-Length.\n";
        return Err(Response::text("411 Length Required", text));
    };
    let digits = !length.is_empty() && length.bytes().all(|b| b.is_ascii_digit());
    if second.is_some() || !digits {
        return Err(Response::bad_request(
            "Content-Length is not a single number",
        ));
    }
    match length.parse() {
        Ok(length) if length <= BODY_BYTES_MAX => Ok(length),
        _ => {
            let text = format!("The body of a request has at most {BODY_BYTES_MAX} bytes.\n");
            Err(Response::text("413 Content Too Large", text))
        }
    }
}

/// The segments of a path. Known clients double slashes.
fn segments(path: &str) -> Vec<String> {
    let names = path.split('/').filter(|name| !name.is_empty());
    let decoded = names.map(|name| percent_decode_str(name).decode_utf8_lossy());
    decoded.map(|name| name.into_owned()).collect()
}

fn headers<'a>(
    request: &httparse::Request<'_, 'a>,
    name: &'static str,
) -> impl Iterator<Item = &'a str> {
    let named = request
        .headers
        .iter()
        .filter(move |h| h.name.eq_ignore_ascii_case(name));
    named.map(|h| std::str::from_utf8(h.value).unwrap_or("?"))
}

fn header<'a>(request: &httparse::Request<'_, 'a>, name: &'static str) -> Option<&'a str> {
    headers(request, name).next()
}

/// The token in an `Authorization` header.
fn bearer<'a>(request: &httparse::Request<'_, 'a>) -> Option<&'a str> {
    let (scheme, token) = header(request, "Authorization")?.split_once(' ')?;
    scheme.eq_ignore_ascii_case("bearer").then(|| token.trim())
}

/// The token in a cookie.
fn cookie<'a>(request: &httparse::Request<'_, 'a>) -> Option<&'a str> {
    let mut cookies = headers(request, "Cookie").flat_map(|line| line.split(';'));
    cookies.find_map(|cookie| {
        let (name, value) = cookie.trim().split_once('=')?;
        (name == COOKIE).then_some(value)
    })
}

/// The headers by which the request states where it comes from.
fn sender<'a>(request: &httparse::Request<'_, 'a>) -> Sender<'a> {
    let equals = |name, value: &str| header(request, name).is_some_and(|v| v == value);
    Sender {
        host: header(request, "Host"),
        origin: header(request, "Origin"),
        site: header(request, "Sec-Fetch-Site"),
        navigates: request.method == Some("GET")
            && equals("Sec-Fetch-Mode", "navigate")
            && equals("Sec-Fetch-Dest", "document"),
    }
}

/// Feeds any bytes to the request parser, with a gate and without one.
///
/// # Panics
/// If a request is admitted without its token, or the parser breaks another guarantee.
#[doc(hidden)]
pub fn fuzz_head(data: &[u8]) {
    const TOKEN: &str = "0123456789abcdef";
    let origins = Origins::default();
    let guarded = |given: Option<&str>| match given {
        Some(TOKEN) => Admission::Admitted(Credential::Token),
        Some(_) => Admission::Wrong,
        None => Admission::Missing,
    };
    let policy = |check_token| AccessPolicy {
        check_token,
        origins: &origins,
        reached: None,
    };
    let holds_token = data.windows(TOKEN.len()).any(|w| w == TOKEN.as_bytes());
    let encoded = data.contains(&b'%');
    if let Some((length, action)) = parse(data, false, policy(&guarded)) {
        assert!(length <= data.len());
        let inside = !matches!(action, Action::Reject(_));
        assert!(
            !inside || holds_token || encoded,
            "admitted without a token"
        );
    }
    let anyone = |_: Option<&str>| Admission::Admitted(Credential::Loopback);
    if let Some((length, _)) = parse(data, true, policy(&anyone)) {
        assert!(length <= data.len());
    }
}

/// Feeds any bytes to the request parser, and serves what it accepts.
///
/// # Panics
/// If the result is not a response.
#[doc(hidden)]
pub fn fuzz(controller: &takt_core::Controller, data: &[u8]) {
    let policy = AccessPolicy {
        check_token: &|_| Admission::Admitted(Credential::Token),
        origins: &Origins::default(),
        reached: None,
    };
    if let Some((_, Action::Serve(request))) = parse(data, false, policy) {
        let gate = crate::access::Gate::new(None, None);
        let site = Site::new(controller.clone(), gate, crate::LogBook::default());
        let response = respond(&site, &request);
        assert!(response.to_string().starts_with("HTTP/1.1 "), "{request:?}");
    }
}
