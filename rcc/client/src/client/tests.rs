//! The client against a peer written here: replies out of order, pushes between them, bad lines, lost connections.

use std::io::{BufRead as _, BufReader};
use std::net::TcpListener;
use std::sync::mpsc;
use std::thread;

use super::*;

/// A peer that shakes hands and then runs `body` with the lines received and the stream to write to.
fn peer(body: impl FnOnce(BufReader<TcpStream>, TcpStream) + Send + 'static) -> Client {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let mut lines = BufReader::new(stream.try_clone().unwrap());
        let tag = command(&mut lines).tag;
        stream
            .write_all(format!("{tag}=ok(\"handshake ok\")\n").as_bytes())
            .unwrap();
        body(lines, stream);
    });
    Client::connect(&address).unwrap()
}

fn command(lines: &mut BufReader<TcpStream>) -> Message {
    let mut line = String::new();
    lines.read_line(&mut line).unwrap();
    Message::decode(line.trim_end()).unwrap()
}

#[test]
fn replies_in_reverse_order_reach_their_callers() {
    let client = peer(|mut lines, mut stream| {
        let commands: Vec<_> = (0..8).map(|_| command(&mut lines)).collect();
        for command in commands.iter().rev() {
            let Some(Value::String(text)) = command.args.first() else {
                panic!("{command}");
            };
            let reply = Message::new(command.tag.as_str(), "ok").with(text.as_str());
            stream.write_all(format!("{reply}\n").as_bytes()).unwrap();
        }
        // Until the client closes.
        let _ = lines.read_line(&mut String::new());
    });
    let callers: Vec<_> = (0..8)
        .map(|number| {
            let client = client.clone();
            thread::spawn(move || {
                let text = format!("call {number}");
                let reply = client.call("nse", [text.as_str()]).unwrap();
                assert_eq!(reply.text(), Some(text.as_str()));
            })
        })
        .collect();
    for caller in callers {
        caller.join().unwrap();
    }
}

#[test]
fn pushes_before_a_reply_are_queued_in_order() {
    let client = peer(|mut lines, mut stream| {
        let tag = command(&mut lines).tag;
        let text =
            format!("{tag}=ns(\"READY\")\n{tag}=nc({{}})\n{tag}=ok()\n{tag}=ns(\"RUNNING\")\n");
        stream.write_all(text.as_bytes()).unwrap();
        let _ = lines.read_line(&mut String::new());
    });
    let tag = client.call("gne", ["rpinet0"]).unwrap().tag;
    let next = || {
        client
            .next_push(Duration::from_secs(5))
            .unwrap()
            .unwrap()
            .to_string()
    };
    let pushes = [next(), next(), next()];
    let expected =
        ["ns(\"READY\")", "nc({})", "ns(\"RUNNING\")"].map(|push| format!("{tag}={push}"));
    assert_eq!(pushes, expected);
    assert_eq!(client.next_push(Duration::ZERO).unwrap(), None);
}

#[test]
fn rejected_command_reports_the_text() {
    let client = peer(|mut lines, mut stream| {
        let tag = command(&mut lines).tag;
        stream
            .write_all(format!("{tag}=err(\"invalid net\",\"rpinet9\")\n").as_bytes())
            .unwrap();
        let _ = lines.read_line(&mut String::new());
    });
    let error = client.call("nest", ["rpinet9"]).unwrap_err();
    assert_eq!(error.to_string(), "invalid net: rpinet9 (`nest`)");
}

#[test]
fn lost_connection_ends_all_waiting_calls() {
    let (hang_up, wait) = mpsc::channel::<()>();
    let client = peer(move |mut lines, stream| {
        for _ in 0..2 {
            command(&mut lines);
        }
        wait.recv().unwrap();
        drop((lines, stream));
    });
    let callers: Vec<_> = (0..2)
        .map(|_| {
            let client = client.clone();
            thread::spawn(move || client.call("gde", [] as [&str; 0]).unwrap_err())
        })
        .collect();
    hang_up.send(()).unwrap();
    for caller in callers {
        let error = caller.join().unwrap();
        assert!(matches!(error, Error::Closed { .. }), "{error}");
    }
    let error = client.next_push(Duration::from_secs(5)).unwrap_err();
    assert!(matches!(error, Error::Closed { .. }), "{error}");
    assert!(client.call("gde", [] as [&str; 0]).is_err());
}

