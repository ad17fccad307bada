//! State machines over DirectIO: every command, and what is wrong with it.

use super::*;

/// A component with a property, an operation that is complete at once, and an out value.
const COUNTER: &str = "component Counter {
      property step: int range 0 .. 10 default 1 live;
      in bias: int;
      out count: int;
      operation clear(to: int range 0 .. 100);
    }
    { step=Core::IntNetcommIn(Key='step', Value='$step'), bias=Core::IntNetcommIn(Key='bias'),
      calls=Core::IntNetcommIn(Key='clear'), to=Core::IntNetcommIn(Key='clear_to'),
      sum=Core::IntAdd(inFirst=step.outValue, inSecond=to.outValue),
      count=Core::IntNetcommOut(inValue=sum.outValue, Key='count'),
      cancel=Cancel(), outTerminate=cancel.outCancel }";

const MACHINE: &str = "machine M {
      component c from \"c\" started;
      component idle from \"c\";
      param first: int = 1;
      event go; event end;
      stop on end within 10s;
      initial state A { transition on go to B; transition on end to Z; }
      state B { entry { c.step := first; } transition on end to Z; transition on error to Z; }
      final state Z { entry { stop c; stop idle; wait 20ms; } }
      machine inner { initial final state I { } }
    }";

fn quoted(text: &str) -> String {
    text.replace('"', "\\\"").replace('\n', " ")
}

fn load_line(more: &str) -> String {
    format!(
        r#"m=mane("{}",{{c:"{}"}}{more})"#,
        quoted(MACHINE),
        quoted(COUNTER)
    )
}

