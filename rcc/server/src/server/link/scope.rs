//! A connection to the scope: its bytes, and when it is polled.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use tokio::time::Instant;

use super::{IDLE_TIMEOUT, Link, READ_BYTES, admit, read, shut_down, sleep_until};
use crate::codec::Received;
use crate::error::Error;
use crate::http::{self, Upgrade};
use crate::live::Loss;
use crate::scope::{REQUEST_BYTES_MAX, SCOPES_MAX, ScopeClient};
use crate::server::ConnectionContext;
use crate::server::slots::Pool;
use crate::site::{Counters, Site};

impl Link {
    /// Serves a client of the scope until it disconnects.
    pub(super) async fn serve_scope(
        &mut self,
        upgrade: Upgrade,
        context: &ConnectionContext,
    ) -> Result<(), Error> {
        let Ok(_permit) = Arc::clone(&context.scopes).try_acquire_owned() else {
            let response = http::too_many_connections(SCOPES_MAX).to_string();
            self.send(response.as_bytes()).await?;
            return self.finish().await;
        };
        admit(context, Pool::Messages(upgrade.credential))?;
        self.codec.raise_bound_to(REQUEST_BYTES_MAX);
        self.send(upgrade.response.as_bytes()).await?;
        let mut client = Some(ScopeClient::new(context.site.controller.clone()));
        let mut shutdown = context.shutdown.clone();
        let mut received = Vec::new();
        let (site, mut loss) = (&context.site, Loss::default());
        loop {
            loop {
                match self.codec.poll() {
                    Ok(None) => break,
                    Ok(Some(Received::Line(text))) => {
                        Counters::add(&self.counters.received, 1);
                        let work = move |c: &mut ScopeClient, now| c.handle_text(&text, now);
                        self.with_scope(&mut client, work).await?;
                        self.note_loss(&mut client, &mut loss, site);
                    }
                    Ok(Some(Received::Reply(bytes))) => self.send(&bytes).await?,
                    Ok(Some(Received::Close(bytes))) => return self.send(&bytes).await,
                    Err(error) => return Err(error),
                }
            }
            let due = client.as_ref().and_then(ScopeClient::poll_timeout);
            let due = due.map(|at| self.begin + at);
            let is_idle = client.as_ref().is_some_and(ScopeClient::is_idle);
            tokio::select! {
                biased;
                () = shut_down(&mut shutdown) => return Ok(()),
                alive = read(&mut self.stream, &mut received, READ_BYTES) => {
                    if !alive.map_err(|e| self.io_error(e))? {
                        return Ok(());
                    }
                    self.received_at = Instant::now();
                    context.slot.touch(context.site.now());
                    self.codec.push(&received);
                    received.clear();
                }
                () = sleep_until(due) => {
                    self.with_scope(&mut client, ScopeClient::poll).await?;
                    self.note_loss(&mut client, &mut loss, site);
                    // What was sent was taken: the client is not idle.
                    context.slot.touch(context.site.now());
                }
                () = tokio::time::sleep_until(self.received_at + IDLE_TIMEOUT), if is_idle => {
                    return Ok(());
                }
            }
        }
    }

    /// Counts what the client lost, and logs an onset.
    fn note_loss(&self, client: &mut Option<ScopeClient>, loss: &mut Loss, site: &Site) {
        let lost = client.as_mut().map_or(0, ScopeClient::take_lost);
        Counters::add(&self.counters.scope_lost, lost);
        if loss.add(lost, std::time::Instant::now()) {
            let line = format!(
                "scope of {}: {lost} samples are lost: it reads too slowly\nhint: fewer probes, or each n-th cycle with `every`",
                self.peer
            );
            site.warn(|limits| &limits.scopes, &line);
        }
    }

    /// Calls the client in a thread that may block, and sends what it returns.
    async fn with_scope(
        &mut self,
        client: &mut Option<ScopeClient>,
        work: impl FnOnce(&mut ScopeClient, Duration) -> Vec<u8> + Send + 'static,
    ) -> Result<(), Error> {
        let Some(mut own) = client.take() else {
            return Ok(());
        };
        let now = self.begin.elapsed();
        let worked = tokio::task::spawn_blocking(move || {
            let bytes = work(&mut own, now);
            (own, bytes)
        });
        let (own, bytes) = worked
            .await
            .map_err(|e| self.io_error(io::Error::other(e)))?;
        *client = Some(own);
        if bytes.is_empty() {
            return Ok(());
        }
        Counters::add(&self.counters.sent, 1);
        self.send(&bytes).await
    }
}
