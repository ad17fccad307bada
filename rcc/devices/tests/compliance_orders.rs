//! Orders of nets to FRI arms besides positions, through the driver endpoints to the emulated controllers, in virtual
//! time: strategies, impedances, additions, tools, inputs and outputs. Motion is tested elsewhere.

#![expect(
    clippy::float_cmp,
    reason = "what goes over the wire is what was ordered, to the bit"
)]
#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test may fail anywhere, its helpers too"
)]

#[path = "../../core/tests/fixtures/mod.rs"]
mod fixtures;

use std::time::Duration;

use fixtures::{Driven, Fixture, watch};
use takt_core::device::{DeviceCommand, DeviceDescription, DeviceState, DeviceStatus, parts};
use takt_devices::fri::{IiwaConfig, IiwaIo, IiwaModel};
use takt_devices::fri::{Orders, Protocol};
use takt_devices::fri::{iiwa, lwr};
use takt_fri::lwr::Protocol as Handshake;
use takt_fri::lwr::emulator::{ExitReason, Krc, KrcConfig, Script};
use takt_fri::lwr::wire::{Cmd, CmdFlags, Control, State};
use takt_fri::sunrise::IoLevel;
use takt_fri::sunrise::emulator::{Cabinet, CabinetConfig, Control as Mode, Io, Overlay, Program};
use takt_fri::sunrise::wire::{
    Command, CommandData, CommandMode, Dialect, IoDirection, MESSAGE_MAX, unframe,
};
use takt_net::device::{Interfaces, Layout};

const AXES: usize = 7;

/// The emulated robot controller.
trait Controller {
    fn due(&self) -> Duration;
    fn send(&mut self, now: Duration, buffer: &mut [u8]) -> Option<usize>;
    fn take(&mut self, datagram: &[u8], now: Duration);
}

impl Controller for Krc {
    fn due(&self) -> Duration {
        self.poll_timeout()
    }

    fn send(&mut self, now: Duration, buffer: &mut [u8]) -> Option<usize> {
        self.poll_transmit(now, buffer)
    }

    fn take(&mut self, datagram: &[u8], now: Duration) {
        self.handle_datagram(datagram, now).unwrap();
    }
}

impl Controller for Cabinet {
    fn due(&self) -> Duration {
        self.poll_timeout()
    }

    fn send(&mut self, now: Duration, buffer: &mut [u8]) -> Option<usize> {
        self.poll_transmit(now, buffer)
    }

    fn take(&mut self, datagram: &[u8], now: Duration) {
        self.handle_datagram(datagram, now).unwrap();
    }
}

/// A net thread, a driver endpoint and a robot controller, stepped in turn.
struct Rig<P, C> {
    fixture: Fixture,
    driven: Driven,
    taken: DeviceCommand,
    reported: DeviceState,
    has: Interfaces,
    end: P,
    robot: C,
    answer: Vec<u8>,
    /// Whether the robot followed at the last answer.
    followed: bool,
    nets: u32,
}

impl<P: Protocol, C: Controller> Rig<P, C> {
    fn of(description: DeviceDescription, end: P, robot: C) -> Self {
        let mut layout = Layout::default();
        let has = parts::lay(&description.parts, AXES, &mut layout);
        let mut fixture = Fixture::default();
        let driven = fixture.add_driven(description);
        Self {
            fixture,
            driven,
            taken: DeviceCommand::new(layout.commands),
            reported: DeviceState::new(layout.signals),
            has,
            end,
            robot,
            answer: Vec::new(),
            followed: false,
            nets: 0,
        }
    }

