//! `/metrics`, read by a strict parser of the text format 0.0.4 that is implemented here from the description of the
//! format.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use takt_core::controller::{RuleRequest, RuleState};
use takt_core::device::DeviceDescription;
use takt_core::device::driver::{DeviceDriver, DriverConfig, DriverEnds, DriverThread};
use takt_core::{CellConfig, Controller};

use super::resources::{body, controller, get, holds, loaded, post};

/// Name and labels of a sample.
type Series = (String, BTreeMap<String, String>);

/// A family of samples.
#[derive(Debug, Default)]
struct Family {
    kind: String,
    samples: Vec<(Series, f64)>,
}

fn is_name(name: &str, colon: bool) -> bool {
    let begins = |c: char| c.is_ascii_alphabetic() || c == '_' || (colon && c == ':');
    name.starts_with(begins) && name.chars().all(|c| begins(c) || c.is_ascii_digit())
}

/// Reads labels up to the closing brace; returns them and the rest.
fn labels(mut text: &str) -> Result<(BTreeMap<String, String>, &str), String> {
    let mut found = BTreeMap::new();
    loop {
        if let Some(rest) = text.strip_prefix('}') {
            return Ok((found, rest));
        }
        let (name, rest) = text.split_once("=\"").ok_or("a label without a value")?;
        if !is_name(name, false) || name.starts_with("__") {
            return Err(format!("label {name:?}"));
        }
        let (mut value, mut chars) = (String::new(), rest.char_indices());
        let end = loop {
            match chars.next().ok_or("a value without its end")? {
                (at, '"') => break at,
                (_, '\\') => match chars.next().map(|(_, c)| c) {
                    Some('n') => value.push('\n'),
                    Some(c @ ('\\' | '"')) => value.push(c),
                    other => return Err(format!("escape {other:?}")),
                },
                (_, c) => value.push(c),
            }
        };
        if found.insert(name.to_owned(), value).is_some() {
            return Err(format!("label {name} twice"));
        }
        let rest = &rest[end + 1..];
        text = match rest.strip_prefix(',') {
            Some(rest) if !rest.starts_with('}') => rest,
            Some(_) => return Err("a comma before the brace".to_owned()),
            None if rest.starts_with('}') => rest,
            None => return Err(format!("{rest:?} after a label")),
        };
    }
}

fn value(text: &str) -> Result<f64, String> {
    match text {
        "+Inf" => Ok(f64::INFINITY),
        "-Inf" => Ok(f64::NEG_INFINITY),
        "NaN" => Ok(f64::NAN),
        number if number.bytes().all(|b| b"0123456789.-+eE".contains(&b)) => {
            number.parse().map_err(|_| format!("number {number:?}"))
        }
        other => Err(format!("number {other:?}")),
    }
}

/// Parses the format more strictly than collectors: each family has help and type once, in this
/// order, before its samples, which are adjacent; no series occurs twice.
fn parse(text: &str) -> Result<BTreeMap<String, Family>, String> {
    let mut families: BTreeMap<String, Family> = BTreeMap::new();
    let (mut helped, mut current) = (None, String::new());
    let mut seen = BTreeSet::new();
    let body = text.strip_suffix('\n').ok_or("the last line has no end")?;
    for line in body.split('\n') {
        let wrong = |cause: &str| Err(format!("{cause}: {line:?}"));
        if let Some(help) = line.strip_prefix("# HELP ") {
            let (name, doc) = help.split_once(' ').ok_or("help without text")?;
            if !is_name(name, true) || doc.trim().is_empty() || helped.is_some() {
                return wrong("help");
            }
            helped = Some(name.to_owned());
        } else if let Some(kind) = line.strip_prefix("# TYPE ") {
            let (name, kind) = kind.split_once(' ').ok_or("type without text")?;
            let known = ["counter", "gauge", "histogram"].contains(&kind);
            if helped.take().as_deref() != Some(name) || !known || families.contains_key(name) {
                return wrong("type");
            }
            name.clone_into(&mut current);
            let family = families.entry(name.to_owned()).or_default();
            kind.clone_into(&mut family.kind);
        } else {
            let end = line.find(['{', ' ']).ok_or("a sample without a value")?;
            let (name, rest) = line.split_at(end);
            let (labels, rest) = match rest.strip_prefix('{') {
                Some(rest) => labels(rest)?,
                None => (BTreeMap::new(), rest),
            };
            let number = value(rest.strip_prefix(' ').ok_or("no blank before the value")?)?;
            let family = families
                .get_mut(&current)
                .ok_or("a sample without a type")?;
            let parts: &[&str] = match family.kind.as_str() {
                "histogram" => &["_bucket", "_sum", "_count"],
                _ => &[""],
            };
            let own = parts.iter().any(|part| name == format!("{current}{part}"));
            let series = (name.to_owned(), labels);
            if helped.is_some() || !own || !is_name(name, true) || !seen.insert(series.clone()) {
                return wrong("sample");
            }
            family.samples.push((series, number));
        }
    }
    for (name, family) in &families {
        check(name, family)?;
    }
    Ok(families)
}

