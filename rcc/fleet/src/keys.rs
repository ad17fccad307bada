//! Key expressions of the fleet. It knows no network.
