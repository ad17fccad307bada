//! The results of each primitive of this crate, compared with closed forms, at limits and over
//! time. `every.rs` tests for all of them that null propagates and nothing panics.

#![allow(
    clippy::unwrap_used,
    clippy::too_many_lines,
    reason = "this file is tests and their tables"
)]

mod common;

use common::{B, Bench, D, F, I, R, T, V, check, close, null, over_time};

#[test]
fn double_arithmetic() {
    check(&[
        ("Core::DoubleAdd(First='1.5',Second='2')", D, "3.5"),
        ("Core::DoubleAdd()", D, "0"),
        ("Core::DoubleMultiply(First='-3',Second='2')", D, "-6"),
        ("Core::DoubleDivide(First='1',Second='4')", D, "0.25"),
        ("Core::DoubleDivide(First='1',Second='0')", D, "+inf"),
        ("Core::DoubleDivide(First='0',Second='0')", D, "nan"),
        ("Core::DoubleModulo(First='7',Second='3')", D, "1"),
        ("Core::DoubleModulo(First='-7',Second='3')", D, "-1"),
        ("Core::DoubleModulo()", D, "0"),
        ("Core::DoublePower(First='2',Second='-1')", D, "0.5"),
        ("Core::DoublePower(First='-1',Second='0.5')", D, "nan"),
        ("Core::DoublePower()", D, "1"),
        ("Core::DoubleSquareRoot(Value='2')", D, "1.4142135623730951"),
        ("Core::DoubleSquareRoot(Value='-1')", D, "nan"),
        ("Core::DoubleLog(Value='2.718281828459045')", D, "1"),
        ("Core::DoubleLog()", D, "-inf"),
        ("Core::DoubleSin(Value='1.5707963267948966')", D, "1"),
        ("Core::DoubleCos(Value='3.141592653589793')", D, "-1"),
        ("Core::DoubleTan(Value='0.7853981633974483')", D, "1"),
        ("Core::DoubleSin(Value='+inf')", D, "nan"),
        ("Core::DoubleAsin()", D, "1.5707963267948966"),
        ("Core::DoubleAcos(Value='-1')", D, "3.141592653589793"),
        ("Core::DoubleAsin(Value='1.1')", D, "nan"),
        ("Core::DoubleAtan2()", D, "0.7853981633974483"),
        ("Core::DoubleAtan2(Y='1',X='0')", D, "1.5707963267948966"),
        ("Core::DoubleAtan2(Y='-1',X='-1')", D, "-2.356194490192345"),
    ]);
}

#[test]
fn int_arithmetic() {
    check(&[
        ("Core::IntAdd(First='2',Second='-5')", I, "-3"),
        ("Core::IntAdd(First='2147483647',Second='1')", I, "null"),
        ("Core::IntMultiply(First='-3',Second='7')", I, "-21"),
        ("Core::IntMultiply(First='65536',Second='65536')", I, "null"),
        ("Core::IntDivide(First='-7',Second='2')", I, "-3"),
        ("Core::IntDivide(First='1',Second='0')", I, "null"),
        (
            "Core::IntDivide(First='-2147483648',Second='-1')",
            I,
            "null",
        ),
        ("Core::DoubleFromInt(Value='-2147483648')", D, "-2147483648"),
        ("Core::IntFromDouble(Value='-1.9')", I, "-1"),
        ("Core::IntFromDouble(Value='1e10')", I, "null"),
        ("Core::IntFromDouble(Value='nan')", I, "null"),
    ]);
}

#[test]
fn comparisons() {
    check(&[
        (
            "Core::DoubleEquals(First='1',Second='1.5',Epsilon='0.5')",
            B,
            "true",
        ),
        (
            "Core::DoubleEquals(First='1',Second='1.6',Epsilon='0.5')",
            B,
            "false",
        ),
        ("Core::DoubleEquals()", B, "true"),
        (
            "Core::DoubleEquals(First='nan',Second='nan',Epsilon='+inf')",
            B,
            "false",
        ),
        ("Core::DoubleGreater(First='2',Second='2')", B, "false"),
        ("Core::DoubleGreater(First='2',Second='1.9')", B, "true"),
        ("Core::DoubleGreater(First='nan',Second='0')", B, "false"),
        (
            "Core::IntEquals(First='-5',Second='5',Epsilon='10')",
            B,
            "true",
        ),
        (
            "Core::IntEquals(First='-5',Second='5',Epsilon='9')",
            B,
            "false",
        ),
        (
            "Core::IntEquals(First='-2147483648',Second='2147483647',Epsilon='2147483647')",
            B,
            "false",
        ),
        ("Core::IntEquals(Epsilon='-1')", B, "false"),
        ("Core::IntGreater(First='3',Second='2')", B, "true"),
    ]);
}

