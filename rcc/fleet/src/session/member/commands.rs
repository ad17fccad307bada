//! The thread that admits commands, and one for each session that executes them. What may be executed is decided by [`Admission`],
//! not here.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, TrySendError, channel};
use std::time::{Duration, Instant};

use serde::Serialize;
use takt_core::Nanos;
use zenoh::Wait as _;
use zenoh::liveliness::LivelinessToken;
use zenoh::query::Query as Sent;

use super::notified::{self, Asked};
use super::shared::{Shared, TOO_MANY, refuse, reply};
use crate::command::{Answer, LossPolicy, Lost, Query, Reply, to_json};

/// Longest wait for a query, after which losses of sessions are looked for.
const WAIT_MAX: Duration = Duration::from_millis(20);

/// Refusals of one kind are logged again after a pause of this length only.
const REFUSALS_PAUSE: Duration = Duration::from_secs(10);

const NO_THREAD: &str =
    "the controller has no thread for this session\nhint: close the session and open another";

/// What the thread that admits commands takes from its queue.
pub(super) enum Event {
    /// A query from the network.
    Query(Sent),
    /// A command was executed.
    Done(Done),
}

/// A command that was executed, with its reply lines.
pub(super) struct Done {
    session: u32,
    seq: u64,
    lines: Vec<String>,
    sent: Sent,
}

/// A command to be executed.
struct Job {
    seq: u64,
    line: String,
    until: Nanos,
    sent: Sent,
}

/// An open session.
struct Open {
    /// To its thread, which ends when this is dropped.
    jobs: Sender<Job>,
    /// To the thread that answers what it was notified of; `None` if the host has none left.
    notified: Option<SyncSender<Asked>>,
    _token: Option<LivelinessToken>,
}

/// Takes commands until the member leaves; then all sessions are lost.
pub(super) fn serve(shared: &Arc<Shared>, (queue, events): (SyncSender<Event>, Receiver<Event>)) {
    let mut commands = Commands {
        shared,
        queue,
        open: BTreeMap::new(),
        refusals: Refusals::default(),
    };
    while !shared.ends() {
        match events.recv_timeout(WAIT_MAX) {
            Ok(Event::Query(query)) => commands.handle(query),
            Ok(Event::Done(done)) => commands.finish(done),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => break,
        }
        commands.lose(shared.cell.now());
    }
    commands.lose(Nanos(i64::MAX));
}

struct Commands<'a> {
    shared: &'a Arc<Shared>,
    queue: SyncSender<Event>,
    open: BTreeMap<u32, Open>,
    refusals: Refusals,
}

