//! The shapes of text in `/proc`, `/sys` and `/etc`: what a value is, wherever it stands.
//!
//! It judges nothing and trusts nothing: what does not have the shape is `None` or left out.

/// The chosen one of alternatives, `always [madvise] never` or `none (voluntary) full`; without brackets the
/// whole text.
pub(super) fn chosen(text: &str) -> &str {
    let text = text.trim();
    for (open, close) in [('[', ']'), ('(', ')')] {
        let inner = text
            .split_once(open)
            .and_then(|(_, rest)| rest.split_once(close));
        if let Some((inner, _)) = inner
            && !inner.is_empty()
        {
            return inner;
        }
    }
    text
}

/// The value after `key` and a colon, as in `/proc/self/status` and `/proc/cpuinfo`; the first of several.
pub(super) fn field<'a>(text: &'a str, key: &str) -> Option<&'a str> {
    text.lines().find_map(|line| {
        let (found, value) = line.split_once(':')?;
        (found.trim() == key).then(|| value.trim())
    })
}

/// The value after `key` and a space, as in `/proc/stat` and in what the probes write.
pub(super) fn entry<'a>(text: &'a str, key: &str) -> Option<&'a str> {
    text.lines().find_map(|line| {
        let (found, value) = line.split_once(' ')?;
        (found == key).then(|| value.trim())
    })
}

/// A value of `/proc/meminfo`, in kB.
pub(super) fn meminfo_kb(text: &str, key: &str) -> Option<u64> {
    field(text, key)?.strip_suffix("kB")?.trim().parse().ok()
}

/// The last value of a parameter of the kernel's command line, empty for one without `=`. Quoted
/// values may contain spaces.
pub(super) fn parameter<'a>(cmdline: &'a str, name: &str) -> Option<&'a str> {
    let mut found = None;
    let mut quoted = false;
    let words = cmdline.trim().split(|c: char| {
        quoted ^= c == '"';
        c.is_whitespace() && !quoted
    });
    for word in words {
        let (key, value) = word.split_once('=').unwrap_or((word, ""));
        // The kernel takes both characters for the same.
        if key.replace('-', "_") == name.replace('-', "_") {
            found = Some(value.trim_matches('"'));
        }
    }
    found
}

/// The flags before the processors of `isolcpus=managed_irq,domain,2-3`, and the processors.
pub(super) fn isolcpus(value: &str) -> (Vec<&str>, &str) {
    let mut rest = value;
    let mut flags = Vec::new();
    while let Some(flag) = rest.split(',').next()
        && flag.starts_with(|c: char| c.is_ascii_alphabetic())
    {
        flags.push(flag);
        rest = rest.get(flag.len() + 1..).unwrap_or("");
    }
    (flags, rest)
}

/// A line of `/proc/interrupts` that belongs to a numbered interrupt.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Interrupt {
    pub(super) number: u32,
    /// How often it came since boot, per column.
    pub(super) counts: Vec<u64>,
    /// Chip, kind and the names of who handles it.
    pub(super) description: String,
}

/// The processors of the columns, and the numbered interrupts.
pub(super) fn interrupts(text: &str) -> (Vec<u32>, Vec<Interrupt>) {
    let mut lines = text.lines();
    let heads = lines.next().unwrap_or_default().split_whitespace();
    let columns: Vec<u32> = heads
        .filter_map(|head| head.strip_prefix("CPU")?.parse().ok())
        .collect();
    let interrupts = lines.filter_map(|line| interrupt(line, columns.len()));
    (columns.clone(), interrupts.collect())
}

fn interrupt(line: &str, columns: usize) -> Option<Interrupt> {
    let (number, rest) = line.split_once(':')?;
    let number = number.trim().parse().ok()?;
    let mut words = rest.split_whitespace();
    let counts = words
        .by_ref()
        .take(columns)
        .map(|count| count.parse().ok())
        .collect::<Option<Vec<u64>>>()?;
    let description = words.collect::<Vec<_>>().join(" ");
    Some(Interrupt {
        number,
        counts,
        description,
    })
}

/// A soft limit of `/proc/self/limits`. `None` in the outer place if there is no such line, in the inner
/// one if it is unlimited.
pub(super) fn limit(text: &str, name: &str) -> Option<Option<u64>> {
    let rest = text.lines().find_map(|line| line.strip_prefix(name))?;
    match rest.split_whitespace().next()? {
        "unlimited" => Some(None),
        number => number.parse().ok().map(Some),
    }
}

/// Whether a set of capabilities, `CapEff` and the like of a status file, holds the one of that number.
pub(super) fn has_capability(status: &str, set: &str, bit: u32) -> Option<bool> {
    let mask = u64::from_str_radix(field(status, set)?, 16).ok()?;
    Some(mask & (1_u64.checked_shl(bit)?) != 0)
}

