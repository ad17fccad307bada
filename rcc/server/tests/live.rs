//! Live data over the Foxglove WebSocket: admission, channels, messages without a gap, services, and clients that misbehave.

#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

mod common;

use std::collections::BTreeMap;
use std::net::{SocketAddr, TcpStream};
use std::time::{Duration, Instant};

use common::TestServer;
use serde_json::{Value, json};
use takt_client::Token;
use takt_core::controller::{LoadRequest, NetState};
use takt_server::{LiveConfig, ServerConfig};
use tungstenite::client::IntoClientRequest as _;
use tungstenite::http::HeaderValue;
use tungstenite::{Error, Message, WebSocket};

const TOKEN: &str = "0123456789abcdef";
const ENDLESS: &str = "{c=Cancel(),outTerminate=c.outCancel}";

fn any() -> Option<SocketAddr> {
    Some(SocketAddr::from(([127, 0, 0, 1], 0)))
}

fn config(services: bool) -> ServerConfig {
    ServerConfig {
        live: LiveConfig {
            foxglove: any(),
            services,
            origins: vec!["https://listed.example".to_owned()],
            ..LiveConfig::default()
        },
        ..ServerConfig::default()
    }
}

/// A server with a simulated arm.
fn server(config: ServerConfig) -> TestServer {
    let server = TestServer::start_with(config);
    let list = |value: f64| format!("{:?}", [value; 7]);
    let parameters = [
        ("min_joint", list(-2.9)),
        ("max_joint", list(2.9)),
        ("max_vel", list(2.0)),
        ("max_acc", list(8.0)),
    ];
    let parameters: BTreeMap<_, _> = parameters
        .map(|(key, value)| (key.to_owned(), value))
        .into();
    let added = server
        .controller
        .add_device("left", "kuka_lwr_sim", &parameters);
    added.unwrap();
    server
}

/// A client of the Foxglove WebSocket.
struct Client {
    socket: WebSocket<TcpStream>,
    /// Channels by topic.
    channels: BTreeMap<String, u64>,
    /// Text messages that were not waited for, by operation.
    texts: Vec<Value>,
}

/// The result of a handshake with these headers.
fn shake(server: &TestServer, query: &str, headers: &[(&str, &str)]) -> Result<Client, String> {
    let address = server.foxglove.unwrap();
    let mut request = format!("ws://{address}/{query}")
        .into_client_request()
        .unwrap();
    for (name, value) in headers {
        let name: tungstenite::http::HeaderName = name.parse().unwrap();
        request
            .headers_mut()
            .insert(name, HeaderValue::from_str(value).unwrap());
    }
    let stream = TcpStream::connect(address).unwrap();
    stream
        .set_read_timeout(Some(Duration::from_secs(20)))
        .unwrap();
    match tungstenite::client(request, stream) {
        Ok((socket, response)) => {
            let spoken = response.headers()["Sec-WebSocket-Protocol"]
                .to_str()
                .unwrap();
            assert!(spoken.starts_with("foxglove."), "{spoken}");
            Ok(Client {
                socket,
                channels: BTreeMap::new(),
                texts: Vec::new(),
            })
        }
        Err(tungstenite::HandshakeError::Failure(Error::Http(response))) => {
            let body = response.body().clone().unwrap_or_default();
            Err(format!(
                "{} {}",
                response.status(),
                String::from_utf8_lossy(&body)
            ))
        }
        Err(error) => Err(error.to_string()),
    }
}

const V1: (&str, &str) = ("Sec-WebSocket-Protocol", "foxglove.sdk.v1");

fn connect(server: &TestServer) -> Client {
    shake(server, "", &[V1]).unwrap()
}

impl Client {
    /// The next message of that operation, or the next binary one for `None`.
    fn next(&mut self, op: Option<&str>) -> Vec<u8> {
        loop {
            match self.socket.read().unwrap() {
                Message::Text(text) => {
                    let value: Value = serde_json::from_str(&text).unwrap();
                    for channel in value["channels"].as_array().into_iter().flatten() {
                        assert_eq!(channel["encoding"], "cdr");
                        assert_eq!(channel["schemaEncoding"], "ros2msg");
                        let topic = channel["topic"].as_str().unwrap().to_owned();
                        self.channels.insert(topic, channel["id"].as_u64().unwrap());
                    }
                    if op.is_some() && value["op"].as_str() == op {
                        return text.as_bytes().to_vec();
                    }
                    self.texts.push(value);
                }
                Message::Binary(bytes) if op.is_none() => return bytes.to_vec(),
                Message::Binary(_)
                | Message::Ping(_)
                | Message::Pong(_)
                | Message::Close(_)
                | Message::Frame(_) => {}
            }
        }
    }

