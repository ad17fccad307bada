//! Control strategies, contact, guards and handshakes of FRI 1.0: session, dialog and emulated controller in virtual time.
#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

use std::time::Duration;
use takt_fri::guard::Guard;
use takt_fri::lwr::emulator::{Contact, ExitReason, Krc, KrcConfig, Script, Shape, Stiffness};
use takt_fri::lwr::wire::{Cmd, CmdFlags, Control, Msr, Quality, State};
use takt_fri::lwr::{
    AXES, Dialog, DialogError, Fields, JOINT_NAMES, Load, Progress, Protocol, Request, Session,
    SessionConfig, Settings,
};

const PERIOD: Duration = Duration::from_millis(2);
/// A bent arm: far from singularities.
const JOINTS: [f64; AXES] = [0.0, -0.5, 0.0, 1.2, 0.0, -1.0, 0.0];

struct Pair {
    krc: Krc,
    session: Session,
    dialog: Dialog,
    now: Duration,
    progress: Vec<Progress>,
    /// Added to the mirrored positions in every cycle, rad.
    step: [f64; AXES],
    /// Faults of answers in transit.
    spoil: fn(&mut Cmd),
}

impl Pair {
    fn new(config: KrcConfig) -> Self {
        let protocol = match config.script {
            Script::Handshake(protocol) => protocol,
            Script::Manual | Script::Auto { .. } => Protocol::Stanford,
        };
        let config = KrcConfig {
            joints: JOINTS,
            ..config
        };
        Self {
            krc: Krc::new(config, Duration::ZERO),
            session: Session::new(SessionConfig::default()),
            dialog: Dialog::new(protocol),
            now: Duration::ZERO,
            progress: Vec::new(),
            step: [0.0; AXES],
            spoil: |_| {},
        }
    }

    fn in_mode(control: Control, flags: CmdFlags) -> Self {
        let mut pair = Self::new(KrcConfig {
            control,
            ..KrcConfig::default()
        });
        pair.session.choose(flags).unwrap();
        pair.run(200);
        assert!(pair.session.is_commanding(), "{:?}", pair.krc);
        pair
    }

    fn run(&mut self, cycles: u32) -> &mut Self {
        let (mut msr, mut cmd) = ([0; Msr::LEN], [0; Cmd::LEN]);
        for _ in 0..cycles {
            self.now = self.krc.poll_timeout();
            while self.krc.poll_transmit(self.now, &mut msr).is_some() {
                self.session.handle_datagram(&msr, self.now).unwrap();
                self.talk();
                let mut joints = self.session.mirror();
                for (joint, step) in joints.iter_mut().zip(self.step) {
                    *joint += step;
                }
                self.session.answer(Some(&joints), &mut cmd).unwrap();
                let mut sent = Cmd::decode(&cmd).unwrap();
                (self.spoil)(&mut sent);
                sent.encode(&mut cmd).unwrap();
                self.krc.handle_datagram(&cmd, self.now).unwrap();
            }
        }
        self
    }

    fn talk(&mut self) {
        let msr = *self.session.measurement().unwrap();
        match self.dialog.poll(&msr, self.session.krl_mut(), self.now) {
            Progress::Idle | Progress::Running => {}
            ended @ (Progress::Done | Progress::Failed(_)) => self.progress.push(ended),
        }
    }

    fn ask(&mut self, request: &Request) -> Result<(), DialogError> {
        let msr = *self.session.measurement().unwrap();
        let krl = self.session.krl_mut();
        self.dialog.request(request, &msr, krl, self.now)
    }

    fn msr(&self) -> &Msr {
        self.session.measurement().unwrap()
    }

    fn reasons(&self) -> Vec<String> {
        self.krc.log().map(|left| left.reason.to_string()).collect()
    }
}

fn handshake(protocol: Protocol) -> Pair {
    let script = Script::Handshake(protocol);
    let mut pair = Pair::new(KrcConfig {
        script,
        ..KrcConfig::default()
    });
    pair.run(150);
    pair
}

fn start() -> Request {
    Request::Start { strategy: None }
}

fn wall(height: f64) -> Contact {
    Contact {
        shape: Shape::Wall,
        point: [0.0, 0.0, height],
        normal: [0.0, 0.0, 1.0],
        stiffness: 20_000.0,
        damping: 50.0,
    }
}

// ---------------------------------------------------------------------------------------------------- control strategies

