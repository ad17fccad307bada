//! Detects allocations in real-time threads: a global allocator that counts the calls of these threads, or
//! ends the process at the first. The kernel counts page faults over the same scope.
//!
//! It does not make allocation faster or bounded, and does not see allocations that bypass Rust's
//! allocator, such as a C library's own `malloc`.
#![expect(unsafe_code, reason = "GlobalAlloc is an unsafe trait")]

use std::{
    alloc::{GlobalAlloc, Layout, System},
    cell::Cell,
    fmt::{self, Write},
    marker::PhantomData,
    sync::atomic::{AtomicBool, AtomicU64, Ordering},
};

pub use crate::linux::faults::{PageFaults, real_time_page_faults};
use crate::linux::{faults, process};

thread_local! {
    /// Number of [`RealTimeScope`]s of this thread. Constant and without destructor: using it never
    /// allocates, even while the thread ends.
    static SCOPES: Cell<u32> = const { Cell::new(0) };
    /// This thread's part of [`CALLS`].
    static CALLS_OF_THREAD: Cell<u64> = const { Cell::new(0) };
}

static CALLS: AtomicU64 = AtomicU64::new(0);
static ABORT: AtomicBool = AtomicBool::new(false);

/// Counting wrapper of the system's allocator. A binary or test installs it:
///
/// ```
/// #[global_allocator]
/// static ALLOCATOR: takt_rt::alloc::CountingAllocator = takt_rt::alloc::CountingAllocator;
/// ```
#[derive(Debug, Clone, Copy, Default)]
pub struct CountingAllocator;

/// Reaction to an allocation in a real-time thread.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Guard {
    /// Count it. The initial state.
    Count,
    /// End the process with status 1 and one line on standard error. A panic there has the same effect,
    /// since it allocates.
    Abort,
}

/// Sets the reaction to allocations in real-time threads, for the whole process.
pub fn set_guard(guard: Guard) {
    ABORT.store(guard == Guard::Abort, Ordering::Relaxed);
}

/// Calls of alloc, realloc and dealloc made in real-time scopes of all threads since the start. Stays 0
/// unless [`CountingAllocator`] is installed.
pub fn real_time_allocations() -> u64 {
    CALLS.load(Ordering::Relaxed)
}

/// As [`real_time_allocations`], those of the calling thread only.
pub fn real_time_allocations_of_thread() -> u64 {
    CALLS_OF_THREAD.get()
}

/// Marks the calling thread as real-time until the scope is dropped. Scopes nest.
///
/// Its page faults are counted from here on, too. The outermost scope locks and allocates for that, before
/// it begins and after it ends: use it once per thread, or for each long section of one, not once per cycle.
pub fn enter_real_time() -> RealTimeScope {
    if SCOPES.get() == 0 {
        faults::begin();
    }
    SCOPES.set(SCOPES.get() + 1);
    RealTimeScope {
        _this_thread: PhantomData,
    }
}

/// The section of a thread that must not allocate; created by [`enter_real_time`].
#[derive(Debug)]
#[must_use = "the thread is real-time only as long as this lives"]
pub struct RealTimeScope {
    /// Neither `Send` nor `Sync`: it must end on the thread that it marked.
    _this_thread: PhantomData<*const ()>,
}

impl Drop for RealTimeScope {
    fn drop(&mut self) {
        SCOPES.set(SCOPES.get() - 1);
        if SCOPES.get() == 0 {
            faults::end();
        }
    }
}

// SAFETY: every call passes the caller's arguments to `System`, whose requirements the caller thus
// guarantees; `watch` neither allocates nor unwinds.
unsafe impl GlobalAlloc for CountingAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        watch(layout.size());
        // SAFETY: the caller guarantees what `System` requires.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        watch(layout.size());
        // SAFETY: as in `alloc`.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, old: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        watch(size);
        // SAFETY: as in `alloc`; `old` came from `System`.
        unsafe { System.realloc(old, layout, size) }
    }

    unsafe fn dealloc(&self, old: *mut u8, layout: Layout) {
        watch(layout.size());
        // SAFETY: as in `alloc`; `old` came from `System`.
        unsafe { System.dealloc(old, layout) }
    }
}

#[inline]
fn watch(size: usize) {
    if SCOPES.get() > 0 {
        violation(size);
    }
}

#[cold]
fn violation(size: usize) {
    CALLS.fetch_add(1, Ordering::Relaxed);
    CALLS_OF_THREAD.set(CALLS_OF_THREAD.get() + 1);
    if ABORT.load(Ordering::Relaxed) {
        process::die(abort_message(&process::thread_name(), size).as_bytes());
    }
}

fn abort_message(thread: &[u8; 16], size: usize) -> Line {
    let end = thread
        .iter()
        .position(|&byte| byte == 0)
        .unwrap_or(thread.len());
    let name = std::str::from_utf8(&thread[..end]).unwrap_or("?");
    let mut line = Line {
        bytes: [0; 128],
        length: 0,
    };
    // Cannot fail: `Line` truncates.
    let _ = writeln!(
        line,
        "takt: real-time thread {name} allocated or freed {size} bytes; ending the run"
    );
    line
}

/// Text of fixed size: formatting of integers and strings into it does not allocate.
struct Line {
    bytes: [u8; 128],
    length: usize,
}

impl Line {
    fn as_bytes(&self) -> &[u8] {
        &self.bytes[..self.length]
    }
}

impl Write for Line {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        let room = &mut self.bytes[self.length..];
        let taken = text.len().min(room.len());
        room[..taken].copy_from_slice(&text.as_bytes()[..taken]);
        self.length += taken;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn abort_message_fits_one_line() {
        let line = abort_message(b"fifteen-letters\0", usize::MAX);
        let text = std::str::from_utf8(line.as_bytes()).unwrap();
        assert_eq!(
            text,
            "takt: real-time thread fifteen-letters allocated or freed 18446744073709551615 bytes; \
             ending the run\n"
        );
    }

    #[test]
    fn abort_message_accepts_non_utf8_name() {
        let line = abort_message(&[0xff; 16], 1);
        assert!(line.as_bytes().starts_with(b"takt: real-time thread ? "));
    }

    #[test]
    fn real_time_scopes_nest() {
        let outer = enter_real_time();
        drop(enter_real_time());
        assert_eq!(SCOPES.get(), 1);
        drop(outer);
        assert_eq!(SCOPES.get(), 0);
    }
}
