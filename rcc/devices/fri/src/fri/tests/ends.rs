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
    let description = lwr::describe("arm").with(lwr::PARTS);
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
    let description = lwr::describe("arm").with(lwr::PARTS);
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
