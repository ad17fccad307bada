//! The declaration of a component.
//!
//! ```text
//! file      = "component" name [ text ] "{" { item } "}" net
//! item      = "every" number ";"
//!           | "property" value { "default" constant | "live" | "doc" text } ";"
//!           | ( "in" | "out" ) value ";"
//!           | "operation" name "(" [ value { "," value } ] ")" [ "done" name ] [ "doc" text ] ";"
//! value     = name ":" kind [ "[" number "]" ] { "unit" text | "range" number ".." number | "doc" text }
//! kind      = "bool" | "int" | "double" | "string"
//! constant  = "true" | "false" | number | text | quoted | "[" constant { "," constant } "]"
//! ```

use takt_net::Quantity;

use super::configuration::Data;
use super::declaration::{
    ARRAY_MAX, Component, DECLARATIONS_MAX, Declared, EVERY_MAX, Operation, Port, Property,
};
use crate::diagnostic::{Diagnostics, suggest};
use crate::syntax::{Cursor, Parse, Token};
use crate::value::{Kind, Shape};

const ITEMS: [&str; 5] = ["every", "property", "in", "out", "operation"];

pub(super) fn parse(text: &str) -> (Option<Component>, Diagnostics) {
    let mut parser = Parser {
        at: Cursor::new(text),
    };
    let component = parser.component().ok();
    (component, parser.at.found)
}

struct Parser<'t> {
    at: Cursor<'t>,
}

