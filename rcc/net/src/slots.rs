//! The arena of a plan: every port has a slot, with one column per value type, and primitives read
//! and write slots through typed handles. Slots are `Cell`s, so a step needs no exclusive access; a
//! plan belongs to one thread at a time. A handle fits the plan it was built for, which is not
//! checked: in another plan it may read null and write nothing, but cannot panic. This keeps the
//! code of a step short.

mod ports;

use std::cell::Cell;
use std::marker::PhantomData;

use crate::value::text::{TextValue, format_array};
use crate::value::{Element, Frame, Nanos, Rotation, Twist, Type, Value, Vector, Wrench};

/// All slots of one value type.
#[derive(Debug)]
pub struct Column<T: Copy> {
    /// One slot per scalar port; slot 0 is always null, for "not connected".
    scalars: Box<[Cell<Option<T>>]>,
    /// The elements of all arrays, one after the other.
    elements: Box<[Cell<T>]>,
    /// Whether an array is non-null, by array number; array 0 is always null.
    present: Box<[Cell<bool>]>,
}

/// One column for each value type.
#[derive(Debug)]
pub struct Slots {
    pub(crate) bool: Column<bool>,
    pub(crate) int: Column<i32>,
    pub(crate) double: Column<f64>,
    pub(crate) nanos: Column<Nanos>,
    pub(crate) vector: Column<Vector>,
    pub(crate) rotation: Column<Rotation>,
    pub(crate) frame: Column<Frame>,
    pub(crate) twist: Column<Twist>,
    pub(crate) wrench: Column<Wrench>,
}

/// Evaluates one generic expression for the Rust type of an [`Element`].
macro_rules! for_element {
    ($element:expr, $T:ident => $body:expr) => {
        match $element {
            $crate::value::Element::Bool => {
                type $T = bool;
                $body
            }
            $crate::value::Element::Int => {
                type $T = i32;
                $body
            }
            $crate::value::Element::Double => {
                type $T = f64;
                $body
            }
            $crate::value::Element::Nanos => {
                type $T = $crate::value::Nanos;
                $body
            }
            $crate::value::Element::Vector => {
                type $T = $crate::value::Vector;
                $body
            }
            $crate::value::Element::Rotation => {
                type $T = $crate::value::Rotation;
                $body
            }
            $crate::value::Element::Frame => {
                type $T = $crate::value::Frame;
                $body
            }
            $crate::value::Element::Twist => {
                type $T = $crate::value::Twist;
                $body
            }
            $crate::value::Element::Wrench => {
                type $T = $crate::value::Wrench;
                $body
            }
        }
    };
}
pub(crate) use for_element;

/// An in port: reads the slot that it is linked to.
#[derive(Debug)]
pub struct In<T>(pub(crate) u32, pub(crate) PhantomData<fn() -> T>);

/// An out port: writes its own slot.
#[derive(Debug)]
pub struct Out<T>(pub(crate) u32, pub(crate) PhantomData<fn() -> T>);

/// The location of an array in its column.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct ArraySlot {
    pub(crate) number: u32,
    pub(crate) start: u32,
    pub(crate) len: u32,
}

/// An in port that carries a fixed array.
#[derive(Debug)]
pub struct ArrayIn<T>(pub(crate) ArraySlot, pub(crate) PhantomData<fn() -> T>);

/// An out port that carries a fixed array.
#[derive(Debug)]
pub struct ArrayOut<T>(pub(crate) ArraySlot, pub(crate) PhantomData<fn() -> T>);

impl<T> Clone for In<T> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<T> Copy for In<T> {}
impl<T> Clone for Out<T> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<T> Copy for Out<T> {}

impl<T: Value> In<T> {
    #[inline]
    pub(crate) fn read(self, slots: &Slots) -> Option<T> {
        T::column(slots).scalars.get(self.0 as usize)?.get()
    }
}

impl<T: Value> ArrayIn<T> {
    /// Number of elements that the source of this port carries; known at load time.
    pub fn len(&self) -> usize {
        self.0.len as usize
    }

    /// Whether the port carries no elements.
    pub fn is_empty(&self) -> bool {
        self.0.len == 0
    }
}

impl<T: Value> ArrayOut<T> {
    /// Number of elements that the port carries.
    pub fn len(&self) -> usize {
        self.0.len as usize
    }

    /// Whether the port carries no elements.
    pub fn is_empty(&self) -> bool {
        self.0.len == 0
    }
}

impl<T: Copy> Column<T> {
    fn elements_of(&self, slot: ArraySlot) -> &[Cell<T>] {
        &self.elements[slot.start as usize..(slot.start + slot.len) as usize]
    }

    fn bytes(&self) -> usize {
        size_of_val(&*self.scalars) + size_of_val(&*self.elements) + size_of_val(&*self.present)
    }
}

impl Slots {
    /// Memory of all slots, in bytes.
    pub(crate) fn bytes(&self) -> usize {
        Element::ALL
            .into_iter()
            .map(|e| for_element!(e, T => <T as Value>::column(self).bytes()))
            .sum()
    }
}

/// A slot of any type: enough to set it to null, or to read it as a value of its type.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum SlotRef {
    Scalar { element: Element, slot: u32 },
    Array { element: Element, slot: ArraySlot },
}

impl SlotRef {
    /// The slot that is always null, for ports without a source.
    pub(crate) const fn null(ty: Type) -> Self {
        if ty.array {
            let slot = ArraySlot {
                number: 0,
                start: 0,
                len: 0,
            };
            Self::Array {
                element: ty.element,
                slot,
            }
        } else {
            Self::Scalar {
                element: ty.element,
                slot: 0,
            }
        }
    }

