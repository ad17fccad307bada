#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod error;
mod wire;

pub use error::{DecodeError, EncodeError};
pub use wire::{
    Address, AlState, AlStatus, AlStatusCode, CoeService, Command, Datagram, DatagramHeader,
    Datagrams, Emergency, Fmmu, Frame, FrameHeader, FrameWriter, MailboxError, MailboxHeader,
    MailboxKind, SyncManager, WorkingCounter, coe, register, sii,
};
