//! From an unknown segment to process data, and faults on the way.

use takt_cia402::dictionary::{Address, Mapped};

use super::*;
use crate::config::{PdoSpec, StartupSdo};
use crate::emulator::{ServoConfig, ServoDrive};
use crate::{AlStatusCode, Command, Frame};

/// A coupler, four digital outputs, two analogue inputs, eight digital inputs.
fn terminals() -> (Segment, [Io; 3]) {
    let (outputs, a) = Io::digital(4, 0);
    let (analogue, b) = Io::analogue(1, 2);
    let (inputs, c) = Io::digital(0, 8);
    (
        Segment::line([Coupler::slave(), outputs, analogue, inputs]),
        [a, b, c],
    )
}

fn mapped(index: u16, bits: u8) -> Mapped {
    Mapped {
        address: Address::new(index, 0),
        bits,
    }
}

/// A drive with a mapping of the master's choice, without SYNC0.
fn drive_spec() -> SlaveSpec {
    SlaveSpec {
        product: Some(0x4021),
        outputs: Some(vec![PdoSpec {
            index: 0x1600,
            entries: vec![mapped(0x6040, 16), mapped(0x607A, 32), mapped(0x6060, 8)],
        }]),
        inputs: Some(vec![PdoSpec {
            index: 0x1A00,
            entries: vec![mapped(0x6041, 16), mapped(0x6064, 32), mapped(0x6061, 8)],
        }]),
        startup: vec![StartupSdo::entry(
            Address::new(0x6065, 0),
            12_345_u32.to_le_bytes(),
        )],
        ..SlaveSpec::new("axis", Location::Position(0))
    }
}

#[test]
fn terminals_reach_op_and_exchange_process_data() {
    let (segment, [outputs, analogue, inputs]) = terminals();
    let mut rig = Rig::new(MasterConfig::default(), segment);
    rig.until(3000, Master::is_operational);
    inputs.set_inputs(&[0b1010_0110]);
    analogue.set_inputs(&[1, 2, 3, 4]);
    rig.master.outputs_mut(1).copy_from_slice(&[0b0101]);
    rig.master.outputs_mut(2).copy_from_slice(&[0x34, 0x12]);
    rig.cycles(4);
    assert_eq!(
        (outputs.outputs(), analogue.outputs()),
        (vec![0b0101], vec![0x34, 0x12])
    );
    assert_eq!(rig.master.inputs(3), (&[0b1010_0110][..], 0));
    assert_eq!(rig.master.inputs(2), (&[1, 2, 3, 4][..], 0));
    // Outputs of one, of another with inputs, inputs of a third: 2 + 3 + 1.
    let group = &rig.master.groups()[0];
    assert_eq!((group.counter, group.expected), (6, (6, 6)));
    let names: Vec<_> = (0..4)
        .map(|n| rig.master.slave(n).unwrap().info().name.clone())
        .collect();
    assert_eq!(
        names,
        [
            "TK1100 coupler",
            "TK0400 digital",
            "TK0102 analogue",
            "TK0008 digital"
        ]
    );
    assert_eq!(rig.master.frames().lost, 0);
}

#[test]
fn cycle_frame_has_clock_image_census_and_one_datagram() {
    let (segment, _) = terminals();
    let mut rig = Rig::new(MasterConfig::default(), segment);
    rig.until(3000, Master::is_operational);
    rig.cycles(20);
    let mut frame = [0; 1500];
    let len = rig.master.poll_transmit(rig.now, &mut frame).unwrap();
    let frame = Frame::decode(&frame[..len]).unwrap();
    let commands: Vec<_> = frame
        .datagrams()
        .map(|d| d.unwrap().header.command)
        .collect();
    assert_eq!(
        commands,
        [Command::Frmw, Command::Lrw, Command::Brd, Command::Fprd]
    );
}

