//! All conditions in the order of the report, and their examination on a host. The conditions themselves are in the
//! modules of their groups.

use super::condition::{Check, Condition, Finding};
use super::host::Host;
use super::{can, clock, irq, isolation, kernel, memory, nic, power, rights, service};

/// Groups in the order of the report, each with its table.
pub(super) const GROUPS: &[(&str, &[Condition])] = &[
    ("kernel", kernel::CONDITIONS),
    ("isolation", isolation::CONDITIONS),
    ("interrupts", irq::CONDITIONS),
    ("power", power::CONDITIONS),
    ("memory", memory::CONDITIONS),
    ("clock", clock::CONDITIONS),
    ("rights of this user", rights::CONDITIONS),
    ("rights of the service", service::CONDITIONS),
    ("network", nic::CONDITIONS),
    ("CAN", can::CONDITIONS),
];

/// A condition with its finding.
#[derive(Clone, Debug)]
pub(super) struct Row {
    pub(super) group: &'static str,
    /// The condition's name, with the interface after a space where it is about one.
    pub(super) name: String,
    pub(super) why: &'static str,
    pub(super) finding: Finding,
}

/// Checks all conditions of a host.
pub(super) fn examine(host: &Host) -> Vec<Row> {
    let rows = GROUPS.iter().flat_map(|(group, conditions)| {
        conditions
            .iter()
            .flat_map(move |condition| check(host, group, condition))
    });
    rows.collect()
}

fn check(host: &Host, group: &'static str, condition: &Condition) -> Vec<Row> {
    let row = |name: String, finding| Row {
        group,
        name,
        why: condition.why,
        finding,
    };
    let per_interface = |interfaces: Vec<String>, check: fn(&Host, &str) -> Finding, none: &str| {
        if interfaces.is_empty() {
            return vec![row(condition.name.to_owned(), Finding::skip(none))];
        }
        let rows = interfaces.iter().map(|interface| {
            let name = format!("{} {interface}", condition.name);
            row(name, check(host, interface))
        });
        rows.collect()
    };
    match condition.check {
        Check::Host(check) => vec![row(condition.name.to_owned(), check(host))],
        Check::Nic(check) => per_interface(nic::interfaces(host), check, "no network adapter"),
        Check::Can(check) => per_interface(can::interfaces(host), check, "no CAN interface"),
    }
}
