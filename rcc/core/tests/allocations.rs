//! Proof that neither the net thread nor drivers allocate: whole runs under a counting allocator,
//! and that it would have seen an allocation.

#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

mod common;

use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use common::{Cell, swing};
use takt_core::record::Recorder;
use takt_net::{Cycle, Definition, Image, Limits, LoadContext, Moment, NoDevices, Primitive, load};
use takt_rt::alloc::{CountingAllocator, enter_real_time, real_time_allocations};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// The counter is the process's: one test at a time.
static COUNTER: Mutex<()> = Mutex::new(());

/// How many allocations real-time threads make while `run` runs.
fn allocations(run: impl FnOnce()) -> u64 {
    let _alone = COUNTER.lock().unwrap_or_else(PoisonError::into_inner);
    let before = real_time_allocations();
    run();
    real_time_allocations() - before
}

/// Cycles of a whole run that are looked at.
const CYCLES: u64 = 2000;

fn move_an_arm(cell: &Cell) {
    let first = cell.controller.stats().cycles;
    let cancelled = cell.load(&swing("left", 5.0));
    cell.controller.start_net(cancelled).unwrap();
    cell.controller.cancel(cancelled).unwrap();
    cell.wait_for_end(cancelled);
    // Each moves the joint on by half a radian: few enough to stay in its range.
    while cell.controller.stats().cycles < first + CYCLES {
        let net = cell.load(&swing("left", 0.9));
        cell.controller.start_net(net).unwrap();
        cell.wait_for_end(net);
        cell.controller.unload(net).unwrap();
    }
}

#[test]
fn a_running_cell_allocates_nothing_in_real_time() {
    let count = allocations(|| move_an_arm(&Cell::new(&["left"])));
    assert_eq!(count, 0);
}

#[test]
fn nor_does_one_that_is_recorded() {
    let path = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("allocations.mcap");
    let count = allocations(|| {
        let cell = Cell::recorded(&["left"], Some(Recorder::start(&path).unwrap()));
        move_an_arm(&cell);
        cell.controller.finish_recording().unwrap();
        // And goes on when nobody takes the cycles any more.
        let cycles = cell.controller.stats().cycles;
        cell.wait("cycles without a recording", |c| {
            c.stats().cycles > cycles + 600
        });
    });
    assert_eq!(count, 0);
}

/// A primitive as it must not be.
struct Careless;

impl Primitive for Careless {
    fn step(&mut self, cycle: &Cycle<'_>) {
        drop(std::hint::black_box(vec![cycle.count; 8]));
    }
}

#[test]
fn a_primitive_that_allocates_is_caught() {
    let mut registry = takt_core::registry();
    let careless = |_: &mut takt_net::Build<'_, '_>| Ok(Careless);
    registry.add([Definition::new("Test::Careless", "Allocates.", careless)]);
    let net =
        |inside| format!("{{{inside}never=Core::BooleanValue(),outTerminate=never.outValue}}");
    let evaluate = |text: &str| {
        let (limits, period) = (Limits::default(), Duration::from_millis(1));
        let context = LoadContext {
            registry: &registry,
            devices: &NoDevices,
            period,
            limits,
        };
        let mut plan = load(text, &context).unwrap();
        let image = Image::default();
        allocations(|| {
            let _scope = enter_real_time();
            for cycle in 1..=10 {
                assert!(!plan.evaluate(
                    &image,
                    Moment {
                        cycle,
                        ..Moment::default()
                    }
                ));
            }
        })
    };
    assert_eq!(evaluate(&net("")), 0);
    // One to allocate and one to free in each cycle.
    assert_eq!(evaluate(&net("x=Test::Careless(),")), 20);
}
