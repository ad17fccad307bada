//! Which clients a controller admits, by its cell, and warnings on open access.

use std::net::SocketAddr;
use std::path::Path;

use takt_client::Token;
use takt_core::CellConfig;
use takt_server::{Error, LocalSocket, Loopback, Server, ServerConfig, local};

use crate::token;

/// Which clients are admitted.
#[derive(Debug, Default)]
pub(crate) struct Access {
    socket: Option<LocalSocket>,
    /// Whether the cell names the socket, so that nothing runs without it.
    is_configured: bool,
    token: Option<Token>,
    loopback: Option<Loopback>,
    hosts: Vec<String>,
    origins: Vec<String>,
}

impl Access {
    /// Access by the cell; a token may be made.
    pub(super) fn of_cell(cell: &CellConfig) -> anyhow::Result<Self> {
        let cell = &cell.controller;
        let path = match &cell.socket {
            Some(path) if path == Path::new("") => None,
            Some(path) => Some(path.clone()),
            None => Some(local::default_path()),
        };
        let group = cell.socket_group.clone();
        let token = token::of_controller(cell.token_file.as_deref(), cell.loopback)?;
        Ok(Self {
            socket: path.map(|path| LocalSocket { path, group }),
            is_configured: cell.socket.is_some() || cell.socket_group.is_some(),
            token,
            loopback: cell.loopback,
            hosts: cell.hosts.clone(),
            origins: cell.origins.clone(),
        })
    }

    /// What clients give that are not admitted without.
    pub(super) const fn token(&self) -> Option<&Token> {
        self.token.as_ref()
    }

    /// Listens, and logs what is open. A Unix socket that the cell does not name may be missing: another controller
    /// may have it.
    pub(super) async fn bind(self, config: ServerConfig) -> Result<Server, Error> {
        let is_open = match self.loopback {
            None => self.token.is_none(),
            Some(loopback) => loopback == Loopback::Open,
        };
        let open = [config.http, config.tcp]
            .into_iter()
            .flatten()
            .filter(|_| is_open && self.socket.is_some());
        let open: Vec<_> = open.collect();
        let config = ServerConfig {
            local: self.socket,
            token: self.token,
            loopback: self.loopback,
            hosts: self.hosts,
            origins: self.origins,
            ..config
        };
        let server = match Server::bind(config.clone()).await {
            Err(error @ Error::Local { .. }) if !self.is_configured => {
                tracing::warn!("{error}; tools reach this controller by --connect only");
                let local = None;
                Server::bind(ServerConfig { local, ..config }).await
            }
            bound => bound,
        };
        if server.is_ok() && !open.is_empty() {
            tracing::info!("{}", open_line(&open));
        }
        server
    }
}

/// What it means that loopback is open.
fn open_line(addresses: &[SocketAddr]) -> String {
    let addresses: Vec<_> = addresses.iter().map(SocketAddr::to_string).collect();
    format!(
        "loopback is open: every account and program of this host can command robots by {} without a token; \
         loopback = \"token\" under [controller] of cell.toml ends that, for clients that know no token too",
        addresses.join(" and ")
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn access(text: &str) -> Access {
        let cell = takt_devices::parse_cell(&format!("[controller]\n{text}")).unwrap();
        Access::of_cell(&cell).unwrap()
    }

    #[test]
    fn access_socket_is_that_of_cell_or_default() {
        let path = |text| access(text).socket.map(|socket| socket.path);
        assert_eq!(path(""), Some(local::default_path()));
        assert_eq!(path("socket = \"\""), None);
        assert_eq!(path("socket = \"/run/a\""), Some("/run/a".into()));
        assert!(access("socket_group = \"takt\"").is_configured);
        assert!(!access("").is_configured);
    }

    #[test]
    fn log_line_names_what_is_open_and_the_key() {
        let line = open_line(&[SocketAddr::from(([127, 0, 0, 1], 8080))]);
        assert!(line.contains("127.0.0.1:8080"), "{line}");
        assert!(line.contains("loopback = \"token\""), "{line}");
    }
}
