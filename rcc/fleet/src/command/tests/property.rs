//! A network that delays, repeats, reorders and forges, and a controller that restarts: whatever they do, a command is
//! executed at most once, by the run of the controller that it was sent to, in the order of its session, and no later
//! than its nonce permits.

use std::collections::BTreeSet;

use proptest::prelude::*;
use takt_core::Nanos;

use super::{COMMAND_KEY, SESSION_KEY, admission, query};
use crate::command::*;

#[derive(Clone, Debug)]
enum Step {
    /// Time passes, ms.
    Pass(u16),
    /// The client opens a session; the query is delivered at once.
    Open,
    /// The client sends a keep-alive or command, which the network keeps.
    Renew,
    Command {
        allowed_ms: u16,
    },
    /// The network delivers one of the queries sent so far, from the newest on; its reply arrives or not.
    Deliver {
        back: usize,
        reply_arrives: bool,
    },
    /// The network delivers it to a key with a wildcard.
    Broadcast {
        back: usize,
    },
    /// A client sends a command without knowing a nonce.
    Forge {
        session: u32,
        seq: u64,
        nonce: u128,
    },
    Restart,
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        4 => (0_u16..300).prop_map(Step::Pass),
        2 => Just(Step::Open),
        4 => Just(Step::Renew),
        6 => (0_u16..800).prop_map(|allowed_ms| Step::Command { allowed_ms }),
        10 => (0_usize..12, any::<bool>())
            .prop_map(|(back, reply_arrives)| Step::Deliver { back, reply_arrives }),
        1 => (0_usize..12).prop_map(|back| Step::Broadcast { back }),
        1 => (0_u32..4, 0_u64..4, any::<u128>())
            .prop_map(|(session, seq, nonce)| Step::Forge { session, seq, nonce }),
        1 => Just(Step::Restart),
    ]
}

/// A query on the network.
#[derive(Clone)]
struct Sent {
    run: u128,
    key: &'static str,
    text: String,
    /// The latest instant at which it may be executed: the client's own bound.
    latest: Nanos,
}

struct World {
    now: Nanos,
    run: u128,
    cell: Admission,
    sent: Vec<Sent>,
    /// What the client knows: session, nonce, instant of its grant.
    known: Option<(Boot, u32, Nonce, Nanos)>,
    next_seq: u64,
    commands: u64,
    executed: BTreeSet<String>,
    last_executed: Option<(u128, u32, u64)>,
}

impl World {
    fn new() -> Self {
        Self {
            now: Nanos::ZERO,
            run: 1,
            cell: admission(Boot(1), Limits::default()),
            sent: Vec::new(),
            known: None,
            next_seq: 1,
            commands: 0,
            executed: BTreeSet::new(),
            last_executed: None,
        }
    }

    fn step(&mut self, step: &Step) {
        match *step {
            Step::Pass(ms) => self.now += Nanos::from_millis(i64::from(ms)),
            Step::Open => self.open(),
            Step::Renew => self.renew(),
            Step::Command { allowed_ms } => self.command(Nanos::from_millis(allowed_ms.into())),
            Step::Deliver {
                back,
                reply_arrives,
            } => self.deliver(back, reply_arrives),
            Step::Broadcast { back } => {
                if let Some(sent) = self.recent(back) {
                    let text = sent.text.as_bytes();
                    let answer = self
                        .cell
                        .handle_query(&query("takt/*/cmd/directio", text), self.now);
                    assert!(matches!(answer, Answer::Reply(Reply::Refused { .. })));
                }
            }
            Step::Forge {
                session,
                seq,
                nonce,
            } => self.forge(session, seq, Nonce(nonce)),
            Step::Restart => {
                self.run += 1;
                self.cell = admission(Boot(self.run), Limits::default());
                // The monotonic clock of a host that boots begins at zero.
                self.now = Nanos::ZERO;
            }
        }
    }

    fn recent(&self, back: usize) -> Option<Sent> {
        self.sent.iter().rev().nth(back).cloned()
    }

