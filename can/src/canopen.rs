//! CANopen (CiA 301) without I/O: messages, and the state machines of master and slave. Frames are
//! values; time is an argument; nothing allocates after construction.

pub mod eds;
pub mod emcy;
#[cfg(feature = "emulator")]
pub mod emulator;
pub mod lss;
mod message;
pub mod network;
pub mod nmt;
pub mod node;
pub mod pdo;
pub mod sdo;
pub mod store;
pub mod sync;
mod time;

pub use message::{
    EMERGENCY, Emergency, HEARTBEAT, LSS_MASTER, LSS_SLAVE, Message, NMT, NmtCommand, NmtState,
    NodeId, NodeIdError, RPDO1, SDO_REQUEST, SDO_RESPONSE, SYNC, TIME, TPDO1, emergency, heartbeat,
    sync,
};
pub use time::TimeOfDay;
