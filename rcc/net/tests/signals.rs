//! Primitives that shape signals (signs, bounds, filters, controllers, generators) compared with closed
//! forms and over random inputs. `every.rs` tests for all of them that nothing panics or allocates.

#![allow(clippy::unwrap_used, reason = "this file is tests and their tables")]

mod common;

use std::time::Duration;

use common::{B, Bench, D, F, I, R, T, V, check, over_time};
use proptest::prelude::*;

/// A primitive whose `inValue` programs write as `x`, and its out values.
struct Driven(Bench);

impl Driven {
    fn at(primitive: &str, period: Duration) -> Self {
        Self(Bench::at(
            &format!(
                "{{x=Core::DoubleNetcommIn(Key='x'),p={primitive},\
                 o=Core::DoubleNetcommOut(inValue=p.outValue,Key='v'),\
                 c=Cancel(),outTerminate=c.outCancel}}"
            ),
            period,
        ))
    }

    fn new(primitive: &str) -> Self {
        Self::at(primitive, common::PERIOD)
    }

    fn text(&mut self, x: &str) -> String {
        self.0.write("x", x);
        self.0.cycle();
        self.0.out("v")
    }

    fn value(&mut self, x: f64) -> f64 {
        self.text(&written(x)).parse().unwrap()
    }
}

/// The text of a number, as programs write it.
fn written(x: f64) -> String {
    format!("{x:e}").to_lowercase()
}

#[test]
fn signs_and_extremes_match_table() {
    check(&[
        ("Core::DoubleSubtract(First='1.5',Second='2')", D, "-0.5"),
        ("Core::DoubleNegate(Value='1.5')", D, "-1.5"),
        ("Core::DoubleAbs(Value='-inf')", D, "+inf"),
        ("Core::DoubleSign(Value='-3')", D, "-1"),
        ("Core::DoubleSign(Value='-0')", D, "0"),
        ("Core::DoubleSign(Value='nan')", D, "nan"),
        ("Core::DoubleMin(First='2',Second='-1')", D, "-1"),
        ("Core::DoubleMin(First='2',Second='nan')", D, "nan"),
        ("Core::DoubleMin(First='nan',Second='2')", D, "nan"),
        ("Core::DoubleMax(First='2',Second='-1')", D, "2"),
        ("Core::DoubleMax(First='nan',Second='+inf')", D, "nan"),
        ("Core::DoubleMax(First='-inf',Second='-1')", D, "-1"),
        ("Core::IntSubtract(First='2',Second='5')", I, "-3"),
        (
            "Core::IntSubtract(First='-2147483648',Second='1')",
            I,
            "null",
        ),
        ("Core::IntNegate(Value='7')", I, "-7"),
        ("Core::IntNegate(Value='-2147483648')", I, "null"),
        ("Core::IntAbs(Value='-7')", I, "7"),
        ("Core::IntAbs(Value='-2147483648')", I, "null"),
        ("Core::IntSign(Value='-7')", I, "-1"),
        ("Core::IntMin(First='3',Second='-4')", I, "-4"),
        ("Core::IntMax(First='3',Second='-4')", I, "3"),
    ]);
}

#[test]
fn parameters_with_units_are_converted_to_si() {
    check(&[
        ("Core::DoubleValue(Value='180deg')", D, "3.141592653589793"),
        ("Core::DoubleAdd(First='5mm',Second='0.002 m')", D, "0.007"),
        ("Core::DoubleSin(Value='90deg')", D, "1"),
        (
            "World::FrameValue(Value='{pos:{z:5mm},rot:{a:30deg}}')",
            F,
            "{pos:{x:0,y:0,z:0.005},rot:{a:0.5235987755982988,b:0,c:0}}",
        ),
        (
            "World::TwistValue(Value='{vel:{x:50mm/s},rot:{z:-180deg/s}}')",
            T,
            "{vel:{x:0.05,y:0,z:0},rot:{x:0,y:0,z:-3.141592653589793}}",
        ),
        (
            "World::VectorValue(Value='{x:1cm,y:2}')",
            V,
            "{x:0.01,y:2,z:0}",
        ),
        (
            "World::WrenchValue(Value='{force:{x:2kN/m}}')",
            "World::Wrench outValue",
            "{force:{x:2000,y:0,z:0},torque:{x:0,y:0,z:0}}",
        ),
        ("Core::DoubleNetcommIn(Value='250ms',Key='k')", D, "0.25"),
        (
            "Core::DoubleArrayGet(inArray=Core::DoubleArrayNetcommIn(Key='k',Value='[1,90deg]').outValue,Size='2',Index='1')",
            D,
            "1.5707963267948966",
        ),
    ]);
}

