//! The servo in virtual time; nothing here sleeps or reads a clock.
mod sim;
mod states;
mod virtual_time;
