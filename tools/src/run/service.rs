//! Notifications to the service manager: ready, reloading, stopping, a status line, the watchdog. Without a service
//! manager the same code runs and sends none.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::Context as _;
use sd_notify::NotifyState;
use takt_core::{CellConfig, Controller};
use tokio::signal::unix::{Signal, SignalKind, signal};

use super::reload::apply;
use super::rest::come_to_rest;
use super::state_file::{LastState, StateFile};
use super::watchdog::Watchdog;
use crate::logging::Logging;
use crate::output::complain;

/// How often changes are polled.
const POLL_EVERY: Duration = Duration::from_millis(100);

/// A controller in service.
#[derive(Debug)]
pub(super) struct Service<'a> {
    config: &'a Path,
    /// The cell of the controller at present.
    cell: CellConfig,
    controller: &'a Controller,
    logging: Logging,
    notifier: Notifier,
}

/// Writes changes to the service manager and the state directory, each once.
#[derive(Debug)]
struct Notifier {
    began: Instant,
    watchdog: Option<Watchdog>,
    file: StateFile,
    status: String,
    /// Whether nets or devices changed since the last poll.
    changed: Arc<AtomicBool>,
    _watch: takt_core::controller::Watch,
    /// Remarks on the run before, and on the last reload.
    remarks: [Option<String>; 2],
}

/// Events of the service.
enum Wake {
    Poll,
    Reload,
    Stop,
}

impl<'a> Service<'a> {
    /// `cell` is what the controller was started with.
    pub(super) fn new(
        config: &'a Path,
        cell: CellConfig,
        controller: &'a Controller,
        logging: Logging,
    ) -> Self {
        let directory = std::env::var_os("STATE_DIRECTORY").map(PathBuf::from);
        let (file, before) = StateFile::open(directory.as_deref());
        let before = before.and_then(|before| before.broken_off());
        if let Some(remark) = &before {
            tracing::warn!("{remark}");
        }
        let changed = Arc::new(AtomicBool::new(true));
        let changed_by_event = Arc::clone(&changed);
        let notifier = Notifier {
            _watch: controller.on_change(move |_| changed_by_event.store(true, Ordering::Relaxed)),
            changed,
            began: Instant::now(),
            watchdog: sd_notify::watchdog_enabled().map(Watchdog::new),
            file,
            status: String::new(),
            remarks: [before, None],
        };
        Self {
            config,
            cell,
            controller,
            logging,
            notifier,
        }
    }

    /// Runs until asked to end, and then until the robots are at rest.
    pub(super) fn run(mut self) -> anyhow::Result<()> {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()?;
        runtime.block_on(async {
            let listen = |kind| signal(kind).context("cannot listen for signals");
            let mut hangup = listen(SignalKind::hangup())?;
            let mut terminate = listen(SignalKind::terminate())?;
            let mut ticks = tokio::time::interval(POLL_EVERY);
            self.notifier.poll(self.controller, None);
            notify(&[NotifyState::Ready]);
            loop {
                match wake(&mut ticks, &mut hangup, &mut terminate).await {
                    Wake::Poll => self.notifier.poll(self.controller, None),
                    Wake::Reload => self.reload(),
                    Wake::Stop => return anyhow::Ok(()),
                }
            }
        })?;
        notify(&[NotifyState::Stopping]);
        self.notifier.changed.store(true, Ordering::Relaxed);
        let Self {
            controller,
            notifier,
            ..
        } = &mut self;
        come_to_rest(controller, || notifier.poll(controller, Some("stopping")));
        self.notifier.file.close();
        Ok(())
    }

