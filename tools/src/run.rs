//! `takt run`: the controller in the foreground, as a service runs it. What a cell is made of
//! stands in its `cell.toml`.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::Context as _;
use clap::Args;
use takt_core::controller::NetState;
use takt_core::record::Recorder;
use takt_core::{CellConfig, Controller};
use takt_rt::host::{HostConfig, prepare};

use crate::Verdict;
use crate::output::{complain, say};

/// Run the controller.
#[derive(Debug, Args)]
pub(crate) struct Run {
    /// What the cell is made of.
    #[arg(long, value_name = "FILE", default_value = "cell.toml")]
    config: PathBuf,
    /// Record everything that enters and leaves the net thread.
    #[arg(long, value_name = "FILE.mcap")]
    record: Option<PathBuf>,
    /// End the process at the first allocation in a real-time thread.
    #[arg(long)]
    guard: bool,
}

/// How long nets get to end after a cancel, before they are aborted.
const CANCEL_WITHIN: Duration = Duration::from_secs(5);

impl Run {
    pub(crate) fn run(self) -> anyhow::Result<Verdict> {
        start_logging();
        let cell = read_cell(&self.config)?;
        let host = prepare(&HostConfig::default());
        if self.guard {
            takt_rt::alloc::set_guard(takt_rt::alloc::Guard::Abort);
        }
        let recording = self.record.as_deref().map(Recorder::start).transpose()?;
        let controller = Controller::start_recording(&cell, recording)?;
        tell_grants(&host, &controller);
        let server = Server::start(&cell, &controller)?;
        for address in server.addresses() {
            say(&address)?;
        }
        for (name, address) in controller.with_arms(|a| (a.name().to_owned(), a.address())) {
            say(&format!("{name} waits for its robot at udp {address}"))?;
        }
        until_stopped(None, || Ok(()))?;
        come_to_rest(&controller);
        server.stop();
        if let Some(cycles) = controller.finish_recording()? {
            say(&format!("recorded {cycles} cycles"))?;
        }
        Ok(Verdict::Good)
    }
}

/// Reads a cell; one that does not exist yet is shown how to begin.
fn read_cell(path: &Path) -> anyhow::Result<CellConfig> {
    let missing = !path.exists();
    let cell = CellConfig::read(path);
    if missing {
        return cell.context(
            "no cell yet; an empty file is a controller without robots, and each robot is \
             `[[device]]` with `name`, `type = \"kuka_lwr_fri\"`, `listen = \"0.0.0.0:49938\"`",
        );
    }
    Ok(cell?)
}

/// The server of a controller, in threads of its own.
#[derive(Debug)]
pub(crate) struct Server {
    runtime: tokio::runtime::Runtime,
    task: tokio::task::JoinHandle<()>,
    stop: tokio::sync::oneshot::Sender<()>,
    http: Option<SocketAddr>,
    tcp: Option<SocketAddr>,
}

impl Server {
    /// Begins to listen where the cell says.
    pub(crate) fn start(cell: &CellConfig, controller: &Controller) -> anyhow::Result<Self> {
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(2)
            .enable_all()
            .thread_name("takt-server")
            .build()
            .context("cannot start the server's threads")?;
        let config = takt_server::ServerConfig {
            http: cell.controller.websocket,
            tcp: cell.controller.tcp,
            ..takt_server::ServerConfig::default()
        };
        let server = runtime.block_on(takt_server::Server::bind(config))?;
        let (http, tcp) = (server.http_address(), server.tcp_address());
        let (stop, stopped) = tokio::sync::oneshot::channel();
        let shutdown = async {
            // A sender that is gone means the same as one that has sent.
            let _ = stopped.await;
        };
        let task = runtime.spawn(server.run(controller.clone(), shutdown));
        Ok(Self {
            runtime,
            task,
            stop,
            http,
            tcp,
        })
    }

    /// Where it listens.
    pub(crate) fn addresses(&self) -> Vec<String> {
        let http = self
            .http
            .map(|at| format!("DirectIO at ws://{at}/DirectIO/"));
        let tcp = self.tcp.map(|at| format!("DirectIO lines at tcp {at}"));
        http.into_iter().chain(tcp).collect()
    }

    /// Where it takes plain lines.
    pub(crate) const fn tcp(&self) -> Option<SocketAddr> {
        self.tcp
    }

    /// Ends all connections.
    pub(crate) fn stop(self) {
        let _ = self.stop.send(());
        if self.runtime.block_on(self.task).is_err() {
            complain("the server had ended by a fault of its own");
        }
    }
}

/// Says which requests to the host were refused, once each.
pub(crate) fn tell_grants(host: &takt_rt::host::Host, controller: &Controller) {
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

/// Cancels all running nets, waits for them, and aborts those that do not end.
fn come_to_rest(controller: &Controller) {
    let running = || {
        let nets = controller
            .nets()
            .into_iter()
            .filter_map(|id| controller.net(id));
        let runs = |s: NetState| matches!(s, NetState::Running | NetState::Cancelling);
        nets.filter(|net| runs(net.state()))
            .map(|net| net.id)
            .collect::<Vec<_>>()
    };
    for net in running() {
        if let Err(error) = controller.cancel(net) {
            complain(&format!("cannot cancel {net}: {error}"));
        }
    }
    let until = Instant::now() + CANCEL_WITHIN;
    while !running().is_empty() && Instant::now() < until {
        std::thread::sleep(Duration::from_millis(10));
    }
    for net in running() {
        complain(&format!(
            "{net} did not end within {CANCEL_WITHIN:?}; it is aborted"
        ));
        if let Err(error) = controller.abort(net) {
            complain(&format!("cannot abort {net}: {error}"));
        }
    }
}

fn start_logging() {
    let filter = tracing_subscriber::EnvFilter::try_from_default_env()
        .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new("info"));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .init();
}

/// Calls `look` ten times a second until Ctrl-C, a request to terminate, or the end of `duration`.
pub(crate) fn until_stopped(
    duration: Option<Duration>,
    mut look: impl FnMut() -> anyhow::Result<()>,
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
                _ = ticks.tick() => look()?,
            }
            if end.is_some_and(|end| tokio::time::Instant::now() >= end) {
                return Ok(());
            }
        }
    })
}
