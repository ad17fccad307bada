//! `Homing::Axis`: finds the zero of an axis whose driver homes by proximity switch and index pulse. What moves is the driver's;
//! the primitive wants it for as long as it is evaluated, and says how it ended.

use crate::device::homing::TOUCHED;
use takt_net::definition::port;
use takt_net::device::Homing;
use takt_net::{Build, Cycle, Definition, Fault, In, NullRule, Out, Primitive};

struct Home {
    axis: Homing,
    leave: In<bool>,
    /// Whether the driver has begun since this primitive requests it: what it reported before is of an earlier homing.
    has_begun: bool,
    waited: u32,
    is_done: Out<bool>,
    is_homing: Out<bool>,
    is_touched: Out<bool>,
    step: Out<i32>,
    has_failed: Out<bool>,
    number: Out<i32>,
}

/// What `outFailure` says.
const NUMBERS: &str = "0, or 1 sensor not found, 2 switch stuck, 3 index not found, 4 wrong direction, 5 not moving, 6 time-out, \
                       7 power lost";
/// What `outStep` says.
const STEP: &str = "where it is: 0 not begun, 1 off the switch on which it began, 2 to the switch, 3 on the switch until it may \
                    leave, 4 off the switch, 5 to the index pulse, 6 to its start, 7 done, 8 failed or cancelled";
/// Cycles after which what the driver reports is of this request, as it may have failed at once.
const BEGIN_MAX: u32 = 100;

impl Primitive for Home {
    fn step(&mut self, cycle: &Cycle<'_>) {
        if !self.axis.home.is_taken(cycle) {
            let may_leave = self.leave.get(cycle) == Some(true);
            self.axis.home.give(cycle, may_leave);
        }
        let image = cycle.image;
        let homing = self.axis.homing.get(image);
        let homed = self.axis.homed.get(image);
        self.waited = self.waited.saturating_add(1);
        self.has_begun |= homing == Some(true) || self.waited > BEGIN_MAX;
        let has_ended = self.has_begun && homing == Some(false);
        let failure = self.axis.failure.get(image).unwrap_or_default();
        let number = if has_ended { failure } else { 0 };
        self.is_homing.set(cycle, homing);
        let step = self.axis.step.get(image).filter(|_| self.has_begun);
        self.is_touched.set(cycle, step.map(|step| step == TOUCHED));
        self.step.set(cycle, step);
        self.is_done
            .set(cycle, homed.map(|homed| has_ended && homed));
        self.has_failed.set(cycle, Some(number != 0));
        self.number.set(cycle, Some(number));
    }
}

fn build(b: &mut Build<'_, '_>) -> Result<Home, Fault> {
    let axis = b.interface("Device", "axis that homes", |has| has.homing)?;
    let device = b.text("Device").to_owned();
    b.claim(&device, format!("{device}_Home"));
    b.commands(axis.home.target());
    Ok(Home {
        axis,
        leave: b.input("inLeave")?,
        has_begun: false,
        waited: 0,
        is_done: b.output("outHomed"),
        is_homing: b.output("outHoming"),
        is_touched: b.output("outTouched"),
        step: b.output("outStep"),
        has_failed: b.output("outFailed"),
        number: b.output("outFailure"),
    })
}

pub(super) fn table() -> Vec<Definition> {
    let homing = Definition::new(
        "Homing::Axis",
        "Homes an axis by its proximity switch and index pulse, from its first cycle on. When its net ends before, the axis \
         brakes. The arm of the axis must not be commanded meanwhile.",
        build,
    )
    .active()
    .text("Device", "name of the axis")
    .input::<bool>(port("inLeave", "whether it may leave its proximity switch; until then it rests on it").or("Leave", "true"))
    .output::<bool>("outHomed", "whether its zero was found")
    .output::<bool>("outHoming", "whether it is under way")
    .output::<bool>("outTouched", "whether it is on its proximity switch until it may leave")
    .output::<i32>("outStep", STEP)
    .output::<bool>("outFailed", "whether it failed")
    .output::<i32>("outFailure", NUMBERS)
    .null(NullRule::Own(
        "outHomed and outHoming are null while the driver does not know them, outTouched and outStep also before it has begun; a \
         null inLeave is false.",
    ));
    vec![homing]
}

#[cfg(test)]
mod tests {
    use super::{NUMBERS, STEP};
    use crate::device::homing::{FAILURES, STEPS, TOUCHED};

    #[test]
    fn homing_step_numbers_are_documented() {
        for (number, step) in STEPS.iter().enumerate() {
            assert!(STEP.contains(&format!("{number} {step}")), "{step}");
        }
        assert!(STEP.contains(&format!("{TOUCHED} on the switch")));
    }

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
