//! Messages and frames of the scope over a running controller, without sockets.

use std::time::Instant;

use serde_json::from_str;
use takt_core::CellConfig;
use takt_core::controller::LoadRequest;
use takt_core::{NetId, SessionId};

use super::*;
use crate::codec::{Codec, Received};
use crate::websocket::FrameReader;

const NET: &str = "{clock=Core::Clock(),twice=Core::DoubleMultiply(inFirst=clock.outValue,Second='2'),\
    stop=Cancel(),outTerminate=stop.outCancel}";

fn controller() -> Controller {
    let mut cell = CellConfig::default();
    cell.controller.priority = None;
    Controller::start(&cell).unwrap()
}

fn start(controller: &Controller) -> NetId {
    let net = controller
        .load(LoadRequest {
            text: NET.to_owned(),
            session: SessionId::NONE,
            description: "twice".to_owned(),
            period: None,
        })
        .unwrap();
    controller.start_net(net).unwrap();
    net
}

/// Group, lost samples and values of a frame.
type Numbers = (u32, u32, Vec<f64>);

/// The payloads of frames: texts as JSON, others as numbers.
fn decode(bytes: &[u8]) -> (Vec<Value>, Vec<Numbers>) {
    let (mut texts, mut frames) = (Vec::new(), Vec::new());
    let mut at = 0;
    while at < bytes.len() {
        let opcode = bytes[at] & 0x0f;
        let (length, head) = match bytes[at + 1] {
            126 => (
                usize::from(u16::from_be_bytes([bytes[at + 2], bytes[at + 3]])),
                4,
            ),
            127 => {
                let length = u64::from_be_bytes(bytes[at + 2..at + 10].try_into().unwrap());
                (usize::try_from(length).unwrap(), 10)
            }
            short => (usize::from(short), 2),
        };
        let payload = &bytes[at + head..at + head + length];
        at += head + length;
        if opcode == 1 {
            texts.push(from_str(std::str::from_utf8(payload).unwrap()).unwrap());
            continue;
        }
        let word = |n: usize| u32::from_le_bytes(payload[4 * n..4 * n + 4].try_into().unwrap());
        let values = payload[16..].chunks(8);
        let values = values.map(|bytes| f64::from_le_bytes(bytes.try_into().unwrap()));
        let values: Vec<_> = values.collect();
        assert_eq!(values.len(), (word(1) * (word(2) + 1)) as usize);
        frames.push((word(0), word(3), values));
    }
    (texts, frames)
}

#[test]
fn scope_streams_net_and_thread_in_one_group() {
    let controller = controller();
    let net = start(&controller);
    let mut client = ScopeClient::new(controller.clone());
    let request = r#"{"probes": ["net:twice/twice.outValue", "net:twice/clock.outValue", "thread:nets.latency",
        "net:twice.state", "thread:nets.latncy"], "rate_hz": 100}"#;
    let (texts, _) = decode(&client.handle_text(request, Duration::ZERO));
    let scope = &texts[0]["scope"];
    assert_eq!(scope["version"], 1);
    assert_eq!(scope["groups"].as_array().unwrap().len(), 1, "{scope}");
    let group = &scope["groups"][0];
    assert_eq!(group["probes"].as_array().unwrap().len(), 4);
    assert_eq!(group["probes"][3]["states"][4], "RUNNING");
    let rejected = &scope["rejected"][0];
    assert_eq!(rejected["probe"], "thread:nets.latncy");
    let hint = rejected["hint"].as_str().unwrap();
    assert!(
        hint.contains("did you mean `thread:nets.latency`"),
        "{hint}"
    );
    let (mut rows, mut ended) = (Vec::new(), Vec::new());
    let begin = Instant::now();
    while ended.len() < 3 && begin.elapsed() < Duration::from_secs(20) {
        std::thread::sleep(Duration::from_millis(20));
        let (texts, frames) = decode(&client.poll(begin.elapsed()));
        ended.extend(texts.into_iter().filter(|text| !text["ended"].is_null()));
        for (group, _, values) in frames {
            assert_eq!(group, 0);
            rows.extend(values.chunks(5).map(<[f64]>::to_vec));
        }
        if rows.len() > 50 {
            let _ = controller.abort(net);
        }
    }
    assert_eq!(ended[0]["ended"]["cause"], format!("net {net} has ended"));
    let sampled: Vec<_> = rows.iter().filter(|row| !row[2].is_nan()).collect();
    assert!(sampled.len() >= 50);
    for row in &sampled {
        assert!((row[1] - 2.0 * row[2]).abs() < 1e-9, "{row:?}");
        assert!((row[4] - 4.0).abs() < 1e-9, "RUNNING");
        assert!(row[3] >= 0.0);
    }
    assert!(
        rows.windows(2).all(|pair| pair[0][0] < pair[1][0]),
        "in time"
    );
}

