//! Servers and clients over loopback sockets: both transports, the known client with its deviations from RFC 6455,
//! and lost clients. The meaning of commands is tested without sockets.

#![expect(
    clippy::unwrap_used,
    reason = "tests and their helpers fail by panicking"
)]

mod common;

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::{Duration, Instant};

use common::TestServer;
use takt_client::{Client, Error, Value};
use takt_core::NetId;
use takt_server::server::CONNECTIONS_MAX;
use takt_server::{OnLoss, Server, ServerConfig};

/// Runs until it is cancelled.
const CANCELLABLE: &str = "{c=Core::Clock(Increment='1'),\
    t=Core::DoubleNetcommOut(inValue=c.outValue,Key='t'),x=Cancel(),outTerminate=x.outCancel}";

/// Ignores cancelling.
const ENDLESS: &str = "{f=Core::BooleanValue(Value='false'),outTerminate=f.outValue}";

/// Far longer than any test takes; expires only if a test fails.
const TIMEOUT: Duration = Duration::from_secs(20);

fn client(server: &TestServer) -> Client {
    Client::connect(&server.tcp.to_string()).unwrap()
}

/// Opens a session, loads a net in it and starts it.
fn run(client: &Client, net: &str) -> NetId {
    let session = client
        .call("nse", ["test"])
        .unwrap()
        .text()
        .unwrap()
        .to_owned();
    let loaded = client.call("nene", [net, session.as_str()]).unwrap();
    client.call("nest", [loaded.text().unwrap()]).unwrap();
    loaded.text().unwrap().parse().unwrap()
}

fn wait_until(event: &str, mut done: impl FnMut() -> bool) {
    let until = Instant::now() + TIMEOUT;
    while !done() {
        assert!(Instant::now() < until, "timed out waiting for {event}");
        std::thread::sleep(Duration::from_millis(1));
    }
}

#[test]
fn net_is_loaded_watched_and_cancelled_over_plain_tcp() {
    let server = TestServer::start(OnLoss::Keep);
    let client = client(&server);
    let net = client
        .call("nene", [CANCELLABLE])
        .unwrap()
        .text()
        .unwrap()
        .to_owned();
    let watch = client
        .call("gne", [Value::from(net.as_str()), Value::from(0.01)])
        .unwrap();
    client.call("nest", [net.as_str()]).unwrap();
    let next = |client: &Client| {
        let push = client.next_push(TIMEOUT).unwrap().unwrap();
        assert_eq!(push.tag, watch.tag);
        push
    };
    assert_eq!(next(&client).args, [Value::from("READY")]);
    assert_eq!(next(&client).args, [Value::from("RUNNING")]);
    let values = next(&client);
    assert_eq!(values.command, "nc");
    assert!(values.args[0].as_map().unwrap().contains_key("outt"));
    client.call("neca", [net.as_str()]).unwrap();
    let mut last = values;
    loop {
        let push = next(&client);
        if push.args == [Value::from("TERMINATED")] {
            break;
        }
        last = if push.command == "nc" { push } else { last };
    }
    let info = server.controller.out_values(net.parse().unwrap());
    assert_eq!(last.args, [Value::map_of(info)]);
}

#[test]
fn command_errors_reach_caller() {
    let server = TestServer::start(OnLoss::Keep);
    let client = client(&server);
    let error = client.call("nest", ["rpinet5"]).unwrap_err();
    assert_eq!(error.to_string(), "invalid net (`nest`)");
    assert!(client.next_push(Duration::ZERO).unwrap().is_none());
}

#[test]
fn connection_refused_error_has_hint() {
    let free = std::net::TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap();
    let error = Client::connect(&free.to_string()).unwrap_err();
    assert_eq!(
        error.to_string(),
        format!(
            "cannot connect to {free}: connection refused\nhint: start the controller with `takt run`"
        )
    );
}

#[test]
fn lines_arrive_split_or_merged() {
    let server = TestServer::start(OnLoss::Keep);
    let mut stream = TcpStream::connect(server.tcp).unwrap();
    stream.set_read_timeout(Some(TIMEOUT)).unwrap();
    stream.set_nodelay(true).unwrap();
    for byte in b"a=ver(\"2.0\")\n" {
        stream.write_all(&[*byte]).unwrap();
    }
    stream
        .write_all(b"b=nse(\"two\nlines\")\r\n\nc=what?\nd=quit()\n")
        .unwrap();
    let expected = "a=ok(\"handshake ok\")\nb=ok(\"s1\")\nnone=err(\"invalid syntax\")\n\
        d=ok(\"quitting\")\n";
    assert_eq!(
        read_exactly(&mut stream, expected.len()),
        expected.as_bytes()
    );
}

