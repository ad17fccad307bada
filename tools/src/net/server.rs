//! The controller that a command talks to: address and token, as options of every such command.

use std::path::PathBuf;

use clap::Args;

use crate::client::Client;
use crate::token;

/// Where the controller listens.
#[derive(Debug, Args)]
pub(crate) struct Server {
    /// Where the controller listens: an address, or the path of its Unix socket; else the Unix socket of this
    /// account or of the service, else 127.0.0.1:8081.
    #[arg(long, alias = "server", value_name = "HOST:PORT")]
    pub(crate) connect: Option<String>,
    /// File with the token that the controller asks for; else TAKT_TOKEN_FILE or TAKT_TOKEN.
    #[arg(long, value_name = "FILE")]
    pub(crate) token_file: Option<PathBuf>,
}

impl Server {
    pub(crate) fn connect(&self) -> anyhow::Result<Client> {
        let token = token::of_client(self.token_file.as_deref(), self.connect.as_deref())?;
        Client::connect(self.connect.as_deref(), token.as_ref())
    }

    /// The same for motions.
    pub(crate) fn cell(&self) -> anyhow::Result<takt_api::Cell> {
        let token = token::of_client(self.token_file.as_deref(), self.connect.as_deref())?;
        let cell = match self.connect.as_deref() {
            Some(address) => takt_api::Cell::connect_with(address, token.as_ref()),
            None => takt_api::Cell::connect_here(token.as_ref()),
        };
        // The line of the program is one of this tool, and says nothing to its user.
        cell.map_err(|error| anyhow::anyhow!(error.kind.to_string()))
    }
}
