//! EEPROMs of emulated slaves, read, decoded and written in virtual time.

use takt_ethercat::AlState;
use takt_ethercat::emulator::Profile;
use takt_ethercat::sii::{Sii, checksum};

use super::{Change, read, text, write};
use crate::ecat::session::Session;
use crate::ecat::tests::{Emulated, tree, up};

const DRIVE: usize = 1;

fn image(session: &mut Session<Emulated>) -> Vec<u8> {
    read(session, DRIVE).unwrap().unwrap()
}

/// Writes a change and reads the whole EEPROM back.
fn changed(session: &mut Session<Emulated>, change: &Change) -> Vec<u8> {
    let present = image(session);
    let words = change.words(&present).unwrap();
    write(session, DRIVE, &words, &present).unwrap().unwrap();
    image(session)
}

#[test]
fn sii_text_has_every_category() {
    let mut session = up(tree(), AlState::PreOp);
    let image = image(&mut session);
    assert_eq!(image.len(), 2048);
    let text = text("drive", &image);
    for line in [
        "  identity    vendor 00007A87h product 00004021h revision 00010000h serial 1",
        "  PDI         control 08h (16 bit microcontroller, asynchronous), configuration 0000h",
        "  controller  DC SYNC unit, DC latch unit, SYNC pulse 1000 ns",
        "  mailbox     receives at 1000h 128 bytes, sends at 1080h 128 bytes",
        "  protocols   CoE",
        "  name        \"TK4021 servo\", order \"TK4021\", group -, picture -",
        "  CoE         SDO, information, PDO assignment, PDO configuration, complete access",
        "  ports       MII, MII, -, -",
        "  FMMU 2  mailbox state",
        "  SyncManager 2  outputs     at 1100h, 14 bytes, control 64h",
        "    607Ah:00   32 bits  INTEGER32",
        "  \"DC-Synchron\": AssignActivate 0300h, SYNC0 each the master's cycle (factor 0), shift 0 ns; SYNC1 factor 0, shift 0 ns",
    ] {
        assert!(text.lines().any(|other| other == line), "{line}\n{text}");
    }
    assert!(!text.contains('!'), "{text}");
    let used = Sii::new(&image).used().unwrap();
    for len in 0..used {
        let cut = super::text("cut", &image[..len]);
        assert!(cut.contains("! the end category is missing"), "{len}");
    }
    // The recorded file of the command line tests.
    let recorded = include_bytes!("../../../tests/ecat/drive.sii");
    assert!(
        image == recorded,
        "regenerate it by `takt ecat sii IFACE SLAVE --raw`"
    );
}

#[test]
fn sii_alias_is_written_to_slow_eeprom() {
    // Both chips reject commands while they store: one reads eight bytes at once, the other four.
    for device in [Profile::El3004, Profile::Akd] {
        let (segment, _) = Profile::line(&[Profile::Ek1100, device], 2).unwrap();
        let mut session = up(segment, AlState::PreOp);
        let after = changed(&mut session, &Change::Alias(0x1234));
        let sii = Sii::new(&after);
        assert_eq!(
            (sii.word(4), sii.is_checked()),
            (Some(0x1234), true),
            "{device}"
        );
    }
}

#[test]
fn sii_alias_changes_only_alias_and_checksum() {
    let mut session = up(tree(), AlState::PreOp);
    let before = image(&mut session);
    let after = changed(&mut session, &Change::Alias(0x1234));
    let sii = Sii::new(&after);
    assert_eq!((sii.word(4), sii.is_checked()), (Some(0x1234), true));
    let differ = before.iter().zip(&after).enumerate();
    let differ: Vec<usize> = differ
        .filter(|(_, (a, b))| a != b)
        .map(|(at, _)| at)
        .collect();
    assert_eq!(differ, [8, 9, 14]);
    let again = Change::Alias(0x1234).words(&after).unwrap();
    assert!(again.is_empty());
}

/// Changes the alias while the EEPROM accepts one write and refuses the following.
fn refused(refuses: u32) -> (Vec<u8>, Vec<u8>, Result<String, String>) {
    let mut session = up(tree(), AlState::PreOp);
    let before = image(&mut session);
    let words = Change::Alias(0x1234).words(&before).unwrap();
    let slave = session.wire().segment.slave(2).unwrap();
    slave.faults().refuse_sii_writes = (1, refuses);
    let done = write(&mut session, DRIVE, &words, &before).unwrap();
    let slave = session.wire().segment.slave(2).unwrap();
    (before, slave.eeprom().to_vec(), done)
}

#[test]
fn sii_write_repeats_until_eeprom_acknowledges() {
    let (before, after, done) = refused(600);
    done.unwrap();
    assert_ne!(before, after);
    assert!(Sii::new(&after).is_checked());
}

#[test]
fn sii_write_that_fails_restores_former_content() {
    let (before, after, done) = refused(2000);
    let text = done.unwrap_err();
    assert_eq!(before, after);
    assert!(text.contains("acknowledges no command"), "{text}");
    assert!(text.ends_with("has its former content again"), "{text}");
    let (before, after, done) = refused(u32::MAX);
    let text = done.unwrap_err();
    assert_ne!(before, after);
    assert!(
        text.contains("the former ones cannot be restored"),
        "{text}"
    );
    assert!(text.contains("hint: repeat the command before"), "{text}");
}

#[test]
fn sii_of_erased_eeprom_is_written() {
    let mut session = up(tree(), AlState::PreOp);
    let good = image(&mut session);
    let mut segment = tree();
    segment.slave(2).unwrap().eeprom_mut().fill(0xFF);
    segment.set_power(2, false);
    segment.set_power(2, true);
    let mut session = up(segment, AlState::PreOp);
    let drive = (0..3)
        .find(|number| {
            session
                .master()
                .slave(*number)
                .unwrap()
                .info()
                .identity
                .vendor
                == u32::MAX
        })
        .unwrap();
    let erased = read(&mut session, drive).unwrap().unwrap();
    let shown = text("drive", &erased);
    assert!(shown.contains("! checksum    FFh"), "{shown}");
    let words = Change::Image(good.clone()).words(&erased).unwrap();
    let (first, last) = (words.first().unwrap().0, words.last().unwrap().0);
    assert!(first >= 8 && last == 7, "{first} {last}");
    write(&mut session, drive, &words, &erased)
        .unwrap()
        .unwrap();
    assert_eq!(read(&mut session, drive).unwrap().unwrap(), good);
}

#[test]
fn sii_file_of_another_slave_is_rejected() {
    let mut session = up(tree(), AlState::PreOp);
    let present = image(&mut session);
    let mut other = present.clone();
    other[20] ^= 1;
    let mut broken = present.clone();
    broken[2] ^= 1;
    let expected = format!("instead of {:02X}h", checksum(&broken[..14]));
    for (image, cause) in [
        (other, "the EEPROM of another slave"),
        (broken, expected.as_str()),
        (vec![0; 127], "the file has 127 bytes"),
        (
            [present.clone(), vec![0; 2]].concat(),
            "the EEPROM only 2048",
        ),
    ] {
        let error = Change::Image(image)
            .words(&present)
            .unwrap_err()
            .to_string();
        assert!(error.contains(cause), "{error}");
    }
}
