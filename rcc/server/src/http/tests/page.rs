//! Resources that the page needs beyond those of programs: pictures of nets, rules, findings, nets that jog.

use std::sync::Arc;

use takt_core::Controller;
use takt_core::controller::RuleRequest;

use super::super::*;
use super::parse;
use super::resources::{ARM, controller, get, holds, post};
use crate::host_program::{HostProgram, JogKind};

const NET: &str = "{a=Core::Clock(),o=Core::DoubleNetcommOut(inValue=a.outValue,Key='time'),\
    x=Cancel(),outTerminate=x.outCancel}";

/// A program with these cells.
#[derive(Debug)]
struct Program(Option<&'static str>);

impl HostProgram for Program {
    fn findings(&self) -> Result<String, String> {
        Ok(r#"{"version":1,"conditions":[]}"#.to_owned())
    }

    fn cells(&self) -> Result<Option<String>, String> {
        Ok(self.0.map(str::to_owned))
    }

    fn jog_net(&self, arm: &str, kind: JogKind, speed: f64) -> Result<String, String> {
        Err(format!("{arm} {kind:?} {speed}\nhint: none"))
    }
}

/// The response to a request to a server with a program.
fn ask(controller: &Controller, path: &str) -> String {
    ask_of(Program(None), controller, path)
}

fn ask_of(program: Program, controller: &Controller, path: &str) -> String {
    let request = format!("GET {path} HTTP/1.1\r\n\r\n");
    let Some((_, Action::Serve(request))) = parse(request.as_bytes(), false) else {
        panic!("{path}");
    };
    let gate = crate::access::Gate::new(None, None);
    let site = Site {
        program: Some(Arc::new(program)),
        ..Site::new(controller.clone(), gate, crate::LogBook::default())
    };
    respond(&site, &request).to_string()
}

/// Loads a net; returns its path.
fn load(controller: &Controller, text: &str) -> String {
    let loaded = post(controller, "/nets/", &format!("dionet={text}"));
    let (_, at) = loaded.split_once("Location: ").unwrap();
    at.lines().next().unwrap().to_owned()
}

#[test]
fn net_graph_is_svg_with_names() {
    let controller = controller();
    let net = load(&controller, NET);
    holds(
        &get(&controller, &format!("{net}graph")),
        &[
            "200 OK",
            "image/svg+xml",
            r#"data-path="a" data-type="Core::Clock" data-outs="outValue""#,
        ],
    );
    let broken = load(&controller, "{a=");
    holds(&get(&controller, &format!("{broken}graph")), &["409"]);
}

#[test]
fn net_graph_beyond_bound_is_rejected() {
    let controller = controller();
    let clocks: String = (0..4001).map(|n| format!("c{n}=Core::Clock(),")).collect();
    let net = load(
        &controller,
        &format!("{{{clocks}x=Cancel(),outTerminate=x.outCancel}}"),
    );
    let parts = ["409 Conflict", "at most 4000 are drawn\nhint: "];
    holds(&get(&controller, &format!("{net}graph")), &parts);
}

#[test]
fn rules_are_listed_once() {
    let controller = controller();
    let [first, second] = [0, 1].map(|_| load(&controller, NET));
    let id = |path: &str| path.split('/').nth(2).unwrap().parse().unwrap();
    let request = RuleRequest {
        condition: "t".to_owned(),
        start: vec![id(&first), id(&second)],
        description: "both".to_owned(),
        ..RuleRequest::default()
    };
    controller.schedule(request).unwrap();
    let rules = get(&controller, "/rules/?format=json");
    assert_eq!(rules.matches("\"condition\"").count(), 1, "{rules}");
    holds(&rules, &[r#""desc":"both""#, r#""condition":"t""#]);
    holds(&post(&controller, "/rules/", ""), &["405"]);
}

#[test]
fn findings_need_a_host_program() {
    let controller = controller();
    holds(&get(&controller, "/host/"), &["404 Not Found"]);
    let parts = ["200 OK", "application/json", r#""conditions":[]"#];
    holds(&ask(&controller, "/host/"), &parts);
}

#[test]
fn fleet_is_listed_if_controller_is_in_one() {
    let controller = controller();
    holds(&get(&controller, "/fleet/"), &["404 Not Found"]);
    holds(
        &ask(&controller, "/fleet/"),
        &["200 OK", r#"{"own":null,"cells":[]}"#],
    );
    let cells = r#"{"own":"a","cells":[]}"#;
    holds(
        &ask_of(Program(Some(cells)), &controller, "/fleet/"),
        &["200 OK", "application/json", cells],
    );
    holds(&post(&controller, "/fleet/", ""), &["405"]);
}

#[test]
fn jog_net_checks_arm_kind_and_speed() {
    let controller = controller();
    holds(&ask(&controller, "/devices/none/jog"), &["404 Not Found"]);
    holds(&ask(&controller, "/devices/rcc/jog"), &["404 Not Found"]);
    holds(&post(&controller, "/devices/", ARM), &["201 Created"]);
    let of = |query: &str| ask(&controller, &format!("/devices/lwr1/jog?{query}"));
    holds(
        &of("kind=joints&speed=0.5"),
        &["409", "lwr1 Joints 0.5\nhint: none"],
    );
    holds(&of("kind=flange"), &["lwr1 Flange 0.1"]);
    for wrong in [
        "",
        "kind=base",
        "kind=joints&speed=0",
        "kind=joints&speed=1.1",
        "kind=joints&speed=NaN",
    ] {
        holds(&of(wrong), &["400 Bad Request"]);
    }
    holds(
        &get(&controller, "/devices/lwr1/jog?kind=joints"),
        &["404 Not Found"],
    );
}
