//! The devices that one net thread serves: driver states are copied to the image before a cycle,
//! commands of nets to the drivers after it. It starts no driver.

mod gate;

use takt_net::Moment;
use takt_net::device::JointError;
use takt_rt::Nanos;
use takt_rt::latest::{LatestReader, LatestWriter};
use takt_rt::stats::Recorder;

use crate::device::sim::Simulated;
use crate::device::{DeviceCommand, DeviceState, Place, SetPoint};
use crate::executor::flight::FlightWriter;
use crate::executor::serve::gate::Gate;
use crate::executor::stop::StopPart;
use crate::executor::{DEVICES_MAX, DeviceView, Executor};

/// A device as a net thread serves it.
#[derive(Debug)]
pub struct DeviceEnd {
    number: usize,
    place: Place,
    driver: Driver,
    /// Commands of nets.
    command: DeviceCommand,
    gate: Gate,
    flight: Option<FlightWriter>,
    /// When the state that nets see was measured.
    stamp: Nanos,
}

impl DeviceEnd {
    /// The end of the device of that number.
    #[must_use]
    pub fn new(number: usize, place: Place, driver: Driver) -> Self {
        let command = DeviceCommand::new(place.commands.len());
        let gate = Gate::new(place.commands.len());
        Self {
            number,
            place,
            driver,
            command,
            gate,
            flight: None,
            stamp: Nanos::ZERO,
        }
    }

    /// This end with a ring that keeps its last values.
    #[must_use]
    pub fn with_flight(mut self, flight: FlightWriter) -> Self {
        self.flight = Some(flight);
        self
    }

    /// Its device number.
    #[must_use]
    pub const fn number(&self) -> usize {
        self.number
    }
}

/// Driver of a device.
#[derive(Debug)]
pub enum Driver {
    /// A driver in a thread of its own.
    Cells {
        /// Its state.
        state: LatestReader<DeviceState>,
        /// Its commands.
        command: LatestWriter<DeviceCommand>,
    },
    /// This thread itself: the device is simulated.
    Simulated {
        /// The simulation.
        device: Box<dyn Simulated>,
        /// Its state for programs and other net threads.
        published: LatestWriter<DeviceState>,
    },
    /// Another net thread commands it; nets of this one see it.
    Seen {
        /// Its state.
        state: LatestReader<DeviceState>,
    },
}

/// The devices of one net thread.
#[derive(Debug)]
pub struct Served {
    /// By device number.
    ends: Vec<Option<Box<DeviceEnd>>>,
    /// Time from one cycle of the thread to the next.
    period: Nanos,
    /// Time between handing over commands to the first and to the last device in one cycle.
    hand_over: Recorder,
    stop: StopPart,
}

impl Served {
    /// No devices yet, for a thread of that period.
    #[must_use]
    pub fn new(period: Nanos, hand_over: Recorder) -> Self {
        Self {
            ends: (0..DEVICES_MAX).map(|_| None).collect(),
            period,
            hand_over,
            stop: StopPart::default(),
        }
    }

    /// Sets the thread's part of the controller's emergency stop.
    #[must_use]
    pub fn under(mut self, stop: StopPart) -> Self {
        self.stop = stop;
        self
    }

    /// Before a cycle that begins at `now`: polls whether devices must stop. [`Self::read`] applies it.
    pub fn poll(&mut self, now: Nanos) {
        self.stop.poll(now);
    }

    /// The thread's part of the emergency stop.
    pub const fn stop(&mut self) -> &mut StopPart {
        &mut self.stop
    }

    /// Serves a device from now on.
    pub fn add(&mut self, end: Box<DeviceEnd>, executor: &mut Executor) {
        if let Some(slot) = self.ends.get_mut(end.number) {
            executor.use_place(end.number, &end.place);
            *slot = Some(end);
            // A net may start in this very cycle.
            self.read(executor);
        }
    }

    /// Stops serving a device and returns its endpoint.
    pub fn remove(&mut self, number: usize, executor: &mut Executor) -> Option<Box<DeviceEnd>> {
        let end = self.ends.get_mut(number).and_then(Option::take)?;
        executor.set_device(number, DeviceView::default());
        Some(end)
    }

    /// Copies the last driver states to the image. During a stop, devices that would follow
    /// commands appear as not enabled.
    pub fn read(&mut self, executor: &mut Executor) {
        let stop = &self.stop;
        for end in self.ends.iter_mut().flatten() {
            let (number, place) = (end.number, &end.place);
            let stamp = &mut end.stamp;
            let mut take = |state: &DeviceState| {
                *stamp = state.stamp;
                show(state, number, place, stop, executor);
            };
            match &mut end.driver {
                Driver::Cells { state, .. } | Driver::Seen { state } => state.read_with(take),
                Driver::Simulated { device, .. } => take(device.state()),
            }
        }
    }

