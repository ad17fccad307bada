//! CAN interfaces by netlink: state and configuration, with the reason when the kernel rejects a change. It opens no
//! socket for frames.

use std::fmt;
use std::fs;
use std::io;
use std::time::Duration;

use nix::net::if_::if_nametoindex;
use socketcan::nl::CanState;
use socketcan::{CanCtrlMode, CanInterface};

use super::netlink::{Change, KernelError, can};
use super::qdisc;
use crate::BusState;
use crate::bits::Rates;

/// Settings to change. `None` or false leaves a setting unchanged.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Setup {
    /// Nominal bit rate in bit/s, up to 1,000,000.
    pub bitrate: Option<u32>,
    /// Sample point in tenths of a percent; by default the kernel uses the value recommended by
    /// CiA.
    pub sample_point: Option<u32>,
    /// CAN FD data bit rate in bit/s; enables CAN FD.
    pub data_bitrate: Option<u32>,
    /// Delay of the automatic restart after bus-off, whole milliseconds.
    pub restart: Option<Duration>,
    /// Length of the send queue, frames.
    pub queue: Option<u32>,
    /// Report every bus error, not only state changes.
    pub report_errors: Option<bool>,
    /// Listen-only mode: neither send nor acknowledge.
    pub listen_only: Option<bool>,
}

impl Setup {
    /// Whether a requested setting can only change while the interface is down.
    pub(crate) const fn needs_down(&self) -> bool {
        self.bitrate.is_some()
            || self.data_bitrate.is_some()
            || self.restart.is_some()
            || self.report_errors.is_some()
            || self.listen_only.is_some()
    }
}

/// A step of the interface configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// Reading its state.
    ReadState,
    /// Taking it down.
    Down,
    /// Setting the nominal bit rate.
    BitRate,
    /// Setting the CAN FD data bit rate.
    DataBitRate,
    /// Setting the controller's modes.
    Modes,
    /// Setting the automatic restart.
    Restart,
    /// Setting the length of the send queue.
    Queue,
    /// Bringing it up.
    Up,
}

impl fmt::Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::ReadState => "read the state",
            Self::Down => "take it down",
            Self::BitRate => "set the bit rate",
            Self::DataBitRate => "set the CAN FD data bit rate",
            Self::Modes => "set the controller's modes",
            Self::Restart => "set the automatic restart",
            Self::Queue => "set the length of the send queue",
            Self::Up => "bring it up",
        })
    }
}

/// Errors of the interface configuration.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum InterfaceError {
    /// There is no such interface.
    #[error("there is no interface {name}; {present}")]
    Missing {
        /// The requested name.
        name: String,
        /// The CAN interfaces of this host.
        present: Present,
    },
    /// The interface is not a CAN interface.
    #[error("{name} is not a CAN interface; {present}")]
    NotCan {
        /// The requested name.
        name: String,
        /// The CAN interfaces of this host.
        present: Present,
    },
    /// The kernel rejected a step.
    #[error("{name}: cannot {step}: {reason}")]
    Refused {
        /// The interface.
        name: String,
        /// The rejected step.
        step: Step,
        /// Cause and remedy.
        reason: String,
    },
}

/// Names of the CAN interfaces of this host.
pub fn interfaces() -> Vec<String> {
    Present::list().0
}

/// CAN interfaces of this host.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Present(pub Vec<String>);

