//! The other end of a ring, when a command was given only one: frames leave the segment there instead of returning. It
//! sends nothing of its own.

use std::time::Duration;

use takt_ethercat::Frame;
use takt_ethercat::link::{FRAME_MAX, HEADER_LEN, Link};
use takt_ethercat::linux::PacketLink;

use super::session::{Session, Wire};

/// Frames that are sent while the other interfaces listen.
const FRAMES: usize = 50;
/// Most interfaces that listen.
const INTERFACES_MAX: usize = 64;

/// The other end of a ring.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct OtherEnd {
    interface: String,
    /// Slaves process frames on the way there; on the way back they only forward them.
    is_last: bool,
}

/// The interface at which frames of a silent session leave the segment.
pub(super) fn other_end<W: Wire>(session: &mut Session<W>) -> Option<OtherEnd> {
    if !session.master().is_empty() {
        return None;
    }
    // What another program drives, such as an emulated segment, is no free end.
    let open = |name: String| Some((PacketLink::open_locked(&name).ok()?, name));
    let others = interfaces(session.interface());
    let mut others: Vec<(PacketLink, String)> = others.filter_map(open).collect();
    for _ in 0..FRAMES {
        session.cycle().ok()?;
        for (link, name) in &mut others {
            if let Some(is_last) = passes(link) {
                let interface = name.clone();
                return Some(OtherEnd { interface, is_last });
            }
        }
    }
    None
}

/// Whether slaves have counted in a received frame; `None` without a frame.
fn passes(link: &mut PacketLink) -> Option<bool> {
    let mut frame = [0; FRAME_MAX];
    let received = link.receive(&mut frame, Duration::ZERO);
    let Ok(Some((len, _))) = received else {
        return None;
    };
    let frame = frame.get(HEADER_LEN..len).unwrap_or_default();
    let counted = |frame: Frame<'_>| {
        let mut datagrams = frame.datagrams().flatten();
        datagrams.any(|datagram| datagram.working_counter.raw() > 0)
    };
    Frame::decode(frame).ok().map(counted)
}

/// The other interfaces of this host that have a link.
fn interfaces(own: &str) -> impl Iterator<Item = String> {
    let all = nix::net::if_::if_nameindex();
    let names = all.iter().flatten().map(|interface| interface.name());
    let names = names.filter_map(|name| name.to_str().ok());
    let others = names.filter(|name| *name != own && crate::link::fault(name).is_none());
    let others: Vec<String> = others.take(INTERFACES_MAX).map(str::to_owned).collect();
    others.into_iter()
}

/// The error of a command that was given one end.
pub(super) fn one_end_of(interface: &str, other: &OtherEnd) -> anyhow::Error {
    let OtherEnd {
        interface: other,
        is_last,
    } = other;
    let (first, last) = if *is_last {
        (interface, other.as_str())
    } else {
        (other.as_str(), interface)
    };
    anyhow::anyhow!(
        "{interface}: frames leave the segment at {other}: it is a ring between both interfaces\nhint: name both ends: \
         `{first} --second {last}`"
    )
}

/// The error of a command that was given both ends in the wrong order.
pub(super) fn reversed(interface: &str, second: &str) -> anyhow::Error {
    anyhow::anyhow!(
        "{interface}: the first slave is at {second}, the other end of the ring\nhint: name it first: `{second} --second \
         {interface}`"
    )
}
