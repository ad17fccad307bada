//! Datagram handling of a FRI arm's thread: which peer is accepted, what is answered, and what is published to nets.
//! It moves no bytes and creates no thread, so that tests run it in virtual time; it never reads this host's clock.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use takt_fri::diagnosis::Measurement;
use takt_fri::guard::Violation;
use takt_net::JointLimits;
use takt_rt::Nanos;
use takt_rt::latest::LatestWriter;
use takt_rt::servo::Estimate;
use takt_rt::stats::Recorder;

use super::clock::DatagramClock;
use super::events::{Event, EventSender};
use super::figures::Notes;
use super::force::ForceByTorques;
use super::{AXES, Joints, Orders, Protocol, Shared};
use takt_core::device::driver::DeviceEnd;
use takt_core::device::endpoint::Endpoint;
use takt_core::device::setpoint::Joint;
use takt_core::device::{DeviceDescription, DeviceStatus};

/// A joint faster than this moves, rad/s.
const MOVES_FROM: f64 = 1e-3;

/// Life of the thread.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Life {
    /// Nets command the arm.
    Running,
    /// The joints brake: no command is followed.
    Stopping,
    /// They brake, and an answer was sent since: nothing is added.
    LetGo,
}

/// Measurements published last, for differences.
#[derive(Default)]
struct Published {
    positions: Option<[f64; AXES]>,
    velocities: Option<[f64; AXES]>,
}

/// The arm and its state.
pub(super) struct Driver<P> {
    pub(super) session: P,
    /// The peer, while the session lasts.
    peer: Option<SocketAddr>,
    /// The newest measurement and its quality, until it is evaluated.
    received: Option<(Measurement, i32)>,
    clock: DatagramClock,
    pub(super) joints: Vec<Joint>,
    /// Limits of the arm, for braking, independent of those of its joints.
    limits: Vec<JointLimits>,
    /// Joint positions of the last answers, rad, and velocities, rad/s.
    sent: [Joints; 2],
    /// The guard violation of the last answer.
    withheld: Option<Violation>,
    last: Published,
    end: Endpoint,
    force: ForceByTorques,
    /// The robot's cycles since the last answer. The robot's speed check counts in these, so the joints' limits do
    /// too, independent of its clock.
    cycles: i64,
    notes: Notes,
    /// Whether the robot followed at the last answer, and has done so since.
    was_commanding: bool,
    /// Whether the robot restarted while its published state was operational; nets that command it must see this.
    has_fallen: bool,
    life: Life,
    shared: Arc<Shared>,
    event_sender: EventSender,
    pub(super) answer_time: Recorder,
    pub(super) set_point_age: Recorder,
    pub(super) phase_error: Recorder,
    clock_out: LatestWriter<Estimate>,
}

impl<P: Protocol> Driver<P> {
    pub(super) fn new(
        session: P,
        description: &DeviceDescription,
        event_sender: EventSender,
        (end, clock_out, shared): (DeviceEnd, LatestWriter<Estimate>, Arc<Shared>),
    ) -> Self {
        Self {
            session,
            peer: None,
            received: None,
            clock: DatagramClock::default(),
            joints: description.limits.iter().copied().map(Joint::new).collect(),
            limits: description.limits.clone(),
            sent: [[0.0; AXES]; 2],
            withheld: None,
            last: Published::default(),
            end: Endpoint::new(end, &description.parts, AXES),
            force: ForceByTorques::new(&description.model),
            cycles: 0,
            notes: Notes::default(),
            was_commanding: false,
            has_fallen: false,
            life: Life::Running,
            shared,
            event_sender,
            answer_time: Recorder::new(),
            set_point_age: Recorder::new(),
            phase_error: Recorder::new(),
            clock_out,
        }
    }

    fn is_commanding(&self) -> bool {
        self.session.status() == DeviceStatus::Operational
    }

    /// Starts braking, whatever nets command.
    pub(super) const fn begin_stop(&mut self) {
        self.life = Life::Stopping;
    }

    /// Whether nothing moves by command, and the robot was sent that nothing is added.
    pub(super) fn is_at_rest(&self) -> bool {
        let is_resting = |joint: &Joint| joint.motion().1.abs() < f64::EPSILON;
        !self.is_commanding() || (self.life == Life::LetGo && self.joints.iter().all(is_resting))
    }

