//! Message encoder, as existing clients expect it: no blanks, maps sorted by key, floats with 6 decimals. It checks
//! nothing; see [`Message::new`].

use std::fmt::{self, Display, Formatter, Write as _};

use super::{Message, Value, is_identifier};

impl Display for Message {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write!(f, "{}={}(", self.tag, self.command)?;
        separated(f, &self.args, |f, v| v.fmt(f))?;
        f.write_char(')')
    }
}

impl Display for Value {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::String(text) => quoted(f, text),
            Self::Integer(number) => write!(f, "{number}"),
            Self::Float(number) => write!(f, "{number:.6}"),
            Self::List(items) => {
                f.write_char('[')?;
                separated(f, items, |f, v| v.fmt(f))?;
                f.write_char(']')
            }
            Self::Map(items) => {
                f.write_char('{')?;
                separated(f, items, |f, (k, v)| {
                    key(f, k)?;
                    write!(f, ":{v}")
                })?;
                f.write_char('}')
            }
        }
    }
}

fn separated<T>(
    f: &mut Formatter<'_>,
    items: impl IntoIterator<Item = T>,
    write: impl Fn(&mut Formatter<'_>, T) -> fmt::Result,
) -> fmt::Result {
    for (number, item) in items.into_iter().enumerate() {
        if number > 0 {
            f.write_char(',')?;
        }
        write(f, item)?;
    }
    Ok(())
}

fn key(f: &mut Formatter<'_>, key: &str) -> fmt::Result {
    if is_identifier(key) {
        f.write_str(key)
    } else {
        quoted(f, key)
    }
}

fn quoted(f: &mut Formatter<'_>, text: &str) -> fmt::Result {
    f.write_char('"')?;
    for part in text.split_inclusive(['"', '\\']) {
        match part.strip_suffix(['"', '\\']) {
            None => f.write_str(part)?,
            Some(plain) => {
                f.write_str(plain)?;
                f.write_char('\\')?;
                f.write_str(&part[plain.len()..])?;
            }
        }
    }
    f.write_char('"')
}
