//! Proof that neither the net thread nor drivers allocate: whole runs under a counting allocator,
//! and that the counter detects an allocation.

#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

mod common;

use std::sync::Arc;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use common::{Cell, swing};
use takt_core::cell::NetThreadSettings;
use takt_core::controller::RuleRequest;
use takt_core::device::driver::DriverConfig;
use takt_core::record::Recorder;
use takt_core::{CellConfig, Controller, NetId};
use takt_devices::fri::LwrConfig;
use takt_net::{Cycle, Definition, Image, Limits, LoadContext, Moment, NoDevices, Primitive, load};
use takt_rt::alloc::{CountingAllocator, enter_real_time, real_time_allocations};
use takt_tests::steady;

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// The counter covers the whole process: one test at a time.
static COUNTER: Mutex<()> = Mutex::new(());

/// How many allocations real-time threads make while `run` runs.
fn allocations(run: impl FnOnce()) -> u64 {
    let _alone = COUNTER.lock().unwrap_or_else(PoisonError::into_inner);
    let before = real_time_allocations();
    run();
    real_time_allocations() - before
}

/// Checked cycles of a whole run.
const CYCLES: u64 = 2000;

fn move_an_arm(cell: &Cell) {
    let first = cell.controller.stats().cycles;
    let cancelled = cell.load(&swing("left", 5.0));
    cell.controller.start_net(cancelled).unwrap();
    cell.controller.cancel(cancelled).unwrap();
    cell.wait_for_end(cancelled);
    // Each moves the joint by half a radian, within its range.
    while cell.controller.stats().cycles < first + CYCLES {
        let net = cell.load(&swing("left", 0.9));
        cell.controller.start_net(net).unwrap();
        cell.wait_for_end(net);
        cell.controller.unload(net).unwrap();
    }
}

#[test]
fn running_cell_does_not_allocate() {
    let count = steady(|| allocations(|| move_an_arm(&Cell::new(&["left"]))));
    assert_eq!(count, 0);
}

#[test]
fn recorded_cell_does_not_allocate() {
    let count = steady(|| {
        let path = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("allocations.mcap");
        allocations(|| {
            let cell = Cell::recorded(&["left"], Some(Recorder::start(&path).unwrap()));
            move_an_arm(&cell);
            cell.controller.finish_recording().unwrap();
            // The controller goes on after the recording ends.
            let cycles = cell.controller.stats().cycles;
            cell.wait("cycles without a recording", |c| {
                c.stats().cycles > cycles + 600
            });
        })
    });
    assert_eq!(count, 0);
}

/// Ends after so many seconds.
fn lasting(seconds: f64) -> String {
    format!(
        "{{clock=Core::Clock(),over=Core::DoubleGreater(inFirst=clock.outValue,Second='{seconds}'),
        done=Core::BooleanNetcommOut(inValue=over.outValue,Key='done'),
        outTerminate=over.outValue}}"
    )
}

#[test]
fn shared_rules_do_not_allocate() {
    let count = steady(|| {
        let slow = Duration::from_millis(4);
        let anywhere = std::net::SocketAddr::from(([127, 0, 0, 1], 0));
        let mut cell = CellConfig::default();
        cell.controller.threads = vec![NetThreadSettings::new(slow)];
        let arm = |name: &str, thread| -> Arc<dyn DriverConfig> {
            let lwr = LwrConfig::new(name, anywhere);
            Arc::new(LwrConfig { thread, ..lwr })
        };
        cell.devices = vec![arm("left", None), arm("right", Some(slow))];
        allocations(|| {
            let cell = Cell::of(&cell, None);
            let first = cell.controller.stats().cycles;
            let mut angle = 0.0;
            while cell.controller.stats().cycles < first + CYCLES {
                let [left, right] = ["left", "right"].map(|arm| cell.load(&swing(arm, 0.9)));
                let periods = [Duration::from_millis(1), slow];
                let [fast, late] = periods.map(|period| cell.load_every(&lasting(0.1), period));
                // Started by an event in the other thread.
                let request = |condition: String, start| RuleRequest {
                    condition,
                    start: vec![start],
                    ..RuleRequest::default()
                };
                let controller = &cell.controller;
                controller
                    .schedule(request(format!("{late}.outdone"), left))
                    .unwrap();
                controller
                    .schedule(request(format!("{fast}.terminated"), right))
                    .unwrap();
                controller.start_net(fast).unwrap();
                controller.start_net(late).unwrap();
                for net in [left, right] {
                    assert_eq!(cell.wait_for_end(net).end, None);
                }
                angle += 0.5;
                assert!(angle < 2.5, "the joints come to their end");
            }
            let threads = cell.controller.threads();
            assert!(
                threads
                    .iter()
                    .all(|thread| thread.stats.cycles > CYCLES / 8)
            );
        })
    });
    assert_eq!(count, 0);
}

