//! Names and texts use the terms of the field. A word of the table is a finding in Rust (identifiers, comments and
//! strings) and in Markdown, as a whole word or as a part of an identifier. Grammar and style are not checked.

use super::Finding;
use crate::metadata::Workspace;
use crate::tree::{File, Tree};

/// Banned words, each with what to write instead.
type Words = [(&'static str, &'static str)];

const BANNED: &Words = &[
    ("told", "reported, published, commanded or configured"),
    ("tell", "report, publish, return or print"),
    ("tells", "reports, publishes, returns or prints"),
    ("telling", "reporting, publishing, returning or printing"),
    ("heard", "received or observed"),
    ("hear", "receive or observe"),
    ("hears", "receives or observes"),
    ("anew", "again, or a verb with re-"),
    ("desk", "registry, controller state or what it is"),
    ("herald", "event sender"),
    ("farewell", "shutdown, stop or grace period"),
    ("mend", "fix, repair or recover"),
    ("mends", "fixes, repairs or recovers"),
    ("mended", "fixed, repaired or recovered"),
    ("whoever", "a client, a peer or another process"),
    ("somebody", "a client, a peer or another process"),
    ("nobody", "no client, no peer or no one"),
    ("bears", "supports, tolerates or withstands"),
    ("news", "event or notification"),
    ("wish", "request or pending order"),
    ("wishes", "requests or pending orders"),
    ("patience", "timeout, deadline or tolerance"),
];

/// A file, or a folder that ends in `/`, in which some banned words are correct.
#[derive(Debug)]
struct Exemption {
    path: &'static str,
    words: &'static [&'static str],
    /// Why they are correct.
    reason: &'static str,
}

const fn exempt(
    path: &'static str,
    words: &'static [&'static str],
    reason: &'static str,
) -> Exemption {
    Exemption {
        path,
        words,
        reason,
    }
}

const EXEMPTIONS: &[Exemption] = &[
    exempt(THIS_FILE, &[], "the table of banned words"),
    exempt("tools/src/fri/report.rs", &["heard"], "a JSON key"),
    exempt("tools/src/can/scan/survey.rs", &["nobody"], "a JSON value"),
];

const THIS_FILE: &str = "tools/xtask/src/tidy/words.rs";

impl Exemption {
    /// No words means all.
    fn covers(&self, path: &str, word: &str) -> bool {
        let inside = self.path == path || (self.path.ends_with('/') && path.starts_with(self.path));
        inside && (self.words.is_empty() || self.words.contains(&word))
    }
}

pub(super) fn check(_: &Workspace, tree: &Tree) -> Vec<Finding> {
    check_with(tree, BANNED, EXEMPTIONS)
}

fn check_with(tree: &Tree, banned: &Words, exemptions: &[Exemption]) -> Vec<Finding> {
    let texts = tree.files.iter().filter(|file| is_checked(&file.path));
    let hits: Vec<Hit<'_>> = texts.flat_map(|file| hits(file, banned)).collect();
    let is_exempt = |hit: &&Hit<'_>| exemptions.iter().any(|e| e.covers(hit.path, hit.word));
    let mut findings: Vec<Finding> = hits
        .iter()
        .filter(|hit| !is_exempt(hit))
        .map(Hit::finding)
        .collect();
    findings.extend(unused(exemptions, &hits));
    findings
}

fn is_checked(path: &str) -> bool {
    path.ends_with(".rs") || path.ends_with(".md")
}

/// A banned word in a line.
#[derive(Debug)]
struct Hit<'a> {
    path: &'a str,
    line: usize,
    word: &'static str,
    instead: &'static str,
}

impl Hit<'_> {
    fn finding(&self) -> Finding {
        let cause = format!("banned word `{}`", self.word);
        Finding::new(
            self.path,
            self.line,
            cause,
            format!("write {}", self.instead),
        )
    }
}

/// Each banned word of a file, once per line.
fn hits<'a>(file: &'a File, table: &Words) -> Vec<Hit<'a>> {
    let mut found = Vec::new();
    for (index, line) in file.text.lines().enumerate() {
        let mut words = words(line);
        words.sort_unstable();
        words.dedup();
        for word in words {
            if let Some((word, instead)) = table.iter().find(|(banned, _)| *banned == word) {
                found.push(Hit {
                    path: &file.path,
                    line: index + 1,
                    word,
                    instead,
                });
            }
        }
    }
    found
}

/// The words of a line in lower case. Identifiers are split at each character that is no letter and where the case changes:
/// `PollState`, `poll_state` and `STATEReader` contain `state`. A backslash and the character after it are an escape and end a
/// word.
fn words(line: &str) -> Vec<String> {
    let mut words = Vec::new();
    let mut word = String::new();
    let mut before = ' ';
    let mut chars = line.chars().peekable();
    while let Some(c) = chars.next() {
        let next_is_lower = chars.peek().is_some_and(|next| next.is_lowercase());
        let begins = c.is_uppercase() && (before.is_lowercase() || next_is_lower);
        if (begins || !c.is_alphabetic()) && !word.is_empty() {
            words.push(std::mem::take(&mut word));
        }
        if c == '\\' {
            chars.next();
            before = ' ';
            continue;
        }
        if c.is_alphabetic() {
            word.extend(c.to_lowercase());
        }
        before = c;
    }
    words.push(word);
    words
}

