//! The net of a Cartesian linear motion of two LWRs: its cost per cycle in a 1 kHz loop, by type of
//! primitive. Drivers and their wires are not part of it.
//!
//! The share of a type is measured by doubling: the same net with a second instance, fed by the same
//! links, beside each primitive of that type. The increase is the cost of that type. A clock read
//! around each step would cost more than most steps do.

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::time::Duration;

use serde_json::{Value, json};
use takt_core::device::{ArmDescription, DeviceTable};
use takt_net::device::{Image, JointState};
use takt_net::value::text::TextValue as _;
use takt_net::{Frame, JointLimits, Limits, LoadContext, Moment, Nanos, Plan, Registry, load};
use takt_rt::monotonic;
use takt_rt::thread::ThreadConfig;

use crate::quantiles::{as_f64, median, quantile};

const ARMS: [&str; 2] = ["left", "right"];
const JOINTS: usize = 7;
/// Cycles in the 1 kHz loop.
const CYCLES: usize = 6_000;
/// Rounds in which every variant of the net is timed once, and cycles of one timing.
const ROUNDS: usize = 200;
const BATCH: usize = 20;
const PERIOD: Duration = Duration::from_millis(1);
const PERIOD_NS: i64 = 1_000_000;
const PRIORITY: u8 = 90;

/// A child of the net: name, type, arguments.
type Child = (String, &'static str, String);

/// Joint positions at the start, rad.
const HOME: [f64; JOINTS] = [0.3, 0.6, 0.2, -1.4, 0.1, 0.9, 0.4];
/// The motion from there, m.
const WAY: [f64; 3] = [-0.05, 0.1, 0.08];

/// Start and end of the motion, as text.
fn ends() -> [String; 2] {
    let arm = takt_motion::kinematics::named("kuka_lwr4").expect("a model of this crate");
    let from = arm.forward(&HOME);
    let mut to = from;
    to.translation.vector += nalgebra::Vector3::from(WAY);
    [from, to].map(|frame: Frame| {
        let mut text = String::new();
        frame.format(&mut text);
        text
    })
}

/// The children that a net has for one arm.
struct Arm<'a> {
    name: &'a str,
    children: Vec<Child>,
}

impl Arm<'_> {
    /// The name of a child of this arm.
    fn n(&self, part: &str) -> String {
        format!("{}_{part}", self.name)
    }

    fn add(&mut self, part: &str, ty: &'static str, args: String) {
        let name = self.n(part);
        self.children.push((name, ty, args));
    }

    /// The motion, from the joints' measurements to their set-points.
    fn moves(&mut self, [from, to]: &[String; 2]) {
        let robot = format!("Robot='{}'", self.name);
        // So slow that it lasts longer than the measurement: 0.14 m at 0.1 mm/s.
        let args = format!(
            "From='{from}',To='{to}',Velocity='0.0001',RotVelocity='0.001',\
             inOverride=speed.outValue,inStop=cancel.outCancel"
        );
        self.add("lin", "Motion::Lin", args);
        let (mut hints, mut measured) = (String::new(), String::new());
        for joint in 0..JOINTS {
            let part = format!("m{joint}");
            let args = format!("{robot},Axis='{joint}'");
            self.add(&part, "RobotArm::JointMonitor", args);
            let (one, monitor) = (joint + 1, self.n(&part));
            hints += &format!("inHintJ{one}={monitor}.outCommandedPosition,");
            measured += &format!("inJ{one}={monitor}.outMeasuredPosition,");
        }
        let inverse = format!("inFrame={}.outPosition,{hints}{robot}", self.n("lin"));
        self.add("inv", "KUKA::LWR::InvKin", inverse);
        self.add("kin", "KUKA::LWR::Kin", format!("{measured}{robot}"));
        for joint in 0..JOINTS {
            let source = format!("inPosition={}.outJ{}", self.n("inv"), joint + 1);
            let args = format!("{source},{robot},Axis='{joint}'");
            self.add(&format!("j{joint}"), "RobotArm::JointPosition", args);
        }
    }

    /// Whether a joint failed, or the flange is not where it should be.
    fn watches(&mut self) {
        let mut failed = format!("{}.outErrorJointFailed", self.n("j0"));
        for joint in 1..JOINTS {
            let part = format!("f{joint}");
            let other = self.n(&format!("j{joint}"));
            let args = format!("inFirst={failed},inSecond={other}.outErrorJointFailed");
            self.add(&part, "Core::BooleanOr", args);
            failed = format!("{}.outValue", self.n(&part));
        }
        let [lin, kin, there, off, parts, far, lost] =
            ["lin", "kin", "there", "off", "parts", "far", "lost"].map(|part| self.n(part));
        let rows = [
            (
                "there",
                "World::FrameInvert",
                format!("inValue={lin}.outPosition"),
            ),
            (
                "off",
                "World::FrameTransform",
                format!("inFirst={there}.outValue,inSecond={kin}.outFrame"),
            ),
            (
                "parts",
                "World::FrameToPosRot",
                format!("inValue={off}.outValue"),
            ),
            (
                "far",
                "World::VectorDot",
                format!("inFirst={parts}.outPosition,inSecond={parts}.outPosition"),
            ),
            // Squared, m².
            (
                "lost",
                "Core::DoubleGreater",
                format!("inFirst={far}.outValue,Second='0.01'"),
            ),
            (
                "bad",
                "Core::BooleanOr",
                format!("inFirst={failed},inSecond={lost}.outValue"),
            ),
        ];
        rows.into_iter()
            .for_each(|(part, ty, args)| self.add(part, ty, args));
    }

    /// Where a successor may take over, the end, and the values for programs.
    fn ends(&mut self) {
        let [lin, kin, inv, past, blend, bad] =
            ["lin", "kin", "inv", "past", "blend", "bad"].map(|part| self.n(part));
        let rows = [
            (
                "past",
                "Core::DoubleGreater",
                format!("inFirst={lin}.outProgress,Second='0.8'"),
            ),
            (
                "blend",
                "Core::BooleanAnd",
                format!("inFirst={past}.outValue,inSecond=takeover.outTakeover"),
            ),
            (
                "end",
                "Core::BooleanOr",
                format!("inFirst={blend}.outValue,inSecond={lin}.outDone"),
            ),
        ];
        rows.into_iter()
            .for_each(|(part, ty, args)| self.add(part, ty, args));
        let outputs = [
            ("frame", "World::FrameNetcommOut", format!("{kin}.outFrame")),
            (
                "part",
                "Core::DoubleNetcommOut",
                format!("{lin}.outProgress"),
            ),
            ("error", "Core::IntNetcommOut", format!("{inv}.outError")),
            (
                "fault",
                "Core::BooleanNetcommOut",
                format!("{bad}.outValue"),
            ),
        ];
        for (what, ty, value) in outputs {
            let args = format!("inValue={value},Key='{}'", self.n(what));
            self.add(&format!("report_{what}"), ty, args);
        }
    }
}

