//! The net threads of a controller: they start with it, a net is assigned to one of them when it
//! is loaded, and each command goes to the thread that it concerns. The executor module executes
//! the commands.

use std::sync::Arc;
use std::time::Duration;

use takt_net::fault::{Fault, FaultKind};
use takt_net::{NetCost, Rejection};
use takt_rt::thread::ThreadConfig;

use crate::cell::{CellConfig, THREADS_MAX, listed};
use crate::controller::clock::FollowedClock;
use crate::controller::registry::Registry;
use crate::error::Error;
use crate::executor::figures::budget;
use crate::executor::rules::Literal;
use crate::executor::serve::{DeviceEnd, Driver};
use crate::executor::stop::{EmergencyStop, StopPart};
use crate::executor::thread::{COMMANDS, Command, NetThread, NetThreadConfig};
use crate::ids::NetId;
use crate::record::Tap;

/// Maximum period of a net.
const NET_PERIOD_MAX: Duration = Duration::from_mins(1);

/// Thread and period of a net.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Place {
    /// Number of its thread.
    pub(super) thread: usize,
    /// Its period.
    pub(super) period: Duration,
    /// Its period in cycles of the thread.
    pub(super) every: u64,
}

impl Place {
    /// Rejects a net whose cost bound exceeds the budget of its thread's cycle, whatever its own period.
    pub(super) fn check_cost(&self, cost: &NetCost) -> Result<(), Rejection> {
        let Self { period, every, .. } = *self;
        let thread = period / u32::try_from(every.max(1)).unwrap_or(u32::MAX);
        let budget = budget(thread);
        if cost.total <= budget {
            return Ok(());
        }
        let why = format!(
            "a cycle of the net costs up to {:?}, and may cost {budget:?}: it is evaluated within one cycle of \
             a net thread of {thread:?}, if only in one of {every}; the heaviest are {}; use fewer of these, \
             or load it for a net thread of {period:?} (`[[controller.thread]]`), which then serves the \
             devices it commands too",
            cost.total,
            cost.heaviest(3)
        );
        Err(refused("cycle", why))
    }
}

/// Starts all net threads of a cell on one time base; the first one is recorded.
pub(super) fn start(
    cell: &CellConfig,
    clock: Option<&FollowedClock>,
    stop: &Arc<EmergencyStop>,
    tap: Option<Tap>,
) -> Result<Vec<NetThread>, Error> {
    let controller = &cell.controller;
    let first = ThreadConfig {
        priority: controller.priority,
        cpus: controller.cpus.clone(),
        ..ThreadConfig::new("takt-nets")
    };
    let others = controller.threads.iter().map(|thread| ThreadConfig {
        priority: thread.priority,
        cpus: thread.cpus.clone(),
        ..ThreadConfig::new(format!("takt-nets-{:?}", thread.period).replace('µ', "u"))
    });
    let base = takt_rt::monotonic();
    let mut tap = tap;
    let mut threads = Vec::new();
    for (thread, period) in [first].into_iter().chain(others).zip(cell.periods()) {
        let config = NetThreadConfig {
            period,
            base,
            follow: clock.and_then(|clock| clock.follow(threads.len())),
            stop: StopPart::new(Arc::clone(stop), threads.len()),
            thread,
        };
        stop.switch().register(threads.len(), period.into());
        threads.push(NetThread::start(config, tap.take())?);
    }
    Ok(threads)
}

impl Registry {
    /// The thread of that period, by default the first.
    pub(super) fn thread_of_period(&self, period: Option<Duration>) -> Result<usize, String> {
        let Some(period) = period else {
            return Ok(0);
        };
        let mut threads = self.threads.iter();
        threads.position(|t| t.period == period).ok_or_else(|| {
            let periods = listed(&self.periods());
            format!("there is no net thread of {period:?}; the net threads are those of {periods}")
        })
    }

    /// Sets the thread that serves a device, by default the first.
    pub(super) fn serve_in(&mut self, device: &str, thread: usize) {
        self.serving.insert(device.to_owned(), thread);
    }

    /// The thread that serves a device.
    pub(super) fn serving_thread(&self, device: &str) -> usize {
        self.serving.get(device).copied().unwrap_or(0)
    }

    fn periods(&self) -> Vec<Duration> {
        self.threads.iter().map(|thread| thread.period).collect()
    }

