//! Key expressions, liveliness tokens, qualities of service and attachments of `rmw_zenoh_cpp` (`docs/design.md` there). Which
//! nodes and topics there are is not known here.
//!
//! | bytes of an attachment | value |
//! |---|---|
//! | 0..8 | sequence number, from 1, i64 little-endian |
//! | 8..16 | time of the source, ns since 1970, i64 little-endian |
//! | 16 | length of the identifier, 16 |
//! | 17..33 | identifier of the endpoint |

use std::fmt::Write as _;

use super::types::Type;

/// Length of an attachment.
pub const ATTACHMENT: usize = 33;
/// Length of the identifier of an endpoint.
pub const GID: u8 = 16;
/// Longest name of a node, topic or namespace.
pub const NAME_MAX: usize = 256;

/// Why a name is no name of ROS.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{0}` is no name of ROS\nhint: letters, digits and _ between slashes, no digit first, at most {NAME_MAX} characters"
)]
pub struct NameError(String);

/// Checks a name of a topic, service, namespace or node, with or without slashes.
///
/// # Errors
/// If it is none: parts of letters, digits and underscores, no digit first, divided by single slashes.
pub fn check_name(name: &str) -> Result<(), NameError> {
    let is_part = |part: &str| {
        let is_first = part
            .chars()
            .next()
            .is_some_and(|c| c.is_ascii_alphabetic() || c == '_');
        is_first && part.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
    };
    let inner = name.strip_prefix('/').unwrap_or(name);
    if name.len() <= NAME_MAX && inner.split('/').all(is_part) {
        Ok(())
    } else {
        Err(NameError(name.chars().take(NAME_MAX).collect()))
    }
}

/// The name as a single chunk of a key: slashes are `%`, nothing is `%`.
#[must_use]
pub fn mangled(name: &str) -> String {
    if name.is_empty() {
        "%".to_owned()
    } else {
        name.replace('/', "%")
    }
}

/// The key of a topic or service: domain, name without outer slashes, type and hash.
#[must_use]
pub fn topic_key(domain: u32, name: &str, ty: &Type) -> String {
    let name = name.trim_matches('/');
    format!("{domain}/{name}/{}/{}", ty.dds_name(), ty.hash)
}

/// What an endpoint does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Publishes a topic.
    Publisher,
    /// Subscribes to a topic.
    Subscription,
    /// Answers requests.
    Service,
    /// Sends requests.
    Client,
}

impl Kind {
    const fn text(self) -> &'static str {
        match self {
            Self::Publisher => "MP",
            Self::Subscription => "MS",
            Self::Service => "SS",
            Self::Client => "SC",
        }
    }

    fn of(text: &str) -> Option<Self> {
        let all = [
            Self::Publisher,
            Self::Subscription,
            Self::Service,
            Self::Client,
        ];
        all.into_iter().find(|kind| kind.text() == text)
    }
}

/// Quality of service, as far as the parts here differ in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Qos {
    /// Whether messages are sent again until they arrive; else best effort.
    pub reliable: bool,
    /// Whether the last messages are kept for subscriptions that begin later.
    pub transient_local: bool,
    /// How many messages are kept; `None` for all.
    pub depth: Option<u32>,
}

impl Qos {
    /// That of topics by default: reliable, nothing kept for later ones, depth 10.
    pub const TOPIC: Self = Self {
        reliable: true,
        transient_local: false,
        depth: Some(10),
    };
    /// That of services.
    pub const SERVICE: Self = Self::TOPIC;
    /// That of a model or state which subscriptions need that begin later.
    pub const LATCHED: Self = Self {
        reliable: true,
        transient_local: true,
        depth: Some(1),
    };

    /// The text in a token: `reliability:durability:history,depth:deadline:lifespan:liveliness`; what is the default is left out.
    #[must_use]
    pub fn text(self) -> String {
        let reliability = if self.reliable { "" } else { "2" };
        let durability = if self.transient_local { "1" } else { "" };
        let (history, depth) = match self.depth {
            Some(depth) => ("", depth.to_string()),
            None => ("2", String::new()),
        };
        format!("{reliability}:{durability}:{history},{depth}:,:,:,,")
    }

    /// Reads the text of a token; what it leaves out is the default of the format.
    #[must_use]
    pub fn read(text: &str) -> Option<Self> {
        let mut parts = text.split(':');
        let (reliability, durability, history) = (parts.next()?, parts.next()?, parts.next()?);
        if parts.count() != 3 {
            return None;
        }
        let (history, depth) = history.split_once(',')?;
        let choice = |text: &str, first: bool| match text {
            "" => Some(first),
            "1" => Some(true),
            "2" => Some(false),
            _ => None,
        };
        let keeps_last = choice(history, true)?;
        let depth = match depth {
            "" => 42,
            depth => depth.parse().ok()?,
        };
        Some(Self {
            reliable: choice(reliability, true)?,
            transient_local: choice(durability, false)?,
            depth: keeps_last.then_some(depth),
        })
    }
}

