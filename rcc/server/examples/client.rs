//! Runs a controller without devices, its server, and a client that executes a net, all in one process and
//! without hardware. WebSocket is not shown.

use std::error::Error;
use std::net::SocketAddr;
use std::time::Duration;

use takt_client::{Client, Value};
use takt_core::{CellConfig, Controller};
use takt_server::{Server, ServerConfig};

/// Counts to 50 ms and ends.
const NET: &str = "{c=Core::Clock(Increment='1'),\
    g=Core::DoubleGreater(inFirst=c.outValue,Second='0.05'),\
    t=Core::DoubleNetcommOut(inValue=c.outValue,Key='t'),outTerminate=g.outValue}";

#[tokio::main]
async fn main() -> Result<(), Box<dyn Error>> {
    let mut cell = CellConfig::default();
    cell.controller.priority = None;
    let controller = Controller::start(&cell)?;
    let tcp = Some(SocketAddr::from(([127, 0, 0, 1], 0)));
    let server = Server::bind(ServerConfig {
        tcp,
        ..ServerConfig::default()
    })
    .await?;
    let address = server.tcp_address().ok_or("no address")?.to_string();
    let (done, finished) = tokio::sync::oneshot::channel::<()>();
    let program = tokio::task::spawn_blocking(move || {
        let outcome = program(&address);
        drop(done);
        outcome
    });
    server.run(controller, async { drop(finished.await) }).await;
    Ok(program.await??)
}

/// The client program; blocking.
fn program(address: &str) -> Result<(), takt_client::Error> {
    let client = Client::connect(address)?;
    let loaded = client.call("nene", [NET])?;
    let net = loaded.text().unwrap_or_default();
    let every = Value::from("every");
    client.call("gne", [Value::from(net), Value::from(0.01), every])?;
    client.call("nest", [net])?;
    while let Some(push) = client.next_push(Duration::from_secs(5))? {
        print(&push.to_string());
        if push.args == [Value::from("TERMINATED")] {
            break;
        }
    }
    Ok(())
}

#[expect(clippy::print_stdout, reason = "the example prints what it receives")]
fn print(line: &str) {
    println!("{line}");
}
