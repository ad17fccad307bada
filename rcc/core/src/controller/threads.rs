//! The net threads of a controller: they start with it, a net is assigned to one of them when it
//! is loaded, and each command goes to the thread that it concerns. The executor module executes
//! the commands.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use takt_net::fault::{Fault, FaultKind};
use takt_net::{NetCost, Rejection};
use takt_rt::thread::ThreadConfig;

use crate::cell::{CellConfig, THREADS_MAX, listed};
use crate::controller::clock::{self, FollowedClock};
use crate::device::Device;
use crate::error::Error;
use crate::executor::figures::budget;
use crate::executor::flight;
use crate::executor::report::Notifier;
use crate::executor::serve::{DeviceEnd, Driver};
use crate::executor::stop::{EmergencyStop, StopPart};
use crate::executor::thread::{COMMANDS, Command, Event, NetThread, NetThreadConfig};
use crate::record::Tap;

/// Maximum period of a net.
const NET_PERIOD_MAX: Duration = Duration::from_mins(1);

/// The thread and the period of a net.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Placement {
    /// Number of its thread.
    pub(super) thread: usize,
    /// Its period.
    pub(super) period: Duration,
    /// Its period in cycles of the thread.
    pub(super) every: u64,
}

impl Placement {
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
        Err(rejected("cycle", why))
    }
}

/// Where and how often a net is to be evaluated.
#[derive(Clone, Copy, Debug)]
pub(super) enum Wanted {
    /// With this period, or with that of its thread.
    Period(Option<Duration>),
    /// Every so many cycles of the thread that serves its devices; without devices, of this one.
    Cycles(u32, usize),
}

impl Wanted {
    /// Whether the period is known before the net is built.
    pub(super) const fn is_period(self) -> bool {
        matches!(self, Self::Period(Some(_)))
    }
}

/// The net threads, the first one first.
#[derive(Debug, Default)]
pub(super) struct NetThreads {
    threads: Vec<NetThread>,
    /// Threads of devices, by device name; the first thread for devices that are not listed.
    serving: BTreeMap<String, usize>,
}

impl NetThreads {
    /// Starts all net threads of a cell on one time base; the first one is recorded.
    pub(super) fn start(
        cell: &CellConfig,
        followed: Option<&FollowedClock>,
        stop: &Arc<EmergencyStop>,
        notifier: &Arc<Notifier>,
        tap: Option<Tap>,
    ) -> Result<Self, Error> {
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
        let base = clock::base(&cell.periods().collect::<Vec<_>>());
        let mut tap = tap;
        let mut threads = Vec::new();
        for (thread, period) in [first].into_iter().chain(others).zip(cell.periods()) {
            let config = NetThreadConfig {
                period,
                base,
                follow: followed.and_then(|clock| clock.follow(threads.len())),
                stop: StopPart::new(Arc::clone(stop), threads.len()),
                notifier: Arc::clone(notifier),
                thread,
            };
            stop.switch().register(threads.len(), period.into());
            threads.push(NetThread::start(config, tap.take())?);
        }
        Ok(Self {
            threads,
            serving: BTreeMap::new(),
        })
    }

