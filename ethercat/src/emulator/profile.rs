//! Slaves that answer as real ones do in public recordings: registers, SII, SyncManagers, clocks, times and deviations
//! from the standard. Their process data is not specific: beyond the wire they are the same terminals and drives as all
//! emulated ones.

mod coe;
mod images;

use std::fmt;
use std::str::FromStr;

use takt_cia402::dictionary::DictionaryError;

use super::application::Plain;
use super::drive::{PdoSet, ServoConfig, ServoDrive};
use super::segment::Segment;
use super::slave::{Chip, ClockUnit, Slave, SlaveConfig, Span, Times};
use super::terminal::Io;
use super::{Clock, SiiImage};

/// A device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Profile {
    /// Coupler to E-bus terminals; its controller has no firmware.
    Ek1100,
    /// Four digital inputs; announces a clock that it does not have.
    El1004,
    /// Four digital outputs; the SII gives no length for their SyncManager.
    El2004,
    /// Eight digital outputs.
    El2828,
    /// Sixteen digital outputs: two SyncManagers of one byte, adjacent in registers.
    El2889,
    /// Four analogue inputs, with CoE.
    El3004,
    /// Coupler with a few channels, with CoE.
    Ek1914,
    /// Evaluation board: AL control that is read late, mailboxes of 40 ms.
    Lan9252,
    /// Drive: a clock of 32 bits, AL control that is read late, a default PDO assignment that it refuses.
    Akd,
}

/// A slave of a profile and its handles.
#[derive(Debug)]
pub struct Profiled {
    /// The slave.
    pub slave: Slave,
    /// Its terminals, if it has any.
    pub io: Option<Io>,
    /// The drive, if it is one.
    pub drive: Option<ServoDrive>,
}

/// The terminals and the drive of a slave, if present.
pub type Handles = (Option<Io>, Option<ServoDrive>);

/// An unknown profile name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "unknown device `{0}`; known are ek1100, el1004, el2004, el2828, el2889, el3004, ek1914, lan9252, akd"
)]
pub struct UnknownProfile(pub String);

impl FromStr for Profile {
    type Err = UnknownProfile;

    fn from_str(name: &str) -> Result<Self, UnknownProfile> {
        let found = Self::ALL.into_iter().find(|profile| profile.name() == name);
        found.ok_or_else(|| UnknownProfile(name.to_owned()))
    }
}

impl fmt::Display for Profile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl Profile {
    /// All of them.
    pub const ALL: [Self; 9] = [
        Self::Ek1100,
        Self::El1004,
        Self::El2004,
        Self::El2828,
        Self::El2889,
        Self::El3004,
        Self::Ek1914,
        Self::Lan9252,
        Self::Akd,
    ];
    /// A typical line: coupler, digital inputs and outputs, outputs in registers, analogue inputs, a drive.
    pub const LINE: [Self; 6] = [
        Self::Ek1100,
        Self::El1004,
        Self::El2004,
        Self::El2889,
        Self::El3004,
        Self::Akd,
    ];

