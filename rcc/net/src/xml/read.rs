//! XML to net text, in one pass. An element is written when it ends; nothing is resolved.

use std::borrow::Cow;

use quick_xml::events::{BytesStart, Event};
use quick_xml::{Reader, XmlVersion};

use super::{ROOT, XmlFault, XmlFaultKind};
use crate::limits::Limits;

/// Upper bound on the attributes of one element.
const ATTRIBUTES_MAX: usize = 16;

type Read<T> = Result<T, XmlFaultKind>;

/// Converts the XML form of a net to net text.
pub fn from_xml(xml: &str, limits: &Limits) -> Result<String, XmlFault> {
    if xml.len() > limits.text_bytes {
        let (item, found, bound) = ("bytes of XML", xml.len(), limits.text_bytes);
        let kind = XmlFaultKind::Bound { item, found, bound };
        return Err(XmlFault { line: 1, kind });
    }
    let mut reader = Reader::from_str(xml);
    reader.config_mut().expand_empty_elements = true;
    let mut net = Net {
        open: Vec::new(),
        text: None,
        depth: limits.depth,
    };
    loop {
        let handled = match reader.read_event() {
            Ok(Event::Eof) => break,
            Ok(event) => net.handle(event),
            Err(error) => Err(XmlFaultKind::Malformed(error.to_string())),
        };
        handled.map_err(|kind| fault(xml, reader.buffer_position(), kind))?;
    }
    let missing = || fault(xml, xml.len() as u64, XmlFaultKind::NoNet);
    net.text.ok_or_else(missing)
}

fn fault(xml: &str, at: u64, kind: XmlFaultKind) -> XmlFault {
    let at = usize::try_from(at).unwrap_or(xml.len()).min(xml.len());
    let before = &xml.as_bytes()[..at];
    let line = before.iter().filter(|b| **b == b'\n').count() + 1;
    XmlFault { line, kind }
}

/// An open element, with the net text of its content so far.
enum Open {
    Net {
        items: String,
    },
    Module {
        head: String,
        args: String,
    },
    Fragment(Fragment),
    /// A parameter or port; its text is already written.
    Leaf,
}

struct Fragment {
    id: String,
    items: String,
    args: String,
}

impl Open {
    const fn name(&self) -> &'static str {
        match self {
            Self::Net { .. } => "`<rpinet>`",
            Self::Module { .. } => "`<module>`",
            Self::Fragment(_) => "`<fragment>`",
            Self::Leaf => "a parameter or port",
        }
    }
}

struct Net {
    open: Vec<Open>,
    text: Option<String>,
    /// Upper bound on nested fragments.
    depth: usize,
}

impl Net {
    fn handle(&mut self, event: Event<'_>) -> Read<()> {
        match event {
            Event::Start(start) | Event::Empty(start) => self.begin(&start),
            Event::End(_) => {
                self.end();
                Ok(())
            }
            Event::DocType(_) => Err(XmlFaultKind::DocumentType),
            Event::Text(_)
            | Event::CData(_)
            | Event::Comment(_)
            | Event::Decl(_)
            | Event::PI(_)
            | Event::GeneralRef(_)
            | Event::Eof => Ok(()),
        }
    }

    fn begin(&mut self, start: &BytesStart<'_>) -> Read<()> {
        let attributes = Attributes::read(start)?;
        let name = start.local_name().as_ref().to_ascii_lowercase();
        let (enclosing, around) = (self.fragment(0), self.fragment(1));
        let open = match (self.open.last_mut(), name.as_str()) {
            (None, "rpinet") if self.text.is_none() => Open::Net {
                items: String::new(),
            },
            (Some(Open::Net { .. } | Open::Fragment(_)), "module") => {
                let (id, ty) = (attributes.id("module")?, attributes.name("module", "type")?);
                let (head, args) = (format!("{id}={ty}"), String::new());
                Open::Module { head, args }
            }
            (Some(Open::Net { .. } | Open::Fragment(_)), "fragment") => {
                let id = attributes.id("fragment")?.into_owned();
                let (items, args) = (String::new(), String::new());
                Open::Fragment(Fragment { id, items, args })
            }
            (Some(Open::Net { items } | Open::Fragment(Fragment { items, .. })), "outport") => {
                separate(items, &attributes.link("outport", &enclosing)?);
                Open::Leaf
            }
            (Some(Open::Module { args, .. }), "port") => {
                separate(args, &attributes.link("port", &enclosing)?);
                Open::Leaf
            }
            (Some(Open::Fragment(Fragment { args, .. })), "inport") => {
                // An in port is fed from outside its fragment.
                separate(args, &attributes.link("inport", &around)?);
                Open::Leaf
            }
            (
                Some(Open::Module { args, .. } | Open::Fragment(Fragment { args, .. })),
                "parameter",
            ) => {
                separate(args, &attributes.parameter()?);
                Open::Leaf
            }
            (inside, _) => {
                let inside = inside.map_or("the document", |open| open.name());
                let element = shorten(&name);
                return Err(XmlFaultKind::Element { element, inside });
            }
        };
        self.push(open)
    }

    fn push(&mut self, open: Open) -> Read<()> {
        // Besides fragments, the net, a module and a port can be open.
        let bound = self.depth;
        if self.open.len() >= bound + 3 {
            let (item, found) = ("fragments inside one another", bound + 1);
            return Err(XmlFaultKind::Bound { item, found, bound });
        }
        self.open.push(open);
        Ok(())
    }