/// The first two numbers of a kernel's release, `6.12.48-rt` for instance.
pub(super) fn release(text: &str) -> Option<(u32, u32)> {
    let mut numbers = text.trim().split(|c: char| !c.is_ascii_digit());
    Some((numbers.next()?.parse().ok()?, numbers.next()?.parse().ok()?))
}

/// The path within the hierarchy of a cgroup controller (version 1), from `/proc/self/cgroup`; the empty
/// name is that of version 2.
pub(super) fn cgroup<'a>(text: &'a str, controller: &str) -> Option<&'a str> {
    text.lines().find_map(|line| {
        let (controllers, path) = line.split_once(':')?.1.split_once(':')?;
        controllers
            .split(',')
            .any(|name| name == controller)
            .then_some(path)
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn text_chosen_alternative_is_in_brackets() {
        assert_eq!(chosen("always [madvise] never\n"), "madvise");
        assert_eq!(chosen("none voluntary (full)"), "full");
        assert_eq!(chosen("performance\n"), "performance");
        assert_eq!(chosen("[]"), "[]");
    }

    #[test]
    fn parameters_are_found_quoted_and_with_either_dash() {
        let line = "ro isolcpus=2-3 dyndbg=\"file a.c +p\" rt-group_sched=0 isolcpus=3 quiet\n";
        assert_eq!(parameter(line, "isolcpus"), Some("3"));
        assert_eq!(parameter(line, "dyndbg"), Some("file a.c +p"));
        assert_eq!(parameter(line, "rt_group_sched"), Some("0"));
        assert_eq!(parameter(line, "quiet"), Some(""));
        assert_eq!(parameter(line, "a.c"), None);
    }

    #[test]
    fn isolation_has_flags_before_its_processors() {
        assert_eq!(
            isolcpus("managed_irq,domain,2-3,5"),
            (vec!["managed_irq", "domain"], "2-3,5")
        );
        assert_eq!(isolcpus("2"), (vec![], "2"));
        assert_eq!(isolcpus("nohz"), (vec!["nohz"], ""));
    }

    #[test]
    fn interrupts_are_counted_per_column() {
        let text = "      CPU0   CPU2\n  41:  5  7  PCI-MSIX-0000:00:04.0  1-edge  eth0-rx\nNMI:  1  1  x\n";
        let (columns, found) = interrupts(text);
        assert_eq!(columns, [0, 2]);
        assert_eq!(found.len(), 1);
        assert_eq!(
            (found[0].number, found[0].counts.as_slice()),
            (41, &[5, 7][..])
        );
        assert!(found[0].description.ends_with("eth0-rx"));
    }

    #[test]
    fn limits_and_capabilities_are_read() {
        let text = "Limit   Soft Limit  Hard Limit  Units\nMax locked memory   8388608   unlimited   bytes\nMax realtime priority  unlimited  unlimited\n";
        assert_eq!(limit(text, "Max locked memory"), Some(Some(8_388_608)));
        assert_eq!(limit(text, "Max realtime priority"), Some(None));
        assert_eq!(limit(text, "Max cpu time"), None);
        let status = "Name:\tx\nCapEff:\t0000000000800000\n";
        assert_eq!(has_capability(status, "CapEff", 23), Some(true));
        assert_eq!(has_capability(status, "CapEff", 99), None);
        assert_eq!(
            meminfo_kb("MemAvailable:   12 kB\n", "MemAvailable"),
            Some(12)
        );
    }

    #[test]
    fn cgroups_and_releases_are_read() {
        let text = "4:cpu,cpuacct:/user.slice\n0::/init.scope\n";
        assert_eq!(cgroup(text, "cpu"), Some("/user.slice"));
        assert_eq!(cgroup(text, ""), Some("/init.scope"));
        assert_eq!(cgroup(text, "memory"), None);
        assert_eq!(release("6.1.0-56-rt-amd64"), Some((6, 1)));
        assert_eq!(release("rolling"), None);
    }

    proptest! {
        #[test]
        fn any_text_is_read_or_left_out(text in "[ \\n:a-zA-Z0-9,\\[\\]()\"=/-]{0,80}|\\PC{0,80}", name in "[a-z_]{0,8}") {
            let _ = (chosen(&text), field(&text, &name), entry(&text, &name), meminfo_kb(&text, &name));
            let _ = (parameter(&text, &name), isolcpus(&text), interrupts(&text), limit(&text, &name));
            let _ = (has_capability(&text, &name, 63), release(&text), cgroup(&text, &name));
        }
    }
}
