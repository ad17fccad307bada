//! A complete cycle thread: host, thread, real-time scope, statistics, and a published state.
//! `cargo run --example cycle --release [CYCLES]`; 1 ms each, no rights needed.
//!
//! It moves nothing: the body of the cycle is a counter.
#![expect(clippy::print_stdout, reason = "examples print results")]

use std::{env, io, ops::ControlFlow, time::Duration};

use takt_rt::{
    alloc::{self, CountingAllocator},
    cycle::run_cycles,
    host::{self, HostConfig},
    latest::latest,
    stats,
    thread::{ThreadConfig, spawn},
};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

fn main() -> io::Result<()> {
    let cycles = env::args()
        .nth(1)
        .and_then(|text| text.parse().ok())
        .unwrap_or(1_000);

    let host = host::prepare(&HostConfig::default());
    let (mut writer, reader) = stats::pair();
    let (mut state_out, mut state_in) = latest(1, || 0_u64);

    let config = ThreadConfig {
        priority: Some(80),
        ..ThreadConfig::new("cycle")
    };
    let thread = spawn(config, move || {
        // Set-up ends here: from now on the thread must not allocate.
        let _real_time = alloc::enter_real_time();
        run_cycles(Duration::from_millis(1), None, &mut writer, |tick| {
            state_out.write(tick.index);
            if tick.index + 1 < cycles {
                ControlFlow::Continue(())
            } else {
                ControlFlow::Break(())
            }
        })
    })?;

    for grant in host.grants().iter().chain(thread.grants()) {
        println!("{grant}");
    }
    let ran = thread.join().expect("the body does not panic");
    println!("{ran} cycles run, the last in slot {}", state_in.read());
    println!("{}", reader.snapshot());
    println!(
        "{} allocations in real-time threads",
        alloc::real_time_allocations()
    );
    Ok(())
}
