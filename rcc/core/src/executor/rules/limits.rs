//! Limits of the rules of one thread, so that the cost of a cycle is bounded. They are checked where rules are added.

/// Maximum number of waiting rules of one thread.
pub const RULES_MAX: usize = 1024;
/// Maximum work of all waiting rules of one thread per cycle: literals, operations, and
/// nets that they stop, cancel and start. Of a rule in several threads, literals count in each.
pub const WORK_MAX: usize = 8192;
/// Maximum number of scheduled nets.
pub const SCHEDULED_MAX: usize = 1024;
/// Maximum number of Boolean operations of one condition.
pub const CONDITION_MAX: usize = 256;