/// A client with the machine, loaded in a session of its own.
fn loaded(controller: &Controller) -> (Client, String) {
    let mut client = Client::with_handshake(controller);
    let session = client.call(r#"s=nse("machines")"#);
    let session = session.strip_prefix("s=ok(\"").unwrap();
    let session = session.strip_suffix("\")").unwrap().to_owned();
    let more = format!(r#","{session}",{{first:"7"}},{{c:"step = 3"}}"#);
    assert_eq!(client.call(&load_line(&more)), r#"m=ok("M")"#);
    (client, session)
}

impl Client {
    /// Asks until the description of the machines contains a text.
    fn described(&mut self, text: &str) -> String {
        for _ in 0..5_000 {
            let answer = self.call("i=main()");
            if answer.contains(text) {
                return answer;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        panic!("{text} is missing in {}", self.call("i=main()"));
    }
}

#[test]
fn machine_is_loaded_commanded_and_ended() {
    let controller = controller();
    let (mut client, session) = loaded(&controller);
    let all = client.call("i=main()");
    for part in [
        r#"status:"inactive""#,
        &format!(r#"session:"{session}""#),
        r#"first:"7""#,
        r#"phase:"running""#,
        r#"phase:"pre_operational""#,
        "step_cost_us:",
    ] {
        assert!(all.contains(part), "{part}: {all}");
    }
    assert_eq!(client.call(r#"a=maco("M","start")"#), "a=ok()");
    client.described(r#"state:"A""#);
    assert_eq!(
        client.call(r#"a=maco("M","c.clear(4); c.step := 2; raise go")"#),
        "a=ok()"
    );
    let one = client.described(r#"state:"B""#);
    assert!(one.contains(r#"transitions:"1""#), "{one}");
    let picture = client.call(r#"g=magr("M")"#);
    assert!(picture.starts_with(r#"g=ok("<svg"#), "{picture}");
    assert!(client.call(r#"g=magr("M","inner")"#).contains(">I</text>"));
    // The final state is entered, and takes 20 ms.
    assert_eq!(client.call(r#"e=maen("M")"#), "e=ok()");
    assert_eq!(client.call("i=main()"), "i=ok({})");
    assert!(client.call(r#"i=main("M")"#).starts_with("i=err("));
}

#[test]
fn machine_of_ended_session_runs_its_final_state() {
    let controller = controller();
    let (mut client, session) = loaded(&controller);
    assert_eq!(client.call(r#"a=maco("M","start")"#), "a=ok()");
    client.described(r#"state:"A""#);
    let watching = controller.clone();
    let seen = std::thread::spawn(move || {
        for _ in 0..5_000 {
            match watching.machine("M") {
                Ok(machine) if machine.state() == "Z" => return true,
                Ok(_) => std::thread::sleep(Duration::from_millis(1)),
                Err(_) => return false,
            }
        }
        false
    });
    assert!(
        client
            .send(&format!(r#"e=ase("{session}")"#))
            .contains(&"e=ok()".to_owned())
    );
    assert!(seen.join().unwrap(), "the final state");
    assert!(controller.machines().is_empty() && controller.nets().is_empty());
}

/// A net that was being loaded for a component is unloaded when it is there.
fn wait_until_unloaded(controller: &Controller) {
    for _ in 0..5_000 {
        if controller.nets().is_empty() {
            return;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    panic!("{:?} are left", controller.nets());
}

#[test]
fn machine_commands_with_errors_are_refused() {
    let controller = controller();
    let (mut client, session) = loaded(&controller);
    let long = format!("c {{ {} }}", "step := 1; ".repeat(9));
    let mut wrong = Vec::new();
    for (line, cause) in [
        // Loading: malformed, a missing file, a property out of range, unknown names, another client's session.
        (
            r#"m=mane("machine {",{})"#.to_owned(),
            "the name of the machine",
        ),
        (
            r#"m=mane("machine N { component c from \"d\"; }",{})"#.to_owned(),
            "the file d was not sent",
        ),
        (load_line(r#","",{},{c:"step = 11"}"#), "invalid session"),
        (
            load_line(&format!(r#","{session}",{{}},{{}}"#)),
            "a machine `M` is loaded already",
        ),
        (
            load_line("")
                .replace("machine M", "machine N")
                .replace("range 0 .. 10 default 1", "range 0 .. 10 default 11"),
            "11 is not in the range",
        ),
        (r#"m=mane(1)"#.to_owned(), "arameter"),
        (r#"m=mane()"#.to_owned(), "arameter"),
        // Commands.
        (
            r#"a=maco("N","start")"#.to_owned(),
            "there is no machine `N`",
        ),
        (r#"a=maco("M","c.gone()")"#.to_owned(), "gone"),
        (
            r#"a=maco("M","c.step := 11")"#.to_owned(),
            "11 is not in the range 0 to 10",
        ),
        (
            r#"a=maco("M","idle.start()")"#.to_owned(),
            "`start` is not allowed while the component is pre_operational",
        ),
        (r#"a=maco("M","idle.clear(1)")"#.to_owned(), "does not run"),
        (
            r#"a=maco("M","c.clear(101)")"#.to_owned(),
            "101 is not in the range 0 to 100",
        ),
        (
            r#"a=maco("M","M.pause()")"#.to_owned(),
            "`pause` is not possible while the machine is inactive",
        ),
        (r#"a=maco("M","raise nowhere")"#.to_owned(), "nowhere"),
        (r#"a=maco("M","enter Nowhere")"#.to_owned(), "Nowhere"),
        (format!(r#"a=maco("M","{long}")"#), "step"),
        (r#"a=maco("M")"#.to_owned(), "arameter"),
        (r#"g=magr("M","N")"#.to_owned(), "invalid machine"),
        (r#"g=magr("N")"#.to_owned(), "there is no machine `N`"),
        (r#"i=main("N")"#.to_owned(), "there is no machine `N`"),
        (r#"e=maen("N")"#.to_owned(), "there is no machine `N`"),
    ] {
        let answer = client.call(&line);
        if !answer.contains("=err(") || !answer.contains(cause) {
            wrong.push(format!("{cause}: {line}: {answer}"));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
    // Nothing of that has changed it.
    assert!(client.call("i=main()").contains(r#"status:"inactive""#));
    assert_eq!(client.call(r#"e=maen("M")"#), "e=ok()");
    wait_until_unloaded(&controller);
}
