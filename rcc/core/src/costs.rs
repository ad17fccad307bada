//! Cost tables: the cost of each primitive on a host, measured by `takt net calibrate`, in a TOML file.
//! The controller uses it for admission control. The measurement is in the tools.
//!
//! ```toml
//! version = 1
//! host = "cell-3"                   # where, with what and when it was measured
//! cpu = "Intel(R) Core(TM) i7-9700"
//! kernel = "6.12.9-rt"
//! date = "2026-11-21"
//!
//! [primitive]
//! "Core::DoubleAdd" = { first_ns = 210.0, ns = 11.5, element_ns = 0.0 }
//! ```

use std::collections::BTreeMap;
use std::fs::read_to_string;
use std::path::Path;

use serde::{Deserialize, Serialize};
use takt_net::{Cost, Registry};

use crate::error::Error;
use crate::files;

/// Version of the format, written and required when reading.
const VERSION: u32 = 1;
/// Maximum accepted cost, ns: a primitive that takes a second is a typing error.
const LARGEST_NS: f64 = 1e9;

/// Costs of primitives on a host.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CostTable {
    /// Version of the format.
    version: u32,
    /// Name of the host.
    pub host: String,
    /// Model of its processor. The table is valid only for it.
    pub cpu: String,
    /// Release of its kernel.
    pub kernel: String,
    /// When it was measured, UTC: `2026-11-21`.
    pub date: String,
    /// Costs by the full names of primitives.
    #[serde(rename = "primitive")]
    primitives: BTreeMap<String, Row>,
}

/// The figures of one primitive; see [`Cost`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Row {
    first_ns: f64,
    ns: f64,
    element_ns: f64,
}

impl CostTable {
    /// Costs measured on this host.
    #[must_use]
    pub fn of_this_host(date: String, costs: impl IntoIterator<Item = (String, Cost)>) -> Self {
        let row = |cost: Cost| Row {
            first_ns: cost.first_ns,
            ns: cost.ns,
            element_ns: cost.element_ns,
        };
        let rows = costs.into_iter().map(|(name, cost)| (name, row(cost)));
        Self {
            version: VERSION,
            host: line_of("/proc/sys/kernel/hostname"),
            cpu: this_cpu(),
            kernel: line_of("/proc/sys/kernel/osrelease"),
            date,
            primitives: rows.collect(),
        }
    }

    /// Reads a file.
    ///
    /// # Errors
    /// If it cannot be read, is not a table of this version, or a cost is invalid.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let text = files::read_text(path, files::TEXT_BYTES_MAX).map_err(|source| Error::File {
            path: path.to_owned(),
            source,
        })?;
        Self::parse(&text).map_err(|why| Error::Config {
            path: path.to_owned(),
            why,
        })
    }

    fn parse(text: &str) -> Result<Self, String> {
        #[derive(Deserialize)]
        struct Versioned {
            version: u32,
        }
        // First, because another version may have other fields.
        let Versioned { version } = toml::from_str(text).map_err(|e| e.to_string())?;
        if version != VERSION {
            return Err(format!(
                "the cost table has version {version}, this is for version {VERSION}; measure again \
                 with `takt net calibrate`"
            ));
        }
        let table: Self = toml::from_str(text).map_err(|e| e.to_string())?;
        for (name, row) in &table.primitives {
            for (field, ns) in [
                ("first_ns", row.first_ns),
                ("ns", row.ns),
                ("element_ns", row.element_ns),
            ] {
                if !(0.0..=LARGEST_NS).contains(&ns) {
                    return Err(format!(
                        "{name}: {field} is {ns}; it must be 0 to {LARGEST_NS}"
                    ));
                }
            }
        }
        Ok(table)
    }

    /// The file's text.
    #[must_use]
    pub fn text(&self) -> String {
        let Self {
            version,
            host,
            cpu,
            kernel,
            date,
            primitives,
        } = self;
        // One line per primitive, where the serializer would write a section of five.
        let quoted = |text: &str| toml::Value::from(text).to_string();
        let [host, cpu, kernel, date] = [host, cpu, kernel, date].map(|text| quoted(text));
        let mut text = format!(
            "# What primitives cost at most on this host, measured by `takt net calibrate`.\n\
             version = {version}\nhost = {host}\ncpu = {cpu}\nkernel = {kernel}\ndate = {date}\n\n\
             [primitive]\n"
        );
        for (name, row) in primitives {
            let Row {
                first_ns,
                ns,
                element_ns,
            } = row;
            let name = quoted(name);
            text += &format!(
                "{name} = {{ first_ns = {first_ns:?}, ns = {ns:?}, element_ns = {element_ns:?} }}\n"
            );
        }
        text
    }

    /// The costs by name.
    pub fn costs(&self) -> impl Iterator<Item = (&str, Cost)> {
        self.primitives.iter().map(|(name, row)| {
            let cost = Cost {
                first_ns: row.first_ns,
                ns: row.ns,
                element_ns: row.element_ns,
            };
            (&**name, cost)
        })
    }

    /// Whether it was measured on a processor like that of this host.
    ///
    /// # Errors
    /// If not.
    pub fn check_host(&self) -> Result<(), String> {
        let here = this_cpu();
        if self.cpu == here {
            return Ok(());
        }
        Err(format!(
            "the cost table was measured on `{}` (host {}), this host has `{here}`; measure again with \
             `takt net calibrate`",
            self.cpu, self.host
        ))
    }
}