/// Counts its cycles in `count` and never ends.
const ENDLESS: &str = "{kept=Core::IntPre(inValue=cycles.outValue),
    isNull=Core::IntIsNull(inValue=kept.outValue),
    before=Core::IntConditional(inCondition=isNull.outValue,inFalse=kept.outValue),
    cycles=Core::IntAdd(inFirst=before.outValue,Second='1'),
    count=Core::IntNetcommOut(inValue=cycles.outValue,Key='count'),
    never=Core::BooleanValue(),outTerminate=never.outValue}";

/// Difference between the cycle counts of a net and of its thread: constant between two cycles if none
/// is missing or repeated, and one more during a cycle.
fn ahead(controller: &Controller, net: NetId, thread: usize) -> i64 {
    let cycles = || controller.threads()[thread].stats.cycles;
    let sample = || loop {
        let before = cycles();
        let net = controller.net_figures(net).unwrap().counts.cycles;
        if cycles() == before {
            return i64::try_from(net).unwrap() - i64::try_from(before).unwrap();
        }
    };
    (0..50).map(|_| sample()).min().unwrap()
}

#[test]
fn loading_large_nets_causes_no_missed_cycles() {
    let mut large = String::from("{never=Core::BooleanValue(),outTerminate=never.outValue");
    for i in 0..10_000 {
        large += &format!(",a{i}=Core::DoubleAdd(First='1')");
    }
    large.push('}');
    let slow = Duration::from_millis(4);
    let mut cell = CellConfig::default();
    cell.controller.threads = vec![NetThreadSettings::new(slow)];
    let count = allocations(|| {
        let cell = Cell::of(&cell, None);
        let controller = &cell.controller;
        let nets = [cell.load(ENDLESS), cell.load_every(ENDLESS, slow)];
        for net in nets {
            controller.start_net(net).unwrap();
        }
        let ahead = || [0, 1].map(|i| ahead(controller, nets[i], i));
        let before = ahead();
        for round in 0..6 {
            let period = [Duration::from_millis(1), slow][round % 2];
            let net = cell.load_every(&large, period);
            // Into the net thread, and out of it again.
            let request = RuleRequest {
                condition: format!("{}.terminated", nets[round % 2]),
                start: vec![net],
                ..RuleRequest::default()
            };
            controller.schedule(request).unwrap();
            controller.unload(net).unwrap();
        }
        assert_eq!(ahead(), before);
        for net in nets {
            controller.abort(net).unwrap();
            let counted = controller.net_figures(net).unwrap().counts.cycles;
            let values = controller.out_values(net);
            assert_eq!(values[0].1, counted.to_string(), "the net's own count");
        }
    });
    assert_eq!(count, 0);
}

/// A primitive that allocates.
struct Careless;

impl Primitive for Careless {
    fn step(&mut self, cycle: &Cycle<'_>) {
        drop(std::hint::black_box(vec![cycle.count; 8]));
    }
}

#[test]
fn allocating_primitive_is_detected() {
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
