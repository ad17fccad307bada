//! The address filter of the Ethernet port of a slave, as EoE carries it.

use std::fmt;

use super::settings::mac;

/// Places for addresses and masks on the wire.
const ADDRESSES: usize = 16;
const MASKS: usize = 4;
/// Most addresses that the count can name.
const COUNT_MAX: usize = 15;
const MASK_COUNT_MAX: usize = 3;
const NO_BROADCASTS: u16 = 0x0080;

/// Which frames a port accepts.
///
/// | bytes | field |
/// |---|---|
/// | 0, 1 | bits 0 to 3 number of addresses, 4 and 5 number of masks, 7 no broadcasts |
/// | 2 to 97 | 16 MAC addresses |
/// | 98 to 121 | 4 masks |
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct AddressFilter {
    /// Accepted addresses, up to 15.
    pub addresses: Vec<[u8; 6]>,
    /// Masks of accepted addresses, up to 3.
    pub masks: Vec<[u8; 6]>,
    /// Broadcasts are not accepted.
    pub no_broadcasts: bool,
}

impl AddressFilter {
    /// Bytes on the wire.
    pub const LEN: usize = 2 + 6 * (ADDRESSES + MASKS);

    /// Decodes it; `None` if truncated.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let (word, rest) = bytes.get(..Self::LEN)?.split_first_chunk::<2>()?;
        let word = u16::from_le_bytes(*word);
        let (addresses, masks) = rest.split_at_checked(6 * ADDRESSES)?;
        let first = |bytes: &[u8], count: u16| -> Vec<[u8; 6]> {
            let all = bytes.chunks_exact(6).filter_map(|six| six.first_chunk());
            all.copied().take(count.into()).collect()
        };
        Some(Self {
            addresses: first(addresses, word & 0x0F),
            masks: first(masks, word >> 4 & 0x03),
            no_broadcasts: word & NO_BROADCASTS != 0,
        })
    }

    /// The bytes; `None` if it has too many addresses or masks.
    pub fn encode(&self) -> Option<Vec<u8>> {
        let count = |len: usize, most: usize| u16::try_from(len).ok().filter(|_| len <= most);
        let addresses = count(self.addresses.len(), COUNT_MAX)?;
        let masks = count(self.masks.len(), MASK_COUNT_MAX)?;
        let broadcasts = if self.no_broadcasts { NO_BROADCASTS } else { 0 };
        let mut bytes = (addresses | masks << 4 | broadcasts).to_le_bytes().to_vec();
        bytes.extend(self.addresses.iter().flatten());
        bytes.resize(2 + 6 * ADDRESSES, 0);
        bytes.extend(self.masks.iter().flatten());
        bytes.resize(Self::LEN, 0);
        Some(bytes)
    }
}

impl fmt::Display for AddressFilter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let parts = [("addresses", &self.addresses), ("masks", &self.masks)];
        for (what, list) in parts {
            write!(f, "{} {what}", list.len())?;
            for address in list {
                f.write_str(" ")?;
                mac(f, *address)?;
            }
            f.write_str(", ")?;
        }
        f.write_str(if self.no_broadcasts {
            "no broadcasts"
        } else {
            "broadcasts"
        })
    }
}
