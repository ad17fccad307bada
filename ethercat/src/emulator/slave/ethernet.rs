//! The Ethernet port of a slave (EoE): its addresses, which a master sets, and a station that answers ARP, ping (ICMP echo)
//! and UDP echo (port 7). It is no router, and answers no fragments of IP.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::faults::happens;
use crate::MailboxHeader;
use crate::eoe::{
    AddressFilter, Eoe, EoeRequest, EoeResult, FRAME_MIN, Fragment, IpSettings, Reassembly,
};

/// Frames that wait for the mailbox; more are dropped, as with any small buffer.
const FRAMES_MAX: usize = 8;
/// Shortest frame without checksum, bytes.
const PADDED: usize = 60;
const ARP: [u8; 2] = [0x08, 0x06];
const IP: [u8; 2] = [0x08, 0x00];
const BROADCAST: [u8; 6] = [0xFF; 6];
/// The MAC address before a master has set one.
const DEFAULT_MAC: [u8; 6] = [0x02, 0, 0, 0, 0, 0x01];

/// Faults of an Ethernet port; those with a number are counted down as they happen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EthernetFaults {
    /// Number of fragments that are never sent.
    pub lose: u32,
    /// Number of fragments that are sent after the next one of their frame.
    pub swap: u32,
    /// Number of fragments with the number of another frame.
    pub wrong_frame: u32,
    /// Number of frames that are longer than their first fragment announces.
    pub too_long: u32,
    /// Number of requests that are refused, and the result.
    pub refuse: (u32, EoeResult),
    /// Number of frames received and left out, as by a busy station.
    pub deaf: u32,
    /// It supports no address filter.
    pub no_filter: bool,
    /// Frames are sent with a time stamp.
    pub stamps: bool,
}

impl Default for EoeResult {
    fn default() -> Self {
        Self::UNSPECIFIED
    }
}

/// The state of an Ethernet port.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct EthernetState {
    /// Its addresses.
    pub settings: IpSettings,
    /// Its address filter; `None` accepts all.
    pub filter: Option<AddressFilter>,
    /// Its faults.
    pub faults: EthernetFaults,
    /// Frames received and sent.
    pub received: u64,
    /// Frames sent.
    pub sent: u64,
    /// Frames received whose fragments do not fit together, and frames to send that found the buffer full.
    pub dropped: u64,
}

/// Access to the Ethernet port of a slave.
#[derive(Clone, Debug, Default)]
pub struct EthernetPort(Arc<Mutex<EthernetState>>);

impl EthernetPort {
    /// Locks the port.
    pub fn lock(&self) -> MutexGuard<'_, EthernetState> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The station behind the port.
#[derive(Debug, Default)]
pub(super) struct Station {
    pub(super) port: EthernetPort,
    reassembly: Reassembly,
    /// Frames to send, the first possibly in part.
    frames: VecDeque<Vec<u8>>,
    /// Position in the first frame, number of the next fragment, number of the frame.
    at: usize,
    number: u8,
    frame: u8,
    /// A fragment that is sent after the next one.
    held: Option<Vec<u8>>,
    /// Time of the next unsolicited frame, ns; `None` before it has an address.
    due: Option<u64>,
}

impl Station {
    /// After power-on it has no address.
    pub(super) fn power_on(&mut self) {
        {
            let mut state = self.port.lock();
            (state.settings, state.filter) = (IpSettings::default(), None);
        }
        *self = Self {
            port: self.port.clone(),
            ..Self::default()
        };
    }

    /// Sends unsolicited frames from a time on, ns, or ends that.
    pub(super) const fn announce(&mut self, due: Option<u64>) {
        self.due = due;
    }

    /// Handles a message at `now`, ns, where the system time is `time`, ns; returns the answer, if there is one.
    pub(super) fn answer(&mut self, message: &[u8], now: u64, time: u64) -> Option<Vec<u8>> {
        match Eoe::decode(message) {
            Some(Eoe::Fragment(fragment)) => {
                self.receive(&fragment);
                let (port, time) = (fragment.port, u32::try_from(time & 0xFFFF_FFFF));
                let time = time.unwrap_or(0);
                (fragment.last && fragment.stamp_requested)
                    .then(|| encoded(&Eoe::TimeStamp { port, time }))
            }
            Some(Eoe::Request {
                port,
                request,
                data,
            }) => {
                let (result, data) = match self.request(request, data, now) {
                    Ok(data) => (EoeResult::SUCCESS, data),
                    Err(result) => (result, Vec::new()),
                };
                Some(encoded(&Eoe::Response {
                    port,
                    request,
                    result,
                    data: &data,
                }))
            }
            Some(Eoe::TimeStamp { .. } | Eoe::Response { .. }) | None => {
                Some(encoded(&Eoe::Response {
                    port: 0,
                    request: EoeRequest::SetAddress,
                    result: EoeResult::UNSUPPORTED,
                    data: &[],
                }))
            }
        }
    }

