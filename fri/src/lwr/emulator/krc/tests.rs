//! Every transition and rule of the emulated controller against a manual client. Behaviour with the session of this
//! crate: tests/lwr_behaviour.rs.

use super::super::{LineFaults, PowerOff, Shape};
use super::message::to_f32;
use super::*;
use crate::lwr::wire::Header;

const PERIOD: Duration = Duration::from_millis(2);
const START: Duration = Duration::from_secs(5);

/// A controller and a client in lock-step; the test sets the client's answers.
struct Bench {
    krc: Krc,
    now: Duration,
    msr: Option<Msr>,
    sequence: u16,
}

impl Bench {
    fn new(config: KrcConfig) -> Self {
        Self {
            krc: Krc::new(config, START),
            now: START,
            msr: None,
            sequence: 40_000,
        }
    }

    /// One cycle: receives the measurement, then sends the mirrored answer after `change`.
    fn cycle(&mut self, change: impl FnOnce(&mut Cmd)) -> &mut Self {
        self.receive();
        let cmd = self.mirrored(change);
        self.send(&cmd, PERIOD / 4);
        self
    }

    fn receive(&mut self) -> &mut Self {
        self.now = self.krc.poll_timeout();
        let mut buf = [0; Msr::LEN];
        while let Some(len) = self.krc.poll_transmit(self.now, &mut buf) {
            self.msr = Some(Msr::decode(&buf[..len]).unwrap());
        }
        self
    }

    fn mirrored(&mut self, change: impl FnOnce(&mut Cmd)) -> Cmd {
        let msr = self.msr.unwrap();
        self.sequence = self.sequence.wrapping_add(1);
        let mut cmd = Cmd {
            header: Header {
                sequence: self.sequence,
                reflected: msr.header.sequence,
            },
            flags: CmdFlags::JNTPOS,
            joints: msr.set_point().map(to_f32),
            ..Cmd::default()
        };
        change(&mut cmd);
        cmd
    }

    fn send(&mut self, cmd: &Cmd, after: Duration) {
        let mut buf = [0; Cmd::LEN];
        cmd.encode(&mut buf).unwrap();
        self.krc.handle_datagram(&buf, self.now + after).unwrap();
    }

    fn cycles(&mut self, count: u32) -> &mut Self {
        for _ in 0..count {
            self.cycle(|_| {});
        }
        self
    }

    fn silent(&mut self, count: u32) -> &mut Self {
        for _ in 0..count {
            self.receive();
        }
        self
    }

    fn reason(&self) -> Option<ExitReason> {
        self.krc.log().next_back().map(|left| left.reason)
    }
}

fn manual() -> KrcConfig {
    KrcConfig {
        script: Script::Manual,
        ..KrcConfig::default()
    }
}

/// In MON with 101 answered cycles.
fn mon() -> Bench {
    let mut bench = Bench::new(manual());
    bench.cycles(101);
    assert_eq!(
        (bench.krc.state(), bench.krc.quality()),
        (State::Mon, Quality::Perfect)
    );
    bench
}

/// In CMD, following, at rest at zero.
fn cmd() -> Bench {
    let mut bench = mon();
    bench.krc.fri_start(1.0).unwrap();
    bench.cycles(3);
    assert!(bench.krc.following);
    bench
}

// ---- MON x inputs

#[test]
fn krc_mon_fri_start_enters_cmd_next_cycle() {
    let mut bench = mon();
    assert_eq!(bench.krc.fri_start(0.5), Ok(()));
    bench.cycle(|_| {});
    let interface = bench.msr.unwrap().interface;
    assert_eq!(
        (interface.state, interface.safety_scale.to_bits()),
        (State::Cmd, 0.5_f32.to_bits())
    );
}

#[test]
fn krc_mon_bad_timing_or_braking_refuses_start() {
    let mut bench = Bench::new(manual());
    bench.cycles(50);
    let refused = bench.krc.fri_start(1.0);
    assert_eq!(refused, Err(StartError::Quality { answer_rate: 0.49 }));
    bench.cycles(1);
    assert_eq!(bench.krc.fri_start(1.0), Ok(()));
    assert_eq!(bench.krc.fri_start(1.0), Err(StartError::Commanding));

    let mut bench = mon();
    bench.silent(11);
    assert_eq!(
        bench.krc.fri_start(1.0),
        Err(StartError::Misses { cycles: 10 })
    );

    let mut bench = cmd();
    bench.cycle(|cmd| cmd.joints[0] += 0.003).receive();
    bench.krc.fri_stop();
    assert_eq!(bench.krc.fri_start(1.0), Err(StartError::Moving));
}

