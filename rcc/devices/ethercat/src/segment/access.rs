//! Questions of other threads to the master of a running segment. They reach the driver thread by a bounded ring and are
//! answered by another: the driver never waits, allocates or frees. Callers make and free all buffers.

mod history;
mod report;
#[cfg(test)]
mod tests;

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use serde_json::Value;
use takt_cia402::dictionary::Address;
use takt_core::Nanos;
use takt_core::device::bus::{BusAccess, BusError, BusRead};
use takt_ethercat::coe::Whole;
use takt_ethercat::master::{Job, JobKind, Master, Reply};
use takt_rt::ring::{Consumer, Producer, ring};

use super::events::SegmentEvent;
use crate::config::EthercatConfig;
use history::History;
use report::Report;

/// Questions that wait for their answer at most.
const PENDING_MAX: usize = 8;
/// Longest object that is read, bytes.
const OBJECT_MAX: usize = 1 << 16;
/// Longest register access, bytes.
const REGISTER_MAX: usize = 128;
/// Timeout of a report: many cycles.
const REPORT: Duration = Duration::from_secs(1);
/// Timeout of an answer of a slave, in addition to that of the master.
const ANSWER: Duration = Duration::from_secs(10);
/// Polling period for an answer.
const POLL: Duration = Duration::from_millis(1);
/// Marks the tokens of these jobs; others are of the devices of the segment.
const MARK: u64 = 1 << 63;

/// A question to the driver thread, and its answer.
#[derive(Debug)]
enum Letter {
    /// To be filled.
    Report(u64, Box<Report>),
    Job(Job),
    /// A job with its result.
    Done(Reply),
}

impl Letter {
    const fn token(&self) -> u64 {
        match self {
            Self::Report(token, _) => *token,
            Self::Job(job) => job.token,
            Self::Done(reply) => reply.job.token,
        }
    }
}

/// The end of the driver thread.
#[derive(Debug)]
pub(super) struct Inspector {
    from: Consumer<Letter>,
    to: Producer<Letter>,
    /// Frames lost and working counters missed so far, and when the last ones were.
    losses: [(u64, Option<Nanos>); 2],
}

impl Inspector {
    /// Answers at most one question.
    pub(super) fn cycle(&mut self, master: &mut Master, now: Nanos) {
        let missed = master.groups().iter().map(|group| group.misses).sum();
        for ((known, at), count) in self.losses.iter_mut().zip([master.frames().lost, missed]) {
            if *known != count {
                (*known, *at) = (count, Some(now));
            }
        }
        let Some(letter) = self.from.pop() else {
            return;
        };
        match letter {
            Letter::Report(token, mut report) => {
                report.fill(master, now, self.losses.map(|(_, at)| at));
                self.answer(Letter::Report(token, report));
            }
            Letter::Job(job) => self.submit(job, master),
            Letter::Done(reply) => self.answer(Letter::Done(reply)),
        }
    }

    fn submit(&mut self, job: Job, master: &mut Master) {
        if let Err(refused) = master.submit(job) {
            self.answer(Letter::Done(refused));
        }
    }

    /// Handles the reply to a job of its own; returns those of others.
    pub(super) fn handle_reply(&mut self, reply: Reply) -> Option<Reply> {
        if reply.job.token & MARK == 0 {
            return Some(reply);
        }
        self.answer(Letter::Done(reply));
        None
    }

    /// There are never more questions than the ring of answers holds.
    fn answer(&mut self, letter: Letter) {
        self.to.push(letter).ok();
    }
}

/// The end of the callers.
#[derive(Debug)]
struct Endpoint {
    to: Producer<Letter>,
    from: Consumer<Letter>,
    /// The token of the last question.
    token: u64,
    /// Questions that were not answered yet; their callers may have timed out.
    pending: usize,
}

/// Access to a segment.
#[derive(Debug)]
pub(super) struct Access {
    name: String,
    interfaces: Vec<String>,
    cycle: Duration,
    slaves: Vec<String>,
    endpoint: Mutex<Endpoint>,
    history: Mutex<History>,
}

