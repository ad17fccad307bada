//! What the server adds to loading: a net of 10,000 primitives is loaded in this process and over WebSocket, in turns,
//! and the medians are compared. It measures the whole way of a client: frame, message, load, reply.
//!
//! ```console
//! $ cargo run --release -p takt-server --example load
//! ```

use std::error::Error;
use std::fmt::Write as _;
use std::io::{Read, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::time::{Duration, Instant};

use takt_core::controller::{LoadRequest, NetState};
use takt_core::{CellConfig, Controller, NetId, SessionId};
use takt_server::{Server, ServerConfig};

const PRIMITIVES: usize = 10_000;
const ROUNDS: usize = 15;
/// Long enough for the cost of that many primitives.
const PERIOD: Duration = Duration::from_millis(50);

/// The handshake of the known client, whose frames are not masked.
const UPGRADE: &str = "GET /DirectIO/ HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\n\
    Connection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n";

/// A chain of additions.
fn net() -> String {
    let mut text =
        "{x=Cancel(),outTerminate=x.outCancel,a0=Core::DoubleValue(Value='1')".to_owned();
    for n in 1..PRIMITIVES - 1 {
        // Writing to a String cannot fail.
        let _ = write!(
            text,
            ",a{n}=Core::DoubleAdd(inFirst=a{}.outValue,Second='1')",
            n - 1
        );
    }
    text + "}"
}

/// A client over WebSocket.
struct Client(TcpStream);

impl Client {
    fn connect(address: SocketAddr) -> Result<Self, Box<dyn Error>> {
        let mut stream = TcpStream::connect(address)?;
        stream.set_nodelay(true)?;
        stream.write_all(UPGRADE.as_bytes())?;
        let mut head = Vec::new();
        while !head.ends_with(b"\r\n\r\n") {
            let mut byte = [0];
            stream.read_exact(&mut byte)?;
            head.extend(byte);
        }
        let mut client = Self(stream);
        client.call("c=ver(\"2.0\")")?;
        Ok(client)
    }

    /// Sends a message and returns the next one.
    fn call(&mut self, line: &str) -> Result<String, Box<dyn Error>> {
        let mut frame = vec![0x81];
        match u16::try_from(line.len()) {
            Ok(short) if short < 126 => frame.push(u8::try_from(short)?),
            Ok(middle) => {
                frame.push(126);
                frame.extend(middle.to_be_bytes());
            }
            Err(_) => {
                frame.push(127);
                frame.extend(u64::try_from(line.len())?.to_be_bytes());
            }
        }
        frame.extend(line.bytes());
        self.0.write_all(&frame)?;
        let mut head = [0; 2];
        self.0.read_exact(&mut head)?;
        let mut payload = vec![0; usize::from(head[1])];
        self.0.read_exact(&mut payload)?;
        Ok(String::from_utf8(payload)?)
    }
}

fn load_here(controller: &Controller, text: &str) -> Result<Duration, Box<dyn Error>> {
    let begin = Instant::now();
    let net = controller.load(LoadRequest {
        text: text.to_owned(),
        session: SessionId::NONE,
        description: String::new(),
        period: Some(PERIOD),
    })?;
    let took = begin.elapsed();
    unload(controller, net)?;
    Ok(took)
}

fn load_there(
    controller: &Controller,
    client: &mut Client,
    text: &str,
) -> Result<Duration, Box<dyn Error>> {
    let seconds = PERIOD.as_secs_f64();
    let line = format!("l=nene(\"{text}\",\"s0\",\"\",{seconds},0)");
    let begin = Instant::now();
    let reply = client.call(&line)?;
    let took = begin.elapsed();
    let name = reply.strip_prefix("l=ok(\"").ok_or("not loaded")?;
    let name = name.strip_suffix("\")").ok_or("not loaded")?;
    unload(controller, name.parse()?)?;
    Ok(took)
}

fn unload(controller: &Controller, net: NetId) -> Result<(), Box<dyn Error>> {
    let state = controller.net(net).map(|net| net.state());
    if state != Some(NetState::Ready) {
        return Err(format!("{net} is {state:?}").into());
    }
    Ok(controller.unload(net)?)
}

fn median(mut times: Vec<Duration>) -> Duration {
    times.sort_unstable();
    times.get(times.len() / 2).copied().unwrap_or_default()
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut cell = CellConfig::default();
    cell.controller.priority = None;
    let controller = Controller::start(&cell)?;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()?;
    let config = ServerConfig {
        http: Some(SocketAddr::from(([127, 0, 0, 1], 0))),
        ..ServerConfig::default()
    };
    let server = runtime.block_on(Server::bind(config))?;
    let address = server.http_address().ok_or("no address")?;
    runtime.spawn(server.run(controller.clone(), std::future::pending()));
    let mut client = Client::connect(address)?;
    let text = net();
    let (mut here, mut there) = (Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        here.push(load_here(&controller, &text)?);
        there.push(load_there(&controller, &mut client, &text)?);
    }
    print(text.len(), median(here), median(there));
    runtime.shutdown_background();
    Ok(())
}

#[expect(clippy::print_stdout, reason = "the example prints what it measured")]
fn print(bytes: usize, here: Duration, there: Duration) {
    let ratio = there.as_secs_f64() / here.as_secs_f64();
    println!("{PRIMITIVES} primitives, {bytes} bytes of text, median of {ROUNDS}");
    println!("in process {here:.2?}, over WebSocket {there:.2?}, {ratio:.2} times");
}
