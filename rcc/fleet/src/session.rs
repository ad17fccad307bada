//! The zenoh session of a cell. No real-time thread calls it.
