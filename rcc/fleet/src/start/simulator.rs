//! Cells, their clocks and a bad network in virtual time, by seed: what must never happen in a coordinated start is looked for in
//! thousands of histories. It knows the messages only by their types.

use std::collections::{BTreeMap, BTreeSet};

use takt_core::Nanos;
use takt_core::tai::{FreeCause, Tai, TaiState};

use super::participant::{Output, Participant, Readiness};
use super::{
    Armed, BEAT_EVERY, Beat, Commit, Goal, Initiator, Member, Outcome, Prepare, Ready, Refusal,
};
use crate::command::{Boot, Nonce, Txn};

/// Step of virtual time.
const STEP: Nanos = Nanos::from_millis(2);
/// Length of a history.
const LENGTH: Nanos = Nanos::from_millis(4_000);
/// Largest error of a clock that is not stepped, below a quarter of the period.
const CLOCK_ERROR: i64 = 200_000;
/// Periods of the cells, ns.
const PERIODS: [i64; 3] = [1_000_000, 2_000_000, 4_000_000];

/// A generator of numbers (splitmix64).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn below(&mut self, bound: u64) -> u64 {
        self.next() % bound.max(1)
    }

    fn within(&mut self, bound: i64) -> i64 {
        i64::try_from(self.below(2 * bound.unsigned_abs() + 1)).unwrap() - bound
    }

    fn chance(&mut self, percent: u64) -> bool {
        self.below(100) < percent
    }
}

/// How bad the network and the hosts are, in percent.
#[derive(Clone, Copy, Debug)]
pub(super) struct Weather {
    pub(super) loss: u64,
    pub(super) repeat: u64,
    /// Longest delay, ms; some messages take ten times as long.
    pub(super) delay_ms: u64,
    /// A cell restarts in the course of a history.
    pub(super) reboot: u64,
    /// A clock is stepped in the course of a history.
    pub(super) step: u64,
    /// The network splits for a while.
    pub(super) split: u64,
}

#[derive(Clone, Debug)]
enum Message {
    Prepare(Prepare),
    Commit(Commit),
    Abort,
    Ready(Result<Ready, Refusal>),
    Committed(Result<(), Refusal>),
    Armed(Armed),
    Beat(Beat),
}

/// A message on its way; the initiator has the number of its attempt, so that replies of an earlier one are recognised.
struct Sent {
    at: Nanos,
    to: usize,
    from: usize,
    attempt: u32,
    message: Message,
}

struct Cell {
    participant: Participant,
    boot: Boot,
    period: Nanos,
    /// `CLOCK_MONOTONIC` minus true time; TAI minus true time.
    monotonic: i64,
    error: i64,
    is_free_until: Nanos,
    begins: Vec<(Txn, Boot)>,
    lost: BTreeSet<usize>,
}

/// What must never happen, and did.
#[derive(Debug, Default)]
pub(super) struct Report {
    pub(super) violations: Vec<String>,
    /// Histories of starts: all, some and no cells began.
    pub(super) all: u32,
    pub(super) some: u32,
    pub(super) none: u32,
}

pub(super) struct World {
    random: Random,
    weather: Weather,
    now: Nanos,
    cells: Vec<Cell>,
    sent: Vec<Sent>,
    txn: Txn,
    initiator: Option<Initiator>,
    attempt: u32,
    next_attempt: Nanos,
    /// Arms that were published: by cell, instant and permissions.
    armed: BTreeSet<(usize, i64, Vec<Nonce>)>,
    /// Permissions of the present run of each cell.
    given: BTreeMap<usize, BTreeSet<Nonce>>,
    /// Instant and permissions to which each cell has committed last, and the error of its clock then.
    committed: BTreeMap<usize, (i64, Vec<Nonce>, i64)>,
    split: Option<(usize, Nanos, Nanos)>,
    report: Report,
}