impl Parser<'_> {
    fn component(&mut self) -> Parse<Component> {
        if !self.at.eat_word("component") {
            let hint = "a component file begins with `component Name { … }`; its net follows";
            return Err(self.at.expected("`component`", hint));
        }
        let name = self.at.name("the name of the component")?;
        let mut component = Component {
            name: name.text,
            doc: String::new(),
            every: 1,
            properties: Vec::new(),
            ports: Vec::new(),
            operations: Vec::new(),
            net: String::new(),
            net_start: 0,
        };
        if self.at.is(Token::Text) {
            component.doc = self.at.quoted("a text")?;
        }
        self.at.expect(Token::Open, "`{`")?;
        while !self.at.is(Token::Close) && !self.at.is(Token::End) {
            if self.at.found.is_full() {
                break;
            }
            if self.item(&mut component).is_err() {
                self.at.skip();
            }
        }
        let end = self.at.span().end;
        if !self.at.is(Token::Close) {
            return Err(self
                .at
                .expected("`}`", "the declaration ends with `}`; the net follows"));
        }
        component.net = self.at.text.get(end..).unwrap_or_default().to_owned();
        component.net_start = end;
        Ok(component)
    }

    fn item(&mut self, component: &mut Component) -> Parse<()> {
        let count = component.properties.len() + component.ports.len() + component.operations.len();
        if count >= DECLARATIONS_MAX {
            let cause = format!("at most {DECLARATIONS_MAX} declarations are allowed");
            self.at
                .found
                .error(self.at.span(), cause, "split the component");
        }
        let word = self.at.slice();
        match word {
            "every" => {
                self.at.advance();
                let at = self.at.span();
                let every = self.at.number("a number of cycles")?;
                if every.fract() != 0.0 || !(1.0..=f64::from(EVERY_MAX)).contains(&every) {
                    let cause = format!("a component is evaluated every 1 to {EVERY_MAX} cycles");
                    self.at.found.error(at, cause, "write `every 5;`");
                } else {
                    #[expect(
                        clippy::cast_possible_truncation,
                        clippy::cast_sign_loss,
                        reason = "a whole number within the bounds just checked"
                    )]
                    let every = every as u32;
                    component.every = every;
                }
            }
            "property" => {
                self.at.advance();
                let property = self.property()?;
                component.properties.push(property);
            }
            "in" | "out" => {
                self.at.advance();
                let declared = self.declared()?;
                component.ports.push(Port {
                    declared,
                    is_output: word == "out",
                });
            }
            "operation" => {
                self.at.advance();
                let operation = self.operation()?;
                component.operations.push(operation);
            }
            _ => {
                let hint = suggest(word, ITEMS);
                return Err(self.at.expected("a declaration", &hint));
            }
        }
        self.at.expect(Token::Semicolon, "`;`")
    }

    fn property(&mut self) -> Parse<Property> {
        let mut declared = self.declared()?;
        let (mut default, mut live) = (None, false);
        loop {
            if self.at.eat_word("default") {
                let at = self.at.span();
                let data = self.constant()?;
                match data.fitting(&declared) {
                    Ok(data) => default = Some(data),
                    Err(reason) => {
                        let cause = format!("default of `{}`: {reason}", declared.name);
                        let at = at.start..self.at.since(at.start).end;
                        self.at.found.error(at, cause, reason.hint());
                    }
                }
            } else if self.at.eat_word("live") {
                live = true;
            } else if self.at.eat_word("doc") {
                declared.doc = self.at.quoted("a text in double quotes")?;
            } else {
                break;
            }
        }
        Ok(Property {
            declared,
            default,
            live,
        })
    }

    fn operation(&mut self) -> Parse<Operation> {
        let name = self.at.name("the name of the operation")?;
        self.at.expect(Token::OpenParen, "`(`")?;
        let mut arguments = Vec::new();
        while !self.at.eat(Token::CloseParen) {
            arguments.push(self.declared()?);
            if !self.at.eat(Token::Comma) {
                self.at.expect(Token::CloseParen, "`,` or `)`")?;
                break;
            }
        }
        let (mut done, mut doc) = (None, String::new());
        loop {
            if self.at.eat_word("done") {
                done = Some(self.at.name("the name of a Boolean out port")?.text);
            } else if self.at.eat_word("doc") {
                doc = self.at.quoted("a text in double quotes")?;
            } else {
                break;
            }
        }
        Ok(Operation {
            name: name.text,
            arguments,
            done,
            doc,
            at: name.at,
        })
    }

    fn declared(&mut self) -> Parse<Declared> {
        let name = self.at.name("a name")?;
        self.at.expect(Token::Colon, "`:` and a type")?;
        let shape = self.shape()?;
        let mut declared = Declared {
            name: name.text,
            shape,
            quantity: Quantity::Any,
            range: None,
            doc: String::new(),
            at: name.at,
        };
        loop {
            if self.at.eat_word("unit") {
                let at = self.at.span();
                let unit = self.at.quoted("a unit such as \"rad/s\"")?;
                match Quantity::of_unit(&unit) {
                    Some(quantity) if shape.kind == Kind::Double => declared.quantity = quantity,
                    Some(_) => {
                        let hint = "only a `double` has a unit";
                        self.at
                            .found
                            .error(at, format!("a {shape} has no unit"), hint);
                    }
                    None => {
                        let cause = format!("`{unit}` is not an SI unit");
                        let hint = "units of declarations are SI, such as \"rad\", \"m/s\", \"s\", \"Nm\", or \"1\"; \
                                    values may have others";
                        self.at.found.error(at, cause, hint);
                    }
                }
            } else if self.at.eat_word("range") {
                let start = self.at.span().start;
                let low = self.at.number("the smallest value")?;
                self.at.expect(Token::To, "`..`")?;
                let high = self.at.number("the largest value")?;
                let at = self.at.since(start);
                if !matches!(shape.kind, Kind::Int | Kind::Double) {
                    let hint = "only an `int` or a `double` has a range";
                    self.at
                        .found
                        .error(at, format!("a {shape} has no range"), hint);
                } else if low > high {
                    let hint = "write the smaller one first";
                    self.at.found.error(at, "this range is empty", hint);
                } else {
                    declared.range = Some((low, high));
                }
            } else if self.at.eat_word("doc") {
                declared.doc = self.at.quoted("a text in double quotes")?;
            } else {
                break;
            }
        }
        Ok(declared)
    }

    fn shape(&mut self) -> Parse<Shape> {
        let word = self.at.slice();
        let Some(kind) = Kind::of(word).filter(|_| self.at.is(Token::Word)) else {
            let hint = suggest(word, ["bool", "int", "double", "string"]);
            return Err(self.at.expected("a type", &hint));
        };
        self.at.advance();
        let mut len = None;
        if self.at.eat(Token::OpenBracket) {
            let at = self.at.span();
            let text = self.at.slice();
            self.at.number("the number of elements")?;
            match text.parse::<u32>() {
                Ok(n) if (1..=ARRAY_MAX).contains(&n) && kind != Kind::Text => len = Some(n),
                _ => {
                    let cause = "this is not a size of an array".to_owned();
                    let hint =
                        format!("arrays have 1 to {ARRAY_MAX} elements; there are none of strings");
                    self.at.found.error(at, cause, hint);
                }
            }
            self.at.expect(Token::CloseBracket, "`]`")?;
        }
        Ok(Shape { kind, len })
    }

    fn constant(&mut self) -> Parse<Data> {
        if self.at.eat(Token::OpenBracket) {
            let mut elements = Vec::new();
            while !self.at.eat(Token::CloseBracket) {
                elements.push(self.single()?);
                if elements.len() > ARRAY_MAX as usize {
                    return Err(self.at.expected("`]`", "arrays have at most 1000 elements"));
                }
                if !self.at.eat(Token::Comma) {
                    self.at.expect(Token::CloseBracket, "`,` or `]`")?;
                    break;
                }
            }
            return Ok(Data::List(elements));
        }
        self.single()
    }

    fn single(&mut self) -> Parse<Data> {
        if self.at.eat_word("true") {
            return Ok(Data::Bool(true));
        }
        if self.at.eat_word("false") {
            return Ok(Data::Bool(false));
        }
        if self.at.is(Token::Text) {
            return Ok(Data::Text(self.at.quoted("a text")?));
        }
        if self.at.is(Token::Quoted) {
            let text = self.at.slice().trim_matches('\'').to_owned();
            self.at.advance();
            return Ok(Data::Text(text));
        }
        let start = self.at.span().start;
        let value = self
            .at
            .number("a value such as `0.5`, `true`, `'30deg'` or `[1, 2]`")?;
        let text = self.at.text.get(self.at.since(start)).unwrap_or_default();
        Ok(text
            .replace(' ', "")
            .parse()
            .map_or(Data::Double(value), Data::Int))
    }
}