    fn step(&mut self) {
        self.fixture.step();
        let taken = &mut self.taken;
        self.driven
            .command
            .read_with(|command| taken.copy_from(command));
        let (mut buffer, now) = ([0; MESSAGE_MAX], self.robot.due());
        while let Some(len) = self.robot.send(now, &mut buffer) {
            self.end.receive(&buffer[..len], now).unwrap();
            if !self.end.is_due() {
                continue;
            }
            let follows = self.end.status() == DeviceStatus::Operational;
            let orders = Orders {
                words: &self.taken.words,
                cycle: self.taken.cycle,
                is_fresh: true,
                follows: follows && self.followed,
                moves: false,
                now,
            };
            self.end.apply(&self.has, &orders);
            self.followed = follows;
            let rest = self.end.rest();
            let reply = self.end.reply(&rest, &mut || rest, &mut buffer);
            let len = reply.unwrap().len;
            self.answer = buffer[..len].to_vec();
            self.robot.take(&buffer[..len], now);
        }
        self.reported.status = self.end.status();
        self.end.report(&self.has, &mut self.reported.signals);
        if let Some(place) = &self.has.wrench {
            place.report(&mut self.reported.signals, self.end.wrench());
        }
        let reported = &self.reported;
        self.driven
            .state
            .write_with(|state| state.copy_from(reported));
    }

    fn steps(&mut self, count: usize) {
        (0..count).for_each(|_| self.step());
    }

    fn until(&mut self, what: &str, done: impl Fn(&Self) -> bool) {
        for _ in 0..20_000 {
            if done(self) {
                return;
            }
            self.step();
        }
        panic!("waited in vain for: {what}");
    }

    fn until_operational(&mut self) {
        self.until("command mode", |rig| {
            rig.end.status() == DeviceStatus::Operational
        });
        // Until nets receive it.
        self.steps(2);
    }

    /// Starts a net that runs until it is cancelled.
    fn start(&mut self, children: &str) -> u32 {
        self.nets += 1;
        self.fixture.start(self.nets, children);
        self.nets
    }

    /// Outcome of an order of a net, once known: 0 if it was carried out.
    fn outcome(&mut self, net: u32) -> String {
        for _ in 0..20_000 {
            self.step();
            let error = self.fixture.out(net, "error");
            if self.fixture.out(net, "done") == "true" || error != "0" {
                return error;
            }
        }
        panic!("the order of net {net} is never answered");
    }

    /// The same; then ends the net.
    fn ordered(&mut self, children: &str) -> String {
        let net = self.start(children);
        let outcome = self.outcome(net);
        self.fixture.end(net);
        outcome
    }
}

/// With its outcome under `done` and `error`.
fn ordered(order: &str) -> String {
    format!(
        "{order},{},{}",
        watch("Core::Boolean", "done", "order.outCompleted"),
        watch("Core::Int", "error", "order.outError")
    )
}

fn strategy(number: i32) -> String {
    ordered(&format!(
        "n=Core::IntValue(Value='{number}'),
        order=KUKA::LWR::ControlStrategy(inStrategy=n.outValue,Robot='arm')"
    ))
}

/// Orders inputs of the impedance of joint 1, such as `("inStiffness", 300.0)`.
fn joint(inputs: &[(&str, f64)]) -> String {
    let mut values = String::new();
    let mut links = String::new();
    for (port, value) in inputs {
        values += &format!("v_{port}=Core::DoubleValue(Value='{value}'),");
        links += &format!("{port}=v_{port}.outValue,");
    }
    ordered(&format!(
        "{values}order=KUKA::LWR::JointImpParameters({links}Robot='arm',Axis='1')"
    ))
}

/// Orders an input of the impedance of the tool.
fn tool_gives_way(port: &str, value: &str) -> String {
    ordered(&format!(
        "w=World::WrenchValue(Value='{value}'),
        order=KUKA::LWR::CartImpParameters({port}=w.outValue,Robot='arm')"
    ))
}

// ------------------------------------------------------------------------------------------ LWR

type Lwr = Rig<lwr::End, Krc>;

