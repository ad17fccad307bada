//! How arms over FRI come to rest when the net that moves them ends: what leaves in their datagrams, and where the
//! emulated controllers have the joint.

use takt_fri::sunrise::IoLevel;
use takt_fri::sunrise::emulator::Io;
use takt_fri::sunrise::wire::IoDirection;

use super::*;
use crate::plant::{Plant, Row, Wire, joint, outputs_follow_their_policy};
use takt_core::device::on_end::{OnEnd, OutputsOnEnd};

impl<C: Controller, P: Protocol> Plant for Rig<C, P> {
    fn now(&self) -> Nanos {
        self.now.into()
    }

    fn run_to(&mut self, until: Nanos, given: &DeviceCommand, is_ending: bool) {
        self.is_led = true;
        self.wanted.copy_from(given);
        if is_ending {
            self.driver.begin_stop();
        }
        while Nanos::from(self.controller.due()) <= until {
            self.step();
        }
    }

    fn copy_state(&mut self, state: &mut DeviceState) {
        self.state.read_with(|reported| state.copy_from(reported));
    }

    fn sent(&mut self) -> f64 {
        self.driver.session.rest()[JOINT]
    }

    fn place(&mut self) -> f64 {
        self.controller.set_point()[JOINT]
    }

    fn fail(&mut self, is_on: bool) {
        self.controller.power(!is_on);
    }
}

fn row(name: &'static str, description: DeviceDescription) -> Row {
    Row {
        name,
        acceleration: description.limits[JOINT].acceleration_max,
        description,
        children: joint(JOINT, [0.5, -0.5]),
        runs: 260,
        wire: Wire::Positions,
        resolution: 1e-6,
        latency: MS * 4,
        creep: 1e-4,
        without: |_, _| None,
    }
}

#[test]
fn lwr_net_ends_wire_rests_within_stopping_time() {
    let description = lwr::describe("arm").with(&lwr::parts());
    row("LWR", description).comes_to_rest(|| {
        let mut rig = krc(KrcConfig::default());
        rig.follow();
        rig
    });
}

#[test]
fn iiwa_net_ends_wire_rests_within_stopping_time() {
    let description = iiwa::describe("arm", IiwaModel::Iiwa14);
    let description = description.with(&iiwa::parts(&IiwaIo::default()));
    // Force at the tool by the geometry of a known model is most of the work of a cycle, and nothing of what is tested.
    let driven = DeviceDescription {
        model: "unknown".into(),
        ..description.clone()
    };
    row("iiwa", description).comes_to_rest(|| {
        let mut rig = cabinet_of(CabinetConfig::default(), &driven);
        rig.follow();
        rig
    });
}

/// Policies of the first outputs, and what becomes of `true` and 2 by them.
fn policies() -> [(OutputsOnEnd, (bool, f64)); 2] {
    let value = OutputsOnEnd {
        bool: vec![OnEnd::Take(false)],
        real: vec![OnEnd::Take(0.25)],
    };
    [
        (OutputsOnEnd::default(), (true, 2.0)),
        (value, (false, 0.25)),
    ]
}

#[test]
fn lwr_net_ends_user_data_follow_stated_policy() {
    let description = lwr::describe("arm").with(&lwr::parts());
    for (on_end, expected) in policies() {
        let config = KrcConfig {
            period: MS,
            joints: POSTURE,
            ..KrcConfig::default()
        };
        let krc = Krc::new(config, Duration::ZERO);
        let mut rig = Rig::new(krc, lwr::End::new(None).on_end(on_end), &description);
        rig.follow();
        outputs_follow_their_policy(&description, expected, 4, rig);
    }
}

#[test]
fn iiwa_net_ends_outputs_follow_stated_policy() {
    let model = IiwaModel::Iiwa14;
    let io = IiwaIo {
        bool_out: vec!["Media.Lamp".to_owned()],
        real_out: vec!["Media.Volt".to_owned()],
        ..IiwaIo::default()
    };
    let description = iiwa::describe("arm", model).with(&iiwa::parts(&io));
    for (on_end, expected) in policies() {
        let output = |name: &str, level| Io {
            name: name.to_owned(),
            direction: IoDirection::Output,
            level,
        };
        let config = CabinetConfig {
            send_period: MS,
            joints: POSTURE,
            ios: vec![
                output("Media.Lamp", IoLevel::Boolean(false)),
                output("Media.Volt", IoLevel::Analog(0.0)),
            ],
            ..CabinetConfig::default()
        };
        let cabinet = Cabinet::new(config, Duration::ZERO);
        let end = iiwa::End::new(model, io.clone()).on_end(on_end);
        let mut rig = Rig::new(cabinet, end, &description);
        rig.follow();
        outputs_follow_their_policy(&description, expected, 8, rig);
    }
}

