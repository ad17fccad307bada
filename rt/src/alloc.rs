//! Shows that real-time threads do not allocate: a global allocator that counts the calls they make, or
//! ends the process at the first. Page faults in the same stretch of a thread are counted by the kernel.
//!
//! It does not make allocation faster or bounded, and sees nothing that bypasses Rust's allocator, such
//! as a C library's own `malloc`.
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
    /// How many [`RealTimeScope`]s this thread is in. Constant and without destructor: its use never
    /// allocates and is allowed to the very end of the thread.
    static SCOPES: Cell<u32> = const { Cell::new(0) };
}

static CALLS: AtomicU64 = AtomicU64::new(0);
static ABORT: AtomicBool = AtomicBool::new(false);

/// The system's allocator, watched. Installed by a binary or test:
///
/// ```
/// #[global_allocator]
/// static ALLOCATOR: takt_rt::alloc::CountingAllocator = takt_rt::alloc::CountingAllocator;
/// ```
#[derive(Debug, Clone, Copy, Default)]
pub struct CountingAllocator;

/// What an allocation in a real-time thread leads to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Guard {
    /// It is counted. The initial state.
    Count,
    /// It ends the process with status 1 and one line on standard error. So does a panic there, which
    /// allocates.
    Abort,
}

/// Chooses what an allocation in a real-time thread leads to, for the whole process.
pub fn set_guard(guard: Guard) {
    ABORT.store(guard == Guard::Abort, Ordering::Relaxed);
}

/// Calls of alloc, realloc and dealloc made in real-time scopes of all threads since the start. Stays 0
/// unless [`CountingAllocator`] is installed.
pub fn real_time_allocations() -> u64 {
    CALLS.load(Ordering::Relaxed)
}

/// Marks the calling thread as real-time until the scope is dropped. Scopes nest.
///
/// Its page faults are counted from here on too. The outermost scope locks and allocates for that, before it
/// begins and after it ends: once per thread, or for each long stretch of one, not once per cycle.
pub fn enter_real_time() -> RealTimeScope {
    if SCOPES.get() == 0 {
        faults::begin();
    }
    SCOPES.set(SCOPES.get() + 1);
    RealTimeScope {
        _this_thread: PhantomData,
    }
}

/// The stretch of a thread that must not allocate; made by [`enter_real_time`].
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

// SAFETY: every call goes to `System` with the caller's arguments, whose promises thus pass on unchanged;
// `watch` neither allocates nor unwinds.
unsafe impl GlobalAlloc for CountingAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        watch(layout.size());
        // SAFETY: the caller's promises are those that `System` asks for.
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
        offence(size);
    }
}

#[cold]
fn offence(size: usize) {
    CALLS.fetch_add(1, Ordering::Relaxed);
    if ABORT.load(Ordering::Relaxed) {
        process::die(last_words(&process::thread_name(), size).as_bytes());
    }
}

fn last_words(thread: &[u8; 16], size: usize) -> Line {
    let end = thread
        .iter()
        .position(|&byte| byte == 0)
        .unwrap_or(thread.len());
    let name = std::str::from_utf8(&thread[..end]).unwrap_or("?");
    let mut line = Line {
        bytes: [0; 128],
        length: 0,
    };
    // Cannot fail: `Line` takes what fits.
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
    fn the_last_words_fit_and_end_the_line() {
        let line = last_words(b"fifteen-letters\0", usize::MAX);
        let text = std::str::from_utf8(line.as_bytes()).unwrap();
        assert_eq!(
            text,
            "takt: real-time thread fifteen-letters allocated or freed 18446744073709551615 bytes; \
             ending the run\n"
        );
    }

    #[test]
    fn a_name_that_is_no_text_does_no_harm() {
        let line = last_words(&[0xff; 16], 1);
        assert!(line.as_bytes().starts_with(b"takt: real-time thread ? "));
    }

    #[test]
    fn scopes_nest() {
        let outer = enter_real_time();
        drop(enter_real_time());
        assert_eq!(SCOPES.get(), 1);
        drop(outer);
        assert_eq!(SCOPES.get(), 0);
    }
}