impl Lwr {
    fn new(script: Script, control: Control) -> Self {
        let handshake = match script {
            Script::Handshake(protocol) => Some(protocol),
            Script::Manual | Script::Auto { .. } => None,
        };
        let config = KrcConfig {
            period: fixtures::PERIOD,
            script,
            control,
            ..KrcConfig::default()
        };
        let krc = Krc::new(config, Duration::ZERO);
        let description = lwr::describe("arm").with(&lwr::parts());
        Self::of(description, lwr::End::new(handshake), krc)
    }

    fn manual(control: Control) -> Self {
        let mut rig = Self::new(Script::Manual, control);
        rig.steps(200);
        rig
    }

    fn enter(&mut self) {
        self.robot.fri_start(1.0).unwrap();
        self.until_operational();
        self.steps(5);
    }

    fn cmd(&self) -> Cmd {
        Cmd::decode(&self.answer).unwrap()
    }
}

#[test]
fn lwr_net_switches_strategy_through_krl_program() {
    for protocol in [Handshake::Rcc, Handshake::Stanford, Handshake::KukaLwr] {
        let mut rig = Lwr::new(Script::Handshake(protocol), Control::Position);
        rig.steps(200);
        if protocol == Handshake::Rcc {
            // Its program enters command mode by itself, the others' with the strategy.
            rig.until_operational();
        }
        for (number, control) in [
            (3, Control::JointImpedance),
            (2, Control::CartesianImpedance),
            (1, Control::Position),
        ] {
            assert_eq!(rig.ordered(&strategy(number)), "0", "{protocol}");
            assert_eq!(rig.robot.control(), control, "{protocol}");
            rig.until_operational();
        }
        let mut reasons = rig.robot.log().map(|left| left.reason);
        assert!(
            reasons.all(|reason| reason == ExitReason::FriStop),
            "{protocol}"
        );
    }
}

#[test]
fn lwr_net_enters_and_leaves_command_mode() {
    for protocol in [Handshake::Stanford, Handshake::KukaLwr, Handshake::Tum] {
        let mut rig = Lwr::new(Script::Handshake(protocol), Control::Position);
        rig.steps(200);
        assert_eq!(rig.robot.state(), State::Mon, "{protocol}: not requested");
        for _ in 0..2 {
            assert_eq!(rig.ordered(&strategy(1)), "0", "{protocol}");
            rig.until_operational();
            assert_eq!(rig.ordered(&strategy(0)), "0", "{protocol}");
            rig.steps(200);
            assert_eq!(rig.robot.state(), State::Mon, "{protocol}");
        }
    }
    let mut rig = Lwr::new(Script::Handshake(Handshake::Rcc), Control::Position);
    rig.until_operational();
    assert_eq!(rig.ordered(&strategy(0)), "4", "its program cannot");
    assert_eq!(rig.robot.state(), State::Cmd);
}

#[test]
fn lwr_impossible_strategy_is_refused() {
    let mut rig = Lwr::new(Script::default(), Control::Position);
    rig.until_operational();
    assert_eq!(rig.ordered(&strategy(1)), "0", "it is in force");
    assert_eq!(rig.ordered(&strategy(3)), "4", "no handshake is known");
    assert_eq!(rig.ordered(&strategy(7)), "1", "there is none");
    assert_eq!(rig.robot.state(), State::Cmd, "nothing was asked of KRL");
    let krl = *rig.robot.krl();
    assert_eq!((krl.int, krl.bools), ([0; 16], 0));
    for protocol in [Handshake::Tum, Handshake::FirstApp] {
        let mut rig = Lwr::new(Script::Handshake(protocol), Control::Position);
        rig.steps(200);
        assert_eq!(rig.ordered(&strategy(3)), "4", "{protocol}");
    }
}

#[test]
fn lwr_unresponsive_program_is_reported_next_order_accepted() {
    // The program uses another handshake than the cell configures.
    let mut rig = Lwr::new(Script::default(), Control::Position);
    rig.end = lwr::End::new(Some(Handshake::Rcc));
    rig.until_operational();
    assert_eq!(rig.ordered(&strategy(3)), "5");
    assert_eq!(rig.ordered(&strategy(1)), "0");
}

