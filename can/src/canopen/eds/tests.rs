//! Data sheets of vendors, and round trips of our own.

use takt_cia402::dictionary::{Access, DataType, Dictionary, ObjectCode, PdoUse};

use super::*;

fn at(index: u16, sub: u8) -> Address {
    Address::new(index, sub)
}

fn node(raw: u8) -> NodeId {
    NodeId::new(raw).unwrap()
}

/// Features of files in the field: comments, empty values, any letter case, octal numbers.
const FIELD: &str = "\u{FEFF}; written by hand
[FileInfo]
FileName=field.eds
EDSVersion=4.0
[DeviceInfo]
ProductName=Servo ; inline
ProductNumber=
[deviceComissioning]
NodeID=0x0A
Baudrate=500
[1000]
ParameterName=Device type
DataType=0x0007
AccessType=ro
DefaultValue=0x00020192
[1014]
ParameterName=COB-ID EMCY
ObjectType=0x7
DataType=7
AccessType=RW
DefaultValue=$NODEID+0x80
ParameterValue=$nodeid+0x80
[1800]
ParameterName=TPDO 1
ObjectType=9
SubNumber=3
[1800sub0]
ParameterName=highest
DataType=5
AccessType=const
DefaultValue=2
[1800SUB1]
ParameterName=COB-ID
DataType=0x7
AccessType=rw
DefaultValue=0x40000180+$NODEID
[1800sub2]
ParameterName=type
DataType=0x5
AccessType=rw
DefaultValue=0377
[2001]
ParameterName=Gains
ObjectType=8
DataType=0x0003
AccessType=rww
PDOMapping=1
DefaultValue=-5
LowLimit=0x8000
HighLimit=32767
CompactSubObj=3
[2001Name]
NrOfEntries=1
2=middle
[2001Value]
NrOfEntries=1
3=0x7
[2002]
ParameterName=Name
DataType=9
AccessType=rw
DefaultValue=a; b
[2003]
ParameterName=Factor
DataType=0x08
AccessType=rw
DefaultValue=1.5
[2004]
ParameterName=Broken
DataType=0x0005
AccessType=rw
DefaultValue=300
[2005]
ParameterName=No type
AccessType=rw
[00A0]
ParameterName=A type
ObjectType=6
";

#[test]
fn eds_files_of_vendors_are_read() {
    let eds = Eds::parse(FIELD).unwrap();
    assert_eq!(eds.info("deviceinfo", "productname"), Some("Servo"));
    assert_eq!((eds.node, eds.kbit), (NodeId::new(10).ok(), Some(500)));
    assert_eq!(eds.relative, [at(0x1014, 0), at(0x1800, 1)]);
    let d = eds.dictionary(node(10)).unwrap();
    assert_eq!(d.bytes(at(0x1014, 0)).unwrap(), 0x8A_u32.to_le_bytes());
    assert_eq!(
        d.bytes(at(0x1800, 1)).unwrap(),
        0x4000_018A_u32.to_le_bytes()
    );
    assert_eq!(d.bytes(at(0x1800, 2)).unwrap(), [255], "0377 is octal");
    assert_eq!(d.bytes(at(0x2001, 0)).unwrap(), [3]);
    assert_eq!(d.bytes(at(0x2001, 2)).unwrap(), (-5_i16).to_le_bytes());
    assert_eq!(d.bytes(at(0x2001, 3)).unwrap(), 7_i16.to_le_bytes());
    let gain = d.entry(at(0x2001, 1)).unwrap();
    assert_eq!((gain.low, gain.high), (Some(-32768), Some(32767)));
    assert_eq!(
        (gain.access, gain.pdo),
        (Access::ReadWrite, PdoUse::Receive)
    );
    assert_eq!(d.bytes(at(0x2003, 0)).unwrap(), 1.5_f32.to_le_bytes());
    assert_eq!(d.bytes(at(0x2002, 0)).unwrap(), b"a; b");
    assert_eq!(d.object(0x2001).unwrap().code, ObjectCode::Array);
    let remarks: Vec<_> = eds.remarks.iter().map(ToString::to_string).collect();
    assert_eq!(
        remarks,
        [
            "[2004] DefaultValue `300` is not a valid UNSIGNED8; 0 is used",
            "[2005] has no DataType; skipped",
            "[2005] has no entries; skipped",
        ]
    );
}

#[test]
fn eds_entries_are_found_by_name() {
    let eds = Eds::parse(FIELD).unwrap();
    assert_eq!(eds.name(at(0x1000, 0)).as_deref(), Some("Device type"));
    assert_eq!(eds.name(at(0x2001, 2)).as_deref(), Some("Gains/middle"));
    for (name, address) in [
        ("device TYPE", Some(at(0x1000, 0))),
        ("Gains/middle", Some(at(0x2001, 2))),
        ("middle", Some(at(0x2001, 2))),
        ("nothing", None),
    ] {
        assert_eq!(eds.find(name), address, "{name}");
    }
}

#[test]
fn eds_other_texts_are_rejected() {
    let line = |text: &str| match Eds::parse(text) {
        Err(EdsError::Line { line, .. }) => line,
        other => panic!("{other:?}"),
    };
    assert_eq!(line("a=1"), 1);
    assert_eq!(line("[A]\n\nnothing"), 3);
    assert_eq!(line("[A\n"), 1);
    assert!(matches!(Eds::parse("[FileInfo]\n"), Err(EdsError::Empty)));
    let wrong = "[DeviceComissioning]\nNodeID=200\n[1000]\nDataType=7\n";
    assert!(matches!(Eds::parse(wrong), Err(EdsError::Node(_))));
}

