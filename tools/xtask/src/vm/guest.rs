//! A machine around the host's own files: what was built on the host runs in it as it is. Files of the
//! host are read-only to it but for the checkout and the target directory.

use std::path::{Path, PathBuf};

use anyhow::Context;
use serde_json::Value;

use super::needs;
use super::system::Processors;
use super::Had;
use crate::cargo::{self, Cargo, note};
use crate::shell::{Line, quoted};
use crate::test::tally::{Reader, Tally};

/// Networks of a machine before anything else runs: CAN interfaces that need no hardware. A host whose
/// kernel has none is not an error here; tests say what they miss.
const NETWORKS: &str = "\
ip link set lo up
modprobe -a can-raw can-bcm vcan 2>/dev/null
for name in vcan0 vcan1; do
    ip link add $name type vcan 2>/dev/null && ip link set $name up
done
";

/// How to boot a machine.
#[derive(Debug)]
pub(super) struct Guest {
    root: PathBuf,
    target: PathBuf,
    vng: PathBuf,
    kernel: PathBuf,
    processors: Processors,
}

impl Guest {
    /// Fetches what is missing.
    pub(super) fn prepare(root: &Path) -> Had<Self> {
        for packages in [needs::MACHINE, needs::GUEST] {
            if let Err(obstacle) = needs::packages(packages)? {
                return Ok(Err(obstacle));
            }
        }
        let vng = match needs::vng(root)? {
            Ok(vng) => vng,
            Err(obstacle) => return Ok(Err(obstacle)),
        };
        let kernel = match needs::kernel() {
            Ok(kernel) => kernel,
            Err(obstacle) => return Ok(Err(obstacle)),
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
        status
    }

    /// Runs test binaries one after the other, and counts.
    pub(super) fn test(
        &self,
        binaries: &[Binary],
        skips: &Path,
        seconds: u64,
    ) -> anyhow::Result<Tally> {
        let script = self.script(&tests(binaries, skips))?;
        let mut reader = Reader::default();
        let show = |text: &str| {
            if reader.line(text) {
                cargo::say(text);
            }
        };
        let status = self.boot(&script).limited(seconds).lines(show)?;
        std::fs::remove_file(script)?;
        if status == 124 {
            note(&format!(
                "the virtual machine did not end within {seconds} s"
            ));
        }
        Ok(reader.finish(status == 0))
    }

    fn boot(&self, script: &Path) -> Line {
        self.line(
            self.processors,
            &format!("sh {}", quoted(&script.to_string_lossy())),
        )
    }

    fn line(&self, processors: Processors, command: &str) -> Line {
        let line = Line::new(&self.vng).args(["--user", "root", "--cpus", "2", "--memory", "1G"]);
        let line = match processors {
            Processors::Emulated => line.arg("--disable-kvm"),
            Processors::Kvm => line,
        };
        // Named, as the machine has folders of its own in places where these may lie.
        let line = line
            .arg("--rwdir")
            .arg(&self.root)
            .arg("--rwdir")
            .arg(&self.target);
        line.arg("-r")
            .arg(&self.kernel)
            .args(["--", command])
            .within(&self.root)
    }

    /// A file with what the machine is to do, so that no shell between here and there changes a word.
    fn script(&self, body: &str) -> anyhow::Result<PathBuf> {
        let path = self
            .target
            .join(format!("vm/guest-{}.sh", std::process::id()));
        let text = format!("{}{NETWORKS}{body}", self.environment());
        std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))?;
        Ok(path)
    }

    /// The host's environment as far as cargo and its toolchain need it.
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

/// The script that runs test binaries, each in its package's folder as cargo does.
fn tests(binaries: &[Binary], skips: &Path) -> String {
    let mut text = format!(
        "export TAKT_SKIPS={}\nbad=0\n",
        quoted(&skips.to_string_lossy())
    );
    for Binary {
        program, folder, ..
    } in binaries
    {
        let (program, folder) = (program.to_string_lossy(), folder.to_string_lossy());
        let folder = quoted(&folder);
        text.push_str(&format!(
            "cd {folder} && CARGO_MANIFEST_DIR={folder} {} || bad=1\n",
            quoted(&program)
        ));
    }
    text + "exit $bad\n"
}

/// A test binary that cargo built.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Binary {
    name: String,
    program: PathBuf,
    /// Of its package.
    pub(super) folder: PathBuf,
}

impl Binary {
    /// Tests that send on a CAN bus are in a file whose name ends in `vcan`.
    pub(super) fn needs_vcan(&self) -> bool {
        self.name.ends_with("vcan")
    }
}

/// The test binaries of a cargo line, which are built already.
pub(super) fn binaries(root: &Path, line: &Cargo) -> anyhow::Result<Vec<Binary>> {
    let line = line.clone().arg("--no-run").arg("--message-format=json");
    let mut found = Vec::new();
    let good = line.lines(root, |text| found.extend(binary(text)))?;
    // What does not build was told when it was to be run.
    Ok(if good { found } else { Vec::new() })
}

fn binary(message: &str) -> Option<Binary> {
    let message: Value = serde_json::from_str(message).ok()?;
    let is_test = message["profile"]["test"] == true;
    let program = message["executable"].as_str().filter(|_| is_test)?;
    let manifest = Path::new(message["manifest_path"].as_str()?);
    Some(Binary {
        name: message["target"]["name"].as_str()?.to_owned(),
        program: program.into(),
        folder: manifest.parent()?.to_owned(),
    })
}

/// Whether the host itself has virtual CAN interfaces, so that no machine is needed for them.
pub(super) fn has_vcan() -> bool {
    let class = Path::new("/sys/class/net");
    // 280 is the hardware type of CAN.
    let is_can = |name: &str| {
        let kind = std::fs::read_to_string(class.join(name).join("type"));
        kind.is_ok_and(|kind| kind.trim() == "280")
    };
    ["vcan0", "vcan1"].into_iter().all(is_can)
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
    fn machine_may_write_only_to_checkout_and_target() {
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
        assert!(
            !guest()
                .line(Processors::Kvm, "true")
                .to_string()
                .contains("kvm")
        );
    }

    #[test]
    fn message_of_cargo_names_a_binary_and_its_folder() {
        let message = r#"{"reason":"compiler-artifact","manifest_path":"/c/can/Cargo.toml",
            "target":{"name":"frames_vcan"},"profile":{"test":true},"executable":"/t/frames-1"}"#;
        let found = binary(message).unwrap();
        assert_eq!(
            (found.program.as_path(), found.folder.as_path()),
            (Path::new("/t/frames-1"), Path::new("/c/can"))
        );
        assert!(found.needs_vcan());
        assert_eq!(binary(&message.replace("true", "false")), None);
        assert_eq!(binary(&message.replace("\"/t/frames-1\"", "null")), None);
        assert_eq!(binary("running 2 tests"), None);
    }

    #[test]
    fn one_bad_binary_makes_the_whole_bad_and_hides_no_other() {
        let binary = |name: &str| Binary {
            name: name.to_owned(),
            program: PathBuf::from(format!("/t/{name}")),
            folder: "/c".into(),
        };
        let text = tests(&[binary("a"), binary("b")], Path::new("/t/skips"));
        let bad = text.matches("|| bad=1").count();
        assert!(bad == 2 && text.ends_with("exit $bad\n"), "{text}");
    }
}