/// A node in the graph.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeName {
    /// Domain (`ROS_DOMAIN_ID`).
    pub domain: u32,
    /// Identifier of its zenoh session, hexadecimal.
    pub zid: String,
    /// Number of the node in its session.
    pub number: u32,
    /// Namespace: empty, or `/cell`.
    pub namespace: String,
    /// Name without slashes.
    pub name: String,
}

impl NodeName {
    /// The token of the node.
    #[must_use]
    pub fn token(&self) -> String {
        let mut key = self.head(self.number, "NN");
        self.tail(&mut key);
        key
    }

    fn head(&self, number: u32, kind: &str) -> String {
        let Self {
            domain,
            zid,
            number: node,
            ..
        } = self;
        format!("@ros2_lv/{domain}/{zid}/{node}/{number}/{kind}")
    }

    fn tail(&self, key: &mut String) {
        // Writing to a String does not fail. The enclave is always `/`.
        let _ = write!(key, "/%/{}/{}", mangled(&self.namespace), self.name);
    }

    /// The token of one of its endpoints.
    #[must_use]
    pub fn endpoint_token(
        &self,
        number: u32,
        kind: Kind,
        (topic, ty): (&str, &Type),
        qos: Qos,
    ) -> String {
        let mut key = self.head(number, kind.text());
        self.tail(&mut key);
        let topic = mangled(&format!("/{}", topic.trim_matches('/')));
        let _ = write!(key, "/{topic}/{}/{}/{}", ty.dds_name(), ty.hash, qos.text());
        key
    }
}

/// The key of all tokens of a domain.
#[must_use]
pub fn all_tokens(domain: u32) -> String {
    format!("@ros2_lv/{domain}/**")
}

/// An endpoint of any node, read from its token.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Endpoint {
    /// Identifier of the zenoh session.
    pub zid: String,
    /// What it does.
    pub kind: Kind,
    /// Name of its node.
    pub node: String,
    /// Its topic or service, with the slash in front.
    pub topic: String,
    /// Its type as DDS writes it.
    pub ty: String,
    /// Hash of the type.
    pub hash: String,
}

impl Endpoint {
    /// Reads a token; `None` if it is none of an endpoint.
    #[must_use]
    pub fn read(token: &str) -> Option<Self> {
        let parts: Vec<&str> = token.split('/').take(16).collect();
        let [
            "@ros2_lv",
            _,
            zid,
            _,
            _,
            kind,
            _,
            _,
            node,
            topic,
            ty,
            hash,
            qos,
        ] = parts[..]
        else {
            return None;
        };
        Qos::read(qos)?;
        Some(Self {
            zid: zid.to_owned(),
            kind: Kind::of(kind)?,
            node: node.to_owned(),
            topic: topic.replace('%', "/"),
            ty: ty.to_owned(),
            hash: hash.to_owned(),
        })
    }
}

/// What accompanies each message, request and reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Attachment {
    /// Number of the message, from 1.
    pub sequence: i64,
    /// When it was sent, ns since 1970.
    pub time_ns: i64,
    /// Who sent it.
    pub gid: [u8; GID as usize],
}

impl Attachment {
    /// The bytes on the wire.
    #[must_use]
    pub fn encode(&self) -> [u8; ATTACHMENT] {
        let mut bytes = [0; ATTACHMENT];
        let (sequence, rest) = bytes.split_at_mut(8);
        sequence.copy_from_slice(&self.sequence.to_le_bytes());
        let (time, rest) = rest.split_at_mut(8);
        time.copy_from_slice(&self.time_ns.to_le_bytes());
        if let Some((length, gid)) = rest.split_first_mut() {
            *length = GID;
            gid.copy_from_slice(&self.gid);
        }
        bytes
    }

    /// Reads it; `None` if it has another length. Those of `rmw_zenoh_cpp` before 0.2.4 do.
    #[must_use]
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let (sequence, rest) = bytes.split_first_chunk()?;
        let (time, rest) = rest.split_first_chunk()?;
        let (length, gid) = rest.split_first()?;
        Some(Self {
            sequence: i64::from_le_bytes(*sequence),
            time_ns: i64::from_le_bytes(*time),
            gid: gid.try_into().ok().filter(|_| *length == GID)?,
        })
    }
}

