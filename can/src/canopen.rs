//! CANopen (CiA 301) without I/O: messages, and the machines of both sides of them. Frames come in
//! and go out as values; time is an argument; nothing allocates once it is built.

pub mod sdo;
