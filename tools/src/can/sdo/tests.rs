//! `takt can sdo` against an emulated drive.

use clap::Parser;

use super::*;
use crate::can::lab::{Lab, node};
use takt_can::canopen::eds::Eds;
use takt_can::canopen::emulator::DriveNodeConfig;

#[derive(Debug, Parser)]
struct Line {
    #[command(flatten)]
    sdo: Sdo,
}

/// Parses the command line after `takt can sdo can0 5`.
fn action(words: &[&str]) -> Action {
    let line = ["sdo", "can0", "5"].iter().chain(words);
    Line::try_parse_from(line).unwrap().sdo.action
}

fn drive() -> DriveNodeConfig {
    DriveNodeConfig {
        domain_len: 1000,
        ..DriveNodeConfig::new(node(5))
    }
}

fn lab() -> Lab {
    let mut lab = Lab::new();
    lab.add_drive(drive());
    lab.run(10);
    lab
}

fn run(lab: &mut Lab, words: &[&str]) -> Result<Report, SdoError> {
    perform(lab, node(5), &action(words), Some(500)).unwrap()
}

fn text(lab: &mut Lab, words: &[&str]) -> String {
    let report = run(lab, words).unwrap();
    assert!(report.good, "{report:?}");
    report.text
}

/// A file that is removed at the end of its test.
struct TempFile(PathBuf);

impl TempFile {
    fn new(name: &str) -> Self {
        Self(std::env::temp_dir().join(format!("takt-sdo-{}-{name}", std::process::id())))
    }

    fn path(&self) -> &str {
        self.0.to_str().unwrap()
    }
}