#[test]
fn drive_is_set_up_as_configured() {
    let (slave, drive) = ServoDrive::slave(ServoConfig::default()).unwrap();
    let config = MasterConfig {
        slaves: vec![drive_spec()],
        ..MasterConfig::default()
    };
    let mut rig = Rig::new(config, Segment::line([slave]));
    rig.until(5000, Master::is_operational);
    rig.cycles(5);
    let entry =
        |index, sub| drive.dictionary(|d| d.bytes(Address::new(index, sub)).unwrap().to_vec());
    assert_eq!(entry(0x6065, 0), 12_345_u32.to_le_bytes());
    assert_eq!(
        (entry(0x1600, 0), entry(0x1600, 2)),
        (vec![3], vec![32, 0, 0x7A, 0x60])
    );
    assert_eq!(
        (entry(0x1C12, 0), entry(0x1C12, 1)),
        (vec![1], vec![0x00, 0x16])
    );
    let group = &rig.master.groups()[0];
    assert_eq!((group.counter, group.expected), (3, (3, 3)));
    let process = rig.master.slave(0).unwrap().process().clone();
    assert_eq!((process.outputs_len(), process.inputs_len()), (7, 7));
    let location = process.locate(Address::new(0x6064, 0), false).unwrap();
    assert_eq!((location.bit, location.bits), (16, 32));
    let (inputs, age) = rig.master.inputs(0);
    assert_eq!((inputs[0] & 0x4F, age), (0x40, 0), "switch on disabled");
}

#[test]
fn drive_without_configuration_keeps_its_pdos() {
    let (slave, drive) = ServoDrive::slave(ServoConfig::default()).unwrap();
    let mut rig = Rig::new(MasterConfig::default(), Segment::line([slave]));
    rig.until(5000, Master::is_operational);
    let count = drive.dictionary(|d| d.bytes(Address::new(0x1600, 0)).unwrap()[0]);
    let process = rig.master.slave(0).unwrap().process().clone();
    let outputs: Vec<_> = process
        .channels
        .iter()
        .filter(|channel| channel.outputs)
        .collect();
    assert_eq!(outputs[0].pdos[0].entries.len(), usize::from(count));
    assert!(process.locate(Address::new(0x6041, 0), false).is_some());
}

#[test]
fn unexpected_slaves_are_reported_and_stay_in_init() {
    let (segment, _) = terminals();
    let wrong = SlaveSpec {
        product: Some(7),
        ..SlaveSpec::new("gate", Location::Position(1))
    };
    let slaves = vec![
        SlaveSpec::new("coupler", Location::Position(0)),
        wrong,
        SlaveSpec::new("x", Location::Alias(5)),
    ];
    let mut rig = Rig::new(
        MasterConfig {
            slaves,
            ..MasterConfig::default()
        },
        segment,
    );
    rig.until(1000, |master| master.phase() == Phase::Refused);
    let texts: Vec<_> = rig
        .master
        .differences()
        .iter()
        .map(ToString::to_string)
        .collect();
    assert_eq!(texts.len(), 4, "{texts:?}");
    assert!(
        texts[0]
            .starts_with("position 1: \"gate\" should have product 00000007h, \"TK0400 digital\"")
    );
    assert!(texts[1].starts_with("\"x\" is missing at alias 5"));
    assert!(texts[2].starts_with("position 2: \"TK0102 analogue\""));
    rig.cycles(50);
    assert_eq!(rig.segment.slave(1).unwrap().state(), AlState::Init);
}

#[test]
fn refused_state_is_reported_with_code_and_retried() {
    let (segment, _) = terminals();
    let mut rig = Rig::new(MasterConfig::default(), segment);
    let code = AlStatusCode(0x001E);
    rig.segment
        .slave(3)
        .unwrap()
        .refuse(Some((AlState::SafeOp, code)));
    rig.until(5000, |master| {
        master.slave(3).is_some_and(|slave| slave.fault().is_some())
    });
    let fault = rig.master.slave(3).unwrap().fault().unwrap();
    assert_eq!(
        fault.to_string(),
        "SAFE-OP wanted, PRE-OP + error shown: invalid input configuration (001Eh): length of SyncManager 3 and the \
         sum of 1C13h differ, or 1C13h lists PDOs that may not be assigned together"
    );
    // The others continue.
    rig.until(1000, |master| {
        (0..3).all(|n| master.slave(n).unwrap().is_running())
    });
    rig.segment.slave(3).unwrap().refuse(None);
    rig.until(8000, Master::is_operational);
}