#[test]
fn logic_has_three_values() {
    let unknown = null("Core::Boolean");
    let value = |v: &str| match v {
        "null" => unknown.clone(),
        _ => format!("Core::BooleanValue(Value='{v}').outValue"),
    };
    for (a, b, and, or) in [
        ("true", "true", "true", "true"),
        ("true", "false", "false", "true"),
        ("false", "false", "false", "false"),
        ("null", "true", "null", "true"),
        ("null", "false", "false", "null"),
        ("null", "null", "null", "null"),
    ] {
        for (a, b) in [(a, b), (b, a)] {
            let inputs = format!("inFirst={},inSecond={}", value(a), value(b));
            check(&[
                (&format!("Core::BooleanAnd({inputs})"), B, and),
                (&format!("Core::BooleanOr({inputs})"), B, or),
            ]);
        }
    }
    check(&[
        ("Core::BooleanAnd()", B, "true"),
        ("Core::BooleanOr()", B, "false"),
        ("Core::BooleanNot()", B, "true"),
        (&format!("Core::BooleanNot(inValue={unknown})"), B, "null"),
    ]);
}

/// The generic families, for one type with two different values.
fn families(ty: &str, first: &str, second: &str, zero: &str) {
    let value = |v: &str| format!("{ty}Value(Value='{v}').outValue");
    let bool = |v: &str| format!("Core::BooleanValue(Value='{v}').outValue");
    let (a, b, n) = (value(first), value(second), null(ty));
    let out = format!("{ty} outValue");
    let conditional = |condition: &str, rest: &str| {
        format!("{ty}Conditional(inCondition={condition},inTrue={a},{rest})")
    };
    let array = format!("{ty}ArrayNetcommIn(Key='k',Value='[{first},{second},{first}]').outValue");
    let set = format!("{ty}ArraySet(inArray={array},inValue={b},Size='3',Index='2').outArray");
    let get = |array: &str, size: usize, index: usize| {
        format!("{ty}ArrayGet(inArray={array},Size='{size}',Index='{index}')")
    };
    let null_array = format!(
        "{ty}ArraySetNull(inValue={array},inNull={},Size='3').outValue",
        bool("true")
    );
    check(&[
        (&format!("{ty}Value(Value='{first}')"), &out, first),
        (&format!("{ty}Value()"), &out, zero),
        (&format!("{ty}IsNull(inValue={a})"), B, "false"),
        (&format!("{ty}IsNull(inValue={n})"), B, "true"),
        (
            &format!("{ty}SetNull(inValue={a},inNull={})", bool("false")),
            &out,
            first,
        ),
        (
            &format!("{ty}SetNull(inValue={a},inNull={})", bool("true")),
            &out,
            "null",
        ),
        (
            &conditional(&bool("true"), &format!("inFalse={n}")),
            &out,
            first,
        ),
        (
            &conditional(&bool("false"), &format!("inFalse={b}")),
            &out,
            second,
        ),
        (
            &conditional(&bool("false"), &format!("False='{second}'")),
            &out,
            second,
        ),
        (
            &conditional(&bool("false"), &format!("inFalse={n}")),
            &out,
            "null",
        ),
        (
            &conditional(&null("Core::Boolean"), &format!("inFalse={b}")),
            &out,
            "null",
        ),
        (&get(&array, 3, 1), &out, second),
        (&get(&set, 3, 1), &out, second),
        (&get(&set, 3, 2), &out, second),
        (&get(&set, 3, 0), &out, first),
        (
            &get(
                &format!("{ty}ArraySlice(inArray={array},Start='1',Size='2').outArray"),
                2,
                0,
            ),
            &out,
            second,
        ),
        (
            &get(&format!("{ty}Array(Size='2').outArray"), 2, 1),
            &out,
            zero,
        ),
        (&get(&null_array, 3, 0), &out, "null"),
        (&format!("{ty}ArrayIsNull(inValue={null_array})"), B, "true"),
        (&format!("{ty}ArrayIsNull(inValue={array})"), B, "false"),
        (
            &format!("{ty}NetcommIn(Key='q',Value='{second}')"),
            &out,
            second,
        ),
        (&format!("{ty}AtTime(inValue={a})"), &out, first),
    ]);
    // An array that is published is read back unchanged, also from the parameter.
    for source in [
        format!("inValue={array}"),
        format!("Value='[{first},{second},{first}]'"),
    ] {
        let mut net = Bench::new(&format!(
            "{{o={ty}ArrayNetcommOut({source},Key='v'),c=Cancel(),outTerminate=c.outCancel}}"
        ));
        net.cycle();
        let expected = format!("[{first},{second},{first}]");
        assert!(close(&net.out("v"), &expected), "{}", net.out("v"));
    }
}

