//! Per-process requests to the host before cycle threads start: locked memory, no deep sleep states, exact
//! timers.
//!
//! It changes nothing beyond this process and its lifetime, and never fails: each refused request is
//! reported as a [`Grant`], and the run continues without it.

use std::{
    fs::{self, File, OpenOptions},
    io::{self, Write},
};

pub use crate::grant::{Grant, Outcome};
use crate::linux::{
    memory::{LockError, lock_all, prefault_heap},
    scheduler::set_timer_slack,
};

/// Requests to the host. The default requests everything.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HostConfig {
    /// Keep all pages of the process, present and future, in memory.
    pub lock_memory: bool,
    /// Bytes of heap to touch in advance; 0 for none. For the work around the cycles: a cycle itself does
    /// not allocate.
    pub heap_bytes: usize,
    /// Keep processors out of sleep states with long wake-up times, as long as [`Host`] lives. Costs power.
    pub stay_awake: bool,
    /// Let sleeps of ordinary threads end on time, not up to 50 µs late. Threads inherit it from the one
    /// that calls [`prepare`].
    pub exact_timers: bool,
}

impl Default for HostConfig {
    fn default() -> Self {
        Self {
            lock_memory: true,
            heap_bytes: 8 << 20,
            stay_awake: true,
            exact_timers: true,
        }
    }
}

/// Outcomes of the requests; holds their resources. Keep it as long as cycles run.
#[derive(Debug)]
#[must_use = "processors stay awake only as long as this lives"]
pub struct Host {
    grants: Vec<Grant>,
    /// The kernel honours the request as long as this file is open.
    _awake: Option<File>,
}

/// Makes all requests of `config`. Call it once, first thing in `main`: threads that the caller starts
/// later inherit timer slack.
pub fn prepare(config: &HostConfig) -> Host {
    let (awake, stay_awake) = stay_awake(config.stay_awake);
    let grants = vec![
        kernel(&fs::read_to_string("/sys/kernel/realtime")),
        lock_memory(config.lock_memory),
        touch_heap(config.heap_bytes),
        stay_awake,
        exact_timers(config.exact_timers),
    ];
    Host {
        grants,
        _awake: awake,
    }
}

/// Returns to the kernel unused memory of the allocator, as after large nets were unloaded. It takes up to some
/// 0.1 ms per MiB, during which other threads wait to allocate: call it where no cycle is computed. Locked memory stays
/// locked but for the pages returned, which are populated when they are used again.
///
/// # Errors
/// If the heap cannot be locked again; the process runs on, and its heap can fault.
pub fn return_memory() -> io::Result<()> {
    crate::linux::memory::return_free()
}

impl Host {
    /// One grant per property, in the order of [`HostConfig`], after the kernel's.
    pub fn grants(&self) -> &[Grant] {
        &self.grants
    }

    /// Whether the kernel is PREEMPT_RT.
    pub fn is_preempt_rt(&self) -> bool {
        self.grants
            .iter()
            .any(|grant| grant.item == KERNEL && grant.is_granted())
    }

    /// Whether the kernel is PREEMPT_RT and no request was refused. Cycles run either way; otherwise their
    /// worst case is unbounded.
    pub fn is_real_time(&self) -> bool {
        self.is_preempt_rt() && !self.grants.iter().any(Grant::is_refused)
    }
}

/// Name of the memory-lock grant.
pub const MEMORY: &str = "memory lock";

/// Name of the kernel's grant.
pub const KERNEL: &str = "PREEMPT_RT kernel";

/// `flag` is the content of `/sys/kernel/realtime`, which only PREEMPT_RT has. The version string proves
/// nothing: `PREEMPT_DYNAMIC` is not real time, whatever its mode.
fn kernel(flag: &io::Result<String>) -> Grant {
    let why = match flag {
        Ok(text) if text.trim() == "1" => return Grant::from_attempt(KERNEL, "", Ok(())),
        Ok(text) => format!("/sys/kernel/realtime says {:?}", text.trim()),
        Err(error) => format!("/sys/kernel/realtime: {}", error_text(error)),
    };
    let remedy = "boot a PREEMPT_RT kernel; continuing with unbounded worst-case latency";
    Grant::from_attempt(KERNEL, "", Err((why, remedy.into())))
}

