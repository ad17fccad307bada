//! Where nets run, and what happens when a thread has no room for a command.

use super::*;
use crate::cell::NetThreadSettings;
use crate::controller::registry::Registry;
use crate::controller::{Controller, LoadRequest, NetState, RuleRequest, RuleState};
use crate::ids::{NetId, SessionId};

const NET: &str = "{c=Cancel(),outTerminate=c.outCancel}";

fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

/// A controller without devices and with threads of these periods, ms.
fn controller(periods: &[u64]) -> Controller {
    let mut cell = CellConfig::default();
    let (first, others) = periods.split_first().unwrap();
    cell.controller.period = ms(*first);
    let settings = others
        .iter()
        .map(|period| NetThreadSettings::new(ms(*period)));
    cell.controller.threads = settings.collect();
    Controller::start(&cell).unwrap()
}

fn load(controller: &Controller) -> NetId {
    let request = LoadRequest {
        text: NET.to_owned(),
        session: SessionId::NONE,
        description: String::new(),
        period: None,
    };
    let net = controller.load(request).unwrap();
    assert_eq!(controller.net(net).unwrap().state(), NetState::Ready);
    net
}

// Placement.

#[test]
fn net_runs_in_slowest_dividing_thread() {
    let controller = controller(&[2, 8, 1, 20]);
    let registry = controller.inner.lock();
    for (period, thread, every) in [
        (None, 0, 1),
        (Some(2), 0, 1),
        (Some(8), 1, 1),
        (Some(1), 2, 1),
        (Some(20), 3, 1),
        (Some(16), 1, 2),
        (Some(40), 3, 2),
        (Some(6), 0, 3),
        (Some(7), 2, 7),
    ] {
        let place = registry.threads.place(period.map(ms), &[]).unwrap();
        assert_eq!((place.thread, place.every), (thread, every), "{period:?}");
        assert_eq!(place.period, ms(period.unwrap_or(2)));
    }
    let odd = registry
        .threads
        .place(Some(Duration::from_micros(1500)), &[]);
    let text = odd.unwrap_err().to_string();
    let expected = "1.5ms is not a whole multiple of the controller's 2ms, 8ms, 1ms and 20ms";
    assert!(text.contains(expected), "{text}");
}

#[test]
fn commanding_net_runs_in_device_thread() {
    let controller = controller(&[1, 4]);
    let mut registry = controller.inner.lock();
    registry.threads.serve_in("slow", 1);
    registry.threads.serve_in("slower", 1);
    let names =
        |names: &[&str]| -> Vec<String> { names.iter().map(|name| (*name).to_owned()).collect() };
    for (period, devices, expected) in [
        (None, &["fast"][..], Ok((0, 1, 1))),
        (Some(4), &["fast"], Ok((0, 4, 4))),
        (None, &["slow"], Ok((1, 4, 1))),
        (Some(8), &["slow", "slower"], Ok((1, 8, 2))),
        (
            Some(6),
            &["slow"],
            Err("6ms is not a whole multiple of the 4ms of the net thread that serves `slow`"),
        ),
        (
            None,
            &["slow", "fast"],
            Err("`slow` is served by that of 4ms and `fast` by that of 1ms; give both"),
        ),
    ] {
        let place = registry.threads.place(period.map(ms), &names(devices));
        match (place, expected) {
            (Ok(place), Ok((thread, period, every))) => {
                let expected = Placement {
                    thread,
                    period: ms(period),
                    every,
                };
                assert_eq!(place, expected, "{devices:?}");
            }
            (Err(rejection), Err(text)) => {
                assert!(rejection.to_string().contains(text), "{rejection}");
            }
            (place, expected) => panic!("{place:?} is not {expected:?}"),
        }
    }
}

// Commands for which there is no room.

/// Fills the ring to the first thread.
fn fill(registry: &mut Registry) {
    while registry.threads.send(0, Command::Forget(u32::MAX)).is_ok() {}
}

#[test]
fn net_stays_ready_if_command_queue_full() {
    let controller = controller(&[10]);
    let net = (0..10).find_map(|_| {
        let net = load(&controller);
        let mut registry = controller.inner.lock();
        fill(&mut registry);
        // The thread may make room before this; then it is no test.
        let error = registry.start(net).err()?.to_string();
        assert!(
            error.contains("requests to the net thread: at most 1024"),
            "{error}"
        );
        let known = registry.nets.get(net).unwrap();
        assert_eq!(known.state(), NetState::Ready);
        assert!(!known.is_starting());
        Some(net)
    });
    let net = net.unwrap();
    wait_for_room(&controller);
    controller.start_net(net).unwrap();
    assert_eq!(controller.net(net).unwrap().state(), NetState::Running);
}

#[test]
fn rule_rejected_by_full_queue_keeps_nets() {
    let controller = controller(&[10]);
    let nets: Vec<_> = (0..40).map(|_| load(&controller)).collect();
    let request = || RuleRequest {
        condition: "t".to_owned(),
        start: nets.clone(),
        ..RuleRequest::default()
    };
    {
        let mut registry = controller.inner.lock();
        fill(&mut registry);
        // One cycle takes 16 commands: not enough for these.
        let error = registry.install(request(), None).unwrap_err().to_string();
        assert!(error.contains("requests to the net thread"), "{error}");
    }
    for net in &nets {
        assert_eq!(controller.net(*net).unwrap().state(), NetState::Ready);
    }
    wait_for_room(&controller);
    let rule = controller.schedule(request()).unwrap();
    // Each net is still there to be started.
    while controller.rule(rule).unwrap().state == RuleState::Active {
        std::thread::sleep(ms(5));
    }
    assert_eq!(controller.rule(rule).unwrap().state, RuleState::Fired);
}

fn wait_for_room(controller: &Controller) {
    while controller
        .inner
        .lock()
        .threads
        .check_capacity(COMMANDS)
        .is_err()
    {
        std::thread::sleep(ms(5));
    }
}
