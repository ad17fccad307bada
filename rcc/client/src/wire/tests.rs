//! Each rule of the grammar, round trips, and robustness against any bytes.

use std::collections::BTreeMap;

use proptest::prelude::*;

use super::lines::{LineReader, LineTooLong};
use super::*;

fn args(text: &str) -> Vec<Value> {
    Message::decode(&format!("t=c({text})")).unwrap().args
}

fn error(text: &str) -> String {
    Message::decode(text).unwrap_err().to_string()
}

#[test]
fn message_without_values() {
    assert_eq!(Message::decode("c3=gde()"), Ok(Message::new("c3", "gde")));
}

#[test]
fn every_value_kind_is_decoded() {
    let empty = BTreeMap::new();
    assert_eq!(args(r#""a""#), [Value::from("a")]);
    assert_eq!(args("1"), [Value::Integer(1)]);
    assert_eq!(args("0.25"), [Value::Float(0.25)]);
    assert_eq!(args(".5"), [Value::Float(0.5)]);
    assert_eq!(args("[]"), [Value::List(Vec::new())]);
    assert_eq!(args("{}"), [Value::Map(empty)]);
    assert_eq!(
        args(r#"["a",1]"#),
        [Value::List(vec!["a".into(), 1.into()])]
    );
    assert_eq!(
        args(r#"{a:1,"b c":[2.0]}"#),
        [Value::map_of([
            ("a", Value::Integer(1)),
            ("b c", Value::List(vec![2.0.into()])),
        ])]
    );
}

#[test]
fn integer_and_float_are_different() {
    assert_ne!(args("1"), args("1.0"));
}

#[test]
fn strings_escape_quotes_and_backslashes() {
    assert_eq!(args(r#""a\"b\\c""#), [Value::from(r#"a"b\c"#)]);
    assert_eq!(args("\"a\nb,)\""), [Value::from("a\nb,)")]);
    assert_eq!(
        error(r#"t=c("a\n")"#),
        "`\"` or `\\` after a backslash is expected at byte 7, not `n`"
    );
    assert_eq!(
        error(r#"t=c("a"#),
        "`\"` is expected at byte 6, not the end of the message"
    );
    assert_eq!(
        error(r#"t=c("a\"#),
        "`\"` or `\\` after a backslash is expected at byte 7, not the end of the message"
    );
}

#[test]
fn only_blanks_separate_tokens() {
    let spread = " t = c ( 1 , [ \"a\" , { k : 2.0 } ] ) ";
    assert_eq!(
        Message::decode(spread),
        Message::decode(r#"t=c(1,["a",{k:2.0}])"#)
    );
    assert_eq!(
        error("t=c(1,\t2)"),
        "a value is expected at byte 6, not `\\t`"
    );
    assert_eq!(
        error("t=c(1)\n"),
        "the end of the message is expected at byte 6, not `\\n`"
    );
}

#[test]
fn blanks_split_numbers_and_names() {
    assert_eq!(
        error("t=c(1 2)"),
        "`,` or `)` is expected at byte 6, not `2`"
    );
    assert_eq!(error("t=c d()"), "`(` is expected at byte 4, not `d`");
}

#[test]
fn identifiers_begin_with_a_letter_or_underscore() {
    assert!(Message::decode("_1=a_2()").is_ok());
    assert_eq!(error("1=c()"), "a tag is expected at byte 0, not `1`");
    assert_eq!(error("t=2()"), "a command is expected at byte 2, not `2`");
    assert_eq!(error("t=c({1:2})"), "a key is expected at byte 5, not `1`");
    assert_eq!(error("ä=c()"), "a tag is expected at byte 0, not `ä`");
    assert_eq!(
        error(""),
        "a tag is expected at byte 0, not the end of the message"
    );
}

#[test]
fn numbers_have_no_sign_or_exponent() {
    assert_eq!(error("t=c(-1)"), "a value is expected at byte 4, not `-`");
    assert_eq!(
        error("t=c(1e3)"),
        "`,` or `)` is expected at byte 5, not `e`"
    );
    assert_eq!(
        error("t=c(1.)"),
        "a digit after the decimal point is expected at byte 6, not `)`"
    );
    assert_eq!(
        error("t=c(.)"),
        "a digit after the decimal point is expected at byte 5, not `)`"
    );
}

#[test]
fn numbers_are_bounded() {
    assert_eq!(args("2147483647"), [Value::Integer(2_147_483_647)]);
    assert_eq!(
        error("t=c(2147483648)"),
        DecodeError::NumberTooLarge { at: 4 }.to_string()
    );
    let huge = format!("t=c({}.0)", "9".repeat(400));
    assert_eq!(
        Message::decode(&huge),
        Err(DecodeError::NumberTooLarge { at: 4 })
    );
}

#[test]
fn separators_are_required() {
    for text in [
        "t=c(,)",
        "t=c(1,)",
        "t=c([1,])",
        "t=c({a:1,})",
        "t=c({a})",
        "t=c({a 1})",
    ] {
        assert!(Message::decode(text).is_err(), "{text}");
    }
    for text in [
        "t=c(", "t=c([)", "t=c({]", "t", "t=", "t=c", "t=c())", "t=c()x", "=c()",
    ] {
        assert!(Message::decode(text).is_err(), "{text}");
    }
}

#[test]
fn duplicate_key_last_value_wins() {
    assert_eq!(args("{a:1,a:2}"), args("{a:2}"));
}

#[test]
fn length_is_bounded() {
    let longest = format!("t=c(\"{}\")", "x".repeat(MESSAGE_BYTES_MAX - 7));
    assert!(Message::decode(&longest[..]).is_ok());
    let bytes = MESSAGE_BYTES_MAX + 1;
    assert_eq!(
        Message::decode(&"x".repeat(bytes)),
        Err(DecodeError::TooLong { bytes })
    );
}

#[test]
fn depth_is_bounded() {
    let nested = |depth| format!("t=c({}{})", "[".repeat(depth), "]".repeat(depth));
    assert!(Message::decode(&nested(DEPTH_MAX)).is_ok());
    let at = 4 + DEPTH_MAX;
    assert_eq!(
        Message::decode(&nested(DEPTH_MAX + 1)),
        Err(DecodeError::TooDeep { at })
    );
    assert!(Message::decode(&format!("t=c({}", "[{a:".repeat(1_000_000))).is_err());
}

#[test]
fn name_length_is_bounded() {
    let with = |length| format!("{}=c()", "t".repeat(length));
    assert!(Message::decode(&with(IDENTIFIER_BYTES_MAX)).is_ok());
    assert_eq!(
        Message::decode(&with(IDENTIFIER_BYTES_MAX + 1)),
        Err(DecodeError::NameTooLong { at: 0 })
    );
}

#[test]
fn value_count_is_bounded() {
    let with = |count| format!("t=c({})", vec!["1"; count].join(","));
    assert!(Message::decode(&with(VALUES_MAX)).is_ok());
    let error = Message::decode(&with(VALUES_MAX + 1)).unwrap_err();
    assert!(
        matches!(error, DecodeError::TooManyValues { .. }),
        "{error}"
    );
}

#[test]
fn message_encoding_matches_original() {
    let devices = Value::map_of([
        ("type", Value::from("rcc")),
        ("interfaces", Value::Map(BTreeMap::new())),
    ]);
    let message = Message::new("c3", "da").with(Value::map_of([("rcc", devices)]));
    assert_eq!(
        message.to_string(),
        r#"c3=da({rcc:{interfaces:{},type:"rcc"}})"#
    );
}

#[test]
fn non_identifier_keys_are_quoted() {
    let map = Value::map_of([("a b", 1), ("", 2), ("a\"", 3), ("_1", 4), ("1", 5)]);
    assert_eq!(map.to_string(), r#"{"":2,"1":5,_1:4,"a b":1,"a\"":3}"#);
}

#[test]
fn floats_have_six_decimals() {
    assert_eq!(Value::Float(0.2).to_string(), "0.200000");
    assert_eq!(Value::Float(1e-9).to_string(), "0.000000");
    assert_eq!(
        Value::list_of([1.0, 2.5]).to_string(),
        "[1.000000,2.500000]"
    );
}

#[test]
fn only_quotes_and_backslashes_are_escaped() {
    assert_eq!(Value::from("a\"b\\\nü").to_string(), "\"a\\\"b\\\\\nü\"");
}

fn any_value() -> impl Strategy<Value = Value> {
    let leaf = prop_oneof![
        any::<String>().prop_map(Value::String),
        (0..=i32::MAX.cast_unsigned()).prop_map(Value::Integer),
        (0_u32..1_000_000).prop_map(|n| Value::Float(f64::from(n) / 64.0)),
    ];
    leaf.prop_recursive(4, 32, 5, |inner| {
        prop_oneof![
            proptest::collection::vec(inner.clone(), 0..5).prop_map(Value::List),
            proptest::collection::btree_map(any::<String>(), inner, 0..5).prop_map(Value::Map),
        ]
    })
}

proptest! {
    #[test]
    fn message_round_trips(
        tag in "[A-Za-z_][A-Za-z0-9_]{0,8}",
        command in "[A-Za-z_][A-Za-z0-9_]{0,8}",
        args in proptest::collection::vec(any_value(), 0..4),
    ) {
        let message = Message { tag, command, args };
        let line = message.to_string();
        prop_assert_eq!(Message::decode(&line), Ok(message));
        let mut lines = LineReader::default();
        lines.push(format!("{line}\n").as_bytes());
        prop_assert_eq!(lines.poll_message(), Ok(Some(line)));
    }

    #[test]
    fn random_bytes_do_not_panic(data in proptest::collection::vec(any::<u8>(), 0..200)) {
        fuzz(&data);
    }

    #[test]
    fn random_messages_do_not_panic(text in r#"[a-c]=[a-c]\([\[\]{}:,."\\ a-c0-3]{0,40}\)?"#) {
        fuzz(text.as_bytes());
    }
}

/// All messages in a stream that arrives in pieces of `piece` bytes.
fn lines(stream: &str, piece: usize) -> Vec<String> {
    let mut reader = LineReader::default();
    let mut out = Vec::new();
    for piece in stream.as_bytes().chunks(piece) {
        reader.push(piece);
        while let Some(line) = reader.poll_message().unwrap() {
            out.push(line);
        }
    }
    out
}

#[test]
fn lines_end_at_newlines_outside_quotes() {
    let stream = "a=b()\n\n c=d(\"x\ny\\\"\n\")\r\ne=f(\"\\\\\")\nrest";
    let expected = ["a=b()", " c=d(\"x\ny\\\"\n\")", "e=f(\"\\\\\")"];
    for piece in 1..=stream.len() {
        assert_eq!(lines(stream, piece), expected, "{piece}");
    }
}

#[test]
fn endless_line_is_rejected() {
    let mut reader = LineReader::default();
    reader.push(b"a=b(\"");
    let part = vec![b'\n'; MESSAGE_BYTES_MAX / 2];
    reader.push(&part);
    assert_eq!(reader.poll_message(), Ok(None));
    reader.push(&part);
    assert_eq!(
        reader.poll_message(),
        Err(LineTooLong {
            bound: MESSAGE_BYTES_MAX
        })
    );
}
