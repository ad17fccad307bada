//! Network management (CiA 301, clauses 7.2.8 and 7.3.2): NMT slave state machine, heartbeat and
//! node guarding of both sides. The network master decides which node starts when.

mod consumer;
mod guarding;
mod slave;

pub use consumer::{Consumer, HeartbeatEvent, Watch};
pub use guarding::{Guarded, Guarding};
pub use slave::{ErrorBehaviour, Input, Reset, Slave, State, step};
