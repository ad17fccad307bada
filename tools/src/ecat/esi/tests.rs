//! ESI files: what is read, what is left out, which PDOs are chosen.

use super::*;

/// A file as vendors write them, in the words of the emulated drive.
pub(in crate::ecat) const DRIVE: &str = r##"<?xml version="1.0"?>
<EtherCATInfo Version="1.6"><Vendor><Id>#x7A87</Id><Name>Takt</Name></Vendor><Descriptions><Devices>
<Device Physics="YY"><Type ProductCode="#x4021" RevisionNo="#x10000">TK4021</Type>
<Name LcId="1031"><![CDATA[Antrieb]]></Name><Name LcId="1033"><![CDATA[Servo drive]]></Name>
<Profile><ProfileNo>402</ProfileNo><Dictionary><Objects>
<Object><Index>#x6041</Index><Name>Status word</Name><Type>UINT</Type><BitSize>16</BitSize></Object>
</Objects></Dictionary></Profile>
<RxPdo Fixed="1" Sm="2"><Index>#x1600</Index><Name>out</Name>
<Entry><Index>#x6040</Index><SubIndex>0</SubIndex><BitLen>16</BitLen><Name>Control word</Name><DataType>UINT</DataType></Entry>
<Entry><Index>#x607A</Index><SubIndex>0</SubIndex><BitLen>32</BitLen><Name>Target</Name></Entry></RxPdo>
<TxPdo Sm="3"><Index>#x1A00</Index><Name>in</Name>
<Entry><Index>#x6041</Index><SubIndex>0</SubIndex><BitLen>16</BitLen></Entry>
<Entry><Index>0</Index><BitLen>8</BitLen></Entry>
<Entry><Index>#x6064</Index><SubIndex>0</SubIndex><BitLen>32</BitLen></Entry></TxPdo>
<Mailbox><CoE SdoInfo="0" CompleteAccess="1"><InitCmd><Transition>PS</Transition><Index>#x6060</Index>
<SubIndex>0</SubIndex><Data>08</Data><Comment>CSP</Comment></InitCmd></CoE></Mailbox>
<Dc><OpMode><Name>SM</Name><AssignActivate>#x0</AssignActivate></OpMode>
<OpMode><Name>DC</Name><AssignActivate>#x300</AssignActivate><ShiftTimeSync0>-250000</ShiftTimeSync0></OpMode></Dc>
</Device></Devices></Descriptions></EtherCATInfo>"##;

#[test]
fn esi_device_has_pdos_commands_clocks_and_objects() {
    let devices = parse(DRIVE).unwrap();
    let device = &devices[0];
    assert_eq!(
        (device.vendor, device.product, device.revision),
        (0x7A87, 0x4021, 0x1_0000)
    );
    assert_eq!(
        (device.order.as_str(), device.name.as_str()),
        ("TK4021", "Servo drive")
    );
    let pdo = &device.rx_pdos[0];
    assert_eq!(
        (pdo.index, pdo.sync_manager, pdo.is_fixed),
        (0x1600, Some(2), true)
    );
    assert_eq!(pdo.entries[1], (0x607A, 0, 32, "Target".to_owned()));
    assert_eq!(device.tx_pdos[0].entries[1], (0, 0, 8, String::new()));
    assert_eq!(
        (device.startup[0].index, &device.startup[0].data[..]),
        (0x6060, &[8][..])
    );
    assert_eq!(
        (device.clocks[1].assign_activate, device.clocks[1].shift0_ns),
        (0x300, -250_000)
    );
    assert!(device.has_coe && !device.has_information);
    let text = device.text(false);
    assert!(
        text.contains("6041h    16 bits UINT         Status word"),
        "{text}"
    );
}

#[test]
fn esi_vendor_spellings_are_read() {
    let text = DRIVE
        .replace("#x4021", "#X4021")
        .replace("<Data>08<", "<Data>08 01\n 0A<")
        .replace("<BitLen>8<", "<BitLen>1024<")
        .replace("<Name>Target<", "<Name>Target &amp; &#956;<");
    let device = &parse(&text).unwrap()[0];
    assert_eq!(device.product, 0x4021);
    assert_eq!(device.startup[0].data, [8, 1, 10]);
    assert_eq!(device.tx_pdos[0].entries[1].2, 1024);
    assert_eq!(device.rx_pdos[0].entries[1].3, "Target & \u{3bc}");
}

#[test]
fn esi_revision_is_matched_by_age() {
    let of = |revision| Device {
        product: 1,
        revision,
        ..Device::default()
    };
    let devices = [of(1), of(5), of(9)];
    let found = |revision| find(&devices, 0, 1, revision).map(|it| it.revision);
    assert_eq!(
        [found(5), found(7), found(0), found(99)],
        [Some(5), Some(5), Some(1), Some(9)]
    );
    assert!(find(&devices, 0, 2, 1).is_none());
}

