//! LSS slave. It returns actions to its owner and has no non-volatile storage.

use super::{
    ACTIVATE_TIMING, FAST_SCAN, IDENTIFIED, IDENTIFIED_NONE, IDENTIFY, IDENTIFY_NONE, INQUIRE,
    INQUIRE_NODE, Identity, Message, Mode, NO_NODE, SCAN_RESET, SELECT, SELECTED, SET_NODE,
    SET_TIMING, STORE, SWITCH_GLOBAL, number, short, with_number,
};
use crate::canopen::NodeId;

/// Actions for the owner.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Done {
    /// A device without node number has got one: start with it (reset communication).
    Activate(NodeId),
    /// Store this node number in non-volatile memory; `None` is no number.
    Store(Option<NodeId>),
    /// Switch to the bit timing with that index of the CiA table, after the delay in ms.
    BitTiming(u8, u16),
}

/// The LSS slave of one device.
///
/// ```text
///         1 switch global, 2 selected by address, 3 found by fast scan
/// Waiting ---------------------------------------------------------> Configuration
///    ^                                                                     |
///    +---- 4 switch global; a device without number starts with its new one +
/// ```
#[derive(Clone, Debug)]
pub struct Slave {
    identity: Identity,
    pub(super) mode: Mode,
    /// Active node number.
    active: Option<NodeId>,
    /// Pending node number.
    pending: Option<NodeId>,
    timing: Option<u8>,
    /// Number of consecutive matching parts of a selection or identification.
    matched: u8,
    /// Index of the number that a fast scan searches.
    scan: u8,
}

impl Slave {
    /// A slave with this LSS address, and its node number if it has one.
    pub const fn new(identity: Identity, node: Option<NodeId>) -> Self {
        Self {
            identity,
            mode: Mode::Waiting,
            active: node,
            pending: node,
            timing: None,
            matched: 0,
            scan: 0,
        }
    }

    /// Its mode.
    pub const fn mode(&self) -> Mode {
        self.mode
    }

    /// The node number after the next reset communication.
    pub const fn pending(&self) -> Option<NodeId> {
        self.pending
    }

    /// The device starts with its new number.
    pub const fn activate(&mut self) {
        self.active = self.pending;
    }

    /// Handles a message of the master; returns response and action.
    pub fn handle(&mut self, message: &Message) -> (Option<Message>, Option<Done>) {
        let configuring = self.mode == Mode::Configuration;
        match message[0] {
            SWITCH_GLOBAL => (None, self.switch(message[1])),
            SELECT..SELECTED if !configuring => (self.select(message), None),
            IDENTIFY..IDENTIFY_NONE => (self.identify(message), None),
            IDENTIFY_NONE if self.active.is_none() => (Some(short(IDENTIFIED_NONE, 0, 0)), None),
            FAST_SCAN if !configuring && self.active.is_none() && self.pending.is_none() => {
                (self.fast_scan(message), None)
            }
            command if configuring => self.configure(command, message),
            _ => (None, None),
        }
    }

    fn switch(&mut self, mode: u8) -> Option<Done> {
        match mode {
            0 => {
                self.mode = Mode::Waiting;
                let new = self.pending.filter(|_| self.active.is_none());
                new.map(Done::Activate)
            }
            1 => {
                self.mode = Mode::Configuration;
                None
            }
            _ => None,
        }
    }

    /// The four numbers must arrive in order.
    fn select(&mut self, message: &Message) -> Option<Message> {
        let part = message[0] - SELECT;
        let wanted = self.identity.numbers()[usize::from(part & 3)];
        let in_order = part == 0 || part == self.matched;
        self.matched = if in_order && number(message) == wanted {
            part + 1
        } else {
            0
        };
        if self.matched < 4 {
            return None;
        }
        (self.matched, self.mode) = (0, Mode::Configuration);
        Some(short(SELECTED, 0, 0))
    }

    /// Vendor and product equal, revision and serial within bounds, in this order.
    fn identify(&mut self, message: &Message) -> Option<Message> {
        let part = message[0] - IDENTIFY;
        let [vendor, product, revision, serial] = self.identity.numbers();
        let value = number(message);
        let fits = match part {
            0 => value == vendor,
            1 => value == product,
            2 => revision >= value,
            3 => revision <= value,
            4 => serial >= value,
            _ => serial <= value,
        };
        let in_order = part == 0 || part == self.matched;
        self.matched = if in_order && fits { part + 1 } else { 0 };
        (self.matched == 6).then(|| {
            self.matched = 0;
            short(IDENTIFIED, 0, 0)
        })
    }

    fn fast_scan(&mut self, message: &Message) -> Option<Message> {
        let [.., bit, sub, next] = *message;
        if bit == SCAN_RESET {
            self.scan = 0;
            return Some(short(IDENTIFIED, 0, 0));
        }
        if bit > 31 || sub > 3 || next > 3 || sub != self.scan {
            return None;
        }
        let mask = u32::MAX << bit;
        let own = self.identity.numbers()[usize::from(sub)];
        if (own ^ number(message)) & mask != 0 {
            return None;
        }
        self.scan = next;
        if bit == 0 && next < sub {
            self.mode = Mode::Configuration;
        }
        Some(short(IDENTIFIED, 0, 0))
    }

    fn configure(&mut self, command: u8, message: &Message) -> (Option<Message>, Option<Done>) {
        let answer = |error| Some(short(command, error, 0));
        match command {
            SET_NODE => match (NodeId::new(message[1]), message[1]) {
                (Err(_), raw) if raw != NO_NODE => (answer(1), None),
                (node, _) => {
                    self.pending = node.ok();
                    (answer(0), None)
                }
            },
            SET_TIMING => {
                // Table 0 of CiA 301: 1000 kbit/s to 10 kbit/s; 5 is reserved.
                let known = message[1] == 0 && message[2] <= 8 && message[2] != 5;
                self.timing = known.then_some(message[2]);
                (answer(u8::from(!known)), None)
            }
            ACTIVATE_TIMING => {
                let delay = u16::from_le_bytes([message[1], message[2]]);
                (
                    None,
                    self.timing.map(|timing| Done::BitTiming(timing, delay)),
                )
            }
            STORE => (answer(0), Some(Done::Store(self.pending))),
            INQUIRE..INQUIRE_NODE => {
                let number = self.identity.numbers()[usize::from((command - INQUIRE) & 3)];
                (Some(with_number(command, number)), None)
            }
            INQUIRE_NODE => {
                let node = self.active.map_or(NO_NODE, NodeId::raw);
                (answer(node), None)
            }
            _ => (None, None),
        }
    }
}
