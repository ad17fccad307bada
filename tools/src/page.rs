//! `takt page`: prints the address of a controller's page for a browser, with the token that the browser gives once and
//! then keeps as a cookie. It connects to nothing.

use clap::Args;
use takt_client::Token;

use crate::http::Site;
use crate::output::say;
use crate::{Verdict, token};

/// Print the address of a controller's page, with the token that a browser gives once.
///
/// Anyone who has the printed line can command the robots: keep it out of logs and chats.
#[derive(Debug, Args)]
pub(crate) struct Page {
    #[command(flatten)]
    site: Site,
}

impl Page {
    pub(crate) fn run(self) -> anyhow::Result<Verdict> {
        let Site {
            connect,
            token_file,
        } = self.site;
        let token = token::of_client(token_file.as_deref(), Some(&connect))?;
        say(&link(&connect, token.as_ref()))?;
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
