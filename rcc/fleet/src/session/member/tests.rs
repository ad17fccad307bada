//! Two cells and an observer in one process, over loopback. The cells have a clock that a test sets, so that no nonce expires by chance.

use std::net::TcpListener;
use std::sync::Mutex;
use std::sync::atomic::AtomicI64;
use std::time::Duration;

use serde_json::{Value, json};
use takt_core::Nanos;
use takt_core::tai::Tai;
use zenoh_ext::{AdvancedSubscriberBuilderExt as _, HistoryConfig};

use super::*;
use crate::command::{
    CommandRequest, LossPolicy, Lost, Nonce, OpenId, Refusal, Reply, SessionRequest, to_json,
};
use crate::config::{FleetMode, FleetRight, FleetRule, Observer, of_observer};
use crate::keys::{ALL_ALIVE, cell_of_alive};
use crate::session::observer::{Fleet, Seen};
use crate::session::remote::Remote;
use crate::session::tunnel;
use takt_client::wire::Message;

/// Upper bound for a reply that must arrive.
const ARRIVES: Duration = Duration::from_secs(20);
/// For replies that must not arrive.
const DENIED: Duration = Duration::from_millis(500);

mod starts;

#[derive(Default)]
struct Bench {
    now: AtomicI64,
    /// Its part in coordinated starts.
    starts: starts::Part,
    /// Commands `wait` end when this is set.
    is_released: AtomicBool,
    /// The clock runs by itself.
    is_real: bool,
    executed: Mutex<Vec<String>>,
    lost: Mutex<Vec<u32>>,
    /// What sessions are notified of.
    notices: Mutex<Vec<String>>,
    /// None of them is notified of anything until this is over.
    holds: AtomicBool,
    /// Why they are notified of nothing any more.
    mute: Mutex<Option<String>>,
    /// Devices whose joints are subscribed to.
    wanted: Mutex<Vec<String>>,
}

impl Cell for Bench {
    fn now(&self) -> Nanos {
        if self.is_real {
            return takt_core::monotonic();
        }
        Nanos(self.now.load(Ordering::SeqCst))
    }

    fn info(&self) -> serde_json::Map<String, Value> {
        serde_json::Map::from_iter([("version".to_owned(), json!("1"))])
    }

    fn telemetry(&self) -> Vec<Topic> {
        vec![("device/left/state".to_owned(), json!("operational"))]
    }

    fn devices(&self) -> Vec<String> {
        vec!["left".to_owned()]
    }

    fn arms(&self) -> Vec<String> {
        vec!["left".to_owned()]
    }

    fn joints(&self, devices: &[String]) -> Vec<(String, Value)> {
        *self.wanted.lock().unwrap() = devices.to_vec();
        let batch = |name: &String| (name.clone(), json!([0.5]));
        devices.iter().map(batch).collect()
    }

    fn log(&self, from: u64) -> (Vec<String>, u64) {
        let lines = ["first", "second"].map(str::to_owned);
        let from = usize::try_from(from).unwrap();
        (lines.into_iter().skip(from).collect(), 2)
    }

    fn resource(&self, path: &str) -> Result<Value, String> {
        let there = (path == "nets").then(|| json!([1, 2]));
        there.ok_or_else(|| format!("there is no resource `{path}`"))
    }

    fn opened(&self, _session: u32, _client: &str, _on_loss: LossPolicy) {}

    fn execute(&self, _session: u32, line: &str) -> Vec<String> {
        self.executed.lock().unwrap().push(line.to_owned());
        while line == "wait" && !self.is_released.load(Ordering::SeqCst) {
            std::thread::yield_now();
        }
        if line == "second" {
            std::thread::sleep(Duration::from_secs(1));
        }
        if let Ok(message) = Message::decode(line) {
            let text = "x".repeat(if message.command == "long" {
                1 << 20
            } else {
                1
            });
            return vec![Message::new(message.tag, "ok").with(text).to_string()];
        }
        vec![format!("did {line}")]
    }

    fn notifications(&self, _session: u32, wait: Duration) -> Result<Vec<String>, String> {
        if let Some(why) = self.mute.lock().unwrap().clone() {
            return Err(why);
        }
        while self.holds.load(Ordering::SeqCst) {
            std::thread::yield_now();
        }
        let lines = std::mem::take(&mut *self.notices.lock().unwrap());
        if lines.is_empty() {
            std::thread::sleep(wait / 20);
        }
        Ok(lines)
    }

    fn closed(&self, _session: u32) {}

    fn lost(&self, lost: Lost) {
        self.lost.lock().unwrap().push(lost.session);
    }