impl Commands<'_> {
    fn lose(&mut self, now: Nanos) {
        loop {
            let lost = self.shared.admission().poll(now);
            let Some(lost) = lost else {
                return;
            };
            let Lost { session, on_loss } = lost;
            let nets = match on_loss {
                LossPolicy::Continue => "its nets run on",
                LossPolicy::Cancel => "its nets are cancelled",
                LossPolicy::Stop => "its nets are aborted",
            };
            tracing::warn!(
                "session {session} of the fleet is lost, since no keep-alive arrived in time: {nets}"
            );
            self.open.remove(&session);
            self.shared.cell.lost(lost);
        }
    }

    fn handle(&mut self, sent: Sent) {
        let now = self.shared.cell.now();
        let payload = sent.payload().map(|payload| payload.to_bytes());
        let query = Query {
            key: sent.key_expr().as_str(),
            parameters: sent.parameters().as_str(),
            payload: payload.as_deref().unwrap_or_default(),
        };
        // The key of the queryable that got it is not known here: what is not exactly the one is checked as the other.
        let answer = if query.key == self.shared.keys.cmd_session() {
            self.shared.admission().handle_session(&query, now)
        } else {
            self.shared.admission().handle_query(&query, now)
        };
        drop(payload);
        match answer {
            Answer::Reply(said) => self.answer(&sent, &said),
            Answer::Opened {
                session,
                client,
                on_loss,
                reply,
            } => {
                self.shared.cell.opened(session, &client, on_loss);
                self.begin(session);
                self.answer(&sent, &reply);
            }
            Answer::Closed { session, reply } => {
                self.open.remove(&session);
                self.shared.cell.closed(session);
                self.answer(&sent, &reply);
            }
            Answer::Notify { session, from } => self.notify(session, Asked { from, sent }),
            Answer::Execute {
                session,
                seq,
                line,
                until,
            } => self.execute(
                session,
                Job {
                    seq,
                    line,
                    until,
                    sent,
                },
            ),
        }
    }

    /// Passes a request for notifications to the thread of its session.
    fn notify(&self, session: u32, asked: Asked) {
        let open = self.open.get(&session);
        let Some(notified) = open.and_then(|open| open.notified.as_ref()) else {
            return refuse(&asked.sent, NO_THREAD);
        };
        match notified.try_send(asked) {
            Ok(()) => {}
            Err(TrySendError::Full(asked)) => refuse(&asked.sent, TOO_MANY),
            Err(TrySendError::Disconnected(asked)) => refuse(&asked.sent, NO_THREAD),
        }
    }

    /// Starts the threads of a session and shows it to the fleet.
    fn begin(&mut self, session: u32) {
        let (jobs, from_jobs) = channel::<Job>();
        let (shared, queue) = (Arc::clone(self.shared), self.queue.clone());
        let thread = std::thread::Builder::new().name(format!("fleet-s{session}"));
        let started = thread.spawn(move || {
            while let Ok(job) = from_jobs.recv() {
                let lines = execute(&shared, session, &job);
                let Job { seq, sent, .. } = job;
                let done = Done {
                    session,
                    seq,
                    lines,
                    sent,
                };
                if queue.send(Event::Done(done)).is_err() {
                    return;
                }
            }
        });
        if let Err(why) = started {
            tracing::error!("no thread for session {session} of the fleet: {why}");
        }
        let notified = notified::start(self.shared, session);
        if let Err(why) = &notified {
            tracing::error!("no thread for notifications of session {session} of the fleet: {why}");
        }
        let key = self.shared.keys.session_alive(&session.to_string());
        let token = self.shared.session.liveliness().declare_token(key).wait();
        if let Err(why) = &token {
            tracing::warn!("session {session} of the fleet is not shown as alive: {why}");
        }
        let _token = token.ok();
        let notified = notified.ok();
        let open = Open {
            jobs,
            notified,
            _token,
        };
        self.open.insert(session, open);
    }

    fn execute(&mut self, session: u32, job: Job) {
        let Some(open) = self.open.get(&session) else {
            let why = "the session ended before the command";
            return refuse(&job.sent, why);
        };
        if let Err(unsent) = open.jobs.send(job) {
            let Job { seq, sent, .. } = unsent.0;
            let why = "error: the controller has no thread for this session, the command was not begun\nhint: close the session and open another";
            self.finish(Done {
                session,
                seq,
                lines: vec![why.to_owned()],
                sent,
            });
        }
    }

    fn finish(&mut self, done: Done) {
        let said = self
            .shared
            .admission()
            .finish(done.session, done.seq, done.lines);
        match said {
            Some(said) => self.answer(&done.sent, &said),
            None => refuse(&done.sent, "the session ended while the command ran"),
        }
    }

    /// Replies, or refuses: a reply may only be to a key that the query includes.
    fn answer(&mut self, sent: &Sent, said: &Reply) {
        if let Reply::Refused { reason, .. } = said {
            self.refusals.note(reason, Instant::now());
        }
        let asked = sent.key_expr().as_str();
        let keys = [
            self.shared.keys.cmd_session(),
            self.shared.keys.cmd_directio(),
        ];
        match keys.iter().find(|key| *key == asked) {
            Some(own) => reply(sent, own, to_json(said)),
            None => refuse(sent, &to_json(said)),
        }
    }
}

fn execute(shared: &Shared, session: u32, job: &Job) -> Vec<String> {
    if shared.cell.now() > job.until {
        vec!["error: too late, the command was not begun".to_owned()]
    } else {
        shared.cell.execute(session, &job.line)
    }
}

/// Reports refusals at their onset, by kind.
#[derive(Debug, Default)]
pub(super) struct Refusals(BTreeMap<String, Instant>);

impl Refusals {
    /// Logs a refusal unless one of its kind was there shortly before. Returns whether it did.
    pub(super) fn note(&mut self, reason: &(impl Serialize + fmt::Display), now: Instant) -> bool {
        let kind = serde_json::to_value(reason).unwrap_or_default();
        let kind = kind["code"].as_str().unwrap_or_default().to_owned();
        let before = self.0.insert(kind, now);
        let is_onset = before.is_none_or(|before| now.duration_since(before) > REFUSALS_PAUSE);
        if is_onset {
            tracing::warn!("a query of the fleet is refused and changes nothing: {reason}");
        }
        is_onset
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::command::Refusal;

    #[test]
    fn refusals_of_a_kind_are_logged_at_onset() {
        let mut refusals = Refusals::default();
        let begin = Instant::now();
        let at = |seconds| begin + Duration::from_secs(seconds);
        let late = |late_ns| Refusal::Late { late_ns };
        assert!(refusals.note(&late(1), at(0)));
        assert!(!refusals.note(&late(2), at(9)));
        assert!(refusals.note(&Refusal::Wildcard, at(9)));
        assert!(!refusals.note(&late(3), at(18)));
        assert!(refusals.note(&late(3), at(40)));
    }
}
