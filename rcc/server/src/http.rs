//! HTTP requests: from bytes to a request with its form, and to what is answered. The known
//! client's way of asking for a WebSocket is not quite that of RFC 6455, and its forms are not
//! quite those of HTML, which is why no library does this. A connection carries one request.

mod element;
mod form;
mod page;
mod resources;
mod response;

#[cfg(test)]
mod tests;

use httparse::{EMPTY_HEADER, Status};
use percent_encoding::percent_decode_str;
use tungstenite::handshake::derive_accept_key;

use std::net::IpAddr;

use crate::access::origin::{Origins, Sender};
use crate::access::{Admission, Credential, WRONG_MAX, WRONG_WITHIN};
use crate::site::Site;
use crate::wire::MESSAGE_BYTES_MAX;
pub(crate) use resources::debug::{DEBUG_STREAMS_MAX, DebugStream};
pub(crate) use resources::respond;
pub(crate) use response::Response;

/// Most bytes of a request's head.
pub(crate) const HEAD_BYTES_MAX: usize = 16 << 10;

/// Most bytes of a request's body: as many as a message may have.
pub(crate) const BODY_BYTES_MAX: usize = MESSAGE_BYTES_MAX;

/// Most header lines of a request.
const HEADERS_MAX: usize = 64;

/// Name of the cookie that may hold the token, for browsers.
const COOKIE: &str = "takt_token";

/// Where DirectIO is.
const DIRECT_IO: &str = "DirectIO";

/// Keys and values of a form or query, in order.
type Form = Vec<(String, String)>;

/// What to do with a connection.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Answer {
    /// Go on with WebSocket frames.
    Upgrade(Upgrade),
    /// The head is that of a client which is admitted: send this, which asks for the body, and read on.
    Body {
        credential: Credential,
        ask: &'static str,
    },
    /// Do what the request says, send the response, and close.
    Serve(Request),
    /// Send this and close.
    Refuse(Response),
}

/// A WebSocket handshake.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Upgrade {
    /// What to send.
    pub(crate) response: String,
    /// What the client was admitted for.
    pub(crate) credential: Credential,
    /// Whether it named a version, as RFC 6455 wants it and the known client does not.
    pub(crate) is_versioned: bool,
}

/// Who is admitted.
#[derive(Clone, Copy)]
pub(crate) struct Guard<'a> {
    /// Looks at a token, or at there being none.
    pub(crate) token: &'a dyn Fn(Option<&str>) -> Admission,
    /// Pages and names of this host that are accepted.
    pub(crate) origins: &'a Origins,
    /// The address that the connection came to.
    pub(crate) reached: Option<IpAddr>,
}

/// A request for a resource.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Request {
    /// What the client was admitted for.
    pub(crate) credential: Credential,
    /// Whether it is to change something.
    pub(crate) post: bool,
    /// The parts of the path between its slashes, decoded.
    pub(crate) path: Vec<String>,
    /// What follows the question mark.
    pub(crate) query: Form,
    /// The body.
    pub(crate) form: Form,
    /// Whether JSON is wanted rather than XML.
    pub(crate) json: bool,
}

/// Looks at what was received so far; `continued` says whether [`Answer::Body`] was answered before. `None`: the
/// request is not whole yet; otherwise how many bytes it has, and the answer.
pub(crate) fn answer(
    received: &[u8],
    continued: bool,
    guard: Guard<'_>,
) -> Option<(usize, Answer)> {
    let mut headers = [EMPTY_HEADER; HEADERS_MAX];
    let mut head = httparse::Request::new(&mut headers);
    let all = received.len();
    // What is longer is not looked at, however much of it came at once.
    let bounded = received.get(..HEAD_BYTES_MAX).unwrap_or(received);
    let (length, read) = match head.parse(bounded) {
        Ok(Status::Complete(length)) => (length, Head::admitted(&head, guard)),
        Ok(Status::Partial) if all <= HEAD_BYTES_MAX => return None,
        Ok(Status::Partial) => {
            let text = format!("The head of a request has at most {HEAD_BYTES_MAX} bytes.\n");
            let status = "431 Request Header Fields Too Large";
            return Some((all, Answer::Refuse(Response::text(status, text))));
        }
        Err(e) => (all, Err(Response::bad_request(e))),
    };
    let head = match read {
        Ok(head) if head.path == [DIRECT_IO] => return Some((length, head.upgrade())),
        Ok(head) => head,
        Err(refusal) => return Some((length, Answer::Refuse(refusal))),
    };
    match received.get(length..length + head.body_bytes) {
        Some(body) => Some((length + head.body_bytes, Answer::Serve(head.request(body)))),
        None if !continued => {
            let ask = if head.expects_continue {
                "HTTP/1.1 100 Continue\r\n\r\n"
            } else {
                ""
            };
            let credential = head.credential;
            Some((0, Answer::Body { credential, ask }))
        }
        None => None,
    }
}