#[test]
fn krc_mon_ignores_other_inputs() {
    let inputs: [fn(&mut Bench); 7] = [
        |bench| bench.krc.fri_stop(),
        |bench| bench.krc.set_power(false),
        |bench| _ = bench.silent(30),
        |bench| _ = bench.cycle(|cmd| cmd.joints = [3.0; AXES]),
        |bench| _ = bench.cycle(|cmd| cmd.joints = [f32::NAN; AXES]),
        |bench| _ = bench.cycle(|cmd| cmd.flags = CmdFlags::NONE),
        |bench| _ = bench.krc.handle_datagram(&[0; 3], bench.now).unwrap_err(),
    ];
    for (index, input) in inputs.into_iter().enumerate() {
        let mut bench = mon();
        input(&mut bench);
        bench.cycles(2);
        assert_eq!(
            (bench.krc.state(), bench.reason()),
            (State::Mon, None),
            "input {index}"
        );
        assert!(bench.krc.set_point().iter().all(|joint| joint.abs() < 1e-9));
    }
}

// ---- CMD x inputs

/// Runs `input` in CMD, ends the cycle and returns the reason of leaving, if it left.
fn cmd_after(input: impl FnOnce(&mut Bench)) -> Option<ExitReason> {
    let mut bench = cmd();
    input(&mut bench);
    bench.receive();
    let reason = bench.reason();
    assert_eq!(bench.krc.state() == State::Mon, reason.is_some());
    assert_eq!(bench.msr.unwrap().interface.state, bench.krc.state());
    reason
}

#[test]
fn krc_cmd_exits_for_every_reason() {
    let fall = cmd_after(|bench| bench.krc.fri_stop());
    assert_eq!(fall, Some(ExitReason::FriStop));
    let fall = cmd_after(|bench| _ = bench.silent(10));
    assert_eq!(
        fall,
        Some(ExitReason::Misses {
            cycles: 10,
            span_ms: 20.0
        })
    );
    let fall = cmd_after(|bench| bench.krc.faults_mut().quality = Some(Quality::Unacceptable));
    assert_eq!(fall, Some(ExitReason::Quality { answer_rate: 1.0 }));
    let fall = cmd_after(|bench| _ = bench.cycle(|cmd| cmd.joints[6] = f32::INFINITY));
    assert_eq!(fall, Some(ExitReason::NotFinite { joint: 6 }));
    let fall = cmd_after(|bench| _ = bench.cycle(|cmd| cmd.flags = CmdFlags::NONE));
    let (from, to) = (CmdFlags::JNTPOS, CmdFlags::NONE);
    assert_eq!(fall, Some(ExitReason::FlagsChanged { from, to }));
    let fall = cmd_after(|bench| _ = bench.cycle(|cmd| cmd.joints[3] = 0.004_62));
    assert_eq!(
        fall.unwrap().to_string(),
        "A3 commanded 2.31 rad/s, limit 1.96 rad/s"
    );
}

#[test]
fn krc_cmd_survives_bridged_faults() {
    let inputs: [fn(&mut Bench); 6] = [
        |bench| _ = bench.silent(9),
        |bench| _ = bench.cycle(|cmd| cmd.joints = [0.0039; AXES]),
        |bench| _ = bench.cycle(|cmd| cmd.header.sequence = cmd.header.sequence.wrapping_sub(5)),
        |bench| _ = bench.cycle(|cmd| cmd.header.reflected = 9_999),
        |bench| _ = bench.krc.handle_datagram(&[0; 375], bench.now).unwrap_err(),
        |bench| bench.krc.set_power(false),
    ];
    for (index, input) in inputs.into_iter().enumerate() {
        assert_eq!(cmd_after(input), None, "input {index}");
    }
}

