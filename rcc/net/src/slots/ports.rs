//! Reading and writing of ports in a cycle. The arena itself knows no cycle.

use std::cell::Cell;

use super::{ArrayIn, ArrayOut, In, Out};
use crate::cycle::Cycle;
use crate::value::Value;

impl<T: Value> In<T> {
    /// The value of this cycle; `None` is null.
    #[inline]
    pub fn get(self, cycle: &Cycle<'_>) -> Option<T> {
        self.read(cycle.slots)
    }
}

impl<T: Value> Out<T> {
    /// Sets the value of this cycle; `None` is null.
    #[inline]
    pub fn set(self, cycle: &Cycle<'_>, value: impl Into<Option<T>>) {
        if let Some(slot) = T::column(cycle.slots).scalars.get(self.0 as usize) {
            slot.set(value.into());
        }
    }

    /// The slot read back: the value last written.
    #[inline]
    pub fn held(self, cycle: &Cycle<'_>) -> Option<T> {
        T::column(cycle.slots).scalars.get(self.0 as usize)?.get()
    }
}

impl<T: Value> ArrayIn<T> {
    /// The elements of this cycle; `None` is null.
    #[inline]
    pub fn get<'a>(&self, cycle: &Cycle<'a>) -> Option<&'a [Cell<T>]> {
        let column = T::column(cycle.slots);
        column.present[self.0.number as usize]
            .get()
            .then(|| column.elements_of(self.0))
    }
}

impl<T: Value> ArrayOut<T> {
    /// Fills the array from `values`, which must yield at least as many elements; the rest is
    /// ignored.
    #[inline]
    pub fn set(&self, cycle: &Cycle<'_>, values: impl Iterator<Item = T>) {
        let column = T::column(cycle.slots);
        for (cell, value) in column.elements_of(self.0).iter().zip(values) {
            cell.set(value);
        }
        column.present[self.0.number as usize].set(true);
    }

    /// Sets the whole array to null.
    #[inline]
    pub fn set_null(&self, cycle: &Cycle<'_>) {
        T::column(cycle.slots).present[self.0.number as usize].set(false);
    }
}
