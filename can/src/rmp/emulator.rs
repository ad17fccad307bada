//! Power bases that speak from the other end: one, and the pair of the omnidirectional base, each with
//! the truth of where it is and the faults of which users of real ones tell. They hold no thread and no
//! clock; the owner says what time it is.

mod pair;
mod powerbase;

pub use pair::Pair;
pub use powerbase::{Faults, Powerbase, PowerbaseConfig};

#[cfg(test)]
mod tests;
