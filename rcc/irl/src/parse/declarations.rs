//! Declarations and types.

use super::{Kind, Parsed, Parser};
use crate::tree::{Body, Declaration, Name, Parameter, Routine, TypeExpr};

impl Parser<'_> {
    /// Declarations and statements up to the word `end` and its `;`.
    pub(super) fn body(&mut self, end: &str) -> Body {
        let mut body = Body::default();
        while self.peek() != Kind::End {
            let parsed = if self.accept_word("const") {
                self.section(&mut body, Self::constant)
            } else if self.accept_word("type") {
                self.section(&mut body, Self::type_declaration)
            } else if self.accept_word("var") {
                self.section(&mut body, Self::variable)
            } else if self.is_word("signal") && self.begins_signals() {
                self.advance();
                self.section(&mut body, Self::signal)
            } else if self.is_word("procedure") || self.is_word("function") {
                self.routine().map(|routine| {
                    let routine = Declaration::Routine(Box::new(routine));
                    body.declarations.push(routine);
                })
            } else {
                break;
            };
            if parsed.is_err() {
                self.resume();
            }
        }
        if !body.declarations.is_empty() && self.expect_word("begin").is_err() {
            // The statements are parsed nevertheless.
            self.accept_word("begin");
        } else if body.declarations.is_empty() {
            self.accept_word("begin");
        }
        body.statements = self.statements();
        if self.expect_word(end).is_err() {
            self.resume();
        } else if self.peek() == Kind::Semicolon {
            self.advance();
        } else if self.expect(Kind::Semicolon, "`;`").is_err() {
            self.resume();
        }
        body
    }

    fn begins_signals(&self) -> bool {
        let next = self.tokens.get(self.position + 1);
        let word = next.and_then(|token| self.text.get(token.at.clone()));
        word.is_some_and(|word| word.eq_ignore_ascii_case("in") || word.eq_ignore_ascii_case("out"))
    }

    /// One declaration or more: as long as names follow.
    fn section(
        &mut self,
        body: &mut Body,
        parse: impl Fn(&mut Self) -> Parsed<Declaration>,
    ) -> Parsed<()> {
        loop {
            match parse(self) {
                Ok(declaration) => body.declarations.push(declaration),
                Err(_) => self.resume(),
            }
            let word = self.word();
            let is_name = self.peek() == Kind::Name
                && (!crate::token::RESERVED.contains(&word.as_str())
                    || matches!(word.as_str(), "in" | "out"));
            if !is_name {
                return Ok(());
            }
        }
    }

    fn constant(&mut self) -> Parsed<Declaration> {
        let name = self.name("the name of a constant")?;
        self.expect(Kind::Colon, "`:`").or_else(|reported| {
            if self.peek() == Kind::Assign {
                self.diagnostics.pop();
                Ok(())
            } else {
                Err(reported)
            }
        })?;
        let ty = if self.peek() == Kind::Assign {
            None
        } else {
            Some(self.type_expr()?)
        };
        self.expect(Kind::Assign, "`:=`")?;
        let value = self.expr()?;
        self.expect(Kind::Semicolon, "`;`")?;
        Ok(Declaration::Const(name, ty, value))
    }

    fn type_declaration(&mut self) -> Parsed<Declaration> {
        let name = self.name("the name of a type")?;
        self.expect(Kind::Equals, "`=`")?;
        let ty = self.type_expr()?;
        self.expect(Kind::Semicolon, "`;`")?;
        Ok(Declaration::Type(name, ty))
    }

    fn names(&mut self) -> Parsed<Vec<Name>> {
        let mut names = vec![self.name("a name")?];
        while self.accept(Kind::Comma) {
            names.push(self.name("a name")?);
        }
        Ok(names)
    }

    fn variable(&mut self) -> Parsed<Declaration> {
        let names = self.names()?;
        self.expect(Kind::Colon, "`:`")?;
        let ty = self.type_expr()?;
        let value = if self.accept(Kind::Assign) {
            Some(self.expr()?)
        } else {
            None
        };
        self.expect(Kind::Semicolon, "`;`")?;
        Ok(Declaration::Var(names, ty, value))
    }

    fn signal(&mut self) -> Parsed<Declaration> {
        let is_out = if self.accept_word("in") {
            false
        } else if self.accept_word("out") {
            true
        } else {
            return self.fail("`in` or `out`", String::new());
        };
        let name = self.name("the name of a signal")?;
        self.expect(Kind::Equals, "`=`")?;
        let of = self.expr()?;
        self.expect(Kind::Semicolon, "`;`")?;
        Ok(Declaration::Signal { is_out, name, of })
    }

    pub(super) fn type_expr(&mut self) -> Parsed<TypeExpr> {
        self.nested(Self::type_inside)
    }

    fn type_inside(&mut self) -> Parsed<TypeExpr> {
        if self.accept_word("array") {
            self.expect(Kind::OpenIndex, "`[`")?;
            let mut ranges = Vec::new();
            loop {
                let from = self.expr()?;
                self.expect(Kind::Range, "`..`")?;
                ranges.push((from, self.expr()?));
                if !self.accept(Kind::Comma) {
                    break;
                }
            }
            self.expect(Kind::CloseIndex, "`]`")?;
            self.expect_word("of")?;
            return Ok(TypeExpr::Array(ranges, Box::new(self.type_expr()?)));
        }
        if self.accept_word("record") {
            let mut fields = Vec::new();
            while !self.is_word("endrecord") {
                let names = self.names()?;
                self.expect(Kind::Colon, "`:`")?;
                let ty = self.type_expr()?;
                self.expect(Kind::Semicolon, "`;`")?;
                fields.push((names, ty));
            }
            self.advance();
            return Ok(TypeExpr::Record(fields));
        }
        if self.is_word("event") {
            let (text, at) = (self.word(), self.at());
            self.advance();
            return Ok(TypeExpr::Named(Name { text, at }));
        }
        Ok(TypeExpr::Named(self.name("a type")?))
    }

    fn routine(&mut self) -> Parsed<Routine> {
        let is_function = self.is_word("function");
        self.advance();
        let name = self.name("the name of the routine")?;
        let mut parameters = Vec::new();
        if self.accept(Kind::Open) && !self.accept(Kind::Close) {
            loop {
                let by_reference = self.accept_word("out") || self.accept_word("inout");
                if !by_reference {
                    self.accept_word("in");
                }
                let names = self.names()?;
                self.expect(Kind::Colon, "`:`")?;
                let ty = self.type_expr()?;
                parameters.extend(names.into_iter().map(|name| Parameter {
                    by_reference,
                    name,
                    ty: ty.clone(),
                }));
                if !self.accept(Kind::Semicolon) {
                    break;
                }
            }
            self.expect(Kind::Close, "`)`")?;
        }
        let result = if is_function {
            self.expect(Kind::Colon, "`:` and the type of the result")?;
            Some(self.type_expr()?)
        } else {
            None
        };
        self.expect(Kind::Semicolon, "`;`")?;
        let end = if is_function { "endfct" } else { "endproc" };
        let body = self.nested(|parser| Ok(parser.body(end)))?;
        Ok(Routine {
            name,
            parameters,
            result,
            body,
        })
    }
}
