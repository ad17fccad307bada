//! The stop that always gets through: a switch of atomic words that every net thread reads at the beginning of its
//! cycle, and a channel of its own to it, a Unix socket and a TCP port, served by one thread that shares no lock, no
//! allocation and no runtime with the server. It brakes nothing itself and is no safety function.
//!
//! The thread exists before all others of the controller and runs above net threads and drivers. Below them, a thread
//! that takes a whole processor, which is one of the reasons to press stop, would keep the stop away; above
//! them, what it may take from them must be bounded: it takes at most 128 connections in 10 ms,
//! each of one short request, and sleeps between.
//!
//! A stop is latched: all nets end, what was requested before does not happen after, and nothing starts until the
//! stop is released. The release starts nothing: programs request again. A momentary stop was the
//! alternative; a program that retries would be back in motion before the hand has left the button.

mod answer;
mod folder;
mod http;
mod listener;
mod switch;

pub use listener::{PRIORITY, StopChannel, StopChannelConfig, default_socket, socket_folders};
pub use switch::{Generation, Origin, StopSwitch, ThreadAnswer};
