//! Triggers as written and as sent; what is wrong with others.

use super::*;

#[test]
fn trigger_texts_are_sent_as_meant() {
    for (text, sent) in [
        (
            "left.joint.6.commanded>0.5",
            r#"{"on":"above","probe":"left.joint.6.commanded","level":0.5}"#,
        ),
        (
            " left.force.z < -10N ",
            r#"{"on":"below","probe":"left.force.z","level":-10.0}"#,
        ),
        (
            "rising left.force.z 10",
            r#"{"on":"rising","probe":"left.force.z","level":10.0}"#,
        ),
        (
            "rising left.force.z 10N hysteresis 2N",
            r#"{"on":"rising","probe":"left.force.z","level":10.0,"hysteresis":2.0}"#,
        ),
        (
            "falling hysteresis 1 hysteresis 0",
            r#"{"on":"falling","probe":"hysteresis","level":1.0,"hysteresis":0.0}"#,
        ),
        (
            "falling thread:nets.latency 250us",
            r#"{"on":"falling","probe":"thread:nets.latency","level":0.00025}"#,
        ),
        (
            "above left.joint.0.measured 180deg",
            r#"{"on":"above","probe":"left.joint.0.measured","level":3.141592653589793}"#,
        ),
        (
            "outside left.base.x -1mm 1mm",
            r#"{"on":"outside","probe":"left.base.x","low":-0.001,"high":0.001}"#,
        ),
        (
            "inside a.b 1e-3 2",
            r#"{"on":"inside","probe":"a.b","low":0.001,"high":2.0}"#,
        ),
        ("fault left", r#"{"on":"fault","probe":"left"}"#),
        ("event left", r#"{"on":"event","probe":"left"}"#),
        (
            "event machine:cell",
            r#"{"on":"event","probe":"machine:cell"}"#,
        ),
        ("overrun nets", r#"{"on":"overrun","probe":"nets"}"#),
        ("overrun", r#"{"on":"overrun"}"#),
        (
            "net:swing=RUNNING",
            r#"{"on":"state","probe":"net:swing.state","equals":"RUNNING"}"#,
        ),
        (
            "\"net:swing left\" = RUNNING",
            r#"{"on":"state","probe":"net:swing left.state","equals":"RUNNING"}"#,
        ),
        (
            "state left.status op",
            r#"{"on":"state","probe":"left.status","equals":"op"}"#,
        ),
        (
            "machine:station=\"Move = Robot\"",
            r#"{"on":"state","probe":"machine:station.state","equals":"Move = Robot"}"#,
        ),
    ] {
        let trigger = parse(text).unwrap_or_else(|why| panic!("{text}: {why}"));
        assert_eq!(serde_json::to_string(&trigger).unwrap(), sent, "{text}");
    }
}

#[test]
fn trigger_errors_name_place_cause_and_hint() {
    for (text, expected) in [
        (
            "",
            "column 1: a trigger is expected\nhint: write a condition such as `left",
        ),
        (
            "> 1",
            "column 1: the name of a probe is expected\nhint: write",
        ),
        (
            "left.force.z >",
            "column 15: a number is expected\nhint: write a number, in SI",
        ),
        (
            "rising a.b 1 hysteresis",
            "column 24: a number is expected\nhint: write a number",
        ),
        (
            "rising a.b 1 hysteresis -1N",
            "column 25: the hysteresis -1 is negative\nhint: write by how much",
        ),
        (
            "above a.b 1 hysteresis 1",
            "column 13: a hysteresis belongs to an edge\nhint: write `rising`",
        ),
        (
            "left.force.z > ten",
            "column 16: `ten` is no number\nhint: write a number",
        ),
        (
            "left.force.z > 10 N",
            "column 19: `N` is too much\nhint: a name with blanks",
        ),
        ("left.force.z > inf", "column 16: `inf` is no number"),
        (
            "left.force.z",
            "column 13: `>`, `<` or `=` is expected\nhint: write a condition",
        ),
        (
            "rising",
            "column 7: the name of a probe is expected\nhint: `takt scope --list`",
        ),
        ("rising left.force.z", "column 20: a number is expected"),
        (
            "raising left.force.z 3",
            "column 1: `raising` is no kind of trigger; did you mean `rising`?",
        ),
        (
            "inside a.b 2 1",
            "column 14: the upper bound 1 is below the lower one 2\nhint: write the lower",
        ),
        (
            "fault",
            "column 6: a device is expected\nhint: write `fault left`",
        ),
        (
            "net:swing =",
            "column 12: a state is expected\nhint: write the name of a state",
        ),
        (
            "\"net:swing",
            "column 1: the quotation mark is not closed\nhint: close it",
        ),
        ("überlauf x", "column 1: `überlauf` is no kind of trigger"),
        ("a.b == 1", "column 6: a state is expected"),
    ] {
        let why = parse(text).expect_err(text);
        assert!(why.starts_with(expected), "{text}:\n{why}");
    }
}

#[test]
fn trigger_of_any_characters_does_not_panic() {
    let parts = [
        "rising", " ", "a.b", ">", "<", "=", "\"", "1mm", "é", "inside", "net:x",
    ];
    for a in parts {
        for b in parts {
            for c in parts {
                for d in parts {
                    let _ = parse(&[a, b, c, d].concat());
                }
            }
        }
    }
}