#[test]
fn generic_families_exist_for_every_type() {
    families("Core::Boolean", "true", "false", "false");
    families("Core::Int", "7", "-8", "0");
    families("Core::Double", "0.1", "1e300", "0");
    families(
        "World::Vector",
        "{x:1,y:2,z:3}",
        "{x:-4,y:5,z:0.5}",
        "{x:0,y:0,z:0}",
    );
    families(
        "World::Rotation",
        "{a:1,b:0.5,c:-0.25}",
        "{a:-2,b:0,c:3}",
        "{a:0,b:0,c:0}",
    );
    families(
        "World::Frame",
        "{pos:{x:1,y:2,z:3},rot:{a:1,b:0.5,c:-0.25}}",
        "{pos:{x:0,y:0,z:9},rot:{a:0,b:0,c:1}}",
        "{pos:{x:0,y:0,z:0},rot:{a:0,b:0,c:0}}",
    );
    families(
        "World::Twist",
        "{vel:{x:1,y:2,z:3},rot:{x:4,y:5,z:6}}",
        "{vel:{x:-1,y:0,z:0},rot:{x:0,y:0,z:0}}",
        "{vel:{x:0,y:0,z:0},rot:{x:0,y:0,z:0}}",
    );
    families(
        "World::Wrench",
        "{force:{x:1,y:2,z:3},torque:{x:4,y:5,z:6}}",
        "{force:{x:-1,y:0,z:0},torque:{x:0,y:0,z:0}}",
        "{force:{x:0,y:0,z:0},torque:{x:0,y:0,z:0}}",
    );
}

#[test]
fn array_is_exported_when_an_element_changes() {
    let mut net = Bench::new(
        "{i=Core::IntArrayNetcommIn(Key='i',Value='[1,2]'),c=Cancel(),\
         o=Core::IntArrayNetcommOut(inValue=i.outValue,Key='o'),outTerminate=c.outCancel}",
    );
    let mut changes = |value: &str| {
        net.write("i", value);
        net.cycle();
        net.plan.take_changed()
    };
    let values = ["[1,2]", "[1,2]", "[1,3]", "[1,3]", "[4,3]"];
    assert_eq!(values.map(&mut changes), [true, false, true, false, true]);
    let entry = net.plan.inbox().find("ini").unwrap();
    let mut words: Vec<u64> = net.plan.inbox_words().collect();
    let error = entry.write("[1,2,3]", &mut words).unwrap_err();
    assert_eq!(error.message, "has 3 elements; at most 2 are allowed");
}

#[test]
fn snapshot_holds_copied_value() {
    let snapshot = "Core::DoubleSnapshot(inValue=x.outValue,inSnapshot=s.outValue,\
                    inReset=r.outValue,inActive=a.outValue,Value='42')";
    over_time(
        "Core::Double",
        snapshot,
        D,
        &[
            ("1", "", "42"),
            ("2", "s", "2"),
            ("3", "", "2"),
            ("3", "-a", "null"),
            ("4", "", "2"),
            ("null", "s", "null"),
            ("5", "", "null"),
            ("6", "s", "6"),
            ("7", "r", "42"),
            ("8", "rs", "8"),
        ],
    );
}

