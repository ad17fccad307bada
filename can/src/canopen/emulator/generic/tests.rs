//! A device made from a data sheet, seen from the network.

use super::super::DriveNodeConfig;
use super::*;
use crate::LogLine;

const MS: Duration = Duration::from_millis(1);

fn id() -> NodeId {
    NodeId::new(5).unwrap()
}

/// The data sheet of the emulated drive with TPDO 3 (statusword, position) enabled, at 5 ms.
fn sheet() -> Eds {
    let text = DriveNodeConfig::new(id()).eds().print();
    let mut eds = Eds::parse(&text).unwrap();
    eds.values = vec![
        (Address::new(0x1802, 1), 0x385_u32.to_le_bytes().to_vec()),
        (Address::new(0x1802, 5), 5_u16.to_le_bytes().to_vec()),
    ];
    eds
}

fn config() -> GenericConfig {
    GenericConfig {
        id: id(),
        signals: signals(&sheet(), id(), Duration::from_secs(1)).unwrap(),
        update: 5 * MS,
        heartbeat_ms: Some(100),
        sdo_timeout: 500 * MS,
        quirks: NodeQuirks::default(),
    }
}

fn run(node: &mut GenericNode, from: u32, to: u32) -> Vec<String> {
    let mut frames = Vec::new();
    for ms in from..to {
        frames.extend(std::iter::from_fn(|| node.poll_transmit(ms * MS)));
    }
    frames.iter().map(ToString::to_string).collect()
}

fn send(node: &mut GenericNode, frame: &str, ms: u32) {
    let line = format!("(1.000000) can0 {frame}");
    let frame = LogLine::parse(&line).unwrap().frame;
    node.handle_frame(&frame, ms * MS);
}

#[test]
fn sheet_device_boots_up_answers_and_moves() {
    let mut node = GenericNode::of_sheet(&sheet(), config(), Duration::ZERO).unwrap();
    assert_eq!(run(&mut node, 0, 1)[0], "705#00");
    send(&mut node, "605#4000100000000000", 1);
    let answer = run(&mut node, 1, 2);
    assert!(
        answer.contains(&"585#4300100092010200".to_owned()),
        "{answer:?}"
    );
    send(&mut node, "000#0105", 2);
    let frames = run(&mut node, 2, 1002);
    assert!(frames.iter().filter(|frame| *frame == "705#05").count() >= 9);
    let positions: Vec<i32> = frames
        .iter()
        .filter_map(|frame| frame.strip_prefix("385#"))
        .map(|data| {
            let raw = u32::from_str_radix(&data[4..12], 16).unwrap();
            raw.swap_bytes().cast_signed()
        })
        .collect();
    assert!(positions.len() > 100, "{}", positions.len());
    let (low, high) = (
        positions.iter().min().unwrap(),
        positions.iter().max().unwrap(),
    );
    assert!(
        (-1000..-900).contains(low) && (900..=1000).contains(high),
        "{low} {high}"
    );
}

#[test]
fn sheet_signals_are_of_enabled_tpdos() {
    let signals = signals(&sheet(), id(), Duration::from_secs(1)).unwrap();
    let addresses: Vec<Address> = signals.iter().map(|signal| signal.address).collect();
    // TPDO 1 carries the statusword alone.
    assert_eq!(addresses, [Address::new(0x6064, 0)]);
}

#[test]
fn sheet_signal_that_does_not_fit_is_rejected() {
    let with = |index, range| {
        let signal = Signal {
            address: Address::new(index, 0),
            wave: Wave::Ramp,
            range: Some(range),
            period: Duration::from_secs(1),
        };
        let config = GenericConfig {
            signals: vec![signal],
            ..config()
        };
        GenericNode::of_sheet(&sheet(), config, Duration::ZERO)
    };
    assert!(with(0x6064, (0.0, 10.0)).is_ok());
    let absent = with(0x2ABC, (0.0, 1.0)).unwrap_err();
    assert_eq!(absent, GenericError::Absent(Address::new(0x2ABC, 0)));
    let unfit = with(0x6061, (0.0, 1e6)).unwrap_err().to_string();
    assert!(unfit.contains("6061h:00 is INTEGER8"), "{unfit}");
    let text = with(0x1008, (0.0, 1.0)).unwrap_err();
    assert!(matches!(text, GenericError::Unfit { .. }), "{text}");
}

#[test]
fn wave_stays_within_its_range() {
    let mut dice = 1;
    for (name, wave) in Wave::NAMES {
        assert_eq!((name.parse(), wave.to_string().as_str()), (Ok(wave), name));
        for n in 0..100 {
            let value = wave.at(f64::from(n) / 100.0, &mut dice);
            assert!((0.0..=1.0).contains(&value), "{name} {value}");
        }
    }
    assert!("saw".parse::<Wave>().unwrap_err().contains("sine, ramp"));
}
