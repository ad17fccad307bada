//! Facts of the host that make two reports comparable, and how busy it was meanwhile.
//!
//! It checks no setting: `takt doctor` does.

use std::fs::{self, File};
use std::os::unix::fs::FileExt as _;
use std::path::Path;

use serde::{Deserialize, Serialize};

/// The machine and its kernel.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Host {
    /// Name, release and version of the kernel.
    pub(crate) kernel: String,
    pub(crate) preempt_rt: bool,
    /// Model of the processors; empty if the kernel does not report it.
    pub(crate) processor: String,
    /// Processors that this process may use.
    pub(crate) cpus: usize,
    /// Whose virtual machine this is; `None` on bare metal.
    pub(crate) virtual_machine: Option<String>,
}

impl Host {
    /// Reads it.
    pub(crate) fn read(preempt_rt: bool) -> Self {
        let text = |path: &str| fs::read_to_string(path).unwrap_or_default();
        let cpuinfo = text("/proc/cpuinfo");
        Self {
            kernel: format!(
                "{} {} {}",
                text("/proc/sys/kernel/ostype").trim(),
                text("/proc/sys/kernel/osrelease").trim(),
                text("/proc/sys/kernel/version").trim()
            ),
            preempt_rt,
            processor: field(&cpuinfo, "model name").unwrap_or_default().to_owned(),
            cpus: usable_cpus().len(),
            virtual_machine: virtual_machine(&cpuinfo, &text("/sys/class/dmi/id/sys_vendor")),
        }
    }
}

fn field<'a>(text: &'a str, name: &str) -> Option<&'a str> {
    let mut fields = text.lines().filter_map(|line| line.split_once(':'));
    let (_, value) = fields.find(|(key, _)| key.trim() == name)?;
    Some(value.trim())
}

/// x86 processors report to guests that they are virtualized.
fn virtual_machine(cpuinfo: &str, vendor: &str) -> Option<String> {
    let flags = field(cpuinfo, "flags")?;
    let is_guest = flags.split_whitespace().any(|flag| flag == "hypervisor");
    let vendor = vendor.trim();
    let name = if vendor.is_empty() {
        "unnamed hypervisor"
    } else {
        vendor
    };
    is_guest.then(|| name.to_owned())
}

/// The processors that this process may use, ascending.
pub(crate) fn usable_cpus() -> Vec<usize> {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let list = field(&status, "Cpus_allowed_list");
    list.and_then(|list| cpu_list(list).ok())
        .unwrap_or_default()
}

/// Reads a list such as `0-2,5`. Ascending, each once.
pub(crate) fn cpu_list(text: &str) -> Result<Vec<usize>, String> {
    const MOST: usize = 1023;
    let wrong = || format!("`{text}` is no list of processors: write 1, 0-3 or 0,2-3");
    let number = |text: &str| text.trim().parse().ok().filter(|&cpu: &usize| cpu <= MOST);
    let mut cpus = Vec::new();
    for part in text.split(',') {
        let (first, last) = part.split_once('-').unwrap_or((part, part));
        let (first, last) = number(first).zip(number(last)).ok_or_else(wrong)?;
        if first > last {
            return Err(wrong());
        }
        cpus.extend(first..=last);
    }
    cpus.sort_unstable();
    cpus.dedup();
    Ok(cpus)
}

/// A reading of the processors' time, in the kernel's ticks.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct CpuTime {
    total: u64,
    idle: u64,
    steal: u64,
}

impl CpuTime {
    /// Reads it now.
    pub(crate) fn read() -> Option<Self> {
        Self::parse(&fs::read_to_string("/proc/stat").ok()?)
    }

    /// From the text of `/proc/stat`: user, nice, system, idle, iowait, irq, softirq, steal.
    fn parse(stat: &str) -> Option<Self> {
        let line = stat.lines().find_map(|line| line.strip_prefix("cpu "))?;
        let ticks: Result<Vec<u64>, _> = line.split_whitespace().map(str::parse).collect();
        let ticks = ticks.ok()?;
        Some(Self {
            total: ticks.iter().take(8).sum(),
            idle: ticks.get(3)? + ticks.get(4)?,
            steal: *ticks.get(7)?,
        })
    }

