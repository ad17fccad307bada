//! Slaves in a line or a tree: the path and delay of a frame, cut cables, and injected faults. The behaviour of a slave
//! is in [`Slave`].

use crate::{Address, DatagramHeader, Frame, FrameHeader};

use super::slave::{Arrival, Slave};

/// Entry of the segment at the master: the second is the redundancy cable at the last slave.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Entry {
    /// At the first slave.
    #[default]
    First,
    /// At the last slave of the line.
    Last,
}

/// How a frame returned to the master.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Returned {
    /// Its entry.
    pub by: Entry,
    /// Its delay, ns.
    pub after: u64,
}

/// Faults to inject. Each is counted down when it happens.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Faults {
    /// Number of frames lost before the first slave.
    pub lose: u32,
    /// Number of frames that pass all slaves and are lost when returning.
    pub lose_returned: u32,
    /// Frames corrupted on the cable to a port of a slave.
    pub corrupt: Option<Corrupt>,
    /// Number of frames that return late, and their delay, ns.
    pub late: Option<(u32, u64)>,
}

/// Frames corrupted on a cable by bit errors, which the receiving slave counts and marks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Corrupt {
    /// The slave that receives them.
    pub slave: usize,
    /// The receiving port: 0 outbound, another when returning.
    pub port: usize,
    /// Number of frames.
    pub frames: u32,
}

/// A slave in the topology.
#[derive(Debug)]
struct Node {
    slave: Slave,
    /// Parent slave and port of its cable; `None` at the master.
    parent: Option<(usize, usize)>,
    /// Whether that cable is intact.
    link: bool,
    powered: bool,
}

/// Delay of a cable, ns: some 20 m.
const CABLE: u64 = 100;
/// Ports in the order in which a frame passes them.
const ORDER: [usize; 3] = [3, 1, 2];
/// Bit of the source address that marks a frame that has passed the segment.
const PASSED: u8 = 0x02;
/// Ethertype of EtherCAT.
const ETHERTYPE: [u8; 2] = [0x88, 0xA4];
/// Length of an Ethernet header.
const ETHERNET: usize = 14;

/// A segment.
#[derive(Debug, Default)]
pub struct Segment {
    nodes: Vec<Node>,
    /// A cable from the last slave of the line back to the master.
    redundant: bool,
    /// The path of the present frame.
    path: Vec<(usize, Arrival)>,
    now: u64,
    /// Pending faults.
    pub faults: Faults,
    /// Number of processed frames.
    pub frames: u64,
}

impl Segment {
    /// A segment of slaves in a line.
    pub fn line(slaves: impl IntoIterator<Item = Slave>) -> Self {
        let mut segment = Self::default();
        for slave in slaves {
            let parent = segment.nodes.len().checked_sub(1).map(|last| (last, 1));
            segment.add(slave, parent);
        }
        segment
    }

    /// Adds a slave at a port (1 to 3) of another, or at the master. Returns its number; numbers follow the order of
    /// insertion, not that of the ring.
    pub fn add(&mut self, slave: Slave, parent: Option<(usize, usize)>) -> usize {
        self.nodes.push(Node {
            slave,
            parent,
            link: true,
            powered: true,
        });
        self.update_links();
        self.nodes.len() - 1
    }

    /// Plugs a second cable from the last slave of the line to the master, or unplugs it.
    pub fn set_redundant(&mut self, redundant: bool) {
        self.redundant = redundant;
        self.update_links();
    }

    /// Cuts or repairs the cable before a slave.
    pub fn set_link(&mut self, number: usize, link: bool) {
        let Some(node) = self.nodes.get_mut(number) else {
            return;
        };
        let was = std::mem::replace(&mut node.link, link);
        if was && !link {
            self.count_lost_links(number, true);
        }
        self.update_links();
    }