    fn clock_id(&self) -> String {
        self.starts.clock.clone()
    }

    fn tai(&self) -> Tai {
        self.starts.tai()
    }

    fn prepare_start(&self, nets: &[String]) -> Result<Box<dyn Held>, String> {
        self.starts.prepare(nets)
    }
}

/// A program at this endpoint.
fn connected(endpoint: &str) -> Fleet {
    Fleet::connect(&Observer {
        connect: vec![endpoint.to_owned()],
        tls: None,
    })
    .unwrap()
}

fn free_endpoint() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    format!("tcp/{}", listener.local_addr().unwrap())
}

/// The router of a line: a cell at which the others and the tools arrive.
fn router(endpoint: &str) -> FleetSettings {
    FleetSettings {
        mode: FleetMode::Router,
        listen: Some(vec![endpoint.to_owned()]),
        allow: vec![FleetRule {
            certificates: Vec::new(),
            rights: vec![FleetRight::Read, FleetRight::Command],
        }],
        ..FleetSettings::default()
    }
}

fn joined(name: &str, settings: &FleetSettings, cell: &Arc<Bench>) -> Result<Member, JoinError> {
    let cell: Arc<dyn Cell> = Arc::<Bench>::clone(cell);
    let name = CellName::new(name).unwrap();
    Member::join(&name, settings, Limits::default(), cell)
}

fn observer(endpoint: &str) -> zenoh::Session {
    let observer = Observer {
        connect: vec![endpoint.to_owned()],
        tls: None,
    };
    open(&of_observer(&observer).unwrap()).unwrap()
}

/// The values of all replies, and the texts of all refusals.
fn ask(from: &zenoh::Session, key: &str, payload: &str, timeout: Duration) -> Vec<String> {
    let replies = from.get(key).payload(payload).timeout(timeout).wait();
    let replies = replies.unwrap();
    let texts = std::iter::from_fn(|| replies.recv().ok()).map(|reply| {
        let bytes = match reply.result() {
            Ok(sample) => sample.payload().to_bytes().into_owned(),
            Err(error) => error.payload().to_bytes().into_owned(),
        };
        String::from_utf8(bytes).unwrap()
    });
    texts.collect()
}

fn call(from: &zenoh::Session, key: &str, payload: &str) -> Reply {
    let replies = ask(from, key, payload, ARRIVES);
    serde_json::from_str(&replies[0]).unwrap()
}

fn alive(from: &zenoh::Session) -> Vec<String> {
    let tokens = from.liveliness().get(ALL_ALIVE).timeout(ARRIVES).wait();
    let tokens = tokens.unwrap();
    let keys = std::iter::from_fn(|| tokens.recv().ok());
    let mut names: Vec<_> = keys
        .filter_map(|reply| {
            let sample = reply.into_result().ok()?;
            cell_of_alive(sample.key_expr().as_str()).map(str::to_owned)
        })
        .collect();
    names.sort();
    names
}

#[test]
fn two_cells_are_seen_read_and_found_by_late_joiner() {
    let endpoint = free_endpoint();
    let (first, second) = (Arc::new(Bench::default()), Arc::new(Bench::default()));
    let a = joined("cell-a", &router(&endpoint), &first).unwrap();
    let settings = FleetSettings {
        connect: vec![endpoint.clone()],
        ..FleetSettings::default()
    };
    let b = joined("cell-b", &settings, &second).unwrap();
    let observer = observer(&endpoint);
    while alive(&observer) != ["cell-a", "cell-b"] {
        std::thread::yield_now();
    }
    let nets = "takt/cell-a/resource/nets";
    assert_eq!(ask(&observer, nets, "", ARRIVES), ["[1,2]"]);
    let none = ask(&observer, "takt/cell-a/resource/x", "", ARRIVES);
    assert_eq!(none, ["there is no resource `x`"]);
    assert_eq!(ask(&observer, "takt/*/info", "", ARRIVES).len(), 2);
    // Published once, before this subscriber came.
    let history = HistoryConfig::default().detect_late_publishers();
    let subscriber = observer.declare_subscriber("takt/cell-a/device/left/state");
    let subscriber = subscriber.history(history).wait().unwrap();
    let sample = subscriber.recv_timeout(ARRIVES).unwrap().unwrap();
    assert_eq!(*sample.payload().to_bytes(), *b"\"operational\"");
    drop(b);
    while alive(&observer) != ["cell-a"] {
        std::thread::yield_now();
    }
    assert!(!a.clashes());
}

