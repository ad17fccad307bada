//! Each key of the generated configuration, and that zenoh takes it.

use serde_json::{Value, json};

use super::*;

fn settings() -> FleetSettings {
    FleetSettings {
        cell: Some("weld3".to_owned()),
        ..FleetSettings::default()
    }
}

fn with_tls() -> FleetSettings {
    FleetSettings {
        listen: Some(vec!["tls/192.0.2.3:7447".to_owned()]),
        ca: Some("ca.pem".into()),
        certificate: Some("weld3.pem".into()),
        key: Some("weld3.key".into()),
        ..settings()
    }
}

fn entries(settings: &FleetSettings) -> Entries {
    of_cell(&cell_name(settings).unwrap().unwrap(), settings)
}

fn value(entries: &Entries, key: &str) -> Value {
    let found = entries.iter().filter(|(path, _)| *path == key);
    let values: Vec<_> = found.map(|(_, value)| value.clone()).collect();
    assert!(values.len() <= 1, "{key} is given twice");
    values.into_iter().next().unwrap_or(Value::Null)
}

#[test]
fn config_default_is_closed_and_bounded() {
    let entries = entries(&settings());
    for (key, wanted) in [
        ("mode", json!("peer")),
        ("listen/endpoints", json!(["tcp/127.0.0.1:7447"])),
        ("listen/exit_on_failure", json!(true)),
        ("connect/endpoints", json!([])),
        ("connect/exit_on_failure", json!(false)),
        ("connect/timeout_ms", json!(-1)),
        ("scouting/multicast/enabled", json!(false)),
        ("scouting/gossip/enabled", json!(false)),
        ("transport/unicast/max_sessions", json!(128)),
        ("transport/unicast/accept_pending", json!(16)),
        ("transport/link/tx/lease", json!(1000)),
        ("transport/link/rx/max_message_size", json!(1 << 20)),
        ("adminspace/enabled", json!(false)),
    ] {
        assert_eq!(value(&entries, key), wanted, "{key}");
    }
    let access = value(&entries, "access_control");
    assert_eq!(access["enabled"], true);
    assert_eq!(access["default_permission"], "deny");
    assert!(entries.iter().all(|(key, _)| !key.contains("tls")));
}

#[test]
fn config_with_certificates_demands_them_of_others() {
    let entries = entries(&with_tls());
    let tls = |key: &str| value(&entries, &format!("transport/link/tls/{key}"));
    assert_eq!(tls("enable_mtls"), true);
    assert_eq!(tls("verify_name_on_connect"), true);
    assert_eq!(tls("close_link_on_expiration"), true);
    assert_eq!(tls("root_ca_certificate"), "ca.pem");
    assert_eq!(tls("listen_certificate"), "weld3.pem");
    assert_eq!(tls("listen_private_key"), "weld3.key");
    assert_eq!(tls("connect_certificate"), "weld3.pem");
    assert_eq!(tls("connect_private_key"), "weld3.key");
}

/// Keys of a rule.
fn keys<'a>(access: &'a Value, rule: &str) -> Vec<&'a str> {
    let rules = access["rules"].as_array().unwrap();
    let found = rules.iter().find(|it| it["id"] == rule).unwrap();
    assert_eq!(found["permission"], "allow");
    let keys = found["key_exprs"].as_array().unwrap();
    keys.iter().map(|key| key.as_str().unwrap()).collect()
}

/// Rules of a subject.
fn rules_of<'a>(access: &'a Value, subject: &str) -> Vec<&'a str> {
    let policies = access["policies"].as_array().unwrap();
    let found = policies
        .iter()
        .find(|it| it["subjects"] == json!([subject]));
    let rules = found.unwrap()["rules"].as_array().unwrap();
    rules.iter().map(|rule| rule.as_str().unwrap()).collect()
}

#[test]
fn access_data_leave_only_as_own() {
    let access = value(&entries(&settings()), "access_control");
    let own = ["takt/weld3/**", "takt/weld3/**/@adv/**"];
    assert_eq!(keys(&access, "own-out"), own);
    // What a reader asks for never includes the keys of commands.
    assert!(
        keys(&access, "read-in").iter().all(|key| {
            !key.contains("cmd") && *key != "takt/**" && !key.starts_with("takt/*/**")
        })
    );
    assert_eq!(keys(&access, "command-in"), ["takt/weld3/cmd/**"]);
    let router = FleetSettings {
        mode: FleetMode::Router,
        ..settings()
    };
    let access = value(&entries(&router), "access_control");
    assert!(keys(&access, "own-out").contains(&"takt/**"), "it forwards");
}

#[test]
fn access_without_rule_is_reading() {
    let access = value(&entries(&settings()), "access_control");
    for subject in ["plain", "certified"] {
        let rules = rules_of(&access, subject);
        assert!(rules.contains(&"read-in"), "{subject}");
        assert!(!rules.contains(&"command-in") && !rules.contains(&"start-in"));
    }
}