/// All primitives of a controller, with their costs from the table at `path`, if given.
///
/// # Errors
/// If the table cannot be read or belongs to another processor: its costs are not valid here.
pub(crate) fn registry(path: Option<&Path>) -> Result<Registry, Error> {
    let mut registry = crate::registry();
    let Some(path) = path else {
        return Ok(registry);
    };
    let table = CostTable::read(path)?;
    table.check_host().map_err(|why| Error::Config {
        path: path.to_owned(),
        why,
    })?;
    let unknown = registry.set_costs(table.costs());
    if !unknown.is_empty() {
        tracing::warn!(
            table = %path.display(),
            primitives = unknown.join(", "),
            "the cost table names primitives that do not exist"
        );
    }
    Ok(registry)
}

fn this_cpu() -> String {
    let info = read_to_string("/proc/cpuinfo").unwrap_or_default();
    cpu_in(&info)
}

/// The model in the text of `/proc/cpuinfo`. Some architectures have numbers instead of names.
fn cpu_in(info: &str) -> String {
    let field = |name: &str| {
        let mut fields = info.lines().filter_map(|line| line.split_once(':'));
        let value = fields.find(|(key, _)| key.trim() == name)?.1.trim();
        (!value.is_empty()).then(|| value.to_owned())
    };
    let by_number = || {
        let (maker, part) = (field("CPU implementer")?, field("CPU part")?);
        Some(format!("implementer {maker} part {part}"))
    };
    let named = field("model name").or_else(by_number);
    named.unwrap_or_else(|| "unknown".to_owned())
}

fn line_of(path: &str) -> String {
    let text = read_to_string(path).unwrap_or_default();
    text.trim().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cost(ns: f64) -> Cost {
        Cost {
            first_ns: 150.0,
            ns,
            element_ns: 0.25,
        }
    }

    fn table() -> CostTable {
        let costs = [("Core::DoubleAdd", 11.5), ("Core::Nothing", 1.0)];
        let costs = costs.map(|(name, ns)| (name.to_owned(), cost(ns)));
        CostTable::of_this_host("2026-11-21".to_owned(), costs)
    }

    #[test]
    fn what_is_written_is_read() {
        let table = CostTable {
            host: "a \"quoted\" \\ \u{1b} name".to_owned(),
            ..table()
        };
        assert_eq!(CostTable::parse(&table.text()), Ok(table.clone()));
        assert_eq!(table.costs().count(), 2);
    }

    #[test]
    fn cost_table_replaces_only_named_costs() {
        let mut registry = crate::registry();
        let declared = registry.find("Core::DoubleMultiply").unwrap().cost;
        assert_eq!(registry.set_costs(table().costs()), ["Core::Nothing"]);
        assert_eq!(registry.find("Core::DoubleAdd").unwrap().cost, cost(11.5));
        assert_eq!(
            registry.find("Core::DoubleMultiply").unwrap().cost,
            declared
        );
    }

    #[test]
    fn cost_table_of_other_processor_is_rejected() {
        let here = table();
        assert_eq!(here.check_host(), Ok(()));
        let other = CostTable {
            cpu: "Z80".to_owned(),
            ..here
        };
        let why = other.check_host().unwrap_err();
        assert!(why.contains("`Z80`") && why.contains("calibrate"), "{why}");
    }

    #[test]
    fn cost_table_faults_name_the_field() {
        let good = table().text();
        for (was, is, said) in [
            ("version = 1", "version = 2", "has version 2"),
            ("version = 1", "", "missing field `version`"),
            ("ns = 11.5", "ns = -1.0", "Core::DoubleAdd: ns is -1"),
            ("ns = 11.5", "ns = nan", "Core::DoubleAdd: ns is NaN"),
            ("first_ns = 150.0", "first = 1", "unknown field `first`"),
        ] {
            assert!(good.contains(was));
            let error = CostTable::parse(&good.replacen(was, is, 1)).unwrap_err();
            assert!(error.contains(said), "{error}");
        }
    }

    #[test]
    fn cpuinfo_gives_name_or_number() {
        for (info, cpu) in [
            (
                "processor\t: 0\nmodel name\t: A B\nmodel name\t: C\n",
                "A B",
            ),
            (
                "CPU implementer\t: 0x41\nCPU part\t: 0xd0b\n",
                "implementer 0x41 part 0xd0b",
            ),
            ("model name\t:\n", "unknown"),
        ] {
            assert_eq!(cpu_in(info), cpu);
        }
    }
}