    fn end(&mut self) {
        let item = match self.open.pop() {
            Some(Open::Net { items }) => {
                self.text = Some(format!("{{{items}}}"));
                return;
            }
            Some(Open::Module { head, args }) => format!("{head}({args})"),
            Some(Open::Fragment(Fragment { id, items, args })) => {
                format!("{id}={{{items}}}({args})")
            }
            Some(Open::Leaf) | None => return,
        };
        if let Some(Open::Net { items } | Open::Fragment(Fragment { items, .. })) =
            self.open.last_mut()
        {
            separate(items, &item);
        }
    }

    /// The name of the open fragment, or of the one that is `outwards` levels around it.
    fn fragment(&self, outwards: usize) -> String {
        self.fragments().nth(outwards).unwrap_or(ROOT).to_owned()
    }

    /// The names of the open fragments, the innermost first.
    fn fragments(&self) -> impl Iterator<Item = &str> {
        self.open.iter().rev().filter_map(|open| match open {
            Open::Fragment(fragment) => Some(fragment.id.as_str()),
            Open::Net { .. } | Open::Module { .. } | Open::Leaf => None,
        })
    }
}

/// Appends an item to a list.
fn separate(list: &mut String, item: &str) {
    if !list.is_empty() {
        list.push(',');
    }
    list.push_str(item);
}

/// The attributes used in nets.
#[derive(Default)]
struct Attributes<'a> {
    id: Option<Cow<'a, str>>,
    ty: Option<Cow<'a, str>>,
    name: Option<Cow<'a, str>>,
    value: Option<Cow<'a, str>>,
    from_module: Option<Cow<'a, str>>,
    from_port: Option<Cow<'a, str>>,
    debug: Option<Cow<'a, str>>,
}

impl<'a> Attributes<'a> {
    fn read(start: &'a BytesStart<'_>) -> Read<Self> {
        let mut found = Self::default();
        for (number, attribute) in start.attributes().enumerate() {
            if number == ATTRIBUTES_MAX {
                let (item, bound) = ("attributes of one element", ATTRIBUTES_MAX);
                let found = bound + 1;
                return Err(XmlFaultKind::Bound { item, found, bound });
            }
            let malformed = |e: &dyn std::fmt::Display| XmlFaultKind::Malformed(e.to_string());
            let attribute = attribute.map_err(|e| malformed(&e))?;
            let slot = match attribute.key.as_ref().to_ascii_lowercase().as_str() {
                "id" => &mut found.id,
                "type" => &mut found.ty,
                "name" => &mut found.name,
                "value" => &mut found.value,
                "frommodule" => &mut found.from_module,
                "fromport" => &mut found.from_port,
                "debug" => &mut found.debug,
                _ => continue,
            };
            let value = attribute.normalized_value(XmlVersion::Implicit1_0);
            *slot = Some(value.map_err(|e| malformed(&e))?);
        }
        Ok(found)
    }

    fn get(&self, element: &'static str, attribute: &'static str) -> Read<&str> {
        let value = match attribute {
            "id" => &self.id,
            "type" => &self.ty,
            "name" => &self.name,
            "value" => &self.value,
            "frommodule" => &self.from_module,
            _ => &self.from_port,
        };
        let missing = XmlFaultKind::Missing { element, attribute };
        value.as_deref().ok_or(missing)
    }

    fn name(&self, element: &'static str, attribute: &'static str) -> Read<&str> {
        let text = self.get(element, attribute)?;
        if is_name(text) {
            return Ok(text);
        }
        Err(XmlFaultKind::Value {
            attribute,
            value: shorten(text),
            wanted: "a name of letters, digits, `:` and `_`",
        })
    }

    fn id(&self, element: &'static str) -> Read<Cow<'_, str>> {
        self.module(element, "id")
    }

    /// The name of a module. Unnamed primitives got names with dots, which net text does not allow.
    fn module(&self, element: &'static str, attribute: &'static str) -> Read<Cow<'_, str>> {
        let text = self.get(element, attribute)?;
        if !text.contains('.') {
            return self.name(element, attribute).map(Cow::Borrowed);
        }
        let text = text.replace('.', "_");
        if is_name(&text) {
            return Ok(Cow::Owned(text));
        }
        Err(XmlFaultKind::Value {
            attribute,
            value: shorten(&text),
            wanted: "a name of letters, digits, `:`, `_` and dots",
        })
    }

    fn link(&self, element: &'static str, enclosing: &str) -> Read<String> {
        let (name, port) = (self.name(element, "name")?, self.name(element, "fromport")?);
        let debug = self.debug()?;
        let module = self.module(element, "frommodule")?;
        let module = if module == enclosing {
            "parent"
        } else {
            &module
        };
        Ok(format!("{name}{debug}={module}.{port}"))
    }

    fn debug(&self) -> Read<String> {
        let Some(text) = self.debug.as_deref().filter(|text| !text.is_empty()) else {
            return Ok(String::new());
        };
        let plain = text.bytes().all(|b| b.is_ascii_digit() || b == b'.');
        if plain && text.parse::<f64>().is_ok() {
            return Ok(format!("[{text}]"));
        }
        Err(XmlFaultKind::Value {
            attribute: "debug",
            value: shorten(text),
            wanted: "a number of seconds such as 2.0",
        })
    }

    fn parameter(&self) -> Read<String> {
        let name = self.name("parameter", "name")?;
        let value = self.get("parameter", "value")?;
        let mut out = format!("{name}='");
        for c in value.chars() {
            if matches!(c, '\'' | '\\') {
                out.push('\\');
            }
            out.push(c);
        }
        out.push('\'');
        Ok(out)
    }
}

fn is_name(text: &str) -> bool {
    let belongs = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b':' | b'_');
    !text.is_empty() && text.bytes().all(belongs)
}

/// A text, truncated for a message.
fn shorten(text: &str) -> String {
    text.chars().take(60).collect()
}