impl Present {
    fn list() -> Self {
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

/// State and settings of an interface.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Details {
    /// Whether it is up.
    pub up: bool,
    /// Nominal bit rate in bit/s; a virtual interface has none.
    pub bitrate: Option<u32>,
    /// Sample point in tenths of a percent.
    pub sample_point: Option<u32>,
    /// CAN FD data bit rate in bit/s.
    pub data_bitrate: Option<u32>,
    /// Controller state.
    pub state: Option<BusState>,
    /// Transmit and receive error counters.
    pub counters: Option<(u16, u16)>,
    /// Delay of the automatic restart after bus-off; zero: never.
    pub restart: Option<Duration>,
    /// Whether every bus error is reported.
    pub report_errors: bool,
    /// Whether it is in listen-only mode.
    pub listen_only: bool,
    /// Whether CAN FD is enabled.
    pub fd: bool,
    /// Controller clock in Hz.
    pub clock: Option<u32>,
    /// Length of the send queue, frames.
    pub queue: Option<u32>,
    /// Received frames dropped by the driver or the kernel.
    pub receive_dropped: u64,
    /// Frames to send that the queue or the driver dropped.
    pub send_dropped: u64,
}

impl Details {
    /// Whether it is virtual, without a controller.
    pub const fn is_virtual(&self) -> bool {
        self.state.is_none() && self.bitrate.is_none()
    }

    /// Its bit rates, if set.
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

/// The nominal bit rate of an interface, bit/s; `None` if it has none, as a virtual one, or does not exist.
#[must_use]
pub fn bit_rate(name: &str) -> Option<u32> {
    let details = Interface::open(name).ok()?.details().ok()?;
    details.rates().map(|rates| rates.nominal)
}

/// A CAN interface.
#[derive(Debug)]
pub struct Interface {
    name: String,
    index: u32,
    netlink: CanInterface,
}

impl Interface {
    /// Opens the interface of that name.
    pub fn open(name: &str) -> Result<Self, InterfaceError> {
        let missing = |_| InterfaceError::Missing {
            name: name.to_owned(),
            present: Present::list(),
        };
        let index = if_nametoindex(name).map_err(missing)?;
        if !is_can(name) {
            return Err(InterfaceError::NotCan {
                name: name.to_owned(),
                present: Present::list(),
            });
        }
        Ok(Self {
            name: name.to_owned(),
            index,
            netlink: CanInterface::open_iface(index),
        })
    }

    /// Reads its current state.
    pub fn details(&self) -> Result<Details, InterfaceError> {
        let info = self.netlink.details();
        let info = info.map_err(|error| InterfaceError::Refused {
            name: self.name.clone(),
            step: Step::ReadState,
            reason: error.to_string(),
        })?;
        let has = |mode| info.can.ctrl_mode.is_some_and(|modes| modes.has_mode(mode));
        let number = |file| sysfs(&self.name, file)?.parse::<u64>().ok();
        let timing = info.can.bit_timing.filter(|timing| timing.bitrate > 0);
        Ok(Details {
            up: info.is_up,
            bitrate: timing.map(|timing| timing.bitrate),
            sample_point: timing.map(|timing| timing.sample_point),
            data_bitrate: info
                .can
                .data_bit_timing
                .map(|t| t.bitrate)
                .filter(|r| *r > 0),
            state: info.can.state.map(bus_state),
            counters: info.can.berr_counter.map(|c| (c.txerr, c.rxerr)),
            restart: info
                .can
                .restart_ms
                .map(|ms| Duration::from_millis(ms.into())),
            report_errors: has(CanCtrlMode::BerrReporting),
            listen_only: has(CanCtrlMode::ListenOnly),
            fd: has(CanCtrlMode::Fd),
            clock: info.can.clock.map(|clock| clock.freq),
            queue: number("tx_queue_len").and_then(|len| len.try_into().ok()),
            receive_dropped: number("statistics/rx_dropped").unwrap_or(0)
                + number("statistics/rx_over_errors").unwrap_or(0),
            send_dropped: number("statistics/tx_dropped").unwrap_or(0)
                + u64::from(qdisc::refused(self.index).unwrap_or(0)),
        })
    }

