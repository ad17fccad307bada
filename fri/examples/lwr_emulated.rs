//! A session commands an emulated LWR over a wire that loses 1 % of all datagrams, in virtual time: no hardware, no waiting.
//! It is no real-time program.
#![expect(clippy::print_stdout, reason = "examples print results")]

use std::time::Duration;
use takt_fri::lwr::emulator::{Faults, Krc, KrcConfig, LineFaults, PowerOff};
use takt_fri::lwr::wire::{Cmd, Msr};
use takt_fri::lwr::{AXES, Session, SessionConfig};

/// Angular frequency of the motion, rad/s.
const OMEGA: f64 = 2.0;
const END: Duration = Duration::from_secs(6);

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let line = LineFaults {
        drop: 0.01,
        ..LineFaults::default()
    };
    let power_off = PowerOff {
        at: Duration::from_secs(3),
        span: Duration::from_secs(1),
    };
    let faults = Faults {
        to_client: line,
        to_krc: line,
        power_off: Some(power_off),
        ..Faults::default()
    };
    let mut krc = Krc::new(
        KrcConfig {
            faults,
            ..KrcConfig::default()
        },
        Duration::ZERO,
    );
    let mut session = Session::new(SessionConfig::default());
    let mut swing = Swing::default();
    let (mut msr, mut cmd) = ([0; Msr::LEN], [0; Cmd::LEN]);
    while krc.poll_timeout() < END {
        let now = krc.poll_timeout();
        while let Some(len) = krc.poll_transmit(now, &mut msr) {
            let reception = session.handle_datagram(&msr[..len], now)?;
            if let Some(event) = reception.event {
                println!(
                    "{:7.3} s  {event}, quality {}",
                    now.as_secs_f64(),
                    reception.quality
                );
            }
            let joints = swing.joints(&session, now);
            let len = session.answer(joints.as_ref(), &mut cmd)?;
            krc.handle_datagram(&cmd[..len], now)?;
        }
    }
    println!("{}", Msr::decode(&msr)?);
    println!("{}", Cmd::decode(&cmd)?);
    println!("{:?}\n{:?}", session.counters(), krc.counters());
    for left in krc.log() {
        println!(
            "{:7.3} s  left command mode: {}",
            left.at.as_secs_f64(),
            left.reason
        );
    }
    Ok(())
}

/// Swings A1 by 0.4 rad from the position at the start of command mode.
#[derive(Default)]
struct Swing {
    began: Option<(Duration, [f64; AXES])>,
}

impl Swing {
    fn joints(&mut self, session: &Session, now: Duration) -> Option<[f64; AXES]> {
        if !session.is_commanding() {
            self.began = None;
            return None;
        }
        let (since, mut joints) = *self.began.get_or_insert_with(|| (now, session.mirror()));
        joints[0] += 0.2 * (1.0 - (OMEGA * (now - since).as_secs_f64()).cos());
        Some(joints)
    }
}