    /// Both ends of the cable before a slave lose the link; only one if the slave itself has no power.
    fn count_lost_links(&mut self, number: usize, at_slave: bool) {
        let Some(node) = self.nodes.get_mut(number) else {
            return;
        };
        if at_slave {
            node.slave.count_lost_link(0);
        }
        if let Some((parent, port)) = node.parent
            && let (Some(node), Ok(port)) = (self.nodes.get_mut(parent), u16::try_from(port))
        {
            node.slave.count_lost_link(port);
        }
    }

    /// Switches a slave's power off or on; slaves behind it are unreachable meanwhile.
    pub fn set_power(&mut self, number: usize, on: bool) {
        let now = self.now;
        let Some(node) = self.nodes.get_mut(number) else {
            return;
        };
        let was = std::mem::replace(&mut node.powered, on);
        if on && !was {
            node.slave.power_on(now);
        }
        if was && !on {
            self.count_lost_links(number, false);
            for behind in 0..self.nodes.len() {
                if matches!(self.nodes[behind].parent, Some((parent, _)) if parent == number) {
                    self.nodes[behind].slave.count_lost_link(0);
                }
            }
        }
        self.update_links();
    }

    /// Number of slaves.
    pub fn len(&self) -> usize {
        self.nodes.len()
    }

    /// Whether the segment is empty.
    pub fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    /// A slave.
    pub fn slave(&mut self, number: usize) -> Option<&mut Slave> {
        self.nodes.get_mut(number).map(|node| &mut node.slave)
    }

    /// The slave at a port of another, or at the master, if frames reach it.
    fn child(&self, parent: Option<(usize, usize)>) -> Option<usize> {
        let closed = parent.is_some_and(|(number, port)| {
            let node = self.nodes.get(number);
            node.is_none_or(|node| node.slave.is_closed(port))
        });
        let here = |node: &Node| node.parent == parent && node.link && node.powered;
        self.nodes.iter().position(here).filter(|_| !closed)
    }

    fn update_links(&mut self) {
        let last = self.last();
        for number in 0..self.nodes.len() {
            let node = &self.nodes[number];
            let up = node
                .parent
                .is_none_or(|(parent, _)| self.nodes[parent].powered);
            let mut links = [node.link && up, false, false, false];
            let mut ports = 0x0F;
            for (port, link) in links.iter_mut().enumerate().skip(1) {
                let behind = |n: &Node| n.parent == Some((number, port));
                if self.nodes.iter().any(behind) {
                    ports |= 3 << (2 * port);
                }
                let up = |n: &Node| behind(n) && n.link && n.powered;
                *link = self.nodes.iter().any(up)
                    || (self.redundant && port == 1 && Some(number) == last);
            }
            let slave = &mut self.nodes[number].slave;
            slave.set_ports(ports);
            slave.set_links(links);
        }
    }

    /// The last slave of the line as built, intact or not.
    fn last(&self) -> Option<usize> {
        let after = |parent| self.nodes.iter().position(|node| node.parent == parent);
        let mut at = after(None)?;
        while let Some(next) = after(Some((at, 1))) {
            at = next;
        }
        Some(at)
    }

    /// The slave at which the processing of a frame from an entry starts.
    fn begin(&self, entry: Entry) -> Option<usize> {
        match entry {
            Entry::First => self.child(None),
            Entry::Last if self.is_open_ended() => {
                // It passes back along the line to the cut; processing starts there.
                let mut at = self.last().filter(|last| self.nodes[*last].powered)?;
                loop {
                    let node = &self.nodes[at];
                    match node.parent {
                        _ if !node.link => return Some(at),
                        // A closed ring forwards it unprocessed.
                        None => return None,
                        Some((parent, _)) if self.nodes[parent].powered => at = parent,
                        Some(_) => return Some(at),
                    }
                }
            }
            Entry::Last => None,
        }
    }

    /// Whether frames pass between the last slave of the line and the second cable.
    fn is_open_ended(&self) -> bool {
        let last = self.last().and_then(|last| self.nodes.get(last));
        self.redundant && last.is_some_and(|last| !last.slave.is_closed(1))
    }