#[test]
fn krc_position_out_of_range_names_limit() {
    let mut joints = [0.0; AXES];
    joints[1] = 2.093;
    let mut bench = Bench::new(KrcConfig { joints, ..manual() });
    bench.cycles(100).krc.fri_start(1.0).unwrap();
    bench
        .cycles(2)
        .cycle(|cmd| cmd.joints[1] = 2.0945)
        .receive();
    assert_eq!(
        bench.reason().unwrap().to_string(),
        "A2 commanded 2.095 rad, limit 2.094 rad"
    );
}

#[test]
fn krc_fri_start_scale_scales_speed_limit() {
    let mut bench = mon();
    bench.krc.fri_start(0.1).unwrap();
    bench
        .cycles(3)
        .cycle(|cmd| cmd.joints[0] = 0.0005)
        .receive();
    assert!(
        matches!(bench.reason(), Some(ExitReason::Speed { joint: 0, limit, .. }) if limit < 0.2)
    );
}

#[test]
fn krc_client_without_mirror_exits_on_entry() {
    let mut bench = mon();
    bench
        .cycle(|cmd| cmd.joints[2] = 0.4)
        .krc
        .fri_start(1.0)
        .unwrap();
    bench.receive();
    let text = "FRI interpolation error: E1 commanded 0.4000 rad, set-point 0.0000 rad";
    assert_eq!(bench.reason().unwrap().to_string(), text);
}

#[test]
fn krc_cmd_without_power_requires_mirror() {
    let mut bench = cmd();
    bench.krc.set_power(false);
    bench.cycles(5);
    let msr = bench.msr.unwrap();
    assert_eq!((msr.interface.state, msr.robot.power), (State::Cmd, 0));
    bench.cycle(|cmd| cmd.joints[0] = 0.02).receive();
    assert!(matches!(
        bench.reason(),
        Some(ExitReason::Interpolation { joint: 0, .. })
    ));
}

#[test]
fn krc_power_loss_in_motion_brakes_then_follows() {
    let mut bench = cmd();
    for _ in 0..20 {
        bench.cycle(|cmd| cmd.joints[0] += 0.002);
    }
    bench.krc.faults_mut().power_off = Some(PowerOff {
        at: bench.now - START + PERIOD,
        span: PERIOD * 300,
    });
    let before = bench.krc.set_point()[0];
    bench.cycles(299);
    assert!(!bench.krc.has_power() && bench.krc.set_point()[0] > before + 0.05);
    let rest = bench.krc.set_point()[0];
    bench
        .cycles(5)
        .cycle(|cmd| cmd.joints[0] += 0.002)
        .receive();
    assert!((bench.krc.set_point()[0] - rest - 0.002).abs() < 1e-6);
    assert_eq!(bench.reason(), None);
}

#[test]
fn krc_first_command_after_power_starts_at_set_point() {
    let mut bench = cmd();
    bench.krc.set_power(false);
    bench.cycles(100);
    bench.krc.set_power(true);
    bench.cycle(|cmd| cmd.joints[4] = 0.2).receive();
    assert!(matches!(
        bench.reason(),
        Some(ExitReason::Speed { joint: 4, .. })
    ));
}

// ---- known client behaviour

#[test]
fn krc_fril_style_client_is_accepted() {
    let mut bench = Bench::new(KrcConfig {
        joints: [0.3; AXES],
        ..KrcConfig::default()
    });
    for _ in 0..2 {
        bench.cycle(|cmd| {
            cmd.flags = CmdFlags::NONE;
            cmd.joints = [0.0; AXES];
            cmd.header.reflected = 0;
        });
    }
    for _ in 0..110 {
        let measured = bench.receive().msr.unwrap().measured_joints;
        let cmd = bench.mirrored(|cmd| cmd.joints = measured);
        bench.send(&cmd, PERIOD / 4);
    }
    assert_eq!((bench.krc.state(), bench.reason()), (State::Cmd, None));
}

