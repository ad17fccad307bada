//! HTTP responses. The connection is closed after each.

use std::fmt;
use std::fs::File;
use std::sync::Arc;

use super::element::Element;

/// A response. Its text has no bytes of a file: the connection sends these behind it.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Response {
    status: &'static str,
    kind: &'static str,
    /// Additional header lines.
    extra: String,
    body: Body,
}

#[derive(Debug, PartialEq, Eq)]
enum Body {
    Text(String),
    File(Download),
    /// What a HEAD request would get by GET, of so many bytes.
    Omitted(u64),
}

impl Body {
    fn length(&self) -> u64 {
        match self {
            Self::Text(text) => text.len() as u64,
            Self::File(download) => download.bytes,
            Self::Omitted(bytes) => *bytes,
        }
    }
}

/// An open file, of which so many bytes are sent.
#[derive(Clone, Debug)]
pub(crate) struct Download {
    pub(crate) file: Arc<File>,
    pub(crate) bytes: u64,
}

impl PartialEq for Download {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.file, &other.file) && self.bytes == other.bytes
    }
}

impl Eq for Download {}

impl Response {
    /// A plain text.
    pub(crate) fn text(status: &'static str, body: impl Into<String>) -> Self {
        Self {
            status,
            kind: "text/plain; charset=utf-8",
            extra: String::new(),
            body: Body::Text(body.into()),
        }
    }

    /// A resource.
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

    /// A redirection.
    pub(super) fn redirect(status: &'static str, location: &str) -> Self {
        Self {
            extra: format!("Location: {location}\r\n"),
            ..Self::text(status, "")
        }
    }

    /// The request is invalid, and why.
    pub(super) fn bad_request(why: impl fmt::Display) -> Self {
        Self::text("400 Bad Request", format!("{why}\n"))
    }

    /// The request cannot be executed now, and why.
    pub(super) fn conflict(why: impl fmt::Display) -> Self {
        Self::text("409 Conflict", format!("{why}\n"))
    }

    /// The status line.
    pub(crate) const fn status(&self) -> &'static str {
        self.status
    }

    /// Whether it rejects the client rather than the request.
    pub(crate) fn is_denial(&self) -> bool {
        ["401", "403", "421", "429"]
            .iter()
            .any(|code| self.status.starts_with(code))
    }

    /// The resource does not exist.
    pub(super) fn not_found(why: impl fmt::Display) -> Self {
        Self::text("404 Not Found", format!("{why}\n"))
    }

    /// A token is required, and why the one received is not accepted.
    pub(super) fn unauthorized(why: &str) -> Self {
        Self {
            extra: "WWW-Authenticate: Bearer realm=\"takt\"\r\n".to_owned(),
            ..Self::text("401 Unauthorized", why)
        }
    }

    /// Redirects to the page, with the token in a cookie rather than in the URL. `token` was checked before, so it
    /// contains no character that could end a header.
    pub(super) fn with_cookie(name: &str, token: &str) -> Self {
        let extra = format!(
            "Location: /\r\nSet-Cookie: {name}={token}; Path=/; HttpOnly; SameSite=Strict\r\n"
        );
        Self {
            extra,
            ..Self::text("303 See Other", "")
        }
    }

    /// The web page. Its policy permits scripts and styles from this server only, none in the page itself, and no connections
    /// except to this server and to the port of the stop channel.
    pub(super) fn page(body: &str, stop: Option<u16>) -> Self {
        let stop = stop.map_or_else(String::new, |port| format!(" http://*:{port}"));
        Self {
            kind: "text/html; charset=utf-8",
            extra: format!(
                "Content-Security-Policy: default-src 'none'; style-src 'self'; script-src 'self'; \
                 connect-src 'self'{stop}; img-src 'self' data:; base-uri 'none'; form-action 'none'; \
                 frame-ancestors 'none'\r\nReferrer-Policy: no-referrer\r\n"
            ),
            ..Self::text("200 OK", body)
        }
    }

    /// A text with another content type.
    pub(super) fn of_kind(kind: &'static str, body: String) -> Self {
        Self {
            kind,
            ..Self::text("200 OK", body)
        }
    }

    /// A file to be saved under this name.
    pub(super) fn file(name: &str, download: Download) -> Self {
        let is_plain = |c: char| c.is_ascii_alphanumeric() || "._-".contains(c);
        let letters = name.chars().map(|c| if is_plain(c) { c } else { '_' });
        let name: String = letters.collect();
        Self {
            status: "200 OK",
            kind: "application/octet-stream",
            extra: format!("Content-Disposition: attachment; filename=\"{name}\"\r\n"),
            body: Body::File(download),
        }
    }

    /// The same head, without a body: the response to HEAD.
    pub(crate) fn without_body(self) -> Self {
        let body = Body::Omitted(self.body.length());
        Self { body, ..self }
    }

    /// The file whose bytes follow its text.
    pub(crate) fn download(&self) -> Option<Download> {
        match &self.body {
            Body::File(download) => Some(download.clone()),
            Body::Text(_) | Body::Omitted(_) => None,
        }
    }

    /// A bound is exceeded, and which one.
    pub(crate) fn too_many(why: impl fmt::Display) -> Self {
        Self::text("503 Service Unavailable", format!("{why}\n"))
    }

    /// The resource is for WebSocket only.
    pub(super) fn upgrade_required() -> Self {
        Self {
            extra: "Upgrade: websocket\r\n".to_owned(),
            ..Self::text(
                "426 Upgrade Required",
                "This resource is for WebSocket only.\n",
            )
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
        let length = body.length();
        let text = match body {
            Body::Text(text) => text,
            Body::File(_) | Body::Omitted(_) => "",
        };
        write!(
            f,
            "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {length}\r\n{extra}\
             Cache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\n\
             Connection: close\r\n\r\n{text}"
        )
    }
}
