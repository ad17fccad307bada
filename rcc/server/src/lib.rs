#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod client;
mod codec;
pub mod dio;
pub mod error;
mod http;
pub mod server;
pub mod wire;

pub use client::{Client, Reply};
pub use error::Error;
#[doc(hidden)]
pub use http::fuzz as fuzz_http;
pub use server::{OnLoss, Server, ServerConfig};
pub use wire::{Message, Value};
