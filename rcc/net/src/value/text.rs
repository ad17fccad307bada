//! The text form of values: parameters, netcomm values and evaluation results. Numbers are written
//! in the shortest form that reads back exactly. Net text and messages are elsewhere.
//!
//! `true`, `42`, `0.5`, `nan`, `+inf`, `-inf`, `[a,b]`, `{x:0,y:0,z:0}` (Vector), `{a:0,b:0,c:0}`
//! (Rotation: Z-Y-X Euler angles, rad), `{pos:{..},rot:{..}}` (Frame), `{vel:{..},rot:{..}}`
//! (Twist), `{force:{..},torque:{..}}` (Wrench). Omitted members are zero.

mod json;

use std::fmt::Write as _;
use std::ops::Range;

use crate::value::unit::{self, Dimension, Quantity};
use crate::value::{Frame, Nanos, Rotation, Twist, Type, Value, Vector, Wrench};
pub use json::to_json;

/// Why a text is not a value of the expected type, and where in the text.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct ValueError {
    /// The cause.
    pub message: String,
    /// The bytes of the text that it refers to.
    pub at: Range<usize>,
}

/// Upper bound on the nesting of lists and maps; values need less.
const DEPTH: usize = 8;

/// A value that can be read from and written as text.
pub trait TextValue: Value {
    /// Appends the text form.
    fn format(self, out: &mut String);

    /// Reads the value from a syntax tree. Units are those of the quantity.
    ///
    /// # Errors
    /// If the tree does not have this type's structure.
    #[doc(hidden)]
    fn from_tree(tree: &Tree<'_>, quantity: Quantity) -> Result<Self, ValueError>;

    /// Reads the value from text without units.
    ///
    /// # Errors
    /// If the text is not a value of this type, with the location.
    fn parse(text: &str) -> Result<Self, ValueError> {
        Self::parse_as(text, Quantity::Number)
    }

    /// Reads the value from text whose numbers may have units of the quantity.
    ///
    /// # Errors
    /// If the text is not a value of this type and quantity, with the location.
    fn parse_as(text: &str, quantity: Quantity) -> Result<Self, ValueError> {
        Self::from_tree(&Tree::parse(text)?, quantity)
    }
}

/// Reads a fixed array such as `[1,2,3]`.
///
/// # Errors
/// If the text is not a list of values of this type, or has more than `most` elements.
pub fn parse_array<T: TextValue>(text: &str, most: usize) -> Result<Vec<T>, ValueError> {
    parse_array_as(text, most, Quantity::Number)
}

/// Reads a fixed array whose numbers may have units of the quantity, such as `[30deg,1]`.
///
/// # Errors
/// If the text is not a list of such values, or has more than `most` elements.
pub fn parse_array_as<T: TextValue>(
    text: &str,
    most: usize,
    quantity: Quantity,
) -> Result<Vec<T>, ValueError> {
    let tree = Tree::parse(text)?;
    let TreeKind::List(items) = &tree.kind else {
        return Err(tree.mismatch(&format!("a list of {}", T::ELEMENT.name())));
    };
    if items.len() > most {
        let message = format!("has {} elements; at most {most} are allowed", items.len());
        let at = tree.at;
        return Err(ValueError { message, at });
    }
    let item = |tree| T::from_tree(tree, quantity);
    items.iter().map(item).collect()
}

/// Writes values as `[a,b,c]`.
pub fn format_array<T: TextValue>(values: impl IntoIterator<Item = T>, out: &mut String) {
    out.push('[');
    for (i, value) in values.into_iter().enumerate() {
        if i > 0 {
            out.push(',');
        }
        value.format(out);
    }
    out.push(']');
}

/// Formats the value in `words`, laid out as by [`Value::put`].
pub(crate) fn format_words(ty: Type, words: &[u64], out: &mut String) {
    fn one<T: TextValue>(words: &[u64]) -> T {
        T::take(|i| words.get(i).copied().unwrap_or(0))
    }
    crate::slots::for_element!(ty.element, T => if ty.array {
        format_array(words.chunks_exact(T::WORDS).map(one::<T>), out);
    } else {
        one::<T>(words).format(out);
    });
}

/// Parses a value of `ty` into `words`; an array must have exactly the length that fills them.
pub(crate) fn parse_words(ty: Type, text: &str, words: &mut [u64]) -> Result<(), ValueError> {
    crate::slots::for_element!(ty.element, T => {
        let values = if ty.array {
            parse_array::<T>(text, words.len())?
        } else {
            vec![T::parse(text)?]
        };
        if values.len() * T::WORDS != words.len() {
            let wanted = words.len() / T::WORDS;
            let message = format!("has {} elements, the port carries {wanted}", values.len());
            return Err(ValueError { message, at: 0..text.len() });
        }
        for (value, chunk) in values.into_iter().zip(words.chunks_exact_mut(T::WORDS)) {
            value.put(|i, w| chunk[i] = w);
        }
    });
    Ok(())
}

/// The syntax of a value, before its type is known.
#[derive(Debug)]
pub struct Tree<'a> {
    kind: TreeKind<'a>,
    at: Range<usize>,
}

