//! The machines of a controller: loaded with the nets of their components, given to a net thread, commanded by programs.
//! Loading is in [`load`], requests in [`command`], and what machines request of the controller in [`work`]; the thread
//! steps them.

mod access;
mod command;
mod load;
pub(super) mod work;

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::{Duration, Instant};

use takt_machine::machine::{Cause, Failure, Graph, Status};
use takt_machine::{Configuration, Program};
use takt_rt::latest::LatestReader;

use crate::error::Error;
use crate::executor::flight::{AFTER, BEFORE, STATES_MAX};
use crate::executor::machines::{InputError, MachineView};
use crate::executor::{ResourceSet, StartError};
use crate::ids::{NetId, SessionId};

/// Maximum number of unloaded machines that are kept for flight files.
const PAST_MAX: usize = 16;
/// How long they are kept.
const PAST_FOR: Duration = Duration::from_secs(BEFORE.as_secs() + AFTER.as_secs() + 1);

/// A machine to be loaded.
#[derive(Clone, Debug, Default)]
pub struct MachineRequest {
    /// Its text.
    pub text: String,
    /// The files of its components, by the names in its text.
    pub files: Vec<(String, String)>,
    /// Session that it belongs to; `SessionId(0)` for none.
    pub session: u32,
    /// Parameters of the machine, as name and text.
    pub parameters: Vec<(String, String)>,
    /// Property files of components, TOML or `.cpf`, as component and text.
    pub properties: Vec<(String, String)>,
}

/// What a machine costs in a cycle at most.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MachineCost {
    /// Its step and its connections.
    pub step: Duration,
    /// All its components together.
    pub components: Duration,
}

/// A machine as programs see it.
#[derive(Clone, Debug)]
pub struct MachineInfo {
    /// Its name.
    pub name: String,
    /// Session that it belongs to.
    pub session: SessionId,
    /// Its program.
    pub program: Arc<Program>,
    /// Its text.
    pub text: Arc<str>,
    /// Where it is.
    pub view: MachineView,
    /// Its cost bound.
    pub cost: MachineCost,
    /// Why nets of components ended last, by component; of those that ended for a reason.
    pub ends: BTreeMap<usize, String>,
}

impl MachineInfo {
    /// The state of the outermost machine.
    #[must_use]
    pub fn state(&self) -> &str {
        let state = self.view.machines.first().and_then(|machine| machine.state);
        let name = state.and_then(|state| self.program.states(0).nth(state));
        name.unwrap_or("-")
    }

    /// The status of the outermost machine.
    #[must_use]
    pub fn status(&self) -> Status {
        let first = self.view.machines.first();
        first.map(|machine| machine.status).unwrap_or_default()
    }

    /// The graph of the machine, or of the one of that name inside, with its present state.
    #[must_use]
    pub fn graph(&self, inside: Option<&str>) -> Option<Graph> {
        let number = match inside {
            None => 0,
            Some(name) => self.program.machines().position(|one| one == name)?,
        };
        let state = self.view.machines.get(number)?.state;
        self.program.graph(number, state)
    }

    /// The last error of a machine, with its location; `None` if there was none.
    #[must_use]
    pub fn failure(&self, machine: usize) -> Option<String> {
        let failure = self.view.machines.get(machine)?.failure?;
        let text = failure_text(&self.program, &self.text, &self.ends, (machine, failure));
        Some(text)
    }
}

fn failure_text(
    program: &Program,
    text: &str,
    ends: &BTreeMap<usize, String>,
    (machine, failure): (usize, Failure),
) -> String {
    let state = program.states(machine).nth(failure.state).unwrap_or("?");
    let before = text.get(..failure.at.0).unwrap_or_default();
    let line = before.matches('\n').count() + 1;
    let place = if failure.at == (0, 0) {
        String::new()
    } else {
        format!(" (line {line})")
    };
    let end = if let Cause::Component(component) = failure.cause {
        program.members().get(component).zip(ends.get(&component))
    } else {
        None
    };
    let cause = end.map_or_else(
        || failure.cause.to_string(),
        |(member, why)| {
            let name = &member.name;
            format!("component {name}: {why}\nhint: handle it with a transition `on error`")
        },
    );
    format!("in state {state}{place}: {cause}")
}

/// A component of a loaded machine.
#[derive(Debug)]
struct Part {
    configuration: Configuration,
    /// What its net may cost, as found while the machine was loaded.
    cost: Duration,
    resources: ResourceSet,
}

/// A machine in the registry.
#[derive(Debug)]
struct Loaded {
    program: Arc<Program>,
    text: Arc<str>,
    session: SessionId,
    thread: usize,
    parts: Vec<Part>,
    cost: MachineCost,
    view: LatestReader<MachineView>,
    /// The answer of its thread to its addition.
    added: Option<Result<(), StartError>>,
    /// Until when its final state may take, once its end has stopped it.
    stop_by: Option<Instant>,
    is_ending: bool,
    /// Why nets of components ended last, by component.
    ends: BTreeMap<usize, String>,
}

/// Work that a machine causes outside of its thread.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Job {
    /// Load one more net for the next starts of a component.
    Refill(u32, usize),
    /// Load the nets of a component with the present values of its properties.
    Configure(u32, usize),
    /// Unload an ended net of a component.
    Unload(NetId),
}

