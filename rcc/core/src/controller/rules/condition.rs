//! Conditions of synchronization rules: their text, compiled for a stack machine. This module does not know
//! which nets exist.
//!
//! ```text
//! or   = and { "|" and }      and  = not { "&" not }      not = [ "!" ] atom
//! atom = "t" | net "." key | net ".terminated" | "(" or ")"
//! ```
//! `key` is that of a Boolean value which the net reports, such as `outdone`. `terminated`, an
//! addition of Takt, is true once the net has ended by itself: "schedule after" of Vistein et al.
//! 2014, section 5.3.

use std::collections::HashMap;

use crate::error::Error;
use crate::executor::rules::{CONDITION_MAX, Step};

/// Maximum nesting depth of parentheses.
const DEPTH_MAX: usize = 64;

const fn is_name(c: char) -> bool {
    c.is_ascii_alphanumeric() || matches!(c, ':' | '_')
}

/// A condition whose nets are not resolved yet.
#[derive(Debug, Default)]
pub(in crate::controller) struct Condition {
    /// Net and key by literal.
    pub(in crate::controller) literals: Vec<(String, String)>,
    pub(in crate::controller) steps: Vec<Step>,
}

pub(in crate::controller) struct Parser<'t> {
    text: &'t str,
    at: usize,
    condition: Condition,
    known: HashMap<(&'t str, &'t str), usize>,
}

impl<'t> Parser<'t> {
    /// Parses a condition.
    pub(in crate::controller) fn parse(text: &'t str) -> Result<Condition, Error> {
        let mut parser = Self {
            text,
            at: 0,
            condition: Condition::default(),
            known: HashMap::new(),
        };
        parser.or(DEPTH_MAX)?;
        if parser.peek().is_some() {
            return Err(parser.expected("`&`, `|` or the end"));
        }
        if parser.condition.steps.len() > CONDITION_MAX {
            let bound = CONDITION_MAX;
            return Err(Error::TooMany {
                item: "operations in a condition",
                bound,
            });
        }
        Ok(parser.condition)
    }

    fn peek(&mut self) -> Option<char> {
        let rest = self.text.get(self.at..)?.trim_start();
        self.at = self.text.len() - rest.len();
        rest.chars().next()
    }

    fn eat(&mut self, c: char) -> bool {
        let is = self.peek() == Some(c);
        self.at += if is { c.len_utf8() } else { 0 };
        is
    }

    fn expected(&mut self, expected: &str) -> Error {
        let found = self
            .peek()
            .map_or_else(|| "the end".to_owned(), |c| format!("`{c}`"));
        let column = self.text[..self.at].chars().count() + 1;
        Error::Condition {
            why: format!("column {column}: {expected} is expected here, not {found}"),
        }
    }

    fn or(&mut self, depth: usize) -> Result<(), Error> {
        self.and(depth)?;
        while self.eat('|') {
            self.and(depth)?;
            self.condition.steps.push(Step::Or);
        }
        Ok(())
    }

    fn and(&mut self, depth: usize) -> Result<(), Error> {
        self.not(depth)?;
        while self.eat('&') {
            self.not(depth)?;
            self.condition.steps.push(Step::And);
        }
        Ok(())
    }

    fn not(&mut self, depth: usize) -> Result<(), Error> {
        let negated = self.eat('!');
        self.atom(depth)?;
        if negated {
            self.condition.steps.push(Step::Not);
        }
        Ok(())
    }

    fn atom(&mut self, depth: usize) -> Result<(), Error> {
        if self.eat('(') {
            if depth == 0 {
                return Err(self.expected("fewer parentheses inside one another"));
            }
            self.or(depth - 1)?;
            return if self.eat(')') {
                Ok(())
            } else {
                Err(self.expected("`)`"))
            };
        }
        let net = self.name();
        if net.is_empty() {
            return Err(self.expected("`t`, `net.key`, `!` or `(`"));
        }
        if self.eat('.') {
            let key = self.name();
            if key.is_empty() {
                return Err(self.expected("a key such as `outdone`, or `terminated`,"));
            }
            let literals = &mut self.condition.literals;
            let number = *self.known.entry((net, key)).or_insert_with(|| {
                literals.push((net.to_owned(), key.to_owned()));
                literals.len() - 1
            });
            self.condition.steps.push(Step::Literal(number));
        } else if net == "t" {
            self.condition.steps.push(Step::Constant(true));
        } else {
            return Err(self.expected("`.` and a key"));
        }
        Ok(())
    }

    fn name(&mut self) -> &'t str {
        self.peek();
        let rest = &self.text[self.at..];
        let end = rest.find(|c: char| !is_name(c)).unwrap_or(rest.len());
        self.at += end;
        &rest[..end]
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn fault(text: &str) -> String {
        Parser::parse(text).unwrap_err().to_string()
    }

    #[test]
    fn condition_operators_have_usual_precedence() {
        let condition = Parser::parse("!rpinet0.outa & (t | rpinet1.outb)|rpinet0.outa").unwrap();
        let literal = Step::Literal;
        assert_eq!(
            condition.steps,
            [
                literal(0),
                Step::Not,
                Step::Constant(true),
                literal(1),
                Step::Or,
                Step::And,
                literal(0),
                Step::Or
            ]
        );
        assert_eq!(condition.literals.len(), 2);
    }

    #[test]
    fn condition_faults_name_the_column() {
        assert!(fault("a b c").contains("column 3: `.` and a key is expected here, not `b`"));
        assert!(fault("").contains("column 1"));
        assert!(fault("(t").contains("`)` is expected here, not the end"));
        assert!(fault("t &").contains("column 4"));
        assert!(fault(&"(".repeat(100_000)).contains("fewer parentheses"));
        assert!(fault(&"t|".repeat(300)).contains("column 601"));
        assert!(fault(&format!("{}t", "t|".repeat(300))).contains("at most 256"));
    }

    proptest! {
        #[test]
        fn any_text_is_read_without_panic(text in "[a-c.t()!&| ä]{0,40}") {
            let _ = Parser::parse(&text);
        }
    }
}
