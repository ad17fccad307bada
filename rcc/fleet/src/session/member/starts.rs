//! The thread of coordinated starts: it binds [`Participant`] to the network and to the nets of a [`Cell`](super::Cell). What may begin is
//! decided by the participant; when, by the net thread, which needs no message for it.
//!
//! A prepare may take several cycles, so that a thread of its own makes it: this one must publish within 100 ms that its nets run.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::time::{Duration, Instant};

use serde::Serialize;
use serde::de::DeserializeOwned;
use takt_core::Nanos;
use takt_core::tai::Tai;
use zenoh::Wait as _;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::Query;
use zenoh::sample::{Locality, Sample};

use super::commands::Refusals;
use super::shared::{Held, HeldState, QUEUE, Shared, answer, refuse, reply};
use crate::command::{self, LossPolicy, Txn, check_key, random, to_json};
use crate::keys::parts;
use crate::session::SessionError;
use crate::start::{
    Abort, Armed, BEAT_EVERY, Beat, Began, Commit, LEAD_MIN, NETS_MAX, Output, Participant,
    Prepare, Readiness, Ready, Refusal, ReleaseCause, Stage, StartReply, Status, TRANSACTIONS_MAX,
};

/// Queries of the own cell.
const STEPS: [&str; 4] = ["prepare", "commit", "abort", "status"];
/// What partners publish.
const FROM_PARTNERS: [&str; 2] = ["takt/*/start/*/armed", "takt/*/start/*/beat"];
/// Longest message.
const BYTES_MAX: usize = 16 << 10;
/// Starts that are over and still shown.
const SHOWN: usize = 16;
/// How long the thread waits for messages while no start is under way.
const IDLE: Duration = Duration::from_millis(100);

/// What the thread takes from its queue.
pub(super) enum Event {
    Query(Query),
    Sample(Sample),
    Prepared(Prepared),
}

/// The result of a prepare.
pub(super) struct Prepared {
    query: Query,
    request: Prepare,
    on_loss: LossPolicy,
    /// Until when the session permits it.
    until: Nanos,
    result: Result<Box<dyn Held>, String>,
}

/// Messages of coordinated starts.
pub(super) type Messages = (SyncSender<Event>, Receiver<Event>);

/// Declares the keys. Callbacks only pass messages on; a full queue refuses queries, and drops what partners publish every 20 ms.
pub(super) fn listen(shared: &Arc<Shared>) -> Result<Messages, SessionError> {
    let (queue, messages) = sync_channel(4 * QUEUE);
    let keys = STEPS.map(|step| shared.keys.start(step));
    answer(shared, &keys, &queue, Event::Query)?;
    let is_full = Arc::new(AtomicBool::new(false));
    for key in FROM_PARTNERS {
        let (queue, is_full) = (queue.clone(), Arc::clone(&is_full));
        let take = move |sample: Sample| {
            let sent = queue.try_send(Event::Sample(sample));
            let is_lost = matches!(sent, Err(TrySendError::Full(_)));
            if is_lost && !is_full.swap(is_lost, Ordering::AcqRel) {
                tracing::warn!(
                    "messages of coordinated starts arrive faster than they are taken; some are dropped\nhint: is the host overloaded? `takt doctor`"
                );
            }
        };
        let subscriber = shared.session.declare_subscriber(key);
        let subscriber = subscriber.allowed_origin(Locality::Remote).callback(take);
        subscriber
            .background()
            .wait()
            .map_err(SessionError::of("cannot subscribe to starts of partners"))?;
    }
    Ok((queue, messages))
}

/// Takes part in starts until the member leaves; what has not begun then is released.
pub(super) fn serve(shared: &Arc<Shared>, (queue, messages): Messages) {
    let name = shared.keys.cell().as_str();
    let clock = shared.cell.clock_id();
    let mut starts = Starts {
        participant: Participant::new(name, shared.boot, &clock, random()),
        shared,
        queue,
        preparing: BTreeSet::new(),
        held: BTreeMap::new(),
        over: VecDeque::new(),
        refusals: Refusals::default(),
        is_failing: false,
    };
    let mut next_beat = Instant::now();
    while !shared.ends() {
        match messages.recv_timeout(starts.wait(next_beat)) {
            Ok(Event::Query(query)) => starts.handle(&query),
            Ok(Event::Sample(sample)) => starts.take(&sample),
            Ok(Event::Prepared(prepared)) => starts.finish(prepared),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => break,
        }
        if starts.held.is_empty() && !starts.has_to_publish() {
            continue;
        }
        starts.poll();
        if Instant::now() >= next_beat {
            starts.publish();
            next_beat = Instant::now() + BEAT_EVERY;
        }
    }
}

