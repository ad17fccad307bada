//! What a net may at most be, so that no client can make loading or a cycle unbounded.

use std::time::Duration;

/// Upper bounds on one net. A net beyond one is refused with a text that names the bound.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Bytes of net text.
    pub text_bytes: usize,
    /// Primitives in the net, inline ones included.
    pub primitives: usize,
    /// Fragments or inline primitives inside one another.
    pub depth: usize,
    /// Elements of one array.
    pub array_size: usize,
    /// Netcomm values, in and out together.
    pub netcomm: usize,
    /// Time that one cycle of the net may cost at most; `None` for any.
    pub cost: Option<Duration>,
    /// Samples that one primitive may keep of the past.
    pub history: usize,
    /// Bytes of all arrays and histories together.
    pub memory_bytes: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            text_bytes: 16 << 20,
            primitives: 200_000,
            depth: 64,
            array_size: 1024,
            netcomm: 4096,
            cost: None,
            history: 60_000,
            memory_bytes: 256 << 20,
        }
    }
}
