//! The threads that publish telemetry and answer questions. They change nothing.

use std::collections::BTreeMap;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::Duration;

use zenoh::Wait as _;
use zenoh::query::Query;
use zenoh_ext::{AdvancedPublisher, AdvancedPublisherBuilderExt as _, CacheConfig};

use super::{Shared, TELEMETRY_PERIOD, TOPICS_MAX, refuse, reply};
use crate::keys;
use crate::session::SessionError;

/// Answers queries of information and resources.
pub(super) fn answer(shared: &Shared, queue: &Receiver<Query>) {
    while !shared.ends() {
        match queue.recv_timeout(Duration::from_millis(100)) {
            Ok(query) => read(shared, &query),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return,
        }
    }
}

/// Reading may be asked of several cells, but of one resource: `takt/*/resource/nets`.
fn read(shared: &Shared, query: &Query) {
    let asked = query.key_expr().as_str();
    let rest = asked.splitn(3, '/').nth(2).unwrap_or_default();
    if rest == "info" {
        return reply(query, &shared.keys.info(), shared.info());
    }
    let Some(path) = rest.strip_prefix("resource/") else {
        return refuse(query, "only `info` and `resource/…` are answered");
    };
    if !keys::is_exact(path) {
        return refuse(
            query,
            "a resource is named without wildcard\nhint: resource/PATH",
        );
    }
    match shared.cell.resource(path) {
        Some(value) => reply(query, &shared.keys.resource(path), value.to_string()),
        None => refuse(query, &format!("there is no resource `{path}`")),
    }
}

struct Published<'a> {
    publisher: AdvancedPublisher<'a>,
    last: String,
}

/// Publishes what has changed, each period, and looks for a cell of the same name.
pub(super) fn publish(shared: &Shared) {
    let mut published = BTreeMap::new();
    let mut is_full = false;
    let mut failure = Failure::default();
    while !shared.ends() {
        let mut topics = shared.cell.telemetry();
        let is_over = topics.len() >= TOPICS_MAX;
        if is_over && !is_full {
            let count = topics.len();
            tracing::warn!("{count} topics of telemetry; only {TOPICS_MAX} are published");
        }
        is_full = is_over;
        topics.truncate(TOPICS_MAX - 1);
        let mut now: BTreeMap<_, _> = topics
            .into_iter()
            .map(|(rest, value)| (shared.keys.of(&rest), value.to_string()))
            .collect();
        now.insert(shared.keys.info(), shared.info());
        published.retain(|key, _: &mut Published<'_>| now.contains_key(key));
        let updated: Vec<_> = now
            .into_iter()
            .map(|(key, text)| update(shared, &mut published, key, text))
            .chain([look_for_clash(shared)])
            .collect();
        failure.note(updated.into_iter().find_map(Result::err));
        std::thread::park_timeout(TELEMETRY_PERIOD);
    }
}

fn update<'a>(
    shared: &'a Shared,
    published: &mut BTreeMap<String, Published<'a>>,
    key: String,
    text: String,
) -> Result<(), SessionError> {
    if !published.contains_key(&key) {
        let publisher = shared.session.declare_publisher(key.clone());
        let publisher = publisher
            .cache(CacheConfig::default().max_samples(1))
            .publisher_detection();
        let publisher = publisher
            .wait()
            .map_err(SessionError::of("cannot declare a topic"))?;
        let last = String::new();
        published.insert(key.clone(), Published { publisher, last });
    }
    if let Some(topic) = published.get_mut(&key).filter(|topic| topic.last != text) {
        let put = topic.publisher.put(text.as_str()).wait();
        put.map_err(SessionError::of("cannot publish a topic"))?;
        topic.last = text;
    }
    Ok(())
}

/// Reports at its onset that the network takes nothing, and once that it does again.
#[derive(Debug, Default)]
struct Failure(bool);

impl Failure {
    fn note(&mut self, error: Option<SessionError>) {
        let did = std::mem::replace(&mut self.0, error.is_some());
        match error {
            Some(why) if !did => {
                tracing::warn!(
                    "telemetry of the fleet is not complete: {why}\nhint: restart the controller if it lasts"
                );
            }
            None if did => tracing::info!("telemetry of the fleet is complete again"),
            _ => {}
        }
    }
}

fn look_for_clash(shared: &Shared) -> Result<(), SessionError> {
    let clashes = shared.finds_clash()?;
    let did = shared.clashes.swap(clashes, Ordering::AcqRel);
    let name = shared.keys.cell();
    match (did, clashes) {
        (false, true) => tracing::error!(
            "another controller has joined the fleet with the name `{name}`; commands to the other are refused here by the boot id\n\
             hint: set another fleet.cell in one of the two cell files"
        ),
        (true, false) => tracing::info!("no other controller has the name `{name}` any more"),
        _ => {}
    }
    Ok(())
}
