#![doc = include_str!("../README.md")]
#![deny(unsafe_code)]

pub mod axis;
pub mod config;
pub mod dc;
#[cfg(feature = "emulator")]
pub mod emulator;
pub mod encoder;
mod error;
pub mod link;
#[cfg(target_os = "linux")]
pub mod linux;
pub mod master;
pub mod topology;
mod wire;
pub mod youbot;

pub use error::{DecodeError, EncodeError};
pub use wire::{
    Address, AlState, AlStatus, AlStatusCode, CoeService, Command, Datagram, DatagramHeader,
    Datagrams, Emergency, Fmmu, Frame, FrameHeader, FrameWriter, MailboxError, MailboxHeader,
    MailboxKind, SyncManager, WorkingCounter, coe, eoe, foe, register, sii,
};
