//! `/machines/` and below, of a real controller: each resource, and what is wrong with a request.

use std::time::Duration;

use super::resources::{body, controller, get, holds, post};

const COMPONENT: &str = "component Counter {
      property step: int range 0 .. 10 default 1 live;
      out count: int;
      operation clear(to: int range 0 .. 100);
    }
    { step=Core::IntNetcommIn(Key='step', Value='$step'), calls=Core::IntNetcommIn(Key='clear'),
      to=Core::IntNetcommIn(Key='clear_to'), sum=Core::IntAdd(inFirst=step.outValue, inSecond=to.outValue),
      count=Core::IntNetcommOut(inValue=sum.outValue, Key='count'),
      cancel=Cancel(), outTerminate=cancel.outCancel }";

const MACHINE: &str = "machine M {
      component c from \"c\" started;
      param first: int = 1;
      event go;
      initial state A { transition on go to B; transition if false to Z; }
      state B { entry { c.step := first; } transition if false to Z; }
      final state Z { entry { stop c; } }
      machine inner { initial final state I { } }
    }";

/// A form value.
fn form(text: &str) -> String {
    text.bytes().map(|byte| format!("%{byte:02X}")).collect()
}

fn machine(more: &str) -> String {
    format!("text={}&file.c={}{more}", form(MACHINE), form(COMPONENT))
}

fn until(controller: &takt_core::Controller, path: &str, part: &str) -> String {
    for _ in 0..5_000 {
        let page = get(controller, path);
        if page.contains(part) {
            return page;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    panic!("{part} is missing in {}", get(controller, path));
}

#[test]
fn machine_resources_load_show_command_and_end() {
    let controller = controller();
    holds(&get(&controller, "/machines/"), &["200 OK", "<machines"]);
    let more = format!("&param.first=7&properties.c={}", form("step = 3"));
    let response = post(&controller, "/machines/", &machine(&more));
    holds(&response, &["302 Found", "Location: /machines/M/"]);
    holds(
        &get(&controller, "/machines/"),
        &[r#"uri="/machines/M/""#, r#"status="inactive""#],
    );
    holds(
        &get(&controller, "/machines/?format=json"),
        &["application/json", r#""name":"M""#],
    );
    holds(
        &get(&controller, "/machines/M/"),
        &[
            r#"name="c" phase="running""#,
            r#"name="first""#,
            "7",
            "<figures",
        ],
    );
    assert_eq!(body(&get(&controller, "/machines/M/text")), MACHINE);
    holds(
        &get(&controller, "/machines/M/properties/c"),
        &["200 OK", "step", "3"],
    );
    let started = post(&controller, "/machines/M/", "action=START");
    holds(&started, &["303 See Other", "Location: /machines/M/"]);
    until(&controller, "/machines/M/", r#"state="A""#);
    holds(
        &get(&controller, "/machines/?format=json"),
        &[r#""machine":[{"#, r#""name":"inner""#],
    );
    let command = form("c.clear(4); c.step := 2; raise go");
    holds(
        &post(&controller, "/machines/M/", &format!("command={command}")),
        &["303 See Other"],
    );
    until(&controller, "/machines/M/", r#"state="B""#);
    for action in ["PAUSE", "STEP"] {
        let done = post(&controller, "/machines/M/", &format!("action={action}"));
        holds(&done, &["303 See Other"]);
    }
    until(&controller, "/machines/M/", r#"paused="true""#);
    holds(
        &get(&controller, "/machines/M/graph"),
        &["image/svg+xml", "<svg", ">B</text>"],
    );
    holds(
        &get(&controller, "/machines/M/graph/inner"),
        &["image/svg+xml", ">I</text>"],
    );
    post(&controller, "/machines/M/", "action=STOP");
    until(&controller, "/machines/M/", r#"status="finished""#);
    let ended = post(&controller, "/machines/M/", "action=END");
    holds(&ended, &["303 See Other", "Location: /machines/\r\n"]);
    holds(&get(&controller, "/machines/M/"), &["404"]);
}

#[test]
#[expect(clippy::too_many_lines, reason = "a table")]
fn machine_requests_with_errors_name_cause() {
    let controller = controller();
    post(&controller, "/machines/", &machine(""));
    let other = |from: &str, to: &str| machine("").replace(&form(from), &form(to));
    for (path, sent, status, cause) in [
        (
            "/machines/",
            "x=1".to_owned(),
            "400",
            "a machine is required",
        ),
        (
            "/machines/",
            "text=machine".to_owned(),
            "409",
            "the name of the machine",
        ),
        ("/machines/", machine(""), "409", "is loaded already"),
        (
            "/machines/",
            other("machine M", "machine N").replace("file.c", "file.d"),
            "409",
            "was not sent",
        ),
        (
            "/machines/",
            other("machine M", "machine N") + "&param.last=1",
            "409",
            "no parameter `last`",
        ),
        (
            "/machines/",
            other("machine M", "machine N") + "&properties.c=step%20%3D%2011",
            "409",
            "11 is not in the range",
        ),
        (
            "/machines/N/",
            "action=START".to_owned(),
            "404",
            "there is no machine `N`",
        ),
        (
            "/machines/M/",
            "action=JUMP".to_owned(),
            "400",
            "START, STOP, STEP, PAUSE or END",
        ),
        (
            "/machines/M/",
            "action=PAUSE".to_owned(),
            "409",
            "while the machine is inactive",
        ),
        ("/machines/M/", "command=c.gone()".to_owned(), "400", "gone"),
        (
            "/machines/M/",
            format!("command={}", form("c.step := 11")),
            "409",
            "11 is not in the range",
        ),
        (
            "/machines/M/",
            "command=c.start()".to_owned(),
            "409",
            "is not allowed while the component is running",
        ),
    ] {
        let response = post(&controller, path, &sent);
        assert!(
            response.starts_with(&format!("HTTP/1.1 {status}")),
            "{sent}: {response}"
        );
        holds(&response, &[cause]);
    }
    for path in [
        "/machines/N/",
        "/machines/M/graph/N",
        "/machines/M/properties/d",
        "/machines/M/other",
    ] {
        holds(&get(&controller, path), &["HTTP/1.1 404"]);
    }
    holds(&get(&controller, "/machines/M/"), &[r#"status="inactive""#]);
}
