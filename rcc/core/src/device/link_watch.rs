//! Link state of a driver's interface: reported once when it stops carrying frames, and once when it recovers. The
//! real-time thread only counts failed frames; the reader of the driver's events queries the interface flags.

use std::io;
use std::sync::atomic::{AtomicI32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use takt_rt::interface::{Interface, LinkFault, Medium};

use super::driver::DriverEvent;

/// Time between two queries of an interface without failures.
const EVERY: Duration = Duration::from_millis(100);
/// A link without a failed frame for this long has recovered.
const QUIET: Duration = Duration::from_secs(1);

/// Failed sends and receives, counted in the real-time thread.
#[derive(Debug, Default)]
pub struct LinkErrors {
    count: AtomicU64,
    errno: AtomicI32,
}

impl LinkErrors {
    /// Notes an error number.
    pub fn note(&self, errno: i32) {
        self.errno.store(errno, Ordering::Relaxed);
        self.count.fetch_add(1, Ordering::Release);
    }

    /// Number of failed sends and receives.
    pub fn failed(&self) -> u64 {
        self.count.load(Ordering::Relaxed)
    }

    /// Notes an error of a system link.
    pub fn note_io(&self, error: &io::Error) {
        self.note(error.raw_os_error().unwrap_or(nix::libc::EIO));
    }
}

/// The link of a driver: a network interface, or a link without a state.
#[derive(Debug)]
pub struct LinkWatch {
    medium: Medium,
    errors: Arc<LinkErrors>,
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    name: String,
    interface: Option<Interface>,
    asked: Option<Instant>,
    /// Error count, and when it last increased.
    seen: u64,
    failed: Option<Instant>,
    /// The fault reported last.
    fault: Option<LinkFault>,
}

impl State {
    fn find(&mut self, interface: &str) {
        interface.clone_into(&mut self.name);
        self.interface = Interface::open(interface).ok();
    }
}

impl LinkWatch {
    /// A watch of the named interface, if there is one; errors are reported under `name` otherwise.
    pub fn new(name: &str, interface: Option<&str>, medium: Medium) -> Self {
        let errors = Arc::<LinkErrors>::default();
        let mut state = State {
            name: name.to_owned(),
            interface: None,
            asked: None,
            seen: 0,
            failed: None,
            fault: None,
        };
        if let Some(interface) = interface {
            state.find(interface);
        }
        Self {
            medium,
            errors,
            state: Mutex::new(state),
        }
    }

    /// Sets the interface of a link that was unknown before.
    pub fn find(&self, interface: impl FnOnce() -> Option<String>) {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        if state.interface.is_none()
            && state.asked.is_none_or(|at| at.elapsed() >= EVERY)
            && let Some(interface) = interface()
        {
            state.find(&interface);
        }
    }

    /// Counters for the real-time thread.
    pub fn errors(&self) -> Arc<LinkErrors> {
        Arc::clone(&self.errors)
    }

    /// Number of failed sends and receives.
    pub fn failed(&self) -> u64 {
        self.errors.failed()
    }

    /// The change since the last call.
    pub fn poll(&self, now: Instant) -> Option<DriverEvent> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let count = self.errors.count.load(Ordering::Acquire);
        let fails = count != state.seen;
        let since = |at: Instant| now.saturating_duration_since(at);
        if !fails && state.asked.is_some_and(|at| since(at) < EVERY) {
            return None;
        }
        state.asked = Some(now);
        state.seen = count;
        if fails {
            state.failed = Some(now);
        }
        let failed = state.failed.is_some_and(|at| since(at) < QUIET);
        let fault = self.fault(&state, failed);
        if fault == state.fault {
            return None;
        }
        state.fault = fault;
        Some(match fault {
            Some(fault) => DriverEvent::error(fault.on(&state.name, self.medium).to_string()),
            None => DriverEvent::info(format!("{}: the link works again", state.name)),
        })
    }

    fn fault(&self, state: &State, failed: bool) -> Option<LinkFault> {
        let of_errno =
            failed.then(|| LinkFault::of_errno(self.errors.errno.load(Ordering::Relaxed)));
        let Some(interface) = &state.interface else {
            return of_errno;
        };
        interface.fault().or_else(|| match of_errno? {
            // It has recovered meanwhile.
            LinkFault::Down => None,
            LinkFault::Missing => Some(LinkFault::Replaced),
            other @ (LinkFault::Replaced
            | LinkFault::NoCarrier
            | LinkFault::QueueFull
            | LinkFault::Os(_)) => Some(other),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::driver::Severity;
    use super::*;

    fn poll(watch: &LinkWatch, at: Instant) -> Option<(Severity, String)> {
        let event = watch.poll(at)?;
        Some((event.severity, event.text))
    }

    #[test]
    fn failed_frames_report_onset_and_end_once() {
        let watch = LinkWatch::new("can0", None, Medium::Can);
        let start = Instant::now();
        assert_eq!(poll(&watch, start), None);
        let errors = watch.errors();
        for ms in 0..50 {
            errors.note(nix::libc::ENOBUFS);
            let event = poll(&watch, start + Duration::from_millis(ms));
            assert_eq!(event.is_some(), ms == 0);
            let Some((severity, text)) = event else {
                continue;
            };
            assert_eq!(severity, Severity::Error);
            assert!(text.contains("No buffer space available"), "{text}");
            assert!(text.contains("\nhint: "), "{text}");
        }
        assert_eq!(poll(&watch, start + QUIET / 2), None);
        let (severity, text) = poll(&watch, start + QUIET * 2).unwrap();
        assert_eq!(severity, Severity::Info);
        assert_eq!(text, "can0: the link works again");
        assert_eq!(poll(&watch, start + QUIET * 3), None);
        assert_eq!(watch.failed(), 50);
    }

    #[test]
    fn another_link_error_is_reported_again() {
        let watch = LinkWatch::new("can0", None, Medium::Can);
        let now = Instant::now();
        watch.errors().note(nix::libc::ENOBUFS);
        assert!(poll(&watch, now).is_some());
        watch.errors().note(nix::libc::ENETDOWN);
        let (_, text) = poll(&watch, now).unwrap();
        assert!(text.contains("Network is down"), "{text}");
        watch
            .errors()
            .note_io(&io::Error::from_raw_os_error(nix::libc::EIO));
        let (_, text) = poll(&watch, now).unwrap();
        assert!(text.contains("Input/output error"), "{text}");
    }

    #[test]
    fn missing_interface_is_reported_before_any_frame() {
        let watch = LinkWatch::new("bus", Some("nowhere0"), Medium::Ethernet);
        let (severity, text) = poll(&watch, Instant::now()).unwrap();
        assert_eq!(severity, Severity::Error);
        assert!(text.starts_with("nowhere0: no such interface"), "{text}");
        let watch = LinkWatch::new("bus", Some("lo"), Medium::Ethernet);
        assert_eq!(poll(&watch, Instant::now()), None);
    }

    #[test]
    fn replaced_interface_is_named_as_such() {
        let watch = LinkWatch::new("bus", Some("lo"), Medium::Ethernet);
        watch.errors().note(nix::libc::ENXIO);
        let (_, text) = poll(&watch, Instant::now()).unwrap();
        assert!(text.contains("removed and came back"), "{text}");
    }
}
