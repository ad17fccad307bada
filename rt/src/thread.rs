//! Threads for cycles: named, pinned, prioritised and prefaulted before their work begins.
//!
//! It assigns no priorities, and never fails for missing rights: the thread runs, and its [`Grant`]s
//! report how.

use std::{
    fmt, io,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
        mpsc,
    },
    thread,
};

use nix::errno::Errno;

use crate::{
    Grant,
    linux::{
        memory::prefault_stack,
        scheduler::{has_cap_sys_nice, set_affinity, set_fifo, set_timer_slack},
    },
    simulated,
};

/// Settings of a thread.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ThreadConfig {
    /// Its name; the kernel shows the first 15 bytes.
    pub name: String,
    /// `SCHED_FIFO` priority, 1 to 98 (99 is the kernel's own); `None` for an ordinary thread.
    pub priority: Option<u8>,
    /// The processors it may use, counted from 0; empty for any.
    pub cpus: Vec<usize>,
    /// Stack size in bytes; all but the last 64 KiB are touched before the work begins.
    pub stack_bytes: usize,
}

impl ThreadConfig {
    /// An ordinary thread on any processor with 512 KiB of stack.
    pub fn new(name: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            priority: None,
            cpus: Vec::new(),
            stack_bytes: 512 * 1024,
        }
    }
}

/// A running thread.
pub struct Thread<T> {
    handle: thread::JoinHandle<T>,
    grants: Vec<Grant>,
}

/// Starts a thread that applies `config` and then runs `body`. Returns when the set-up is complete and
/// `body` about to begin.
///
/// The thread counts as real-time for [`alloc`](crate::alloc) only once `body` enters that scope, after
/// its own set-up.
///
/// # Errors
/// If the system cannot create a thread, or the name contains a zero byte.
pub fn spawn<T: Send + 'static>(
    config: ThreadConfig,
    body: impl FnOnce() -> T + Send + 'static,
) -> io::Result<Thread<T>> {
    if config.name.contains('\0') {
        return Err(io::Error::new(
            io::ErrorKind::InvalidInput,
            "thread name with a zero byte",
        ));
    }
    let builder = thread::Builder::new()
        .name(config.name.clone())
        .stack_size(config.stack_bytes);
    let (report, set_up) = mpsc::sync_channel(1);
    let handle = builder.spawn(move || {
        prefault_stack(config.stack_bytes);
        // Fails only if the spawning thread no longer waits for it. Dropped here, so that `body` owns
        // nothing of the set-up.
        drop(report.send(set_self_up(&config)));
        drop((report, config));
        body()
    })?;
    let grants = set_up.recv().map_err(io::Error::other)?;
    Ok(Thread { handle, grants })
}

/// A thread whose body ends when that is requested.
#[derive(Debug)]
pub struct Stoppable<T> {
    thread: Thread<T>,
    stop: Arc<AtomicBool>,
}

impl<T: Send + 'static> Stoppable<T> {
    /// Starts a thread as [`spawn`] does. `body` ends soon after its argument became true.
    ///
    /// # Errors
    /// As [`spawn`].
    pub fn spawn(
        config: ThreadConfig,
        body: impl FnOnce(&AtomicBool) -> T + Send + 'static,
    ) -> io::Result<Self> {
        let stop = Arc::new(AtomicBool::new(false));
        let stopping = Arc::clone(&stop);
        let thread = spawn(config, move || body(&stopping))?;
        Ok(Self { thread, stop })
    }
}

impl<T> Stoppable<T> {
    /// Requests the end, waits for it and returns the result of the body, or its panic.
    pub fn stop(self) -> thread::Result<T> {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.join()
    }

    /// Whether the body has ended.
    pub fn is_finished(&self) -> bool {
        self.thread.is_finished()
    }
}

/// Affinity first: a real-time thread on the wrong processor disturbs the threads there.
///
/// Simulated time waits for all threads alike: on a busy host, those with priority would only keep the processors from those
/// without, such as the program that commands the robots.
fn set_self_up(config: &ThreadConfig) -> Vec<Grant> {
    let is_simulated = simulated::is_on();
    if is_simulated {
        // Fails never; without it, sleeps last 50 us longer.
        let _ = set_timer_slack(1);
    }
    let priority = config.priority.filter(|_| !is_simulated);
    vec![pin(&config.cpus), prioritise(priority)]
}

fn pin(cpus: &[usize]) -> Grant {
    const WHAT: &str = "affinity to CPU";
    if cpus.is_empty() {
        return Grant::not_requested(WHAT);
    }
    let list: Vec<_> = cpus.iter().map(ToString::to_string).collect();
    let attempt = set_affinity(cpus).map_err(|errno| {
        let remedy = "name processors that are online and in this cgroup's cpuset \
                      (see /proc/self/status, Cpus_allowed_list); continuing on any processor";
        (errno.desc().to_owned(), remedy.into())
    });
    Grant::from_attempt(WHAT, list.join(","), attempt)
}