#[test]
fn pre_outputs_previous_cycle() {
    let pre = "Core::IntPre(inValue=x.outValue,inReset=r.outValue,inActive=a.outValue)";
    over_time(
        "Core::Int",
        pre,
        I,
        &[
            ("1", "", "null"),
            ("2", "", "1"),
            ("3", "r", "2"),
            ("4", "", "null"),
            ("null", "", "4"),
            ("5", "", "null"),
            ("6", "-a", "null"),
            ("7", "", "null"),
            ("8", "", "7"),
        ],
    );
}

#[test]
fn trigger_latches_once() {
    let trigger = "Core::Trigger(inOn=x.outValue,inOff=s.outValue,inReset=r.outValue)";
    over_time(
        "Core::Boolean",
        trigger,
        "Core::Boolean outActive",
        &[
            ("false", "s", "false"),
            ("true", "", "true"),
            ("false", "", "true"),
            ("null", "", "null"),
            ("false", "", "true"),
            ("false", "s", "false"),
            ("true", "", "false"),
            ("true", "r", "true"),
            ("true", "rs", "false"),
            ("true", "", "false"),
        ],
    );
}

#[test]
fn edges_are_true_for_one_cycle() {
    let edge = |direction: &str| {
        format!(
            "Core::EdgeDetection(inValue=x.outValue,inReset=r.outValue,inActive=a.outValue,\
             Direction='{direction}')"
        )
    };
    over_time(
        "Core::Boolean",
        &edge("true"),
        B,
        &[
            ("true", "", "true"),
            ("true", "", "false"),
            ("false", "", "false"),
            ("null", "", "null"),
            ("true", "", "true"),
            ("true", "r", "true"),
            ("false", "", "false"),
            ("true", "-a", "null"),
            ("true", "", "true"),
        ],
    );
    let rows = [
        ("false", "", "true"),
        ("true", "", "false"),
        ("false", "", "true"),
    ];
    over_time("Core::Boolean", &edge("false"), B, &rows);
}

#[test]
fn boolean_windows() {
    let last = "Core::BooleanLastN(inValue=x.outValue,inReset=r.outValue,Count='2')";
    let rows: [(&str, &str, [&str; 3]); 7] = [
        ("true", "", ["1", "false", "false"]),
        ("true", "", ["2", "true", "false"]),
        ("null", "", ["null", "null", "null"]),
        ("false", "", ["1", "false", "false"]),
        ("false", "", ["0", "false", "true"]),
        ("true", "", ["1", "false", "false"]),
        ("true", "r", ["1", "false", "false"]),
    ];
    let outs = [
        "Core::Int outCount",
        "Core::Boolean outAll",
        "Core::Boolean outNone",
    ];
    for (i, out) in outs.into_iter().enumerate() {
        let rows = rows.map(|(x, set, outs)| (x, set, outs[i]));
        over_time("Core::Boolean", last, out, &rows);
    }
    let history = "Core::BooleanHistory(inValue=x.outValue,Duration='0.004')";
    let rows = [
        ("true", "", "0.25"),
        ("false", "", "0.25"),
        ("true", "", "0.5"),
    ];
    over_time("Core::Boolean", history, "Core::Double outAmount", &rows);
}

#[test]
fn averages() {
    let average = "Core::DoubleAverage(inValue=x.outValue,inReset=r.outValue,Duration='0.002')";
    over_time(
        "Core::Double",
        average,
        D,
        &[
            ("1", "", "1"),
            ("2", "", "1.5"),
            ("4", "", "3"),
            ("null", "", "null"),
            ("6", "", "5"),
            ("nan", "", "null"),
            ("1", "", "null"),
            ("2", "", "1.5"),
            ("7", "r", "7"),
        ],
    );
    let average = "World::VectorAverage(inValue=x.outValue,Duration='1')";
    let rows = [
        ("{x:1}", "", "{x:1,y:0,z:0}"),
        ("{x:3,z:1}", "", "{x:2,y:0,z:0.5}"),
    ];
    over_time("World::Vector", average, V, &rows);
    let average = "World::RotationAverage(inValue=x.outValue,inReset=r.outValue)";
    let rows = [
        ("{a:3}", "", "{a:3,b:0,c:0}"),
        ("{a:-3}", "", "{a:3.141592653589793,b:0,c:0}"),
        ("{a:1}", "r", "{a:1,b:0,c:0}"),
    ];
    over_time("World::Rotation", average, R, &rows);
}