/// An iiwa with these outputs, which shares `shared`, led by a net that writes them.
fn iiwa_writing(io: &IiwaIo, shared: Vec<Io>) -> Rig<Cabinet, iiwa::End> {
    let description = iiwa::describe("arm", IiwaModel::Iiwa14).with(&iiwa::parts(io));
    let config = CabinetConfig {
        send_period: MS,
        joints: POSTURE,
        ios: shared,
        ..CabinetConfig::default()
    };
    let cabinet = Cabinet::new(config, Duration::ZERO);
    let end = iiwa::End::new(IiwaModel::Iiwa14, io.clone());
    let mut rig = Rig::new(cabinet, end, &description);
    rig.follow();
    rig
}

/// Commands the outputs of an arm with I/O alone: first the digital ones, then the numbers.
fn command_outputs(rig: &mut Rig<Cabinet, iiwa::End>, io: &IiwaIo, bools: bool, number: f64) {
    let before = iiwa::parts(&IiwaIo::default());
    let mut layout = takt_net::device::Layout::default();
    let _places = takt_core::device::parts::lay(&before, AXES, &mut layout);
    let cycle = rig.wanted.cycle;
    let words = [u64::from(bools), number.to_bits()];
    let kinds = std::iter::repeat_n(words[0], io.bool_out.len())
        .chain(std::iter::repeat_n(words[1], io.real_out.len()));
    // A stamp of three words, then the value.
    for (output, value) in kinds.enumerate() {
        let at = layout.commands + output * 4;
        rig.wanted.words[at..at + 4].copy_from_slice(&[cycle, cycle, 1, value]);
    }
}

fn shared(name: &str, direction: IoDirection, level: IoLevel) -> Io {
    Io {
        name: name.to_owned(),
        direction,
        level,
    }
}

#[test]
fn iiwa_refused_outputs_are_reported_once() {
    let names = |all: &[&str]| all.iter().map(|name| (*name).to_owned()).collect();
    let io = IiwaIo {
        bool_out: names(&["Media.Absent", "Media.Count"]),
        real_out: names(&["Media.Lamp", "Media.Level"]),
        ..IiwaIo::default()
    };
    let output = IoDirection::Output;
    let mut rig = iiwa_writing(
        &io,
        vec![
            shared("Media.Count", output, IoLevel::Digital(0)),
            shared("Media.Lamp", output, IoLevel::Boolean(false)),
            shared("Media.Level", IoDirection::Input, IoLevel::Analog(0.0)),
        ],
    );
    assert_eq!(rig.events(), Vec::<String>::new());
    // One event of a kind in a second.
    for _ in 0..6_000 {
        command_outputs(&mut rig, &io, true, 1.0);
        rig.step();
    }
    let events = rig.events();
    let [absent, count, lamp, level] = &events[..] else {
        panic!("{events:#?}");
    };
    for (event, cause) in [
        (
            absent,
            "output `Media.Absent` is not written: the controller does not share it\nhint: ",
        ),
        (
            count,
            "output `Media.Count` is not written: it is of type digital, not bool\nhint: ",
        ),
        (
            lamp,
            "output `Media.Lamp` is not written: it is of type bool, not analog\nhint: ",
        ),
        (
            level,
            "output `Media.Level` is not written: it is an input for this client\nhint: ",
        ),
    ] {
        assert!(event.starts_with(cause), "{event}");
    }
    assert_eq!(rig.controller.io("Media.Count"), Some(IoLevel::Digital(0)));
}

#[test]
fn iiwa_digital_output_takes_whole_numbers() {
    let io = IiwaIo {
        real_out: vec!["Media.Count".to_owned()],
        ..IiwaIo::default()
    };
    let output = IoDirection::Output;
    let mut rig = iiwa_writing(
        &io,
        vec![shared("Media.Count", output, IoLevel::Digital(0))],
    );
    for (value, expected) in [(5.0, 5), (6.6, 7), (-1.0, 7), (f64::NAN, 7), (0.0, 0)] {
        for _ in 0..5 {
            command_outputs(&mut rig, &io, false, value);
            rig.step();
        }
        let found = rig.controller.io("Media.Count");
        assert_eq!(found, Some(IoLevel::Digital(expected)), "{value}");
    }
    let events = rig.events();
    assert!(
        events
            .iter()
            .any(|event| event.contains("whole numbers from 0")),
        "{events:#?}"
    );
}
