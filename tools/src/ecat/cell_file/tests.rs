//! Cell files from scans of emulated segments.

use std::time::Duration;

use super::*;
use crate::ecat::cell;
use crate::ecat::tests::{CYCLE, tree, up};

#[test]
fn cell_from_scan_brings_up_its_segment() {
    let mut session = up(tree(), AlState::PreOp);
    let devices = esi::parse(esi::tests::DRIVE).unwrap();
    let text = text(&session, "line", None, &devices).unwrap();
    for part in [
        "[[ethercat]]\nname = \"line\"\ninterface = \"emulated0\"\n",
        "# Servo drive, revision 00010000h, serial 1\n[[ethercat.slave]]\nname = 'tk4021_1'\nposition = 1\n",
        "axes = 1\nsync0 = true\nshift = '-250000ns'\n",
        "[[ethercat.slave.startup]] # CSP\nindex = 0x6060\nsub = 0\nvalue = { bytes = [8] }\n",
        "digital_in = [['tk0808_2', 8]]\ndigital_out = [['tk0808_2', 8]]\n",
    ] {
        assert!(text.contains(part), "{part}\n{text}");
    }
    let parsed = takt_devices::parse_cell(&text).unwrap();
    let segment = cell::segment(&parsed, None).unwrap();
    session
        .restart(cell::master(segment, CYCLE, AlState::Op))
        .unwrap();
    session.follow_sync0();
    session.bring_up(Duration::from_secs(20)).unwrap();
    assert!(
        session.master().is_operational(),
        "{}",
        scan::text(&session)
    );
}

#[test]
fn cell_arm_template_filled_in_drives_axes() {
    let mut session = up(tree(), AlState::PreOp);
    let text = text(&session, "line", None, &[]).unwrap();
    let keys = [
        "increments_per_turn",
        "zero",
        "range",
        "velocity_max",
        "acceleration_max",
    ];
    for key in keys {
        assert!(text.contains(&format!("\n#{key} = ")), "{key}\n{text}");
    }
    // As a user does: comment signs removed, figures filled in.
    let start = text.find("#[[ethercat.arm]]").unwrap();
    let (head, arm) = text.split_at(start);
    let open = format!("{head}{}", arm.replace("\n#", "\n").trim_start_matches('#'));
    let error = takt_devices::parse_cell(&open).unwrap_err().to_string();
    assert!(
        error.contains("line "),
        "an open figure is an error with its line: {error}"
    );
    let filled = open
        .replace("increments_per_turn = ?", "increments_per_turn = 360000")
        .replace("zero = ?", "zero = 0")
        .replace("range = [?, ?]", "range = [-170, 170]")
        .replace("_max = ?", "_max = 90");
    let parsed = takt_devices::parse_cell(&filled).unwrap_or_else(|e| panic!("{e}\n{filled}"));
    let segment = cell::segment(&parsed, None).unwrap();
    let arms = takt_devices::ethercat::describe(segment);
    let arm = arms.iter().find(|it| it.name == "arm").unwrap();
    assert_eq!(arm.limits.len(), 1);
    session
        .restart(cell::master(segment, CYCLE, AlState::Op))
        .unwrap();
    session.bring_up(Duration::from_secs(20)).unwrap();
    let slave = session.master().slave(1).unwrap();
    let axis = takt_ethercat::axis::Axis::new(1, slave.process(), 0, Default::default());
    assert!(axis.is_ok(), "{axis:?}");
}

/// The drive of the fixture with a second, default TxPDO set that excludes the first.
fn exclusive() -> String {
    let other = "<TxPdo Sm=\"3\"><Index>#x1A01</Index><Exclude>#x1A00</Exclude><Name>short</Name>\
         <Entry><Index>#x6041</Index><SubIndex>0</SubIndex><BitLen>16</BitLen></Entry></TxPdo><Mailbox>";
    esi::tests::DRIVE
        .replace("SdoInfo=\"0\"", "SdoInfo=\"0\" PdoAssign=\"1\"")
        .replace("<TxPdo Sm", "<TxPdo Fixed=\"1\" Sm")
        .replacen("<Mailbox>", other, 1)
}

#[test]
fn cell_excluded_pdo_is_not_assigned_and_named() {
    let session = up(tree(), AlState::PreOp);
    let devices = esi::parse(&exclusive()).unwrap();
    let text = text(&session, "line", None, &devices).unwrap();
    assert!(text.contains("\ninputs = [{ pdo = 0x1A00 }]\n"), "{text}");
    let all = warnings(session.master(), &devices).join("\n");
    let cause = "tk4021_1: PDO 1A01h is not used: 1A00h and it exclude each other\nhint: ";
    assert!(all.contains(cause), "{all}");
}

#[test]
fn cell_warns_of_parts_left_out_of_esi() {
    let session = up(tree(), AlState::PreOp);
    let modular = esi::tests::DRIVE.replace("</Dc>", "</Dc>\n<Slots><Slot/></Slots>");
    let devices = esi::parse(&modular).unwrap();
    let all = warnings(session.master(), &devices);
    assert_eq!(all.len(), 1, "{all:?}");
    let cause = ", line 19: TK4021: left out: modules in 1 slots";
    assert!(
        all[0].contains(cause) && all[0].contains("\nhint: "),
        "{all:?}"
    );
}
