//! Faults of network interfaces, with the causes and remedies of the drivers. It changes no interface.

use std::io;

use anyhow::{anyhow, bail};
use takt_rt::interface::{Interface, LinkFault, Medium};

/// The present fault of an interface, if any.
pub(crate) fn fault(interface: &str) -> Option<LinkFault> {
    Interface::open(interface).map_or(Some(LinkFault::Missing), |interface| interface.fault())
}

/// Refuses to begin where none of these carries frames; of a ring one is enough.
///
/// # Errors
/// With the cause and the remedy of the first.
pub(crate) fn ready<'i>(
    interfaces: impl IntoIterator<Item = &'i str>,
    medium: Medium,
) -> anyhow::Result<()> {
    let mut first = None;
    for interface in interfaces {
        match fault(interface) {
            None => return Ok(()),
            Some(fault) => first = first.or(Some((interface, fault))),
        }
    }
    match first {
        Some((interface, fault)) => bail!("{}", fault.on(interface, medium)),
        None => Ok(()),
    }
}

/// An error of an interface that is in use, with its cause and remedy.
pub(crate) fn failed(interface: &str, medium: Medium, error: io::Error) -> anyhow::Error {
    match error.raw_os_error() {
        Some(errno) => {
            let fault = LinkFault::of_errno(errno);
            anyhow!("{}", fault.on(interface, medium))
        }
        None => anyhow::Error::new(error).context(format!("{interface}: the interface failed")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn error_numbers_become_cause_and_remedy() {
        let down = io::Error::from_raw_os_error(nix::libc::ENETDOWN);
        let text = format!("{:#}", failed("eth1", Medium::Ethernet, down));
        assert!(text.contains("Network is down"), "{text}");
        assert!(text.ends_with("hint: `ip link set eth1 up`"), "{text}");
        let other = io::Error::other("cut");
        let text = format!("{:#}", failed("eth1", Medium::Ethernet, other));
        assert_eq!(text, "eth1: the interface failed: cut");
    }

    #[test]
    fn one_end_that_works_is_enough() {
        assert!(ready(["nowhere0", "lo"], Medium::Ethernet).is_ok());
        let error = ready(["nowhere0", "nowhere1"], Medium::Ethernet).unwrap_err();
        assert!(
            error.to_string().starts_with("nowhere0: no such interface"),
            "{error}"
        );
    }
}
