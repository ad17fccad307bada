//! Terminals of incremental encoders (EL5101 and EL5151 kind): the counter beyond its wraps, the latch of the C pulse and the
//! setting of the counter, by their hand-shakes. What the counts mean is up to the owner.

use takt_cia402::dictionary::Address;

use crate::axis::NotMapped;
use crate::master::{Master, ProcessData};

/// The objects of the first channel, of the newer kind and of the older.
const FIRST: [(u16, u16); 2] = [(0x6000, 0x7000), (0x6010, 0x7010)];
/// From an object of one channel to that of the next.
const CHANNEL: u16 = 0x10;
/// Channels of a terminal, at most.
pub const CHANNELS_MAX: u8 = 4;

/// First bit and number of bits.
type Place = (usize, usize);

/// Where the values of a channel are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Places {
    counter: Place,
    open_circuit: Option<Place>,
    latch: Option<Latch>,
    set: Option<Set>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Latch {
    enable: Place,
    valid: Place,
    value: Place,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Set {
    set: Place,
    done: Place,
    value: Place,
}

/// Progress of the latch: the terminal arms it again only after it was taken back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum LatchState {
    Idle,
    Armed,
    Latched(i64),
}

/// Progress of setting the counter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum SetState {
    Idle,
    Asked(u32),
    Done,
}

/// A channel of an encoder terminal.
#[derive(Clone, Copy, Debug)]
pub struct Encoder {
    slave: usize,
    places: Places,
    /// The counter as last read, and beyond its wraps.
    last: Option<u32>,
    count: i64,
    latch: LatchState,
    set: SetState,
}

/// What an encoder shows in a cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EncoderReading {
    /// Its slave answers; the other fields are of this cycle or of the last few.
    pub online: bool,
    /// Counts beyond the wraps of the counter; those of the terminal at the first reading.
    pub count: i64,
    /// Count at the C pulse, once one came after arming.
    pub latched: Option<i64>,
    /// The terminal has set its counter: counts go on from there.
    pub was_set: bool,
    /// The terminal detects a broken wire.
    pub open_circuit: bool,
}

impl Encoder {
    /// The channel (from 0) of a slave whose process data is known.
    ///
    /// # Errors
    /// If its counter is not mapped.
    pub fn new(slave: usize, process: &ProcessData, channel: u8) -> Result<Self, NotMapped> {
        let step = CHANNEL * u16::from(channel);
        let find = |index: u16, sub: u8, outputs| {
            let found = process.locate(Address::new(index + step, sub), outputs)?;
            Some((found.bit, usize::from(found.bits)))
        };
        let all = FIRST.into_iter().find_map(|(inputs, outputs)| {
            let counter = find(inputs, 0x11, false)?;
            let [read, write] = [(inputs, false), (outputs, true)];
            let at = |(index, is_output): (u16, bool), sub| find(index, sub, is_output);
            let latch = || {
                Some(Latch {
                    enable: at(write, 0x01)?,
                    valid: at(read, 0x01)?,
                    value: at(read, 0x12)?,
                })
            };
            let set = || {
                Some(Set {
                    set: at(write, 0x03)?,
                    done: at(read, 0x03)?,
                    value: at(write, 0x11)?,
                })
            };
            Some(Places {
                counter,
                open_circuit: at(read, 0x07),
                latch: latch(),
                set: set(),
            })
        });
        let missing = NotMapped {
            address: Address::new(0x6000 + step, 0x11),
        };
        let usable = all.filter(|it| matches!(it.counter.1, 16 | 32));
        Ok(Self {
            slave,
            places: usable.ok_or(missing)?,
            last: None,
            count: 0,
            latch: LatchState::Idle,
            set: SetState::Idle,
        })
    }

    /// Whether the latch of the C pulse is mapped.
    pub const fn has_latch(&self) -> bool {
        self.places.latch.is_some()
    }

    /// Asks the terminal to set its counter. False if that is not mapped or still under way.
    pub fn set_counter(&mut self, value: u32) -> bool {
        let is_free = self.places.set.is_some() && !matches!(self.set, SetState::Asked(_));
        if is_free {
            self.set = SetState::Asked(value);
        }
        is_free
    }