#[test]
fn value_of_program_with_unit_is_rejected() {
    let net = Bench::new("{i=Core::DoubleNetcommIn(Key='i'),c=Cancel(),outTerminate=c.outCancel}");
    let mut words: Vec<u64> = net.plan.inbox_words().collect();
    let entry = net.plan.inbox().find("ini").unwrap();
    assert!(entry.write("5mm", &mut words).is_err());
}

#[test]
fn orders_match_table_and_reject_nan() {
    for (first, second, less, less_equal, greater_equal) in [
        ("1", "2", "true", "true", "false"),
        ("2", "2", "false", "true", "true"),
        ("3", "2", "false", "false", "true"),
    ] {
        for ty in ["Core::Double", "Core::Int"] {
            let of = |name: &str| format!("{ty}{name}(First='{first}',Second='{second}')");
            check(&[
                (&of("Less"), B, less),
                (&of("LessEqual"), B, less_equal),
                (&of("GreaterEqual"), B, greater_equal),
            ]);
        }
    }
    for name in ["Less", "LessEqual", "GreaterEqual"] {
        check(&[(
            &format!("Core::Double{name}(First='nan',Second='nan')"),
            B,
            "false",
        )]);
    }
}

#[test]
fn clamps_and_dead_bands_match_table() {
    let double = |v: &str| format!("inValue=Core::DoubleValue(Value='{v}').outValue");
    let int = |v: &str| format!("inValue=Core::IntValue(Value='{v}').outValue");
    let vector = |v: &str| format!("inValue=World::VectorValue(Value='{v}').outValue");
    let clamp = |v: &str, rest: &str| format!("Core::DoubleClamp({}{rest})", double(v));
    let band = |v: &str| format!("Core::DoubleDeadBand({},Width='0.5')", double(v));
    check(&[
        (&clamp("3", ",Min='-1',Max='2'"), D, "2"),
        (&clamp("-inf", ",Min='-1',Max='2'"), D, "-1"),
        (&clamp("0.5", ",Min='-1',Max='2'"), D, "0.5"),
        (&clamp("7", ""), D, "7"),
        (&clamp("nan", ",Min='-1',Max='2'"), D, "nan"),
        (&clamp("0", ",Min='2',Max='1'"), D, "null"),
        (&clamp("0", ",Min='nan'"), D, "null"),
        (
            &format!("Core::IntClamp({},Min='1',Max='3')", int("7")),
            I,
            "3",
        ),
        (
            &format!("Core::IntClamp({},Min='3',Max='1')", int("2")),
            I,
            "null",
        ),
        (
            &format!("Core::IntClamp({})", int("-2147483648")),
            I,
            "-2147483648",
        ),
        (
            &format!("World::VectorClamp({},Max='5')", vector("{x:6,y:8}")),
            V,
            "{x:3,y:4,z:0}",
        ),
        (
            &format!("World::VectorClamp({},Max='5')", vector("{z:4}")),
            V,
            "{x:0,y:0,z:4}",
        ),
        (
            &format!("World::VectorClamp({},Max='-1')", vector("{z:4}")),
            V,
            "null",
        ),
        (&band("0.5"), D, "0"),
        (&band("-0.5"), D, "0"),
        (&band("1.75"), D, "1.25"),
        (&band("-1.75"), D, "-1.25"),
        (
            &format!("Core::DoubleDeadBand({},Width='-1')", double("1")),
            D,
            "null",
        ),
        (
            &format!("World::VectorDeadBand({},Width='5')", vector("{x:6,y:8}")),
            V,
            "{x:3,y:4,z:0}",
        ),
    ]);
}

