//! What the thread of a FRI arm does with datagrams: who is heard, what is answered, and what nets are told. It moves
//! no bytes and makes no thread, so that tests run it in virtual time; the clock of this host it reads not at all.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use takt_fri::diagnosis::Measurement;
use takt_fri::guard::Violation;
use takt_net::device::{Interfaces, JointError, Layout};
use takt_net::{JointLimits, JointState};
use takt_rt::Nanos;
use takt_rt::latest::{LatestReader, LatestWriter};
use takt_rt::servo::Estimate;
use takt_rt::stats::Recorder;

use super::clock::DatagramClock;
use super::force::ForceByTorques;
use super::news::{Herald, News};
use super::{AXES, Joints, Orders, Protocol, Shared};
use crate::device::continuity::Continuity;
use crate::device::driver::DeviceEnd;
use crate::device::setpoint::Joint;
use crate::device::{DeviceCommand, DeviceDescription, DeviceState, DeviceStatus, parts};

/// Set-points older than this many cycles of the driver are no longer followed.
const STALE_AFTER: i64 = 10;
/// Faster than this a joint moves, rad/s.
const MOVES_FROM: f64 = 1e-3;

/// What was last told to nets, for differences.
#[derive(Default)]
struct Published {
    state: DeviceState,
    continuity: Continuity,
    positions: Option<[f64; AXES]>,
    velocities: Option<[f64; AXES]>,
}

/// The arm and all that is known of it.
pub(super) struct Driver<P> {
    pub(super) session: P,
    /// Whose measurements count, while the session lasts.
    peer: Option<SocketAddr>,
    /// The newest measurement and its quality, until it is judged.
    heard: Option<(Measurement, i32)>,
    clock: DatagramClock,
    pub(super) joints: Vec<Joint>,
    /// Limits of the arm, by which it brakes whatever its joints went by.
    limits: Vec<JointLimits>,
    /// Where the joints are by the last answers, rad, and how fast, rad/s.
    sent: [Joints; 2],
    /// What a guard refused in the last answer.
    withheld: Option<Violation>,
    last: Published,
    /// The newest command.
    taken: DeviceCommand,
    interfaces: Interfaces,
    force: ForceByTorques,
    /// Time from one cycle of the net thread to the next.
    net_period: Nanos,
    /// The robot's cycles since the last answer. Its speed check counts in these, so the joints'
    /// limits do too, whatever its clock does.
    cycles: i64,
    /// Whether the last answer was given while the robot followed, and nothing has come between since.
    was_commanding: bool,
    /// Whether the robot began anew although it was last told to follow: those who command it learn that.
    has_fallen: bool,
    /// Whether the thread is to end: nothing is followed any more.
    is_stopping: bool,
    /// Whether an answer left since then: nothing is added any more.
    has_let_go: bool,
    state: LatestWriter<DeviceState>,
    command: LatestReader<DeviceCommand>,
    shared: Arc<Shared>,
    herald: Herald,
    pub(super) answer_time: Recorder,
    pub(super) set_point_age: Recorder,
    pub(super) phase_error: Recorder,
    clock_out: LatestWriter<Estimate>,
}

impl<P: Protocol> Driver<P> {
    pub(super) fn new(
        session: P,
        description: &DeviceDescription,
        herald: Herald,
        (end, clock_out, shared): (DeviceEnd, LatestWriter<Estimate>, Arc<Shared>),
    ) -> Self {
        let mut layout = Layout::default();
        let interfaces = parts::lay(&description.parts, AXES, &mut layout);
        Self {
            session,
            peer: None,
            heard: None,
            clock: DatagramClock::default(),
            joints: description.limits.iter().copied().map(Joint::new).collect(),
            limits: description.limits.clone(),
            sent: [[0.0; AXES]; 2],
            withheld: None,
            last: Published {
                state: DeviceState::new(layout.signals),
                ..Published::default()
            },
            taken: DeviceCommand::new(layout.commands),
            interfaces,
            force: ForceByTorques::new(&description.model),
            net_period: end.net_period.into(),
            cycles: 0,
            was_commanding: false,
            has_fallen: false,
            is_stopping: false,
            has_let_go: false,
            state: end.state,
            command: end.command,
            shared,
            herald,
            answer_time: Recorder::new(),
            set_point_age: Recorder::new(),
            phase_error: Recorder::new(),
            clock_out,
        }
    }