impl Drop for TempFile {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

#[test]
fn sdo_upload_by_number_and_name_prints_value() {
    let mut lab = lab();
    let status = text(&mut lab, &["upload", "6041"]);
    assert!(status.starts_with("6041h:00 "), "{status}");
    assert!(
        status.contains("= 592 (0250h)  0x0250 voltage-enabled+switch-on-disabled+remote"),
        "{status}"
    );
    let serial = text(&mut lab, &["upload", "serial number"]);
    assert!(
        serial.ends_with("serial number = 5 (00000005h)"),
        "{serial}"
    );
    let name = text(&mut lab, &["upload", "1008", "--block"]);
    assert!(name.ends_with("= \"Takt emulated drive\""), "{name}");
    let json = text(&mut lab, &["upload", "1018:02", "--json"]);
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(json["bytes"], json!([2, 4, 0, 0]));
    assert_eq!(
        (&json["node"], &json["type"]),
        (&5.into(), &"UNSIGNED32".into())
    );
    let forced = text(&mut lab, &["upload", "1018:02", "--type", "bytes"]);
    assert!(forced.ends_with("= 02 04 00 00"), "{forced}");
}

#[test]
fn sdo_download_writes_value_and_reports_abort() {
    let mut lab = lab();
    let written = text(&mut lab, &["download", "1017", "250"]);
    assert!(written.ends_with("= 250 (00FAh)"), "{written}");
    assert!(text(&mut lab, &["upload", "1017"]).contains("250"));
    let refused = run(&mut lab, &["download", "6041", "0"]).unwrap_err();
    assert!(
        refused
            .to_string()
            .contains("the object can only be read (0601 0002h)"),
        "{refused}"
    );
    let refused = run(&mut lab, &["upload", "5FFF"]).unwrap_err();
    assert!(
        refused.to_string().contains("there is no such object"),
        "{refused}"
    );
    for (words, why) in [
        (
            &["download", "1017", "70000"][..],
            "does not fit UNSIGNED16",
        ),
        (&["download", "5FFF", "1"], "give --type"),
        (&["upload", "nonsense!"], "is not an object"),
    ] {
        let error = perform(&mut lab, node(5), &action(words), None).unwrap_err();
        assert!(format!("{error:#}").contains(why), "{error:#}");
    }
}

#[test]
fn sdo_file_is_written_and_read_back() {
    let mut lab = lab();
    let (to, from) = (TempFile::new("to"), TempFile::new("from"));
    let bytes: Vec<u8> = (0..1000_u32).map(|n| (n * 7).to_le_bytes()[0]).collect();
    std::fs::write(&to.0, &bytes).unwrap();
    let output = text(
        &mut lab,
        &["download", "2000", "--file", to.path(), "--block"],
    );
    assert!(output.contains("1000 bytes of"), "{output}");
    let output = text(&mut lab, &["upload", "2000", "--output", from.path()]);
    assert!(output.contains("1000 bytes in"), "{output}");
    assert_eq!(std::fs::read(&from.0).unwrap(), bytes);
}

#[test]
fn sdo_node_is_dumped_and_compared() {
    let mut lab = lab();
    let (eds, dcf) = (TempFile::new("eds"), TempFile::new("dcf"));
    std::fs::write(&eds.0, drive().eds().print()).unwrap();
    // The factory settings are the defaults of its data sheet.
    let output = text(&mut lab, &["compare", eds.path()]);
    assert!(
        output.ends_with(" differ") && output.contains(", 0 differ"),
        "{output}"
    );
    text(&mut lab, &["download", "6083", "4321"]);
    let dumped = text(
        &mut lab,
        &["dump", "--eds", eds.path(), "--dcf", dcf.path()],
    );
    assert!(dumped.contains("entries read, 0 refused"), "{dumped}");
    let file = Eds::parse(&std::fs::read_to_string(&dcf.0).unwrap()).unwrap();
    assert_eq!((file.node, file.kbit), (Some(node(5)), Some(500)));
    assert_eq!(file.remarks, []);
    assert!(text(&mut lab, &["compare", dcf.path()]).contains(", 0 differ"));
    text(&mut lab, &["download", "6083", "99"]);
    let differs = run(&mut lab, &["compare", dcf.path()]).unwrap();
    assert!(!differs.good);
    let first = differs.text.lines().next().unwrap();
    assert!(
        first.starts_with("6083h:00 ") && first.contains("file 4321") && first.contains("node 99")
    );
    assert!(differs.text.ends_with(", 1 differ"), "{}", differs.text);
    let json = run(&mut lab, &["compare", dcf.path(), "--json"]).unwrap();
    let json: serde_json::Value = serde_json::from_str(&json.text).unwrap();
    assert_eq!(
        (&json["equal"], &json["differences"][0]["node"]),
        (&false.into(), &json!([99, 0, 0, 0]))
    );
}

/// The data sheet of another product is named, compares as different, and writes nothing.
#[test]
fn sdo_data_sheet_of_another_product_is_rejected() {
    let mut lab = lab();
    let eds = TempFile::new("stranger");
    let mut other = drive();
    other.identity.product = 0x999;
    std::fs::write(&eds.0, other.eds().print()).unwrap();
    let compared = run(&mut lab, &["compare", eds.path()]).unwrap();
    assert!(!compared.good);
    let first = compared.text.lines().next().unwrap();
    assert!(
        first.contains("its product is 999h, 1018h:02 of the node is 402h"),
        "{first}"
    );
    let written = run(&mut lab, &["download", "6083", "7", "--eds", eds.path()]).unwrap();
    assert!(!written.good && written.text.contains("nothing was written"));
    let read = text(&mut lab, &["upload", "6083", "--eds", eds.path()]);
    assert!(!read.contains("= 7"), "{read}");
}

#[test]
fn sdo_missing_object_is_reported_and_timeout_ends() {
    let mut lab = lab();
    let eds = TempFile::new("two");
    let mut two = drive();
    two.axes.push(two.axes[0].clone());
    std::fs::write(&eds.0, two.eds().print()).unwrap();
    let dumped = text(&mut lab, &["dump", "--eds", eds.path()]);
    assert!(
        dumped.contains("node 5 refuses 6840h:00: there is no such object"),
        "{dumped}"
    );
    let differs = run(&mut lab, &["compare", eds.path()]).unwrap();
    assert!(
        !differs.good && differs.text.contains("node 5 refuses 6860h:00"),
        "{}",
        differs.text
    );
    lab.at(0, |devices| devices[0] = crate::can::lab::Device::Nothing);
    assert!(run(&mut lab, &["dump"]).unwrap_err().is_timeout());
    assert!(
        run(&mut lab, &["compare", eds.path()])
            .unwrap_err()
            .is_timeout()
    );
}

#[test]
fn sdo_objects_beyond_communication_can_move() {
    assert!(!can_move(Address::new(0x1017, 0)));
    assert!(can_move(Address::new(0x6040, 0)) && can_move(Address::new(0x2000, 0)));
}

#[test]
fn sdo_settings_are_stored_and_restored() {
    let mut lab = lab();
    let reset = |lab: &mut Lab| {
        let frame = takt_can::canopen::NmtCommand::ResetNode.frame(None);
        Wire::send(lab, &frame).unwrap();
        lab.run(50);
    };
    text(&mut lab, &["download", "6083", "4321"]);
    text(&mut lab, &["download", "607A", "777"]);
    assert_eq!(text(&mut lab, &["store"]), "node 5: stored");
    reset(&mut lab);
    assert!(text(&mut lab, &["upload", "6083"]).contains("4321"));
    // A target position is not a setting.
    assert!(text(&mut lab, &["upload", "607A"]).ends_with("= 0 (00000000h)"));
    assert!(text(&mut lab, &["restore", "application"]).contains("after its next reset"));
    reset(&mut lab);
    assert!(text(&mut lab, &["upload", "6083"]).contains("400000"));
    assert!(Line::try_parse_from(["sdo", "can0", "5", "store", "some"]).is_err());
}

#[test]
fn sdo_stored_data_sheet_serves_as_eds() {
    let file = TempFile::new("stored.eds");
    let mut without = lab();
    let refused = run(&mut without, &["eds", file.path()]).unwrap_err();
    assert!(refused.to_string().contains("node 5 refuses 1021h:00"));
    let mut lab = Lab::new();
    lab.add_drive(DriveNodeConfig {
        stored_eds: true,
        ..drive()
    });
    lab.run(10);
    let output = text(&mut lab, &["eds", file.path()]);
    assert!(output.contains("product 00000402h"), "{output}");
    let own = std::fs::read_to_string(file.path()).unwrap();
    assert_eq!(own, drive().eds().print());
    let read = text(&mut lab, &["upload", "domain", "--eds", file.path()]);
    assert!(read.starts_with("2000h:00 domain = "), "{read}");
}