    /// Sends commands to all drivers, one right after the other. The cycle began at `begin` on this
    /// host's clock.
    pub fn write(&mut self, executor: &mut Executor, moment: Moment, begin: Nanos) {
        let vote = executor.image.stop.get().at(moment.cycle);
        self.stop.say(vote, begin);
        let at = (moment.cycle, begin);
        let (mut first, mut last) = (None, Nanos::ZERO);
        for end in self.ends.iter_mut().flatten() {
            if matches!(end.driver, Driver::Seen { .. }) {
                continue;
            }
            let commanded = collect(&mut end.command, &end.place, executor, at, self.period);
            let DeviceEnd {
                command,
                place,
                gate,
                ..
            } = &mut **end;
            gate.pass(command, place, &executor.image, self.stop.is_on());
            let given = &end.command;
            match &mut end.driver {
                Driver::Cells { command, .. } => command.write_with(|slot| slot.copy_from(given)),
                Driver::Simulated { device, published } => {
                    device.step(given, self.period);
                    published.write_with(|slot| slot.copy_from(device.state()));
                }
                Driver::Seen { .. } => {}
            }
            if let Some(flight) = &mut end.flight {
                let view = executor.devices.get(end.number).copied();
                let of_device = (&end.place, view.unwrap_or_default(), end.stamp);
                flight.write_device(of_device, &executor.image, moment, begin);
            }
            if commanded {
                last = takt_rt::monotonic();
                first.get_or_insert(last);
            }
        }
        if let Some(first) = first {
            self.hand_over.record(last - first);
        }
    }

    /// Sends withdrawn commands after [`Self::write`] in the same cycle.
    pub fn retract(&mut self, executor: &Executor) {
        for end in self.ends.iter_mut().flatten() {
            if matches!(end.driver, Driver::Seen { .. })
                || !retract(&mut end.command, &end.place, executor)
            {
                continue;
            }
            let DeviceEnd {
                command,
                place,
                gate,
                ..
            } = &mut **end;
            gate.pass(command, place, &executor.image, self.stop.is_on());
            let given = &end.command;
            match &mut end.driver {
                Driver::Cells { command, .. } => command.write_with(|slot| slot.copy_from(given)),
                Driver::Simulated { device, published } => {
                    device.retract(given);
                    published.write_with(|slot| slot.copy_from(device.state()));
                }
                Driver::Seen { .. } => {}
            }
        }
    }
}

/// Removes commands that were withdrawn since [`collect`]; returns whether there were any.
fn retract(command: &mut DeviceCommand, place: &Place, executor: &Executor) -> bool {
    let mut changed = false;
    let joints = &executor.image.joints[place.first_joint..][..place.joints];
    for (joint, set_points) in joints.iter().zip(&mut command.joints) {
        if set_points.active && joint.command.get().every == 0 {
            set_points.advance(None);
            changed = true;
        }
    }
    let cells = &executor.image.commands[place.commands.clone()];
    for (word, cell) in command.words.iter_mut().zip(cells) {
        changed |= *word != cell.get();
        *word = cell.get();
    }
    changed
}

/// Puts a device's state into the image.
fn show(
    state: &DeviceState,
    number: usize,
    place: &Place,
    stop: &StopPart,
    executor: &mut Executor,
) {
    let view = DeviceView {
        status: state.status.under(stop.is_on()),
        // Faults that begin with a stop are counted like any other.
        faults: state.faults + stop.count(),
        jumps: state.jumped.count,
    };
    executor.set_device(number, view);
    state.show(place, &executor.image);
    if stop.is_on() {
        let joints = executor.image.joints.iter().skip(place.first_joint);
        for joint in joints.take(place.joints) {
            let mut shown = joint.state.get();
            if shown.error == JointError::None as i32 {
                shown.error = JointError::NotEnabled as i32;
                joint.state.set(shown);
            }
        }
    }
}

/// Copies the commands for a device from the image; returns whether nets commanded it in this cycle.
fn collect(
    command: &mut DeviceCommand,
    place: &Place,
    executor: &Executor,
    (cycle, time): (u64, Nanos),
    period: Nanos,
) -> bool {
    (command.time, command.cycle) = (time, cycle);
    let mut commanded = false;
    let joints = &executor.image.joints[place.first_joint..][..place.joints];
    for (joint, set_points) in joints.iter().zip(&mut command.joints) {
        let wanted = joint.command.get();
        let given = wanted.cycle == cycle && wanted.every > 0;
        commanded |= given;
        // A set-point of a slower net is valid until that net gives the next, or ends.
        if given || !wanted.is_in_force(cycle) {
            let position = wanted.position;
            set_points.advance(given.then_some(SetPoint { time, position }));
            set_points.period = Nanos(period.0 * wanted.every.max(1).cast_signed());
        }
    }
    let cells = &executor.image.commands[place.commands.clone()];
    for (word, cell) in command.words.iter_mut().zip(cells) {
        commanded |= *word != cell.get();
        *word = cell.get();
    }
    commanded
}