#[test]
fn lwr_strategy_needs_power_and_set_point() {
    let mut rig = Lwr::new(Script::Handshake(Handshake::Rcc), Control::Position);
    rig.until_operational();
    rig.robot.set_power(false);
    rig.steps(100);
    assert_eq!(rig.ordered(&strategy(3)), "2");
    assert_eq!(rig.robot.control(), Control::Position);
}

#[test]
fn lwr_orders_before_command_mode_apply_with_it() {
    let mut rig = Lwr::manual(Control::JointImpedance);
    let net = rig.start(&joint(&[("inStiffness", 300.0), ("inDamping", 0.5)]));
    assert_eq!(rig.outcome(net), "0");
    rig.enter();
    let cmd = rig.cmd();
    let wanted = CmdFlags::JNTPOS | CmdFlags::JNTSTIFF | CmdFlags::JNTDAMP;
    assert_eq!(cmd.flags, wanted);
    assert_eq!((cmd.joint_stiffness[1], cmd.joint_damping[1]), (300.0, 0.5));
    assert_eq!(rig.fixture.out(net, "error"), "0");
    rig.fixture.end(net);
    rig.steps(10);
    assert_eq!(rig.cmd().joint_stiffness[1], 300.0, "it stays");
    assert_eq!(rig.robot.exits(), 0);
}

#[test]
fn lwr_unselected_fields_wait_for_next_command_mode() {
    let mut rig = Lwr::manual(Control::JointImpedance);
    rig.enter();
    let net = rig.start(&joint(&[("inStiffness", 300.0)]));
    assert_eq!(rig.outcome(net), "6");
    assert_eq!(rig.cmd().flags, CmdFlags::JNTPOS, "$STIFFNESS rules");
    rig.robot.fri_stop();
    rig.steps(200);
    rig.enter();
    assert_eq!(rig.fixture.out(net, "error"), "0");
    assert!(rig.cmd().flags.contains(CmdFlags::JNTSTIFF));
    assert_eq!(rig.robot.exits(), 1, "friStop alone");
}

#[test]
fn lwr_impedance_in_wrong_strategy_is_refused() {
    let mut rig = Lwr::manual(Control::CartesianImpedance);
    let soft = "{force:{x:500,y:600,z:700},torque:{x:50,y:60,z:70}}";
    assert_eq!(rig.ordered(&joint(&[("inStiffness", 300.0)])), "4");
    assert_eq!(rig.ordered(&tool_gives_way("inStiffness", soft)), "0");
    assert_eq!(rig.ordered(&joint(&[("inStiffness", -1.0)])), "1");
    assert_eq!(rig.ordered(&tool_gives_way("inDamping", soft)), "1");
    rig.enter();
    let wire = [500.0, 600.0, 700.0, 70.0, 60.0, 50.0];
    assert_eq!(rig.cmd().cartesian_stiffness, wire, "about z comes first");
    assert_eq!(rig.cmd().flags, CmdFlags::JNTPOS | CmdFlags::CARTSTIFF);
}

#[test]
fn lwr_torque_needs_running_net_and_renewal_after_fault() {
    let mut rig = Lwr::manual(Control::JointImpedance);
    // Chooses the field.
    assert_eq!(rig.ordered(&joint(&[("inAddTorque", 0.0)])), "0");
    rig.enter();
    let net = rig.start(&joint(&[("inAddTorque", 5.0)]));
    assert_eq!(rig.outcome(net), "0");
    assert_eq!(rig.cmd().joint_torque[1], 5.0);
    rig.steps(2000);
    // 5 Nm against 1000 Nm/rad.
    let given_way = rig.robot.joints()[1] - rig.robot.set_point()[1];
    assert!((given_way - 0.005).abs() < 1e-4, "{given_way}");
    rig.robot.set_power(false);
    rig.steps(50);
    rig.robot.set_power(true);
    rig.until_operational();
    rig.steps(5);
    assert_eq!(rig.cmd().joint_torque, [0.0; 7], "not requested again");
    assert_eq!(rig.fixture.out(net, "error"), "6");
    rig.fixture.end(net);
    rig.steps(2);
    let net = rig.start(&joint(&[("inAddTorque", 5.0)]));
    assert_eq!(rig.outcome(net), "0");
    assert_eq!(rig.cmd().joint_torque[1], 5.0);
    rig.fixture.end(net);
    rig.steps(3);
    assert_eq!(rig.cmd().joint_torque[1], 0.0, "it ends with its net");
}