    /// The entry by which a processed frame leaves.
    fn end(&self, entry: Entry) -> Entry {
        let last = self.last();
        let reaches_last = self.path.iter().any(|(n, _)| Some(*n) == last);
        // From the cut it can only return to its origin.
        match entry {
            Entry::First if reaches_last && self.is_open_ended() => Entry::Last,
            Entry::First => Entry::First,
            Entry::Last => Entry::Last,
        }
    }

    /// A frame that leaves by the second cable does not return to the slaves of the line.
    fn forget_return(&mut self) {
        let mut at = self.last();
        while let Some(number) = at {
            let on_path = self.path.iter_mut().find(|(n, _)| *n == number);
            if let Some((_, arrival)) = on_path {
                arrival.ports[1] = None;
            }
            at = self.nodes[number].parent.map(|(parent, _)| parent);
        }
    }

    /// The slaves that a frame passes, with the times at which it passes their ports; returns when
    /// it has passed the last.
    fn route(&self, number: usize, at: u64, path: &mut Vec<(usize, Arrival)>) -> u64 {
        let index = path.len();
        let mut arrival = Arrival {
            at,
            ports: [Some(at), None, None, None],
        };
        path.push((number, arrival));
        let forwarding = self.nodes[number].slave.config().forwarding;
        let mut now = at;
        for port in ORDER {
            if let Some(child) = self.child(Some((number, port))) {
                let back = self.route(child, now + forwarding + CABLE, path);
                now = back + CABLE;
                arrival.ports[port] = Some(now);
            }
        }
        path[index].1 = arrival;
        now + forwarding
    }

    /// Advances the time of the slaves' firmware independent of frames: state changes, mailboxes, watchdogs, SYNC0.
    /// [`Self::process`] does this too.
    pub fn poll(&mut self, now: u64) {
        self.now = now;
        for node in self.nodes.iter_mut().filter(|node| node.powered) {
            node.slave.poll(now);
        }
    }

    /// Processes an Ethernet frame, from its destination address on; one that is not EtherCAT is lost.
    pub fn process_ethernet(
        &mut self,
        frame: &mut [u8],
        entry: Entry,
        now: u64,
    ) -> Option<Returned> {
        let (header, datagrams) = frame.split_at_mut_checked(ETHERNET)?;
        if header.get(12..14) != Some(&ETHERTYPE) {
            return None;
        }
        let processed = self.begin(entry).is_some();
        let returned = self.process(datagrams, entry, now)?;
        if processed && let Some(source) = header.get_mut(6) {
            *source |= PASSED;
        }
        Some(returned)
    }

    /// Processes a frame (after its Ethernet header); `None` if it does not return.
    pub fn process(&mut self, frame: &mut [u8], entry: Entry, now: u64) -> Option<Returned> {
        self.frames += 1;
        self.poll(now);
        if self.faults.lose > 0 {
            self.faults.lose -= 1;
            return None;
        }
        let Some(first) = self.begin(entry) else {
            // A closed ring forwards the frame; without slaves it is lost.
            return self.pass_back(entry);
        };
        let mut path = std::mem::take(&mut self.path);
        path.clear();
        let out = self.route(first, now + CABLE, &mut path);
        self.path = path;
        let by = self.end(entry);
        if by == Entry::Last {
            self.forget_return();
        }
        let whole = self.corrupt();
        self.pass(frame, whole.unwrap_or(self.path.len()));
        // Updates loops that the frame itself closed or opened.
        self.update_links();
        let lost = whole.is_some() || self.faults.lose_returned > 0;
        if self.faults.lose_returned > 0 {
            self.faults.lose_returned -= 1;
        }
        if lost {
            return None;
        }
        let mut after = out + CABLE - now;
        if let Some((left, by)) = self.faults.late {
            self.faults.late = (left > 1).then_some((left - 1, by));
            after += by;
        }
        Some(Returned { by, after })
    }