fn lock_memory(requested: bool) -> Grant {
    const WHAT: &str = MEMORY;
    if !requested {
        return Grant::not_requested(WHAT);
    }
    let refusal = |error| {
        let why = match error {
            LockError::Refused(errno) => errno.desc().to_owned(),
            LockError::Limited(bytes) => {
                format!(
                    "limited to {} KiB, later allocations would fail",
                    bytes / 1024
                )
            }
        };
        let remedy = "run with LimitMEMLOCK=infinity (systemd), memlock unlimited (limits.d) \
                      or CAP_IPC_LOCK; continuing with memory that can fault";
        (why, remedy.into())
    };
    Grant::from_attempt(WHAT, "", lock_all().map_err(refusal))
}

fn touch_heap(bytes: usize) -> Grant {
    const WHAT: &str = "heap prefault";
    if bytes == 0 {
        return Grant::not_requested(WHAT);
    }
    let attempt = if prefault_heap(bytes) {
        Ok(())
    } else {
        let why = "the C library's allocator cannot keep freed memory";
        Err((
            why.into(),
            "use glibc; continuing with a heap that can fault".into(),
        ))
    };
    Grant::from_attempt(WHAT, format!("{} KiB", bytes / 1024), attempt)
}

fn stay_awake(requested: bool) -> (Option<File>, Grant) {
    const WHAT: &str = "/dev/cpu_dma_latency 0 us";
    if !requested {
        return (None, Grant::not_requested(WHAT));
    }
    let held = OpenOptions::new()
        .write(true)
        .open("/dev/cpu_dma_latency")
        .and_then(|mut file| {
            file.write_all(&0_i32.to_ne_bytes())?;
            Ok(file)
        });
    match held {
        Ok(file) => (Some(file), Grant::from_attempt(WHAT, "", Ok(()))),
        Err(error) => {
            let remedy = "give the user write access to it (udev) or run as root; \
                          continuing with processors that may sleep deeply";
            (
                None,
                Grant::from_attempt(WHAT, "", Err((error_text(&error), remedy.into()))),
            )
        }
    }
}

fn exact_timers(requested: bool) -> Grant {
    const WHAT: &str = "timer slack 1 ns";
    if !requested {
        return Grant::not_requested(WHAT);
    }
    let remedy = "allow prctl in the system call filter; continuing with sleeps up to 50 us late";
    let attempt = set_timer_slack(1).map_err(|errno| (errno.desc().to_owned(), remedy.into()));
    Grant::from_attempt(WHAT, "", attempt)
}

/// The system's error text without Rust's `(os error 13)`.
fn error_text(error: &io::Error) -> String {
    error.raw_os_error().map_or_else(
        || error.to_string(),
        |code| nix::errno::Errno::from_raw(code).desc().to_owned(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kernel_flag_one_is_real_time() {
        assert!(kernel(&Ok("1\n".into())).is_granted());
        assert!(kernel(&Ok("0\n".into())).is_refused());
        let absent = kernel(&Err(io::ErrorKind::NotFound.into()));
        assert!(
            absent
                .to_string()
                .starts_with("PREEMPT_RT kernel: refused (/sys/kernel/realtime: ")
        );
    }

    #[test]
    fn host_without_requests_does_nothing() {
        let config = HostConfig {
            lock_memory: false,
            heap_bytes: 0,
            stay_awake: false,
            exact_timers: false,
        };
        let host = prepare(&config);
        let requested = host
            .grants()
            .iter()
            .filter(|grant| grant.outcome != Outcome::NotRequested);
        assert!(
            requested.eq([&host.grants()[0]]),
            "only the kernel has a result"
        );
    }

    #[test]
    fn host_is_real_time_requires_kernel_and_grants() {
        let host = |grants| Host {
            grants,
            _awake: None,
        };
        let kernel = Grant::from_attempt(KERNEL, "", Ok(()));
        let refused = Grant::from_attempt("memory lock", "", Err(("no".into(), "do".into())));
        let unasked = Grant::not_requested("heap prefault");
        assert!(host(vec![kernel.clone(), unasked]).is_real_time());
        assert!(!host(vec![kernel.clone(), refused]).is_real_time());
        assert!(!host(vec![]).is_real_time());
    }
}
