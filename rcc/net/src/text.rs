//! Net text: its tokens, its syntax tree and the parser, which continues after an error so that one
//! run reports all of them. The meaning of names is checked elsewhere.
//!
//! ```text
//! net      = fragment
//! fragment = "{" [ item { "," item } ] "}"
//! item     = ident [dbg] "=" ( node | node "." ident )      child, or out port of the fragment
//! node     = ident "(" [ arg { "," arg } ] ")"              primitive of that type
//!          | ident                                          reference, only before "." ident
//!          | fragment "(" [ arg { "," arg } ] ")"           nested fragment with its in ports
//! arg      = ident [dbg] "=" ( string | node "." ident )    parameter, or link to an in port
//! dbg      = "[" seconds "]"      string = "'" … "'" with \' and \\      ident = [A-Za-z0-9:_]+
//! ```
//! A `#` outside a string starts a comment up to the end of the line: an addition of Takt.

use std::borrow::Cow;
use std::ops::Range;

use logos::{Lexer, Logos};

use crate::fault::{FAULTS_MAX, Fault, FaultKind};
use crate::limits::Limits;

/// A word of the text and its location.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Name<'a> {
    /// The word.
    pub text: &'a str,
    /// Its first byte.
    pub start: usize,
}

impl Name<'_> {
    /// The bytes of the text that it covers.
    pub const fn span(&self) -> Range<usize> {
        self.start..self.start + self.text.len()
    }
}

/// A fragment: children and out ports.
#[derive(Debug, Default)]
pub struct Fragment<'a> {
    /// Primitives and fragments inside.
    pub children: Vec<Child<'a>>,
    /// Out ports, each fed by one source inside.
    pub outs: Vec<Arg<'a>>,
    /// Bytes of the text.
    pub at: Range<usize>,
}

/// A named child of a fragment.
#[derive(Debug)]
pub struct Child<'a> {
    /// Its name in the fragment.
    pub name: Name<'a>,
    /// The child.
    pub node: Node<'a>,
}

/// A primitive or a nested fragment with its arguments.
#[derive(Debug)]
pub struct Node<'a> {
    /// The kind of node.
    pub body: Body<'a>,
    /// Parameters and in ports.
    pub args: Vec<Arg<'a>>,
    /// Bytes of the text.
    pub at: Range<usize>,
}

/// The kind of a node.
#[derive(Debug)]
pub enum Body<'a> {
    /// An instance of the primitive of that name.
    Primitive(Name<'a>),
    /// A nested fragment.
    Fragment(Fragment<'a>),
}

/// `name=value`: a parameter, an in port or an out port.
#[derive(Debug)]
pub struct Arg<'a> {
    /// Name of the parameter or port.
    pub name: Name<'a>,
    /// How long a debug tap on this port keeps values, s.
    pub debug_s: Option<f64>,
    /// The value or link.
    pub value: ArgValue<'a>,
}

/// The right-hand side of an argument.
#[derive(Debug)]
pub enum ArgValue<'a> {
    /// A parameter's text and the index of its first byte inside the quotes.
    Text(Cow<'a, str>, usize),
    /// A link from an out port.
    Link(Source<'a>),
}

/// The out port a link starts at.
#[derive(Debug)]
pub struct Source<'a> {
    /// The owner of the port.
    pub of: SourceOf<'a>,
    /// The port.
    pub port: Name<'a>,
}

/// The owner of the out port at which a link starts.
#[derive(Debug)]
pub enum SourceOf<'a> {
    /// A child of the same fragment, or `parent` for the fragment's own in ports.
    Child(Name<'a>),
    /// An inline primitive or fragment.
    Inline(Box<Node<'a>>),
}

impl Source<'_> {
    /// Bytes of the text.
    pub fn span(&self) -> Range<usize> {
        let start = match &self.of {
            SourceOf::Child(name) => name.start,
            SourceOf::Inline(node) => node.at.start,
        };
        start..self.port.span().end
    }
}

#[derive(Logos, Clone, Copy, Debug, PartialEq, Eq)]
#[logos(skip r"[ \t\r\n]+")]
#[logos(skip(r"#[^\n]*", allow_greedy = true))]
enum Token {
    #[token("{")]
    OpenFragment,
    #[token("}")]
    CloseFragment,
    #[token("(")]
    OpenArgs,
    #[token(")")]
    CloseArgs,
    #[token("[")]
    OpenDebug,
    #[token("]")]
    CloseDebug,
    #[token(",")]
    Comma,
    #[token("=")]
    Is,
    #[token(".")]
    Dot,
    #[regex(r"[A-Za-z0-9:_]+")]
    Ident,
    #[regex(r"'([^'\\]|\\(.|\n))*'")]
    Text,
    /// A text without its closing quote, or a character that starts no token.
    Bad,
}

