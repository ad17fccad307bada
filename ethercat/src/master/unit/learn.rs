//! Asks a slave which PDOs it has assigned and what is mapped into them (1C12h, 1C13h, 1600h, 1A00h and following),
//! object by object. What is wanted instead is not known here.

use takt_cia402::dictionary::{Address, Mapped};

use super::super::process::Pdo;

/// Where the questions are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Place {
    /// How many PDOs are assigned?
    #[default]
    Count,
    /// Which is the n-th?
    Index(u8),
    /// How many entries has it?
    Entries,
    /// Which is the n-th?
    Entry(u8),
}

/// The questions about one SyncManager.
#[derive(Clone, Debug, Default)]
pub(super) struct Learn {
    /// 1C10h and the number of the SyncManager.
    list: u16,
    place: Place,
    pdos: Vec<Pdo>,
    /// PDOs assigned, and entries of the PDO that is asked about.
    counts: (u8, u8),
    /// The PDO that is asked about.
    at: usize,
}

/// PDOs of one SyncManager, at most: what a slave says is bounded.
const PDOS_MAX: u8 = 64;

impl Learn {
    /// About the list of a SyncManager.
    pub(super) fn new(list: u16) -> Self {
        Self {
            list,
            ..Self::default()
        }
    }

    /// The object that is asked for next; `None` when all is known.
    pub(super) fn question(&self) -> Option<Address> {
        let pdo = self.pdos.get(self.at).map(|pdo| pdo.index);
        match self.place {
            Place::Count => Some(Address::new(self.list, 0)),
            Place::Index(number) => Some(Address::new(self.list, number)),
            Place::Entries => pdo.map(|index| Address::new(index, 0)),
            Place::Entry(number) => pdo.map(|index| Address::new(index, number)),
        }
    }

    /// Whether the next question is about the list itself.
    pub(super) const fn is_at_list(&self) -> bool {
        matches!(self.place, Place::Count)
    }

    /// The answer: as many bytes as the slave gave.
    pub(super) fn answer(&mut self, bytes: &[u8]) {
        let mut four = [0; 4];
        for (to, from) in four.iter_mut().zip(bytes) {
            *to = *from;
        }
        let [low, high, ..] = four;
        match self.place {
            Place::Count => {
                self.counts.0 = low.min(PDOS_MAX);
                self.place = if self.counts.0 == 0 {
                    Place::Entries
                } else {
                    Place::Index(1)
                };
            }
            Place::Index(number) => {
                let index = u16::from_le_bytes([low, high]);
                self.pdos.push(Pdo {
                    index,
                    entries: Vec::new(),
                });
                self.place = if number < self.counts.0 {
                    Place::Index(number + 1)
                } else {
                    Place::Entries
                };
            }
            Place::Entries => {
                self.counts.1 = low;
                if low == 0 {
                    self.next_pdo();
                } else {
                    self.place = Place::Entry(1);
                }
            }
            Place::Entry(number) => {
                if let Some(pdo) = self.pdos.get_mut(self.at) {
                    pdo.entries.push(Mapped::from_raw(u32::from_le_bytes(four)));
                }
                if number < self.counts.1 {
                    self.place = Place::Entry(number + 1);
                } else {
                    self.next_pdo();
                }
            }
        }
    }

    const fn next_pdo(&mut self) {
        self.at += 1;
        self.place = Place::Entries;
    }

    /// What was learnt.
    pub(super) fn into_pdos(self) -> Vec<Pdo> {
        self.pdos
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_object_is_asked_for_once() {
        let mut learn = Learn::new(0x1C12);
        let answers: [(u16, u8, &[u8]); 7] = [
            (0x1C12, 0, &[2]),
            (0x1C12, 1, &[0x00, 0x16]),
            (0x1C12, 2, &[0x05, 0x16]),
            (0x1600, 0, &[2]),
            (0x1600, 1, &[16, 0, 0x40, 0x60]),
            (0x1600, 2, &[32, 0, 0x7A, 0x60]),
            (0x1605, 0, &[0]),
        ];
        for (index, sub, bytes) in answers {
            assert_eq!(learn.question(), Some(Address::new(index, sub)));
            learn.answer(bytes);
        }
        assert_eq!(learn.question(), None);
        let bits: Vec<_> = learn
            .into_pdos()
            .iter()
            .map(|pdo| (pdo.index, pdo.bits()))
            .collect();
        assert_eq!(bits, [(0x1600, 48), (0x1605, 0)]);
    }

    #[test]
    fn an_empty_list_asks_no_more() {
        let mut learn = Learn::new(0x1C13);
        learn.answer(&[0]);
        assert_eq!((learn.question(), learn.into_pdos()), (None, vec![]));
    }
}
