//! Kinematics and motions in running nets allocate nothing: counted over thousands of cycles in
//! which goals, overrides and frames change and some inverses have no solution.

use std::sync::Arc;
use std::time::Duration;

use takt_motion::kinematics::named;
use takt_net::{
    ArmBinding, Devices, Image, JointLimits, Limits, LoadContext, Moment, Nanos, Plan, Registry,
    load,
};
use takt_tests::{Allocations, CountingAllocator};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// Arms named after their models.
struct Arms;

impl Devices for Arms {
    fn arm(&self, name: &str) -> Option<ArmBinding> {
        let kinematics = named(name)?;
        let limits = JointLimits {
            position_min: -2.0,
            position_max: 2.0,
            velocity_max: 1.0,
            acceleration_max: 1.0,
        };
        Some(ArmBinding {
            first_joint: 0,
            limits: vec![limits; kinematics.joints()].into(),
            kinematics: Some(kinematics),
        })
    }

    fn names(&self) -> Vec<String> {
        Vec::new()
    }
}

fn plan(children: &str) -> Plan {
    let mut registry = Registry::core();
    registry.add(takt_motion::all());
    let context = LoadContext {
        registry: &registry,
        devices: &Arms,
        period: Duration::from_millis(1),
        limits: Limits::default(),
    };
    let text = format!("{{{children},never=Core::BooleanValue(),outTerminate=never.outValue}}");
    let plan = load(&text, &context).map_err(|rejection| rejection.lines(&text));
    plan.expect("a net without faults")
}

/// Runs `cycles` cycles and writes `inputs[k]`, a key and its values, one value every seventh
/// cycle; returns the number of allocations and deallocations in the cycles.
fn allocations(children: &str, inputs: &[(&str, &[&str])], cycles: u64) -> u64 {
    let mut plan = plan(children);
    let image = Image::default();
    let inbox = Arc::clone(plan.inbox());
    let mut inside = 0;
    for cycle in 1..=cycles {
        if cycle % 7 == 0 {
            let mut words: Vec<u64> = plan.inbox_words().collect();
            for (key, values) in inputs {
                let entry = inbox.find(&format!("in{key}")).expect("a NetcommIn");
                let number = usize::try_from(cycle / 7).expect("few cycles") % values.len();
                entry.write(values[number], &mut words).expect("a value");
            }
            plan.import(&words);
        }
        let time = Nanos(i64::try_from(cycle).expect("few cycles") * 1_000_000);
        let moment = Moment {
            cycle,
            time,
            wall: time,
            ..Moment::default()
        };
        let allocations = Allocations::count();
        plan.evaluate(&image, moment);
        inside += allocations.end();
    }
    inside
}

#[test]
fn motions_allocate_nothing() {
    let controls = "o=Core::DoubleNetcommIn(Key='o',Value='1'),s=Core::BooleanNetcommIn(Key='s'),\
                    r=Core::BooleanNetcommIn(Key='r'),";
    let inputs: &[(&str, &[&str])] = &[
        ("o", &["1", "0.3", "0.3", "nan", "0", "0.8", "1e-3", "+inf"]),
        ("s", &["false", "false", "false", "false", "true"]),
        ("r", &["false", "false", "false", "false", "false", "true"]),
    ];
    let ports = "inOverride=o.outValue,inStop=s.outValue,inReset=r.outValue";
    for motion in [
        "Ptp({},To='[1,2,3,4,5,6,7]')",
        "Lin({},To='{pos:{x:0.1},rot:{a:1}}')",
        "Circ({},Via='{pos:{x:0.1}}',To='{pos:{y:0.1},rot:{a:1}}')",
    ] {
        let net = format!("{controls}m=Motion::{}", motion.replacen("{}", ports, 1));
        assert_eq!(allocations(&net, inputs, 5000), 0, "{motion}");
    }
}

