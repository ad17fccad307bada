//! Memory that does not fault in a cycle: locking, stack and heap touched beforehand.
//!
//! It does not keep anybody from allocating; [`alloc`](crate::alloc) shows who does.
#![expect(unsafe_code, reason = "mmap, munmap and mallopt have no safe form")]

use std::{
    hint::black_box,
    io,
    num::NonZeroUsize,
    ptr,
    sync::atomic::{AtomicBool, Ordering},
};

use nix::{
    errno::Errno,
    sys::{
        mman::{MapFlags, MlockAllFlags, ProtFlags, mlockall, mmap_anonymous, munlockall, munmap},
        resource::{RLIM_INFINITY, Resource, getrlimit},
    },
};

const PAGE: usize = 4096;

/// Whether all pages of this process are locked.
static IS_LOCKED: AtomicBool = AtomicBool::new(false);

/// Why memory could not be locked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum LockError {
    /// The kernel said no.
    Refused(Errno),
    /// It said yes, but would refuse later mappings beyond this many bytes.
    Limited(u64),
}

/// Locks all present and future pages in memory.
///
/// Without `MCL_ONFAULT`, which would only move the faults to the first touch, into a cycle. The price:
/// the stack of every thread is resident as a whole, so threads should have small ones.
pub(crate) fn lock_all() -> Result<(), LockError> {
    mlockall(MlockAllFlags::MCL_CURRENT | MlockAllFlags::MCL_FUTURE).map_err(LockError::Refused)?;
    match limit_in_force() {
        None => {
            IS_LOCKED.store(true, Ordering::Relaxed);
            Ok(())
        }
        Some(limit) => {
            munlockall().map_err(LockError::Refused)?;
            Err(LockError::Limited(limit))
        }
    }
}

/// The locked-memory limit, if it binds this process. Found by doing, since capabilities decide: with
/// future mappings locked, one that is a page larger than the limit either succeeds or does not.
/// Without this the process would run until some later mapping, a thread's stack say, fails.
fn limit_in_force() -> Option<u64> {
    let (limit, _) = getrlimit(Resource::RLIMIT_MEMLOCK).ok()?;
    if limit == RLIM_INFINITY {
        return None;
    }
    let length = NonZeroUsize::new(usize::try_from(limit).ok()?.checked_add(PAGE)?)?;
    // SAFETY: a fresh private mapping at an address of the kernel's choice; PROT_NONE, so it takes no
    // memory.
    let mapped =
        unsafe { mmap_anonymous(None, length, ProtFlags::PROT_NONE, MapFlags::MAP_PRIVATE) };
    let Ok(address) = mapped else {
        return Some(limit);
    };
    // SAFETY: exactly the mapping made above, to which no other pointer exists.
    let unmapped = unsafe { munmap(address, length.get()) };
    unmapped.err().map(|_| limit)
}

/// Touches `bytes` of heap and keeps the allocator from returning them to the kernel. False if this allocator
/// has no such setting.
pub(crate) fn prefault_heap(bytes: usize) -> bool {
    if !keep_freed_memory(bytes) {
        return false;
    }
    let mut block = vec![0_u8; bytes];
    for page in block.chunks_mut(PAGE) {
        page[0] = 1;
    }
    black_box(&block);
    true
}

/// Blocks of at least this size have a mapping of their own, which goes back to the kernel when they are freed.
#[cfg(target_env = "gnu")]
const MAPPED_BYTES_MIN: libc::c_int = 1 << 20;

/// How much free memory at the end of a heap stays for the next allocations, bytes, beside what was touched at start.
/// More goes back to the kernel, so that the memory of nets that are unloaded does.
#[cfg(target_env = "gnu")]
const KEPT_BYTES_MAX: usize = 16 << 20;

/// Keeps the touched bytes, and lets the allocator return what large nets have taken beyond. Real-time threads neither
/// allocate nor free; with locked memory the kernel populates what an allocation maps before it returns, so a return of
/// memory causes no page fault in a cycle.
#[cfg(target_env = "gnu")]
fn keep_freed_memory(touched: usize) -> bool {
    let number = |bytes: usize| libc::c_int::try_from(bytes).unwrap_or(libc::c_int::MAX);
    let settings = [
        // One heap: the threads of connections come and go, and each heap would keep its own share.
        (libc::M_ARENA_MAX, 1),
        (libc::M_TOP_PAD, number(touched)),
        (
            libc::M_TRIM_THRESHOLD,
            number(touched.saturating_add(KEPT_BYTES_MAX)),
        ),
        (libc::M_MMAP_THRESHOLD, MAPPED_BYTES_MIN),
    ];
    // SAFETY: no pointer is involved; the allocator takes its lock itself.
    let set = |(parameter, value)| unsafe { libc::mallopt(parameter, value) } == 1;
    settings.into_iter().all(set)
}

