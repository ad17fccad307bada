//! Simulated devices keep their limits in every cycle, whatever nets want of them and how rarely: set-points and poses on
//! triangles, differentiated from what they report.

use std::collections::BTreeMap;

use takt_net::device::{CartesianPosition, Layout, Words};
use takt_net::value::{Frame, Rotation, Vector};
use takt_rt::Nanos;

use super::*;
use crate::device::{DeviceCommand, Part, SetPoint, parts};

const DT: Nanos = Nanos(1_000_000);

fn texts(pairs: &[(&str, &str)]) -> BTreeMap<String, String> {
    let owned = |(key, value): &(&str, &str)| ((*key).to_owned(), (*value).to_owned());
    pairs.iter().map(owned).collect()
}

/// Two seconds up and two down.
fn triangle(cycle: u64) -> f64 {
    let phase = f64::from(u32::try_from(cycle % 4000).unwrap()) * 1e-3;
    if phase < 2.0 { phase } else { 4.0 - phase }
}

#[test]
fn sim_braking_joint_reports_no_acceleration_to_go_on_with() {
    let (_, mut arm) = make("arm", "kuka_lwr_sim", &BTreeMap::new()).unwrap();
    let mut command = DeviceCommand::default();
    command.joints[0].period = DT;
    let mut seen = Vec::new();
    for cycle in 0..220_u32 {
        command.time = Nanos(DT.0 * i64::from(cycle));
        command.cycle = cycle.into();
        let since_s = f64::from(cycle) * 1e-3;
        // 2 rad/s², then nothing.
        let (time, position) = (command.time, since_s * since_s);
        let point = (cycle < 200).then_some(SetPoint { time, position });
        command.joints[0].advance(point);
        arm.step(&command, DT);
        let joint = arm.state().joints[0];
        seen.push(joint.commanded_velocity.zip(joint.commanded_acceleration));
    }
    let [(_, follows), (velocity, brakes)] = [199, 210].map(|cycle| seen[cycle].unwrap());
    assert!((follows - 2.0).abs() < 1e-3, "{follows}");
    assert!(
        velocity > 0.2 && brakes.abs() < 1e-12,
        "{velocity} {brakes}"
    );
}

#[test]
fn sim_arm_follows_triangles_within_limits() {
    let texts = texts(&[
        ("min_joint", "[-2,-2,-2,-2,-2]"),
        ("max_joint", "[2,2,2,2,2]"),
        ("max_vel", "[1.9,1.9,1.9,1.9,1.9]"),
        ("max_acc", "[4,4,4,4,4]"),
    ]);
    for every in [1_u64, 4, 20, 100, 1000] {
        let (_, mut arm) = make("arm", "kuka_youbot_arm_sim", &texts).unwrap();
        let mut command = DeviceCommand::default();
        command.joints[2].period = Nanos(DT.0 * every.cast_signed());
        let (mut last, mut hardest) = ([0.0; 2], 0.0_f64);
        for cycle in 0..9000 {
            command.time = Nanos(DT.0 * cycle);
            command.cycle = cycle.cast_unsigned();
            if command.cycle % every == 0 {
                let position = 0.8 * triangle(command.cycle);
                let time = command.time;
                command.joints[2].advance(Some(SetPoint { time, position }));
            }
            arm.step(&command, DT);
            let position = arm.state().joints[2].measured_position.unwrap();
            let speed = (position - last[0]) / 1e-3;
            hardest = hardest.max((speed - last[1]).abs() / 1e-3);
            last = [position, speed];
        }
        assert!(hardest <= 4.0 + 1e-5, "every {every}: {hardest} rad/s²");
        assert!(hardest > 0.5, "every {every}: it moves");
        let limited = arm.state().limited[2];
        assert_eq!(
            limited.onsets > 0,
            every < 400,
            "every {every}: {limited:?}"
        );
    }
}

#[test]
fn sim_base_follows_poses_within_limits() {
    let base = Part::Base {
        wheels: 4,
        velocity_max: 0.8,
        rotation_max: 0.8,
        acceleration_max: 1.6,
        rotation_acceleration_max: 1.6,
    };
    for every in [1_u64, 10, 100] {
        let (_, mut device) = make("base", "kuka_youbot_base_sim", &BTreeMap::new()).unwrap();
        let mut layout = Layout::default();
        let has = parts::lay(&[base.clone(), Part::CartesianPosition], 0, &mut layout);
        let places: CartesianPosition = has.cartesian.unwrap();
        let mut command = DeviceCommand::new(layout.commands);
        // Its command comes last: a stamp of three words, and a frame.
        let at = layout.commands - Frame::LEN - 3;
        let (mut last, mut farthest) = ([0.0; 3], 0.0_f64);
        for cycle in 1..9000_u64 {
            command.cycle = cycle;
            if cycle % every == 1 % every {
                let path = triangle(cycle);
                let turn = Rotation::from_axis_angle(&Vector::z_axis(), 0.3 * path);
                let pose = Frame::from_parts([0.3 * path, 0.1 * path, 0.0].into(), turn);
                let words = &mut command.words;
                (words[at], words[at + 1], words[at + 2]) = (cycle, cycle, every);
                pose.put_words(|i, word| words[at + 3 + i] = word);
                assert_eq!(places.command.read(words).unwrap().cycle, cycle);
            }
            device.step(&command, DT);
            let state = device.state();
            let velocity = has
                .base
                .as_ref()
                .unwrap()
                .velocity
                .read(&state.signals)
                .unwrap();
            let now = [velocity.vel.x, velocity.vel.y, velocity.rot.z];
            let change: [f64; 3] = std::array::from_fn(|i| (now[i] - last[i]) / 1e-3);
            let floor = change[0].hypot(change[1]);
            assert!(floor <= 1.6 + 1e-9, "every {every}, {cycle}: {floor} m/s²");
            assert!(
                change[2].abs() <= 1.6 + 1e-9,
                "every {every}, {cycle}: {change:?}"
            );
            last = now;
            assert_eq!(
                places.error.read(&state.signals),
                Some(0),
                "every {every}, {cycle}"
            );
            let pose = places.measured_position.read(&state.signals).unwrap();
            farthest = farthest.max(pose.translation.vector.x);
        }
        assert!((farthest - 0.6).abs() < 0.05, "every {every}: {farthest} m");
        let limited = device.state().limited[0];
        assert!(limited.cycles > 0, "every {every}: {limited:?}");
    }
}
