//! CAN interfaces by netlink: what they are, and setting them up, with the reason when the kernel refuses.
//! It opens no socket for frames.

use std::fmt;
use std::fs;
use std::io;
use std::time::Duration;

use nix::net::if_::if_nametoindex;
use socketcan::nl::CanState;
use socketcan::{CanCtrlMode, CanInterface};

use super::netlink::{Change, Refusal, can};
use super::qdisc;
use crate::BusState;
use crate::bits::Rates;

/// What is to be set. What is `None` or false stays as it is.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Setup {
    /// Nominal bit rate in bit/s, up to 1,000,000.
    pub bitrate: Option<u32>,
    /// Sample point in tenths of a percent; without it the kernel takes what CiA recommends.
    pub sample_point: Option<u32>,
    /// Bit rate of CAN FD data in bit/s; switches CAN FD on.
    pub data_bitrate: Option<u32>,
    /// After this time a controller that is off the bus tries again; whole milliseconds.
    pub restart: Option<Duration>,
    /// Frames that may wait for being sent.
    pub queue: Option<u32>,
    /// Report each error on the bus, not only changes of state.
    pub report_errors: Option<bool>,
    /// Neither send nor acknowledge.
    pub listen_only: Option<bool>,
}

impl Setup {
    /// Whether something is asked for that a controller takes only while it is down.
    #[must_use]
    pub const fn needs_down(&self) -> bool {
        self.bitrate.is_some()
            || self.data_bitrate.is_some()
            || self.restart.is_some()
            || self.report_errors.is_some()
            || self.listen_only.is_some()
    }
}

/// One thing that is done while an interface is set up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// Asking for its state.
    Ask,
    /// Taking it down.
    Down,
    /// Setting the nominal bit rate.
    BitRate,
    /// Setting the bit rate of CAN FD data.
    DataBitRate,
    /// Switching modes of the controller.
    Modes,
    /// Setting the time of automatic restart.
    Restart,
    /// Setting the length of the send queue.
    Queue,
    /// Bringing it up.
    Up,
}

impl fmt::Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Ask => "ask for the state",
            Self::Down => "take it down",
            Self::BitRate => "set the bit rate",
            Self::DataBitRate => "set the bit rate of CAN FD data",
            Self::Modes => "set the controller's modes",
            Self::Restart => "set the automatic restart",
            Self::Queue => "set the length of the send queue",
            Self::Up => "bring it up",
        })
    }
}

/// Why an interface is not as it should be.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum InterfaceError {
    /// There is no such interface.
    #[error("there is no interface {name}; {present}")]
    Missing {
        /// As asked for.
        name: String,
        /// Which ones there are.
        present: Present,
    },
    /// It is something else.
    #[error("{name} is no CAN interface; {present}")]
    NotCan {
        /// As asked for.
        name: String,
        /// Which ones there are.
        present: Present,
    },
    /// The kernel refused a step.
    #[error("{name}: cannot {step}: {reason}")]
    Refused {
        /// The interface.
        name: String,
        /// What was refused.
        step: Step,
        /// Cause and remedy.
        reason: String,
    },
}

/// Names of the CAN interfaces of this host.
#[must_use]
pub fn interfaces() -> Vec<String> {
    Present::look().0
}

/// CAN interfaces of this host.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Present(pub Vec<String>);

impl Present {
    fn look() -> Self {
        let names = fs::read_dir("/sys/class/net").into_iter().flatten();
        let names = names.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
        let mut names: Vec<String> = names.filter(|name| is_can(name)).collect();
        names.sort();
        Self(names)
    }
}

impl fmt::Display for Present {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0.is_empty() {
            return f.write_str(
                "this host has no CAN interface: is the adapter plugged in and its driver loaded? One \
                 without hardware: modprobe vcan; ip link add vcan0 type vcan",
            );
        }
        write!(f, "CAN interfaces here: {}", self.0.join(", "))
    }
}

/// Hardware type of CAN interfaces.
const ARPHRD_CAN: &str = "280";

fn sysfs(name: &str, file: &str) -> Option<String> {
    let text = fs::read_to_string(format!("/sys/class/net/{name}/{file}")).ok()?;
    Some(text.trim().to_owned())
}

fn is_can(name: &str) -> bool {
    sysfs(name, "type").is_some_and(|kind| kind == ARPHRD_CAN)
}

