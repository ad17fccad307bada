//! The newest value, from one writer to many readers, wait-free on both sides: device threads and net
//! threads exchange whole images by it each cycle.
//!
//! It is not a queue: a value that no reader fetched in time is overwritten. For events use
//! [`ring`](crate::ring).
//!
//! # How it works
//!
//! An anonymous-readers-counting register over `readers + 2` slots. One word, `current`, holds the index
//! of the newest slot in its low 16 bits, and above them the number of reads that began there since it was
//! published. A reader adds one to that word, which returns the slot and announces the read in the same
//! step; when done, it adds one to the slot's `released` count. The writer fills a free slot and swaps its
//! index into `current`; the old word holds the total number of reads of the replaced slot. A slot is free
//! when it is not current and has been released as often.
//!
//! **A free slot always exists.** A handle reads one slot at a time, so `readers` handles keep at most
//! that many slots busy, one more is current, and one is left. The writer's view may lag behind, but never
//! by a second slot of the same handle: counting a read that began in a replaced slot means that the swap
//! observed that handle's addition to `current` (`AcqRel` on both), and the handle's release of its former
//! slot came before that. No slot becomes busy during the writer's scan, because reads begin in the
//! current slot only; so one pass finds a free one.
//!
//! **Orderings.** The swap's `Release` publishes the slot's content to the addition's `Acquire`; later
//! additions continue the release sequence. The release count's `Release` orders the read before the
//! writer's `Acquire` of it, thus before the next overwrite. `version` is stored after the swap, so a
//! reader that sees a new number reads at least that value.
//!
//! **Wrap-around.** Both counts step by 2¹⁶ in 64-bit words, so they wrap together, modulo 2⁴⁸, and do not
//! change the index. They are compared for equality, which could fail only with 2⁴⁸ concurrent reads;
//! there are at most 65,534 handles.
//!
//! **Panics.** A reader's closure that panics still releases its slot. A writer's closure that panics
//! publishes nothing; its half-written slot stays free and is overwritten next.
#![expect(
    unsafe_code,
    reason = "slots are shared by the protocol above, which no safe type expresses"
)]

use std::fmt;

use crate::sync::{Arc, AtomicU64, AtomicUsize, Ordering, UnsafeCell};

/// One read, in the units of `current` and `released`: above the 16 bits of the slot index.
const ONE_READ: u64 = 1 << 16;
const INDEX_MASK: u64 = ONE_READ - 1;

/// The most handles a cell can have: slot indices have 16 bits and two slots are not for readers.
pub const MAX_READERS: usize = 65_534;

/// Creates a cell that holds `make()` until the first write, with up to `readers` reading handles (clamped
/// to 1..=[`MAX_READERS`]).
///
/// `make` is called once per slot, `readers + 2` times. All memory is allocated here and freed with the
/// last handle, which therefore should not be the real-time thread's.
pub fn latest<T: Send + Sync>(
    readers: usize,
    mut make: impl FnMut() -> T,
) -> (LatestWriter<T>, LatestReader<T>) {
    let readers = readers.clamp(1, MAX_READERS);
    let slots: Box<[Slot<T>]> = (0..readers + 2)
        .map(|_| Slot {
            released: AtomicU64::new(0),
            value: UnsafeCell::new(make()),
        })
        .collect();
    let acquired = vec![0; slots.len()].into_boxed_slice();
    let shared = Arc::new(Shared {
        current: AtomicU64::new(0),
        version: AtomicU64::new(0),
        handles: AtomicUsize::new(1),
        readers,
        slots,
    });
    let reader = LatestReader {
        shared: Arc::clone(&shared),
    };
    (
        LatestWriter {
            shared,
            acquired,
            current: 0,
            version: 0,
        },
        reader,
    )
}

/// On cache lines of its own, so that a reader's release does not slow other slots.
#[repr(align(64))]
struct Slot<T> {
    /// Reads of this slot that ended since it was published, times [`ONE_READ`].
    released: AtomicU64,
    value: UnsafeCell<T>,
}

struct Shared<T> {
    /// Index of the newest slot, plus [`ONE_READ`] per read that began there since its publication.
    current: AtomicU64,
    version: AtomicU64,
    /// Number of reading handles; never above `readers`.
    handles: AtomicUsize,
    readers: usize,
    slots: Box<[Slot<T>]>,
}

// SAFETY: only the writer reaches a slot's value by `&mut`, while no reader holds it (module doc), which
// sends it between threads: `T: Send`; many readers reach it by `&` at once: `T: Sync`.
unsafe impl<T: Send + Sync> Sync for Shared<T> {}

fn index_of(current: u64) -> usize {
    usize::try_from(current & INDEX_MASK).expect("16 bits fit a usize")
}

