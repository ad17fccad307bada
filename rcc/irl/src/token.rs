//! The words of L-IRL. Word symbols are names here; the parser decides what they mean.

use std::ops::Range;

use logos::Logos;

/// A kind of word.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Logos)]
#[logos(skip r"[ \t\r\n\f]+")]
pub(crate) enum Kind {
    #[regex("[A-Za-z_][A-Za-z0-9_]*")]
    Name,
    #[regex("[0-9]+")]
    Int,
    #[regex(r"[0-9]+\.[0-9]+([eE][+-]?[0-9]+)?|[0-9]+[eE][+-]?[0-9]+")]
    Real,
    #[regex("\"[^\"\n]*\"")]
    Text,
    #[regex(r"\{[^}]*\}", logos::skip)]
    Comment,
    #[token(":=")]
    Assign,
    #[token("<=")]
    LessEqual,
    #[token(">=")]
    GreaterEqual,
    #[token("<>")]
    Differs,
    #[token("..")]
    Range,
    #[token("<")]
    Less,
    #[token(">")]
    Greater,
    #[token("=")]
    Equals,
    #[token("+")]
    Plus,
    #[token("-")]
    Minus,
    #[token("*")]
    Times,
    #[token("/")]
    Divide,
    #[token("@")]
    At,
    #[token("(")]
    Open,
    #[token(")")]
    Close,
    #[token("[")]
    OpenIndex,
    #[token("]")]
    CloseIndex,
    #[token(",")]
    Comma,
    #[token(";")]
    Semicolon,
    #[token(":")]
    Colon,
    #[token(".")]
    Dot,
    End,
    Bad,
}

/// A word and its location.
#[derive(Clone, Debug)]
pub(crate) struct Token {
    pub(crate) kind: Kind,
    pub(crate) at: Range<usize>,
}

/// Word symbols: they name nothing else.
pub(crate) const RESERVED: &[&str] = &[
    "program",
    "system_specification",
    "endprogram",
    "begin",
    "const",
    "type",
    "var",
    "signal",
    "in",
    "out",
    "inout",
    "procedure",
    "endproc",
    "function",
    "endfct",
    "array",
    "of",
    "record",
    "endrecord",
    "move",
    "move_inc",
    "ptp",
    "lin",
    "circle",
    "seq",
    "endseq",
    "par",
    "endpar",
    "if",
    "then",
    "elsif",
    "else",
    "endif",
    "case",
    "when",
    "default",
    "endcase",
    "for",
    "to",
    "step",
    "do",
    "endfor",
    "while",
    "endwhile",
    "repeat",
    "until",
    "wait",
    "sec",
    "timeout",
    "event",
    "return",
    "exit",
    "pause",
    "halt",
    "or",
    "exor",
    "and",
    "not",
    "div",
    "mod",
    "true",
    "false",
];

pub(crate) fn tokens(text: &str) -> Vec<Token> {
    let words = Kind::lexer(text).spanned();
    let mut tokens: Vec<Token> = words
        .map(|(kind, at)| Token {
            kind: kind.unwrap_or(Kind::Bad),
            at,
        })
        .collect();
    tokens.push(Token {
        kind: Kind::End,
        at: text.len()..text.len(),
    });
    tokens
}
