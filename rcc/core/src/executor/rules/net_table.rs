//! Hash table of the nets that waiting rules name, each with a slot, so that a rule finds its nets in constant time.
//! All memory is allocated at construction.

use super::limits::WORK_MAX;

/// Maximum number of nets in the table: each is named by a rule, and the rules' work is bounded.
const NAMED_MAX: usize = WORK_MAX;
/// Buckets of the index, at least twice the number of nets.
const BUCKETS: usize = (2 * NAMED_MAX).next_power_of_two();
/// Marks an empty bucket, and a position that a net does not have.
const NONE: u16 = u16::MAX;

const _: () = assert!(NAMED_MAX < NONE as usize);

/// The number of a net in the table, as long as a waiting rule names it.
pub(super) type Slot = u16;

/// A net that rules name.
#[derive(Clone, Copy, Debug)]
struct Named {
    id: u32,
    /// Reference count of rules that name it.
    uses: u16,
    /// Number of waiting rules that hand over from it.
    followers: u16,
    /// Last known positions among the running and the scheduled nets.
    running: u16,
    scheduled: u16,
    /// Mark, set during a comparison.
    marked: bool,
}

/// The nets that waiting rules name.
#[derive(Debug)]
pub(super) struct NetTable {
    /// Slots by the nets' numbers, with linear probing.
    index: Box<[Slot]>,
    named: Vec<Named>,
    free: Vec<Slot>,
}

impl Default for NetTable {
    fn default() -> Self {
        Self {
            index: vec![NONE; BUCKETS].into_boxed_slice(),
            named: Vec::with_capacity(NAMED_MAX),
            free: Vec::with_capacity(NAMED_MAX),
        }
    }
}

impl NetTable {
    /// Adds a reference of a rule to a net.
    pub(super) fn enter(&mut self, id: u32) -> Slot {
        let bucket = self.bucket(id);
        if let Some(named) = self.named.get_mut(usize::from(self.index[bucket])) {
            named.uses += 1;
            return self.index[bucket];
        }
        let named = Named {
            id,
            uses: 1,
            followers: 0,
            running: NONE,
            scheduled: NONE,
            marked: false,
        };
        let slot = if let Some(slot) = self.free.pop() {
            self.named[usize::from(slot)] = named;
            slot
        } else {
            self.named.push(named);
            u16::try_from(self.named.len() - 1).unwrap_or(NONE)
        };
        self.index[bucket] = slot;
        slot
    }

    /// Removes a reference of a rule to a net.
    pub(super) fn leave(&mut self, slot: Slot) {
        let Some(named) = self.named.get_mut(usize::from(slot)) else {
            return;
        };
        named.uses = named.uses.saturating_sub(1);
        if named.uses == 0 {
            let id = named.id;
            self.unlink(id);
            self.free.push(slot);
        }
    }

    /// The slot of a net; `None` if no waiting rule names it.
    pub(super) fn find(&self, id: u32) -> Option<Slot> {
        let slot = self.index[self.bucket(id)];
        (slot != NONE).then_some(slot)
    }

    /// Sets the position of a net among the running ones, if a rule names it.
    pub(super) fn set_running_index(&mut self, id: u32, at: usize) {
        if let Some(slot) = self.find(id) {
            self.named[usize::from(slot)].running = u16::try_from(at).unwrap_or(NONE);
        }
    }

    /// Sets the position of a net among the scheduled ones, if a rule names it.
    pub(super) fn set_scheduled_index(&mut self, id: u32, at: usize) {
        if let Some(slot) = self.find(id) {
            self.named[usize::from(slot)].scheduled = u16::try_from(at).unwrap_or(NONE);
        }
    }

    /// The net's number and last known position among the running nets. The caller checks whether it is
    /// still there.
    pub(super) fn running(&self, slot: Slot) -> (u32, usize) {
        let named = &self.named[usize::from(slot)];
        (named.id, usize::from(named.running))
    }

    /// As [`Self::running_at`], among the scheduled nets.
    pub(super) fn scheduled(&self, slot: Slot) -> (u32, usize) {
        let named = &self.named[usize::from(slot)];
        (named.id, usize::from(named.scheduled))
    }

    /// Sets whether a waiting rule hands over from a net.
    pub(super) fn follow(&mut self, slot: Slot, waits: bool) {
        let followers = &mut self.named[usize::from(slot)].followers;
        *followers = if waits {
            *followers + 1
        } else {
            followers.saturating_sub(1)
        };
    }