#[test]
fn second_cell_of_a_name_is_refused() {
    let endpoint = free_endpoint();
    let bench = Arc::new(Bench::default());
    let _first = joined("cell-a", &router(&endpoint), &bench).unwrap();
    let settings = FleetSettings {
        connect: vec![endpoint],
        ..FleetSettings::default()
    };
    let error = joined("cell-a", &settings, &bench).unwrap_err();
    assert!(matches!(error, JoinError::Clash(_)), "{error}");
    let other = joined("cell-b", &settings, &bench);
    assert!(other.is_ok(), "{other:?}");
}

/// Opens a session and returns its number and nonce.
fn opened(from: &zenoh::Session, boot: Boot) -> (u32, Nonce) {
    let open = SessionRequest::Open {
        boot,
        open: OpenId(1),
        client: "panel".to_owned(),
        on_loss: LossPolicy::Cancel,
    };
    let reply = call(from, "takt/cell-a/cmd/session", &to_json(&open));
    let Reply::Granted { session, nonce, .. } = reply else {
        panic!("{reply:?}");
    };
    (session, nonce)
}

#[test]
fn command_repeated_or_late_or_to_all_cells_is_not_executed() {
    let endpoint = free_endpoint();
    let bench = Arc::new(Bench::default());
    let cell = joined("cell-a", &router(&endpoint), &bench).unwrap();
    let observer = observer(&endpoint);
    let (session, nonce) = opened(&observer, cell.boot());
    let request = |seq| {
        to_json(&CommandRequest {
            boot: cell.boot(),
            session,
            seq,
            nonce,
            not_after_ns: i64::MAX,
            line: "nets".to_owned(),
        })
    };
    let key = "takt/cell-a/cmd/directio";
    for _ in 0..2 {
        let done = call(&observer, key, &request(1));
        assert!(matches!(done, Reply::Done { seq: 1, .. }), "{done:?}");
    }
    let wild = ask(&observer, "takt/*/cmd/directio", &request(2), DENIED);
    assert!(wild.len() == 1 && wild[0].contains("wildcard"), "{wild:?}");
    assert_eq!(*bench.executed.lock().unwrap(), ["nets"]);
    bench.now.store(600_000_000, Ordering::SeqCst);
    let late = call(&observer, key, &request(2));
    let Reply::Refused { reason, .. } = late else {
        panic!("{late:?}");
    };
    assert_eq!(reason, Refusal::NoSession { session });
    drop(cell);
    assert_eq!(*bench.lost.lock().unwrap(), [session]);
    assert_eq!(*bench.executed.lock().unwrap(), ["nets"]);
}

/// A query with the newest nonce of a session.
fn command(boot: Boot, session: u32, nonce: Nonce, line: &str) -> String {
    to_json(&CommandRequest {
        boot,
        session,
        seq: 1,
        nonce,
        not_after_ns: i64::MAX,
        line: line.to_owned(),
    })
}

#[test]
fn command_that_takes_long_delays_no_other_session() {
    let endpoint = free_endpoint();
    let bench = Arc::new(Bench::default());
    let cell = joined("cell-a", &router(&endpoint), &bench).unwrap();
    let observer = observer(&endpoint);
    let boot = cell.boot();
    let (slow, nonce) = opened(&observer, boot);
    let long = observer.clone();
    let waits = std::thread::spawn(move || {
        call(
            &long,
            "takt/cell-a/cmd/directio",
            &command(boot, slow, nonce, "wait"),
        )
    });
    while bench.executed.lock().unwrap().is_empty() {
        std::thread::yield_now();
    }
    // Meanwhile the session is kept alive, its command is under way, and another session works.
    let renew = SessionRequest::Renew {
        boot,
        session: slow,
        nonce,
    };
    let renewed = call(&observer, "takt/cell-a/cmd/session", &to_json(&renew));
    assert!(matches!(renewed, Reply::Granted { .. }), "{renewed:?}");
    let again = command(boot, slow, nonce, "wait");
    let again = call(&observer, "takt/cell-a/cmd/directio", &again);
    let Reply::Refused { reason, .. } = again else {
        panic!("{again:?}");
    };
    assert_eq!(reason, Refusal::Busy { seq: 1 });
    let open = SessionRequest::Open {
        boot,
        open: OpenId(2),
        client: "other".to_owned(),
        on_loss: LossPolicy::Stop,
    };
    let other = call(&observer, "takt/cell-a/cmd/session", &to_json(&open));
    let Reply::Granted { session, nonce, .. } = other else {
        panic!("{other:?}");
    };
    let quick = command(boot, session, nonce, "quick");
    let done = call(&observer, "takt/cell-a/cmd/directio", &quick);
    assert!(matches!(done, Reply::Done { .. }), "{done:?}");
    bench.is_released.store(true, Ordering::SeqCst);
    let done = waits.join().unwrap();
    assert!(matches!(done, Reply::Done { session, .. } if session == slow));
    assert_eq!(*bench.executed.lock().unwrap(), ["wait", "quick"]);
}

