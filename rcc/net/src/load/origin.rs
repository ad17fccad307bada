//! The out port at which a link starts. Built ports are addressed by it without the rest of the resolved net.

/// The out port of a primitive.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Origin {
    pub(super) node: u32,
    pub(super) port: u32,
}

/// The number of the next primitive, unit or scope after `len` others.
pub(super) fn number(len: usize) -> u32 {
    u32::try_from(len).expect("Limits bounds the number of primitives far below 2^32")
}
