#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod error;
mod wire;

pub use error::{DecodeError, EncodeError};
pub use wire::{
    Address, Command, Datagram, DatagramHeader, Datagrams, Frame, FrameHeader, FrameWriter,
    WorkingCounter,
};