fn prioritise(priority: Option<u8>) -> Grant {
    const WHAT: &str = "SCHED_FIFO priority";
    let Some(priority) = priority else {
        return Grant::not_requested(WHAT);
    };
    let attempt = match priority {
        1..=98 => set_fifo(priority).map_err(|errno| fifo_refusal(errno, has_cap_sys_nice())),
        _ => Err((
            "not in 1..=98".into(),
            format!("choose 1 to 98; {ORDINARY}"),
        )),
    };
    Grant::from_attempt(WHAT, priority.to_string(), attempt)
}

const ORDINARY: &str = "continuing without real-time priority";

/// With the right present, the cause is a cgroup without real-time budget or a filter.
fn fifo_refusal(errno: Errno, has_right: bool) -> (String, String) {
    let remedy = if has_right {
        "give this cgroup a budget (cpu.rt_runtime_us) or lift RestrictRealtime= and the system \
         call filter"
    } else {
        "run as a user with rtprio (limits.d) or CAP_SYS_NICE"
    };
    (errno.desc().to_owned(), format!("{remedy}; {ORDINARY}"))
}

impl<T> Thread<T> {
    /// Outcomes of the thread's requests: affinity, then priority.
    pub fn grants(&self) -> &[Grant] {
        &self.grants
    }

    /// Waits for the end of the thread and returns the result of its body.
    pub fn join(self) -> thread::Result<T> {
        self.handle.join()
    }

    /// Whether the body has ended.
    pub fn is_finished(&self) -> bool {
        self.handle.is_finished()
    }
}

impl<T> fmt::Debug for Thread<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Thread")
            .field("name", &self.handle.thread().name())
            .field("grants", &self.grants)
            .finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Outcome;

    #[test]
    fn thread_ordinary_makes_no_request() {
        let thread = spawn(ThreadConfig::new("ordinary"), || {
            thread::current().name().map(str::to_owned)
        });
        let thread = thread.unwrap();
        assert!(
            thread
                .grants()
                .iter()
                .all(|grant| grant.outcome == Outcome::NotRequested)
        );
        assert_eq!(thread.join().unwrap().as_deref(), Some("ordinary"));
    }

    #[test]
    fn thread_stoppable_ends_on_request() {
        let body = |stop: &AtomicBool| {
            let mut turns = 0_u64;
            while !stop.load(Ordering::Relaxed) {
                turns += 1;
                thread::yield_now();
            }
            turns
        };
        let thread = Stoppable::spawn(ThreadConfig::new("stoppable"), body).unwrap();
        assert!(!thread.is_finished());
        assert!(thread.stop().is_ok());
        let failed = Stoppable::spawn(ThreadConfig::new("failed"), |_: &AtomicBool| {
            Err::<(), _>("broken")
        });
        assert_eq!(failed.unwrap().stop().unwrap(), Err("broken"));
    }

    /// Whatever the rights of the user: the body runs, and each request has an outcome.
    #[test]
    fn thread_requests_have_outcome_and_body_runs() {
        let config = ThreadConfig {
            priority: Some(10),
            cpus: vec![0],
            stack_bytes: 128 * 1024,
            ..ThreadConfig::new("asking")
        };
        let thread = spawn(config, || 42).unwrap();
        let items: Vec<_> = thread.grants().iter().map(|grant| grant.item).collect();
        assert_eq!(items, ["affinity to CPU", "SCHED_FIFO priority"]);
        assert!(
            thread
                .grants()
                .iter()
                .all(|grant| grant.outcome != Outcome::NotRequested)
        );
        assert_eq!(thread.join().unwrap(), 42);
    }

    #[test]
    fn thread_impossible_request_has_remedy() {
        let config = ThreadConfig {
            priority: Some(99),
            cpus: vec![usize::MAX],
            ..ThreadConfig::new("impossible")
        };
        let thread = spawn(config, || ()).unwrap();
        let lines: Vec<_> = thread.grants().iter().map(ToString::to_string).collect();
        assert_eq!(
            lines[1],
            "SCHED_FIFO priority 99: refused (not in 1..=98); \
             choose 1 to 98; continuing without real-time priority"
        );
        assert!(
            lines[0].contains("refused (Invalid argument)"),
            "{}",
            lines[0]
        );
    }

    #[test]
    fn thread_fifo_refusal_names_likely_cause() {
        let (why, remedy) = fifo_refusal(Errno::EPERM, false);
        assert_eq!(why, "Operation not permitted");
        assert!(remedy.contains("CAP_SYS_NICE"));
        assert!(
            fifo_refusal(Errno::EPERM, true)
                .1
                .contains("cpu.rt_runtime_us")
        );
    }

    #[test]
    fn thread_invalid_name_errors_panic_is_result() {
        assert!(spawn(ThreadConfig::new("a\0b"), || ()).is_err());
        let thread = spawn(ThreadConfig::new("panics"), || panic!("on purpose")).unwrap();
        assert!(thread.join().is_err());
    }
}