#[test]
fn empty_segment_is_counted_until_slaves_appear() {
    let (segment, _) = terminals();
    let mut rig = Rig::new(MasterConfig::default(), segment);
    rig.segment.set_link(0, false);
    rig.cycles(200);
    assert_eq!(rig.master.phase(), Phase::Count);
    rig.segment.set_link(0, true);
    rig.until(3000, Master::is_operational);
}

#[test]
fn lost_frames_during_start_are_resent() {
    let (slave, _) = ServoDrive::slave(ServoConfig::default()).unwrap();
    let config = MasterConfig {
        slaves: vec![drive_spec()],
        ..MasterConfig::default()
    };
    let mut rig = Rig::new(config, Segment::line([slave]));
    for cycle in 0..20_000 {
        match cycle % 37 {
            3 => rig.segment.faults.lose = 1,
            19 => rig.segment.faults.lose_returned = 1,
            _ => {}
        }
        rig.cycle();
        if rig.master.is_operational() {
            break;
        }
    }
    assert!(rig.master.is_operational(), "{:?}", rig.events);
    assert!(rig.master.frames().lost > 20, "{:?}", rig.master.frames());
}

#[test]
fn pdo_entry_refused_is_named_at_every_attempt() {
    // A statusword can be mapped into no PDO that the drive receives.
    let mut spec = drive_spec();
    let outputs = spec.outputs.as_mut().unwrap();
    outputs[0].entries.insert(1, mapped(0x6041, 16));
    let (slave, _) = ServoDrive::slave(ServoConfig::default()).unwrap();
    let config = MasterConfig {
        slaves: vec![spec],
        ..MasterConfig::default()
    };
    let mut rig = Rig::new(config, Segment::line([slave]));
    // Five attempts and more.
    for _ in 0..8000 {
        rig.cycle();
        assert!(!rig.master.is_operational());
        let fault = rig.master.slave(0).and_then(|slave| slave.fault());
        if let Some(fault) = fault {
            let text = fault.to_string();
            assert!(
                text.starts_with("6041h:00 (16 bits) refused as entry 2 of PDO 1600h: "),
                "{text}"
            );
        }
    }
    let is_refused = |event: &Event| matches!(event, Event::Fault { .. });
    assert!(rig.events.iter().any(is_refused), "{:?}", rig.events);
}

#[test]
fn pdo_of_equal_length_with_other_entries_differs() {
    let wanted = drive_spec().outputs.unwrap();
    let spec = SlaveSpec {
        inputs: Some(Vec::new()),
        ..drive_spec()
    };
    let planned = ProcessData::from_spec(&spec).unwrap();
    let channel = &planned.channels[0];
    let swapped = [mapped(0x607A, 32), mapped(0x6040, 16), mapped(0x6060, 8)];
    let found = |entries: &[Mapped]| {
        vec![Pdo {
            index: 0x1600,
            entries: entries.to_vec(),
        }]
    };
    assert_eq!(
        channel.difference(&wanted, &found(&wanted[0].entries)),
        None
    );
    let fault = channel.difference(&wanted, &found(&swapped)).unwrap();
    assert_eq!(
        fault.to_string(),
        "entry 1 of PDO 1600h is 607Ah:00 (32 bits), 6040h:00 (16 bits) was mapped; the PDO is fixed or the slave \
         keeps another mapping"
    );
    let fault = channel.difference(&wanted, &found(&swapped[..0])).unwrap();
    assert!(
        fault
            .to_string()
            .starts_with("entry 1 of PDO 1600h is nothing")
    );
    let list = channel.difference(&wanted, &[]).unwrap();
    assert!(
        matches!(
            list,
            Fault::Assignment {
                wanted: 56,
                found: 0,
                ..
            }
        ),
        "{list:?}"
    );
}
