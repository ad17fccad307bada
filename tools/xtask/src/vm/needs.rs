//! What machines are made of, fetched from Debian's and Python's registries where it is missing. On
//! other systems, or without root, nothing is touched and the obstacle is told.

use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use super::{Had, Obstacle};
use crate::cargo;
use crate::shell::{self, Line};

/// Debian packages of every machine.
pub(super) const MACHINE: &[&str] = &["linux-image-rt-amd64", "qemu-system-x86"];
/// And of one around the host's files.
pub(super) const GUEST: &[&str] = &["busybox-static", "iproute2", "kmod"];
/// And of one around a Debian of its own.
pub(super) const SERVICE: &[&str] = &["debootstrap", "e2fsprogs"];

/// Installs what is missing of these packages.
pub(super) fn packages(names: &[&str]) -> Had<()> {
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
        return Ok(Err(Obstacle(format!(
            "needs Debian or the like for {list}"
        ))));
    }
    if !is_root() {
        return Ok(Err(Obstacle(format!(
            "needs root to apt-get install {list}"
        ))));
    }
    // Another apt may be at work.
    let apt = || Line::new("apt-get").args(["--quiet", "--quiet", "-o", "DPkg::Lock::Timeout=600"]);
    let install = apt()
        .args(["install", "--yes", "--no-install-recommends"])
        .args(&missing);
    let install = install.env("DEBIAN_FRONTEND", "noninteractive");
    if apt().arg("update").succeeds()? && install.succeeds()? {
        Ok(Ok(()))
    } else {
        Ok(Err(Obstacle(format!(
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

/// Whether this process may do what only root may.
pub(crate) fn is_root() -> bool {
    std::fs::metadata("/proc/self").is_ok_and(|process| process.uid() == 0)
}

/// virtme-ng: one that is installed, or one of our own.
pub(super) fn vng(root: &Path) -> Had<PathBuf> {
    if shell::exists("vng") {
        return Ok(Ok(PathBuf::from("vng")));
    }
    Ok(python(root)?.map(|python| python.with_file_name("vng")))
}

/// Debian packages that tests on a bus talk to, or look at it with.
const PEERS: &[&str] = &["can-utils", "iproute2", "tshark"];
/// What our own Python has beside itself: virtme-ng, and what tests on a bus talk to.
const MODULES: [&str; 3] = ["virtme-ng~=1.42", "python-can~=4.0", "canopen~=2.0"];
/// The same for EtherCAT, as a person installs it too.
const MASTERS: &str = include_str!("../../../../ethercat/tests/peers/requirements.txt");

/// Fetches what tests on a bus talk to; returns the Python that has such modules. Of what cannot be
/// had the tests say so themselves.
pub(crate) fn peers(root: &Path) -> anyhow::Result<Option<PathBuf>> {
    let told = |Obstacle(why)| cargo::note(&format!("tests on a bus miss peers: {why}"));
    packages(PEERS)?.unwrap_or_else(told);
    Ok(python(root)?.map_err(told).ok())
}

/// A Python in a virtual environment of our own, as Debian's refuses to be added to.
fn python(root: &Path) -> Had<PathBuf> {
    let folder = cargo::target_dir(root).join("vm/python");
    let python = folder.join("bin/python3");
    let complete = folder.join("complete");
    let wanted = format!("{} {MASTERS}", MODULES.join(" "));
    // One that was made for other modules is added to.
    if std::fs::read_to_string(&complete).is_ok_and(|has| has == wanted) {
        return Ok(Ok(python));
    }
    if let Err(obstacle) = packages(&["python3-venv"])? {
        return Ok(Err(obstacle));
    }
    let make = Line::new("/usr/bin/python3").args(["-m", "venv"]);
    let fetch = Line::new(folder.join("bin/pip")).args(["install", "--quiet"]);
    if !make.arg(&folder).succeeds()? || !fetch.clone().args(MODULES).succeeds()? {
        let modules = MODULES.join(" ");
        let why = format!("needs {modules}, and pip cannot install it");
        return Ok(Err(Obstacle(why)));
    }
    // Nothing else needs the masters of EtherCAT, and their tests say so themselves.
    if fetch.args(MASTERS.lines()).succeeds()? {
        std::fs::write(complete, wanted)?;
    } else {
        cargo::note(&format!("pip cannot install {MASTERS}"));
    }
    Ok(Ok(python))
}

/// The newest real-time kernel of the host.
pub(super) fn kernel() -> Result<PathBuf, Obstacle> {
    let files = std::fs::read_dir("/boot").into_iter().flatten().flatten();
    let names = files.filter_map(|file| file.file_name().into_string().ok());
    newest(names)
        .map(|name| Path::new("/boot").join(name))
        .ok_or_else(|| Obstacle("needs a kernel /boot/vmlinuz-*-rt-amd64".to_owned()))
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
    fn debian_and_what_is_made_of_it_are_known() {
        assert!(is_debian("NAME=x\nID=debian\n"));
        assert!(is_debian("ID=pop\nID_LIKE=\"ubuntu debian\"\n"));
        assert!(!is_debian("ID=fedora\nHOME_URL=\"debian\"\n"));
        assert!(!is_debian(""));
    }

    #[test]
    fn newest_kernel_is_the_one_with_the_highest_numbers() {
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