#[test]
fn krc_measurement_has_pose_jacobian_and_strategy() {
    let mut pair = Pair::in_mode(Control::JointImpedance, CmdFlags::JNTPOS);
    pair.step[0] = 1e-4;
    pair.run(500);
    let msr = pair.msr();
    assert_eq!(msr.robot.control, Control::JointImpedance);
    let flange = pair.krc.flange();
    for (row, place) in flange.into_iter().enumerate() {
        assert!((f64::from(msr.measured_frame[row * 4 + 3]) - place).abs() < 1e-3);
    }
    // Column of A1: the flange turns about the base's z.
    let column = [0, 7, 14, 21].map(|at| f64::from(msr.jacobian[at]));
    assert!((column[0] + flange[1]).abs() < 1e-3 && (column[1] - flange[0]).abs() < 1e-3);
    assert!(
        column[2].abs() < 1e-6 && (column[3] - 1.0).abs() < 1e-6,
        "row RZ comes first"
    );
    assert_eq!(pair.reasons(), Vec::<String>::new());
}

#[test]
fn krc_joint_impedance_deflects_by_torque_over_stiffness() {
    let flags = CmdFlags::JNTPOS | CmdFlags::JNTSTIFF | CmdFlags::JNTDAMP | CmdFlags::JNTTRQ;
    let mut pair = Pair::in_mode(Control::JointImpedance, flags);
    *pair.session.fields_mut() = Fields {
        joint_stiffness: [200.0; AXES],
        joint_torque: [0.0, 0.0, 0.0, 4.0, 0.0, 0.0, 0.0],
        ..Fields::default()
    };
    pair.run(2_000);
    let moved = pair.krc.joints()[3] - JOINTS[3];
    assert!((moved - 0.02).abs() < 1e-4, "{moved}");
    assert_eq!(pair.reasons(), Vec::<String>::new());
}

#[test]
fn krc_unflagged_fields_keep_krl_values() {
    let stiffness = Stiffness {
        joint_stiffness: [100.0; AXES],
        ..Stiffness::default()
    };
    let mut pair = Pair::new(KrcConfig {
        control: Control::JointImpedance,
        stiffness,
        ..KrcConfig::default()
    });
    pair.session
        .choose(CmdFlags::JNTPOS | CmdFlags::JNTTRQ)
        .unwrap();
    pair.session.fields_mut().joint_torque[3] = 2.0;
    pair.run(2_000);
    let moved = pair.krc.joints()[3] - JOINTS[3];
    assert!((moved - 0.02).abs() < 1e-4, "{moved}");
}

#[test]
fn lwr_contact_approach_hold_and_loss() {
    for flags in [
        CmdFlags::JNTPOS | CmdFlags::CARTSTIFF | CmdFlags::CARTDAMP | CmdFlags::TCPFT,
        CmdFlags::CARTPOS | CmdFlags::CARTSTIFF | CmdFlags::CARTDAMP | CmdFlags::TCPFT,
    ] {
        let mut pair = Pair::in_mode(Control::CartesianImpedance, flags);
        let height = pair.krc.flange()[2];
        *pair.krc.contact_mut() = Some(wall(height - 0.002));
        let felt = |pair: &Pair| pair.msr().external_wrench[2];
        while felt(&pair) < 20.0 {
            let press = &mut pair.session.fields_mut().wrench[2];
            *press -= 0.05;
            assert!(*press > -60.0);
            pair.run(5);
        }
        pair.run(500);
        assert!((felt(&pair) - 20.0).abs() < 2.0, "{}", felt(&pair));
        *pair.krc.contact_mut() = None;
        pair.run(2);
        assert!(felt(&pair).abs() < 1e-6, "the loss shows within two cycles");
        assert_eq!(pair.reasons(), Vec::<String>::new());
    }
}

#[test]
fn krc_frames_followed_unreachable_ends_command() {
    let flags = CmdFlags::CARTPOS | CmdFlags::CARTSTIFF | CmdFlags::CARTDAMP;
    let mut pair = Pair::in_mode(Control::CartesianImpedance, flags);
    let before = pair.krc.flange();
    let mut frame = pair.msr().measured_frame.map(f64::from);
    for _ in 0..500 {
        frame[7] += 4e-5;
        pair.session.fields_mut().frame = Some(frame);
        pair.run(1);
    }
    pair.run(1_000);
    let moved = pair.krc.flange()[1] - before[1];
    assert!((moved - 0.02).abs() < 2e-4, "{moved}");
    assert_eq!(pair.reasons(), Vec::<String>::new());
    frame[3] = 5.0;
    pair.session.fields_mut().frame = Some(frame);
    pair.run(3);
    assert_eq!(pair.reasons(), ["the commanded frame is out of reach"]);
}

