//! Reads and counts the text that libtest prints. It knows no processes; a run that crashed appears as a group of tests
//! without a result.

/// Result of a run.
#[derive(Debug, Default, PartialEq, Eq)]
pub(crate) struct Tally {
    pub(crate) passed: usize,
    pub(crate) failed: usize,
    /// Name and reason of each skipped test.
    pub(crate) skips: Vec<String>,
    /// Names of the tests that ran, without their modules.
    pub(crate) names: Vec<String>,
    /// Full names of the tests that failed.
    pub(crate) failures: Vec<String>,
    /// Tests that failed beside others and passed when repeated alone.
    pub(crate) unsteady: Vec<String>,
}

impl Tally {
    pub(crate) fn add(&mut self, other: Self) {
        self.passed += other.passed;
        self.failed += other.failed;
        self.skips.extend(other.skips);
        self.names.extend(other.names);
        self.failures.extend(other.failures);
        self.unsteady.extend(other.unsteady);
    }

    /// Counts a failed test that passed when repeated.
    pub(crate) fn pass_repeated(&mut self, name: &str, times: usize) {
        self.failed = self.failed.saturating_sub(1);
        self.passed += 1;
        self.failures.retain(|failed| failed != name);
        self.unsteady.push(format!(
            "{name}: failed beside others, passed {times} times alone"
        ));
    }

    /// Result of an environment that is not available, with the reason.
    pub(crate) fn skipped(why: &str) -> Self {
        Self {
            skips: vec![why.to_owned()],
            ..Self::default()
        }
    }

    /// Applies the lines of the skip file. libtest counted each such test as passed, as a running test cannot report
    /// otherwise.
    pub(crate) fn skip_passed(&mut self, lines: &str) {
        for line in lines.lines().filter(|line| !line.trim().is_empty()) {
            self.passed = self.passed.saturating_sub(1);
            let line = line.trim_start_matches("skipped:").trim();
            self.names.retain(|name| name != test_name(line));
            self.skips.push(line.to_owned());
        }
    }

    /// Adds the results of another environment: a test that was skipped here and ran there is no longer skipped; if it
    /// was skipped in both, that environment's reason counts.
    pub(crate) fn add_environment(&mut self, other: Self) {
        let skipped = |name: &str| other.skips.iter().any(|skip| test_name(skip) == name);
        let ran = |name: &str| other.names.iter().any(|other| other == name);
        self.skips.retain(|skip| {
            let name = test_name(skip);
            !ran(name) && !skipped(name)
        });
        self.add(other);
    }

    /// One line per skip with its reason and per unsteady test, then the count.
    pub(crate) fn summary(&self) -> Vec<String> {
        let skips = self.skips.iter().map(|skip| format!("skipped: {skip}"));
        let unsteady = self.unsteady.iter().map(|test| format!("unsteady: {test}"));
        let mut lines: Vec<String> = skips.chain(unsteady).collect();
        let (passed, failed, skipped) = (self.passed, self.failed, self.skips.len());
        lines.push(format!(
            "{passed} passed, {failed} failed, {skipped} skipped"
        ));
        lines
    }
}

/// Test name of a line `modules::name: reason`, without modules.
pub(crate) fn test_name(line: &str) -> &str {
    let name = line.split(": ").next().unwrap_or(line);
    name.rsplit("::").next().unwrap_or(name)
}

/// Section of a test binary's text.
#[derive(Debug, Default, PartialEq, Eq)]
enum Section {
    /// Between two binaries.
    #[default]
    Outside,
    /// Among the lines `test … ok`.
    Tests,
    /// In the output of failed tests, which is shown but not parsed.
    Failures,
}

/// Reads the text of one cargo line.
#[derive(Debug, Default)]
pub(crate) struct Reader {
    tally: Tally,
    section: Section,
}

impl Reader {
    /// Parses one line; true if it is to be shown.
    pub(crate) fn line(&mut self, line: &str) -> bool {
        if let Some(counts) = line.strip_prefix("test result: ") {
            return self.result(counts);
        }
        match self.section {
            Section::Outside => {
                if line.starts_with("running ") {
                    self.section = Section::Tests;
                }
                let dull = line.is_empty() || line.starts_with("all doctests ran");
                !dull && self.section == Section::Outside
            }
            Section::Tests => self.test_line(line),
            Section::Failures => true,
        }
    }

    fn test_line(&mut self, line: &str) -> bool {
        if line == "failures:" {
            self.section = Section::Failures;
            return true;
        }
        let Some((name, verdict)) = line
            .strip_prefix("test ")
            .and_then(|l| l.split_once(" ... "))
        else {
            return !line.is_empty();
        };
        if let Some(rest) = verdict.strip_prefix("ignored") {
            let reason = rest.trim_start_matches(',').trim();
            let reason = if reason.is_empty() {
                "ignored without a reason"
            } else {
                reason
            };
            self.tally.skips.push(format!("{name}: {reason}"));
        }
        if matches!(verdict, "ok" | "FAILED") {
            self.tally.names.push(test_name(name).to_owned());
        }
        if verdict == "FAILED" {
            self.tally.failures.push(name.to_owned());
        }
        verdict != "ok" && !verdict.starts_with("ignored")
    }

