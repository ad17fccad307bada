//! Admission of commands from the network: what may change a cell, once, in time. No I/O and no clock: what a query
//! asks for is executed by the caller, who passes the instant at which it took the query from its queue.
//!
//! A timeout takes no message back: a query that waited in a queue arrives later all the same, and a network may
//! repeat, reorder and delay. Each command therefore carries a session, a sequence number, the boot id of the
//! controller that it is meant for, and a nonce that this controller granted and that expires on its own monotonic
//! clock. No clock of two hosts is compared.

mod admission;
mod id;
mod message;
mod session;

pub use admission::{Admission, Answer, Limits, Lost, Query, check_key};
pub use id::{Boot, Entropy, Nonce, OpenId, Txn, random};
pub use message::{
    CommandRequest, LossPolicy, NAME_BYTES_MAX, Refusal, Reply, SessionRequest, to_json,
};

#[cfg(test)]
mod tests;
