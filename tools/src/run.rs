//! `takt run`: the controller in the foreground, as a service runs it. The cell is described by its `cell.toml`;
//! `service` notifies the service manager.

mod access;
mod fleet;
mod page_program;
mod reload;
mod rest;
mod service;
mod state_file;
mod watchdog;

use std::fmt;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context as _;
use clap::Args;
use takt_client::Token;
use takt_core::cell::LiveSettings;
use takt_core::controller::FlightSettings;
use takt_core::record::{Recorder, Rotation};
use takt_core::stop_channel::{
    PRIORITY, StopChannel, StopChannelConfig, StopSwitch, default_socket,
};
use takt_core::{CellConfig, Controller};
use takt_link::linux::host::{Transport, bind_error};
use takt_rt::host::{HostConfig, prepare};
use takt_server::{LiveConfig, LogBook, ServerThreads};

pub(crate) use self::access::Access;
pub(crate) use self::fleet::FleetView;
use self::page_program::PageProgram;
use self::service::Service;
use crate::logging::Logging;
use crate::output::{chain, complain, say};
use crate::quantity::size;
use crate::{Verdict, token};

/// Run the controller.
///
/// SIGHUP reloads the cell: added and removed devices and the log level change while nets run; the rest needs a
/// restart. SIGTERM and Ctrl-C cancel all nets, wait until the robots are at rest, and end. Under systemd it reports
/// its state and feeds the watchdog.
#[derive(Debug, Args)]
pub(crate) struct Run {
    /// The cell file.
    #[arg(long, value_name = "FILE", default_value = "cell.toml")]
    config: PathBuf,
    /// Record everything that enters and leaves the net thread.
    #[arg(long, value_name = "FILE.mcap")]
    record: Option<PathBuf>,
    /// Go on in another file when one has this size, such as 1GiB: FILE-TIME-0001.mcap and so on, each complete.
    #[arg(long, value_name = "SIZE", value_parser = size, requires = "record")]
    rotate: Option<u64>,
    /// Keep this number of files, and delete the oldest.
    #[arg(long, value_name = "FILES", value_parser = clap::value_parser!(u32).range(1..), requires = "rotate")]
    keep: Option<u32>,
    /// End the process at the first allocation in a real-time thread.
    #[arg(long)]
    guard: bool,
}

impl Run {
    pub(crate) fn run(self) -> anyhow::Result<Verdict> {
        let cell = read_cell(&self.config).map_err(WrongCell)?;
        let fleet = fleet::Settings::of_cell(&self.config, &cell).map_err(WrongCell)?;
        // Before all threads: each that allocated earlier would keep free memory of its own.
        let host = prepare(&HostConfig::default());
        let book = LogBook::default();
        let logging = Logging::start(cell.controller.log.as_deref(), &book)?;
        let access = Access::of_cell(&cell)?;
        #[cfg(feature = "fleet")]
        let (token, lines) = (access.token().cloned(), book.clone());
        // Before threads with work, so that nothing delays a stop, and after memory is locked.
        let switch = StopSwitch::default();
        let channel = stop_channel(&cell, access.token(), &switch)?;
        if self.guard {
            takt_rt::alloc::set_guard(takt_rt::alloc::Guard::Abort);
        }
        if let Some(shortage) = takt_core::memory::shortage(cell.controller.nets_memory_mib) {
            complain(&format!("warning: {shortage}"));
        }
        let rotation = self.rotate.map(|bytes| Rotation {
            bytes,
            keep: self.keep.and_then(|keep| usize::try_from(keep).ok()),
        });
        let recording = self.record.as_deref().map(|path| match rotation {
            Some(rotation) => Recorder::start_rotating(path, rotation),
            None => Recorder::start(path),
        });
        let recording = recording.transpose()?;
        if let Some((recorder, _)) = &recording {
            logging.record_in(recorder);
        }
        let controller = Controller::start_under(&cell, recording, switch).map_err(judged)?;
        print_grants(&host, &controller);
        warn_of_grants(&channel);
        let view = FleetView::default();
        let server = start_server(
            &cell,
            &controller,
            access,
            book,
            Some(&channel),
            view.clone(),
        )?;
        for address in addresses(&server)
            .into_iter()
            .chain(stop_addresses(&channel))
        {
            say(&address)?;
        }
        if let Some(line) = record_flights(&self.config, &cell, &controller, &logging) {
            say(&line)?;
        }
        for (name, address) in controller.waits_at() {
            say(&format!("{name} waits for its robot at udp {address}"))?;
        }
        #[cfg(feature = "fleet")]
        let fleet = fleet
            .map(|settings| {
                fleet::Fleet::start(settings, &controller, &server, token, (lines, view))
            })
            .transpose()?;
        Service::new(&self.config, cell, &controller, logging).run()?;
        drop(fleet);
        stop_server(server);
        if let Some(cycles) = controller.finish_recording()? {
            say(&format!("recorded {cycles} cycles"))?;
        }
        Ok(Verdict::Good)
    }
}

