//! Admission of commands from the network: what may change a cell, once, in time. No I/O and no clock.