#[test]
fn scope_trigger_single_sends_whole_capture() {
    let controller = controller();
    start(&controller);
    let mut client = ScopeClient::new(controller);
    let request = r#"{"probes": ["net:twice/clock.outValue"], "pre_s": 0.01, "post_s": 0.02, "mode": "single",
        "trigger": {"on": "rising", "probe": "net:twice/twice.outValue", "level": 0.2}}"#;
    let (texts, _) = decode(&client.handle_text(request, Duration::ZERO));
    assert_eq!(
        texts[0]["scope"]["groups"][0]["probes"]
            .as_array()
            .unwrap()
            .len(),
        1
    );
    let begin = Instant::now();
    let (mut texts, mut frames) = (Vec::new(), Vec::new());
    while !client.is_idle() && begin.elapsed() < Duration::from_secs(20) {
        std::thread::sleep(Duration::from_millis(10));
        let (more_texts, more_frames) = decode(&client.poll(begin.elapsed()));
        texts.extend(more_texts);
        frames.extend(more_frames);
    }
    let time = texts[0]["triggered"]["time_s"].as_f64().unwrap();
    assert!(!texts.last().unwrap()["done"].is_null(), "{texts:?}");
    let [(0, 0, values)] = &frames[..] else {
        panic!("{frames:?}");
    };
    let rows: Vec<_> = values.chunks(2).collect();
    assert_eq!(rows.len(), 31, "10 before, the trigger, 20 after");
    assert!((rows[10][0] - time).abs() < 1e-9, "{rows:?}");
    assert!(rows[10][1] >= 0.1 && rows[9][1] < 0.1, "{rows:?}");
}

const PROBE: &str = r#""probes": ["thread:nets.latency"]"#;