/// Motions that begin in motion, again and again, and join their paths.
#[test]
fn motions_from_any_state_allocate_nothing() {
    let controls = "o=Core::DoubleNetcommIn(Key='o',Value='1'),s=Core::BooleanNetcommIn(Key='s'),\
                    r=Core::BooleanNetcommIn(Key='r'),q=Core::DoubleArrayNetcommIn(Key='q',Value='[0,0]'),\
                    qv=Core::DoubleArrayNetcommIn(Key='qv',Value='[0,0]'),\
                    f=World::FrameNetcommIn(Key='f'),fv=World::TwistNetcommIn(Key='fv'),";
    let often: Vec<_> = (0..40)
        .map(|k| if k == 39 { "true" } else { "false" })
        .collect();
    let inputs: &[(&str, &[&str])] = &[
        ("o", &["1", "0.3", "nan", "0", "0.8", "1", "1"]),
        ("s", &often[1..]),
        ("r", &often),
        ("q", &["[0.1,-0.1]", "[1,2]", "[nan,0]", "[0.3,1e5]"]),
        ("qv", &["[0.05,-0.02]", "[1,-3]", "[0,0]"]),
        (
            "f",
            &["{pos:{x:0.05,y:0.02}}", "{rot:{a:1}}", "{pos:{x:nan}}"],
        ),
        ("fv", &["{vel:{x:0.1}}", "{vel:{x:-1,y:2},rot:{z:3}}", "{}"]),
    ];
    let ports = "inOverride=o.outValue,inStop=s.outValue,inReset=r.outValue";
    let joints = "inFrom=q.outValue,inFromVelocity=qv.outValue,inFromAcceleration=qv.outValue";
    let frame = "inFrom=f.outValue,inFromVelocity=fv.outValue,inFromAcceleration=fv.outValue";
    for motion in [
        format!("Ptp({ports},{joints},To='[1,2]')"),
        format!("Track(inStop=s.outValue,inReset=r.outValue,{joints},inGoal=q.outValue)"),
        format!("Lin({ports},{frame},To='{{pos:{{x:0.1}},rot:{{a:1}}}}')"),
        format!("Lin({ports},{frame},To='{{pos:{{x:0.1}},rot:{{a:1}}}}',Join='0.5')"),
        format!("Circ({ports},{frame},Via='{{pos:{{x:0.1}}}}',To='{{pos:{{y:0.1}},rot:{{a:1}}}}')"),
        format!(
            "Spline({ports},{frame},Points='[{{}},{{pos:{{x:0.1}}}},{{pos:{{y:0.1}},rot:{{a:1}}}}]')"
        ),
    ] {
        let net = format!("{controls}m=Motion::{motion}");
        assert_eq!(allocations(&net, inputs, 5000), 0, "{motion}");
    }
}

#[test]
fn tracking_allocates_nothing() {
    let net = "g=Core::DoubleArrayNetcommIn(Key='g',Value='[0,0]'),s=Core::BooleanNetcommIn(Key='s'),\
               r=Core::BooleanNetcommIn(Key='r'),\
               m=Motion::Track(inGoal=g.outValue,inStop=s.outValue,inReset=r.outValue)";
    let inputs: &[(&str, &[&str])] = &[
        (
            "g",
            &["[1,-1]", "[0.3,nan]", "[1e6,1e300]", "[-0.1,0.2]", "[0,0]"],
        ),
        (
            "s",
            &["false", "false", "false", "false", "false", "false", "true"],
        ),
        (
            "r",
            &[
                "false", "false", "false", "false", "false", "false", "false", "true",
            ],
        ),
    ];
    assert_eq!(allocations(net, inputs, 10_000), 0);
}

