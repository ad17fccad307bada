//! Virtual time, and states and values without a controller.

use super::*;
use NetState::{Cancelling, Loading, Ready, Rejected, Running, Scheduled, Terminated};

const REFRESH: Duration = Duration::from_millis(100);

fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

/// A subscription to every state.
fn watch(states: usize) -> NetWatch {
    NetWatch::new("t".to_owned(), REFRESH, Pace::Every, states)
}

fn running() -> NetWatch {
    let mut watch = watch(1);
    watch.handle_states(&[Loading, Ready, Running], Vec::new, Pushes::Due, ms(0));
    watch
}

fn values(values: &[(&str, &str)]) -> Values {
    values
        .iter()
        .map(|(k, v)| ((*k).to_owned(), (*v).to_owned()))
        .collect()
}

fn states(watch: &mut NetWatch, states: &[NetState], at: Duration) -> Vec<String> {
    let messages = watch.handle_states(states, || values(&[("outa", "1")]), Pushes::Due, at);
    messages.iter().map(Message::to_string).collect()
}

fn changes(watch: &mut NetWatch, of: &[(&str, &str)], at: Duration) -> Option<String> {
    watch.handle_values(values(of), at).map(|m| m.to_string())
}

#[test]
fn new_watch_pushes_only_present_state() {
    assert_eq!(
        states(&mut watch(2), &[Loading, Ready], ms(0)),
        [r#"t=ns("READY")"#]
    );
    assert_eq!(
        states(&mut watch(2), &[Loading, Rejected], ms(0)),
        [r#"t=ns("REJECTED")"#]
    );
    let ended = states(&mut watch(4), &[Loading, Ready, Running, Terminated], ms(0));
    assert_eq!(ended, [r#"t=nc({outa:"1"})"#, r#"t=ns("TERMINATED")"#]);
}

#[test]
fn later_states_are_pushed_once_in_order() {
    let mut watch = watch(2);
    let life = [Loading, Ready, Scheduled, Running, Cancelling, Terminated];
    let pushed: Vec<_> = (2..=6)
        .flat_map(|n| states(&mut watch, &life[..n], ms(0)))
        .collect();
    let expected = [
        r#"t=ns("READY")"#,
        r#"t=ns("SCHEDULED")"#,
        r#"t=ns("RUNNING")"#,
        r#"t=nc({outa:"1"})"#,
        r#"t=ns("CANCELLING")"#,
        r#"t=nc({outa:"1"})"#,
        r#"t=ns("TERMINATED")"#,
    ];
    assert_eq!(pushed, expected);
    assert_eq!(states(&mut watch, &life, ms(0)), Vec::<String>::new());
}

#[test]
fn states_passed_at_once_are_all_pushed() {
    let life = [Loading, Ready, Running, Cancelling, Terminated];
    let expected = [
        r#"t=ns("RUNNING")"#,
        r#"t=nc({outa:"1"})"#,
        r#"t=ns("CANCELLING")"#,
        r#"t=ns("TERMINATED")"#,
    ];
    assert_eq!(states(&mut watch(3), &life, ms(0)), expected);
}

#[test]
fn values_are_polled_only_while_net_runs() {
    let mut watch = watch(2);
    states(&mut watch, &[Loading, Ready], ms(0));
    assert_eq!(watch.values_timeout(), None);
    states(&mut watch, &[Loading, Ready, Running], ms(5));
    assert!(watch.values_timeout().is_some_and(|at| at <= ms(5)));
    changes(&mut watch, &[], ms(5));
    assert_eq!(watch.values_timeout(), Some(ms(15)));
    states(&mut watch, &[Loading, Ready, Running, Terminated], ms(6));
    assert_eq!(watch.values_timeout(), None);
}

#[test]
fn value_is_pushed_after_change_and_interval() {
    let mut watch = running();
    let nc = |text: &str| Some(format!("t=nc({{outa:\"{text}\"}})"));
    assert_eq!(changes(&mut watch, &[("outa", "1")], ms(10)), nc("1"));
    assert_eq!(changes(&mut watch, &[("outa", "2")], ms(109)), None);
    assert_eq!(changes(&mut watch, &[("outa", "2")], ms(110)), nc("2"));
    assert_eq!(changes(&mut watch, &[("outa", "2")], ms(500)), None);
    assert_eq!(changes(&mut watch, &[("outa", "3")], ms(501)), nc("3"));
}

#[test]
fn each_value_has_its_own_interval() {
    let mut watch = running();
    changes(&mut watch, &[("outa", "1")], ms(0));
    let second = changes(&mut watch, &[("outa", "2"), ("outb", "1")], ms(50));
    assert_eq!(second.as_deref(), Some(r#"t=nc({outb:"1"})"#));
    let third = changes(&mut watch, &[("outa", "2"), ("outb", "2")], ms(100));
    assert_eq!(third.as_deref(), Some(r#"t=nc({outa:"2"})"#));
}

#[test]
fn state_change_pushes_values_despite_interval() {
    let mut watch = running();
    changes(&mut watch, &[("outa", "1")], ms(0));
    let end = states(&mut watch, &[Loading, Ready, Running, Terminated], ms(1));
    assert_eq!(end, [r#"t=nc({outa:"1"})"#, r#"t=ns("TERMINATED")"#]);
}

#[test]
fn unloaded_net_pushes_terminated_first() {
    let gone = |watch: &mut NetWatch| {
        let (messages, last) = watch.handle_unloaded(|| None, Pushes::Due, ms(0));
        assert!(last);
        texts(&messages)
    };
    let end = [r#"t=ns("TERMINATED")"#, r#"t=ns("UNLOADED")"#];
    assert_eq!(gone(&mut running()), end);
    let mut ended = watch(1);
    states(&mut ended, &[Loading, Terminated], ms(0));
    assert_eq!(gone(&mut ended), end[1..]);
}

/// A subscription at the default pace to a net that is ready, with its state already pushed.
fn ready() -> NetWatch {
    let mut watch = NetWatch::new("t".to_owned(), REFRESH, Pace::Coalesced, 2);
    let pushed = reply(&mut watch, &[Loading, Ready], ms(0));
    assert_eq!(pushed, [r#"t=ns("READY")"#]);
    watch
}

fn texts(messages: &[Message]) -> Vec<String> {
    messages.iter().map(Message::to_string).collect()
}

fn pushed(watch: &mut NetWatch, states: &[NetState], pushes: Pushes, at: Duration) -> Vec<String> {
    texts(&watch.handle_states(states, || values(&[("outa", "1")]), pushes, at))
}

fn reply(watch: &mut NetWatch, states: &[NetState], at: Duration) -> Vec<String> {
    pushed(watch, states, Pushes::BeforeReply, at)
}

const NC: &str = r#"t=nc({outa:"1"})"#;
const RUNNING: &str = r#"t=ns("RUNNING")"#;
const TERMINATED: &str = r#"t=ns("TERMINATED")"#;
const NONE: [&str; 0] = [];

#[test]
fn states_within_window_are_pushed_as_the_last() {
    let mut watch = ready();
    let life = [Loading, Ready, Scheduled, Running, Terminated];
    for (at, known) in [(20, 3), (21, 4), (22, 5), (29, 5)] {
        assert_eq!(states(&mut watch, &life[..known], ms(at)), NONE, "{at}");
    }
    assert_eq!(watch.state_timeout(), Some(ms(31)), "10 ms after RUNNING");
    assert_eq!(states(&mut watch, &life, ms(31)), [NC, TERMINATED]);
    assert_eq!(watch.state_timeout(), None);
    assert_eq!(states(&mut watch, &life, ms(99)), NONE);
}

#[test]
fn state_alone_is_pushed_after_window() {
    let mut watch = ready();
    let life = [Loading, Ready, Scheduled];
    assert_eq!(states(&mut watch, &life, ms(20)), NONE);
    assert_eq!(states(&mut watch, &life, ms(30)), [r#"t=ns("SCHEDULED")"#]);
}

#[test]
fn command_pushes_present_state_before_reply() {
    let mut watch = ready();
    let life = [Loading, Ready, Running, Terminated];
    assert_eq!(reply(&mut watch, &life[..3], ms(20)), [RUNNING]);
    assert_eq!(reply(&mut watch, &life, ms(40)), [NC, TERMINATED]);
}

#[test]
fn started_net_pushes_no_values_within_window() {
    let mut watch = ready();
    let life = [Loading, Ready, Running];
    assert_eq!(reply(&mut watch, &life, ms(20)), [RUNNING]);
    assert_eq!(watch.values_timeout(), Some(ms(30)));
    assert_eq!(changes(&mut watch, &[("outa", "1")], ms(30)).unwrap(), NC);
}

#[test]
fn started_net_pushes_no_end_within_window() {
    for seen in [ms(20), ms(24)] {
        let mut watch = ready();
        let life = [Loading, Ready, Running, Terminated];
        assert_eq!(reply(&mut watch, &life[..3], seen), [RUNNING]);
        for at in [seen, seen + ms(9)] {
            assert_eq!(reply(&mut watch, &life, at), NONE);
            assert_eq!(states(&mut watch, &life, at), NONE);
        }
        assert_eq!(watch.state_timeout(), Some(seen + ms(10)));
        assert_eq!(states(&mut watch, &life, seen + ms(10)), [NC, TERMINATED]);
    }
}

#[test]
fn cancelled_net_pushes_values_first_after_window() {
    let mut watch = ready();
    let life = [Loading, Ready, Running, Cancelling];
    assert_eq!(reply(&mut watch, &life, ms(20)), NONE);
    assert_eq!(
        states(&mut watch, &life, ms(30)),
        [NC, r#"t=ns("CANCELLING")"#]
    );
}

#[test]
fn all_values_follow_running() {
    let mut watch = ready();
    let of = [("outa", "1"), ("outb", "2")];
    let mut life = vec![Loading, Ready, Running];
    reply(&mut watch, &life, ms(20));
    let all = r#"t=nc({outa:"1",outb:"2"})"#;
    assert_eq!(changes(&mut watch, &of, ms(30)).unwrap(), all);
    assert_eq!(changes(&mut watch, &of, ms(500)), None);
    life.push(Terminated);
    states(&mut watch, &life, ms(501));
    assert_eq!(
        watch.values_timeout(),
        Some(ms(510)),
        "until the end is pushed"
    );
    assert_eq!(states(&mut watch, &life, ms(511)), [NC, TERMINATED]);
    assert_eq!(watch.values_timeout(), None, "no values after the end");
}

#[test]
fn ended_net_pushes_present_state_at_once() {
    let mut watch = NetWatch::new("t".to_owned(), REFRESH, Pace::Coalesced, 4);
    let life = [Loading, Ready, Running, Terminated];
    assert_eq!(reply(&mut watch, &life, ms(0)), [NC, TERMINATED]);
}

/// A net that starts, ends and is unloaded at once still delivers its values, its end, and `UNLOADED` once.
#[test]
fn net_unloaded_within_window_loses_nothing() {
    let mut controller = takt_core::CellConfig::default();
    controller.controller.priority = None;
    let controller = takt_core::Controller::start(&controller).unwrap();
    let text = "{a=Core::DoubleValue(Value='1'),o=Core::DoubleNetcommOut(inValue=a.outValue,Key='a'),\
                x=Core::BooleanValue(Value='true'),outTerminate=x.outValue}";
    let request = takt_core::controller::LoadRequest {
        text: text.to_owned(),
        session: takt_core::SessionId::NONE,
        description: String::new(),
        period: None,
    };
    let net = controller.load(request).unwrap();
    let mut watch = ready();
    controller.start_net(net).unwrap();
    while controller.net(net).unwrap().state() != Terminated {
        std::thread::yield_now();
    }
    controller.unload(net).unwrap();
    let result = controller.retained(net);
    let mut gone = |at, pushes| {
        let (messages, last) = watch.handle_unloaded(|| result.clone(), pushes, ms(at));
        (texts(&messages), last)
    };
    assert_eq!(gone(20, Pushes::BeforeReply), (vec![], false));
    assert_eq!(gone(29, Pushes::Due), (vec![], false));
    let all = [NC, TERMINATED, r#"t=ns("UNLOADED")"#].map(str::to_owned);
    assert_eq!(gone(30, Pushes::Due), (all.to_vec(), true));
}

#[test]
fn unloading_repeats_end_with_all_values() {
    let mut watch = ready();
    let life = [Loading, Ready, Terminated];
    assert_eq!(reply(&mut watch, &life, ms(20)), [NC, TERMINATED]);
    let repeated = watch.handle_unloading(values(&[("outa", "1")]), ms(20));
    assert_eq!(texts(&repeated), [NC, TERMINATED]);
    let (before, last) = watch.handle_unloaded(|| None, Pushes::BeforeReply, ms(20));
    assert!(before.is_empty() && !last);
    assert_eq!(watch.state_timeout(), Some(ms(30)));
    let (end, last) = watch.handle_unloaded(|| None, Pushes::Due, ms(30));
    assert_eq!(texts(&end), [r#"t=ns("UNLOADED")"#]);
    assert!(last);
}

/// Pushes for Boolean values.
fn results(watch: &mut NetWatch, of: &[(&str, &str)], at: Duration) -> Option<String> {
    let push = watch.handle_results(|_| values(of), at);
    push.map(|m| m.to_string())
}

#[test]
fn boolean_changes_are_pushed_at_most_every_interval() {
    let mut watch = running();
    let pushed = |text: &str| Some(format!(r#"t=nc({{outr:"{text}"}})"#));
    assert_eq!(
        changes(&mut watch, &[("outr", "false")], ms(0)),
        pushed("false")
    );
    assert_eq!(results(&mut watch, &[("outr", "true")], ms(9)), None);
    assert_eq!(
        changes(&mut watch, &[("outr", "true")], ms(10)),
        pushed("true")
    );
    assert_eq!(
        results(&mut watch, &[("outr", "false")], ms(21)),
        pushed("false")
    );
    assert_eq!(results(&mut watch, &[("outr", "true")], ms(22)), None);
    assert_eq!(
        results(&mut watch, &[("outr", "true")], ms(31)),
        pushed("true")
    );
}

#[test]
fn boolean_of_ended_net_is_not_polled() {
    let mut watch = running();
    let life = [Loading, Ready, Running, Terminated];
    states(&mut watch, &life, ms(1));
    assert_eq!(results(&mut watch, &[("outr", "true")], ms(50)), None);
}
