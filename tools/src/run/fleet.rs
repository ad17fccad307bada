//! `[fleet]` of a cell: `takt run` joins a fleet in threads of its own, beside the controller. The controller does not depend on it: a
//! name that is taken, or an address that is, is logged and tried again.

#[cfg(feature = "fleet")]
mod cell;
#[cfg(feature = "fleet")]
mod commands;
#[cfg(feature = "fleet")]
mod joints;
#[cfg(feature = "fleet")]
mod starts;

use std::path::Path;

use takt_core::CellConfig;
use takt_core::cell::located;

/// The text of a cell file.
fn text_of(path: &Path) -> anyhow::Result<String> {
    Ok(takt_core::files::read_text(
        path,
        takt_core::files::TEXT_BYTES_MAX,
    )?)
}

/// An error in the table, as those of the other tables are shown.
fn wrong(path: &Path, why: &str) -> anyhow::Error {
    anyhow::anyhow!("{}: {why}", path.display())
}

#[cfg(not(feature = "fleet"))]
pub(crate) use without::FleetView;
#[cfg(not(feature = "fleet"))]
pub(super) use without::Settings;

#[cfg(not(feature = "fleet"))]
mod without {
    use super::*;

    /// There are none.
    #[derive(Debug)]
    pub(crate) enum Settings {}

    /// There is none.
    #[derive(Clone, Debug, Default)]
    pub(crate) struct FleetView;

    impl FleetView {
        /// None.
        #[expect(
            clippy::unused_self,
            clippy::unnecessary_wraps,
            reason = "as with the feature"
        )]
        pub(crate) fn cells(&self) -> Result<Option<String>, String> {
            Ok(None)
        }
    }

    impl Settings {
        /// Refuses a table that this program has no use for.
        pub(crate) fn of_cell(path: &Path, cell: &CellConfig) -> anyhow::Result<Option<Self>> {
            if cell.fleet.is_none() {
                return Ok(None);
            }
            let why = "[fleet]: this program was built without fleets\nhint: build it with the cargo feature `fleet`, or take out \
                       the table";
            Err(wrong(path, &located(&text_of(path)?, why.to_owned())))
        }
    }
}

#[cfg(feature = "fleet")]
pub(crate) use with::FleetView;
#[cfg(feature = "fleet")]
pub(super) use with::{Fleet, Settings};

#[cfg(feature = "fleet")]
mod with {
    use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
    use std::thread::JoinHandle;
    use std::time::{Duration, Instant};

    use takt_client::Token;
    use takt_core::Controller;
    use takt_fleet::command::Limits;
    use takt_fleet::config::FleetSettings;
    use takt_fleet::keys::CellName;
    use takt_fleet::session::member::{Cell, Member};
    use takt_fleet::session::observer;
    use takt_server::{LogBook, ServerThreads};

    use super::cell::{FleetCell, Ways};
    use super::*;

    /// How long after a failure it tries to join again.
    const RETRY: Duration = Duration::from_secs(5);

    /// How long each query to all cells may take; a cell that is alive and does not answer is shown as silent.
    const READ_TIMEOUT: Duration = Duration::from_millis(500);

    /// How long a reading of all cells is kept: each asks all of them.
    const READING_KEPT: Duration = Duration::from_secs(1);

    /// What the controller sees of its fleet, for the page. Cells are asked only while someone looks.
    #[derive(Clone, Debug, Default)]
    pub(crate) struct FleetView(Arc<Mutex<Seen>>);

    #[derive(Debug, Default)]
    struct Seen {
        /// Name of the own cell, if it is to join a fleet.
        own: Option<String>,
        /// Its session, once it has joined.
        fleet: Option<observer::Fleet>,
        last: Option<(Instant, String)>,
    }

    impl FleetView {
        fn seen(&self) -> MutexGuard<'_, Seen> {
            self.0.lock().unwrap_or_else(PoisonError::into_inner)
        }