/// Checks naming conventions and the invariants of a histogram.
fn check(name: &str, family: &Family) -> Result<(), String> {
    if family.samples.is_empty() {
        return Err(format!("{name} has no sample"));
    }
    if (family.kind == "counter") != name.ends_with("_total") {
        return Err(format!("{name} is a {}", family.kind));
    }
    if family.kind == "counter" && family.samples.iter().any(|(_, v)| *v < 0.0) {
        return Err(format!("{name} is negative"));
    }
    if family.kind != "histogram" {
        return Ok(());
    }
    let mut by_labels: BTreeMap<_, Vec<(f64, f64)>> = BTreeMap::new();
    let mut counts = BTreeMap::new();
    for ((sample, labels), number) in &family.samples {
        let mut rest = labels.clone();
        let le = rest.remove("le");
        let rest: Vec<_> = rest.into_iter().collect();
        match (sample.rsplit('_').next(), le) {
            (Some("bucket"), Some(le)) => {
                by_labels
                    .entry(rest)
                    .or_default()
                    .push((value(&le)?, *number));
            }
            (Some("count"), None) => {
                counts.insert(rest, *number);
            }
            (Some("sum"), None) => {}
            _ => return Err(format!("{sample} has the wrong labels")),
        }
    }
    for (labels, buckets) in &by_labels {
        let rising = buckets
            .windows(2)
            .all(|w| w[0].0 < w[1].0 && w[0].1 <= w[1].1);
        let last = buckets.last().copied();
        let whole = counts.get(labels).map(|count| (f64::INFINITY, *count));
        if !rising || last != whole {
            return Err(format!("{name}{labels:?}: {buckets:?} of {whole:?}"));
        }
    }
    (by_labels.len() == counts.len())
        .then_some(())
        .ok_or_else(|| format!("{name} has counts without buckets"))
}

#[test]
fn parser_rejects_malformed_metrics() {
    let head = "# HELP a_total b\n# TYPE a_total counter\n";
    assert!(parse(&format!("{head}a_total{{x=\"\\\"\\n\\\\\"}} 1\n")).is_ok());
    for bad in [
        "a_total 1",
        "a_total 1 \n",
        "a_total  1\n",
        "a_total 1_0\n",
        "b_total 1\n",
        "a_total{x=\"1\"} 1\na_total{x=\"1\"} 1\n",
        "a_total{x=\"\\q\"} 1\n",
        "a_total{x=\"1\",} 1\n",
        "a_total{1=\"1\"} 1\n",
        "a_total{x=\"1\"x=\"2\"} 1\n",
        "a_total -1\n",
        "# TYPE a_total counter\n",
        "",
    ] {
        assert!(parse(&format!("{head}{bad}")).is_err(), "{bad:?}");
    }
    let histogram = "# HELP h b\n# TYPE h histogram\n";
    let sum = "h_sum 1\nh_count 2\n";
    let good = "h_bucket{le=\"1\"} 1\nh_bucket{le=\"+Inf\"} 2\n";
    assert!(parse(&format!("{histogram}{good}{sum}")).is_ok());
    for bad in [
        "h_bucket{le=\"1\"} 3\nh_bucket{le=\"+Inf\"} 2\n",
        "h_bucket{le=\"1\"} 1\n",
        "h_bucket{le=\"+Inf\"} 1\n",
        "h_bucket 2\n",
    ] {
        assert!(parse(&format!("{histogram}{bad}{sum}")).is_err(), "{bad:?}");
    }
}

#[test]
fn metrics_follow_text_format_and_conventions() {
    let controller = controller();
    loaded(&controller, "{x=Cancel(),outTerminate=x.outCancel}");
    let made = post(
        &controller,
        "/nets/",
        "dionet={a=Core::Nope(),outTerminate=a.outValue}",
    );
    holds(&made, &["302 Found"]);
    while controller.stats().cycles < 3 {
        std::thread::sleep(Duration::from_millis(1));
    }
    let response = get(&controller, "/metrics");
    holds(
        &response,
        &[
            "200 OK",
            "Content-Type: text/plain; version=0.0.4; charset=utf-8\r\n",
        ],
    );
    let families = parse(body(&response)).unwrap_or_else(|e| panic!("{e}\n{response}"));
    let sample = |family: &str, label: (&str, &str)| {
        let samples = &families[family].samples;
        let found = samples
            .iter()
            .find(|((_, labels), _)| labels.get(label.0).map(String::as_str) == Some(label.1));
        found.map(|(_, value)| *value)
    };
    assert_eq!(sample("takt_nets", ("state", "ready")), Some(1.0));
    assert_eq!(sample("takt_nets", ("state", "rejected")), Some(1.0));
    assert_eq!(sample("takt_nets", ("state", "running")), Some(0.0));
    assert_eq!(sample("takt_device_state", ("state", "op")), Some(1.0));
    assert!(sample("takt_cycles_total", ("thread", "nets")) >= Some(3.0));
    for name in [
        "takt_cycle_latency_seconds",
        "takt_cycle_duration_seconds",
        "takt_cycles_missed_total",
        "takt_real_time_allocations_total",
        "takt_real_time_page_faults_total",
        "takt_rules",
        "takt_sessions",
        "takt_clients",
        "takt_messages_total",
    ] {
        assert!(families.contains_key(name), "{name}");
    }
}