#[test]
fn long_average_does_not_drift() {
    let average = "Core::DoubleAverage(inValue=x.outValue,Duration='0.01')";
    let children = format!("x=Core::DoubleNetcommIn(Key='x'),p={average}");
    let mut net = Bench::watching("Core::Double", &children, "p.outValue");
    net.write("x", "1e16");
    net.series(3);
    net.write("x", "0.1");
    assert!(close(&net.series(25)[24], "0.1"));
}

#[test]
fn at_time_returns_past_values() {
    let at = "Core::IntAtTime(inValue=x.outValue,Age='0.002',MaxAge='0.003')";
    let rows = [
        ("1", "", "null"),
        ("2", "", "null"),
        ("3", "", "1"),
        ("null", "", "2"),
        ("5", "", "3"),
        ("6", "", "null"),
        ("7", "", "5"),
    ];
    over_time("Core::Int", at, I, &rows);
    for (age, expected) in [
        ("0", "4"),
        ("0.0014", "3"),
        ("0.003", "1"),
        ("0.004", "null"),
        ("-0.001", "null"),
        ("nan", "null"),
    ] {
        let at = format!("Core::IntAtTime(inValue=x.outValue,Age='{age}',MaxAge='0.003')");
        let mut net = Bench::watching(
            "Core::Int",
            &format!("x=Core::IntNetcommIn(Key='x'),p={at}"),
            "p.outValue",
        );
        let mut last = String::new();
        for x in 1..=4 {
            net.write("x", &x.to_string());
            last = net.series(1).remove(0);
        }
        assert_eq!(last, expected, "age {age}");
    }
}

#[test]
fn time_history_finds_stamps() {
    // Stamps lag: TimeNet of the previous cycle. Searched for: the time `x` seconds ago.
    let history = "Core::TimeHistory(inValue=Core::TimeNet().outValue,MaxAge='0.005',\
                   inReset=r.outValue,inTime=Core::TimeAdd(inTime=Core::TimeNet().outValue,\
                   inDelta=x.outValue).outValue)";
    over_time(
        "Core::Double",
        history,
        "Core::Double outAge",
        &[
            ("-0.001", "", "null"),
            ("-0.001", "", "0.001"),
            ("-0.0015", "", "0.002"),
            ("0", "", "0"),
            ("5", "", "0"),
            ("-0.005", "", "0.005"),
            ("-0.006", "", "null"),
            ("null", "", "null"),
            ("-0.001", "r", "null"),
        ],
    );
}

#[test]
fn consistent_ranges_are_matched() {
    let time = |name: &str, key: &str| {
        format!("{name}=Core::TimeAdd(inTime=t.outValue,inDelta={key}.outValue)")
    };
    // All times count from the net's start.
    let times = [("a", "fs"), ("d", "fe"), ("e", "ss"), ("g", "se")].map(|(n, k)| time(n, k));
    let mut net = Bench::new(&format!(
        "{{k=Core::Clock(),b=Core::DoubleMultiply(inFirst=k.outValue,Second='-1'),\
         t=Core::TimeAdd(inTime=Core::TimeNet().outValue,inDelta=b.outValue),\
         fs=Core::DoubleNetcommIn(Key='fs'),fe=Core::DoubleNetcommIn(Key='fe'),\
         ss=Core::DoubleNetcommIn(Key='ss'),se=Core::DoubleNetcommIn(Key='se'),{},\
         p=Core::TimeConsistentRange(inFirstStart=a.outValue,inFirstEnd=d.outValue,\
         inSecondStart=e.outValue,inSecondEnd=g.outValue,MaxSize='3',MaxAge='0.003'),\
         u=Core::TimeDiff(inFirst=p.outStart,inSecond=t.outValue),\
         w=Core::TimeDiff(inFirst=p.outEnd,inSecond=t.outValue),\
         o=Core::DoubleNetcommOut(inValue=u.outValue,Key='start'),\
         q=Core::DoubleNetcommOut(inValue=w.outValue,Key='end'),\
         c=Cancel(),outTerminate=c.outCancel}}",
        times.join(",")
    ));
    // A row: the first source's range, the second's, and the expected pair.
    for (row, (first, second, found)) in [
        (("10", "11"), ("1", "2"), ("null", "null")),
        // The second source is late: 9..10 fits 10..11 of the row before.
        (("20", "21"), ("9", "10"), ("9", "11")),
        (("30", "31"), ("19", "20"), ("19", "21")),
        (("40", "41"), ("39", "42"), ("39", "42")),
        // No pair matches any more, until the last one is forgotten.
        (("50", "51"), ("60", "61"), ("39", "42")),
        (("70", "79"), ("90", "91"), ("39", "42")),
        (("100", "101"), ("110", "111"), ("null", "null")),
    ]
    .into_iter()
    .enumerate()
    {
        for (key, text) in [
            ("fs", first.0),
            ("fe", first.1),
            ("ss", second.0),
            ("se", second.1),
        ] {
            net.write(key, text);
        }
        net.cycle();
        let out = (net.out("start"), net.out("end"));
        assert!(
            close(&out.0, found.0) && close(&out.1, found.1),
            "row {row}: {out:?}"
        );
    }
}