    fn text(&mut self, op: &str) -> Value {
        serde_json::from_slice(&self.next(Some(op))).unwrap()
    }

    fn send(&mut self, value: &Value) {
        self.socket.send(Message::text(value.to_string())).unwrap();
    }

    /// Waits for a channel and subscribes it.
    fn subscribe(&mut self, subscription: u32, topic: &str) {
        while !self.channels.contains_key(topic) {
            self.next(Some("advertise"));
        }
        let channel = self.channels[topic];
        let subscriptions = json!([{"id": subscription, "channelId": channel}]);
        self.send(&json!({"op": "subscribe", "subscriptions": subscriptions}));
    }

    /// The payload of the next message of a subscription.
    fn message(&mut self, subscription: u32) -> Vec<u8> {
        loop {
            let bytes = self.next(None);
            assert_eq!(bytes[0], 1);
            if bytes[1..5] == subscription.to_le_bytes() {
                return bytes[13..].to_vec();
            }
        }
    }

    /// Calls a service; returns its response, or the text of its failure.
    fn call(&mut self, service: u32, payload: &str) -> Result<Value, String> {
        let mut bytes = vec![2];
        for number in [service, 7, 4] {
            bytes.extend(number.to_le_bytes());
        }
        bytes.extend(b"json");
        bytes.extend(payload.bytes());
        self.socket.send(Message::binary(bytes)).unwrap();
        loop {
            match self.socket.read().unwrap() {
                Message::Binary(bytes) if bytes[0] == 3 => {
                    return Ok(serde_json::from_slice(&bytes[17..]).unwrap());
                }
                Message::Text(text) => {
                    let value: Value = serde_json::from_str(&text).unwrap();
                    if value["op"] == "serviceCallFailure" {
                        assert_eq!(value["callId"], 7);
                        return Err(value["message"].as_str().unwrap().to_owned());
                    }
                }
                Message::Binary(_)
                | Message::Ping(_)
                | Message::Pong(_)
                | Message::Close(_)
                | Message::Frame(_) => {}
            }
        }
    }
}

/// The number of the cycle in a message of `/takt/thread`.
fn cycle(payload: &[u8]) -> u64 {
    u64::from_le_bytes(payload[12..20].try_into().unwrap())
}

#[test]
fn foxglove_handshake_admits_listed_clients_only() {
    let open = server(config(false));
    let why = |headers: &[(&str, &str)]| shake(&open, "", headers).err().unwrap_or_default();
    assert!(why(&[]).contains("foxglove.sdk.v1"), "{}", why(&[]));
    assert!(why(&[("Sec-WebSocket-Protocol", "chat")]).starts_with("400"));
    assert_eq!(
        why(&[("Sec-WebSocket-Protocol", "a, foxglove.websocket.v1")]),
        ""
    );
    for origin in ["https://evil.example", "file://", "null"] {
        let why = why(&[V1, ("Origin", origin)]);
        assert!(why.starts_with("403") && why.contains("[live]"), "{why}");
    }
    assert_eq!(why(&[V1, ("Origin", "https://listed.example")]), "");
    assert!(why(&[V1, ("Host", "evil.example")]).starts_with("421"));

    let guarded = server(ServerConfig {
        token: Some(Token::new(TOKEN).unwrap()),
        ..config(true)
    });
    let why = |query: &str| shake(&guarded, query, &[V1]).err().unwrap_or_default();
    assert!(why("").starts_with("401"));
    assert!(why("?token=guessguessguess1").starts_with("401"));
    assert_eq!(why(&format!("?token={TOKEN}")), "");
    let bearer = format!("Bearer {TOKEN}");
    assert!(shake(&guarded, "", &[V1, ("Authorization", &bearer)]).is_ok());
}

