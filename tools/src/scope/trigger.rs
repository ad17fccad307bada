//! What starts a capture, as a text of the command line. Names are resolved by the controller.
//!
//! ```text
//! trigger = ( "rising" | "falling" ) probe level [ "hysteresis" width ]
//!         | ( "above" | "below" ) probe level
//!         | ( "inside" | "outside" ) probe low high
//!         | "state" probe name | probe "=" name
//!         | probe ">" level | probe "<" level
//!         | "fault" device
//!         | "event" ( device | machine | net )
//!         | "overrun" [ thread ]
//! ```
//! A level is a number, with or without a unit. A name with blanks is in quotation marks.

use serde::Serialize;

/// What starts a capture, as on the wire.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Trigger {
    on: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    probe: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    level: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    hysteresis: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    low: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    high: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    equals: Option<String>,
}

/// Edges, which may have a hysteresis, and levels.
const LEVELS: [&str; 4] = ["rising", "falling", "above", "below"];
/// The edges of them.
const EDGES: [&str; 2] = ["rising", "falling"];
/// Windows.
const WINDOWS: [&str; 2] = ["inside", "outside"];

/// Units with their size in the SI unit; a unit that ends in another one comes before it.
const UNITS: [(&str, f64); 19] = [
    ("deg/s", std::f64::consts::PI / 180.0),
    ("rad/s", 1.0),
    ("mm/s", 1e-3),
    ("m/s", 1.0),
    ("deg", std::f64::consts::PI / 180.0),
    ("rad", 1.0),
    ("kN", 1e3),
    ("Nm", 1.0),
    ("N", 1.0),
    ("mA", 1e-3),
    ("A", 1.0),
    ("mV", 1e-3),
    ("V", 1.0),
    ("us", 1e-6),
    ("ms", 1e-3),
    ("mm", 1e-3),
    ("cm", 1e-2),
    ("s", 1.0),
    ("m", 1.0),
];

/// A word of the text, with the column where it begins, from 1.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Token {
    column: usize,
    text: String,
    is_quoted: bool,
}

impl Token {
    /// Whether it is `<`, `>` or `=`.
    fn is_symbol(&self) -> bool {
        !self.is_quoted && ["<", ">", "="].contains(&self.text.as_str())
    }
}

/// Reads a trigger.
pub(crate) fn parse(text: &str) -> Result<Trigger, String> {
    let tokens = tokens(text)?;
    let end = text.chars().count() + 1;
    let mut words = Words {
        tokens: tokens.into_iter().peekable(),
        end,
    };
    let first = words.any("a trigger is expected", FORMS)?;
    if first.is_symbol() {
        return Err(wrong(
            first.column,
            "the name of a probe is expected",
            FORMS,
        ));
    }
    let trigger = if words.tokens.peek().is_some_and(Token::is_symbol) {
        comparison(first, &mut words)?
    } else {
        condition(&first, &mut words)?
    };
    match words.tokens.next() {
        None => Ok(trigger),
        Some(rest) => {
            let cause = format!("`{}` is too much", rest.text);
            let hint = "a name with blanks is in quotation marks";
            Err(wrong(rest.column, &cause, hint))
        }
    }
}

const FORMS: &str = "write a condition such as `left.joint.6.commanded > 0.5`, `rising left.force.z 10`, \
    `outside left.joint.0.error -1mm 1mm`, `fault left`, `event left`, `overrun nets`, `net:swing=RUNNING`";

/// `probe > level`, `probe < level`, `probe = state`.
fn comparison(probe: Token, words: &mut Words) -> Result<Trigger, String> {
    let symbol = words.any("a condition is expected", FORMS)?;
    let probe = Some(probe.text);
    if symbol.text == "=" {
        return Ok(state(probe, words.state()?));
    }
    let on = if symbol.text == ">" { "above" } else { "below" };
    Ok(Trigger {
        on,
        probe,
        level: Some(words.level()?),
        ..Trigger::default()
    })
}

/// A condition that begins with its kind.
#[expect(clippy::too_many_lines, reason = "one arm for each kind")]
fn condition(kind: &Token, words: &mut Words) -> Result<Trigger, String> {
    let word = kind.text.as_str();
    let probes = "`takt scope --list` shows all probes";
    let probe = |words: &mut Words| {
        let token = words.any("the name of a probe is expected", probes)?;
        Ok::<_, String>(Some(token.text))
    };
    if let Some(on) = LEVELS.into_iter().find(|it| *it == word) {
        return Ok(Trigger {
            on,
            probe: probe(words)?,
            level: Some(words.level()?),
            hysteresis: words.hysteresis(EDGES.contains(&on))?,
            ..Trigger::default()
        });
    }
    if let Some(on) = WINDOWS.into_iter().find(|it| *it == word) {
        let probe = probe(words)?;
        let low = words.level()?;
        let column = words.column();
        let high = words.level()?;
        if high < low {
            let cause = format!("the upper bound {high} is below the lower one {low}");
            return Err(wrong(column, &cause, "write the lower bound first"));
        }
        return Ok(Trigger {
            on,
            probe,
            low: Some(low),
            high: Some(high),
            ..Trigger::default()
        });
    }
    match word {
        "state" => {
            let probe = probe(words)?;
            Ok(state(probe, words.state()?))
        }
        "fault" => Ok(Trigger {
            on: "fault",
            probe: Some(
                words
                    .any("a device is expected", "write `fault left`")?
                    .text,
            ),
            ..Trigger::default()
        }),
        "event" => Ok(Trigger {
            on: "event",
            probe: Some(
                words
                    .any(
                        "a device, machine or net is expected",
                        "write `event left`, `event machine:cell` or `event net:swing`",
                    )?
                    .text,
            ),
            ..Trigger::default()
        }),
        "overrun" => Ok(Trigger {
            on: "overrun",
            probe: words.tokens.next().map(|thread| thread.text),
            ..Trigger::default()
        }),
        // A probe, and nothing that it is compared with.
        _ if word.contains(['.', ':']) => {
            Err(wrong(words.column(), "`>`, `<` or `=` is expected", FORMS))
        }
        _ => {
            let known = LEVELS.into_iter().chain(WINDOWS);
            let known = known.chain(["state", "fault", "event", "overrun"]);
            let similar = takt_net::fault::similar(word, known);
            let meant = similar.map_or_else(String::new, |it| format!("; did you mean `{it}`?"));
            let cause = format!("`{word}` is no kind of trigger{meant}");
            Err(wrong(kind.column, &cause, FORMS))
        }
    }
}

