//! The machine that supervises the assembly, `examples/machine/assembly`: it decides what is to be done, and this does it by the
//! program and raises an event. It moves nothing itself.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use anyhow::Context as _;
use takt_api::Cell;
use takt_client::Value;

use super::program::{Order, Progress, Station, Step};
use crate::client::Client;

const MACHINE: &str = include_str!("../../../../examples/machine/assembly/assembly.machine");
const WATCH: &str = include_str!("../../../../examples/machine/assembly/watch.component");
/// Between two requests for the state.
const POLL_EVERY: Duration = Duration::from_millis(20);
/// How long the machine may wait for something else than the program.
const WAITS_WITHIN: Duration = Duration::from_secs(30);

/// States of the machine and when it entered each, s since its start.
pub(super) type States = Vec<(String, f64)>;

/// How a supervised assembly ended.
#[derive(Debug, Default)]
pub(super) struct Supervised {
    pub(super) steps: Vec<Step>,
    pub(super) states: States,
    /// The first error of the program, or that of the machine.
    pub(super) error: Option<String>,
}

impl Supervised {
    /// One that did not begin.
    pub(super) fn failed(error: String) -> Self {
        Self {
            error: Some(error),
            ..Self::default()
        }
    }
}

/// Loads the machine, starts it, and does what it decides until it is finished.
pub(super) fn run(
    cell: &Cell,
    address: &str,
    order: Order,
    report: &dyn Fn(Progress<'_>),
) -> Supervised {
    let mut ended = Supervised::default();
    if let Err(error) = follow(cell, address, order, report, &mut ended) {
        // A connection that was lost ends the program first.
        ended.error.get_or_insert_with(|| format!("{error:#}"));
    }
    ended
}

fn follow(
    cell: &Cell,
    address: &str,
    order: Order,
    report: &dyn Fn(Progress<'_>),
    ended: &mut Supervised,
) -> anyhow::Result<()> {
    let mut client = Client::connect(Some(address), None)?;
    client.open_session("supervisor of the assembly")?;
    let machine = load(&mut client)?;
    let begin = Instant::now();
    let station = Station::new(cell, order, report);
    let mut station = station.map_err(|error| anyhow::anyhow!("{error}"))?;
    let mut changed = begin;
    loop {
        let (state, status) = state(&mut client, &machine)?;
        if ended.states.last().is_none_or(|(last, _)| *last != state) {
            let at_s = begin.elapsed().as_secs_f64();
            ended.states.push((state.clone(), at_s));
            changed = Instant::now();
        }
        let work = match state.as_str() {
            "Home" => Some((station.home(), "homed")),
            "Work" => Some((station.work(), "done")),
            "Recover" => Some((station.recover(), "contained")),
            _ => None,
        };
        if let Some((result, event)) = work {
            let event = match result {
                Ok(()) => event,
                Err(error) => {
                    ended.error.get_or_insert_with(|| error.to_string());
                    "failed"
                }
            };
            raise(&mut client, &machine, event)?;
            await_change(&mut client, &machine, &state)?;
        } else if status == "finished" {
            ended.steps = station.steps;
            return client.end_session();
        } else {
            anyhow::ensure!(
                status == "active" && changed.elapsed() < WAITS_WITHIN,
                "the machine of the assembly is {status} in state {state}\nhint: `takt machine state` has its error"
            );
            std::thread::sleep(POLL_EVERY);
        }
    }
}

fn load(client: &mut Client) -> anyhow::Result<String> {
    let files = BTreeMap::from([("watch.component".to_owned(), WATCH.to_owned())]);
    let none = || Value::map_of(BTreeMap::<String, String>::new());
    let args = [
        MACHINE.into(),
        Value::map_of(files),
        client.session().into(),
        none(),
        none(),
    ];
    let reply = client.machine("mane", args)?;
    let name = reply.first().and_then(Value::as_str);
    let name = name.context("the controller gave no machine")?.to_owned();
    client.machine("maco", [name.as_str().into(), "start".into()])?;
    Ok(name)
}

/// State and status of the machine.
fn state(client: &mut Client, machine: &str) -> anyhow::Result<(String, String)> {
    let reply = client.machine("main", [machine.into()])?;
    let Some(Value::Map(machines)) = reply.into_iter().next() else {
        anyhow::bail!("the controller did not describe {machine}");
    };
    let Some((_, Value::Map(members))) = machines.into_iter().next() else {
        anyhow::bail!("the controller did not describe {machine}");
    };
    let text = |key: &str| {
        let value = members.get(key).and_then(Value::as_str);
        value.unwrap_or_default().to_owned()
    };
    Ok((text("state"), text("status")))
}

fn raise(client: &mut Client, machine: &str, event: &str) -> anyhow::Result<()> {
    let command = format!("raise {event}");
    client.machine("maco", [machine.into(), command.as_str().into()])?;
    Ok(())
}

/// Waits until the machine has examined an event: it leaves the state.
fn await_change(client: &mut Client, machine: &str, before: &str) -> anyhow::Result<()> {
    let until = Instant::now() + WAITS_WITHIN;
    while Instant::now() < until {
        if state(client, machine)?.0 != before {
            return Ok(());
        }
        std::thread::sleep(POLL_EVERY);
    }
    anyhow::bail!("the machine of the assembly stays in state {before}")
}