    /// The thread of that period, by default the first.
    pub(super) fn of_period(&self, period: Option<Duration>) -> Result<usize, String> {
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

    /// The thread and period of a net that commands these devices.
    pub(super) fn place_for(
        &self,
        wanted: Wanted,
        devices: &[String],
    ) -> Result<Placement, Rejection> {
        let (every, thread) = match wanted {
            Wanted::Period(period) => return self.place(period, devices),
            Wanted::Cycles(every, thread) => (every, thread),
        };
        let serving = devices.first().map(|device| self.serving_thread(device));
        let thread = serving.unwrap_or(thread);
        let period = self
            .period(thread)
            .unwrap_or_default()
            .saturating_mul(every);
        let placed = self.place(Some(period), devices)?;
        let every = u64::from(every);
        Ok(if serving.is_some() {
            placed
        } else {
            Placement {
                thread,
                period,
                every,
            }
        })
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
    ) -> Result<Placement, Rejection> {
        if let Some(period) = period.filter(|period| *period > NET_PERIOD_MAX) {
            let why =
                format!("{period:?} is longer than the {NET_PERIOD_MAX:?} that a cycle may take");
            return Err(rejected("cycle", why));
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
                rejected(
                    "cycle",
                    format!("{period:?} is not a whole multiple of the controller's {threads}"),
                )
            })?;
            return Ok(Placement {
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
            return Err(rejected("Robot", why));
        }
        let period = period.unwrap_or_else(|| given(thread));
        let every = multiple(period, given(thread)).ok_or_else(|| {
            let thread = given(thread);
            let why = format!(
                "{period:?} is not a whole multiple of the {thread:?} of the net thread that serves \
                 `{device}`"
            );
            rejected("cycle", why)
        })?;
        Ok(Placement {
            thread,
            period,
            every,
        })
    }

    /// Sends a command to a thread. If its queue is full, the command is dropped.
    ///
    /// # Errors
    /// If its queue is full.
    pub(super) fn send(&mut self, thread: usize, command: Command) -> Result<(), Error> {
        let thread = self.threads.get_mut(thread).ok_or_else(busy)?;
        thread.commands.push(command).map_err(|_| busy())
    }

    /// Checks that a thread's queue has space for one command. The result holds while the registry is locked, until the
    /// command is sent.
    pub(super) fn check_capacity_of(&mut self, thread: usize) -> Result<(), Error> {
        let thread = self.threads.get_mut(thread).ok_or_else(busy)?;
        if thread.commands.free_slots() > 0 {
            return Ok(());
        }
        Err(busy())
    }

    /// Checks that each thread's queue has space for so many commands. The result holds while the registry
    /// is locked, until they are sent.
    pub(super) fn check_capacity(&mut self, commands: usize) -> Result<(), Error> {
        let free = self.threads.iter_mut().map(|t| t.commands.free_slots());
        match free.min() {
            Some(free) if free >= commands => Ok(()),
            _ => Err(busy()),
        }
    }

    /// Assigns a device to the thread that serves it; all other threads can read its state.
    pub(super) fn add_device(
        &mut self,
        number: usize,
        device: &Device,
        driver: Driver,
    ) -> Result<(), Error> {
        self.check_capacity(1)?;
        let end = |driver| DeviceEnd::new(number, device.place.clone(), driver);
        let serving = self.serving_thread(&device.name);
        for thread in (0..self.threads.len()).filter(|thread| *thread != serving) {
            let state = device.reader().ok_or(Error::TooMany {
                item: "threads that see a device",
                bound: THREADS_MAX,
            })?;
            let end = Box::new(end(Driver::Seen { state }));
            self.send(thread, Command::AddDevice(end))?;
        }
        let period = self.period(serving).unwrap_or_default();
        let (writer, reader) = flight::of_device(&device.place, period);
        // A device is served once, from when it is added.
        device.flight.get_or_init(|| reader);
        let end = Box::new(end(driver).with_flight(writer));
        self.send(serving, Command::AddDevice(end))
    }

    /// Takes a device from all threads.
    pub(super) fn remove_device(&mut self, number: usize) -> Result<(), Error> {
        self.check_capacity(1)?;
        for thread in 0..self.threads.len() {
            self.send(thread, Command::RemoveDevice(number))?;
        }
        Ok(())
    }

    /// The next event of a thread.
    pub(super) fn next_event(&mut self, thread: usize) -> Option<Event> {
        self.threads.get_mut(thread)?.events.pop()
    }

    pub(super) fn len(&self) -> usize {
        self.threads.len()
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = &NetThread> {
        self.threads.iter()
    }

    pub(super) fn get(&self, thread: usize) -> Option<&NetThread> {
        self.threads.get(thread)
    }

    pub(super) fn first(&self) -> Option<&NetThread> {
        self.threads.first()
    }

    /// Period of the thread of that number.
    pub(super) fn period(&self, thread: usize) -> Option<Duration> {
        self.threads.get(thread).map(|thread| thread.period)
    }

    /// Time that nets of a thread may take together in a cycle.
    pub(super) fn budget(&self, thread: usize) -> Duration {
        budget(self.period(thread).unwrap_or_default())
    }

    /// The longest period of a thread.
    pub(super) fn slowest(&self) -> Duration {
        self.periods().into_iter().max().unwrap_or_default()
    }

    /// Ends all threads and waits for that.
    pub(super) fn stop(&mut self) {
        self.threads.iter().for_each(NetThread::request_stop);
        for thread in self.threads.drain(..) {
            thread.stop();
        }
    }
}

/// The error of a thread whose queue is full.
pub(super) const fn busy() -> Error {
    Error::TooMany {
        item: "requests to the net thread",
        bound: COMMANDS,
    }
}

/// Period of a net in cycles of the thread, if it is a whole multiple.
fn multiple(period: Duration, thread_period: Duration) -> Option<u64> {
    let (wanted, given) = (period.as_nanos(), thread_period.as_nanos().max(1));
    let whole = wanted > 0 && wanted.is_multiple_of(given);
    whole.then(|| u64::try_from(wanted / given).unwrap_or(u64::MAX))
}

fn rejected(parameter: &str, why: String) -> Rejection {
    let parameter = parameter.to_owned();
    let kind = FaultKind::Parameter { parameter, why };
    Rejection {
        faults: vec![Fault::new(kind, 0..0)],
    }
}

#[cfg(test)]
mod tests;
