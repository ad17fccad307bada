//! Loading: a net's text is compiled to a plan in the caller's thread, while all others continue. Nothing is
//! started here.

use std::sync::Arc;
use std::time::Duration;

use takt_net::{Limits, LoadContext, Plan, Rejection, load};
use takt_rt::latest::latest;

use crate::controller::links::Surroundings;
use crate::controller::net::{Net, Prepared};
use crate::controller::threads::Place;
use crate::controller::{Controller, NETS_MAX, limits_for};
use crate::device::DeviceTable;
use crate::error::Error;
use crate::executor::links::OUT_READERS;
use crate::executor::{ResourceSet, Running};
use crate::ids::{NetId, SessionId};

/// A request to load a net.
#[derive(Clone, Debug)]
pub struct LoadRequest {
    /// The net.
    pub text: String,
    /// Session that it belongs to; `SessionId(0)` for none.
    pub session: SessionId,
    /// Description for users.
    pub description: String,
    /// Period, a whole multiple of a net thread's; `None` for the period
    /// of the thread that serves the devices it commands, or of the first.
    pub period: Option<Duration>,
}

/// Memory for a net within the host's limits, bytes: half of what is free, as loading takes more than the loaded net.
///
/// # Errors
/// If it does not suffice even to parse the text.
fn free_for(text: &str) -> Result<usize, Error> {
    /// Maximum bytes that parsing takes per byte of text.
    const BYTES_PER_BYTE: u64 = 32;
    let Some(free) = crate::memory::free() else {
        return Ok(usize::MAX);
    };
    if free / 2 < text.len() as u64 * BYTES_PER_BYTE || free == 0 {
        return Err(Error::HostMemory {
            free_mib: free >> 20,
        });
    }
    Ok(usize::try_from(free / 2).unwrap_or(usize::MAX))
}

/// How long a load may wait for others: less than the reply timeout of clients.
const LOADS_WITHIN: Duration = Duration::from_secs(20);

impl Controller {
    /// Loads a net. A rejected net gets an identifier too; its state shows the rejection. If there are
    /// [`NETS_MAX`] nets, the oldest ended one is unloaded.
    ///
    /// # Errors
    /// If there are too many nets, or no such session.
    pub fn load(&self, request: LoadRequest) -> Result<NetId, Error> {
        let period = request.period;
        let free = free_for(&request.text)?;
        let (id, text) = self.accept(request)?;
        let memory = self.keep_memory(id)?.min(free);
        let prepared = self.prepare(id, &text, period, memory);
        let mut registry = self.inner.lock();
        registry.release_memory(id);
        let taken = match &prepared {
            Ok(prepared) => registry.check_memory(&prepared.running.plan),
            Err(rejection) => Err(rejection.clone()),
        };
        // A rejected net may be large: it is freed without the lock.
        let mut refused = None;
        if let Some(net) = registry.nets.get_mut(&id) {
            match (prepared, taken) {
                (Ok(prepared), Ok(())) => net.make_ready(prepared),
                (prepared, taken) => {
                    refused = prepared.ok();
                    taken.err().into_iter().for_each(|why| net.reject(why));
                }
            }
        }
        self.inner.announce(&registry);
        drop(registry);
        drop(refused);
        Ok(id)
    }

    /// Adds a net with its text.
    fn accept(&self, request: LoadRequest) -> Result<(NetId, Arc<str>), Error> {
        let LoadRequest {
            text,
            session,
            description,
            ..
        } = request;
        let text: Arc<str> = text.into();
        let mut registry = self.inner.lock();
        registry.refuse_if_closing()?;
        if session != SessionId::NONE && !registry.sessions.contains_key(&session) {
            return Err(Error::NoSuchSession(session.to_string()));
        }
        registry.take_text(text.len())?;
        if registry.nets.len() >= NETS_MAX && registry.forget_oldest().is_none() {
            return Err(Error::TooMany {
                what: "loaded nets",
                bound: NETS_MAX,
            });
        }
        let id = registry.next_net();
        let net = Net::new(session, description, Arc::clone(&text));
        registry.nets.insert(id, net);
        self.inner.announce(&registry);
        Ok((id, text))
    }

