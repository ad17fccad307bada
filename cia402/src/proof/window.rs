//! Values of an object by PDO over the cycles of an upload, and whether the upload belongs to them. Which cycles those are
//! is decided elsewhere.

use super::objects::{Kind, Object};

/// Values of one object.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Window {
    first: Option<u32>,
    last: u32,
    /// Lowest and highest, as differences to the first: numbers wrap around.
    low: i64,
    high: i64,
    /// Bits that were not always the same.
    toggled: u32,
}

impl Window {
    pub(super) fn take(&mut self, object: Object, raw: u32) {
        let first = *self.first.get_or_insert(raw);
        self.last = raw;
        let difference = difference(object, raw, first);
        self.low = self.low.min(difference);
        self.high = self.high.max(difference);
        self.toggled |= raw ^ first;
    }

    pub(super) const fn last(&self) -> u32 {
        self.last
    }

    /// Whether a value by SDO belongs to these by PDO.
    pub(super) fn holds(&self, object: Object, sdo: u32) -> bool {
        let Some(first) = self.first else {
            return false;
        };
        let room = match object.kind() {
            Kind::Bits => return (sdo ^ first) & !self.toggled == 0,
            Kind::Exact => self.high - self.low,
            Kind::Measured(noise) => self.high - self.low + i64::from(noise),
        };
        let difference = difference(object, sdo, first);
        (self.low - room..=self.high + room).contains(&difference)
    }
}

/// From one value to another, the short way around.
fn difference(object: Object, to: u32, from: u32) -> i64 {
    let difference = object.number(to) - object.number(from);
    let span = 1_i64 << (8 * object.bytes());
    let half = span / 2;
    (difference + half).rem_euclid(span) - half
}

#[cfg(test)]
mod tests {
    use super::*;

    fn window(index: u16, values: &[u32]) -> (Object, Window) {
        let object = Object::of(index).unwrap();
        let mut window = Window::default();
        values.iter().for_each(|raw| window.take(object, *raw));
        (object, window)
    }

    #[test]
    fn measured_value_may_lie_beyond_by_its_own_spread() {
        let (object, window) = window(0x6064, &[1000, 1100, 1050]);
        assert!(window.holds(object, 892) && window.holds(object, 1208));
        assert!(!window.holds(object, 891) && !window.holds(object, 1209));
    }

    #[test]
    fn position_at_the_end_of_its_range_wraps() {
        let ends = [i32::MAX, i32::MIN, i32::MIN + 5].map(i32::cast_unsigned);
        let (object, window) = window(0x6064, &ends);
        assert!(window.holds(object, (i32::MIN + 6).cast_unsigned()));
        assert!(!window.holds(object, 0));
    }

    #[test]
    fn toggling_bits_are_not_compared() {
        let (object, window) = window(0x6041, &[0x0250, 0x1650, 0x0250]);
        assert!(window.holds(object, 0x0650) && window.holds(object, 0x1250));
        assert!(!window.holds(object, 0x0231) && !window.holds(object, 0x4250));
    }

    #[test]
    fn number_that_stands_still_is_exact() {
        let (object, window) = window(0x6061, &[0xFF, 0xFF]);
        assert!(window.holds(object, 0xFF) && !window.holds(object, 0xFE));
    }
}
