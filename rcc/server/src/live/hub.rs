//! Channels, the clients that subscribed them, and a bounded queue for each client. It moves no bytes and derives no message.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use serde_json::Value;
use takt_core::Error;
use takt_core::record::{Sink, Stamp};
use tokio::sync::Notify;

use crate::live::wire;
use crate::site::Counters;

/// Most subscriptions of a client.
pub(crate) const SUBSCRIPTIONS_MAX: usize = 4096;
/// Most messages that wait for a client; the oldest are dropped first.
pub(crate) const QUEUE_MAX: usize = 32_768;
/// Most bytes of messages that wait for a client.
pub(crate) const QUEUE_BYTES_MAX: usize = 8 << 20;
/// Most texts, such as announcements of channels, that wait for a client; one with more is disconnected.
const TEXTS_MAX: usize = 16_384;
/// Most bytes of such texts that wait for a client.
const TEXT_BYTES_MAX: usize = 32 << 20;
/// The topic whose last message is sent to each new subscriber: it does not come again.
const LATCHED: &str = "/tf_static";

/// A message that waits for a client.
#[derive(Clone, Debug)]
pub(crate) struct Outgoing {
    pub(crate) subscription: u32,
    pub(crate) time: u64,
    pub(crate) data: Arc<[u8]>,
}

#[derive(Debug, Default)]
struct Queue {
    /// Channels by subscription.
    subscriptions: BTreeMap<u32, u16>,
    messages: VecDeque<Outgoing>,
    bytes: usize,
    texts: VecDeque<String>,
    text_bytes: usize,
    /// Messages dropped since the last report.
    dropped: u64,
    /// It did not take its texts.
    is_over: bool,
}

/// What waits for a client.
#[derive(Debug, Default)]
pub(crate) struct Waiting {
    pub(crate) texts: Vec<String>,
    pub(crate) messages: Vec<Outgoing>,
    /// Messages dropped since the last call.
    pub(crate) dropped: u64,
    /// The client is to be disconnected: it does not take its texts.
    pub(crate) is_over: bool,
}

/// The queue of a client.
#[derive(Debug, Default)]
struct Mailbox {
    queue: Mutex<Queue>,
    filled: Notify,
}

