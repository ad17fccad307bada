//! Configuration of a master: expected slaves and their set-up. Plain values: no file is read here.

use std::fmt;
use std::time::Duration;

use takt_cia402::dictionary::{Address, Mapped};

use crate::AlState;
use crate::coe::Whole;

/// Longest process image of one frame, bytes: the capacity of an Ethernet frame beside the frame header, the clock's
/// datagram (20 bytes), the census (14 bytes), one datagram of 152 bytes for a mailbox, and the image's own headers.
pub const IMAGE_MAX: usize = 1500 - 2 - 20 - 14 - 152 - 4 * 12;
/// Maximum number of slaves of a segment; ETG.1000.4 allows 65,535.
pub const SLAVES_MAX: usize = 512;

/// Configuration of a master.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MasterConfig {
    /// Period of the cyclic frame.
    pub cycle: Duration,
    /// Frame timeout during start-up, when no cycle limits it.
    pub frame_timeout: Duration,
    /// The expected slaves; empty accepts any slaves with their own process data.
    pub slaves: Vec<SlaveSpec>,
    /// Goal of the segment: PRE-OP, SAFE-OP or OP.
    pub goal: AlState,
    /// A second port at the end of the line.
    pub redundant: bool,
    /// Consecutive lost frames after which all slaves count as absent, 1 or more; a slave whose inputs are missing for one
    /// cycle more than that is offline.
    pub lost_frames: u8,
    /// Datagrams of mailboxes and diagnosis in a cyclic frame once the segment runs; 1 or more.
    pub acyclic: u8,
    /// Distributed clocks.
    pub clocks: ClockConfig,
    /// Timeouts of every slave without its own.
    pub timeouts: Timeouts,
}

impl Default for MasterConfig {
    /// 1 ms, one port, any slaves, to OP.
    fn default() -> Self {
        Self {
            cycle: Duration::from_millis(1),
            frame_timeout: Duration::from_millis(10),
            slaves: Vec::new(),
            goal: AlState::Op,
            redundant: false,
            lost_frames: 3,
            acyclic: 1,
            clocks: ClockConfig::default(),
            timeouts: Timeouts::default(),
        }
    }
}

/// Timeouts of slaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Timeouts {
    /// From AL control to PRE-OP.
    pub pre_op: Duration,
    /// From AL control to SAFE-OP or OP.
    pub op: Duration,
    /// Mailbox answer.
    pub mailbox: Duration,
    /// Answer to [`RawMailbox`](crate::master::JobKind::RawMailbox), whose sender repeats lost requests.
    pub raw: Duration,
    /// SII access.
    pub sii: Duration,
    /// Retry delay of a failed slave; doubled each time, up to 32 times as long.
    pub again: Duration,
}

impl Default for Timeouts {
    fn default() -> Self {
        Self {
            pre_op: Duration::from_secs(3),
            op: Duration::from_secs(10),
            mailbox: Duration::from_secs(4),
            raw: Duration::from_millis(250),
            sii: Duration::from_millis(500),
            again: Duration::from_millis(200),
        }
    }
}

/// Synchronisation of clocks (ETG.1000.4, clause 9.1.3).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClockConfig {
    /// System time at the master's time zero, ns since 2000-01-01.
    pub epoch_ns: u64,
    /// Largest difference to the reference clock (092Ch) at which a clock counts as locked, ns.
    pub window_ns: u32,
    /// Lock timeout of a slave's clock before SYNC0 is started.
    pub lock: Duration,
    /// Handling of a slave whose clock does not lock in time.
    pub unlocked: Unlocked,
    /// From setting SYNC0 up to its first pulse.
    pub lead: Duration,
}

impl Default for ClockConfig {
    fn default() -> Self {
        Self {
            epoch_ns: 0,
            window_ns: 1000,
            lock: Duration::from_secs(5),
            unlocked: Unlocked::Refuse,
            lead: Duration::from_millis(100),
        }
    }
}

/// Handling of a slave whose clock does not lock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unlocked {
    /// It is not brought beyond PRE-OP.
    Refuse,
    /// It is started nevertheless; its difference is reported.
    Start,
}

/// Location of an expected slave.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Location {
    /// In the ring, counted from 0 among the slaves that are not optional.
    Position(u16),
    /// By its station alias (SII word 4).
    Alias(u16),
    /// By its name or order code in the SII; with several of one name the first that is not taken.
    Name(String),
}

impl fmt::Display for Location {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Position(position) => write!(f, "position {position}"),
            Self::Alias(alias) => write!(f, "alias {alias}"),
            Self::Name(name) => write!(f, "name \"{name}\""),
        }
    }
}