    /// Its name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Ek1100 => "ek1100",
            Self::El1004 => "el1004",
            Self::El2004 => "el2004",
            Self::El2828 => "el2828",
            Self::El2889 => "el2889",
            Self::El3004 => "el3004",
            Self::Ek1914 => "ek1914",
            Self::Lan9252 => "lan9252",
            Self::Akd => "akd",
        }
    }

    /// A slave of this profile, with recorded times multiplied by a factor.
    ///
    /// # Errors
    /// If the objects of its firmware do not make a dictionary.
    pub fn slave(self, times: u64) -> Result<Profiled, DictionaryError> {
        if self == Self::Akd {
            return akd(times);
        }
        let (sii, mut config) = (self.sii(), self.config());
        config.times = config.times.scaled(times);
        let io = Io::default();
        let has_data = sii.rx_pdos.len() + sii.tx_pdos.len() > 0;
        let slave = if sii.coe > 0 {
            let firmware = coe::Firmware::new(&sii, io.clone())?;
            Slave::new(config, Box::new(firmware))
        } else if has_data {
            Slave::new(config, Box::new(io.clone()))
        } else {
            Slave::new(config, Box::new(Plain))
        };
        Ok(Profiled {
            slave,
            io: has_data.then_some(io),
            drive: None,
        })
    }

    /// These profiles in a line, and the handles of each.
    ///
    /// # Errors
    /// As [`Self::slave`].
    pub fn line(profiles: &[Self], times: u64) -> Result<(Segment, Vec<Handles>), DictionaryError> {
        let (mut slaves, mut handles) = (Vec::new(), Vec::new());
        for profile in profiles {
            let Profiled { slave, io, drive } = profile.slave(times)?;
            slaves.push(slave);
            handles.push((io, drive));
        }
        Ok((Segment::line(slaves), handles))
    }

    /// The content of its EEPROM.
    fn sii(self) -> SiiImage {
        match self {
            Self::Ek1100 => images::ek1100(),
            Self::El1004 => images::el1004(),
            Self::El2004 => images::el2004(),
            Self::El2828 => images::el2828(),
            Self::El2889 => images::el2889(),
            Self::El3004 => images::el3004(),
            Self::Ek1914 => images::ek1914(),
            Self::Lan9252 => images::lan9252(),
            Self::Akd => images::akd(),
        }
    }

    fn config(self) -> SlaveConfig {
        let config = SlaveConfig::new(self.sii());
        let forwarding = match self {
            Self::Ek1100 => 35,
            Self::El1004
            | Self::El2004
            | Self::El2828
            | Self::El2889
            | Self::El3004
            | Self::Ek1914 => 55,
            Self::Lan9252 | Self::Akd => 260,
        };
        SlaveConfig {
            chip: self.chip(),
            // The status that it showed at power-on.
            clock: Some(Clock::new(0x0123_4567_89AB, self.drift_ppb())),
            times: self.times(),
            dirty_mailbox: matches!(self, Self::El3004 | Self::Ek1914),
            forwarding,
            ..config
        }
    }

    const fn drift_ppb(self) -> i64 {
        match self {
            Self::Ek1100 => 0,
            Self::El1004 | Self::El2004 | Self::El2828 | Self::El2889 => 12_000,
            Self::El3004 | Self::Ek1914 => -8_000,
            Self::Lan9252 => 30_000,
            Self::Akd => -25_000,
        }
    }

    /// Registers 0000h to 0009h, its clock, its SII interface. Values not recorded of a device are those of similar
    /// devices.
    const fn chip(self) -> Chip {
        // FMMUs, SyncManagers, KiB, 0007h, 0008h, clock, 0502h at rest.
        let (kind, counts, ports, features, clock, sii_status) = match self {
            Self::Ek1100 => {
                let kind = (0x11, 0x00, 0x0003);
                (kind, (8, 8, 8), 0x3B, 0x00FC, ClockUnit::Bits64, 0x0040)
            }
            Self::El1004 | Self::El2828 | Self::El3004 => {
                let kind = (0x12, 0x01, 0x0001);
                let clock = ClockUnit::ReceiveTimes;
                (kind, (3, 4, 1), 0x4A, 0x01FC, clock, 0x0050)
            }
            Self::El2004 => {
                let kind = (0x12, 0x01, 0x0001);
                let clock = ClockUnit::ReceiveTimes;
                (kind, (3, 4, 1), 0x4A, 0x00FC, clock, 0x0040)
            }
            Self::El2889 => {
                let kind = (0x12, 0x01, 0x0001);
                (kind, (3, 4, 1), 0x4A, 0x00FC, ClockUnit::Bits64, 0x0040)
            }
            Self::Ek1914 => {
                let kind = (0x11, 0x00, 0x0003);
                let clock = ClockUnit::ReceiveTimes;
                (kind, (8, 8, 8), 0x3B, 0x00FC, clock, 0x0040)
            }
            Self::Lan9252 => {
                let kind = (0xC0, 0x02, 0x0001);
                (kind, (3, 4, 4), 0x1F, 0x01CC, ClockUnit::Bits64, 0x0080)
            }
            Self::Akd => {
                let kind = (0x04, 0x02, 0x0043);
                (kind, (3, 4, 4), 0x0F, 0x0184, ClockUnit::Bits32, 0x0020)
            }
        };
        Chip {
            kind: kind.0,
            revision: kind.1,
            build: kind.2,
            fmmus: counts.0,
            sync_managers: counts.1,
            ram_kib: counts.2,
            ports: Some(ports),
            features: Some(features),
            clock,
            dl_status: match self {
                Self::Ek1100 => 0x01,
                Self::Lan9252 => 0x07,
                Self::El1004
                | Self::El2004
                | Self::El2828
                | Self::El2889
                | Self::El3004
                | Self::Ek1914
                | Self::Akd => 0x03,
            },
            sii_status,
            unused_times: *b"Verl",
        }
    }

    const fn times(self) -> Times {
        // Terminals and couplers have the same EEPROMs: ready at once after a write, while still storing.
        let terminal = Times {
            al_read: None,
            to_pre_op: Span::micros(300, 700),
            to_safe_op: Span::micros(6_000, 6_000),
            to_op: Span::micros(300, 900),
            mailbox: Span::micros(600, 7_400),
            sii_read: Span::micros(600, 900),
            sii_write: Span::exactly(0),
            sii_store: Span::micros(900, 900),
        };
        match self {
            Self::Ek1100
            | Self::El1004
            | Self::El2004
            | Self::El2828
            | Self::El2889
            | Self::El3004 => terminal,
            Self::Ek1914 => Times {
                to_pre_op: Span::micros(1_500, 5_800),
                to_safe_op: Span::micros(6_400, 6_400),
                to_op: Span::micros(1_300, 1_300),
                mailbox: Span::micros(600, 7_600),
                ..terminal
            },
            Self::Lan9252 => Times {
                al_read: Some(Span::micros(6_800, 7_300)),
                to_pre_op: Span::micros(12_000, 18_500),
                to_safe_op: Span::micros(15_000, 18_500),
                to_op: Span::micros(15_000, 18_500),
                mailbox: Span::micros(37_000, 40_000),
                sii_read: Span::micros(100, 500),
                ..terminal
            },
            Self::Akd => Times {
                al_read: Some(Span::micros(6_800, 7_300)),
                to_pre_op: Span::micros(5_000, 19_000),
                to_safe_op: Span::micros(5_000, 19_000),
                to_op: Span::micros(5_000, 19_000),
                mailbox: Span::micros(2_000, 3_500),
                sii_read: Span::micros(100, 500),
                ..terminal
            },
        }
    }
}

/// Period at which a drive sends an Ethernet frame by its mailbox once it has an address, ns.
const ETHERNET: u64 = 50_000_000;

fn akd(times: u64) -> Result<Profiled, DictionaryError> {
    let profile = Profile::Akd;
    let mut config = profile.config();
    config.times = config.times.scaled(times);
    config.eoe = Some(ETHERNET);
    config.counters_follow = true;
    let image = profile.sii();
    let servo = ServoConfig {
        name: image.name.clone(),
        identity: Some(image.identity),
        mailbox: image.mailbox_len,
        coe: image.coe,
        pdos: PdoSet::Four,
        ..ServoConfig::default()
    };
    let (slave, drive) = ServoDrive::with_controller(servo, config)?;
    Ok(Profiled {
        slave,
        io: None,
        drive: Some(drive),
    })
}
