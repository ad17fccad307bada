//! What each wrong query gets, one by one. What orders of right and wrong ones can do is in `property`.

mod property;

use takt_core::Nanos;

use super::*;

pub(super) const SESSION_KEY: &str = "takt/a/cmd/session";
pub(super) const COMMAND_KEY: &str = "takt/a/cmd/directio";
const BOOT: Boot = Boot(7);

/// Numbers that count up from a run's own range: runs share none.
pub(super) fn counting(run: u128) -> Entropy {
    let mut next = run << 64;
    Box::new(move || {
        next += 1;
        next
    })
}

pub(super) fn admission(boot: Boot, limits: Limits) -> Admission {
    let keys = (SESSION_KEY.to_owned(), COMMAND_KEY.to_owned());
    Admission::new(keys, boot, limits, counting(boot.0))
}

fn ms(at: i64) -> Nanos {
    Nanos::from_millis(at)
}

fn query<'a>(key: &'a str, payload: &'a [u8]) -> Query<'a> {
    let parameters = "";
    Query {
        key,
        parameters,
        payload,
    }
}

fn refusal(answer: Answer) -> Refusal {
    let Answer::Reply(Reply::Refused { reason, text, .. }) = answer else {
        panic!("not refused: {answer:?}");
    };
    assert_eq!(text, reason.to_string());
    reason
}

/// A controller with one session, opened at 0.
struct Bench {
    cell: Admission,
    session: u32,
    nonce: Nonce,
}

impl Bench {
    fn new() -> Self {
        Self::with(Limits::default())
    }

    fn with(limits: Limits) -> Self {
        let mut bench = Self {
            cell: admission(BOOT, limits),
            session: 0,
            nonce: Nonce(0),
        };
        let opened = bench.session(&open(1), 0);
        let Answer::Opened { session, reply, .. } = opened else {
            panic!("{opened:?}");
        };
        bench.session = session;
        bench.nonce = nonce(&reply);
        bench
    }

    fn session(&mut self, request: &SessionRequest, at: i64) -> Answer {
        let text = to_json(request);
        self.cell
            .handle_session(&query(SESSION_KEY, text.as_bytes()), ms(at))
    }

    fn renew(&mut self, nonce: Nonce, at: i64) -> Answer {
        let (boot, session) = (BOOT, self.session);
        self.session(
            &SessionRequest::Renew {
                boot,
                session,
                nonce,
            },
            at,
        )
    }

    fn command(&self, seq: u64, line: &str) -> CommandRequest {
        CommandRequest {
            boot: BOOT,
            session: self.session,
            seq,
            nonce: self.nonce,
            not_after_ns: i64::MAX,
            line: line.to_owned(),
        }
    }

    fn send(&mut self, request: &CommandRequest, at: i64) -> Answer {
        let text = to_json(request);
        self.cell
            .handle_query(&query(COMMAND_KEY, text.as_bytes()), ms(at))
    }

    fn notified(&mut self, nonce: Nonce, from: u64, at: i64) -> Answer {
        let (boot, session) = (BOOT, self.session);
        self.session(
            &SessionRequest::Notified {
                boot,
                session,
                nonce,
                from,
            },
            at,
        )
    }

    /// Executes a command at once.
    fn execute(&mut self, seq: u64, at: i64) -> Reply {
        let answer = self.send(&self.command(seq, "x"), at);
        assert!(matches!(answer, Answer::Execute { .. }), "{answer:?}");
        let lines = vec![format!("reply {seq}")];
        self.cell.finish(self.session, seq, lines).unwrap()
    }
}

fn open(number: u128) -> SessionRequest {
    SessionRequest::Open {
        boot: BOOT,
        open: OpenId(number),
        client: "bench".to_owned(),
        on_loss: LossPolicy::Stop,
    }
}

fn nonce(reply: &Reply) -> Nonce {
    let Reply::Granted { nonce, .. } = reply else {
        panic!("{reply:?}");
    };
    *nonce
}

#[test]
fn command_in_time_executes_once_and_repeats_reply() {
    let mut bench = Bench::new();
    let first = bench.execute(1, 10);
    let repeated = bench.send(&bench.command(1, "x"), 20);
    assert_eq!(repeated, Answer::Reply(first.clone()));
    // Also after the nonce has expired, while the session lives.
    let old = bench.command(1, "x");
    bench.nonce = nonce(&granted(bench.renew(bench.nonce, 400)));
    assert_eq!(bench.send(&old, 700), Answer::Reply(first));
    assert!(matches!(bench.execute(2, 701), Reply::Done { seq: 2, .. }));
    assert_eq!(
        refusal(bench.send(&bench.command(1, "x"), 702)),
        Refusal::OldSequence { seq: 1, next: 3 }
    );
}