#[test]
fn vectors_twists_wrenches_are_subtracted_and_scaled() {
    let value = |ty: &str, v: &str| format!("{ty}Value(Value='{v}').outValue");
    let two = |name: &str, ty: &str, a: &str, b: &str| {
        format!(
            "{ty}{name}(inFirst={},inSecond={})",
            value(ty, a),
            value(ty, b)
        )
    };
    let one = |name: &str, ty: &str, a: &str, rest: &str| {
        format!("{ty}{name}(inValue={}{rest})", value(ty, a))
    };
    let (v, t, w) = ("World::Vector", "World::Twist", "World::Wrench");
    let wrench = "World::Wrench outValue";
    let (force, torque) = ("{force:{x:3}}", "{torque:{y:4}}");
    check(&[
        (&two("Subtract", v, "{x:3}", "{y:2}"), V, "{x:3,y:-2,z:0}"),
        (&one("Negate", v, "{x:3}", ""), V, "{x:-3,y:0,z:0}"),
        (&one("Length", v, "{x:3,z:-4}", ""), D, "5"),
        (
            &two("Subtract", t, "{vel:{x:3}}", "{rot:{y:2}}"),
            T,
            "{vel:{x:3,y:0,z:0},rot:{x:0,y:-2,z:0}}",
        ),
        (
            &one("Negate", t, "{rot:{z:2}}", ""),
            T,
            "{vel:{x:0,y:0,z:0},rot:{x:0,y:0,z:-2}}",
        ),
        (
            &one("Scale", t, "{vel:{x:2}}", ",Factor='0.5'"),
            T,
            "{vel:{x:1,y:0,z:0},rot:{x:0,y:0,z:0}}",
        ),
        (
            &two("Add", w, force, torque),
            wrench,
            "{force:{x:3,y:0,z:0},torque:{x:0,y:4,z:0}}",
        ),
        (
            &two("Subtract", w, force, torque),
            wrench,
            "{force:{x:3,y:0,z:0},torque:{x:0,y:-4,z:0}}",
        ),
        (
            &one("Scale", w, torque, ",Factor='2'"),
            wrench,
            "{force:{x:0,y:0,z:0},torque:{x:0,y:8,z:0}}",
        ),
    ]);
}

/// Step responses agree with the analytic ones to 1e-9 whatever the period is.
#[test]
fn low_pass_steps_match_closed_form_at_any_period() {
    for period_us in [250, 1000, 7000, 100_000] {
        let period = Duration::from_micros(period_us);
        let tau = 0.02;
        let mut first = Driven::at(
            "Core::DoubleLowPass(inValue=x.outValue,TimeConstant='0.02')",
            period,
        );
        assert_eq!(first.text("1"), "1", "it starts at the first input");
        for cycle in 1..200 {
            let time = period.as_secs_f64() * f64::from(cycle);
            let expected = 3.0 - 2.0 * (-time / tau).exp();
            assert!(
                (first.value(3.0) - expected).abs() < 1e-9,
                "{period_us} {cycle}"
            );
        }
        for damping in [0.0, 0.2, 0.7, 0.999_999_999, 1.0, 1.000_000_001, 3.0, 200.0] {
            let text = format!(
                "Core::DoubleLowPass2(inValue=x.outValue,Frequency='5',Damping='{damping}')"
            );
            let mut second = Driven::at(&text, period);
            second.text("0");
            for cycle in 1..200 {
                let time = period.as_secs_f64() * f64::from(cycle);
                let expected = step_of_second_order(31.415_926_535_897_93, damping, time);
                let found = second.value(1.0);
                assert!(
                    (found - expected).abs() < 1e-9,
                    "{period_us} {damping} {cycle}: {found} {expected}"
                );
            }
        }
    }
}

/// Step response of ω²/(s²+2ζωs+ω²), by the roots of its denominator.
fn step_of_second_order(omega: f64, damping: f64, time: f64) -> f64 {
    let root = nalgebra::Complex::new(damping * damping - 1.0, 0.0).sqrt();
    let (slow, fast) = ((-root + damping) * -omega, (root + damping) * -omega);
    if (slow - fast).norm() < 1e-2 {
        // A double root, up to second order in the distance of both.
        return 1.0 - (1.0 + omega * time) * (-omega * time).exp();
    }
    let sum = (slow * (fast * time).exp() - fast * (slow * time).exp()) / (fast - slow);
    1.0 + sum.re
}