#[test]
fn remote_keeps_session_alive_and_executes_in_order() {
    takt_tests::steady(|| {
        let endpoint = free_endpoint();
        let bench = Arc::new(Bench {
            is_real: true,
            ..Bench::default()
        });
        let _cell = joined("cell-a", &router(&endpoint), &bench).unwrap();
        let fleet = connected(&endpoint);
        let name = CellName::new("cell-a").unwrap();
        let opened = Remote::open(&fleet, &name, "panel", LossPolicy::Cancel);
        let mut remote = opened.unwrap();
        // The second takes twice as long as a nonce lives.
        for line in ["first", "second", "third"] {
            let (lines, omitted) = remote.execute(line, ARRIVES).unwrap();
            assert_eq!((lines, omitted), (vec![format!("did {line}")], 0));
        }
        drop(remote);
        assert_eq!(
            *bench.executed.lock().unwrap(),
            ["first", "second", "third"]
        );
        assert!(bench.lost.lock().unwrap().is_empty(), "it was closed");
        let none = CellName::new("none").unwrap();
        let error = Remote::open(&fleet, &none, "panel", LossPolicy::Cancel).unwrap_err();
        assert!(error.to_string().contains("no answer from none"), "{error}");
    });
}

#[test]
fn client_in_tunnel_gets_replies_and_each_notification_in_order() {
    takt_tests::steady(|| {
        let endpoint = free_endpoint();
        let bench = Arc::new(Bench {
            is_real: true,
            ..Bench::default()
        });
        let _cell = joined("cell-a", &router(&endpoint), &bench).unwrap();
        let fleet = connected(&endpoint);
        let name = CellName::new("cell-a").unwrap();
        let connect = || tunnel::connect(&fleet, &name, "panel", LossPolicy::Cancel).unwrap();
        let client = connect();
        // 1000 notifications of 1 kB each exceed what fits into one reply.
        let line = |number: usize| format!("s=net(\"{number}\",\"{}\")", "y".repeat(1000));
        for hundred in 0..10 {
            let lines = (100 * hundred..100 * (hundred + 1)).map(line);
            bench.notices.lock().unwrap().extend(lines);
            assert_eq!(client.call("nin", ["a"]).unwrap().text(), Some("x"));
        }
        for number in 0..1000 {
            let push = client.next_push(ARRIVES).unwrap().unwrap();
            assert_eq!(push.to_string(), line(number));
        }
        // The program closes: nothing is lost.
        drop(client);
        let begin = std::time::Instant::now();
        while begin.elapsed() < DENIED {
            assert!(bench.lost.lock().unwrap().is_empty());
            std::thread::sleep(DENIED / 10);
        }
        // A command that no message can take is rejected alone; a reply that none can take ends the connection.
        let client = connect();
        let error = client.call("nin", ["z".repeat(2 << 20)]).unwrap_err();
        assert!(error.to_string().contains("at most"), "{error}");
        client.call("nin", ["a"]).unwrap();
        let error = client.call("long", ["a"]).unwrap_err();
        assert!(
            error.to_string().contains("too long for a message"),
            "{error}"
        );
        // So does a notification that none can take.
        let client = connect();
        *bench.notices.lock().unwrap() = vec![format!("s=net(\"{}\")", "y".repeat(1 << 20))];
        let error = last_error(&client);
        assert!(error.contains("too long for a message"), "{error}");
        // And a session that is notified of nothing any more.
        let client = connect();
        *bench.mute.lock().unwrap() = Some("65536 notifications wait unread".to_owned());
        let error = last_error(&client);
        assert!(error.contains("wait unread"), "{error}");
    });
}

/// Why a client is disconnected, once it is.
fn last_error(client: &takt_client::Client) -> String {
    loop {
        if let Err(error) = client.next_push(ARRIVES) {
            return error.to_string();
        }
    }
}

