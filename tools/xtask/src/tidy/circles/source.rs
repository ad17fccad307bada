//! What a Rust file defines, imports and names in paths, from its tokens. Tests are left out; macros are not expanded,
//! but the items and paths in their bodies count.

use std::collections::BTreeSet;

/// An imported item: its path, the name that it has in the file, and whether it is exported again.
#[derive(Debug)]
pub(super) struct Import<'t> {
    pub(super) path: Vec<&'t str>,
    pub(super) alias: &'t str,
    pub(super) public: bool,
}

/// The content of a file.
#[derive(Debug, Default)]
pub(super) struct Source<'t> {
    pub(super) defined: BTreeSet<&'t str>,
    pub(super) imports: Vec<Import<'t>>,
    /// Paths of at least two names, outside of imports.
    pub(super) paths: Vec<Vec<&'t str>>,
    /// All names outside of imports.
    pub(super) names: BTreeSet<&'t str>,
    /// Modules in files of their own that only tests have.
    pub(super) tests: Vec<&'t str>,
}

impl<'t> Source<'t> {
    pub(super) fn of(text: &'t str) -> Self {
        let tokens = tokens(text);
        let (mut source, mut body) = (Self::default(), Vec::new());
        let mut at = 0;
        while let Some(&token) = tokens.get(at) {
            let rest = &tokens[at..];
            at += match (token, &rest[1..]) {
                ("#", ["[", "cfg", ..]) if is_test(rest) => {
                    if let Some(name) = module(rest) {
                        source.tests.push(name);
                    }
                    item(rest)
                }
                ("mod", [_, ";", ..]) => 3,
                ("pub", ["(", "in", ..]) => end(rest, "(", ")"),
                ("use", [first, ..]) if *first != "<" => {
                    let public = at > 0 && matches!(tokens[at - 1], "pub" | ")");
                    let mut next = 1;
                    source.import(rest, &mut next, &[], public);
                    next + 1
                }
                ("fn" | "struct" | "enum" | "trait" | "type", [name, ..])
                | ("const" | "static" | "union" | "mod", [name, ..])
                | ("macro_rules", ["!", name, ..])
                    if is_name(name) =>
                {
                    source.defined.insert(name);
                    1
                }
                _ => {
                    body.push(token);
                    1
                }
            };
        }
        source.paths = paths(&body);
        source.names = body.into_iter().filter(|it| is_name(it)).collect();
        source
    }

    /// Reads an import from `tokens[*at]` to the comma, brace or semicolon that ends it.
    fn import(&mut self, tokens: &[&'t str], at: &mut usize, prefix: &[&'t str], public: bool) {
        let (mut path, mut alias, mut is_item) = (prefix.to_vec(), None, false);
        while let Some(&token) = tokens.get(*at) {
            match token {
                "," | "}" | ";" => break,
                "{" => {
                    while let Some(&("{" | ",")) = tokens.get(*at) {
                        *at += 1;
                        self.import(tokens, at, &path, public);
                    }
                    (path, is_item) = (prefix.to_vec(), false);
                }
                "as" => {
                    *at += 1;
                    alias = tokens.get(*at).copied();
                }
                "::" => {}
                "self" if !prefix.is_empty() => is_item = true,
                name => {
                    path.push(name);
                    is_item = true;
                }
            }
            *at += 1;
        }
        if let (true, Some(&last)) = (is_item, path.last()) {
            let alias = alias.unwrap_or(last);
            self.imports.push(Import {
                path,
                alias,
                public,
            });
        }
    }
}

/// Whether an attribute `#[cfg(…)]` holds in tests only.
fn is_test(tokens: &[&str]) -> bool {
    let attribute = &tokens[..end(tokens, "[", "]")];
    let is_negated = attribute.windows(3).any(|it| it == ["not", "(", "test"]);
    attribute.contains(&"test") && !attribute.contains(&"any") && !is_negated
}

/// The number of tokens to the end of the first group.
fn end(tokens: &[&str], open: &str, close: &str) -> usize {
    let mut depth = 0_usize;
    for (at, token) in tokens.iter().enumerate() {
        if *token == open {
            depth += 1;
        } else if *token == close {
            depth = depth.saturating_sub(1);
            if depth == 0 {
                return at + 1;
            }
        }
    }
    tokens.len()
}

/// The number of tokens of an item with its attributes.
fn item(tokens: &[&str]) -> usize {
    let mut at = 0;
    while tokens.get(at) == Some(&"#") {
        at += end(&tokens[at..], "[", "]");
    }
    let is_import = match &tokens[at..] {
        ["use", ..] | ["pub", "use", ..] => true,
        ["pub", "(", rest @ ..] => rest.iter().skip_while(|it| **it != ")").nth(1) == Some(&"use"),
        _ => false,
    };
    let mut depth = 0_usize;
    for (behind, token) in tokens[at..].iter().enumerate() {
        match *token {
            "(" | "[" => depth += 1,
            ")" | "]" => depth = depth.saturating_sub(1),
            ";" if depth == 0 => return at + behind + 1,
            "{" if !is_import => return at + behind + end(&tokens[at + behind..], "{", "}"),
            _ => {}
        }
    }
    tokens.len()
}