#[test]
fn krc_client_one_cycle_behind_is_in_time() {
    let mut bench = Bench::new(KrcConfig::default());
    bench.receive();
    for _ in 0..150 {
        let cmd = bench.mirrored(|_| {});
        bench.receive();
        bench.send(&cmd, PERIOD / 4);
    }
    assert_eq!(bench.krc.state(), State::Cmd);
    let latency_s = bench.msr.unwrap().statistics.latency_s;
    assert!((latency_s - 0.0025).abs() < 1e-6, "{latency_s}");

    let timing = super::super::Timing {
        reflected_age_max: 0,
        ..Default::default()
    };
    let mut strict = Bench::new(KrcConfig {
        timing,
        ..KrcConfig::default()
    });
    strict.receive();
    for _ in 0..150 {
        let cmd = strict.mirrored(|_| {});
        strict.receive();
        strict.send(&cmd, PERIOD / 4);
    }
    assert_eq!(strict.krc.quality(), Quality::Unacceptable);
}

#[test]
fn krc_new_client_counter_is_accepted() {
    let mut bench = cmd();
    bench.sequence = 7;
    bench.cycles(5);
    assert_eq!((bench.krc.misses, bench.reason()), (0, None));
    // A jump within the window appears as old datagrams until a silence.
    let old = bench.krc.counters().old;
    bench.sequence = bench.sequence.wrapping_sub(45);
    bench.cycles(200);
    assert_eq!(bench.krc.quality(), Quality::Perfect);
    assert!((10..=11).contains(&(bench.krc.counters().old - old)));
}

#[test]
fn krc_lost_answers_are_extrapolated_without_jump() {
    let mut bench = cmd();
    let speed = 0.003;
    let mut position = 0.0;
    for cycle in 0..60 {
        bench.receive();
        assert!(
            (bench.krc.set_point()[0] - position).abs() < 1e-5,
            "cycle {cycle}"
        );
        position += speed;
        let cmd = bench.mirrored(|cmd| cmd.joints[0] = to_f32(position));
        if cycle % 7 < 4 {
            bench.send(&cmd, PERIOD / 4);
        }
    }
    bench.receive();
    assert_eq!(bench.reason(), None);
    assert!((bench.krc.set_point()[0] - position).abs() < 1e-5);
}

#[test]
fn krc_exit_in_motion_brakes_to_rest() {
    let mut bench = cmd();
    for _ in 0..20 {
        bench.cycle(|cmd| cmd.joints[5] += 0.002);
    }
    bench.receive().krc.fri_stop();
    let mut last = bench.krc.set_point()[5];
    let mut step = 0.002;
    for _ in 0..150 {
        bench.cycles(1);
        let moved = bench.krc.set_point()[5] - last;
        assert!((-1e-12..=step).contains(&moved), "{moved} after {step}");
        (last, step) = (last + moved, moved + 1e-12);
    }
    assert!(bench.krc.arm.is_at_rest());
    assert!((bench.krc.joints()[5] - last).abs() < 1e-3);
    let msr = bench.msr.unwrap();
    assert!((msr.set_point()[5] - last).abs() < 1e-6);
}

// ---- script, time, faults

#[test]
fn krc_script_restarts_after_pause_except_fri_stop() {
    let mut bench = Bench::new(KrcConfig::default());
    bench.cycles(105);
    assert_eq!(bench.krc.state(), State::Cmd);
    bench.cycle(|cmd| cmd.joints[0] = 1.0).cycles(500);
    assert_eq!(bench.krc.state(), State::Mon);
    bench.cycles(5);
    assert_eq!((bench.krc.state(), bench.krc.exits()), (State::Cmd, 1));
    bench.krc.fri_stop();
    bench.cycles(1000);
    assert_eq!((bench.krc.state(), bench.krc.exits()), (State::Mon, 2));
}

#[test]
fn krc_emulator_stall_is_not_counted() {
    let mut bench = cmd();
    let (missed, next) = (bench.krc.counters().missed, bench.krc.poll_timeout());
    let (sequence, mut buf) = (bench.msr.unwrap().header.sequence, [0; Msr::LEN]);
    // 12.5 periods late, and the client stalled with it.
    let now = next + PERIOD * 25 / 2;
    assert!(bench.krc.poll_transmit(now, &mut buf).is_some());
    assert!(bench.krc.poll_transmit(now, &mut buf).is_none());
    assert_eq!(Msr::decode(&buf).unwrap().header.sequence, sequence + 1);
    assert_eq!(bench.krc.poll_timeout(), next + PERIOD * 13);
    assert_eq!(bench.krc.counters().stalls, 12);
    bench.receive();
    assert_eq!((bench.krc.counters().missed, bench.krc.misses), (missed, 0));
    // In time again: now silence is the client's.
    bench.silent(2);
    assert_eq!(bench.krc.counters().missed, missed + 2);
}

