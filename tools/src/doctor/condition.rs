//! A condition: a name, why it matters, and a function from a host to a finding. The tables are in the modules of the
//! groups; a new condition is a row and its function there. Nothing here reads or changes a host.

use super::host::Host;

/// The result of a condition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Status {
    Ok,
    /// Cycles run, but later or less surely than they could.
    Warn,
    /// Cycles do not run as they must.
    Fail,
    /// The subject of the condition does not exist here, or cannot be read.
    Skip,
}

impl Status {
    /// As in the report and in JSON.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Warn => "WARN",
            Self::Fail => "FAIL",
            Self::Skip => "skip",
        }
    }

    pub(super) fn is_bad(self) -> bool {
        matches!(self, Self::Warn | Self::Fail)
    }
}

/// What fixes a condition.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Remedy {
    None,
    /// A line for a shell.
    Command(String),
    /// Instructions for a person.
    Advice(String),
}

impl Remedy {
    pub(super) fn text(&self) -> &str {
        match self {
            Self::None => "",
            Self::Command(text) | Self::Advice(text) => text,
        }
    }
}

/// A setting of the running system that would fix a condition.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Change {
    pub(super) path: String,
    pub(super) new: String,
}

/// The result of a check.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Finding {
    pub(super) status: Status,
    /// The value read; for a skipped condition, the reason.
    pub(super) read: String,
    pub(super) remedy: Remedy,
    pub(super) changes: Vec<Change>,
}

impl Finding {
    fn new(status: Status, read: impl Into<String>, remedy: Remedy) -> Self {
        Self {
            status,
            read: read.into(),
            remedy,
            changes: Vec::new(),
        }
    }

    pub(super) fn ok(read: impl Into<String>) -> Self {
        Self::new(Status::Ok, read, Remedy::None)
    }

    pub(super) fn skip(reason: impl Into<String>) -> Self {
        Self::new(Status::Skip, reason, Remedy::None)
    }

    pub(super) fn warn(read: impl Into<String>, remedy: Remedy) -> Self {
        Self::new(Status::Warn, read, remedy)
    }

    pub(super) fn fail(read: impl Into<String>, remedy: Remedy) -> Self {
        Self::new(Status::Fail, read, remedy)
    }

    /// The same, fixed by writing these.
    pub(super) fn with_changes(mut self, changes: Vec<Change>) -> Self {
        self.changes = changes;
        self
    }

    /// A warning about one setting: the remedy and the change are the same write.
    pub(super) fn warn_setting(
        read: impl Into<String>,
        path: &str,
        new: impl Into<String>,
    ) -> Self {
        let new = new.into();
        Self::warn(read, setting(path, &new)).with_changes(vec![change(path, new)])
    }
}

pub(super) fn command(text: impl Into<String>) -> Remedy {
    Remedy::Command(text.into())
}

pub(super) fn advice(text: impl Into<String>) -> Remedy {
    Remedy::Advice(text.into())
}

/// The parameters to add to the kernel's command line.
pub(super) fn boot_with(parameters: impl AsRef<str>) -> Remedy {
    advice(format!(
        "boot with `{}` (GRUB_CMDLINE_LINUX in /etc/default/grub, then update-grub)",
        parameters.as_ref()
    ))
}

pub(super) fn change(path: impl Into<String>, new: impl Into<String>) -> Change {
    Change {
        path: path.into(),
        new: new.into(),
    }
}

/// The command that writes a setting of the kernel.
fn setting(path: &str, value: &str) -> Remedy {
    command(match path.strip_prefix("/proc/sys/") {
        Some(name) => format!("sysctl -w {}={value}", name.replace('/', ".")),
        None => format!("echo {value} > {path}"),
    })
}

/// The subject of a condition.
#[derive(Clone, Copy, Debug)]
pub(super) enum Check {
    Host(fn(&Host) -> Finding),
    /// Once per network adapter.
    Nic(fn(&Host, &str) -> Finding),
    /// Once per CAN interface.
    Can(fn(&Host, &str) -> Finding),
}

/// A row of the tables.
#[derive(Clone, Copy, Debug)]
pub(super) struct Condition {
    pub(super) name: &'static str,
    pub(super) why: &'static str,
    pub(super) check: Check,
}

impl Condition {
    pub(super) const fn host(
        name: &'static str,
        check: fn(&Host) -> Finding,
        why: &'static str,
    ) -> Self {
        let check = Check::Host(check);
        Self { name, why, check }
    }

    pub(super) const fn nic(
        name: &'static str,
        check: fn(&Host, &str) -> Finding,
        why: &'static str,
    ) -> Self {
        let check = Check::Nic(check);
        Self { name, why, check }
    }

    pub(super) const fn can(
        name: &'static str,
        check: fn(&Host, &str) -> Finding,
        why: &'static str,
    ) -> Self {
        let check = Check::Can(check);
        Self { name, why, check }
    }
}