#[test]
fn esi_broken_file_is_rejected_with_cause() {
    for (text, cause) in [
        ("<a/>", "EtherCATInfo is missing"),
        ("<EtherCATInfo><Vendor>", "ends within an element"),
        ("<EtherCATInfo></Vendor>", "at byte"),
        (
            "<EtherCATInfo><Vendor><Id>&eacute;</Id>",
            "unknown entity &eacute;",
        ),
        (
            &DRIVE.replace("<Data>08<", "<Data>081<"),
            "`081` is no sequence of bytes",
        ),
        (
            &DRIVE.replace("<Data>08<", "<Data>0g<"),
            "`0g` is no sequence of bytes",
        ),
        (
            &DRIVE.replace("#x4021", "4021h"),
            "ProductCode of a device: `4021h` is no number",
        ),
        (
            &DRIVE.replace("#x6041", "#x16041"),
            "`#x16041` is no number of 2 bytes",
        ),
    ] {
        let error = format!("{:#}", parse(text).unwrap_err());
        assert!(error.contains(cause), "{error}");
    }
    let deep = "<a>".repeat(100);
    assert!(parse(&deep).unwrap_err().to_string().contains("too deeply"));
}

#[test]
fn esi_parts_not_read_have_line_and_remedy() {
    let text = DRIVE
        .replace(
            "</Dc>",
            "</Dc>\n<Slots><Slot/><Slot/></Slots>\n<Blob/><VendorSpecific/>",
        )
        .replace("<Mailbox>", "\n<Mailbox><SoE/><VoE/>")
        .replace("<Transition>PS<", "<Transition>SO<")
        .replace("<TxPdo Sm=\"3\">", "<TxPdo Sm=\"3\" OSFac=\"2\">")
        .replace(
            "<Name>SM</Name>",
            "<Name>SM</Name><CycleTimeSync1 Factor=\"-2\">0</CycleTimeSync1>",
        );
    let device = &parse(&text).unwrap()[0];
    let found: Vec<(u32, &str)> = device
        .left_out
        .iter()
        .map(|it| (it.line, it.what.as_str()))
        .collect();
    for (line, what) in [
        (11, "oversampling of PDO #x1A00"),
        (16, "SoE"),
        (16, "VoE"),
        (16, "the start-up command of #x6060 at `SO`"),
        (18, "CycleTimeSync1 of DC mode `SM`"),
        (20, "modules in 2 slots"),
        (21, "the element Blob"),
        (21, "data of the vendor"),
    ] {
        let has = found.iter().any(|it| it.0 == line && it.1.contains(what));
        assert!(has, "line {line}, {what}: {found:?}");
    }
    assert_eq!(found.len(), 8, "{found:?}");
    assert!(device.left_out.iter().all(|it| !it.remedy.is_empty()));
    let listed = device.text(false);
    assert!(
        listed.contains("left out, line 21: the element Blob; "),
        "{listed}"
    );
    assert!(parse(DRIVE).unwrap()[0].left_out.is_empty());
}

#[test]
fn esi_exclusive_pdos_are_never_chosen_together() {
    let pdo = |index, sm: Option<u8>, excludes: &[u16], entries: &[u16]| Pdo {
        index,
        sync_manager: sm,
        excludes: excludes.to_vec(),
        entries: entries
            .iter()
            .map(|it| (*it, 0, 16, String::new()))
            .collect(),
        ..Pdo::default()
    };
    let all = [
        pdo(0x1A00, Some(3), &[], &[0x6041]),
        pdo(0x1A01, Some(3), &[0x1A00], &[0x6041, 0x6061]),
        pdo(0x1A02, None, &[0x1A00, 0x1A01], &[0x6041, 0x6064]),
        pdo(0x1A03, Some(3), &[], &[0x603F]),
    ];
    let default = |pdo: &Pdo| pdo.sync_manager.is_some();
    let usual = choose(&all, &[], default);
    assert_eq!(usual.pdos, [0x1A00, 0x1A03]);
    assert_eq!(usual.excluded, [(0x1A01, 0x1A00)]);
    // The position is in none of the default: what carries it takes the place of what it excludes.
    let moved = choose(&all, &[(0x6041, 0), (0x6064, 0)], default);
    assert_eq!(moved.pdos, [0x1A02, 0x1A03]);
    assert_eq!(moved.excluded, [(0x1A00, 0x1A02), (0x1A01, 0x1A02)]);
    // What a mandatory PDO excludes is out of reach.
    let mut forced = all.to_vec();
    forced[0].is_mandatory = true;
    let lacking = choose(&forced, &[(0x6064, 0)], default);
    assert_eq!(
        (lacking.pdos, lacking.lacking),
        (vec![0x1A00, 0x1A03], vec![(0x6064, 0)])
    );
    let error = parse(&DRIVE.replace("<TxPdo Sm=\"3\">", "<TxPdo Sm=\"3\"><Exclude>x</Exclude>"));
    let error = format!("{:#}", error.unwrap_err());
    assert!(
        error.contains("line 11: Exclude: `x` is no index of a PDO"),
        "{error}"
    );
}