/// Returns free pages of the heap to the kernel, also between those in use.
///
/// The kernel discards no locked page, so the heap is unlocked meanwhile, its pages staying where they are; then it is
/// locked again as far as it is present. Threads that do not allocate see none of this.
///
/// # Errors
/// If the heap cannot be locked again; it works on unlocked.
#[cfg(target_env = "gnu")]
pub(crate) fn return_free() -> io::Result<()> {
    let locked = IS_LOCKED.load(Ordering::Relaxed);
    for (start, length) in heaps().into_iter().filter(|_| locked) {
        // SAFETY: a range of this process; unlocking changes no content.
        let _ = unsafe { libc::munlock(ptr::without_provenance(start), length) };
    }
    // SAFETY: no pointer is involved; the allocator takes its lock itself.
    unsafe { libc::malloc_trim(KEPT_BYTES_MAX) };
    // They may be shorter now.
    for (start, length) in heaps().into_iter().filter(|_| locked) {
        // SAFETY: as above; locking changes no content either.
        let status =
            unsafe { libc::mlock2(ptr::without_provenance(start), length, libc::MLOCK_ONFAULT) };
        if status != 0 {
            return Err(io::Error::last_os_error());
        }
    }
    Ok(())
}

#[cfg(not(target_env = "gnu"))]
pub(crate) fn return_free() -> io::Result<()> {
    Ok(())
}

/// Threads that allocated before the number of heaps was set to one have heaps of their own, which other threads use too:
/// mappings that begin at multiples of this.
#[cfg(target_env = "gnu")]
const THREAD_HEAP_BYTES: usize = 64 << 20;

/// Start and length of each heap in bytes.
#[cfg(target_env = "gnu")]
fn heaps() -> Vec<(usize, usize)> {
    heaps_of(&std::fs::read_to_string("/proc/self/maps").unwrap_or_default())
}

/// The kernel lists parts that are locked differently line by line.
#[cfg(target_env = "gnu")]
fn heaps_of(maps: &str) -> Vec<(usize, usize)> {
    let range = |line: &str| {
        let mut fields = line.split_whitespace();
        let (start, end) = fields.next()?.split_once('-')?;
        let number = |text| usize::from_str_radix(text, 16).ok();
        let (start, end) = (number(start)?, number(end)?);
        let is_writable = fields.next()?.starts_with("rw");
        let is_heap = match fields.nth(3) {
            Some(name) => name == "[heap]",
            None => is_writable && start.is_multiple_of(THREAD_HEAP_BYTES),
        };
        is_heap.then_some((start, end.checked_sub(start)?))
    };
    maps.lines().filter_map(range).collect()
}

#[cfg(not(target_env = "gnu"))]
fn keep_freed_memory(_touched: usize) -> bool {
    false
}

/// Left untouched at the end of a stack: what the callers above and the frames below here occupy.
const STACK_MARGIN: usize = 64 * 1024;

/// Touches the calling thread's stack, `stack_bytes` large, down to its last 64 KiB.
pub(crate) fn prefault_stack(stack_bytes: usize) {
    let top = 0_u8;
    let depth = stack_bytes.saturating_sub(STACK_MARGIN);
    touch_stack(ptr::from_ref(&top).addr().saturating_sub(depth));
}

/// One page per call; the address, not a count, ends it, since frames are larger than what they hold.
#[inline(never)]
fn touch_stack(down_to: usize) {
    let mut page = [0_u8; PAGE];
    black_box(&mut page);
    if ptr::from_ref(&page).addr() > down_to {
        touch_stack(down_to);
    }
    // After the call, lest it become a jump that uses the same frame again.
    black_box(&mut page);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(target_env = "gnu")]
    #[test]
    fn heaps_are_those_of_process_and_threads() {
        let maps = "00400000-00500000 r-xp 0 fe:00 1 /bin/takt\n\
                    01000000-01200000 rw-p 0 00:00 0     [heap]\n\
                    01200000-01300000 rw-p 0 00:00 0     [heap]\n\
                    7c000000-7c100000 rw-p 0 00:00 0\n\
                    7c100000-7fe00000 ---p 0 00:00 0\n\
                    7ff00000-7ff10000 rw-p 0 00:00 0\n";
        let heaps = [
            (0x0100_0000, 0x0020_0000),
            (0x0120_0000, 0x0010_0000),
            (0x7c00_0000, 0x0010_0000),
        ];
        assert_eq!(heaps_of(maps), heaps);
        assert!(heaps_of("").is_empty());
    }

    #[test]
    fn a_small_stack_is_touched_without_overflow() {
        for stack_bytes in [96 * 1024, 256 * 1024] {
            let thread = std::thread::Builder::new().stack_size(stack_bytes);
            thread
                .spawn(move || prefault_stack(stack_bytes))
                .unwrap()
                .join()
                .unwrap();
        }
    }
}
