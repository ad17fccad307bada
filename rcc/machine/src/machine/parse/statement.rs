//! Statements.

use super::Parser;
use crate::machine::tree::{Expression, Member, StatementKind, Within};
use crate::syntax::{Parse, Token};

/// Longest time of a statement, s.
const TIME_MAX_S: f64 = 1e6;

impl Parser<'_> {
    pub(super) fn statement(&mut self) -> Parse<StatementKind> {
        let word = self.at.slice();
        match word {
            "start" | "stop" | "configure" | "cleanup" | "recover" | "activate" | "deactivate"
            | "pause" | "reactive" | "step" => {
                let verb = self.at.name("a statement")?;
                let target = self.at.name("the name of a component or machine")?;
                self.at.expect(Token::Semicolon, "`;`")?;
                Ok(StatementKind::Request(verb, target))
            }
            "call" => {
                self.at.advance();
                let (operation, arguments) = self.called()?;
                self.at.expect(Token::Semicolon, "`;`")?;
                Ok(StatementKind::Call(operation, arguments))
            }
            "do" => {
                self.at.advance();
                let (operation, arguments) = self.called()?;
                let until = if self.at.eat_word("until") {
                    Some(self.expression()?)
                } else {
                    None
                };
                let within = self.within()?;
                Ok(StatementKind::Do(operation, arguments, until, within))
            }
            "wait" => {
                self.at.advance();
                if self.at.eat_word("for") {
                    let condition = self.expression()?;
                    return Ok(StatementKind::WaitFor(condition, self.within()?));
                }
                let time = self.time()?;
                self.at.expect(Token::Semicolon, "`;`")?;
                Ok(StatementKind::Wait(time))
            }
            "if" => self.conditional(),
            "while" => {
                self.at.advance();
                let condition = self.expression()?;
                Ok(StatementKind::While(condition, self.block()?))
            }
            "yield" => {
                self.at.advance();
                self.at.expect(Token::Semicolon, "`;`")?;
                Ok(StatementKind::Yield)
            }
            "raise" => {
                self.at.advance();
                let event = self.at.name("the name of an event")?;
                self.at.expect(Token::Semicolon, "`;`")?;
                Ok(StatementKind::Raise(event))
            }
            "set" => self.set(),
            _ => self.assignment(),
        }
    }

    fn set(&mut self) -> Parse<StatementKind> {
        self.at.advance();
        let component = self.at.name("the name of a component")?;
        self.at.expect(Token::Open, "`{`")?;
        let mut values = Vec::new();
        while !self.at.eat(Token::Close) {
            let name = self.at.name("the name of a property")?;
            values.push((name, self.assigned()?));
        }
        Ok(StatementKind::Set(component, values))
    }

    fn conditional(&mut self) -> Parse<StatementKind> {
        self.at.advance();
        let condition = self.expression()?;
        let then = self.block()?;
        let mut otherwise = Vec::new();
        if self.at.eat_word("else") {
            if self.at.is_word("if") {
                let start = self.at.span().start;
                let kind = self.nested(Self::conditional)?;
                let at = self.at.since(start);
                otherwise.push(crate::machine::tree::Statement { kind, at });
            } else {
                otherwise = self.block()?;
            }
        }
        Ok(StatementKind::If(condition, then, otherwise))
    }

    fn called(&mut self) -> Parse<(Member, Vec<Expression>)> {
        let operation = self.member()?;
        self.at.expect(Token::OpenParen, "`(`")?;
        let mut arguments = Vec::new();
        while !self.at.eat(Token::CloseParen) {
            arguments.push(self.expression()?);
            if !self.at.eat(Token::Comma) {
                self.at.expect(Token::CloseParen, "`,` or `)`")?;
                break;
            }
        }
        Ok((operation, arguments))
    }

    /// `within 5s;`, `within 5s else { … }` or `;`.
    fn within(&mut self) -> Parse<Within> {
        if !self.at.eat_word("within") {
            self.at
                .expect(Token::Semicolon, "`within` and a time, or `;`")?;
            return Ok(None);
        }
        let time = self.time()?;
        if self.at.eat_word("else") {
            return Ok(Some((time, Some(self.block()?))));
        }
        self.at.expect(Token::Semicolon, "`else` or `;`")?;
        Ok(Some((time, None)))
    }

    /// A time, ns.
    pub(super) fn time(&mut self) -> Parse<i64> {
        let text = self.at.slice();
        let split = text.find(|c: char| c.is_ascii_alphabetic());
        let parts = split
            .filter(|_| self.at.is(Token::Time))
            .map(|at| text.split_at(at));
        let Some((number, unit)) = parts else {
            return Err(self.at.expected("a time such as `200ms` or `5s`", ""));
        };
        let scale = match unit {
            "ns" => 1e-9,
            "us" => 1e-6,
            "ms" => 1e-3,
            "min" => 60.0,
            _ => 1.0,
        };
        let seconds = number.parse::<f64>().unwrap_or(f64::INFINITY) * scale;
        if seconds > TIME_MAX_S {
            let hint = "the longest time is 1000000s";
            return Err(self.at.expected("a shorter time", hint));
        }
        self.at.advance();
        #[expect(clippy::cast_possible_truncation, reason = "at most 1e15")]
        let nanos = (seconds * 1e9).round() as i64;
        Ok(nanos)
    }
}