    /// Configures the interface and brings it up; returns the executed steps.
    ///
    /// # Errors
    /// Names the rejected step, the cause and the remedy. Earlier steps are not undone.
    pub fn set_up(&self, setup: &Setup) -> Result<Vec<Step>, InterfaceError> {
        let details = self.details()?;
        if details.is_virtual() && setup.needs_down() {
            // Check this before the interface goes down.
            let error = KernelError {
                errno: libc::EOPNOTSUPP,
                text: None,
            };
            return Err(self.refused(Step::BitRate, &error, &details));
        }
        let mut done = Vec::new();
        for (step, change) in self.changes(setup, details.up) {
            let result = change.request();
            result.map_err(|error| self.refused(step, &error, &details))?;
            done.push(step);
        }
        Ok(done)
    }

    /// The necessary steps, in this order.
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

    /// Restarts a controller that is bus-off.
    ///
    /// # Errors
    /// As [`Interface::set_up`]; also if it is not bus-off.
    pub fn restart(&self) -> Result<(), InterfaceError> {
        let details = self.details()?;
        let result = Change::can(self.index, can::RESTART, &[1]).request();
        result.map_err(|error| self.refused(Step::Restart, &error, &details))
    }

    fn refused(&self, step: Step, error: &KernelError, details: &Details) -> InterfaceError {
        let reason = reason(step, error.errno, details);
        InterfaceError::Refused {
            name: self.name.clone(),
            step,
            reason: match &error.text {
                Some(text) => format!("{reason} (kernel: {text})"),
                None => reason,
            },
        }
    }
}

/// Bit rate and sample point; the kernel computes the other six values.
fn timing(bitrate: u32, sample_point: Option<u32>) -> Vec<u32> {
    vec![bitrate, sample_point.unwrap_or(0), 0, 0, 0, 0, 0, 0]
}

/// Mask of the modes to change, and their new values.
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

/// Cause and remedy of a kernel error.
fn reason(step: Step, errno: i32, details: &Details) -> String {
    let system = io::Error::from_raw_os_error(errno);
    match (errno, step) {
        (libc::EPERM | libc::EACCES | libc::EROFS, _) => {
            "permission denied; run it with sudo, or grant the capability CAP_NET_ADMIN".to_owned()
        }
        (libc::ENODEV | libc::ENXIO, _) => "the interface was removed; is the adapter unplugged?".to_owned(),
        (libc::EOPNOTSUPP, _) if details.is_virtual() => {
            "it is virtual and has no controller to configure; bring it up without these options"
                .to_owned()
        }
        (libc::EOPNOTSUPP, Step::Modes | Step::DataBitRate) => {
            "its controller or driver does not support this; leave out the mode or use another adapter"
                .to_owned()
        }
        (libc::EBUSY, _) => {
            "it is up, although it was taken down before; is another program configuring it?"
                .to_owned()
        }
        (libc::EINVAL, Step::Up) if details.bitrate.is_none() && !details.is_virtual() => {
            "no bit rate is set; set the bit rate of the nodes (--bitrate)".to_owned()
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
    fn interface_rejected_step_has_cause_and_remedy() {
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
    fn interface_missing_error_lists_present_ones() {
        let error = Interface::open("nosuchcan0").unwrap_err();
        assert!(
            error
                .to_string()
                .starts_with("there is no interface nosuchcan0; ")
        );
        let error = Interface::open("lo").unwrap_err();
        assert!(error.to_string().starts_with("lo is not a CAN interface; "));
        assert!(Present::default().to_string().contains("modprobe vcan"));
        let two = Present(vec!["can0".to_owned(), "can1".to_owned()]);
        assert_eq!(two.to_string(), "CAN interfaces here: can0, can1");
    }

    #[test]
    fn interface_sets_only_requested_settings() {
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
            "the queue length can change while it is up"
        );
    }

    #[test]
    fn interface_data_rate_defaults_to_nominal() {
        let details = Details {
            bitrate: Some(500_000),
            ..Details::default()
        };
        assert_eq!(details.rates(), Some(Rates::classic(500_000)));
        assert_eq!(Details::default().rates(), None);
        assert!(Details::default().is_virtual() && !details.is_virtual());
    }
}
