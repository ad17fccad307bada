//! Every kind of device at once: in virtual time and in a running controller, recorded and replayed,
//! and without an allocation in real time.

#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

mod fixtures;

#[path = "fixtures/cell.rs"]
mod cell;

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use fixtures::Fixture;
use takt_core::controller::{LoadRequest, NetState};
use takt_core::executor::report::Notifier;
use takt_core::record::{Recorder, replay};
use takt_core::{CellConfig, Controller, SessionId};
use takt_rt::alloc::{CountingAllocator, enter_real_time, real_time_allocations};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// The counter covers the whole process: one test at a time.
static COUNTER: Mutex<()> = Mutex::new(());

/// Outputs of the net of all devices after its run.
fn assert_used(value: impl Fn(&str) -> String) {
    let number = |key: &str| value(key).parse::<f64>().unwrap();
    for key in ["strategy", "tool", "flag", "bool"] {
        assert_eq!(value(key), "true", "{key}");
    }
    assert!((number("lwr") - 0.3).abs() < 1e-3, "{}", value("lwr"));
    assert!((number("ship") - 0.3).abs() < 1e-3, "{}", value("ship"));
    assert!((number("real") - 0.3).abs() < 1e-3, "{}", value("real"));
    // Up to 0.3 Nm at 100 Nm/rad, behind its damper.
    assert!(
        (0.002..0.0031).contains(&number("iiwa")),
        "{}",
        value("iiwa")
    );
    assert!(number("torque").abs() > 1.0, "{}", value("torque"));
    assert!(number("wheel").abs() > 1.0, "{}", value("wheel"));
    assert!(number("hand") > 0.009, "{}", value("hand"));
    assert_eq!(value("errors"), "0");
}

#[test]
fn sim_devices_step_without_allocation() {
    let _alone = COUNTER.lock().unwrap_or_else(PoisonError::into_inner);
    let mut fixture = Fixture::default();
    for (name, kind, parameters) in cell::devices() {
        fixture.add(name, kind, &parameters);
    }
    fixture.step();
    fixture.try_start(1, &cell::net(1.0), 1).unwrap();
    let before = real_time_allocations();
    let scope = enter_real_time();
    fixture.steps(1000);
    drop(scope);
    assert_eq!(real_time_allocations() - before, 0);
    let seen = std::cell::RefCell::new(fixture);
    assert_used(|key| seen.borrow_mut().out(1, key));
}

/// Runs the net of all devices to its end.
fn run(controller: &Controller) {
    let request = LoadRequest {
        text: cell::net(1.0),
        session: SessionId::NONE,
        description: String::new(),
        period: None,
    };
    let id = controller.load(request).unwrap();
    let net = controller.net(id).unwrap();
    assert_eq!(net.state(), NetState::Ready, "{:?}", net.rejection);
    controller.start_net(id).unwrap();
    let until = Instant::now() + Duration::from_secs(30);
    while controller.net(id).unwrap().state() != NetState::Terminated {
        assert!(Instant::now() < until, "the net does not end");
        std::thread::sleep(Duration::from_millis(5));
    }
    assert_eq!(controller.net(id).unwrap().end, None);
    let values = controller.out_values(id);
    assert_used(|key| {
        let key = format!("out{key}");
        let found = values.iter().find(|(k, _)| *k == key);
        found.map(|(_, text)| text.clone()).unwrap_or_default()
    });
    controller.unload(id).unwrap();
}

/// Records a cell of all devices; returns how many cycles, or that the host was too slow for that.
fn record(path: &Path) -> Result<u64, takt_core::Error> {
    let recording = Some(Recorder::start(path).unwrap());
    let controller = Controller::start_recording(&CellConfig::default(), recording).unwrap();
    // The second time the devices get the numbers of others.
    for round in 0..2 {
        let mut devices = cell::devices();
        if round == 1 {
            devices.reverse();
        }
        for (name, kind, parameters) in &devices {
            controller.add_device(name, kind, parameters).unwrap();
        }
        run(&controller);
        for (name, ..) in &devices {
            controller.remove_device(name).unwrap();
        }
    }
    controller.finish_recording().map(Option::unwrap)
}

#[test]
fn sim_cell_allocates_nothing_and_replays_identically() {
    let _alone = COUNTER.lock().unwrap_or_else(PoisonError::into_inner);
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("devices.mcap");
    let before = real_time_allocations();
    let mut attempts = (0..3).map(|_| record(&path));
    let cycles = attempts.find_map(Result::ok).unwrap();
    assert_eq!(real_time_allocations() - before, 0);
    let first = replay(&path).unwrap();
    assert_eq!((first.differs, first.cycles), (None, cycles));
    assert!(cycles > 1000, "{cycles}");
    assert_eq!(replay(&path).unwrap(), first);
}

#[test]
fn devices_list_interfaces_that_clients_know() {
    let controller = Controller::start(&CellConfig::default()).unwrap();
    for (name, kind, parameters) in cell::devices() {
        controller.add_device(name, kind, &parameters).unwrap();
    }
    let devices = controller.devices();
    let interfaces = |name: &str| {
        let device = devices.iter().find(|d| d.name == name).unwrap();
        let interfaces = device.interfaces.iter();
        interfaces
            .map(|(name, parameters)| format!("{name}{parameters:?}"))
            .collect::<Vec<_>>()
    };
    assert_eq!(interfaces("base"), ["cartesianposition{}", "robotbase{}"]);
    assert_eq!(
        interfaces("lwr"),
        [
            "armkinematics{}",
            "io{\"anin\": \"0\", \"anout\": \"8\", \"digin\": \"8\", \"digout\": \"8\"}",
            "robotarm{\"jointcount\": \"7\"}"
        ]
    );
    assert_eq!(
        interfaces("io"),
        ["io{\"anin\": \"2\", \"anout\": \"2\", \"digin\": \"8\", \"digout\": \"8\"}"]
    );
}

#[test]
fn notify_of_waiting_thread_allocates_nothing() {
    let _alone = COUNTER.lock().unwrap_or_else(PoisonError::into_inner);
    let (notifier, ended) = (
        Arc::new(Notifier::default()),
        Arc::new(AtomicBool::new(false)),
    );
    let (waits, ends) = (Arc::clone(&notifier), Arc::clone(&ended));
    let receiver = std::thread::spawn(move || {
        waits.attach();
        while !ends.load(Ordering::Relaxed) {
            waits.wait(Duration::from_secs(10));
            waits.take();
        }
    });
    let before = real_time_allocations();
    let scope = enter_real_time();
    for round in 0..1000 {
        notifier.notify(round % 2 == 0);
    }
    drop(scope);
    assert_eq!(real_time_allocations() - before, 0);
    ended.store(true, Ordering::Relaxed);
    while !receiver.is_finished() {
        notifier.notify(false);
        std::thread::yield_now();
    }
}