#[test]
fn lwr_torque_beyond_guard_is_refused() {
    let mut rig = Lwr::manual(Control::JointImpedance);
    assert_eq!(rig.ordered(&joint(&[("inAddTorque", 0.0)])), "0");
    rig.enter();
    assert_eq!(rig.ordered(&joint(&[("inAddTorque", 177.0)])), "1");
    assert_eq!(rig.cmd().joint_torque, [0.0; 7]);
}

#[test]
fn lwr_force_is_added_in_cartesian_impedance() {
    let mut rig = Lwr::manual(Control::CartesianImpedance);
    assert_eq!(rig.ordered(&tool_gives_way("inAddTorque", "{}")), "0");
    rig.enter();
    let net = rig.start(&tool_gives_way(
        "inAddTorque",
        "{force:{z:-20},torque:{x:1}}",
    ));
    assert_eq!(rig.outcome(net), "0");
    assert_eq!(rig.cmd().wrench, [0.0, 0.0, -20.0, 0.0, 0.0, 1.0]);
}

#[test]
fn lwr_net_sends_tool_to_krl_program() {
    let mut rig = Lwr::new(Script::Handshake(Handshake::Rcc), Control::Position);
    rig.until_operational();
    let tool = ordered(
        "m=Core::DoubleValue(Value='1.5'),
        com=World::FrameValue(Value='{pos:{x:0.01,z:0.1}}'),
        moi=World::VectorValue(Value='{x:0.1,y:0.2,z:0.3}'),
        tcp=World::FrameValue(Value='{pos:{z:0.25},rot:{a:1.5707963267948966}}'),
        order=KUKA::LWR::ToolParameters(inMass=m.outValue,inCOM=com.outValue,inMOI=moi.outValue,
            inTCP=tcp.outValue,robot='arm')",
    );
    assert_eq!(rig.ordered(&tool), "0");
    assert_eq!(rig.robot.tool(), [0.0, 0.0, 250.0, 90.0, 0.0, 0.0]);
    let load = rig.robot.load();
    assert_eq!((load.mass_kg, load.inertia), (1.5, [0.1, 0.2, 0.3]));
    assert_eq!(load.centre, [10.0, 0.0, 100.0, 0.0, 0.0, 0.0]);
}

#[test]
fn lwr_user_data_outside_handshake_are_io() {
    let mut rig = Lwr::new(Script::Handshake(Handshake::Rcc), Control::Position);
    rig.until_operational();
    let ports = |ports: [u32; 2]| {
        let [one, other] = ports;
        format!(
            "t=Core::BooleanValue(Value='true'),r=Core::DoubleValue(Value='2.5'),
            b1=IO::OutBool(inIO=t.outValue,DeviceID='arm',Port='{one}'),
            b2=IO::OutBool(inIO=t.outValue,DeviceID='arm',Port='{other}'),
            r1=IO::OutReal(inIO=r.outValue,DeviceID='arm',Port='{one}'),
            r2=IO::OutReal(inIO=r.outValue,DeviceID='arm',Port='14'),
            s=IO::OutBoolSensor(DeviceID='arm',Port='{other}'),
            ib=IO::InBool(DeviceID='arm',Port='4'),ir=IO::InReal(DeviceID='arm',Port='5'),
            {},{},{}",
            watch("Core::Boolean", "sent", "s.outIO"),
            watch("Core::Boolean", "bool", "ib.outIO"),
            watch("Core::Double", "real", "ir.outIO"),
        )
    };
    let net = rig.start(&ports([3, 15]));
    rig.robot.krl_mut().set_bool(4, true);
    rig.robot.krl_mut().real[5] = -1.25;
    rig.steps(5);
    let krl = *rig.robot.krl();
    assert!(krl.bool(3) && !krl.bool(15), "the last is the handshake's");
    assert_eq!((krl.real[3], krl.real[14]), (2.5, 0.0));
    assert_eq!(rig.fixture.out(net, "sent"), "false", "and a net sees it");
    assert_eq!(rig.fixture.out(net, "bool"), "true");
    assert_eq!(rig.fixture.out(net, "real"), "-1.25");
    assert_eq!(rig.robot.state(), State::Cmd);
}

