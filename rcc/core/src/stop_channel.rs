//! The stop that works independently of the server: a switch of atomic words that every net thread reads at the start
//! of its cycle, and a channel of its own to it, a Unix socket and a TCP port, served by one thread that shares no lock, no
//! allocation and no runtime with the server. It does not brake itself and is not a safety function.
//!
//! The thread exists before all others of the controller and runs above net threads and drivers. Below them, a thread
//! that occupies a whole processor, one of the reasons to press stop, would block the stop; above
//! them, its own load must be bounded: it accepts at most 128 connections in 10 ms,
//! each of one short request, and sleeps between.
//!
//! A stop is latched: all nets end, earlier requests are discarded, and nothing starts until the
//! stop is released. The release starts nothing: programs repeat their requests. A momentary stop was the
//! alternative; a program that retries would resume motion while the button is still pressed.

mod answer;
mod folder;
mod http;
mod listener;
mod switch;

pub use listener::{PRIORITY, StopChannel, StopChannelConfig, default_socket, socket_folders};
pub use switch::{Generation, Origin, StopSwitch, ThreadAnswer};
