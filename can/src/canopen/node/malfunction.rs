//! Malfunctions that begin and end while a node runs: what its master and the tools must notice. Quirks in contrast are
//! how a healthy node of some make behaves, from power-on.

use std::time::Duration;

use takt_cia402::dictionary::Mapping;
use takt_cia402::emulator::Distortion;

use super::{Application, Node};
use crate::Frame;
use crate::canopen::lss::Slave as LssSlave;
use crate::canopen::message::frame;
use crate::canopen::nmt::{Input, Reset};
use crate::canopen::{Emergency, HEARTBEAT, NmtCommand, NodeId};

/// Malfunctions of a node; none by default.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Malfunctions {
    /// Without power, or unplugged: it sends and receives nothing. It starts again afterwards.
    pub off: bool,
    /// It sends no heartbeat and answers no guarding; its boot-up message remains.
    pub no_heartbeat: bool,
    /// It answers no SDO request.
    pub no_sdo: bool,
    /// It uses the entries of its PDOs in reverse order, whatever mapping it acknowledged.
    pub wrong_map: bool,
    /// It restarts again and again, with this time in between.
    pub boot_loop: Option<Duration>,
    /// It sends this emergency again and again, with this time in between.
    pub emergency_storm: Option<(Emergency, Duration)>,
    /// It was off in the last poll.
    was_off: bool,
    /// When it restarts, and when it sends the next emergency.
    restart: Option<Duration>,
    next_emergency: Option<Duration>,
}

/// Whether what repeats at an interval is due; `due` is when it is due next.
fn repeat(due: &mut Option<Duration>, every: Option<Duration>, now: Duration) -> bool {
    let Some(every) = every else {
        *due = None;
        return false;
    };
    let at = *due.get_or_insert(now);
    let is_due = now >= at;
    if is_due {
        *due = Some(now + every.max(Duration::from_micros(100)));
    }
    is_due
}

impl Malfunctions {
    pub(super) fn poll_timeout(&self) -> Option<Duration> {
        let restart = self.restart.filter(|_| self.boot_loop.is_some());
        let storm = self.emergency_storm.and(self.next_emergency);
        restart.into_iter().chain(storm).min()
    }
}

/// Reverses the entries of a PDO.
fn reverse(mapping: &Mapping, bytes: &mut [u8], receives: bool) {
    let lens: Vec<usize> = mapping
        .entries()
        .map(|mapped| usize::from(mapped.bits / 8))
        .collect();
    let order: Vec<usize> = (0..lens.len()).rev().collect();
    let mut distortion = Distortion::order(order);
    if receives {
        distortion.receive(&lens, bytes);
    } else {
        distortion.transmit(&lens, bytes);
    }
}

impl<A: Application> Node<A> {
    /// Its malfunctions, to begin and to end them.
    pub const fn malfunctions_mut(&mut self) -> &mut Malfunctions {
        &mut self.malfunctions
    }

    /// Gives it another number, as a turned switch and a restart of its communication do.
    pub fn renumber(&mut self, id: NodeId, now: Duration) {
        let identity = super::configure::identity(&self.dictionary);
        self.lss = LssSlave::new(identity, Some(id));
        self.begin(Reset::Communication, now);
    }

    /// Begins and ends malfunctions, and does what is due by them.
    pub(super) fn run_malfunctions(&mut self, now: Duration) {
        let is_off = self.malfunctions.off;
        if std::mem::replace(&mut self.malfunctions.was_off, is_off) && !is_off {
            self.begin(Reset::Node, now);
        }
        let every = self.malfunctions.boot_loop;
        if repeat(&mut self.malfunctions.restart, every, now) {
            self.manage(Input::Command(NmtCommand::ResetNode), now);
        }
        let storm = self.malfunctions.emergency_storm;
        let every = storm.map(|(_, every)| every);
        if repeat(&mut self.malfunctions.next_emergency, every, now)
            && let Some((emergency, _)) = storm
            && let Some(id) = self.settings.emergency
            && self.slave.state().communicates()
        {
            self.push(frame(id, &emergency.encode()));
        }
    }

    /// A received frame as the node sees it; `None` if it is off.
    pub(super) fn misread(&self, frame: &Frame) -> Option<Frame> {
        if self.malfunctions.off {
            return None;
        }
        let id = frame.id();
        let mapping = self.rpdos.iter().find(|(_, rpdo)| rpdo.id() == Some(id));
        match mapping.filter(|_| self.malfunctions.wrong_map && !frame.is_remote()) {
            Some((_, rpdo)) => Some(reversed(rpdo.mapping(), frame, true)),
            None => Some(*frame),
        }
    }

    /// A frame to send as it gets onto the wire, if it does.
    pub(super) fn missend(&self, frame: Frame) -> Option<Frame> {
        let faults = &self.malfunctions;
        let id = frame.id();
        let is_beat = id == self.slave.id().cob(HEARTBEAT) && frame.data() != [0];
        let is_lost = faults.off
            || faults.no_heartbeat && is_beat
            || faults.no_sdo && id == self.settings.response;
        if is_lost {
            return None;
        }
        let tpdo = self.tpdos.iter().find(|(_, tpdo)| tpdo.id() == Some(id));
        Some(match tpdo.filter(|_| faults.wrong_map) {
            Some((_, tpdo)) => reversed(tpdo.mapping(), &frame, false),
            None => frame,
        })
    }
}

fn reversed(mapping: &Mapping, frame: &Frame, receives: bool) -> Frame {
    let mut data = [0; 8];
    let len = frame.data().len();
    let Some(bytes) = data.get_mut(..len) else {
        return *frame;
    };
    bytes.copy_from_slice(frame.data());
    reverse(mapping, bytes, receives);
    Frame::new(frame.id(), bytes).unwrap_or(*frame)
}