/// Parses net text into a syntax tree and appends all syntax faults to `faults`. The tree holds all
/// parts that could be parsed, so that later checks can continue.
pub fn parse<'a>(text: &'a str, limits: &Limits, faults: &mut Vec<Fault>) -> Fragment<'a> {
    if text.len() > limits.text_bytes {
        let (item, found, bound) = ("bytes of text", text.len(), limits.text_bytes);
        faults.push(Fault::new(FaultKind::Bound { item, found, bound }, 0..0));
        return Fragment::default();
    }
    let mut parser = Parser {
        text,
        lexer: Token::lexer(text),
        token: None,
        last_end: 0,
        depth: limits.depth,
        depth_max: limits.depth,
        faults,
    };
    parser.token = parser.lex();
    let root = parser.fragment().unwrap_or_default();
    if parser.token.is_some() && parser.faults.is_empty() {
        parser.expected("the end of the net");
    }
    root
}

struct Parser<'a, 'f> {
    text: &'a str,
    /// The rest of the text after [`Self::token`]. Tokens are not stored, as a text may have
    /// millions.
    lexer: Lexer<'a, Token>,
    /// The next token; `None` at the end of the text.
    token: Option<Token>,
    /// End of the previous token.
    last_end: usize,
    /// Remaining nesting depth.
    depth: usize,
    depth_max: usize,
    faults: &'f mut Vec<Fault>,
}

/// A fault was recorded; the caller continues after the next comma.
struct Recorded;

type Parse<T> = Result<T, Recorded>;