    /// A frame that enters a closed ring by the redundancy cable leaves by the other end.
    fn pass_back(&self, entry: Entry) -> Option<Returned> {
        let whole = entry == Entry::Last && self.is_open_ended() && self.child(None).is_some();
        let each = |n: &Node| n.slave.config().forwarding + CABLE;
        let after = CABLE + self.nodes.iter().map(each).sum::<u64>();
        whole.then_some(Returned {
            by: Entry::First,
            after,
        })
    }

    /// Corrupts the frame if that is due, and counts it at all following ports; returns how many slaves it passes
    /// intact.
    fn corrupt(&mut self) -> Option<usize> {
        let fault = self.faults.corrupt?;
        let at = self.path.iter().position(|(n, _)| *n == fault.slave)?;
        let broken = self.path[at].1.ports.get(fault.port).copied().flatten()?;
        self.faults.corrupt = (fault.frames > 1).then_some(Corrupt {
            frames: fault.frames - 1,
            ..fault
        });
        for (number, arrival) in &self.path {
            for (port, when) in (0..).zip(arrival.ports) {
                let first = *number == fault.slave && usize::from(port) == fault.port;
                if when.is_some_and(|when| when >= broken) {
                    let slave = &mut self.nodes[*number].slave;
                    slave.count_bad_frame(port, !first);
                }
            }
        }
        Some(if fault.port == 0 { at } else { self.path.len() })
    }

    /// Processes each datagram in the first `count` slaves of the path, one after the other. A frame with inconsistent
    /// lengths is not processed beyond the error.
    fn pass(&mut self, frame: &mut [u8], count: usize) {
        let sound = Frame::decode(frame).is_ok_and(|f| {
            f.header.kind == FrameHeader::DATAGRAMS && f.datagrams().all(|d| d.is_ok())
        });
        let path = self.path.get(..count).unwrap_or_default();
        if !sound {
            for (number, _) in path {
                self.nodes[*number].slave.count_bad_length();
            }
        }
        let Ok(header) = FrameHeader::decode(frame) else {
            return;
        };
        if header.kind != FrameHeader::DATAGRAMS {
            return;
        }
        let end = (FrameHeader::LEN + usize::from(header.len)).min(frame.len());
        let mut rest = frame.get_mut(FrameHeader::LEN..end).unwrap_or_default();
        while let Ok(header) = DatagramHeader::decode(rest) {
            let len = DatagramHeader::LEN + usize::from(header.len) + 2;
            let Some((datagram, after)) = rest.split_at_mut_checked(len) else {
                return;
            };
            for (number, arrival) in path {
                pass_datagram(datagram, &mut self.nodes[*number].slave, arrival);
            }
            rest = after;
            if !header.more {
                return;
            }
        }
    }
}

/// Processes a complete datagram in one slave.
fn pass_datagram(datagram: &mut [u8], slave: &mut Slave, arrival: &Arrival) {
    let Ok(mut header) = DatagramHeader::decode(datagram) else {
        return;
    };
    let Some((head, rest)) = datagram.split_at_mut_checked(DatagramHeader::LEN) else {
        return;
    };
    let Some((data, counter)) = rest.split_last_chunk_mut::<2>() else {
        return;
    };
    let (command, irq) = (header.command, &mut header.irq);
    let gained = slave.execute(command, &mut header.address, irq, data, arrival);
    let sum = u16::from_le_bytes(*counter).wrapping_add(gained);
    *counter = sum.to_le_bytes();
    if let (Address::Device { adp, .. }, Some(adp_bytes)) = (header.address, head.get_mut(2..4)) {
        adp_bytes.copy_from_slice(&adp.to_le_bytes());
    }
    if let Some(irq_bytes) = head.get_mut(8..10) {
        irq_bytes.copy_from_slice(&header.irq.to_le_bytes());
    }
}
