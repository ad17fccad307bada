//! Machine text to syntax tree. After an error it continues with the next item or statement, so that one run reports all.

mod expression;
mod statement;

use crate::diagnostic::{Diagnostics, suggest};
use crate::machine::tree::{
    Block, Component, Machine, Member, State, Statement, StatementKind, Transition, Variable,
};
use crate::syntax::{Cursor, Name, Parse, Token};
use crate::value::{Kind, Value};

/// Deepest nesting of machines, blocks and expressions.
pub(super) const DEPTH_MAX: usize = 32;

const ITEMS: [&str; 11] = [
    "component",
    "connect",
    "order",
    "param",
    "var",
    "event",
    "machine",
    "state",
    "initial",
    "final",
    "stop",
];
const PARTS: [&str; 6] = [
    "precondition",
    "entry",
    "run",
    "handle",
    "exit",
    "transition",
];
/// Words that begin a statement or are a part of one; no name may be one of them.
const WORDS: [&str; 34] = [
    "start",
    "stop",
    "configure",
    "cleanup",
    "recover",
    "activate",
    "deactivate",
    "pause",
    "reactive",
    "step",
    "call",
    "do",
    "wait",
    "if",
    "else",
    "while",
    "yield",
    "raise",
    "set",
    "until",
    "within",
    "for",
    "is",
    "in",
    "has",
    "not",
    "and",
    "or",
    "true",
    "false",
    "on",
    "to",
    "state",
    "transition",
];

pub(crate) fn parse(text: &str) -> (Option<Machine>, Diagnostics) {
    let mut parser = Parser {
        at: Cursor::new(text),
        depth: 0,
    };
    let machine = parser.file().ok();
    (machine, parser.at.found)
}

struct Parser<'t> {
    at: Cursor<'t>,
    depth: usize,
}

