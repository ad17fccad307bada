//! CANopen (CiA 301) without I/O: messages, and the machines of both sides of them. Frames come in
//! and go out as values; time is an argument; nothing allocates once it is built.

mod message;
pub mod sdo;

pub use message::{
    EMERGENCY, Emergency, HEARTBEAT, LSS_MASTER, LSS_SLAVE, Message, NMT, NmtCommand, NmtState,
    NodeId, NodeIdError, RPDO1, SDO_REQUEST, SDO_RESPONSE, SYNC, TIME, TPDO1, emergency, heartbeat,
    sync,
};