    fn is_commanding(&self) -> bool {
        self.session.status() == DeviceStatus::Operational
    }

    /// From now on it brakes, whatever nets want.
    pub(super) const fn begin_stop(&mut self) {
        self.is_stopping = true;
    }

    /// Whether nothing that it commands moves, and the robot was told that nothing is added.
    pub(super) fn is_at_rest(&self) -> bool {
        let is_resting = |joint: &Joint| joint.motion().1.abs() < f64::EPSILON;
        !self.is_commanding() || (self.has_let_go && self.joints.iter().all(is_resting))
    }

    /// To whom answers go.
    pub(super) const fn peer(&self) -> Option<SocketAddr> {
        self.peer
    }

    /// Where it told its clock.
    pub(super) fn into_clock(self) -> LatestWriter<Estimate> {
        self.clock_out
    }

    /// Whether an arrival at `at` is so late that another datagram may be waiting.
    pub(super) fn is_late(&self, at: Nanos) -> bool {
        self.clock.is_late(at)
    }

    /// It is `now`, and nothing came that is new.
    pub(super) fn handle_silence(&mut self, now: Duration) {
        self.clock.handle_time(now.into());
        self.publish_clock();
        let is_gone = self.session.hear_nothing(now);
        self.take_orders(now);
        self.note_heard();
        if is_gone {
            self.was_commanding = false;
            self.herald.tell(News::Gone, now);
            self.herald.begin_anew();
            self.herald.publish();
            self.publish(now.into());
        } else {
            self.tell();
        }
    }

    /// Takes a datagram that came from there `at`; whether it is a new measurement. Two controllers that send here
    /// would drive one arm by the other's measurements: whoever comes second is not heard before the first is gone.
    pub(super) fn accept(&mut self, from: SocketAddr, datagram: &[u8], at: Duration) -> bool {
        let lasts = self.session.status() != DeviceStatus::Offline;
        if lasts && self.peer.is_some_and(|peer| peer != from) {
            self.herald.note_foreign();
            self.herald.tell(News::Foreign(from), at);
            return false;
        }
        let heard = match self.session.hear(datagram, at) {
            Ok(heard) => heard,
            Err(error) => {
                // Counted by the session; a stranger's datagram is no reason to stop.
                self.herald.note_refusal(error);
                self.herald.tell(News::Refused(error), at);
                self.count();
                return false;
            }
        };
        self.note_heard();
        if heard.is_first {
            self.herald.begin_anew();
        }
        let quality = self.session.quality_code();
        let measurement = self.session.measurement(at);
        self.heard = measurement.map(|measurement| (measurement, quality));
        if !heard.is_new {
            return false;
        }
        self.peer = Some(from);
        if heard.is_first {
            self.has_fallen |= self.last.state.status == DeviceStatus::Operational;
            self.cycles = 0;
        }
        self.was_commanding &= !heard.is_first && self.is_commanding();
        let period = self.session.cycle().unwrap_or(Duration::from_millis(1));
        self.clock.tick(at.into(), period.into(), heard.lost);
        self.phase_error
            .record((Nanos::from(at) - self.clock.now()).abs());
        self.cycles += 1 + i64::from(heard.lost);
        true
    }

    /// Writes the answer to the newest measurement, which came `at`, if it wants one.
    pub(super) fn answer(&mut self, at: Nanos, buffer: &mut [u8]) -> Option<usize> {
        if !self.session.is_due() {
            return None;
        }
        self.take_orders(Duration::from_nanos(at.0.unsigned_abs()));
        let joints = self.next_positions();
        let len = self.session.reply(&joints, buffer)?;
        self.has_let_go = self.is_stopping;
        if self.is_commanding() {
            self.take_back(&joints);
        }
        Some(len)
    }