    fn open(&mut self) {
        let request = SessionRequest::Open {
            boot: Boot(self.run),
            open: OpenId(u128::from(self.commands) << 32 | self.sent.len() as u128),
            client: "client".to_owned(),
            on_loss: LossPolicy::Cancel,
        };
        self.next_seq = 1;
        self.send(SESSION_KEY, to_json(&request), Nanos::MAX);
        self.deliver(0, true);
    }

    fn renew(&mut self) {
        if let Some((boot, session, nonce, _)) = self.known {
            let request = SessionRequest::Renew {
                boot,
                session,
                nonce,
            };
            self.send(SESSION_KEY, to_json(&request), Nanos::MAX);
        }
    }

    fn command(&mut self, allowed: Nanos) {
        let Some((boot, session, nonce, granted)) = self.known else {
            return;
        };
        self.commands += 1;
        let not_after = granted + allowed;
        let request = CommandRequest {
            boot,
            session,
            seq: self.next_seq,
            nonce,
            not_after_ns: not_after.0,
            line: format!("command {}", self.commands),
        };
        self.next_seq += 1;
        let latest = not_after.min(granted + Limits::default().nonce_life);
        self.send(COMMAND_KEY, to_json(&request), latest);
    }

    fn send(&mut self, key: &'static str, text: String, latest: Nanos) {
        let run = self.run;
        self.sent.push(Sent {
            run,
            key,
            text,
            latest,
        });
    }

    fn deliver(&mut self, back: usize, reply_arrives: bool) {
        let Some(sent) = self.recent(back) else {
            return;
        };
        let query = query(sent.key, sent.text.as_bytes());
        let answer = if sent.key == SESSION_KEY {
            self.cell.handle_session(&query, self.now)
        } else {
            self.cell.handle_query(&query, self.now)
        };
        match answer {
            Answer::Execute {
                session, seq, line, ..
            } => {
                self.check_executed(&sent, session, seq, line);
                self.cell.finish(session, seq, Vec::new());
            }
            Answer::Opened { reply, .. } | Answer::Reply(reply) if reply_arrives => {
                if let Reply::Granted {
                    boot,
                    session,
                    nonce,
                    now_ns,
                    ..
                } = reply
                {
                    self.known = Some((boot, session, nonce, Nanos(now_ns)));
                }
            }
            Answer::Opened { .. }
            | Answer::Reply(_)
            | Answer::Closed { .. }
            | Answer::Notify { .. } => {}
        }
    }

    fn check_executed(&mut self, sent: &Sent, session: u32, seq: u64, line: String) {
        assert_eq!(sent.run, self.run, "sent before a restart: {line}");
        assert!(self.now <= sent.latest, "late: {line}");
        assert!(self.executed.insert(line), "executed twice");
        if let Some((run, last_session, last)) = self.last_executed
            && (run, last_session) == (self.run, session)
        {
            assert_eq!(seq, last + 1, "out of order");
        }
        self.last_executed = Some((self.run, session, seq));
    }

    fn forge(&mut self, session: u32, seq: u64, nonce: Nonce) {
        let request = CommandRequest {
            boot: Boot(self.run),
            session,
            seq,
            nonce,
            not_after_ns: i64::MAX,
            line: "forged".to_owned(),
        };
        let text = to_json(&request);
        let answer = self
            .cell
            .handle_query(&query(COMMAND_KEY, text.as_bytes()), self.now);
        assert!(matches!(answer, Answer::Reply(Reply::Refused { .. })));
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]
    #[test]
    fn commands_on_bad_network_execute_once_in_time(steps in prop::collection::vec(step(), 0..60)) {
        let mut world = World::new();
        for step in &steps {
            world.step(step);
        }
    }

    #[test]
    fn queries_of_any_bytes_never_panic(payload in prop::collection::vec(any::<u8>(), 0..200), key in ".{0,20}") {
        let mut cell = admission(Boot(1), Limits::default());
        for key in [COMMAND_KEY, SESSION_KEY, &key] {
            cell.handle_query(&query(key, &payload), Nanos::ZERO);
            cell.handle_session(&query(key, &payload), Nanos::ZERO);
        }
        prop_assert_eq!(cell.open(), 0);
    }
}