        /// The cells, as [`HostProgram::cells`](takt_server::HostProgram::cells) returns them.
        pub(crate) fn cells(&self) -> Result<Option<String>, String> {
            let mut seen = self.seen();
            let Some(own) = &seen.own else {
                return Ok(None);
            };
            let fleet = seen.fleet.as_ref().ok_or_else(|| {
                format!(
                    "the controller has not joined its fleet as `{own}` yet\nhint: its log says why"
                )
            })?;
            if let Some((_, cells)) = seen
                .last
                .as_ref()
                .filter(|it| it.0.elapsed() < READING_KEPT)
            {
                return Ok(Some(cells.clone()));
            }
            let cells = crate::fleet::reading::read(fleet, READ_TIMEOUT);
            let cells = cells.map_err(|why| format!("{why:#}"))?;
            let cells = serde_json::json!({ "own": own, "cells": cells }).to_string();
            seen.last = Some((Instant::now(), cells.clone()));
            Ok(Some(cells))
        }
    }

    /// The table, checked.
    #[derive(Clone, Debug)]
    pub(crate) struct Settings {
        name: CellName,
        settings: FleetSettings,
    }

    impl Settings {
        /// Reads the table of a cell file, if it has one.
        pub(crate) fn of_cell(path: &Path, cell: &CellConfig) -> anyhow::Result<Option<Self>> {
            if cell.fleet.is_none() {
                return Ok(None);
            }
            let folder = path.parent().unwrap_or_else(|| Path::new(""));
            let text = text_of(path)?;
            let read = FleetSettings::of_file(&text, folder, &cell.controller);
            let read = read.map_err(|why| wrong(path, &why))?;
            if cell.controller.websocket.is_none() {
                let why = "[fleet] needs the controller's HTTP: its telemetry is read there, but controller.websocket is not set\n\
                           hint: set websocket = \"127.0.0.1:8080\" under [controller]";
                return Err(wrong(path, &located(&text, why.to_owned())));
            }
            Ok(read.map(|(name, settings)| Self { name, settings }))
        }

        /// Bounds of commands, within those of messages.
        fn limits(&self) -> Limits {
            let message_bytes = usize::try_from(self.settings.message_kib).unwrap_or(usize::MAX);
            let message_bytes = message_bytes.saturating_mul(1024);
            let default = Limits::default();
            Limits {
                message_bytes: default.message_bytes.min(message_bytes),
                // JSON escapes quotation marks.
                reply_bytes: default.reply_bytes.min(message_bytes / 4),
                ..default
            }
        }
    }

    /// The membership of a controller; it leaves when this is dropped.
    #[derive(Debug)]
    pub(crate) struct Fleet {
        ends: Arc<AtomicBool>,
        thread: Option<JoinHandle<()>>,
    }

    impl Fleet {
        /// Starts to join.
        pub(crate) fn start(
            settings: Settings,
            controller: &Controller,
            server: &ServerThreads,
            token: Option<Token>,
            (book, view): (LogBook, FleetView),
        ) -> anyhow::Result<Self> {
            view.seen().own = Some(settings.name.to_string());
            let http = server.http_address().map(here);
            let tcp = server.tcp_address().map(|tcp| here(tcp).to_string());
            let local = server.local_path().map(|path| path.display().to_string());
            let ways = Ways {
                http: http.map(|http| http.to_string()),
                lines: local.or(tcp),
                token,
            };
            let cell = Arc::new(FleetCell::new(
                controller.clone(),
                ways,
                book,
                settings.settings.joints_hz,
            ));
            let ends = Arc::new(AtomicBool::new(false));
            let ended = Arc::clone(&ends);
            let thread = std::thread::Builder::new().name("fleet".to_owned());
            let thread = thread.spawn(move || stay(&settings, &cell, &view, &ended))?;
            Ok(Self {
                ends,
                thread: Some(thread),
            })
        }
    }

    impl Drop for Fleet {
        fn drop(&mut self) {
            self.ends.store(true, Ordering::Release);
            if let Some(thread) = self.thread.take() {
                thread.thread().unpark();
                if thread.join().is_err() {
                    tracing::error!("the thread of the fleet has panicked");
                }
            }
        }
    }

    /// Joins, tries again until it succeeds, and stays until the end.
    fn stay(settings: &Settings, cell: &Arc<FleetCell>, view: &FleetView, ends: &AtomicBool) {
        let mut reported = String::new();
        let mut member = None;
        // So that who sees the cell at once sees what it is.
        cell.read();
        while !ends.load(Ordering::Acquire) {
            if member.is_some() {
                std::thread::park();
                continue;
            }
            let Settings {
                name,
                settings: fleet,
            } = settings;
            let of: Arc<dyn Cell> = Arc::<FleetCell>::clone(cell);
            match Member::join(name, fleet, settings.limits(), of) {
                Ok(joined) => {
                    let listens = fleet.listens().join(", ");
                    let at = if listens.is_empty() {
                        String::new()
                    } else {
                        format!(" at {listens}")
                    };
                    tracing::info!("in the fleet as `{name}`{at}, boot {}", joined.boot());
                    view.seen().fleet = Some(joined.observe());
                    member = Some(joined);
                }
                Err(why) => {
                    let why = why.to_string();
                    if why != reported {
                        tracing::error!("not in the fleet, tried again each {RETRY:?}: {why}");
                        reported = why;
                    }
                    std::thread::park_timeout(RETRY);
                }
            }
        }
    }

    /// How this host reaches an address at which it listens.
    fn here(mut address: SocketAddr) -> SocketAddr {
        if address.ip().is_unspecified() {
            address.set_ip(match address.ip() {
                IpAddr::V4(_) => Ipv4Addr::LOCALHOST.into(),
                IpAddr::V6(_) => Ipv6Addr::LOCALHOST.into(),
            });
        }
        address
    }

    #[cfg(test)]
    mod tests {
        use super::*;

        fn settings(text: &str) -> anyhow::Result<Option<Settings>> {
            static NUMBER: std::sync::atomic::AtomicU32 = std::sync::atomic::AtomicU32::new(0);
            let number = NUMBER.fetch_add(1, Ordering::Relaxed);
            let name = format!("takt-fleet-cell-{}-{number}.toml", std::process::id());
            let path = std::env::temp_dir().join(name);
            std::fs::write(&path, text).unwrap();
            let cell = takt_devices::read_cell(&path).unwrap();
            let settings = Settings::of_cell(&path, &cell);
            std::fs::remove_file(&path).unwrap();
            settings
        }

        #[test]
        fn fleet_table_errors_name_file_line_and_remedy() {
            assert!(settings("[controller]").unwrap().is_none());
            let good = settings("[fleet]\ncell = \"a\"\nmessage_kib = 16").unwrap();
            assert_eq!(good.unwrap().limits().reply_bytes, 4096);
            for (text, parts) in [
                (
                    "[fleet]\ncell = \"a\"\nlinks = 0",
                    ["line 3", "fleet.links is 0"],
                ),
                ("[fleet]\nlinks = 3", ["has no `cell`", "hint: "]),
                (
                    "[fleet]\ncell = \"a\"\nroom = 1",
                    ["line 3", "unknown field `room`"],
                ),
            ] {
                let error = settings(text).unwrap_err().to_string();
                assert!(error.contains(".toml: "), "{error}");
                assert!(parts.iter().all(|part| error.contains(part)), "{error}");
            }
        }

        #[test]
        fn address_of_all_interfaces_is_reached_on_loopback() {
            let here = |text: &str| here(text.parse().unwrap()).to_string();
            assert_eq!(here("0.0.0.0:80"), "127.0.0.1:80");
            assert_eq!(here("[::]:80"), "[::1]:80");
            assert_eq!(here("192.0.2.1:80"), "192.0.2.1:80");
        }
    }
}
