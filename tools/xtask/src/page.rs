//! The type check of the web page: its modules carry JSDoc types, which the TypeScript compiler checks. The page itself needs no
//! build step and nothing of this.

use std::path::Path;

use crate::cargo;
use crate::shell::{self, Line};
use crate::test::tally::Tally;

/// The page, relative to the root.
const PAGE: &str = "rcc/server/page";
/// Pinned version of the compiler.
const PACKAGE: &str = include_str!("../../../rcc/server/page/package.json");
/// Longest installation and longest check, s.
const TIME_MAX: u64 = 300;

/// Checks the page; counts as one test.
pub(crate) fn test(root: &Path) -> anyhow::Result<Tally> {
    if !shell::exists("node") || !shell::exists("npm") {
        return Ok(Tally::skipped("types of the page: needs node and npm"));
    }
    let folder = cargo::target_dir(root).join("page");
    let complete = folder.join("complete");
    if !std::fs::read_to_string(&complete).is_ok_and(|has| has == PACKAGE) {
        std::fs::create_dir_all(&folder)?;
        std::fs::write(folder.join("package.json"), PACKAGE)?;
        let fetch = Line::new("npm")
            .args(["install", "--no-audit", "--no-fund", "--loglevel=error"])
            .within(&folder)
            .limited(TIME_MAX);
        if !fetch.succeeds()? {
            let why = "types of the page: npm cannot install typescript";
            return Ok(Tally::skipped(why));
        }
        std::fs::write(&complete, PACKAGE)?;
    }
    let check = Line::new("node")
        .arg(folder.join("node_modules/typescript/bin/tsc"))
        .arg("--project")
        .arg(root.join(PAGE).join("tsconfig.json"))
        .limited(TIME_MAX);
    let good = check.succeeds()?;
    Ok(Tally {
        passed: usize::from(good),
        failed: usize::from(!good),
        ..Tally::default()
    })
}