impl<'a> Parser<'a, '_> {
    fn lex(&mut self) -> Option<Token> {
        let token = self.lexer.next()?;
        Some(token.unwrap_or(Token::Bad))
    }

    fn advance(&mut self) {
        self.last_end = self.lexer.span().end;
        self.token = self.lex();
    }

    fn span(&self) -> Range<usize> {
        let end = self.text.len();
        match self.token {
            Some(_) => self.lexer.span(),
            None => end..end,
        }
    }

    fn eat(&mut self, token: Token) -> bool {
        let is = self.token == Some(token);
        if is {
            self.advance();
        }
        is
    }

    fn expected(&mut self, expected: &str) -> Recorded {
        let span = self.span();
        if self.faults.len() >= FAULTS_MAX {
            return Recorded;
        }
        if self.token.is_none() && self.faults.last().is_some_and(Fault::is_syntax) {
            // An unexpected end of the text has the same cause.
            return Recorded;
        }
        let found = match self.token {
            None => "the end of the text".to_owned(),
            Some(Token::Bad) if self.text[span.clone()].starts_with('\'') => {
                "a text without its closing `'`".to_owned()
            }
            Some(_) => {
                let word: String = self.text[span.clone()].chars().take(24).collect();
                format!("`{word}`")
            }
        };
        let expected = expected.to_owned();
        self.faults
            .push(Fault::new(FaultKind::Syntax { expected, found }, span));
        Recorded
    }

    /// A value where a text should be: the most common mistake in nets written by hand.
    fn unquoted(&mut self, value: Name<'a>) -> Recorded {
        if self.faults.len() < FAULTS_MAX {
            let text = value.text;
            let expected = format!("a text in quotes, `'{text}'`,");
            let found = format!("`{text}`");
            let at = value.start..value.start + text.len();
            let kind = FaultKind::Syntax { expected, found };
            self.faults.push(Fault::new(kind, at));
        }
        Recorded
    }

    fn ident(&mut self, expected: &str) -> Parse<Name<'a>> {
        if self.token != Some(Token::Ident) {
            return Err(self.expected(expected));
        }
        let span = self.span();
        self.advance();
        Ok(Name {
            text: &self.text[span.clone()],
            start: span.start,
        })
    }

    /// Parses `item`s up to `close`; after a fault it continues after the next comma of this level.
    fn list(&mut self, close: Token, expected: &str, mut item: impl FnMut(&mut Self) -> Parse<()>) {
        if self.eat(close) {
            return;
        }
        loop {
            if item(self).is_err() {
                self.skip_item();
            }
            if self.eat(close) {
                return;
            }
            if !self.eat(Token::Comma) {
                self.expected(expected);
                self.skip_item();
                if self.eat(close) || !self.eat(Token::Comma) {
                    return;
                }
            }
        }
    }

    /// Skips to the next comma or closing bracket of the present level.
    fn skip_item(&mut self) {
        let mut open = 0_usize;
        while let Some(token) = self.token {
            match token {
                Token::OpenFragment | Token::OpenArgs => open += 1,
                Token::CloseFragment | Token::CloseArgs if open == 0 => return,
                Token::CloseFragment | Token::CloseArgs => open -= 1,
                Token::Comma if open == 0 => return,
                Token::OpenDebug
                | Token::CloseDebug
                | Token::Comma
                | Token::Is
                | Token::Dot
                | Token::Ident
                | Token::Text
                | Token::Bad => {}
            }
            self.advance();
        }
    }

    fn fragment(&mut self) -> Parse<Fragment<'a>> {
        let start = self.span().start;
        if !self.eat(Token::OpenFragment) {
            return Err(self.expected("`{`, the start of a fragment,"));
        }
        let mut fragment = Fragment::default();
        self.list(Token::CloseFragment, "`,` or `}`", |p| {
            p.item(&mut fragment)
        });
        fragment.at = start..self.last_end;
        Ok(fragment)
    }

    fn item(&mut self, fragment: &mut Fragment<'a>) -> Parse<()> {
        let name = self.ident("the name of a child or out port")?;
        let debug_s = self.debug()?;
        if !self.eat(Token::Is) {
            return Err(self.expected("`=`"));
        }
        match self.node_or_source()? {
            Expression::Node(node) => fragment.children.push(Child { name, node }),
            Expression::Source(source) => {
                fragment.outs.push(Arg {
                    name,
                    debug_s,
                    value: ArgValue::Link(source),
                });
            }
        }
        Ok(())
    }

    fn debug(&mut self) -> Parse<Option<f64>> {
        if !self.eat(Token::OpenDebug) {
            return Ok(None);
        }
        let start = self.span().start;
        while matches!(self.token, Some(Token::Ident | Token::Dot)) {
            self.advance();
        }
        let seconds = self
            .text
            .get(start..self.last_end)
            .unwrap_or_default()
            .parse()
            .ok();
        match seconds {
            Some(seconds) if self.eat(Token::CloseDebug) => Ok(Some(seconds)),
            _ => Err(self.expected("a number of seconds and `]`")),
        }
    }

    fn node_or_source(&mut self) -> Parse<Expression<'a>> {
        if self.depth == 0 {
            let bound = self.depth_max;
            let kind = FaultKind::Bound {
                item: "levels of fragments or inline primitives inside one another",
                found: bound + 1,
                bound,
            };
            self.faults.push(Fault::new(kind, self.span()));
            return Err(Recorded);
        }
        self.depth -= 1;
        let result = self.node_or_source_within();
        self.depth += 1;
        result
    }

    fn node_or_source_within(&mut self) -> Parse<Expression<'a>> {
        let start = self.span().start;
        let body = if self.token == Some(Token::OpenFragment) {
            Body::Fragment(self.fragment()?)
        } else {
            let name = self.ident("a primitive `Type(…)`, a fragment `{…}` or a `child.port`")?;
            if self.eat(Token::Dot) {
                let port = self.ident("the name of an out port")?;
                return Ok(Expression::Source(Source {
                    of: SourceOf::Child(name),
                    port,
                }));
            }
            Body::Primitive(name)
        };
        let mut args = Vec::new();
        if self.eat(Token::OpenArgs) {
            self.list(Token::CloseArgs, "`,` or `)`", |p| {
                args.push(p.arg()?);
                Ok(())
            });
        } else if matches!(body, Body::Primitive(_)) {
            return Err(self.expected("`(…)` after a primitive's type or `.port` after a child"));
        }
        let node = Node {
            body,
            args,
            at: start..self.last_end,
        };
        if !self.eat(Token::Dot) {
            return Ok(Expression::Node(node));
        }
        let port = self.ident("the name of an out port")?;
        Ok(Expression::Source(Source {
            of: SourceOf::Inline(Box::new(node)),
            port,
        }))
    }

    fn arg(&mut self) -> Parse<Arg<'a>> {
        let name = self.ident("the name of a parameter or in port")?;
        let debug_s = self.debug()?;
        if !self.eat(Token::Is) {
            return Err(self.expected("`=`"));
        }
        let starts_link = matches!(self.token, Some(Token::Ident | Token::OpenFragment));
        let word = self.text.get(self.span()).unwrap_or_default();
        let is_value = word.parse::<f64>().is_ok() || matches!(word, "true" | "false");
        let next = self.lexer.clone().next();
        let leads_on = matches!(next, Some(Ok(Token::Dot | Token::OpenArgs)));
        if self.token == Some(Token::Ident) && is_value && !leads_on {
            let value = self.ident("a value")?;
            return Err(self.unquoted(value));
        }
        let value = if self.token == Some(Token::Text) {
            let span = self.span();
            self.advance();
            let inside = &self.text[span.start + 1..span.end - 1];
            ArgValue::Text(unescape(inside), span.start + 1)
        } else if !starts_link {
            return Err(self.expected("a text such as '1' or a link such as `child.port`"));
        } else {
            match self.node_or_source()? {
                Expression::Source(source) => ArgValue::Link(source),
                Expression::Node(_) => {
                    return Err(self.expected("`.` and an out port of this primitive"));
                }
            }
        };
        Ok(Arg {
            name,
            debug_s,
            value,
        })
    }
}

