//! The text of a value as JSON, for programs that read results. JSON is not read here.

use super::{Tree, TreeKind};

/// The JSON of a value's text: numbers, Booleans, lists and objects. Numbers that JSON does not have (`nan`, `+inf`) are
/// strings. `None` if the text is not a value.
pub fn to_json(text: &str) -> Option<String> {
    let mut json = String::new();
    Tree::parse(text).ok()?.write_json(&mut json);
    Some(json)
}

impl Tree<'_> {
    fn write_json(&self, out: &mut String) {
        match &self.kind {
            TreeKind::Atom(atom) => write_json_atom(atom, out),
            TreeKind::List(items) => {
                out.push('[');
                for (number, item) in items.iter().enumerate() {
                    out.push_str(if number > 0 { "," } else { "" });
                    item.write_json(out);
                }
                out.push(']');
            }
            TreeKind::Map(members) => {
                out.push('{');
                for (number, (name, member)) in members.iter().enumerate() {
                    out.push_str(if number > 0 { "," } else { "" });
                    write_json_string(name, out);
                    out.push(':');
                    member.write_json(out);
                }
                out.push('}');
            }
        }
    }
}

fn write_json_atom(atom: &str, out: &mut String) {
    match (atom, atom.parse::<i64>(), atom.parse::<f64>()) {
        ("true" | "false", ..) => out.push_str(atom),
        (_, Ok(number), _) => out.push_str(&number.to_string()),
        (.., Ok(number)) if number.is_finite() => out.push_str(&number.to_string()),
        _ => write_json_string(atom, out),
    }
}

fn write_json_string(text: &str, out: &mut String) {
    out.push('"');
    for c in text.chars() {
        match c {
            '"' | '\\' => out.extend(['\\', c]),
            c if c.is_control() => out.push_str(&format!("\\u{:04x}", u32::from(c))),
            c => out.push(c),
        }
    }
    out.push('"');
}

#[cfg(test)]
mod tests {
    use super::to_json;

    #[test]
    fn values_become_json_of_their_kind() {
        for (text, json) in [
            ("0.5", "0.5"),
            ("-42", "-42"),
            ("+1.", "1"),
            ("1e3", "1000"),
            ("9223372036854775807", "9223372036854775807"),
            ("true", "true"),
            ("nan", "\"nan\""),
            ("+inf", "\"+inf\""),
            ("[1, 2.50]", "[1,2.5]"),
            ("{pos:{x:1},rot:{}}", r#"{"pos":{"x":1},"rot":{}}"#),
        ] {
            let found = to_json(text);
            assert_eq!(found.as_deref(), Some(json), "{text}");
            let value: Result<serde_json::Value, _> = serde_json::from_str(json);
            assert!(value.is_ok(), "{json}");
        }
        assert_eq!(to_json("[1,"), None);
    }
}
