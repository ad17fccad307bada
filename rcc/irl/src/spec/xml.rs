//! The XML form of a system specification: the entries of the TOML form, with simple ones as attributes. It is read into the same
//! tables, so that both forms have the same checks.

use quick_xml::events::{BytesStart, Event};
use quick_xml::{Reader, XmlVersion};
use toml::{Table, Value};

/// Most elements of a specification: robots, their joints and frames, signals.
const ELEMENTS_MAX: usize = 1024;
/// Numbers of a frame.
const FRAME: [&str; 6] = ["x", "y", "z", "a", "b", "c"];

/// Whether a text is XML.
pub(super) fn is_xml(text: &str) -> bool {
    text.trim_start_matches('\u{feff}')
        .trim_start()
        .starts_with('<')
}

/// The tables of the TOML form.
pub(super) fn read(text: &str) -> Result<Table, String> {
    let mut reader = Reader::from_str(text);
    reader.config_mut().expand_empty_elements = true;
    let mut form = Form::default();
    loop {
        let at = reader.buffer_position();
        let line = |at: u64| {
            let before = text.get(..usize::try_from(at).unwrap_or(0));
            before.unwrap_or(text).matches('\n').count() + 1
        };
        let located = |why: String| format!("line {}: {why}", line(at));
        match reader.read_event() {
            Ok(Event::Eof) => break,
            Ok(Event::Start(start) | Event::Empty(start)) => {
                form.begin(&start).map_err(located)?;
            }
            Ok(Event::End(_)) => form.end(),
            Ok(Event::Text(more)) if !more.xml10_content().trim().is_empty() => {
                return Err(located("text outside of attributes".to_owned()));
            }
            Ok(Event::CData(_) | Event::GeneralRef(_)) => {
                return Err(located("text outside of attributes".to_owned()));
            }
            Ok(Event::DocType(kind)) if kind.contains('[') => {
                let why = "a document type with definitions is not accepted";
                return Err(located(why.to_owned()));
            }
            Ok(
                Event::Text(_)
                | Event::DocType(_)
                | Event::Comment(_)
                | Event::Decl(_)
                | Event::PI(_),
            ) => {}
            Err(error) => {
                let at = reader.error_position();
                return Err(format!("line {}: malformed XML: {error}", line(at)));
            }
        }
    }
    if !form.open.is_empty() || !form.has_begun {
        return Err("the specification is not one closed element `<system>`".to_owned());
    }
    Ok(form.system)
}

/// What was read.
#[derive(Default)]
struct Form {
    system: Table,
    /// Names of the open elements.
    open: Vec<String>,
    has_begun: bool,
    elements: usize,
}

impl Form {
    fn begin(&mut self, start: &BytesStart<'_>) -> Result<(), String> {
        self.elements += 1;
        if self.elements > ELEMENTS_MAX {
            return Err(format!("more than {ELEMENTS_MAX} elements"));
        }
        let name = start.local_name().as_ref().to_owned();
        let values = attributes(start)?;
        let inside: Vec<&str> = self.open.iter().map(String::as_str).collect();
        match (inside.as_slice(), name.as_str()) {
            ([], "system") if !self.has_begun && values.is_empty() => self.has_begun = true,
            (["system"], "robot" | "signal") => list(&mut self.system, &name)?.push(values.into()),
            (["system", "robot"], "joint") => {
                list(self.robot()?, "joints")?.push(values.into());
            }
            (["system", "robot"], "base" | "tool") => {
                let frame = frame(values)?;
                self.add(&name, frame)?;
            }
            (["system", "robot"], "home") => {
                let home = home(values)?;
                self.add("home", home)?;
            }
            _ => {
                let name: String = name.chars().take(40).collect();
                let inside = inside.last().unwrap_or(&"the document");
                return Err(format!(
                    "`<{name}>` is not allowed inside {inside}: `<system>` has `<robot>` and `<signal>`, a robot `<joint>`, \
                     `<base>`, `<tool>` and `<home>`"
                ));
            }
        }
        self.open.push(name);
        Ok(())
    }

    fn end(&mut self) {
        self.open.pop();
    }

    /// The robot that is being read.
    fn robot(&mut self) -> Result<&mut Table, String> {
        let robot = list(&mut self.system, "robot")?.last_mut();
        let robot = robot.and_then(Value::as_table_mut);
        robot.ok_or_else(|| "there is no robot".to_owned())
    }

    fn add(&mut self, name: &str, values: Vec<Value>) -> Result<(), String> {
        let known = self.robot()?.insert(name.to_owned(), Value::Array(values));
        match known {
            Some(_) => Err(format!("`<{name}>` is given twice")),
            None => Ok(()),
        }
    }
}

/// The list of that name in a table.
fn list<'t>(table: &'t mut Table, name: &str) -> Result<&'t mut Vec<Value>, String> {
    let list = table
        .entry(name)
        .or_insert_with(|| Value::Array(Vec::new()));
    let list = list.as_array_mut();
    list.ok_or_else(|| format!("attribute `{name}` is not allowed here"))
}

/// Attributes; those that are no names are numbers.
fn attributes(start: &BytesStart<'_>) -> Result<Table, String> {
    let mut table = Table::new();
    for attribute in start.attributes() {
        let attribute = attribute.map_err(|error| error.to_string())?;
        let key = attribute.key.as_ref().to_owned();
        let text = attribute.normalized_value(XmlVersion::Implicit1_0);
        let text = text.map_err(|error| error.to_string())?;
        let is_text =
            ["name", "model", "direction", "kind", "positions", "io"].contains(&key.as_str());
        let value = if is_text {
            Value::String(text.into_owned())
        } else {
            number(&text)
                .ok_or_else(|| format!("`{key}` is no number: `{}`", text.escape_debug()))?
        };
        table.insert(key, value);
    }
    Ok(table)
}

fn number(text: &str) -> Option<Value> {
    let text = text.trim();
    let whole = text.parse::<i64>().ok().map(Value::Integer);
    whole.or_else(|| text.parse::<f64>().ok().map(Value::Float))
}

/// Six numbers; those that are not given are 0.
fn frame(mut values: Table) -> Result<Vec<Value>, String> {
    let zero = || Value::Integer(0);
    let numbers = FRAME.map(|name| values.remove(name).unwrap_or_else(zero));
    match values.keys().next() {
        Some(key) => Err(format!("a frame has x, y, z, a, b and c, not `{key}`")),
        None => Ok(numbers.to_vec()),
    }
}

fn home(mut values: Table) -> Result<Vec<Value>, String> {
    let positions = values.remove("positions");
    let (Some(Value::String(text)), true) = (positions, values.is_empty()) else {
        return Err("`<home>` has one attribute, `positions`".to_owned());
    };
    let numbers = text.split_whitespace().map(number).collect::<Option<_>>();
    numbers.ok_or_else(|| "the positions of `<home>` are numbers with spaces between".to_owned())
}