/// What the net does for one arm.
fn arm(name: &str, ends: &[String; 2]) -> Vec<Child> {
    let children = Vec::new();
    let mut arm = Arm { name, children };
    arm.moves(ends);
    arm.watches();
    arm.ends();
    arm.children
}

/// All children of the net; `end` is true when it is to end.
fn children() -> Vec<Child> {
    let ends = ends();
    let mut children: Vec<Child> = [
        ("speed", "Core::DoubleNetcommIn", "Key='speed',Value='1'"),
        ("cancel", "Cancel", ""),
        ("takeover", "Takeover", ""),
    ]
    .map(|(name, ty, args)| (name.to_owned(), ty, args.to_owned()))
    .into();
    children.extend(ARMS.iter().flat_map(|name| arm(name, &ends)));
    let [left, right] = ARMS;
    let both =
        |port: &str| format!("inFirst={left}_{port}.outValue,inSecond={right}_{port}.outValue");
    children.extend([
        ("done".to_owned(), "Core::BooleanAnd", both("end")),
        ("bad".to_owned(), "Core::BooleanOr", both("bad")),
        (
            "end".to_owned(),
            "Core::BooleanOr",
            "inFirst=done.outValue,inSecond=bad.outValue".to_owned(),
        ),
    ]);
    children
}

/// The net's text, with a second instance of each primitive of type `doubled`.
fn text(children: &[Child], doubled: Option<&str>) -> String {
    let mut text = String::from("{");
    for (name, ty, args) in children {
        text += &format!("{name}={ty}({args}),");
        if doubled == Some(ty) {
            let args = args.replace("Key='", "Key='other_");
            text += &format!("other_{name}={ty}({args}),");
        }
    }
    text + "outTerminate=end.outValue}"
}

/// A net in a cell whose arms follow without delay.
struct Cell {
    plan: Plan,
    image: Image,
    cycle: u64,
}

impl Cell {
    fn new(text: &str, registry: &Registry, devices: &DeviceTable) -> Self {
        let context = LoadContext {
            registry,
            devices,
            period: PERIOD,
            limits: Limits::default(),
        };
        let plan = load(text, &context).expect("the net is good");
        let cell = Self {
            plan,
            image: Image::default(),
            cycle: 0,
        };
        for (i, joint) in cell.image.joints[..2 * JOINTS].iter().enumerate() {
            let home = Some(HOME[i % JOINTS]);
            joint.state.set(JointState {
                commanded_position: home,
                measured_position: home,
                ..JointState::default()
            });
        }
        cell
    }

