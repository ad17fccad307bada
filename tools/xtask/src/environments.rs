//! Runs tests outside of cargo: those that failed are repeated alone, and those that the host cannot run go elsewhere: those skipped for a missing bus run again where the bus exists, and real-time
//! tests run on a real-time kernel. A network namespace is preferred to a virtual machine, as it costs nothing. Tests
//! with other missing requirements stay skipped.

mod namespace;
mod networks;

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use anyhow::Context;

use crate::binaries::{self, Binary, Built, TestRun};
use crate::cargo::{self, Cargo, note};
use crate::metadata::Workspace;
use crate::parts::Part;
use crate::shell::{Line, quoted};
use crate::test::repeat;
use crate::test::tally::{Reader, Tally, test_name};
use crate::vm::{self, Guest, Unavailable};
pub(crate) use networks::NETWORKS;

/// The packages whose tests also run on the real-time kernel.
const ON_THE_KERNEL: &[&str] = &["takt-rt"];

/// Variable with the Python that has the test peers' modules.
const PYTHON: &str = "TAKT_PYTHON";

/// A bus that tests need.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Bus {
    /// A virtual CAN interface.
    Vcan,
    /// A CAN controller with errors and a bit rate.
    Can,
    /// An Ethernet cable.
    Veth,
}

impl Bus {
    /// The buses that the reason of a skip names.
    fn wanted_by(reason: &str) -> BTreeSet<Self> {
        let reason = reason.to_lowercase();
        let words = [
            ("vcan", Self::Vcan),
            ("takt_can_pair", Self::Can),
            ("veth", Self::Veth),
        ];
        let found = words.iter().filter(|(word, _)| reason.contains(word));
        found.map(|(_, bus)| *bus).collect()
    }
}

/// Where tests run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Environment {
    Host,
    Namespace,
    Machine,
}

/// Runs the tests of the parts (none: all) that need another environment. `lines` are the cargo lines that built the
/// tests, `skipped` is the content of the skip file.
pub(crate) fn test(
    root: &Path,
    parts: &[&Part],
    lines: &[Cargo],
    skipped: &str,
) -> anyhow::Result<Tally> {
    let mut tally = Tally::default();
    let asked: Vec<(&str, BTreeSet<Bus>)> = skipped
        .lines()
        .map(|line| (test_name(line), Bus::wanted_by(line)))
        .filter(|(_, buses)| !buses.is_empty())
        .collect();
    let kernel = vm::wants_kernel(parts);
    let service = vm::wants_service(parts);
    if asked.is_empty() && !kernel && !service {
        return Ok(tally);
    }
    let built = Built::by(root, lines)?;
    let (here, mut there) = test_runs(&built.tests, &asked, namespace::has);
    if kernel {
        there.extend(of_kernel(root, built.tests)?);
    }
    let python = match asked[..] {
        [] => None,
        _ => vm::peers(root)?,
    };
    let python = python.as_deref();
    tally.add(run(root, Environment::Namespace, &here, python)?);
    tally.add(run(root, Environment::Machine, &there, python)?);
    if service {
        tally.add(vm::service(root, built.takt.as_deref())?);
    }
    Ok(tally)
}

/// Splits the tests between namespace and machine.
fn test_runs(
    binaries: &[Binary],
    asked: &[(&str, BTreeSet<Bus>)],
    namespace_has: impl Fn(Bus) -> bool,
) -> (Vec<TestRun>, Vec<TestRun>) {
    if asked.is_empty() {
        return (Vec::new(), Vec::new());
    }
    let wanted: BTreeSet<Bus> = asked.iter().flat_map(|(_, buses)| buses).copied().collect();
    let had: BTreeSet<Bus> = wanted
        .into_iter()
        .filter(|bus| namespace_has(*bus))
        .collect();
    let (near, far): (Vec<_>, Vec<_>) = asked.iter().partition(|(_, buses)| buses.is_subset(&had));
    let (mut here, mut there) = (Vec::new(), Vec::new());
    for binary in binaries {
        let tests = binary.tests();
        for (asked, test_runs) in [(&near, &mut here), (&far, &mut there)] {
            let asked = |test: &&String| asked.iter().any(|(name, _)| *name == last(test));
            let tests: Vec<String> = tests.iter().filter(asked).cloned().collect();
            if !tests.is_empty() {
                let binary = binary.clone();
                test_runs.push(TestRun { binary, tests });
            }
        }
    }
    (here, there)
}

/// A test's name without its modules.
fn last(test: &str) -> &str {
    test.rsplit("::").next().unwrap_or(test)
}