/// Starts the flight recorder of a cell, if it has one; returns a line for the start. Without it the controller runs all the
/// same.
fn record_flights(
    config: &Path,
    cell: &CellConfig,
    controller: &Controller,
    logging: &Logging,
) -> Option<String> {
    let state = || Some(token::state_directory()?.join("flights"));
    let directory = cell.controller.flight_recorder.clone().or_else(state);
    let Some(directory) = directory.filter(|it| !it.as_os_str().is_empty()) else {
        return Some("flight recorder: off".to_owned());
    };
    let mib = cell.controller.flight_recorder_mib;
    let settings = FlightSettings {
        directory: directory.clone(),
        bytes_max: u64::from(mib) << 20,
        cell: takt_core::files::read_text(config, takt_core::files::TEXT_BYTES_MAX).ok(),
    };
    match controller.record_flights(settings) {
        Ok(log) => {
            logging.record(move |level, part, text| log.line_of(level, part, text));
            let memory = controller.flight_memory().div_ceil(1 << 20);
            Some(format!(
                "flight recorder: 10 s before each fault to {}, at most {mib} MiB; {memory} MiB of memory",
                directory.display()
            ))
        }
        Err(error) => {
            complain(&format!(
                "warning: no flight recorder: {error}\nhint: set flight_recorder under [controller] to a directory that \
                 this account can write, or to \"\""
            ));
            None
        }
    }
}

/// The error of an address that cannot be listened at, with the program that holds its port.
fn cannot_listen(what: &str, address: SocketAddr, source: &std::io::Error) -> anyhow::Error {
    let why = bind_error(Transport::Tcp, address, source);
    anyhow::anyhow!("{what} at {address}: {why}")
}

/// Starts the stop channel of a cell. Without a path in the cell its socket is where `takt stop` searches.
pub(crate) fn stop_channel(
    cell: &CellConfig,
    token: Option<&Token>,
    switch: &StopSwitch,
) -> anyhow::Result<StopChannel> {
    let socket = match cell
        .controller
        .stop_socket
        .clone()
        .map_or_else(default_socket, Ok)
    {
        Ok(socket) => Some(socket),
        Err(error) => {
            complain(&format!(
                "warning: no folder for the stop socket: {error}\nhint: set stop_socket under [controller]; until then \
                 `takt stop` needs --connect and the token"
            ));
            None
        }
    };
    let config = StopChannelConfig {
        socket,
        tcp: cell.controller.stop_address(),
        token: token.map(|token| token.text().to_owned()),
        priority: Some(PRIORITY),
    };
    if config.tcp.is_some_and(|at| !at.ip().is_loopback()) && token.is_none() {
        anyhow::bail!(
            "the stop channel is to listen beyond loopback without a token\nhint: set token_file under [controller]"
        );
    }
    let tcp = config.tcp;
    StopChannel::start(config, switch.clone()).map_err(|error| match (error, tcp) {
        (takt_core::Error::StopChannel { address, source }, Some(tcp))
            if address == tcp.to_string() =>
        {
            cannot_listen("the stop channel cannot listen", tcp, &source)
        }
        (error, _) => error.into(),
    })
}

/// Addresses at which it can be stopped, as text.
pub(crate) fn stop_addresses(channel: &StopChannel) -> Vec<String> {
    let socket = channel
        .socket()
        .map(|path| format!("stop at unix {}", path.display()));
    let tcp = channel
        .tcp_address()
        .map(|at| format!("stop at http://{at}/stop"));
    socket.into_iter().chain(tcp).collect()
}

/// A cell that cannot be read or is invalid: a restart does not help.
#[derive(Debug)]
pub(crate) struct WrongCell(anyhow::Error);

impl fmt::Display for WrongCell {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl std::error::Error for WrongCell {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        self.0.source()
    }
}

/// Distinguishes faults of the cell from missing resources of the host, such as an interface or an address, which may
/// appear later.
fn judged(error: takt_core::Error) -> anyhow::Error {
    use takt_core::Error as E;
    let is_of_the_cell = matches!(
        error,
        E::Cell(_)
            | E::Config { .. }
            | E::DeviceTwice { .. }
            | E::DeviceParameter { .. }
            | E::TooManyJoints { .. }
            | E::TooManyValues { .. }
    );
    if is_of_the_cell {
        WrongCell(error.into()).into()
    } else {
        error.into()
    }
}