#[test]
fn times() {
    let now = "Core::TimeNet().outValue";
    let later =
        format!("Core::TimeAdd(inTime={now},inDelta=Core::DoubleValue(Value='2.5').outValue)");
    check(&[
        (
            &format!("Core::TimeDiff(inFirst={later}.outValue,inSecond={now})"),
            D,
            "2.5",
        ),
        (
            &format!("Core::TimeDiff(inFirst={now},inSecond=Core::TimeWall().outValue)"),
            D,
            "0",
        ),
        ("Core::CycleTime()", D, "0.001"),
        ("Core::Clock(Increment='2')", D, "0.002"),
    ]);
    let clock = "Core::Clock(inIncrement=x.outValue,inReset=r.outValue,inActive=a.outValue)";
    let rows = [
        ("1", "", "0.001"),
        ("2", "", "0.003"),
        ("null", "", "null"),
        ("nan", "", "null"),
        ("1", "-a", "null"),
        ("1", "", "0.004"),
        ("1", "r", "0.001"),
    ];
    over_time("Core::Double", clock, D, &rows);
}

#[test]
fn numbers_as_bits() {
    let bits = |coder: &str, value: i32, parameters: &str| {
        format!("{coder}(inValue=Core::IntValue(Value='{value}').outValue,{parameters})")
    };
    let read = |decoder: &str, bits: &str, parameters: &str| {
        let array = format!("Core::BooleanArrayNetcommIn(Key='k',Value='{bits}').outValue");
        format!("{decoder}(inArray={array},{parameters})")
    };
    let overflow = "Core::Boolean overflowBit";
    let array = "Core::BooleanArray outArray";
    let (t, f) = ("true", "false");
    check(&[
        (
            &bits("Core::DecToBin", 6, "amountBits='4'"),
            array,
            &format!("[{f},{t},{t},{f}]"),
        ),
        (&bits("Core::DecToBin", 16, "amountBits='4'"), overflow, t),
        (
            &bits("Core::DecToBin", -1, "amountBits='2',signBit='true'"),
            array,
            "[true,true]",
        ),
        (
            &bits("Core::DecToBin", -3, "amountBits='2',signBit='true'"),
            overflow,
            t,
        ),
        (
            &bits("Core::DecToBCD", -12, "amountBits='9'"),
            array,
            &format!("[{f},{t},{f},{f},{t},{f},{f},{f},{t}]"),
        ),
        (&bits("Core::DecToBCD", 12, "amountBits='9'"), overflow, f),
        (
            &read("Core::BinToDec", "[true,true,false]", "amountBits='3'"),
            I,
            "3",
        ),
        (
            &read(
                "Core::BinToDec",
                "[true,true]",
                "amountBits='2',signBit='true'",
            ),
            I,
            "-1",
        ),
        (
            &read(
                "Core::BCDToDec",
                "[true,false,false,false,true,true]",
                "amountBits='6'",
            ),
            I,
            "-11",
        ),
        (
            &read(
                "Core::BCDToDec",
                "[false,true,false,true,true]",
                "amountBits='5'",
            ),
            I,
            "null",
        ),
    ]);
}