impl World {
    pub(super) fn new(seed: u64, weather: Weather, ignores_arms: bool) -> Self {
        let mut random = Random(seed);
        let count = 2 + usize::try_from(random.below(3)).unwrap();
        let cells = (0..count).map(|at| {
            let boot = Boot(u128::from(random.next()));
            let period = PERIODS[usize::try_from(random.below(3)).unwrap()];
            Cell {
                participant: participant(at, boot, random.next(), ignores_arms),
                boot,
                period: Nanos(period),
                monotonic: random.within(1_000_000_000_000),
                error: random.within(CLOCK_ERROR),
                is_free_until: Nanos::ZERO,
                begins: Vec::new(),
                lost: BTreeSet::new(),
            }
        });
        let cells: Vec<Cell> = cells.collect();
        let split = random.chance(weather.split).then(|| {
            let begin = Nanos::from_millis(i64::try_from(random.below(2_000)).unwrap());
            let end = begin + Nanos::from_millis(i64::try_from(random.below(1_000)).unwrap());
            (
                usize::try_from(random.below(count as u64)).unwrap(),
                begin,
                end,
            )
        });
        Self {
            txn: Txn(u128::from(random.next())),
            random,
            weather,
            now: Nanos(1_000_000_000_000),
            cells,
            sent: Vec::new(),
            initiator: None,
            attempt: 0,
            next_attempt: Nanos::ZERO,
            armed: BTreeSet::new(),
            given: BTreeMap::new(),
            committed: BTreeMap::new(),
            split,
            report: Report::default(),
        }
    }

    /// The whole history.
    pub(super) fn run(mut self, ignores_arms: bool) -> Report {
        let begin = self.now;
        while self.now < begin + LENGTH {
            self.now += STEP;
            self.disturb(begin, ignores_arms);
            self.deliver(begin);
            self.initiate();
            for at in 0..self.cells.len() {
                self.poll(at, begin);
            }
        }
        let began = self.cells.iter().filter(|it| !it.begins.is_empty()).count();
        match began {
            0 => self.report.none += 1,
            all if all == self.cells.len() => self.report.all += 1,
            _ => self.report.some += 1,
        }
        self.report
    }

    /// Restarts and steps of clocks: each with its chance once in the first three seconds on the mean.
    fn disturb(&mut self, begin: Nanos, ignores_arms: bool) {
        if self.now - begin > Nanos::from_millis(3_000) {
            return;
        }
        let at = usize::try_from(self.random.below(self.cells.len() as u64)).unwrap();
        if self.random.below(300_000) < self.weather.reboot {
            let (boot, seed) = (Boot(u128::from(self.random.next())), self.random.next());
            self.cells[at].boot = boot;
            self.cells[at].participant = participant(at, boot, seed, ignores_arms);
            self.given.remove(&at);
            self.committed.remove(&at);
        }
        if self.random.below(300_000) < self.weather.step {
            self.cells[at].error += self.random.within(50_000_000);
            self.cells[at].is_free_until = self.now + Nanos::from_millis(3_000);
        }
    }

    fn tai(&self, at: usize) -> (Tai, Nanos) {
        let cell = &self.cells[at];
        let monotonic = self.now + Nanos(cell.monotonic);
        let is_free = self.now < cell.is_free_until;
        let tai = Tai {
            state: if is_free {
                TaiState::Free
            } else {
                TaiState::Locked
            },
            cause: if is_free {
                FreeCause::Stepped(Nanos(cell.error))
            } else {
                FreeCause::default()
            },
            at: monotonic,
            offset: Nanos(cell.error - cell.monotonic),
            uncertainty: Nanos(CLOCK_ERROR),
            tai_utc_s: 37,
        };
        (tai, monotonic)
    }

