//! The stop switch of a controller: a count that any thread may advance without waiting, and for each net
//! thread a word with its answer. It does not end nets itself.

use std::fmt;
use std::net::{IpAddr, Ipv6Addr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, AtomicU32, AtomicU64, AtomicUsize, Ordering};

use takt_rt::Nanos;

use crate::cell::THREADS_MAX;

/// Source of a stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Origin {
    /// A process of this host, over the Unix socket.
    Process {
        /// Its process number.
        pid: u32,
        /// Its user.
        uid: u32,
    },
    /// Over TCP, with the token or the page's key.
    Network(SocketAddr),
    /// Through the server, the second path of the page.
    Server,
    /// The program that the controller is part of.
    Program,
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Process { pid, uid } => write!(f, "process {pid} of user {uid}"),
            Self::Network(address) => address.fmt(f),
            Self::Server => f.write_str("a client of the server"),
            Self::Program => f.write_str("the controller's own program"),
        }
    }
}

impl Origin {
    #[expect(clippy::cast_possible_truncation, reason = "the halves of 128 bits")]
    const fn words(self) -> [u64; 3] {
        match self {
            Self::Process { pid, uid } => [1 | (pid as u64) << 8, uid as u64, 0],
            Self::Network(address) => {
                let ip = match address.ip() {
                    IpAddr::V4(ip) => ip.to_ipv6_mapped(),
                    IpAddr::V6(ip) => ip,
                };
                let (port, bits) = (address.port() as u64, ip.to_bits());
                [2 | port << 8, (bits >> 64) as u64, bits as u64]
            }
            Self::Server => [3, 0, 0],
            Self::Program => [4, 0, 0],
        }
    }

    #[expect(
        clippy::cast_possible_truncation,
        reason = "each word was made of a value of that width"
    )]
    fn of_words([first, second, third]: [u64; 3]) -> Option<Self> {
        match first & 0xff {
            1 => Some(Self::Process {
                pid: (first >> 8) as u32,
                uid: second as u32,
            }),
            2 => {
                let ip = Ipv6Addr::from_bits(u128::from(second) << 64 | u128::from(third));
                let port = (first >> 8) as u16;
                Some(Self::Network(SocketAddr::new(ip.to_canonical(), port)))
            }
            3 => Some(Self::Server),
            4 => Some(Self::Program),
            _ => None,
        }
    }
}

/// Generation: counts stops and releases of a controller; odd while it is stopped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Generation(u64);

impl Generation {
    /// Whether the controller is stopped.
    #[must_use]
    pub const fn is_stopped(self) -> bool {
        self.0 % 2 == 1
    }

    /// Number of stops.
    #[must_use]
    pub const fn stops(self) -> u64 {
        self.0.div_ceil(2)
    }
}

/// Answer words of one net thread.
#[derive(Debug, Default)]
struct Word {
    /// Time from one of its cycles to the next, ns.
    period: AtomicI64,
    /// The last generation that it applied.
    applied: AtomicU64,
    /// Number of nets that it ended for it.
    nets: AtomicU32,
    /// When it had sent the withdrawal of all commands to the drivers, ns.
    at: AtomicI64,
}

/// The answer of a net thread.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ThreadAnswer {
    /// Its period.
    pub period: Nanos,
    /// Whether it applied the present generation.
    pub is_applied: bool,
    /// Number of nets that it ended for it.
    pub nets: u32,
    /// When drivers received it, on the monotonic clock of this host.
    pub at: Nanos,
}

#[derive(Debug, Default)]
struct Shared {
    generation: AtomicU64,
    /// Source of the last stop, with its generation.
    origin: [AtomicU64; 3],
    origin_of: AtomicU64,
    /// When, ns.
    since: AtomicI64,
    /// Number of net threads.
    threads: AtomicUsize,
    words: [Word; THREADS_MAX],
    /// Number of rejected requests over the channel.
    refused: AtomicU64,
}

/// The switch. Clones are the same one. No call of it waits, locks or allocates.
#[derive(Clone, Debug, Default)]
pub struct StopSwitch {
    shared: Arc<Shared>,
}

impl StopSwitch {
    /// Stops; returns whether it was running before.
    pub fn stop(&self, origin: Origin) -> bool {
        let shared = &self.shared;
        // Time first: a reader of the new generation finds a time that is at most slightly early.
        let now = takt_rt::monotonic();
        let raised =
            shared
                .generation
                .fetch_update(Ordering::AcqRel, Ordering::Acquire, |generation| {
                    (generation % 2 == 0).then(|| generation + 1)
                });
        let Ok(before) = raised else {
            return false;
        };
        shared.since.store(now.0, Ordering::Relaxed);
        for (word, value) in shared.origin.iter().zip(origin.words()) {
            word.store(value, Ordering::Relaxed);
        }
        shared.origin_of.store(before + 1, Ordering::Release);
        true
    }

