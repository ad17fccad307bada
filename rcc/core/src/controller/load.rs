//! Loading: a net's text is compiled to a plan in the caller's thread, while all others continue. Nothing is
//! started here.

use std::sync::Arc;
use std::time::Duration;

use takt_net::{Limits, LoadContext, Parsed, Plan, Rejection, Sorted};
use takt_rt::latest::latest;

use crate::controller::Controller;
use crate::controller::nets::{Change, NETS_MAX, Prepared, Values};
use crate::controller::registry::Registry;
use crate::controller::shared::Shared;
use crate::controller::threads::{Placement, Wanted, busy};
use crate::device::{DeviceTable, Surroundings};
use crate::error::Error;
use crate::executor::figures::budget;
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
        let wanted = Wanted::Period(request.period);
        self.inner.load(request, wanted)
    }
}

impl Shared {
    /// Loads a net for a thread and a period.
    pub(super) fn load(&self, request: LoadRequest, wanted: Wanted) -> Result<NetId, Error> {
        let free = free_for(&request.text)?;
        let (id, text) = self.accept(request)?;
        let memory = self.reserve_memory(id)?.min(free);
        let prepared = self.prepare(id, &text, wanted, memory);
        let mut registry = self.lock();
        let Registry {
            nets, admission, ..
        } = &mut *registry;
        // What is reserved is not taken besides.
        nets.get_mut(id).into_iter().for_each(|net| net.reserve(0));
        let admitted = prepared.as_ref().map_err(Clone::clone);
        let admitted = admitted.and_then(|it| admission.check_memory(nets, &it.running.plan));
        // A rejected net may be large: it is freed without the lock.
        let mut rejected = None;
        if let Some(net) = nets.get_mut(id) {
            match (prepared, admitted) {
                (Ok(prepared), Ok(())) => net.make_ready(prepared),
                (prepared, admitted) => {
                    rejected = prepared.ok();
                    if let Err(why) = admitted {
                        net.change(Change::Reject(why));
                    }
                }
            }
        }
        self.announce(&registry);
        drop(registry);
        drop(rejected);
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
        let mut registry = self.lock();
        registry.permission.check_load()?;
        if !registry.sessions.is_valid(session) {
            return Err(Error::NoSuchSession(session.to_string()));
        }
        let mut excess = registry.admission.check_text(&registry.nets, text.len())?;
        while excess > 0 {
            let unloaded = registry.unload_oldest().ok_or_else(busy)?;
            excess = excess.saturating_sub(unloaded.text().len());
        }
        if registry.nets.len() >= NETS_MAX && registry.unload_oldest().is_none() {
            return Err(Error::TooMany {
                item: "loaded nets",
                bound: NETS_MAX,
            });
        }
        let id = registry.nets.add(session, description, Arc::clone(&text));
        self.announce(&registry);
        Ok((id, text))
    }

    /// Reserves memory for a net to be loaded; waits for other loads if necessary.
    fn reserve_memory(&self, id: NetId) -> Result<usize, Error> {
        let most = Limits::default().memory_bytes;
        let registry = self.lock();
        let keep = |registry: &mut Registry| {
            let Registry {
                nets, admission, ..
            } = registry;
            admission.reserve(nets, id, most)
        };
        self.wait_until(registry, LOADS_WITHIN, keep).map_err(|_| {
            let mut registry = self.lock();
            registry.nets.remove(id);
            self.announce(&registry);
            Error::TooMany {
                item: "bytes of nets that are loaded at once; load them one after the other",
                bound: registry.admission.memory(),
            }
        })
    }

    /// Checks a net and makes it ready, without the registry except for a copy of the devices.
    fn prepare(
        &self,
        id: NetId,
        text: &Arc<str>,
        wanted: Wanted,
        memory: usize,
    ) -> Result<Prepared, Rejection> {
        let devices = self.lock().devices.table.clone();
        let (plan, place) = self.plan(text, wanted, &devices, memory)?;
        place.check_cost(plan.cost())?;
        let mut registry = self.lock();
        let mut resources = ResourceSet::default();
        for name in plan.resources() {
            resources.insert(registry.nets.resource(name)?);
        }
        // Only the first thread is recorded.
        if let (Some(recorder), 0) = (&registry.recorder, place.thread) {
            recorder.net(id, (place.every, place.period), text, plan.outbox());
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
        let (links, links_end) = self.lock().nets.link(&plan, &out_reader)?;
        let (in_writer, inbox) = latest(1, || in_words.clone());
        let mut running = Box::new(Running::new(id.0, plan, out, inbox));
        running.resources = resources;
        running.devices = numbers;
        running.set_every(place.every);
        running.links = links;
        Ok(Prepared {
            thread: place.thread,
            running,
            values: Values {
                links: links_end,
                out_directory,
                out_reader,
                in_directory,
                in_writer,
                in_words,
            },
        })
    }

    /// Compiles the plan and finds its thread. Which devices a net commands is known only when it is
    /// built, and so is the default period. It is parsed, resolved and sorted once, and built again if that is
    /// another period than assumed.
    fn plan(
        &self,
        text: &str,
        wanted: Wanted,
        devices: &DeviceTable,
        memory_bytes: usize,
    ) -> Result<(Plan, Placement), Rejection> {
        let place = |devices: &[String]| self.lock().threads.place_for(wanted, devices);
        let before = place(&[])?;
        let limits = Limits {
            memory_bytes,
            ..Limits::default()
        };
        let context = LoadContext {
            registry: &self.primitives,
            devices: &Surroundings {
                devices,
                boxes: |id| self.lock().nets.get(id)?.boxes(),
            },
            period: before.period,
            limits,
        };
        let parsed = Parsed::new(text, &limits);
        let sorted = Sorted::new(&parsed, &context);
        let assumed = budget(before.period);
        // The budget of a period that is not known yet is no reason to reject.
        let plan = sorted.build(before.period, wanted.is_period().then_some(assumed))?;
        let after = place(plan.devices())?;
        if after.period == before.period && plan.cost().total <= assumed {
            return Ok((plan, after));
        }
        drop(plan);
        let plan = sorted.build(after.period, Some(budget(after.period)))?;
        Ok((plan, after))
    }
}
