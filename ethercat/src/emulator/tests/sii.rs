//! The SII interface, as masters use it: command and address in one write of 4, 6 or 8 bytes.

use super::*;
use crate::sii::Sii;

fn control(bench: &mut Bench, station: u16) -> u16 {
    u16::from_le_bytes(bench.read(station, register::SII_CONTROL))
}

/// Reads eight bytes at a word address as SOEM and ethercrab do.
fn read(bench: &mut Bench, word: u32) -> [u8; 8] {
    let [a, b, c, d] = word.to_le_bytes();
    bench.write(0x1002, register::SII_CONTROL, &[0, 1, a, b, c, d]);
    assert_eq!(control(bench, 0x1002) & 0x8000, 0x8000, "busy");
    bench.now += MS;
    assert_eq!(control(bench, 0x1002), 0x0040);
    bench.read(0x1002, register::SII_DATA)
}

#[test]
fn sii_image_can_be_read_completely() {
    let (mut bench, _) = Bench::small();
    let image: Vec<u8> = (0..1024 / 4)
        .flat_map(|n| read(&mut bench, 4 * n))
        .collect();
    assert_eq!(image, bench.segment.slave(2).unwrap().eeprom());
    let sii = Sii::new(&image);
    assert!(sii.is_checked());
    assert_eq!(sii.string(1), Some("TK0808"));
    assert_eq!(sii.sync_managers().count(), 2);
    assert_eq!(read(&mut bench, 0x0001_0000), [0xFF; 8], "beyond its end");
}

#[test]
fn sii_broadcast_read_and_four_byte_address() {
    let (mut bench, _) = Bench::small();
    // KickCAT commands all slaves by one BWR; IgH writes control and 16 bits of address.
    bench.device(Command::Bwr, 0, register::SII_CONTROL, &[0, 1, 8, 0]);
    bench.now += MS;
    let products: Vec<[u8; 10]> = (0..3)
        .map(|n| bench.read(0x1000 + n, register::SII_CONTROL))
        .collect();
    assert_eq!(
        products[0][6..10],
        super::super::terminal::VENDOR.to_le_bytes()
    );
    assert_eq!(
        products[2][6..10],
        super::super::terminal::VENDOR.to_le_bytes()
    );
    assert_eq!(products[1][..2], [0x40, 0]);
}

#[test]
fn sii_write_requires_write_enable() {
    let (mut bench, _) = Bench::small();
    let mut write = |enable: u8, word: u16, value: u16| {
        let ([a, b], [c, d]) = (word.to_le_bytes(), value.to_le_bytes());
        let bytes = [enable, 2, a, b, 0, 0, c, d];
        bench.write(0x1002, register::SII_CONTROL, &bytes);
        bench.now += 5 * MS;
        control(&mut bench, 0x1002)
    };
    assert_eq!(write(0, 4, 0x1234), 0x4040, "no write enable");
    assert_eq!(write(1, 4, 0x1234), 0x0040);
    assert_eq!(write(1, 0x7FFF, 1), 0x2040, "no such word");
    assert_eq!(read(&mut bench, 4)[..2], [0x34, 0x12]);
    assert_eq!(
        bench.read::<2>(0x1002, register::STATION_ALIAS),
        [0, 0],
        "not loaded yet"
    );
    // With the old checksum the reload is refused.
    bench.write(0x1002, register::SII_CONTROL, &[0, 4]);
    bench.now += MS;
    assert_eq!(control(&mut bench, 0x1002), 0x0840);
    assert_eq!(bench.read::<2>(0x1002, register::STATION_ALIAS), [0, 0]);
}

#[test]
fn sii_owned_by_firmware_refuses_until_taken() {
    let (mut bench, _) = Bench::small();
    bench.segment.slave(2).unwrap().faults().sii_held = true;
    bench.write(0x1002, register::SII_CONTROL, &[0, 1, 8, 0]);
    assert_eq!(control(&mut bench, 0x1002), 0x2040);
    assert_eq!(bench.read::<1>(0x1002, 0x0501), [1]);
    bench.write(0x1002, register::SII_ACCESS, &[2]);
    bench.write(0x1002, register::SII_CONTROL, &[0, 1, 8, 0]);
    bench.now += MS;
    assert_eq!(control(&mut bench, 0x1002), 0x0040);
    // Given to the firmware by the master itself.
    bench.write(0x1002, register::SII_ACCESS, &[1]);
    bench.write(0x1002, register::SII_CONTROL, &[0, 1, 8, 0]);
    assert_eq!(control(&mut bench, 0x1002), 0x2040);
    bench.write(0x1002, register::SII_ACCESS, &[0]);
    bench.write(0x1002, register::SII_CONTROL, &[0, 0]);
    assert_eq!(
        control(&mut bench, 0x1002),
        0x0040,
        "command 0 clears errors"
    );
}

#[test]
fn sii_checksum_error_is_reported_at_power_on() {
    let (mut bench, _) = Bench::small();
    let slave = bench.segment.slave(1).unwrap();
    slave.eeprom_mut()[3] ^= 0xFF;
    bench.segment.set_power(1, false);
    bench.segment.set_power(1, true);
    bench.address();
    assert_eq!(control(&mut bench, 0x1001) & 0x0800, 0x0800);
    assert_eq!(control(&mut bench, 0x1000) & 0x0800, 0);
}
