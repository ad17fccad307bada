//! Where in a cell file an error of meaning is. Checks see values and not where they were written, so the location is
//! found by the names, keys and values that the text of an error mentions. A wrong location is worse than a coarse one:
//! if several keys fit equally well, it is the table that contains them all.

use std::ops::Range;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::drivers::error_at;

/// The text of an error of meaning, with its line of the cell file if one is found.
#[must_use]
pub fn located(file: &str, why: String) -> String {
    let table = DeTable::parse(file);
    let Some(span) = table.ok().and_then(|table| find(table.get_ref(), &why)) else {
        return why;
    };
    let mut error = error_at(span, &why);
    error.set_input(Some(file));
    // The file is good TOML.
    error.to_string().replacen("TOML parse error at ", "at ", 1)
}

/// A key that the error may be about.
#[derive(Debug)]
struct Candidate {
    /// How many names of it and of the tables around it the error mentions, less the tables that it does not mention.
    score: i32,
    /// Locations of the tables around it, outermost first.
    around: Vec<Range<usize>>,
    span: Range<usize>,
}

/// A search for what an error mentions.
#[derive(Debug)]
struct Search<'a> {
    why: &'a str,
    found: Vec<Candidate>,
}

fn find(table: &DeTable<'_>, why: &str) -> Option<Range<usize>> {
    // A hint names what to write, which may be elsewhere.
    let why = why.split("\nhint:").next().unwrap_or_default();
    let mut search = Search {
        why,
        found: Vec::new(),
    };
    search.table(table, 0, &[]);
    let best = search.found.iter().map(|found| found.score).max()?;
    search.found.retain(|found| found.score == best);
    let last = search.found.last()?;
    if search.found.len() == 1 {
        return Some(last.span.clone());
    }
    let shared = |depth: &usize| {
        let at = |found: &Candidate| found.around.get(*depth).cloned();
        search.found.iter().all(|found| at(found) == at(last))
    };
    let depth = (0..last.around.len()).take_while(shared).last();
    // Of what is given twice, the second one is to change.
    Some(depth.map_or_else(|| last.span.clone(), |depth| last.around[depth].clone()))
}

impl Search<'_> {
    /// Searches a table with that score.
    fn table(&mut self, table: &DeTable<'_>, score: i32, around: &[Range<usize>]) {
        for (key, value) in table {
            match value.get_ref() {
                DeValue::Table(inner) => {
                    let around = within(around, value.span());
                    self.table(
                        inner,
                        score + self.score(inner, key.get_ref(), None),
                        &around,
                    );
                }
                DeValue::Array(items) if items.iter().any(|item| item.get_ref().is_table()) => {
                    for (number, item) in items.iter().enumerate() {
                        let around = within(around, item.span());
                        if let DeValue::Table(inner) = item.get_ref() {
                            let own = self.score(inner, key.get_ref(), Some(number));
                            self.table(inner, score + own, &around);
                        }
                    }
                }
                DeValue::String(_)
                | DeValue::Integer(_)
                | DeValue::Float(_)
                | DeValue::Boolean(_)
                | DeValue::Datetime(_)
                | DeValue::Array(_) => {
                    let own =
                        i32::from(self.mentions(key.get_ref())) + i32::from(self.quotes(value));
                    if own > 0 {
                        self.found.push(Candidate {
                            score: score + own,
                            around: around.to_vec(),
                            span: key.span().start..value.span().end,
                        });
                    }
                }
            }
        }
    }

    /// What a table adds to the score of its keys: how much of its key, its name and its number is mentioned. Most
    /// errors begin with the name of a device or bus.
    fn score(&self, table: &DeTable<'_>, key: &str, number: Option<usize>) -> i32 {
        let name = table.get("name").and_then(|name| name.get_ref().as_str());
        let name = name.map(|name| format!("{name}:")).unwrap_or_default();
        let place = number.is_some_and(|number| self.mentions(&format!("{key} {number}")));
        let mentioned = [
            self.mentions(key),
            place,
            self.mentions(&name),
            !name.is_empty() && self.why.starts_with(&name),
        ];
        match mentioned.into_iter().map(i32::from).sum() {
            0 => -1,
            score => score,
        }
    }

    /// Whether the error contains this as a word or words.
    fn mentions(&self, word: &str) -> bool {
        let is_part = |c: Option<char>| c.is_some_and(|c| c.is_alphanumeric() || c == '_');
        !word.is_empty()
            && self.why.match_indices(word).any(|(at, _)| {
                let (before, from) = self.why.split_at(at);
                let behind = from[word.len()..].chars().next();
                !is_part(before.chars().last()) && (word.ends_with(':') || !is_part(behind))
            })
    }

    /// Whether the error contains the text of a value, as a quotation.
    fn quotes(&self, value: &Spanned<DeValue<'_>>) -> bool {
        match value.get_ref() {
            DeValue::String(text) => {
                self.why.contains(&format!("`{text}`")) || self.why.contains(&format!("{text:?}"))
            }
            DeValue::Array(items) => items.iter().any(|item| self.quotes(item)),
            DeValue::Integer(_)
            | DeValue::Float(_)
            | DeValue::Boolean(_)
            | DeValue::Datetime(_)
            | DeValue::Table(_) => false,
        }
    }
}

fn within(around: &[Range<usize>], inner: Range<usize>) -> Vec<Range<usize>> {
    around.iter().cloned().chain([inner]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = "[controller]
period = \"1ms\"
priority = 80
[[controller.thread]]
period = \"2ms\"
priority = 99
[[device]]
name = \"left\"
priority = 85
[[device]]
name = \"left arm\"
priority = 85
[[ethercat]]
name = \"segment\"
[[ethercat.slave]]
name = \"coupler\"
shift = \"1s\"
[[ethercat.slave]]
name = \"drives\"
shift = \"1s\"
[[ethercat.arm]]
name = \"tx90\"
joint = [
  { slave = \"drives\", range = [0, 1], zero = 1 },
  { slave = \"drivs\", range = [1, 0], zero = 2 },
]
[[device]]
name = \"left\"
";

    #[test]
    fn errors_of_meaning_have_their_line() {
        for (why, line) in [
            ("controller.period is 1ms; it must be more", 2),
            ("controller: priority must be 1 to 98", 3),
            ("controller.thread: period 2ms is given twice", 5),
            ("controller.thread: priority must be 1 to 98", 6),
            ("left arm: priority must be 1 to 98", 12),
            ("segment: slave drives: `shift` is 1 s", 20),
            (
                "segment: arm tx90: joint 1: range must go up, zero must be finite",
                25,
            ),
            ("segment: arm tx90: joint 1: there is no slave `drivs`", 25),
            ("device name `left` is given twice", 28),
            ("device name \"left arm\" is longer than 64 characters", 11),
        ] {
            let text = located(FILE, why.to_owned());
            let begin = format!("at line {line}, ");
            assert!(text.starts_with(&begin), "{line}: {text}");
            assert!(text.trim_end().ends_with(why), "{text}");
        }
    }

    #[test]
    fn error_about_nothing_in_file_has_no_line() {
        let why = "9 net threads; at most 8 are possible";
        assert_eq!(located(FILE, why.to_owned()), why);
        assert_eq!(located("", why.to_owned()), why);
    }
}
