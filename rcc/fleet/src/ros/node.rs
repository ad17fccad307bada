//! A node of ROS in a zenoh session of its own, as sessions of `rmw_zenoh_cpp` are set up: a peer on this host that connects to a
//! router. Publishing and answering happen on threads of zenoh or of the caller, never in real time. It knows no controller.

use std::sync::atomic::{AtomicI64, AtomicU32, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{SystemTime, UNIX_EPOCH};

use serde_json::json;
use zenoh::liveliness::LivelinessToken;
use zenoh::qos::CongestionControl;
use zenoh::{Session, Wait as _};
use zenoh_ext::{AdvancedPublisher, AdvancedPublisherBuilderExt as _, CacheConfig};

use super::cdr::MESSAGE_MAX;
use super::keys::{Attachment, Kind, NameError, NodeName, Qos, check_name, gid, topic_key};
use super::messages::Nanos;
use super::types::Type;
use crate::session::{self, SessionError};

/// Address of the router that sessions of ROS connect to.
pub const ROUTER: &str = "tcp/localhost:7447";

/// Where a node is, and what it is called.
#[derive(Clone, Debug)]
pub struct NodeConfig {
    /// `ROS_DOMAIN_ID`.
    pub domain: u32,
    /// Namespace, empty or `/cell`.
    pub namespace: String,
    /// Name without slashes.
    pub name: String,
    /// Address of the router, such as [`ROUTER`].
    pub router: String,
}

/// Why there is no node, or no endpoint of it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NodeError {
    /// A name is none of ROS.
    #[error(transparent)]
    Name(#[from] NameError),
    /// The session cannot be opened.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// An endpoint cannot be declared, or a message not sent.
    #[error("{what}: {cause}")]
    Zenoh {
        /// What was tried.
        what: String,
        /// Why it failed.
        cause: String,
    },
}

fn failed<E: ToString>(what: &str) -> impl FnOnce(E) -> NodeError {
    move |error| NodeError::Zenoh {
        what: what.to_owned(),
        cause: error.to_string(),
    }
}

/// A session without discovery by multicast.
fn open(mode: &str, listen: &[&str], connect: &[&str]) -> Result<Session, NodeError> {
    let entries = vec![
        ("mode", json!(mode)),
        ("listen/endpoints", json!(listen)),
        ("connect/endpoints", json!(connect)),
        ("scouting/multicast/enabled", json!(false)),
        // Transient local topics order their messages by time.
        ("timestamping/enabled", json!(true)),
        ("transport/link/rx/max_message_size", json!(MESSAGE_MAX)),
    ];
    Ok(session::open(&entries)?)
}

/// A router for the sessions of ROS on this host, as `ros2 run rmw_zenoh_cpp rmw_zenohd` is one. It ends when it is dropped.
#[derive(Debug)]
pub struct Router(#[expect(dead_code, reason = "the session is open as long as it lives")] Session);

impl Router {
    /// Listens at an address.
    ///
    /// # Errors
    /// If it cannot, such as when another router does.
    pub fn open(address: &str) -> Result<Self, NodeError> {
        Ok(Self(open("router", &[address], &[])?))
    }
}

/// Time since 1970, ns.
#[must_use]
pub fn now() -> Nanos {
    let now = SystemTime::now().duration_since(UNIX_EPOCH);
    now.map_or(0, |it| i64::try_from(it.as_nanos()).unwrap_or(i64::MAX))
}

/// A node. Its endpoints end with it.
#[derive(Debug)]
pub struct Node {
    session: Session,
    name: NodeName,
    /// Number of the next endpoint; 0 is the node.
    next: AtomicU32,
    tokens: Mutex<Vec<LivelinessToken>>,
}

impl Node {
    /// Opens the session. Without a router it connects as soon as there is one.
    ///
    /// # Errors
    /// If a name is none, or the session cannot be opened.
    pub fn open(config: &NodeConfig) -> Result<Self, NodeError> {
        check_name(&config.name)?;
        if !config.namespace.is_empty() {
            check_name(&config.namespace)?;
        }
        let session = open("peer", &["tcp/localhost:0"], &[&config.router])?;
        let name = NodeName {
            domain: config.domain,
            zid: session.zid().to_string(),
            number: 0,
            namespace: config.namespace.clone(),
            name: config.name.clone(),
        };
        let node = Self {
            session,
            next: AtomicU32::new(1),
            tokens: Mutex::default(),
            name,
        };
        node.declare(node.name.token())?;
        Ok(node)
    }

    fn declare(&self, token: String) -> Result<(), NodeError> {
        let declared = self.session.liveliness().declare_token(token).wait();
        let token = declared.map_err(failed("cannot declare a liveliness token"))?;
        let mut tokens = self.tokens.lock().unwrap_or_else(PoisonError::into_inner);
        tokens.push(token);
        Ok(())
    }

    /// The key of an endpoint, and its identifier; its token is declared.
    fn endpoint(
        &self,
        kind: Kind,
        (topic, ty): (&str, &Type),
        qos: Qos,
    ) -> Result<(String, [u8; 16]), NodeError> {
        // The parts of actions begin with an underscore, as names may.
        check_name(topic)?;
        let number = self.next.fetch_add(1, Ordering::Relaxed);
        let topic = if topic.starts_with('/') {
            topic.to_owned()
        } else {
            format!("{}/{topic}", self.name.namespace)
        };
        let token = self.name.endpoint_token(number, kind, (&topic, ty), qos);
        let gid = gid(&token);
        self.declare(token)?;
        Ok((topic_key(self.name.domain, &topic, ty), gid))
    }

    /// A publisher of a topic; a name without a slash in front is in the namespace of the node.
    ///
    /// # Errors
    /// If the name is none, or zenoh refuses it.
    pub fn publisher(&self, topic: &str, ty: &Type, qos: Qos) -> Result<Publisher, NodeError> {
        let (key, gid) = self.endpoint(Kind::Publisher, (topic, ty), qos)?;
        let publisher = self.session.declare_publisher(key);
        // A subscriber that reads too slowly loses messages, and never delays others.
        let publisher = publisher.congestion_control(CongestionControl::Drop);
        let sends = if qos.transient_local {
            let depth = usize::try_from(qos.depth.unwrap_or(1)).unwrap_or(1);
            let cache = CacheConfig::default().max_samples(depth);
            let latched = publisher.cache(cache).publisher_detection().wait();
            Sends::Latched(latched.map_err(failed("cannot declare a publisher"))?)
        } else {
            let plain = publisher.wait();
            Sends::Plain(plain.map_err(failed("cannot declare a publisher"))?)
        };
        Ok(Publisher {
            sends,
            gid,
            sequence: AtomicI64::new(1),
        })
    }

    /// A service; `answer` gets the requests, on a thread of zenoh, and must not wait.
    ///
    /// # Errors
    /// As [`Self::publisher`].
    pub fn service(
        &self,
        name: &str,
        ty: &Type,
        answer: impl Fn(Request) + Send + Sync + 'static,
    ) -> Result<(), NodeError> {
        let (key, _) = self.endpoint(Kind::Service, (name, ty), Qos::SERVICE)?;
        let declared = self.session.declare_queryable(key).complete(true);
        let declared = declared.callback(move |query| answer(Request(query)));
        let declared = declared.background().wait();
        declared.map_err(failed("cannot declare a service"))
    }

    /// A subscription; `take` gets the messages, on a thread of zenoh, and must not wait.
    ///
    /// # Errors
    /// As [`Self::publisher`].
    pub fn subscription(
        &self,
        topic: &str,
        ty: &Type,
        take: impl Fn(&[u8]) + Send + Sync + 'static,
    ) -> Result<(), NodeError> {
        let (key, _) = self.endpoint(Kind::Subscription, (topic, ty), Qos::TOPIC)?;
        let declared = self.session.declare_subscriber(key);
        let declared = declared.callback(move |sample| take(&sample.payload().to_bytes()));
        let declared = declared.background().wait();
        declared.map_err(failed("cannot declare a subscription"))
    }
}

#[derive(Debug)]
enum Sends {
    Plain(zenoh::pubsub::Publisher<'static>),
    Latched(AdvancedPublisher<'static>),
}

/// A publisher of a topic.
pub struct Publisher {
    sends: Sends,
    gid: [u8; 16],
    sequence: AtomicI64,
}

impl std::fmt::Debug for Publisher {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Publisher").finish_non_exhaustive()
    }
}

impl Publisher {
    /// Publishes a message with its header.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn publish(&self, message: Vec<u8>) -> Result<(), NodeError> {
        let attachment = Attachment {
            sequence: self.sequence.fetch_add(1, Ordering::Relaxed),
            time_ns: now(),
            gid: self.gid,
        };
        let attachment = attachment.encode().to_vec();
        let sent = match &self.sends {
            Sends::Plain(publisher) => publisher.put(message).attachment(attachment).wait(),
            Sends::Latched(publisher) => publisher.put(message).attachment(attachment).wait(),
        };
        sent.map_err(failed("cannot publish"))
    }
}

/// A request of a client. Without a reply the client gets none.
#[derive(Debug)]
pub struct Request(zenoh::query::Query);

impl Request {
    /// The message with its header; empty if there is none.
    #[must_use]
    pub fn message(&self) -> Vec<u8> {
        let payload = self.0.payload();
        payload.map_or_else(Vec::new, |it| it.to_bytes().into_owned())
    }

    /// Answers it. The attachment repeats number and identifier of the request, by which the client knows its answer.
    ///
    /// # Errors
    /// If the request has no attachment, or the session is closed.
    pub fn reply(self, message: Vec<u8>) -> Result<(), NodeError> {
        let attachment = self.0.attachment().map(zenoh::bytes::ZBytes::to_bytes);
        let request = attachment.and_then(|bytes| Attachment::decode(&bytes));
        let Some(request) = request else {
            return Err(failed("cannot answer a request")(
                "its attachment has not 33 bytes, as those of rmw_zenoh_cpp before 0.2.4",
            ));
        };
        let attachment = Attachment {
            time_ns: now(),
            ..request
        };
        let key = self.0.key_expr().clone();
        let reply = self.0.reply(key, message);
        let reply = reply.attachment(attachment.encode().to_vec()).wait();
        reply.map_err(failed("cannot answer a request"))
    }
}

#[cfg(test)]
mod tests;