    /// The text of the value; `None` while it is null.
    pub(crate) fn text(self, slots: &Slots) -> Option<String> {
        let mut out = String::new();
        match self {
            Self::Scalar { element, slot } => for_element!(element, T => {
                let value = <T as Value>::column(slots).scalars[slot as usize].get()?;
                value.format(&mut out);
            }),
            Self::Array { element, slot } => for_element!(element, T => {
                let column = <T as Value>::column(slots);
                if !column.present[slot.number as usize].get() {
                    return None;
                }
                format_array(column.elements_of(slot).iter().map(Cell::get), &mut out);
            }),
        }
        Some(out)
    }

    /// Number of words of the value.
    pub(crate) fn words(self) -> usize {
        match self {
            Self::Scalar { element, .. } => for_element!(element, T => <T as Value>::WORDS),
            Self::Array { element, slot } => {
                for_element!(element, T => <T as Value>::WORDS * slot.len as usize)
            }
        }
    }

    /// Writes the value's words; returns whether it is non-null, else nothing is written.
    pub(crate) fn put(self, slots: &Slots, out: &mut [u64]) -> bool {
        match self {
            Self::Scalar { element, slot } => for_element!(element, T => {
                let Some(value) = <T as Value>::column(slots).scalars[slot as usize].get() else {
                    return false;
                };
                put(value, out);
            }),
            Self::Array { element, slot } => for_element!(element, T => {
                let column = <T as Value>::column(slots);
                if !column.present[slot.number as usize].get() {
                    return false;
                }
                let cells = column.elements_of(slot).iter();
                for (cell, chunk) in cells.zip(out.chunks_exact_mut(<T as Value>::WORDS)) {
                    put(cell.get(), chunk);
                }
            }),
        }
        true
    }

    pub(crate) fn clear(self, slots: &Slots) {
        match self {
            Self::Scalar { element, slot } => {
                for_element!(element, T => <T as Value>::column(slots).scalars[slot as usize].set(None));
            }
            Self::Array { element, slot } => {
                for_element!(element, T => <T as Value>::column(slots).present[slot.number as usize].set(false));
            }
        }
    }
}

/// Writes as many words of a value as fit.
fn put<T: Value>(value: T, out: &mut [u64]) {
    value.put(|i, word| {
        if let Some(word_out) = out.get_mut(i) {
            *word_out = word;
        }
    });
}

/// Collects slots while a plan is built.
#[doc(hidden)]
#[derive(Debug, Default)]
pub struct SlotsBuilder {
    pub(crate) bool: ColumnBuilder<bool>,
    pub(crate) int: ColumnBuilder<i32>,
    pub(crate) double: ColumnBuilder<f64>,
    pub(crate) nanos: ColumnBuilder<Nanos>,
    pub(crate) vector: ColumnBuilder<Vector>,
    pub(crate) rotation: ColumnBuilder<Rotation>,
    pub(crate) frame: ColumnBuilder<Frame>,
    pub(crate) twist: ColumnBuilder<Twist>,
    pub(crate) wrench: ColumnBuilder<Wrench>,
}

/// The slots of one type while a plan is built.
#[doc(hidden)]
#[derive(Debug)]
pub struct ColumnBuilder<T: Copy> {
    scalars: Vec<Cell<Option<T>>>,
    elements: Vec<Cell<T>>,
    present: Vec<Cell<bool>>,
}

impl<T: Copy> Default for ColumnBuilder<T> {
    fn default() -> Self {
        Self {
            scalars: vec![Cell::new(None)],
            elements: Vec::new(),
            present: vec![Cell::new(false)],
        }
    }
}

fn index(len: usize) -> u32 {
    u32::try_from(len).expect("Limits bounds the number of ports and elements far below 2^32")
}

impl<T: Copy> ColumnBuilder<T> {
    /// A new scalar slot with an initial value.
    pub(crate) fn scalar(&mut self, initial: Option<T>) -> u32 {
        self.scalars.push(Cell::new(initial));
        index(self.scalars.len() - 1)
    }

    /// A new array slot; null unless `initial` provides its elements.
    pub(crate) fn array(&mut self, len: usize, fill: T, initial: Option<&[T]>) -> ArraySlot {
        let slot = ArraySlot {
            number: index(self.present.len()),
            start: index(self.elements.len()),
            len: index(len),
        };
        self.present.push(Cell::new(initial.is_some()));
        match initial {
            Some(values) => self.elements.extend(values.iter().copied().map(Cell::new)),
            None => self.elements.extend((0..len).map(|_| Cell::new(fill))),
        }
        slot
    }

    fn finish(self) -> Column<T> {
        Column {
            scalars: self.scalars.into_boxed_slice(),
            elements: self.elements.into_boxed_slice(),
            present: self.present.into_boxed_slice(),
        }
    }
}

impl SlotsBuilder {
    pub(crate) fn scalar(&mut self, element: Element) -> SlotRef {
        let slot = for_element!(element, T => <T as Value>::builder(self).scalar(None));
        SlotRef::Scalar { element, slot }
    }

    pub(crate) fn array(&mut self, element: Element, len: usize) -> SlotRef {
        let slot =
            for_element!(element, T => <T as Value>::builder(self).array(len, T::default(), None));
        SlotRef::Array { element, slot }
    }

    pub(crate) fn finish(self) -> Slots {
        Slots {
            bool: self.bool.finish(),
            int: self.int.finish(),
            double: self.double.finish(),
            nanos: self.nanos.finish(),
            vector: self.vector.finish(),
            rotation: self.rotation.finish(),
            frame: self.frame.finish(),
            twist: self.twist.finish(),
            wrench: self.wrench.finish(),
        }
    }
}
