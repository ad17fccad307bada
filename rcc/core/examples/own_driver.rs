//! A driver in a program of its own: a turntable of one axis. Its wire is a motor inside of this process, where a real
//! driver exchanges a datagram. All else is what any driver needs; it does not open a port for programs.

#![expect(clippy::print_stdout, reason = "an example prints its result")]

use std::ops::ControlFlow;
use std::sync::atomic::Ordering;
use std::time::Duration;

use serde::Deserialize;
use takt_core::cell::{DriverKind, Section};
use takt_core::controller::{LoadRequest, NetState};
use takt_core::device::driver::{DeviceDriver, DriverConfig, DriverEnds, DriverThread};
use takt_core::device::endpoint::Endpoint;
use takt_core::device::setpoint::Joint;
use takt_core::device::{ArmDescription, DeviceDescription, DeviceStatus};
use takt_core::{CellConfig, Controller, Error, SessionId};
use takt_net::JointLimits;
use takt_rt::cycle::Cycles;
use takt_rt::stats;

/// One line for each driver of this program; in `takt`, the table of `takt-devices`.
const DRIVERS: &[DriverKind] = &[DriverKind::new::<Turntable>(Section::Device("turntable"))];
const CELL: &str = "[controller]\npriority = 80\n\
    [[device]]\ntype = 'turntable'\nname = 'table'\nvelocity_max = 60.0";
const CYCLE: Duration = Duration::from_millis(1);

/// Table of the cell file.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct Turntable {
    name: String,
    /// Degrees per second.
    velocity_max: f64,
}

impl DriverConfig for Turntable {
    fn name(&self) -> &str {
        &self.name
    }

    fn priority(&self) -> Option<u8> {
        Some(85)
    }

    fn check(&self) -> Result<(), String> {
        match self.velocity_max {
            0.1..=360.0 => Ok(()),
            _ => Err(format!("{}: velocity_max must be 0.1 to 360", self.name)),
        }
    }

    fn devices(&self) -> Vec<DeviceDescription> {
        let arm = ArmDescription {
            name: self.name.clone(),
            kind: "turntable",
            limits: vec![self.limits()],
            model: "".into(),
        };
        vec![arm.with(&[])]
    }

    fn start(&self, ends: DriverEnds) -> Result<Box<dyn DeviceDriver>, Error> {
        let (end, clock) = ends.only(&self.name)?;
        let mut end = Endpoint::new(end, &[], 1);
        let mut joint = Joint::new(self.limits());
        let mut motor = Motor::default();
        let (mut recorder, _) = stats::pair();
        let thread = DriverThread::start(&self.name, self.priority(), &[], move |stopping| {
            let scope = takt_rt::alloc::enter_real_time();
            Cycles::every(CYCLE).run(&mut recorder, |tick| {
                let is_stopping = stopping.load(Ordering::Relaxed);
                end.take();
                let set_points = &end.taken.joints[0];
                let fresh = !is_stopping && end.is_fresh(tick.scheduled, CYCLE.into());
                let play = tick.scheduled - joint.delay(set_points);
                // Within the limits, and braking at them when set-points end.
                let target = joint.sample(set_points, fresh, play, CYCLE.as_secs_f64());
                let measured = motor.exchange(target);
                end.reported
                    .enter(DeviceStatus::Operational, tick.scheduled);
                end.report_joints([(&joint, [Some(measured), None, None])]);
                end.publish();
                if is_stopping && joint.motion().1.abs() < 1e-6 {
                    return ControlFlow::Break(());
                }
                ControlFlow::Continue(())
            });
            drop(scope);
            clock
        })?;
        Ok(Box::new(thread))
    }
}

impl Turntable {
    fn limits(&self) -> JointLimits {
        JointLimits {
            position_min: -3.0,
            position_max: 3.0,
            velocity_max: self.velocity_max.to_radians(),
            acceleration_max: 2.0,
        }
    }
}

/// In place of a wire: a motor that is half of the way to its target a cycle later.
#[derive(Default)]
struct Motor(f64);

impl Motor {
    fn exchange(&mut self, target: f64) -> f64 {
        self.0 += (target - self.0) / 2.0;
        self.0
    }
}

fn main() -> Result<(), Error> {
    println!("the table is at {:.3} rad", turn()?);
    Ok(())
}

/// Turns the table by 0.3 rad in a second; returns where it is then, rad.
pub(crate) fn turn() -> Result<f64, Error> {
    let controller = Controller::start(&CellConfig::parse(CELL, DRIVERS)?)?;
    let text = "{clock=Core::Clock(),
        at=Core::DoubleMultiply(inFirst=clock.outValue,Second='0.3'),
        j=RobotArm::JointPosition(inPosition=at.outValue,Robot='table',Axis='0'),
        end=Core::DoubleGreater(inFirst=clock.outValue,Second='1'),outTerminate=end.outValue}";
    let net = controller.load(LoadRequest {
        text: text.to_owned(),
        session: SessionId::NONE,
        description: "turns the table".to_owned(),
        period: None,
    })?;
    while controller.devices()[0].status != DeviceStatus::Operational {
        std::thread::sleep(CYCLE);
    }
    controller.start_net(net)?;
    while controller
        .net(net)
        .is_some_and(|net| net.state() == NetState::Running)
    {
        std::thread::sleep(CYCLE);
    }
    let position = controller.arm_state("table").unwrap_or_default().joints[0].measured_position;
    Ok(position.unwrap_or(f64::NAN))
}
