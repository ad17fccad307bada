//! The nets that waiting rules name, each with a slot, so that a rule finds its nets in constant time. It
//! takes all of its memory when it is made, and knows no rule.

use super::WORK_MAX;

/// Most nets on the roll: each is named by a rule, and what rules name is bounded.
const NAMED_MAX: usize = WORK_MAX;
/// Places of the index, at least twice as many as there are nets.
const PLACES: usize = (2 * NAMED_MAX).next_power_of_two();
/// What stands in a place without a slot, and for a position that a net does not have.
const NONE: u16 = u16::MAX;

const _: () = assert!(NAMED_MAX < NONE as usize);

/// The number of a net on the roll, as long as a waiting rule names it.
pub(super) type Slot = u16;

/// A net that rules name.
#[derive(Clone, Copy, Debug)]
struct Named {
    id: u32,
    /// How often rules name it.
    uses: u16,
    /// How often rules wait that hand over from it.
    followers: u16,
    /// Where it was last seen among the running nets, and among the scheduled ones.
    running: u16,
    scheduled: u16,
    /// Set for the length of a comparison.
    marked: bool,
}

/// The nets that waiting rules name.
#[derive(Debug)]
pub(super) struct Roll {
    /// Slots by the nets' numbers, with linear probing.
    index: Box<[Slot]>,
    named: Vec<Named>,
    free: Vec<Slot>,
}

impl Default for Roll {
    fn default() -> Self {
        Self {
            index: vec![NONE; PLACES].into_boxed_slice(),
            named: Vec::with_capacity(NAMED_MAX),
            free: Vec::with_capacity(NAMED_MAX),
        }
    }
}

impl Roll {
    /// Notes that a rule names a net.
    pub(super) fn enter(&mut self, id: u32) -> Slot {
        let place = self.place(id);
        if let Some(named) = self.named.get_mut(usize::from(self.index[place])) {
            named.uses += 1;
            return self.index[place];
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
        self.index[place] = slot;
        slot
    }

    /// Notes that a rule names a net no longer.
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
        let slot = self.index[self.place(id)];
        (slot != NONE).then_some(slot)
    }

    /// Notes where a net is among the running ones, if a rule names it.
    pub(super) fn seat_running(&mut self, id: u32, at: usize) {
        if let Some(slot) = self.find(id) {
            self.named[usize::from(slot)].running = u16::try_from(at).unwrap_or(NONE);
        }
    }

    /// Notes where a net is among the scheduled ones, if a rule names it.
    pub(super) fn seat_scheduled(&mut self, id: u32, at: usize) {
        if let Some(slot) = self.find(id) {
            self.named[usize::from(slot)].scheduled = u16::try_from(at).unwrap_or(NONE);
        }
    }

    /// The net's number and where it was last seen among the running nets. Whether it is still there is
    /// for the caller to see.
    pub(super) fn running(&self, slot: Slot) -> (u32, usize) {
        let named = &self.named[usize::from(slot)];
        (named.id, usize::from(named.running))
    }

    /// The same among the scheduled nets.
    pub(super) fn scheduled(&self, slot: Slot) -> (u32, usize) {
        let named = &self.named[usize::from(slot)];
        (named.id, usize::from(named.scheduled))
    }

    /// Notes that a rule waits that hands over from a net, or that it does no longer.
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

    /// Marks a net or takes its mark away.
    pub(super) fn mark(&mut self, slot: Slot, marked: bool) {
        self.named[usize::from(slot)].marked = marked;
    }

    /// Whether a net is marked.
    pub(super) fn is_marked(&self, slot: Slot) -> bool {
        self.named[usize::from(slot)].marked
    }

    /// The place of a net in the index, or the free one where it belongs.
    fn place(&self, id: u32) -> usize {
        let mut place = home(id);
        while let Some(named) = self.named.get(usize::from(self.index[place])) {
            if named.id == id {
                break;
            }
            place = (place + 1) % PLACES;
        }
        place
    }

    /// Takes a net out of the index, and moves those behind it up that would not be found otherwise.
    fn unlink(&mut self, id: u32) {
        let mut hole = self.place(id);
        let mut next = hole;
        loop {
            next = (next + 1) % PLACES;
            let Some(named) = self.named.get(usize::from(self.index[next])) else {
                break;
            };
            let from_home = (PLACES + next - home(named.id)) % PLACES;
            if from_home >= (PLACES + next - hole) % PLACES {
                self.index[hole] = self.index[next];
                hole = next;
            }
        }
        self.index[hole] = NONE;
    }
}

/// Where the search for a net begins: the upper bits of its number times 2^32 by the golden ratio.
const fn home(id: u32) -> usize {
    id.wrapping_mul(0x9E37_79B9) as usize >> (u32::BITS - PLACES.ilog2())
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use proptest::prelude::*;

    use super::*;

    #[test]
    fn as_many_nets_as_rules_can_name_have_a_slot_each() {
        let mut roll = Roll::default();
        let count = u32::try_from(NAMED_MAX).unwrap();
        let slots: std::collections::BTreeSet<_> = (0..count).map(|id| roll.enter(id)).collect();
        assert_eq!(slots.len(), NAMED_MAX);
        assert!((0..count).all(|id| roll.find(id).is_some()));
        slots.iter().for_each(|slot| roll.leave(*slot));
        assert!((0..count).all(|id| roll.find(id).is_none()));
        assert!(roll.index.iter().all(|slot| *slot == NONE));
    }

    #[test]
    fn a_slot_that_is_used_again_remembers_nothing() {
        let mut roll = Roll::default();
        let slot = roll.enter(7);
        roll.seat_running(7, 3);
        roll.seat_scheduled(7, 4);
        roll.follow(slot, true);
        roll.leave(slot);
        assert_eq!(roll.enter(8), slot);
        assert!(!roll.is_followed(8));
        assert_eq!(roll.running(slot), (8, usize::from(NONE)));
        assert_eq!(roll.scheduled(slot), (8, usize::from(NONE)));
    }

    proptest! {
        /// Against a map; few homes, so that they collide and wrap around the end.
        #[test]
        fn it_finds_what_a_map_finds(steps in proptest::collection::vec((0_u32..40, any::<bool>()), 0..400)) {
            let last = u32::try_from(PLACES).unwrap() - 1;
            // Numbers whose homes are the last place and the ones before and after it.
            let ids: Vec<u32> = (0..u32::MAX)
                .filter(|id| matches!(u32::try_from(home(*id)), Ok(h) if h <= 2 || h >= last - 1))
                .take(40)
                .collect();
            let (mut roll, mut map) = (Roll::default(), BTreeMap::new());
            for (number, enters) in steps {
                let id = ids[number as usize];
                if enters {
                    let uses = map.entry(id).or_insert((0, 0));
                    *uses = (uses.0 + 1, roll.enter(id));
                } else if let Some((uses, slot)) = map.remove(&id) {
                    roll.leave(slot);
                    if uses > 1 {
                        map.insert(id, (uses - 1, slot));
                    }
                }
                for id in &ids {
                    prop_assert_eq!(roll.find(*id), map.get(id).map(|(_, slot)| *slot));
                }
            }
        }
    }
}