    /// Whether a rule waits that hands over from this net.
    pub(super) fn is_followed(&self, id: u32) -> bool {
        let slot = self.find(id);
        slot.is_some_and(|slot| self.named[usize::from(slot)].followers > 0)
    }

    /// Sets or clears the mark of a net.
    pub(super) fn mark(&mut self, slot: Slot, marked: bool) {
        self.named[usize::from(slot)].marked = marked;
    }

    /// Whether a net is marked.
    pub(super) fn is_marked(&self, slot: Slot) -> bool {
        self.named[usize::from(slot)].marked
    }

    /// The bucket of a net in the index, or the free bucket for it.
    fn bucket(&self, id: u32) -> usize {
        let mut bucket = home(id);
        while let Some(named) = self.named.get(usize::from(self.index[bucket])) {
            if named.id == id {
                break;
            }
            bucket = (bucket + 1) % BUCKETS;
        }
        bucket
    }

    /// Removes a net from the index and moves up those behind it that probing would not find otherwise.
    fn unlink(&mut self, id: u32) {
        let mut hole = self.bucket(id);
        let mut next = hole;
        loop {
            next = (next + 1) % BUCKETS;
            let Some(named) = self.named.get(usize::from(self.index[next])) else {
                break;
            };
            let from_home = (BUCKETS + next - home(named.id)) % BUCKETS;
            if from_home >= (BUCKETS + next - hole) % BUCKETS {
                self.index[hole] = self.index[next];
                hole = next;
            }
        }
        self.index[hole] = NONE;
    }
}

/// Where the search for a net begins: the upper bits of its number times 2^32 by the golden ratio.
const fn home(id: u32) -> usize {
    id.wrapping_mul(0x9E37_79B9) as usize >> (u32::BITS - BUCKETS.ilog2())
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use proptest::prelude::*;

    use super::*;

    #[test]
    fn net_table_has_slot_for_every_named_net() {
        let mut nets_named = NetTable::default();
        let count = u32::try_from(NAMED_MAX).unwrap();
        let slots: std::collections::BTreeSet<_> =
            (0..count).map(|id| nets_named.enter(id)).collect();
        assert_eq!(slots.len(), NAMED_MAX);
        assert!((0..count).all(|id| nets_named.find(id).is_some()));
        slots.iter().for_each(|slot| nets_named.leave(*slot));
        assert!((0..count).all(|id| nets_named.find(id).is_none()));
        assert!(nets_named.index.iter().all(|slot| *slot == NONE));
    }

    #[test]
    fn net_table_reused_slot_is_clean() {
        let mut nets_named = NetTable::default();
        let slot = nets_named.enter(7);
        nets_named.set_running_index(7, 3);
        nets_named.set_scheduled_index(7, 4);
        nets_named.follow(slot, true);
        nets_named.leave(slot);
        assert_eq!(nets_named.enter(8), slot);
        assert!(!nets_named.is_followed(8));
        assert_eq!(nets_named.running(slot), (8, usize::from(NONE)));
        assert_eq!(nets_named.scheduled(slot), (8, usize::from(NONE)));
    }

    proptest! {
            /// Against a map; few homes, so that they collide and wrap around the end.
            #[test]
            fn net_table_agrees_with_map(steps in proptest::collection::vec((0_u32..40, any::<bool>()), 0..400)) {
                let last = u32::try_from(BUCKETS).unwrap() - 1;
    // Numbers whose homes are the last bucket and those before and after it.
                let ids: Vec<u32> = (0..u32::MAX)
                    .filter(|id| matches!(u32::try_from(home(*id)), Ok(h) if h <= 2 || h >= last - 1))
                    .take(40)
                    .collect();
                let (mut nets_named, mut map) = (NetTable::default(), BTreeMap::new());
                for (number, enters) in steps {
                    let id = ids[number as usize];
                    if enters {
                        let uses = map.entry(id).or_insert((0, 0));
                        *uses = (uses.0 + 1, nets_named.enter(id));
                    } else if let Some((uses, slot)) = map.remove(&id) {
                        nets_named.leave(slot);
                        if uses > 1 {
                            map.insert(id, (uses - 1, slot));
                        }
                    }
                    for id in &ids {
                        prop_assert_eq!(nets_named.find(*id), map.get(id).map(|(_, slot)| *slot));
                    }
                }
            }
        }
}
