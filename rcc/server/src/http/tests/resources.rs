//! Resources of a real controller that initially has no devices.

use std::time::Duration;

use proptest::prelude::*;
use takt_core::controller::{NetState, RuleRequest};
use takt_core::{CellConfig, Controller, NetId};

use super::super::*;
use super::parse;

const CANCELLABLE: &str = "{x=Cancel(),k=Core::BooleanNetcommOut(inValue=x.outCancel,Key='k'),\
    i=Core::DoubleNetcommIn(Key='gain',Value='2'),\
    e=Core::DoubleNetcommOut(inValue=i.outValue,Key='echo'),outTerminate=x.outCancel}";

pub(super) const ARM: &str = "name=lwr1&type=kuka_lwr_sim&com={pos:{x:0.0,y:0.0,z:0.0}}&\
    link_lengths=[0.0,0.3105,0.4,0.39,0.078]&min_joint=[-2.9,-2.0,-2.9,-2.0,-2.9,-2.0,-2.9]&\
    max_joint=[2.9,2.0,2.9,2.0,2.9,2.0,2.9]&home_joint=[0.0,0.5,0.0,1.5,0.0,-0.5,0.0]&\
    max_vel=[1.9,1.9,2.2,2.2,3.5,3.2,3.2]&max_acc=[7.5,7.5,9.0,9.0,14.0,13.0,13.0]&mass=0.0";

pub(super) fn controller() -> Controller {
    let mut cell = CellConfig::default();
    cell.controller.priority = None;
    Controller::start(&cell).unwrap()
}

fn request(controller: &Controller, request: &str) -> String {
    match parse(request.as_bytes(), false) {
        Some((_, Action::Serve(request))) => {
            let log = crate::LogBook::default();
            log.push("a robot is there");
            let gate = crate::access::Gate::new(None, None);
            let site = Site::new(controller.clone(), gate, log);
            respond(&site, &request).to_string()
        }
        other => panic!("{other:?}"),
    }
}

pub(super) fn get(controller: &Controller, path: &str) -> String {
    request(controller, &format!("GET {path} HTTP/1.1\r\n\r\n"))
}

pub(super) fn post(controller: &Controller, path: &str, body: &str) -> String {
    let length = body.len();
    request(
        controller,
        &format!("POST {path} HTTP/1.1\r\nContent-Length: {length}\r\n\r\n{body}"),
    )
}

pub(super) fn body(response: &str) -> &str {
    response.split_once("\r\n\r\n").unwrap().1
}

#[track_caller]
pub(super) fn holds(text: &str, parts: &[&str]) {
    for part in parts {
        assert!(text.contains(part), "{part} is missing in {text}");
    }
}

pub(super) fn loaded(controller: &Controller, text: &str) -> NetId {
    let response = post(controller, "/nets/", &format!("dionet={text}&desc=a <b>"));
    holds(&response, &["HTTP/1.1 302 Found\r\n"]);
    let (_, rest) = response.split_once("Location: /nets/").unwrap();
    rest.split_once('/').unwrap().0.parse().unwrap()
}

