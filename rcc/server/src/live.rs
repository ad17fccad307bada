//! Live data for other tools: the Foxglove WebSocket protocol, and samples of probes in UDP datagrams. Messages are those of a recording
//! ([`LiveStream`](takt_core::record::LiveStream)). A thread of its own drains the rings of the controller; a slow client loses
//! messages, which are counted, and never delays the controller.
//!
//! The crate `foxglove` has this protocol too, but checks neither the origin of a page nor a token, bounds neither connections nor
//! subscriptions, and takes no accepted connection. Here it shares admission, slots and frames with the other ports of this server.

mod actions;
mod drain;
pub(crate) mod hub;
mod udp;
pub(crate) mod wire;

use std::net::SocketAddr;

pub(crate) use actions::Actions;
pub(crate) use drain::{Drain, Loss, Messages, Task};
pub(crate) use hub::{Client, Hub};
pub(crate) use udp::Datagrams;
#[doc(hidden)]
pub use wire::fuzz;

/// What is sent to other tools.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LiveConfig {
    /// Address of the Foxglove WebSocket; `None` disables it.
    pub foxglove: Option<SocketAddr>,
    /// Whether its clients may start, cancel and abort nets and stop the controller.
    pub services: bool,
    /// Page origins that may connect, such as `https://app.foxglove.dev`.
    pub origins: Vec<String>,
    /// Where samples of [`probes`](Self::probes) are sent as JSON, a datagram for each cycle; `None` disables it.
    pub udp: Option<SocketAddr>,
    /// The probes whose samples are sent there.
    pub probes: Vec<String>,
    /// Only each n-th cycle is sent; 0 is the same as 1.
    pub every: u64,
}
