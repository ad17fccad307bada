//! Coordinated starts over a real network of this host, of cells whose nets are only noted: who begins, when, and what other messages cause,
//! which is nothing.

use std::sync::atomic::AtomicUsize;

use takt_core::tai::{FreeCause, Tai, TaiState};
use zenoh::Session;

use super::*;
use crate::command::{Txn, random};
use crate::session::together::{self, Together, TogetherError};
use crate::start::{
    Abort, Armed, Commit, Prepare, Ready, Refusal as Why, Stage, StartReply, Status,
};

/// TAI minus `CLOCK_MONOTONIC` of all cells.
const OFFSET: Nanos = Nanos(7_000_000_000_000);

/// What a cell notes of its nets.
#[derive(Default)]
pub(super) struct Noted {
    /// Nets that are kept or run.
    held: AtomicUsize,
    began: Mutex<Vec<Nanos>>,
    lost: Mutex<Vec<LossPolicy>>,
    ends: AtomicBool,
}

/// A cell's part in starts.
#[derive(Default)]
pub(super) struct Part {
    pub(super) clock: String,
    is_locked: bool,
    noted: Arc<Noted>,
}

struct Nets {
    noted: Arc<Noted>,
    begins: Option<Nanos>,
}

impl Held for Nets {
    fn period(&self) -> Nanos {
        Nanos::from_millis(1)
    }

    fn begin_at(&mut self, at: Nanos) {
        self.begins = Some(at);
        self.noted.began.lock().unwrap().push(at + OFFSET);
    }

    fn state(&mut self) -> HeldState {
        match self.begins.filter(|at| takt_core::monotonic() >= *at) {
            None => HeldState::Waiting,
            Some(at) => HeldState::Running {
                cycle: 7,
                begin: at,
                woken: at,
                end: self.noted.ends.load(Ordering::SeqCst).then_some(Ok(())),
            },
        }
    }

    fn lose_partner(&mut self, policy: LossPolicy) {
        self.noted.lost.lock().unwrap().push(policy);
    }
}

impl Drop for Nets {
    fn drop(&mut self) {
        self.noted.held.fetch_sub(1, Ordering::SeqCst);
    }
}

impl Part {
    pub(super) fn tai(&self) -> Tai {
        let state = if self.is_locked {
            TaiState::Locked
        } else {
            TaiState::Free
        };
        Tai {
            state,
            cause: FreeCause::Unsynchronised,
            at: takt_core::monotonic(),
            offset: OFFSET,
            uncertainty: Nanos(1_000),
            tai_utc_s: 37,
        }
    }

    pub(super) fn prepare(&self, nets: &[String]) -> Result<Box<dyn Held>, String> {
        if nets.iter().any(|net| net == "busy") {
            return Err("net busy needs left, which rpinet3 holds".to_owned());
        }
        self.noted.held.fetch_add(1, Ordering::SeqCst);
        let noted = Arc::clone(&self.noted);
        Ok(Box::new(Nets {
            noted,
            begins: None,
        }))
    }
}

/// Two cells, of which the first is the router, and a program that commands both.
struct Line {
    cells: [Arc<Bench>; 2],
    members: Vec<Member>,
    fleet: Fleet,
}

fn line(of_host: [&str; 2], is_locked: bool) -> Line {
    let endpoint = free_endpoint();
    let cell = |clock: &str| {
        Arc::new(Bench {
            is_real: true,
            starts: Part {
                clock: clock.to_owned(),
                is_locked,
                ..Part::default()
            },
            ..Bench::default()
        })
    };
    let cells = of_host.map(cell);
    let allow = vec![FleetRule {
        certificates: Vec::new(),
        rights: vec![FleetRight::Command, FleetRight::Start],
    }];
    let first = FleetSettings {
        allow: allow.clone(),
        ..router(&endpoint)
    };
    let second = FleetSettings {
        connect: vec![endpoint.clone()],
        allow,
        ..FleetSettings::default()
    };
    let members = vec![
        joined("cell-a", &first, &cells[0]).unwrap(),
        joined("cell-b", &second, &cells[1]).unwrap(),
    ];
    let observer = Observer {
        connect: vec![endpoint],
        tls: None,
    };
    let fleet = Fleet::connect(&observer).unwrap();
    while alive(fleet.session()).len() < 2 {
        std::thread::yield_now();
    }
    Line {
        cells,
        members,
        fleet,
    }
}