#[derive(Debug)]
enum TreeKind<'a> {
    Atom(&'a str),
    List(Vec<Tree<'a>>),
    Map(Vec<(&'a str, Tree<'a>)>),
}

impl<'a> Tree<'a> {
    fn parse(text: &'a str) -> Result<Self, ValueError> {
        let mut reader = Reader { text, at: 0 };
        let tree = reader.tree(DEPTH)?;
        reader.skip_blank();
        if reader.at < text.len() {
            let rest: String = text[reader.at..].chars().take(20).collect();
            return Err(reader.error(&format!("the value ends before `{rest}`")));
        }
        Ok(tree)
    }

    fn mismatch(&self, wanted: &str) -> ValueError {
        let this = match self.kind {
            TreeKind::Atom(text) if text.chars().count() <= 40 => format!("`{text}`"),
            TreeKind::Atom(_) | TreeKind::List(_) | TreeKind::Map(_) => "this".to_owned(),
        };
        ValueError {
            message: format!("{this} is not {wanted}"),
            at: self.at.clone(),
        }
    }

    fn atom(&self, wanted: &str) -> Result<&'a str, ValueError> {
        match self.kind {
            TreeKind::Atom(text) => Ok(text),
            TreeKind::List(_) | TreeKind::Map(_) => Err(self.mismatch(wanted)),
        }
    }

    /// The members of a map in the order of `names`; omitted ones are `None`.
    fn members<const N: usize>(
        &self,
        names: [&str; N],
        wanted: &str,
    ) -> Result<[Option<&Self>; N], ValueError> {
        let TreeKind::Map(entries) = &self.kind else {
            return Err(self.mismatch(wanted));
        };
        let mut found = [None; N];
        for (key, tree) in entries {
            match names.iter().position(|name| name == key) {
                Some(i) if found[i].is_none() => found[i] = Some(tree),
                Some(_) => {
                    let message = format!("`{key}` is given twice");
                    let at = tree.at.clone();
                    return Err(ValueError { message, at });
                }
                None => {
                    let known = names.join("`, `");
                    let message = format!("{wanted} has no member `{key}`, only `{known}`");
                    return Err(ValueError {
                        message,
                        at: tree.at.clone(),
                    });
                }
            }
        }
        Ok(found)
    }
}

struct Reader<'a> {
    text: &'a str,
    at: usize,
}

impl<'a> Reader<'a> {
    fn skip_blank(&mut self) {
        let rest = self.text[self.at..].trim_start();
        self.at = self.text.len() - rest.len();
    }

    fn peek(&mut self) -> Option<char> {
        self.skip_blank();
        self.text[self.at..].chars().next()
    }

    fn error(&self, message: &str) -> ValueError {
        ValueError {
            message: message.to_owned(),
            at: self.at..self.text.len().max(self.at),
        }
    }

    fn tree(&mut self, depth: usize) -> Result<Tree<'a>, ValueError> {
        if depth == 0 {
            return Err(self.error("nested too deeply"));
        }
        let first = self.peek();
        let start = self.at;
        let kind = match first {
            Some('[') => TreeKind::List(self.items('[', ']', |r| r.tree(depth - 1))?),
            Some('{') => TreeKind::Map(self.items('{', '}', |r| r.member(depth - 1))?),
            _ => TreeKind::Atom(self.word()?),
        };
        Ok(Tree {
            kind,
            at: start..self.at,
        })
    }

    fn items<T>(
        &mut self,
        open: char,
        close: char,
        mut item: impl FnMut(&mut Self) -> Result<T, ValueError>,
    ) -> Result<Vec<T>, ValueError> {
        self.at += open.len_utf8();
        let mut items = Vec::new();
        if self.peek() == Some(close) {
            self.at += 1;
            return Ok(items);
        }
        loop {
            items.push(item(self)?);
            match self.peek() {
                Some(',') => self.at += 1,
                Some(c) if c == close => {
                    self.at += 1;
                    return Ok(items);
                }
                _ => return Err(self.error(&format!("`,` or `{close}` is missing here"))),
            }
        }
    }

    fn member(&mut self, depth: usize) -> Result<(&'a str, Tree<'a>), ValueError> {
        let key = self.word()?;
        if self.peek() != Some(':') {
            return Err(self.error(&format!("`:` is missing after `{key}`")));
        }
        self.at += 1;
        Ok((key, self.tree(depth)?))
    }

    fn word(&mut self) -> Result<&'a str, ValueError> {
        self.skip_blank();
        let rest = &self.text[self.at..];
        let end = rest
            .find(['[', ']', '{', '}', ',', ':'])
            .unwrap_or(rest.len());
        let word = rest[..end].trim_end();
        if word.is_empty() {
            return Err(self.error("a value is missing here"));
        }
        self.at += word.len();
        Ok(word)
    }
}

