//! Simulated time of a whole process: its threads miss no cycle, however late the host runs them.
#![allow(
    clippy::unwrap_used,
    clippy::disallowed_methods,
    reason = "a test may fail anywhere, and stalls on purpose"
)]

use std::io::Write as _;
use std::ops::ControlFlow;
use std::os::fd::AsFd as _;
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

use takt_rt::cycle::run_cycles;
use takt_rt::{Nanos, monotonic, read_tai, readable, simulated, sleep_until, stats};

const PERIOD: Duration = Duration::from_millis(1);
const CYCLES: u64 = 300;
/// Longer than a cycle by far.
const STALL: Duration = Duration::from_millis(20);

/// Cycles of a thread that stalls in some of them; how many it missed.
fn missed(stalls_each: u64) -> u64 {
    let (mut writer, reader) = stats::pair();
    run_cycles(PERIOD, None, &mut writer, |tick| {
        if stalls_each > 0 && tick.index % stalls_each == stalls_each - 1 {
            std::thread::sleep(STALL);
        }
        if tick.index < CYCLES {
            ControlFlow::Continue(())
        } else {
            ControlFlow::Break(())
        }
    });
    reader.snapshot().overruns
}

/// All in one test: the time of a process is simulated from its begin to the end of the process.
#[test]
fn simulated_time_waits_for_stalled_threads_sockets_and_sleeps() {
    assert_eq!(simulated::waited(), None);
    let before = monotonic();
    let offset = read_tai().map(|reading| reading.offset());
    simulated::begin(1.0);
    assert!(monotonic() >= before);
    let begin = (Instant::now(), monotonic());
    let threads = [37, 0, 50].map(|each| std::thread::spawn(move || missed(each)));
    let missed = threads.map(|thread| thread.join().unwrap());
    assert_eq!(missed, [0; 3]);
    // Twelve stalls or so, of which each thread's own cycles took a part.
    let waited = simulated::waited().unwrap();
    assert!(waited > Nanos::from(STALL * 8), "{waited}");
    let (real, simulated) = (Nanos::from(begin.0.elapsed()), monotonic() - begin.1);
    assert!(real > simulated && real >= waited, "{real} {simulated}");

    // TAI keeps its distance, as if nothing had stood.
    if let (Ok(before), Ok(now)) = (offset, read_tai()) {
        let moved = (now.offset() - before).abs();
        assert!(moved < Nanos::from_millis(1), "{moved}");
    }

    // A thread that waits for a socket is awaited, and wakes when something arrives.
    let (mut near, far) = UnixStream::pair().unwrap();
    assert!(!readable(far.as_fd(), 5 * PERIOD).unwrap());
    let waits = std::thread::spawn(move || readable(far.as_fd(), Duration::from_secs(60)).unwrap());
    sleep_until(monotonic() + PERIOD.into()).unwrap();
    near.write_all(b"x").unwrap();
    assert!(waits.join().unwrap());
}
