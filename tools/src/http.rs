//! Requests of subcommands to the HTTP resources of a running controller. The meaning of the resources is not known here.

use std::io::{Read as _, Write as _};
use std::net::{TcpStream, ToSocketAddrs as _};
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context as _, bail};
use clap::Args;
use serde_json::Value;
use takt_client::Token;

use crate::token;

/// Longest response, bytes.
const RESPONSE_MAX: u64 = 16 << 20;

/// Where the controller serves HTTP.
#[derive(Clone, Debug, Args)]
pub(crate) struct Site {
    /// Where the controller listens: `websocket` of its cell.toml.
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:8080")]
    pub(crate) connect: String,
    /// File with the controller's token; else TAKT_TOKEN_FILE or TAKT_TOKEN, or the file that a controller of this account made.
    #[arg(long, value_name = "FILE")]
    pub(crate) token_file: Option<PathBuf>,
}

impl Site {
    /// A client whose connections and answers may each take so long.
    pub(crate) fn client(&self, timeout: Duration) -> anyhow::Result<Http> {
        Http::new(&self.connect, self.token_file.as_deref(), timeout)
    }
}

/// A client of the HTTP resources, with a connection for each request.
#[derive(Clone, Debug)]
pub(crate) struct Http {
    address: String,
    token: Option<Token>,
    timeout: Duration,
}

impl Http {
    /// A client of `HOST:PORT` or `http://HOST:PORT`. It connects to nothing yet.
    pub(crate) fn new(
        url: &str,
        token_file: Option<&Path>,
        timeout: Duration,
    ) -> anyhow::Result<Self> {
        let address = url.strip_prefix("http://").unwrap_or(url);
        let address = address.trim_end_matches('/').to_owned();
        let token = token::of_client(token_file, Some(&address))?;
        Ok(Self {
            address,
            token,
            timeout,
        })
    }

    #[cfg(feature = "fleet")]
    /// A client of `HOST:PORT` with this token. It connects to nothing yet.
    pub(crate) const fn with_token(
        address: String,
        token: Option<Token>,
        timeout: Duration,
    ) -> Self {
        Self {
            address,
            token,
            timeout,
        }
    }

    /// `HOST:PORT`.
    pub(crate) fn address(&self) -> &str {
        &self.address
    }

    /// The token that it sends.
    #[must_use]
    pub(crate) const fn token(&self) -> Option<&Token> {
        self.token.as_ref()
    }

    /// A connection, whose reads end after the timeout.
    pub(crate) fn connect(&self) -> anyhow::Result<TcpStream> {
        let address = &self.address;
        let mut addresses = address
            .to_socket_addrs()
            .with_context(|| format!("{address} is no address\nhint: write HOST:PORT"))?;
        let first = addresses
            .next()
            .with_context(|| format!("{address} is unknown"))?;
        let hint = "no controller answers there\nhint: see `websocket` in its cell.toml";
        let stream = TcpStream::connect_timeout(&first, self.timeout)
            .with_context(|| format!("{address}: {hint}"))?;
        stream.set_read_timeout(Some(self.timeout))?;
        stream.set_write_timeout(Some(self.timeout))?;
        Ok(stream)
    }

    /// A resource as JSON.
    pub(crate) fn get(&self, path: &str) -> anyhow::Result<Value> {
        self.request("GET", path)
    }

    /// A request without a form; its response as JSON.
    pub(crate) fn post(&self, path: &str) -> anyhow::Result<Value> {
        self.request("POST", path)
    }

    fn request(&self, method: &str, path: &str) -> anyhow::Result<Value> {
        let address = &self.address;
        let mut stream = self.connect()?;
        let bearer = self.token.as_ref().map_or_else(String::new, |token| {
            format!("Authorization: Bearer {}\r\n", token.text())
        });
        let request = format!(
            "{method} {path} HTTP/1.1\r\nHost: {address}\r\nContent-Length: 0\r\nAccept: application/json\r\n{bearer}Connection: close\r\n\r\n"
        );
        // At once: a peer that answers and closes before the rest is no error.
        stream
            .write_all(request.as_bytes())
            .with_context(|| format!("{address}: cannot send a request"))?;
        let mut response = Vec::new();
        let silent = || {
            let span = self.timeout;
            format!(
                "{address}: the controller has not answered within {span:?}\nhint: see its log, and the load of its host"
            )
        };
        stream
            .take(RESPONSE_MAX)
            .read_to_end(&mut response)
            .with_context(silent)?;
        let response = String::from_utf8_lossy(&response);
        let (head, body) = response
            .split_once("\r\n\r\n")
            .with_context(|| format!("{address}: no HTTP response"))?;
        let status = head.lines().next().unwrap_or_default();
        if !status.contains(" 200 ") {
            bail!("{}", body.trim_end());
        }
        serde_json::from_str(body).with_context(|| format!("{address}: no JSON"))
    }
}
