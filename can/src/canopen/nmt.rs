//! Network management (CiA 301, clauses 7.2.8 and 7.3.2): the state machine of a slave, heartbeat
//! and node guarding of both sides. Who starts which node when, the network decides, not this.

mod consumer;
mod guarding;
mod slave;

pub use consumer::{Consumer, Heard, Watch};
pub use guarding::{Guarded, Guarding};
pub use slave::{ErrorBehaviour, Input, Reset, Slave, State, step};
