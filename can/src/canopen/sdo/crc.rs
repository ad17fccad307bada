//! The checksum of block transfers: CRC-16 with polynomial 1021h and initial value 0 (CiA 301,
//! clause 7.2.4.3.16).

/// Updates a checksum with `data`; the initial value is 0.
pub fn crc(before: u16, data: &[u8]) -> u16 {
    let bit = |crc: u16| crc << 1 ^ if crc & 0x8000 == 0 { 0 } else { 0x1021 };
    data.iter().fold(before, |crc, byte| {
        (0..8).fold(crc ^ u16::from(*byte) << 8, |crc, _| bit(crc))
    })
}

#[cfg(test)]
mod tests {
    #[test]
    fn sdo_crc_matches_check_value() {
        assert_eq!(super::crc(0, b"123456789"), 0x31C3);
        assert_eq!(super::crc(super::crc(0, b"1234"), b"56789"), 0x31C3);
    }
}