/// A slave that is expected.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SlaveSpec {
    /// Its name in the cell.
    pub name: String,
    /// Its location.
    pub location: Location,
    /// Vendor as in object 1018h:01; `None` takes any.
    pub vendor: Option<u32>,
    /// Product code as in object 1018h:02; `None` takes any.
    pub product: Option<u32>,
    /// Revision as in object 1018h:03; `None` takes any.
    pub revision: Option<u32>,
    /// It may be missing at start, and be connected or removed at any time (hot connect). Located by alias or name.
    pub optional: bool,
    /// Slaves of one group share a datagram and its working counter, 0 to 7.
    pub group: u8,
    /// Its goal: PRE-OP, SAFE-OP or OP, but not farther than the segment; or INIT or BOOT, without process data, whatever
    /// the goal of the segment is.
    pub goal: AlState,
    /// PDOs that it is to receive; `None` leaves what the slave has assigned.
    pub outputs: Option<Vec<PdoSpec>>,
    /// PDOs that it is to send; `None` leaves what the slave has assigned.
    pub inputs: Option<Vec<PdoSpec>>,
    /// Objects written in PRE-OP, in order, before PDOs are assigned.
    pub startup: Vec<StartupSdo>,
    /// Its SYNC signals; `None` for free run or synchronisation by frames.
    pub sync: Option<SyncSpec>,
    /// Process data watchdog; `None` leaves it at 100 ms, zero switches it off. Up to 6.5 s, in steps of 100 us.
    pub watchdog: Option<Duration>,
    /// Allows complete access where the SII announces it.
    pub complete_access: bool,
    /// Timeouts of this slave; `None` for the defaults.
    pub timeouts: Option<Timeouts>,
    /// Ethernet frames that it sends (EoE) are kept to be fetched, rather than left out.
    pub ethernet: bool,
}

impl SlaveSpec {
    /// A slave at a location, of any vendor, brought to OP with its defaults.
    pub fn new(name: impl Into<String>, location: Location) -> Self {
        Self {
            name: name.into(),
            location,
            vendor: None,
            product: None,
            revision: None,
            optional: false,
            group: 0,
            goal: AlState::Op,
            outputs: None,
            inputs: None,
            startup: Vec::new(),
            sync: None,
            watchdog: None,
            complete_access: true,
            timeouts: None,
            ethernet: false,
        }
    }
}

/// A PDO by its objects.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PdoSpec {
    /// 1600h or 1A00h and following.
    pub index: u16,
    /// Its entries; empty leaves the mapping unchanged.
    pub entries: Vec<Mapped>,
}

/// A start-up object.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StartupSdo {
    /// The object.
    pub address: Address,
    /// By complete access or entry by entry.
    pub whole: Whole,
    /// Its bytes, little-endian.
    pub data: Vec<u8>,
    /// Continue if the slave refuses it.
    pub may_fail: bool,
}

impl StartupSdo {
    /// Writes one entry, which must succeed.
    pub fn entry(address: Address, data: impl Into<Vec<u8>>) -> Self {
        Self {
            address,
            whole: Whole::Entry,
            data: data.into(),
            may_fail: false,
        }
    }
}

/// SYNC signals of a slave, as OpMode in its ESI.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SyncSpec {
    /// AssignActivate: 0300h SYNC0, 0700h SYNC0 and SYNC1.
    pub assign_activate: u16,
    /// Period of SYNC0.
    pub sync0: Duration,
    /// Delay of SYNC1 behind SYNC0; zero without SYNC1.
    pub sync1: Duration,
    /// Shift of SYNC0 after the start of the cycle, ns; negative is before.
    pub shift_ns: i32,
}

impl SyncSpec {
    /// AssignActivate for SYNC0.
    pub const SYNC0: u16 = 0x0300;
    /// AssignActivate for SYNC0 and SYNC1.
    pub const BOTH: u16 = 0x0700;

    /// SYNC0 in each cycle.
    pub const fn sync0(cycle: Duration) -> Self {
        Self {
            assign_activate: Self::SYNC0,
            sync0: cycle,
            sync1: Duration::ZERO,
            shift_ns: 0,
        }
    }
}

/// Why a configuration is invalid.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ConfigError {
    /// The cycle is zero or exceeds the SYNC registers.
    #[error("a cycle of {0:?}: write 50 us to 1 s")]
    Cycle(Duration),
    /// Too many slaves.
    #[error("{0} slaves are more than the {SLAVES_MAX} of one segment")]
    Slaves(usize),
    /// A group is not one of eight.
    #[error("slave \"{slave}\": group {group}; groups are 0 to 7")]
    Group {
        /// Its name.
        slave: String,
        /// The given value.
        group: u8,
    },
    /// A goal is no state to bring a slave or a segment to.
    #[error("slave \"{slave}\": goal {goal}; write PRE-OP, SAFE-OP or OP")]
    Goal {
        /// Its name, or "segment".
        slave: String,
        /// The given value.
        goal: AlState,
    },
    /// Two slaves have the same name or location.
    #[error("slaves \"{first}\" and \"{second}\" share {item}")]
    Twice {
        /// The earlier one.
        first: String,
        /// The later one.
        second: String,
        /// The shared name or location.
        item: String,
    },
    /// An optional slave cannot be recognised by its position.
    #[error("slave \"{0}\" is optional and located by position; locate it by alias or name")]
    OptionalPosition(String),
    /// A PDO has too many entries.
    #[error("slave \"{slave}\": {index:04X}h has {count} entries; {max} are possible")]
    Entries {
        /// Its name.
        slave: String,
        /// The PDO.
        index: u16,
        /// Entries given.
        count: usize,
        /// Entries possible.
        max: usize,
    },
}

