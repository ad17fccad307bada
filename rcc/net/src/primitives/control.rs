//! Primitives for requests: from outside into a net, and from a net to the executor, which forwards
//! them.

use std::ops::RangeInclusive;
use std::time::Duration;

use crate::definition::{Build, Definition, NullRule, Primitive, port};
use crate::fault::Fault;
use crate::plan::Cycle;
use crate::slots::{In, Out};

/// How long a net may go on after a device failed, s.
const FAILURE_S: RangeInclusive<f64> = 0.001..=10.0;

/// Writes one Boolean of the moment.
struct Request {
    value: Out<bool>,
    read: fn(&Cycle<'_>) -> bool,
}

impl Primitive for Request {
    fn step(&mut self, cycle: &Cycle<'_>) {
        self.value.set(cycle, (self.read)(cycle));
    }
}

/// Votes in every cycle of its net whether to stop all devices.
struct EStop {
    stop: In<bool>,
}

impl Primitive for EStop {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let until = cycle.moment.cycle.saturating_add(cycle.moment.every.max(1));
        let stop = self.stop.get(cycle).unwrap_or(true);
        let vote = &cycle.image.stop;
        vote.set(vote.get().with(until, stop));
    }
}

pub(super) fn table() -> Vec<Definition> {
    let cancel = |b: &mut Build<'_, '_>| -> Result<Request, Fault> {
        Ok(Request {
            value: b.output("outCancel"),
            read: |c| c.moment.cancel,
        })
    };
    let takeover = |b: &mut Build<'_, '_>| -> Result<Request, Fault> {
        Ok(Request {
            value: b.output("outTakeover"),
            read: |c| c.moment.takeover,
        })
    };
    let estop = |b: &mut Build<'_, '_>| -> Result<EStop, Fault> {
        Ok(EStop {
            stop: b.input("inEStop")?,
        })
    };
    let failure = |b: &mut Build<'_, '_>| -> Result<Request, Fault> {
        b.outlives_failure(Duration::from_secs_f64(b.double("Time", FAILURE_S)?));
        Ok(Request {
            value: b.output("outFailed"),
            read: |c| c.moment.device_failed,
        })
    };
    vec![
        Definition::new("EStop", "Stops all devices of the controller while its input is true: nets that command them end, and drivers brake. It is not a safety function. The last state remains in effect until an EStop of any net changes it.", estop)
            .input::<bool>(port("inEStop", "true to stop").required())
            .null(NullRule::Own("Null stops: a lost signal is not a permission to move.")),
        Definition::new("Cancel", "Whether the net was requested to cancel. The net decides how it ends; it must then set its `outTerminate`.", cancel)
            .output::<bool>("outCancel", "true from the cycle after the request on")
            .null(NullRule::Own("Never null.")),
        Definition::new("Takeover", "Whether a successor is scheduled after this net. The net may then end early.", takeover)
            .output::<bool>("outTakeover", "true once a successor is scheduled")
            .null(NullRule::Own("Never null.")),
        Definition::new("DeviceFailure", "Whether a device that the net commands has failed. Without this primitive the net ends in that cycle, and each driver brakes its own device. With it the net goes on for `Time`, to bring its other devices to rest on their common path, and must then end itself; what it commands to the failed device has no effect, also if that returns. The net ends at once when none of its devices follows commands, as in an emergency stop.", failure)
            .parameter::<f64>("Time", "1", "how long the net goes on, s, 0.001 to 10; the least one of several applies")
            .output::<bool>("outFailed", "true from the cycle on in which the first device failed")
            .null(NullRule::Own("Never null.")),
    ]
}
