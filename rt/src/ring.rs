//! A bounded queue between two threads, for events, commands and plans: neither side waits, and rejected
//! items are counted.
//!
//! It wakes no thread: the consumer polls in its own cycle.
//!
//! Own code rather than a library: the crate promises a model check of the orderings, and no published
//! ring lets loom replace its atomics; see the README.
//!
//! `tail` counts the items ever pushed, `head` those ever popped, both modulo 2⁶⁴ (or 2³²). The buffer
//! length is a power of two, so the index of an item is its number masked. Each side owns one of the two
//! counters and caches the other, which it reloads only if the ring seems full or empty.
#![expect(
    unsafe_code,
    reason = "slots are uninitialised memory, owned by position"
)]

use std::{fmt, mem::MaybeUninit};

use crate::sync::{Arc, AtomicU64, AtomicUsize, Ordering, UnsafeCell};

/// Creates a ring for `capacity` items (at least 1). All memory is allocated here.
///
/// Remaining items are dropped with the last of the two endpoints, in its thread.
///
/// # Panics
/// If `capacity` is beyond half the address space.
pub fn ring<T: Send>(capacity: usize) -> (Producer<T>, Consumer<T>) {
    let capacity = capacity.max(1);
    let slots = (0..capacity.next_power_of_two())
        .map(|_| UnsafeCell::new(MaybeUninit::uninit()))
        .collect();
    let shared = Arc::new(Shared {
        head: Position(AtomicUsize::new(0)),
        tail: Position(AtomicUsize::new(0)),
        dropped: AtomicU64::new(0),
        capacity,
        slots,
    });
    let producer = Producer {
        shared: Arc::clone(&shared),
        tail: 0,
        head_seen: 0,
    };
    (
        producer,
        Consumer {
            shared,
            head: 0,
            tail_seen: 0,
        },
    )
}

/// On a cache line of its own: each endpoint writes one.
#[repr(align(64))]
struct Position(AtomicUsize);

struct Shared<T> {
    /// Items ever popped; written by the consumer.
    head: Position,
    /// Items ever pushed; written by the producer.
    tail: Position,
    dropped: AtomicU64,
    capacity: usize,
    slots: Box<[UnsafeCell<MaybeUninit<T>>]>,
}

// SAFETY: items move from one thread to the other, `T: Send`; no `&T` is ever shared. Slots in
// `head..tail` belong to the consumer, all others to the producer, and each handle exists once.
unsafe impl<T: Send> Sync for Shared<T> {}

impl<T> Shared<T> {
    fn slot(&self, number: usize) -> &UnsafeCell<MaybeUninit<T>> {
        &self.slots[number & (self.slots.len() - 1)]
    }

    /// Moves item `number` out.
    ///
    /// # Safety
    /// `number` is in `head..tail`, its push was observed by `Acquire`, and it is taken only once.
    unsafe fn take(&self, number: usize) -> T {
        self.slot(number).with(|slot| {
            // SAFETY: the pointer is valid as long as `self`, and the caller guarantees that the producer,
            // having pushed the item, does not use the slot.
            let slot = unsafe { &*slot };
            // SAFETY: the caller guarantees that the item exists and is taken once.
            unsafe { slot.assume_init_read() }
        })
    }
}

impl<T> Drop for Shared<T> {
    fn drop(&mut self) {
        let mut head = self.head.0.load(Ordering::Relaxed);
        let tail = self.tail.0.load(Ordering::Relaxed);
        while head != tail {
            // SAFETY: `&mut self`: both endpoints are dropped, and dropping the `Arc` ordered their
            // accesses before this. The remaining items in `head..tail` are taken once here.
            drop(unsafe { self.take(head) });
            head = head.wrapping_add(1);
        }
    }
}

/// The pushing endpoint of a [`ring`].
pub struct Producer<T> {
    shared: Arc<Shared<T>>,
    tail: usize,
    head_seen: usize,
}

impl<T: Send> Producer<T> {
    /// How many items were pushed, those included that a full ring returned.
    pub fn offered(&self) -> u64 {
        (self.tail as u64).wrapping_add(self.dropped())
    }

    /// Appends `item`; a full ring returns it and counts it as dropped.
    ///
    /// # Errors
    /// The item, if the ring is full.
    pub fn push(&mut self, item: T) -> Result<(), T> {
        if !self.has_space() {
            // The only writer of this count: no read-modify-write needed.
            let dropped = self.shared.dropped.load(Ordering::Relaxed);
            self.shared
                .dropped
                .store(dropped.wrapping_add(1), Ordering::Relaxed);
            return Err(item);
        }
        self.shared.slot(self.tail).with_mut(|slot| {
            // SAFETY: the pointer is valid as long as `shared`. The slot is outside `head..tail`, the
            // removal of its last item was observed by `Acquire` in `has_space`, and `&mut self` excludes
            // another producer.
            let slot = unsafe { &mut *slot };
            slot.write(item);
        });
        self.tail = self.tail.wrapping_add(1);
        self.shared.tail.0.store(self.tail, Ordering::Release);
        Ok(())
    }

    /// Number of items rejected because the ring was full.
    pub fn dropped(&self) -> u64 {
        self.shared.dropped.load(Ordering::Relaxed)
    }

