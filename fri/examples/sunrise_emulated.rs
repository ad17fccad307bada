//! A session presses an emulated iiwa onto a table by Cartesian impedance and a wrench, then removes the table; over a wire that
//! loses 1 % of all datagrams, in virtual time: no hardware, no waiting. It is no real-time program.
#![expect(clippy::print_stdout, reason = "examples print results")]

use std::time::Duration;
use takt_fri::sunrise::emulator::{
    Cabinet, CabinetConfig, Contact, Control, LineFaults, Overlay, Program, Shape,
};
use takt_fri::sunrise::wire::{CommandMode, Dialect, MESSAGE_MAX};
use takt_fri::sunrise::{Demand, Event, Session, SessionConfig};

const TABLE_GOES: Duration = Duration::from_secs(3);
const END: Duration = Duration::from_secs(4);
const PRINT_PERIOD: Duration = Duration::from_millis(250);

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut cabinet = Cabinet::new(config(), Duration::ZERO);
    let height = cabinet.flange()[2] - 0.004;
    *cabinet.contact_mut() = Some(Contact {
        shape: Shape::Wall,
        point: [0.0, 0.0, height],
        normal: [0.0, 0.0, 1.0],
        stiffness: 15_000.0,
        damping: 50.0,
    });
    let mut session = Session::new(SessionConfig::default());
    let (mut buf, mut next_print) = ([0; MESSAGE_MAX], Duration::ZERO);
    while cabinet.poll_timeout() < END {
        let now = cabinet.poll_timeout();
        if now >= TABLE_GOES {
            *cabinet.contact_mut() = None;
        }
        while let Some(len) = cabinet.poll_transmit(now, &mut buf) {
            let reception = session.handle_datagram(&buf[..len], now)?;
            if let Some(event) = reception.event {
                println!(
                    "{:7.3} s  {event}, {}",
                    now.as_secs_f64(),
                    reception.quality
                );
            }
            if reception.event == Some(Event::CommandEntered) {
                session.engage()?;
            }
            let wrench = [0.0, 0.0, -30.0, 0.0, 0.0, 0.0];
            let joints = None;
            if let Ok(answer) = session.answer(&Demand::Wrench { wrench, joints }, &mut buf) {
                cabinet.handle_datagram(&buf[..answer.len], now)?;
            }
        }
        if now >= next_print {
            next_print += PRINT_PERIOD;
            let ([_, _, z], [_, _, force]) = (cabinet.flange(), cabinet.force());
            let millimetres = (z - height) * 1e3;
            println!(
                "{:7.3} s  {millimetres:6.2} mm above the table, {force:5.1} N",
                now.as_secs_f64()
            );
        }
    }
    if let Some(message) = session.message() {
        println!("{message}");
    }
    println!("{:?}\n{:?}", session.counters(), cabinet.counters());
    Ok(())
}

fn config() -> CabinetConfig {
    let line = LineFaults {
        drop: 0.01,
        ..LineFaults::default()
    };
    let control = Control::CartesianImpedance {
        stiffness: [2000.0, 2000.0, 2000.0, 200.0, 200.0, 200.0],
        damping: [0.7; 6],
    };
    let command = CommandMode::Wrench;
    let mut config = CabinetConfig {
        dialect: Dialect::V3,
        program: Program::Auto {
            overlay: Overlay { control, command },
            restart: None,
        },
        ..CabinetConfig::default()
    };
    (config.faults.to_client, config.faults.to_cabinet) = (line, line);
    config
}
