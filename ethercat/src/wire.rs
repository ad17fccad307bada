//! Bytes to values and back, one file per layer. No clock, no socket, no allocation.

// Bytes come from outside; tests index their own.
#![cfg_attr(not(test), warn(clippy::indexing_slicing))]

mod command;
mod datagram;
mod frame;
mod writer;

pub use command::Command;
pub use datagram::{Address, Datagram, DatagramHeader, WorkingCounter};
pub use frame::{Datagrams, Frame, FrameHeader};
pub use writer::FrameWriter;

/// Lengths on the wire have eleven bits.
const LENGTH_MASK: u16 = 0x07FF;
