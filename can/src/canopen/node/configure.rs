//! Configures the services of a node from its communication objects: at start and after a write,
//! never in a cycle.

use std::time::Duration;

use takt_cia402::dictionary::{Address, Dictionary};

use super::{Application, Node, NodeError, Settings};
use crate::Id;
use crate::canopen::lss::Identity;
use crate::canopen::nmt::{Consumer, ErrorBehaviour};
use crate::canopen::pdo::{Direction, PDOS_MAX, Rpdo, Tpdo, number_at};
use crate::canopen::store::Group;
use crate::canopen::{NodeId, SDO_REQUEST, SDO_RESPONSE, SYNC, sync};

const OFF: u32 = 1 << 31;
const PRODUCES: u32 = 1 << 30;

fn number(d: &Dictionary, index: u16, sub: u8) -> Option<u32> {
    number_at(d, Address::new(index, sub))
}

fn low8(number: u32) -> u8 {
    number.to_le_bytes()[0]
}

fn ms(number: Option<u32>) -> Duration {
    Duration::from_millis(number.unwrap_or(0).into())
}

fn us(number: Option<u32>) -> Duration {
    Duration::from_micros(number.unwrap_or(0).into())
}

/// The identifier in a COB-ID object.
fn id(raw: u32) -> Option<Id> {
    u16::try_from(raw & 0x1FFF_FFFF)
        .ok()
        .and_then(|raw| Id::standard(raw).ok())
}

pub(super) fn identity(d: &Dictionary) -> Identity {
    Identity::from_numbers([1, 2, 3, 4].map(|sub| number(d, 0x1018, sub).unwrap_or(0)))
}

pub(super) fn settings(d: &Dictionary, node: NodeId) -> Settings {
    let sdo = |sub, function| {
        let configured = number(d, 0x1200, sub).and_then(id);
        configured.unwrap_or_else(|| node.cob(function))
    };
    let consumes = |raw: &u32| raw & OFF != 0;
    let emergency = number(d, 0x1014, 0).filter(|raw| raw & OFF == 0);
    Settings {
        sync: number(d, 0x1005, 0).and_then(id).unwrap_or(SYNC),
        time: number(d, 0x1012, 0).filter(consumes).and_then(id),
        emergency: emergency.and_then(id),
        request: sdo(1, SDO_REQUEST),
        response: sdo(2, SDO_RESPONSE),
        behaviour: ErrorBehaviour::from_raw(low8(number(d, 0x1029, 1).unwrap_or(0))),
    }
}

type Pdos = (Vec<(u16, Rpdo)>, Vec<(u16, Tpdo)>);

/// Creates all PDOs of a dictionary.
pub(super) fn pdos(d: &Dictionary) -> Result<Pdos, NodeError> {
    let (mut rpdos, mut tpdos) = (vec![], vec![]);
    for number in 0..PDOS_MAX {
        let refused = |direction: Direction| {
            let index = direction.mapping() + number;
            move |why| NodeError::Mapping { index, why }
        };
        let rpdo = Rpdo::new(d, number).map_err(refused(Direction::Receive))?;
        let tpdo = Tpdo::new(d, number).map_err(refused(Direction::Transmit))?;
        rpdos.extend(rpdo.map(|rpdo| (number, rpdo)));
        tpdos.extend(tpdo.map(|tpdo| (number, tpdo)));
    }
    Ok((rpdos, tpdos))
}

/// Adds the node number to the relative defaults.
pub(in crate::canopen) fn add_node_id(d: &mut Dictionary, relative: &[Address], node: NodeId) {
    for address in relative {
        let default = d.entry(*address).map(|entry| {
            let mut four = [0; 4];
            four.iter_mut()
                .zip(&entry.default)
                .for_each(|(to, from)| *to = *from);
            (u32::from_le_bytes(four), entry.default.len())
        });
        if let Some((base, len)) = default {
            let sum = base.wrapping_add(node.raw().into()).to_le_bytes();
            let bytes = sum.get(..len).unwrap_or(&sum);
            // The length matches: this cannot fail.
            let _ = d.store(*address, bytes);
        }
    }
}

/// Prepends an error to the history 1003h.
pub(super) fn remember(d: &mut Dictionary, code: u16, vendor: u8) {
    let Some(object) = d.object(0x1003) else {
        return;
    };
    let capacity = u8::try_from(object.entries.len() - 1).unwrap_or(u8::MAX);
    let count = low8(number(d, 0x1003, 0).unwrap_or(0)).min(capacity);
    let mut store = |sub, value: u32, len: usize| {
        let bytes = value.to_le_bytes();
        // The length matches; without a valid 1003h there is no history.
        let _ = d.store(
            Address::new(0x1003, sub),
            bytes.get(..len).unwrap_or(&bytes),
        );
        d.bytes(Address::new(0x1003, sub.saturating_add(1)))
            .map(|b| {
                let mut four = [0; 4];
                four.iter_mut().zip(b).for_each(|(to, from)| *to = *from);
                u32::from_le_bytes(four)
            })
    };
    let mut carried = u32::from(code) | u32::from(vendor) << 16;
    let mut next = store(0, (count.saturating_add(1)).min(capacity).into(), 1);
    for sub in 1..=count.saturating_add(1).min(capacity) {
        let here = next;
        next = store(sub, carried, 4);
        carried = here.unwrap_or(0);
    }
}

