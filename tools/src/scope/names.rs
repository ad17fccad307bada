//! The names of probes: listed, expanded from patterns, and the nearest one of a misspelt name.

use serde_json::Value;

use super::wire::Rejected;
use crate::Verdict;
use crate::http::Http;
use crate::output::say;

/// Probes that match a pattern; more are no picture.
const MATCHES_MAX: usize = 64;

/// The probes of a controller.
fn probes(http: &Http) -> anyhow::Result<Vec<Value>> {
    let mut all = http.get("/probes/")?;
    let probes = all.get_mut("probe").map(Value::take);
    Ok(match probes {
        Some(Value::Array(probes)) => probes,
        Some(_) | None => Vec::new(),
    })
}

fn name(probe: &Value) -> &str {
    probe["name"].as_str().unwrap_or_default()
}

/// Prints the probes whose names contain the text.
pub(super) fn list(http: &Http, filter: &str, json: bool) -> anyhow::Result<Verdict> {
    let mut found = probes(http)?;
    found.retain(|probe| name(probe).contains(filter));
    if json {
        say(&Value::Array(found).to_string())?;
        return Ok(Verdict::Good);
    }
    if found.is_empty() {
        say(&format!("no probe contains `{filter}`"))?;
        return Ok(Verdict::Failed);
    }
    say(table(&found).trim_end())?;
    Ok(Verdict::Good)
}

fn table(probes: &[Value]) -> String {
    let width = probes.iter().map(|it| name(it).chars().count()).max();
    let width = width.unwrap_or(0).max(12);
    let mut out = format!(
        "{:<width$}  {:<8} {:>9}  thread\n",
        "probe", "unit", "period"
    );
    for probe in probes {
        let text = |key: &str| probe[key].as_str().unwrap_or_default().to_owned();
        let period = probe["period_s"].as_f64().unwrap_or(0.0);
        let line = format!(
            "{:<width$}  {:<8} {:>6} ms  {}",
            name(probe),
            text("unit"),
            period * 1e3,
            text("thread")
        );
        out.push_str(line.trim_end());
        out.push('\n');
    }
    out
}

/// The names with their patterns replaced by what matches; an error text if nothing does. Names without a pattern are the
/// controller's to judge.
pub(super) fn expanded(
    http: &Http,
    patterns: &[String],
) -> anyhow::Result<Result<Vec<String>, String>> {
    if patterns.iter().all(|pattern| !pattern.contains('*')) {
        return Ok(Ok(patterns.to_vec()));
    }
    Ok(expand(&probes(http)?, patterns))
}

fn expand(probes: &[Value], patterns: &[String]) -> Result<Vec<String>, String> {
    let mut found: Vec<String> = Vec::new();
    for pattern in patterns {
        let before = found.len();
        if pattern.contains('*') {
            let names = probes.iter().map(name).filter(|it| matches(pattern, it));
            found.extend(names.map(str::to_owned));
        } else {
            found.push(pattern.clone());
        }
        if found.len() == before {
            return Err(format!(
                "no probe matches `{pattern}`\nhint: `takt scope --list` shows all"
            ));
        }
    }
    if found.len() > MATCHES_MAX {
        let count = found.len();
        return Err(format!(
            "{count} probes match, at most {MATCHES_MAX} are sampled together\nhint: write a narrower pattern"
        ));
    }
    Ok(found)
}

/// Whether a name matches a pattern, in which * stands for any characters.
fn matches(pattern: &str, name: &str) -> bool {
    let Some((before, after)) = pattern.split_once('*') else {
        return pattern == name;
    };
    let Some(mut rest) = name.strip_prefix(before) else {
        return false;
    };
    let mut parts = after.split('*').peekable();
    while let Some(part) = parts.next() {
        if parts.peek().is_none() {
            return rest.ends_with(part);
        }
        let Some(at) = rest.find(part) else {
            return false;
        };
        rest = rest.get(at + part.len()..).unwrap_or_default();
    }
    true
}

/// Why a probe is not sampled, with the nearest name if the controller names none.
pub(super) fn explain(http: &Http, rejected: &Rejected) -> String {
    let Rejected { probe, cause, hint } = rejected;
    let nearest = if hint.contains("did you mean") {
        None
    } else {
        probes(http).ok().and_then(|all| nearest(&all, probe))
    };
    let hint = match nearest {
        Some(name) => format!("did you mean `{name}`?"),
        None if hint.is_empty() => "`takt scope --list` shows all probes".to_owned(),
        None => hint.clone(),
    };
    format!("{probe}: {cause}\nhint: {hint}")
}

/// The nearest name: of those with the same beginning, as far as there are any.
fn nearest(probes: &[Value], wanted: &str) -> Option<String> {
    let begin = wanted.split_inclusive(['.', '/']).next().unwrap_or(wanted);
    let own = probes.iter().map(name).filter(|it| it.starts_with(begin));
    let own: Vec<&str> = own.collect();
    let found = takt_net::fault::similar(wanted, own);
    let found = found.or_else(|| takt_net::fault::similar(wanted, probes.iter().map(name)));
    found.map(str::to_owned)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn all() -> Vec<Value> {
        let names = [
            "left.joint.0.measured",
            "left.joint.1.measured",
            "left.joint.1.error",
            "thread:nets.latency",
        ];
        let probe = |name: &str| json!({ "name": name, "unit": "rad", "thread": "nets", "period_s": 0.001 });
        names.iter().map(|name| probe(name)).collect()
    }

    #[test]
    fn patterns_match_any_characters() {
        for (pattern, name, is) in [
            ("left.joint.*.error", "left.joint.1.error", true),
            ("left.joint.*.error", "left.joint.1.errors", false),
            ("*", "", true),
            ("*.*", "a.b", true),
            ("*.*", "ab", false),
            ("a*a", "a", false),
            ("a*b*c", "axxbyyc", true),
            ("a*b*c", "axxcyyb", false),
            ("ab", "ab", true),
        ] {
            assert_eq!(matches(pattern, name), is, "{pattern} {name}");
        }
    }

    #[test]
    fn patterns_are_replaced_or_named() {
        let expand = |patterns: &[&str]| {
            let patterns: Vec<_> = patterns.iter().map(|it| (*it).to_owned()).collect();
            expand(&all(), &patterns)
        };
        assert_eq!(
            expand(&["left.joint.1.*", "x.y"]).unwrap(),
            ["left.joint.1.measured", "left.joint.1.error", "x.y"]
        );
        let why = expand(&["right.*"]).unwrap_err();
        assert!(
            why.starts_with("no probe matches `right.*`\nhint: "),
            "{why}"
        );
        let many = vec!["*"; 17];
        let why = expand(&many).unwrap_err();
        assert!(why.starts_with("68 probes match, at most 64"), "{why}");
    }

    #[test]
    fn nearest_name_begins_alike() {
        let nearest = |name: &str| nearest(&all(), name);
        assert_eq!(
            nearest("left.jont.1.measured").as_deref(),
            Some("left.joint.1.measured")
        );
        assert_eq!(
            nearest("thraed:nets.latency").as_deref(),
            Some("thread:nets.latency")
        );
        assert_eq!(nearest("temperature"), None);
    }

    #[test]
    fn listed_probes_have_unit_period_thread() {
        assert_eq!(
            table(&all()[2..]),
            "probe                unit        period  thread\n\
             left.joint.1.error   rad           1 ms  nets\n\
             thread:nets.latency  rad           1 ms  nets\n"
        );
    }
}