#[test]
fn net_is_loaded_shown_and_controlled() {
    let controller = controller();
    let net = loaded(&controller, CANCELLABLE);
    let list = r#"<net uri="/nets/rpinet0/" status="READY" desc="a &lt;b&gt;"/>"#;
    holds(
        &get(&controller, "/nets/"),
        &["200 OK", "application/xml", list],
    );
    holds(
        &get(&controller, "/nets/?format=json"),
        &["application/json", r#""status":"READY""#],
    );
    let page = format!("/nets/{net}/");
    let started = post(&controller, &page, "action=START&ingain=3.5");
    holds(&started, &["303 See Other", "Location: /nets/rpinet0/\r\n"]);
    let rule = RuleRequest {
        condition: format!("{net}.outk"),
        stop: vec![net],
        ..RuleRequest::default()
    };
    controller.schedule(rule).unwrap();
    let echoed = || get(&controller, &page).contains(r#"<data key="outecho">3.5</data>"#);
    while !echoed() {
        std::thread::sleep(Duration::from_millis(1));
    }
    holds(
        &get(&controller, &page),
        &[
            r#"status="RUNNING""#,
            r#"<data key="ingain">3.5</data>"#,
            r#"<data key="outk">false</data>"#,
            r#"<rule id="1" condition="rpinet0.outk" state="ACTIVE" desc="">"#,
            r#"<stop net="rpinet0"/>"#,
        ],
    );
    holds(
        &post(&controller, &page, "action=START"),
        &["409 Conflict", "RUNNING"],
    );
    holds(&post(&controller, &page, "ingain=x"), &["400 Bad Request"]);
    holds(&post(&controller, &page, "innone=1"), &["400 Bad Request"]);
    holds(
        &post(&controller, &page, "action=STOP"),
        &["400 Bad Request"],
    );
    post(&controller, &page, "action=CANCEL");
    while controller.net(net).unwrap().state() != NetState::Terminated {
        std::thread::sleep(Duration::from_millis(1));
    }
    // The last values stay until the net is unloaded.
    holds(
        &get(&controller, &page),
        &[r#"<data key="outk">true</data>"#],
    );
    let unloaded = post(&controller, &page, "action=UNLOAD");
    holds(&unloaded, &["303 See Other", "Location: /nets/\r\n"]);
    holds(&get(&controller, &page), &["404 Not Found"]);
}

#[test]
fn net_is_aborted_before_it_runs() {
    let controller = controller();
    let net = loaded(&controller, CANCELLABLE);
    post(&controller, &format!("/nets/{net}/"), "action=ABORT");
    assert_eq!(controller.net(net).unwrap().state(), NetState::Terminated);
}

#[test]
fn rejected_net_shows_its_faults() {
    let controller = controller();
    let net = loaded(&controller, "{a=Core::Nope(),outTerminate=a.outValue}");
    let fault =
        r#"<errorState major="1" minor="2" block="">1:4: there is no primitive `Core::Nope`"#;
    let page = get(&controller, &format!("/nets/{net}/"));
    holds(&page, &[r#"status="REJECTED""#, fault]);
    let broken = loaded(&controller, "{");
    holds(
        &get(&controller, &format!("/nets/{broken}")),
        &[r#"minor="12""#],
    );
    let xml = get(&controller, &format!("/nets/{broken}/xml"));
    holds(&xml, &["409 Conflict"]);
}

#[test]
fn net_has_text_xml_and_figures() {
    let controller = controller();
    let net = loaded(&controller, CANCELLABLE);
    let text = get(&controller, &format!("/nets/{net}/dio"));
    assert_eq!(body(&text), CANCELLABLE);
    let xml = get(&controller, &format!("/nets/{net}/xml"));
    holds(
        &xml,
        &["application/xml", r#"<module id="x" type="Cancel">"#],
    );
    let again = post(&controller, "/nets/", &format!("rpinet={}", body(&xml)));
    holds(&again, &["302 Found", "Location: /nets/rpinet1/"]);
    assert_eq!(*controller.net(NetId(1)).unwrap().text, *CANCELLABLE);
    let stats = get(&controller, &format!("/nets/{net}/stats"));
    holds(
        &stats,
        &[
            "<stats>\n  <module name=\"ROOT\">\n    <exec min=\"0.000000\" average=\"0.000000\"",
            "\n    <latency min=",
            r#"<module name="nets">"#,
            r#"<figures period="1.000000" thread="1.000000" cycles="0" overruns="0" overbudget="0""#,
            r#"primitives="4" cost="0.000960""#,
            r#"budget="0.800000""#,
        ],
    );
    let json = get(&controller, &format!("/nets/{net}/stats?format=json"));
    holds(
        &json,
        &["application/json", r#""overbudget":0"#, r#""name":"ROOT""#],
    );
    holds(
        &get(&controller, "/stats/"),
        &[
            r#"<thread name="nets" period="1.000000" cycles=""#,
            r#"<net uri="/nets/rpinet0/">"#,
        ],
    );
    holds(
        &get(&controller, &format!("/nets/{net}/x")),
        &["404 Not Found"],
    );
}

#[test]
fn net_period_can_be_given() {
    let controller = controller();
    let load = |frequency: &str| {
        let form = format!("useparams=1&frequency={frequency}&dionet={CANCELLABLE}");
        post(&controller, "/nets/", &form)
    };
    for frequency in ["500", "0.002", "0"] {
        holds(&load(frequency), &["302 Found"]);
    }
    holds(&get(&controller, "/nets/"), &[r#"status="READY""#]);
    load("3000");
    holds(
        &get(&controller, "/nets/rpinet3/"),
        &["REJECTED", "not a whole multiple"],
    );
    for frequency in ["x", "-1", "nan", "inf1"] {
        holds(&load(frequency), &["400 Bad Request", "frequency"]);
    }
}

#[test]
fn forms_without_net_are_rejected() {
    let controller = controller();
    for path in ["/nets/", "/eval/"] {
        holds(
            &post(&controller, path, "a=b"),
            &["400 Bad Request", "dionet="],
        );
        let xml = "rpinet=<rpinet>\n<modul/></rpinet>";
        holds(
            &post(&controller, path, xml),
            &["400 Bad Request", "line 2: `<modul>`"],
        );
    }
    let long = format!("desc={}&dionet={{}}", "x".repeat(4097));
    holds(
        &post(&controller, "/nets/", &long),
        &["400 Bad Request", "4096"],
    );
}

#[test]
fn evaluation_runs_one_cycle_without_trace() {
    let controller = controller();
    let net = "{c=Core::Clock(Increment='2'),t=Cancel(),\
        a=Core::DoubleArray(Size='2'),v=Core::DoubleArrayNetcommOut(inValue=a.outArray,Key='a'),\
        outValue=c.outValue,outTerminate=t.outCancel}";
    let encoded: String = form_urlencoded::byte_serialize(net.as_bytes()).collect();
    for form in [format!("dionet={net}"), format!("dionet={encoded}")] {
        holds(
            &post(&controller, "/eval/", &form),
            &[
                "200 OK",
                r#"<data key="outValue">0.002</data>"#,
                r#"<data key="outTerminate">false</data>"#,
                r#"<data key="outa">[0,0]</data>"#,
            ],
        );
    }
    let error = post(
        &controller,
        "/eval/",
        "dionet={a=Core::Nope(),outTerminate=a.b}",
    );
    holds(
        &error,
        &["200 OK", r#"<data key="error">1:4: there is no primitive"#],
    );
    assert!(controller.nets().is_empty());
    holds(&get(&controller, "/eval/"), &["405 Method Not Allowed"]);
}

/// The known client creates, reads and removes a device like this: doubled slashes, no encoding.
#[test]
fn device_is_created_read_and_removed() {
    let controller = controller();
    holds(&post(&controller, "//devices/", ARM), &["201 Created"]);
    // Its first measurement is that of the next cycle.
    let measured = || get(&controller, "/devices/").contains(r#"state="op" age=""#);
    while !measured() {
        std::thread::sleep(Duration::from_millis(1));
    }
    holds(
        &get(&controller, "/devices/"),
        &[
            r#"name="lwr1" type="kuka_lwr_sim" state="op" age=""#,
            r#"" faults="0" recovered="0""#,
            r#"<parameter name="jointcount" value="7"/>"#,
            r#"name="rcc" type="rcc" state="op" faults="0" recovered="0"/>"#,
        ],
    );
    let read = "dionet={m=RobotArm::JointMonitor(Robot='lwr1',Axis='3'),x=Cancel(),\
        d=Core::DoubleNetcommOut(inValue=m.outMeasuredPosition,Key='d0'),outTerminate=x.outCancel}";
    holds(
        &post(&controller, "/eval/", read),
        &[r#"<data key="outd0">1.5</data>"#],
    );
    holds(
        &get(&controller, "/devices/lwr1/robotarm"),
        &[r#"<joint axis="3" error="0" commanded="1.5" measured="1.5""#],
    );
    holds(&get(&controller, "/devices/rcc/"), &[r#"name="rcc""#]);
    holds(
        &get(&controller, "/devices/rcc/robotarm"),
        &["404 Not Found"],
    );
    holds(
        &post(&controller, "//devices/", ARM),
        &["400 Bad Request", "lwr1"],
    );
    let remove = "name=lwr1&type=kuka_lwr_sim&action=remove";
    holds(&post(&controller, "//devices/", remove), &["303 See Other"]);
    assert!(controller.devices().is_empty());
    holds(&post(&controller, "//devices/", remove), &["404 Not Found"]);
}

#[test]
fn device_name_of_any_text_works_everywhere() {
    let controller = controller();
    for (form, uri, in_net) in [
        (
            "Test+device+Lwr4",
            "Test%20device%20Lwr4",
            "Test device Lwr4",
        ),
        ("a.b-c", "a.b-c", "a.b-c"),
        ("it%27s+%5C", "it%27s%20%5C", r"it\'s \\"),
        ("left%2Fright", "left%2Fright", "left/right"),
        ("%C3%A4rm", "%C3%A4rm", "ärm"),
    ] {
        let add = ARM.replace("=lwr1", &format!("={form}"));
        holds(&post(&controller, "/devices/", &add), &["201 Created"]);
        let uri = format!("/devices/{uri}/");
        holds(&get(&controller, "/devices/"), &[&format!("uri=\"{uri}\"")]);
        holds(&get(&controller, &uri), &[r#"type="kuka_lwr_sim""#]);
        holds(
            &get(&controller, &format!("{uri}robotarm")),
            &[r#"axis="3""#],
        );
        holds(
            &get(&controller, &format!("{uri}armkinematics")),
            &[r#"key="outFrame""#],
        );
        holds(&get(&controller, &format!("{uri}io")), &["<port "]);
        let read = format!(
            "dionet={{m=RobotArm::JointMonitor(Robot='{in_net}',Axis='3'),outP=m.outMeasuredPosition}}"
        );
        holds(
            &post(&controller, "/eval/", &read),
            &[r#"<data key="outP">"#],
        );
        let remove = format!("name={form}&action=remove");
        holds(&post(&controller, "/devices/", &remove), &["303 See Other"]);
    }
}

#[test]
fn invalid_devices_are_rejected() {
    let controller = controller();
    let with = |from: &str, to: &str| ARM.replace(from, to);
    for form in [
        with("name=lwr1&", ""),
        with("=lwr1", "="),
        with("=lwr1", "=a%07"),
        with("=lwr1", "=rcc"),
        with("=lwr1", &format!("={}", "a".repeat(65))),
        with("&type=kuka_lwr_sim", ""),
        with("kuka_lwr_sim", "nope"),
        with("max_vel=[1.9,", "max_vel=["),
        with("mass=", "action=x&mass="),
    ] {
        let refused = post(&controller, "/devices/", &form);
        assert!(refused.starts_with("HTTP/1.1 400 "), "{form}: {refused}");
    }
    assert!(controller.devices().is_empty());
}

#[test]
fn http_session_end_ends_its_nets() {
    let controller = controller();
    holds(
        &post(&controller, "/sessions/", "desc=lab"),
        &["302 Found", "Location: /sessions/s1/"],
    );
    let load = format!("action=LOADNET&dionet={CANCELLABLE}&desc=n");
    holds(&post(&controller, "/sessions/s1/", &load), &["302 Found"]);
    holds(
        &get(&controller, "/sessions/"),
        &[r#"<session uri="/sessions/s1/" id="s1" desc="lab" onloss="keep"/>"#],
    );
    let updated = post(&controller, "/sessions/s1/", "action=UPDATE&desc=line 2");
    holds(&updated, &["303 See Other", "Location: /sessions/s1/"]);
    let listed = get(&controller, "/sessions/?format=json");
    holds(&listed, &[r#""desc":"line 2","id":"s1","onloss":"keep""#]);
    let lost = post(&controller, "/sessions/", "desc=lab&onloss=end");
    holds(&lost, &["400 Bad Request", "no connection to lose"]);
    holds(
        &get(&controller, "/sessions/s1/"),
        &[r#"<net uri="/nets/rpinet0/""#],
    );
    holds(
        &post(&controller, "/sessions/s1/", "action=x"),
        &["400 Bad Request"],
    );
    holds(
        &post(&controller, "/sessions/s1/", "action=TERMINATE"),
        &["303 See Other"],
    );
    assert!(controller.nets().is_empty());
    for session in ["s0", "s1", "x"] {
        holds(
            &get(&controller, &format!("/sessions/{session}/")),
            &["404 Not Found"],
        );
    }
}

#[test]
fn primitives_describe_themselves() {
    let controller = controller();
    let clock = get(&controller, "/modules/Core::Clock/");
    holds(
        &clock,
        &[
            r#"<module name="Core::Clock""#,
            r#"null="While inIncrement is null or not finite, the clock stops"#,
            r#"src/primitives/time.rs" firstns="200" ns="40" elementns="10">"#,
            r#"<outport name="outValue" type="Core::double">"#,
            r#"<parameter name="Increment" type="Core::double" default="1">"#,
            r#"<inport name="inActive" type="Core::bool" required="false">"#,
        ],
    );
    holds(
        &get(&controller, "/modules/"),
        &[r#"<module name="Core::Clock""#],
    );
    let details = get(&controller, "/modulesdetails/?format=json");
    let details: serde_json::Value = serde_json::from_str(body(&details)).unwrap();
    let modules = details["module"].as_array().unwrap().len();
    assert_eq!(modules, controller.registry().definitions().len());
    holds(
        &get(&controller, "/modules/Core::Clokc"),
        &["404", "did you mean Core::Clock?"],
    );
    holds(&get(&controller, "/types/"), &[r#"name="World::Frame[]""#]);
    holds(&get(&controller, "/types/World::Frame%5B%5D/"), &["200 OK"]);
    holds(&get(&controller, "/types/x"), &["404"]);
    holds(&post(&controller, "/types/", ""), &["405"]);
}

#[test]
fn unknown_path_lists_resources() {
    let controller = controller();
    for path in [
        "/x/",
        "/nets/rpinet0/a/b",
        "/devices/a/b",
        "/modules/Core::Clock/source.java",
    ] {
        holds(&get(&controller, path), &["404 Not Found"]);
    }
    holds(&get(&controller, "/x"), &["/modulesdetails/"]);
}

#[test]
fn page_and_extensions_load_no_foreign_code() {
    let controller = controller();
    holds(
        &get(&controller, "/extensions/"),
        &["200 OK", "<extensions/>"],
    );
    let loaded = post(&controller, "/extensions/", "extension=evil");
    holds(
        &loaded,
        &["403 Forbidden", "No code is loaded from the network"],
    );
    let page = get(&controller, "//");
    holds(
        &page,
        &[
            "200 OK",
            "text/html",
            "Content-Security-Policy: default-src 'none'",
            "script-src 'self'",
        ],
    );
    assert!(!page.contains("unsafe-inline"));
    for elsewhere in ["https://", "http://", "@import", "url("] {
        assert!(!body(&page).contains(elsewhere), "{elsewhere}");
    }
}

#[test]
fn page_files_have_their_content_types() {
    let controller = controller();
    for (path, kind) in [
        ("/page/js/main.js", "Content-Type: text/javascript"),
        ("/page/style.css", "Content-Type: text/css"),
    ] {
        let parts = ["200 OK", kind, "nosniff", "Cache-Control: no-store"];
        holds(&get(&controller, path), &parts);
    }
    for path in [
        "/page/",
        "/page/js/",
        "/page/../page.rs",
        "/page/js/none.js",
    ] {
        holds(&get(&controller, path), &["404 Not Found"]);
    }
    holds(
        &post(&controller, "/page/js/main.js", ""),
        &["405 Method Not Allowed"],
    );
}

#[test]
fn log_is_filtered_by_number_and_word() {
    let controller = controller();
    holds(
        &get(&controller, "/log/"),
        &[
            r#"<log next="1">"#,
            r#"<line number="0">a robot is there</line>"#,
        ],
    );
    holds(&get(&controller, "/log/?start=1"), &[r#"<log next="1"/>"#]);
    holds(
        &get(&controller, "/log/?filter=hand&format=json"),
        &[r#"{"next":1}"#],
    );
}

#[test]
fn status_reports_usage_of_each_bound() {
    let controller = controller();
    loaded(&controller, CANCELLABLE);
    while controller.stats().cycles < 3 {
        std::thread::sleep(Duration::from_millis(1));
    }
    let status = get(&controller, "//status/?format=json");
    let status: serde_json::Value = serde_json::from_str(body(&status)).unwrap();
    let nets = &status["count"][0];
    assert_eq!((&nets["name"], &nets["used"]), (&"nets".into(), &1.into()));
    assert_eq!(nets["bound"], 1024);
    let thread = &status["thread"][0];
    assert_eq!(thread["period"], 1.0);
    let buckets = thread["latency"][0]["bucket"].as_array().unwrap();
    assert_eq!(buckets.last().unwrap()["le"], 100.0);
}

#[test]
fn arm_kinematics_invert_each_other() {
    let controller = controller();
    holds(&post(&controller, "//devices/", ARM), &["201"]);
    let parameters = get(&controller, "/devices/lwr1/parameters");
    holds(
        &parameters,
        &[r#"<parameter name="jointcount" value="7"/>"#],
    );
    let changed = post(&controller, "/devices/lwr1/parameters", "jointcount=6");
    holds(&changed, &["409 Conflict", "create it again"]);
    holds(
        &get(&controller, "/devices/lwr1/nope"),
        &["404", "robotarm"],
    );
    let at = "j1=0.1&j2=0.2&j3=0.3&j4=1.4&j5=0.5&j6=0.6&j7=0.7";
    let frame = get(&controller, &format!("/devices/lwr1/armkinematics?{at}"));
    let (_, frame) = frame.split_once(r#"key="outFrame">{pos:{"#).unwrap();
    let (frame, _) = frame.split_once("}}").unwrap();
    let frame = frame
        .replace("},rot:{", ",")
        .replace(':', "=")
        .replace(',', "&");
    let back = get(
        &controller,
        &format!("/devices/lwr1/armkinematics?{frame}&{at}"),
    );
    let (_, joints) = back.split_once(r#"key="outJoints">["#).unwrap();
    let (joints, _) = joints.split_once(']').unwrap();
    let joints: Vec<f64> = joints.split(',').map(|j| j.parse().unwrap()).collect();
    for (joint, expected) in joints.iter().zip([0.1, 0.2, 0.3, 1.4, 0.5, 0.6, 0.7]) {
        assert!((joint - expected).abs() < 1e-9, "{joints:?}");
    }
    let far = get(&controller, "/devices/lwr1/kinematics?x=10");
    holds(&far, &["409 Conflict", "cannot reach"]);
    let wrong = get(&controller, "/devices/lwr1/armkinematics?j1='%7D");
    holds(&wrong, &["400 Bad Request", "j1: a number"]);
}

const TAPPED: &str = "{c=Core::Clock(),x=Cancel(),a=Core::DoubleAdd(inFirst[0.5]=c.outValue,Second='1'),\
    n=Core::DoubleSetNull(inValue=a.outValue,inNull=x.outCancel),\
    o=Core::DoubleNetcommOut(inValue[0.5]=n.outValue,Key='o'),\
    f=Core::BooleanValue(),outTerminate=f.outValue}";

#[test]
fn debug_taps_record_each_cycle_while_polled() {
    let controller = controller();
    let net = loaded(&controller, TAPPED);
    let debug = format!("/nets/{net}/debug");
    controller.start_net(net).unwrap();
    let first = get(&controller, &debug);
    holds(
        &first,
        &[
            "text/tab-separated-values",
            "\r\n\r\ntime\ta.inFirst\to.inValue\n",
        ],
    );
    while body(&get(&controller, &debug)).lines().count() < 30 {
        std::thread::sleep(Duration::from_millis(1));
    }
    controller.abort(net).unwrap();
    let text = get(&controller, &debug);
    let rows = body(&text).lines().skip(1).map(|line| {
        let fields: Vec<f64> = line.split('\t').map(|f| f.parse().unwrap()).collect();
        fields.try_into().unwrap()
    });
    let rows: Vec<[f64; 3]> = rows.collect();
    for pair in rows.windows(2) {
        let [before, after] = [pair[0], pair[1]];
        // No cycle is missing: the clock counts them.
        assert!(
            (after[1] - before[1] - 0.001).abs() < 1e-9,
            "{before:?} {after:?}"
        );
        assert!(after[0] > before[0], "{before:?} {after:?}");
        assert!((after[2] - after[1] - 1.0).abs() < 1e-9, "{after:?}");
    }
    let json = get(&controller, &format!("{debug}?format=json"));
    let json: serde_json::Value = serde_json::from_str(body(&json)).unwrap();
    assert_eq!(json["time_ns"].as_array().unwrap().len(), rows.len());
    assert_eq!(json["ports"][1]["name"], "o.inValue");
    assert_eq!(json["ports"][1]["type"], "Core::double");
}

#[test]
fn net_without_taps_has_empty_record() {
    let controller = controller();
    let net = loaded(&controller, CANCELLABLE);
    let debug = get(&controller, &format!("/nets/{net}/debug"));
    assert_eq!(body(&debug), "time\n");
    holds(&get(&controller, "/nets/rpinet7/debug"), &["404"]);
}

#[test]
fn nets_with_recorded_taps_are_bounded() {
    use takt_core::controller::RECORDED_NETS_MAX;
    let controller = controller();
    for _ in 0..RECORDED_NETS_MAX {
        let net = loaded(&controller, TAPPED);
        holds(
            &get(&controller, &format!("/nets/{net}/debug")),
            &["200 OK"],
        );
    }
    let net = loaded(&controller, TAPPED);
    let refused = get(&controller, &format!("/nets/{net}/debug"));
    holds(
        &refused,
        &["503", "nets whose debug taps are recorded", "16"],
    );
    // Continued recording does not count again.
    holds(&get(&controller, "/nets/rpinet0/debug"), &["200 OK"]);
}

#[test]
fn evaluation_size_and_time_are_bounded() {
    use takt_core::controller::EVAL_PRIMITIVES_MAX;
    let controller = controller();
    let net = |primitives: usize| {
        let adds: String = (0..primitives)
            .map(|i| format!("a{i}=Core::DoubleAdd(),"))
            .collect();
        format!("dionet={{{adds}e=Core::BooleanValue(),outTerminate=e.outValue}}")
    };
    holds(&post(&controller, "/eval/", &net(100)), &["outTerminate"]);
    let one_shot = post(
        &controller,
        "/eval/",
        "dionet={a=Core::DoubleAdd(First='2',Second='3'),outSum=a.outValue}",
    );
    holds(&one_shot, &[r#"<data key="outSum">5</data>"#]);
    let refused = post(&controller, "/eval/", &net(EVAL_PRIMITIVES_MAX));
    holds(&refused, &[r#"<data key="error">"#, "20000"]);
}

/// A request from random words, some of which form valid ones.
fn requests() -> impl Strategy<Value = Vec<u8>> {
    let method = "(POST|POST|POST|GET|GET|GET|[A-Z ]{0,6})";
    let name = "(nets|eval|sessions|types|modules|devices|rpinet[0-3]|s[0-2]|xml|dio|stats|lwr1|\
        robotarm|Core::Clock|%|%41|%ff|\\?|\\?format=json|\\.\\.|[ -~]{0,3})";
    let path = prop::collection::vec(name, 0..5).prop_map(|p| format!("/{}", p.join("/")));
    let value = "(START|ABORT|remove|TERMINATE|LOADNET|lwr1|kuka_lwr_sim|0\\.002|1|\\{\\}|\
        \\{x=Cancel\\(\\),outTerminate=x\\.outCancel\\}|\\{a=b\\(inX=c\\.d,E='f'|<rpinet/>|<rpinet>|\
        <rpinet><module id='a' type='Cancel'/></rpinet>|\\[1,2|%7B%7D|%|%zz|\\+|[ -~ä]{0,8})";
    let key =
        "(dionet|rpinet|desc|useparams|frequency|action|name|type|inX|min_joint|&|=|[a-z]{0,2})";
    let form = prop::collection::vec((key, value), 0..5);
    let form = form.prop_map(|f| {
        f.into_iter()
            .map(|(k, v)| format!("{k}={v}"))
            .collect::<Vec<_>>()
            .join("&")
    });
    let header = "(Host: h|Accept: application/json|Expect: 100-continue|Origin: null|\
        Content-Length: [0-9]{1,3}|Transfer-Encoding: chunked|[ -~]{0,12})";
    let headers = prop::collection::vec(header, 0..2);
    let spoil = prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..2);
    let parts = (method, path, headers, form, any::<bool>(), spoil);
    parts.prop_map(|(method, path, headers, form, length, spoil)| {
        let mut head = format!("{method} {path} HTTP/1.1\r\n");
        headers
            .iter()
            .for_each(|h| head.push_str(&format!("{h}\r\n")));
        if length {
            head.push_str(&format!("Content-Length: {}\r\n", form.len()));
        }
        let mut bytes = format!("{head}\r\n{form}").into_bytes();
        for (at, byte) in spoil {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        bytes
    })
}

/// No panic, and always a complete response; the controller bounds what the requests create.
#[test]
fn random_requests_get_valid_responses() {
    let controller = controller();
    let served = std::cell::Cell::new(0);
    let config = ProptestConfig {
        failure_persistence: None,
        ..ProptestConfig::with_cases(10_000)
    };
    proptest::test_runner::TestRunner::new(config)
        .run(&requests(), |bytes| {
            let whole = matches!(parse(&bytes, true), Some((_, Action::Serve(_))));
            served.set(served.get() + u32::from(whole));
            fuzz(&controller, &bytes);
            Ok(())
        })
        .unwrap();
    assert!(served.get() > 2000, "only {} were requests", served.get());
    assert!(controller.nets().len() <= takt_core::controller::NETS_MAX);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(10_000))]

    #[test]
    fn random_forms_are_decoded(body in prop::collection::vec(
        prop_oneof![any::<u8>(), prop::sample::select(&b"&=%+{ab1"[..])], 0..40))
    {
        let fields = form::decode(&body);
        let length: usize = fields.iter().map(|(k, v)| k.len() + v.len()).sum();
        // Each byte that is not UTF-8 becomes three.
        prop_assert!(length <= 3 * body.len());
    }
}

#[test]
fn rejected_set_points_are_shown_and_counted() {
    let controller = controller();
    post(&controller, "/devices/", &format!("{ARM}&limits=strict"));
    let text = "{v=Core::DoubleValue(Value='1.0'),x=Cancel(),outTerminate=x.outCancel,\
        j=RobotArm::JointPosition(inPosition=v.outValue,Robot='lwr1',Axis='4')}";
    let net = loaded(&controller, text);
    controller.start_net(net).unwrap();
    let page = || get(&controller, &format!("/nets/{net}/"));
    while !page().contains("<rejected") {
        std::thread::sleep(Duration::from_millis(1));
    }
    let cause = r#"cause="lwr1 joint 4 rejects set-points of rpinet0: the first is 1.0000 rad from the measured 0.0000"#;
    holds(&page(), &[r#"reason="start""#, cause, r#"hint="begin"#]);
    // The list has it too, so that one request finds all.
    holds(&get(&controller, "/nets/"), &[r#"reason="start""#, cause]);
    holds(
        &get(&controller, "/metrics"),
        &[
            r#"takt_set_points_rejected_total{device="lwr1",part="joint 4",reason="start"} 1"#,
            r#"takt_device_events_total{device="lwr1",severity="warning"} 1"#,
        ],
    );
    holds(
        &get(&controller, "/devices/lwr1/"),
        &[r#"<event severity="warning""#, cause],
    );
}

#[test]
fn posted_arm_checks_range_only_and_reports_speed() {
    let controller = controller();
    post(&controller, "/devices/", ARM);
    let text = "{v=Core::DoubleValue(Value='1.0'),x=Cancel(),outTerminate=x.outCancel,\
        j=RobotArm::JointPosition(inPosition=v.outValue,Robot='lwr1',Axis='4')}";
    let net = loaded(&controller, text);
    controller.start_net(net).unwrap();
    let arm = || get(&controller, "/devices/lwr1/robotarm");
    while !arm().contains(r#"axis="4" error="0" commanded="1" measured="1""#) {
        std::thread::sleep(Duration::from_millis(1));
    }
    let device = || get(&controller, "/devices/lwr1/");
    while !device().contains("<event") {
        std::thread::sleep(Duration::from_millis(1));
    }
    holds(
        &device(),
        &[
            "joint 4: velocity 1000.0000 rad/s commanded, limit 3.5000 rad/s; it followed",
            "limits=strict",
        ],
    );
    assert_eq!(controller.rejected(Some(net)), []);
    let wrong = post(
        &controller,
        "/devices/",
        &format!("{}&limits=no", ARM.replace("lwr1", "lwr2")),
    );
    holds(
        &wrong,
        &["400 Bad Request", "`no` is neither strict nor range"],
    );
}

#[test]
fn flight_request_without_recorder_is_a_conflict() {
    let controller = controller();
    holds(&get(&controller, "/flights/"), &["recording=\"false\""]);
    let refused = post(&controller, "/flights/", "");
    holds(
        &refused,
        &["409 Conflict", "it is off\nhint: set flight_recorder"],
    );
}

#[test]
fn flight_requested_is_listed_until_complete() {
    let controller = controller();
    let directory = std::env::temp_dir().join(format!("takt-http-flights-{}", std::process::id()));
    let settings = takt_core::controller::FlightSettings {
        directory: directory.clone(),
        bytes_max: 16 << 20,
        cell: None,
    };
    controller.record_flights(settings).unwrap();
    let answer = post(&controller, "/flights/", "");
    holds(&answer, &["200 OK", "-request.mcap"]);
    let until = std::time::Instant::now() + Duration::from_secs(60);
    while !get(&controller, "/flights/").contains("complete=\"true\"") {
        assert!(std::time::Instant::now() < until, "it is never complete");
        std::thread::sleep(Duration::from_millis(20));
    }
    std::fs::remove_dir_all(directory).unwrap();
}
