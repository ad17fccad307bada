//! Bounds of the server that need sockets, each with an error that names the bound; and configuration of tokens and
//! lost clients.

#![expect(
    clippy::unwrap_used,
    reason = "tests and their helpers fail by panicking"
)]

mod common;

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::{Duration, Instant};

use common::TestServer;
use takt_client::{Client, Token, Value};
use takt_server::{OnLoss, Server, ServerConfig};

/// Far longer than any test takes; expires only if a test fails.
const TIMEOUT: Duration = Duration::from_secs(20);

const TOKEN: &str = "0123456789abcdef";

const TAPPED: &str = "{c=Core::Clock(),x=Cancel(),a=Core::DoubleAdd(inFirst[0.5]=c.outValue),\
    outTerminate=x.outCancel}";

fn get(server: &TestServer, path: &str) -> TcpStream {
    let mut stream = TcpStream::connect(server.http).unwrap();
    stream.set_read_timeout(Some(TIMEOUT)).unwrap();
    let request = format!("GET {path} HTTP/1.1\r\n\r\n");
    stream.write_all(request.as_bytes()).unwrap();
    stream
}

fn read_until(stream: &mut TcpStream, done: impl Fn(&str) -> bool) -> String {
    let (mut text, mut part) = (String::new(), [0; 4096]);
    while !done(&text) {
        let count = stream.read(&mut part).unwrap();
        assert!(count > 0, "the server closed after {text}");
        text.push_str(std::str::from_utf8(&part[..count]).unwrap());
    }
    text
}

#[test]
fn debug_streams_are_live_and_bounded() {
    let server = TestServer::start(OnLoss::Keep);
    let client = Client::connect(&server.tcp.to_string()).unwrap();
    let net = client.call("nene", [TAPPED]).unwrap();
    let net = net.text().unwrap().to_owned();
    client.call("nest", [net.as_str()]).unwrap();
    let path = format!("/nets/{net}/debugstream");
    let mut streams: Vec<_> = (0..8)
        .map(|_| {
            let mut stream = get(&server, &path);
            let head = read_until(&mut stream, |t| t.contains("time\ta.inFirst\n"));
            assert!(head.contains("Transfer-Encoding: chunked\r\n"), "{head}");
            stream
        })
        .collect();
    let mut refused = String::new();
    get(&server, &path).read_to_string(&mut refused).unwrap();
    assert!(refused.starts_with("HTTP/1.1 503 "), "{refused}");
    assert!(refused.contains("at most 8 debug streams"), "{refused}");
    let rows = |text: &str| text.lines().filter(|line| line.contains('\t')).count();
    read_until(&mut streams[0], |text| rows(text) > 20);
    client.call("neca", [net.as_str()]).unwrap();
    // The streams end with their net.
    for mut stream in streams {
        let mut rest = String::new();
        stream.read_to_string(&mut rest).unwrap();
        assert!(rest.ends_with("\r\n0\r\n\r\n"), "{rest}");
    }
    let mut missing = String::new();
    get(&server, "/nets/rpinet9/debugstream")
        .read_to_string(&mut missing)
        .unwrap();
    assert!(missing.starts_with("HTTP/1.1 404 "), "{missing}");
}

#[test]
fn session_sets_on_loss_when_opened() {
    let server = TestServer::start(OnLoss::Keep);
    let lost = Client::connect(&server.tcp.to_string()).unwrap();
    lost.call("nse", ["stays"]).unwrap();
    lost.call("nse", ["ends", "end"]).unwrap();
    let error = lost.call("nse", ["what", "maybe"]).unwrap_err().to_string();
    assert!(error.contains("\"keep\" or \"end\""), "{error}");
    assert_eq!(server.controller.sessions().len(), 2);
    drop(lost);
    let until = Instant::now() + TIMEOUT;
    while server.controller.sessions().len() > 1 {
        assert!(Instant::now() < until, "the session does not end");
        std::thread::sleep(Duration::from_millis(1));
    }
    assert_eq!(server.controller.sessions()[0].1, "stays");
}

#[tokio::test]
async fn listening_beyond_loopback_requires_token() {
    let everywhere = SocketAddr::from(([0, 0, 0, 0], 0));
    let config = |token| ServerConfig {
        http: Some(everywhere),
        token,
        ..ServerConfig::default()
    };
    let error = Server::bind(config(None)).await.unwrap_err().to_string();
    assert!(error.contains("openssl rand -hex 32"), "{error}");
    assert!(error.contains("token_file under [controller]"), "{error}");
    let token = Token::new(TOKEN).unwrap();
    assert!(Server::bind(config(Some(token))).await.is_ok());
}

#[test]
fn client_sends_its_token() {
    let token = Token::new(TOKEN).unwrap();
    let server = TestServer::start_with(ServerConfig {
        token: Some(token.clone()),
        ..ServerConfig::default()
    });
    let address = server.tcp.to_string();
    let error = Client::connect(&address).unwrap_err().to_string();
    assert!(error.contains("--token-file or TAKT_TOKEN"), "{error}");
    let client = Client::connect_with(&address, Some(&token)).unwrap();
    assert_eq!(client.call("nin", [""; 0]).unwrap().values.len(), 1);
    let wrong = Token::new("wrong-wrong-wrong-wrong").unwrap();
    let error = Client::connect_with(&address, Some(&wrong)).unwrap_err();
    assert!(error.to_string().contains("wrong token"), "{error}");
    // A server without a token accepts any.
    let open = TestServer::start(OnLoss::Keep);
    assert!(Client::connect_with(&open.tcp.to_string(), Some(&token)).is_ok());
}

#[test]
fn long_line_before_token_closes_connection() {
    let server = TestServer::start_with(ServerConfig {
        token: Some(Token::new(TOKEN).unwrap()),
        ..ServerConfig::default()
    });
    let mut stream = TcpStream::connect(server.tcp).unwrap();
    stream.set_read_timeout(Some(TIMEOUT)).unwrap();
    let line = format!("t=tok(\"{}", "a".repeat(513 - 7));
    stream.write_all(line.as_bytes()).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    assert!(answer.contains("more than 512 bytes"), "{answer}");
    // After the token, longer messages are accepted.
    let token = Token::new(TOKEN).unwrap();
    let client = Client::connect_with(&server.tcp.to_string(), Some(&token)).unwrap();
    let description = "d".repeat(4000);
    client.call("nse", [description.as_str()]).unwrap();
}

#[test]
fn net_count_is_bounded() {
    use takt_core::controller::NETS_MAX;
    let server = TestServer::start(OnLoss::Keep);
    let client = Client::connect(&server.tcp.to_string()).unwrap();
    let net = "{x=Cancel(),outTerminate=x.outCancel}";
    for _ in 0..NETS_MAX {
        client.call("nene", [net]).unwrap();
    }
    let error = client.call("nene", [net]).unwrap_err().to_string();
    assert!(
        error.contains("loaded nets") && error.contains("1024"),
        "{error}"
    );
    let described = client.call("nin", ["rpinet0"]).unwrap();
    assert!(matches!(described.values[0], Value::Map(_)));
}
