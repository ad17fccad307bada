//! Generators of test signals and rhythms: waves and a single ramp. They count cycles and do not add
//! up times, so they do not drift. Sines are `Core::DoubleSin` of a `Core::Clock`.

use crate::definition::{Build, Definition, NullRule, Primitive};
use crate::fault::Fault;
use crate::plan::Cycle;
use crate::slots::{In, Out};

/// Counts the active cycles since the start or the last reset.
struct Ticks {
    reset: In<bool>,
    count: u64,
    period_s: f64,
}

impl Ticks {
    fn new(b: &mut Build<'_, '_>) -> Result<Self, Fault> {
        Ok(Self {
            reset: b.input("inReset")?,
            count: 0,
            period_s: b.period_s(),
        })
    }

    /// Time since the start, s: 0 in the first cycle.
    fn next(&mut self, cycle: &Cycle<'_>) -> f64 {
        if self.reset.get(cycle) == Some(true) {
            self.count = 0;
        }
        #[expect(clippy::cast_precision_loss, reason = "2^53 cycles are 285,000 years")]
        let time_s = self.count as f64 * self.period_s;
        self.count = self.count.saturating_add(1);
        time_s
    }
}

struct Wave<F> {
    ticks: Ticks,
    out: Out<f64>,
    every_s: f64,
    phase: f64,
    amplitude: f64,
    offset: f64,
    shape: F,
}

impl<F: Fn(f64) -> f64 + Send> Primitive for Wave<F> {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let turns = self.ticks.next(cycle) / self.every_s + self.phase;
        let value = (self.shape)(turns.rem_euclid(1.0));
        self.out.set(cycle, self.offset + self.amplitude * value);
    }
}

/// Upper bound on the magnitude of amplitudes and offsets, so that no sum overflows.
const LARGEST: f64 = 1e300;

fn shaped<F>(b: &mut Build<'_, '_>, shape: F) -> Result<Wave<F>, Fault> {
    Ok(Wave {
        ticks: Ticks::new(b)?,
        out: b.output("outValue"),
        every_s: b.double("Period", b.period_s()..=1e9)?,
        phase: b.double("Phase", 0.0..=1.0)?,
        amplitude: b.double("Amplitude", -LARGEST..=LARGEST)?,
        offset: b.double("Offset", -LARGEST..=LARGEST)?,
        shape,
    })
}

fn wave(definition: Definition) -> Definition {
    definition
        .stateful()
        .parameter::<f64>(
            "Period",
            "1",
            "time of one wave, at least that of one cycle, s",
        )
        .parameter::<f64>("Amplitude", "1", "largest distance from Offset")
        .parameter::<f64>("Offset", "0", "middle of the wave")
        .parameter::<f64>("Phase", "0", "part of the wave at which it starts, 0 to 1")
        .output::<f64>("outValue", "the value of this cycle")
        .null(NullRule::Own("Never null while active."))
}

fn square() -> Definition {
    let definition = Definition::new(
        "Core::SquareWave",
        "Offset plus Amplitude during the part Duty of each wave, then Offset minus Amplitude.",
        |b| {
            let duty = b.double("Duty", 0.0..=1.0)?;
            shaped(b, move |turn| if turn < duty { 1.0 } else { -1.0 })
        },
    );
    wave(definition.parameter::<f64>("Duty", "0.5", "upper part of the wave, 0 to 1"))
}

fn triangle() -> Definition {
    wave(Definition::new(
        "Core::TriangleWave",
        "Straight up and down around Offset: it starts there, and upwards.",
        |b| {
            shaped(b, |turn: f64| {
                if turn < 0.25 {
                    4.0 * turn
                } else if turn < 0.75 {
                    2.0 - 4.0 * turn
                } else {
                    4.0 * turn - 4.0
                }
            })
        },
    ))
}

fn sawtooth() -> Definition {
    wave(Definition::new(
        "Core::SawtoothWave",
        "A ramp from Offset minus Amplitude to Offset plus Amplitude, again and again.",
        |b| shaped(b, |turn: f64| 2.0 * turn - 1.0),
    ))
}

struct Ramp {
    ticks: Ticks,
    out: Out<f64>,
    done: Out<bool>,
    from: f64,
    to: f64,
    duration_s: f64,
}

impl Primitive for Ramp {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let time_s = self.ticks.next(cycle);
        let is_done = time_s >= self.duration_s;
        let part = time_s / self.duration_s;
        let value = if is_done {
            self.to
        } else {
            self.from * (1.0 - part) + self.to * part
        };
        self.out.set(cycle, value);
        self.done.set(cycle, is_done);
    }
}

fn ramp() -> Definition {
    let build = |b: &mut Build<'_, '_>| -> Result<Ramp, Fault> {
        Ok(Ramp {
            ticks: Ticks::new(b)?,
            out: b.output("outValue"),
            done: b.output("outDone"),
            from: b.double("From", -LARGEST..=LARGEST)?,
            to: b.double("To", -LARGEST..=LARGEST)?,
            duration_s: b.double("Duration", 0.0..=1e9)?,
        })
    };
    Definition::new(
        "Core::Ramp",
        "From in the first cycle, then straight to To within Duration, and To from then on. The corners are \
         sharp: for set-points of robots use a motion.",
        build,
    )
    .stateful()
    .parameter::<f64>("From", "0", "value at the start")
    .parameter::<f64>("To", "1", "value at the end")
    .parameter::<f64>("Duration", "1", "time from start to end, s")
    .output::<f64>("outValue", "the value of this cycle")
    .output::<bool>("outDone", "whether To is reached")
    .null(NullRule::Own("Never null while active."))
}

pub(super) fn table() -> Vec<Definition> {
    vec![square(), triangle(), sawtooth(), ramp()]
}
