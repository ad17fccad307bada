//! Flight recorder: rings of the last rows of words, written by the net thread in each cycle without allocation or lock, read by any
//! thread at any time. A ring has one per device and one for the out values of all nets of a thread; what the words mean
//! is up to their readers. A longer ring records longer: nothing else depends on its size. A reader with a cursor takes each row once.

pub(super) mod rows;
mod since;

use std::time::Duration;

use takt_net::ports::NULL;
use takt_net::{Image, Moment, Nanos};
use takt_rt::cycle::Tick;

use super::{DeviceView, Running};
use crate::device::Place;
use crate::executor::machines::MACHINES_MAX;

pub use rows::{FlightReader, FlightWriter, ring};

/// Time that a flight file covers before its trigger.
pub(crate) const BEFORE: Duration = Duration::from_secs(10);
/// Time that a flight file covers after its trigger.
pub(crate) const AFTER: Duration = Duration::from_secs(1);
/// Time that a device's ring covers: that of a flight file, and a second for a disk that is slow to begin.
const SPAN: Duration = Duration::from_secs(11);
/// Upper bound on the words of one ring, 32 MiB; one of more words covers less time.
const WORDS_MAX: usize = 1 << 22;
/// Rows of the ring for out values of the nets of a thread, 8 MiB.
const NET_ROWS: usize = 1 << 17;
/// Words of out values in one row of it; longer out-boxes take several rows.
pub(crate) const NET_WORDS: usize = 6;
/// Words of a device's row before those of its joints: cycle, begin of the cycle, status, number of faults, when its driver
/// measured, and when the thread woke.
pub(crate) const HEAD: usize = 6;
/// Words of a thread's row: cycle, begin of the cycle, latency of the wake-up, execution time, phase error, missed cycles, and the
/// states of its machines.
const THREAD_WORDS: usize = MACHINES_AT + STATES_MAX;
/// States of machines, those inside included, in a thread's row; the outermost ones come first.
pub(crate) const STATES_MAX: usize = 3 * MACHINES_MAX;
/// A phase error that is not known.
pub(crate) const UNKNOWN: u64 = i64::MIN.cast_unsigned();
/// Where the states of machines begin in it, as [`state_word`](crate::executor::machines::state_word) has them.
pub(crate) const MACHINES_AT: usize = 6;
/// Words by joint: set-point, commanded and measured position, measured velocity, error.
pub(crate) const JOINT_WORDS: usize = 5;
/// The word of a device's row that is the begin of its cycle, ns.
pub(crate) const DEVICE_BEGIN: usize = 1;
/// The word of a device's row that is when the thread woke for its cycle, ns: the time of its messages.
pub(crate) const DEVICE_WOKEN: usize = 5;
/// The word of a row of out values that is the begin of its cycle, ns.
pub(crate) const NET_BEGIN: usize = 0;
/// Words of a row of out values before these: begin of the cycle, net and part, and when the thread woke.
pub(crate) const NET_HEAD: usize = 3;
/// The word of a row of out values that is when the thread woke for its cycle, ns.
pub(crate) const NET_WOKEN: usize = 2;
/// The word of a thread's row that is the begin of its cycle, ns.
pub(crate) const THREAD_BEGIN: usize = 1;

/// The ring of a device for the last seconds of a thread with that period.
#[must_use]
pub fn of_device(place: &Place, period: Duration) -> (FlightWriter, FlightReader) {
    let width = HEAD + place.joints * JOINT_WORDS + place.signals.len();
    let rows = SPAN.as_nanos() / period.as_nanos().max(1);
    let rows = usize::try_from(rows).unwrap_or(usize::MAX);
    ring(width, rows.min(WORDS_MAX / width))
}

/// The ring of a thread with that period for its own cycles.
#[must_use]
pub fn of_thread(period: Duration) -> (FlightWriter, FlightReader) {
    let rows = SPAN.as_nanos() / period.as_nanos().max(1);
    let rows = usize::try_from(rows).unwrap_or(usize::MAX).max(16);
    ring(THREAD_WORDS, rows.min(WORDS_MAX / THREAD_WORDS))
}

/// The ring for out values of all nets of a thread.
#[must_use]
pub fn of_nets() -> (FlightWriter, FlightReader) {
    ring(NET_WORDS + NET_HEAD, NET_ROWS)
}

