//! The checksum of block transfers: CRC-16 with polynomial 1021h, begun at zero (CiA 301, clause
//! 7.2.4.3.16). Not for frames; those have their own in hardware.

/// The checksum over `data`, going on from that of what came before (0 at the beginning).
#[must_use]
pub fn crc(before: u16, data: &[u8]) -> u16 {
    let bit = |crc: u16| crc << 1 ^ if crc & 0x8000 == 0 { 0 } else { 0x1021 };
    data.iter().fold(before, |crc, byte| {
        (0..8).fold(crc ^ u16::from(*byte) << 8, |crc, _| bit(crc))
    })
}

#[cfg(test)]
mod tests {
    #[test]
    fn check_value() {
        assert_eq!(super::crc(0, b"123456789"), 0x31C3);
        assert_eq!(super::crc(super::crc(0, b"1234"), b"56789"), 0x31C3);
    }
}
