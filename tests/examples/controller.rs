//! A controller with the simulated arms `left` and `right`, a KUKA youBot (`platform`, `hand`), a Schunk WSG (`gripper`,
//! with a part of 0.05 m) and inputs and outputs (`plant`), for programs in other languages: it prints the address of its
//! line protocol, then those of HTTP and of the Foxglove WebSocket, and ends with its standard input. It accepts connections of this
//! host only, and records to a file if one is given.
//!
//! ```console
//! $ cargo run -p takt-tests --example controller -- [RECORDING]
//! ```

use std::collections::BTreeMap;
use std::error::Error;
use std::io::{Read as _, Write as _};
use std::net::SocketAddr;
use std::path::Path;

use takt_core::controller::MachineRequest;
use takt_core::record::Recorder;
use takt_core::{CellConfig, Controller};
use takt_server::{LiveConfig, Server, ServerConfig};

/// Where things are in a recording.
const PLACED: &str = "[[base]]
device = 'left'
position = [0, 0.3, 0.5]

[[tool]]
name = 'pen'
device = 'left'
position = [0, 0, 0.2]
";

fn main() -> Result<(), Box<dyn Error>> {
    let controller = match std::env::args_os().nth(1) {
        Some(path) => {
            let (recorder, tap) = Recorder::start(Path::new(&path))?;
            recorder
                .log()
                .line(tracing::Level::INFO, "tests", "the recording has begun");
            let cell = CellConfig::parse(PLACED, &[])?;
            Controller::start_recording(&cell, Some((recorder, tap)))?
        }
        None => Controller::start(&CellConfig::default())?,
    };
    add_devices(&controller)?;
    if std::env::args_os().nth(1).is_some() {
        let machine =
            "machine Blink { initial state On { transition to Off; } final state Off { } }";
        let name = controller.load_machine(&MachineRequest {
            text: machine.to_owned(),
            ..MachineRequest::default()
        })?;
        controller.start_machine(&name)?;
    }
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(1)
        .enable_all()
        .build()?;
    let any = Some(SocketAddr::from(([127, 0, 0, 1], 0)));
    let config = ServerConfig {
        tcp: any,
        http: any,
        live: LiveConfig {
            foxglove: any,
            services: true,
            ..LiveConfig::default()
        },
        ..ServerConfig::default()
    };
    let server = runtime.block_on(Server::bind(config))?;
    let address = server.tcp_address().ok_or("the server has no address")?;
    let mut out = std::io::stdout();
    writeln!(out, "{address}")?;
    for address in [server.http_address(), server.foxglove_address()] {
        writeln!(out, "{}", address.ok_or("the server has no address")?)?;
    }
    out.flush()?;
    let (stop, stopped) = tokio::sync::oneshot::channel();
    std::thread::spawn(move || {
        // The end of the input, or of its reading, is the request to stop.
        let _ = std::io::stdin().read_to_end(&mut Vec::new());
        let _ = stop.send(());
    });
    runtime.block_on(server.run(controller, async {
        let _ = stopped.await;
    }));
    Ok(())
}

/// Two arms, a base, grippers, inputs and outputs.
fn add_devices(controller: &Controller) -> Result<(), Box<dyn Error>> {
    for arm in ["left", "right"] {
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
        controller.add_device(arm, "kuka_lwr_sim", &parameters)?;
    }
    let part = BTreeMap::from([("part".to_owned(), "0.05".to_owned())]);
    for (device, kind, parameters) in [
        ("platform", "kuka_youbot_base_sim", &BTreeMap::new()),
        ("hand", "kuka_youbot_gripper_sim", &BTreeMap::new()),
        ("gripper", "schunk_wsg_sim", &part),
        ("plant", "io_sim", &BTreeMap::new()),
    ] {
        controller.add_device(device, kind, parameters)?;
    }
    Ok(())
}