impl FlightWriter {
    /// Writes what nets commanded to a device in this cycle, and what it reported before.
    pub(super) fn write_device(
        &mut self,
        (place, view, stamp): (&Place, DeviceView, takt_rt::Nanos),
        image: &Image,
        moment: Moment,
        begin: takt_rt::Nanos,
    ) {
        let begin = begin.0.cast_unsigned();
        let status = view.status as u64;
        let stamp = stamp.0.cast_unsigned();
        let woken = moment.wall.0.cast_unsigned();
        let head = [moment.cycle, begin, status, view.faults, stamp, woken];
        let joints = image
            .joints
            .iter()
            .skip(place.first_joint)
            .take(place.joints);
        let joints = joints.flat_map(|joint| {
            let (command, state) = (joint.command.get(), joint.state.get());
            let set_point = command
                .is_in_force(moment.cycle)
                .then_some(command.position);
            let bits = |value: Option<f64>| value.map_or(NULL, f64::to_bits);
            [
                bits(set_point),
                bits(state.commanded_position),
                bits(state.measured_position),
                bits(state.measured_velocity),
                f64::from(state.error).to_bits(),
            ]
        });
        let signals = image.signals.iter().skip(place.signals.start);
        let signals = signals.take(place.signals.len()).map(std::cell::Cell::get);
        self.write(head.into_iter().chain(joints).chain(signals));
    }

    /// Writes the timing of a cycle that has ended, and the states of machines, times in ns: after all else of the cycle, so that a
    /// reader that sees this row sees what was written before it.
    pub(super) fn write_thread(
        &mut self,
        tick: &Tick,
        ended: takt_rt::Nanos,
        machines: impl Iterator<Item = u64>,
    ) {
        let words = |time: takt_rt::Nanos| time.0.cast_unsigned();
        let head = [
            tick.index.max(1),
            words(tick.scheduled),
            words(tick.woken - tick.scheduled),
            words(ended - tick.woken),
            tick.phase_error.map_or(UNKNOWN, words),
            tick.missed.into(),
        ];
        self.write(head.into_iter().chain(machines));
    }

    /// Writes the out values of a net, which changed in the cycle that began then and for which the thread woke then.
    pub(super) fn write_net(&mut self, net: &Running, begin: takt_rt::Nanos, woken: Nanos) {
        let mut words = net.plan.outbox_words();
        for part in 0.. {
            let mut row = [0; NET_WORDS];
            let mut given = 0;
            for (slot, word) in row.iter_mut().zip(&mut words) {
                *slot = word;
                given += 1;
            }
            if given == 0 {
                break;
            }
            let source = (u64::from(net.id) << 32) | part;
            let head = [begin.0.cast_unsigned(), source, woken.0.cast_unsigned()];
            self.write(head.into_iter().chain(row));
        }
    }
}

impl FlightReader {
    /// The out-boxes of a net with so many words, as they changed: the begin of the cycle, ns, and the words; oldest first.
    #[must_use]
    pub fn rows_of_net(&self, net: u32, words: usize, since: i64) -> Vec<(i64, Vec<u64>)> {
        let mut found: Vec<(i64, Vec<u64>)> = Vec::new();
        for row in self.rows_since(since, NET_BEGIN) {
            let [begin, source, _, ref values @ ..] = row[..] else {
                continue;
            };
            if source >> 32 != u64::from(net) {
                continue;
            }
            if source & u64::from(u32::MAX) == 0 {
                found.push((begin.cast_signed(), Vec::with_capacity(words)));
            }
            // The first parts of the oldest out-box may be overwritten.
            if let Some((_, whole)) = found.last_mut() {
                let left = words - whole.len().min(words);
                whole.extend(values.iter().take(left));
            }
        }
        found.retain(|(_, whole)| whole.len() == words);
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flight_ring_holds_out_values_by_net() {
        let (mut writer, reader) = of_nets();
        let text = "{a=Core::DoubleValue(Value='2.5'),\
            o=Core::DoubleNetcommOut(inValue=a.outValue,Key='v'),\
            p=Core::DoubleNetcommOut(inValue=a.outValue,Key='w'),\
            q=Core::DoubleNetcommOut(inValue=a.outValue,Key='x'),c=Cancel(),outTerminate=c.outCancel}";
        let mut net = crate::executor::tests::net(7, text);
        net.plan.evaluate(&Image::default(), Moment::default());
        let words = net.plan.outbox().words();
        writer.write_net(&net, takt_rt::Nanos(5), Nanos(6));
        let rows = reader.rows_of_net(7, words, 0);
        assert_eq!(rows.len(), 1);
        assert_eq!((rows[0].0, rows[0].1.len()), (5, words));
        assert!(words > NET_WORDS, "it takes several rows");
        let entry = net.plan.outbox().find("outx").unwrap();
        assert_eq!(entry.value(&rows[0].1), [2.5_f64.to_bits()]);
        assert!(reader.rows_of_net(8, words, 0).is_empty());
        assert!(reader.rows_of_net(7, words, 6).is_empty(), "too early");
    }
}