    /// Number of items that can be pushed now at least; the consumer may free more at any time.
    pub fn free_slots(&mut self) -> usize {
        self.head_seen = self.shared.head.0.load(Ordering::Acquire);
        self.shared.capacity - self.tail.wrapping_sub(self.head_seen)
    }

    fn has_space(&mut self) -> bool {
        let capacity = self.shared.capacity;
        if self.tail.wrapping_sub(self.head_seen) < capacity {
            return true;
        }
        self.head_seen = self.shared.head.0.load(Ordering::Acquire);
        self.tail.wrapping_sub(self.head_seen) < capacity
    }
}

impl<T> fmt::Debug for Producer<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Producer")
            .field("pushed", &self.tail)
            .finish_non_exhaustive()
    }
}

/// The popping endpoint of a [`ring`].
pub struct Consumer<T> {
    shared: Arc<Shared<T>>,
    head: usize,
    tail_seen: usize,
}

impl<T: Send> Consumer<T> {
    /// Returns the oldest item; `None` if the ring is empty.
    pub fn pop(&mut self) -> Option<T> {
        if self.head == self.tail_seen {
            self.tail_seen = self.shared.tail.0.load(Ordering::Acquire);
            if self.head == self.tail_seen {
                return None;
            }
        }
        // SAFETY: `head` is before `tail_seen`, a value of `tail` loaded by `Acquire`; the step below and
        // `&mut self` ensure that no item is taken twice.
        let item = unsafe { self.shared.take(self.head) };
        self.head = self.head.wrapping_add(1);
        self.shared.head.0.store(self.head, Ordering::Release);
        Some(item)
    }

    /// Number of items that the producer could not push because the ring was full.
    pub fn dropped(&self) -> u64 {
        self.shared.dropped.load(Ordering::Relaxed)
    }
}

impl<T> fmt::Debug for Consumer<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Consumer")
            .field("popped", &self.head)
            .finish_non_exhaustive()
    }
}

#[cfg(all(test, not(loom)))]
mod tests {
    use super::*;
    use std::collections::VecDeque;

    use proptest::prelude::*;

    #[test]
    fn ring_is_fifo_with_exact_capacity() {
        let (mut producer, mut consumer) = ring(3);
        assert_eq!(consumer.pop(), None);
        for item in 0..3 {
            assert_eq!(producer.push(item), Ok(()));
        }
        assert_eq!(producer.push(3), Err(3));
        assert_eq!((producer.dropped(), consumer.dropped()), (1, 1));
        assert_eq!(producer.offered(), 4);
        assert_eq!(producer.free_slots(), 0);
        assert_eq!(consumer.pop(), Some(0));
        assert_eq!(producer.free_slots(), 1);
        assert_eq!(producer.push(4), Ok(()));
        assert_eq!(
            [consumer.pop(), consumer.pop(), consumer.pop()],
            [Some(1), Some(2), Some(4)]
        );
        assert_eq!(consumer.pop(), None);
    }

    #[test]
    fn ring_zero_capacity_holds_one() {
        let (mut producer, mut consumer) = ring(0);
        assert_eq!(producer.push(1), Ok(()));
        assert_eq!(producer.push(2), Err(2));
        assert_eq!(consumer.pop(), Some(1));
    }

    #[test]
    fn ring_remaining_items_are_dropped_once() {
        let token = Arc::new(());
        let (mut producer, mut consumer) = ring(4);
        for _ in 0..3 {
            producer.push(Arc::clone(&token)).unwrap();
        }
        drop(consumer.pop());
        drop(producer);
        assert_eq!(
            Arc::strong_count(&token),
            3,
            "the consumer may still pop them"
        );
        drop(consumer);
        assert_eq!(Arc::strong_count(&token), 1);
    }

    #[test]
    fn ring_positions_wrap() {
        let start = usize::MAX - 1;
        let (mut producer, mut consumer) = ring(2);
        (producer.tail, producer.head_seen) = (start, start);
        (consumer.head, consumer.tail_seen) = (start, start);
        producer.shared.head.0.store(start, Ordering::Relaxed);
        producer.shared.tail.0.store(start, Ordering::Relaxed);
        for item in 0..10 {
            assert_eq!(producer.push(item), Ok(()));
            assert_eq!(producer.push(item), Ok(()));
            assert_eq!(producer.push(item), Err(item));
            assert_eq!(
                [consumer.pop(), consumer.pop(), consumer.pop()],
                [Some(item), Some(item), None]
            );
        }
    }

    proptest! {
        #[test]
        fn ring_behaves_as_bounded_deque(capacity in 1_usize..9, pushes in proptest::collection::vec(any::<bool>(), 0..200)) {
            let (mut producer, mut consumer) = ring(capacity);
            let mut model = VecDeque::new();
            for (number, push) in pushes.into_iter().enumerate() {
                if push {
                    let fits = model.len() < capacity;
                    prop_assert_eq!(producer.push(number), if fits { Ok(()) } else { Err(number) });
                    if fits { model.push_back(number); }
                } else {
                    prop_assert_eq!(consumer.pop(), model.pop_front());
                }
            }
        }
    }
}