    /// Percent of all processors' time since `earlier`: busy, and stolen by the hypervisor.
    #[expect(clippy::cast_precision_loss, reason = "a percentage")]
    pub(crate) fn busy_and_steal(self, earlier: Self) -> Option<(f64, f64)> {
        let total = self.total.checked_sub(earlier.total).filter(|&t| t > 0)?;
        let percent = |part: u64| (part as f64 * 1000.0 / total as f64).round() / 10.0;
        let idle = self.idle.saturating_sub(earlier.idle).min(total);
        let steal = self.steal.saturating_sub(earlier.steal);
        Some((percent(total - idle), percent(steal)))
    }
}

/// Number of system management interrupts since power-up, as Intel processors count it; they stop all
/// processors at once, so one's counter is enough.
///
/// # Errors
/// Why it cannot be read.
pub(crate) fn smi_count(cpu: usize) -> Result<u32, String> {
    smi_count_at(Path::new(&format!("/dev/cpu/{cpu}/msr")))
}

fn smi_count_at(path: &Path) -> Result<u32, String> {
    const MSR_SMI_COUNT: u64 = 0x34;
    let why = |e: std::io::Error| {
        let remedy = if e.kind() == std::io::ErrorKind::NotFound {
            "modprobe msr"
        } else if e.kind() == std::io::ErrorKind::PermissionDenied {
            "run as root"
        } else {
            "this processor has no such counter"
        };
        let text = e.to_string();
        let text = text.split(" (os error").next().unwrap_or_default();
        format!("{}: {text}; {remedy}", path.display())
    };
    let file = File::open(path).map_err(why)?;
    let mut value = [0; 8];
    file.read_exact_at(&mut value, MSR_SMI_COUNT).map_err(why)?;
    let [a, b, c, d, ..] = value;
    Ok(u32::from_le_bytes([a, b, c, d]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_of_processors() {
        assert_eq!(cpu_list("3"), Ok(vec![3]));
        assert_eq!(cpu_list("0-2,5, 1"), Ok(vec![0, 1, 2, 5]));
        for wrong in ["", "x", "2-1", "0-", "-1", "1,,2", "0-99999999999"] {
            assert!(cpu_list(wrong).is_err(), "{wrong}");
        }
        assert!(!usable_cpus().is_empty());
    }

    #[test]
    fn host_detects_virtual_machine() {
        let cpuinfo = "processor : 0\nmodel name : A CPU\nflags : fpu hypervisor lm\n";
        let vendor = |text| virtual_machine(cpuinfo, text);
        assert_eq!(vendor("QEMU\n"), Some("QEMU".into()));
        assert_eq!(vendor(""), Some("unnamed hypervisor".into()));
        let bare = cpuinfo.replace("hypervisor ", "");
        assert_eq!(virtual_machine(&bare, "QEMU"), None);
        assert_eq!(field(cpuinfo, "model name"), Some("A CPU"));
    }

    #[test]
    fn busy_and_steal_are_differences() {
        let at = |text: &str| CpuTime::parse(text).unwrap();
        let before = at("cpu  100 0 100 700 100 0 0 0 0 0\n");
        let after = at("cpu  130 0 110 740 110 0 0 10 0 0\ncpu0 1 2 3 4 5\n");
        assert_eq!(after.busy_and_steal(before), Some((50.0, 10.0)));
        assert_eq!(before.busy_and_steal(before), None);
        assert_eq!(CpuTime::parse("cpu  1 2\n"), None);
        assert_eq!(CpuTime::parse("intr 5\n"), None);
    }

    #[test]
    fn smi_count_is_read_or_error_names_cause() {
        let path = std::env::temp_dir().join(format!("takt-msr-{}", std::process::id()));
        let mut registers = vec![0; 0x34];
        registers.extend(17_u64.to_le_bytes());
        fs::write(&path, &registers).unwrap();
        assert_eq!(smi_count_at(&path), Ok(17));
        fs::write(&path, &registers[..0x36]).unwrap();
        assert!(smi_count_at(&path).unwrap_err().contains("no such counter"));
        fs::remove_file(&path).unwrap();
        assert!(smi_count_at(&path).unwrap_err().contains("modprobe msr"));
    }
}