#[test]
fn vectors() {
    let v = |v: &str| format!("World::VectorValue(Value='{v}').outValue");
    let two = |name: &str, a: &str, b: &str| format!("{name}(inFirst={},inSecond={})", v(a), v(b));
    let (a, b) = ("{x:1,y:2,z:3}", "{x:-4,y:5,z:6}");
    let turn = "World::RotationFromABC(A='1.5707963267948966').outValue";
    check(&[
        ("World::VectorFromXYZ(X='1',Y='2',Z='3')", V, a),
        (
            &format!("World::VectorToXYZ(inValue={})", v(a)),
            "Core::Double outY",
            "2",
        ),
        (&two("World::VectorAdd", a, b), V, "{x:-3,y:7,z:9}"),
        (&two("World::VectorDot", a, b), D, "24"),
        (&two("World::VectorCross", a, b), V, "{x:-3,y:-18,z:13}"),
        (
            &format!("World::VectorScale(inValue={},Factor='-2')", v(a)),
            V,
            "{x:-2,y:-4,z:-6}",
        ),
        (&format!("World::VectorScale(inValue={})", v(a)), V, a),
        (
            &format!("World::VectorRotate(inValue={},inRot={turn})", v(a)),
            V,
            "{x:-2,y:1,z:3}",
        ),
    ]);
}

#[test]
fn rotations() {
    let r = |v: &str| format!("World::RotationValue(Value='{v}').outValue");
    let axis = |v: &str| format!("World::VectorValue(Value='{v}').outValue");
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let quarter = "1.5707963267948966";
    check(&[
        (
            "World::RotationFromABC(A='0.1',B='0.2',C='0.3')",
            R,
            "{a:0.1,b:0.2,c:0.3}",
        ),
        (
            &format!("World::RotationToABC(inValue={})", r("{a:0.1,b:0.2,c:0.3}")),
            "Core::Double outC",
            "0.3",
        ),
        (
            &format!("World::RotationFromAxisAngle(Angle='{quarter}')"),
            R,
            "{a:0,b:0,c:1.5707963267948966}",
        ),
        (
            &format!(
                "World::RotationFromAxisAngle(Angle='1',inAxis={})",
                axis("{z:5}")
            ),
            R,
            "{a:1,b:0,c:0}",
        ),
        (
            &format!(
                "World::RotationFromAxisAngle(Angle='1',inAxis={})",
                axis("{}")
            ),
            R,
            "null",
        ),
        (
            &format!("World::RotationToAxisAngle(inValue={})", r("{b:-1}")),
            "World::Vector outAxis",
            "{x:0,y:-1,z:0}",
        ),
        (
            &format!("World::RotationToAxisAngle(inValue={})", r("{a:-3}")),
            "Core::Double outAngle",
            "3",
        ),
        (
            &format!("World::RotationToAxisAngle(inValue={})", r("{}")),
            "World::Vector outAxis",
            "{x:1,y:0,z:0}",
        ),
        (
            &format!("World::RotationFromQuaternion(X='0',Z='{half}',W='{half}')"),
            R,
            "{a:1.5707963267948966,b:0,c:0}",
        ),
        ("World::RotationFromQuaternion(X='0')", R, "null"),
        (
            "World::RotationFromQuaternion()",
            R,
            "{a:0,b:0,c:3.141592653589793}",
        ),
        (
            &format!(
                "World::RotationToQuaternion(inValue={})",
                r(&format!("{{a:{quarter}}}"))
            ),
            "Core::Double outZ",
            &half.to_string(),
        ),
        (
            &format!("World::RotationInvert(inValue={})", r("{a:1}")),
            R,
            "{a:-1,b:0,c:0}",
        ),
        // First about Z, then about the turned X: the Euler angles of both.
        (
            &format!(
                "World::RotationTransform(inFirst={},inSecond={})",
                r("{a:1}"),
                r("{c:0.5}")
            ),
            R,
            "{a:1,b:0,c:0.5}",
        ),
    ]);
}