    fn request(
        &mut self,
        request: EoeRequest,
        data: &[u8],
        now: u64,
    ) -> Result<Vec<u8>, EoeResult> {
        let mut state = self.port.lock();
        let (left, result) = &mut state.faults.refuse;
        if happens(left) {
            return Err(*result);
        }
        if state.faults.no_filter
            && matches!(request, EoeRequest::SetFilter | EoeRequest::GetFilter)
        {
            return Err(EoeResult::NO_FILTER);
        }
        match request {
            EoeRequest::SetAddress => {
                let new = IpSettings::decode(data).ok_or(EoeResult::UNSPECIFIED)?;
                let old = state.settings;
                state.settings = IpSettings {
                    mac: new.mac.or(old.mac),
                    ip: new.ip.or(old.ip),
                    mask: new.mask.or(old.mask),
                    gateway: new.gateway.or(old.gateway),
                    dns: new.dns.or(old.dns),
                    name: new.name.or(old.name),
                };
                self.due = Some(now);
            }
            EoeRequest::SetFilter => {
                let filter = AddressFilter::decode(data).ok_or(EoeResult::UNSPECIFIED)?;
                state.filter = Some(filter);
            }
            EoeRequest::GetAddress => return Ok(state.settings.encode()),
            EoeRequest::GetFilter => {
                let filter = state.filter.clone().unwrap_or_default();
                return filter.encode().ok_or(EoeResult::UNSPECIFIED);
            }
        }
        Ok(Vec::new())
    }

    fn receive(&mut self, fragment: &Fragment<'_>) {
        let before = self.reassembly.dropped().0;
        let whole = self.reassembly.push(fragment);
        let answer = {
            let mut state = self.port.lock();
            match whole {
                Some((frame, _)) => {
                    state.received += 1;
                    let is_deaf = happens(&mut state.faults.deaf);
                    let accepted = !is_deaf && accepts(&state, frame);
                    accepted.then(|| reply(&state.settings, frame)).flatten()
                }
                None => None,
            }
        };
        self.port.lock().dropped += self.reassembly.dropped().0 - before;
        if let Some(frame) = answer {
            self.push(frame);
        }
    }

    fn push(&mut self, mut frame: Vec<u8>) {
        if self.frames.len() >= FRAMES_MAX {
            self.port.lock().dropped += 1;
            return;
        }
        frame.resize(frame.len().max(PADDED), 0);
        self.frames.push_back(frame);
    }

    /// The next fragment for a mailbox of `len` bytes; with a `period`, ns, also of unsolicited frames.
    pub(super) fn fragment(
        &mut self,
        now: u64,
        period: Option<u64>,
        len: usize,
    ) -> Option<Vec<u8>> {
        if let (Some(period), Some(due)) = (period, self.due)
            && now >= due
            && self.frames.is_empty()
        {
            self.due = Some(now + period);
            let settings = self.port.lock().settings;
            self.push(probe(&settings));
        }
        if let Some(held) = self.held.take() {
            return Some(held);
        }
        let fragment = self.next(len)?;
        let mut state = self.port.lock();
        if happens(&mut state.faults.lose) {
            return None;
        }
        if self.number > 1 && happens(&mut state.faults.swap) {
            drop(state);
            let after = self.next(len)?;
            self.held = Some(fragment);
            return Some(after);
        }
        Some(fragment)
    }