#[test]
fn geometric_low_passes_follow_position_and_turn() {
    // After one time constant the part 1 - 1/e of the step is made.
    let made = 1.0 - (-1.0_f64).exp();
    let step = |ty: &str, from: &str, to: &str| {
        let first = "Core::BooleanIsNull(inValue=Core::BooleanPre(\
                     inValue=Core::BooleanValue(Value='true').outValue).outValue).outValue";
        format!(
            "s={ty}Conditional(inCondition={first},True='{from}',False='{to}'),\
             p={ty}LowPass(inValue=s.outValue,TimeConstant='0.01')"
        )
    };
    for (ty, from, to, expected) in [
        (
            "World::Vector",
            "{x:1}",
            "{x:2}",
            format!("{{x:{},y:0,z:0}}", 1.0 + made),
        ),
        // By the shorter turn, over π.
        ("World::Rotation", "{a:3}", "{a:-3}", {
            let angle = 3.0 + made * (std::f64::consts::TAU - 6.0) - std::f64::consts::TAU;
            format!("{{a:{angle},b:0,c:0}}")
        }),
        (
            "World::Frame",
            "{}",
            "{pos:{z:2},rot:{c:0.5}}",
            format!(
                "{{pos:{{x:0,y:0,z:{}}},rot:{{a:0,b:0,c:{}}}}}",
                2.0 * made,
                0.5 * made
            ),
        ),
        (
            "World::Twist",
            "{}",
            "{rot:{y:2}}",
            format!("{{vel:{{x:0,y:0,z:0}},rot:{{x:0,y:{},z:0}}}}", 2.0 * made),
        ),
    ] {
        let mut net = Bench::watching(ty, &step(ty, from, to), "p.outValue");
        let found = net.series(11).pop().unwrap();
        assert!(
            common::close(&found, &expected),
            "{ty}: {found}, not {expected}"
        );
    }
}

#[test]
fn derivative_of_ramp_matches_closed_form() {
    for period_us in [500, 1000, 20_000] {
        let period = Duration::from_micros(period_us);
        let text = "Core::DoubleDerivative(inValue=x.outValue,TimeConstant='0.01')";
        let mut filtered = Driven::at(text, period);
        let mut plain = Driven::at(
            "Core::DoubleDerivative(inValue=x.outValue,TimeConstant='0')",
            period,
        );
        assert_eq!(
            (filtered.text("5"), plain.text("5")),
            ("0".to_owned(), "0".to_owned())
        );
        for cycle in 1..100 {
            let time = period.as_secs_f64() * f64::from(cycle);
            let expected = 3.0 * (1.0 - (-time / 0.01).exp());
            assert!(
                (filtered.value(5.0 + 3.0 * time) - expected).abs() < 1e-9,
                "{cycle}"
            );
            assert!(
                (plain.value(5.0 + 3.0 * time) - 3.0).abs() < 1e-9,
                "{cycle}"
            );
        }
    }
}

#[test]
fn derivative_starts_again_after_null() {
    over_time(
        "Core::Double",
        "Core::DoubleDerivative(inValue=x.outValue,inReset=r.outValue,TimeConstant='0')",
        D,
        &[
            ("1", "", "0"),
            ("2", "", "1000"),
            ("null", "", "null"),
            ("9", "", "0"),
            ("8", "", "-1000"),
            ("nan", "", "null"),
            ("7", "", "-1000"),
            ("5", "r", "0"),
        ],
    );
}

#[test]
fn integrator_stops_at_bound_and_leaves_at_once() {
    over_time(
        "Core::Double",
        "Core::DoubleIntegrator(inValue=x.outValue,inReset=r.outValue,inActive=a.outValue,\
         Min='-1',Max='2',Value='0.5')",
        D,
        &[
            ("1000", "", "1.5"),
            ("1000", "", "2"),
            ("1e300", "", "2"),
            ("null", "", "null"),
            ("nan", "", "null"),
            ("+inf", "", "null"),
            ("-250", "", "1.75"),
            ("-250", "-a", "null"),
            ("-5000", "", "-1"),
            ("100", "", "-0.9"),
            ("100", "r", "0.6"),
        ],
    );
    over_time(
        "World::Vector",
        "World::VectorIntegrator(inValue=x.outValue,Max='5')",
        V,
        &[
            ("{x:3000,y:4000}", "", "{x:3,y:4,z:0}"),
            ("{x:3000,y:4000}", "", "{x:3,y:4,z:0}"),
            ("{x:-1000}", "", "{x:2,y:4,z:0}"),
        ],
    );
}