#[test]
fn session_flags_change_in_monitor_mode_only() {
    let all = CmdFlags::from_bits(0x3535);
    for (control, allowed) in [
        (Control::Position, 0x0001),
        (Control::JointImpedance, 0x0035),
        (Control::CartesianImpedance, 0x3501),
    ] {
        let mut pair = Pair::in_mode(control, all);
        assert_eq!(pair.session.flags(), CmdFlags::from_bits(allowed));
        let refused = pair.session.choose(CmdFlags::JNTPOS).unwrap_err();
        assert!(
            refused
                .to_string()
                .starts_with("command flags may change in monitor mode only")
        );
        pair.run(200);
        assert_eq!(pair.reasons(), Vec::<String>::new());
    }
}

#[test]
fn krc_strategy_changes_in_monitor_mode_only() {
    let mut pair = Pair::in_mode(Control::Position, CmdFlags::JNTPOS);
    assert!(pair.krc.set_strategy(Control::JointImpedance).is_err());
    pair.krc.fri_stop();
    pair.krc.set_strategy(Control::JointImpedance).unwrap();
    pair.run(2);
    assert_eq!(pair.msr().robot.control, Control::JointImpedance);
}

#[test]
fn session_guard_holds_robot_and_names_limit() {
    let guard = Guard {
        speed_rad_per_s: [0.5; AXES],
        torque_nm: [5.0; AXES],
        ..Guard::open(JOINT_NAMES)
    };
    let flags = CmdFlags::JNTPOS | CmdFlags::JNTTRQ;
    let mut pair = Pair::new(KrcConfig {
        control: Control::JointImpedance,
        ..KrcConfig::default()
    });
    pair.session = Session::new(SessionConfig {
        guard,
        ..SessionConfig::default()
    });
    pair.session.choose(flags).unwrap();
    pair.run(200);
    pair.step[2] = 0.0009;
    pair.run(10);
    assert_eq!(pair.session.violation(), None);
    pair.step[2] = 0.0011;
    pair.run(10);
    let text = pair.session.violation().unwrap().to_string();
    assert_eq!(text, "E1 commanded 0.550 rad/s, limit 0.500 rad/s");
    pair.step[2] = 0.0;
    pair.session.fields_mut().joint_torque[6] = 6.0;
    pair.run(10);
    let text = pair.session.violation().unwrap().to_string();
    assert_eq!(text, "A6 commanded 6.00 Nm, limit 5.00 Nm");
    assert!(
        (pair.krc.joints()[6] - JOINTS[6]).abs() < 1e-6,
        "nothing was added"
    );
    assert_eq!(
        (pair.session.counters().withheld, pair.reasons().len()),
        (20, 0)
    );
}