#[test]
fn counters_never_decrease() {
    let controller = controller();
    let counters = |controller| {
        let families = parse(body(&get(controller, "/metrics"))).unwrap();
        let samples = families.into_iter().flat_map(|(name, family)| {
            let counts = name.ends_with("_total");
            family.samples.into_iter().filter(move |_| counts)
        });
        samples.collect::<BTreeMap<_, _>>()
    };
    let before = counters(&controller);
    let net = loaded(&controller, "{x=Cancel(),outTerminate=x.outCancel}");
    controller.start_net(net).unwrap();
    controller.abort(net).unwrap();
    let after = counters(&controller);
    assert!(!before.is_empty() && before.keys().eq(after.keys()));
    for (name, count) in &before {
        assert!(
            after[name] >= *count,
            "{name:?}: {count} and then {}",
            after[name]
        );
    }
}

#[test]
fn rules_are_counted_by_state() {
    let controller = controller();
    let net = loaded(&controller, "{x=Cancel(),outTerminate=x.outCancel}");
    controller.start_net(net).unwrap();
    let rule = |condition: String, cancel| RuleRequest {
        condition,
        cancel: vec![cancel],
        ..RuleRequest::default()
    };
    controller
        .schedule(rule(format!("{net}.terminated"), net))
        .unwrap();
    assert_eq!(controller.rule_states(), [RuleState::Active]);
    controller.abort(net).unwrap();
    while controller.rule_states() != [RuleState::Inactive] {
        std::thread::sleep(Duration::from_millis(1));
    }
    let text = get(&controller, "/metrics");
    for line in [
        "takt_rules{state=\"inactive\"} 1",
        "takt_rules{state=\"active\"} 0",
    ] {
        assert!(text.lines().any(|found| found == line), "{line} in {text}");
    }
}

#[test]
fn metrics_do_not_grow_with_nets() {
    let controller = controller();
    let lines = |controller| get(controller, "/metrics").lines().count();
    let before = lines(&controller);
    for _ in 0..50 {
        loaded(&controller, "{x=Cancel(),outTerminate=x.outCancel}");
    }
    assert_eq!(lines(&controller), before);
}

/// A driver without a robot: its clock is never measured.
#[derive(Debug, PartialEq)]
struct Silent;

impl DriverConfig for Silent {
    fn name(&self) -> &str {
        "left"
    }

    fn priority(&self) -> Option<u8> {
        None
    }

    fn devices(&self) -> Vec<DeviceDescription> {
        vec![DeviceDescription {
            name: "left".to_owned(),
            kind: "test",
            limits: Vec::new(),
            model: "".into(),
            parts: Vec::new(),
        }]
    }

    fn start(&self, ends: DriverEnds) -> Result<Box<dyn DeviceDriver>, takt_core::Error> {
        let clock = ends.clock;
        let thread = DriverThread::start("left", None, &[], |_| clock)?;
        Ok(Box::new(thread))
    }
}

#[test]
fn followed_clock_is_reported() {
    let host = get(&controller(), "/metrics");
    assert!(!host.contains("takt_clock_state"), "nothing is followed");
    let mut cell = CellConfig::default();
    cell.controller.priority = None;
    cell.controller.follow = Some("left".to_owned());
    cell.controller.phase = Some(Duration::from_micros(300));
    cell.devices = vec![Arc::new(Silent)];
    let controller = Controller::start(&cell).unwrap();
    let response = get(&controller, "/metrics");
    let families = parse(body(&response)).unwrap_or_else(|e| panic!("{e}\n{response}"));
    assert_eq!(families["takt_cycle_phase_error_seconds"].kind, "histogram");
    holds(
        &response,
        &[
            r#"takt_clock_state{thread="nets",device="left",state="unlocked"} 1"#,
            r#"takt_clock_state{thread="nets",device="left",state="stable"} 0"#,
            r#"takt_cycle_phase_error_seconds_count{thread="nets"} 0"#,
        ],
    );
    let status = get(&controller, "/status/?format=json");
    let status: serde_json::Value = serde_json::from_str(body(&status)).unwrap();
    let clock = &status["thread"][0]["phaseerror"][0];
    let reported = ["device", "state"].map(|key| clock[key].as_str().unwrap());
    assert_eq!(reported, ["left", "unlocked"]);
    assert_eq!(clock["phase"], 0.3);
}

#[test]
fn device_names_are_escaped() {
    // Names from a cell file are checked less strictly than those from forms.
    assert!(parse("# HELP a b\n# TYPE a gauge\na{x=\"a\\\\b\\\"c\"} 1\n").is_ok());
}