/// An identifier of an endpoint, made of its token: FNV-1a over two seeds. Others compare it, no one computes it again.
#[must_use]
pub fn gid(token: &str) -> [u8; GID as usize] {
    let hash = |seed: u64| {
        token.bytes().fold(seed, |hash, byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
        })
    };
    let both = [hash(0xcbf2_9ce4_8422_2325), hash(0x9ae1_6a3b_2f90_404f)];
    let mut gid = [0; GID as usize];
    for (to, from) in gid.chunks_exact_mut(8).zip(both) {
        to.copy_from_slice(&from.to_le_bytes());
    }
    gid
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ros::types;

    fn node() -> NodeName {
        NodeName {
            domain: 0,
            zid: "aac3178e146ba6f1fc6e6a4085e77f21".to_owned(),
            number: 0,
            namespace: String::new(),
            name: "takt".to_owned(),
        }
    }

    #[test]
    fn topic_key_has_domain_name_type_and_hash() {
        let hash = "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e";
        let key = format!("0/joint_states/sensor_msgs::msg::dds_::JointState_/{hash}");
        for name in ["/joint_states", "joint_states", "/joint_states/"] {
            assert_eq!(topic_key(0, name, &types::JOINT_STATE), key);
        }
        let send = topic_key(
            7,
            "/left/follow_joint_trajectory/_action/send_goal",
            &types::FOLLOW_JOINT_TRAJECTORY.send_goal,
        );
        let wanted = "7/left/follow_joint_trajectory/_action/send_goal/\
                      control_msgs::action::dds_::FollowJointTrajectory_SendGoal_/RIHS01_b13789";
        assert!(send.starts_with(wanted), "{send}");
    }

    #[test]
    fn node_token_has_percent_for_slash_and_nothing() {
        let zid = "aac3178e146ba6f1fc6e6a4085e77f21";
        assert_eq!(node().token(), format!("@ros2_lv/0/{zid}/0/0/NN/%/%/takt"));
        let inside = NodeName {
            namespace: "/line/cell".to_owned(),
            domain: 2,
            ..node()
        };
        let wanted = format!("@ros2_lv/2/{zid}/0/0/NN/%/%line%cell/takt");
        assert_eq!(inside.token(), wanted);
    }

    #[test]
    fn endpoint_token_is_read_as_written() {
        let qos = Qos::TOPIC;
        let of = ("/left/joint_states", &types::JOINT_STATE);
        let token = node().endpoint_token(3, Kind::Publisher, of, qos);
        let wanted = format!(
            "@ros2_lv/0/aac3178e146ba6f1fc6e6a4085e77f21/0/3/MP/%/%/takt/%left%joint_states/\
             sensor_msgs::msg::dds_::JointState_/{}/::,10:,:,:,,",
            types::JOINT_STATE.hash
        );
        assert_eq!(token, wanted);
        let read = Endpoint::read(&token).unwrap();
        assert_eq!(read.topic, "/left/joint_states");
        assert_eq!((read.kind, &*read.node), (Kind::Publisher, "takt"));
        assert_eq!(read.hash, types::JOINT_STATE.hash);
        assert_eq!(Endpoint::read(&node().token()), None);
        for end in 0..token.len() - 1 {
            // Shorter ones are none, or of another quality of service.
            let read = Endpoint::read(&token[..end]);
            assert!(read.is_none_or(|it| it.ty.ends_with("JointState_")));
        }
    }

    #[test]
    fn qos_text_leaves_defaults_out() {
        assert_eq!(Qos::TOPIC.text(), "::,10:,:,:,,");
        assert_eq!(Qos::LATCHED.text(), ":1:,1:,:,:,,");
        let sensor = Qos {
            reliable: false,
            transient_local: false,
            depth: Some(5),
        };
        assert_eq!(sensor.text(), "2::,5:,:,:,,");
        let all = Qos {
            depth: None,
            ..Qos::TOPIC
        };
        assert_eq!(all.text(), "::2,:,:,:,,");
        for qos in [Qos::TOPIC, Qos::LATCHED, sensor, all] {
            assert_eq!(Qos::read(&qos.text()), Some(qos));
        }
        assert_eq!(Qos::read("::,:,:,:,,").unwrap().depth, Some(42));
        for wrong in ["", ":::::", "3::,1:,:,:,,", "::,x:,:,:,,", "::,1:,:,"] {
            assert_eq!(Qos::read(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn attachment_has_33_bytes() {
        let attachment = Attachment {
            sequence: 1,
            time_ns: 0x0102_0304_0506_0708,
            gid: std::array::from_fn(|n| u8::try_from(n).unwrap()),
        };
        let bytes = attachment.encode();
        assert_eq!(bytes[..8], [1, 0, 0, 0, 0, 0, 0, 0]);
        assert_eq!(bytes[8..17], [8, 7, 6, 5, 4, 3, 2, 1, 16]);
        assert_eq!(bytes[17..], attachment.gid);
        assert_eq!(Attachment::decode(&bytes), Some(attachment));
        for end in 0..bytes.len() {
            assert_eq!(Attachment::decode(&bytes[..end]), None);
        }
        let mut wrong = bytes;
        wrong[16] = 15;
        assert_eq!(Attachment::decode(&wrong), None);
    }

    #[test]
    fn names_with_other_characters_are_refused() {
        for name in ["/a", "a", "/a/b_1", "_x"] {
            assert_eq!(check_name(name), Ok(()), "{name}");
        }
        let long = "a".repeat(NAME_MAX + 1);
        for name in ["", "/", "/a//b", "/1a", "a b", "/a/", "*", "@x", &long] {
            assert!(check_name(name).is_err(), "{name}");
        }
    }
}
