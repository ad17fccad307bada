//! Text commands to a machine and its components, such as `servo.gain := 2` and `generator.start()`, one after the other.
//! They are checked whole before the first is executed; who executes them is decided elsewhere.

use std::ops::Range;

use crate::component::{Component, Data};
use crate::diagnostic::{Diagnostics, suggest};
use crate::lifecycle::Request;
use crate::machine::{Control, Program};
use crate::syntax::{Cursor, Name, Parse, Recorded, Token};
use crate::value::{Kind, Shape, Value};

/// Most commands of a text.
pub const COMMANDS_MAX: usize = 1000;

/// A text command, with the numbers of its program.
#[derive(Clone, Debug, PartialEq)]
pub enum Command {
    /// `Lola.start()`: changes the mode of a machine.
    Control(usize, Control),
    /// `raise abort`: raises an event.
    Raise(usize),
    /// `enter Off`, `enter Homing.Search`: requests a state of a machine.
    Enter(usize, usize),
    /// `servo.start()`: changes the life cycle of a component.
    Request(usize, Request),
    /// `servo.gain := 2`, `servo { gain := 2; limit := 3 }`: sets properties, all or none.
    Set(usize, Vec<(String, Data)>),
    /// `servo.desired := 0.5`: writes an in port.
    Write(usize, usize, Value),
    /// `robot.open(1)`: calls an operation.
    Call(usize, usize, Vec<Value>),
}

/// A command and where it stands.
#[derive(Clone, Debug, PartialEq)]
pub struct Placed {
    /// The command.
    pub command: Command,
    /// Its bytes in the text.
    pub at: Range<usize>,
}

/// Parses text commands, separated by `;` or by lines.
///
/// # Errors
/// All errors of the text.
pub fn parse(text: &str, program: &Program) -> Result<Vec<Placed>, Diagnostics> {
    let mut parser = Parser {
        cursor: Cursor::new(text),
        program,
    };
    let mut commands = Vec::new();
    loop {
        while parser.cursor.eat(Token::Semicolon) {}
        if parser.cursor.is(Token::End) || parser.cursor.found.is_full() {
            break;
        }
        let start = parser.cursor.span().start;
        match parser.command() {
            Ok(command) if commands.len() < COMMANDS_MAX => {
                let at = parser.cursor.since(start);
                commands.push(Placed { command, at });
            }
            Ok(_) => {
                let at = parser.cursor.since(start);
                let cause = format!("there are more than {COMMANDS_MAX} commands");
                parser
                    .cursor
                    .found
                    .error(at, cause, "send them in several texts");
                break;
            }
            Err(Recorded) => {
                while !parser.cursor.is(Token::Semicolon) && !parser.cursor.is(Token::End) {
                    parser.cursor.advance();
                }
            }
        }
    }
    let mut found = parser.cursor.found;
    if found.has_errors() {
        found.sort();
        return Err(found);
    }
    Ok(commands)
}

struct Parser<'t> {
    cursor: Cursor<'t>,
    program: &'t Program,
}

