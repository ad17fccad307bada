#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

use std::path::Path;

use takt_core::cell::{DriverKind, Section};
use takt_core::device::sim::{ARM, ArmSimConfig};
use takt_core::{CellConfig, Error};

#[cfg(feature = "canopen")]
pub use takt_device_canopen as canopen;
#[cfg(feature = "ethercat")]
pub use takt_device_ethercat as ethercat;
#[cfg(feature = "fri")]
pub use takt_device_fri as fri;
#[cfg(feature = "rmp")]
pub use takt_device_rmp as rmp;
#[cfg(feature = "wsg")]
pub use takt_device_wsg as wsg;

/// The table of drivers: cargo feature, table of the cell file, type of its configuration.
macro_rules! drivers {
    ($($feature:tt, $section:ident($name:literal) => $config:path;)*) => {
        &[$({
            #[cfg(feature = $feature)]
            let kind = DriverKind::new::<$config>(Section::$section($name));
            #[cfg(not(feature = $feature))]
            let kind = DriverKind::without(Section::$section($name), $feature);
            kind
        },)*
        // It needs no wire.
        DriverKind::new::<ArmSimConfig>(Section::Device(ARM)),]
    };
}

/// The drivers of this program. A new driver is one line.
pub const DRIVERS: &[DriverKind] = drivers! {
    "fri", Device("kuka_lwr_fri") => takt_device_fri::LwrConfig;
    "fri", Device("kuka_iiwa_fri") => takt_device_fri::IiwaConfig;
    "rmp", Device("segway_rmp") => takt_device_rmp::RmpConfig;
    "wsg", Device("schunk_wsg") => takt_device_wsg::WsgConfig;
    "ethercat", Bus("ethercat") => takt_device_ethercat::EthercatConfig;
    "canopen", Bus("canopen") => takt_device_canopen::CanopenConfig;
};

/// Reads a cell file with the drivers of this program.
///
/// # Errors
/// As [`CellConfig::read`].
pub fn read_cell(path: &Path) -> Result<CellConfig, Error> {
    CellConfig::read(path, DRIVERS)
}

/// Parses the text of a cell file with the drivers of this program.
///
/// # Errors
/// As [`CellConfig::parse`].
pub fn parse_cell(text: &str) -> Result<CellConfig, Error> {
    CellConfig::parse(text, DRIVERS)
}
