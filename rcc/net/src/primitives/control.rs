//! Primitives that bring requests from outside into a net. How requests reach the net is the
//! executor's business.

use crate::definition::{Build, Definition, NullRule, Primitive};
use crate::fault::Fault;
use crate::plan::Cycle;
use crate::slots::Out;

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
    vec![
        Definition::new("Cancel", "Whether the net was asked to cancel. The net decides how it comes to an end; it must then set its `outTerminate`.", cancel)
            .output::<bool>("outCancel", "true from the cycle after the request on")
            .null(NullRule::Own("Never null.")),
        Definition::new("Takeover", "Whether a successor is scheduled after this net. The net may end early then, and need not.", takeover)
            .output::<bool>("outTakeover", "true once a successor is scheduled")
            .null(NullRule::Own("Never null.")),
    ]
}
