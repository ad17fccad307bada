//! What is answered to a request. After each, the connection is closed.

use std::fmt;

use super::element::Element;

/// A response.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Response {
    status: &'static str,
    kind: &'static str,
    /// Other header lines.
    extra: String,
    body: String,
}

impl Response {
    /// A text for people.
    pub(crate) fn text(status: &'static str, body: impl Into<String>) -> Self {
        Self {
            status,
            kind: "text/plain; charset=utf-8",
            extra: String::new(),
            body: body.into(),
        }
    }

    /// What a resource is.
    pub(super) fn element(element: &Element, json: bool) -> Self {
        let (kind, body) = if json {
            ("application/json", element.to_json())
        } else {
            ("application/xml", element.to_xml())
        };
        Self {
            kind,
            ..Self::text("200 OK", body)
        }
    }

    /// An XML text.
    pub(super) fn xml(body: String) -> Self {
        Self {
            kind: "application/xml",
            ..Self::text("200 OK", body)
        }
    }

    /// What is asked for is elsewhere.
    pub(super) fn redirect(status: &'static str, location: &str) -> Self {
        Self {
            extra: format!("Location: {location}\r\n"),
            ..Self::text(status, "")
        }
    }

    /// The request cannot be understood, and why.
    pub(super) fn bad_request(why: impl fmt::Display) -> Self {
        Self::text("400 Bad Request", format!("{why}\n"))
    }

    /// The request cannot be done now, and why.
    pub(super) fn conflict(why: impl fmt::Display) -> Self {
        Self::text("409 Conflict", format!("{why}\n"))
    }

    /// The status line.
    pub(crate) const fn status(&self) -> &'static str {
        self.status
    }

    /// Whether it refuses the client, rather than what it asks for.
    pub(crate) fn is_denial(&self) -> bool {
        ["401", "403", "421", "429"]
            .iter()
            .any(|code| self.status.starts_with(code))
    }

    /// There is no such resource.
    pub(super) fn not_found(why: impl fmt::Display) -> Self {
        Self::text("404 Not Found", format!("{why}\n"))
    }

    /// A token is needed, and why what came is none.
    pub(super) fn unauthorized(why: &str) -> Self {
        Self {
            extra: "WWW-Authenticate: Bearer realm=\"takt\"\r\n".to_owned(),
            ..Self::text("401 Unauthorized", why)
        }
    }

    /// The same page again, with the token in a cookie rather than in the address. `token` was found to
    /// be right, so it holds no character that could end a header.
    pub(super) fn with_cookie(name: &str, token: &str) -> Self {
        let extra = format!(
            "Location: /\r\nSet-Cookie: {name}={token}; Path=/; HttpOnly; SameSite=Strict\r\n"
        );
        Self {
            extra,
            ..Self::text("303 See Other", "")
        }
    }

    /// The page for people, which takes nothing from elsewhere.
    /// But for the port of the stop channel.
    pub(super) fn page(body: &str, stop: Option<u16>) -> Self {
        let stop = stop.map_or_else(String::new, |port| format!(" http://*:{port}"));
        Self {
            kind: "text/html; charset=utf-8",
            extra: format!(
                "Content-Security-Policy: default-src 'none'; style-src 'unsafe-inline'; \
                 script-src 'unsafe-inline'; connect-src 'self'{stop}; img-src data:; \
                 frame-ancestors 'none'\r\n"
            ),
            ..Self::text("200 OK", body)
        }
    }

    /// A text of another kind.
    pub(super) fn of_kind(kind: &'static str, body: String) -> Self {
        Self {
            kind,
            ..Self::text("200 OK", body)
        }
    }

    /// There are too many of something, and what the bound is.
    pub(crate) fn too_many(why: impl fmt::Display) -> Self {
        Self::text("503 Service Unavailable", format!("{why}\n"))
    }

    /// Only WebSocket is spoken here.
    pub(super) fn upgrade_required() -> Self {
        Self {
            extra: "Upgrade: websocket\r\n".to_owned(),
            ..Self::text("426 Upgrade Required", "This resource speaks WebSocket.\n")
        }
    }
}

impl fmt::Display for Response {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            status,
            kind,
            extra,
            body,
        } = self;
        let length = body.len();
        write!(
            f,
            "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {length}\r\n{extra}\
             Cache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\n\
             Connection: close\r\n\r\n{body}"
        )
    }
}