#[test]
fn pushes_before_the_end_are_still_received() {
    let client = peer(|_, mut stream| {
        stream
            .write_all(b"t1=ns(\"TERMINATED\")\nnone=err(\"bye\")\n")
            .unwrap();
    });
    let push = client.next_push(Duration::from_secs(5)).unwrap().unwrap();
    assert_eq!(push.to_string(), "t1=ns(\"TERMINATED\")");
    let error = client
        .next_push(Duration::from_secs(5))
        .unwrap_err()
        .to_string();
    assert!(
        error.ends_with("closed the connection after `none=err(\"bye\")`"),
        "{error}"
    );
}

#[test]
fn invalid_line_ends_the_connection_with_its_cause() {
    let client = peer(|mut lines, mut stream| {
        stream.write_all(b"what is this\n").unwrap();
        let _ = lines.read_line(&mut String::new());
    });
    let error = client
        .next_push(Duration::from_secs(5))
        .unwrap_err()
        .to_string();
    assert!(error.contains("`=` is expected at byte 5"), "{error}");
}

#[test]
fn unread_pushes_are_bounded() {
    let client = peer(|mut lines, mut stream| {
        let push = "t1=ns(\"READY\")\n".repeat(PUSHES_MAX + 1);
        // The client hangs up before it has received everything.
        let _ = stream.write_all(push.as_bytes());
        let _ = lines.read_line(&mut String::new());
    });
    let error = loop {
        if let Err(error) = client.call("gde", [] as [&str; 0]) {
            break error;
        }
    };
    assert!(matches!(error, Error::Unread { .. }), "{error}");
}

#[test]
fn last_clone_dropped_closes_the_connection() {
    let (send, closed) = mpsc::channel();
    let client = peer(move |mut lines, _stream| {
        let count = lines.read_line(&mut String::new()).unwrap();
        send.send(count).unwrap();
    });
    drop(client.clone());
    assert!(closed.recv_timeout(Duration::from_millis(10)).is_err());
    drop(client);
    assert_eq!(closed.recv_timeout(Duration::from_secs(5)), Ok(0));
}

#[test]
fn refusal_conflict_has_fields_beside_its_text() {
    let client = peer(|mut lines, mut stream| {
        for values in [
            r#""net start failed","why",{resource:"left_Joint_2",holder:"net rpinet3"}"#,
            r#""net start failed","why",{resource:"left_Base"}"#,
            // A controller of an older version, and fields of another kind.
            r#""net start failed","why""#,
            r#""net start failed","why",{resource:1}"#,
        ] {
            let tag = command(&mut lines).tag;
            let reply = format!("{tag}=err({values})\n");
            stream.write_all(reply.as_bytes()).unwrap();
        }
        let _ = lines.read_line(&mut String::new());
    });
    let refused = || match client.call("nest", ["rpinet1"]) {
        Err(Error::Refused { text, conflict, .. }) => {
            assert_eq!(text, "net start failed: why");
            conflict
        }
        other => panic!("{other:?}"),
    };
    let conflict = |resource: &str, holder: Option<&str>| {
        Some(Conflict {
            resource: resource.to_owned(),
            holder: holder.map(str::to_owned),
        })
    };
    assert_eq!(refused(), conflict("left_Joint_2", Some("net rpinet3")));
    assert_eq!(refused(), conflict("left_Base", None));
    assert_eq!(refused(), None);
    assert_eq!(refused(), None);
}

#[test]
fn late_reply_is_taken_for_no_other_command() {
    let mut inbox = Inbox::default();
    assert!(inbox.expect_reply("f"));
    assert!(!inbox.expect_reply("f"), "its reply is awaited");
    inbox.end_wait("f", true);
    assert!(!inbox.expect_reply("f"), "its reply may still come");
    inbox.handle(Message::new("f", "ok").with("late"));
    assert!(inbox.pushes.is_empty());
    assert!(inbox.expect_reply("f"));
    inbox.handle(Message::new("f", "ok").with("in time"));
    inbox.end_wait("f", false);
    assert!(inbox.expect_reply("f"));
    // Own tags pass by those of the caller.
    assert!(inbox.expect_reply("t0"));
    assert_eq!(inbox.new_tag(), "t1");
}