/// What an interface is and how it is.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Details {
    /// Whether it is up.
    pub up: bool,
    /// Nominal bit rate in bit/s; a virtual interface has none.
    pub bitrate: Option<u32>,
    /// Sample point in tenths of a percent.
    pub sample_point: Option<u32>,
    /// Bit rate of CAN FD data in bit/s.
    pub data_bitrate: Option<u32>,
    /// State of the controller.
    pub state: Option<BusState>,
    /// Counters of transmit and receive errors.
    pub counters: Option<(u16, u16)>,
    /// After this time a controller that is off the bus tries again; zero: never.
    pub restart: Option<Duration>,
    /// Whether each error is reported.
    pub report_errors: bool,
    /// Whether it only listens.
    pub listen_only: bool,
    /// Whether CAN FD frames may be sent.
    pub fd: bool,
    /// The controller's clock in Hz.
    pub clock: Option<u32>,
    /// Frames that may wait for being sent.
    pub queue: Option<u32>,
    /// Received frames that the driver or the kernel dropped.
    pub receive_dropped: u64,
    /// Frames that were to be sent and that its queue or its driver refused.
    pub send_dropped: u64,
}

impl Details {
    /// Whether it has no controller that could be set up.
    #[must_use]
    pub const fn is_virtual(&self) -> bool {
        self.state.is_none() && self.bitrate.is_none()
    }

    /// Its bit rates, if it has any.
    #[must_use]
    pub fn rates(&self) -> Option<Rates> {
        let nominal = self.bitrate.filter(|rate| *rate > 0)?;
        Some(Rates {
            nominal,
            data: self
                .data_bitrate
                .filter(|rate| *rate > 0)
                .unwrap_or(nominal),
        })
    }
}

/// A CAN interface.
#[derive(Debug)]
pub struct Interface {
    name: String,
    index: u32,
    netlink: CanInterface,
}

impl Interface {
    /// The interface of that name.
    ///
    /// # Errors
    /// If there is none, or it is no CAN interface.
    pub fn open(name: &str) -> Result<Self, InterfaceError> {
        let missing = |_| InterfaceError::Missing {
            name: name.to_owned(),
            present: Present::look(),
        };
        let index = if_nametoindex(name).map_err(missing)?;
        if !is_can(name) {
            return Err(InterfaceError::NotCan {
                name: name.to_owned(),
                present: Present::look(),
            });
        }
        Ok(Self {
            name: name.to_owned(),
            index,
            netlink: CanInterface::open_iface(index),
        })
    }

    /// How it is at present.
    ///
    /// # Errors
    /// If the kernel does not tell.
    pub fn details(&self) -> Result<Details, InterfaceError> {
        let told = self.netlink.details();
        let told = told.map_err(|error| InterfaceError::Refused {
            name: self.name.clone(),
            step: Step::Ask,
            reason: error.to_string(),
        })?;
        let has = |mode| told.can.ctrl_mode.is_some_and(|modes| modes.has_mode(mode));
        let number = |file| sysfs(&self.name, file)?.parse::<u64>().ok();
        let timing = told.can.bit_timing.filter(|timing| timing.bitrate > 0);
        Ok(Details {
            up: told.is_up,
            bitrate: timing.map(|timing| timing.bitrate),
            sample_point: timing.map(|timing| timing.sample_point),
            data_bitrate: told
                .can
                .data_bit_timing
                .map(|t| t.bitrate)
                .filter(|r| *r > 0),
            state: told.can.state.map(bus_state),
            counters: told.can.berr_counter.map(|c| (c.txerr, c.rxerr)),
            restart: told
                .can
                .restart_ms
                .map(|ms| Duration::from_millis(ms.into())),
            report_errors: has(CanCtrlMode::BerrReporting),
            listen_only: has(CanCtrlMode::ListenOnly),
            fd: has(CanCtrlMode::Fd),
            clock: told.can.clock.map(|clock| clock.freq),
            queue: number("tx_queue_len").and_then(|len| len.try_into().ok()),
            receive_dropped: number("statistics/rx_dropped").unwrap_or(0)
                + number("statistics/rx_over_errors").unwrap_or(0),
            send_dropped: number("statistics/tx_dropped").unwrap_or(0)
                + u64::from(qdisc::refused(self.index).unwrap_or(0)),
        })
    }

