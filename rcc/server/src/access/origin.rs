//! Which web pages may send a request, and by which host names a request without a token may address this server.
//! A browser lets any page send forms to any host and open WebSockets to it, and an attacker can make a name of his
//! own resolve to this host (DNS rebinding). The protection is what the browser itself reports in `Origin`,
//! `Sec-Fetch-Site` and `Host`. Programs other than browsers can send any header; the token protects against those.

use std::net::IpAddr;

/// Host names and origins that are accepted besides this server's own.
#[derive(Clone, Debug)]
pub(crate) struct Origins {
    /// Names of this host, with or without a port.
    pub(crate) hosts: Vec<String>,
    /// Page origins of other servers.
    pub(crate) origins: Vec<String>,
    /// The section of the cell file that lists them.
    pub(crate) section: &'static str,
}

impl Default for Origins {
    fn default() -> Self {
        Self {
            hosts: Vec::new(),
            origins: Vec::new(),
            section: "[controller]",
        }
    }
}

/// The headers by which a request states where it comes from.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Sender<'a> {
    /// `Host`.
    pub(crate) host: Option<&'a str>,
    /// `Origin`.
    pub(crate) origin: Option<&'a str>,
    /// `Sec-Fetch-Site`: how the page relates to this server.
    pub(crate) site: Option<&'a str>,
    /// Whether it is a navigation by link, rather than a subresource of another page.
    pub(crate) navigates: bool,
}

impl Origins {
    /// Whether the web page that sends a request, if any, is permitted. Programs send no `Origin`.
    pub(crate) fn admit_page(&self, sender: &Sender<'_>) -> bool {
        match (sender.origin, sender.site) {
            (Some(origin), _) => self.is_listed(origin) || is_own(origin, sender.host),
            (None, None | Some("same-origin" | "none")) => true,
            // Images and other subresources of foreign pages carry no origin.
            (None, Some(_)) => sender.navigates,
        }
    }

    /// Whether a request without a token may be addressed to `host`; `reached` is the local address of its
    /// connection. Browsers always send `Host`.
    pub(crate) fn admit_host(&self, host: Option<&str>, reached: Option<IpAddr>) -> bool {
        let Some(host) = host else {
            return true;
        };
        let name = without_port(host);
        let is_ours = |address: IpAddr| address.is_loopback() || Some(address) == reached;
        let listed = |h: &String| h.eq_ignore_ascii_case(host) || h.eq_ignore_ascii_case(name);
        let literal = name.trim_start_matches('[').trim_end_matches(']');
        name.eq_ignore_ascii_case("localhost")
            || literal.parse().is_ok_and(is_ours)
            || self.hosts.iter().any(listed)
    }

    fn is_listed(&self, origin: &str) -> bool {
        self.origins.iter().any(|o| o.eq_ignore_ascii_case(origin))
    }
}

/// Whether the page's origin has the host and port that the request is sent to.
fn is_own(origin: &str, host: Option<&str>) -> bool {
    let of_page = origin.split_once("://").map(|(_, host)| host);
    matches!((of_page, host), (Some(page), Some(host)) if page.eq_ignore_ascii_case(host))
}

fn without_port(host: &str) -> &str {
    match host.rsplit_once(':') {
        Some((name, port)) if port.bytes().all(|b| b.is_ascii_digit()) && !name.ends_with(':') => {
            name
        }
        _ => host,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn origins() -> Origins {
        Origins {
            hosts: vec!["robot".to_owned(), "cell:9000".to_owned()],
            origins: vec!["http://localhost:3000".to_owned()],
            ..Origins::default()
        }
    }

    #[test]
    fn rebound_host_is_rejected() {
        let reached = Some(IpAddr::from([192, 0, 2, 7]));
        let admits = |host: &str| origins().admit_host(Some(host), reached);
        for host in [
            "localhost",
            "LOCALHOST:8080",
            "127.0.0.1:8080",
            "127.1.2.3",
            "[::1]:8080",
            "[::1]",
            "192.0.2.7:8080",
            "robot:8080",
            "Robot",
            "cell:9000",
        ] {
            assert!(admits(host), "{host}");
        }
        for host in [
            "",
            "evil.example",
            "localhost.evil.example:8080",
            "127.0.0.1.evil.example",
            "192.0.2.8",
            "cell",
            "cell:9001",
            "localhost@evil.example",
            "::1:x",
        ] {
            assert!(!admits(host), "{host}");
        }
        assert!(origins().admit_host(None, reached), "no browser");
    }

    #[test]
    fn page_from_other_origin_is_rejected() {
        let admits = |origin, site, navigates| {
            origins().admit_page(&Sender {
                host: Some("localhost:8080"),
                origin,
                site,
                navigates,
            })
        };
        assert!(admits(None, None, false), "a program");
        assert!(admits(
            Some("http://localhost:8080"),
            Some("same-origin"),
            false
        ));
        assert!(admits(
            Some("http://localhost:3000"),
            Some("same-site"),
            false
        ));
        for origin in [
            "http://localhost:3001",
            "http://127.0.0.1:8080",
            "http://localhost",
            "http://evil.example",
            "null",
            "",
        ] {
            assert!(!admits(Some(origin), None, false), "{origin}");
        }
        assert!(admits(None, Some("none"), false), "typed by a person");
        assert!(admits(None, Some("cross-site"), true), "a link");
        for site in ["cross-site", "same-site", "whatever"] {
            assert!(!admits(None, Some(site), false), "{site}");
        }
    }
}
