//! A program that wants nets of several cells to begin at one instant: this binds [`Initiator`] to the network, and reads afterwards how it went. The
//! nets were loaded by sessions of commands, whose permission and policy count.

use std::sync::mpsc::{Sender, channel};
use std::time::{Duration, Instant};

use takt_core::Nanos;
use zenoh::Wait as _;

use super::SessionError;
use super::observer::{Fleet, FleetError};
use super::remote::Remote;
use crate::command::{Boot, Txn, random, to_json};
use crate::keys::{CellKeys, CellName};
use crate::start::{Abort, Goal, Initiator, Member, Outcome, Ready, Refusal, StartReply, Status};

/// How long a reply may take; the initiator gives up long before.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(2);
/// How often the initiator looks at its timeouts.
const TICK: Duration = Duration::from_millis(5);

/// Why nets do not begin together.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[expect(missing_docs, reason = "each field is named in its variant's text")]
pub enum TogetherError {
    #[error(transparent)]
    Session(#[from] SessionError),
    #[error(transparent)]
    Fleet(#[from] FleetError),
    /// It says of itself nothing that a start needs.
    #[error("{cell} was restarted since its session was opened\nhint: start again")]
    Restarted { cell: String },
    #[error("nothing begins: {why}")]
    Refused { cell: String, why: Refusal },
    #[error(
        "nothing begins: {cell} did not answer in time\nhint: it gives this link no right `start` in [[fleet.allow]] of its cell file, or \
         its host or the network is slow"
    )]
    Silent { cell: String },
    #[error("nothing begins: {0}")]
    Mismatch(String),
}

/// A start to which all have committed. Each begins if the arms of all reach it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Together {
    /// Its number.
    pub txn: Txn,
    /// The instant, TAI, ns.
    pub start_tai_ns: i64,
    members: Vec<(CellName, Boot)>,
}

enum Said {
    Prepared(usize, Result<StartReply, String>),
    Committed(usize, Result<StartReply, String>),
}

/// Lets nets of several cells begin at one instant, at least `lead` ahead. `parts` are open sessions at the cells, with the nets of each.
///
/// # Errors
/// If one refuses, does not answer, or they do not fit together: all were asked to abort then, and nothing begins.
pub fn start(
    fleet: &Fleet,
    parts: &[(&Remote, Vec<String>)],
    lead: Duration,
) -> Result<Together, TogetherError> {
    let members: Vec<Member> = parts
        .iter()
        .map(|(remote, nets)| member(fleet, remote, nets))
        .collect::<Result<_, _>>()?;
    let keys: Vec<CellKeys> = parts
        .iter()
        .map(|(remote, _)| CellKeys::new(remote.cell().clone()))
        .collect();
    let boots: Vec<Boot> = members.iter().map(|it| it.boot).collect();
    let txn = Txn(random()());
    let lead = Nanos(i64::try_from(lead.as_nanos()).unwrap_or(i64::MAX));
    let mut initiator = Initiator::new(txn, members, lead, takt_core::monotonic());
    let (sender, said) = channel();
    loop {
        while let Some(goal) = initiator.poll(takt_core::monotonic()) {
            match goal {
                Goal::Prepare(at, prepare) => {
                    let of = move |said| Said::Prepared(at, said);
                    ask(
                        fleet,
                        &keys[at].start("prepare"),
                        &to_json(&prepare),
                        &sender,
                        of,
                    )?;
                }
                Goal::Commit(at, commit) => {
                    let of = move |said| Said::Committed(at, said);
                    ask(
                        fleet,
                        &keys[at].start("commit"),
                        &to_json(&commit),
                        &sender,
                        of,
                    )?;
                }
                Goal::Abort(at) => {
                    let boot = boots[at];
                    let abort = to_json(&Abort { txn, boot });
                    let get = fleet.session().get(keys[at].start("abort")).payload(abort);
                    // What is not released by it expires by itself.
                    get.timeout(ANSWER_TIMEOUT)
                        .wait()
                        .map_err(SessionError::of("cannot send an abort"))?;
                }
                Goal::Finished(outcome) => {
                    let members = parts.iter().map(|(it, _)| it.cell().clone()).zip(boots);
                    return finished(outcome, txn, members.collect());
                }
            }
        }
        let now = takt_core::monotonic;
        match said.recv_timeout(TICK) {
            Ok(Said::Prepared(at, reply)) => {
                initiator.handle_ready(at, ready_of(keys[at].cell(), reply), now());
            }
            Ok(Said::Committed(at, reply)) => {
                initiator.handle_armed(at, armed_of(keys[at].cell(), reply));
            }
            Err(_) => {}
        }
    }
}

/// What a cell says of itself.
fn member(fleet: &Fleet, remote: &Remote, nets: &[String]) -> Result<Member, TogetherError> {
    let cell = remote.cell();
    let key = CellKeys::new(cell.clone()).info();
    let answers = fleet.ask(&key, ANSWER_TIMEOUT)?;
    let info = answers.into_iter().find_map(|answer| answer.result.ok());
    let Some(info) = info else {
        return Err(FleetError::NoAnswer {
            cell: cell.to_string(),
            waited: ANSWER_TIMEOUT,
        }
        .into());
    };
    if info["boot"] != remote.boot().to_string() {
        let cell = cell.to_string();
        return Err(TogetherError::Restarted { cell });
    }
    let (session, nonce) = remote.permission();
    Ok(Member {
        cell: cell.to_string(),
        boot: remote.boot(),
        clock: info["clock"].as_str().unwrap_or_default().to_owned(),
        session,
        nonce,
        nets: nets.to_vec(),
    })
}