/// Nets that are kept or run.
struct Kept {
    nets: Box<dyn Held>,
    session: u32,
    on_loss: LossPolicy,
    status: Status,
}

struct Starts<'a> {
    shared: &'a Arc<Shared>,
    queue: SyncSender<Event>,
    participant: Participant,
    preparing: BTreeSet<Txn>,
    held: BTreeMap<Txn, Kept>,
    over: VecDeque<Status>,
    refusals: Refusals,
    /// Whether the network takes nothing, which was reported.
    is_failing: bool,
}

impl Starts<'_> {
    fn wait(&self, next_beat: Instant) -> Duration {
        if self.held.is_empty() && !self.has_to_publish() {
            return IDLE;
        }
        let now = self.shared.cell.now();
        let due = self
            .participant
            .poll_timeout()
            .map(|due| (due - now).0.max(0));
        let due = due
            .and_then(|due| u64::try_from(due).ok())
            .map(Duration::from_nanos);
        let beat = next_beat.saturating_duration_since(Instant::now());
        due.unwrap_or(IDLE).min(beat)
    }

    fn has_to_publish(&self) -> bool {
        !self.participant.beats().is_empty()
    }

    fn name(&self) -> String {
        self.shared.keys.cell().to_string()
    }

    fn handle(&mut self, query: &Query) {
        let own = STEPS.map(|step| self.shared.keys.start(step));
        let asked = query.key_expr().as_str();
        let Some(own) = own.iter().find(|own| *own == asked) else {
            // It reaches several cells, or several steps.
            let cell = self.shared.keys.start("prepare");
            return self.refuse(query, &cell, Refusal::OtherKey { own: cell.clone() });
        };
        let said = match asked.rsplit('/').next() {
            Some("prepare") => match self.begin_prepare(query) {
                Ok(()) => return,
                Err(why) => Err(why),
            },
            Some("commit") => self.commit(query),
            Some("abort") => self.abort(query),
            _ => Ok(StartReply::Status {
                starts: self.statuses(),
            }),
        };
        match said {
            Ok(said) => reply(query, own, to_json(&said)),
            Err(why) => self.refuse(query, own, why),
        }
    }

    fn refuse(&mut self, query: &Query, own: &str, reason: Refusal) {
        self.refusals.note(&reason, Instant::now());
        let text = reason.to_string();
        let said = to_json(&StartReply::Refused { reason, text });
        if query.key_expr().as_str() == own {
            reply(query, own, said);
        } else {
            refuse(query, &said);
        }
    }

    /// Starts a thread that keeps the nets of a prepare.
    fn begin_prepare(&mut self, query: &Query) -> Result<(), Refusal> {
        let request: Prepare = self.read(query, "prepare")?;
        let now = self.shared.cell.now();
        let (session, txn) = (request.session, request.txn);
        let (permission, on_loss) = {
            let mut admission = self.shared.admission();
            let permission = admission.check(request.boot, session, request.nonce, now);
            (
                permission,
                admission.on_loss(session, now).unwrap_or_default(),
            )
        };
        let cell = self.name();
        let until = permission.map_err(|why| {
            if why == command::Refusal::OtherBoot {
                return Refusal::OtherBoot;
            }
            let cell = cell.clone();
            Refusal::Session { cell, why }
        })?;
        if !(1..=NETS_MAX).contains(&request.nets.len()) {
            let why = format!("a start has 1 to {NETS_MAX} nets of a cell");
            return Err(Refusal::Nets { cell, why });
        }
        if self.participant.knows(txn) {
            // The machine repeats its reply, or refuses: it looks at no net then.
            let readiness = self.readiness(Nanos::MAX);
            let ready = self.participant.prepare(&request, &readiness, now)?;
            reply(
                query,
                &self.shared.keys.start("prepare"),
                to_json(&StartReply::Ready(ready)),
            );
            return Ok(());
        }
        if self.preparing.contains(&txn) {
            return Err(Refusal::Busy { cell });
        }
        if self.preparing.len() + self.held.len() >= TRANSACTIONS_MAX {
            let bound = TRANSACTIONS_MAX;
            return Err(Refusal::TooMany { cell, bound });
        }
        let (shared, queue, query) = (Arc::clone(self.shared), self.queue.clone(), query.clone());
        let thread = std::thread::Builder::new().name("fleet-prepare".to_owned());
        let started = thread.spawn(move || {
            let result = shared.cell.prepare_start(&request.nets);
            // If this thread has ended, dropping it releases the nets.
            let _ = queue.send(Event::Prepared(Prepared {
                query,
                request,
                on_loss,
                until,
                result,
            }));
        });
        if let Err(why) = started {
            let why = format!("no thread to prepare the nets: {why}");
            return Err(Refusal::Nets { cell, why });
        }
        self.preparing.insert(txn);
        Ok(())
    }

    fn readiness(&self, period: Nanos) -> Readiness {
        Readiness {
            tai: self.shared.cell.tai(),
            period,
            lead: LEAD_MIN,
        }
    }

    /// The nets of a prepare are kept, or cannot be.
    fn finish(&mut self, prepared: Prepared) {
        self.preparing.remove(&prepared.request.txn);
        let own = self.shared.keys.start("prepare");
        let query = prepared.query.clone();
        match self.take_part(prepared) {
            Ok(ready) => reply(&query, &own, to_json(&StartReply::Ready(ready))),
            Err(why) => self.refuse(&query, &own, why),
        }
    }

    fn take_part(&mut self, prepared: Prepared) -> Result<Ready, Refusal> {
        let Prepared {
            request,
            on_loss,
            until,
            result,
            ..
        } = prepared;
        let now = self.shared.cell.now();
        let cell = self.name();
        if now > until {
            let late_ns = (now - until).0;
            let why = command::Refusal::Late { late_ns };
            return Err(Refusal::Session { cell, why });
        }
        let nets = result.map_err(|why| Refusal::Nets { cell, why })?;
        let readiness = self.readiness(nets.period());
        let ready = self.participant.prepare(&request, &readiness, now)?;
        let Prepare {
            txn,
            session,
            nets: names,
            ..
        } = request;
        let status = Status {
            txn,
            stage: Stage::Prepared,
            why: None,
            nets: names,
            start_tai_ns: None,
            began: None,
            lost: Vec::new(),
        };
        self.held.insert(
            txn,
            Kept {
                nets,
                session,
                on_loss,
                status,
            },
        );
        Ok(ready)
    }

    fn commit(&mut self, query: &Query) -> Result<StartReply, Refusal> {
        let commit: Commit = self.read(query, "commit")?;
        let (tai, now) = (self.shared.cell.tai(), self.shared.cell.now());
        let armed = self.participant.commit(&commit, &tai, now)?;
        if let Some(kept) = self.held.get_mut(&commit.txn) {
            kept.status.stage = Stage::Committed;
            kept.status.start_tai_ns = Some(commit.start_tai_ns);
        }
        self.put(armed.txn, "armed", &armed);
        Ok(StartReply::Armed(armed))
    }

    fn abort(&mut self, query: &Query) -> Result<StartReply, Refusal> {
        let Abort { txn, boot } = self.read(query, "abort")?;
        if boot != self.shared.boot {
            return Err(Refusal::OtherBoot);
        }
        let output = self.participant.abort(txn);
        let released = output.is_some();
        if let Some(output) = output {
            self.apply(output);
        }
        Ok(StartReply::Aborted { released })
    }

    fn read<M: DeserializeOwned>(&self, query: &Query, step: &str) -> Result<M, Refusal> {
        let own = self.shared.keys.start(step);
        let payload = query.payload().map(|payload| payload.to_bytes());
        let payload = payload.as_deref().unwrap_or_default();
        let asked = command::Query {
            key: query.key_expr().as_str(),
            parameters: query.parameters().as_str(),
            payload,
        };
        check_key(&asked, &own).map_err(|_| Refusal::OtherKey { own })?;
        decode(payload).map_err(|why| Refusal::Malformed { why })
    }

    /// Takes what a partner has published; what is not for exactly a start of this cell has no effect.
    fn take(&mut self, sample: &Sample) {
        let key = sample.key_expr().as_str();
        let Some((cell, rest)) = parts(key) else {
            return;
        };
        let payload = sample.payload().to_bytes();
        match rest.rsplit('/').next() {
            Some("armed") => {
                let armed = decode::<Armed>(&payload).ok();
                if let Some(armed) = armed.filter(|it| it.cell == cell) {
                    self.participant.armed(&armed);
                }
            }
            Some("beat") => {
                let beat = decode::<Beat>(&payload).ok();
                if let Some(beat) = beat.filter(|it| it.cell == cell) {
                    self.participant.beat(&beat, self.shared.cell.now());
                }
            }
            Some(_) | None => {}
        }
    }

    fn statuses(&self) -> Vec<Status> {
        let held = self.held.values().map(|kept| &kept.status);
        self.over.iter().chain(held).cloned().collect()
    }

    /// Does what is due, and looks at the nets.
    fn poll(&mut self) {
        let tai = self.shared.cell.tai();
        let now = self.shared.cell.now();
        while let Some(output) = self.participant.poll(&tai, now) {
            self.apply(output);
        }
        let all: Vec<Txn> = self.held.keys().copied().collect();
        for txn in all {
            self.look_at(txn, &tai, now);
        }
    }

    fn apply(&mut self, output: Output) {
        match output {
            Output::Begin { txn, at } => {
                if let Some(kept) = self.held.get_mut(&txn) {
                    kept.nets.begin_at(at);
                    kept.status.stage = Stage::Begins;
                }
            }
            Output::Release { txn, cause } => {
                let why = cause.to_string();
                if cause == ReleaseCause::Aborted {
                    tracing::info!("coordinated start {txn} is released: {why}");
                } else {
                    tracing::warn!(
                        "coordinated start {txn} is released, no net of it begins: {why}"
                    );
                }
                self.close(txn, Stage::Failed, Some(why));
            }
            Output::PartnerLost { txn, cell } => {
                let Some(kept) = self.held.get_mut(&txn) else {
                    return;
                };
                let effect = match kept.on_loss {
                    LossPolicy::Continue => "the nets run on",
                    LossPolicy::Cancel => "the nets are cancelled",
                    LossPolicy::Stop => "the nets are aborted",
                };
                tracing::warn!(
                    "cell {cell} of coordinated start {txn} is lost, as it did not begin, ended by a fault or cannot be reached: {effect}"
                );
                kept.status.lost.push(cell);
                kept.nets.lose_partner(kept.on_loss);
            }
        }
    }

    /// Looks how far the nets of a start are.
    fn look_at(&mut self, txn: Txn, tai: &Tai, now: Nanos) {
        let Some(kept) = self.held.get_mut(&txn) else {
            return;
        };
        let is_waiting = matches!(kept.status.stage, Stage::Prepared | Stage::Committed);
        let session = kept.session;
        if is_waiting && self.shared.admission().on_loss(session, now).is_none() {
            tracing::warn!(
                "coordinated start {txn} is released, since the session that prepared it has ended"
            );
            let _ = self.participant.abort(txn);
            let why = "the session that prepared it has ended".to_owned();
            return self.close(txn, Stage::Failed, Some(why));
        }
        match kept.nets.state() {
            HeldState::Waiting => {}
            HeldState::Failed(why) => {
                tracing::warn!("coordinated start {txn}: no net of it begins: {why}");
                self.participant.ended(txn);
                self.close(txn, Stage::Failed, Some(why));
            }
            HeldState::Running {
                cycle,
                begin,
                woken,
                end,
            } => {
                let period_ns = kept.nets.period().0;
                kept.status.stage = Stage::Running;
                kept.status.began.get_or_insert_with(|| Began {
                    cycle,
                    begin_tai_ns: tai.tai(begin).0,
                    woken_tai_ns: tai.tai(woken).0,
                    period_ns,
                });
                match end {
                    None => {}
                    Some(Ok(())) => {
                        self.participant.over(txn, now);
                        self.close(txn, Stage::Over, None);
                    }
                    Some(Err(why)) => {
                        self.participant.ended(txn);
                        self.close(txn, Stage::Failed, Some(why));
                    }
                }
            }
        }
    }

    /// Keeps the nets of a start no longer.
    fn close(&mut self, txn: Txn, stage: Stage, why: Option<String>) {
        let Some(Kept { mut status, .. }) = self.held.remove(&txn) else {
            return;
        };
        (status.stage, status.why) = (stage, why);
        self.over.push_back(status);
        if self.over.len() > SHOWN {
            self.over.pop_front();
        }
    }

    /// Publishes the arms and beats of this cell.
    fn publish(&mut self) {
        for armed in self.participant.arms() {
            self.put(armed.txn, "armed", &armed);
        }
        for beat in self.participant.beats() {
            self.put(beat.txn, "beat", &beat);
        }
    }

    fn put(&mut self, txn: Txn, what: &str, message: &impl Serialize) {
        let key = self.shared.keys.of(&format!("start/{txn}/{what}"));
        let put = self.shared.session.put(key, to_json(message));
        // A link that takes nothing must not hold up this thread.
        let put = put.congestion_control(CongestionControl::Drop);
        let done = put.priority(Priority::InteractiveHigh).express(true).wait();
        let did = std::mem::replace(&mut self.is_failing, done.is_err());
        if let Err(why) = done
            && !did
        {
            tracing::warn!("partners of a coordinated start receive nothing from this cell: {why}");
        }
    }
}

fn decode<M: DeserializeOwned>(payload: &[u8]) -> Result<M, String> {
    if payload.len() > BYTES_MAX {
        let found = payload.len();
        return Err(format!(
            "it has {found} bytes; at most {BYTES_MAX} are accepted"
        ));
    }
    serde_json::from_slice(payload).map_err(|why| why.to_string())
}