impl TextValue for bool {
    fn format(self, out: &mut String) {
        out.push_str(if self { "true" } else { "false" });
    }

    fn from_tree(tree: &Tree<'_>, _: Quantity) -> Result<Self, ValueError> {
        match tree.atom("`true` or `false`")? {
            "true" => Ok(true),
            "false" => Ok(false),
            _ => Err(tree.mismatch("`true` or `false`")),
        }
    }
}

impl TextValue for i32 {
    fn format(self, out: &mut String) {
        write!(out, "{self}").expect("writing to a String cannot fail");
    }

    fn from_tree(tree: &Tree<'_>, _: Quantity) -> Result<Self, ValueError> {
        let wanted = "a whole number of 32 bits";
        tree.atom(wanted)?
            .parse()
            .map_err(|_| tree.mismatch(wanted))
    }
}

impl TextValue for Nanos {
    fn format(self, out: &mut String) {
        write!(out, "{}", self.0).expect("writing to a String cannot fail");
    }

    fn from_tree(tree: &Tree<'_>, _: Quantity) -> Result<Self, ValueError> {
        let wanted = "a whole number of nanoseconds";
        tree.atom(wanted)?
            .parse()
            .map(Self)
            .map_err(|_| tree.mismatch(wanted))
    }
}

impl TextValue for f64 {
    fn format(self, out: &mut String) {
        let magnitude = self.abs();
        let written = if self.is_nan() {
            out.push_str("nan");
            Ok(())
        } else if self.is_infinite() {
            out.push_str(if self > 0.0 { "+inf" } else { "-inf" });
            Ok(())
        } else if magnitude != 0.0 && !(1e-5..1e16).contains(&magnitude) {
            write!(out, "{self:e}")
        } else {
            write!(out, "{self}")
        };
        written.expect("writing to a String cannot fail");
    }

    fn from_tree(tree: &Tree<'_>, quantity: Quantity) -> Result<Self, ValueError> {
        match tree.atom("a number")? {
            "nan" => Ok(Self::NAN),
            "inf" | "+inf" => Ok(Self::INFINITY),
            "-inf" => Ok(Self::NEG_INFINITY),
            text => number(text)
                .map_or_else(|| unit::parse(text, quantity), Ok)
                .map_err(|message| match message {
                    Some(message) => ValueError {
                        message,
                        at: tree.at.clone(),
                    },
                    None => tree.mismatch("a number"),
                }),
        }
    }
}

/// A number without unit. `f64::from_str` also accepts words such as `infinity`, which are not part of
/// this text form.
fn number(text: &str) -> Option<f64> {
    let is_number = text.ends_with(|c: char| c.is_ascii_digit() || c == '.');
    text.parse().ok().filter(|_| is_number)
}

fn member_or_zero<T: TextValue>(
    tree: Option<&Tree<'_>>,
    quantity: Quantity,
) -> Result<T, ValueError> {
    tree.map_or_else(|| Ok(T::default()), |tree| T::from_tree(tree, quantity))
}

fn format_map<T: TextValue>(members: &[(&str, T)], out: &mut String) {
    out.push('{');
    for (i, (key, value)) in members.iter().enumerate() {
        if i > 0 {
            out.push(',');
        }
        out.push_str(key);
        out.push(':');
        value.format(out);
    }
    out.push('}');
}

impl TextValue for Vector {
    fn format(self, out: &mut String) {
        format_map(&[("x", self.x), ("y", self.y), ("z", self.z)], out);
    }

    fn from_tree(tree: &Tree<'_>, quantity: Quantity) -> Result<Self, ValueError> {
        let [x, y, z] = tree.members(["x", "y", "z"], "a Vector")?;
        Ok(Self::new(
            member_or_zero(x, quantity)?,
            member_or_zero(y, quantity)?,
            member_or_zero(z, quantity)?,
        ))
    }
}

impl TextValue for Rotation {
    fn format(self, out: &mut String) {
        let (c, b, a) = self.euler_angles();
        format_map(&[("a", a), ("b", b), ("c", c)], out);
    }

    fn from_tree(tree: &Tree<'_>, quantity: Quantity) -> Result<Self, ValueError> {
        let [a, b, c] = tree.members(["a", "b", "c"], "a Rotation")?;
        let angle = |tree| member_or_zero(tree, quantity.part(Dimension::ANGLE));
        Ok(Self::from_euler_angles(angle(c)?, angle(b)?, angle(a)?))
    }
}

