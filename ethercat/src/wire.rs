//! Encoding and decoding of the wire formats, one file per layer. No clock, no socket, and no allocation but in the settings of
//! Ethernet ports and the buffer of their frames, which are made once.

// Received bytes are untrusted; tests index their own.
#![cfg_attr(not(test), warn(clippy::indexing_slicing))]

mod al;
pub mod coe;
mod command;
mod datagram;
pub mod eoe;
pub mod foe;
mod frame;
mod mailbox;
pub mod register;
pub mod sii;
mod writer;

pub use al::{AlState, AlStatus, AlStatusCode};
pub use command::Command;
pub use datagram::{Address, Datagram, DatagramHeader, WorkingCounter};
pub use frame::{Datagrams, Frame, FrameHeader};
pub use mailbox::{CoeService, Emergency, MailboxError, MailboxHeader, MailboxKind};
pub use register::{Fmmu, SyncManager};
pub use writer::FrameWriter;

/// Lengths on the wire have eleven bits.
const LENGTH_MASK: u16 = 0x07FF;
