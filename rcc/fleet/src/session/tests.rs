//! Two real sessions on loopback: what the access rules of a cell let through.

use std::net::TcpListener;
use std::time::Duration;

use super::*;
use crate::config::{
    FleetRight, FleetRule, FleetSettings, Observer, cell_name, of_cell, of_observer,
};
use crate::keys::{ALL_ALIVE, CellKeys};

/// Upper bound for a reply that must arrive.
const ARRIVES: Duration = Duration::from_secs(20);
/// For replies that must not arrive: that others arrived first shows that the link works.
const DENIED: Duration = Duration::from_millis(500);

/// A cell with queryables at the keys of its info and its commands, and an observer of it.
struct Pair {
    keys: CellKeys,
    _cell: zenoh::Session,
    observer: zenoh::Session,
}

fn pair(allow: Vec<FleetRule>) -> Pair {
    let port = TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap()
        .port();
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let settings = FleetSettings {
        cell: Some("weld3".to_owned()),
        listen: Some(vec![endpoint.clone()]),
        allow,
        ..FleetSettings::default()
    };
    let name = cell_name(&settings).unwrap().unwrap();
    let cell = open(&of_cell(&name, &settings)).unwrap();
    let keys = CellKeys::new(name);
    for key in [keys.info(), keys.cmd_session()] {
        let own = key.clone();
        let answer = move |query: zenoh::query::Query| {
            query.reply(own.as_str(), "yes").wait().unwrap();
        };
        let queryable = cell.declare_queryable(key).callback(answer);
        queryable.background().wait().unwrap();
    }
    let observer = Observer {
        connect: vec![endpoint],
        tls: None,
    };
    let observer = open(&of_observer(&observer).unwrap()).unwrap();
    Pair {
        keys,
        _cell: cell,
        observer,
    }
}

impl Pair {
    /// Number of replies to a query.
    fn replies(&self, key: &str, timeout: Duration) -> usize {
        let replies = self.observer.get(key).timeout(timeout).wait().unwrap();
        let mut count = 0;
        while let Ok(reply) = replies.recv() {
            count += usize::from(reply.result().is_ok());
        }
        count
    }
}

#[test]
fn access_reader_gets_info_and_no_command() {
    let pair = pair(Vec::new());
    assert_eq!(pair.replies("takt/*/info", ARRIVES), 1);
    assert_eq!(pair.replies(&pair.keys.cmd_session(), DENIED), 0);
    assert_eq!(pair.replies("takt/**", DENIED), 0, "it includes commands");
}

#[test]
fn access_with_right_reaches_commands() {
    let pair = pair(vec![FleetRule {
        certificates: Vec::new(),
        rights: vec![FleetRight::Command],
    }]);
    assert_eq!(pair.replies(&pair.keys.cmd_session(), ARRIVES), 1);
    assert_eq!(
        pair.replies("takt/*/cmd/session", DENIED),
        0,
        "of one cell only"
    );
}

#[test]
fn cell_without_own_token_is_not_alive() {
    let pair = pair(Vec::new());
    let tokens = |timeout| {
        let tokens = pair
            .observer
            .liveliness()
            .get(ALL_ALIVE)
            .timeout(timeout)
            .wait()
            .unwrap();
        std::iter::from_fn(|| tokens.recv().ok()).count()
    };
    assert_eq!(tokens(DENIED), 0);
    let token = pair
        ._cell
        .liveliness()
        .declare_token(pair.keys.alive())
        .wait()
        .unwrap();
    while tokens(ARRIVES) == 0 {
        std::thread::yield_now();
    }
    drop(token);
}

#[test]
fn observer_without_cell_fails() {
    let port = TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap()
        .port();
    let observer = Observer {
        connect: vec![format!("tcp/127.0.0.1:{port}")],
        tls: None,
    };
    let error = open(&of_observer(&observer).unwrap()).unwrap_err();
    assert!(
        error.to_string().starts_with("cannot open a session"),
        "{error}"
    );
}