fn granted(answer: Answer) -> Reply {
    let Answer::Reply(reply @ Reply::Granted { .. }) = answer else {
        panic!("{answer:?}");
    };
    reply
}

#[test]
fn command_unfinished_is_busy_for_repeats_and_successors() {
    let mut bench = Bench::new();
    let started = bench.send(&bench.command(1, "x"), 0);
    assert!(matches!(started, Answer::Execute { until, .. } if until == ms(500)));
    for (seq, line) in [(1, "x"), (2, "y")] {
        let why = refusal(bench.send(&bench.command(seq, line), 1));
        assert_eq!(why, Refusal::Busy { seq: 1 });
    }
    assert!(bench.cell.finish(bench.session, 2, Vec::new()).is_none());
    assert!(bench.cell.finish(bench.session, 1, Vec::new()).is_some());
    assert!(bench.cell.finish(bench.session, 1, Vec::new()).is_none());
    bench.execute(2, 2);
}

#[test]
fn command_wrong_in_one_field_is_refused() {
    type Change = fn(&mut CommandRequest);
    let session = 1;
    let table: [(Change, i64, Refusal); 9] = [
        (|c| c.boot = Boot(8), 1, Refusal::OtherBoot),
        (|c| c.session = 9, 1, Refusal::NoSession { session: 9 }),
        (|c| c.nonce = Nonce(3), 1, Refusal::UnknownNonce { session }),
        (|c| c.seq = 3, 1, Refusal::SequenceGap { seq: 3, next: 2 }),
        (|c| c.seq = 0, 1, Refusal::OldSequence { seq: 0, next: 2 }),
        (
            |c| c.seq = u64::MAX,
            1,
            Refusal::SequenceGap {
                seq: u64::MAX,
                next: 2,
            },
        ),
        (
            |c| (c.seq, c.line) = (1, "other".to_owned()),
            1,
            Refusal::SequenceReused { seq: 1, next: 2 },
        ),
        (
            |c| c.not_after_ns = 999_999,
            1,
            Refusal::Late { late_ns: 1 },
        ),
        (|_| (), 501, Refusal::NoSession { session }),
    ];
    for (change, at, expected) in table {
        let mut bench = Bench::new();
        bench.execute(1, 0);
        let mut command = bench.command(2, "y");
        change(&mut command);
        assert_eq!(refusal(bench.send(&command, at)), expected);
        if expected != (Refusal::NoSession { session }) {
            bench.execute(2, 2);
        }
    }
}

#[test]
fn command_taken_after_its_nonce_expired_is_refused() {
    let mut bench = Bench::new();
    let old = bench.command(1, "x");
    bench.renew(bench.nonce, 300);
    assert!(matches!(
        bench.send(&old, 500),
        Answer::Execute { until, .. } if until == ms(500)
    ));
    let mut bench = Bench::new();
    bench.renew(bench.nonce, 300);
    let mut late = ms(500);
    late.0 += 1;
    let text = to_json(&old);
    let answer = bench
        .cell
        .handle_query(&query(COMMAND_KEY, text.as_bytes()), late);
    assert_eq!(refusal(answer), Refusal::Late { late_ns: 1 });
}

#[test]
fn command_nonce_before_previous_is_unknown() {
    let mut bench = Bench::new();
    let old = bench.command(1, "x");
    for at in [10, 20] {
        bench.nonce = nonce(&granted(bench.renew(bench.nonce, at)));
    }
    assert_eq!(
        refusal(bench.send(&old, 30)),
        Refusal::UnknownNonce { session: 1 }
    );
    bench.execute(1, 30);
}

#[test]
fn query_key_not_exactly_own_is_refused() {
    let mut bench = Bench::new();
    let text = to_json(&bench.command(1, "x"));
    for key in [
        "takt/*/cmd/directio",
        "takt/**",
        "takt/a/cmd/*",
        "takt/a/cmd/direct$*",
        "**",
    ] {
        let answer = bench.cell.handle_query(&query(key, text.as_bytes()), ms(1));
        assert_eq!(refusal(answer), Refusal::Wildcard, "{key}");
    }
    let own = COMMAND_KEY.to_owned();
    for (key, parameters) in [
        (SESSION_KEY, ""),
        ("takt/a/cmd/directio/", ""),
        ("", ""),
        (COMMAND_KEY, "all=true"),
    ] {
        let query = Query {
            parameters,
            ..query(key, text.as_bytes())
        };
        let expected = Refusal::OtherKey { own: own.clone() };
        assert_eq!(refusal(bench.cell.handle_query(&query, ms(1))), expected);
    }
    bench.execute(1, 2);
}

