//! Coordinated starts: nets of several controllers begin at one instant. No I/O and no clock.