#[test]
fn integrator_of_constant_is_time() {
    let mut net = Driven::at(
        "Core::DoubleIntegrator(inValue=x.outValue)",
        Duration::from_millis(4),
    );
    for cycle in 1..1000 {
        let found = net.value(1.0);
        assert!(
            (found - 0.004 * f64::from(cycle)).abs() < 1e-9,
            "{cycle}: {found}"
        );
    }
}

#[test]
fn rate_limiter_continues_where_it_stopped() {
    over_time(
        "Core::Double",
        "Core::DoubleRateLimiter(inValue=x.outValue,inReset=r.outValue,inActive=a.outValue,Rate='1000')",
        D,
        &[
            ("5", "", "5"),
            ("9", "", "6"),
            ("9", "-a", "null"),
            ("null", "", "null"),
            ("+inf", "", "null"),
            ("6.25", "", "6.25"),
            ("-9", "", "5.25"),
            ("-9", "r", "-9"),
        ],
    );
    let mut net = Driven::new("Core::DoubleRateLimiter(inValue=x.outValue,Rate='-1')");
    assert_eq!(net.text("1"), "null");
}

#[test]
fn geometric_rate_limiters_take_the_straight_way() {
    let rows = |ty: &str, rates: &str, out: &str, from: &str, to: &str, expected: &str| {
        let text = format!("{ty}RateLimiter(inValue=x.outValue,{rates})");
        over_time(
            ty,
            &text,
            out,
            &[(from, "", from), (to, "", expected), (to, "", to)],
        );
    };
    rows(
        "World::Vector",
        "Rate='5000'",
        V,
        "{x:1,y:1,z:0}",
        "{x:7,y:9,z:0}",
        "{x:4,y:5,z:0}",
    );
    // From 3 to -3 rad by the shorter turn, over π.
    rows(
        "World::Rotation",
        "Rate='200'",
        R,
        "{a:3,b:0,c:0}",
        "{a:-3,b:0,c:0}",
        "{a:-3.083185307179586,b:0,c:0}",
    );
    rows(
        "World::Frame",
        "MaxTransVel='1000',MaxRotVel='250'",
        F,
        "{pos:{x:0,y:0,z:0},rot:{a:0,b:0,c:0}}",
        "{pos:{x:2,y:0,z:0},rot:{a:0.5,b:0,c:0}}",
        "{pos:{x:1,y:0,z:0},rot:{a:0.25,b:0,c:0}}",
    );
    rows(
        "World::Twist",
        "MaxTransAcc='1000',MaxRotAcc='500'",
        T,
        "{vel:{x:0,y:0,z:0},rot:{x:0,y:0,z:0}}",
        "{vel:{x:2,y:0,z:0},rot:{x:0,y:0,z:1}}",
        "{vel:{x:1,y:0,z:0},rot:{x:0,y:0,z:0.5}}",
    );
}

#[test]
fn debounce_needs_its_whole_time() {
    over_time(
        "Core::Boolean",
        "Core::BooleanDebounce(inValue=x.outValue,inReset=r.outValue,OnTime='0.003',OffTime='0.002')",
        B,
        &[
            ("true", "", "false"),
            ("true", "", "false"),
            ("false", "", "false"),
            ("true", "", "false"),
            ("true", "", "false"),
            ("true", "", "true"),
            ("false", "", "true"),
            ("null", "", "null"),
            ("false", "", "true"),
            ("true", "", "true"),
            ("false", "", "true"),
            ("false", "", "false"),
            ("true", "", "false"),
            ("true", "r", "false"),
            ("true", "", "false"),
            ("true", "", "true"),
        ],
    );
}