/// Reads a cell; if the file is missing, the hint describes one.
fn read_cell(path: &Path) -> anyhow::Result<CellConfig> {
    let missing = !path.exists();
    let cell = takt_devices::read_cell(path);
    if missing {
        return cell.map_err(|error| {
            anyhow::anyhow!(
                "{}\nhint: an empty file is a controller without robots; each robot is `[[device]]` with `name`, \
                 `type = \"kuka_lwr_fri\"`, `listen = \"0.0.0.0:49938\"`",
                chain(&error.into())
            )
        });
    }
    Ok(cell?)
}

/// Complains about what the host refuses to the stop channel.
fn warn_of_grants(channel: &StopChannel) {
    let refused = channel.grants().iter().filter(|grant| grant.is_refused());
    for grant in refused {
        complain(&format!("warning: the stop channel: {grant}"));
    }
}

/// Starts the server of a controller at the addresses of the cell, in threads of its own.
pub(crate) fn start_server(
    cell: &CellConfig,
    controller: &Controller,
    access: Access,
    log: LogBook,
    channel: Option<&StopChannel>,
    fleet: FleetView,
) -> anyhow::Result<ServerThreads> {
    let program = Arc::new(PageProgram::new(access.token(), fleet));
    let config = takt_server::ServerConfig {
        http: cell.controller.websocket,
        tcp: cell.controller.tcp,
        live: live_config(&cell.live),
        on_loss: cell.controller.on_loss,
        log,
        stop: channel.and_then(|channel| {
            let port = channel.tcp_address()?.port();
            Some(takt_server::StopPort::new(port, channel.key()))
        }),
        program: Some(Arc::clone(&program) as _),
        ..takt_server::ServerConfig::default()
    };
    let server = ServerThreads::start(access.bind(config), controller).map_err(|error| {
        if let takt_server::Error::Listen { address, source } = &error {
            return cannot_listen("cannot listen", *address, source);
        }
        anyhow::Error::from(error)
    })?;
    program.set_server(&server);
    Ok(server)
}

fn live_config(live: &LiveSettings) -> LiveConfig {
    LiveConfig {
        foxglove: live.foxglove,
        services: live.services,
        origins: live.origins.clone(),
        udp: live.udp,
        probes: live.probes.clone(),
        every: live.every,
    }
}

/// Where a server listens, as text.
fn addresses(server: &ServerThreads) -> Vec<String> {
    let http = server
        .http_address()
        .map(|at| format!("DirectIO at ws://{at}/DirectIO/"));
    let tcp = server
        .tcp_address()
        .map(|at| format!("DirectIO lines at tcp {at}"));
    let local = server.local_path();
    let local = local.map(|path| format!("DirectIO lines at unix {}", path.display()));
    let foxglove = server.foxglove_address();
    let foxglove = foxglove
        .map(|at| format!("live data at ws://{at}, for Foxglove, Lichtblick and PlotJuggler"));
    http.into_iter()
        .chain(tcp)
        .chain(local)
        .chain(foxglove)
        .collect()
}

/// Ends a server and all of its connections.
pub(crate) fn stop_server(server: ServerThreads) {
    if !server.stop() {
        complain("the server had ended by a fault of its own");
    }
}

/// Prints which requests to the host were refused, once each.
pub(crate) fn print_grants(host: &takt_rt::host::Host, controller: &Controller) {
    let mut refused: Vec<String> = Vec::new();
    let threads = controller.grants().into_iter().map(|(_, grant)| grant);
    for grant in host.grants().iter().cloned().chain(threads) {
        let line = grant.to_string();
        if grant.is_refused() && !refused.contains(&line) {
            complain(&format!("warning: {line}"));
            refused.push(line);
        }
    }
}

/// Calls `poll` ten times a second until Ctrl-C, a request to terminate, or the end of `duration`.
pub(crate) fn until_stopped(
    duration: Option<Duration>,
    mut poll: impl FnMut() -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()?;
    runtime.block_on(async {
        let mut terminate =
            tokio::signal::unix::signal(tokio::signal::unix::SignalKind::terminate())
                .context("cannot listen for signals")?;
        let mut ticks = tokio::time::interval(Duration::from_millis(100));
        let end = duration.map(|d| tokio::time::Instant::now() + d);
        loop {
            tokio::select! {
                _ = tokio::signal::ctrl_c() => return Ok(()),
                _ = terminate.recv() => return Ok(()),
                _ = ticks.tick() => poll()?,
            }
            if end.is_some_and(|end| tokio::time::Instant::now() >= end) {
                return Ok(());
            }
        }
    })
}
