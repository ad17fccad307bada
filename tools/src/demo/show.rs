//! `takt demo --open`: the page of the demo's controller in a browser, and motion until Ctrl-C. Each part of the cell moves as soon
//! as its devices follow commands, round after round. A part whose net another client ended rests, so that the page can jog it, until
//! its next net is started there.

use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::Context as _;
use takt_core::controller::NetState;
use takt_core::stop_channel::StopSwitch;
use takt_core::{Controller, NetId};
use takt_embedded::{EmulatedCell, Machines};
use takt_rt::host::{HostConfig, prepare};
use takt_server::LogBook;

use super::cell::{Arm, Kind};
use super::recovery::{HOME, RETURN, RETURN_SPEED};
use super::{Demo, motion, recovery};
use crate::Verdict;
use crate::client::Client;
use crate::logging::Logging;
use crate::output::{complain, say};
use crate::run::{Access, FleetView, print_grants, start_server, stop_channel, stop_server};
use crate::signal::Stop;

/// Between two looks at all nets.
const POLL: Duration = Duration::from_millis(50);
/// Between two attempts to start a net.
const AGAIN: Duration = Duration::from_millis(500);
/// Between two rounds of the machine of the station.
const PAUSE: Duration = Duration::from_secs(1);
/// How long an opener of addresses may take until its result counts as good: some stay until the browser ends.
const OPENER: Duration = Duration::from_secs(2);
/// Any free port of loopback.
pub(super) const ANY: std::net::SocketAddr =
    std::net::SocketAddr::new(std::net::IpAddr::V4(std::net::Ipv4Addr::LOCALHOST), 0);

/// What a part of the cell does.
#[derive(Clone, Copy, Debug)]
enum State {
    /// Its next net is started when its devices follow commands, not before this time.
    Waits(Instant),
    /// Its net runs since then, and its devices had so many faults before.
    Moves(NetId, Instant, u64),
    /// Its next net is loaded, and another client starts it.
    Rests(NetId),
}

/// A part of the cell that one net moves.
struct Part<'c> {
    controller: &'c Controller,
    arms: &'static [Arm],
    /// By arm: where its joints began, rad; empty before the first round.
    home: Vec<Vec<f64>>,
    round: Duration,
    state: State,
}

impl Demo {
    /// Serves the page, opens it, and moves the cell until a signal stops it.
    pub(super) fn show(&self) -> anyhow::Result<Verdict> {
        let mut emulated = EmulatedCell::named(self.robots.cell())?;
        emulated.config.controller.websocket = Some(ANY);
        let cell = emulated.config.clone();
        let stop = Stop::listen()?;
        let host = prepare(&HostConfig::default());
        let book = LogBook::default();
        Logging::keep(&book)?;
        let switch = StopSwitch::default();
        let channel = stop_channel(&cell, None, &switch)?;
        if self.guard {
            takt_rt::alloc::set_guard(takt_rt::alloc::Guard::Abort);
        }
        let controller = Controller::start_under(&cell, None, switch)?;
        print_grants(&host, &controller);
        let server = start_server(
            &cell,
            &controller,
            Access::default(),
            book,
            Some(&channel),
            FleetView::default(),
        )?;
        let machines = Machines::start(&controller, emulated, self.drop)?;
        let page = server
            .http_address()
            .context("the server does not listen")?;
        let page = format!("http://{page}/");
        say(&format!("page       {page}"))?;
        say("Ctrl-C ends the demo")?;
        open(&page);
        let address = server.tcp_address().context("the server does not listen")?;
        let mut client = Client::connect(Some(&address.to_string()), None)?;
        client.open_session("takt demo")?;
        let ended = match self.robots {
            Kind::Lola => self.repeat_machine(&controller, &machines, &mut client, &stop),
            Kind::Pair | Kind::Factory | Kind::Assembly => {
                self.repeat(&controller, &mut client, &stop)
            }
        };
        drop(client);
        stop_server(server);
        drop(controller);
        machines.stop()?;
        ended?;
        Ok(Verdict::Good)
    }

    /// Moves all parts, round after round.
    fn repeat(
        &self,
        controller: &Controller,
        client: &mut Client,
        stop: &Stop,
    ) -> anyhow::Result<()> {
        let part = |arms: &&'static [Arm]| Part {
            controller,
            arms,
            home: Vec::new(),
            round: self.duration,
            state: State::Waits(Instant::now()),
        };
        let mut parts: Vec<_> = self.robots.parts().iter().map(part).collect();
        while !stop.is_requested() {
            for part in &mut parts {
                part.poll(client)?;
            }
            std::thread::sleep(POLL);
        }
        client.end_session()
    }

    /// Lets the machine of the station run from its start to its end, again and again.
    fn repeat_machine(
        &self,
        controller: &Controller,
        machines: &Machines,
        client: &mut Client,
        stop: &Stop,
    ) -> anyhow::Result<()> {
        while !stop.is_requested() {
            self.wait_until_ready(controller, machines, stop)?;
            let ended = super::lola::follow(controller, machines, client, stop, false)?;
            for failure in ended.failures.iter().filter(|_| !stop.is_requested()) {
                complain(failure);
            }
            // The next round loads it again.
            for machine in controller.machines() {
                client.machine("maen", [machine.name.as_str().into()])?;
            }
            std::thread::sleep(PAUSE);
        }
        Ok(())
    }
}

