//! The options by which a fleet is reached, and the connection made of them.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use takt_fleet::config::{Observer, TlsFiles};
use takt_fleet::session::observer;

use crate::output::span_of_ms;

/// How the fleet is reached.
#[derive(Clone, Debug, Args)]
pub(super) struct Link {
    /// Where a cell or router listens, `listen` under `[fleet]` of its cell file; given several times, a link to each.
    #[arg(long, value_name = "ENDPOINT", default_value = "tcp/127.0.0.1:7447")]
    pub(super) connect: Vec<String>,
    /// Certificate of the authority of all members, PEM, for tls/… endpoints.
    #[arg(long, value_name = "FILE", requires = "certificate")]
    ca: Option<PathBuf>,
    /// Own certificate, PEM; its common name is what [[fleet.allow]] of a cell names.
    #[arg(long, value_name = "FILE", requires = "key")]
    certificate: Option<PathBuf>,
    /// Its private key, PEM.
    #[arg(long, value_name = "FILE", requires = "ca")]
    key: Option<PathBuf>,
    /// How long cells may take to answer, 100ms to 60s.
    #[arg(long, value_name = "TIME", default_value = "2s", value_parser = span_of_ms(100..=60_000))]
    pub(super) timeout: Duration,
}

impl Link {
    /// As a program that observes at these endpoints.
    pub(super) fn observer(&self, connect: Vec<String>) -> Observer {
        let tls = match (&self.ca, &self.certificate, &self.key) {
            (Some(ca), Some(certificate), Some(key)) => Some(TlsFiles {
                ca: ca.clone(),
                certificate: certificate.clone(),
                key: key.clone(),
            }),
            _ => None,
        };
        Observer { connect, tls }
    }

    pub(super) fn open(&self) -> anyhow::Result<observer::Fleet> {
        Ok(observer::Fleet::connect(
            &self.observer(self.connect.clone()),
        )?)
    }
}
