//! A queue of fixed capacity, allocated at load time: pushing into a full queue replaces the oldest
//! value. It knows no time.

/// The last values pushed.
#[derive(Debug)]
pub(super) struct Ring<T> {
    values: Box<[T]>,
    /// Index of the next value.
    next: usize,
    len: usize,
}

impl<T: Copy> Ring<T> {
    /// An empty ring for `capacity` (at least 1) values.
    pub(super) fn new(capacity: usize, fill: T) -> Self {
        Self {
            values: vec![fill; capacity.max(1)].into_boxed_slice(),
            next: 0,
            len: 0,
        }
    }

    pub(super) const fn capacity(&self) -> usize {
        self.values.len()
    }

    pub(super) const fn len(&self) -> usize {
        self.len
    }

    /// Whether the next value goes to index 0, so that the ring has wrapped around.
    pub(super) const fn at_start(&self) -> bool {
        self.next == 0
    }

    /// Adds a value; returns the one that it replaced.
    pub(super) fn push(&mut self, value: T) -> Option<T> {
        let full = self.len == self.capacity();
        let old = std::mem::replace(&mut self.values[self.next], value);
        self.next = (self.next + 1) % self.capacity();
        self.len += usize::from(!full);
        full.then_some(old)
    }

    /// The value pushed `back` values before the newest.
    pub(super) fn get(&self, back: usize) -> Option<T> {
        let index = (self.next + self.capacity() - 1).checked_sub(back)? % self.capacity();
        (back < self.len).then(|| self.values[index])
    }

    pub(super) const fn clear(&mut self) {
        (self.next, self.len) = (0, 0);
    }
}

#[cfg(test)]
mod tests {
    use super::Ring;

    #[test]
    fn keeps_the_last_values() {
        let mut ring = Ring::new(3, 0);
        assert_eq!(ring.get(0), None);
        for i in 1..=5 {
            assert_eq!(ring.push(i), (i > 3).then(|| i - 3));
        }
        assert_eq!(
            [0, 1, 2, 3].map(|back| ring.get(back)),
            [Some(5), Some(4), Some(3), None]
        );
        ring.clear();
        assert_eq!((ring.len(), ring.get(0)), (0, None));
    }
}