#[test]
fn foxglove_beyond_loopback_needs_token() {
    let bind = |token| {
        let mut config = config(false);
        config.live.foxglove = Some(SocketAddr::from(([0, 0, 0, 0], 0)));
        config.token = token;
        let runtime = tokio::runtime::Runtime::new().unwrap();
        runtime
            .block_on(takt_server::Server::bind(config))
            .map(drop)
    };
    let refused = bind(None).unwrap_err().to_string();
    assert!(refused.contains("without a token"), "{refused}");
    assert!(bind(Some(Token::new(TOKEN).unwrap())).is_ok());
}

#[test]
fn foxglove_two_clients_get_each_cycle() {
    let server = server(config(false));
    let mut clients = [connect(&server), connect(&server)];
    for client in &mut clients {
        let info = client.text("serverInfo");
        assert_eq!(info["name"], "takt");
        assert_eq!(
            info["capabilities"],
            json!(["parameters", "parametersSubscribe"])
        );
        client.subscribe(5, "/takt/thread");
        client.subscribe(6, "/left/joint_states");
    }
    for client in &mut clients {
        let mut before = cycle(&client.message(5));
        for _ in 0..500 {
            let payload = client.message(5);
            let missed = u64::from_le_bytes(payload[28..36].try_into().unwrap());
            assert_eq!(
                cycle(&payload),
                before + 1 + missed,
                "a gap that is not reported"
            );
            before = cycle(&payload);
        }
        let state = client.message(6);
        assert!(state.windows(12).any(|part| part == b"left.joint_7"));
        client.send(&json!({"op": "unsubscribe", "subscriptionIds": [5, 6]}));
        client.send(&json!({"op": "getParameters", "parameterNames": [], "id": "all"}));
        let values = client.text("parameterValues");
        assert_eq!(values["id"], "all");
        let value = |name: &str| {
            let mut all = values["parameters"].as_array().unwrap().iter();
            all.find(|it| it["name"] == name).unwrap()["value"].clone()
        };
        assert_eq!(value("takt.period_s"), 0.001);
        assert_eq!(value("takt.device.left.joints"), 7);
        assert_eq!(value("takt.live.dropped"), 0);
        client.send(
            &json!({"op": "setParameters", "parameters": [{"name": "takt.period_s", "value": 1}]}),
        );
        assert!(
            client.text("status")["message"]
                .as_str()
                .unwrap()
                .contains("read-only")
        );
        assert_eq!(
            client.text("parameterValues")["parameters"][0]["value"],
            0.001
        );
        assert_eq!(
            client.call(4, "{}").unwrap_err().lines().next(),
            Some("services are off")
        );
    }
    assert!(!server.controller.is_stopped());
}

#[test]
fn foxglove_services_start_cancel_abort_and_stop() {
    let server = server(config(true));
    let mut client = connect(&server);
    assert_eq!(
        client.text("advertiseServices")["services"]
            .as_array()
            .unwrap()
            .len(),
        4
    );
    let session = server.controller.open_session("test").unwrap();
    let load = || {
        let request = LoadRequest {
            text: ENDLESS.to_owned(),
            session,
            description: String::new(),
            period: None,
        };
        server.controller.load(request).unwrap()
    };
    let nets = [load(), load()];
    let deadline = Instant::now() + Duration::from_secs(20);
    let wait = |net, state| {
        while server.controller.net(net).unwrap().state() != state {
            assert!(Instant::now() < deadline, "{net} did not come to {state:?}");
            std::thread::sleep(Duration::from_millis(5));
        }
    };
    let names = nets.map(|net| format!("{{\"net\":\"{net}\"}}"));
    for (net, name) in nets.iter().zip(&names) {
        wait(*net, NetState::Ready);
        assert_eq!(client.call(1, name), Ok(json!({"ok": true})));
        wait(*net, NetState::Running);
    }
    assert!(client.call(1, &names[0]).is_err(), "it runs already");
    client.call(2, &names[0]).unwrap();
    client.call(3, &names[1]).unwrap();
    wait(nets[0], NetState::Terminated);
    wait(nets[1], NetState::Terminated);
    for wrong in ["", "{}", "{\"net\":7}", "{\"net\":\"x\"}"] {
        assert!(
            client.call(1, wrong).unwrap_err().contains("rpinet0"),
            "{wrong}"
        );
    }
    assert!(client.call(1, "{\"net\":\"rpinet999\"}").is_err());
    assert!(client.call(99, "{}").unwrap_err().contains("no service 99"));
    client.call(4, "{}").unwrap();
    assert!(server.controller.is_stopped());
}