impl<A: Application> Node<A> {
    /// Configures all services.
    pub(super) fn configure_all(&mut self, now: Duration) {
        for index in [0x1005, 0x100C, 0x1015, 0x1016, 0x1017] {
            self.configure(Address::new(index, 0), now);
        }
        for at in 0..self.rpdos.len() {
            self.configure_pdo(Direction::Receive, at);
        }
        for at in 0..self.tpdos.len() {
            self.configure_pdo(Direction::Transmit, at);
        }
    }

    /// Configures the service of an object.
    pub(super) fn configure(&mut self, address: Address, now: Duration) {
        let d = &self.dictionary;
        match address.index {
            0x1005 | 0x1006 | 0x1007 | 0x1019 => {
                self.settings = settings(d, self.slave.id());
                self.configure_sync(now);
            }
            0x100C | 0x100D => {
                let factor = number(d, 0x100D, 0).unwrap_or(0);
                self.slave.set_life_time(ms(number(d, 0x100C, 0)) * factor);
            }
            0x1012 | 0x1014 | 0x1029 | 0x1200 => self.settings = settings(d, self.slave.id()),
            0x1015 => {
                let inhibit = us(number(d, 0x1015, 0)) * 100;
                self.errors.set_inhibit(inhibit);
            }
            0x1016 => self.configure_consumers(),
            0x1010 | 0x1011 => self.keep(address),
            0x1017 => self.slave.set_heartbeat(ms(number(d, 0x1017, 0)), now),
            index => {
                if let Some((direction, number, _)) = Direction::of(index) {
                    self.configure_number(direction, number);
                }
            }
        }
    }

    /// The signature was written: restores the capability value of the object.
    fn keep(&mut self, address: Address) {
        let Some(group) = Group::from_sub(address.sub) else {
            return;
        };
        if address.index == 0x1010 {
            self.store.save(&self.dictionary, group);
        } else {
            self.store.forget(group);
        }
        let _ = self.dictionary.store(address, &1_u32.to_le_bytes());
    }

    fn configure_sync(&mut self, now: Duration) {
        let d = &self.dictionary;
        let overflow = low8(number(d, 0x1019, 0).unwrap_or(0));
        self.sync = sync::Consumer::new(overflow, us(number(d, 0x1007, 0)));
        let period = us(number(d, 0x1006, 0));
        let produces = number(d, 0x1005, 0).unwrap_or(0) & PRODUCES != 0 && !period.is_zero();
        self.sync_producer = produces.then(|| sync::Producer::new(period, overflow, now + period));
    }

    fn configure_consumers(&mut self) {
        let d = &self.dictionary;
        let count = d.object(0x1016).map_or(0, |object| object.entries.len());
        self.consumers.clear();
        for (sub, _) in (1..=u8::MAX).zip(1..count) {
            let raw = number(d, 0x1016, sub).unwrap_or(0);
            let node = NodeId::new(low8(raw >> 16)).ok();
            let time = Duration::from_millis((raw & 0xFFFF).into());
            if node.is_some() && !time.is_zero() {
                self.consumers.push((node, Consumer::new(time)));
            }
        }
    }

    fn configure_number(&mut self, direction: Direction, number: u16) {
        let at = match direction {
            Direction::Receive => self.rpdos.iter().position(|(n, _)| *n == number),
            Direction::Transmit => self.tpdos.iter().position(|(n, _)| *n == number),
        };
        if let Some(at) = at {
            self.configure_pdo(direction, at);
        }
    }

    /// A mapping is incomplete while it is being written; the PDO keeps the previous one until it
    /// is complete.
    fn configure_pdo(&mut self, direction: Direction, at: usize) {
        let d = &self.dictionary;
        match direction {
            Direction::Receive => {
                if let Some((number, rpdo)) = self.rpdos.get_mut(at)
                    && let Ok(Some(new)) = Rpdo::new(d, *number)
                {
                    *rpdo = new;
                }
            }
            Direction::Transmit => {
                if let Some((number, tpdo)) = self.tpdos.get_mut(at)
                    && let Ok(Some(new)) = Tpdo::new(d, *number)
                {
                    *tpdo = new;
                }
            }
        }
    }
}
