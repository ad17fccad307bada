//! Holding an arm where it is: it brakes, stays at rest under command, and can be taken over at any time.

use super::ArmDescription;
use crate::error::ErrorKind;
use crate::net::Net;
use crate::order::{Operation, Ports, Requests};

/// Brakes an arm within its limits, and keeps it where it comes to rest.
#[derive(Clone, Debug)]
pub(crate) struct Hold {
    pub(crate) arm: ArmDescription,
}

impl Operation for Hold {
    fn devices(&self) -> Vec<String> {
        vec![self.arm.name.clone()]
    }

    fn check(&self) -> Result<(), ErrorKind> {
        Ok(())
    }

    fn write(&self, net: &mut Net, requests: &Requests<'_>) -> Result<Ports, ErrorKind> {
        let arm = &self.arm;
        let positions = arm.joint_array(net, "outCommandedPosition");
        let always = [("Value", "true".into())];
        let always = net.add("Core::BooleanValue", always).out("outValue");
        let track = arm.track(net, &positions, &always, requests.speed);
        let failures = arm.command(net, &track.out("outPosition"));
        let rests = track.out("outDone");
        Ok(Ports {
            done: net.of_two("Core::BooleanAnd", &rests, &requests.stop),
            progress: None,
            failures,
            results: vec![("maintaining", rests)],
            fault: None,
        })
    }
}
