//! The world of the cells `assembly`, and which of its parts each device moves. The program that assembles is not here.

use std::time::Duration;

use nalgebra::Isometry3;
use takt_core::CellConfig;
use takt_fri::lwr::emulator::Sensing;
use takt_world::World;

use crate::error::Error;
use crate::surroundings::CellWorld;

/// How the emulated controllers estimate forces: *assumption*.
const SENSING: Sensing = Sensing {
    noise_nm: 0.1,
    noise_n: 0.3,
    delay: Duration::from_millis(4),
};

impl CellWorld {
    /// The world of the cell `assembly`, whose parts lie and whose base docks by the seed.
    ///
    /// # Errors
    /// None that a seed could cause.
    pub fn assembly(cell: &CellConfig, seed: u64) -> Result<Self, Error> {
        Ok(Self::station(cell, takt_world::assembly(seed)?))
    }

    /// The same later: both boxes stand on the bench.
    ///
    /// # Errors
    /// None that a seed could cause.
    pub fn assembly_unloaded(cell: &CellConfig, seed: u64) -> Result<Self, Error> {
        Ok(Self::station(cell, takt_world::assembly_unloaded(seed)?))
    }

    fn station(cell: &CellConfig, world: World) -> Self {
        let place = |device: &str| {
            let mut bases = cell.frames.bases.iter();
            let base = bases.find(|base| base.device == device);
            base.map_or_else(Isometry3::identity, |base| base.placement().frame())
        };
        let arm = |device: &str, hands: &[&str]| {
            let hands = hands.iter().map(|hand| (*hand).to_owned());
            (device.to_owned(), place(device), hands.collect())
        };
        Self {
            world,
            arms: vec![arm("left", &["left"]), arm("right", &["right", "driver"])],
            grippers: vec![
                ("left_hand".to_owned(), "left".to_owned()),
                ("right_hand".to_owned(), "right".to_owned()),
            ],
            screwdrivers: vec![("right".to_owned(), "driver".to_owned())],
            switches: vec![("left".to_owned(), 0, "dock".to_owned())],
            base: Some("base".to_owned()),
            sensing: SENSING,
        }
    }
}