impl TextValue for Frame {
    fn format(self, out: &mut String) {
        out.push_str("{pos:");
        self.translation.vector.format(out);
        out.push_str(",rot:");
        self.rotation.format(out);
        out.push('}');
    }

    fn from_tree(tree: &Tree<'_>, quantity: Quantity) -> Result<Self, ValueError> {
        let [pos, rot] = tree.members(["pos", "rot"], "a Frame")?;
        let pos: Vector = member_or_zero(pos, quantity.part(Dimension::LENGTH))?;
        Ok(Self::from_parts(pos.into(), member_or_zero(rot, quantity)?))
    }
}

impl TextValue for Twist {
    fn format(self, out: &mut String) {
        format_map(&[("vel", self.vel), ("rot", self.rot)], out);
    }

    fn from_tree(tree: &Tree<'_>, quantity: Quantity) -> Result<Self, ValueError> {
        let [vel, rot] = tree.members(["vel", "rot"], "a Twist")?;
        Ok(Self {
            vel: member_or_zero(vel, quantity.part(Dimension::VELOCITY))?,
            rot: member_or_zero(rot, quantity.part(Dimension::ROTATION))?,
        })
    }
}

impl TextValue for Wrench {
    fn format(self, out: &mut String) {
        format_map(&[("force", self.force), ("torque", self.torque)], out);
    }

    fn from_tree(tree: &Tree<'_>, quantity: Quantity) -> Result<Self, ValueError> {
        let [force, torque] = tree.members(["force", "torque"], "a Wrench")?;
        Ok(Self {
            // Wrenches are also stiffness and damping.
            force: member_or_zero(force, quantity)?,
            torque: member_or_zero(torque, quantity)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn text<T: TextValue>(value: T) -> String {
        let mut out = String::new();
        value.format(&mut out);
        out
    }

    #[test]
    fn numbers_take_their_shortest_form() {
        assert_eq!(text(2.0), "2");
        assert_eq!(text(0.1), "0.1");
        assert_eq!(text(-1e-7), "-1e-7");
        assert_eq!(text(1e300), "1e300");
        assert_eq!(text(f64::INFINITY), "+inf");
        assert_eq!(text(f64::NAN), "nan");
        assert_eq!(text(-0.0), "-0");
    }

    #[test]
    fn composed_values() {
        let frame = Frame::parse("{pos:{x:1,y:-2.5},rot:{a:0.5}}").unwrap();
        assert_eq!(frame.translation.vector, Vector::new(1.0, -2.5, 0.0));
        assert_eq!(
            text(Twist {
                vel: Vector::new(1.0, 0.0, 0.5),
                rot: Vector::zeros()
            }),
            "{vel:{x:1,y:0,z:0.5},rot:{x:0,y:0,z:0}}"
        );
        assert_eq!(
            parse_array::<f64>("[ 1 , 2.5,-3]", 9).unwrap(),
            [1.0, 2.5, -3.0]
        );
        assert_eq!(parse_array::<bool>("[]", 9).unwrap(), [] as [bool; 0]);
    }

    #[test]
    fn euler_angles_are_z_y_x() {
        let r = Rotation::parse("{a:1.5707963267948966}").unwrap();
        let moved = r * Vector::x();
        assert!((moved - Vector::y()).norm() < 1e-12, "{moved}");
    }

    #[test]
    fn faults_name_their_location() {
        let error = Vector::parse("{x:1,q:2}").unwrap_err();
        assert_eq!(
            error.message,
            "a Vector has no member `q`, only `x`, `y`, `z`"
        );
        assert_eq!(error.at, 7..8);
        assert_eq!(
            f64::parse("abc").unwrap_err().message,
            "`abc` is not a number"
        );
        assert_eq!(
            f64::parse("1 2").unwrap_err().message,
            "`1 2` is not a number"
        );
        assert_eq!(
            f64::parse("").unwrap_err().message,
            "a value is missing here"
        );
        assert!(
            Vector::parse("{x:1")
                .unwrap_err()
                .message
                .contains("missing")
        );
        assert!(i32::parse("3000000000").is_err());
        assert!(
            f64::parse(&"[".repeat(100_000))
                .unwrap_err()
                .message
                .contains("deep")
        );
    }

    proptest! {
        #[test]
        fn every_double_reads_back_exactly(bits: u64) {
            let value = f64::from_bits(bits);
            let back = f64::parse(&text(value)).unwrap();
            prop_assert!(back.to_bits() == bits || (value.is_nan() && back.is_nan()));
        }

        #[test]
        fn any_text_is_read_without_panic(input in ".{0,40}") {
            let _ = f64::parse(&input);
            let _ = Frame::parse(&input);
            let _ = parse_array::<Vector>(&input, 4);
        }
    }
}