impl Part<'_> {
    fn poll(&mut self, client: &mut Client) -> anyhow::Result<()> {
        match self.state {
            State::Waits(time) => {
                let is_due = Instant::now() >= time && !self.controller.stop_switch().is_stopped();
                if is_due && recovery::follow(self.controller, self.arms) {
                    self.start(client)?;
                }
            }
            State::Moves(net, since, faults) => {
                let Some(info) = self.controller.net(net) else {
                    return self.rest(client);
                };
                if info.state() == NetState::Terminated {
                    client.command("neun", &net.to_string())?;
                    let is_whole = since.elapsed() >= self.round;
                    let was_refused = !self.controller.rejected(Some(net)).is_empty();
                    let had_fault = recovery::faults_of(self.controller, self.arms) > faults;
                    if info.end.is_none() && is_whole || was_refused || had_fault {
                        self.state = State::Waits(Instant::now());
                    } else {
                        return self.rest(client);
                    }
                }
            }
            State::Rests(net) => match self.controller.net(net).map(|info| info.state()) {
                Some(NetState::Ready) => {}
                Some(_) => self.state = self.moves(net),
                None => return self.rest(client),
            },
        }
        Ok(())
    }

    fn moves(&self, net: NetId) -> State {
        let faults = recovery::faults_of(self.controller, self.arms);
        State::Moves(net, Instant::now(), faults)
    }

    fn names(&self) -> String {
        let names: Vec<_> = self.arms.iter().map(|arm| arm.name).collect();
        names.join(" and ")
    }

    /// Loads its next net: a round, or the way back to where it began if it is elsewhere.
    fn load(&mut self, client: &mut Client) -> anyhow::Result<NetId> {
        let here = self.arms.iter();
        let here: Vec<_> = here
            .map(|arm| recovery::commanded(self.controller, arm))
            .collect();
        if self.home.is_empty() {
            self.home.clone_from(&here);
        }
        let joints = here.iter().flatten().zip(self.home.iter().flatten());
        let away = joints.fold(0.0_f64, |most, (here, home)| most.max((here - home).abs()));
        let is_arm = self.arms.iter().all(|arm| arm.wheel.is_none());
        let (text, what) = if is_arm && away > HOME {
            let span = RETURN.max(Duration::from_secs_f64(away / RETURN_SPEED));
            (motion::back(self.arms, &self.home, span), "returns")
        } else {
            (motion::of(self.arms, self.round), "moves")
        };
        let net = client.load(&text, &format!("demo: {what} {}", self.names()))?;
        net.parse().ok().context("the controller gave no net")
    }

    fn start(&mut self, client: &mut Client) -> anyhow::Result<()> {
        let net = self.load(client)?;
        let state = self.moves(net);
        if client.command("nest", &net.to_string()).is_ok() {
            self.state = state;
        } else {
            // Another client holds one of its devices, or one was lost again.
            client.command("neun", &net.to_string())?;
            self.state = State::Waits(Instant::now() + AGAIN);
        }
        Ok(())
    }

    /// Its net was ended by someone else: the next one waits until it is started.
    fn rest(&mut self, client: &mut Client) -> anyhow::Result<()> {
        let net = self.load(client)?;
        complain(&format!(
            "the net that moves {} was ended: it rests until {net} is started on the page",
            self.names()
        ));
        self.state = State::Rests(net);
        Ok(())
    }
}

/// Opens an address in the user's browser; says so if that is not possible. The address is printed in any case.
pub(super) fn open(address: &str) {
    let child = Command::new("xdg-open")
        .arg(address)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn();
    let failed = match child {
        Err(error) => Some(format!("xdg-open: {error}")),
        Ok(mut child) => {
            let begin = Instant::now();
            loop {
                match child.try_wait() {
                    Ok(Some(status)) if status.success() => break None,
                    Ok(Some(status)) => break Some(format!("xdg-open: {status}")),
                    Ok(None) if begin.elapsed() < OPENER => std::thread::sleep(POLL),
                    Ok(None) | Err(_) => break None,
                }
            }
        }
    };
    if let Some(why) = failed {
        complain(&format!(
            "no browser was opened: {why}\nhint: open the address above in one"
        ));
    }
}
