//! Decoding by a DBC file: byte orders, signs, floats, multiplexing, value names, and damaged files.

use takt_can::log::parse_frame;

use super::*;

const FILE: &str = r#"VERSION ""

NS_ :

BS_:

BU_: ECU

BO_ 291 Motor: 8 ECU
 SG_ Speed : 0|16@1- (0.1,0) [-3000|3000] "rpm" ECU
 SG_ Torque : 23|12@0- (0.5,-10) [0|0] "Nm" ECU
 SG_ State : 40|3@1+ (1,0) [0|7] "" ECU
 SG_ Count : 56|8@1+ (1,0) [0|255] "" ECU

BO_ 2566844926 Extended: 4 ECU
 SG_ Ratio : 0|32@1- (1,0) [0|0] "" ECU

BO_ 512 Muxed: 4 ECU
 SG_ Page M : 0|8@1+ (1,0) [0|0] "" ECU
 SG_ A m0 : 8|8@1+ (1,0) [0|0] "V" ECU
 SG_ B m1 : 8|8@1+ (1,-40) [0|0] "C" ECU

VAL_ 291 State 0 "off" 1 "ready" 2 "running" ;
SIG_VALTYPE_ 2566844926 Ratio : 1;
"#;

fn shown(frame: &str) -> Option<String> {
    let database = Database::parse(FILE.as_bytes()).unwrap();
    let frame = parse_frame(frame).unwrap();
    database.decode(&frame).map(|decoded| text(&decoded))
}

#[test]
fn dbc_signals_of_both_byte_orders_are_decoded() {
    // Speed -2 counts; torque 0xFFE of bits 23 down to 12: -2 counts; state 2.
    assert_eq!(
        shown("123#FEFFFFE00002002A").as_deref(),
        Some("Motor: Speed=-0.2 rpm, Torque=-11 Nm, State=2 (running), Count=42")
    );
    assert_eq!(shown("124#00"), None);
    assert_eq!(shown("123#R8"), None);
}

#[test]
fn dbc_frame_of_another_length_lacks_signals() {
    assert_eq!(
        shown("123#0A00").as_deref(),
        Some("Motor: Speed=1 rpm [2 bytes, the DBC has 8]")
    );
}

#[test]
fn dbc_extended_float_is_decoded() {
    assert_eq!(
        shown("18FEF1FE#0000C03F").as_deref(),
        Some("Extended: Ratio=1.5")
    );
}

#[test]
fn dbc_multiplexed_signals_follow_their_switch() {
    assert_eq!(
        shown("200#00050000").as_deref(),
        Some("Muxed: Page=0, A=5 V")
    );
    assert_eq!(
        shown("200#01050000").as_deref(),
        Some("Muxed: Page=1, B=-35 C")
    );
    assert_eq!(shown("200#02050000").as_deref(), Some("Muxed: Page=2"));
}

#[test]
fn dbc_ranges_cover_the_measurement() {
    let database = Database::parse(FILE.as_bytes()).unwrap();
    let mut ranges = Ranges::default();
    for frame in ["200#00050000", "200#00090000", "200#00070000"] {
        ranges.handle(&database, &parse_frame(frame).unwrap());
    }
    let table = ranges.table(&database);
    let line = table.lines().find(|line| line.contains("Muxed.A")).unwrap();
    let words: Vec<&str> = line.split_ascii_whitespace().collect();
    assert_eq!(words, ["200", "Muxed.A", "5", "9", "7", "V"]);
    assert_eq!(ranges.json(&database)[0]["frames"], 3);
}

#[test]
fn dbc_damaged_file_is_an_error() {
    for text in ["", "nonsense", "BO_ 291 Motor: 8", "VERSION \"\"\n"] {
        assert!(Database::parse(text.as_bytes()).is_err(), "{text}");
    }
    // Cut anywhere, it is an error or a database; bits beyond the frame are no signal.
    for end in 0..FILE.len() {
        let _ = Database::parse(&FILE.as_bytes()[..end]);
    }
    let wild = FILE.replace("0|16@1-", "18446744073709551615|64@1-");
    if let Ok(database) = Database::parse(wild.as_bytes()) {
        let frame = parse_frame("123#FEFFFFE00002002A").unwrap();
        assert_eq!(database.decode(&frame).unwrap().values.len(), 3);
    }
}