#[test]
fn endless_line_closes_connection_with_bound() {
    let server = TestServer::start(OnLoss::Keep);
    let mut stream = TcpStream::connect(server.tcp).unwrap();
    stream.set_read_timeout(Some(TIMEOUT)).unwrap();
    stream.write_all(b"a=ver(\"2.0\")\n").unwrap();
    let greeted = b"a=ok(\"handshake ok\")\n";
    assert_eq!(read_exactly(&mut stream, greeted.len()), greeted);
    stream.write_all(b"b=nse(\"").unwrap();
    // Exactly one byte too many, so that nothing is left unread when the server closes.
    stream.write_all(&vec![b' '; (8 << 20) - 6]).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    assert!(
        answer.starts_with("none=err(\"a message has more than 8388608 bytes"),
        "{answer}"
    );
    client(&server);
}

fn read_exactly(stream: &mut TcpStream, count: usize) -> Vec<u8> {
    let mut bytes = vec![0; count];
    stream.read_exact(&mut bytes).unwrap();
    bytes
}

/// The known client of the original: no version, no masks, ping, `BYE`.
struct KnownClient(TcpStream);

impl KnownClient {
    fn connect(address: SocketAddr) -> Self {
        Self::connect_with(address, "")
    }

    fn connect_with(address: SocketAddr, header: &str) -> Self {
        let mut stream = TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(TIMEOUT)).unwrap();
        let request = format!(
            "GET /DirectIO/ HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\n\
             Connection: Upgrade\r\n{header}Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
        );
        stream.write_all(request.as_bytes()).unwrap();
        let expected = "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\n\
            Connection: Upgrade\r\nSec-WebSocket-Accept: s3pPLMBiTxaQ9kYGzzhZRbK+xOo=\r\n\r\n";
        assert_eq!(
            read_exactly(&mut stream, expected.len()),
            expected.as_bytes()
        );
        Self(stream)
    }

    /// Sends an unmasked frame with this first byte.
    fn send(&mut self, first: u8, payload: &[u8]) {
        let length = u8::try_from(payload.len()).unwrap();
        self.0
            .write_all(&[&[first, length], payload].concat())
            .unwrap();
    }

    /// First byte and payload of the next frame.
    fn receive(&mut self) -> (u8, String) {
        let head = read_exactly(&mut self.0, 2);
        let payload = read_exactly(&mut self.0, head[1].into());
        (head[0], String::from_utf8(payload).unwrap())
    }

    fn text(&mut self) -> String {
        let (first, text) = self.receive();
        assert_eq!(first, 0x81);
        text
    }
}

