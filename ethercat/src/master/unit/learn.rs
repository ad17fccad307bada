//! Reads which PDOs a slave has assigned and what they map (1C12h, 1C13h, 1600h, 1A00h and following), object by
//! object. The wanted PDOs are not known here.

use takt_cia402::dictionary::{Address, Mapped};

use super::super::process::Pdo;

/// The current query.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Query {
    /// Number of assigned PDOs.
    #[default]
    Count,
    /// Index of the n-th PDO.
    Index(u8),
    /// Number of entries.
    Entries,
    /// The n-th entry.
    Entry(u8),
}

/// The queries for one SyncManager.
#[derive(Clone, Debug, Default)]
pub(super) struct Learn {
    /// 1C10h and the number of the SyncManager.
    list: u16,
    query: Query,
    pdos: Vec<Pdo>,
    /// Number of assigned PDOs, and of entries of the current PDO.
    counts: (u8, u8),
    /// Index of the current PDO.
    at: usize,
}

/// Maximum number of PDOs of one SyncManager: the answers of a slave are bounded.
const PDOS_MAX: u8 = 64;

impl Learn {
    /// Queries for the PDO list of a SyncManager.
    pub(super) fn new(list: u16) -> Self {
        Self {
            list,
            ..Self::default()
        }
    }

    /// The next object to read; `None` when all is known.
    pub(super) fn question(&self) -> Option<Address> {
        let pdo = self.pdos.get(self.at).map(|pdo| pdo.index);
        match self.query {
            Query::Count => Some(Address::new(self.list, 0)),
            Query::Index(number) => Some(Address::new(self.list, number)),
            Query::Entries => pdo.map(|index| Address::new(index, 0)),
            Query::Entry(number) => pdo.map(|index| Address::new(index, number)),
        }
    }

    /// Whether the next query is for the list itself.
    pub(super) const fn is_at_list(&self) -> bool {
        matches!(self.query, Query::Count)
    }

    /// Handles an answer of any length.
    pub(super) fn answer(&mut self, bytes: &[u8]) {
        let mut four = [0; 4];
        for (to, from) in four.iter_mut().zip(bytes) {
            *to = *from;
        }
        let [low, high, ..] = four;
        match self.query {
            Query::Count => {
                self.counts.0 = low.min(PDOS_MAX);
                self.query = if self.counts.0 == 0 {
                    Query::Entries
                } else {
                    Query::Index(1)
                };
            }
            Query::Index(number) => {
                let index = u16::from_le_bytes([low, high]);
                self.pdos.push(Pdo {
                    index,
                    entries: Vec::new(),
                });
                self.query = if number < self.counts.0 {
                    Query::Index(number + 1)
                } else {
                    Query::Entries
                };
            }
            Query::Entries => {
                self.counts.1 = low;
                if low == 0 {
                    self.next_pdo();
                } else {
                    self.query = Query::Entry(1);
                }
            }
            Query::Entry(number) => {
                if let Some(pdo) = self.pdos.get_mut(self.at) {
                    pdo.entries.push(Mapped::from_raw(u32::from_le_bytes(four)));
                }
                if number < self.counts.1 {
                    self.query = Query::Entry(number + 1);
                } else {
                    self.next_pdo();
                }
            }
        }
    }

    const fn next_pdo(&mut self) {
        self.at += 1;
        self.query = Query::Entries;
    }

    /// The result.
    pub(super) fn into_pdos(self) -> Vec<Pdo> {
        self.pdos
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pdo_discovery_reads_each_object_once() {
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
    fn pdo_discovery_of_empty_list_ends() {
        let mut learn = Learn::new(0x1C13);
        learn.answer(&[0]);
        assert_eq!((learn.question(), learn.into_pdos()), (None, vec![]));
    }
}