#[test]
fn requests_for_notifications_beyond_bound_are_refused() {
    takt_tests::steady(|| {
        let endpoint = free_endpoint();
        let bench = Arc::new(Bench::default());
        bench.holds.store(true, Ordering::SeqCst);
        let _cell = joined("cell-a", &router(&endpoint), &bench).unwrap();
        let fleet = connected(&endpoint);
        let name = CellName::new("cell-a").unwrap();
        let remote = Remote::open(&fleet, &name, "panel", LossPolicy::Cancel).unwrap();
        let (session, nonce) = remote.permission();
        let request = SessionRequest::Notified {
            boot: remote.boot(),
            session,
            nonce,
            from: 0,
        };
        // One is looked at, four wait.
        let (sender, replies) = std::sync::mpsc::channel();
        for _ in 0..20 {
            let sender = sender.clone();
            let get = fleet.session().get("takt/cell-a/cmd/session");
            let take = move |reply: zenoh::query::Reply| {
                let text = match reply.result() {
                    Ok(sample) => sample.payload().to_bytes().into_owned(),
                    Err(error) => error.payload().to_bytes().into_owned(),
                };
                sender.send(String::from_utf8(text).unwrap()).unwrap();
            };
            let get = get.payload(to_json(&request)).timeout(ARRIVES);
            get.callback(take).wait().unwrap();
        }
        for _ in 0..15 {
            let refused = replies.recv_timeout(ARRIVES).unwrap();
            assert!(refused.contains("too many queries wait"), "{refused}");
        }
        bench.holds.store(false, Ordering::SeqCst);
        for _ in 0..5 {
            let said = replies.recv_timeout(ARRIVES).unwrap();
            assert!(said.contains("\"notified\""), "{said}");
        }
    });
}

#[test]
fn client_in_tunnel_learns_that_its_cell_is_gone() {
    takt_tests::steady(|| {
        let endpoint = free_endpoint();
        let bench = Arc::new(Bench {
            is_real: true,
            ..Bench::default()
        });
        let cell = joined("cell-a", &router(&endpoint), &bench).unwrap();
        let fleet = connected(&endpoint);
        let name = CellName::new("cell-a").unwrap();
        let client = tunnel::connect(&fleet, &name, "panel", LossPolicy::Cancel).unwrap();
        drop(cell);
        let error = last_error(&client);
        assert!(
            error.contains("cell-a closed the connection after"),
            "{error}"
        );
        let causes = ["is lost", "no session", "leaves the fleet"];
        assert!(causes.iter().any(|cause| error.contains(cause)), "{error}");
    });
}

#[test]
fn watch_shows_history_log_tokens_and_loss() {
    let endpoint = free_endpoint();
    let bench = Arc::new(Bench::default());
    let _router = joined("cell-a", &router(&endpoint), &bench).unwrap();
    let settings = FleetSettings {
        connect: vec![endpoint.clone()],
        ..FleetSettings::default()
    };
    let cell = joined("cell-b", &settings, &bench).unwrap();
    let fleet = connected(&endpoint);
    let watch = fleet.watch("takt/cell-b/**").unwrap();
    let value = |rest: &str, text: &str| Seen::Value {
        key: format!("takt/cell-b/{rest}"),
        text: text.to_owned(),
    };
    let alive = |rest: &str| Seen::Alive {
        key: format!("takt/cell-b/{rest}"),
    };
    let mut missing = vec![
        value("device/left/state", "\"operational\""),
        value("log", "\"first\""),
        value("log", "\"second\""),
        alive("alive"),
        alive("device/left/alive"),
    ];
    while !missing.is_empty() {
        let seen = watch.next(ARRIVES).unwrap();
        missing.retain(|it| *it != seen);
    }
    drop(cell);
    let lost = Seen::Lost {
        key: "takt/cell-b/alive".to_owned(),
    };
    while watch.next(ARRIVES).unwrap() != lost {}
    assert_eq!(watch.missed(), 0);
}

#[test]
fn joints_are_published_while_subscribed_to() {
    let endpoint = free_endpoint();
    let bench = Arc::new(Bench::default());
    let _cell = joined("cell-a", &router(&endpoint), &bench).unwrap();
    let observer = observer(&endpoint);
    assert!(bench.wanted.lock().unwrap().is_empty());
    let joints = observer.declare_subscriber("takt/cell-a/device/left/joints");
    let joints = joints.wait().unwrap();
    let sample = joints.recv_timeout(ARRIVES).unwrap().unwrap();
    assert_eq!(*sample.payload().to_bytes(), *b"[0.5]");
    assert_eq!(*bench.wanted.lock().unwrap(), ["left"]);
    joints.undeclare().wait().unwrap();
    while !bench.wanted.lock().unwrap().is_empty() {
        std::thread::yield_now();
    }
}
