//! Arguments that several commands read alike: node numbers and bit rates.

use takt_can::canopen::NodeId;

/// Reads a node number of the command line.
pub(super) fn node(text: &str) -> Result<NodeId, String> {
    let raw = text.parse::<u8>().ok();
    raw.and_then(|raw| NodeId::new(raw).ok())
        .ok_or_else(|| format!("`{text}` is not a node number; they are 1 to 127"))
}

/// Reads a bit rate of the command line: `500k`, `1M`, or bit/s.
pub(super) fn bitrate(text: &str) -> Result<u32, String> {
    let (digits, unit) = match text.strip_suffix(['k', 'K']) {
        Some(digits) => (digits, 1_000),
        None => match text.strip_suffix('M') {
            Some(digits) => (digits, 1_000_000),
            None => (text, 1),
        },
    };
    let rate = digits
        .parse::<u32>()
        .ok()
        .and_then(|rate| rate.checked_mul(unit));
    rate.filter(|rate| (1_000..=20_000_000).contains(rate))
        .ok_or_else(|| format!("`{text}` is not a bit rate\nhint: write 500k, 1M, or bit/s"))
}