/// Messages that are no request, or out of bounds.
fn bad_requests() -> Vec<String> {
    let many: Vec<_> = (0..65).map(|n| format!("a.{n}")).collect();
    let mut requests = vec![
        String::new(),
        "{".to_owned(),
        "[]".to_owned(),
        "null".to_owned(),
        "7".to_owned(),
        "{}".to_owned(),
        r#"{"probes": []}"#.to_owned(),
        r#"{"probes": [""]}"#.to_owned(),
        r#"{"probes": [7]}"#.to_owned(),
        r#"{"probes": "a"}"#.to_owned(),
        r#"{"probe": ["a"]}"#.to_owned(),
        json!({"probes": many}).to_string(),
        json!({"probes": ["x".repeat(257)]}).to_string(),
        json!({"probes": ["x"], "text": "y".repeat(70_000)}).to_string(),
        "\u{0}\u{ffff}".to_owned(),
        "[".repeat(10_000),
    ];
    for (field, values) in [
        (
            "every",
            &[
                "0",
                "-1",
                "1.5",
                "1000001",
                "\"1\"",
                "null",
                "18446744073709551616",
            ][..],
        ),
        (
            "rate_hz",
            &["0", "-1", "0.09", "101", "1e999", "\"fast\"", "null"][..],
        ),
        ("pre_s", &["-1", "61", "1e400", "\"1s\"", "[]"][..]),
        ("post_s", &["-0.1", "60.1", "{}", "true"][..]),
        ("mode", &["\"never\"", "1", "null"][..]),
        ("trigger", &["7", "\"rising\"", "{}", "[]"][..]),
    ] {
        requests.extend(
            values
                .iter()
                .map(|it| format!(r#"{{{PROBE}, "{field}": {it}}}"#)),
        );
    }
    requests
}

/// Requests with triggers that cannot be.
fn bad_triggers() -> Vec<String> {
    let trigger = |fields: &str| format!(r#"{{{PROBE}, "trigger": {{{fields}}}}}"#);
    let level = r#""level": 1, "probe": "thread:nets.latency""#;
    let mut requests = Vec::new();
    for fields in [
        r#""on": "rising""#.to_owned(),
        r#""on": "rising", "level": 1"#.to_owned(),
        r#""on": "above", "probe": "thread:nets.latency""#.to_owned(),
        format!(r#""on": "sideways", {level}"#),
        format!(r#""on": "rising", {level}, "hysteresis": -1"#),
        format!(r#""on": "above", {level}, "hysteresis": 1"#),
        format!(r#""on": "inside", {level}"#),
        format!(r#""on": "inside", {level}, "low": 1"#),
        format!(r#""on": "outside", {level}, "low": 2, "high": 1"#),
        format!(r#""on": "state", {level}"#),
        r#""on": "state", "probe": "net:twice.state", "equals": "DANCING""#.to_owned(),
        r#""on": "state", "probe": "net:swing.state", "equals": "RUNNING""#.to_owned(),
        r#""on": "fault""#.to_owned(),
        r#""on": "fault", "probe": "left""#.to_owned(),
        r#""on": "overrun", "probe": "thread:none""#.to_owned(),
        r#""on": "above", "probe": "net:twice/nothing.outValue", "level": 1"#.to_owned(),
        r#""on": "above", "probe": "net:", "level": 1"#.to_owned(),
        r#""on": "above", "probe": "net:twice", "level": 1"#.to_owned(),
        r#""on": "above", "probe": "net:twice/", "level": 1, "more": 2"#.to_owned(),
    ] {
        requests.push(trigger(&fields));
    }
    requests
}

#[test]
fn scope_bad_requests_are_answered_with_cause() {
    let controller = controller();
    start(&controller);
    let mut client = ScopeClient::new(controller);
    let requests = [bad_requests(), bad_triggers()].concat();
    assert!(requests.len() >= 64, "{}", requests.len());
    for request in requests {
        let (texts, frames) = decode(&client.handle_text(&request, Duration::ZERO));
        let shown: String = request.chars().take(200).collect();
        assert!(texts.len() == 1 && frames.is_empty());
        let cause = texts[0]["error"]["cause"].as_str();
        let cause = cause.unwrap_or_else(|| panic!("{shown}: {}", texts[0]));
        let hint = texts[0]["error"]["hint"].as_str().unwrap_or_default();
        assert!(!cause.is_empty() && !hint.is_empty(), "{shown}: {cause}");
        assert!(client.is_idle(), "{shown}");
    }
    let (texts, _) = decode(&client.handle_text(&format!("{{{PROBE}}}"), Duration::ZERO));
    assert!(!texts[0]["scope"].is_null() && !client.is_idle());
}

#[test]
fn scope_refused_request_leaves_running_scope() {
    let controller = controller();
    start(&controller);
    let mut client = ScopeClient::new(controller);
    let good =
        r#"{"probes": ["net:twice/twice.outValue", "thread:nets.cycle", "thread:nets.missed"]}"#;
    let _ = client.handle_text(good, Duration::ZERO);
    let (begin, mut cycles) = (Instant::now(), Vec::new());
    for bad in [bad_requests(), bad_triggers()].concat() {
        let (texts, _) = decode(&client.handle_text(&bad, begin.elapsed()));
        assert!(texts[0]["error"].is_object(), "{}", texts[0]);
        let (_, frames) = decode(&client.poll(begin.elapsed()));
        for (_, lost, values) in frames {
            assert_eq!(lost, 0);
            cycles.extend(values.chunks(4).map(|row| (row[2], row[3])));
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    assert!(cycles.len() > 100, "{}", cycles.len());
    for pair in cycles.windows(2) {
        let step = pair[1].0 - pair[0].0;
        assert!(
            (step - 1.0 - pair[1].1).abs() < 1e-9,
            "{pair:?}: cycles that ran are missing"
        );
    }
}

/// As many samplers as a net may have: another scope of this client takes the place of its last.
#[test]
fn scope_request_replaces_last_one_at_limit() {
    let controller = controller();
    start(&controller);
    let request = r#"{"probes": ["net:twice/twice.outValue"]}"#;
    let mut clients: Vec<_> = (0..8)
        .map(|_| ScopeClient::new(controller.clone()))
        .collect();
    for client in &mut clients {
        let (texts, _) = decode(&client.handle_text(request, Duration::ZERO));
        assert_eq!(texts[0]["scope"]["rejected"], json!([]));
    }
    let mut one_too_many = ScopeClient::new(controller);
    let (texts, _) = decode(&one_too_many.handle_text(request, Duration::ZERO));
    assert_eq!(texts[0]["scope"]["rejected"].as_array().unwrap().len(), 1);
    for client in &mut clients {
        let (texts, _) = decode(&client.handle_text(request, Duration::ZERO));
        assert_eq!(texts[0]["scope"]["rejected"], json!([]), "its own place");
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn scope_request_fuzz_seeds_hold() {
    for seed in [
        &b"{}"[..],
        b"{\"probes\":[\"a\"],\"rate_hz\":1e9}",
        b"\xff\xfe{",
        b"{\"probes\":[\"a\"]}",
    ] {
        fuzz(seed);
    }
}

#[test]
fn scope_frames_pass_own_reader() {
    let frame = Frame {
        group: 1,
        columns: 1,
        lost: 7,
        values: vec![0.5, f64::NAN],
    };
    let mut out = Vec::new();
    write_event(&ScopeEvent::Frame(frame), &mut out);
    let mut codec = Codec::WebSocket(FrameReader::default());
    codec.push(&out);
    assert!(matches!(codec.poll(), Ok(Some(Received::Line(_)))));
    let (_, frames) = decode(&out);
    assert_eq!((frames[0].0, frames[0].1), (1, 7));
}