impl Line {
    fn noted(&self, cell: usize) -> &Noted {
        &self.cells[cell].starts.noted
    }

    fn remotes(&self, on_loss: LossPolicy) -> [Remote; 2] {
        ["cell-a", "cell-b"].map(|name| {
            let name = CellName::new(name).unwrap();
            Remote::open(&self.fleet, &name, "panel", on_loss).unwrap()
        })
    }

    fn start(&self, remotes: &[Remote; 2], nets: [&str; 2]) -> Result<Together, TogetherError> {
        let nets = |at: usize| vec![nets[at].to_owned()];
        let parts = [(&remotes[0], nets(0)), (&remotes[1], nets(1))];
        together::start(&self.fleet, &parts, Duration::from_secs(1))
    }

    fn wait(&self, what: &str, done: impl Fn(&Self) -> bool) {
        let until = std::time::Instant::now() + ARRIVES;
        while !done(self) {
            assert!(std::time::Instant::now() < until, "waited in vain: {what}");
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    fn is_free(&self) -> bool {
        self.cells
            .iter()
            .all(|cell| cell.starts.noted.held.load(Ordering::SeqCst) == 0)
    }
}

/// How the start is at both cells.
fn stages(line: &Line, together: &Together) -> Vec<Option<Status>> {
    let all = together.statuses(&line.fleet).unwrap();
    all.into_iter().map(|(_, status)| status).collect()
}

#[test]
fn start_begins_on_two_cells_and_lost_partner_is_noticed() {
    takt_tests::steady(|| {
        let mut line = line(["one", "other"], true);
        let remotes = line.remotes(LossPolicy::Stop);
        let together = line.start(&remotes, ["rpinet0", "rpinet0"]).unwrap();
        let begun = together.begun(&line.fleet, ARRIVES).unwrap();
        for (cell, status) in &begun {
            let began = status.as_ref().unwrap().began.unwrap();
            assert_eq!(began.begin_tai_ns, together.start_tai_ns, "{cell}");
        }
        let began = |cell: usize| line.noted(cell).began.lock().unwrap().clone();
        assert_eq!(
            (began(0), began(1)),
            (vec![Nanos(together.start_tai_ns)], began(0))
        );
        // The other one goes while both run: the first applies the policy of its session, once.
        assert!(line.noted(0).lost.lock().unwrap().is_empty());
        drop(line.members.pop());
        line.wait("the loss", |line| {
            !line.noted(0).lost.lock().unwrap().is_empty()
        });
        assert_eq!(*line.noted(0).lost.lock().unwrap(), [LossPolicy::Stop]);
        let status = stages(&line, &together).remove(0).unwrap();
        assert_eq!(
            (status.stage, status.lost),
            (Stage::Running, vec!["cell-b".to_owned()])
        );
        // Its own nets end by themselves.
        line.noted(0).ends.store(true, Ordering::SeqCst);
        line.wait("the end", Line::is_free);
    });
}

#[test]
fn start_with_end_of_one_cell_does_not_end_the_other() {
    takt_tests::steady(|| {
        let line = line(["host", "host"], false);
        let remotes = line.remotes(LossPolicy::Cancel);
        let together = line.start(&remotes, ["rpinet0", "rpinet0"]).unwrap();
        together.begun(&line.fleet, ARRIVES).unwrap();
        line.noted(1).ends.store(true, Ordering::SeqCst);
        line.wait("the end of one", |line| {
            line.noted(1).held.load(Ordering::SeqCst) == 0
        });
        // Far longer than a silence that counts as a loss.
        std::thread::sleep(Duration::from_millis(700));
        assert!(line.noted(0).lost.lock().unwrap().is_empty());
        assert_eq!(
            stages(&line, &together)[0].as_ref().unwrap().stage,
            Stage::Running
        );
        assert_eq!(
            stages(&line, &together)[1].as_ref().unwrap().stage,
            Stage::Over
        );
    });
}

#[test]
fn start_refused_by_one_cell_begins_nowhere() {
    let line = line(["one", "other"], false);
    let remotes = line.remotes(LossPolicy::Cancel);
    let error = line
        .start(&remotes, ["rpinet0", "rpinet0"])
        .unwrap_err()
        .to_string();
    for part in [
        "nothing begins",
        "not fit for a coordinated start",
        "no time service",
        "hint: start ptp4l",
    ] {
        assert!(error.contains(part), "{error}");
    }
    line.wait("the release", Line::is_free);
    drop((remotes, line));
    // A net that cannot be kept, at one of two cells.
    let line = self::line(["host", "host"], false);
    let remotes = line.remotes(LossPolicy::Cancel);
    let error = line.start(&remotes, ["rpinet0", "busy"]).unwrap_err();
    assert!(
        matches!(&error, TogetherError::Refused { cell, .. } if cell == "cell-b"),
        "{error}"
    );
    assert!(error.to_string().contains("which rpinet3 holds"), "{error}");
    line.wait("the release", Line::is_free);
    for cell in 0..2 {
        assert!(line.noted(cell).began.lock().unwrap().is_empty());
    }
}

fn said(from: &Session, step: &str, message: &str) -> StartReply {
    let key = format!("takt/cell-a/start/{step}");
    let replies = ask(from, &key, message, ARRIVES);
    serde_json::from_str(&replies[0]).unwrap()
}

fn why(reply: StartReply) -> Why {
    let StartReply::Refused { reason, .. } = reply else {
        panic!("{reply:?}");
    };
    reason
}

/// Prepares at the first cell alone, with a partner that is never asked.
fn prepared(line: &Line, remote: &Remote, txn: Txn) -> (Prepare, Ready) {
    let (session, nonce) = remote.permission();
    let prepare = Prepare {
        txn,
        boot: remote.boot(),
        partners: ["cell-a", "cell-b"].map(str::to_owned).to_vec(),
        session,
        nonce,
        nets: vec!["rpinet0".to_owned()],
        clock: Some("host".to_owned()),
    };
    let reply = said(line.fleet.session(), "prepare", &to_json(&prepare));
    let StartReply::Ready(ready) = reply else {
        panic!("{reply:?}");
    };
    (prepare, ready)
}

#[test]
fn start_message_forged_stale_or_repeated_begins_nothing() {
    takt_tests::steady(|| {
        let line = line(["host", "host"], false);
        let from = line.fleet.session();
        let remotes = line.remotes(LossPolicy::Cancel);
        let txn = Txn(random()());
        let (prepare, ready) = prepared(&line, &remotes[0], txn);
        let commit = Commit {
            txn,
            boot: prepare.boot,
            start_tai_ns: (ready.tai_ns + 1_000_000_000) / 1_000_000 * 1_000_000,
            nonces: vec![ready.nonce, Nonce(9)],
        };
        // Forged: another permission, session or run; to all cells; no message at all.
        let forged = Prepare {
            txn: Txn(1),
            nonce: Nonce(1),
            ..prepare.clone()
        };
        let refused = why(said(from, "prepare", &to_json(&forged)));
        assert!(matches!(refused, Why::Session { .. }), "{refused:?}");
        let forged = Commit {
            nonces: vec![Nonce(8), Nonce(9)],
            ..commit.clone()
        };
        let refused = why(said(from, "commit", &to_json(&forged)));
        assert!(matches!(refused, Why::Nonce { .. }), "{refused:?}");
        let stale = Commit {
            boot: Boot(1),
            ..commit.clone()
        };
        assert_eq!(why(said(from, "commit", &to_json(&stale))), Why::OtherBoot);
        let refused = why(said(from, "commit", "{}"));
        assert!(matches!(refused, Why::Malformed { .. }), "{refused:?}");
        let wild = ask(from, "takt/*/start/commit", &to_json(&commit), DENIED);
        assert!(wild.iter().all(|it| it.contains("other_key")), "{wild:?}");
        // Late: it is beyond its instant less the guard.
        let late = Commit {
            start_tai_ns: commit.start_tai_ns - 950_000_000,
            ..commit.clone()
        };
        let refused = why(said(from, "commit", &to_json(&late)));
        assert!(matches!(refused, Why::Late { .. }), "{refused:?}");
        // The good one, twice; and an arm of the partner with other permissions, and one by a link that may only read.
        for _ in 0..2 {
            let armed = said(from, "commit", &to_json(&commit));
            assert!(matches!(armed, StartReply::Armed(_)), "{armed:?}");
        }
        let arm = Armed {
            txn,
            cell: "cell-b".to_owned(),
            start_tai_ns: commit.start_tai_ns,
            nonces: vec![ready.nonce, Nonce(10)],
        };
        let key = format!("takt/cell-b/start/{txn}/armed");
        from.put(&key, to_json(&arm)).wait().unwrap();
        line.wait("the release", Line::is_free);
        assert!(line.noted(0).began.lock().unwrap().is_empty());
        let StartReply::Status { starts } = said(from, "status", "") else {
            panic!("no status");
        };
        let why_not = starts[0].why.clone().unwrap();
        assert!(why_not.contains("not all partners were armed"), "{why_not}");
        // What is over stays over.
        let refused = why(said(from, "commit", &to_json(&commit)));
        assert!(matches!(refused, Why::Unknown { .. }), "{refused:?}");
        let boot = prepare.boot;
        let aborted = said(from, "abort", &to_json(&Abort { txn, boot }));
        assert_eq!(aborted, StartReply::Aborted { released: false });
    });
}

#[test]
fn start_of_session_that_ends_is_released() {
    let line = line(["host", "host"], false);
    let [first, _second] = line.remotes(LossPolicy::Cancel);
    prepared(&line, &first, Txn(5));
    assert!(!line.is_free());
    drop(first);
    line.wait("the release", Line::is_free);
    assert!(line.noted(0).began.lock().unwrap().is_empty());
}

#[test]
fn start_by_link_without_right_gets_no_answer_and_arms_nothing() {
    let endpoint = free_endpoint();
    let bench = Arc::new(Bench::default());
    let _cell = joined("cell-a", &router(&endpoint), &bench).unwrap();
    let observer = observer(&endpoint);
    for step in ["prepare", "commit", "abort"] {
        let key = format!("takt/cell-a/start/{step}");
        assert!(
            ask(&observer, &key, "{}", DENIED)
                .iter()
                .all(|it| it == "Timeout"),
            "{step}"
        );
    }
    // What it may not publish reaches no other link either.
    let other = self::observer(&endpoint);
    let arms = other.declare_subscriber("takt/*/start/**").wait().unwrap();
    let lines = other.declare_subscriber("takt/*/log").wait().unwrap();
    observer
        .put("takt/cell-b/start/1/armed", "{}")
        .wait()
        .unwrap();
    let until = std::time::Instant::now() + ARRIVES;
    // What it may publish comes after it on the same link.
    loop {
        observer.put("takt/cell-b/log", "\"later\"").wait().unwrap();
        let sample = lines.recv_timeout(Duration::from_millis(50)).unwrap();
        if sample.is_some_and(|it| it.key_expr().as_str() == "takt/cell-b/log") {
            break;
        }
        assert!(std::time::Instant::now() < until);
    }
    assert!(arms.try_recv().unwrap().is_none());
}
