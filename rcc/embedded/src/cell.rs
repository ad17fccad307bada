//! Cells whose robots are emulated in the process. What serves them is in `machines`.

use std::net::{Ipv4Addr, SocketAddr};
use std::sync::Arc;

use takt_core::CellConfig;
use takt_core::device::driver::DriverConfig;
use takt_devices::ethercat::EthercatConfig;
use takt_devices::wsg::WsgConfig;
use takt_devices::wsg::emulator::Port;

use crate::error::Error;
use crate::surroundings::CellWorld;

/// Of two cells, whose worlds differ.
const ASSEMBLY: &str = include_str!("../cells/assembly.toml");
/// Names and texts of the cells.
const CELLS: [(&str, &str); 8] = [
    ("two_lwr", include_str!("../cells/two_lwr.toml")),
    ("iiwa", include_str!("../cells/iiwa.toml")),
    ("factory", include_str!("../cells/factory.toml")),
    ("lwr_wsg", include_str!("../cells/lwr_wsg.toml")),
    ("lwr_table", include_str!("../cells/lwr_table.toml")),
    ("assembly", ASSEMBLY),
    ("assembly_unloaded", ASSEMBLY),
    ("lola", include_str!("../cells/lola.toml")),
];

/// Names of the emulated cells.
pub const NAMES: [&str; 8] = [
    CELLS[0].0, CELLS[1].0, CELLS[2].0, CELLS[3].0, CELLS[4].0, CELLS[5].0, CELLS[6].0, CELLS[7].0,
];

/// Of the world of a cell, unless it is replaced.
const SEED: u64 = 1;

/// Any free port of loopback.
pub(crate) const ANY_PORT: SocketAddr =
    SocketAddr::new(std::net::IpAddr::V4(Ipv4Addr::LOCALHOST), 0);

/// A cell whose robots are emulated.
#[derive(Debug)]
pub struct EmulatedCell {
    /// The controller and the devices that it reaches by sockets.
    pub config: CellConfig,
    /// The EtherCAT segments, which are inside of the process.
    pub(crate) segments: Vec<EthercatConfig>,
    /// Where emulated grippers accept their driver, by device.
    pub(crate) grippers: Vec<(String, Port)>,
    /// The world around the robots; without one, arms meet at most a table. `assembly` has [`CellWorld::assembly`], and
    /// `assembly_unloaded` [`CellWorld::assembly_unloaded`].
    pub world: Option<CellWorld>,
}

impl EmulatedCell {
    /// A cell by its name; see [`NAMES`].
    ///
    /// # Errors
    /// If there is none of that name, or no port is free for a gripper.
    pub fn named(name: &str) -> Result<Self, Error> {
        let Some((_, text)) = CELLS.iter().find(|(known, _)| *known == name) else {
            let (name, known) = (name.to_owned(), NAMES.join(", "));
            return Err(Error::UnknownCell { name, known });
        };
        let mut config = takt_devices::parse_cell(text)?;
        config.controller.websocket = None;
        config.controller.tcp = Some(ANY_PORT);
        let segments = config.of_kind().cloned().collect();
        config.buses.clear();
        let mut grippers = Vec::new();
        for device in &mut config.devices {
            let any: &dyn std::any::Any = &**device;
            let Some(gripper) = any.downcast_ref::<WsgConfig>() else {
                continue;
            };
            let failed = |error| Error::emulator(&gripper.name, error);
            let port = Port::listen(ANY_PORT).map_err(failed)?;
            let address = port.address().map_err(failed)?;
            let moved = WsgConfig {
                address,
                ..gripper.clone()
            };
            grippers.push((moved.name.clone(), port));
            *device = Arc::new(moved) as Arc<dyn DriverConfig>;
        }
        let world = match name {
            "assembly" => Some(CellWorld::assembly(&config, SEED)),
            "assembly_unloaded" => Some(CellWorld::assembly_unloaded(&config, SEED)),
            _ => None,
        };
        Ok(Self {
            world: world.transpose()?,
            config,
            segments,
            grippers,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn emulated_cells_are_valid() {
        let counts = NAMES.map(|name| {
            let cell = EmulatedCell::named(name).unwrap();
            let (devices, segments) = (cell.config.devices.len(), cell.segments.len());
            (devices, segments, cell.grippers.len())
        });
        assert_eq!(
            counts,
            [
                (2, 0, 0),
                (1, 0, 0),
                (2, 2, 0),
                (2, 0, 1),
                (1, 0, 0),
                (4, 1, 2),
                (4, 1, 2),
                (0, 1, 0)
            ]
        );
    }

    #[test]
    fn emulated_cell_unknown_name_lists_all() {
        let error = EmulatedCell::named("three_lwr").unwrap_err().to_string();
        let expected = "there is no emulated cell `three_lwr`\n\
                        hint: the emulated cells are two_lwr, iiwa, factory, lwr_wsg, lwr_table, assembly, assembly_unloaded, lola";
        assert_eq!(error, expected);
    }
}
