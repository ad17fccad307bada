//! The other side of the wire: a segment of emulated slave controllers with typical applications, for tests, labs and
//! demonstrations. A frame goes in and returns as the slaves would leave it; time is an argument.
//!
//! ```text
//! frame -> Segment: topology, delays, faults, order of slaves
//!            -> Slave: commands and working counters (ETG.1000.4), AL states (ETG.1000.6)
//!                 -> Memory: registers, SyncManagers      -> Clock: distributed clock
//!                 -> Application: mailbox, outputs and inputs: terminals, drives
//! ```

mod application;
mod clock;
mod coe;
mod drive;
mod image;
mod memory;
mod profile;
mod segment;
mod serve;
mod slave;
mod station;
mod terminal;
#[cfg(test)]
mod tests;
mod youbot;

pub use application::{Application, Cycle, Plain, Setup};
pub use clock::Clock;
pub use coe::CoeServer;
pub use drive::{PdoSet, ServoConfig, ServoDrive};
pub use image::{PdoImage, SiiImage, SiiLayout};
pub use profile::{Handles, Profile, Profiled, UnknownProfile};
pub use segment::{Corrupt, Entry, Faults, Returned, Segment};
pub use serve::{Server, SharedSegment};
pub use slave::{
    Chip, ClockUnit, EthernetFaults, EthernetPort, EthernetState, FileStore, Files, Slave,
    SlaveConfig, SlaveFaults, Span, Times,
};
pub use station::{STATION_AXES, Station, StationFaults, StationMotor};
pub use terminal::{Coupler, Io};
pub use youbot::{Axis, Bar, Boards, DriveHandle, Firmware, Joint, YouBot, YouBotConfig};