    /// The peer that answers go to.
    pub(super) const fn peer(&self) -> Option<SocketAddr> {
        self.peer
    }

    /// The clock endpoint.
    pub(super) fn into_clock(self) -> LatestWriter<Estimate> {
        self.clock_out
    }

    /// Notes how long after its arrival this thread had a datagram.
    pub(super) fn note_wake_up(&mut self, delay: Nanos) {
        self.event_sender
            .note_wake_up(Duration::try_from(delay).unwrap_or_default());
    }

    /// Whether it is so late that another datagram may be waiting.
    pub(super) fn is_late(&self, now: Nanos) -> bool {
        self.clock.is_late(now)
    }

    /// Handles the time `now` without a new datagram.
    pub(super) fn handle_silence(&mut self, now: Duration) {
        self.clock.handle_time(now.into());
        self.publish_clock();
        let is_lost = self.session.handle_silence(now);
        self.take_orders(now);
        self.note_received();
        if is_lost {
            self.was_commanding = false;
            self.event_sender.send(Event::Lost, now);
            self.event_sender.restart();
            self.event_sender.publish();
            self.publish(now.into());
        } else {
            self.write_state();
        }
    }

    /// Handles a datagram from `from` that arrived `at`; returns whether it is a new measurement. Two controllers
    /// that send here would drive one arm by the other's measurements: the second is ignored until the first is lost.
    pub(super) fn accept(&mut self, from: SocketAddr, datagram: &[u8], at: Duration) -> bool {
        let lasts = self.session.status() != DeviceStatus::Offline;
        if lasts && self.peer.is_some_and(|peer| peer != from) {
            self.event_sender.note_foreign();
            self.event_sender.send(Event::Foreign(from), at);
            return false;
        }
        let received = match self.session.receive(datagram, at) {
            Ok(received) => received,
            Err(error) => {
                // The session counts it; a foreign datagram is no reason to stop.
                self.event_sender.note_decode_error(error);
                self.event_sender.send(Event::Refused(error), at);
                self.count();
                return false;
            }
        };
        self.note_received();
        if received.is_first {
            self.event_sender.restart();
        }
        let quality = self.session.quality_code();
        let measurement = self.session.measurement(at);
        self.received = measurement.map(|measurement| (measurement, quality));
        if !received.is_new {
            return false;
        }
        self.peer = Some(from);
        if received.is_first {
            self.has_fallen |= self.end.reported.status == DeviceStatus::Operational;
            self.cycles = 0;
        }
        self.was_commanding &= !received.is_first && self.is_commanding();
        let period = self.session.cycle().unwrap_or(Duration::from_millis(1));
        self.clock.tick(at.into(), period.into(), received.lost);
        let phase_error = Nanos::from(at) - self.clock.now();
        self.phase_error.record(phase_error.abs());
        self.notes.phase_error = Some(phase_error);
        self.cycles += 1 + i64::from(received.lost);
        true
    }

    /// Writes the answer to the newest measurement, which arrived `at`, if it requests one.
    pub(super) fn answer(&mut self, at: Nanos, buffer: &mut [u8]) -> Option<usize> {
        if !self.session.is_due() {
            return None;
        }
        self.take_orders(Duration::from_nanos(at.0.unsigned_abs()));
        let (wanted, dt_s) = self.next_positions();
        let mut positions = wanted;
        let [sent, speeds] = self.sent;
        // All joints brake from the positions sent last, and their set-points are refused until they end.
        let mut brake = || {
            let joints = self.joints.iter_mut().zip(&self.limits).enumerate();
            for (axis, (joint, limits)) in joints.take(AXES) {
                *joint = joint.refused(*limits, sent[axis], speeds[axis]);
                let set_points = &self.end.taken.joints[axis];
                positions[axis] = joint.sample(set_points, true, Nanos(0), dt_s);
            }
            positions
        };
        let answer = self.session.reply(&wanted, &mut brake, buffer)?;
        self.withheld = answer.refused;
        if self.life == Life::Stopping {
            self.life = Life::LetGo;
        }
        if self.is_commanding() {
            if answer.is_held {
                // Otherwise the joints would run away from where the robot is held.
                let held = self.session.rest();
                self.rest(&held);
            } else {
                let speeds = std::array::from_fn(|axis| (positions[axis] - sent[axis]) / dt_s);
                self.sent = [positions, speeds];
            }
        }
        Some(answer.len)
    }

