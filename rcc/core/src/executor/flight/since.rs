//! Rows of a ring since an instant, without a copy of all of it.

use std::sync::atomic::Ordering;

use super::FlightReader;

impl FlightReader {
    /// Bytes of the ring.
    #[must_use]
    pub fn bytes(&self) -> usize {
        size_of_val(&*self.ring.words)
    }

    /// The cursor of the first row whose word `key` is at least `since`; these words never decrease.
    #[must_use]
    pub fn cursor_at(&self, since: i64, key: usize) -> u64 {
        let ring = &*self.ring;
        let mut high = ring.written.load(Ordering::Acquire);
        let mut low = high.saturating_sub(ring.rows as u64);
        while low < high {
            let middle = low + (high - low) / 2;
            let row = usize::try_from(middle % ring.rows as u64).unwrap_or(0);
            let word = ring.words.get(row * ring.width + key);
            let word = word.map_or(0, |word| word.load(Ordering::Relaxed));
            if word.cast_signed() < since {
                low = middle + 1;
            } else {
                high = middle;
            }
        }
        low
    }

    /// The last row; empty if there is none.
    #[must_use]
    pub fn last(&self) -> Vec<u64> {
        let (mut cursor, mut words) = (self.end().saturating_sub(1), Vec::new());
        self.read_since(&mut cursor, 1, &mut words);
        words
    }

    /// The rows whose word `key` is at least `since`, oldest first; these words never decrease.
    #[must_use]
    pub fn rows_since(&self, since: i64, key: usize) -> Vec<Vec<u64>> {
        let (mut cursor, mut words) = (self.cursor_at(since, key), Vec::new());
        self.read_since(&mut cursor, self.rows_max(), &mut words);
        words
            .chunks_exact(self.width())
            .map(<[u64]>::to_vec)
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::ring;

    #[test]
    fn rows_since_instant_begin_with_it() {
        let (mut writer, reader) = ring(2, 8);
        for n in 0..11 {
            writer.write([n, n * 10].into_iter());
        }
        let first = |since| reader.rows_since(since, 1).first().map(|row| row[0]);
        assert_eq!(first(75), Some(8));
        assert_eq!(first(80), Some(8));
        assert_eq!(first(0), Some(3), "older ones are overwritten");
        assert_eq!(first(101), None);
    }
}