/// All machines.
#[derive(Debug, Default)]
pub(super) struct Machines {
    all: BTreeMap<u32, Loaded>,
    last: u32,
    /// Machines that were unloaded within the time of a flight file, with when.
    past: VecDeque<(Instant, u32, Arc<Program>, Arc<str>)>,
    jobs: VecDeque<Job>,
    /// The machine for which a net is being loaded.
    loading: Option<u32>,
    /// Requests that are not answered, and answers that are not taken.
    answers: BTreeMap<u64, Option<Result<(), InputError>>>,
    requests: u64,
}

impl Machines {
    /// Those that are loaded or were within the time of a flight file: number, program, text.
    pub(super) fn that_ran(&self) -> impl Iterator<Item = (u32, &Arc<Program>, &Arc<str>)> {
        let all = self.all.iter();
        let all = all.map(|(id, loaded)| (*id, &loaded.program, &loaded.text));
        let past = self.past.iter();
        past.map(|(_, id, program, text)| (*id, program, text))
            .chain(all)
    }

    /// Their texts, by file name: of several of one name the last.
    pub(super) fn texts(&self) -> impl Iterator<Item = (String, Arc<str>)> {
        let texts = self.that_ran().map(|(_, program, text)| {
            let name = format!("machines/{}.machine", program.name());
            (name, Arc::clone(text))
        });
        texts.collect::<BTreeMap<_, _>>().into_iter()
    }

    /// Removes a machine, and keeps what a flight file needs of it for a while.
    fn remove(&mut self, id: u32) -> Option<Loaded> {
        let loaded = self.all.remove(&id)?;
        let kept = |at: &Instant| at.elapsed() <= PAST_FOR;
        self.past.retain(|(at, ..)| kept(at));
        if self.past.len() >= PAST_MAX {
            self.past.pop_front();
        }
        let (program, text) = (Arc::clone(&loaded.program), Arc::clone(&loaded.text));
        self.past.push_back((Instant::now(), id, program, text));
        Some(loaded)
    }

    fn find(&self, name: &str) -> Result<(u32, &Loaded), Error> {
        let mut all = self.all.iter();
        let found = all.find(|(_, loaded)| loaded.program.name() == name);
        found.map(|(id, loaded)| (*id, loaded)).ok_or_else(|| {
            let names: Vec<&str> = self.all.values().map(|it| it.program.name()).collect();
            Error::NoSuchMachine {
                name: name.to_owned(),
                known: if names.is_empty() {
                    "none".to_owned()
                } else {
                    names.join(", ")
                },
            }
        })
    }

    /// Each machine and those inside, as far as the rows of its thread have room for all: its number and that of the machine
    /// inside, its thread, its name, and the names of its states.
    pub(super) fn of_probes(
        &self,
    ) -> impl Iterator<Item = ((u32, usize), usize, String, Arc<[String]>)> + '_ {
        let inside = |thread: usize| -> usize {
            let all = self.all.values().filter(move |it| it.thread == thread);
            all.map(|it| it.program.machines().count()).sum()
        };
        self.all.iter().flat_map(move |(id, loaded)| {
            let program = &loaded.program;
            let is_shown = inside(loaded.thread) <= STATES_MAX;
            let shown = if is_shown { usize::MAX } else { 1 };
            let machines = program.machines().enumerate().take(shown);
            machines.map(move |(number, name)| {
                let states = program.states(number).map(str::to_owned).collect();
                let name = match number {
                    0 => name.to_owned(),
                    _ => format!("{}.{name}", program.name()),
                };
                ((*id, number), loaded.thread, name, states)
            })
        })
    }

    /// The thread answered the addition of a machine.
    pub(super) fn added(&mut self, id: u32, result: Result<(), StartError>) {
        if let Some(loaded) = self.all.get_mut(&id) {
            loaded.added = Some(result);
        }
    }

    /// The thread answered a request.
    pub(super) fn answered(&mut self, _: u32, number: u64, result: Result<(), InputError>) {
        // A caller whose timeout is over has removed its place.
        if let Some(answer) = self.answers.get_mut(&number) {
            *answer = Some(result);
        }
    }

    /// A machine requests a `configure`.
    pub(super) fn configure(&mut self, id: u32, component: usize) {
        self.jobs.push_back(Job::Configure(id, component));
    }

    /// The status of a machine has changed: a failure is logged, once.
    pub(super) fn report_status(&mut self, id: u32, status: Status) {
        let Some(loaded) = self.all.get_mut(&id) else {
            return;
        };
        let (program, text) = (Arc::clone(&loaded.program), Arc::clone(&loaded.text));
        let name = program.name();
        let failure = loaded
            .view
            .read_with(|view| view.machines.first().and_then(|machine| machine.failure));
        match (status, failure) {
            (Status::Failed, Some(failure)) => {
                let why = failure_text(&program, &text, &loaded.ends, (0, failure));
                tracing::warn!(
                    machine = name,
                    "machine failed, its components are stopped: {why}"
                );
            }
            (Status::Failed, None) => {
                tracing::warn!(machine = name, "machine failed, its components are stopped");
            }
            (Status::Finished, _) => tracing::info!(machine = name, "machine finished"),
            (Status::Active | Status::Inactive, _) => {}
        }
    }
}

impl Loaded {
    fn status(&mut self) -> Status {
        let first = |view: &MachineView| view.machines.first().map(|machine| machine.status);
        self.view.read_with(first).unwrap_or_default()
    }

    pub(super) fn info(&mut self) -> MachineInfo {
        MachineInfo {
            name: self.program.name().to_owned(),
            session: self.session,
            program: Arc::clone(&self.program),
            text: Arc::clone(&self.text),
            view: self.view.read_with(MachineView::clone),
            cost: self.cost,
            ends: self.ends.clone(),
        }
    }
}