/// Sends a query whose replies are passed to a channel.
fn ask(
    fleet: &Fleet,
    key: &str,
    payload: &str,
    to: &Sender<Said>,
    of: impl Fn(Result<StartReply, String>) -> Said + Send + Sync + 'static,
) -> Result<(), SessionError> {
    let to = to.clone();
    let take = move |reply: zenoh::query::Reply| {
        let said = match reply.result() {
            Ok(sample) => serde_json::from_slice(&sample.payload().to_bytes())
                .map_err(|why| format!("an answer in another form: {why}")),
            Err(error) => {
                let text = error.payload().to_bytes();
                if *text == *b"Timeout" {
                    // The initiator notices the silence itself.
                    return;
                }
                Err(String::from_utf8_lossy(&text).into_owned())
            }
        };
        // Of an initiator that is over, no reply matters.
        let _ = to.send(of(said));
    };
    let get = fleet
        .session()
        .get(key)
        .payload(payload)
        .timeout(ANSWER_TIMEOUT);
    let sent = get.callback(take).wait();
    sent.map_err(SessionError::of("cannot send a request"))
}

fn reply_of(cell: &CellName, reply: Result<StartReply, String>) -> Result<StartReply, Refusal> {
    match reply {
        Ok(StartReply::Refused { reason, .. }) => Err(reason),
        Ok(reply) => Ok(reply),
        Err(why) => Err(Refusal::Nets {
            cell: cell.to_string(),
            why,
        }),
    }
}

fn ready_of(cell: &CellName, reply: Result<StartReply, String>) -> Result<Ready, Refusal> {
    match reply_of(cell, reply)? {
        StartReply::Ready(ready) => Ok(ready),
        other @ (StartReply::Armed(_)
        | StartReply::Aborted { .. }
        | StartReply::Status { .. }
        | StartReply::Refused { .. }) => Err(unexpected(cell, &other)),
    }
}

fn armed_of(cell: &CellName, reply: Result<StartReply, String>) -> Result<(), Refusal> {
    match reply_of(cell, reply)? {
        StartReply::Armed(_) => Ok(()),
        other @ (StartReply::Ready(_)
        | StartReply::Aborted { .. }
        | StartReply::Status { .. }
        | StartReply::Refused { .. }) => Err(unexpected(cell, &other)),
    }
}

fn unexpected(cell: &CellName, reply: &StartReply) -> Refusal {
    Refusal::Nets {
        cell: cell.to_string(),
        why: format!("an answer to another request: {}", to_json(reply)),
    }
}

fn finished(
    outcome: Outcome,
    txn: Txn,
    members: Vec<(CellName, Boot)>,
) -> Result<Together, TogetherError> {
    match outcome {
        Outcome::Armed { start_tai_ns } => Ok(Together {
            txn,
            start_tai_ns,
            members,
        }),
        Outcome::Refused { cell, why } => Err(TogetherError::Refused { cell, why }),
        Outcome::Silent { cell } => Err(TogetherError::Silent { cell }),
        Outcome::Mismatch { text } => Err(TogetherError::Mismatch(text)),
    }
}

impl Together {
    /// How far it is at each cell; `None` for one that does not answer, or knows nothing of it (any more).
    ///
    /// # Errors
    /// If zenoh refuses the query.
    pub fn statuses(&self, fleet: &Fleet) -> Result<Vec<(CellName, Option<Status>)>, FleetError> {
        let mut all = Vec::new();
        for (cell, _) in &self.members {
            let key = CellKeys::new(cell.clone()).start("status");
            let answers = fleet.ask(&key, ANSWER_TIMEOUT)?;
            let status = answers.into_iter().find_map(|answer| {
                let reply = serde_json::from_value(answer.result.ok()?).ok()?;
                let StartReply::Status { starts } = reply else {
                    return None;
                };
                starts.into_iter().find(|it| it.txn == self.txn)
            });
            all.push((cell.clone(), status));
        }
        Ok(all)
    }

    /// Waits until it has begun, or has failed, everywhere; returns how it is then.
    ///
    /// # Errors
    /// If zenoh refuses the query.
    pub fn begun(
        &self,
        fleet: &Fleet,
        timeout: Duration,
    ) -> Result<Vec<(CellName, Option<Status>)>, FleetError> {
        let until = Instant::now() + timeout;
        loop {
            let all = self.statuses(fleet)?;
            let is_decided = |status: &Option<Status>| {
                let status = status.as_ref();
                status.is_some_and(|it| it.began.is_some() || it.why.is_some())
            };
            if all.iter().all(|(_, status)| is_decided(status)) || Instant::now() >= until {
                return Ok(all);
            }
            std::thread::sleep(TICK);
        }
    }
}
