//! A machine with a Debian of its own, made by debootstrap: systemd is its first process, and the package is installed
//! as an administrator would. `tests/vm/service.sh` has the steps.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context;

use super::system::Processors;
use super::{Availability, Unavailable, needs};
use crate::cargo::{self, Cargo, note, say};
use crate::deb::Package;
use crate::shell::Line;
use crate::test::tally::{Reader, Tally};

/// Debian mirror.
const MIRROR: &str = "http://deb.debian.org/debian";
/// Packages of the userland besides the minimum.
const USERLAND: &str = "--include=systemd-sysv,dbus,udev,procps,kmod,iproute2";
/// Timeout of all steps together, s.
const TIMEOUT_S: u64 = 900;

/// Runs the content of the second disk once everything else has started, and switches off.
const UNIT: &str = "\
[Unit]
Description=Test of the package
After=multi-user.target

[Service]
Type=oneshot
StandardInput=null
StandardOutput=file:/dev/ttyS1
StandardError=inherit
ExecStart=/bin/sh -c 'mkdir /opt/test && tar -C /opt/test -xf /dev/vdb && sh /opt/test/service.sh'
ExecStopPost=/bin/systemctl --no-block poweroff --force --force
";
const TARGET: &str = "\
[Unit]
Description=Multi-user, and the test
Requires=multi-user.target
Wants=takt-test.service
AllowIsolate=yes
";
/// Services of a permanent installation; here they only take time.
const MASKED: [&str; 7] = [
    "apt-daily.timer",
    "apt-daily-upgrade.timer",
    "dpkg-db-backup.timer",
    "e2scrub_all.timer",
    "fstrim.timer",
    "getty@tty1.service",
    "serial-getty@ttyS0.service",
];

/// Builds the package, boots the machine and counts what its script prints.
pub(super) fn test(root: &Path, takt: Option<&Path>) -> Availability<Tally> {
    if let Err(unavailable) = super::refused() {
        return Ok(Err(unavailable));
    }
    for packages in [needs::MACHINE, needs::SERVICE] {
        if let Err(unavailable) = needs::packages(packages)? {
            return Ok(Err(unavailable));
        }
    }
    let kernel = match needs::kernel() {
        Ok(kernel) => kernel,
        Err(unavailable) => return Ok(Err(unavailable)),
    };
    let image = match image(root)? {
        Ok(image) => image,
        Err(unavailable) => return Ok(Err(unavailable)),
    };
    let folder = cargo::target_dir(root).join("vm");
    let machine = Machine {
        kernel,
        image,
        disk: disk(root, &folder, &packages(root, &folder, takt)?)?,
        console: folder.join("console.log"),
    };
    let quick = Machine {
        disk: machine.image.clone(),
        console: folder.join("kvm.log"),
        ..machine.clone()
    };
    let processors = Processors::of_host(root, |kind| quick.line(kind, "init=/bin/false"))?;
    let mut reader = Reader::default();
    let mut ended = false;
    let show = |text: &str| {
        ended |= text.starts_with("test result: ");
        if reader.line(text) {
            say(text);
        }
    };
    let line = machine.line(processors, "systemd.unit=takt-test.target");
    let status = line.limited(TIMEOUT_S).lines(show)?;
    if !ended {
        let console = machine.console.display();
        note(&format!(
            "the machine ended with status {status} before its tests did; see {console}"
        ));
    }
    Ok(Ok(reader.finish(ended)))
}

/// The package of this checkout, and the same as a later version. Its program is the one that the tests were built with.
fn packages(root: &Path, folder: &Path, takt: Option<&Path>) -> anyhow::Result<[PathBuf; 2]> {
    let program = match takt {
        Some(program) => program.to_owned(),
        None => {
            let build = Cargo::new("build -p takt-tools --all-features");
            anyhow::ensure!(build.succeeds(root)?, "takt does not build");
            cargo::target_dir(root).join("debug/takt")
        }
    };
    let folder = folder.join("package");
    let package = |version| Package {
        program: &program,
        folder: &folder,
        version,
        release: false,
    };
    let next = concat!(env!("CARGO_PKG_VERSION"), "-2");
    Ok([package(None).make(root)?, package(Some(next)).make(root)?])
}

/// The second disk: the machine's input, as an archive without file system.
fn disk(root: &Path, folder: &Path, packages: &[PathBuf; 2]) -> anyhow::Result<PathBuf> {
    let content = folder.join("content");
    let _ = fs::remove_dir_all(&content);
    fs::create_dir_all(&content)?;
    let swing = root.join("tests/nets/swing/swing.net");
    let script = root.join("tests/vm/service.sh");
    let [package, next] = packages;
    for (from, name) in [
        (package, "takt.deb"),
        (next, "takt-next.deb"),
        (&swing, "swing.net"),
        (&script, "service.sh"),
    ] {
        fs::copy(from, content.join(name)).with_context(|| format!("no {}", from.display()))?;
    }
    let disk = folder.join("content.tar");
    // A disk consists of whole sectors.
    let tar = Line::new("tar")
        .arg("--blocking-factor=20")
        .arg("-C")
        .arg(&content);
    anyhow::ensure!(tar.arg("-cf").arg(&disk).arg(".").succeeds()?, "tar failed");
    Ok(disk)
}