// ----------------------------------------------------------------------------------------- iiwa

type Iiwa = Rig<iiwa::End, Cabinet>;

impl Iiwa {
    fn new(dialect: Dialect, control: Mode, command: CommandMode) -> Self {
        let overlay = Overlay { control, command };
        let lamp = |name: &str, direction, level| Io {
            name: name.to_owned(),
            direction,
            level,
        };
        let (input, output) = (IoDirection::Input, IoDirection::Output);
        let config = CabinetConfig {
            dialect,
            send_period: fixtures::PERIOD,
            program: Program::Auto {
                overlay,
                restart: Some(Duration::from_millis(100)),
            },
            ios: vec![
                lamp("Media.Key", input, IoLevel::Boolean(true)),
                lamp("Media.Lamp", output, IoLevel::Boolean(false)),
                lamp("Media.Count", input, IoLevel::Digital(42)),
                lamp("Media.Volt", output, IoLevel::Analog(0.0)),
            ],
            ..CabinetConfig::default()
        };
        let names = |name: &str| vec![name.to_owned()];
        let io = IiwaIo {
            bool_in: names("Media.Key"),
            bool_out: vec!["Media.Lamp".to_owned(), "Media.Missing".to_owned()],
            real_in: names("Media.Count"),
            real_out: names("Media.Volt"),
        };
        let arm = IiwaConfig::new("arm", ([127, 0, 0, 1], 0).into());
        let description = iiwa::describe(&arm.name, arm.model).with(&iiwa::parts(&io));
        let end = iiwa::End::new(IiwaModel::Iiwa14, io);
        let cabinet = Cabinet::new(config, Duration::ZERO);
        let mut rig = Self::of(description, end, cabinet);
        rig.until_operational();
        rig
    }

    fn data(&self) -> CommandData {
        let (_, message) = unframe(&self.answer).unwrap();
        Command::decode(message).unwrap().data.unwrap()
    }
}

const SPRINGS: Mode = Mode::JointImpedance {
    stiffness: [1000.0; AXES],
    damping: [0.7; AXES],
};
const SOFT_TOOL: Mode = Mode::CartesianImpedance {
    stiffness: [2000.0, 2000.0, 2000.0, 200.0, 200.0, 200.0],
    damping: [0.7; 6],
};

#[test]
fn iiwa_torques_are_added_in_torque_overlay() {
    for dialect in [Dialect::V1, Dialect::V2, Dialect::V3] {
        let mut rig = Iiwa::new(dialect, SPRINGS, CommandMode::Torque);
        let net = rig.start(&joint(&[("inAddTorque", 5.0)]));
        assert_eq!(rig.outcome(net), "0");
        assert_eq!(rig.data().torque.map(|torque| torque[1]), Some(5.0));
        rig.steps(2000);
        let given_way = rig.robot.joints()[1] - rig.robot.set_point()[1];
        assert!((given_way - 0.005).abs() < 1e-4, "{given_way}");
        rig.robot.set_power(false);
        rig.steps(50);
        rig.robot.set_power(true);
        rig.until_operational();
        rig.steps(5);
        assert_eq!(rig.data().torque, Some([0.0; AXES]), "not requested again");
        assert_eq!(rig.fixture.out(net, "error"), "6");
    }
}