    /// One cycle; returns the time of the evaluation, ns.
    fn cycle(&mut self) -> f64 {
        self.cycle += 1;
        let time = Nanos(i64::try_from(self.cycle).expect("few cycles") * PERIOD_NS);
        let moment = Moment {
            cycle: self.cycle,
            time,
            wall: time,
            ..Moment::default()
        };
        let start = monotonic();
        let ends = self.plan.evaluate(&self.image, moment);
        let spent = (monotonic() - start).0;
        assert!(!ends, "the motion goes on");
        for joint in &self.image.joints[..2 * JOINTS] {
            let command = joint.command.get();
            assert_eq!(command.cycle, self.cycle, "every joint gets a set-point");
            let mut state = joint.state.get();
            state.commanded_position = Some(command.position);
            state.measured_position = Some(command.position);
            joint.state.set(state);
        }
        as_f64(spent)
    }
}

/// An arm of seven joints with the kinematics of an LWR.
fn description(name: &str) -> ArmDescription {
    let limits = JointLimits {
        position_min: -3.0,
        position_max: 3.0,
        velocity_max: 2.0,
        acceleration_max: 4.0,
    };
    ArmDescription {
        name: name.to_owned(),
        kind: "test",
        limits: vec![limits; 7],
        model: "kuka_lwr4".into(),
    }
}

pub(crate) fn run() -> Value {
    let (registry, children) = (takt_core::registry(), children());
    let mut devices = DeviceTable::default();
    for name in ARMS {
        devices.add_arm(description(name)).expect("there is room");
    }
    let cell = |doubled| Cell::new(&text(&children, doubled), &registry, &devices);
    let paced = paced(cell(None));
    let mut types: Vec<&str> = children.iter().map(|(_, ty, _)| *ty).collect();
    types.sort_unstable();
    types.dedup();
    let variants = [None].into_iter().chain(types.iter().copied().map(Some));
    let cells: Vec<Cell> = variants.map(cell).collect();
    let primitives = children.len();
    let (whole, by_type) = shares(cells, &types);
    let us = |ns: f64| (ns / 10.0).round() / 100.0;
    let (p50, p99) = (us(median(&paced)), us(quantile(&paced, 0.99)));
    println!(
        "mixed net, {primitives} primitives, 1 kHz: {p50:.2} us a cycle, p99 {p99:.2} us; back to \
         back {:.2} us, of it",
        us(whole)
    );
    let mut rows: Vec<_> = by_type.iter().collect();
    rows.sort_by(|(_, a), (_, b)| b.total_cmp(a));
    for (ty, share) in rows {
        let count = children.iter().filter(|(_, of, _)| of == ty).count();
        println!("{:6.1} % {count:3} {ty}", share * 100.0);
    }
    json!({
        "mixed_net_primitives": primitives, "mixed_net_us": p50, "mixed_net_us_p99": p99,
        "mixed_net_warm_us": us(whole), "mixed_net_share": by_type,
    })
}

/// Times of cycles in a 1 kHz loop, ns.
fn paced(mut cell: Cell) -> Vec<f64> {
    let config = ThreadConfig {
        priority: Some(PRIORITY),
        ..ThreadConfig::new("mixed")
    };
    let thread = takt_rt::thread::spawn(config, move || {
        let (mut stats, _) = takt_rt::stats::pair();
        let mut times = Vec::with_capacity(CYCLES);
        takt_rt::cycle::run_cycles(PERIOD, None, &mut stats, |_| {
            times.push(cell.cycle());
            if times.len() < CYCLES {
                ControlFlow::Continue(())
            } else {
                ControlFlow::Break(())
            }
        });
        times
    });
    let thread = thread.expect("the system has a thread to give");
    thread.join().expect("no cycle panics")
}

/// The time of the first net, ns, and the share of each type in it: the increase in the net with that type
/// doubled. The remainder is the evaluation itself and rounding.
fn shares<'t>(mut cells: Vec<Cell>, types: &[&'t str]) -> (f64, BTreeMap<&'t str, f64>) {
    let mut times = vec![Vec::new(); cells.len()];
    for _ in 0..ROUNDS {
        for (cell, times) in cells.iter_mut().zip(&mut times) {
            let batch: Vec<f64> = (0..BATCH).map(|_| cell.cycle()).collect();
            times.push(median(&batch));
        }
    }
    let whole = median(&times[0]);
    // In the same round the machine is the same.
    let above = |doubled: &Vec<f64>| {
        let differences: Vec<f64> = doubled.iter().zip(&times[0]).map(|(d, t)| d - t).collect();
        let share = median(&differences) / whole;
        (share.max(0.0) * 1e4).round() / 1e4
    };
    let shares = types.iter().copied().zip(times[1..].iter().map(above));
    (whole, shares.collect())
}