/// The first disk, with Debian; made once and kept in the target directory.
fn image(root: &Path) -> Availability<PathBuf> {
    let folder = cargo::target_dir(root).join("vm");
    fs::create_dir_all(&folder)?;
    let os = fs::read_to_string("/etc/os-release").unwrap_or_default();
    // The package is built for the host's libraries.
    let Some(suite) = codename(&os) else {
        return Ok(Err(Unavailable("needs a release of Debian".to_owned())));
    };
    let image = folder.join(format!("{suite}.ext4"));
    if image.is_file() {
        return Ok(Ok(image));
    }
    if !needs::is_root() {
        return Ok(Err(Unavailable("needs root for debootstrap".to_owned())));
    }
    let tree = folder.join(suite);
    let _ = fs::remove_dir_all(&tree);
    let fetch = Line::new("debootstrap").args(["--variant=minbase", USERLAND, suite]);
    if !fetch.arg(&tree).arg(MIRROR).quiet().succeeds()? {
        return Ok(Err(Unavailable(format!(
            "needs {MIRROR}, where debootstrap fails"
        ))));
    }
    install_units(&tree)?;
    let new = folder.join("new.ext4");
    fs::File::create(&new)?.set_len(800 << 20)?;
    let make = Line::new("mkfs.ext4").args(["-q", "-O", "^has_journal", "-d"]);
    anyhow::ensure!(make.arg(&tree).arg(&new).succeeds()?, "mkfs.ext4 failed");
    fs::rename(&new, &image)?;
    fs::remove_dir_all(&tree)?;
    Ok(Ok(image))
}

/// Copies the test's units into the tree.
fn install_units(tree: &Path) -> anyhow::Result<()> {
    let units = tree.join("etc/systemd/system");
    fs::write(units.join("takt-test.service"), UNIT)?;
    fs::write(units.join("takt-test.target"), TARGET)?;
    for unit in MASKED {
        let link = units.join(unit);
        let _ = fs::remove_file(&link);
        std::os::unix::fs::symlink("/dev/null", link)?;
    }
    let _ = fs::remove_dir_all(tree.join("var/cache/apt/archives"));
    Ok(fs::write(tree.join("etc/hostname"), "machine\n")?)
}

fn codename(os_release: &str) -> Option<&str> {
    let is_debian = os_release.lines().any(|line| line == "ID=debian");
    let names = os_release
        .lines()
        .filter_map(|line| line.strip_prefix("VERSION_CODENAME="));
    names.map(|name| name.trim_matches('"')).find(|_| is_debian)
}

#[derive(Clone, Debug)]
struct Machine {
    kernel: PathBuf,
    image: PathBuf,
    disk: PathBuf,
    /// Output of kernel and systemd.
    console: PathBuf,
}

impl Machine {
    /// Its second serial line is our standard output.
    fn line(&self, processors: Processors, what: &str) -> Line {
        let accelerator: &[&str] = match processors {
            Processors::Emulated => &["tcg,thread=multi", "-cpu", "max"],
            Processors::Kvm => &["kvm", "-cpu", "host"],
        };
        let initrd = self
            .kernel
            .to_string_lossy()
            .replacen("vmlinuz", "initrd.img", 1);
        let append = format!(
            "root=/dev/vda rw console=ttyS0 quiet panic=-1 mitigations=off net.ifnames=0 {what}"
        );
        let drive = |path: &Path, option: &str| {
            // A comma separates values, and is doubled within one.
            let path = path.to_string_lossy().replace(',', ",,");
            format!("file={path},format=raw,if=virtio,{option}")
        };
        let console = self.console.to_string_lossy().replace(',', ",,");
        Line::new("qemu-system-x86_64")
            .arg("-accel")
            .args(accelerator)
            .args([
                "-smp",
                "2",
                "-m",
                "1G",
                "-display",
                "none",
                "-nodefaults",
                "-no-reboot",
            ])
            .arg("-kernel")
            .arg(&self.kernel)
            .args(["-initrd", &initrd, "-append", &append])
            // The machine's writes are discarded.
            .args(["-drive", &drive(&self.image, "snapshot=on")])
            .args(["-drive", &drive(&self.disk, "readonly=on")])
            .args(["-serial", &format!("file:{console}"), "-serial", "stdio"])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn service_machine_discards_writes_and_powers_off() {
        let machine = Machine {
            kernel: "/boot/vmlinuz-1-rt-amd64".into(),
            image: "/cache/a,b.ext4".into(),
            disk: "/cache/content.tar".into(),
            console: "/cache/console.log".into(),
        };
        let line = machine.line(Processors::Emulated, "x=y").to_string();
        for part in [
            "-accel tcg,thread=multi -cpu max",
            "-initrd /boot/initrd.img-1-rt-amd64",
            "-no-reboot",
            "file=/cache/a,,b.ext4,format=raw,if=virtio,snapshot=on",
            "net.ifnames=0 x=y'",
            "-serial stdio",
        ] {
            assert!(line.contains(part), "{part}: {line}");
        }
        assert!(
            machine
                .line(Processors::Kvm, "")
                .to_string()
                .contains("-accel kvm -cpu host")
        );
    }

    #[test]
    fn service_codename_requires_debian() {
        let debian = "ID=debian\nVERSION_CODENAME=bookworm\n";
        assert_eq!(codename(debian), Some("bookworm"));
        assert_eq!(codename("ID=ubuntu\nVERSION_CODENAME=noble\n"), None);
    }
}