/// That a net or machine enters a state: `net:swing` is `net:swing.state`.
fn state(probe: Option<String>, name: String) -> Trigger {
    let probe = probe.map(|probe| {
        let is_whole = !probe.starts_with("net:") && !probe.starts_with("machine:");
        if is_whole || probe.contains('/') || probe.ends_with(".state") {
            probe
        } else {
            format!("{probe}.state")
        }
    });
    Trigger {
        on: "state",
        probe,
        equals: Some(name),
        ..Trigger::default()
    }
}

/// The words that were not read yet.
struct Words {
    tokens: std::iter::Peekable<std::vec::IntoIter<Token>>,
    /// Column behind the text.
    end: usize,
}

impl Words {
    /// Where the next word begins.
    fn column(&mut self) -> usize {
        self.tokens.peek().map_or(self.end, |token| token.column)
    }

    fn any(&mut self, cause: &str, hint: &str) -> Result<Token, String> {
        let end = self.end;
        self.tokens.next().ok_or_else(|| wrong(end, cause, hint))
    }

    fn state(&mut self) -> Result<String, String> {
        let hint = "write the name of a state, such as RUNNING";
        let token = self.any("a state is expected", hint)?;
        if token.is_symbol() {
            return Err(wrong(token.column, "a state is expected", hint));
        }
        Ok(token.text)
    }

    /// `hysteresis 0.5N`, behind the level of an edge.
    fn hysteresis(&mut self, is_edge: bool) -> Result<Option<f64>, String> {
        let is_it = |token: &Token| !token.is_quoted && token.text == "hysteresis";
        let Some(word) = self.tokens.next_if(is_it) else {
            return Ok(None);
        };
        if !is_edge {
            let cause = "a hysteresis belongs to an edge";
            let hint = "write `rising` or `falling` for `above` or `below`";
            return Err(wrong(word.column, cause, hint));
        }
        let column = self.column();
        let width = self.level()?;
        if width < 0.0 {
            let cause = format!("the hysteresis {width} is negative");
            let hint = "write by how much the value must first be on the other side of the level";
            return Err(wrong(column, &cause, hint));
        }
        Ok(Some(width))
    }

    fn level(&mut self) -> Result<f64, String> {
        let hint = "write a number, in SI or with its unit: 0.5, 30deg, 10N, 250us";
        let token = self.any("a number is expected", hint)?;
        let text = token.text.as_str();
        let of = |(unit, size): &(&str, f64)| {
            let number: f64 = text.strip_suffix(unit)?.parse().ok()?;
            Some(number * size)
        };
        let number = text.parse().ok().or_else(|| UNITS.iter().find_map(of));
        let number = number.filter(|it: &f64| it.is_finite());
        number.ok_or_else(|| wrong(token.column, &format!("`{text}` is no number"), hint))
    }
}

fn wrong(column: usize, cause: &str, hint: &str) -> String {
    format!("column {column}: {cause}\nhint: {hint}")
}

/// Words, names in quotation marks, and `<`, `>`, `=`.
fn tokens(text: &str) -> Result<Vec<Token>, String> {
    let mut found: Vec<Token> = Vec::new();
    let mut letters = (1..).zip(text.chars()).peekable();
    while let Some((column, letter)) = letters.next() {
        let mut word = String::from(letter);
        let is_quoted = letter == '"';
        if letter.is_whitespace() {
            continue;
        } else if is_quoted {
            word.clear();
            loop {
                match letters.next() {
                    Some((_, '"')) => break,
                    Some((_, letter)) => word.push(letter),
                    None => {
                        let cause = "the quotation mark is not closed";
                        return Err(wrong(column, cause, "close it behind the name"));
                    }
                }
            }
        } else if !"<>=".contains(letter) {
            let goes_on = |letter: char| !letter.is_whitespace() && !"<>=\"".contains(letter);
            while let Some((_, letter)) = letters.next_if(|(_, letter)| goes_on(*letter)) {
                word.push(letter);
            }
        }
        found.push(Token {
            column,
            text: word,
            is_quoted,
        });
    }
    Ok(found)
}

#[cfg(test)]
mod tests;
