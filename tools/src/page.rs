//! `takt page`: prints the address of a controller's page for a browser, with the token that the browser gives once and
//! then keeps as a cookie. It connects to nothing.

use std::path::PathBuf;

use clap::Args;
use takt_client::Token;

use crate::output::say;
use crate::{Verdict, token};

/// Print the address of a controller's page, with the token that a browser gives once.
///
/// Anyone who has the printed line can command the robots: keep it out of logs and chats.
#[derive(Debug, Args)]
pub(crate) struct Page {
    /// Where the controller listens: `websocket` of its cell.toml.
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:8080")]
    connect: String,
    /// File with the controller's token; else TAKT_TOKEN_FILE or TAKT_TOKEN, or the file that a controller of this account made.
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
}

impl Page {
    pub(crate) fn run(self) -> anyhow::Result<Verdict> {
        let token = token::of_client(self.token_file.as_deref(), Some(&self.connect))?;
        say(&link(&self.connect, token.as_ref()))?;
        Ok(Verdict::Good)
    }
}

fn link(address: &str, token: Option<&Token>) -> String {
    match token {
        // Its characters need no escape.
        Some(token) => format!("http://{address}/?token={}", token.text()),
        None => format!("http://{address}/"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn page_link_carries_token() {
        let token = Token::new("0123456789abcdef").unwrap();
        assert_eq!(
            link("127.0.0.1:8080", Some(&token)),
            "http://127.0.0.1:8080/?token=0123456789abcdef"
        );
        assert_eq!(link("robot:8080", None), "http://robot:8080/");
    }
}
