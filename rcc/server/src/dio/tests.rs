//! Lines in, lines out, with a real controller without devices. Nets run in real time, so the tests check only the
//! order of pushes, not their times.

mod bounds;
mod machines;
mod results;
mod rules;

use std::time::Instant;

use takt_client::wire::Value;
use takt_core::CellConfig;

use super::*;

/// Runs for 1 s of logical time or until it is cancelled, and echoes a value.
const PROBE: &str = "{c=Core::Clock(Increment='1'),\
    g=Core::DoubleGreater(inFirst=c.outValue,Second='1.0'),x=Cancel(),\
    o=Core::BooleanOr(inFirst=g.outValue,inSecond=x.outCancel),\
    t=Core::DoubleNetcommOut(inValue=c.outValue,Key='t'),\
    r=Core::BooleanNetcommOut(inValue=o.outValue,Key='r0'),\
    i=Core::DoubleNetcommIn(Key='gain',Value='2'),\
    e=Core::DoubleNetcommOut(inValue=i.outValue,Key='echo'),outTerminate=o.outValue}";

/// Never ends by itself.
const ENDLESS: &str = "{f=Core::BooleanValue(Value='false'),outTerminate=f.outValue}";

const REJECTED: &str = "{a=Core::Nope(),outTerminate=a.outValue}";

fn controller() -> Controller {
    let mut cell = CellConfig::default();
    cell.controller.priority = None;
    Controller::start(&cell).unwrap()
}

/// A client and its clock, which advances by 1 ms with every poll.
struct Client {
    connection: Connection,
    now: Duration,
    /// All lines sent to it.
    seen: Vec<String>,
}

impl Client {
    fn new(controller: &Controller) -> Self {
        Self {
            connection: Connection::new(controller.clone()),
            now: Duration::ZERO,
            seen: Vec::new(),
        }
    }

