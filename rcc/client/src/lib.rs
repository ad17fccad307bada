#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod client;
pub mod error;
pub mod local;
pub mod token;
pub mod wire;

pub use client::{Client, Reply};
pub use error::{Conflict, Error};
pub use token::{Token, TokenError};
pub use wire::{Message, Value};
