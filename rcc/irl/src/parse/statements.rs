//! Statements.

use super::{Kind, Parsed, Parser};
use crate::diagnostic::did_you_mean;
use crate::token::RESERVED;
use crate::tree::{ExprKind, Move, PathKind, Statement, StatementKind};

impl Parser<'_> {
    /// Statements up to a word that ends a block.
    pub(super) fn statements(&mut self) -> Vec<Statement> {
        let mut statements = Vec::new();
        while self.peek() != Kind::End && !(self.peek() == Kind::Name && self.ends_block()) {
            if self.accept(Kind::Semicolon) {
                continue;
            }
            let start = self.at().start;
            match self.nested(Self::statement) {
                Ok(kind) => {
                    let at = start..self.end();
                    statements.push(Statement { kind, at });
                }
                Err(_) => self.resume(),
            }
        }
        statements
    }

    fn statement(&mut self) -> Parsed<StatementKind> {
        let word = if self.peek() == Kind::Name {
            self.word()
        } else {
            String::new()
        };
        match word.as_str() {
            "seq" => self.block("endseq").map(StatementKind::Seq),
            "par" => self.block("endpar").map(StatementKind::Par),
            "if" => self.if_(),
            "case" => self.case(),
            "for" => self.for_(),
            "while" => {
                self.advance();
                let condition = self.expr()?;
                self.accept_word("do");
                let body = self.statements();
                self.closing("endwhile")?;
                Ok(StatementKind::While(condition, body))
            }
            "repeat" => {
                self.advance();
                let body = self.statements();
                self.expect_word("until")?;
                let condition = self.expr()?;
                self.expect(Kind::Semicolon, "`;`")?;
                Ok(StatementKind::Repeat(body, condition))
            }
            _ => {
                let kind = self.simple(&word)?;
                self.expect(Kind::Semicolon, "`;`")?;
                Ok(kind)
            }
        }
    }

    fn closing(&mut self, end: &str) -> Parsed<()> {
        self.expect_word(end)?;
        self.expect(Kind::Semicolon, "`;`")
    }

    /// `seq` and `par`: the `;` behind their end may be missing.
    fn block(&mut self, end: &str) -> Parsed<Vec<Statement>> {
        self.advance();
        let statements = self.statements();
        self.expect_word(end)?;
        self.accept(Kind::Semicolon);
        Ok(statements)
    }

    fn if_(&mut self) -> Parsed<StatementKind> {
        let mut branches = Vec::new();
        loop {
            self.advance();
            let condition = self.expr()?;
            self.expect_word("then")?;
            branches.push((condition, self.statements()));
            if !self.is_word("elsif") {
                break;
            }
        }
        let otherwise = if self.accept_word("else") {
            self.statements()
        } else {
            Vec::new()
        };
        self.closing("endif")?;
        Ok(StatementKind::If(branches, otherwise))
    }

    fn case(&mut self) -> Parsed<StatementKind> {
        self.advance();
        let of = self.expr()?;
        self.expect_word("of")?;
        let mut branches = Vec::new();
        while self.accept_word("when") {
            let mut labels = vec![self.expr()?];
            while self.accept(Kind::Comma) {
                labels.push(self.expr()?);
            }
            self.expect(Kind::Colon, "`:`")?;
            branches.push((labels, self.statements()));
        }
        if branches.is_empty() {
            return self.fail("`when`", String::new());
        }
        let mut default = None;
        if self.accept_word("default") {
            self.expect(Kind::Colon, "`:`")?;
            default = Some(self.statements());
        }
        self.closing("endcase")?;
        Ok(StatementKind::Case(of, branches, default))
    }

    fn for_(&mut self) -> Parsed<StatementKind> {
        self.advance();
        let variable = self.name("the variable of the loop")?;
        self.expect(Kind::Assign, "`:=`")?;
        let from = self.expr()?;
        self.expect_word("to")?;
        let to = self.expr()?;
        let step = if self.accept_word("step") {
            Some(self.expr()?)
        } else {
            None
        };
        self.accept_word("do");
        let body = self.statements();
        self.closing("endfor")?;
        Ok(StatementKind::For {
            variable,
            from,
            to,
            step,
            body,
        })
    }

    fn simple(&mut self, word: &str) -> Parsed<StatementKind> {
        match word {
            "move" | "move_inc" => self.move_(word == "move_inc"),
            "wait" => {
                self.advance();
                if self.accept_word("for") {
                    let condition = self.expr()?;
                    let timeout = if self.accept_word("timeout") {
                        Some(self.expr()?)
                    } else {
                        None
                    };
                    return Ok(StatementKind::WaitFor(condition, timeout));
                }
                let time = self.expr()?;
                self.expect_word("sec")?;
                Ok(StatementKind::WaitSec(time))
            }
            "signal" => {
                self.advance();
                self.expect_word("event")?;
                Ok(StatementKind::SignalEvent(
                    self.name("the name of an event")?,
                ))
            }
            "return" => {
                self.advance();
                if self.peek() == Kind::Semicolon {
                    return Ok(StatementKind::Return(None));
                }
                Ok(StatementKind::Return(Some(self.expr()?)))
            }
            "exit" | "pause" | "halt" => {
                self.advance();
                Ok(match word {
                    "exit" => StatementKind::Exit,
                    "pause" => StatementKind::Pause,
                    _ => StatementKind::Halt,
                })
            }
            _ => self.assignment_or_call(word),
        }
    }

    fn assignment_or_call(&mut self, word: &str) -> Parsed<StatementKind> {
        if self.peek() != Kind::Name || RESERVED.contains(&word) {
            let hint = match word {
                "const" | "type" | "var" | "procedure" | "function" => {
                    "declarations come before `begin`".to_owned()
                }
                _ => String::new(),
            };
            return self.fail("a statement", hint);
        }
        let reference = self.reference()?;
        if self.accept(Kind::Assign) {
            return Ok(StatementKind::Assign(reference, self.expr()?));
        }
        match reference.kind {
            ExprKind::Call(name, arguments) => Ok(StatementKind::Call(name, arguments)),
            ExprKind::Name(text) if self.peek() == Kind::Semicolon => {
                let at = reference.at;
                Ok(StatementKind::Call(
                    crate::tree::Name { text, at },
                    Vec::new(),
                ))
            }
            _ => {
                let statements = [
                    "move", "move_inc", "wait", "signal", "return", "while", "repeat",
                ];
                let hint = if self.peek() == Kind::Equals {
                    "`:=` assigns, `=` compares".to_owned()
                } else {
                    did_you_mean(word, statements)
                };
                self.fail("`:=`", hint)
            }
        }
    }

    fn move_(&mut self, is_incremental: bool) -> Parsed<StatementKind> {
        self.advance();
        let path = match self.word().as_str() {
            "ptp" => PathKind::Ptp,
            "lin" => PathKind::Lin,
            "circle" => PathKind::Circle,
            word => {
                let hint = did_you_mean(word, ["ptp", "lin", "circle"]);
                return self.fail("`ptp`, `lin` or `circle`", hint);
            }
        };
        self.advance();
        let mut target = self.expr()?;
        let mut via = None;
        if path == PathKind::Circle {
            self.expect(Kind::Comma, "`,` and the end of the arc")?;
            via = Some(std::mem::replace(&mut target, self.expr()?));
        }
        let mut attributes = Vec::new();
        while self.peek() == Kind::Name {
            let name = self.name("an attribute")?;
            let shown = format!("`:=` after attribute `{}`", name.text);
            if self.peek() != Kind::Assign {
                return self.fail(&shown, String::new());
            }
            self.advance();
            attributes.push((name, self.expr()?));
        }
        Ok(StatementKind::Move(Box::new(Move {
            is_incremental,
            path,
            via,
            target,
            attributes,
        })))
    }
}
