//! `takt net set`: writes values that a net takes from programs. The controller ignores unknown keys, as its clients
//! expect; here they are errors.

use std::collections::BTreeMap;

use clap::Args;

use super::Server;
use crate::Verdict;
use crate::output::complain;

/// Write values that a net takes.
///
/// They are those of its NetcommIn primitives, by their `Key`: `takt net set rpinet0 speed=0.5 on=true`. The net has them
/// in its next cycle, and also if it is started later.
#[derive(Debug, Args)]
pub(crate) struct Set {
    /// Its identifier, such as rpinet0.
    net: String,
    /// What to write, as in the text of a net: `0.5`, `true`, `[1,2]`, `{x:0,y:0,z:0.1}`.
    #[arg(required = true, value_name = "KEY=VALUE", value_parser = assignment)]
    values: Vec<(String, String)>,
    #[command(flatten)]
    server: Server,
}

impl Set {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let mut client = self.server.connect()?;
        let [known, _] = client.values(&self.net)?;
        let (mut values, mut unknown) = (BTreeMap::new(), false);
        for (key, text) in self.values {
            match on_wire(&key, &known) {
                Some(key) => {
                    values.insert(key, text);
                }
                None => {
                    complain(&missing(&self.net, &key, &known));
                    unknown = true;
                }
            }
        }
        if unknown {
            return Ok(Verdict::Failed);
        }
        client.write(&self.net, values)?;
        Ok(Verdict::Good)
    }
}

/// Reads `key=value`.
fn assignment(text: &str) -> Result<(String, String), String> {
    match text.split_once('=') {
        Some((key, value)) if !key.is_empty() => Ok((key.to_owned(), value.to_owned())),
        _ => Err("write KEY=VALUE, such as speed=0.5".to_owned()),
    }
}

/// The key as the protocol has it: `in` and the `Key` of the primitive.
fn on_wire(key: &str, known: &BTreeMap<String, String>) -> Option<String> {
    let keys = [format!("in{key}"), key.to_owned()];
    keys.into_iter().find(|key| known.contains_key(key))
}

fn missing(net: &str, key: &str, known: &BTreeMap<String, String>) -> String {
    let keys = known
        .keys()
        .map(|key| key.strip_prefix("in").unwrap_or(key));
    let keys: Vec<_> = keys.collect();
    if keys.is_empty() {
        format!(
            "{net} takes no value {key}, and no other: it has no NetcommIn primitive\n\
             hint: such as Core::DoubleNetcommIn(Key='{key}', Value='0')"
        )
    } else {
        format!("{net} takes no value {key}; it takes {}", keys.join(", "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn assignments_have_key_and_value() {
        assert_eq!(assignment("a=b=c"), Ok(("a".to_owned(), "b=c".to_owned())));
        assert_eq!(assignment("a="), Ok(("a".to_owned(), String::new())));
        for wrong in ["a", "=b", ""] {
            assert!(assignment(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn keys_are_found_with_and_without_prefix() {
        let known = ["inspeed", "ininput"].map(|key| (key.to_owned(), "0".to_owned()));
        let known = BTreeMap::from(known);
        assert_eq!(on_wire("speed", &known).as_deref(), Some("inspeed"));
        assert_eq!(on_wire("inspeed", &known).as_deref(), Some("inspeed"));
        assert_eq!(on_wire("input", &known).as_deref(), Some("ininput"));
        assert_eq!(on_wire("sped", &known), None);
        let text = missing("rpinet0", "sped", &known);
        assert_eq!(text, "rpinet0 takes no value sped; it takes input, speed");
    }
}