/// Exemptions that cover no text any more.
fn unused(exemptions: &[Exemption], hits: &[Hit<'_>]) -> Vec<Finding> {
    let is_used = |e: &&Exemption| hits.iter().any(|hit| e.covers(hit.path, hit.word));
    let unused = exemptions.iter().filter(|e| !is_used(e));
    unused
        .map(|e| {
            let cause = format!("exemption of {} ({}) covers no text", e.path, e.reason);
            Finding::new(THIS_FILE, 1, cause, "remove it from the table")
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::tests::causes;
    use super::*;

    const TABLE: &Words = &[("widget", "part"), ("gadget", "tool"), ("gizmo", "device")];

    fn found(path: &str, text: &str) -> Vec<String> {
        causes(&check_with(&Tree::of(&[(path, text)]), TABLE, &[]))
    }

    #[test]
    fn banned_word_is_found_in_code_comment_and_string() {
        let cause = |line| format!("a.rs:{line} banned word `widget`");
        let code =
            "fn f() {}\nlet widget = 1; // Widget twice\n\n/// Is widget.\nsay(\"WIDGET\");\n";
        assert_eq!(found("a.rs", code), [cause(2), cause(4), cause(5)]);
        assert_eq!(found("a.md", "Gizmo knows"), ["a.md:1 banned word `gizmo`"]);
        assert!(found("a.json", "{\"widget\": 1}").is_empty());
    }

    #[test]
    fn banned_word_is_found_in_parts_of_identifiers() {
        for name in [
            "poll_widget",
            "PollWidget",
            "WIDGET_MAX",
            "WIDGETReader",
            "widget2",
            "IOWidget",
            "pollWIDGET",
        ] {
            assert_eq!(
                found("a.rs", name),
                ["a.rs:1 banned word `widget`"],
                "{name}"
            );
        }
    }

    #[test]
    fn longer_words_are_not_banned() {
        for text in [
            "gadgetry",
            "megagizmo",
            "widgetry",
            "Gizmos",
            "e\\widget",
            "midwidget",
        ] {
            assert!(found("a.rs", text).is_empty(), "{text}");
        }
    }

    #[test]
    fn banned_word_after_escape_is_found() {
        let cause = ["a.rs:1 banned word `widget`"];
        assert_eq!(found("a.rs", "\\twidget"), cause);
        assert_eq!(found("a.rs", "A\\nWidget"), cause);
    }

    #[test]
    fn banned_word_is_found_once_per_line() {
        let causes = found("a.md", "widget, widget and gadget\n");
        assert_eq!(
            causes,
            ["a.md:1 banned word `gadget`", "a.md:1 banned word `widget`"]
        );
    }

    #[test]
    fn finding_names_replacement() {
        let findings = check_with(&Tree::of(&[("a.rs", "gadget")]), TABLE, &[]);
        let text = "a.rs:1: banned word `gadget`; write tool";
        assert_eq!(findings[0].to_string(), text);
    }

    #[test]
    fn exemption_covers_its_words_and_files_only() {
        let exemptions = [
            exempt("a/", &["widget"], "wire"),
            exempt("b.md", &[], "wire"),
        ];
        let files = [
            ("a/x.rs", "widget gadget"),
            ("ab/x.rs", "widget"),
            ("b.md.md", "widget"),
            ("b.md", "widget gadget"),
        ];
        let findings = check_with(&Tree::of(&files), TABLE, &exemptions);
        assert_eq!(
            causes(&findings),
            [
                "a/x.rs:1 banned word `gadget`",
                "ab/x.rs:1 banned word `widget`",
                "b.md.md:1 banned word `widget`"
            ]
        );
    }

    #[test]
    fn exemption_without_text_is_found() {
        let tree = Tree::of(&[("b.md", "gadget"), ("c.md", "widget")]);
        let exemptions = [
            exempt("b.md", &["widget"], "wire"),
            exempt("c.md", &["widget"], "wire"),
        ];
        let cause = "tools/xtask/src/tidy/words.rs:1 exemption of b.md (wire) covers no text";
        assert_eq!(
            causes(&check_with(&tree, TABLE, &exemptions)),
            ["b.md:1 banned word `gadget`", cause]
        );
    }

    #[test]
    fn replacements_contain_no_banned_word() {
        for (word, instead) in BANNED {
            assert!(
                words(word).contains(&(*word).to_owned()),
                "{word} is one word"
            );
            let banned = words(instead)
                .into_iter()
                .find(|new| BANNED.iter().any(|(old, _)| old == new));
            assert_eq!(banned, None, "instead of {word}");
        }
    }
}
