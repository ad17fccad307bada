//! What the emulated gripper refuses, and how it moves.

use super::*;

fn at(millis: u64) -> Duration {
    Duration::from_millis(millis)
}

/// Sends a packet; returns the status of the first answer.
fn ask(gripper: &mut Gripper, packet: &Packet, now: Duration) -> Option<Status> {
    let mut bytes = [0; PACKET_MAX];
    let len = packet.encode(&mut bytes);
    gripper.handle_bytes(&bytes[..len], now);
    let mut reader = PacketReader::default();
    let answers = gripper.transmit();
    let mut read = answers.iter().filter_map(|byte| reader.push(*byte));
    Some(read.next()?.ok()?.answer()?.0)
}

fn homed() -> Gripper {
    let mut gripper = Gripper::new(GripperConfig::default(), Duration::ZERO);
    let homing = Packet::new(Command::Homing).with(&[2]);
    assert_eq!(ask(&mut gripper, &homing, at(0)), Some(Status::PENDING));
    gripper.step(at(3000));
    gripper.transmit();
    assert!(gripper.width().abs() < 1e-9);
    gripper
}

fn preposition(width: f32, speed: f32) -> Packet {
    Packet::new(Command::Preposition)
        .with(&[0])
        .with_float(width)
        .with_float(speed)
}

#[test]
fn malformed_commands_are_rejected_with_their_status() {
    let mut gripper = homed();
    let cases = [
        (Packet::new(Command::Other(0x99)), Status::CMD_UNKNOWN),
        (Packet::new(Command::Homing), Status::NOT_ENOUGH_PARAMS),
        (Packet::new(Command::Grasp), Status::NOT_ENOUGH_PARAMS),
        (Packet::new(Command::Acknowledge), Status::CMD_FORMAT),
        (preposition(f32::NAN, 50.0), Status::INVALID_PARAMETER),
        (preposition(50.0, 0.0), Status::RANGE),
        (preposition(500.0, 50.0), Status::RANGE),
    ];
    for (packet, status) in cases {
        assert_eq!(
            ask(&mut gripper, &packet, at(3000)),
            Some(status),
            "{packet}"
        );
    }
}

#[test]
fn fingers_keep_speed_and_acceleration() {
    let mut gripper = homed();
    let moved = ask(&mut gripper, &preposition(100.0, 200.0), at(3000));
    assert_eq!(moved, Some(Status::PENDING));
    let (mut before, mut speed) = (gripper.width(), 0.0);
    for millis in 3001..5000 {
        gripper.step(at(millis));
        let now = (gripper.width() - before) / 1e-3;
        assert!(now <= 200.0 + 1e-6, "{now} mm/s");
        assert!(now - speed <= 2000.0 * 1e-3 + 1e-6, "{speed} {now}");
        (before, speed) = (gripper.width(), now);
    }
    assert!((gripper.width() - 100.0).abs() < 0.02 && gripper.rests());
}

#[test]
fn lost_connection_is_a_fast_stop() {
    let mut gripper = homed();
    ask(&mut gripper, &preposition(100.0, 50.0), at(3000));
    gripper.step(at(3500));
    gripper.handle_disconnect();
    let width = gripper.width();
    gripper.step(at(6000));
    assert!((gripper.width() - width).abs() < 1e-9, "it stands");
    let denied = ask(&mut gripper, &preposition(10.0, 50.0), at(6000));
    assert_eq!(denied, Some(Status::ACCESS_DENIED));
    let ack = Packet::new(Command::Acknowledge).with(b"ack");
    assert_eq!(ask(&mut gripper, &ack, at(6000)), Some(Status::SUCCESS));
}

#[test]
fn part_between_fingers_blocks_positioning() {
    let mut gripper = homed();
    ask(&mut gripper, &preposition(100.0, 200.0), at(3000));
    gripper.step(at(5000));
    gripper.transmit();
    gripper.knobs.part = Some(40.0);
    ask(&mut gripper, &preposition(10.0, 200.0), at(5000));
    gripper.step(at(7000));
    assert!((gripper.width() - 40.0).abs() < 1e-9);
}