    fn send(&mut self, from: usize, to: usize, message: &Message) {
        if self.random.chance(self.weather.loss) {
            return;
        }
        let copies = 1 + u64::from(self.random.chance(self.weather.repeat));
        for _ in 0..copies {
            let slow = if self.random.chance(3) { 10 } else { 1 };
            let delay = self.random.below(self.weather.delay_ms * slow * 1_000 + 1);
            self.sent.push(Sent {
                at: self.now + Nanos::from_micros(i64::try_from(delay).unwrap()),
                to,
                from,
                attempt: self.attempt,
                message: message.clone(),
            });
        }
    }

    fn is_split(&self, a: usize, b: usize, begin: Nanos) -> bool {
        self.split.is_some_and(|(alone, from, until)| {
            (a == alone) != (b == alone) && (from..until).contains(&(self.now - begin))
        })
    }

    fn deliver(&mut self, begin: Nanos) {
        let now = self.now;
        let (due, left): (Vec<Sent>, Vec<Sent>) = std::mem::take(&mut self.sent)
            .into_iter()
            .partition(|it| it.at <= now);
        self.sent = left;
        for sent in due {
            if self.is_split(sent.from, sent.to, begin) {
                continue;
            }
            if sent.to == self.cells.len() {
                self.reply(sent);
            } else {
                self.receive(sent);
            }
        }
    }

    fn reply(&mut self, sent: Sent) {
        let Some(initiator) = self
            .initiator
            .as_mut()
            .filter(|_| sent.attempt == self.attempt)
        else {
            return;
        };
        match sent.message {
            Message::Ready(reply) => initiator.handle_ready(sent.from, reply, self.now),
            Message::Committed(reply) => initiator.handle_armed(sent.from, reply),
            Message::Prepare(_)
            | Message::Commit(_)
            | Message::Abort
            | Message::Armed(_)
            | Message::Beat(_) => {}
        }
    }

    fn receive(&mut self, sent: Sent) {
        let (at, attempt) = (sent.to, sent.attempt);
        let (tai, now) = self.tai(at);
        let home = self.cells.len();
        match sent.message {
            Message::Prepare(request) => {
                let readiness = Readiness {
                    tai,
                    period: self.cells[at].period,
                    lead: Nanos::from_millis(50),
                };
                let reply = self.cells[at]
                    .participant
                    .prepare(&request, &readiness, now);
                if let Ok(ready) = &reply {
                    self.given.entry(at).or_default().insert(ready.nonce);
                }
                self.answer(attempt, Message::Ready(reply), at, home);
            }
            Message::Commit(commit) => {
                let reply = self.cells[at].participant.commit(&commit, &tai, now);
                if let Ok(armed) = &reply {
                    let start = armed.start_tai_ns;
                    self.armed.insert((at, start, armed.nonces.clone()));
                    // A repeated commit arms again by the clock of the first.
                    let error = self.cells[at].error;
                    let nonces = armed.nonces.clone();
                    let known = self
                        .committed
                        .get(&at)
                        .filter(|it| (it.0, &it.1) == (start, &nonces));
                    let error = known.map_or(error, |it| it.2);
                    self.committed.insert(at, (start, nonces, error));
                    self.publish(at, &Message::Armed(armed.clone()));
                }
                let reply = reply.map(|_| ());
                self.answer(attempt, Message::Committed(reply), at, home);
            }
            Message::Abort => {
                self.cells[at].participant.abort(self.txn);
            }
            Message::Armed(armed) => self.cells[at].participant.armed(&armed),
            Message::Beat(beat) => self.cells[at].participant.beat(&beat, now),
            Message::Ready(_) | Message::Committed(_) => {}
        }
    }

    /// A reply belongs to the attempt of its query.
    fn answer(&mut self, attempt: u32, message: Message, at: usize, home: usize) {
        let attempt = std::mem::replace(&mut self.attempt, attempt);
        self.send(at, home, &message);
        self.attempt = attempt;
    }

