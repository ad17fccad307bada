//! A client of unknown controllers: emulators of both generations, in virtual time.

use super::*;
use crate::diagnosis::{Verdict, judge};
use crate::lwr::emulator::{Krc, KrcConfig};
use crate::sunrise::emulator::{Cabinet, CabinetConfig};
use crate::sunrise::wire::MESSAGE_MAX;

/// Either emulated controller.
enum Controller {
    Krc(Box<Krc>),
    Cabinet(Box<Cabinet>),
}

impl Controller {
    fn krc() -> Self {
        Self::Krc(Box::new(Krc::new(KrcConfig::default(), Duration::ZERO)))
    }

    fn cabinet(dialect: Dialect) -> Self {
        let config = CabinetConfig {
            dialect,
            ..CabinetConfig::default()
        };
        Self::Cabinet(Box::new(Cabinet::new(config, Duration::ZERO)))
    }

    fn due(&self) -> Duration {
        match self {
            Self::Krc(krc) => krc.poll_timeout(),
            Self::Cabinet(cabinet) => cabinet.poll_timeout(),
        }
    }

    fn send(&mut self, now: Duration, buf: &mut [u8]) -> Option<usize> {
        match self {
            Self::Krc(krc) => krc.poll_transmit(now, buf),
            Self::Cabinet(cabinet) => cabinet.poll_transmit(now, buf),
        }
    }

    fn take(&mut self, bytes: &[u8], now: Duration) {
        match self {
            Self::Krc(krc) => krc.handle_datagram(bytes, now).map(drop).unwrap(),
            Self::Cabinet(cabinet) => cabinet.handle_datagram(bytes, now).map(drop).unwrap(),
        }
    }

    fn joints(&self) -> [f64; AXES] {
        match self {
            Self::Krc(krc) => krc.joints(),
            Self::Cabinet(cabinet) => cabinet.joints(),
        }
    }
}

/// `cycles` of a controller from `start`, each answered with the positions that `wanted` returns; without any, no answer is sent.
fn run(
    controller: &mut Controller,
    client: &mut Client,
    cycles: u32,
    mut wanted: impl FnMut(&mut Client) -> Option<[f64; AXES]>,
) {
    let (mut message, mut answer) = ([0; MESSAGE_MAX], [0; MESSAGE_MAX]);
    for _ in 0..cycles {
        let now = controller.due();
        while let Some(len) = controller.send(now, &mut message) {
            client.handle_datagram(&message[..len], now).unwrap();
            let joints = wanted(client);
            let Ok(built) = client.answer(joints.as_ref(), &mut answer) else {
                continue;
            };
            client.handle_sent(now + Duration::from_micros(50));
            controller.take(&answer[..built.len], now);
        }
    }
}

fn everyone() -> [(Controller, Version); 4] {
    [
        (Controller::krc(), Version::Lwr),
        (
            Controller::cabinet(Dialect::V1),
            Version::Sunrise(Some(Dialect::V1)),
        ),
        (
            Controller::cabinet(Dialect::V2),
            Version::Sunrise(Some(Dialect::V2)),
        ),
        (
            Controller::cabinet(Dialect::V3),
            Version::Sunrise(Some(Dialect::V3)),
        ),
    ]
}

#[test]
fn client_detects_version_and_holds_robot() {
    for (mut controller, version) in everyone() {
        let before = controller.joints();
        let mut client = Client::new(ClientConfig::default());
        assert_eq!(client.status(), Status::default());
        run(&mut controller, &mut client, 1_000, |_| None);
        let status = client.status();
        assert_eq!(status.version, Some(version));
        assert_eq!(status.phase, Phase::Command, "{version}");
        assert!(
            status.quality.is_some_and(Quality::is_sound),
            "{:?}",
            status.quality
        );
        assert_eq!(status.has_power, Some(true));
        assert_eq!(status.counters.answered, 1_000, "{version}");
        for (now, before) in controller.joints().iter().zip(before) {
            assert!((now - before).abs() < 1e-6, "{version}");
        }
        let verdict = judge(&client.observed());
        assert_eq!(verdict, Verdict::Good, "{version}");
        assert!(client.observed().acknowledged > 900, "{version}");
    }
}

