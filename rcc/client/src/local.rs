//! Where the Unix socket of a controller on this host is. The kernel reports the account of a client, so no token is
//! needed there.

use std::path::{Path, PathBuf};

/// File name of the socket.
pub const NAME: &str = "takt.sock";

/// Runtime directory of the service.
pub const SERVICE_DIRECTORY: &str = "/run/takt";

/// Paths at which a client searches for a controller: first of the same account's session, then of the service.
pub fn client_paths() -> Vec<PathBuf> {
    let session = std::env::var_os("XDG_RUNTIME_DIR").filter(|value| !value.is_empty());
    let session = session.map(|directory| Path::new(&directory).join("takt").join(NAME));
    let service = Path::new(SERVICE_DIRECTORY).join(NAME);
    session.into_iter().chain([service]).collect()
}
