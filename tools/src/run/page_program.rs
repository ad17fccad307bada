//! What the page of a controller gets from this program: the findings of `takt doctor`, the cells of its fleet, and nets that jog arms, written by the
//! Robotics API, which connects to the controller as any program.

use std::path::PathBuf;
use std::sync::{Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use takt_api::{Arm, Cell, Error};
use takt_client::Token;
use takt_server::{HostProgram, JogKind, ServerThreads};

use super::fleet::FleetView;
use crate::motion::hinted;

/// How long findings are kept: some are read from many files.
const FINDINGS_KEPT: Duration = Duration::from_secs(5);

/// The program behind the page.
#[derive(Debug, Default)]
pub(super) struct PageProgram {
    token: Option<Token>,
    /// Where the controller takes programs, once it listens.
    address: OnceLock<String>,
    findings: Mutex<Option<(Instant, String)>>,
    /// What the controller sees of its fleet.
    fleet: FleetView,
}

impl PageProgram {
    pub(super) fn new(token: Option<&Token>, fleet: FleetView) -> Self {
        let token = token.cloned();
        Self {
            token,
            fleet,
            ..Self::default()
        }
    }

    /// The server listens.
    pub(super) fn set_server(&self, server: &ServerThreads) {
        let tcp = server.tcp_address().map(|address| address.to_string());
        let local = server.local_path().map(PathBuf::from);
        let local = local.map(|path| path.display().to_string());
        if let Some(address) = tcp.or(local) {
            // Set once, when the server starts.
            let _ = self.address.set(address);
        }
    }

    fn arm(&self, name: &str) -> Result<Arm, String> {
        let address = self.address.get().ok_or(
            "the controller takes programs neither over TCP nor over a Unix socket\nhint: set `tcp` or `socket` under [controller]",
        )?;
        let cell = Cell::connect_with(address, self.token.as_ref()).map_err(text)?;
        cell.arm(name).map_err(text)
    }
}

/// Cause and hint of an error; the line of the program that it names is one of this file.
fn text(error: Error) -> String {
    format!("{:#}", hinted(error))
}

impl HostProgram for PageProgram {
    fn findings(&self) -> Result<String, String> {
        let mut kept = self.findings.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, findings)) = kept.as_ref().filter(|it| it.0.elapsed() < FINDINGS_KEPT) {
            return Ok(findings.clone());
        }
        let findings = crate::doctor::findings().map_err(|error| format!("{error:#}"))?;
        *kept = Some((Instant::now(), findings.clone()));
        Ok(findings)
    }

    fn cells(&self) -> Result<Option<String>, String> {
        self.fleet.cells()
    }

    fn jog_net(&self, arm: &str, kind: JogKind, speed: f64) -> Result<String, String> {
        let arm = self.arm(arm)?;
        let explained = match kind {
            JogKind::Joints => arm.jog_joints().speed(speed).explain(),
            JogKind::Flange => arm.jog().speed(speed).explain(),
        };
        Ok(explained.map_err(text)?.net)
    }
}
