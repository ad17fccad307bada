//! Numbers of 128 bits that cannot be guessed and do not repeat: boot ids, nonces, ids of openings. In messages they are 32
//! hexadecimal digits, since a JSON number loses digits in many programs. They encrypt nothing.

use std::fmt;
use std::hash::{BuildHasher as _, RandomState};

use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error as _};

/// Digits of such a number in a message.
const DIGITS: usize = 32;

fn parse(text: &str) -> Option<u128> {
    let is_digit = |b: u8| b.is_ascii_digit() || (b'a'..=b'f').contains(&b);
    if text.len() != DIGITS || !text.bytes().all(is_digit) {
        return None;
    }
    u128::from_str_radix(text, 16).ok()
}

macro_rules! id {
    ($name:ident, $doc:literal) => {
        #[doc = $doc]
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub struct $name(pub u128);

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "{:032x}", self.0)
            }
        }

        impl Serialize for $name {
            fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
                to.collect_str(self)
            }
        }

        impl<'de> Deserialize<'de> for $name {
            fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
                let text = String::deserialize(from)?;
                let id = parse(&text).map(Self);
                id.ok_or_else(|| D::Error::custom("expected 32 hexadecimal digits in lower case"))
            }
        }
    };
}

id!(
    Boot,
    "One run of a controller: another after each start of its process, so that no message of an earlier run counts."
);
id!(
    Nonce,
    "Permission that a controller granted for a short time of its own monotonic clock."
);
id!(
    OpenId,
    "The client's number of one opening, by which a repeated request opens no second session."
);

/// Source of numbers that cannot be guessed; tests pass their own.
pub type Entropy = Box<dyn FnMut() -> u128 + Send>;

/// Numbers from a keyed hash (SipHash) of a counter; its key of 128 bits comes from the operating system once.
#[must_use]
pub fn random() -> Entropy {
    let key = RandomState::new();
    let mut count = 0_u64;
    Box::new(move || {
        count += 1;
        let half = |which: u8| u128::from(key.hash_one((count, which)));
        (half(0) << 64) | half(1)
    })
}
id!(
    Txn,
    "Number of one coordinated start, chosen by its initiator."
);