#[test]
fn table_interpolates_and_keeps_end_values() {
    let mut net = Driven::new("Core::DoubleTable(inValue=x.outValue,X='[-1,0,4]',Y='[10,20,0]')");
    for (x, expected) in [
        ("-inf", "10"),
        ("-1", "10"),
        ("-0.5", "15"),
        ("0", "20"),
        ("1", "15"),
        ("4", "0"),
        ("1e308", "0"),
        ("nan", "null"),
    ] {
        assert_eq!(net.text(x), expected, "{x}");
    }
    for (points, fault) in [
        (
            "X='[0,0]',Y='[1,2]'",
            "parameter `X`: it must be a list of numbers, each greater than the one before",
        ),
        (
            "X='[]',Y='[]'",
            "parameter `X`: it must be a list of numbers, each greater than the one before",
        ),
        (
            "X='[0,1]',Y='[1]'",
            "parameter `Y`: it must be a list of 2 numbers, one for each of X",
        ),
        (
            "X='[0,1]',Y='[1,nan]'",
            "parameter `Y`: it must be a list of 2 numbers, one for each of X",
        ),
    ] {
        let net = format!(
            "{{x=Core::DoubleValue(),t=Core::DoubleTable(inValue=x.outValue,{points}),\
             c=Cancel(),outTerminate=c.outCancel}}"
        );
        let faults = common::try_load(&net).err().unwrap();
        assert!(
            faults.len() == 1 && faults[0].ends_with(fault),
            "{faults:?}"
        );
    }
}

#[test]
fn waves_match_closed_form_at_any_period() {
    for period_us in [1000, 3000, 250_000] {
        for cycle in [0, 1, 2, 7, 100, 1001] {
            let period = Duration::from_micros(period_us);
            let turn = (f64::from(cycle) * period.as_secs_f64() / 0.8 + 0.125).fract();
            // At a corner rounding decides.
            if [0.3, 0.25, 0.75, 0.0]
                .iter()
                .any(|corner| (turn - corner).abs() < 1e-9)
            {
                continue;
            }
            let triangle =
                (std::f64::consts::TAU * turn).sin().asin() / std::f64::consts::FRAC_PI_2;
            let square = if turn < 0.3 { 1.0 } else { -1.0 };
            for (name, duty, shape) in [
                ("Square", ",Duty='0.3'", square),
                ("Triangle", "", triangle),
                ("Sawtooth", "", 2.0 * turn - 1.0),
            ] {
                let text = format!(
                    "Core::{name}Wave(Period='0.8',Amplitude='2',Offset='5',Phase='0.125'{duty})"
                );
                let mut net = Driven::at(&text, period);
                for _ in 0..cycle {
                    net.0.cycle();
                }
                let found = net.value(0.0);
                assert!(
                    (found - 5.0 - 2.0 * shape).abs() < 1e-9,
                    "{name} {period_us} {cycle}: {found}"
                );
            }
        }
    }
}

#[test]
fn ramp_ends_at_its_goal_and_stays() {
    let mut net = Driven::new("Core::Ramp(From='1',To='3',Duration='0.004')");
    let found: Vec<String> = (0..6).map(|_| net.text("0")).collect();
    assert_eq!(found, ["1", "1.5", "2", "2.5", "3", "3"]);
    let mut net = Driven::new("Core::Ramp(From='1',To='3',Duration='0')");
    assert_eq!(net.text("0"), "3");
}

/// A controller of `x` with these parameters and a set-point `s` that programs write, 1 at first.
fn pid(parameters: &str) -> Driven {
    Driven::new(&format!(
        "Core::DoublePID(inSetPoint=s.outValue,inMeasured=x.outValue{parameters}),\
         s=Core::DoubleNetcommIn(Key='s',Value='1')"
    ))
}

#[test]
fn pid_parts_match_closed_forms() {
    let mut proportional = pid(",Kp='3',FeedForward='0.5'");
    assert!((proportional.value(0.75) - 1.25).abs() < 1e-12);
    let mut integral = pid(",Kp='0',Ki='20'");
    for cycle in 1..100 {
        let found = integral.value(0.5);
        assert!(
            (found - 20.0 * 0.5 * 0.001 * f64::from(cycle)).abs() < 1e-12,
            "{cycle}"
        );
    }
    let mut derivative = pid(",Kp='0',Kd='2',TimeConstant='0'");
    // Of the measurement alone: a step of the set-point gives none.
    assert_eq!(derivative.text("0"), "0");
    derivative.0.write("s", "9");
    assert_eq!(derivative.text("0"), "0");
    assert!((derivative.value(0.003) + 6.0).abs() < 1e-9);
}

#[test]
fn pid_leaves_bound_in_the_cycle_the_error_turns() {
    let mut net = pid(",Kp='0.1',Ki='100',Min='-2',Max='2'");
    for _ in 0..10_000 {
        net.value(-50.0);
    }
    assert_eq!(net.text("-50"), "2");
    let found = net.value(1.5);
    assert!(found < 2.0, "{found}");
    for _ in 0..10_000 {
        net.value(50.0);
    }
    let found = net.value(0.5);
    assert!(found > -2.0, "{found}");
}

