#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod access;
pub mod client;
mod codec;
mod dio;
pub mod error;
mod http;
pub mod log;
pub mod server;
mod sessions;
mod site;
pub mod wire;

pub use access::Token;
pub use client::{Client, Reply};
pub use error::Error;
#[doc(hidden)]
pub use http::fuzz as fuzz_http;
#[doc(hidden)]
pub use http::fuzz_head as fuzz_http_head;
pub use log::LogBook;
pub use server::local::{self, LocalSocket};
pub use server::{Loopback, OnLoss, Server, ServerConfig};
pub use site::StopPort;
pub use wire::{Message, Value};