    /// What may be sent of these positions, `dt_s` after the last ones. If a guard refuses them, all joints brake from what
    /// was sent last, whatever brought them there, and whoever asked for them is refused until it ends.
    fn admit(&mut self, wanted: Joints, dt_s: f64) -> Joints {
        self.withheld = self.session.check(&wanted).err();
        let mut positions = wanted;
        let [sent, speeds] = self.sent;
        if self.withheld.is_some() {
            for (axis, joint) in self.joints.iter_mut().enumerate().take(AXES) {
                *joint = joint.refused(self.limits[axis], sent[axis], speeds[axis]);
                let set_points = &self.taken.joints[axis];
                positions[axis] = joint.sample(set_points, true, Nanos(0), dt_s);
            }
        }
        let speeds = std::array::from_fn(|axis| (positions[axis] - sent[axis]) / dt_s);
        self.sent = [positions, speeds];
        positions
    }

    /// The session's own guard holds what it refuses, at once. Whoever asked for it is refused until it ends: else the joint
    /// would run away from where the robot is held.
    fn take_back(&mut self, wanted: &Joints) {
        let sent = self.session.rest();
        if sent.map(f64::to_bits) != wanted.map(f64::to_bits) {
            self.rest(&sent);
        }
    }

    fn rest(&mut self, positions: &Joints) {
        self.sent = [*positions, [0.0; AXES]];
        let joints = self.joints.iter_mut().zip(positions);
        for ((joint, position), set_points) in joints.zip(&self.taken.joints) {
            joint.rest_at(*position, set_points);
        }
    }

    /// The answer to the measurement that came `at` left at `now`.
    pub(super) fn handle_sent(&mut self, at: Nanos, now: Nanos) {
        self.answer_time.record(now - at);
        self.note_heard();
        let sequence = self.session.sent_sequence();
        self.herald.note_answer(now, sequence);
        let mut joints = self.joints.iter().zip(&self.taken.joints);
        let moving = joints.find(|(_, set_points)| set_points.active);
        if let Some((joint, set_points)) = moving.filter(|_| self.is_commanding()) {
            let played = self.clock.now() - joint.delay(set_points);
            self.set_point_age.record(now - played);
        }
    }

    /// Has the newest measurement judged: nothing that its answer waits for.
    fn note_heard(&mut self) {
        if let Some((measurement, quality)) = self.heard.take() {
            self.herald.note_measurement(measurement, quality);
        }
    }

    /// Tells what the measurement that came `at` says, after its answer.
    pub(super) fn finish(&mut self, at: Nanos) {
        self.note_heard();
        self.publish_clock();
        let braked = self.withheld.take();
        let violation = braked.or_else(|| self.session.violation());
        // That the arm brakes is told also while something else is withheld in every cycle.
        if (self.herald.note_violation(violation) || braked.is_some())
            && let Some(violation) = violation
        {
            let at = Duration::from_nanos(at.0.unsigned_abs());
            self.herald.tell(News::Withheld(violation), at);
        }
        self.publish(at);
        self.count();
    }

    /// Takes what nets command now.
    fn take_orders(&mut self, now: Duration) {
        let taken = &mut self.taken;
        self.command.read_with(|command| taken.copy_from(command));
        let moves = |joint: &Joint| joint.motion().1.abs() > MOVES_FROM;
        let orders = Orders {
            words: &self.taken.words,
            cycle: self.taken.cycle,
            is_fresh: self.is_fresh(),
            follows: self.is_commanding() && self.was_commanding,
            moves: self.joints.iter().any(moves),
            now,
        };
        self.session.obey(&self.interfaces, &orders);
    }

    /// Whether the net thread is alive and to be followed.
    fn is_fresh(&self) -> bool {
        let stale = Nanos(self.clock.period().0 * STALE_AFTER) + self.net_period;
        !self.is_stopping && self.clock.now() - self.taken.time <= stale
    }

