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
/// A default cell.
pub const CELL: &str = include_str!("../config/cell.toml");
/// Limits for users who run takt at a terminal.
pub const LIMITS: &str = include_str!("../limits/takt.conf");

/// A file and its installed path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InstalledFile {
    /// Absolute path on the host.
    pub path: &'static str,
    /// Content.
    pub text: &'static str,
}

/// All files of an installation except the program.
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