/// That a request does not carry the token it needs.
fn denied(admission: Admission) -> Option<Response> {
    let why = match admission {
        Admission::Admitted(_) => return None,
        Admission::Missing => {
            "A token is needed: `Authorization: Bearer …`, `?token=…` or the cookie takt_token.\n"
        }
        Admission::Wrong => "The token is wrong.\n",
        Admission::TooMany => {
            let seconds = WRONG_WITHIN.as_secs();
            let text = format!(
                "The token is wrong; more than {WRONG_MAX} wrong ones within {seconds} s from one address are answered late.\n"
            );
            return Some(Response::text("429 Too Many Requests", text));
        }
    };
    Some(Response::unauthorized(why))
}

/// That there are as many connections as the server takes.
pub(crate) fn too_many_connections(bound: usize) -> Response {
    let text = format!("This server takes at most {bound} such connections; close one first.\n");
    Response::text("503 Service Unavailable", text)
}

/// The head of a request that can be served.
struct Head {
    credential: Credential,
    post: bool,
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
    /// Reads the head of a request that is let in. Pages are refused before their tokens are looked at, so that
    /// none of them can have this host's tokens counted as wrong.
    fn admitted(request: &httparse::Request<'_, '_>, guard: Guard<'_>) -> Result<Self, Response> {
        if headers(request, "Host").nth(1).is_some() {
            return Err(Response::bad_request("Host is given twice"));
        }
        let sender = sender(request);
        if !guard.origins.admit_page(&sender) {
            let text = "Web pages of other origins may not reach a robot through your browser.\n\
                hint: list the page's origin as origins under [controller] of cell.toml.\n";
            return Err(Response::text("403 Forbidden", text));
        }
        let target = request.path.unwrap_or_default();
        let (path, query) = target.split_once('?').unwrap_or((target, ""));
        let mut query = form::decode(query.as_bytes());
        let asked = query.iter().position(|(key, _)| key == "token");
        let asked = asked.map(|at| query.remove(at).1);
        let token = bearer(request)
            .or(asked.as_deref())
            .or_else(|| cookie(request));
        let admission = (guard.token)(token);
        let Admission::Admitted(credential) = admission else {
            return Err(denied(admission).unwrap_or_else(|| Response::unauthorized("")));
        };
        let head = Self::read(request, segments(path), query, credential)?;
        // With the token it is its holder, by whatever name. No browser makes a handshake without a version.
        let is_browser = head.websocket.is_none() || head.is_versioned;
        if credential != Credential::Token
            && is_browser
            && !guard.origins.admit_host(sender.host, guard.reached)
        {
            let text = "This server is not known by that name.\n\
                hint: use http://localhost or an address, or list the name as hosts under [controller] of \
                cell.toml.\n";
            return Err(Response::text("421 Misdirected Request", text));
        }
        if let (Credential::Token, Some(token), true) = (credential, &asked, head.path.is_empty()) {
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
        let post = match request.method {
            Some("GET") => false,
            Some("POST") => true,
            _ => {
                return Err(Response::text(
                    "405 Method Not Allowed",
                    "Use GET or POST.\n",
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
        let key = header(request, "Sec-WebSocket-Key").filter(|_| upgrades);
        let expect = header(request, "Expect").unwrap_or_default();
        Ok(Self {
            credential,
            post,
            path,
            query,
            json,
            body_bytes: if post { body_bytes(request)? } else { 0 },
            expects_continue: expect.eq_ignore_ascii_case("100-continue"),
            websocket: key.map(str::to_owned),
            is_versioned: header(request, "Sec-WebSocket-Version").is_some(),
        })
    }

    fn upgrade(&self) -> Answer {
        let Some(key) = &self.websocket else {
            return Answer::Refuse(Response::upgrade_required());
        };
        // The known client compares the accept line byte by byte.
        let response = format!(
            "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\
             Sec-WebSocket-Accept: {}\r\n\r\n",
            derive_accept_key(key.as_bytes())
        );
        Answer::Upgrade(Upgrade {
            response,
            credential: self.credential,
            is_versioned: self.is_versioned,
        })
    }

    fn request(self, body: &[u8]) -> Request {
        let Self {
            credential,
            post,
            path,
            query,
            json,
            ..
        } = self;
        Request {
            credential,
            post,
            path,
            query,
            form: form::decode(body),
            json,
        }
    }
}

/// How long the body is. Only a length that is given once is sure not to be read in two ways.
fn body_bytes(request: &httparse::Request<'_, '_>) -> Result<usize, Response> {
    let mut lengths = headers(request, "Content-Length");
    let (first, second) = (lengths.next(), lengths.next());
    if header(request, "Transfer-Encoding").is_some() {
        let text = "Send the body whole, with its Content-Length.\n";
        return Err(Response::text("501 Not Implemented", text));
    }
    let Some(length) = first else {
        let text = "A POST needs a Content-Length.\n";
        return Err(Response::text("411 Length Required", text));
    };
    let digits = !length.is_empty() && length.bytes().all(|b| b.is_ascii_digit());
    if second.is_some() || !digits {
        return Err(Response::bad_request("the Content-Length is no number"));
    }
    match length.parse() {
        Ok(length) if length <= BODY_BYTES_MAX => Ok(length),
        _ => {
            let text = format!("The body of a request has at most {BODY_BYTES_MAX} bytes.\n");
            Err(Response::text("413 Content Too Large", text))
        }
    }
}

/// The parts of a path. Known clients double slashes.
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

/// The token of an `Authorization` header.
fn bearer<'a>(request: &httparse::Request<'_, 'a>) -> Option<&'a str> {
    let (scheme, token) = header(request, "Authorization")?.split_once(' ')?;
    scheme.eq_ignore_ascii_case("bearer").then(|| token.trim())
}

/// The token of a cookie.
fn cookie<'a>(request: &httparse::Request<'_, 'a>) -> Option<&'a str> {
    let mut cookies = headers(request, "Cookie").flat_map(|line| line.split(';'));
    cookies.find_map(|cookie| {
        let (name, value) = cookie.trim().split_once('=')?;
        (name == COOKIE).then_some(value)
    })
}

/// What the request says about where it comes from.
fn sender<'a>(request: &httparse::Request<'_, 'a>) -> Sender<'a> {
    let says = |name, value: &str| header(request, name).is_some_and(|v| v == value);
    Sender {
        host: header(request, "Host"),
        origin: header(request, "Origin"),
        site: header(request, "Sec-Fetch-Site"),
        navigates: request.method == Some("GET")
            && says("Sec-Fetch-Mode", "navigate")
            && says("Sec-Fetch-Dest", "document"),
    }
}

/// Feeds any bytes to the reader of requests, behind a gate and without one.
///
/// # Panics
/// If a request gets in without its token, or the reader breaks another promise.
#[doc(hidden)]
pub fn fuzz_head(data: &[u8]) {
    const TOKEN: &str = "0123456789abcdef";
    let origins = Origins::default();
    let guarded = |given: Option<&str>| match given {
        Some(TOKEN) => Admission::Admitted(Credential::Token),
        Some(_) => Admission::Wrong,
        None => Admission::Missing,
    };
    let guard = |token| Guard {
        token,
        origins: &origins,
        reached: None,
    };
    let holds_token = data.windows(TOKEN.len()).any(|w| w == TOKEN.as_bytes());
    let encoded = data.contains(&b'%');
    if let Some((length, answer)) = answer(data, false, guard(&guarded)) {
        assert!(length <= data.len());
        let inside = !matches!(answer, Answer::Refuse(_));
        assert!(!inside || holds_token || encoded, "let in without a token");
    }
    let anyone = |_: Option<&str>| Admission::Admitted(Credential::Loopback);
    if let Some((length, _)) = answer(data, true, guard(&anyone)) {
        assert!(length <= data.len());
    }
}

/// Feeds any bytes to the reader of requests, and answers what is one.
///
/// # Panics
/// If the answer is no response.
#[doc(hidden)]
pub fn fuzz(controller: &takt_core::Controller, data: &[u8]) {
    let guard = Guard {
        token: &|_| Admission::Admitted(Credential::Token),
        origins: &Origins::default(),
        reached: None,
    };
    if let Some((_, Answer::Serve(request))) = answer(data, false, guard) {
        let gate = crate::access::Gate::new(None, None);
        let site = Site::new(controller.clone(), gate, crate::LogBook::default());
        let response = respond(&site, &request);
        assert!(response.to_string().starts_with("HTTP/1.1 "), "{request:?}");
    }
}
