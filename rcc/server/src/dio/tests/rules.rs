//! Synchronization rules as the known client uses them.

use super::*;

/// Sets `r0` after `seconds`, and never ends by itself.
fn lasting(seconds: f64) -> String {
    format!(
        "{{c=Core::Clock(),g=Core::DoubleGreater(inFirst=c.outValue,Second='{seconds}'),\
         r=Core::BooleanNetcommOut(inValue=g.outValue,Key='r0'),\
         x=Cancel(),k=Core::BooleanNetcommOut(inValue=x.outCancel,Key='cancelled'),\
         f=Core::BooleanValue(Value='false'),outTerminate=f.outValue}}"
    )
}

fn of_tag<'a>(tag: &str, lines: &'a [String]) -> Vec<&'a str> {
    let mine = lines.iter().filter(|l| l.starts_with(&format!("{tag}=")));
    mine.map(String::as_str).collect()
}

impl Client {
    /// Waits until each of `texts` was pushed, possibly before a reply; returns all lines received.
    fn wait_for(&mut self, texts: &[&str]) -> Vec<String> {
        for _ in 0..10_000 {
            self.pushes();
            if texts
                .iter()
                .all(|t| self.seen.iter().any(|l| l.contains(t)))
            {
                return self.seen.clone();
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        panic!("not all of {texts:?} were pushed; received {:?}", self.seen);
    }

    /// Installs a rule; returns its number.
    fn rule(&mut self, args: &str) -> String {
        let out = self.send(&format!("n=nesc({args})"));
        let answer = out.last().unwrap();
        let number = answer.strip_prefix("n=ok(\"").unwrap();
        number.strip_suffix("\")").unwrap().to_owned()
    }
}

/// The captured exchange with rules. Two nets are started before, so the rule's number is 2.
#[test]
fn captured_rule_exchange() {
    let mut client = Client::with_handshake(&controller());
    client.call(r#"c4=nse("probe@host")"#);
    for (net, watch) in [("rpinet0", "c6"), ("rpinet1", "c13"), ("rpinet2", "c14")] {
        let load = format!(r#"l=nene("{PROBE}","s1","probe net",0.0,1)"#);
        assert_eq!(client.call(&load), format!(r#"l=ok("{net}")"#));
        let watched = client.send(&format!(r#"{watch}=gne("{net}",60.0)"#));
        let expected = [format!(r#"{watch}=ns("READY")"#), format!("{watch}=ok()")];
        assert_eq!(watched, expected);
    }
    client.send(r#"c7=nest("rpinet0")"#);
    client.send(r#"c8=neab("rpinet0")"#);
    let started = [r#"c13=ns("RUNNING")"#, "c16=ok()"];
    assert_eq!(client.send(r#"c16=nest("rpinet1")"#), started);
    let rule = r#"c17=nesc("rpinet1.outr0",["rpinet1"],[],["rpinet2"],"chain")"#;
    let scheduled: Vec<_> = client.send(rule);
    let scheduled: Vec<_> = scheduled.iter().filter(|l| !l.contains("=nc(")).collect();
    assert_eq!(scheduled, [r#"c14=ns("SCHEDULED")"#, r#"c17=ok("2")"#]);
    let watched = [r#"c18=rs("ACTIVE")"#, "c18=ok()"];
    assert_eq!(client.send(r#"c18=gsy("2")"#), watched);
    let ends = [
        r#"c13=ns("TERMINATED")"#,
        r#"c14=ns("RUNNING")"#,
        r#"c18=rs("FIRED")"#,
    ];
    let seen = client.wait_for(&ends);
    let predecessor = of_tag("c13", &seen);
    let [.., values, end] = predecessor[..] else {
        panic!("{seen:?}")
    };
    assert!(
        values.starts_with(r#"c13=nc({outecho:"2",outr0:"true",outt:"1.0"#),
        "{seen:?}"
    );
    assert_eq!(end, ends[0]);
    let successor = of_tag("c14", &seen);
    assert_eq!(successor[3..4], [ends[1]], "{seen:?}");
    assert_eq!(of_tag("c18", &seen).last(), Some(&ends[2]));
    client.wait_for(&["c14=nc("]);
    let aborted = client.send(r#"c19=neab("rpinet2")"#);
    assert!(
        aborted[0].starts_with(r#"c14=nc({outecho:"2",outr0:"false",outt:"#),
        "{aborted:?}"
    );
    assert_eq!(aborted[1..], [r#"c14=ns("TERMINATED")"#, "c19=ok()"]);
}

#[test]
fn invalid_rules_are_rejected_with_reason() {
    let mut client = Client::with_handshake(&controller());
    let net = client.load(&lasting(9.0));
    let mut refused = |args: String| client.call(&format!("a=nesc({args})"));
    for lists in [
        r#"["rpinet9"],[],[]"#,
        r#"[],["x"],[]"#,
        r#"[],[],["rpinet9"]"#,
    ] {
        let answer = refused(format!(r#""t",{lists}"#));
        assert_eq!(answer, r#"a=err("invalid netname")"#);
    }
    for (condition, reason) in [
        (
            "a b c",
            "condition: column 3: `.` and a key is expected here, not `b`",
        ),
        ("", "condition: column 1"),
        ("rpinet9.outr0", "condition: there is no net `rpinet9`"),
        (
            "rpinet0.outnone",
            "condition: rpinet0 has no value `outnone`",
        ),
    ] {
        let answer = refused(format!(r#""{condition}",[],[],["{net}"]"#));
        let expected = format!(r#"a=err("scheduling not possible","{reason}"#);
        assert!(answer.starts_with(&expected), "{answer}");
    }
    let twice = refused(format!(r#""t",[],[],["{net}","{net}"]"#));
    assert!(
        twice.starts_with(r#"a=err("scheduling not possible","net rpinet0 is READY; "#),
        "{twice}"
    );
    for args in [
        r#""t",[],["#,
        r#""t",1,[],[]"#,
        r#""t",[1],[],[]"#,
        "1,[],[],[]",
    ] {
        let answer = refused(args.to_owned());
        assert!(answer.contains("err("), "{answer}");
    }
    assert_eq!(
        refused(r#""t",[]"#.to_owned()),
        r#"a=err("Parameter missing")"#
    );
    let long = "x".repeat(4097);
    assert!(refused(format!(r#""t",[],[],[],"{long}""#)).contains("at most 4096"));
    for rule in ["", "7", "x", "-1"] {
        let answer = client.call(&format!(r#"a=gsy("{rule}")"#));
        assert_eq!(answer, r#"a=err("Invalid synchronization rule")"#);
    }
}

/// The known client's nets never terminate by themselves: their own rules end them.
#[test]
fn nets_end_by_their_own_rules() {
    let mut client = Client::with_handshake(&controller());
    let net = client.load(&lasting(0.02));
    client.send(&format!(r#"w=gne("{net}",0.02)"#));
    let own = client.rule(&format!(r#""{net}.outr0",["{net}"],[],[],"result""#));
    let start = client.rule(&format!(r#""t",[],[],["{net}"],"start""#));
    client.send(&format!(r#"o=gsy("{own}")"#));
    client.send(&format!(r#"s=gsy("{start}")"#));
    let seen = client.wait_for(&[r#"w=ns("TERMINATED")"#, r#"o=rs("FIRED")"#]);
    assert!(of_tag("s", &seen).contains(&r#"s=rs("FIRED")"#), "{seen:?}");
    let values = seen.iter().rfind(|l| l.starts_with("w=nc(")).unwrap();
    assert!(values.contains(r#"outr0:"true""#), "{values}");
}

/// The known client chains motions like this, with the second sent long after the first has ended.
#[test]
fn rule_on_ended_net_is_decided_at_once() {
    let mut client = Client::with_handshake(&controller());
    let (first, second) = (client.load(&lasting(0.0)), client.load(&lasting(0.0)));
    client.send(&format!(r#"v=gne("{first}",0.02)"#));
    client.send(&format!(r#"w=gne("{second}",0.02)"#));
    client.rule(&format!(r#""{first}.outr0",["{first}"],[],[]"#));
    client.rule(&format!(r#""t",[],[],["{first}"]"#));
    client.wait_for(&[r#"v=ns("TERMINATED")"#]);
    let chain = client.rule(&format!(r#""{first}.outr0",["{first}"],[],["{second}"]"#));
    let never = client.rule(&format!(r#""!{first}.outr0",[],[],[]"#));
    client.send(&format!(r#"c=gsy("{chain}")"#));
    client.send(&format!(r#"n=gsy("{never}")"#));
    let decided = [
        r#"c=rs("FIRED")"#,
        r#"n=rs("INACTIVE")"#,
        r#"w=ns("RUNNING")"#,
    ];
    client.wait_for(&decided);
}

/// Both rules start the same net in the same cycle; the second fails.
#[test]
fn rule_fails_if_net_already_started() {
    let mut client = Client::with_handshake(&controller());
    let (first, second) = (client.load(&lasting(0.02)), client.load(&lasting(9.0)));
    let rule = format!(r#""{first}.outr0",[],[],["{second}"]"#);
    let (one, other) = (client.rule(&rule), client.rule(&rule));
    client.send(&format!(r#"o=gsy("{one}")"#));
    client.send(&format!(r#"p=gsy("{other}")"#));
    client.send(&format!(r#"a=nest("{first}")"#));
    let seen = client.wait_for(&[r#"o=rs("FIRED")"#, r#"p=rs("FIREFAILED")"#]);
    assert_eq!(of_tag("p", &seen).len(), 3, "{seen:?}");
}

/// The known client cancels and aborts like this.
#[test]
fn immediate_rules_cancel_and_stop() {
    let mut client = Client::with_handshake(&controller());
    let net = client.load(&lasting(9.0));
    client.send(&format!(r#"w=gne("{net}",0.02)"#));
    client.send(&format!(r#"a=nest("{net}")"#));
    client.rule(&format!(r#""t",[],["{net}"],[]"#));
    let seen = client.wait_for(&[r#"w=ns("CANCELLING")"#, r#"outcancelled:"true""#]);
    assert!(!seen.iter().any(|l| l.contains("TERMINATED")), "{seen:?}");
    client.rule(&format!(r#""t",["{net}"],[],[]"#));
    client.wait_for(&[r#"w=ns("TERMINATED")"#]);
}

/// A decided rule does not count as a subscription: the known client never ends one.
#[test]
fn subscription_ends_with_its_rule() {
    let mut client = Client::with_handshake(&controller());
    let net = client.load(&lasting(9.0));
    let rule = client.rule(&format!(r#""{net}.outr0",[],[],[]"#));
    client.send(&format!(r#"r=gsy("{rule}")"#));
    assert_eq!(client.connection.rules.len(), 1);
    client.send(&format!(r#"a=nest("{net}")"#));
    client.send(&format!(r#"a=neab("{net}")"#));
    client.wait_for(&[r#"r=rs("INACTIVE")"#]);
    assert!(client.connection.rules.is_empty());
}