#[test]
fn pid_without_valid_input_is_null_and_keeps_integral() {
    let mut net = pid(",Kp='0',Ki='1000'");
    assert_eq!(
        (net.text("0"), net.text("nan"), net.text("+inf")),
        ("1".into(), "null".into(), "null".into())
    );
    assert_eq!(net.text("0"), "2");
    assert_eq!(pid(",Min='1',Max='0'").text("0"), "null");
    assert_eq!(pid(",Min='+inf',Max='+inf'").text("0"), "null");
}

#[test]
fn pid_brings_first_order_plant_to_set_point() {
    let text = include_str!("nets/pid.net");
    let mut net = Bench::new(text);
    let mut last = 0.0;
    for cycle in 0..2000 {
        assert!(!net.cycle(), "it ends in cycle {cycle}");
        let temperature: f64 = net.out("temperature").parse().unwrap();
        let heating: f64 = net.out("heating").parse().unwrap();
        assert!((0.0..=1.0).contains(&heating), "{cycle}: {heating}");
        assert!(temperature < 60.5, "{cycle}: overshoot to {temperature}");
        last = temperature;
    }
    assert!((last - 60.0).abs() < 0.05, "{last}");
}

/// Any number, often a usual one.
fn number() -> impl Strategy<Value = f64> {
    prop_oneof![4 => -10.0..10.0_f64, 1 => any::<f64>()]
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(64) })]

    #[test]
    fn clamp_stays_in_range(inputs in proptest::collection::vec(number(), 1..20)) {
        let mut net = Driven::new("Core::DoubleClamp(inValue=x.outValue,Min='-1.5',Max='0.25')");
        for x in inputs.into_iter().filter(|x| !x.is_nan()) {
            let found = net.value(x);
            prop_assert!((-1.5..=0.25).contains(&found), "{x}: {found}");
        }
    }

    #[test]
    fn rate_limiter_keeps_rate_between_any_values(
        inputs in proptest::collection::vec(number(), 2..60),
        rate in 0.0..1e4_f64,
    ) {
        let text = format!("Core::DoubleRateLimiter(inValue=x.outValue,Rate='{rate}')");
        let mut net = Driven::new(&text);
        let mut last: Option<f64> = None;
        for x in inputs {
            let Ok(found) = net.text(&written(x)).parse::<f64>() else { continue };
            let change = last.map_or(0.0, |last| (found - last).abs());
            // One rounding of the sum.
            let rounding = f64::EPSILON * found.abs();
            prop_assert!(change <= rate * 0.001 * (1.0 + f64::EPSILON) + rounding, "{change} {rate}");
            last = Some(found);
        }
    }

    #[test]
    fn bounded_outputs_stay_finite_and_in_range(
        inputs in proptest::collection::vec(number(), 1..60),
    ) {
        let bounded = [
            "Core::DoubleIntegrator(inValue=x.outValue,Min='-3',Max='3')",
            "Core::DoublePID(inSetPoint=x.outValue,inMeasured=y.outValue,Kp='2',Ki='30',Kd='0.1',Min='-3',Max='3'),\
             y=Core::DoubleNegate(inValue=x.outValue)",
            "Core::DoubleTable(inValue=x.outValue,X='[-1e308,0,1e308]',Y='[-3,1,3]')",
        ];
        for text in bounded {
            let mut net = Driven::new(text);
            for x in &inputs {
                if let Ok(found) = net.text(&written(*x)).parse::<f64>() {
                    prop_assert!((-3.0..=3.0).contains(&found), "{x}: {found}");
                }
            }
        }
    }

    #[test]
    fn low_pass_stays_between_its_inputs(inputs in proptest::collection::vec(-10.0..10.0_f64, 1..60)) {
        let mut net = Driven::new("Core::DoubleLowPass(inValue=x.outValue,TimeConstant='0.005')");
        let (mut least, mut most) = (f64::INFINITY, f64::NEG_INFINITY);
        for x in inputs {
            (least, most) = (least.min(x), most.max(x));
            let found = net.value(x);
            prop_assert!((least - 1e-12..=most + 1e-12).contains(&found), "{found}");
        }
    }
}
