//! Access rules of a cell's zenoh session: everything is denied that no rule allows. Rules are for links, not for programs: what
//! comes through a router has the rights of the router's certificate.
//!
//! A rule allows a message if its key expression *includes* that of the message. So a query to `takt/**` is denied to those who may read
//! only: no rule of theirs includes the keys of commands. What an exact key must be is checked again by the cell.

use serde_json::{Value, json};

use super::{FleetMode, FleetRight, FleetSettings};
use crate::keys::{ALL, CellName};

/// Keys that the history of publications uses beside those of the publications.
const ALL_HISTORY: &str = "takt/**/@adv/**";

/// What members publish, but for their part in coordinated starts.
const TOPICS: [&str; 12] = [
    ALL_HISTORY,
    "takt/*/alive",
    "takt/*/info",
    "takt/*/clock",
    "takt/*/summary",
    "takt/*/findings",
    "takt/*/log",
    "takt/*/device/**",
    "takt/*/net/**",
    "takt/*/machine/**",
    "takt/*/thread/**",
    "takt/*/session/**",
];

/// What a member asks of others beside what they are, for its page.
const SUMMARY: &str = "takt/*/resource/summary";
const CLOCK: &str = "takt/*/resource/clock";

/// Messages by which data leave their source, publications first.
const DATA: [&str; 5] = [
    "put",
    "delete",
    "reply",
    "declare_queryable",
    "liveliness_token",
];
/// Messages by which data are requested.
const INTEREST: [&str; 3] = [
    "declare_subscriber",
    "liveliness_query",
    "declare_liveliness_subscriber",
];

/// The value of `access_control`.
pub(super) fn rules(cell: &CellName, settings: &FleetSettings) -> Value {
    let (subjects, policies) = subjects(settings);
    json!({
        "enabled": true,
        "default_permission": "deny",
        "rules": rule_list(cell, settings.mode == FleetMode::Router),
        "subjects": subjects,
        "policies": policies,
    })
}

fn rule(id: &str, flow: &str, messages: &[&str], keys: &[String]) -> Value {
    json!({
        "id": id,
        "permission": "allow",
        "flows": [flow],
        "messages": messages,
        "key_exprs": keys,
    })
}

fn rule_list(cell: &CellName, is_router: bool) -> Vec<Value> {
    let texts = |keys: &[&str]| keys.iter().map(|key| (*key).to_owned()).collect::<Vec<_>>();
    let all = texts(&[ALL, ALL_HISTORY]);
    // Of other cells a member sees what they are and how, and takes part in starts; a router sees and forwards all.
    let (out, asks, seen, started) = if is_router {
        (
            all.clone(),
            all.clone(),
            all.clone(),
            texts(&["takt/*/start/**"]),
        )
    } else {
        (
            vec![format!("takt/{cell}/**"), format!("takt/{cell}/**/@adv/**")],
            texts(&[
                "takt/*/info",
                SUMMARY,
                CLOCK,
                "takt/*/start/**",
                ALL_HISTORY,
            ]),
            texts(&[
                "takt/*/alive",
                "takt/*/info",
                "takt/*/info/@adv/**",
                SUMMARY,
                CLOCK,
            ]),
            vec![format!("takt/{cell}/start/**")],
        )
    };
    let commands = if is_router {
        texts(&["takt/*/cmd/**"])
    } else {
        vec![format!("takt/{cell}/cmd/**")]
    };
    let topics = if is_router {
        texts(&TOPICS)
    } else {
        seen.clone()
    };
    let partners = texts(&["takt/*/start/**"]);
    let reads = texts(&[
        "takt/*/info",
        "takt/*/resource/**",
        "takt/*/start/status",
        ALL_HISTORY,
    ]);
    vec![
        rule("own-out", "egress", &DATA, &out),
        rule("asks-out", "egress", &["query"], &asks),
        rule("interest-out", "egress", &INTEREST, &all),
        rule("interest-in", "ingress", &INTEREST, &all),
        rule("others-in", "ingress", &DATA[1..], &seen),
        rule("others-put", "ingress", &DATA[..1], &topics),
        rule("read-in", "ingress", &["query"], &reads),
        rule("command-in", "ingress", &["query"], &commands),
        rule("start-in", "ingress", &["query"], &started),
        // Arms and beats of partners: a link that may only read cannot arm a start.
        rule("partner-in", "ingress", &["put", "reply"], &partners),
    ]
}

/// Subjects, and the rules of each.
fn subjects(settings: &FleetSettings) -> (Vec<Value>, Vec<Value>) {
    let mut subjects = Vec::new();
    let mut policies = Vec::new();
    let mut add = |id: String, mut subject: Value, rights: &[FleetRight]| {
        subject["id"] = json!(id);
        subjects.push(subject);
        policies.push(json!({ "rules": of_rights(rights), "subjects": [id] }));
    };
    let plain = || json!({ "link_protocols": ["tcp"] });
    if settings.allow.is_empty() {
        add("plain".to_owned(), plain(), &[FleetRight::Read]);
        add(
            "certified".to_owned(),
            json!({ "link_protocols": ["tls"] }),
            &[FleetRight::Read],
        );
    }
    for (number, allowed) in settings.allow.iter().enumerate() {
        let id = format!("rule-{number}");
        if allowed.certificates.is_empty() {
            add(id, plain(), &allowed.rights);
        } else {
            let names = &allowed.certificates;
            add(
                id,
                json!({ "cert_common_names": names, "link_protocols": ["tls"] }),
                &allowed.rights,
            );
        }
    }
    (subjects, policies)
}

/// The rules of rights. A client with any of them sees telemetry: a command without its effect in sight is no right.
fn of_rights(rights: &[FleetRight]) -> Vec<&'static str> {
    let mut rules = vec![
        "own-out",
        "asks-out",
        "interest-out",
        "interest-in",
        "others-in",
        "others-put",
        "read-in",
    ];
    for right in rights {
        match right {
            FleetRight::Read => {}
            FleetRight::Command => rules.push("command-in"),
            FleetRight::Start => rules.extend(["start-in", "partner-in"]),
        }
    }
    rules
}