    fn rest(&mut self, positions: &Joints) {
        self.sent = [*positions, [0.0; AXES]];
        let joints = self.joints.iter_mut().zip(positions);
        for ((joint, position), set_points) in joints.zip(&self.end.taken.joints) {
            joint.rest_at(*position, set_points);
        }
    }

    /// Notes that the answer to the measurement of `at` left at `now`.
    pub(super) fn handle_sent(&mut self, at: Nanos, now: Nanos) {
        self.answer_time.record(now - at);
        self.notes.answer_time = Some(now - at);
        self.note_received();
        let sequence = self.session.sent_sequence();
        self.event_sender.note_answer(now, sequence);
        let mut joints = self.joints.iter().zip(&self.end.taken.joints);
        let moving = joints.find(|(_, set_points)| set_points.active);
        if let Some((joint, set_points)) = moving.filter(|_| self.is_commanding()) {
            let played = self.clock.now() - joint.delay(set_points);
            self.set_point_age.record(now - played);
        }
    }

    /// Evaluates the newest measurement; its answer does not wait for this.
    fn note_received(&mut self) {
        if let Some((measurement, quality)) = self.received.take() {
            self.event_sender.note_measurement(measurement, quality);
        }
    }

    /// Publishes the measurement that arrived `at`, after its answer.
    pub(super) fn finish(&mut self, at: Nanos) {
        self.note_received();
        self.publish_clock();
        let braked = self.withheld.take();
        let violation = braked.or_else(|| self.session.violation());
        // Braking is reported even if something else is withheld in every cycle.
        if (self.event_sender.note_violation(violation) || braked.is_some())
            && let Some(violation) = violation
        {
            let at = Duration::from_nanos(at.0.unsigned_abs());
            self.event_sender.send(Event::Withheld(violation), at);
        }
        self.report_output(at);
        self.publish(at);
        self.count();
    }

    /// Reports an output that cannot be written, once.
    fn report_output(&mut self, at: Nanos) {
        let Some(output) = self.session.refused_output() else {
            return;
        };
        let at = Duration::from_nanos(at.0.unsigned_abs());
        self.event_sender.note_refused_output(output);
        // Another one was reported a moment ago: this one follows.
        if self.event_sender.send(Event::Output(output), at) {
            self.session.confirm_refused_output();
        }
    }

    /// Reads the commands of nets.
    fn take_orders(&mut self, now: Duration) {
        self.end.take();
        let moves = |joint: &Joint| joint.motion().1.abs() > MOVES_FROM;
        let orders = Orders {
            words: &self.end.taken.words,
            cycle: self.end.taken.cycle,
            is_fresh: self.is_fresh(),
            follows: self.is_commanding() && self.was_commanding,
            moves: self.joints.iter().any(moves),
            now,
        };
        self.session.apply(&self.end.interfaces, &orders);
    }

    /// Whether the net thread is alive and followed.
    fn is_fresh(&self) -> bool {
        let cycle = self.clock.period();
        self.life == Life::Running && self.end.is_fresh(self.clock.now(), cycle)
    }

    /// The current joint positions, and the time since the last ones, s. In the first cycle in which the robot follows, they
    /// are those of the robot: motion that a net commanded before does not continue.
    fn next_positions(&mut self) -> (Joints, f64) {
        let is_commanding = self.is_commanding();
        let enters = is_commanding && !self.was_commanding;
        self.was_commanding = is_commanding;
        let mut positions = self.session.rest();
        if enters || !is_commanding {
            self.rest(&positions);
        }
        if !is_commanding {
            self.cycles = 0;
            return (positions, 0.0);
        }
        let (period, fresh) = (self.clock.period(), self.is_fresh());
        let dt_s = Nanos(std::mem::take(&mut self.cycles) * period.0).as_secs_f64();
        for ((joint, position), set_points) in self
            .joints
            .iter_mut()
            .zip(&mut positions)
            .zip(&self.end.taken.joints)
        {
            let play = self.clock.now() - joint.delay(set_points);
            *position = joint.sample(set_points, fresh, play, dt_s);
        }
        (positions, dt_s)
    }

