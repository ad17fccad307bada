//! Memory limits of this process, set by its host: address space (`ulimit -v`) and control groups
//! of both versions. Exceeding them ends the process while robots move, so nets are rejected before.
//! This module does not reserve or free memory.

use std::path::Path;

use crate::files;

/// Maximum bytes read of a kernel file.
const BYTES_MAX: u64 = 1 << 20;

/// Reserve for uncounted memory, bytes: threads, connections, texts being parsed.
pub const MARGIN_BYTES: u64 = 64 << 20;

/// A limit of the host.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MemoryLimit {
    /// Its name, such as `RLIMIT_AS`.
    pub name: String,
    /// The limit, bytes.
    pub bytes: u64,
    /// Present usage, bytes.
    pub used: u64,
}

impl MemoryLimit {
    /// Free bytes.
    #[must_use]
    pub const fn free(&self) -> u64 {
        self.bytes.saturating_sub(self.used)
    }
}

/// The limits of this process.
#[must_use]
pub fn limits() -> Vec<MemoryLimit> {
    let text = |path: &str| files::read_text(Path::new(path), BYTES_MAX).ok();
    let mut limits = Vec::new();
    limits.extend(address_space(&text));
    let groups = text("/proc/self/cgroup").unwrap_or_default();
    for line in groups.lines() {
        let mut fields = line.splitn(3, ':').skip(1);
        let (Some(controllers), Some(path)) = (fields.next(), fields.next()) else {
            continue;
        };
        if controllers.is_empty() {
            let group = Group {
                mount: "/sys/fs/cgroup",
                limit: "memory.max",
                used: "memory.current",
            };
            limits.extend(group.limits(path, &text));
        } else if controllers.split(',').any(|c| c == "memory") {
            let group = Group {
                mount: "/sys/fs/cgroup/memory",
                limit: "memory.limit_in_bytes",
                used: "memory.usage_in_bytes",
            };
            limits.extend(group.limits(path, &text));
        }
    }
    limits
}

/// Memory for all nets together now, bytes, under the tightest limit; `None` without limits.
pub(crate) fn free() -> Option<u64> {
    let free = limits().iter().map(MemoryLimit::free).min();
    free.map(|free| free.saturating_sub(MARGIN_BYTES))
}

/// Cause and hint if the host's limits leave less than `nets_memory_mib`; `None` if they suffice.
#[must_use]
pub fn shortage(nets_memory_mib: u32) -> Option<String> {
    shortage_of(&limits(), nets_memory_mib)
}

fn shortage_of(limits: &[MemoryLimit], nets_memory_mib: u32) -> Option<String> {
    let nets = u64::from(nets_memory_mib) << 20;
    // Their texts take another sixteenth.
    let wanted = nets + nets / 16 + MARGIN_BYTES;
    let least = limits.iter().min_by_key(|limit| limit.free())?;
    let free = least.free();
    (free < wanted).then(|| {
        let mib = |bytes: u64| bytes >> 20;
        let fits = mib(free.saturating_sub(MARGIN_BYTES) / 17 * 16).max(1);
        format!(
            "{} leaves {} MiB, but nets may take {nets_memory_mib} MiB and {} MiB beside: nets that do not fit will \
             be refused\nhint: raise the limit, or set nets_memory_mib = {fits} under [controller] of cell.toml",
            least.name,
            mib(free),
            mib(wanted - nets),
        )
    })
}

fn address_space(text: &impl Fn(&str) -> Option<String>) -> Option<MemoryLimit> {
    let all = text("/proc/self/limits")?;
    let line = all
        .lines()
        .find_map(|l| l.strip_prefix("Max address space"))?;
    let bytes = line.split_whitespace().next()?.parse().ok()?;
    let status = text("/proc/self/status")?;
    let used = status.lines().find_map(|l| l.strip_prefix("VmSize:"))?;
    let kib: u64 = used.split_whitespace().next()?.parse().ok()?;
    Some(MemoryLimit {
        name: "RLIMIT_AS (ulimit -v)".to_owned(),
        bytes,
        used: kib << 10,
    })
}

/// Names of the files of a control group.
struct Group {
    mount: &'static str,
    limit: &'static str,
    used: &'static str,
}