fn reads_of(current: u64) -> u64 {
    current & !INDEX_MASK
}

/// The writing endpoint of [`latest`].
pub struct LatestWriter<T> {
    shared: Arc<Shared<T>>,
    /// Per slot, the reads that began while it was current (times [`ONE_READ`]); known since it was replaced.
    acquired: Box<[u64]>,
    current: usize,
    version: u64,
}

impl<T: Send + Sync> LatestWriter<T> {
    /// Publishes the content of the slot after `f`. The slot holds some **older** value, not the newest:
    /// `f` must overwrite all of it.
    ///
    /// Wait-free: a scan over at most `readers + 2` slots, then one swap.
    pub fn write_with(&mut self, f: impl FnOnce(&mut T)) {
        let free = self.free_slot();
        let slot = &self.shared.slots[free];
        slot.value.with_mut(|value| {
            // SAFETY: the pointer is valid as long as `shared`. The slot is not current, so no read
            // begins in it, and `free_slot` saw every earlier read of it end (`Acquire`). `&mut self`
            // excludes a second writer.
            f(unsafe { &mut *value });
        });
        slot.released.store(0, Ordering::Relaxed);
        let replaced = self.shared.current.swap(free as u64, Ordering::AcqRel);
        self.acquired[self.current] = reads_of(replaced);
        self.current = free;
        self.version = self.version.wrapping_add(1);
        self.shared.version.store(self.version, Ordering::Release);
    }

    /// Publishes `value`.
    pub fn write(&mut self, value: T)
    where
        T: Copy,
    {
        self.write_with(|slot| *slot = value);
    }

    fn free_slot(&self) -> usize {
        let is_free = |&index: &usize| {
            index != self.current
                && self.shared.slots[index].released.load(Ordering::Acquire) == self.acquired[index]
        };
        (0..self.acquired.len())
            .find(is_free)
            .expect("readers + 2 slots leave one free; see the module's proof")
    }
}

impl<T> fmt::Debug for LatestWriter<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("LatestWriter")
            .field("version", &self.version)
            .finish_non_exhaustive()
    }
}

/// A reading endpoint of [`latest`].
pub struct LatestReader<T> {
    shared: Arc<Shared<T>>,
}

impl<T: Send + Sync> LatestReader<T> {
    /// Returns the newest value.
    pub fn read(&mut self) -> T
    where
        T: Copy,
    {
        self.read_with(|value| *value)
    }

    /// Applies `f` to the newest value. Wait-free except for `f`; meanwhile the writer uses other slots.
    pub fn read_with<R>(&mut self, f: impl FnOnce(&T) -> R) -> R {
        let current = self.shared.current.fetch_add(ONE_READ, Ordering::AcqRel);
        let slot = &self.shared.slots[index_of(current)];
        let _release = Release(&slot.released);
        slot.value.with(|value| {
            // SAFETY: the pointer is valid as long as `shared`. The slot was current when this read was
            // counted, so its content is published (`Acquire`), and the writer does not use it until
            // `_release`, dropped after `f`, counts the read as ended.
            f(unsafe { &*value })
        })
    }

    /// Number of values written so far: one load. A reader that stores it can skip an unchanged value;
    /// read the number first, then the value, and none is missed.
    pub fn version(&self) -> u64 {
        self.shared.version.load(Ordering::Acquire)
    }

    /// Creates a further handle; `None` if all readers of the cell exist. A dropped handle can be
    /// replaced. Not for the real-time path: it may retry under contention.
    pub fn another(&self) -> Option<Self> {
        let handles = &self.shared.handles;
        let mut count = handles.load(Ordering::Relaxed);
        while count < self.shared.readers {
            // `Acquire` pairs with the drop of the handle that this one replaces, so that the proof above
            // holds for the two as for one.
            match handles.compare_exchange(count, count + 1, Ordering::Acquire, Ordering::Relaxed) {
                Ok(_) => {
                    return Some(Self {
                        shared: Arc::clone(&self.shared),
                    });
                }
                Err(actual) => count = actual,
            }
        }
        None
    }
}

impl<T> Drop for LatestReader<T> {
    fn drop(&mut self) {
        self.shared.handles.fetch_sub(1, Ordering::Release);
    }
}

impl<T> fmt::Debug for LatestReader<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("LatestReader").finish_non_exhaustive()
    }
}

/// Counts a read as ended when dropped, also by unwinding.
struct Release<'a>(&'a AtomicU64);

impl Drop for Release<'_> {
    fn drop(&mut self) {
        self.0.fetch_add(ONE_READ, Ordering::Release);
    }
}

#[cfg(all(test, not(loom)))]
mod tests;
