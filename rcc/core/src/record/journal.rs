//! What a net thread notes of its cycles beside values: the words of a recording, if there is one, and what happened to nets and
//! machines for the flight recorder and live clients, in a ring that is always written. Nothing here allocates.

use takt_net::Moment;

use crate::executor::flight::{FlightReader, FlightWriter, ring};
use crate::executor::machines::{Hosted, MachineInput};
use crate::executor::{End, Executor, Running};
use crate::record::Tap;
use crate::record::words::{Entry, Reader, Words};

/// Events that the ring of a thread holds, 448 KiB.
const ROWS: usize = 1 << 13;
/// Words of a row before its entry: when the thread woke, and the cycle with its phase in the lowest bit.
const HEAD: usize = 2;
/// The word of a row that is when the thread woke for its cycle, ns.
pub(crate) const EVENT_WOKEN: usize = 0;
/// Words of the longest entry of an event.
const ENTRY_WORDS: usize = 5;

/// Notes of a net thread.
#[derive(Debug)]
pub struct Journal {
    tap: Option<Tap>,
    ring: FlightWriter,
    head: [u64; HEAD],
    /// Memory for an entry.
    words: Vec<u64>,
}

impl Journal {
    /// The notes of a thread, for a recording if there is a tap; its events are read at the other end.
    #[must_use]
    pub fn new(tap: Option<Tap>) -> (Self, FlightReader) {
        let (ring, reader) = ring(HEAD + ENTRY_WORDS, ROWS);
        let journal = Self {
            tap,
            ring,
            head: [0; HEAD],
            words: Vec::with_capacity(ENTRY_WORDS),
        };
        (journal, reader)
    }

    /// A cycle begins.
    pub fn begin(&mut self, moment: Moment) {
        self.head = [moment.wall.0.cast_unsigned(), moment.cycle << 1];
    }

    fn event(&mut self, write: impl FnOnce(&mut Words)) {
        let mut buffer = std::mem::take(&mut self.words);
        buffer.clear();
        let mut words = Words::new(buffer);
        write(&mut words);
        let (Ok(entry) | Err(entry)) = words.finish();
        let row = self.head.iter().chain(&entry);
        self.ring.write(row.copied());
        self.words = entry;
    }

    /// Writes to the recording, if there is one.
    fn tap(&mut self, write: impl FnOnce(&mut Tap)) {
        if let Some(tap) = &mut self.tap {
            write(tap);
        }
    }

    /// A net runs from this cycle on.
    pub fn started(&mut self, id: u32) {
        self.tap(|tap| tap.started(id));
        self.event(|words| words.started(id));
    }

    /// A rule starts a net from the next cycle on, in place of those that end.
    pub fn succeeded(&mut self, id: u32) {
        self.tap(|tap| tap.succeeded(id));
        self.event(|words| words.succeeded(id));
    }

    /// A net receives a cancel.
    pub fn cancelled(&mut self, id: u32) {
        self.tap(|tap| tap.cancelled(id));
        self.event(|words| words.cancelled(id));
    }

    /// A net is ended; the event is its end.
    pub fn aborted(&mut self, id: u32) {
        self.tap(|tap| tap.aborted(id));
    }

    /// A rule ends a net; the event is its end.
    pub fn stopped(&mut self, id: u32) {
        self.tap(|tap| tap.stopped(id));
    }

    /// A net exceeded its time too often; the event is its end.
    pub fn ran_away(&mut self, id: u32) {
        self.tap(|tap| tap.ran_away(id));
    }

    /// Whether a successor waits for a net has changed.
    pub fn takeover(&mut self, id: u32, waits: bool) {
        self.tap(|tap| tap.takeover(id, waits));
        self.event(|words| words.takeover(id, waits));
    }

    /// Programs wrote values of a net.
    pub fn inbox(&mut self, net: &Running) {
        self.tap(|tap| tap.inbox(net));
    }

    /// A machine is stepped from this cycle on.
    pub fn machine_added(&mut self, id: u32) {
        self.tap(|tap| tap.machine_added(id));
        self.event(|words| words.machine_added(id));
    }

    /// A machine is no longer stepped.
    pub fn machine_removed(&mut self, id: u32) {
        self.tap(|tap| tap.machine_removed(id));
        self.event(|words| words.machine_removed(id));
    }

    /// A net waits for the next start of a component.
    pub fn seated(&mut self, net: &Running, fresh: bool) {
        self.tap(|tap| tap.seated(net, fresh));
        self.event(|words| words.seated(net, fresh));
    }

    /// The net of a component could not be loaded.
    pub fn seat_failed(&mut self, machine: u32, component: usize) {
        self.tap(|tap| tap.seat_failed(machine, component));
    }

    /// A program requests something of a machine.
    pub fn machine_input(&mut self, machine: u32, input: &MachineInput) {
        self.tap(|tap| tap.machine_input(machine, input));
    }

    /// A machine was stepped.
    pub fn stepped(&mut self, hosted: &mut Hosted) {
        self.tap(|tap| tap.stepped(hosted));
        let id = hosted.id;
        hosted.changes(|number, word| self.event(|words| words.changed(id, number, word)));
    }

    /// Inputs of the cycle: what is noted from now on in it follows its evaluation.
    pub fn inputs(&mut self, moment: Moment, executor: &Executor) {
        self.tap(|tap| tap.inputs(moment, executor));
        let [_, cycle] = &mut self.head;
        *cycle |= 1;
    }

    /// A net's values for programs changed.
    pub fn outbox(&mut self, net: &Running) {
        self.tap(|tap| tap.outbox(net));
    }

    /// A net ended.
    pub fn ended(&mut self, id: u32, end: End) {
        self.tap(|tap| tap.ended(id, end));
        self.event(|words| words.ended(id, end));
    }

    /// Commands of the cycle.
    pub fn outputs(&mut self, moment: Moment, executor: &Executor) {
        self.tap(|tap| tap.outputs(moment, executor));
    }

    /// Ends the cycle's entry.
    pub fn finish(&mut self) {
        self.tap(Tap::finish);
    }
}

/// An event, read back from a row.
#[derive(Debug)]
pub(super) struct EventRow<'r> {
    /// The cycle.
    pub(super) cycle: u64,
    pub(super) entry: Entry<'r>,
}

impl<'r> EventRow<'r> {
    /// `None` if the row is damaged.
    pub(super) fn of(row: &'r [u64]) -> Option<Self> {
        let (&[_, cycle], entry) = row.split_first_chunk::<HEAD>()?;
        Some(Self {
            cycle: cycle >> 1,
            entry: Reader(entry).next().ok()??,
        })
    }
}

/// Whether an event with that word of its cycle followed the evaluation.
pub(super) const fn is_after(cycle: u64) -> bool {
    cycle & 1 != 0
}