    /// Reloads the cell. A cell that cannot be read changes nothing.
    fn reload(&mut self) {
        let now = NotifyState::monotonic_usec_now();
        let reloading = now.map(|now| vec![NotifyState::Reloading, now]);
        notify(&reloading.unwrap_or_else(|_| vec![NotifyState::Reloading]));
        let remark = match takt_devices::read_cell(self.config) {
            Ok(new) => {
                let logging = &self.logging;
                let reloaded = apply(&mut self.cell, &new, self.controller, |log| {
                    logging.change(log)
                });
                reloaded
                    .applied
                    .iter()
                    .for_each(|line| tracing::info!("reload: {line}"));
                reloaded
                    .refused
                    .iter()
                    .for_each(|line| tracing::warn!("reload: {line}"));
                reloaded.status()
            }
            Err(error) => {
                tracing::error!(%error, "reload: the cell stays as it is");
                format!("reload failed, the cell stays as it is: {error}")
            }
        };
        self.notifier.remarks[1] = Some(remark);
        self.notifier.changed.store(true, Ordering::Relaxed);
        self.notifier.poll(self.controller, None);
        notify(&[NotifyState::Ready]);
    }
}

async fn wake(
    ticks: &mut tokio::time::Interval,
    hangup: &mut Signal,
    terminate: &mut Signal,
) -> Wake {
    tokio::select! {
        _ = tokio::signal::ctrl_c() => Wake::Stop,
        _ = terminate.recv() => Wake::Stop,
        _ = hangup.recv() => Wake::Reload,
        _ = ticks.tick() => Wake::Poll,
    }
}

impl Notifier {
    /// Feeds the watchdog if cycles ran, and reports changes. `doing` comes first in the status.
    fn poll(&mut self, controller: &Controller, doing: Option<&str>) {
        let cycles = || {
            let threads = controller.threads().into_iter();
            threads.map(|thread| thread.stats.cycles).collect()
        };
        let now = self.began.elapsed();
        if self
            .watchdog
            .as_mut()
            .is_some_and(|dog| dog.poll(now, cycles))
        {
            notify(&[NotifyState::Watchdog]);
        }
        if !self.changed.swap(false, Ordering::Relaxed) {
            return;
        }
        let state = LastState::of(controller);
        let status = status(&state, doing, &self.remarks);
        // The file first: readers of the status may rely on it.
        self.file.write(state);
        if status != self.status {
            notify(&[NotifyState::Status(&status)]);
            self.status = status;
        }
    }
}

/// The line that `systemctl status` shows.
fn status(state: &LastState, doing: Option<&str>, remarks: &[Option<String>]) -> String {
    let nets = match &*state.nets {
        [] => "no net runs".to_owned(),
        [net] => format!("{} runs", net.net),
        nets => format!("{} nets run", nets.len()),
    };
    let devices = state.devices.iter();
    let devices = devices.map(|(name, status)| format!("{name} is {status}"));
    let parts = doing.map(str::to_owned).into_iter().chain([nets]);
    let parts = parts
        .chain(devices)
        .chain(remarks.iter().flatten().cloned());
    // The protocol takes one line.
    parts.collect::<Vec<_>>().join("; ").replace('\n', " ")
}

/// Notifies the service manager, if there is one.
fn notify(states: &[NotifyState<'_>]) {
    if let Err(error) = sd_notify::notify(states) {
        complain(&format!("cannot notify the service manager: {error}"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::state_file::LastNet;

    #[test]
    fn status_is_one_line_for_people() {
        let net = |net: &str| LastNet {
            net: net.to_owned(),
            description: String::new(),
            state: "RUNNING".to_owned(),
        };
        let mut state = LastState::default();
        assert_eq!(status(&state, None, &[]), "no net runs");
        state.nets.push(net("rpinet1"));
        state
            .devices
            .push(("left".to_owned(), "operational".to_owned()));
        let remarks = [Some("reload failed:\nline 1".to_owned()), None];
        assert_eq!(
            status(&state, Some("stopping"), &remarks),
            "stopping; rpinet1 runs; left is operational; reload failed: line 1"
        );
        state.nets.push(net("rpinet2"));
        assert!(status(&state, None, &[]).starts_with("2 nets run; "));
    }
}
