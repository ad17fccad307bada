//! A machine with the host's own files: what the host built runs in it unchanged. It can write only to the checkout and
//! the target directory.

use std::path::{Path, PathBuf};

use anyhow::Context;

use super::system::Processors;
use super::{Availability, needs};
use crate::cargo::{self, note};
use crate::environments::NETWORKS;
use crate::shell::{Line, TIMEOUT_STATUS, quoted};

/// Timeout of all tests together, s.
const TESTS_TIMEOUT_S: u64 = 600;

/// Two CAN controllers on a common bus.
const CONTROLLERS: &str = "--qemu-opts=-object can-bus,id=takt \
    -device kvaser_pci,canbus=takt -device kvaser_pci,canbus=takt";

/// Boot settings of a machine.
#[derive(Debug)]
pub(crate) struct Guest {
    root: PathBuf,
    target: PathBuf,
    vng: PathBuf,
    kernel: PathBuf,
    processors: Processors,
}

impl Guest {
    /// Installs missing packages.
    pub(crate) fn prepare(root: &Path) -> Availability<Self> {
        if let Err(unavailable) = super::refused() {
            return Ok(Err(unavailable));
        }
        for packages in [needs::MACHINE, needs::GUEST] {
            if let Err(unavailable) = needs::packages(packages)? {
                return Ok(Err(unavailable));
            }
        }
        let vng = match needs::vng(root)? {
            Ok(vng) => vng,
            Err(unavailable) => return Ok(Err(unavailable)),
        };
        let kernel = match needs::kernel() {
            Ok(kernel) => kernel,
            Err(unavailable) => return Ok(Err(unavailable)),
        };
        let target = cargo::target_dir(root);
        std::fs::create_dir_all(target.join("vm"))?;
        let mut guest = Self {
            root: root.to_owned(),
            target,
            vng,
            kernel,
            processors: Processors::Emulated,
        };
        guest.processors = Processors::of_host(root, |kind| guest.line(kind, "true"))?;
        Ok(Ok(guest))
    }

    /// Runs a command in the checkout; returns its exit status.
    pub(super) fn run(&self, command: &[String], seconds: u64) -> anyhow::Result<u8> {
        let words: Vec<String> = command.iter().map(|word| quoted(word)).collect();
        let script = self.script(&format!("exec {}\n", words.join(" ")))?;
        let status = self.boot(&script).limited(seconds).status();
        std::fs::remove_file(script)?;
        self.report_timeout(*status.as_ref().unwrap_or(&0), seconds);
        status
    }

    /// Runs a script in the checkout; returns its exit status.
    pub(crate) fn test(&self, script: &str, show: impl FnMut(&str)) -> anyhow::Result<u8> {
        let script = self.script(script)?;
        let status = self.boot(&script).limited(TESTS_TIMEOUT_S).lines(show);
        std::fs::remove_file(script)?;
        self.report_timeout(*status.as_ref().unwrap_or(&0), TESTS_TIMEOUT_S);
        status
    }

    fn report_timeout(&self, status: u8, seconds: u64) {
        if status == TIMEOUT_STATUS {
            let processors = match self.processors {
                Processors::Emulated => " on emulated processors",
                Processors::Kvm => "",
            };
            note(&format!(
                "the virtual machine was switched off: it had not ended within {seconds} s{processors}"
            ));
        }
    }

    fn boot(&self, script: &Path) -> Line {
        self.line(
            self.processors,
            &format!("sh {}", quoted(&script.to_string_lossy())),
        )
    }

    fn line(&self, processors: Processors, command: &str) -> Line {
        let line = Line::new(&self.vng).relayed();
        // virtme-ng finds its other programs in the search path.
        let line = match self.vng.parent().filter(|folder| folder.is_absolute()) {
            Some(folder) => line.env("PATH", &format!("{}:{}", folder.display(), path())),
            None => line,
        };
        let line = line.args(["--user", "root", "--cpus", "2", "--memory", "1G"]);
        let line = match processors {
            Processors::Emulated => line.arg("--disable-kvm"),
            Processors::Kvm => line,
        };
        // Given explicitly, as the machine has its own folders at some of these paths.
        let line = line
            .arg("--rwdir")
            .arg(&self.root)
            .arg("--rwdir")
            .arg(&self.target);
        line.arg("-r")
            .arg(&self.kernel)
            .args([CONTROLLERS, "--", command])
            .within(&self.root)
    }

    /// A file with the machine's commands, so that no shell in between changes a word.
    fn script(&self, body: &str) -> anyhow::Result<PathBuf> {
        let path = self
            .target
            .join(format!("vm/guest-{}.sh", std::process::id()));
        let text = format!("{}{NETWORKS}\n{body}", self.environment());
        std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))?;
        Ok(path)
    }

    /// The part of the host's environment that cargo and its toolchain need.
    fn environment(&self) -> String {
        let mut text = format!("cd {}\n", quoted(&self.root.to_string_lossy()));
        for name in [
            "PATH",
            "HOME",
            "CARGO_HOME",
            "RUSTUP_HOME",
            "CARGO_TARGET_DIR",
        ] {
            if let Ok(value) = std::env::var(name) {
                text.push_str(&format!("export {name}={}\n", quoted(&value)));
            }
        }
        text + "export TAKT_VM=inside\n"
    }
}

fn path() -> String {
    std::env::var("PATH").unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn guest() -> Guest {
        Guest {
            root: "/checkout".into(),
            target: "/cache".into(),
            vng: "vng".into(),
            kernel: "/boot/vmlinuz-1-rt-amd64".into(),
            processors: Processors::Emulated,
        }
    }

    #[test]
    fn guest_writes_only_checkout_and_target() {
        let line = guest().boot(Path::new("/cache/vm/a b.sh")).to_string();
        assert!(
            line.contains("--disable-kvm --rwdir /checkout --rwdir /cache "),
            "{line}"
        );
        assert!(!line.contains("--rw "), "{line}");
        assert!(
            line.ends_with(r"-- 'sh '\''/cache/vm/a b.sh'\'''"),
            "{line}"
        );
        assert!(line.starts_with("vng --user root "), "{line}");
        assert!(
            !guest()
                .line(Processors::Kvm, "true")
                .to_string()
                .contains("kvm")
        );
    }

    #[test]
    fn guest_own_vng_extends_search_path() {
        let guest = Guest {
            vng: "/cache/vm/python/bin/vng".into(),
            ..guest()
        };
        let line = guest.line(Processors::Kvm, "true").to_string();
        assert!(line.starts_with("PATH=/cache/vm/python/bin:"), "{line}");
    }
}