impl Parser<'_> {
    fn file(&mut self) -> Parse<Machine> {
        let hint = "a machine file is `machine Name { … }`";
        if !self.at.is_word("machine") {
            return Err(self.at.expected("`machine`", hint));
        }
        let machine = self.machine()?;
        if !self.at.is(Token::End) {
            self.at.expected("the end of the file", hint);
        }
        Ok(machine)
    }

    /// Executes a parser one level deeper.
    fn nested<T>(&mut self, parse: impl FnOnce(&mut Self) -> Parse<T>) -> Parse<T> {
        if self.depth >= DEPTH_MAX {
            let hint = format!("at most {DEPTH_MAX} levels are allowed");
            return Err(self.at.expected("less nesting", &hint));
        }
        self.depth += 1;
        let parsed = parse(self);
        self.depth -= 1;
        parsed
    }

    /// A name that is no word of the language.
    fn new_name(&mut self, expected: &str) -> Parse<Name> {
        let name = self.at.name(expected)?;
        if WORDS.contains(&name.text.as_str()) {
            let cause = format!("`{}` is a word of the language", name.text);
            self.at
                .found
                .error(name.at.clone(), cause, "choose another name");
        }
        Ok(name)
    }

    fn machine(&mut self) -> Parse<Machine> {
        self.at.advance();
        let name = self.new_name("the name of the machine")?;
        self.at.expect(Token::Open, "`{`")?;
        let mut machine = Machine {
            name: name.text,
            at: name.at,
            ..Machine::default()
        };
        while !self.at.is(Token::Close) && !self.at.is(Token::End) && !self.at.found.is_full() {
            if self.nested(|it| it.item(&mut machine)).is_err() {
                self.at.skip();
            }
        }
        self.at.expect(Token::Close, "`}`")?;
        Ok(machine)
    }

    fn item(&mut self, machine: &mut Machine) -> Parse<()> {
        let word = self.at.slice();
        match word {
            "component" => machine.components.push(self.component()?),
            "connect" => {
                self.at.advance();
                let from = self.member()?;
                self.at.expect(Token::Arrow, "`->`")?;
                let to = self.member()?;
                machine.connections.push((from, to));
                self.at.expect(Token::Semicolon, "`;`")?;
            }
            "order" => {
                let at = self.at.span();
                self.at.advance();
                let mut names = vec![self.at.name("the name of a component")?];
                while self.at.eat(Token::Comma) {
                    names.push(self.at.name("the name of a component")?);
                }
                if machine.order.is_some() {
                    self.at
                        .found
                        .error(at.clone(), "`order` is given twice", "remove one of them");
                }
                machine.order = Some((at, names));
                self.at.expect(Token::Semicolon, "`;`")?;
            }
            "param" | "var" => {
                self.at.advance();
                machine.variables.push(self.variable(word == "param")?);
            }
            "event" => {
                self.at.advance();
                machine.events.push(self.new_name("the name of the event")?);
                self.at.expect(Token::Semicolon, "`;`")?;
            }
            "machine" => machine.machines.push(self.machine()?),
            "stop" => self.stop_on_end(machine)?,
            "initial" | "final" | "state" => machine.states.push(self.state()?),
            _ => {
                return Err(self
                    .at
                    .expected("an item of a machine", &suggest(word, ITEMS)));
            }
        }
        Ok(())
    }

    /// `stop on end within 5s;`
    fn stop_on_end(&mut self, machine: &mut Machine) -> Parse<()> {
        let start = self.at.span().start;
        self.at.advance();
        for word in ["on", "end", "within"] {
            if !self.at.eat_word(word) {
                let hint = "a machine that stops when it is ended has `stop on end within 5s;`";
                return Err(self.at.expected(&format!("`{word}`"), hint));
            }
        }
        let time = self.time()?;
        let at = self.at.since(start);
        self.at.expect(Token::Semicolon, "`;`")?;
        if machine.end.replace((at.clone(), time)).is_some() {
            let cause = "`stop on end` is given twice";
            self.at.found.error(at, cause, "remove one of them");
        }
        Ok(())
    }

    fn component(&mut self) -> Parse<Component> {
        self.at.advance();
        let name = self.new_name("the name of the component")?;
        if !self.at.eat_word("from") {
            let hint = "a component is `component servo from \"servo.component\";`";
            return Err(self.at.expected("`from`", hint));
        }
        let file_at = self.at.span();
        let file = self
            .at
            .quoted("the file of the component in double quotes")?;
        let is_started = self.at.eat_word("started");
        let is_configured = is_started || self.at.eat_word("configured");
        self.at
            .expect(Token::Semicolon, "`configured`, `started` or `;`")?;
        Ok(Component {
            name,
            file,
            file_at,
            is_configured,
            is_started,
        })
    }

    fn member(&mut self) -> Parse<Member> {
        let owner = self.at.name("the name of a component")?;
        self.at.expect(Token::Dot, "`.`")?;
        self.member_of(owner)
    }

    /// The rest of a member behind its dot.
    fn member_of(&mut self, owner: Name) -> Parse<Member> {
        let name = self.at.name("the name of a port, property or operation")?;
        let mut index = None;
        if self.at.eat(Token::OpenBracket) {
            let Ok(number) = self.at.slice().parse() else {
                return Err(self.at.expected("a number from 0", ""));
            };
            index = Some(number);
            self.at.advance();
            self.at.expect(Token::CloseBracket, "`]`")?;
        }
        Ok(Member { owner, name, index })
    }

    fn variable(&mut self, is_parameter: bool) -> Parse<Variable> {
        let name = self.new_name("the name of the variable")?;
        self.at.expect(Token::Colon, "`:` and a type")?;
        let kinds = ["bool", "int", "double"];
        let word = self.at.slice();
        let Some(kind) = Kind::of(word).filter(|kind| kinds.contains(&kind.word())) else {
            return Err(self.at.expected("a type", &suggest(word, kinds)));
        };
        self.at.advance();
        let mut initial = Value::zero(kind).unwrap_or(Value::Bool(false));
        if self.at.eat(Token::Is) {
            let start = self.at.span().start;
            let value = self.constant()?;
            initial = match (kind, value) {
                (Kind::Double, Value::Int(value)) => Value::Double(f64::from(value)),
                (kind, value) if value.kind() == kind => value,
                (_, value) => {
                    let cause = format!("`{}` is {kind}, but this is {}", name.text, value.kind());
                    let hint = format!("write a value of type {kind}");
                    self.at.found.error(self.at.since(start), cause, hint);
                    initial
                }
            };
        }
        self.at.expect(Token::Semicolon, "`;`")?;
        Ok(Variable {
            name,
            kind,
            initial,
            is_parameter,
        })
    }

    fn constant(&mut self) -> Parse<Value> {
        for (word, value) in [("true", true), ("false", false)] {
            if self.at.eat_word(word) {
                return Ok(Value::Bool(value));
            }
        }
        let start = self.at.span().start;
        let value = self.at.number("a value such as `true`, `1` or `0.5`")?;
        let text = self.at.text.get(self.at.since(start)).unwrap_or_default();
        Ok(text
            .replace(' ', "")
            .parse()
            .map_or(Value::Double(value), Value::Int))
    }

    fn state(&mut self) -> Parse<State> {
        let (mut is_initial, mut is_final) = (false, false);
        loop {
            if self.at.eat_word("initial") {
                is_initial = true;
            } else if self.at.eat_word("final") {
                is_final = true;
            } else if self.at.eat_word("state") {
                break;
            } else {
                return Err(self.at.expected("`state`", ""));
            }
        }
        let mut state = State {
            name: self.new_name("the name of the state")?,
            is_initial,
            is_final,
            precondition: None,
            entry: None,
            run: None,
            handle: None,
            exit: None,
            transitions: Vec::new(),
        };
        self.at.expect(Token::Open, "`{`")?;
        while !self.at.is(Token::Close) && !self.at.is(Token::End) && !self.at.found.is_full() {
            if self.part(&mut state).is_err() {
                self.at.skip();
            }
        }
        self.at.expect(Token::Close, "`}`")?;
        Ok(state)
    }

    fn part(&mut self, state: &mut State) -> Parse<()> {
        let (word, at) = (self.at.slice(), self.at.span());
        let twice = match word {
            "precondition" => {
                self.at.advance();
                let condition = self.expression()?;
                self.at.expect(Token::Semicolon, "`;`")?;
                state.precondition.replace(condition).is_some()
            }
            "entry" | "run" | "handle" | "exit" => {
                self.at.advance();
                let block = self.block()?;
                let program = match word {
                    "entry" => &mut state.entry,
                    "run" => &mut state.run,
                    "handle" => &mut state.handle,
                    _ => &mut state.exit,
                };
                program.replace(block).is_some()
            }
            "transition" => {
                self.at.advance();
                state.transitions.push(self.transition()?);
                false
            }
            _ => return Err(self.at.expected("a part of a state", &suggest(word, PARTS))),
        };
        if twice {
            let cause = format!("`{word}` is given twice");
            self.at.found.error(
                at,
                cause,
                "a state has one of them; put the statements together",
            );
        }
        Ok(())
    }

    fn transition(&mut self) -> Parse<Transition> {
        let mut event = None;
        if self.at.eat_word("on") {
            event = Some(self.at.name("the name of an event")?);
        }
        let condition = if self.at.eat_word("if") {
            Some(self.expression()?)
        } else {
            None
        };
        if !self.at.eat_word("to") {
            let hint = "a transition is `transition [on event] [if condition] to State { program } else { failure }`";
            return Err(self.at.expected("`to` and a state", hint));
        }
        let target = self.at.name("the name of a state")?;
        let (mut program, mut failure) = (None, None);
        if self.at.is(Token::Open) {
            program = Some(self.block()?);
        }
        if self.at.eat_word("else") {
            failure = Some(self.block()?);
        }
        if program.is_none() && failure.is_none() {
            self.at.expect(Token::Semicolon, "`{` or `;`")?;
        }
        Ok(Transition {
            event,
            condition,
            target,
            program,
            failure,
        })
    }

    fn block(&mut self) -> Parse<Block> {
        self.nested(|it| {
            it.at.expect(Token::Open, "`{`")?;
            let mut statements = Vec::new();
            while !it.at.is(Token::Close) && !it.at.is(Token::End) && !it.at.found.is_full() {
                let start = it.at.span().start;
                match it.statement() {
                    Ok(kind) => statements.push(Statement {
                        kind,
                        at: it.at.since(start),
                    }),
                    Err(_) => it.at.skip(),
                }
            }
            it.at.expect(Token::Close, "`}`")?;
            Ok(statements)
        })
    }

    fn assigned(&mut self) -> Parse<crate::machine::tree::Expression> {
        self.at.expect(Token::Becomes, "`:=`")?;
        let value = self.expression()?;
        self.at.expect(Token::Semicolon, "`;`")?;
        Ok(value)
    }

    fn assignment(&mut self) -> Parse<StatementKind> {
        let name = self.at.name("a statement")?;
        if self.at.eat(Token::Dot) {
            let member = self.member_of(name)?;
            return Ok(StatementKind::Write(member, self.assigned()?));
        }
        if !self.at.is(Token::Becomes) {
            let hint = suggest(&name.text, WORDS.iter().copied().take(19));
            return Err(self.at.expected("`:=`", &hint));
        }
        Ok(StatementKind::Assign(name, self.assigned()?))
    }
}