    /// Takes the next fragment of the first frame.
    fn next(&mut self, len: usize) -> Option<Vec<u8>> {
        let capacity = len.checked_sub(MailboxHeader::LEN + Eoe::HEAD)?;
        let mut state = self.port.lock();
        if self.at == 0 {
            self.number = 0;
            self.frame = (self.frame + 1) % 16;
            if state.faults.stamps
                && let Some(frame) = self.frames.front_mut()
            {
                frame.extend_from_slice(&1_234_567_u32.to_le_bytes());
            }
        }
        let frame = self.frames.front()?;
        let fragment = Fragment::of(frame, self.at, self.number, capacity)?;
        let end = self.at + fragment.data.len();
        let wrong = self.at > 0 && happens(&mut state.faults.wrong_frame);
        let is_short = self.at == 0 && happens(&mut state.faults.too_long);
        let fragment = encoded(&Eoe::Fragment(Fragment {
            frame: (self.frame + u8::from(wrong)) % 16,
            offset: if is_short { 1 } else { fragment.offset },
            stamped: state.faults.stamps && fragment.last,
            ..fragment
        }));
        if end == frame.len() {
            state.sent += 1;
            self.frames.pop_front();
            self.at = 0;
        } else {
            (self.at, self.number) = (end, self.number + 1);
        }
        Some(fragment)
    }
}

fn encoded(message: &Eoe<'_>) -> Vec<u8> {
    let mut bytes = vec![0; crate::link::FRAME_MAX];
    let len = message.encode(&mut bytes).unwrap_or(0);
    bytes.truncate(len);
    bytes
}

/// Whether the station accepts a frame: its own address, and what its filter allows.
fn accepts(state: &EthernetState, frame: &[u8]) -> bool {
    let Some(to) = frame.first_chunk::<6>() else {
        return false;
    };
    if *to == BROADCAST {
        let closed = |filter: &AddressFilter| filter.no_broadcasts;
        return !state.filter.as_ref().is_some_and(closed);
    }
    let listed = |filter: &AddressFilter| filter.addresses.contains(to);
    state.settings.mac.unwrap_or(DEFAULT_MAC) == *to || state.filter.as_ref().is_some_and(listed)
}

/// An ARP probe for its own address, as a station sends that has just got it.
fn probe(settings: &IpSettings) -> Vec<u8> {
    let mac = settings.mac.unwrap_or(DEFAULT_MAC);
    let ip = settings.ip.map_or([0; 4], |ip| ip.octets());
    let head = [&BROADCAST[..], &mac, &ARP].concat();
    let body = [&[0, 1, 8, 0, 6, 4, 0, 1][..], &mac, &[0; 4], &[0; 6], &ip].concat();
    [head, body].concat()
}

/// The answer of a station with these addresses to a frame.
fn reply(settings: &IpSettings, frame: &[u8]) -> Option<Vec<u8>> {
    let (mac, ip) = (settings.mac.unwrap_or(DEFAULT_MAC), settings.ip?.octets());
    let (head, body) = frame.split_first_chunk::<FRAME_MIN>()?;
    let from = head.get(6..12)?;
    let kind = head.get(12..14)?;
    let body = if kind == ARP {
        arp(mac, ip, body)?
    } else if kind == IP {
        echo(ip, body)?
    } else {
        return None;
    };
    Some([from, &mac, kind, &body].concat())
}

/// The reply to an ARP request for this address.
fn arp(mac: [u8; 6], ip: [u8; 4], body: &[u8]) -> Option<Vec<u8>> {
    let body = body.get(..28)?;
    let (head, rest) = body.split_at_checked(8)?;
    if head != [0, 1, 8, 0, 6, 4, 0, 1] || rest.get(16..20)? != ip {
        return None;
    }
    let sender = rest.get(..10)?;
    Some([&[0, 1, 8, 0, 6, 4, 0, 2][..], &mac, &ip, sender].concat())
}

/// The reply to an ICMP echo request, or to a UDP datagram for port 7.
fn echo(ip: [u8; 4], packet: &[u8]) -> Option<Vec<u8>> {
    let first = *packet.first()?;
    let len = usize::from(u16::from_be_bytes([*packet.get(2)?, *packet.get(3)?]));
    let head_len = usize::from(first & 0x0F) * 4;
    // IPv4, whole, not a part of a fragmented packet, for this address.
    let part = u16::from_be_bytes([*packet.get(6)?, *packet.get(7)?]) & 0x3FFF;
    let packet = packet.get(..len)?;
    if first >> 4 != 4 || head_len < 20 || part != 0 || packet.get(16..20)? != ip {
        return None;
    }
    let mut packet = packet.to_vec();
    let from = [packet[12], packet[13], packet[14], packet[15]];
    packet.get_mut(12..16)?.copy_from_slice(&ip);
    packet.get_mut(16..20)?.copy_from_slice(&from);
    let protocol = *packet.get(9)?;
    let (head, body) = packet.split_at_mut_checked(head_len)?;
    match (protocol, body.get(..4)?) {
        (1, [8, 0, ..]) => {
            *body.first_mut()? = 0;
            body.get_mut(2..4)?.fill(0);
            let sum = checksum(body).to_be_bytes();
            body.get_mut(2..4)?.copy_from_slice(&sum);
        }
        // Without the optional checksum.
        (17, [high, low, 0, 7]) => {
            let to = [*high, *low];
            body.get_mut(..2)?.copy_from_slice(&[0, 7]);
            body.get_mut(2..4)?.copy_from_slice(&to);
            body.get_mut(6..8)?.fill(0);
        }
        _ => return None,
    }
    head.get_mut(10..12)?.fill(0);
    let sum = checksum(head).to_be_bytes();
    head.get_mut(10..12)?.copy_from_slice(&sum);
    Some(packet)
}

/// The checksum of IP and ICMP.
fn checksum(bytes: &[u8]) -> u16 {
    let words = bytes.chunks(2).map(|pair| {
        let low = pair.get(1).copied().unwrap_or(0);
        u64::from(u16::from_be_bytes([pair[0], low]))
    });
    let mut sum: u64 = words.sum();
    while sum > 0xFFFF {
        sum = (sum & 0xFFFF) + (sum >> 16);
    }
    !u16::try_from(sum).unwrap_or(0)
}