    /// Sets the interface up and brings it up; returns what had to be done.
    ///
    /// # Errors
    /// Names the step that was refused, the cause and the remedy. Steps before it stay done.
    pub fn set_up(&self, setup: &Setup) -> Result<Vec<Step>, InterfaceError> {
        let details = self.details()?;
        if details.is_virtual() && setup.needs_down() {
            // Known before anything is taken down.
            let refusal = Refusal {
                errno: libc::EOPNOTSUPP,
                text: None,
            };
            return Err(self.refused(Step::BitRate, &refusal, &details));
        }
        let mut done = Vec::new();
        for (step, change) in self.changes(setup, details.up) {
            let result = change.request();
            result.map_err(|refusal| self.refused(step, &refusal, &details))?;
            done.push(step);
        }
        Ok(done)
    }

    /// What has to be done, in this order.
    fn changes(&self, setup: &Setup, is_up: bool) -> Vec<(Step, Change)> {
        let index = self.index;
        let down = is_up && setup.needs_down();
        let down = down.then(|| (Step::Down, Change::up(index, false)));
        let set = |step, kind, numbers: Option<Vec<u32>>| {
            numbers.map(|numbers| (step, Change::can(index, kind, &numbers)))
        };
        let nominal = setup.bitrate.map(|rate| timing(rate, setup.sample_point));
        let data = setup.data_bitrate.map(|rate| timing(rate, None));
        let restart = setup
            .restart
            .map(|restart| vec![u32::try_from(restart.as_millis()).unwrap_or(u32::MAX)]);
        let queue = setup
            .queue
            .map(|frames| (Step::Queue, Change::queue(index, frames)));
        [
            down,
            set(Step::BitRate, can::BIT_TIMING, nominal),
            set(Step::Modes, can::MODES, modes(setup)),
            set(Step::DataBitRate, can::DATA_BIT_TIMING, data),
            set(Step::Restart, can::RESTART_MS, restart),
            queue,
            Some((Step::Up, Change::up(index, true))),
        ]
        .into_iter()
        .flatten()
        .collect()
    }

    /// Brings a controller that is off the bus back at once.
    ///
    /// # Errors
    /// As [`Interface::set_up`]; also if it is not off the bus.
    pub fn restart(&self) -> Result<(), InterfaceError> {
        let details = self.details()?;
        let result = Change::can(self.index, can::RESTART, &[1]).request();
        result.map_err(|refusal| self.refused(Step::Restart, &refusal, &details))
    }

    fn refused(&self, step: Step, refusal: &Refusal, details: &Details) -> InterfaceError {
        let reason = reason(step, refusal.errno, details);
        InterfaceError::Refused {
            name: self.name.clone(),
            step,
            reason: match &refusal.text {
                Some(text) => format!("{reason} (kernel: {text})"),
                None => reason,
            },
        }
    }
}

/// Bit rate and sample point; the kernel computes the other six numbers.
fn timing(bitrate: u32, sample_point: Option<u32>) -> Vec<u32> {
    vec![bitrate, sample_point.unwrap_or(0), 0, 0, 0, 0, 0, 0]
}

/// Which modes to change, and which of them to switch on.
fn modes(setup: &Setup) -> Option<Vec<u32>> {
    let wanted = [
        (CanCtrlMode::Fd, setup.data_bitrate.map(|_| true)),
        (CanCtrlMode::BerrReporting, setup.report_errors),
        (CanCtrlMode::ListenOnly, setup.listen_only),
    ];
    let (mut mask, mut flags) = (0, 0);
    for (mode, on) in wanted {
        mask |= on.map_or(0, |_| mode.mask());
        flags |= on.map_or(0, |on| if on { mode.mask() } else { 0 });
    }
    (mask != 0).then(|| vec![mask, flags])
}

const fn bus_state(state: CanState) -> BusState {
    match state {
        CanState::ErrorActive => BusState::ErrorActive,
        CanState::ErrorWarning => BusState::ErrorWarning,
        CanState::ErrorPassive => BusState::ErrorPassive,
        CanState::BusOff => BusState::BusOff,
        CanState::Stopped | CanState::Sleeping => BusState::Stopped,
    }
}