    fn with_handshake(controller: &Controller) -> Self {
        let mut client = Self::new(controller);
        assert_eq!(
            client.send(r#"c0=ver("2.0")"#),
            [r#"c0=ok("handshake ok")"#]
        );
        client
    }

    fn send(&mut self, line: &str) -> Vec<String> {
        let lines = self.connection.handle_line(line, self.now);
        self.seen.extend_from_slice(&lines);
        lines
    }

    /// The reply to a line that causes no pushes.
    fn call(&mut self, line: &str) -> String {
        let mut answers = self.send(line);
        assert_eq!(answers.len(), 1, "{answers:?}");
        answers.remove(0)
    }

    fn pushes(&mut self) -> Vec<String> {
        self.now += Duration::from_millis(1);
        self.connection.handle_change(Changed::States);
        let lines = self.connection.poll_pushes(self.now);
        self.seen.extend_from_slice(&lines);
        lines
    }

    /// All pushes up to the first one that contains `text`.
    fn pushes_until(&mut self, text: &str) -> Vec<String> {
        let mut seen = Vec::new();
        for _ in 0..10_000 {
            seen.extend(self.pushes());
            if let Some(at) = seen.iter().position(|line| line.contains(text)) {
                assert_eq!(at + 1, seen.len(), "{seen:?}");
                return seen;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        panic!("{text} was not pushed; received {seen:?}");
    }

    fn load(&mut self, text: &str) -> String {
        let answer = self.call(&format!(r#"l=nene("{text}")"#));
        answer
            .strip_prefix("l=ok(\"")
            .unwrap()
            .strip_suffix("\")")
            .unwrap()
            .to_owned()
    }
}

/// Whether all lines are `nc` pushes of this tag.
fn only_values(tag: &str, lines: &[String]) -> bool {
    lines
        .iter()
        .all(|line| line.starts_with(&format!("{tag}=nc({{")))
}

#[test]
fn handshake_with_right_version_must_be_first() {
    let mut client = Client::new(&controller());
    assert_eq!(client.call("a=gde()"), r#"a=err("bad handshake")"#);
    assert_eq!(client.call("a=nonsense()"), r#"a=err("bad handshake")"#);
    assert_eq!(client.call(r#"a=ver("1.0")"#), r#"a=err("bad handshake")"#);
    assert_eq!(client.call("a=ver(2.0)"), r#"a=err("bad handshake")"#);
    assert_eq!(client.call("a=ver()"), r#"a=err("bad handshake")"#);
    assert_eq!(client.call("what?"), r#"none=err("invalid syntax")"#);
    assert_eq!(client.call("a=quit()"), r#"a=ok("quitting")"#);
    assert_eq!(client.call(r#"a=ver("2.0")"#), r#"a=ok("handshake ok")"#);
    let unknown = r#"a=err("unknown command or uninitialized result")"#;
    assert_eq!(client.call("a=nonsense()"), unknown);
    assert_eq!(client.call(r#"a=ver("2.0")"#), unknown);
}

#[test]
fn command_values_are_checked() {
    let mut client = Client::with_handshake(&controller());
    let net = client.load(ENDLESS);
    let mismatch = r#"a=err("Parameter type does not match")"#;
    let lines = [
        "a=nse(1)".to_owned(),
        "a=ase([])".to_owned(),
        "a=nest(0.5)".to_owned(),
        format!(r#"a=gne("{net}",1)"#),
        r#"a=nene("{}","s1","",1,1)"#.to_owned(),
        r#"a=nene("{}","s1","",0.0,1.0)"#.to_owned(),
        "a=snc([])".to_owned(),
        format!("a=snc({{{net}:1}})"),
        format!("a=snc({{{net}:{{ingain:2.0}}}})"),
    ];
    for line in lines {
        assert_eq!(client.call(&line), mismatch, "{line}");
    }
    for line in [
        "a=nse()", "a=ase()", "a=nest()", "a=nene()", "a=snc()", "a=gne()",
    ] {
        assert_eq!(client.call(line), r#"a=err("Parameter missing")"#, "{line}");
    }
}

#[test]
fn unknown_names_are_rejected() {
    let mut client = Client::with_handshake(&controller());
    for command in ["nest", "neca", "neab", "neun"] {
        for name in [
            "rpinet7",
            "rpinet",
            "",
            "net",
            "rpinet-1",
            "rpinet99999999999",
        ] {
            let line = format!(r#"a={command}("{name}")"#);
            assert_eq!(client.call(&line), r#"a=err("invalid net")"#, "{line}");
        }
    }
    assert_eq!(
        client.call(r#"a=gne("rpinet7",0.1)"#),
        r#"a=err("invalid net")"#
    );
    assert_eq!(
        client.call(r#"a=snc({rpinet7:{ina:"1"}})"#),
        r#"a=err("invalidnetname")"#
    );
    for command in ["ase", "gse"] {
        for name in ["s0", "s1", "none", ""] {
            let line = format!(r#"a={command}("{name}")"#);
            assert_eq!(client.call(&line), r#"a=err("invalid session")"#, "{line}");
        }
    }
}

/// The exchange captured from the original; for its rules see `captured_rule_exchange`.
#[test]
fn captured_exchange() {
    let mut client = Client::with_handshake(&controller());
    assert_eq!(client.call(r#"c4=nse("probe@host")"#), r#"c4=ok("s1")"#);
    let devices = [
        r#"c3=da({rcc:{interfaces:{},type:"rcc"}})"#,
        r#"c3=ds({rcc:"op"})"#,
        "c3=ok()",
    ];
    assert_eq!(client.send("c3=gde()"), devices);
    let load = format!(r#"c5=nene("{PROBE}","s1","probe net",0.0,1)"#);
    assert_eq!(client.send(&load), [r#"c5=ok("rpinet0")"#]);
    let observed = [r#"c6=ns("READY")"#, "c6=ok()"];
    assert_eq!(client.send(r#"c6=gne("rpinet0",0.2)"#), observed);
    let started = [r#"c6=ns("RUNNING")"#, "c7=ok()"];
    assert_eq!(client.send(r#"c7=nest("rpinet0")"#), started);
    let first = client.pushes_until("outt");
    assert!(only_values("c6", &first), "{first:?}");
    assert!(
        first
            .concat()
            .contains(r#"outecho:"2",outr0:"false",outt:"#),
        "{first:?}"
    );
    assert_eq!(
        client.send(r#"c8=snc({rpinet0:{ingain:"3.5"}})"#),
        ["c8=ok()"]
    );
    let echo = client.pushes_until(r#"outecho:"3.5""#);
    assert!(only_values("c6", &echo), "{echo:?}");
    let cancelled = client.send(r#"c9=neca("rpinet0")"#);
    assert_eq!(cancelled.last().unwrap(), "c9=ok()");
    let mut end = cancelled;
    end.extend(client.pushes_until(r#"c6=ns("TERMINATED")"#));
    let last_values = end.iter().rfind(|line| line.starts_with("c6=nc("));
    let complete = r#"c6=nc({outecho:"3.5",outr0:"true",outt:"#;
    assert!(
        last_values.is_some_and(|line| line.starts_with(complete)),
        "{end:?}"
    );
    let unloaded = client.send(r#"c10=neun("rpinet0")"#);
    assert!(unloaded[0].starts_with(complete), "{unloaded:?}");
    assert_eq!(unloaded[1..], [r#"c6=ns("TERMINATED")"#, "c10=ok()"]);
    let rest = client.pushes_until(r#"c6=ns("UNLOADED")"#);
    assert_eq!(rest.len(), 1, "{rest:?}");
    assert_eq!(client.send(r#"c15=gse("s1")"#), ["c15=ok()"]);
    let rejected = [r#"c15=st({rpinet1:"REJECTED"})"#, r#"c22=ok("rpinet1")"#];
    let load = format!(r#"c22=nene("{REJECTED}","s1","unknown prim",0.0,1)"#);
    assert_eq!(client.send(&load), rejected);
    assert_eq!(client.send(r#"c30=ase("s1")"#).last().unwrap(), "c30=ok()");
    assert_eq!(
        client.send("c31=quit()").last().unwrap(),
        r#"c31=ok("quitting")"#
    );
}

/// The known client creates its devices over HTTP and waits for these pushes.
#[test]
fn device_added_later_is_pushed() {
    let controller = controller();
    let mut client = Client::with_handshake(&controller);
    client.send("c3=gde()");
    let seven = |value: &str| format!("[{}]", [value; 7].join(","));
    let parameters = [
        ("min_joint", "-2.9"),
        ("max_joint", "2.9"),
        ("max_vel", "1.9"),
        ("max_acc", "7.5"),
    ];
    let parameters = parameters.map(|(key, value)| (key.to_owned(), seven(value)));
    let parameters = BTreeMap::from(parameters);
    let added = controller.add_device("lwr1", "kuka_lwr_sim", &parameters);
    added.unwrap();
    let pushed = client.pushes_until(r#"c3=ds({lwr1:"op"})"#);
    let interfaces = r#"c3=da({lwr1:{interfaces:{armkinematics:{},io:{anin:"0",anout:"8",digin:"8",digout:"8"},robotarm:{jointcount:"7"}},type:"kuka_lwr_sim"}})"#;
    assert_eq!(pushed[0], interfaces);
    controller.remove_device("lwr1").unwrap();
    client.pushes_until(r#"c3=dr(["lwr1"])"#);
}

#[test]
fn aborted_net_pushes_last_values_before_reply() {
    let mut client = Client::with_handshake(&controller());
    let net = client.load(PROBE);
    client.send(&format!(r#"w=gne("{net}",60.0)"#));
    client.send(&format!(r#"a=nest("{net}")"#));
    client.pushes_until("outt");
    let aborted = client.send(&format!(r#"a=neab("{net}")"#));
    assert_eq!(aborted.len(), 3, "{aborted:?}");
    assert!(
        aborted[0].starts_with(r#"w=nc({outecho:"2",outr0:"false",outt:"#),
        "{aborted:?}"
    );
    assert_eq!(aborted[1..], [r#"w=ns("TERMINATED")"#, "a=ok()"]);
}

#[test]
fn ready_net_can_be_aborted() {
    let mut client = Client::with_handshake(&controller());
    let net = client.load(ENDLESS);
    client.send(&format!(r#"w=gne("{net}",0.1)"#));
    let aborted = client.send(&format!(r#"a=neab("{net}")"#));
    assert_eq!(aborted, [r#"w=ns("TERMINATED")"#, "a=ok()"]);
}

#[test]
fn running_net_is_not_unloaded() {
    let mut client = Client::with_handshake(&controller());
    let net = client.load(ENDLESS);
    client.send(&format!(r#"w=gne("{net}",0.1)"#));
    client.send(&format!(r#"a=nest("{net}")"#));
    assert_eq!(client.call(&format!(r#"a=neun("{net}")"#)), "a=ok()");
    assert_eq!(client.pushes(), Vec::<String>::new());
}

#[test]
fn net_started_twice_returns_reason() {
    let mut client = Client::with_handshake(&controller());
    let net = client.load(ENDLESS);
    let start = format!(r#"a=nest("{net}")"#);
    assert_eq!(client.call(&start), "a=ok()");
    let again = client.call(&start);
    assert!(
        again.starts_with(r#"a=err("net start failed","net rpinet0 is RUNNING; "#),
        "{again}"
    );
}

#[test]
fn net_text_syntax_error_is_rejected() {
    let mut client = Client::with_handshake(&controller());
    let answer = client.call(r#"a=nene("{a=Core::Clock(")"#);
    assert!(
        answer.starts_with(r#"a=err("Syntax error in net.","1:"#),
        "{answer}"
    );
    assert_eq!(client.load(REJECTED), "rpinet1");
}

#[test]
fn net_with_unknown_session_belongs_to_none() {
    let mut client = Client::with_handshake(&controller());
    client.call(&format!(r#"a=nene("{ENDLESS}","s9")"#));
    let info = r#"a=ok({rpinet0:{description:"",end:"",last:"",rejected:[],rejection:[],session:"s0",state:"READY",successors:[]}})"#;
    assert_eq!(client.call("a=nin()"), info);
    let info = info.replace("last:", r#"failure:"",holders:[],last:"#);
    assert_eq!(client.call(r#"a=nin("rpinet0")"#), info);
}

#[test]
fn net_figures_omit_nets_never_ready() {
    let mut client = Client::with_handshake(&controller());
    let net = client.load(ENDLESS);
    client.load(REJECTED);
    let all = client.call("a=nst()");
    assert_eq!(client.call(&format!(r#"a=nst("{net}")"#)), all);
    for part in [
        "a=ok({rpinet0:{budget:0.800000,cost:0.0",
        ",cycles:0.000000,max:0.000000,mean:0.000000,min:0.000000,overbudget:0.000000",
        ",overruns:0.000000,period:1.000000,primitives:",
        ",thread:1.000000}})",
    ] {
        assert!(all.contains(part), "{all}");
    }
    let unknown = client.call(r#"a=nst("rpinet9")"#);
    assert!(unknown.starts_with("a=err("), "{unknown}");
}

#[test]
fn rejected_net_describes_its_faults() {
    let mut client = Client::with_handshake(&controller());
    let net = client.load(REJECTED);
    let watched = client.send(&format!(r#"w=gne("{net}",0.1)"#));
    assert_eq!(watched, [r#"w=ns("REJECTED")"#, "w=ok()"]);
    let info = client.call(&format!(r#"a=nin("{net}")"#));
    assert!(
        info.contains(r#"rejection:["1:4: there is no primitive `Core::Nope`"#),
        "{info}"
    );
}

#[test]
fn session_end_unloads_its_nets() {
    let controller = controller();
    let mut client = Client::with_handshake(&controller);
    client.call(r#"a=nse("x")"#);
    assert_eq!(client.connection.opened_sessions(), [SessionId(1)]);
    client.call(&format!(r#"a=nene("{PROBE}","s1")"#));
    client.send(r#"w=gne("rpinet0",60.0)"#);
    client.send(r#"s=gse("s1")"#);
    client.send(r#"a=nest("rpinet0")"#);
    client.pushes_until("outt");
    let ended = client.send(r#"a=ase("s1")"#);
    assert!(ended[0].starts_with("w=nc("), "{ended:?}");
    assert_eq!(
        ended[1..3],
        [r#"w=ns("TERMINATED")"#, r#"s=st({rpinet0:"TERMINATED"})"#]
    );
    assert_eq!(ended[3], ended[0], "the values again");
    let rest = [
        r#"w=ns("TERMINATED")"#,
        r#"s=st({rpinet0:"UNLOADED"})"#,
        "a=ok()",
    ];
    assert_eq!(ended[4..], rest);
    let repeated = client.pushes_until(r#"w=ns("UNLOADED")"#);
    assert_eq!(repeated.len(), 1, "{repeated:?}");
    assert_eq!(client.pushes(), Vec::<String>::new());
    assert!(client.connection.opened_sessions().is_empty());
    assert_eq!(client.call(r#"a=gse("s1")"#), r#"a=err("invalid session")"#);
    assert!(controller.nets().is_empty());
}

#[test]
fn clients_see_each_others_nets() {
    let controller = controller();
    let (mut one, mut other) = (
        Client::with_handshake(&controller),
        Client::with_handshake(&controller),
    );
    let net = one.load(ENDLESS);
    other.send(&format!(r#"w=gne("{net}",0.1)"#));
    one.send(&format!(r#"a=nest("{net}")"#));
    assert_eq!(other.pushes_until("RUNNING"), [r#"w=ns("RUNNING")"#]);
    one.send(&format!(r#"a=neab("{net}")"#));
    one.send(&format!(r#"a=neun("{net}")"#));
    assert_eq!(
        other.pushes_until("UNLOADED"),
        [r#"w=ns("TERMINATED")"#, r#"w=ns("UNLOADED")"#]
    );
}

#[test]
fn last_values_are_pushed_when_another_client_unloads() {
    let controller = controller();
    let (mut one, mut other) = (
        Client::with_handshake(&controller),
        Client::with_handshake(&controller),
    );
    let net = one.load(PROBE);
    other.send(&format!(r#"w=gne("{net}",60.0)"#));
    one.send(&format!(r#"a=nest("{net}")"#));
    other.pushes_until("outt");
    one.send(&format!(r#"a=snc({{{net}:{{ingain:"3.5"}}}})"#));
    one.send(&format!(r#"a=neca("{net}")"#));
    let ended = || controller.net(net.parse().unwrap()).unwrap().state();
    while ended() != takt_core::controller::NetState::Terminated {
        std::thread::sleep(Duration::from_millis(1));
    }
    one.send(&format!(r#"a=neun("{net}")"#));
    let pushed = other.pushes_until("UNLOADED");
    let last_values = pushed.iter().rfind(|line| line.starts_with("w=nc("));
    let complete = r#"w=nc({outecho:"3.5",outr0:"true",outt:"#;
    assert!(
        last_values.is_some_and(|line| line.starts_with(complete)),
        "{pushed:?}"
    );
    let end = [r#"w=ns("TERMINATED")"#, r#"w=ns("UNLOADED")"#];
    assert_eq!(pushed[pushed.len() - 2..], end);
    assert_eq!(
        one.call(&format!(r#"a=nest("{net}")"#)),
        r#"a=err("invalid net")"#
    );
}

/// The known client rarely unloads a net.
#[test]
fn oldest_ended_net_is_unloaded_when_full() {
    use takt_core::controller::NETS_MAX;
    let mut client = Client::with_handshake(&controller());
    let first = client.load(ENDLESS);
    let over = client.load(ENDLESS);
    client.send(&format!(r#"a=neab("{over}")"#));
    for _ in 2..NETS_MAX {
        client.load(ENDLESS);
    }
    client.send(&format!(r#"w=gne("{over}",0.1)"#));
    let loaded = client.send(&format!(r#"l=nene("{ENDLESS}")"#));
    let reply = format!(r#"l=ok("rpinet{NETS_MAX}")"#);
    assert_eq!(loaded, [r#"w=ns("TERMINATED")"#, reply.as_str()]);
    assert_eq!(client.pushes_until("UNLOADED"), [r#"w=ns("UNLOADED")"#]);
    let full = client.call(&format!(r#"a=nene("{ENDLESS}")"#));
    assert!(full.contains("loaded nets: at most 1024"), "{full}");
    assert_eq!(client.send(&format!(r#"a=nest("{first}")"#)), ["a=ok()"]);
}

#[test]
fn second_subscription_replaces_first() {
    let mut client = Client::with_handshake(&controller());
    let net = client.load(ENDLESS);
    client.send(&format!(r#"w=gne("{net}",0.1)"#));
    let again = client.send(&format!(r#"v=gne("{net}",0.1)"#));
    assert_eq!(again, [r#"v=ns("READY")"#, "v=ok()"]);
    let started = client.send(&format!(r#"a=nest("{net}")"#));
    assert_eq!(started, [r#"v=ns("RUNNING")"#, "a=ok()"]);
    assert_eq!(client.send("d=gde()").len(), 3);
    assert_eq!(client.send("e=gde()").len(), 3);
}

#[test]
fn snc_ignores_unknown_keys_rejects_bad_values() {
    let mut client = Client::with_handshake(&controller());
    let net = client.load(PROBE);
    assert_eq!(
        client.call(&format!(r#"a=snc({{{net}:{{innope:"1"}}}})"#)),
        "a=ok()"
    );
    let bad = client.call(&format!(r#"a=snc({{{net}:{{ingain:"x"}}}})"#));
    assert!(
        bad.starts_with(r#"a=err("net rpinet0, value ingain: "#),
        "{bad}"
    );
    // Nothing is written if one of the nets does not exist.
    let both = client.call(&format!(r#"a=snc({{{net}:{{ingain:"x"}},rpinet7:{{}}}})"#));
    assert_eq!(both, r#"a=err("invalidnetname")"#);
}

#[test]
fn any_cycle_time_is_handled() {
    let mut client = Client::with_handshake(&controller());
    let long = "9".repeat(300);
    for seconds in [
        "0.0000000001",
        "0.001",
        "0.0015",
        "0.5",
        "10000000000.0",
        &format!("{long}.0"),
    ] {
        let net = client.call(&format!(r#"a=nene("{PROBE}","s0","",{seconds},1)"#));
        let name = net.strip_prefix("a=ok(").unwrap();
        client.call(&format!("a=nest({name}"));
        let out = client.send(&format!("a=neab({name}"));
        assert_eq!(out, ["a=ok()"], "{seconds}");
    }
}

#[test]
fn connection_without_subscriptions_has_no_timeout() {
    let mut client = Client::with_handshake(&controller());
    assert_eq!(client.connection.poll_timeout(), Some(Duration::ZERO));
    client.pushes();
    assert_eq!(client.connection.poll_timeout(), None);
}

#[test]
fn random_lines_get_valid_replies() {
    let mut client = Client::with_handshake(&controller());
    let values = [
        "",
        "1",
        "0.5",
        r#""rpinet0""#,
        r#""s1""#,
        "[]",
        "{}",
        "{a:{b:1}}",
        "[[1]]",
    ];
    let commands = [
        "ver", "nse", "ase", "gse", "gde", "nene", "nest", "neca", "neab", "neun", "gne", "snc",
        "nin", "nst", "nesc", "gsy", "quit",
    ];
    for command in commands {
        for first in values {
            for second in values.iter().skip(1) {
                let args = if first.is_empty() {
                    String::new()
                } else {
                    format!("{first},{second}")
                };
                let out = client.send(&format!("a={command}({args})"));
                let reply = Message::decode(out.last().unwrap()).unwrap();
                assert!(matches!(reply.command.as_str(), "ok" | "err"), "{out:?}");
            }
        }
    }
}

#[test]
fn values_of_net_are_described_by_key() {
    let mut client = Client::with_handshake(&controller());
    let text = "{i=Core::DoubleNetcommIn(Key='speed', Value='1'), o=Core::DoubleNetcommOut(inValue=i.outValue, Key='o'), \
        x=Cancel(), outTerminate=x.outCancel}";
    let net = client.load(text);
    let call = format!(r#"a=nva("{net}")"#);
    assert_eq!(client.call(&call), r#"a=ok({inspeed:"1"},{})"#);
    client.call(&format!(r#"a=snc({{{net}:{{inspeed:"2.5"}}}})"#));
    assert_eq!(client.call(&call), r#"a=ok({inspeed:"2.5"},{})"#);
    assert_eq!(
        client.call(r#"a=nva("rpinet9")"#),
        r#"a=err("invalid net")"#
    );
}

#[test]
fn taps_are_read_in_order_of_cycles() {
    let mut client = Client::with_handshake(&controller());
    let text = "{i=Core::IntValue(Value='3'), a=Core::IntAdd(inFirst[1]=i.outValue), x=Cancel(), outTerminate=x.outCancel}";
    let net = client.load(text);
    let empty = client.call(&format!(r#"a=nta("{net}")"#));
    assert_eq!(empty, r#"a=ok(0.000000,["a.inFirst"],["Core::int"],[])"#);
    client.send(&format!(r#"a=nest("{net}")"#));
    let until = Instant::now() + Duration::from_secs(10);
    let (mut next, mut numbers) = (0.0, Vec::new());
    while numbers.len() < 20 {
        assert!(Instant::now() < until);
        let reply = client.call(&format!(r#"a=nta("{net}",{next:.1})"#));
        let args = Message::decode(&reply).unwrap().args;
        let [Value::Float(number), _, _, Value::List(records)] = &args[..] else {
            panic!("{reply}");
        };
        next = *number;
        for record in records {
            let [Value::Float(number), Value::String(_), Value::String(value)] =
                record.as_list().unwrap()
            else {
                panic!("{record}");
            };
            assert_eq!(value, "3");
            numbers.push(*number);
        }
    }
    assert!(numbers.is_sorted_by(|a, b| a < b), "{numbers:?}");
    let rejected = client.load("{a=Core::Clok(), outTerminate=a.outCancel}");
    assert_eq!(
        client.call(&format!(r#"a=nta("{rejected}")"#)),
        r#"a=err("the net is not ready and records nothing")"#
    );
}

#[test]
fn devices_are_described_with_limits_and_period() {
    let controller = controller();
    let parameters = [
        ("min_joint", "[-2,-2,-2,-2,-2,-2,-2]"),
        ("max_joint", "[2,2,2,2,2,2,2.5]"),
        ("max_vel", "[1,1,1,1,1,1,1]"),
        ("max_acc", "[4,4,4,4,4,4,4]"),
    ];
    let parameters = parameters.map(|(key, value)| (key.to_owned(), value.to_owned()));
    controller
        .add_device("left", "kuka_lwr_sim", &parameters.into())
        .unwrap();
    let mut client = Client::with_handshake(&controller);
    let reply = client.call(r#"a=din("left")"#);
    for part in [
        r#"type:"kuka_lwr_sim""#,
        r#"state:"#,
        r#"period:"0.001""#,
        r#"{acceleration_max:"4",jerk_max:"40",position_max:"2.5",position_min:"-2",velocity_max:"1"}]"#,
    ] {
        assert!(reply.contains(part), "{part} is missing in {reply}");
    }
    assert!(client.call("a=din()").contains("left:{"));
    assert_eq!(
        client.call(r#"a=din("right")"#),
        r#"a=err("invalid device")"#
    );
}

#[test]
fn net_is_evaluated_once_over_directio() {
    let mut client = Client::with_handshake(&controller());
    let net = "{o=Core::DoubleNetcommOut(Value='1.5',Key='x')}";
    assert_eq!(
        client.call(&format!(r#"a=eva("{net}")"#)),
        r#"a=ok({outx:"1.5"})"#
    );
    let rejected = client.call(r#"a=eva("{o=Core::Nothing()}")"#);
    assert!(
        rejected.starts_with(r#"a=err("net rejected","#),
        "{rejected}"
    );
}