    /// Reserves memory for a net to be loaded; waits for other loads if necessary.
    fn keep_memory(&self, id: NetId) -> Result<usize, Error> {
        let most = Limits::default().memory_bytes;
        let registry = self.inner.lock();
        let keep = |registry: &mut super::Registry| registry.keep_memory(id, most);
        self.inner
            .wait_within(registry, LOADS_WITHIN, keep)
            .map_err(|_| {
                let mut registry = self.inner.lock();
                registry.nets.remove(&id);
                self.inner.announce(&registry);
                Error::TooMany {
                    what: "bytes of nets that are loaded at once; load them one after the other",
                    bound: registry.room.memory,
                }
            })
    }

    /// Checks a net and makes it ready, without the registry except for a copy of the devices.
    fn prepare(
        &self,
        id: NetId,
        text: &Arc<str>,
        period: Option<Duration>,
        memory: usize,
    ) -> Result<Prepared, Rejection> {
        let devices = self.inner.lock().devices.clone();
        let (plan, place) = self.plan(text, period, &devices, memory)?;
        place.check_cost(plan.cost())?;
        let mut registry = self.inner.lock();
        let mut resources = ResourceSet::default();
        for name in plan.resources() {
            resources.insert(registry.resource(name)?);
        }
        // Only the first thread is recorded.
        if let (Some(recorder), 0) = (&registry.recorder, place.thread) {
            recorder.net(id.0, place.every, place.period, text);
        }
        drop(registry);
        let numbers = plan
            .devices()
            .iter()
            .filter_map(|name| devices.number(name));
        let numbers: Vec<_> = numbers.map(|number| (number, 0)).collect();
        let (out_directory, in_directory) = (Arc::clone(plan.outbox()), Arc::clone(plan.inbox()));
        let in_words: Box<[u64]> = plan.inbox_words().collect();
        let (out, out_reader) = latest(OUT_READERS, || {
            vec![0; out_directory.words()].into_boxed_slice()
        });
        let (links, links_end) = self.inner.lock().link(&plan, &out_reader)?;
        let (in_writer, inbox) = latest(1, || in_words.clone());
        let mut running = Box::new(Running::new(id.0, plan, out, inbox));
        running.resources = resources;
        running.devices = numbers;
        running.set_every(place.every);
        running.links = links;
        Ok(Prepared {
            thread: place.thread,
            running,
            links: links_end,
            out_directory,
            out_reader,
            in_directory,
            in_writer,
            in_words,
        })
    }

    /// Compiles the plan and finds its thread. Which devices a net commands is known only when it is
    /// loaded, and so is the default period.
    fn plan(
        &self,
        text: &str,
        period: Option<Duration>,
        devices: &DeviceTable,
        memory_bytes: usize,
    ) -> Result<(Plan, Place), Rejection> {
        let limits_for = |period| Limits {
            memory_bytes,
            ..limits_for(period)
        };
        let place = |devices: &[String]| self.inner.lock().place(period, devices);
        let before = place(&[])?;
        let limits = limits_for(before.period);
        // The budget of a period that is not known yet is no reason to reject.
        let cost = limits.cost.filter(|_| period.is_some());
        let plan = self.load_for(text, before.period, Limits { cost, ..limits }, devices)?;
        let after = place(plan.devices())?;
        let fits = limits.cost.is_none_or(|cost| plan.cost().total <= cost);
        if after.period == before.period && fits {
            return Ok((plan, after));
        }
        let limits = limits_for(after.period);
        let plan = self.load_for(text, after.period, limits, devices)?;
        Ok((plan, after))
    }

    fn load_for(
        &self,
        text: &str,
        period: Duration,
        limits: Limits,
        devices: &DeviceTable,
    ) -> Result<Plan, Rejection> {
        let context = LoadContext {
            registry: &self.inner.primitives,
            devices: &Surroundings {
                devices,
                inner: &self.inner,
            },
            period,
            limits,
        };
        load(text, &context)
    }
}
