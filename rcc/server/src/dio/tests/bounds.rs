//! What a client cannot exceed.

use super::super::limits::SUBSCRIPTIONS_MAX;
use super::super::pace::Pace;
use super::*;

#[test]
fn subscriptions_are_bounded() {
    let controller = controller();
    let mut client = Client::with_handshake(&controller);
    let net = client.load(ENDLESS);
    let watch = |n| {
        (
            NetId(n),
            NetWatch::new("w".to_owned(), VALUES_INTERVAL, Pace::Every, 0),
        )
    };
    let count = u32::try_from(SUBSCRIPTIONS_MAX).unwrap();
    client.connection.nets.extend((1..=count).map(watch));
    let refused = client
        .connection
        .handle_line(&format!(r#"a=gne("{net}",0.1)"#), client.now);
    let refused = refused.last().unwrap();
    assert!(
        refused.contains("too many subscriptions: a connection has at most 4096"),
        "{refused}"
    );
}

#[test]
fn descriptions_are_bounded() {
    let mut client = Client::with_handshake(&controller());
    let long = "x".repeat(4097);
    let refused = r#"a=err("the description has 4097 bytes; at most 4096 are taken")"#;
    assert_eq!(client.call(&format!(r#"a=nse("{long}")"#)), refused);
    assert_eq!(
        client.call(&format!(r#"a=nene("{ENDLESS}","s1","{long}")"#)),
        refused
    );
    assert_eq!(
        client.call(&format!(r#"a=nse("{}")"#, &long[1..])),
        r#"a=ok("s1")"#
    );
}

#[test]
fn net_with_many_faults_lists_first_20() {
    let mut client = Client::with_handshake(&controller());
    let children: String = (0..100).map(|n| format!("c{n}=No{n}(),")).collect();
    let net = client.load(&format!("{{{children}outTerminate=c0.outValue}}"));
    let info = client.call(&format!(r#"a=nin("{net}")"#));
    assert!(
        info.contains("`No19`") && !info.contains("`No20`"),
        "{info}"
    );
    assert!(info.contains(r#""and 80 more"]"#), "{info}");
}