/// Both ends of the access to a segment.
pub(super) fn pair(config: &EthercatConfig) -> (Access, Inspector) {
    let (to_driver, from) = ring(PENDING_MAX);
    let (to, from_driver) = ring(PENDING_MAX);
    let specs = super::master_config(config).slaves;
    let access = Access {
        name: config.name.clone(),
        interfaces: std::iter::once(config.interface.clone())
            .chain(config.second.clone())
            .collect(),
        cycle: config.cycle,
        slaves: specs.into_iter().map(|slave| slave.name).collect(),
        endpoint: Mutex::new(Endpoint {
            to: to_driver,
            from: from_driver,
            token: 0,
            pending: 0,
        }),
        history: Mutex::new(History::default()),
    };
    let losses = [(0, None); 2];
    (access, Inspector { from, to, losses })
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Access {
    /// Adds an event to the history.
    pub(super) fn note(&self, event: &SegmentEvent) {
        lock(&self.history).note(event);
    }

    /// Puts a question and waits for its answer.
    fn request(
        &self,
        timeout: Duration,
        letter: impl FnOnce(u64) -> Letter,
    ) -> Result<Letter, BusError> {
        let mut endpoint = lock(&self.endpoint);
        let endpoint = &mut *endpoint;
        while endpoint.from.pop().is_some() {
            endpoint.pending = endpoint.pending.saturating_sub(1);
        }
        if endpoint.pending >= PENDING_MAX {
            return Err(self.silent());
        }
        endpoint.token = (endpoint.token + 1) & !MARK;
        let token = endpoint.token | MARK;
        endpoint.to.push(letter(token)).map_err(|_| self.silent())?;
        endpoint.pending += 1;
        let begin = Instant::now();
        while begin.elapsed() < timeout {
            while let Some(answer) = endpoint.from.pop() {
                endpoint.pending = endpoint.pending.saturating_sub(1);
                // Others are late answers, whose callers timed out.
                if answer.token() == token {
                    return Ok(answer);
                }
            }
            std::thread::sleep(POLL);
        }
        Err(self.silent())
    }

    fn silent(&self) -> BusError {
        let name = &self.name;
        BusError::Failed(format!(
            "the driver of {name} does not answer\nhint: see its thread in /status/ and the log"
        ))
    }

    /// The number of a slave, given by number or name.
    fn find(&self, text: &str) -> Result<usize, BusError> {
        let named = || self.slaves.iter().position(|name| name == text);
        let found = text.parse().ok().or_else(named);
        found.ok_or_else(|| {
            let known = self.slaves.join(", ");
            BusError::NoSuch(format!(
                "{} has no slave `{text}`; it has {known}",
                self.name
            ))
        })
    }
}

impl BusAccess for Access {
    fn kind(&self) -> &'static str {
        "ethercat"
    }

    fn name(&self) -> &str {
        &self.name
    }

    fn is_at(&self, interface: &str) -> bool {
        self.interfaces.iter().any(|it| it == interface)
    }

    fn report(&self) -> Result<Value, BusError> {
        let report = Box::new(Report::with_room(self.slaves.len()));
        match self.request(REPORT, |token| Letter::Report(token, report))? {
            Letter::Report(_, report) => {
                let history = lock(&self.history);
                Ok(report.object(&self.name, &self.interfaces, self.cycle, &history))
            }
            Letter::Job(_) | Letter::Done(_) => Err(self.silent()),
        }
    }

    fn read(&self, station: &str, what: BusRead) -> Result<Vec<u8>, BusError> {
        let slave = self.find(station)?;
        let (kind, capacity) = match what {
            BusRead::Object { index, sub } => (
                JobKind::Upload {
                    address: Address::new(index, sub),
                    whole: Whole::Entry,
                },
                OBJECT_MAX,
            ),
            BusRead::Register { at, len } => (JobKind::ReadRegister { at, len }, REGISTER_MAX),
        };
        let data = Vec::with_capacity(capacity);
        let letter = |token| {
            Letter::Job(Job {
                slave,
                kind,
                data,
                token,
            })
        };
        match self.request(ANSWER, letter)? {
            Letter::Done(reply) => match reply.result {
                Ok(()) => Ok(reply.job.data),
                Err(error) => Err(BusError::Failed(format!("slave {slave}: {error}"))),
            },
            Letter::Job(_) | Letter::Report(..) => Err(self.silent()),
        }
    }
}
