//! The bytes of a file as a response, with bounded memory.

use std::io::{self, Read as _};
use std::sync::Arc;

use super::{Link, shut_down};
use crate::error::Error;
use crate::http;
use crate::server::ConnectionContext;

/// Bytes of a file that are in memory at once.
const FILE_BYTES: usize = 64 << 10;

impl Link {
    /// Sends a file piece by piece. A client that takes no piece for 10 s is lost; a file that became shorter ends the
    /// connection before its announced length.
    pub(super) async fn send_file(
        &mut self,
        download: http::Download,
        context: &ConnectionContext,
    ) -> Result<(), Error> {
        let mut shutdown = context.shutdown.clone();
        let (mut left, mut piece) = (download.bytes, vec![0; FILE_BYTES]);
        while left > 0 {
            let file = Arc::clone(&download.file);
            let wanted = usize::try_from(left).map_or(FILE_BYTES, |left| left.min(FILE_BYTES));
            let work = move || {
                let read = file
                    .as_ref()
                    .read(piece.get_mut(..wanted).unwrap_or_default());
                read.map(|bytes| (piece, bytes))
            };
            let worked = tokio::task::spawn_blocking(work).await;
            let read = worked.map_err(|e| self.io_error(io::Error::other(e)))?;
            let (back, bytes) = read.map_err(|e| self.io_error(e))?;
            piece = back;
            if bytes == 0 {
                return Err(self.io_error(io::ErrorKind::UnexpectedEof.into()));
            }
            tokio::select! {
                () = shut_down(&mut shutdown) => return Ok(()),
                sent = self.send(piece.get(..bytes).unwrap_or_default()) => sent?,
            }
            context.slot.touch(context.site.now());
            left -= bytes as u64;
        }
        Ok(())
    }
}