#[test]
fn eds_values_of_every_type_read_back() {
    for (kind, text, bytes) in [
        (DataType::Boolean, "0x01", &[1][..]),
        (DataType::Integer8, "-1", &[255]),
        (DataType::Integer8, "0xFF", &[255]),
        (DataType::Unsigned24, "0x123456", &[0x56, 0x34, 0x12]),
        (
            DataType::Integer64,
            "-2",
            &[254, 255, 255, 255, 255, 255, 255, 255],
        ),
        (
            DataType::Real64,
            "0x3FF0000000000000",
            &[0, 0, 0, 0, 0, 0, 0xF0, 0x3F],
        ),
        (DataType::OctetString, "01 AB", &[1, 0xAB]),
        (DataType::VisibleString, "a b", b"a b"),
    ] {
        let (parsed, relative) = value::parse(kind, text).unwrap();
        assert_eq!(
            (parsed.as_slice(), relative),
            (bytes, false),
            "{kind} {text}"
        );
        let printed = value::print(kind, bytes, false);
        assert_eq!(
            value::parse(kind, &printed).unwrap().0,
            bytes,
            "{kind} {printed}"
        );
    }
    for (kind, text) in [
        (DataType::Unsigned8, "256"),
        (DataType::Unsigned8, "-129"),
        (DataType::Unsigned8, ""),
        (DataType::Unsigned32, "$NODEID+x"),
        (DataType::Unsigned64, "0x10000000000000000"),
        (DataType::OctetString, "0"),
    ] {
        assert_eq!(value::parse(kind, text), None, "{kind} `{text}`");
    }
}

fn same(a: &Eds, b: &Eds) {
    assert_eq!(a.objects, b.objects);
    assert_eq!((&a.relative, a.node, a.kbit), (&b.relative, b.node, b.kbit));
    assert!(b.remarks.is_empty(), "{:?}", b.remarks);
}

#[test]
#[cfg(feature = "emulator")]
fn eds_of_emulated_drive_reads_back() {
    use crate::canopen::emulator::{DriveNode, DriveNodeConfig};
    let config = DriveNodeConfig::new(node(5));
    let eds = config.eds();
    let read = Eds::parse(&eds.print()).unwrap();
    let mut sorted = eds.clone();
    sorted.objects.sort_by_key(|object| object.index);
    same(&sorted, &read);
    assert_eq!(read.print(), Eds::parse(&read.print()).unwrap().print());
    // A node created from the data sheet has the values of the drive.
    let drive = DriveNode::power_on(config, Duration::ZERO).unwrap();
    let from_file = read.dictionary(node(5)).unwrap();
    for object in drive.dictionary().objects() {
        for (sub, _) in &object.entries {
            let address = at(object.index, *sub);
            let own = address.index < 0x6000;
            let (is, expected) = (from_file.bytes(address), drive.dictionary().bytes(address));
            assert!(!own || is == expected, "{address}: {is:?} {expected:?}");
        }
    }
}

#[test]
#[cfg(feature = "emulator")]
fn dcf_becomes_node_plan() {
    use crate::canopen::emulator::DriveNodeConfig;
    let config = DriveNodeConfig::new(node(5));
    let mut eds = config.eds();
    let mut dictionary: Dictionary = eds.dictionary(node(5)).unwrap();
    dictionary
        .store(at(0x6085, 0), &77_u32.to_le_bytes())
        .unwrap();
    dictionary
        .store(at(0x1017, 0), &50_u16.to_le_bytes())
        .unwrap();
    eds.configure(node(5), 500, &dictionary);
    let read = Eds::parse(&eds.print()).unwrap();
    assert_eq!((read.node, read.kbit), (NodeId::new(5).ok(), Some(500)));
    let plan = read.plan(node(5)).unwrap();
    assert_eq!(
        plan.supervision,
        Supervision::Heartbeat(Duration::from_millis(50))
    );
    assert_eq!(plan.device_type, Some(0x0002_0192));
    assert_eq!(plan.identity[1], Some(0x402));
    let pdos = |pdos: &[(u16, Parameters)]| {
        pdos.iter()
            .map(|(n, p)| (*n, p.cob.to_string()))
            .collect::<Vec<_>>()
    };
    assert_eq!(pdos(&plan.rpdos), [(0, "205h".into())]);
    assert_eq!(pdos(&plan.tpdos), [(0, "185h".into())]);
    let speed = Download::new(0x6085, 0, &77_u32.to_le_bytes());
    assert!(plan.downloads.contains(&speed));
    let pdo = |d: &Download| (0x1400..0x1C00).contains(&d.address.index);
    assert!(
        !plan.downloads.iter().any(pdo),
        "PDOs go by their procedure"
    );
}

proptest::proptest! {
    #[test]
    fn eds_any_text_does_not_panic(text in "(\\[?[0-9A-Fa-f]{0,4}(sub[0-9A-F])?\\]?[ =;a-zA-Z0-9x$+-]*\n){0,30}") {
        if let Ok(eds) = Eds::parse(&text) {
            let again = Eds::parse(&eds.print());
            proptest::prop_assert!(again.is_ok());
        }
    }
}
