//! Memory that does not fault in a cycle: locking, stack and heap touched beforehand.
//!
//! It does not keep anybody from allocating; [`alloc`](crate::alloc) shows who does.
#![expect(unsafe_code, reason = "mmap, munmap and mallopt have no safe form")]

use std::{hint::black_box, num::NonZeroUsize, ptr};

use nix::{
    errno::Errno,
    sys::{
        mman::{MapFlags, MlockAllFlags, ProtFlags, mlockall, mmap_anonymous, munlockall, munmap},
        resource::{RLIM_INFINITY, Resource, getrlimit},
    },
};

const PAGE: usize = 4096;

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
        None => Ok(()),
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
    // SAFETY: exactly the mapping made above, of which nobody else knows.
    let unmapped = unsafe { munmap(address, length.get()) };
    unmapped.err().map(|_| limit)
}

/// Touches `bytes` of heap and keeps the allocator from giving them back. False if this allocator
/// cannot be told to.
pub(crate) fn prefault_heap(bytes: usize) -> bool {
    if !keep_freed_memory() {
        return false;
    }
    let mut block = vec![0_u8; bytes];
    for page in block.chunks_mut(PAGE) {
        page[0] = 1;
    }
    black_box(&block);
    true
}

#[cfg(target_env = "gnu")]
fn keep_freed_memory() -> bool {
    // SAFETY: no pointer is involved; the allocator takes its lock itself.
    let no_trim = unsafe { libc::mallopt(libc::M_TRIM_THRESHOLD, -1) };
    // SAFETY: as above.
    let no_mmap = unsafe { libc::mallopt(libc::M_MMAP_MAX, 0) };
    no_trim == 1 && no_mmap == 1
}

#[cfg(not(target_env = "gnu"))]
fn keep_freed_memory() -> bool {
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