enum Expression<'a> {
    Node(Node<'a>),
    Source(Source<'a>),
}

fn unescape(text: &str) -> Cow<'_, str> {
    if !text.contains('\\') {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len());
    let mut chars = text.chars();
    while let Some(c) = chars.next() {
        out.push(if c == '\\' {
            chars.next().unwrap_or('\\')
        } else {
            c
        });
    }
    Cow::Owned(out)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn faults_of(text: &str) -> Vec<String> {
        let mut faults = Vec::new();
        parse(text, &Limits::default(), &mut faults);
        crate::fault::Rejection { faults }.lines(text)
    }

    #[test]
    fn parser_reads_whole_grammar() {
        let text = r"{a=Core::DoubleAdd(inFirst=Core::Clock(Increment='2').outValue,
            inSecond[2.0]=b.outY, Text='it\'s \\'), 7={x=P(), outY=x.outValue,
            outZ=parent.inQ}(inQ=a.outValue), outTerminate=7.outY}";
        let mut faults = Vec::new();
        let net = parse(text, &Limits::default(), &mut faults);
        assert_eq!(faults, []);
        assert_eq!(net.children.len(), 2);
        assert_eq!(net.outs.len(), 1);
        let add = &net.children[0].node;
        assert_eq!(add.args[1].debug_s, Some(2.0));
        let ArgValue::Text(value, _) = &add.args[2].value else {
            panic!("no text")
        };
        assert_eq!(value, r"it's \");
    }

    #[test]
    fn all_faults_are_reported_at_once() {
        let text = "{a=Core::Clock(Increment=), b=c, d=E(inX='1' inY='2'), f g=H(), outT=a.o}";
        assert_eq!(
            faults_of(text),
            [
                "1:26: a text such as '1' or a link such as `child.port` is expected here, not `)`",
                "1:32: `(…)` after a primitive's type or `.port` after a child is expected here, not `,`",
                "1:46: `,` or `)` is expected here, not `inY`",
                "1:58: `=` is expected here, not `g`",
            ]
        );
    }

    #[test]
    fn unquoted_value_fault_suggests_quotes() {
        assert_eq!(
            faults_of("{a=P(X=3, Y=true), outT=a.o}"),
            [
                "1:8: a text in quotes, `'3'`, is expected here, not `3`",
                "1:13: a text in quotes, `'true'`, is expected here, not `true`",
            ]
        );
    }

    #[test]
    fn unexpected_end_is_reported() {
        assert_eq!(
            faults_of(""),
            ["1:1: `{`, the start of a fragment, is expected here, not the end of the text"]
        );
        assert_eq!(
            faults_of("{a=B("),
            ["1:6: the name of a parameter or in port is expected here, not the end of the text",]
        );
        assert!(faults_of("{a=B(x='abc)}")[0].contains("without its closing `'`"));
        assert_eq!(
            faults_of("{}}"),
            ["1:3: the end of the net is expected here, not `}`"]
        );
    }

    #[test]
    fn nesting_is_bounded() {
        let deep = format!(
            "{{{}a=X(){}}}",
            "f={".repeat(100_000),
            "}()".repeat(100_000)
        );
        assert!(faults_of(&deep)[0].contains("inside one another"));
    }

    proptest! {
        #[test]
        fn any_text_is_read_without_panic(text in r"[{}()\[\],=.'\\a-c \n]{0,60}") {
            faults_of(&text);
        }
    }
}