#[test]
fn krc_invalid_field_ends_command_with_name() {
    type Case = (Control, CmdFlags, fn(&mut Cmd), &'static str);
    let [joint, cartesian] = [Control::JointImpedance, Control::CartesianImpedance];
    let cases: [Case; 8] = [
        (
            joint,
            CmdFlags::JNTTRQ,
            |cmd| cmd.joint_torque[6] = 38.5,
            "A6 commanded an added torque of 38.500 (Nm, a number within the joint's torque)",
        ),
        (
            joint,
            CmdFlags::JNTTRQ,
            |cmd| cmd.joint_torque[0] = f32::NAN,
            "A1 commanded an added torque of NaN (Nm, a number within the joint's torque)",
        ),
        (
            joint,
            CmdFlags::JNTSTIFF,
            |cmd| cmd.joint_stiffness[2] = -1.0,
            "E1 commanded stiffness -1.000 (a number from 0)",
        ),
        (
            joint,
            CmdFlags::JNTDAMP,
            |cmd| cmd.joint_damping[3] = 1.01,
            "A3 commanded damping 1.010 (0 to 1)",
        ),
        (
            cartesian,
            CmdFlags::TCPFT,
            |cmd| cmd.wrench[1] = f32::INFINITY,
            "Y commanded an added force or torque of inf (a number)",
        ),
        (
            cartesian,
            CmdFlags::CARTSTIFF,
            |cmd| cmd.cartesian_stiffness[0] = f32::NAN,
            "X commanded stiffness NaN (a number from 0)",
        ),
        (
            cartesian,
            CmdFlags::CARTSTIFF,
            |cmd| cmd.cartesian_stiffness[4] = f32::INFINITY,
            "about Y commanded stiffness inf (a number from 0)",
        ),
        (
            cartesian,
            CmdFlags::CARTDAMP,
            |cmd| cmd.cartesian_damping[5] = f32::NAN,
            "about X commanded damping NaN (0 to 1)",
        ),
    ];
    for (control, flag, spoil, text) in cases {
        let mut pair = Pair::in_mode(control, CmdFlags::JNTPOS | flag);
        pair.spoil = spoil;
        pair.run(3);
        assert_eq!(
            (pair.krc.state(), pair.reasons()),
            (State::Mon, vec![text.to_owned()])
        );
        assert!(pair.krc.joints().iter().all(|joint| joint.is_finite()));
        // The controller ignores the same value in a field that no flag declares valid.
        let mut pair = Pair::in_mode(control, CmdFlags::JNTPOS);
        pair.spoil = spoil;
        pair.run(3);
        assert_eq!(pair.reasons(), Vec::<String>::new());
    }
}

#[test]
fn session_foreign_datagram_is_named() {
    let mut session = Session::new(SessionConfig::default());
    let mut pair = Pair::new(KrcConfig::default());
    let mut cmd = [0; Cmd::LEN];
    Cmd::default().encode(&mut cmd).unwrap();
    let refused = session
        .handle_datagram(&cmd, PERIOD)
        .unwrap_err()
        .to_string();
    assert!(
        refused.starts_with(
            "a command of FRI 1.0 (LWR), expected a measurement of FRI 1.0 (LWR): a client sends"
        ),
        "{refused}"
    );
    let sunrise = [
        0x0a, 0x0a, 0x08, 0xc2, 0xa2, 0x91, 0x01, 0x10, 0xac, 0x02, 0x18, 0x02,
    ];
    for refused in [
        session.handle_datagram(&sunrise, PERIOD).unwrap_err(),
        pair.krc.handle_datagram(&sunrise, PERIOD).unwrap_err(),
    ] {
        let text = refused.to_string();
        assert!(
            text.starts_with("a monitoring message of Sunrise FRI 1.x or 2.0 to 2.5, expected"),
            "{text}"
        );
    }
}

// ------------------------------------------------------------------------------------------------------------ handshakes

#[test]
fn dialog_start_works_in_every_protocol() {
    for protocol in [
        Protocol::Stanford,
        Protocol::KukaLwr,
        Protocol::Tum,
        Protocol::FirstApp,
    ] {
        let mut pair = handshake(protocol);
        assert_eq!(pair.krc.state(), State::Mon, "{protocol}");
        pair.ask(&start()).unwrap();
        assert_eq!(pair.ask(&start()), Err(DialogError::Busy));
        pair.run(50);
        assert_eq!(pair.progress, [Progress::Done], "{protocol}");
        assert!(pair.session.is_commanding(), "{protocol}");
    }
}

#[test]
fn dialog_stop_and_restart_work() {
    for protocol in [Protocol::Stanford, Protocol::KukaLwr, Protocol::Tum] {
        let mut pair = handshake(protocol);
        for _ in 0..2 {
            pair.ask(&start()).unwrap();
            pair.run(50);
            assert!(pair.session.is_commanding(), "{protocol}");
            pair.ask(&Request::Stop).unwrap();
            pair.run(50);
            assert_eq!(pair.krc.state(), State::Mon, "{protocol}");
        }
        assert_eq!(pair.progress, [Progress::Done; 4], "{protocol}");
        assert_eq!(pair.reasons(), ["friStop"; 2]);
    }
}

#[test]
fn dialog_exit_does_not_restart_robot() {
    for protocol in [
        Protocol::Stanford,
        Protocol::KukaLwr,
        Protocol::Tum,
        Protocol::FirstApp,
    ] {
        let mut pair = handshake(protocol);
        pair.ask(&start()).unwrap();
        pair.run(50);
        pair.krc.faults_mut().to_krc.drop_next = 15;
        pair.run(1_000);
        assert!(matches!(
            pair.krc.log().next().unwrap().reason,
            ExitReason::Misses { .. }
        ));
        assert_eq!(pair.krc.state(), State::Mon, "{protocol}");
    }
}

#[test]
fn dialog_cancelled_start_has_no_later_effect() {
    for protocol in [Protocol::Stanford, Protocol::KukaLwr, Protocol::FirstApp] {
        let mut pair = handshake(protocol);
        pair.krc.set_power(false);
        pair.ask(&start()).unwrap();
        pair.run(5_100);
        assert!(
            matches!(
                pair.progress[..],
                [Progress::Failed(DialogError::Silent { .. })]
            ),
            "{protocol}"
        );
        pair.krc.set_power(true);
        pair.run(1_000);
        assert_eq!(pair.krc.state(), State::Mon, "{protocol}");
    }
}

#[test]
fn dialog_silence_withdraws_start() {
    for protocol in [
        Protocol::Stanford,
        Protocol::KukaLwr,
        Protocol::Tum,
        Protocol::FirstApp,
    ] {
        for is_under_way in [false, true] {
            let mut pair = handshake(protocol);
            pair.krc.set_power(!is_under_way);
            pair.ask(&start()).unwrap();
            pair.run(50);
            assert_eq!(pair.session.is_commanding(), !is_under_way, "{protocol}");
            let config = KrcConfig {
                script: Script::Handshake(protocol),
                joints: JOINTS,
                ..KrcConfig::default()
            };
            let begin = pair.now + Duration::from_secs(1);
            pair.krc = Krc::new(config, begin);
            assert!(pair.session.handle_timeout(begin));
            let was_busy = pair.dialog.handle_silence(pair.session.krl_mut());
            assert_eq!(was_busy, is_under_way, "{protocol}");
            pair.run(1_000);
            assert_eq!(pair.krc.state(), State::Mon, "{protocol}");
            pair.ask(&start()).unwrap();
            pair.run(50);
            assert!(
                pair.session.is_commanding(),
                "{protocol}: and it can be requested again"
            );
        }
    }
}

#[test]
fn dialog_start_carries_strategy_if_supported() {
    for protocol in [Protocol::Stanford, Protocol::KukaLwr] {
        for control in [
            Control::JointImpedance,
            Control::CartesianImpedance,
            Control::Position,
        ] {
            let mut pair = handshake(protocol);
            let strategy = Some(control);
            pair.ask(&Request::Start { strategy }).unwrap();
            pair.run(50);
            assert_eq!(
                (pair.krc.state(), pair.krc.control()),
                (State::Cmd, control),
                "{protocol}"
            );
        }
    }
    let mut tum = handshake(Protocol::Tum);
    let strategy = Some(Control::JointImpedance);
    let refused = tum
        .ask(&Request::Start { strategy })
        .unwrap_err()
        .to_string();
    assert_eq!(
        refused,
        "the KRL program (tum) cannot do that: choose another handshake or change the program"
    );
}

#[test]
fn dialog_reopen_changes_period() {
    let mut pair = handshake(Protocol::Tum);
    let period = Duration::from_millis(5);
    pair.ask(&Request::Reopen { period }).unwrap();
    pair.run(300);
    assert_eq!(
        (pair.progress.as_slice(), pair.session.period()),
        (&[Progress::Done][..], Some(period))
    );
    pair.ask(&start()).unwrap();
    pair.run(20);
    assert!(pair.session.is_commanding());
}

#[test]
fn dialog_configure_sets_tool_load_and_strategy() {
    let mut pair = handshake(Protocol::Rcc);
    assert_eq!(
        pair.krc.state(),
        State::Mon,
        "the program waits two seconds"
    );
    pair.run(1_000);
    assert!(pair.session.is_commanding());
    let settings = Settings {
        strategy: Some(Control::CartesianImpedance),
        tool: Some([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]),
        load: Some(Load {
            mass_kg: 1.5,
            centre: [7.0, 8.0, 9.0, 10.0, 11.0, 12.0],
            inertia: [0.1, 0.2, 0.3],
        }),
    };
    pair.ask(&Request::Configure(settings)).unwrap();
    pair.run(100);
    assert_eq!(pair.progress, [Progress::Done]);
    assert_eq!(
        (pair.krc.tool(), Some(pair.krc.load())),
        (settings.tool.unwrap(), settings.load)
    );
    assert_eq!(pair.krc.control(), Control::CartesianImpedance);
    assert!(
        pair.session.is_commanding(),
        "and the program starts FRI again"
    );
    let mass = Settings {
        load: Some(Load::default()),
        ..Settings::default()
    };
    pair.ask(&Request::Configure(mass)).unwrap();
    pair.run(100);
    assert_eq!(
        (pair.krc.tool(), pair.krc.load()),
        (settings.tool.unwrap(), Load::default())
    );
    assert_eq!(pair.reasons(), ["friStop"; 2]);
    for request in [start(), Request::Stop] {
        let refused = pair.ask(&request);
        assert!(matches!(refused, Err(DialogError::Unsupported { .. })));
    }
}

#[test]
fn dialog_configure_requires_power_and_rest() {
    let configure = Request::Configure(Settings::default());
    let mut pair = handshake(Protocol::Rcc);
    pair.run(1_000);
    pair.krc.set_power(false);
    pair.run(10);
    assert_eq!(pair.ask(&configure), Err(DialogError::Power));
    let mut pair = Pair::in_mode(Control::JointImpedance, CmdFlags::JNTPOS | CmdFlags::JNTTRQ);
    pair.dialog = Dialog::new(Protocol::Rcc);
    pair.session.fields_mut().joint_torque[3] = 20.0;
    pair.run(1_000);
    let refused = pair.ask(&configure).unwrap_err().to_string();
    assert!(
        refused.starts_with("A3 is 0.0200 rad from its set-point"),
        "{refused}"
    );
}

#[test]
fn dialog_wrong_program_times_out() {
    let mut pair = handshake(Protocol::Stanford);
    pair.dialog = Dialog::new(Protocol::Tum);
    pair.ask(&start()).unwrap();
    pair.run(5_100);
    let [Progress::Failed(error)] = pair.progress[..] else {
        panic!("{:?}", pair.progress)
    };
    assert_eq!(
        error.to_string(),
        "no reaction of the KRL program (tum) for 10 s while waiting for TO_BOOL[1]: check that it runs and uses these indices"
    );
}

#[test]
fn stanford_program_waits_for_ok_announces_close() {
    let mut pair = Pair::new(KrcConfig {
        script: Script::Handshake(Protocol::Stanford),
        ..KrcConfig::default()
    });
    pair.krc.faults_mut().quality = Some(Quality::Bad);
    pair.run(2);
    // FRM_INT[16] requests friStart.
    let krl = pair.session.krl_mut();
    (krl.int[14], krl.int[15]) = (10, 10);
    pair.run(300);
    assert_eq!(pair.msr().interface.state, State::Mon);
    pair.krc.faults_mut().quality = None;
    pair.run(300);
    assert_eq!(pair.msr().interface.state, State::Cmd);
    assert_eq!(pair.msr().krl.int[15], 20);
    // A client closes by the number that the program announces in TO_INT[15].
    let close = pair.msr().krl.int[14];
    assert_eq!(close, 30);
    pair.session.krl_mut().int[15] = close;
    pair.run(10);
    assert_eq!(pair.msr().interface.state, State::Mon);
    assert_eq!(pair.msr().krl.int[15], 30);
}

#[test]
fn lwr_measures_weight_and_moment_of_tool() {
    let config = KrcConfig {
        joints: JOINTS,
        tool_m: [0.0, 0.0, 0.1],
        ..KrcConfig::default()
    };
    let tip = Krc::new(config.clone(), Duration::ZERO).tip();
    let contact = Contact {
        shape: Shape::Spring,
        point: [tip[0] + 0.01, tip[1], tip[2]],
        normal: [1.0, 0.0, 0.0],
        stiffness: 1_000.0,
        damping: 50.0,
    };
    let mut pair = Pair::new(KrcConfig {
        contact: Some(contact),
        ..config
    });
    pair.run(10);
    let msr = pair.msr();
    assert!((msr.external_wrench[0] - 10.0).abs() < 0.1, "{msr}");
    let moment: f32 = msr.external_wrench[3..].iter().map(|it| it.abs()).sum();
    assert!(moment > 0.1, "{:?}", msr.external_wrench);
    assert!(msr.gravity[1].abs() > 5.0, "{:?}", msr.gravity);
    for joint in 0..AXES {
        let rest = msr.measured_torque[joint] - msr.gravity[joint];
        assert!((rest + msr.external_torque[joint]).abs() < 1e-3);
    }
}
