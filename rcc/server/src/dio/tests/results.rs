//! Boolean results reach clients at the change, and one command loads or schedules and subscribes.

use std::sync::mpsc;

use super::*;

/// A Boolean and a number that a client writes.
const ECHO: &str = "{i=Core::BooleanNetcommIn(Key='ask',Value='false'),\
    o=Core::BooleanNetcommOut(inValue=i.outValue,Key='answer'),\
    j=Core::DoubleNetcommIn(Key='number',Value='0'),\
    e=Core::DoubleNetcommOut(inValue=j.outValue,Key='echo'),\
    x=Cancel(),outTerminate=x.outCancel}";

/// Until the next announced change that `wanted` selects.
fn wait_for(changes: &mpsc::Receiver<Changed>, wanted: Changed) {
    let timeout = Duration::from_secs(10);
    while changes.recv_timeout(timeout).unwrap() != wanted {}
}

#[test]
fn boolean_is_pushed_at_change_number_at_refresh() {
    let controller = controller();
    let mut client = Client::with_handshake(&controller);
    let load = format!(r#"l=nene("{ECHO}","","",0.0,1,60.0,"every")"#);
    let out = client.send(&load);
    assert_eq!(out, [r#"l=ns("READY")"#, r#"l=ok("rpinet0","READY")"#]);
    client.send(r#"s=nest("rpinet0")"#);
    client.pushes_until("outanswer");
    let (send, changes) = mpsc::channel();
    let _watch = controller.on_change(move |change| {
        let _ = send.send(change);
    });
    // Far from the time at which values are polled.
    client.now += Duration::from_secs(30);
    client.connection.poll_pushes(client.now);
    client.now += Duration::from_millis(1);
    assert!(client.connection.wants_results());
    client.send(r#"w=snc({rpinet0:{inask:"true",innumber:"5"}})"#);
    let pushed = loop {
        // The first one may be that of the start of the net.
        wait_for(&changes, Changed::Results);
        client.connection.handle_change(Changed::Results);
        assert_eq!(client.connection.poll_timeout(), Some(Duration::ZERO));
        let pushed = client.connection.poll_pushes(client.now);
        if !pushed.is_empty() {
            break pushed;
        }
    };
    assert_eq!(pushed, [r#"l=nc({outanswer:"true"})"#]);
    client.connection.handle_change(Changed::Results);
    assert_eq!(client.connection.poll_pushes(client.now).len(), 0);
}

#[test]
fn known_client_receives_booleans_at_its_pace() {
    let controller = controller();
    let mut client = Client::with_handshake(&controller);
    client.send(&format!(r#"l=nene("{ECHO}","","",0.0,1,60.0)"#));
    client.send(r#"s=nest("rpinet0")"#);
    client.pushes_until("outanswer");
    let (send, changes) = mpsc::channel();
    let _watch = controller.on_change(move |change| {
        let _ = send.send(change);
    });
    client.send(r#"w=snc({rpinet0:{inask:"true"}})"#);
    wait_for(&changes, Changed::Results);
    client.now += Duration::from_millis(1);
    assert!(!client.connection.wants_results());
    client.connection.handle_change(Changed::Results);
    assert_eq!(client.connection.poll_pushes(client.now).len(), 0);
}

#[test]
fn rejected_net_reports_state_in_reply() {
    let mut client = Client::with_handshake(&controller());
    let out = client.send(&format!(r#"l=nene("{REJECTED}","","",0.0,1,0.1,"every")"#));
    assert_eq!(
        out,
        [r#"l=ns("REJECTED")"#, r#"l=ok("rpinet0","REJECTED")"#]
    );
    let wrong = client.call(&format!(r#"l=nene("{ECHO}","","",0.0,1,1)"#));
    assert_eq!(wrong, r#"l=err("Parameter type does not match")"#);
    let wrong = client.call(&format!(r#"l=nene("{ECHO}","","",0.0,1,0.1,"soon")"#));
    assert!(wrong.starts_with("l=err("), "{wrong}");
    assert_eq!(client.load(ECHO), "rpinet1", "nothing was loaded");
}

#[test]
fn rule_is_scheduled_and_subscribed_by_one_command() {
    let mut client = Client::with_handshake(&controller());
    let net = client.load(ENDLESS);
    let out = client.send(&format!(r#"r=nesc("t",[],[],["{net}"],"",1)"#));
    assert_eq!(out.last().unwrap(), r#"r=ok("0")"#);
    client.seen.extend(out);
    let begin = Instant::now();
    while !client.seen.iter().any(|line| line == r#"r=rs("FIRED")"#) {
        assert!(
            begin.elapsed() < Duration::from_secs(10),
            "{:?}",
            client.seen
        );
        client.pushes();
    }
    let plain = client.load(ENDLESS);
    let out = client.send(&format!(r#"p=nesc("t",[],[],["{plain}"],"",0)"#));
    assert_eq!(out, [r#"p=ok("1")"#]);
}
