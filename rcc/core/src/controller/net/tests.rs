//! Starts of a net whose answers come late or to nobody.

use super::*;
use crate::controller::threads::busy;

const ID: NetId = NetId(1);
const TEXT: &str = "{never=Core::BooleanValue(),outTerminate=never.outValue}";

/// A net that is ready.
fn ready() -> Net {
    let mut net = Net::new(SessionId::NONE, String::new(), "".into());
    net.running = Some(crate::executor::tests::net(ID.0, TEXT));
    net.enter(NetState::Ready);
    net
}

fn begin(net: &mut Net) -> Option<Box<Running>> {
    net.check_begin(ID).ok()?;
    let Command::Start(running) = net.begin(ID, Generation::default()) else {
        return None;
    };
    Some(running)
}

#[test]
fn start_rejected_after_timeout_can_be_repeated() {
    let mut net = ready();
    let running = begin(&mut net).unwrap();
    assert!(begin(&mut net).is_none(), "it is under way");
    net.take_back(running, Some(busy()));
    assert!(begin(&mut net).is_some());
    assert!(net.is_to_start(), "the outcome is that of this start");
}