/// Found by a search for goals that cannot be planned for from the present state: limits of very
/// different magnitudes, and a goal nearer than the distance of one cycle.
#[test]
fn failed_plans_allocate_nothing() {
    let goals = [
        "[9.657931820174715]",
        "[0.000000005694524260855557]",
        "[-912466.2404292527]",
        "[847503.6979055653]",
        "[0.000000009894982708035042]",
        "[-0.00000003242035345692076]",
        "[1e308]",
        "[-inf]",
        "[nan]",
        "[-0.0]",
        "[5e-324]",
    ];
    for (velocity, acceleration, jerk) in [
        (
            "103495.93557002446",
            "7204.247045473444",
            "88219.6070782271",
        ),
        (
            "56201.30844236721",
            "63.836126795975346",
            "220674.4261554565",
        ),
        (
            "85810.44643993766",
            "58959.41727481623",
            "813809.9989958379",
        ),
        (
            "8966.675142661368",
            "43318.68396212631",
            "29.97982290112072",
        ),
        (
            "0.0000011035869197075916",
            "0.00018920078594933927",
            "216876.48290599213",
        ),
        (
            "0.5259005265244278",
            "20.614936481973768",
            "89492.39740718369",
        ),
        ("1e6", "1e-6", "1e6"),
        ("1e-6", "1e6", "1e-6"),
    ] {
        let net = format!(
            "g=Core::DoubleArrayNetcommIn(Key='g',Value='[0]'),s=Core::BooleanNetcommIn(Key='s'),\
             r=Core::BooleanNetcommIn(Key='r'),\
             m=Motion::Track(inGoal=g.outValue,inStop=s.outValue,inReset=r.outValue,\
             Velocity='[{velocity}]',Acceleration='[{acceleration}]',Jerk='[{jerk}]')"
        );
        let mut inputs: Vec<(&str, &[&str])> = vec![("g", &goals)];
        let seldom: Vec<_> = (0..61)
            .map(|k| if k == 60 { "true" } else { "false" })
            .collect();
        inputs.extend([("s", &seldom[2..]), ("r", &seldom[..])]);
        assert_eq!(
            allocations(&net, &inputs, 5_000),
            0,
            "{velocity} {acceleration} {jerk}"
        );
    }
}

#[test]
fn kinematics_allocate_nothing() {
    for (model, joints, frame) in [
        ("staubli_tx90", 6, "{pos:{x:0.4,z:0.6},rot:{b:2}}"),
        ("kuka_lwr4", 7, "{pos:{x:0.4,z:0.6},rot:{b:2}}"),
        ("kuka_iiwa14", 7, "{pos:{x:0.4,z:0.6},rot:{b:2}}"),
        ("kuka_youbot", 5, "{pos:{x:0.3,z:0.2},rot:{b:1.5}}"),
    ] {
        let hint = |value: &str| format!("[{}]", vec![value; joints].join(","));
        let hints = [hint("0.3"), hint("1.9"), hint("nan"), hint("-0.7")];
        let net = format!(
            "j=Core::DoubleArrayNetcommIn(Key='j',Value='{}'),f=World::FrameNetcommIn(Key='f'),\
             kin=ArmKinematics::Kin(inJoints=j.outValue,Robot='{model}'),\
             vel=ArmKinematics::VelKin(inJoints=j.outValue,inVelocities=j.outValue,Robot='{model}'),\
             inv=ArmKinematics::InvKin(inFrame=f.outValue,inHintJoints=j.outValue,Robot='{model}'),\
             back=ArmKinematics::InvKin(inFrame=kin.outFrame,inHintJoints=j.outValue,Robot='{model}')",
            hint("0")
        );
        let inputs: &[(&str, &[&str])] = &[
            ("j", &hints.each_ref().map(String::as_str)),
            ("f", &[frame, "{pos:{x:5}}", "{pos:{x:nan}}"]),
        ];
        assert_eq!(allocations(&net, inputs, 700), 0, "{model}");
    }
}

#[test]
fn lwr_kinematics_allocate_nothing() {
    let mut net = String::from("x=Core::DoubleNetcommIn(Key='x'),");
    let links = |prefix: &str| -> String {
        (1..=7)
            .map(|i| format!("{prefix}{i}=x.outValue,"))
            .collect()
    };
    net += &format!("k=KUKA::LWR::Kin({}Robot='kuka_lwr4'),", links("inJ"));
    net += &format!(
        "v=KUKA::LWR::VelKin({}{}Robot='kuka_lwr4'),",
        links("inJ"),
        links("inV")
    );
    net += "f=World::FrameNetcommIn(Key='f',Value='{pos:{x:0.4,z:0.6},rot:{b:2}}'),";
    net += &format!(
        "i=KUKA::LWR::InvKin({}inFrame=f.outValue,Robot='kuka_lwr4')",
        links("inHintJ")
    );
    let inputs: &[(&str, &[&str])] = &[("x", &["0.3", "0", "nan", "1.9", "-0.5"])];
    assert_eq!(allocations(&net, inputs, 2000), 0);
}