#[test]
fn client_positions_move_robot_in_command() {
    for (mut controller, version) in everyone() {
        let mut client = Client::new(ClientConfig::default());
        let before = controller.joints();
        run(&mut controller, &mut client, 1_000, |client| {
            client.engage().ok()?;
            let mut joints = client.mirror();
            joints[3] += 1e-4;
            (client.phase() == Phase::Command).then_some(joints)
        });
        let moved = controller.joints()[3] - before[3];
        assert!((0.03..0.1).contains(&moved), "{version}: {moved}");
    }
}

#[test]
fn client_accepts_other_generation_after_silence() {
    let mut client = Client::new(ClientConfig::default());
    run(&mut Controller::krc(), &mut client, 10, |_| None);
    assert_eq!(client.version(), Some(Version::Lwr));
    assert!(client.handle_timeout(Duration::from_secs(3)));
    assert_eq!(client.phase(), Phase::Offline);
    run(
        &mut Controller::cabinet(Dialect::V3),
        &mut client,
        10,
        |_| None,
    );
    assert_eq!(client.version(), Some(Version::Sunrise(Some(Dialect::V3))));
    let counters = client.status().counters;
    assert_eq!((counters.answered, counters.silences), (20, 1));
    assert_eq!(client.observed().measurements, 10);
}

#[test]
fn client_unexpected_version_is_reported() {
    let error_text = |expected, controller: &mut Controller| {
        let mut client = Client::new(ClientConfig {
            expected: Some(expected),
            ..ClientConfig::default()
        });
        let mut message = [0; MESSAGE_MAX];
        let len = controller.send(controller.due(), &mut message).unwrap();
        let refused = client.handle_datagram(&message[..len], Duration::ZERO);
        assert_eq!(client.status().last_error, refused.err());
        assert_eq!(client.status().counters.refused, 1);
        refused.unwrap_err().to_string()
    };
    assert_eq!(
        error_text(Version::Sunrise(None), &mut Controller::krc()),
        "the controller speaks FRI 1.0 (LWR), expected FRI of Sunrise: the client's SDK must have the \
         controller's version"
    );
    assert_eq!(
        error_text(
            Version::Sunrise(Some(Dialect::V1)),
            &mut Controller::cabinet(Dialect::V3)
        ),
        "the controller speaks FRI 2.7 (3.0), this session is configured for FRI 1.x: correct the setting or leave \
         it to detection"
    );
}

#[test]
fn client_rejects_foreign_datagrams_and_continues() {
    let mut client = Client::new(ClientConfig::default());
    let mut refused = |bytes: &[u8]| {
        let result = client.handle_datagram(bytes, Duration::ZERO);
        result.unwrap_err().to_string()
    };
    assert_eq!(
        refused(b"hello"),
        "expected a controller's measurements, received no FRI datagram: another program uses this port; \
         choose a port that only the controller uses"
    );
    let mut cmd = [0; lwr::wire::Cmd::LEN];
    lwr::wire::Cmd::default().encode(&mut cmd).unwrap();
    assert!(
        refused(&cmd).contains("a second client sends to this host instead of a controller"),
        "{}",
        refused(&cmd)
    );
    let mut krc = Controller::krc();
    run(&mut krc, &mut client, 100, |_| None);
    assert!(client.handle_datagram(&cmd, krc.due()).is_err());
    run(&mut krc, &mut client, 100, |_| None);
    assert_eq!(client.status().counters.answered, 200);
}

#[test]
fn client_second_client_is_detected_by_reflection() {
    for (mut controller, version) in everyone() {
        let mut client = Client::new(ClientConfig::default());
        // Runs longer than the client: its counters are far ahead.
        let mut second = Client::new(ClientConfig {
            lwr: lwr::SessionConfig {
                first_sequence: 30_000,
                ..lwr::SessionConfig::default()
            },
            ..ClientConfig::default()
        });
        run(&mut controller, &mut second, 500, |_| None);
        let (mut message, mut answer) = ([0; MESSAGE_MAX], [0; MESSAGE_MAX]);
        for cycle in 0..1_000 {
            let now = controller.due();
            let Some(len) = controller.send(now, &mut message) else {
                continue;
            };
            for (client, comes) in [(&mut client, true), (&mut second, cycle % 2 == 0)] {
                let _taken = client.handle_datagram(&message[..len], now);
                let built = client.answer(None, &mut answer).unwrap();
                client.handle_sent(now);
                if comes {
                    controller.take(&answer[..built.len], now);
                }
            }
        }
        let verdict = judge(&client.observed());
        assert!(
            matches!(verdict, Verdict::SecondClient { foreign } if (0.3..=0.7).contains(&foreign)),
            "{version}: {verdict}"
        );
    }
}
