//! The parameters of a youBot drive: their values at power-on and write access. Those that show a measurement are
//! answered by the drive itself.

use super::tmcl::Rejection;

/// Write access of a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Access {
    Free,
    /// After unlocking by parameter 248.
    Protected,
    ReadOnly,
}

use Access::{Free, Protected, ReadOnly};

/// Number, value at power-on, access, smallest and largest value.
type Row = (u8, i32, Access, i32, i32);

const ANY: (i32, i32) = (i32::MIN, i32::MAX);

const fn row(number: u8, value: i32, access: Access) -> Row {
    (number, value, access, ANY.0, ANY.1)
}

/// Axis parameters of the drive, except the gains.
const TABLE: [Row; 40] = [
    row(0, 0, Free),
    row(1, 0, Free),
    row(2, 0, Free),
    row(3, 0, ReadOnly),
    (4, 4000, Free, 0, 100_000),
    (6, 8000, Free, 0, 100_000),
    (7, 10_000, Free, 0, 100_000),
    (8, 0, Free, 0, 100_000),
    (9, 3, Free, 0, 100_000),
    (10, 100, Free, 0, 1_000_000),
    (11, 5000, Free, 0, 10_000_000),
    (12, 0, Free, 0, 100_000),
    row(13, 0, ReadOnly),
    (14, 500, Free, 0, 100_000),
    (15, 0, Free, 0, 1),
    (25, 4000, Protected, 0, 1_000_000),
    (26, 211_200, Protected, 0, i32::MAX),
    row(27, 0, ReadOnly),
    row(28, 0, ReadOnly),
    row(29, 0, Free),
    row(30, 120, ReadOnly),
    (31, 0, Free, 0, 1),
    (146, 1, Free, 0, 1),
    row(150, 0, ReadOnly),
    row(151, 2400, ReadOnly),
    row(152, 1200, ReadOnly),
    row(155, 0, ReadOnly),
    row(156, 0, ReadOnly),
    row(157, 300, ReadOnly),
    row(158, 0, Free),
    (159, 3, Protected, 0, 5),
    row(165, 0, Protected),
    (177, 1700, Protected, 0, 100_000),
    (244, 500, Protected, 0, 100_000),
    (245, 0, Protected, 0, 1),
    row(248, 0, Free),
    (249, 2, Protected, 0, 2),
    (250, 4000, Protected, 0, 1_000_000),
    (251, 1, Protected, 0, 1),
    (253, 16, Protected, 2, 254),
];

/// Gains of the control loops: free, 0 to 65535.
const GAINS: [(u8, u8); 5] = [(130, 135), (140, 143), (172, 175), (230, 233), (234, 237)];

/// Axis parameters of a gripper bar.
const BAR: [Row; 17] = [
    row(0, 0, Free),
    row(1, 0, Free),
    row(2, 0, Free),
    row(3, 0, ReadOnly),
    (4, 1000, Free, 0, 2047),
    (5, 500, Free, 0, 2047),
    (6, 150, Free, 0, 255),
    (7, 8, Free, 0, 255),
    row(8, 1, ReadOnly),
    (140, 4, Free, 0, 8),
    (173, 1, Free, 0, 1),
    (174, 0, Free, -64, 63),
    (181, 0, Free, 0, 2047),
    (204, 0, Free, 0, 65_535),
    row(206, 0, ReadOnly),
    row(208, 0, ReadOnly),
    (153, 7, Free, 0, 13),
];

/// Global parameters of the drive: bank, number, value, access.
const GLOBAL: [(u8, u8, i32, Access); 4] = [
    (0, 90, 100, Protected),
    // "Calibrated": volatile, and two more used by some drivers.
    (2, 16, 0, Free),
    (2, 17, 0, Free),
    (2, 18, 0, Free),
];

/// Parameters with their values.
#[derive(Clone, Debug)]
pub(super) struct Parameters {
    rows: Vec<Row>,
    stored: Vec<Row>,
}

impl Parameters {
    /// The parameters of the drive.
    pub(super) fn drive() -> Self {
        let gains = GAINS.iter().flat_map(|(first, last)| *first..=*last);
        let gains = gains.map(|number| (number, 1000, Free, 0, 65_535));
        let invert = [(254, 0, Protected, 0, 1)];
        Self::of(TABLE.into_iter().chain(gains).chain(invert).collect())
    }

    /// The parameters of a gripper bar.
    pub(super) fn bar() -> Self {
        Self::of(BAR.to_vec())
    }

    /// The global parameters of a bank.
    pub(super) fn bank(bank: u8) -> Self {
        let own = GLOBAL.iter().filter(|(of, ..)| *of == bank);
        let rows = own.map(|(_, number, value, access)| row(*number, *value, *access));
        let user = (0..16).map(|number| row(number, 0, Protected));
        let user = user.filter(|_| bank == 2);
        Self::of(rows.chain(user).collect())
    }

    fn of(rows: Vec<Row>) -> Self {
        Self {
            stored: rows.clone(),
            rows,
        }
    }

    pub(super) fn get(&self, number: u8) -> Result<i32, Rejection> {
        let row = self.rows.iter().find(|row| row.0 == number);
        row.map(|row| row.1).ok_or(Rejection::WrongType)
    }

    /// The value of an existing parameter, else 0.
    pub(super) fn value(&self, number: u8) -> i32 {
        self.get(number).unwrap_or(0)
    }

    /// Handles a write from the bus.
    pub(super) fn write(
        &mut self,
        number: u8,
        value: i32,
        unlocked: bool,
    ) -> Result<(), Rejection> {
        let row = self.rows.iter_mut().find(|row| row.0 == number);
        let (_, to, access, low, high) = row.ok_or(Rejection::WrongType)?;
        match access {
            ReadOnly => return Err(Rejection::WrongType),
            Protected if !unlocked => return Err(Rejection::WriteProtected),
            Protected | Free => {}
        }
        if value < *low || value > *high {
            return Err(Rejection::InvalidValue);
        }
        *to = value;
        Ok(())
    }

    /// Sets a measured value.
    pub(super) fn set(&mut self, number: u8, value: i32) {
        if let Some(row) = self.rows.iter_mut().find(|row| row.0 == number) {
            row.1 = value;
        }
    }

    /// Stores a parameter permanently, or restores it.
    pub(super) fn store(&mut self, number: u8, restore: bool) -> Result<i32, Rejection> {
        let (from, to) = if restore {
            (&self.stored, &mut self.rows)
        } else {
            (&self.rows, &mut self.stored)
        };
        let find = |rows: &[Row]| rows.iter().find(|row| row.0 == number).copied();
        let found = find(from).ok_or(Rejection::WrongType)?;
        if let Some(row) = to.iter_mut().find(|row| row.0 == number) {
            *row = found;
        }
        Ok(found.1)
    }

    /// Power-on: restores stored values.
    pub(super) fn reset(&mut self) {
        self.rows.clone_from(&self.stored);
    }
}

/// The nearest whole number that fits.
pub(super) fn whole(value: f64) -> i32 {
    #[expect(clippy::cast_possible_truncation, reason = "it saturates")]
    let whole = value.round() as i32;
    whole
}
