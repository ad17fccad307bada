//! Primitives that bring requests from outside into a net, and one that brings a request out of it. How
//! they reach whom they are for is the executor's business.

use crate::definition::{Build, Definition, NullRule, Primitive, port};
use crate::fault::Fault;
use crate::plan::Cycle;
use crate::slots::{In, Out};

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

/// Says in every cycle of its net whether all is to stop.
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
    vec![
        Definition::new("EStop", "Stops all devices of the controller while its input is true: nets that command them end, and drivers brake. It is no safety function. The last word stands until an EStop of any net says otherwise.", estop)
            .input::<bool>(port("inEStop", "true to stop").required())
            .null(NullRule::Own("Null stops: a signal that is lost is no leave to move.")),
        Definition::new("Cancel", "Whether the net was asked to cancel. The net decides how it comes to an end; it must then set its `outTerminate`.", cancel)
            .output::<bool>("outCancel", "true from the cycle after the request on")
            .null(NullRule::Own("Never null.")),
        Definition::new("Takeover", "Whether a successor is scheduled after this net. The net may end early then, and need not.", takeover)
            .output::<bool>("outTakeover", "true once a successor is scheduled")
            .null(NullRule::Own("Never null.")),
    ]
}