#[test]
fn access_rules_replace_the_default() {
    let rule = |certificates: &[&str], rights: &[FleetRight]| FleetRule {
        certificates: certificates.iter().map(|name| (*name).to_owned()).collect(),
        rights: rights.to_vec(),
    };
    let settings = FleetSettings {
        allow: vec![
            rule(
                &["panel", "weld4"],
                &[FleetRight::Command, FleetRight::Start],
            ),
            rule(&[], &[FleetRight::Read]),
        ],
        ..with_tls()
    };
    let access = value(&entries(&settings), "access_control");
    let subjects = access["subjects"].as_array().unwrap();
    assert_eq!(subjects.len(), 2, "no subject admits all certificates");
    assert_eq!(subjects[0]["cert_common_names"], json!(["panel", "weld4"]));
    assert_eq!(subjects[0]["link_protocols"], json!(["tls"]));
    assert_eq!(subjects[1]["link_protocols"], json!(["tcp"]));
    let first = rules_of(&access, "rule-0");
    assert!(first.contains(&"command-in") && first.contains(&"start-in"));
    assert!(!rules_of(&access, "rule-1").contains(&"command-in"));
}

#[test]
fn observer_beyond_loopback_needs_certificates() {
    let of = |connect: &[&str], tls: Option<TlsFiles>| {
        let connect = connect.iter().map(|text| (*text).to_owned()).collect();
        of_observer(&Observer { connect, tls })
    };
    let files = || TlsFiles {
        ca: "ca.pem".into(),
        certificate: "c.pem".into(),
        key: "c.key".into(),
    };
    assert_eq!(of(&[], None), Err(ObserverError::None));
    assert!(matches!(
        of(&["robot"], None),
        Err(ObserverError::Endpoint(_))
    ));
    let plain = of(&["tcp/192.0.2.1:1"], Some(files()));
    assert!(matches!(plain, Err(ObserverError::NotProtected(_))));
    let tls = of(&["tls/192.0.2.1:1"], None);
    assert!(matches!(tls, Err(ObserverError::NoCertificates(_))));
    let entries = of(&["tls/192.0.2.1:1"], Some(files())).unwrap();
    assert_eq!(value(&entries, "mode"), "client");
    assert_eq!(value(&entries, "listen/endpoints"), json!([]));
    assert_eq!(value(&entries, "connect/exit_on_failure"), true);
}

#[cfg(feature = "zenoh")]
#[test]
fn config_is_taken_by_zenoh_key_by_key() {
    for settings in [settings(), with_tls()] {
        let entries = entries(&settings);
        let config = crate::session::config(&entries).unwrap();
        for (key, wanted) in &entries {
            let found: Value = serde_json::from_str(&config.get_json(key).unwrap()).unwrap();
            if *key == "access_control" {
                assert_eq!(found["default_permission"], "deny");
                let count = |value: &Value| value["rules"].as_array().unwrap().len();
                assert_eq!(count(&found), count(wanted));
            } else {
                assert_eq!(found, *wanted, "{key}");
            }
        }
    }
}

#[test]
fn fleet_reference_states_each_key_and_its_default() {
    let reference = include_str!("../../../../docs/fleet.md");
    let (_, part) = reference.split_once("\n## Settings\n").unwrap();
    let part = part.split("\n## ").next().unwrap();
    let rows = part.lines().filter_map(|line| line.strip_prefix("| `"));
    let rows: Vec<_> = rows
        .map(|row| {
            let mut columns = row.split(" | ");
            let key = columns.next().unwrap().trim_end_matches('`');
            (key, columns.next().unwrap().trim_matches('`'))
        })
        .collect();
    let cell = "cell = 'weld3'\n";
    for (key, default) in &rows {
        if ["required", "–"].contains(default) {
            continue;
        }
        let is_plain = default.starts_with('[') || default.parse::<u32>().is_ok();
        let quote = if is_plain { "" } else { "'" };
        let text = format!("{cell}{key} = {quote}{default}{quote}");
        let stated: FleetSettings = toml::from_str(&text).unwrap();
        assert_eq!(stated, settings(), "{key}");
    }
    // The parser lists the keys that it knows.
    let error = toml::from_str::<FleetSettings>("zz = 1")
        .unwrap_err()
        .to_string();
    let (_, known) = error.split_once("expected one of ").unwrap();
    let mut known: Vec<_> = known.split('`').skip(1).step_by(2).collect();
    let mut keys: Vec<_> = rows.iter().map(|(key, _)| *key).collect();
    known.sort_unstable();
    keys.sort_unstable();
    assert_eq!(known, keys);
    let example = part.split("```toml\n").nth(1).unwrap();
    let example = example.split("```").next().unwrap();
    let example: FleetSettings = toml::from_str(example).unwrap();
    let controller = takt_core::cell::ControllerConfig::default();
    assert_eq!(example.check(&controller), Ok(()));
}