/// All tests of the real-time crates except models of thread interleavings: those do not depend on the kernel, and take
/// long.
fn of_kernel(root: &Path, mut binaries: Vec<Binary>) -> anyhow::Result<Vec<TestRun>> {
    let packages = Workspace::load(root)?.packages;
    let folders: Vec<_> = packages
        .iter()
        .filter(|package| ON_THE_KERNEL.contains(&package.name.as_str()))
        .map(|package| root.join(&package.dir))
        .collect();
    let is_model = |binary: &Binary| binary.program.iter().any(|part| part == "loom");
    binaries.retain(|binary| folders.contains(&binary.folder) && !is_model(binary));
    let all = |binary| TestRun {
        binary,
        tests: Vec::new(),
    };
    Ok(binaries.into_iter().map(all).collect())
}

/// Repeats the failed tests of these binaries on this host.
pub(crate) fn repeat(root: &Path, tally: &mut Tally, binaries: &[Binary]) -> anyhow::Result<()> {
    repeat::failed(tally, binaries, |tests| {
        once(root, Environment::Host, tests, None)
    })
}

/// Runs the tests in an environment, repeats those that failed, and counts them.
fn run(
    root: &Path,
    environment: Environment,
    test_runs: &[TestRun],
    python: Option<&Path>,
) -> anyhow::Result<Tally> {
    let mut tally = once(root, environment, test_runs, python)?;
    let binaries: Vec<Binary> = test_runs.iter().map(|run| run.binary.clone()).collect();
    repeat::failed(&mut tally, &binaries, |tests| {
        once(root, environment, tests, python)
    })?;
    Ok(tally)
}

/// Runs the tests in an environment and counts them. A test that skips itself there too has not passed. Tests with a
/// Python peer get its path, unless the user has set it.
fn once(
    root: &Path,
    environment: Environment,
    test_runs: &[TestRun],
    python: Option<&Path>,
) -> anyhow::Result<Tally> {
    if test_runs.is_empty() {
        return Ok(Tally::default());
    }
    let skips = cargo::target_dir(root).join(format!("xtask-skips-there-{}", std::process::id()));
    fs::write(&skips, "").with_context(|| format!("cannot write {}", skips.display()))?;
    let given = std::env::var(PYTHON).ok();
    let python = given.or_else(|| Some(python?.to_string_lossy().into_owned()));
    let script = binaries::script(test_runs, &skips);
    let script = match python {
        Some(python) => format!("export {PYTHON}={}\n{script}", quoted(&python)),
        None => script,
    };
    let count = test_runs.len();
    let mut reader = Reader::default();
    let show = |text: &str| {
        if reader.line(text) {
            cargo::say(text);
        }
    };
    let status = match environment {
        Environment::Host => Line::new("sh").args(["-c", &script]).lines(show)?,
        Environment::Namespace => {
            note(&format!("{count} test binaries run in a network namespace"));
            namespace::run(root, &script, show)?
        }
        Environment::Machine => match Guest::prepare(root)? {
            Ok(guest) => {
                note(&format!("{count} test binaries run in a virtual machine"));
                guest.test(&script, show)?
            }
            Err(Unavailable(why)) => {
                fs::remove_file(&skips)?;
                return Ok(Tally::skipped(&format!(
                    "tests in a virtual machine: {why}"
                )));
            }
        },
    };
    let skipped = fs::read_to_string(&skips).unwrap_or_default();
    fs::remove_file(&skips)?;
    let mut tally = reader.finish(status == 0);
    tally.skip_passed(&skipped);
    Ok(tally)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn skip_reason_names_bus() {
        let wanted = |reason| Vec::from_iter(Bus::wanted_by(reason));
        assert_eq!(wanted("a: needs vcan"), [Bus::Vcan]);
        assert_eq!(wanted("a: needs TAKT_VCAN=vcan0"), [Bus::Vcan]);
        let pair = "a: needs two CAN controllers on one wire (TAKT_CAN_PAIR=can0,can1)";
        assert_eq!(wanted(pair), [Bus::Can]);
        assert_eq!(
            wanted("a: needs a veth pair and vcan"),
            [Bus::Vcan, Bus::Veth]
        );
        assert_eq!(wanted("a: needs systemd-analyze"), []);
    }

    #[test]
    fn skipped_test_uses_nearest_environment_with_bus() {
        // This binary itself lists its tests.
        let binary = Binary {
            program: std::env::current_exe().unwrap(),
            folder: env!("CARGO_MANIFEST_DIR").into(),
        };
        let near = "skip_reason_names_bus";
        let far = "skipped_test_uses_nearest_environment_with_bus";
        let asked = [
            (near, BTreeSet::from([Bus::Veth])),
            (far, BTreeSet::from([Bus::Veth, Bus::Vcan])),
            ("elsewhere_there_is_none", BTreeSet::from([Bus::Vcan])),
        ];
        let (here, there) = test_runs(&[binary], &asked, |bus| bus == Bus::Veth);
        let tests = |test_runs: &[TestRun]| -> Vec<String> {
            test_runs
                .iter()
                .flat_map(|test_run| test_run.tests.clone())
                .collect()
        };
        assert_eq!(tests(&here), [format!("environments::tests::{near}")]);
        assert_eq!(tests(&there), [format!("environments::tests::{far}")]);
    }
}