    /// Where the joints are to be now. In the first cycle in which the robot follows, they are where it is: what a net
    /// wanted before does not go on.
    fn next_positions(&mut self) -> Joints {
        let is_commanding = self.is_commanding();
        let enters = is_commanding && !self.was_commanding;
        self.was_commanding = is_commanding;
        let mut positions = self.session.rest();
        if enters || !is_commanding {
            self.rest(&positions);
        }
        if !is_commanding {
            self.cycles = 0;
            return positions;
        }
        let (period, fresh) = (self.clock.period(), self.is_fresh());
        #[expect(
            clippy::cast_precision_loss,
            reason = "spans of milliseconds are exact"
        )]
        let dt_s = (std::mem::take(&mut self.cycles) * period.0) as f64 * 1e-9;
        for ((joint, position), set_points) in self
            .joints
            .iter_mut()
            .zip(&mut positions)
            .zip(&self.taken.joints)
        {
            let play = self.clock.now() - joint.delay(set_points);
            *position = joint.sample(set_points, fresh, play, dt_s);
        }
        self.admit(positions, dt_s)
    }

    /// Tells nets how the arm is.
    fn publish(&mut self, at: Nanos) {
        let status = self.session.status();
        let state = &mut self.last.state;
        if std::mem::take(&mut self.has_fallen) {
            state.enter(DeviceStatus::Offline, at);
        }
        state.enter(status, at);
        let measured = self.session.measured();
        let velocities = rates(measured, self.last.positions, self.clock.elapsed());
        let accelerations = rates(velocities, self.last.velocities, self.clock.elapsed());
        (self.last.positions, self.last.velocities) = (measured, velocities);
        for (i, told) in state.joints.iter_mut().enumerate().take(AXES) {
            let (position, velocity, acceleration) = self.joints[i].motion();
            state.limited[i] = *self.joints[i].limited();
            let error = match status {
                DeviceStatus::Offline => JointError::Offline,
                DeviceStatus::SafeOperational => JointError::NotEnabled,
                DeviceStatus::Operational => self.joints[i].error(),
            };
            *told = JointState {
                commanded_position: Some(position),
                commanded_velocity: Some(velocity),
                commanded_acceleration: Some(acceleration),
                measured_position: measured.map(|m| m[i]),
                measured_velocity: velocities.map(|v| v[i]),
                measured_acceleration: accelerations.map(|a| a[i]),
                error: error as i32,
            };
        }
        let limits = &self.limits;
        let Published {
            state, continuity, ..
        } = &mut self.last;
        continuity.check(state, |number| Some(limits.get(number)?.velocity_max));
        self.tell_torques();
        self.tell();
    }

    /// Hands over what is known, with what became of orders.
    fn tell(&mut self) {
        let signals = &mut self.last.state.signals;
        self.session.report(&self.interfaces, signals);
        let told = &self.last.state;
        self.state.write_with(|state| state.copy_from(told));
    }

    /// Tells what the robot's sensors say of torques and forces; nothing while it is silent.
    fn tell_torques(&mut self) {
        let silent = self.last.state.status == DeviceStatus::Offline;
        let heard = Some(&self.session).filter(|_| !silent);
        let estimated = heard.and_then(P::external_torques);
        let measured = heard.and_then(P::measured_torques);
        let signals = &mut self.last.state.signals;
        let places = self.interfaces.torques.iter().flat_map(|t| t.iter());
        for (axis, place) in places.enumerate() {
            let of_axis = |values: Joints| values.get(axis).copied();
            place.estimated.report(signals, estimated.and_then(of_axis));
            place.measured.report(signals, measured.and_then(of_axis));
        }
        if let Some(place) = &self.interfaces.wrench {
            let felt = || heard.and_then(P::measured).zip(estimated);
            let wrench = heard.and_then(P::wrench).or_else(|| {
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
        self.herald.publish();
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

/// Change of each value per second; `None` while there is no earlier value or no time has passed.
fn rates(
    now: Option<[f64; AXES]>,
    before: Option<[f64; AXES]>,
    span: Nanos,
) -> Option<[f64; AXES]> {
    let (now, before) = now.zip(before).filter(|_| span.0 > 0)?;
    #[expect(
        clippy::cast_precision_loss,
        reason = "spans of milliseconds are exact"
    )]
    let span_s = span.0 as f64 * 1e-9;
    Some(std::array::from_fn(|i| (now[i] - before[i]) / span_s))
}