    /// Placement of a net that commands these devices: the thread that serves them, or, without any,
    /// the thread of its period, or the slowest one of which its period is a multiple.
    pub(super) fn place(
        &self,
        period: Option<Duration>,
        devices: &[String],
    ) -> Result<Place, Rejection> {
        if let Some(period) = period.filter(|period| *period > NET_PERIOD_MAX) {
            let why =
                format!("{period:?} is longer than the {NET_PERIOD_MAX:?} that a cycle may take");
            return Err(refused("cycle", why));
        }
        let periods = self.periods();
        let given = |thread: usize| periods.get(thread).copied().unwrap_or_default();
        let Some(device) = devices.first() else {
            let period = period.unwrap_or_else(|| given(0));
            let fitting = periods.iter().enumerate();
            let fitting = fitting.filter_map(|(i, p)| Some((*p, i, multiple(period, *p)?)));
            let slowest = fitting.max_by_key(|(period, ..)| *period);
            let (_, thread, every) = slowest.ok_or_else(|| {
                let threads = listed(&periods);
                refused(
                    "cycle",
                    format!("{period:?} is not a whole multiple of the controller's {threads}"),
                )
            })?;
            return Ok(Place {
                thread,
                period,
                every,
            });
        };
        let thread = self.serving_thread(device);
        let stranger = devices.iter().find(|d| self.serving_thread(d) != thread);
        if let Some(stranger) = stranger {
            let (one, other) = (given(thread), given(self.serving_thread(stranger)));
            let why = format!(
                "a net commands devices of one net thread, but `{device}` is served by that of \
                 {one:?} and `{stranger}` by that of {other:?}; give both the same `thread` in the \
                 cell's configuration, or command them by two nets"
            );
            return Err(refused("Robot", why));
        }
        let period = period.unwrap_or_else(|| given(thread));
        let every = multiple(period, given(thread)).ok_or_else(|| {
            let thread = given(thread);
            let why = format!(
                "{period:?} is not a whole multiple of the {thread:?} of the net thread that serves \
                 `{device}`"
            );
            refused("cycle", why)
        })?;
        Ok(Place {
            thread,
            period,
            every,
        })
    }

    /// Sends a command to a thread; returns it if the thread's queue is full.
    pub(super) fn send(&mut self, thread: usize, command: Command) -> Result<(), Command> {
        match self.threads.get_mut(thread) {
            Some(thread) => thread.commands.push(command),
            None => Err(command),
        }
    }

    /// Checks that each thread's queue has space for so many commands. The result holds while the registry
    /// is locked, until they are sent.
    pub(super) fn has_room(&mut self, commands: usize) -> Result<(), Error> {
        let rooms = self.threads.iter_mut().map(|t| t.commands.free_slots());
        match rooms.min() {
            Some(room) if room >= commands => Ok(()),
            _ => Err(busy()),
        }
    }

    /// Sends a command to the thread of the net or the threads of the device.
    pub(super) fn command(&mut self, command: Command) -> Result<(), Error> {
        let thread = match &command {
            Command::Start(net) | Command::Schedule(net) => self.thread_of(net.id),
            Command::Cancel(id)
            | Command::Abort(id)
            | Command::StartScheduled(id)
            | Command::Forget(id)
            | Command::Answer(Literal { net: id, .. })
            | Command::Unschedule { net: id, .. } => self.thread_of(*id),
            Command::AddRule(_) => 0,
            Command::AddDevice(end) => return self.add_to_threads(end.number(), command),
            Command::RemoveDevice(number) => return self.remove_from_threads(*number),
        };
        self.send(thread, command).map_err(|_| busy())
    }

    /// Assigns a device to the thread that serves it; all other threads can read its state.
    fn add_to_threads(&mut self, number: usize, command: Command) -> Result<(), Error> {
        self.has_room(1)?;
        let Some(device) = self.devices.get(number).cloned() else {
            return Ok(());
        };
        let serving = self.serving_thread(&device.name);
        for thread in (0..self.threads.len()).filter(|thread| *thread != serving) {
            let state = device.reader().ok_or(Error::TooMany {
                what: "threads that see a device",
                bound: THREADS_MAX,
            })?;
            let end = DeviceEnd::new(number, device.place.clone(), Driver::Seen { state });
            let seen = self.send(thread, Command::AddDevice(Box::new(end)));
            seen.map_err(|_| busy())?;
        }
        self.send(serving, command).map_err(|_| busy())
    }

    fn remove_from_threads(&mut self, number: usize) -> Result<(), Error> {
        self.has_room(1)?;
        for thread in 0..self.threads.len() {
            let removed = self.send(thread, Command::RemoveDevice(number));
            removed.map_err(|_| busy())?;
        }
        Ok(())
    }

    /// The thread of a net.
    pub(super) fn thread_of(&self, net: u32) -> usize {
        self.nets.get(&NetId(net)).map_or(0, |net| net.thread)
    }
}

/// The error of a thread whose queue is full.
pub(super) const fn busy() -> Error {
    Error::TooMany {
        what: "requests to the net thread",
        bound: COMMANDS,
    }
}

/// Period of a net in cycles of the thread, if it is a whole multiple.
fn multiple(period: Duration, thread_period: Duration) -> Option<u64> {
    let (wanted, given) = (period.as_nanos(), thread_period.as_nanos().max(1));
    let whole = wanted > 0 && wanted.is_multiple_of(given);
    whole.then(|| u64::try_from(wanted / given).unwrap_or(u64::MAX))
}

fn refused(parameter: &str, why: String) -> Rejection {
    let parameter = parameter.to_owned();
    let kind = FaultKind::Parameter { parameter, why };
    Rejection {
        faults: vec![Fault::new(kind, 0..0)],
    }
}

#[cfg(test)]
mod tests;
