//! A node through a router, observed by a plain zenoh session: keys, attachments and answers as clients of ROS expect them. No
//! client of ROS runs here.

use std::net::TcpListener;
use std::sync::mpsc::channel;
use std::time::Duration;

use zenoh::sample::Sample;

use super::super::keys::{ATTACHMENT, topic_key};
use super::super::messages::{decode_set_bool, joint_state, set_bool, string};
use super::super::types::{JOINT_STATE, SET_BOOL, STRING};
use super::*;

/// Upper bound for a message that must arrive.
const ARRIVES: Duration = Duration::from_secs(20);

struct Bench {
    _router: Router,
    node: Node,
    /// A client of the same router.
    peer: Session,
}

fn bench() -> Bench {
    let free = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("tcp/{}", free.local_addr().unwrap());
    drop(free);
    let router = Router::open(&address).unwrap();
    let node = Node::open(&NodeConfig {
        domain: 7,
        namespace: "/cell".to_owned(),
        name: "takt".to_owned(),
        router: address.clone(),
    });
    Bench {
        _router: router,
        node: node.unwrap(),
        peer: open("client", &[], &[&address]).unwrap(),
    }
}

fn attachment(sample: &Sample) -> Attachment {
    let bytes = sample.attachment().unwrap().to_bytes();
    assert_eq!(bytes.len(), ATTACHMENT);
    Attachment::decode(&bytes).unwrap()
}

#[test]
fn node_publishes_with_key_and_attachment() {
    let Bench {
        node,
        peer,
        _router,
    } = bench();
    let key = topic_key(7, "/cell/joint_states", &JOINT_STATE);
    let (send, samples) = channel();
    let subscriber = peer.declare_subscriber(key);
    let take = move |sample| {
        send.send(sample).ok();
    };
    subscriber.callback(take).background().wait().unwrap();
    let publisher = node
        .publisher("joint_states", &JOINT_STATE, Qos::TOPIC)
        .unwrap();
    let message = joint_state(5, &["a1".to_owned()], [&[0.5], &[0.0], &[1.0]]);
    // Until the subscription has reached the node, messages are for no one.
    let first = loop {
        publisher.publish(message.clone()).unwrap();
        if let Ok(sample) = samples.recv_timeout(Duration::from_millis(20)) {
            break sample;
        }
    };
    assert_eq!(first.payload().to_bytes(), message);
    publisher.publish(message).unwrap();
    let second = samples.recv_timeout(ARRIVES).unwrap();
    let [first, second] = [&first, &second].map(attachment);
    assert_eq!(second.gid, first.gid);
    assert!(second.sequence > first.sequence && first.sequence > 0);
}

#[test]
fn node_latched_message_reaches_late_subscription() {
    use zenoh_ext::{AdvancedSubscriberBuilderExt as _, HistoryConfig};
    let Bench {
        node,
        peer,
        _router,
    } = bench();
    let publisher = node.publisher("/robot_description", &STRING, Qos::LATCHED);
    let message = string("<robot/>");
    publisher
        .as_ref()
        .unwrap()
        .publish(message.clone())
        .unwrap();
    let key = topic_key(7, "/robot_description", &STRING);
    let (send, samples) = channel();
    let subscriber = peer.declare_subscriber(key);
    let subscriber = subscriber.callback(move |sample: Sample| {
        send.send(sample).ok();
    });
    let late = HistoryConfig::default().detect_late_publishers();
    let _subscriber = subscriber.history(late).wait().unwrap();
    let sample = samples.recv_timeout(ARRIVES).unwrap();
    assert_eq!(sample.payload().to_bytes(), message);
}

#[test]
fn node_service_repeats_number_and_client_in_reply() {
    let Bench {
        node,
        peer,
        _router,
    } = bench();
    let answer = |request: Request| {
        let on = decode_set_bool(&request.message()).unwrap();
        request.reply(set_bool(on, "done")).ok();
    };
    node.service("lamp", &SET_BOOL, answer).unwrap();
    let request = Attachment {
        sequence: 41,
        time_ns: 9,
        gid: [3; 16],
    };
    let on = [0, 1, 0, 0, 1];
    let key = topic_key(7, "/cell/lamp", &SET_BOOL);
    let get = |attachment: Option<Vec<u8>>| {
        let get = peer.get(&key).payload(on.to_vec());
        let get = attachment
            .into_iter()
            .fold(get, |get, it| get.attachment(it));
        let replies = get.timeout(ARRIVES).wait().unwrap();
        replies
            .recv()
            .ok()
            .and_then(|reply| reply.into_result().ok())
    };
    // Until the service has reached the client, there is no reply.
    let reply = loop {
        if let Some(reply) = get(Some(request.encode().to_vec())) {
            break reply;
        }
    };
    assert_eq!(reply.payload().to_bytes(), set_bool(true, "done"));
    let found = attachment(&reply);
    assert_eq!((found.sequence, found.gid), (41, [3; 16]));
    assert!(
        get(None).is_none(),
        "a request without attachment has no reply"
    );
}

#[test]
fn node_is_seen_by_its_tokens() {
    let Bench {
        node,
        peer,
        _router,
    } = bench();
    node.publisher("/tf", &STRING, Qos::TOPIC).unwrap();
    let mut tokens = Vec::new();
    while tokens.len() < 2 {
        let replies = peer
            .liveliness()
            .get("@ros2_lv/7/**")
            .timeout(ARRIVES)
            .wait()
            .unwrap();
        let keys = replies.into_iter().filter_map(|it| it.into_result().ok());
        tokens = keys.map(|it| it.key_expr().to_string()).collect();
    }
    tokens.sort();
    assert!(
        tokens
            .iter()
            .any(|it| it.contains("/NN/") && it.ends_with("/%cell/takt")),
        "{tokens:?}"
    );
    assert!(
        tokens
            .iter()
            .any(|it| it.contains("/MP/") && it.contains("/%tf/")),
        "{tokens:?}"
    );
}