    /// `ok. 3 passed; 0 failed; 1 ignored; …`. Ignored tests were counted by their own lines.
    fn result(&mut self, counts: &str) -> bool {
        let count = |what: &str| {
            let before = counts.split(what).next()?;
            before.split_whitespace().next_back()?.parse::<usize>().ok()
        };
        let passed = count(" passed;").unwrap_or(0);
        let failed = count(" failed;").unwrap_or(0);
        self.tally.passed += passed;
        self.tally.failed += failed;
        self.section = Section::Outside;
        passed + failed > 0
    }

    /// `good` is cargo's exit status. A binary that crashed, or code that did not compile, counts as one failure, so
    /// that it does not vanish from the count.
    pub(crate) fn finish(mut self, good: bool) -> Tally {
        if self.section != Section::Outside || (!good && self.tally.failed == 0) {
            self.tally.failed += 1;
        }
        self.tally
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str, good: bool) -> (Tally, Vec<String>) {
        let mut reader = Reader::default();
        let shown = text
            .lines()
            .filter(|line| reader.line(line))
            .map(String::from)
            .collect();
        (reader.finish(good), shown)
    }

    const TWO_BINARIES: &str = "
running 3 tests
test a::one ... ok
test a::two ... ignored, needs a bus
test a::three ... ok

test result: ok. 2 passed; 0 failed; 1 ignored; 0 measured; 0 filtered out; finished in 0.00s

running 1 test
test src/lib.rs - Cycle (line 3) ... ok

test result: ok. 1 passed; 0 failed; 0 ignored; 0 measured; 0 filtered out; finished in 0.10s
";

    const FAILURE: &str = "
running 2 tests
test good ... ok
test bad ... FAILED

failures:

---- bad stdout ----
test liar ... ignored, inside a failure's text
panicked

failures:
    bad

test result: FAILED. 1 passed; 1 failed; 0 ignored; 0 measured; 0 filtered out; finished in 0.00s
";

    #[test]
    fn tally_adds_binaries_and_keeps_ignore_reason() {
        let (tally, shown) = read(TWO_BINARIES, true);
        assert_eq!((tally.passed, tally.failed), (3, 0));
        assert_eq!(tally.skips, ["a::two: needs a bus"]);
        assert_eq!(
            shown.len(),
            2,
            "only the results are worth showing: {shown:?}"
        );
    }

    #[test]
    fn tally_shows_failure_text_without_counting_it() {
        let (tally, shown) = read(FAILURE, false);
        assert_eq!((tally.passed, tally.failed), (1, 1));
        assert!(tally.skips.is_empty());
        assert!(shown.iter().any(|line| line == "panicked"));
        assert!(shown.iter().any(|line| line == "test bad ... FAILED"));
    }

    #[test]
    fn tally_build_error_is_one_failure() {
        assert_eq!(read("", false).0.failed, 1);
    }

    #[test]
    fn tally_crashed_binary_is_one_failure() {
        assert_eq!(
            read("running 2 tests\ntest good ... ok\n", false).0.failed,
            1
        );
    }

    #[test]
    fn tally_skipping_test_is_not_passed() {
        let (mut tally, _) = read(TWO_BINARIES, true);
        tally.skip_passed("skipped: three: needs CAP_NET_RAW\n\n");
        assert_eq!(
            tally.summary(),
            [
                "skipped: a::two: needs a bus",
                "skipped: three: needs CAP_NET_RAW",
                "2 passed, 0 failed, 2 skipped"
            ]
        );
    }

    #[test]
    fn tally_test_run_in_environment_is_not_skipped() {
        let (mut here, _) = read(TWO_BINARIES, true);
        here.skip_passed("three: needs vcan\n");
        let there = "running 2 tests\ntest b::three ... ok\ntest b::four ... ok\n\
                     test result: ok. 2 passed; 0 failed; 0 ignored;";
        let (mut there, _) = read(there, true);
        there.skip_passed("four: needs a peer");
        here.add_environment(there);
        assert_eq!(
            here.summary(),
            [
                "skipped: a::two: needs a bus",
                "skipped: four: needs a peer",
                "3 passed, 0 failed, 2 skipped"
            ]
        );
    }

    #[test]
    fn tally_skip_in_both_environments_uses_last_reason() {
        let mut here = Tally::default();
        let mut there = Tally::default();
        for (tally, why) in [(&mut here, "vcan"), (&mut there, "python-can")] {
            tally.passed = 1;
            tally.skip_passed(&format!("three: needs {why}"));
        }
        here.add_environment(there);
        assert_eq!(
            here.summary(),
            [
                "skipped: three: needs python-can",
                "0 passed, 0 failed, 1 skipped"
            ]
        );
    }

    #[test]
    fn tally_test_failed_in_environment_is_not_skipped() {
        let mut here = Tally {
            passed: 1,
            ..Tally::default()
        };
        here.skip_passed("bad: needs vcan");
        here.add_environment(read(FAILURE, false).0);
        assert_eq!(here.summary(), ["1 passed, 1 failed, 0 skipped"]);
    }

    #[test]
    fn tally_ignore_without_reason_is_reported() {
        let (tally, _) = read(
            "running 1 test\ntest a ... ignored\ntest result: ok. 0 passed; 0 failed; 1 ignored;",
            true,
        );
        assert_eq!(tally.skips, ["a: ignored without a reason"]);
    }
}