#[test]
fn krc_motion_through_stall_is_no_jump() {
    let mut bench = cmd();
    let next = bench.krc.poll_timeout();
    let mut buf = [0; Msr::LEN];
    bench
        .krc
        .poll_transmit(next + PERIOD * 5, &mut buf)
        .unwrap();
    bench.msr = Some(Msr::decode(&buf).unwrap());
    bench.now = next + PERIOD * 5;
    let cmd = bench.mirrored(|cmd| cmd.joints[0] = 0.003 * 6.0);
    bench.send(&cmd, PERIOD / 4);
    bench.receive();
    assert_eq!(bench.reason(), None);
}

#[test]
fn krc_arm_moves_on_through_stall_as_without() {
    let speed = 0.003;
    let mut bench = cmd();
    let mut position = 0.0;
    for _ in 0..20 {
        position += speed;
        bench.cycle(|cmd| cmd.joints[0] = to_f32(position));
    }
    let next = bench.krc.poll_timeout();
    let mut buf = [0; Msr::LEN];
    let late = next + PERIOD * 7;
    bench.krc.poll_transmit(late, &mut buf).unwrap();
    // The answer to the last measurement, and seven cycles at its speed.
    let expected = position + 7.0 * speed;
    assert!((bench.krc.set_point()[0] - expected).abs() < 1e-5);
    // Of a longer stall, 20 ms are made up.
    let late = bench.krc.poll_timeout() + PERIOD * 100;
    bench.krc.poll_transmit(late, &mut buf).unwrap();
    let expected = expected + 11.0 * speed;
    assert!((bench.krc.set_point()[0] - expected).abs() < 1e-5);
    assert_eq!(bench.reason(), None);
}

#[test]
fn krc_log_keeps_last_sixteen() {
    let mut bench = mon();
    for _ in 0..20 {
        bench.krc.fri_start(1.0).unwrap();
        bench.krc.fri_stop();
    }
    assert_eq!((bench.krc.log().count(), bench.krc.exits()), (LOG_LEN, 20));
}

#[test]
fn krc_same_seed_repeats_run() {
    let run = |seed| {
        let line = LineFaults {
            drop: 0.1,
            jitter: PERIOD,
            ..LineFaults::default()
        };
        let faults = Faults {
            to_client: line,
            to_krc: line,
            ..Faults::default()
        };
        let mut bench = Bench::new(KrcConfig {
            seed,
            faults,
            ..KrcConfig::default()
        });
        bench.receive();
        while bench.msr.is_none() {
            bench.receive();
        }
        bench.cycles(500).krc.counters()
    };
    assert_eq!(run(1), run(1));
    assert_ne!(run(1), run(2));
}

#[test]
fn krc_user_data_is_exchanged() {
    let mut bench = mon();
    bench.krc.krl_mut().set_bool(3, true);
    bench.cycle(|cmd| cmd.krl.int[15] = 10);
    assert!(bench.msr.unwrap().krl.bool(3));
    assert_eq!(bench.krc.krl().int[15], 10);
}

#[test]
fn krc_contact_vanishes_while_output_is_true() {
    let mut bench = Bench::new(KrcConfig::default());
    let [_, _, height] = bench.krc.flange();
    let contact = Contact {
        shape: Shape::Wall,
        point: [0.0, 0.0, height + 0.001],
        normal: [0.0, 0.0, 1.0],
        stiffness: 1000.0,
        damping: 0.0,
    };
    bench = Bench::new(KrcConfig {
        contact: Some(contact),
        contact_off: Some(0),
        ..KrcConfig::default()
    });
    bench.receive();
    while bench.msr.is_none() {
        bench.receive();
    }
    let mut force = |is_off: bool| {
        for _ in 0..5 {
            bench.cycle(|cmd| cmd.krl.set_bool(0, is_off));
        }
        bench.krc.force()[2]
    };
    assert!((force(false) - 1.0).abs() < 1e-6);
    assert!(force(true).abs() < 1e-12);
    assert!((force(false) - 1.0).abs() < 1e-6);
}
