//! Tokens of component and machine files, and a cursor over them that records errors and continues. What the tokens mean
//! is decided by the parsers.

#![expect(
    clippy::wildcard_enum_match_arm,
    reason = "all tokens but a few are alike where a parser skips or reports one"
)]

use std::ops::Range;

use logos::Logos;

use crate::diagnostic::Diagnostics;

/// Largest file, bytes.
pub(crate) const BYTES_MAX: usize = 1 << 20;

#[derive(Logos, Clone, Copy, Debug, PartialEq, Eq)]
#[logos(skip r"[ \t\r\n]+")]
#[logos(skip(r"#[^\n]*", allow_greedy = true))]
pub(crate) enum Token {
    #[regex(r"[A-Za-z_][A-Za-z0-9_]*")]
    Word,
    #[regex(r"[0-9]+(\.[0-9]+)?([eE][+-]?[0-9]+)?")]
    Number,
    #[regex(r"[0-9]+(\.[0-9]+)?(ns|us|ms|s|min)")]
    Time,
    #[regex(r#""([^"\\\n]|\\.)*""#)]
    Text,
    #[regex(r"'[^'\n]*'")]
    Quoted,
    #[token("{")]
    Open,
    #[token("}")]
    Close,
    #[token("(")]
    OpenParen,
    #[token(")")]
    CloseParen,
    #[token("[")]
    OpenBracket,
    #[token("]")]
    CloseBracket,
    #[token(",")]
    Comma,
    #[token(";")]
    Semicolon,
    #[token(":")]
    Colon,
    #[token("=")]
    Is,
    #[token(":=")]
    Becomes,
    #[token("..")]
    To,
    #[token(".")]
    Dot,
    #[token("->")]
    Arrow,
    #[token("+")]
    Plus,
    #[token("-")]
    Minus,
    #[token("*")]
    Times,
    #[token("/")]
    Over,
    #[token("%")]
    Percent,
    #[token("==")]
    Equal,
    #[token("!=")]
    NotEqual,
    #[token("<")]
    Less,
    #[token("<=")]
    LessEqual,
    #[token(">")]
    Greater,
    #[token(">=")]
    GreaterEqual,
    /// What starts no token.
    Bad,
    /// The end of the text.
    End,
}

/// A word of the text and its location.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Name {
    pub(crate) text: String,
    pub(crate) at: Range<usize>,
}

/// An error was recorded; the caller continues at the next statement.
#[derive(Debug)]
pub(crate) struct Recorded;

pub(crate) type Parse<T> = Result<T, Recorded>;

pub(crate) struct Cursor<'t> {
    pub(crate) text: &'t str,
    lexer: logos::Lexer<'t, Token>,
    token: Token,
    span: Range<usize>,
    last_end: usize,
    pub(crate) found: Diagnostics,
}

impl<'t> Cursor<'t> {
    /// A cursor at the begin of a text of at most [`BYTES_MAX`]; a longer text is not read.
    pub(crate) fn new(text: &'t str) -> Self {
        let mut found = Diagnostics::default();
        let mut read = text;
        if text.len() > BYTES_MAX {
            let cause = format!(
                "the file has {} bytes; at most {BYTES_MAX} are allowed",
                text.len()
            );
            found.error(0..0, cause, "split it");
            read = "";
        }
        let mut cursor = Self {
            text: read,
            lexer: Token::lexer(read),
            token: Token::End,
            span: 0..0,
            last_end: 0,
            found,
        };
        cursor.advance();
        cursor
    }

    pub(crate) fn advance(&mut self) {
        self.last_end = self.span.end;
        self.token = match self.lexer.next() {
            None => Token::End,
            Some(token) => token.unwrap_or(Token::Bad),
        };
        self.span = self.lexer.span();
    }

    pub(crate) const fn token(&self) -> Token {
        self.token
    }

    pub(crate) fn span(&self) -> Range<usize> {
        self.span.clone()
    }

    /// The text of the token.
    pub(crate) fn slice(&self) -> &'t str {
        self.text.get(self.span.clone()).unwrap_or_default()
    }

    /// From the start of something to the end of the previous token.
    pub(crate) fn since(&self, start: usize) -> Range<usize> {
        start..self.last_end.max(start)
    }

    pub(crate) fn is(&self, token: Token) -> bool {
        self.token == token
    }

    pub(crate) fn is_word(&self, word: &str) -> bool {
        self.token == Token::Word && self.slice() == word
    }

    pub(crate) fn eat(&mut self, token: Token) -> bool {
        let is = self.is(token);
        if is {
            self.advance();
        }
        is
    }

    pub(crate) fn eat_word(&mut self, word: &str) -> bool {
        let is = self.is_word(word);
        if is {
            self.advance();
        }
        is
    }

    pub(crate) fn expect(&mut self, token: Token, expected: &str) -> Parse<()> {
        if self.eat(token) {
            return Ok(());
        }
        Err(self.expected(expected, ""))
    }

    /// Records that something else was expected here.
    pub(crate) fn expected(&mut self, expected: &str, hint: &str) -> Recorded {
        let found = match self.token {
            Token::End => "the end of the file".to_owned(),
            Token::Bad if self.slice().starts_with(['"', '\'']) => {
                "a text without its closing quote".to_owned()
            }
            _ => {
                let word: String = self.slice().chars().take(24).collect();
                format!("`{word}`")
            }
        };
        let hint = if hint.is_empty() {
            format!("write {expected}")
        } else {
            hint.to_owned()
        };
        let cause = format!("{expected} is expected here, not {found}");
        // A missing end is reported at what precedes it.
        self.found.error(self.span.clone(), cause, hint);
        Recorded
    }

    pub(crate) fn name(&mut self, expected: &str) -> Parse<Name> {
        if self.token != Token::Word {
            return Err(self.expected(expected, ""));
        }
        let name = Name {
            text: self.slice().to_owned(),
            at: self.span(),
        };
        self.advance();
        Ok(name)
    }

    /// A text in double quotes, with `\"` and `\\`.
    pub(crate) fn quoted(&mut self, expected: &str) -> Parse<String> {
        if self.token != Token::Text {
            return Err(self.expected(expected, ""));
        }
        let inner = self.slice();
        let inner = inner
            .get(1..inner.len().saturating_sub(1))
            .unwrap_or_default();
        let text = inner.replace("\\\"", "\"").replace("\\\\", "\\");
        self.advance();
        Ok(text)
    }

    /// A number with its sign.
    pub(crate) fn number(&mut self, expected: &str) -> Parse<f64> {
        let is_negative = self.eat(Token::Minus);
        if self.token != Token::Number {
            return Err(self.expected(expected, ""));
        }
        let Ok(value) = self.slice().parse::<f64>() else {
            return Err(self.expected(expected, ""));
        };
        if !value.is_finite() {
            let hint = "the largest number is 1.8e308";
            self.found
                .error(self.span(), "this number is too large", hint);
        }
        self.advance();
        Ok(if is_negative { -value } else { value })
    }

    /// Skips to behind the next semicolon, to a closing brace of this level, or behind a block.
    pub(crate) fn skip(&mut self) {
        let mut open = 0_usize;
        loop {
            match self.token {
                Token::End => return,
                Token::Close if open == 0 => return,
                Token::Semicolon if open == 0 => {
                    self.advance();
                    return;
                }
                Token::Open => open += 1,
                Token::Close => {
                    open -= 1;
                    if open == 0 {
                        self.advance();
                        return;
                    }
                }
                _ => {}
            }
            self.advance();
        }
    }
}
