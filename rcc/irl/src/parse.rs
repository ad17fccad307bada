//! The parser: recursive descent that continues behind the next `;` after an error, so that one run reports all of
//! them. Meaning is not checked. Depth is bounded.

mod declarations;
mod expressions;
mod statements;

use crate::diagnostic::{Code, Diagnostic, ERRORS_MAX, did_you_mean};
use crate::token::{Kind, RESERVED, Token, tokens};
use crate::tree::{Name, Program, Span};

/// Deepest nesting of statements and expressions.
const DEPTH_MAX: usize = 48;
/// Largest source text, bytes.
pub(crate) const TEXT_MAX: usize = 1 << 20;

pub(crate) struct Parser<'t> {
    text: &'t str,
    tokens: Vec<Token>,
    position: usize,
    depth: usize,
    pub(crate) diagnostics: Vec<Diagnostic>,
}

/// An error has been reported; the caller resumes at the end of a statement.
#[derive(Debug)]
pub(crate) struct Reported;

type Parsed<T> = Result<T, Reported>;

/// The syntax tree, or nothing if the program has no beginning.
pub(crate) fn parse(text: &str) -> (Option<Program>, Vec<Diagnostic>) {
    if text.len() > TEXT_MAX {
        let cause = format!(
            "the text has {} bytes; at most {TEXT_MAX} are allowed",
            text.len()
        );
        return (None, vec![Diagnostic::new(Code::Bound, 0..0, cause)]);
    }
    let mut parser = Parser {
        text,
        tokens: tokens(text),
        position: 0,
        depth: 0,
        diagnostics: Vec::new(),
    };
    parser.lexical();
    let program = parser.program().ok();
    (program, parser.diagnostics)
}

impl<'t> Parser<'t> {
    fn lexical(&mut self) {
        for token in self.tokens.iter().filter(|token| token.kind == Kind::Bad) {
            let word = self.text.get(token.at.clone()).unwrap_or_default();
            let hint = match word.chars().next() {
                Some('{') => "a comment ends with `}`",
                Some('"') => "a text ends with `\"` in the same line",
                _ => "comments are written in braces, texts in double quotes",
            };
            let cause = format!("`{}` begins no word of L-IRL", word.escape_debug());
            let found = Diagnostic::new(Code::Lexical, token.at.clone(), cause).hint(hint);
            if self.diagnostics.len() < ERRORS_MAX {
                self.diagnostics.push(found);
            }
        }
        self.tokens.retain(|token| token.kind != Kind::Bad);
    }

    fn peek(&self) -> Kind {
        self.tokens.get(self.position).map_or(Kind::End, |t| t.kind)
    }

    fn at(&self) -> Span {
        let end = self.text.len();
        self.tokens
            .get(self.position)
            .map_or(end..end, |token| token.at.clone())
    }

    /// End of the previous word.
    fn end(&self) -> usize {
        let before = self.position.checked_sub(1);
        before
            .and_then(|i| self.tokens.get(i))
            .map_or(0, |token| token.at.end)
    }

    fn word(&self) -> String {
        self.text
            .get(self.at())
            .unwrap_or_default()
            .to_ascii_lowercase()
    }

    fn advance(&mut self) {
        if self.peek() != Kind::End {
            self.position += 1;
        }
    }

    fn is_word(&self, word: &str) -> bool {
        self.peek() == Kind::Name && self.word() == word
    }

    fn accept_word(&mut self, word: &str) -> bool {
        let found = self.is_word(word);
        if found {
            self.advance();
        }
        found
    }

    fn accept(&mut self, kind: Kind) -> bool {
        let found = self.peek() == kind;
        if found {
            self.advance();
        }
        found
    }

    fn found(&self) -> String {
        if self.peek() == Kind::End {
            return "the end of the text".to_owned();
        }
        format!("`{}`", self.text.get(self.at()).unwrap_or_default())
    }