#[test]
fn known_client_is_served_over_websocket() {
    let server = TestServer::start(OnLoss::Keep);
    let mut client = KnownClient::connect(server.http);
    client.send(0x81, b"c0=ver(\"2.0\")");
    assert_eq!(client.text(), "c0=ok(\"handshake ok\")");
    client.send(0x89, b"p17");
    assert_eq!(client.receive(), (0x8a, "p17".to_owned()));
    client.send(0x01, b"c3=g");
    client.send(0x00, b"de");
    client.send(0x80, b"()");
    assert_eq!(client.text(), r#"c3=da({rcc:{interfaces:{},type:"rcc"}})"#);
    assert_eq!(client.text(), r#"c3=ds({rcc:"op"})"#);
    assert_eq!(client.text(), "c3=ok()");
    client.send(0x88, b"BYE");
    assert_eq!(client.receive(), (0x88, "BYE".to_owned()));
    assert_eq!(client.0.read(&mut [0]).unwrap(), 0);
}

#[test]
fn rfc_client_is_served_over_websocket() {
    let server = TestServer::start(OnLoss::Keep);
    let stream = TcpStream::connect(server.http).unwrap();
    stream.set_read_timeout(Some(TIMEOUT)).unwrap();
    let url = format!("ws://{}/DirectIO/", server.http);
    let (mut socket, _) = tungstenite::client(url, stream).unwrap();
    socket.send("c0=ver(\"2.0\")".into()).unwrap();
    assert_eq!(socket.read().unwrap(), "c0=ok(\"handshake ok\")".into());
    let long = "x".repeat(100_000);
    socket.send(format!("c1=nse(\"{long}\")").into()).unwrap();
    let refused = socket.read().unwrap().into_text().unwrap();
    assert!(
        refused.starts_with("c1=err(\"the description has 100000 bytes; "),
        "{refused}"
    );
    socket.close(None).unwrap();
    assert!(socket.read().unwrap().is_close());
    assert!(matches!(
        socket.read(),
        Err(tungstenite::Error::ConnectionClosed)
    ));
}

#[test]
fn pushes_arrive_unsolicited() {
    let server = TestServer::start(OnLoss::Keep);
    let (watcher, other) = (client(&server), client(&server));
    let net = other
        .call("nene", [CANCELLABLE])
        .unwrap()
        .text()
        .unwrap()
        .to_owned();
    watcher
        .call("gne", [Value::from(net.as_str()), Value::from(0.01)])
        .unwrap();
    assert_eq!(
        watcher.next_push(TIMEOUT).unwrap().unwrap().args,
        [Value::from("READY")]
    );
    other.call("nest", [net.as_str()]).unwrap();
    assert_eq!(
        watcher.next_push(TIMEOUT).unwrap().unwrap().args,
        [Value::from("RUNNING")]
    );
    for _ in 0..3 {
        assert_eq!(watcher.next_push(TIMEOUT).unwrap().unwrap().command, "nc");
    }
}

/// Sends a request in several pieces.
fn request(server: &TestServer, request: &str) -> String {
    let mut stream = TcpStream::connect(server.http).unwrap();
    stream.set_read_timeout(Some(TIMEOUT)).unwrap();
    for part in request.as_bytes().chunks(1 << 16) {
        // The server may have answered before everything is sent.
        let _ = stream.write_all(part);
    }
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

#[test]
fn resource_response_closes_connection() {
    let server = TestServer::start(OnLoss::Keep);
    let get = |path: &str| {
        request(
            &server,
            &format!("GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n"),
        )
    };
    let nets = get("//nets/");
    assert!(nets.starts_with("HTTP/1.1 200 OK\r\n"), "{nets}");
    assert!(
        nets.contains("Connection: close\r\n") && nets.ends_with("<nets/>\n"),
        "{nets}"
    );
    assert!(get("/").starts_with("HTTP/1.1 200 "));
    assert!(get("/nowhere/").starts_with("HTTP/1.1 404 "));
    assert!(get("/DirectIO/").starts_with("HTTP/1.1 426 "));
    assert!(request(&server, "\0\r\n\r\n").starts_with("HTTP/1.1 400 "));
    let net = "{x=Cancel(),outTerminate=x.outCancel}";
    let body = format!("dionet={net}&desc=[{}", "x".repeat(300_000));
    let head = format!(
        "POST /eval/ HTTP/1.1\r\nContent-Length: {}\r\n\r\n",
        body.len()
    );
    let eval = request(&server, &format!("{head}{body}"));
    assert!(
        eval.contains(r#"<data key="outTerminate">false</data>"#),
        "{eval}"
    );
}

#[test]
fn oversized_body_is_rejected_before_sending() {
    let server = TestServer::start(OnLoss::Keep);
    let head = "POST /nets/ HTTP/1.1\r\nContent-Length: 999999999\r\n\r\n";
    let answer = request(&server, &format!("{head}{}", "x".repeat(1 << 20)));
    assert!(answer.starts_with("HTTP/1.1 413 "), "{answer}");
}

/// Opens a session over WebSocket, runs a net in it and drops the connection.
fn lose_websocket_client(mut lost: KnownClient) -> NetId {
    let mut call = |line: String| {
        lost.send(0x81, line.as_bytes());
        loop {
            let answer = lost.text();
            if let Some(rest) = answer.strip_prefix("c=ok(") {
                return rest.trim_matches(['"', ')']).to_owned();
            }
        }
    };
    call("c=ver(\"2.0\")".to_owned());
    let session = call("c=nse(\"test\")".to_owned());
    let short = "{x=Cancel(),outTerminate=x.outCancel}";
    let net = call(format!("c=nene(\"{short}\",\"{session}\")"));
    call(format!("c=nest(\"{net}\")"));
    net.parse().unwrap()
}

#[test]
fn lost_client_net_ends_except_known_client() {
    let server = TestServer::start_with(ServerConfig::default());
    let lost = client(&server);
    run(&lost, CANCELLABLE);
    drop(lost);
    let versioned = KnownClient::connect_with(server.http, "Sec-WebSocket-Version: 13\r\n");
    lose_websocket_client(versioned);
    wait_until("the end of both sessions", || {
        server.controller.sessions().is_empty()
    });
    let stays = lose_websocket_client(KnownClient::connect(server.http));
    // Whether or not the loss has been handled when the next client is served, the net must run.
    let next = client(&server);
    let described = next.call("nin", [stays.to_string()]).unwrap();
    assert!(
        described.values[0]
            .to_string()
            .contains("state:\"RUNNING\""),
        "{described:?}"
    );
    assert_eq!(server.controller.sessions().len(), 1);
}

#[test]
fn lost_client_sessions_end_if_configured() {
    let server = TestServer::start(OnLoss::End);
    let lost = client(&server);
    run(&lost, CANCELLABLE);
    let stays = lost
        .call("nene", [ENDLESS])
        .unwrap()
        .text()
        .unwrap()
        .parse()
        .unwrap();
    drop(lost);
    wait_until("the end of the session", || {
        server.controller.sessions().is_empty()
    });
    // Nets without a session belong to no client.
    assert_eq!(server.controller.nets(), [stays]);
}

#[test]
fn connections_are_bounded() {
    let server = TestServer::start(OnLoss::Keep);
    let mut clients: Vec<_> = (0..CONNECTIONS_MAX).map(|_| client(&server)).collect();
    let bound = format!("at most {CONNECTIONS_MAX}");
    let error = Client::connect(&server.tcp.to_string())
        .unwrap_err()
        .to_string();
    assert!(error.contains(&bound), "{error}");
    // Requests have slots of their own.
    let status = request(&server, "GET /status/ HTTP/1.1\r\n\r\n");
    assert!(status.starts_with("HTTP/1.1 200 "), "{status}");
    clients.pop();
    wait_until("a free slot", || {
        Client::connect(&server.tcp.to_string()).is_ok()
    });
}

#[test]
fn shutdown_closes_connections() {
    let mut server = TestServer::start(OnLoss::Keep);
    let client = client(&server);
    server.stop();
    let error = client.next_push(TIMEOUT).unwrap_err();
    assert!(matches!(error, Error::Closed { .. }), "{error}");
}

#[tokio::test]
async fn listening_beyond_loopback_is_rejected() {
    let everywhere = SocketAddr::from(([0, 0, 0, 0], 0));
    let config = ServerConfig {
        tcp: Some(everywhere),
        ..ServerConfig::default()
    };
    let error = Server::bind(config).await.unwrap_err().to_string();
    assert!(
        error.starts_with("refusing to listen at 0.0.0.0:0"),
        "{error}"
    );
}

#[tokio::test]
async fn address_in_use_is_reported() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap();
    let config = ServerConfig {
        http: Some(address),
        ..ServerConfig::default()
    };
    let error = Server::bind(config).await.unwrap_err().to_string();
    assert!(
        error.starts_with(&format!("cannot listen at {address}: ")),
        "{error}"
    );
}

#[test]
fn random_bytes_leave_server_running() {
    let server = TestServer::start(OnLoss::Keep);
    let mut bytes = vec![0_u8; 20_000];
    let mut state = 1_u32;
    for byte in &mut bytes {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        *byte = state.to_be_bytes()[0];
    }
    for part in bytes.chunks(500) {
        for address in [server.tcp, server.http] {
            // The server may close before everything is sent.
            let _ = TcpStream::connect(address).unwrap().write_all(part);
        }
    }
    // The previous connections may still hold all slots.
    wait_until("a free slot", || {
        Client::connect(&server.tcp.to_string()).is_ok()
    });
    let mut client = KnownClient::connect(server.http);
    let _ = client.0.write_all(&bytes);
    drop(client);
    wait_until("service", || {
        Client::connect(&server.tcp.to_string()).is_ok()
    });
}
