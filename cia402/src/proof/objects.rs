//! The objects that lead an axis by process data: which of them PDOs carry, and their values in a cycle. Where they lie
//! in a PDO is not known here.

use std::fmt;

use crate::dictionary::Address;

/// How many objects there are.
pub(super) const COUNT: usize = 15;

/// How an object is compared and shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// A word of bits, shown in hexadecimal.
    Bits,
    /// A number that is what it is.
    Exact,
    /// A measured number: it may change while it is read, and by so much for no reason at all.
    Measured(u32),
}

struct Row {
    index: u16,
    bytes: u8,
    /// The master sends it.
    sent: bool,
    kind: Kind,
}

const fn sent(index: u16, bytes: u8, kind: Kind) -> Row {
    Row {
        index,
        bytes,
        sent: true,
        kind,
    }
}

const fn received(index: u16, bytes: u8, kind: Kind) -> Row {
    Row {
        index,
        bytes,
        sent: false,
        kind,
    }
}

/// Sent objects first: the order in which they are proven. 60C1h:01 is not here: a record written is a record queued.
const ROWS: [Row; COUNT] = [
    sent(0x6040, 2, Kind::Bits),
    sent(0x6060, 1, Kind::Exact),
    sent(0x607A, 4, Kind::Exact),
    sent(0x60FF, 4, Kind::Exact),
    sent(0x6071, 2, Kind::Exact),
    sent(0x60B0, 4, Kind::Exact),
    sent(0x60B1, 4, Kind::Exact),
    sent(0x60B2, 2, Kind::Exact),
    received(0x6041, 2, Kind::Bits),
    received(0x6061, 1, Kind::Exact),
    received(0x6064, 4, Kind::Measured(8)),
    received(0x606C, 4, Kind::Measured(64)),
    received(0x6077, 2, Kind::Measured(20)),
    received(0x603F, 2, Kind::Bits),
    received(0x60FD, 4, Kind::Bits),
];

/// An object that leads an axis or says how it is.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Object(u8);

impl Object {
    /// Statusword.
    pub(super) const STATUS: Self = Self(8);
    /// Target position.
    pub(super) const TARGET: Self = Self(2);
    /// Controlword.
    pub(super) const CONTROL: Self = Self(0);
    /// Modes of operation.
    pub(super) const MODE: Self = Self(1);

    /// How many there are.
    pub const COUNT: usize = COUNT;

    /// All of them, those that the master sends first.
    pub fn all() -> impl Iterator<Item = Self> {
        (0_u8..).take(COUNT).map(Self)
    }

    /// The object of that index of the first axis; `None` if it leads no axis.
    pub const fn of(index: u16) -> Option<Self> {
        let mut at = 0;
        while at < COUNT {
            if ROWS[at].index == index {
                #[expect(clippy::cast_possible_truncation, reason = "less than COUNT")]
                return Some(Self(at as u8));
            }
            at += 1;
        }
        None
    }

    const fn row(self) -> &'static Row {
        &ROWS[self.0 as usize % COUNT]
    }

    /// Its index on the first axis.
    pub const fn index(self) -> u16 {
        self.row().index
    }

    /// Its address on an axis, 0 to 7.
    pub fn address(self, axis: u8) -> Address {
        let address = Address::new(self.index(), 0);
        address.on_axis(axis).unwrap_or(address)
    }

    /// Its length, bytes.
    pub const fn bytes(self) -> usize {
        self.row().bytes as usize
    }

    /// Whether the master sends it.
    pub const fn is_sent(self) -> bool {
        self.row().sent
    }

    pub(super) const fn kind(self) -> Kind {
        self.row().kind
    }

    /// The number of its bytes, with its sign.
    pub(super) fn number(self, raw: u32) -> i64 {
        let [a, b, ..] = raw.to_le_bytes();
        match (self.kind(), self.bytes()) {
            (Kind::Bits, _) => raw.into(),
            (_, 1) => a.cast_signed().into(),
            (_, 2) => i16::from_le_bytes([a, b]).into(),
            _ => raw.cast_signed().into(),
        }
    }

    pub(super) fn show(self, raw: u32, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.kind() {
            Kind::Bits => write!(f, "{raw:0width$X}h", width = 2 * self.bytes()),
            Kind::Exact | Kind::Measured(_) => write!(f, "{}", self.number(raw)),
        }
    }
}

impl fmt::Debug for Object {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:04X}h", self.index())
    }
}

/// A set of objects.
#[derive(Clone, Copy, Default, PartialEq, Eq)]
pub struct Objects(u16);

impl Objects {
    /// Those of these indices on the first axis.
    ///
    /// # Errors
    /// An index that leads no axis.
    pub fn of(indices: &[u16]) -> Result<Self, u16> {
        let mut all = Self::default();
        for index in indices {
            all.insert(Object::of(*index).ok_or(*index)?);
        }
        Ok(all)
    }

    /// Puts an object in.
    pub const fn insert(&mut self, object: Object) {
        self.0 |= 1 << object.0;
    }

    /// Whether an object is in it.
    pub const fn contains(self, object: Object) -> bool {
        self.0 >> object.0 & 1 == 1
    }

    /// Those that are in both.
    #[must_use]
    pub const fn common(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }

    /// Whether none is in it.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }
}

impl fmt::Display for Objects {
    /// `607Ah, 60FFh`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut first = true;
        for object in Object::all().filter(|object| self.contains(*object)) {
            write!(f, "{}{object:?}", if first { "" } else { ", " })?;
            first = false;
        }
        Ok(())
    }
}

impl fmt::Debug for Objects {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{{{self}}}")
    }
}

/// Values of objects in a cycle, as their bytes lie on the wire, lowest first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Values([u32; COUNT]);

impl Values {
    /// The value of an object.
    pub fn get(&self, object: Object) -> u32 {
        self.0.get(usize::from(object.0)).copied().unwrap_or(0)
    }

    /// Sets the value of an object: as many of its low bytes as the object has.
    pub fn set(&mut self, object: Object, raw: u32) {
        let bits = 8 * u32::try_from(object.bytes()).unwrap_or(4);
        if let Some(value) = self.0.get_mut(usize::from(object.0)) {
            *value = raw & (u32::MAX >> (32 - bits));
        }
    }

    /// The value of the object of that index; zero if there is none.
    pub fn at(&self, index: u16) -> u32 {
        Object::of(index).map_or(0, |object| self.get(object))
    }

    /// Sets the value of the object of that index.
    pub fn put(&mut self, index: u16, raw: u32) {
        if let Some(object) = Object::of(index) {
            self.set(object, raw);
        }
    }
}
