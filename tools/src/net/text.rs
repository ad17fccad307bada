//! The text of a net on the command line: where it is read, and how its faults are shown.

use std::path::Path;

use anyhow::Context as _;
use takt_net::Rejection;

use crate::output::complain;

/// Maximum size of a net's text, bytes: more than a controller accepts in one message.
const NET_BYTES_MAX: u64 = 64 << 20;

/// The text of a net, from a file or standard input.
pub(super) fn read(file: &Path) -> anyhow::Result<String> {
    if file == Path::new("-") {
        let text = takt_core::files::text_of(std::io::stdin().lock(), NET_BYTES_MAX);
        return text.context("cannot read standard input");
    }
    takt_core::files::read_text(file, NET_BYTES_MAX)
        .with_context(|| format!("cannot read {}", file.display()))
}

/// Prints all faults of a net, with their locations.
pub(super) fn complain_of(rejection: &Rejection, name: &str, text: &str) {
    complain(rejection.render(name, text).trim_end());
    let count = rejection.faults.len();
    let plural = if count == 1 { "" } else { "s" };
    complain(&format!("{name}: {count} fault{plural}"));
}