impl Parser<'_> {
    fn command(&mut self) -> Parse<Command> {
        if self.cursor.eat_word("raise") {
            let name = self.cursor.name("the name of an event")?;
            let events = self.program.events();
            let event = events.iter().position(|event| *event == name.text);
            let known = events.iter().map(String::as_str).collect();
            return Ok(Command::Raise(self.known(event, &name, "event", known)?));
        }
        if self.cursor.eat_word("enter") {
            return self.enter();
        }
        let owner = self
            .cursor
            .name("a component, a machine, `raise` or `enter`")?;
        let mut members = self.program.members().iter();
        let component = members.position(|member| member.name == owner.text);
        let Some(component) = component else {
            let mut machines = self.program.machines();
            let machine = machines.position(|machine| machine == owner.text);
            let members = self.program.members().iter();
            let known = members.map(|member| member.name.as_str());
            let known = known.chain(self.program.machines()).collect();
            let machine = self.known(machine, &owner, "component or machine", known)?;
            return self.control(machine);
        };
        if self.cursor.eat(Token::Open) {
            return self.settings(component);
        }
        self.cursor.expect(Token::Dot, "`.` or `{`")?;
        let name = self.cursor.name("a property, port, operation or request")?;
        if self.cursor.eat(Token::Becomes) {
            return self.assigned(component, &name);
        }
        self.call(component, &name)
    }

    fn enter(&mut self) -> Parse<Command> {
        let first = self.cursor.name("the name of a state")?;
        let (machine, state) = if self.cursor.eat(Token::Dot) {
            let mut machines = self.program.machines();
            let machine = machines.position(|machine| machine == first.text);
            let known = self.program.machines().collect();
            let machine = self.known(machine, &first, "machine", known)?;
            (machine, self.cursor.name("the name of a state")?)
        } else {
            (0, first)
        };
        let found = self
            .program
            .states(machine)
            .position(|one| one == state.text);
        let known = self.program.states(machine).collect();
        Ok(Command::Enter(
            machine,
            self.known(found, &state, "state", known)?,
        ))
    }

    fn control(&mut self, machine: usize) -> Parse<Command> {
        self.cursor.expect(Token::Dot, "`.`")?;
        let name = self.cursor.name("a request such as `start`")?;
        let control = Control::ALL.into_iter().find(|one| one.word() == name.text);
        let known = Control::ALL.iter().map(|one| one.word()).collect();
        let control = self.known(control, &name, "request of machines", known)?;
        self.cursor.expect(Token::OpenParen, "`()`")?;
        self.cursor.expect(Token::CloseParen, "`)`")?;
        Ok(Command::Control(machine, control))
    }

    fn component(&self, component: usize) -> Option<&Component> {
        Some(&self.program.members().get(component)?.component)
    }

    /// `{ gain := 2; limit := 3 }` behind the name of a component.
    fn settings(&mut self, component: usize) -> Parse<Command> {
        let mut settings = Vec::new();
        while !self.cursor.eat(Token::Close) {
            let name = self.cursor.name("the name of a property, or `}`")?;
            self.cursor.expect(Token::Becomes, "`:=`")?;
            settings.push((name.text, self.data()?));
            if !self.cursor.eat(Token::Semicolon) && !self.cursor.is(Token::Close) {
                return Err(self.cursor.expected("`;` or `}`", ""));
            }
        }
        Ok(Command::Set(component, settings))
    }

    fn assigned(&mut self, component: usize, name: &Name) -> Parse<Command> {
        let at = self.cursor.span().start;
        let data = self.data()?;
        let at = self.cursor.since(at);
        let ports = self.component(component).map(|it| it.ports.as_slice());
        let mut ports = ports.unwrap_or_default().iter();
        let port = ports.position(|port| port.declared.name == name.text && !port.is_output);
        let Some(port) = port else {
            return Ok(Command::Set(component, vec![(name.text.clone(), data)]));
        };
        let connections = self.program.connections().iter();
        if connections.clone().any(|c| c.to == (component, port)) {
            let cause = format!("the in port `{}` is connected", name.text);
            self.cursor
                .found
                .error(name.at.clone(), cause, "write to the port that it reads");
            return Err(Recorded);
        }
        let declared = self.component(component).and_then(|it| it.ports.get(port));
        let declared = declared.map(|port| port.declared.clone());
        let fitted = declared.map(|declared| data.fitting(&declared));
        let value = match fitted {
            Some(Ok(data)) => data.value(),
            Some(Err(why)) => {
                self.cursor.found.error(at, why.to_string(), why.hint());
                return Err(Recorded);
            }
            None => None,
        };
        value.map_or_else(
            || {
                let cause = "an array cannot be written to a port";
                self.cursor
                    .found
                    .error(at, cause, "connect the port, or use single values");
                Err(Recorded)
            },
            |value| Ok(Command::Write(component, port, value)),
        )
    }

    fn call(&mut self, component: usize, name: &Name) -> Parse<Command> {
        self.cursor.expect(Token::OpenParen, "`:=` or `(`")?;
        let operations = self.component(component).map(|it| it.operations.clone());
        let operations = operations.unwrap_or_default();
        let requests = [
            Request::Configure,
            Request::Start,
            Request::Stop,
            Request::Cleanup,
            Request::Recover,
        ];
        let found = operations.iter().position(|one| one.name == name.text);
        let Some(operation) = found else {
            let request = requests.into_iter().find(|one| one.word() == name.text);
            let names = operations.iter().map(|one| one.name.as_str());
            let known = names.chain(requests.iter().map(|one| one.word())).collect();
            let request = self.known(request, name, "operation or request", known)?;
            self.cursor.expect(Token::CloseParen, "`)`")?;
            return Ok(Command::Request(component, request));
        };
        let arguments = operations.get(operation).map(|it| it.arguments.as_slice());
        let mut values = Vec::new();
        for (number, declared) in arguments.unwrap_or_default().iter().enumerate() {
            if number > 0 {
                self.cursor
                    .expect(Token::Comma, "`,` and the next argument")?;
            }
            let start = self.cursor.span().start;
            let data = self.data()?;
            match data.fitting(declared).map(|data| data.value()) {
                Ok(Some(value)) => values.push(value),
                Ok(None) => {
                    let at = self.cursor.since(start);
                    let cause = "an array cannot be an argument";
                    self.cursor.found.error(at, cause, "use single values");
                    return Err(Recorded);
                }
                Err(why) => {
                    let at = self.cursor.since(start);
                    let cause = format!("argument `{}`: {why}", declared.name);
                    self.cursor.found.error(at, cause, why.hint());
                    return Err(Recorded);
                }
            }
        }
        self.cursor.expect(Token::CloseParen, "`)`")?;
        Ok(Command::Call(component, operation, values))
    }

    /// A constant.
    fn data(&mut self) -> Parse<Data> {
        let is_negative = self.cursor.eat(Token::Minus);
        let text = self.cursor.slice().to_owned();
        let inner = |text: &str| {
            let mut chars = text.chars();
            chars.next();
            chars.next_back();
            chars.as_str().to_owned()
        };
        let token = self.cursor.token();
        if token == Token::Number {
            self.cursor.advance();
            let sign = if is_negative { "-" } else { "" };
            let signed = format!("{sign}{text}");
            if let Ok(value) = signed.parse() {
                return Ok(Data::Int(value));
            }
            return Ok(Data::Double(signed.parse().unwrap_or(f64::NAN)));
        }
        if is_negative {
            return Err(self.cursor.expected("a number", ""));
        }
        let data = match (token, text.as_str()) {
            (Token::Word, "true") => Data::Bool(true),
            (Token::Word, "false") => Data::Bool(false),
            (Token::Quoted | Token::Text, text) => Data::Text(inner(text)),
            (Token::OpenBracket, _) => {
                self.cursor.advance();
                let mut elements = Vec::new();
                while !self.cursor.is(Token::CloseBracket) {
                    // Arrays of arrays do not exist, and would nest as deep as the text is long.
                    if self.cursor.is(Token::OpenBracket) {
                        return Err(self.cursor.expected("a single value", ""));
                    }
                    elements.push(self.data()?);
                    if !self.cursor.eat(Token::Comma) {
                        break;
                    }
                }
                self.cursor.expect(Token::CloseBracket, "`,` or `]`")?;
                return Ok(Data::List(elements));
            }
            _ => {
                let expected = "a constant such as `2`, `true`, `'30deg'` or `[1, 2]`";
                return Err(self.cursor.expected(expected, ""));
            }
        };
        self.cursor.advance();
        Ok(data)
    }

    /// The thing of that name, or an error with the nearest name.
    fn known<T>(
        &mut self,
        found: Option<T>,
        name: &Name,
        kind: &str,
        known: Vec<&str>,
    ) -> Parse<T> {
        found.ok_or_else(|| {
            let hint = suggest(&name.text, known);
            let cause = format!("there is no {kind} `{}`", name.text);
            self.cursor.found.error(name.at.clone(), cause, hint);
            Recorded
        })
    }
}

/// A parameter of a machine from its text.
///
/// # Errors
/// Why the text is not a value of that type.
pub fn parameter(kind: Kind, text: &str) -> Result<Value, String> {
    let wrong = || {
        let shape = Shape { kind, len: None };
        format!("`{text}` is not a {shape}")
    };
    let parsed = match kind {
        Kind::Bool => text.parse().ok().map(Value::Bool),
        Kind::Int => text.parse().ok().map(Value::Int),
        Kind::Double => text
            .parse()
            .ok()
            .filter(|it: &f64| it.is_finite())
            .map(Value::Double),
        Kind::Text => None,
    };
    parsed.ok_or_else(wrong)
}

#[cfg(test)]
mod tests;
