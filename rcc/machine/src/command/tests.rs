//! Text commands against the machine of the examples.

use super::*;

fn program() -> Program {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/machine");
    let text = std::fs::read_to_string(folder.join("lola.machine")).unwrap();
    let library =
        |name: &str| std::fs::read_to_string(folder.join(name)).map_err(|e| e.to_string());
    Program::compile(&text, &library).unwrap().0
}

#[test]
fn commands_of_each_kind_are_parsed() {
    let program = program();
    let text = "servo.gain := 2; servo { gain := -0.5; use_trajectory := true }\n\
        trajectory.start() robot.release_brakes(); raise abort; enter MoveRobot; enter Lola.StopRobot\n\
        Lola.pause() # a comment";
    let commands = parse(text, &program).unwrap();
    let commands: Vec<_> = commands.into_iter().map(|placed| placed.command).collect();
    let expected = [
        Command::Set(3, vec![("gain".into(), Data::Int(2))]),
        Command::Set(
            3,
            vec![
                ("gain".into(), Data::Double(-0.5)),
                ("use_trajectory".into(), Data::Bool(true)),
            ],
        ),
        Command::Request(1, Request::Start),
        Command::Call(4, 0, Vec::new()),
        Command::Raise(1),
        Command::Enter(0, 3),
        Command::Enter(0, 4),
        Command::Control(0, Control::Pause),
    ];
    assert_eq!(commands, expected);
}

#[test]
fn commands_with_errors_are_all_reported() {
    let program = program();
    for (text, cause) in [
        (
            "sevro.gain := 2",
            "there is no component or machine `sevro`",
        ),
        ("servo.strat()", "there is no operation or request `strat`"),
        ("raise abrt", "there is no event `abrt`"),
        ("enter Move", "there is no state `Move`"),
        ("Lola.go()", "there is no request of machines `go`"),
        ("servo.desi_pos := 1", "the in port `desi_pos` is connected"),
        ("robot.release_brakes(1)", "`)` is expected here"),
        ("servo.gain :=", "is expected here"),
        ("servo.gain := [[1]]", "a single value is expected"),
    ] {
        let found = parse(text, &program).unwrap_err();
        let first = &found.all()[0];
        assert!(first.text.contains(cause), "{text}: {}", first.text);
        assert!(!first.hint.is_empty(), "{text}");
    }
    let both = parse("sevro.gain := 2; raise abrt", &program).unwrap_err();
    assert_eq!(both.all().len(), 2);
}

#[test]
fn parameter_of_each_kind_is_checked() {
    assert_eq!(parameter(Kind::Bool, "true"), Ok(Value::Bool(true)));
    assert_eq!(parameter(Kind::Int, "-3"), Ok(Value::Int(-3)));
    assert_eq!(parameter(Kind::Double, "2"), Ok(Value::Double(2.0)));
    assert!(parameter(Kind::Double, "inf").is_err());
    assert!(
        parameter(Kind::Int, "2.5")
            .unwrap_err()
            .contains("is not a int")
    );
}
