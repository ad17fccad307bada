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

use crate::access::{Admission, WRONG_MAX, WRONG_WITHIN};
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
    /// Send this and go on with WebSocket frames.
    Upgrade(String),
    /// Send this, which asks for the body, and read on.
    Continue(&'static str),
    /// Do what the request says, send the response, and close.
    Serve(Request),
    /// Send this and close.
    Refuse(Response),
}

/// A request for a resource.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Request {
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

/// Looks at what was received so far; `continued` says whether the body was asked for, `admit` whether
/// the token that the request carries lets it in. `None`: the request is not whole yet; otherwise how
/// many bytes it has, and the answer.
pub(crate) fn answer(
    received: &[u8],
    continued: bool,
    admit: &dyn Fn(Option<&str>) -> Admission,
) -> Option<(usize, Answer)> {
    let mut headers = [EMPTY_HEADER; HEADERS_MAX];
    let mut head = httparse::Request::new(&mut headers);
    let all = received.len();
    let (length, read) = match head.parse(received) {
        Ok(Status::Complete(length)) => (length, Head::admitted(&head, admit)),
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
        None if head.expects_continue && !continued => {
            Some((0, Answer::Continue("HTTP/1.1 100 Continue\r\n\r\n")))
        }
        None => None,
    }
}

/// That a request does not carry the token it needs.
fn denied(admission: Admission) -> Option<Response> {
    let why = match admission {
        Admission::Admitted => return None,
        Admission::Missing => {
            "A token is needed: `Authorization: Bearer …`, `?token=…` or the cookie takt_token.\n"
        }
        Admission::Wrong => "The token is wrong.\n",
        Admission::TooMany => {
            let seconds = WRONG_WITHIN.as_secs();
            let text = format!(
                "Too many wrong tokens: at most {WRONG_MAX} within {seconds} s from one address; wait that long.\n"
            );
            return Some(Response::text("429 Too Many Requests", text));
        }
    };
    Some(Response::unauthorized(why))
}

/// That there are as many connections as the server takes.
pub(crate) fn too_many_connections(bound: usize) -> Response {
    let text = format!("This server takes at most {bound} connections; close one first.\n");
    Response::text("503 Service Unavailable", text)
}

/// The head of a request that can be served.
struct Head {
    post: bool,
    path: Vec<String>,
    query: Form,
    json: bool,
    body_bytes: usize,
    expects_continue: bool,
    /// The key of a WebSocket handshake.
    websocket: Option<String>,
}

impl Head {
    /// Reads the head of a request that is let in.
    fn admitted(
        request: &httparse::Request<'_, '_>,
        admit: &dyn Fn(Option<&str>) -> Admission,
    ) -> Result<Self, Response> {
        let target = request.path.unwrap_or_default();
        let (path, query) = target.split_once('?').unwrap_or((target, ""));
        let mut query = form::decode(query.as_bytes());
        let asked = query.iter().position(|(key, _)| key == "token");
        let asked = asked.map(|at| query.remove(at).1);
        let token = bearer(request)
            .or(asked.as_deref())
            .or_else(|| cookie(request));
        let open = admit(None) == Admission::Admitted;
        if let Some(refusal) = denied(if open {
            Admission::Admitted
        } else {
            admit(token)
        }) {
            return Err(refusal);
        }
        let path = segments(path);
        if let (false, Some(token), true) = (open, &asked, path.is_empty()) {
            return Err(Response::with_cookie(COOKIE, token));
        }
        Self::read(request, path, query, open)
    }

    fn read(
        request: &httparse::Request<'_, '_>,
        path: Vec<String>,
        query: Form,
        open: bool,
    ) -> Result<Self, Response> {
        // With a token, pages of this very server are let in by whatever name it has.
        let own = |origin: &str| {
            let host = header(request, "Host").filter(|_| !open);
            let rest = origin.split_once("://").map(|(_, rest)| rest);
            rest.is_some_and(|rest| Some(rest) == host)
        };
        if !header(request, "Origin").is_none_or(|origin| is_local_page(origin) || own(origin)) {
            let text = "Web pages of other hosts may not reach a robot through your browser.\n";
            return Err(Response::text("403 Forbidden", text));
        }
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
            post,
            path,
            query,
            json,
            body_bytes: if post { body_bytes(request)? } else { 0 },
            expects_continue: expect.eq_ignore_ascii_case("100-continue"),
            websocket: key.map(str::to_owned),
        })
    }

    fn upgrade(&self) -> Answer {
        let Some(key) = &self.websocket else {
            return Answer::Refuse(Response::upgrade_required());
        };
        // The known client compares the accept line byte by byte.
        Answer::Upgrade(format!(
            "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\
             Sec-WebSocket-Accept: {}\r\n\r\n",
            derive_accept_key(key.as_bytes())
        ))
    }

    fn request(self, body: &[u8]) -> Request {
        let Self {
            post,
            path,
            query,
            json,
            ..
        } = self;
        Request {
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

/// Whether a browser says that the page which connects came from this host. Browsers let any
/// page open a WebSocket to any host, and send forms to it, also to this one.
fn is_local_page(origin: &str) -> bool {
    let host = origin.split_once("://").map_or("", |(_, rest)| rest);
    let host = if host.starts_with('[') {
        host.split_inclusive(']').next().unwrap_or_default()
    } else {
        host.split(':').next().unwrap_or_default()
    };
    matches!(host, "localhost" | "127.0.0.1" | "[::1]")
}

/// Feeds any bytes to the reader of requests, behind a gate and without one.
///
/// # Panics
/// If a request gets in without its token, or the reader breaks another promise.
#[doc(hidden)]
pub fn fuzz_head(data: &[u8]) {
    const TOKEN: &str = "0123456789abcdef";
    let guarded = |given: Option<&str>| match given {
        Some(TOKEN) => Admission::Admitted,
        Some(_) => Admission::Wrong,
        None => Admission::Missing,
    };
    let holds_token = data.windows(TOKEN.len()).any(|w| w == TOKEN.as_bytes());
    let encoded = data.contains(&b'%');
    if let Some((length, answer)) = answer(data, false, &guarded) {
        assert!(length <= data.len());
        let inside = matches!(answer, Answer::Upgrade(_) | Answer::Serve(_));
        assert!(!inside || holds_token || encoded, "let in without a token");
    }
    if let Some((length, _)) = answer(data, true, &|_| Admission::Admitted) {
        assert!(length <= data.len());
    }
}

/// Feeds any bytes to the reader of requests, and answers what is one.
///
/// # Panics
/// If the answer is no response.
#[doc(hidden)]
pub fn fuzz(controller: &takt_core::Controller, data: &[u8]) {
    if let Some((_, Answer::Serve(request))) = answer(data, false, &|_| Admission::Admitted) {
        let (keep, log) = (takt_core::OnLoss::Keep, crate::LogBook::default());
        let site = Site::new(controller.clone(), None, keep, log);
        let response = respond(&site, &request);
        assert!(response.to_string().starts_with("HTTP/1.1 "), "{request:?}");
    }
}
