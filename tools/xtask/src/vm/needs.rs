//! Requirements of machines, installed from Debian's and Python's registries if missing. On other systems, or without
//! root, nothing is installed and the missing requirement is reported.

use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use super::{Availability, Unavailable};
use crate::cargo;
use crate::shell::{self, Line};

/// Debian packages of every machine.
pub(super) const MACHINE: &[&str] = &["linux-image-rt-amd64", "qemu-system-x86"];
/// Debian packages of a machine with the host's files.
pub(super) const GUEST: &[&str] = &["busybox-static", "iproute2", "kmod"];
/// Debian packages of a machine with a Debian of its own.
pub(super) const SERVICE: &[&str] = &["debootstrap", "e2fsprogs"];

/// Installs those packages that are missing.
pub(crate) fn packages(names: &[&str]) -> Availability<()> {
    let missing: Vec<&str> = names
        .iter()
        .copied()
        .filter(|name| !is_installed(name))
        .collect();
    if missing.is_empty() {
        return Ok(Ok(()));
    }
    let list = missing.join(" ");
    if !is_debian(&std::fs::read_to_string("/etc/os-release").unwrap_or_default()) {
        return Ok(Err(Unavailable(format!(
            "needs Debian or the like for {list}"
        ))));
    }
    if !is_root() {
        return Ok(Err(Unavailable(format!(
            "needs root to apt-get install {list}"
        ))));
    }
    // Another apt may be running.
    let apt = || Line::new("apt-get").args(["--quiet", "--quiet", "-o", "DPkg::Lock::Timeout=600"]);
    let install = apt()
        .args(["install", "--yes", "--no-install-recommends"])
        .args(&missing);
    let install = install.env("DEBIAN_FRONTEND", "noninteractive");
    if apt().arg("update").succeeds()? && install.succeeds()? {
        Ok(Ok(()))
    } else {
        Ok(Err(Unavailable(format!(
            "needs {list}, and apt-get cannot install it"
        ))))
    }
}

fn is_installed(package: &str) -> bool {
    let query = ["--show", "--showformat=${db:Status-Status}", package];
    let output = Command::new("dpkg-query").args(query).output();
    output.is_ok_and(|output| output.stdout == b"installed")
}

fn is_debian(os_release: &str) -> bool {
    os_release.lines().any(|line| {
        let (name, value) = line.split_once('=').unwrap_or_default();
        let mut words = value.trim_matches('"').split(' ');
        matches!(name, "ID" | "ID_LIKE") && words.any(|word| word == "debian")
    })
}

/// Whether this process has root rights.
pub(crate) fn is_root() -> bool {
    std::fs::metadata("/proc/self").is_ok_and(|process| process.uid() == 0)
}

/// virtme-ng: the installed one, or one in the target directory.
pub(super) fn vng(root: &Path) -> Availability<PathBuf> {
    if shell::exists("vng") {
        return Ok(Ok(PathBuf::from("vng")));
    }
    Ok(python(root)?.map(|python| python.with_file_name("vng")))
}

/// Debian packages of the tests' peers and monitors on a bus.
const PEERS: &[&str] = &[
    "can-utils",
    "gcc",
    "iproute2",
    "iputils-ping",
    "libpcap-dev",
    "tshark",
];
/// Modules of our own Python environment: virtme-ng, and the tests' peers.
const MODULES: [&str; 3] = ["virtme-ng~=1.42", "python-can~=4.0", "canopen~=2.0"];
/// EtherCAT masters, from the lists that users install too: those with wheels, and those that are built here with
/// [`PEERS`].
const MASTERS: &str = include_str!("../../../../ethercat/tests/peers/requirements.txt");
const BUILT: &str = include_str!("../../../../ethercat/tests/peers/requirements-built.txt");

/// Installs the browser that tests of the page use. These report a missing one themselves.
pub(crate) fn browser() -> anyhow::Result<()> {
    let report =
        |Unavailable(why)| cargo::note(&format!("tests of the page miss a browser: {why}"));
    packages(&["chromium"])?.unwrap_or_else(report);
    Ok(())
}