#[test]
fn iiwa_wrench_is_added_in_wrench_overlay() {
    let mut rig = Iiwa::new(Dialect::V2, SOFT_TOOL, CommandMode::Wrench);
    let net = rig.start(&tool_gives_way(
        "inAddTorque",
        "{force:{z:-20},torque:{x:1}}",
    ));
    assert_eq!(rig.outcome(net), "0");
    let wire = [0.0, 0.0, -20.0, 0.0, 0.0, 1.0];
    assert_eq!(rig.data().wrench, Some(wire));
    rig.fixture.end(net);
    rig.steps(3);
    assert_eq!(rig.data().wrench, Some([0.0; 6]), "it ends with its net");
}

#[test]
fn iiwa_orders_unsupported_by_overlay_are_refused() {
    let mut rig = Iiwa::new(Dialect::V1, Mode::Position, CommandMode::Position);
    assert_eq!(rig.ordered(&strategy(1)), "0", "it is in force");
    assert_eq!(rig.ordered(&strategy(3)), "4", "only its program switches");
    assert_eq!(rig.ordered(&strategy(0)), "1", "there is none");
    assert_eq!(rig.ordered(&joint(&[("inAddTorque", 5.0)])), "4");
    assert_eq!(rig.ordered(&joint(&[("inStiffness", 300.0)])), "4");
    assert_eq!(rig.ordered(&joint(&[("inAddTorque", 321.0)])), "1");
    let push = tool_gives_way("inAddTorque", "{force:{z:-20}}");
    assert_eq!(rig.ordered(&push), "4");
    assert_eq!(rig.robot.exits(), 0);
}

#[test]
fn iiwa_shared_signals_are_io_of_nets() {
    let mut rig = Iiwa::new(Dialect::V2, Mode::Position, CommandMode::Position);
    let net = rig.start(&format!(
        "t=Core::BooleanValue(Value='true'),r=Core::DoubleValue(Value='2.5'),
        b0=IO::OutBool(inIO=t.outValue,DeviceID='arm',Port='0'),
        b1=IO::OutBool(inIO=t.outValue,DeviceID='arm',Port='1'),
        r0=IO::OutReal(inIO=r.outValue,DeviceID='arm',Port='0'),
        s0=IO::OutBoolSensor(DeviceID='arm',Port='0'),s1=IO::OutBoolSensor(DeviceID='arm',Port='1'),
        ib=IO::InBool(DeviceID='arm',Port='0'),ir=IO::InReal(DeviceID='arm',Port='0'),
        {},{},{},{}",
        watch("Core::Boolean", "sent", "s0.outIO"),
        watch("Core::Boolean", "missing", "s1.outIO"),
        watch("Core::Boolean", "bool", "ib.outIO"),
        watch("Core::Double", "real", "ir.outIO"),
    ));
    rig.steps(10);
    assert_eq!(rig.robot.io("Media.Lamp"), Some(IoLevel::Boolean(true)));
    assert_eq!(rig.robot.io("Media.Volt"), Some(IoLevel::Analog(2.5)));
    for (key, value) in [
        ("sent", "true"),
        ("missing", "null"),
        ("bool", "true"),
        ("real", "42"),
    ] {
        assert_eq!(rig.fixture.out(net, key), value, "{key}");
    }
}

#[test]
fn iiwa_tool_force_is_reported_since_fri_2_7() {
    let force = format!(
        "f=KUKA::LWR::FMonitor(Robot='arm'),{}",
        watch("Core::Double", "z", "f.outTcpFz")
    );
    for (dialect, known) in [(Dialect::V1, "null"), (Dialect::V3, "0")] {
        let mut rig = Iiwa::new(dialect, Mode::Position, CommandMode::Position);
        let net = rig.start(&force);
        rig.steps(5);
        assert_eq!(rig.fixture.out(net, "z"), known, "{dialect:?}");
    }
}