    fn fail<T>(&mut self, expected: &str, hint: String) -> Parsed<T> {
        if self.diagnostics.len() < ERRORS_MAX {
            let cause = format!("{expected} is expected here, not {}", self.found());
            let found = Diagnostic::new(Code::Syntax, self.at(), cause).hint(hint);
            self.diagnostics.push(found);
        }
        Err(Reported)
    }

    fn expect(&mut self, kind: Kind, shown: &str) -> Parsed<()> {
        if self.accept(kind) {
            return Ok(());
        }
        let hint = if shown == "`;`" {
            "each statement and declaration ends with `;`".to_owned()
        } else if shown == "`:=`" && self.peek() == Kind::Equals {
            "`:=` assigns, `=` compares".to_owned()
        } else {
            String::new()
        };
        self.fail(shown, hint)
    }

    fn expect_word(&mut self, word: &str) -> Parsed<()> {
        if self.accept_word(word) {
            return Ok(());
        }
        let hint = did_you_mean(&self.word(), [word]);
        self.fail(&format!("`{word}`"), hint)
    }

    fn name(&mut self, what: &str) -> Parsed<Name> {
        let text = self.word();
        if self.peek() != Kind::Name {
            return self.fail(what, String::new());
        }
        if RESERVED.contains(&text.as_str()) {
            let hint = format!("`{text}` is a word of the language and names nothing else");
            return self.fail(what, hint);
        }
        let at = self.at();
        self.advance();
        Ok(Name { text, at })
    }

    fn nested<T>(&mut self, parse: impl FnOnce(&mut Self) -> Parsed<T>) -> Parsed<T> {
        if self.depth >= DEPTH_MAX {
            let cause = format!("more than {DEPTH_MAX} levels of nesting");
            let at = self.at();
            if self
                .diagnostics
                .last()
                .is_none_or(|d| d.code != Code::Bound)
            {
                self.diagnostics
                    .push(Diagnostic::new(Code::Bound, at, cause));
            }
            return Err(Reported);
        }
        self.depth += 1;
        let parsed = parse(self);
        self.depth -= 1;
        parsed
    }

    /// Continues behind the next `;`, or before a word that ends a block.
    fn resume(&mut self) {
        loop {
            match self.peek() {
                Kind::End => return,
                Kind::Semicolon => return self.advance(),
                Kind::Name if self.ends_block() => return,
                _ => self.advance(),
            }
        }
    }

    fn ends_block(&self) -> bool {
        let word = self.word();
        (word.starts_with("end") && RESERVED.contains(&word.as_str()))
            || matches!(
                word.as_str(),
                "until" | "else" | "elsif" | "when" | "default" | "begin"
            )
    }

    fn program(&mut self) -> Parsed<Program> {
        self.expect_word("program")?;
        let name = self.name("the name of the program")?;
        if self.expect(Kind::Semicolon, "`;`").is_err() {
            self.resume();
        }
        let mut specification = None;
        if self.accept_word("system_specification") {
            specification = self.specification().ok();
            if specification.is_none() {
                self.resume();
            }
        }
        let body = self.body("endprogram");
        if self.peek() != Kind::End
            && self
                .fail::<()>("the end of the text", String::new())
                .is_err()
        {
            self.position = self.tokens.len();
        }
        Ok(Program {
            name,
            specification,
            body,
        })
    }

    fn specification(&mut self) -> Parsed<(String, Span)> {
        let at = self.at();
        let text = self.string()?;
        self.expect(Kind::Semicolon, "`;`")?;
        Ok((text, at))
    }

    fn string(&mut self) -> Parsed<String> {
        if self.peek() != Kind::Text {
            return self.fail("a text in double quotes", String::new());
        }
        let text = self.text.get(self.at()).unwrap_or_default();
        let text = text.trim_matches('"').to_owned();
        self.advance();
        Ok(text)
    }
}