    /// Up to four attempts at the same start, as an impatient program makes them.
    fn initiate(&mut self) {
        if self.initiator.is_none() && self.attempt < 4 && self.now >= self.next_attempt {
            self.attempt += 1;
            let members = self.cells.iter().enumerate().map(|(at, cell)| Member {
                cell: name(at),
                boot: cell.boot,
                clock: String::new(),
                session: 1,
                nonce: Nonce(1),
                nets: vec!["rpinet0".to_owned()],
            });
            let lead = Nanos::from_millis(300);
            self.initiator = Some(Initiator::new(self.txn, members.collect(), lead, self.now));
        }
        let home = self.cells.len();
        while let Some(goal) = self.initiator.as_mut().and_then(|it| it.poll(self.now)) {
            match goal {
                Goal::Prepare(to, request) => self.send(home, to, &Message::Prepare(request)),
                Goal::Commit(to, commit) => self.send(home, to, &Message::Commit(commit)),
                Goal::Abort(to) => self.send(home, to, &Message::Abort),
                Goal::Finished(outcome) => {
                    self.initiator = None;
                    let wait = self.random.below(400);
                    self.next_attempt = self.now + Nanos::from_millis(i64::try_from(wait).unwrap());
                    if matches!(outcome, Outcome::Armed { .. }) {
                        self.attempt = 4;
                    }
                }
            }
        }
    }

    fn poll(&mut self, at: usize, begin: Nanos) {
        let (tai, now) = self.tai(at);
        while let Some(output) = self.cells[at].participant.poll(&tai, now) {
            match output {
                Output::Begin { txn, at: start } => self.check(at, txn, start),
                Output::PartnerLost { cell, .. } => {
                    let place = (0..self.cells.len()).find(|at| name(*at) == cell).unwrap();
                    self.cells[at].lost.insert(place);
                }
                Output::Release { .. } => {}
            }
        }
        let every = Nanos::from(BEAT_EVERY);
        if (self.now - begin).0 % every.0 == 0 {
            let participant = &self.cells[at].participant;
            let arms = participant.arms().into_iter().map(Message::Armed);
            let beats = participant.beats().into_iter().map(Message::Beat);
            for message in arms.chain(beats).collect::<Vec<_>>() {
                self.publish(at, &message);
            }
        }
    }

    fn publish(&mut self, from: usize, message: &Message) {
        for to in (0..self.cells.len()).filter(|to| *to != from) {
            self.send(from, to, message);
        }
    }

    /// What must hold whenever a cell begins.
    fn check(&mut self, at: usize, txn: Txn, start: Nanos) {
        let cell = &self.cells[at];
        let mut violations = Vec::new();
        let Some((start_tai, nonces, error)) = self.committed.get(&at).cloned() else {
            self.report
                .violations
                .push(format!("{at} begins without a commit in its run"));
            return;
        };
        let own = nonces.get(at);
        if !own.is_some_and(|own| self.given.get(&at).is_some_and(|given| given.contains(own))) {
            violations.push(format!("{at} begins by a permission of an earlier run"));
        }
        for partner in 0..self.cells.len() {
            if !self.armed.contains(&(partner, start_tai, nonces.clone())) {
                violations.push(format!("{at} begins, and {partner} was never armed for it"));
            }
        }
        // The instant in true time: wrong by the error alone that the clock had at the commit, though it was stepped since.
        let wrong = start.0 - cell.monotonic - start_tai;
        if (wrong + error).abs() > 1 {
            violations.push(format!("{at} begins {wrong} ns beside the instant"));
        }
        if cell.begins.contains(&(txn, cell.boot)) {
            violations.push(format!("{at} begins twice"));
        }
        self.report.violations.extend(violations);
        let boot = cell.boot;
        self.cells[at].begins.push((txn, boot));
    }
}

fn name(at: usize) -> String {
    format!("cell-{at}")
}

fn participant(at: usize, boot: Boot, seed: u64, ignores_arms: bool) -> Participant {
    let mut random = Random(seed);
    let entropy = Box::new(move || u128::from(random.next()));
    let mut participant = Participant::new(&name(at), boot, "", entropy);
    participant.ignores_arms = ignores_arms;
    participant
}
