//! Expressions, in the order of how tightly they bind: `or`, `and`, `not`, comparison, sums, products, signs.
#![expect(
    clippy::wildcard_enum_match_arm,
    reason = "most tokens begin no operand"
)]

use super::Parser;
use crate::machine::tree::{Binary, Expression, ExpressionKind, Unary};
use crate::syntax::{Parse, Token};
use crate::value::Value;

impl Parser<'_> {
    pub(super) fn expression(&mut self) -> Parse<Expression> {
        self.nested(|it| it.binary(0))
    }

    /// The operator at the cursor, if it is of that level.
    fn operator(&self, level: usize) -> Option<Binary> {
        Some(match (level, self.at.token()) {
            (0, Token::Word) if self.at.is_word("or") => Binary::Or,
            (1, Token::Word) if self.at.is_word("and") => Binary::And,
            (2, Token::Equal) => Binary::Equal,
            (2, Token::NotEqual) => Binary::NotEqual,
            (2, Token::Less) => Binary::Less,
            (2, Token::LessEqual) => Binary::LessEqual,
            (2, Token::Greater) => Binary::Greater,
            (2, Token::GreaterEqual) => Binary::GreaterEqual,
            (3, Token::Plus) => Binary::Add,
            (3, Token::Minus) => Binary::Subtract,
            (4, Token::Times) => Binary::Multiply,
            (4, Token::Over) => Binary::Divide,
            (4, Token::Percent) => Binary::Remainder,
            _ => return None,
        })
    }

    fn binary(&mut self, level: usize) -> Parse<Expression> {
        if level == 5 {
            return self.signed();
        }
        let start = self.at.span().start;
        if level == 2 && self.at.eat_word("not") {
            let inner = self.nested(|it| it.binary(2))?;
            let kind = ExpressionKind::Unary(Unary::Not, Box::new(inner));
            return Ok(self.made(kind, start));
        }
        let mut left = self.binary(level + 1)?;
        // A chain of operators nests to the left, so its length is bounded like any nesting.
        let mut links = 0;
        while let Some(operator) = self.operator(level) {
            links += 1;
            if links > super::DEPTH_MAX {
                let hint = "split the expression with a variable";
                return Err(self.at.expected("a shorter expression", hint));
            }
            self.at.advance();
            let right = self.binary(level + 1)?;
            let kind = ExpressionKind::Binary(operator, Box::new(left), Box::new(right));
            left = self.made(kind, start);
        }
        Ok(left)
    }

    fn signed(&mut self) -> Parse<Expression> {
        let start = self.at.span().start;
        if self.at.eat(Token::Minus) {
            let inner = self.nested(Self::signed)?;
            let kind = match inner.kind {
                ExpressionKind::Constant(Value::Double(value)) => {
                    ExpressionKind::Constant(Value::Double(-value))
                }
                _ => ExpressionKind::Unary(Unary::Negate, Box::new(inner)),
            };
            return Ok(self.made(kind, start));
        }
        self.atom()
    }

    fn made(&self, kind: ExpressionKind, start: usize) -> Expression {
        Expression {
            kind,
            at: self.at.since(start),
        }
    }

    fn atom(&mut self) -> Parse<Expression> {
        let start = self.at.span().start;
        if self.at.eat(Token::OpenParen) {
            let inner = self.expression()?;
            self.at.expect(Token::CloseParen, "`)`")?;
            return Ok(inner);
        }
        let kind = match self.at.token() {
            Token::Quoted => {
                let text = self.at.slice().trim_matches('\'').to_owned();
                self.at.advance();
                ExpressionKind::Quoted(text)
            }
            Token::Number => ExpressionKind::Constant(self.constant()?),
            Token::Word if matches!(self.at.slice(), "true" | "false") => {
                ExpressionKind::Constant(self.constant()?)
            }
            Token::Word if self.at.is_word("has") => {
                self.at.advance();
                let inner = self.nested(Self::atom)?;
                ExpressionKind::Has(Box::new(inner))
            }
            Token::Word => {
                let name = self.at.name("a value")?;
                if self.at.eat(Token::Dot) {
                    ExpressionKind::Member(self.member_of(name)?)
                } else if self.at.eat_word("is") {
                    let word = self
                        .at
                        .name("a state of the life cycle such as `running`")?;
                    ExpressionKind::Is(name, word)
                } else if self.at.eat_word("in") {
                    let state = self.at.name("the name of a state")?;
                    ExpressionKind::In(name, state)
                } else {
                    ExpressionKind::Variable(name)
                }
            }
            _ => {
                return Err(self
                    .at
                    .expected("a value", "write a variable, `component.port`, or a number"));
            }
        };
        Ok(self.made(kind, start))
    }
}
