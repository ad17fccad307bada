//! Mobile bases on the real wire, moved by nets: Segway RMP on a CAN bus inside this process.

#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use takt_can::bus::{Bus, Config};
use takt_can::linux::{LivePort, monotonic};
use takt_can::rmp::emulator::{Powerbase, PowerbaseConfig, serve};
use takt_can::rmp::{Model, OmniConfig};
use takt_core::controller::{LoadRequest, NetState};
use takt_core::device::DeviceStatus;
use takt_core::{CellConfig, Controller, NetId, SessionId};
use takt_devices::rmp::RmpConfig;
use takt_devices::rmp::{Rmp, Wire, describe};
use takt_tests::steady;

/// Power bases in threads of their own, and a controller that commands them.
struct Yard {
    controller: Controller,
    stop: Arc<AtomicBool>,
    cut: Vec<Arc<AtomicBool>>,
    threads: Vec<JoinHandle<Powerbase>>,
}

impl Yard {
    fn new(model: Model, count: usize) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let mut yard = Self {
            controller: Controller::start(&CellConfig::default()).unwrap(),
            stop,
            cut: Vec::new(),
            threads: Vec::new(),
        };
        let links = ["front", "back"];
        let config = RmpConfig {
            model: model.name().to_owned(),
            ..RmpConfig::new("base", &links[..count])
        };
        let wires = (0..count).map(|_| Wire::Can(Box::new(yard.powerbase(model, count))));
        let wires: Vec<_> = wires.collect();
        let devices = vec![describe(&config)];
        let added = yard.controller.add_driver("base", devices, None, |ends| {
            Ok(Box::new(Rmp::start(&config, wires, ends)?))
        });
        added.unwrap();
        yard.wait("the base operational", |yard| {
            yard.status() == DeviceStatus::Operational
        });
        yard
    }

    /// Starts a power base on a bus of its own; returns the port at the other end.
    fn powerbase(&mut self, model: Model, count: usize) -> LivePort {
        let config = Config {
            rates: takt_can::bits::Rates::classic(500_000),
            ..Config::default()
        };
        let ours = LivePort::first_of(Bus::new(config));
        let mut theirs = ours.attach();
        let (stop, cut) = (Arc::clone(&self.stop), Arc::new(AtomicBool::new(false)));
        self.cut.push(Arc::clone(&cut));
        let turn_gain = (count == 2).then(|| OmniConfig::default().turn_gain);
        self.threads.push(std::thread::spawn(move || {
            let mut powerbase = Powerbase::new(PowerbaseConfig {
                model,
                turn_gain,
                start: monotonic(),
                ..PowerbaseConfig::default()
            });
            while !stop.load(Ordering::Relaxed) {
                powerbase.faults.silent = [cut.load(Ordering::Relaxed); 2];
                serve(&mut powerbase, &mut theirs, monotonic).unwrap();
            }
            powerbase
        }));
        ours
    }

    fn status(&self) -> DeviceStatus {
        self.controller.arm_state("base").unwrap().status
    }

    fn wait(&self, what: &str, done: impl Fn(&Self) -> bool) {
        let until = Instant::now() + Duration::from_secs(30);
        while !done(self) {
            assert!(Instant::now() < until, "waited in vain for: {what}");
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// Runs a net that moves the base for a while.
    fn start(&self, velocity: &str, seconds: f64) -> NetId {
        let text = format!(
            "{{ v=World::TwistValue(Value='{velocity}'),
                move=RobotBase::BaseVelocity(inVel=v.outValue,Robot='base'),
                clock=Core::Clock(),
                done=Core::DoubleGreater(inFirst=clock.outValue,Second='{seconds}'),
                cancel=Cancel(),
                end=Core::BooleanOr(inFirst=done.outValue,inSecond=cancel.outCancel),
                outTerminate=end.outValue }}"
        );
        let request = LoadRequest {
            text,
            session: SessionId::NONE,
            description: String::new(),
            period: None,
        };
        let id = self.controller.load(request).unwrap();
        self.controller.start_net(id).unwrap();
        id
    }

    fn state(&self, id: NetId) -> NetState {
        self.controller.net(id).unwrap().state()
    }

    fn stop(self) -> Vec<Powerbase> {
        drop(self.controller);
        self.stop.store(true, Ordering::Relaxed);
        let threads = self.threads.into_iter();
        threads.map(|thread| thread.join().unwrap()).collect()
    }
}

#[test]
fn rmp_net_moves_base_which_rests_after_net() {
    steady(|| {
        let yard = Yard::new(Model::Rmp200, 1);
        let net = yard.start("{vel:{x:0.5},rot:{z:0.3}}", 2.0);
        yard.wait("the net over", |yard| {
            yard.state(net) == NetState::Terminated
        });
        std::thread::sleep(Duration::from_secs(1));
        let bases = yard.stop();
        let truth = bases[0].truth();
        assert!(truth.x.hypot(truth.y) > 0.5, "{truth:?}");
        assert!(truth.heading > 0.2, "{truth:?}");
        assert!(bases[0].speed().iter().all(|speed| speed.abs() < 1e-3));
    });
}

#[test]
fn rmp_platform_lost_power_base_stops_and_ends_net() {
    steady(|| {
        let yard = Yard::new(Model::Rmp50, 2);
        let net = yard.start("{vel:{y:0.3}}", 60.0);
        std::thread::sleep(Duration::from_secs(1));
        assert_eq!(yard.state(net), NetState::Running);
        yard.cut[1].store(true, Ordering::Relaxed);
        yard.wait("the base offline", |yard| {
            yard.status() == DeviceStatus::Offline
        });
        yard.wait("the net over", |yard| {
            yard.state(net) == NetState::Terminated
        });
        yard.cut[1].store(false, Ordering::Relaxed);
        yard.wait("the base back", |yard| {
            yard.status() == DeviceStatus::Operational
        });
        std::thread::sleep(Duration::from_millis(500));
        let bases = yard.stop();
        assert!(bases.iter().all(|base| base.turned()[0].abs() > 1000.0));
        let speeds = bases.iter().flat_map(Powerbase::speed);
        assert!(speeds.into_iter().all(|speed| speed.abs() < 1e-3));
    });
}
