//! A partner of unknown controllers: emulators of both generations, in virtual time.

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

/// `cycles` of a controller from `start`, each answered with what `wanted` says; false sends no answer.
fn run(
    controller: &mut Controller,
    partner: &mut Partner,
    cycles: u32,
    mut wanted: impl FnMut(&mut Partner) -> Option<[f64; AXES]>,
) {
    let (mut message, mut answer) = ([0; MESSAGE_MAX], [0; MESSAGE_MAX]);
    for _ in 0..cycles {
        let now = controller.due();
        while let Some(len) = controller.send(now, &mut message) {
            partner.handle_datagram(&message[..len], now).unwrap();
            let joints = wanted(partner);
            let Ok(built) = partner.answer(joints.as_ref(), &mut answer) else {
                continue;
            };
            partner.handle_sent(now + Duration::from_micros(50));
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
fn whoever_comes_is_found_out_and_kept_at_rest() {
    for (mut controller, version) in everyone() {
        let before = controller.joints();
        let mut partner = Partner::new(PartnerConfig::default());
        assert_eq!(partner.status(), Status::default());
        run(&mut controller, &mut partner, 1_000, |_| None);
        let status = partner.status();
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
        let verdict = judge(&partner.observed());
        assert_eq!(verdict, Verdict::Good, "{version}");
        assert!(partner.observed().heard > 900, "{version}");
    }
}

#[test]
fn positions_move_the_robot_once_it_follows() {
    for (mut controller, version) in everyone() {
        let mut partner = Partner::new(PartnerConfig::default());
        let before = controller.joints();
        run(&mut controller, &mut partner, 1_000, |partner| {
            partner.engage().ok()?;
            let mut joints = partner.mirror();
            joints[3] += 1e-4;
            (partner.phase() == Phase::Command).then_some(joints)
        });
        let moved = controller.joints()[3] - before[3];
        assert!((0.03..0.1).contains(&moved), "{version}: {moved}");
    }
}

#[test]
fn a_controller_that_comes_back_may_be_of_the_other_generation() {
    let mut partner = Partner::new(PartnerConfig::default());
    run(&mut Controller::krc(), &mut partner, 10, |_| None);
    assert_eq!(partner.version(), Some(Version::Lwr));
    assert!(partner.handle_timeout(Duration::from_secs(3)));
    assert_eq!(partner.phase(), Phase::Offline);
    run(
        &mut Controller::cabinet(Dialect::V3),
        &mut partner,
        10,
        |_| None,
    );
    assert_eq!(partner.version(), Some(Version::Sunrise(Some(Dialect::V3))));
    let counters = partner.status().counters;
    assert_eq!((counters.answered, counters.silences), (20, 1));
    assert_eq!(partner.observed().measurements, 10);
}

#[test]
fn what_is_not_the_version_asked_for_is_named() {
    let refusal = |expected, controller: &mut Controller| {
        let mut partner = Partner::new(PartnerConfig {
            expected: Some(expected),
            ..PartnerConfig::default()
        });
        let mut message = [0; MESSAGE_MAX];
        let len = controller.send(controller.due(), &mut message).unwrap();
        let refused = partner.handle_datagram(&message[..len], Duration::ZERO);
        assert_eq!(partner.status().refusal, refused.err());
        assert_eq!(partner.status().counters.refused, 1);
        refused.unwrap_err().to_string()
    };
    assert_eq!(
        refusal(Version::Sunrise(None), &mut Controller::krc()),
        "the controller speaks FRI 1.0 (LWR), FRI of Sunrise was asked for: the client's SDK must be of the \
         controller's version"
    );
    assert_eq!(
        refusal(
            Version::Sunrise(Some(Dialect::V1)),
            &mut Controller::cabinet(Dialect::V3)
        ),
        "the controller speaks FRI 2.7 (3.0), this session was told to speak FRI 1.x: correct the setting or leave \
         it to detection"
    );
}

#[test]
fn strangers_are_named_and_do_not_disturb() {
    let mut partner = Partner::new(PartnerConfig::default());
    let mut refused = |bytes: &[u8]| {
        let heard = partner.handle_datagram(bytes, Duration::ZERO);
        heard.unwrap_err().to_string()
    };
    assert_eq!(
        refused(b"hello"),
        "no FRI datagram came, where only a controller's measurements are due: another program uses this port; \
         choose a port of the controller's own"
    );
    let mut cmd = [0; lwr::wire::Cmd::LEN];
    lwr::wire::Cmd::default().encode(&mut cmd).unwrap();
    assert!(
        refused(&cmd).contains("a second client takes this host for a controller"),
        "{}",
        refused(&cmd)
    );
    let mut krc = Controller::krc();
    run(&mut krc, &mut partner, 100, |_| None);
    assert!(partner.handle_datagram(&cmd, krc.due()).is_err());
    run(&mut krc, &mut partner, 100, |_| None);
    assert_eq!(partner.status().counters.answered, 200);
}

#[test]
fn a_second_client_is_seen_in_what_the_controller_reflects() {
    for (mut controller, version) in everyone() {
        let mut partner = Partner::new(PartnerConfig::default());
        // Runs longer than the partner: its counters are far ahead.
        let mut second = Partner::new(PartnerConfig {
            lwr: lwr::SessionConfig {
                first_sequence: 30_000,
                ..lwr::SessionConfig::default()
            },
            ..PartnerConfig::default()
        });
        run(&mut controller, &mut second, 500, |_| None);
        let (mut message, mut answer) = ([0; MESSAGE_MAX], [0; MESSAGE_MAX]);
        for cycle in 0..1_000 {
            let now = controller.due();
            let Some(len) = controller.send(now, &mut message) else {
                continue;
            };
            for (client, comes) in [(&mut partner, true), (&mut second, cycle % 2 == 0)] {
                let _taken = client.handle_datagram(&message[..len], now);
                let built = client.answer(None, &mut answer).unwrap();
                client.handle_sent(now);
                if comes {
                    controller.take(&answer[..built.len], now);
                }
            }
        }
        let verdict = judge(&partner.observed());
        assert!(
            matches!(verdict, Verdict::SecondClient { strange } if (0.3..=0.7).contains(&strange)),
            "{version}: {verdict}"
        );
    }
}