#[test]
fn foxglove_bad_clients_disturb_no_one() {
    let server = server(config(false));
    let mut good = connect(&server);
    good.subscribe(1, "/takt/thread");
    let mut before = cycle(&good.message(1));
    // One that sends what is no message.
    let mut garbage = connect(&server);
    for text in ["", "{", "[]", "{\"op\":\"fly\"}", "\u{0}\u{1}\u{2}"] {
        garbage.socket.send(Message::text(text)).unwrap();
        garbage
            .socket
            .send(Message::binary(text.as_bytes().to_vec()))
            .unwrap();
    }
    assert!(garbage.text("status")["message"].as_str().unwrap().len() > 5);
    // One whose frames are none.
    let mut broken = connect(&server);
    std::io::Write::write_all(broken.socket.get_mut(), &[0xFF; 300]).unwrap();
    // One that announces a message that is too long.
    let mut long = connect(&server);
    let _ = long.socket.send(Message::binary(vec![2; 1 << 20]));
    // One with thousands of subscriptions, that reads nothing.
    let mut greedy = connect(&server);
    greedy.subscribe(0, "/left/joint_states");
    let channel = greedy.channels["/left/joint_states"];
    for part in 0..10 {
        let pairs: Vec<_> = (1..1000_u32)
            .map(|n| json!({"id": part * 1000 + n, "channelId": channel}))
            .collect();
        greedy.send(&json!({"op": "subscribe", "subscriptions": pairs}));
    }
    // Longer than its queue and the buffers of its connection last.
    let end = Instant::now() + Duration::from_secs(3);
    while Instant::now() < end {
        let payload = good.message(1);
        let missed = u64::from_le_bytes(payload[28..36].try_into().unwrap());
        assert_eq!(cycle(&payload), before + 1 + missed);
        before = cycle(&payload);
    }
    good.send(&json!({"op": "getParameters", "parameterNames": ["takt.live.dropped"]}));
    let values = good.text("parameterValues");
    let dropped = values["parameters"][0]["value"].as_u64().unwrap();
    assert!(dropped > 0, "losses of the slow client are counted");
}

#[test]
fn datagrams_have_time_and_values_of_cycles() {
    let listener = std::net::UdpSocket::bind(any().unwrap()).unwrap();
    listener
        .set_read_timeout(Some(Duration::from_secs(20)))
        .unwrap();
    let probes = ["left.joint.3.measured", "thread:nets.latency", "no.such"];
    let server = server(ServerConfig {
        live: LiveConfig {
            udp: Some(listener.local_addr().unwrap()),
            probes: probes.map(str::to_owned).to_vec(),
            every: 5,
            ..LiveConfig::default()
        },
        ..ServerConfig::default()
    });
    assert!(server.foxglove.is_none(), "datagrams need no WebSocket");
    let mut buffer = [0; 2048];
    let mut next = || -> Value {
        let count = listener.recv(&mut buffer).unwrap();
        serde_json::from_slice(&buffer[..count]).unwrap()
    };
    // The arm exists a moment after the server.
    let mut before = next();
    while before.get(probes[0]).is_none() {
        before = next();
    }
    for _ in 0..100 {
        let sample = next();
        let time = |sample: &Value| sample["timestamp"].as_f64().unwrap();
        let cycles = (time(&sample) - time(&before)) * 1e3;
        assert!(
            (cycles / 5.0 - (cycles / 5.0).round()).abs() < 0.01 && cycles > 4.9,
            "{cycles}"
        );
        assert!(sample[probes[0]].is_f64() || sample[probes[0]].is_i64());
        assert!(sample[probes[1]].as_f64().unwrap() >= 0.0);
        assert!(sample.get(probes[2]).is_none());
        before = sample;
    }
}
