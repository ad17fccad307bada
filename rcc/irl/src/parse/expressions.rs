//! Expressions, by precedence.

use super::{Kind, Parsed, Parser};
use crate::tree::{Binary, Expr, ExprKind, Name, Unary};

impl Parser<'_> {
    pub(super) fn expr(&mut self) -> Parsed<Expr> {
        self.nested(|parser| parser.level(0))
    }

    fn operator(&self, level: usize) -> Option<Binary> {
        let word = if self.peek() == Kind::Name {
            self.word()
        } else {
            String::new()
        };
        Some(match (level, self.peek(), word.as_str()) {
            (0, _, "or") => Binary::Or,
            (0, _, "exor") => Binary::Exor,
            (1, _, "and") => Binary::And,
            (2, Kind::Equals, _) => Binary::Equal,
            (2, Kind::Differs, _) => Binary::Differs,
            (2, Kind::Less, _) => Binary::Less,
            (2, Kind::LessEqual, _) => Binary::LessEqual,
            (2, Kind::Greater, _) => Binary::Greater,
            (2, Kind::GreaterEqual, _) => Binary::GreaterEqual,
            (3, Kind::Plus, _) => Binary::Add,
            (3, Kind::Minus, _) => Binary::Subtract,
            (4, Kind::Times, _) => Binary::Multiply,
            (4, Kind::Divide, _) => Binary::Divide,
            (4, Kind::At, _) => Binary::Compose,
            (4, _, "div") => Binary::Div,
            (4, _, "mod") => Binary::Mod,
            _ => return None,
        })
    }

    fn level(&mut self, level: usize) -> Parsed<Expr> {
        if level > 4 {
            return self.unary();
        }
        let mut left = self.level(level + 1)?;
        // A chain of operators is as deep a tree as nesting is.
        let mut links = 0;
        while let Some(operator) = self.operator(level) {
            links += 1;
            if links > 200 {
                return self.fail(
                    "`;`: an expression of at most 200 operators in a row",
                    String::new(),
                );
            }
            self.advance();
            let right = self.level(level + 1)?;
            let at = left.at.start..right.at.end;
            let kind = ExprKind::Binary(operator, Box::new(left), Box::new(right));
            left = Expr { kind, at };
            if level == 2 {
                break;
            }
        }
        Ok(left)
    }

    fn unary(&mut self) -> Parsed<Expr> {
        let start = self.at().start;
        let operator = match self.peek() {
            Kind::Minus => Some(Unary::Negate),
            Kind::Plus => {
                self.advance();
                return self.nested(Self::unary);
            }
            Kind::Name if self.is_word("not") => Some(Unary::Not),
            _ => None,
        };
        let Some(operator) = operator else {
            return self.atom();
        };
        self.advance();
        let inner = self.nested(Self::unary)?;
        let at = start..inner.at.end;
        Ok(Expr {
            kind: ExprKind::Unary(operator, Box::new(inner)),
            at,
        })
    }

    fn atom(&mut self) -> Parsed<Expr> {
        let at = self.at();
        let text = self.text.get(at.clone()).unwrap_or_default();
        let kind = match self.peek() {
            Kind::Int => match text.parse::<i32>() {
                Ok(value) => ExprKind::Int(value.into()),
                Err(_) => return self.fail("a whole number up to 2147483647", String::new()),
            },
            Kind::Real => match text.parse::<f64>() {
                Ok(value) if value.is_finite() => ExprKind::Real(value),
                _ => return self.fail("a number up to 1.7e308", String::new()),
            },
            Kind::Text => {
                let text = self.string()?;
                return Ok(Expr {
                    kind: ExprKind::Text(text),
                    at,
                });
            }
            Kind::Name if self.is_word("true") => ExprKind::Bool(true),
            Kind::Name if self.is_word("false") => ExprKind::Bool(false),
            Kind::Open => return self.tuple(),
            Kind::Name => return self.reference(),
            _ => return self.fail("an expression", String::new()),
        };
        self.advance();
        Ok(Expr { kind, at })
    }

    fn tuple(&mut self) -> Parsed<Expr> {
        let start = self.at().start;
        self.advance();
        let mut parts = self.list(Kind::Close, "`)`")?;
        let at = start..self.end();
        let kind = match (parts.pop(), parts.is_empty()) {
            (Some(one), true) => return Ok(Expr { kind: one.kind, at }),
            (Some(last), false) => {
                parts.push(last);
                ExprKind::Tuple(parts)
            }
            (None, _) => return self.fail("an expression", String::new()),
        };
        Ok(Expr { kind, at })
    }

    /// Expressions up to a closing word.
    pub(super) fn list(&mut self, close: Kind, shown: &str) -> Parsed<Vec<Expr>> {
        let mut list = Vec::new();
        if self.accept(close) {
            return Ok(list);
        }
        loop {
            list.push(self.expr()?);
            if !self.accept(Kind::Comma) {
                self.expect(close, shown)?;
                return Ok(list);
            }
        }
    }

    pub(super) fn reference(&mut self) -> Parsed<Expr> {
        let name = self.name("an expression")?;
        let start = name.at.start;
        if self.accept(Kind::Open) {
            let arguments = self.list(Kind::Close, "`)`")?;
            let at = start..self.end();
            return Ok(Expr {
                kind: ExprKind::Call(name, arguments),
                at,
            });
        }
        let mut expr = Expr {
            kind: ExprKind::Name(name.text),
            at: name.at,
        };
        let mut parts = 0;
        loop {
            parts += 1;
            if parts > 32 {
                return self.fail("a name with at most 32 parts", String::new());
            }
            if self.accept(Kind::Dot) {
                let field: Name = self.name("the name of a component")?;
                let at = start..field.at.end;
                expr = Expr {
                    kind: ExprKind::Field(Box::new(expr), field),
                    at,
                };
            } else if self.accept(Kind::OpenIndex) {
                let indices = self.list(Kind::CloseIndex, "`]`")?;
                let at = start..self.end();
                expr = Expr {
                    kind: ExprKind::Index(Box::new(expr), indices),
                    at,
                };
            } else {
                return Ok(expr);
            }
        }
    }
}