#[test]
fn frames() {
    let f = |v: &str| format!("World::FrameValue(Value='{v}').outValue");
    let turned = "{pos:{x:1},rot:{a:1.5707963267948966}}";
    let ahead = "{pos:{x:2}}";
    check(&[
        (
            "World::FrameFromPosRot(X='1',C='0.5')",
            F,
            "{pos:{x:1,y:0,z:0},rot:{a:0,b:0,c:0.5}}",
        ),
        (
            "World::FrameFromPosRot(inPos=World::VectorFromXYZ(Y='4').outValue,X='1',A='0.5')",
            F,
            "{pos:{x:0,y:4,z:0},rot:{a:0.5,b:0,c:0}}",
        ),
        (
            "World::FrameFromXYZ(inX=Core::DoubleValue(Value='3').outValue,X='1',B='0.5')",
            F,
            "{pos:{x:3,y:0,z:0},rot:{a:0,b:0.5,c:0}}",
        ),
        (
            &format!("World::FrameToPosRot(inValue={})", f(turned)),
            "World::Vector outPosition",
            "{x:1,y:0,z:0}",
        ),
        (
            &format!("World::FrameToXYZ(inValue={})", f(ahead)),
            "Core::Double outX",
            "2",
        ),
        (
            &format!(
                "World::FrameTransform(inFirst={},inSecond={})",
                f(turned),
                f(ahead)
            ),
            F,
            "{pos:{x:1,y:2,z:0},rot:{a:1.5707963267948966,b:0,c:0}}",
        ),
        (
            &format!("World::FrameInvert(inValue={})", f(turned)),
            F,
            "{pos:{x:0,y:1,z:0},rot:{a:-1.5707963267948966,b:0,c:0}}",
        ),
        // One cycle is 1 ms; the twist is along the axes of the reference, not of the frame.
        (
            &format!(
                "World::FrameAddTwist(inFrame={},inTwist=World::TwistFromXYZ(X='1000',A='1000').outValue)",
                f(turned)
            ),
            F,
            "{pos:{x:2,y:0,z:0},rot:{a:2.5707963267948966,b:0,c:0}}",
        ),
    ]);
}

#[test]
fn twists_and_wrenches() {
    let t = |v: &str| format!("World::TwistValue(Value='{v}').outValue");
    let six = "X='1',Y='2',Z='3',A='4',B='5',C='6'";
    let turn = "World::RotationFromABC(A='1.5707963267948966').outValue";
    let frame = |x: &str, a: &str| format!("World::FrameFromPosRot(X='{x}',A='{a}').outValue");
    let spin = "{rot:{z:2}}";
    check(&[
        (
            &format!("World::TwistFromXYZ({six})"),
            T,
            "{vel:{x:1,y:2,z:3},rot:{x:6,y:5,z:4}}",
        ),
        (
            &format!("World::TwistToXYZ(inValue={})", t(spin)),
            "Core::Double outA",
            "2",
        ),
        (
            &format!("World::WrenchFromXYZ({six})"),
            "World::Wrench outValue",
            "{force:{x:1,y:2,z:3},torque:{x:6,y:5,z:4}}",
        ),
        (
            &format!("World::WrenchToXYZ(inValue=World::WrenchFromXYZ({six}).outValue)"),
            "Core::Double outC",
            "6",
        ),
        (
            "World::TwistFromVelocities(X='1',RZ='2')",
            T,
            "{vel:{x:1,y:0,z:0},rot:{x:0,y:0,z:2}}",
        ),
        (
            &format!("World::TwistToVelocities(inValue={})", t(spin)),
            "World::Vector outRotVel",
            "{x:0,y:0,z:2}",
        ),
        (
            &format!(
                "World::TwistAdd(inFirst={},inSecond={})",
                t(spin),
                t("{vel:{x:1},rot:{z:1}}")
            ),
            T,
            "{vel:{x:1,y:0,z:0},rot:{x:0,y:0,z:3}}",
        ),
        (
            &format!(
                "World::TwistRotate(inValue={},inRot={turn})",
                t("{vel:{x:1},rot:{y:2}}")
            ),
            T,
            "{vel:{x:0,y:1,z:0},rot:{x:-2,y:0,z:0}}",
        ),
        (
            &format!(
                "World::TwistChangeCenter(inValue={},inVector=World::VectorFromXYZ(X='3').outValue)",
                t(spin)
            ),
            T,
            "{vel:{x:0,y:6,z:0},rot:{x:0,y:0,z:2}}",
        ),
        // From 3 to -3 rad the short rotation passes π.
        (
            &format!(
                "World::TwistFromFrames(inFrame={},inPrevFrame={})",
                frame("0.002", "-3"),
                frame("0.001", "3")
            ),
            T,
            "{vel:{x:1,y:0,z:0},rot:{x:0,y:0,z:283.18530717958623}}",
        ),
    ]);
}
