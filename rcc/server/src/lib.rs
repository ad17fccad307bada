#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod access;
mod codec;
mod dio;
pub mod error;
mod host_program;
mod http;
mod live;
pub mod log;
mod scope;
pub mod server;
mod sessions;
mod site;
mod threads;
mod websocket;

pub use error::Error;
pub use host_program::{HostProgram, JogKind};
#[doc(hidden)]
pub use http::fuzz as fuzz_http;
#[doc(hidden)]
pub use http::fuzz_head as fuzz_http_head;
pub use live::LiveConfig;
#[doc(hidden)]
pub use live::fuzz as fuzz_live;
pub use log::LogBook;
pub use scope::SCOPES_MAX;
#[doc(hidden)]
pub use scope::fuzz as fuzz_scope;
pub use server::local::{self, LocalSocket};
pub use server::{Loopback, OnLoss, Server, ServerConfig};
pub use site::StopPort;
pub use threads::ServerThreads;
#[doc(hidden)]
pub use websocket::fuzz as fuzz_frames;
