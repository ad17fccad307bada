//! The thread's name and the process's end, for callers that must not allocate, lock or return.
//!
//! It runs no exit handlers: they might allocate.
#![expect(
    unsafe_code,
    reason = "prctl, write and _exit for use inside an allocator"
)]

use std::ffi::c_char;

/// The calling thread's name in the kernel: up to 15 bytes, then zeros.
pub(crate) fn thread_name() -> [u8; 16] {
    let mut name = [0_u8; 16];
    // SAFETY: this operation writes at most 16 bytes, which `name` has.
    let _ = unsafe { libc::prctl(libc::PR_GET_NAME, name.as_mut_ptr().cast::<c_char>()) };
    name
}

/// Writes `text` to standard error and ends the process with status 1.
pub(crate) fn die(text: &[u8]) -> ! {
    // SAFETY: the pointer and length are those of a live slice.
    let _ = unsafe { libc::write(libc::STDERR_FILENO, text.as_ptr().cast(), text.len()) };
    // SAFETY: ends the process; nothing is assumed afterwards.
    unsafe { libc::_exit(1) }
}
