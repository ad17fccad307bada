//! The thread that publishes joints of devices, in batches, and only while a subscriber is there. Batches carry no number and are dropped
//! if the link is slow: a subscriber sees lost samples by their times.

use std::collections::BTreeMap;
use std::time::Duration;

use zenoh::Wait as _;
use zenoh::pubsub::Publisher;
use zenoh::qos::CongestionControl;

use super::publish::Failure;
use super::{Shared, TOPICS_MAX};
use crate::session::SessionError;

/// Time from one batch to the next.
const BATCH_PERIOD: Duration = Duration::from_millis(50);

/// Publishes joints until the member leaves.
pub(super) fn publish(shared: &Shared) {
    let mut topics = BTreeMap::new();
    let mut failure = Failure::default();
    while !shared.ends() {
        failure.note(update(shared, &mut topics).err());
        std::thread::park_timeout(BATCH_PERIOD);
    }
}

fn update<'a>(
    shared: &'a Shared,
    topics: &mut BTreeMap<String, Publisher<'a>>,
) -> Result<(), SessionError> {
    let mut arms = shared.cell.arms();
    arms.truncate(TOPICS_MAX);
    topics.retain(|name, _| arms.contains(name));
    for name in arms {
        if !topics.contains_key(&name) {
            let key = shared.keys.device_joints(&name);
            let topic = shared.session.declare_publisher(key);
            let topic = topic.congestion_control(CongestionControl::Drop).wait();
            let topic = topic.map_err(SessionError::of("cannot declare joints"))?;
            topics.insert(name, topic);
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