    /// Publishes the state of the arm to nets.
    fn publish(&mut self, at: Nanos) {
        let status = self.session.status();
        let state = &mut self.end.reported;
        if std::mem::take(&mut self.has_fallen) {
            state.enter(DeviceStatus::Offline, at);
        }
        state.enter(status, at);
        let measured = self.session.measured();
        let velocities = rates(measured, self.last.positions, self.clock.elapsed());
        let accelerations = rates(velocities, self.last.velocities, self.clock.elapsed());
        (self.last.positions, self.last.velocities) = (measured, velocities);
        let measured = [measured, velocities, accelerations];
        self.end.report_joints(
            self.joints
                .iter()
                .enumerate()
                .map(|(axis, joint)| (joint, measured.map(|values| values.map(|it| it[axis])))),
        );
        self.report_torques();
        self.write_state();
    }

    /// Writes the state, with the answers to orders.
    fn write_state(&mut self) {
        let signals = &mut self.end.reported.signals;
        self.session.report(&self.end.interfaces, signals);
        let is_silent = self.session.status() == DeviceStatus::Offline;
        let events = self.event_sender.sent();
        let values = self.notes.values(&self.session, is_silent, events);
        self.end.report_figures(0, values);
        self.end.publish();
    }

    /// Reports torques and forces; null while the robot is silent.
    fn report_torques(&mut self) {
        let silent = self.end.reported.status == DeviceStatus::Offline;
        let received = Some(&self.session).filter(|_| !silent);
        let estimated = received.and_then(P::external_torques);
        let measured = received.and_then(P::measured_torques);
        let signals = &mut self.end.reported.signals;
        let places = self.end.interfaces.torques.iter().flat_map(|t| t.iter());
        for (axis, place) in places.enumerate() {
            let of_axis = |values: Joints| values.get(axis).copied();
            place.estimated.report(signals, estimated.and_then(of_axis));
            place.measured.report(signals, measured.and_then(of_axis));
        }
        if let Some(place) = &self.end.interfaces.wrench {
            let felt = || received.and_then(P::measured).zip(estimated);
            let wrench = received.and_then(P::wrench).or_else(|| {
                felt().and_then(|(joints, torques)| self.force.estimate(&joints, &torques))
            });
            place.report(signals, wrench);
        }
    }

    fn publish_clock(&mut self) {
        let clock = self.clock.estimate();
        self.clock_out.write(clock);
        let ppb = if clock.state.is_followed() {
            clock.frequency_ppb
        } else {
            f64::NAN
        };
        let bits = &self.shared.clock_ppb_bits;
        bits.store(ppb.to_bits(), Ordering::Relaxed);
    }

    fn count(&mut self) {
        self.event_sender.publish();
        let totals = self.session.totals();
        let shared = &self.shared;
        shared.received.store(totals.received, Ordering::Relaxed);
        shared.lost.store(totals.lost, Ordering::Relaxed);
        shared.malformed.store(totals.malformed, Ordering::Relaxed);
        let quality = self.session.quality_code();
        shared.quality.store(quality, Ordering::Relaxed);
        let period_ns = self.clock.period().0.unsigned_abs();
        shared.period_ns.store(period_ns, Ordering::Relaxed);
        let pair = self.session.set_point().zip(self.session.measured());
        if let Some((wanted, measured)) = pair.filter(|_| self.is_commanding()) {
            let distances = wanted.into_iter().zip(measured);
            let error = distances.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            let bits = &shared.tracking_error_bits;
            let worst = f64::from_bits(bits.load(Ordering::Relaxed)).max(error);
            bits.store(worst.to_bits(), Ordering::Relaxed);
        }
    }
}

/// Rate of change of each value; `None` without an earlier value or elapsed time.
fn rates(
    now: Option<[f64; AXES]>,
    before: Option<[f64; AXES]>,
    span: Nanos,
) -> Option<[f64; AXES]> {
    let (now, before) = now.zip(before).filter(|_| span.0 > 0)?;
    let span_s = span.as_secs_f64();
    Some(std::array::from_fn(|i| (now[i] - before[i]) / span_s))
}