/// The name of an item that is a module in a file of its own.
fn module<'t>(tokens: &[&'t str]) -> Option<&'t str> {
    match tokens[..item(tokens)] {
        [.., "mod", name, ";"] => Some(name),
        _ => None,
    }
}

fn paths<'t>(body: &[&'t str]) -> Vec<Vec<&'t str>> {
    let mut paths: Vec<Vec<&str>> = Vec::new();
    for (at, token) in body.iter().enumerate().filter(|(_, token)| is_name(token)) {
        match (&body[..at], paths.last_mut()) {
            ([.., before, "::"], Some(path)) if is_name(before) => path.push(token),
            _ => paths.push(vec![token]),
        }
    }
    paths.retain(|path| path.len() > 1);
    paths
}

fn is_name(token: &str) -> bool {
    token.starts_with(|c: char| c.is_alphabetic() || c == '_')
}

/// Names, `::` and single characters, without comments, literals and lifetimes.
fn tokens(mut text: &str) -> Vec<&str> {
    let mut tokens = Vec::new();
    while let Some(first) = text.chars().next() {
        let name = text.find(|c: char| !c.is_alphanumeric() && c != '_');
        let (len, is_token) = match (skipped(text), name.unwrap_or(text.len())) {
            (Some(len), _) => (len, false),
            (None, 0) if text.starts_with("::") => (2, true),
            (None, 0) => (first.len_utf8(), !first.is_whitespace()),
            (None, len) => (len, true),
        };
        let (token, rest) = text.split_at(len);
        tokens.extend(is_token.then_some(token));
        text = rest;
    }
    tokens
}

/// The length of a comment, literal or lifetime at the beginning of a text.
fn skipped(text: &str) -> Option<usize> {
    let after = |from: usize, end: &str| match text.get(from..).and_then(|rest| rest.find(end)) {
        Some(at) => from + at + end.len(),
        None => text.len(),
    };
    if text.starts_with("//") {
        return Some(after(0, "\n"));
    }
    if text.starts_with("/*") {
        return Some(after(2, "*/"));
    }
    let plain = text.strip_prefix(['b', 'c']).unwrap_or(text);
    let prefix = text.len() - plain.len();
    if let Some(raw) = plain.strip_prefix('r') {
        let quoted = raw.trim_start_matches('#');
        if quoted.starts_with('"') {
            let hashes = raw.len() - quoted.len();
            return Some(after(
                prefix + hashes + 2,
                &format!("\"{}", "#".repeat(hashes)),
            ));
        }
    }
    match plain.chars().next()? {
        '"' => Some(prefix + quoted(plain)),
        '\'' => Some(prefix + character(plain)),
        _ => None,
    }
}

/// The length of a string with escapes.
fn quoted(text: &str) -> usize {
    let mut escaped = false;
    for (at, c) in text.char_indices().skip(1) {
        match c {
            '"' if !escaped => return at + 1,
            _ => escaped = c == '\\' && !escaped,
        }
    }
    text.len()
}

/// The length of a character or lifetime.
fn character(text: &str) -> usize {
    let mut rest = text.char_indices().skip(1);
    match (rest.next(), rest.next()) {
        (Some((_, '\\')), Some((at, escaped))) => {
            let from = at + escaped.len_utf8();
            text[from..]
                .find('\'')
                .map_or(text.len(), |end| from + end + 1)
        }
        (_, Some((at, '\''))) => at + 1,
        _ => {
            let name = text[1..].find(|c: char| !c.is_alphanumeric() && c != '_');
            name.map_or(text.len(), |end| end + 1)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tokens_skip_comments_literals_and_lifetimes() {
        let text = "a /* b::c */ r#\"d::e\"# \"f\\\"::g\" '\\'' 'h' b'i' // j\n&'k l::m";
        assert_eq!(tokens(text), ["a", "&", "l", "::", "m"]);
    }

    #[test]
    fn source_yields_definitions_imports_and_paths() {
        let source = Source::of(
            "pub(crate) use a::{self, b::{C, D as E}, F};\nuse g::*;\nmod h;\n\
             pub(in crate::i) fn j() -> impl K + use<'_> { super::l::M::n(); }\nmacro_rules! o {}",
        );
        let imports: Vec<_> = source
            .imports
            .iter()
            .map(|import| (import.path.join("::"), import.alias, import.public))
            .collect();
        let found: Vec<_> = imports
            .iter()
            .map(|(p, a, e)| (p.as_str(), *a, *e))
            .collect();
        let expected = [
            ("a", "a", true),
            ("a::b::C", "C", true),
            ("a::b::D", "E", true),
            ("a::F", "F", true),
            ("g::*", "*", false),
        ];
        assert_eq!(found, expected);
        assert_eq!(Vec::from_iter(source.defined), ["j", "o"]);
        assert_eq!(source.paths, [["super", "l", "M", "n"]]);
    }

    #[test]
    fn source_leaves_out_tests() {
        let source = Source::of(
            "#[cfg(test)]\nmod a;\n#[cfg(test)]\nuse b::{C, D};\n#[cfg(all(test, unix))]\nmod e { use f::*; g::h(); }\n\
             #[cfg(not(test))]\nfn i() {}",
        );
        assert_eq!(source.tests, ["a"]);
        assert!(source.imports.is_empty() && source.paths.is_empty());
        assert!(source.defined.contains("i") && !source.defined.contains("e"));
    }
}