/// What a refusal means, and what to do about it.
fn reason(step: Step, errno: i32, details: &Details) -> String {
    let system = io::Error::from_raw_os_error(errno);
    match (errno, step) {
        (libc::EPERM | libc::EACCES | libc::EROFS, _) => {
            "only root may; run it with sudo, or give it the capability CAP_NET_ADMIN".to_owned()
        }
        (libc::ENODEV | libc::ENXIO, _) => "it is gone; is the adapter unplugged?".to_owned(),
        (libc::EOPNOTSUPP, _) if details.is_virtual() => {
            "it is virtual and has no controller to set; bring it up without these options"
                .to_owned()
        }
        (libc::EOPNOTSUPP, Step::Modes | Step::DataBitRate) => {
            "its controller or driver cannot do that; leave out the mode or take another adapter"
                .to_owned()
        }
        (libc::EBUSY, _) => {
            "it is up, and somebody brought it up meanwhile; is another program setting it up?"
                .to_owned()
        }
        (libc::EINVAL, Step::Up) if details.bitrate.is_none() && !details.is_virtual() => {
            "no bit rate is set; give the one that the nodes have (--bitrate)".to_owned()
        }
        (libc::EINVAL | libc::EDOM | libc::ERANGE, Step::BitRate | Step::DataBitRate) => {
            let clock = details.clock.map_or_else(String::new, |clock| {
                format!(" of {} MHz", f64::from(clock) / 1e6)
            });
            format!(
                "the controller's clock{clock} cannot be divided to this bit rate and sample point; CiA 301 \
                 has 10, 20, 50, 125, 250, 500, 800 and 1000 kbit/s, sample point 87.5 %"
            )
        }
        _ => system.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hardware() -> Details {
        Details {
            state: Some(BusState::Stopped),
            clock: Some(8_000_000),
            ..Details::default()
        }
    }

    #[test]
    fn a_refusal_has_its_cause_and_remedy() {
        for (step, errno, details, words) in [
            (Step::Down, libc::EPERM, hardware(), "sudo"),
            (Step::Queue, libc::EROFS, hardware(), "sudo"),
            (Step::Up, libc::ENODEV, hardware(), "unplugged"),
            (
                Step::BitRate,
                libc::EOPNOTSUPP,
                Details::default(),
                "virtual",
            ),
            (
                Step::Modes,
                libc::EOPNOTSUPP,
                hardware(),
                "leave out the mode",
            ),
            (Step::BitRate, libc::EBUSY, hardware(), "another program"),
            (Step::Up, libc::EINVAL, hardware(), "--bitrate"),
            (Step::BitRate, libc::EDOM, hardware(), "clock of 8 MHz"),
            (Step::Up, libc::ENOMEM, hardware(), "allocate memory"),
        ] {
            let text = reason(step, errno, &details);
            assert!(text.contains(words), "{step:?} {errno}: {text}");
        }
    }

    #[test]
    fn an_interface_that_is_not_there_is_named_with_those_that_are() {
        let error = Interface::open("nosuchcan0").unwrap_err();
        assert!(
            error
                .to_string()
                .starts_with("there is no interface nosuchcan0; ")
        );
        let error = Interface::open("lo").unwrap_err();
        assert!(error.to_string().starts_with("lo is no CAN interface; "));
        assert!(Present::default().to_string().contains("modprobe vcan"));
        let two = Present(vec!["can0".to_owned(), "can1".to_owned()]);
        assert_eq!(two.to_string(), "CAN interfaces here: can0, can1");
    }

    #[test]
    fn only_what_is_asked_for_is_set() {
        assert!(modes(&Setup::default()).is_none());
        assert!(!Setup::default().needs_down());
        let setup = Setup {
            data_bitrate: Some(2_000_000),
            listen_only: Some(false),
            ..Setup::default()
        };
        let (fd, listen) = (CanCtrlMode::Fd.mask(), CanCtrlMode::ListenOnly.mask());
        assert_eq!(modes(&setup), Some(vec![fd | listen, fd]));
        assert!(setup.needs_down());
        let queue = Setup {
            queue: Some(1000),
            ..Setup::default()
        };
        assert!(
            !queue.needs_down(),
            "the queue can be changed while it is up"
        );
    }

    #[test]
    fn rates_of_data_default_to_the_nominal_ones() {
        let details = Details {
            bitrate: Some(500_000),
            ..Details::default()
        };
        assert_eq!(details.rates(), Some(Rates::classic(500_000)));
        assert_eq!(Details::default().rates(), None);
        assert!(Details::default().is_virtual() && !details.is_virtual());
    }
}