impl Mailbox {
    fn lock(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn text(&self, text: String) {
        let mut queue = self.lock();
        let bytes = queue.text_bytes + text.len();
        if queue.texts.len() >= TEXTS_MAX || bytes > TEXT_BYTES_MAX {
            queue.is_over = true;
        } else {
            queue.text_bytes = bytes;
            queue.texts.push_back(text);
        }
        drop(queue);
        self.filled.notify_one();
    }
}

impl Queue {
    fn push(&mut self, message: Outgoing) {
        self.bytes += message.data.len();
        self.messages.push_back(message);
        while self.messages.len() > QUEUE_MAX || self.bytes > QUEUE_BYTES_MAX {
            let Some(oldest) = self.messages.pop_front() else {
                break;
            };
            self.bytes -= oldest.data.len();
            self.dropped += 1;
        }
    }
}

#[derive(Debug)]
struct Channel {
    topic: String,
    announcement: Value,
    last: Option<(u64, Arc<[u8]>)>,
}

#[derive(Debug, Default)]
struct State {
    channels: BTreeMap<u16, Channel>,
    clients: BTreeMap<u64, Arc<Mailbox>>,
    next: u64,
}

/// Channels and clients.
#[derive(Debug, Default)]
pub(crate) struct Hub {
    state: Mutex<State>,
    /// Messages that slow clients lost, and rows that were overwritten before they were read.
    pub(crate) counters: Arc<Counters>,
}

/// A connected client; dropping it ends its subscriptions.
#[derive(Debug)]
pub(crate) struct Client {
    hub: Arc<Hub>,
    number: u64,
    mailbox: Arc<Mailbox>,
}

impl Drop for Client {
    fn drop(&mut self) {
        self.hub.lock().clients.remove(&self.number);
    }
}

impl Hub {
    /// A hub that counts there what is lost.
    pub(crate) fn new(counters: Arc<Counters>) -> Self {
        Self {
            state: Mutex::default(),
            counters,
        }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds a client, to which the channels are announced after `first`.
    pub(crate) fn enter(self: &Arc<Self>, first: Vec<Value>) -> Client {
        let mailbox = Arc::new(Mailbox::default());
        let mut state = self.lock();
        let number = state.next;
        state.next += 1;
        first.iter().for_each(|text| mailbox.text(text.to_string()));
        let channels: Vec<_> = state.channels.values().map(|it| &it.announcement).collect();
        if !channels.is_empty() {
            mailbox.text(wire::advertise(&channels).to_string());
        }
        state.clients.insert(number, Arc::clone(&mailbox));
        drop(state);
        Client {
            hub: Arc::clone(self),
            number,
            mailbox,
        }
    }

    /// Number of clients.
    pub(crate) fn clients(&self) -> usize {
        self.lock().clients.len()
    }

    /// The channels that any client subscribed.
    pub(crate) fn wanted(&self) -> BTreeSet<u16> {
        let clients: Vec<_> = self.lock().clients.values().cloned().collect();
        let mut wanted = BTreeSet::new();
        for client in clients {
            wanted.extend(client.lock().subscriptions.values());
        }
        wanted
    }

    fn announce(state: &State, text: &Value) {
        let text = text.to_string();
        state.clients.values().for_each(|it| it.text(text.clone()));
    }

    fn open(&self, topic: &str, schema: &str, text: &str) -> Option<u16> {
        let mut state = self.lock();
        let id = (1..u16::MAX).find(|id| !state.channels.contains_key(id))?;
        let announcement = wire::channel(id.into(), topic, schema, text);
        Self::announce(&state, &wire::advertise(&[&announcement]));
        let channel = Channel {
            topic: topic.to_owned(),
            announcement,
            last: None,
        };
        state.channels.insert(id, channel);
        Some(id)
    }

    fn close(&self, id: u16) {
        let mut state = self.lock();
        if state.channels.remove(&id).is_none() {
            return;
        }
        for client in state.clients.values() {
            client
                .lock()
                .subscriptions
                .retain(|_, channel| *channel != id);
        }
        Self::announce(&state, &wire::unadvertise(&[id.into()]));
    }

    /// Distributes messages: channel, time and content, in order.
    fn deliver(&self, messages: &[(u16, u64, Arc<[u8]>)]) {
        let clients: Vec<_> = self.lock().clients.values().cloned().collect();
        for client in clients {
            let mut queue = client.lock();
            let mut by_channel: BTreeMap<u16, Vec<u32>> = BTreeMap::new();
            for (subscription, channel) in &queue.subscriptions {
                by_channel.entry(*channel).or_default().push(*subscription);
            }
            let dropped = queue.dropped;
            for (channel, time, data) in messages {
                for subscription in by_channel.get(channel).into_iter().flatten() {
                    queue.push(Outgoing {
                        subscription: *subscription,
                        time: *time,
                        data: Arc::clone(data),
                    });
                }
            }
            Counters::add(&self.counters.live_dropped, queue.dropped - dropped);
            let is_filled = !queue.messages.is_empty();
            drop(queue);
            if is_filled {
                client.filled.notify_one();
            }
        }
    }
}

impl Client {
    /// Waits until something waits for it.
    pub(crate) async fn filled(&self) {
        self.mailbox.filled.notified().await;
    }

    /// Takes what waits for it, of messages at most `bytes`.
    pub(crate) fn take(&self, bytes: usize) -> Waiting {
        let mut queue = self.mailbox.lock();
        let mut waiting = Waiting {
            texts: std::mem::take(&mut queue.texts).into(),
            messages: Vec::new(),
            dropped: std::mem::take(&mut queue.dropped),
            is_over: queue.is_over,
        };
        queue.text_bytes = 0;
        let mut taken = 0;
        while taken < bytes
            && let Some(message) = queue.messages.pop_front()
        {
            queue.bytes -= message.data.len();
            taken += message.data.len();
            waiting.messages.push(message);
        }
        let has_more = !queue.messages.is_empty();
        drop(queue);
        if has_more {
            self.mailbox.filled.notify_one();
        }
        waiting
    }

