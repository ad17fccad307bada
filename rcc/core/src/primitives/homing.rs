//! `Homing::Axis`: finds the zero of an axis whose driver homes by proximity switch and index pulse. What moves is the driver's;
//! the primitive wants it for as long as it is evaluated, and says how it ended.

use takt_net::device::{Io, Output, Signal};
use takt_net::{Build, Cycle, Definition, Fault, NullRule, Out, Primitive};

use crate::device::homing::{BOOL_IN, BOOL_OUT, FAILURE, HOME, HOMED, HOMING, REAL_IN};

struct Home {
    home: Output<bool>,
    homed: Signal<bool>,
    homing: Signal<bool>,
    failure: Signal<f64>,
    /// Whether the driver has begun since this primitive wants it: what it showed before is of an earlier homing.
    has_begun: bool,
    waited: u32,
    is_done: Out<bool>,
    is_homing: Out<bool>,
    has_failed: Out<bool>,
    number: Out<i32>,
}

/// What `outFailure` says.
const NUMBERS: &str = "0, or 1 sensor not found, 2 switch stuck, 3 index not found, 4 wrong direction, 5 not moving, 6 time-out, \
                       7 power lost";
/// Cycles after which a driver that needs not begin any more has ended, as one that failed at once.
const BEGIN_MAX: u32 = 100;

impl Primitive for Home {
    fn step(&mut self, cycle: &Cycle<'_>) {
        if !self.home.command.is_taken(cycle) {
            self.home.command.give(cycle, true);
        }
        let image = cycle.image;
        let homing = self.homing.get(image);
        let homed = self.homed.get(image);
        self.waited = self.waited.saturating_add(1);
        self.has_begun |= homing == Some(true) || self.waited > BEGIN_MAX;
        let has_ended = self.has_begun && homing == Some(false);
        let failure = self.failure.get(image).filter(|number| *number >= 1.0);
        #[expect(clippy::cast_possible_truncation, reason = "a small whole number")]
        let number = failure
            .filter(|_| has_ended)
            .map_or(0, |number| number as i32);
        self.is_homing.set(cycle, homing);
        self.is_done
            .set(cycle, homed.map(|homed| has_ended && homed));
        self.has_failed.set(cycle, Some(number != 0));
        self.number.set(cycle, Some(number));
    }
}

/// Whether these are the inputs and outputs of an axis that homes.
fn is_axis(io: &Io) -> bool {
    let counts = [
        io.bool_in.len(),
        io.bool_out.len(),
        io.real_in.len(),
        io.real_out.len(),
    ];
    counts == [BOOL_IN, BOOL_OUT, REAL_IN, 0]
}

fn build(b: &mut Build<'_, '_>) -> Result<Home, Fault> {
    let (home, truths, failure) = b.interface("Device", "axis that homes", |has| {
        let io = has.io.as_ref().filter(|io| is_axis(io))?;
        let truths = [*io.bool_in.get(HOMED)?, *io.bool_in.get(HOMING)?];
        Some((*io.bool_out.get(HOME)?, truths, *io.real_in.get(FAILURE)?))
    })?;
    let device = b.text("Device").to_owned();
    b.claim(&device, format!("{device}_OutBool_{HOME}"));
    b.commands(home.command.target());
    let [homed, homing] = truths;
    Ok(Home {
        home,
        homed,
        homing,
        failure,
        has_begun: false,
        waited: 0,
        is_done: b.output("outHomed"),
        is_homing: b.output("outHoming"),
        has_failed: b.output("outFailed"),
        number: b.output("outFailure"),
    })
}

pub(super) fn table() -> Vec<Definition> {
    vec![
        Definition::new(
            "Homing::Axis",
            "Homes an axis by its proximity switch and index pulse, from its first cycle on. When its net ends before, the axis \
             brakes. The arm of the axis must not be commanded meanwhile.",
            build,
        )
        .active()
        .text("Device", "name of the axis")
        .output::<bool>("outHomed", "whether its zero was found")
        .output::<bool>("outHoming", "whether it is under way")
        .output::<bool>("outFailed", "whether it failed")
        .output::<i32>("outFailure", NUMBERS)
        .null(NullRule::Own("outHomed and outHoming are null while the driver does not know them.")),
    ]
}

#[cfg(test)]
mod tests {
    use super::NUMBERS;
    use crate::device::homing::FAILURES;

    #[test]
    fn homing_failure_numbers_are_documented() {
        for (number, failure) in (1..).zip(FAILURES) {
            assert!(
                NUMBERS.contains(&format!("{number} {failure}")),
                "{failure}"
            );
        }
    }
}