#[test]
fn query_long_or_malformed_is_refused() {
    let mut bench = Bench::with(Limits {
        message_bytes: 300,
        ..Limits::default()
    });
    let long = bench.command(1, &"x".repeat(300));
    let found = to_json(&long).len();
    assert_eq!(
        refusal(bench.send(&long, 0)),
        Refusal::TooLong { found, bound: 300 }
    );
    let good = to_json(&bench.command(1, "x"));
    let more = good.replacen('{', "{\"force\":true,", 1);
    let deep = "[".repeat(250);
    for text in [more.as_str(), "", "{}", "null", "\u{0}", deep.as_str()] {
        let answer = bench
            .cell
            .handle_query(&query(COMMAND_KEY, text.as_bytes()), ms(0));
        assert!(
            matches!(refusal(answer), Refusal::Malformed { .. }),
            "{text}"
        );
        let answer = bench
            .cell
            .handle_session(&query(SESSION_KEY, text.as_bytes()), ms(0));
        assert!(
            matches!(refusal(answer), Refusal::Malformed { .. }),
            "{text}"
        );
    }
    let nonce = format!("{}", Nonce(5)).to_uppercase().replace('0', "A");
    let text = format!(r#"{{"op":"close","boot":"{BOOT}","session":1,"nonce":"{nonce}"}}"#);
    let answer = bench
        .cell
        .handle_session(&query(SESSION_KEY, text.as_bytes()), ms(0));
    assert!(matches!(refusal(answer), Refusal::Malformed { .. }));
    bench.execute(1, 2);
}

#[test]
fn hello_states_boot_and_changes_nothing() {
    let mut bench = Bench::new();
    let hello = bench.session(&SessionRequest::Hello {}, 3);
    assert!(matches!(
        hello,
        Answer::Reply(Reply::Hello {
            boot: BOOT,
            now_ns: 3_000_000,
            sessions_max: 32,
            ..
        })
    ));
    assert_eq!(bench.cell.open(), 1);
}

#[test]
fn opening_repeated_opens_no_second_session() {
    let mut bench = Bench::new();
    let again = granted(bench.session(&open(1), 10));
    assert!(
        matches!(again, Reply::Granted { session: 1, nonce, expires_ns: 500_000_000, .. } if nonce == bench.nonce)
    );
    bench.execute(1, 20);
    assert_eq!(refusal(bench.session(&open(1), 30)), Refusal::OpenRepeated);
    assert_eq!(bench.cell.open(), 1);
}

#[test]
fn session_request_of_other_boot_is_refused() {
    let mut bench = Bench::new();
    let (boot, session, nonce) = (Boot(8), bench.session, bench.nonce);
    let mut other = open(2);
    if let SessionRequest::Open { boot: meant, .. } = &mut other {
        *meant = boot;
    }
    let renew = SessionRequest::Renew {
        boot,
        session,
        nonce,
    };
    let close = SessionRequest::Close {
        boot,
        session,
        nonce,
    };
    for request in [other, renew, close] {
        assert_eq!(refusal(bench.session(&request, 1)), Refusal::OtherBoot);
    }
    assert_eq!(bench.cell.deadline(), Some(ms(500)));
}

#[test]
fn keep_alive_repeated_does_not_extend_session() {
    let mut bench = Bench::new();
    let first = granted(bench.renew(bench.nonce, 300));
    assert_eq!(bench.cell.deadline(), Some(ms(800)));
    // The same keep-alive again, late but while its nonce permits.
    assert_eq!(granted(bench.renew(bench.nonce, 500)), first);
    assert_eq!(bench.cell.deadline(), Some(ms(800)));
    let why = refusal(bench.renew(bench.nonce, 600));
    assert!(matches!(why, Refusal::Late { .. }), "{why}");
}

#[test]
fn session_without_keep_alive_is_lost_once() {
    let mut bench = Bench::new();
    assert_eq!(bench.cell.poll(ms(500)), None);
    let (session, on_loss) = (bench.session, LossPolicy::Stop);
    assert_eq!(bench.cell.poll(ms(501)), Some(Lost { session, on_loss }));
    assert_eq!(bench.cell.poll(ms(502)), None);
    assert_eq!(bench.cell.deadline(), None);
    let why = refusal(bench.renew(bench.nonce, 502));
    assert_eq!(why, Refusal::NoSession { session });
    // A command that is executed meanwhile has no reply any more.
    let mut bench = Bench::new();
    bench.send(&bench.command(1, "x"), 499);
    assert!(bench.cell.poll(ms(501)).is_some());
    assert!(bench.cell.finish(session, 1, Vec::new()).is_none());
}

#[test]
fn session_closed_admits_no_command() {
    let mut bench = Bench::new();
    let (boot, session, nonce) = (BOOT, bench.session, bench.nonce);
    let close = SessionRequest::Close {
        boot,
        session,
        nonce,
    };
    let closed = bench.session(&close, 1);
    assert!(matches!(closed, Answer::Closed { session: 1, .. }));
    for answer in [
        bench.send(&bench.command(1, "x"), 2),
        bench.session(&close, 2),
    ] {
        assert_eq!(refusal(answer), Refusal::NoSession { session });
    }
    assert_eq!(bench.cell.poll(ms(900)), None, "closed, not lost");
}

#[test]
fn sessions_beyond_quota_are_refused_until_loss_is_taken() {
    let mut bench = Bench::with(Limits {
        sessions: 2,
        ..Limits::default()
    });
    assert!(matches!(bench.session(&open(2), 0), Answer::Opened { .. }));
    let full = Refusal::TooManySessions { bound: 2 };
    assert_eq!(refusal(bench.session(&open(3), 1)), full);
    assert_eq!(refusal(bench.session(&open(3), 900)), full);
    while bench.cell.poll(ms(901)).is_some() {}
    assert!(matches!(
        bench.session(&open(3), 902),
        Answer::Opened { session: 3, .. }
    ));
}

#[test]
fn client_name_empty_long_or_with_control_is_refused() {
    let mut bench = Bench::new();
    for name in [String::new(), "x".repeat(65), "a\nb".to_owned()] {
        let mut request = open(2);
        if let SessionRequest::Open { client, .. } = &mut request {
            *client = name;
        }
        let why = refusal(bench.session(&request, 1));
        assert_eq!(why, Refusal::BadName { bound: 64 });
    }
}

#[test]
fn reply_beyond_bound_states_omitted_lines() {
    let mut bench = Bench::with(Limits {
        reply_bytes: 10,
        ..Limits::default()
    });
    bench.send(&bench.command(1, "x"), 0);
    let lines = ["12345", "12345", "1", ""].map(str::to_owned).to_vec();
    let reply = bench.cell.finish(bench.session, 1, lines).unwrap();
    assert!(matches!(&reply, Reply::Done { lines, omitted: 2, .. } if lines.len() == 2));
}

#[test]
fn messages_survive_json() {
    let bench = Bench::new();
    let command = bench.command(1, "a \"quoted\" line");
    let text = to_json(&command);
    assert_eq!(
        serde_json::from_str::<CommandRequest>(&text).unwrap(),
        command
    );
    let late = Refusal::Late { late_ns: -1 };
    let reply = Reply::Refused {
        boot: BOOT,
        now_ns: 1,
        text: late.to_string(),
        reason: late,
    };
    let text = to_json(&reply);
    assert!(
        text.contains(r#""reason":{"code":"late","late_ns":-1}"#),
        "{text}"
    );
    assert_eq!(serde_json::from_str::<Reply>(&text).unwrap(), reply);
}

#[test]
fn random_numbers_differ() {
    let (mut one, mut other) = (random(), random());
    let mut all: Vec<u128> = (0..1000).flat_map(|_| [one(), other()]).collect();
    all.sort_unstable();
    all.dedup();
    assert_eq!(all.len(), 2000);
}

#[test]
fn notifications_need_a_valid_nonce_and_keep_nothing_alive() {
    let mut bench = Bench::new();
    let (session, nonce) = (bench.session, bench.nonce);
    let asked = Answer::Notify { session, from: 7 };
    assert_eq!(bench.notified(nonce, 7, 499), asked);
    let forged = refusal(bench.notified(Nonce(99), 7, 499));
    assert!(matches!(forged, Refusal::UnknownNonce { .. }), "{forged:?}");
    let late = refusal(bench.notified(nonce, 7, 501));
    assert!(matches!(late, Refusal::NoSession { .. }), "{late:?}");
}
