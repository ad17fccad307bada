//! Bits that pass on a bus each second, counted by the thread that sends and receives the frames and read by others. It reads
//! no clock and does not allocate after its creation. Statistics of single identifiers are in [`crate::stat`].

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use crate::AnyFrame;
use crate::bits::Bits;
use crate::link::Link;
use crate::linux::bit_rate;

/// Time over which bits are counted; longer if [`LoadMeter::poll`] is called late.
pub const WINDOW: Duration = Duration::from_secs(1);

/// Marks that no window has ended yet.
const NONE: u32 = u32::MAX;

#[derive(Debug)]
struct Shared {
    last: AtomicU32,
    most: AtomicU32,
}

/// Counts the bits of frames.
#[derive(Debug)]
pub struct LoadMeter {
    begin: Option<Duration>,
    bits: u64,
    shared: Arc<Shared>,
}

/// What a meter counted.
#[derive(Clone, Debug)]
pub struct LoadReader {
    shared: Arc<Shared>,
    bus: String,
    is_interface: bool,
    bit_rate: Option<u32>,
}

/// Bits of frames on a bus. Stuff bits are exact; retransmissions and error frames are not seen. Bits of CAN FD frames at the
/// data bit rate count as nominal ones, which overestimates their load.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Load {
    /// In the last window, bit/s.
    pub last: u32,
    /// In the fullest window, bit/s.
    pub most: u32,
}

impl LoadMeter {
    /// A meter of the bus of a link, and its reader; a link without an interface has that name.
    #[must_use]
    pub fn new(link: &dyn Link, name: &str) -> (Self, LoadReader) {
        let shared = Arc::new(Shared {
            last: AtomicU32::new(NONE),
            most: AtomicU32::new(0),
        });
        let reader = LoadReader {
            shared: Arc::clone(&shared),
            bus: link.interface().unwrap_or(name).to_owned(),
            is_interface: link.interface().is_some(),
            bit_rate: link.bit_rate(),
        };
        let meter = Self {
            begin: None,
            bits: 0,
            shared,
        };
        (meter, reader)
    }

    /// Counts a frame that was sent or received.
    pub fn add(&mut self, frame: &AnyFrame) {
        let bits = Bits::of(frame);
        self.bits += u64::from(bits.nominal) + u64::from(bits.data);
    }

    /// Ends the window if its time is over. `now` never decreases.
    pub fn poll(&mut self, now: Duration) {
        let begin = *self.begin.get_or_insert(now);
        let passed = now.saturating_sub(begin);
        if passed < WINDOW {
            return;
        }
        let ms = passed.as_millis().max(1);
        let rate = u128::from(self.bits) * 1000 / ms;
        let rate = u32::try_from(rate).unwrap_or(NONE - 1).min(NONE - 1);
        self.shared.last.store(rate, Ordering::Relaxed);
        self.shared.most.fetch_max(rate, Ordering::Relaxed);
        (self.begin, self.bits) = (Some(now), 0);
    }
}

impl LoadReader {
    /// The bits of the last window; `None` before the first has ended.
    #[must_use]
    pub fn read(&self) -> Option<Load> {
        let last = self.shared.last.load(Ordering::Relaxed);
        (last != NONE).then(|| Load {
            last,
            // Written later than `last`.
            most: self.shared.most.load(Ordering::Relaxed).max(last),
        })
    }

    /// The interface of the bus, or the name of a link without one.
    #[must_use]
    pub fn bus(&self) -> &str {
        &self.bus
    }

    /// The nominal bit rate, bit/s; `None` if it is not known, as of a virtual interface. It is that of now: the system may
    /// set another one while the link is open.
    #[must_use]
    pub fn bit_rate(&self) -> Option<u32> {
        let asked = || self.is_interface.then(|| bit_rate(&self.bus)).flatten();
        self.bit_rate.or_else(asked)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bus::{Bus, Config, Shared};
    use crate::{Frame, Id};

    const MS: Duration = Duration::from_millis(1);

    fn frame(id: u16, data: &[u8]) -> AnyFrame {
        Frame::new(Id::standard(id).unwrap(), data).unwrap().into()
    }

    fn meter() -> (LoadMeter, LoadReader) {
        LoadMeter::new(&Shared::new(Bus::new(Config::default())).attach(), "bus")
    }

    #[test]
    fn load_of_bus_equals_its_busy_time() {
        let (mut meter, reader) = meter();
        let mut bus = Bus::new(Config::default());
        let (near, far) = (bus.attach(), bus.attach());
        for ms in 0..=1000_u32 {
            let now = MS * ms;
            bus.advance(now);
            while let Some(received) = bus.receive(far) {
                meter.add(&received.frame);
            }
            meter.poll(now);
            for id in [0x80, 0x181, 0x201] {
                let data = [0, ms.to_le_bytes()[0], 0xff, 0, 0, 0, 0, 1];
                bus.send(near, &frame(id, &data), now).unwrap();
            }
        }
        let measured = reader.read().unwrap();
        // 1 Mbit/s: a bit is a microsecond.
        let busy = bus.traffic().busy.as_micros();
        let measured = u128::from(measured.last);
        assert!(measured.abs_diff(busy) <= 3 * 135, "{measured} {busy}");
        assert!(measured > 300_000);
        assert_eq!((reader.bus(), reader.bit_rate()), ("bus", Some(1_000_000)));
    }

    #[test]
    fn load_keeps_maximum_and_divides_by_late_window() {
        let (mut meter, reader) = meter();
        assert_eq!(reader.read(), None);
        let frame = frame(0x7ff, &[0x55; 8]);
        let bits = Bits::of(&frame).nominal;
        meter.poll(MS);
        for _ in 0..100 {
            meter.add(&frame);
        }
        meter.poll(MS * 1000);
        assert_eq!(reader.read(), None);
        meter.poll(MS * 1001);
        let full = Load {
            last: 100 * bits,
            most: 100 * bits,
        };
        assert_eq!(reader.read(), Some(full));
        // A stall of the thread makes the window longer, not the load higher.
        for _ in 0..100 {
            meter.add(&frame);
        }
        meter.poll(MS * 3001);
        assert_eq!(
            reader.read(),
            Some(Load {
                last: 50 * bits,
                ..full
            })
        );
        meter.poll(MS * 4001);
        assert_eq!(reader.read(), Some(Load { last: 0, ..full }));
        // Time that does not advance ends nothing.
        meter.add(&frame);
        meter.poll(MS);
        assert_eq!(reader.read().unwrap().last, 0);
    }
}
