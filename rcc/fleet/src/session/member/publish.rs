//! The threads that publish telemetry and answer questions. They change nothing.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::Duration;

use zenoh::Wait as _;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Publisher;
use zenoh::qos::CongestionControl;
use zenoh::query::Query;
use zenoh_ext::{
    AdvancedPublisher, AdvancedPublisherBuilderExt as _, CacheConfig, MissDetectionConfig,
};

use super::reach::Reach;
use super::shared::{LOG_LINES_KEPT, Shared, TELEMETRY_PERIOD, TOPICS_MAX, refuse, reply};
use crate::keys;
use crate::session::SessionError;

/// How often the number of the newest line of the log is sent, so that a subscriber misses the last one no longer than this.
const LOG_HEARTBEAT: Duration = Duration::from_millis(500);

/// Time from one batch to the next.
const BATCH_PERIOD: Duration = Duration::from_millis(50);

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
        Ok(value) => reply(query, &shared.keys.resource(path), value.to_string()),
        Err(why) => refuse(query, &why),
    }
}

struct Published<'a> {
    publisher: AdvancedPublisher<'a>,
    last: String,
}

/// What the thread that publishes keeps.
struct Publication<'a> {
    shared: &'a Shared,
    topics: BTreeMap<String, Published<'a>>,
    is_full: bool,
    log: Option<AdvancedPublisher<'a>>,
    /// Number of the next line of the log.
    line: u64,
    devices: BTreeMap<String, LivelinessToken>,
}

/// Publishes what has changed, each period, and looks for a cell of the same name and for links.
pub(super) fn publish(shared: &Shared) {
    let mut publication = Publication {
        shared,
        topics: BTreeMap::new(),
        is_full: false,
        log: None,
        line: 0,
        devices: BTreeMap::new(),
    };
    let mut failure = Failure::default();
    let mut reach = Reach::new(&shared.connect);
    while !shared.ends() {
        let results = [
            publication.update_topics(),
            publication.update_log(),
            publication.update_devices(),
            look_for_clash(shared),
        ];
        failure.note(results.into_iter().find_map(Result::err));
        let info = shared.session.info();
        let links = info.routers_zid().wait().count() + info.peers_zid().wait().count();
        reach.handle(links);
        std::thread::park_timeout(TELEMETRY_PERIOD);
    }
}

impl Publication<'_> {
    /// All topics are tried; returns the first error.
    fn update_topics(&mut self) -> Result<(), SessionError> {
        let shared = self.shared;
        let mut topics = shared.cell.telemetry();
        let is_over = topics.len() >= TOPICS_MAX;
        if is_over && !self.is_full {
            let count = topics.len();
            tracing::warn!("{count} topics of telemetry; only {TOPICS_MAX} are published");
        }
        self.is_full = is_over;
        topics.truncate(TOPICS_MAX - 1);
        let mut now: BTreeMap<_, _> = topics
            .into_iter()
            .map(|(rest, value)| (shared.keys.of(&rest), value.to_string()))
            .collect();
        now.insert(shared.keys.info(), shared.info());
        self.topics.retain(|key, _| now.contains_key(key));
        let updated: Vec<_> = now
            .into_iter()
            .map(|(key, text)| self.update(key, text))
            .collect();
        updated.into_iter().collect()
    }

    fn update(&mut self, key: String, text: String) -> Result<(), SessionError> {
        if !self.topics.contains_key(&key) {
            let publisher = declare(self.shared, key.clone(), 1, MissDetectionConfig::default())?;
            let last = String::new();
            self.topics
                .insert(key.clone(), Published { publisher, last });
        }
        if let Some(topic) = self.topics.get_mut(&key).filter(|topic| topic.last != text) {
            let put = topic.publisher.put(text.as_str()).wait();
            put.map_err(SessionError::of("cannot publish a topic"))?;
            topic.last = text;
        }
        Ok(())
    }

    /// Publishes each new line of the log.
    fn update_log(&mut self) -> Result<(), SessionError> {
        let shared = self.shared;
        if self.log.is_none() {
            let misses = MissDetectionConfig::default().heartbeat(LOG_HEARTBEAT);
            self.log = Some(declare(shared, shared.keys.log(), LOG_LINES_KEPT, misses)?);
        }
        let (lines, next) = shared.cell.log(self.line);
        self.line = next;
        let Some(log) = &self.log else {
            return Ok(());
        };
        // Of a log that was long before this cell joined, what a late joiner gets anyway.
        for line in lines
            .iter()
            .skip(lines.len().saturating_sub(LOG_LINES_KEPT))
        {
            let text = serde_json::Value::from(line.as_str()).to_string();
            let put = log.put(text).wait();
            put.map_err(SessionError::of("cannot publish the log"))?;
        }
        Ok(())
    }

    /// Declares and withdraws the tokens of devices.
    fn update_devices(&mut self) -> Result<(), SessionError> {
        let mut answering = self.shared.cell.devices();
        answering.truncate(TOPICS_MAX);
        self.devices.retain(|name, _| answering.contains(name));
        for name in answering {
            if self.devices.contains_key(&name) {
                continue;
            }
            let key = self.shared.keys.device_alive(&name);
            let token = self.shared.session.liveliness().declare_token(key).wait();
            let token = token.map_err(SessionError::of("cannot declare a device alive"))?;
            self.devices.insert(name, token);
        }
        Ok(())
    }
}

/// A publisher that numbers its samples and keeps the last ones for late joiners.
fn declare(
    shared: &Shared,
    key: String,
    kept: usize,
    misses: MissDetectionConfig,
) -> Result<AdvancedPublisher<'_>, SessionError> {
    let publisher = shared.session.declare_publisher(key);
    let publisher = publisher
        .cache(CacheConfig::default().max_samples(kept))
        .sample_miss_detection(misses)
        .publisher_detection();
    publisher
        .wait()
        .map_err(SessionError::of("cannot declare a topic"))
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

/// Publishes joints of devices until the member leaves, in batches, and only while a subscriber is there. Batches carry no number and are
/// dropped if the link is slow: a subscriber sees lost samples by their times.
pub(super) fn publish_joints(shared: &Shared) {
    let mut topics = BTreeMap::new();
    let mut failure = Failure::default();
    while !shared.ends() {
        failure.note(update_joints(shared, &mut topics).err());
        std::thread::park_timeout(BATCH_PERIOD);
    }
}

fn update_joints<'a>(
    shared: &'a Shared,
    topics: &mut BTreeMap<String, Publisher<'a>>,
) -> Result<(), SessionError> {
    let mut arms = shared.cell.arms();
    arms.truncate(TOPICS_MAX);
    topics.retain(|name, _| arms.contains(name));
    for name in arms {
        if let Entry::Vacant(free) = topics.entry(name) {
            let key = shared.keys.device_joints(free.key());
            let topic = shared.session.declare_publisher(key);
            let topic = topic.congestion_control(CongestionControl::Drop).wait();
            free.insert(topic.map_err(SessionError::of("cannot declare joints"))?);
        }
    }
    let mut wanted = Vec::new();
    for (name, topic) in &*topics {
        let matching = topic.matching_status().wait();
        let matching = matching.map_err(SessionError::of("cannot look for subscribers"))?;
        if matching.matching() {
            wanted.push(name.clone());
        }
    }
    for (name, batch) in shared.cell.joints(&wanted) {
        if let Some(topic) = topics.get(&name) {
            let put = topic.put(batch.to_string()).wait();
            put.map_err(SessionError::of("cannot publish joints"))?;
        }
    }
    Ok(())
}
