//! Repeats failed tests alone. Tests of moving robots beside other tests on a shared host fail when the host stalls; a
//! test that passes alone, twice in a row, is reported as unsteady and counts as passed. A defect fails again.

use crate::binaries::{Binary, TestRun};
use crate::cargo::note;

use super::tally::Tally;

/// How often a test must pass, one run after the other.
const TIMES: usize = 2;

/// More failures than that have one cause, and are not repeated.
const MOST: usize = 12;

/// Whether there is anything to repeat.
pub(crate) fn is_wanted(tally: &Tally) -> bool {
    (1..=MOST).contains(&tally.failures.len())
}

/// Repeats the failed tests. `run` runs tests in the environment in which they failed, one at a time.
pub(crate) fn failed(
    tally: &mut Tally,
    binaries: &[Binary],
    mut run: impl FnMut(&[TestRun]) -> anyhow::Result<Tally>,
) -> anyhow::Result<()> {
    if !is_wanted(tally) {
        return Ok(());
    }
    note("the failed tests are repeated alone");
    for name in tally.failures.clone() {
        let runs = test_runs(&name, binaries);
        if !runs.is_empty() && passes(&runs, &mut run)? {
            tally.pass_repeated(&name, TIMES);
        }
    }
    Ok(())
}

/// The test in each binary that has one of this name: libtest does not print which of them failed.
fn test_runs(name: &str, binaries: &[Binary]) -> Vec<TestRun> {
    let has = |binary: &&Binary| binary.tests().iter().any(|test| test == name);
    let run = |binary: &Binary| TestRun {
        binary: binary.clone(),
        tests: vec![name.to_owned()],
    };
    binaries.iter().filter(has).map(run).collect()
}

fn passes(
    runs: &[TestRun],
    run: &mut impl FnMut(&[TestRun]) -> anyhow::Result<Tally>,
) -> anyhow::Result<bool> {
    for _ in 0..TIMES {
        let tally = run(runs)?;
        if tally.failed > 0 || tally.passed != runs.len() {
            return Ok(false);
        }
    }
    Ok(true)
}

#[cfg(test)]
mod tests {
    use super::*;

    const NAME: &str = "test::repeat::tests::failed_test_passing_alone_is_unsteady";

    /// This binary itself, which lists its tests.
    fn binaries() -> Vec<Binary> {
        vec![Binary {
            program: std::env::current_exe().unwrap(),
            folder: env!("CARGO_MANIFEST_DIR").into(),
        }]
    }

    fn tally(failures: &[&str]) -> Tally {
        Tally {
            failed: failures.len(),
            failures: failures.iter().map(ToString::to_string).collect(),
            ..Tally::default()
        }
    }

    fn result(passed: usize, failed: usize) -> Tally {
        Tally {
            passed,
            failed,
            ..Tally::default()
        }
    }

    #[test]
    fn failed_test_passing_alone_is_unsteady() {
        let (mut tally, mut runs) = (tally(&[NAME]), 0);
        failed(&mut tally, &binaries(), |tests| {
            runs += 1;
            assert_eq!(tests.len(), 1);
            assert_eq!(tests[0].tests, [NAME]);
            Ok(result(1, 0))
        })
        .unwrap();
        assert_eq!(runs, TIMES);
        let unsteady =
            format!("unsteady: {NAME}: failed beside others, passed {TIMES} times alone");
        assert_eq!(
            tally.summary(),
            [unsteady, "1 passed, 0 failed, 0 skipped".to_owned()]
        );
    }

    #[test]
    fn failed_test_failing_once_alone_stays_failed() {
        for last in [result(0, 1), result(0, 0)] {
            let (mut tally, mut left) = (tally(&[NAME]), TIMES);
            failed(&mut tally, &binaries(), |_| {
                left -= 1;
                let last = Tally {
                    passed: last.passed,
                    failed: last.failed,
                    ..Tally::default()
                };
                Ok(if left == 0 { last } else { result(1, 0) })
            })
            .unwrap();
            assert_eq!(tally.summary(), ["0 passed, 1 failed, 0 skipped"]);
        }
    }

    #[test]
    fn unknown_or_too_many_failures_are_not_repeated() {
        let many = vec![NAME; MOST + 1];
        for failures in [&["src/lib.rs - Cycle (line 3)"][..], &many] {
            let mut tally = tally(failures);
            failed(&mut tally, &binaries(), |_| panic!("nothing to run")).unwrap();
            assert_eq!(tally.failed, failures.len());
        }
    }
}