/// Installs the tests' peers; returns the Python that has their modules. Tests report missing peers themselves.
pub(crate) fn peers(root: &Path) -> anyhow::Result<Option<PathBuf>> {
    let report = |Unavailable(why)| cargo::note(&format!("tests on a bus miss peers: {why}"));
    packages(PEERS)?.unwrap_or_else(report);
    Ok(python(root)?.map_err(report).ok())
}

/// A Python in a virtual environment of our own, as Debian's is externally managed.
fn python(root: &Path) -> Availability<PathBuf> {
    let folder = cargo::target_dir(root).join("vm/python");
    let python = folder.join("bin/python3");
    let complete = folder.join("complete");
    let wanted = format!("{} {MASTERS} {BUILT}", MODULES.join(" "));
    // An environment with other modules is extended.
    if std::fs::read_to_string(&complete).is_ok_and(|has| has == wanted) {
        return Ok(Ok(python));
    }
    if let Err(unavailable) = packages(&["python3-venv"])? {
        return Ok(Err(unavailable));
    }
    let make = Line::new("/usr/bin/python3").args(["-m", "venv"]);
    let fetch = Line::new(folder.join("bin/pip")).args(["install", "--quiet"]);
    if !make.arg(&folder).succeeds()? || !fetch.clone().args(MODULES).succeeds()? {
        let modules = MODULES.join(" ");
        let why = format!("needs {modules}, and pip cannot install it");
        return Ok(Err(Unavailable(why)));
    }
    // Only tests need the EtherCAT masters, and these report missing ones themselves. One list must not keep the other out.
    let mut all = true;
    for (list, needs) in [
        (MASTERS, ""),
        (BUILT, "; it is built with gcc and libpcap-dev"),
    ] {
        if !fetch.clone().args(list.lines()).succeeds()? {
            cargo::note(&format!("pip cannot install {}{needs}", list.trim_end()));
            all = false;
        }
    }
    if all {
        std::fs::write(complete, wanted)?;
    }
    Ok(Ok(python))
}

/// The newest real-time kernel of the host.
pub(super) fn kernel() -> Result<PathBuf, Unavailable> {
    let files = std::fs::read_dir("/boot").into_iter().flatten().flatten();
    let names = files.filter_map(|file| file.file_name().into_string().ok());
    newest(names)
        .map(|name| Path::new("/boot").join(name))
        .ok_or_else(|| Unavailable("needs a kernel /boot/vmlinuz-*-rt-amd64".to_owned()))
}

fn newest(names: impl Iterator<Item = String>) -> Option<String> {
    let kernels = names.filter(|n| n.starts_with("vmlinuz-") && n.ends_with("-rt-amd64"));
    // Versions are compared as numbers: 6.1.0-9 is older than 6.1.0-56.
    kernels.max_by_key(|name| {
        let numbers = name.split(|c: char| !c.is_ascii_digit());
        numbers
            .filter_map(|n| n.parse::<u64>().ok())
            .collect::<Vec<_>>()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn os_debian_and_derivatives_are_recognised() {
        assert!(is_debian("NAME=x\nID=debian\n"));
        assert!(is_debian("ID=pop\nID_LIKE=\"ubuntu debian\"\n"));
        assert!(!is_debian("ID=fedora\nHOME_URL=\"debian\"\n"));
        assert!(!is_debian(""));
    }

    #[test]
    fn kernel_highest_version_is_newest() {
        let names = [
            "vmlinuz-6.1.0-9-rt-amd64",
            "vmlinuz-6.1.0-56-rt-amd64",
            "vmlinuz-7.0-amd64",
        ];
        let names = names.iter().map(ToString::to_string);
        assert_eq!(newest(names).as_deref(), Some("vmlinuz-6.1.0-56-rt-amd64"));
        assert_eq!(newest(std::iter::empty()), None);
    }
}