    /// Releases a stop; returns whether there was one. Nothing starts by it.
    #[must_use = "there may be nothing to release"]
    pub fn release(&self) -> bool {
        let shared = &self.shared;
        shared
            .generation
            .fetch_update(Ordering::AcqRel, Ordering::Acquire, |generation| {
                (generation % 2 == 1).then(|| generation + 1)
            })
            .is_ok()
    }

    /// The present generation.
    #[must_use]
    pub fn generation(&self) -> Generation {
        Generation(self.shared.generation.load(Ordering::Acquire))
    }

    /// Whether it is stopped.
    #[must_use]
    pub fn is_stopped(&self) -> bool {
        self.generation().is_stopped()
    }

    /// Source and time of the last stop; `None` if there was none or one is being written.
    #[must_use]
    pub fn last_stop(&self) -> Option<(Origin, Nanos)> {
        let shared = &self.shared;
        let of = Generation(shared.origin_of.load(Ordering::Acquire));
        if of.stops() != self.generation().stops() {
            return None;
        }
        let words = shared.origin.each_ref().map(|w| w.load(Ordering::Relaxed));
        let since = Nanos(shared.since.load(Ordering::Relaxed));
        Origin::of_words(words).map(|origin| (origin, since))
    }

    /// Number of rejected requests over the channel.
    #[must_use]
    pub fn refused(&self) -> u64 {
        self.shared.refused.load(Ordering::Relaxed)
    }

    pub(super) fn count_refused(&self) {
        self.shared.refused.fetch_add(1, Ordering::Relaxed);
    }

    /// Registers a net thread with its number and period, in ascending order.
    pub(crate) fn register(&self, thread: usize, period: Nanos) {
        if let Some(word) = self.shared.words.get(thread) {
            word.period.store(period.0, Ordering::Relaxed);
            self.shared.threads.store(thread + 1, Ordering::Release);
        }
    }

    /// Unregisters all net threads.
    pub(crate) fn unregister_all(&self) {
        self.shared.threads.store(0, Ordering::Release);
    }

    /// Records that a thread applied a generation and ended so many nets.
    pub(crate) fn answer(&self, thread: usize, applied: Generation, nets: u32, now: Nanos) {
        if let Some(word) = self.shared.words.get(thread) {
            word.nets.store(nets, Ordering::Relaxed);
            word.at.store(now.0, Ordering::Relaxed);
            word.applied.store(applied.0, Ordering::Release);
        }
    }

    /// Answers of the net threads to the present generation.
    pub fn answers(&self) -> impl Iterator<Item = ThreadAnswer> {
        let generation = self.generation();
        let threads = self.shared.threads.load(Ordering::Acquire);
        let words = self.shared.words.iter().take(threads);
        words.map(move |word| {
            let is_applied = word.applied.load(Ordering::Acquire) >= generation.0;
            ThreadAnswer {
                period: Nanos(word.period.load(Ordering::Relaxed)),
                is_applied,
                nets: word.nets.load(Ordering::Relaxed),
                at: Nanos(word.at.load(Ordering::Relaxed)),
            }
        })
    }

    /// The longest period of a net thread.
    pub(super) fn longest_period(&self) -> Nanos {
        let periods = self.answers().map(|answer| answer.period);
        periods.max().unwrap_or(Nanos::ZERO)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn second_stop_changes_nothing() {
        let switch = StopSwitch::default();
        assert!(!switch.is_stopped() && switch.last_stop().is_none());
        let first = Origin::Process { pid: 7, uid: 1000 };
        assert!(switch.stop(first));
        let at = switch.last_stop().unwrap();
        assert!(!switch.stop(Origin::Program));
        assert_eq!(switch.last_stop(), Some(at));
        assert_eq!(at.0, first);
        assert_eq!(switch.generation().stops(), 1);
        assert!(switch.release() && !switch.release());
        assert!(!switch.is_stopped());
        assert!(switch.stop(Origin::Server));
        assert_eq!(switch.generation().stops(), 2);
    }

    #[test]
    fn stop_sources_round_trip() {
        for origin in [
            Origin::Process {
                pid: u32::MAX,
                uid: 0,
            },
            Origin::Network("192.0.2.1:4711".parse().unwrap()),
            Origin::Network("[2001:db8::1]:65535".parse().unwrap()),
            Origin::Server,
            Origin::Program,
        ] {
            assert_eq!(Origin::of_words(origin.words()), Some(origin));
        }
        assert_eq!(Origin::of_words([0; 3]), None);
    }

    #[test]
    fn unapplied_stop_is_visible() {
        let switch = StopSwitch::default();
        let ms = Nanos::from_millis;
        switch.register(0, ms(1));
        switch.register(1, ms(4));
        switch.stop(Origin::Program);
        switch.answer(1, switch.generation(), 3, ms(5));
        let answers: Vec<_> = switch.answers().collect();
        assert_eq!(answers.len(), 2);
        assert!(!answers[0].is_applied);
        assert!(answers[1].is_applied && answers[1].nets == 3);
        assert_eq!(switch.longest_period(), ms(4));
    }
}