impl Group {
    /// The limits of a group and its ancestors; in a container the path may not exist, and the mount is the
    /// group itself.
    fn limits(&self, path: &str, text: &impl Fn(&str) -> Option<String>) -> Vec<MemoryLimit> {
        let mut limits = Vec::new();
        for group in Path::new(path).ancestors() {
            let folder = format!("{}{}", self.mount, group.display());
            let folder = folder.trim_end_matches('/');
            let number = |name: &str| -> Option<u64> {
                text(&format!("{folder}/{name}"))?.trim().parse().ok()
            };
            // Without a limit the file contains `max`, or a number beyond all memory.
            let limit = number(self.limit).filter(|bytes| *bytes < 1 << 50);
            if let (Some(bytes), Some(used)) = (limit, number(self.used)) {
                let pages = text(&format!("{folder}/memory.stat")).unwrap_or_default();
                limits.push(MemoryLimit {
                    name: format!("{folder}/{}", self.limit),
                    bytes,
                    used: used.saturating_sub(of_files(&pages)),
                });
            }
        }
        limits
    }
}

/// Bytes of a group's page cache, which the kernel reclaims when necessary.
fn of_files(stat: &str) -> u64 {
    let value = |line: &str| {
        let (name, bytes) = line.split_once(' ')?;
        let counts = ["inactive_file", "active_file"].contains(&name);
        bytes.trim().parse::<u64>().ok().filter(|_| counts)
    };
    stat.lines().filter_map(value).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn group_limit_of_either_version_counts() {
        let known = [
            ("/sys/fs/cgroup/a/b/memory.max", "max\n"),
            ("/sys/fs/cgroup/a/b/memory.current", "5\n"),
            ("/sys/fs/cgroup/a/memory.max", "1000\n"),
            ("/sys/fs/cgroup/a/memory.current", "300\n"),
            (
                "/sys/fs/cgroup/a/memory.stat",
                "anon 7\ninactive_file 60\nactive_file 40\n",
            ),
            (
                "/sys/fs/cgroup/memory/memory.limit_in_bytes",
                "9223372036854771712\n",
            ),
            ("/sys/fs/cgroup/memory/memory.usage_in_bytes", "5\n"),
        ];
        let text = |path: &str| {
            let found = known.iter().find(|(name, _)| *name == path);
            found.map(|(_, text)| (*text).to_owned())
        };
        let group = Group {
            mount: "/sys/fs/cgroup",
            limit: "memory.max",
            used: "memory.current",
        };
        let limits = group.limits("/a/b", &text);
        assert_eq!(limits.len(), 1);
        assert_eq!(
            (limits[0].name.as_str(), limits[0].free()),
            ("/sys/fs/cgroup/a/memory.max", 800)
        );
        let old = Group {
            mount: "/sys/fs/cgroup/memory",
            limit: "memory.limit_in_bytes",
            used: "memory.usage_in_bytes",
        };
        assert_eq!(old.limits("/", &text), []);
    }

    #[test]
    fn address_space_limit_is_read() {
        let text = |path: &str| {
            match path {
            "/proc/self/limits" => Some(
                "Max locked memory 8 8 bytes\nMax address space         1073741824           unlimited bytes\n"
                    .to_owned(),
            ),
            "/proc/self/status" => Some("VmSize:\t  524288 kB\n".to_owned()),
            _ => None,
        }
        };
        assert_eq!(address_space(&text).unwrap().free(), 512 << 20);
        let unlimited =
            |_: &str| Some("Max address space  unlimited  unlimited  bytes\n".to_owned());
        assert_eq!(address_space(&unlimited), None);
    }

    #[test]
    fn shortage_names_limit_and_remedy() {
        let limit = |mib: u64| MemoryLimit {
            name: "RLIMIT_AS (ulimit -v)".to_owned(),
            bytes: mib << 20,
            used: 0,
        };
        assert_eq!(shortage_of(&[], 1024), None);
        assert_eq!(shortage_of(&[limit(2048)], 1024), None);
        let text = shortage_of(&[limit(2048), limit(608)], 1024).unwrap();
        assert!(
            text.starts_with("RLIMIT_AS (ulimit -v) leaves 608 MiB"),
            "{text}"
        );
        assert!(text.contains("nets_memory_mib = 512"), "{text}");
        assert_eq!(shortage_of(&[limit(608)], 512), None);
    }
}
