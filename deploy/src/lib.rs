#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

/// The systemd unit.
pub const SERVICE: &str = include_str!("../systemd/takt.service");
/// The account the service runs as.
pub const SYSUSERS: &str = include_str!("../sysusers/takt.conf");
/// Access to the processors' latency control.
pub const UDEV_RULES: &str = include_str!("../udev/60-takt.rules");
/// Kernel settings.
pub const SYSCTL: &str = include_str!("../sysctl/60-takt.conf");
/// A cell to begin with.
pub const CELL: &str = include_str!("../config/cell.toml");
/// Limits of people who run takt at a terminal.
pub const LIMITS: &str = include_str!("../limits/takt.conf");

/// A file and the place it is installed at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InstalledFile {
    /// Absolute, on the host.
    pub path: &'static str,
    /// All of it.
    pub text: &'static str,
}

/// Everything an installation puts in place beside the program.
pub const FILES: [InstalledFile; 6] = [
    InstalledFile {
        path: "/usr/lib/systemd/system/takt.service",
        text: SERVICE,
    },
    InstalledFile {
        path: "/usr/lib/sysusers.d/takt.conf",
        text: SYSUSERS,
    },
    InstalledFile {
        path: "/usr/lib/udev/rules.d/60-takt.rules",
        text: UDEV_RULES,
    },
    InstalledFile {
        path: "/usr/lib/sysctl.d/60-takt.conf",
        text: SYSCTL,
    },
    InstalledFile {
        path: "/etc/takt/cell.toml",
        text: CELL,
    },
    InstalledFile {
        path: "/etc/security/limits.d/takt.conf",
        text: LIMITS,
    },
];
