//! Bounds on the size and cost of a net, so that no client can make loading or a cycle unbounded.

use std::time::Duration;

/// Upper bounds on one net. A net that exceeds one is rejected with an error that names the bound.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Bytes of net text.
    pub text_bytes: usize,
    /// Primitives in the net, inline ones included.
    pub primitives: usize,
    /// Nesting depth of fragments or inline primitives.
    pub depth: usize,
    /// Elements of one array.
    pub array_size: usize,
    /// Netcomm values, in and out values together.
    pub netcomm: usize,
    /// Upper bound on the cost of one cycle; `None` for no bound.
    pub cost: Option<Duration>,
    /// Past samples that one primitive may keep.
    pub history: usize,
    /// Bytes of all arrays and histories together.
    pub memory_bytes: usize,
    /// Whether the root needs the out port `outTerminate`: a net that is evaluated once does not.
    pub terminate: bool,
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
            terminate: true,
        }
    }
}