    /// Adds subscriptions; returns why some were not.
    pub(crate) fn subscribe(&self, pairs: &[(u32, u32)]) -> Option<String> {
        let state = self.hub.lock();
        let mut queue = self.mailbox.lock();
        let mut refused = None;
        for (subscription, channel) in pairs {
            let known = u16::try_from(*channel).ok();
            let known = known.and_then(|id| Some((id, state.channels.get(&id)?)));
            let Some((id, channel)) = known else {
                refused = Some(format!("there is no channel {channel}"));
                continue;
            };
            if queue.subscriptions.len() >= SUBSCRIPTIONS_MAX {
                refused = Some(format!(
                    "at most {SUBSCRIPTIONS_MAX} subscriptions are possible"
                ));
                break;
            }
            if queue.subscriptions.contains_key(subscription) {
                refused = Some(format!("subscription {subscription} exists already"));
                continue;
            }
            queue.subscriptions.insert(*subscription, id);
            if let Some((time, data)) = &channel.last {
                queue.push(Outgoing {
                    subscription: *subscription,
                    time: *time,
                    data: Arc::clone(data),
                });
                self.mailbox.filled.notify_one();
            }
        }
        refused
    }

    /// Ends subscriptions; what waits for them is still sent.
    pub(crate) fn unsubscribe(&self, subscriptions: &[u32]) {
        let mut queue = self.mailbox.lock();
        for subscription in subscriptions {
            queue.subscriptions.remove(subscription);
        }
    }
}

/// Messages of one poll on their way to the clients.
#[derive(Debug)]
pub(crate) struct Batch<'h> {
    hub: &'h Hub,
    wanted: BTreeSet<u16>,
    latched: Option<u16>,
    messages: Vec<(u16, u64, Arc<[u8]>)>,
}

impl<'h> Batch<'h> {
    /// A batch of the channels that are subscribed now.
    pub(crate) fn new(hub: &'h Hub) -> Self {
        let state = hub.lock();
        let mut channels = state.channels.iter();
        let latched = channels.find(|(_, it)| it.topic == LATCHED);
        let latched = latched.map(|(id, _)| *id);
        drop(state);
        Self {
            wanted: hub.wanted(),
            hub,
            latched,
            messages: Vec::new(),
        }
    }

    /// Whether any channel is subscribed.
    pub(crate) fn wants_any(&self) -> bool {
        !self.wanted.is_empty()
    }

    /// Hands the messages to the clients.
    pub(crate) fn deliver(self) {
        let latched = |it: &&(u16, u64, Arc<[u8]>)| Some(it.0) == self.latched;
        if let Some((id, time, data)) = self.messages.iter().rfind(latched)
            && let Some(channel) = self.hub.lock().channels.get_mut(id)
        {
            channel.last = Some((*time, Arc::clone(data)));
        }
        self.hub.deliver(&self.messages);
    }
}

impl Sink for Batch<'_> {
    fn channel(&mut self, topic: &str, schema: &str, text: &str) -> Result<u16, Error> {
        let id = self
            .hub
            .open(topic, schema, text)
            .ok_or_else(|| Error::TooMany {
                item: "live channels",
                bound: u16::MAX.into(),
            })?;
        if topic == LATCHED {
            self.latched = Some(id);
        }
        Ok(id)
    }

    fn close(&mut self, channel: u16) {
        self.hub.close(channel);
    }

    fn wants(&self, channel: u16) -> bool {
        self.wanted.contains(&channel) || self.latched == Some(channel)
    }

    fn message(&mut self, channel: u16, data: &[u8], at: Stamp) -> Result<(), Error> {
        if self.wants(channel) {
            self.messages.push((channel, at.0, data.into()));
        }
        Ok(())
    }
}
