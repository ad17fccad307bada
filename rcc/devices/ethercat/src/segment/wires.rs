//! The wires of a segment, and how they are opened. Frames are exchanged by the driver.

use std::fmt;
use std::time::Duration;

use takt_core::Error;
use takt_ethercat::link::Link;
use takt_ethercat::linux::PacketLink;

use crate::config::EthercatConfig;

/// A link that a driver thread can own.
pub trait EthernetLink: Link + Send + fmt::Debug {}

impl<T: Link + Send + fmt::Debug> EthernetLink for T {}

/// A link and the source address of its frames.
#[derive(Debug)]
pub struct Wire {
    /// The link.
    pub link: Box<dyn EthernetLink>,
    /// Its MAC address.
    pub source: [u8; 6],
}

/// The wires of a segment: one, or two of a ring.
#[derive(Debug)]
pub struct Wires {
    /// To the first slave.
    pub first: Wire,
    /// To the last slave.
    pub second: Option<Wire>,
}

impl From<Wire> for Wires {
    fn from(first: Wire) -> Self {
        Self {
            first,
            second: None,
        }
    }
}

/// How long to detect another master before the first frame: longer than any usual cycle.
const LISTEN: Duration = Duration::from_millis(60);

/// Opens the network interfaces of a segment, exclusively for this process.
///
/// # Errors
/// If an interface does not exist, access is denied, another Takt process has it, or frames of another master arrive.
pub fn open(config: &EthercatConfig) -> Result<Wires, Error> {
    let open = |interface: &String| {
        let link = PacketLink::open_locked(interface).and_then(|mut link| {
            link.listen_first(interface, LISTEN)?;
            Ok(link)
        });
        let link = link.map_err(|source| Error::Device {
            name: config.name.clone(),
            what: format!("open {interface}"),
            source,
        })?;
        let source = link.mac();
        Ok(Wire {
            link: Box::new(link.spinning(config.spin)),
            source,
        })
    };
    Ok(Wires {
        first: open(&config.interface)?,
        second: config.second.as_ref().map(open).transpose()?,
    })
}