impl MasterConfig {
    /// Checks what can be checked without a segment.
    pub fn check(&self) -> Result<(), ConfigError> {
        if !(Duration::from_micros(50)..=Duration::from_secs(1)).contains(&self.cycle) {
            return Err(ConfigError::Cycle(self.cycle));
        }
        if self.slaves.len() > SLAVES_MAX {
            return Err(ConfigError::Slaves(self.slaves.len()));
        }
        check_goal("segment", self.goal)?;
        for (number, slave) in self.slaves.iter().enumerate() {
            slave.check()?;
            for earlier in self.slaves.iter().take(number) {
                slave.check_against(earlier)?;
            }
        }
        Ok(())
    }
}

fn check_goal(slave: &str, goal: AlState) -> Result<(), ConfigError> {
    if matches!(goal, AlState::PreOp | AlState::SafeOp | AlState::Op) {
        return Ok(());
    }
    Err(ConfigError::Goal {
        slave: slave.to_owned(),
        goal,
    })
}

impl SlaveSpec {
    fn check(&self) -> Result<(), ConfigError> {
        let slave = || self.name.clone();
        if self.group > 7 {
            return Err(ConfigError::Group {
                slave: slave(),
                group: self.group,
            });
        }
        if !matches!(self.goal, AlState::Init | AlState::Boot) {
            check_goal(&self.name, self.goal)?;
        }
        if self.optional && matches!(self.location, Location::Position(_)) {
            return Err(ConfigError::OptionalPosition(slave()));
        }
        let pdos = [&self.outputs, &self.inputs];
        let long = pdos.into_iter().flatten().flatten();
        let max = takt_cia402::dictionary::MAPPED_MAX;
        match long.into_iter().find(|pdo| pdo.entries.len() > max) {
            Some(pdo) => Err(ConfigError::Entries {
                slave: slave(),
                index: pdo.index,
                count: pdo.entries.len(),
                max,
            }),
            None => Ok(()),
        }
    }

    fn check_against(&self, earlier: &Self) -> Result<(), ConfigError> {
        let item = if self.name == earlier.name {
            format!("the name \"{}\"", self.name)
        } else if self.location == earlier.location && !matches!(self.location, Location::Name(_)) {
            self.location.to_string()
        } else {
            return Ok(());
        };
        Err(ConfigError::Twice {
            first: earlier.name.clone(),
            second: self.name.clone(),
            item,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with(slaves: Vec<SlaveSpec>) -> String {
        let config = MasterConfig {
            slaves,
            ..MasterConfig::default()
        };
        config
            .check()
            .map_or_else(|e| e.to_string(), |()| "good".to_owned())
    }

    #[test]
    fn configuration_errors_are_each_reported() {
        let at = |name: &str, location| SlaveSpec::new(name, location);
        let first = at("a", Location::Position(0));
        assert_eq!(
            with(vec![first.clone(), at("b", Location::Alias(7))]),
            "good"
        );
        for (slaves, text) in [
            (
                vec![SlaveSpec {
                    group: 8,
                    ..first.clone()
                }],
                "group 8",
            ),
            (
                vec![SlaveSpec {
                    goal: AlState::Other(5),
                    ..first.clone()
                }],
                "goal ",
            ),
            (
                vec![SlaveSpec {
                    optional: true,
                    ..first.clone()
                }],
                "located by position",
            ),
            (
                vec![first.clone(), at("a", Location::Position(1))],
                "share the name \"a\"",
            ),
            (
                vec![first.clone(), at("b", Location::Position(0))],
                "share position 0",
            ),
            (
                vec![SlaveSpec {
                    outputs: Some(vec![PdoSpec {
                        index: 0x1600,
                        entries: vec![Mapped::default(); 65],
                    }]),
                    ..first.clone()
                }],
                "1600h has 65 entries",
            ),
            (
                (0..513)
                    .map(|n| at(&n.to_string(), Location::Position(n)))
                    .collect(),
                "513 slaves",
            ),
        ] {
            let message = with(slaves);
            assert!(message.contains(text), "{message}");
        }
        let cycle = Duration::from_micros(49);
        let config = MasterConfig {
            cycle,
            ..MasterConfig::default()
        };
        assert_eq!(config.check(), Err(ConfigError::Cycle(cycle)));
    }
}