    /// One cycle: reads the inputs of the last frame and writes the outputs of the next. `arm` keeps the latch armed until it
    /// has a value, and that value until `arm` is taken back.
    pub fn cycle(&mut self, master: &mut Master, arm: bool) -> EncoderReading {
        let (inputs, age) = master.inputs(self.slave);
        let online = master.is_online(age);
        if !online {
            // What it counted meanwhile is unknown, and its firmware may have restarted.
            (self.latch, self.set) = (LatchState::Idle, SetState::Idle);
        }
        let bit = |place: Place| read(inputs, place).is_some_and(|raw| raw != 0);
        let mut reading = EncoderReading {
            online,
            open_circuit: self.places.open_circuit.is_some_and(bit),
            ..EncoderReading::default()
        };
        let mut writes = [None; 3];
        if let Some(raw) = read(inputs, self.places.counter).filter(|_| online) {
            if let Some(set) = self.places.set {
                reading.was_set = self.follow_set(bit(set.done));
                let value = if let SetState::Asked(value) = self.set {
                    Some(value)
                } else {
                    None
                };
                writes[0] = Some((set.set, u32::from(value.is_some())));
                writes[1] = value.map(|value| (set.value, value));
            }
            self.count += self.difference(raw, self.last.unwrap_or(raw));
            if self.last.is_none() {
                self.count = self.difference(raw, 0);
            }
            self.last = Some(raw);
            if let Some(latch) = self.places.latch {
                let value = read(inputs, latch.value).filter(|_| bit(latch.valid));
                let value = value.map(|value| self.count + self.difference(value, raw));
                self.follow_latch(arm, value);
            }
        }
        if let Some(latch) = self.places.latch {
            let armed = !matches!(self.latch, LatchState::Idle);
            writes[2] = Some((latch.enable, u32::from(armed)));
        }
        reading.count = self.count;
        if let LatchState::Latched(at) = self.latch {
            reading.latched = Some(at);
        }
        let outputs = master.outputs_mut(self.slave);
        for (place, value) in writes.into_iter().flatten() {
            write(outputs, place, value);
        }
        reading
    }

    /// The latch is armed only after the terminal has shown that it is not valid any more.
    const fn follow_latch(&mut self, arm: bool, value: Option<i64>) {
        self.latch = match (arm, self.latch, value) {
            (false, ..) | (true, LatchState::Idle, Some(_)) => LatchState::Idle,
            (true, LatchState::Idle | LatchState::Armed, None) => LatchState::Armed,
            (true, LatchState::Armed, Some(at)) => LatchState::Latched(at),
            (true, LatchState::Latched(at), _) => LatchState::Latched(at),
        };
    }

    /// Returns whether the counter was set in this cycle; differences to the former counter mean nothing then.
    fn follow_set(&mut self, done: bool) -> bool {
        let asked = match (self.set, done) {
            (SetState::Asked(value), true) => {
                self.set = SetState::Done;
                Some(value)
            }
            (SetState::Done, false) => {
                self.set = SetState::Idle;
                None
            }
            (SetState::Idle | SetState::Asked(_) | SetState::Done, _) => None,
        };
        if let Some(value) = asked {
            self.count = self.difference(value, 0);
            self.last = Some(value);
        }
        asked.is_some()
    }

    /// From one counter to another, over at most one wrap.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "a counter of 16 bits wraps at 16 bits"
    )]
    fn difference(&self, to: u32, from: u32) -> i64 {
        let moved = to.wrapping_sub(from);
        match self.places.counter.1 {
            16 => i64::from((moved as u16).cast_signed()),
            _ => i64::from(moved.cast_signed()),
        }
    }
}

fn read(bytes: &[u8], (first, count): Place) -> Option<u32> {
    let mut raw = 0;
    for n in 0..count.min(32) {
        let at = first + n;
        raw |= u32::from(bytes.get(at / 8)? >> (at % 8) & 1) << n;
    }
    Some(raw)
}

fn write(bytes: &mut [u8], (first, count): Place, value: u32) {
    for n in 0..count.min(32) {
        let at = first + n;
        if let Some(byte) = bytes.get_mut(at / 8) {
            let mask = 1 << (at % 8);
            *byte = if value >> n & 1 == 0 {
                *byte & !mask
            } else {
                *byte | mask
            };
        }
    }
}
