//! The stream of live messages against the recording of the same run: what both have is the same byte for byte.

#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

mod common;

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use common::{Cell, swing};
use takt_core::Error;
use takt_core::controller::{MachineRequest, RuleRequest};
use takt_core::record::{LiveStream, Recorder, Sink, Stamp};
use takt_tests::{pass, simulate_time};

/// Topics with their schemas, and messages by topic.
#[derive(Debug, Default)]
struct Collected {
    topics: Vec<(String, String, String)>,
    unwanted: Vec<String>,
    messages: BTreeMap<String, Vec<(u64, Vec<u8>)>>,
    closed: usize,
}

impl Sink for Collected {
    fn channel(&mut self, topic: &str, schema: &str, text: &str) -> Result<u16, Error> {
        let [topic, schema, text] = [topic, schema, text].map(str::to_owned);
        self.topics.push((topic, schema, text));
        Ok(u16::try_from(self.topics.len() - 1).unwrap())
    }

    fn close(&mut self, _: u16) {
        self.closed += 1;
    }

    fn wants(&self, channel: u16) -> bool {
        !self.unwanted.contains(&self.topics[usize::from(channel)].0)
    }

    fn message(&mut self, channel: u16, data: &[u8], at: Stamp) -> Result<(), Error> {
        assert!(self.wants(channel), "nothing is encoded in vain");
        let (topic, ..) = &self.topics[usize::from(channel)];
        let messages = self.messages.entry(topic.clone()).or_default();
        if let Some((before, _)) = messages.last() {
            assert!(*before <= at.0, "the times of {topic} go back");
        }
        messages.push((at.0, data.to_vec()));
        Ok(())
    }
}

/// Topics, schemas and messages of a file.
fn recorded(path: &Path) -> Collected {
    let bytes = std::fs::read(path).unwrap();
    let mut found = Collected::default();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        let channel = &message.channel;
        let schema = channel.schema.as_ref().unwrap();
        let text = String::from_utf8(schema.data.to_vec()).unwrap();
        let topic = (channel.topic.clone(), schema.name.clone(), text);
        if !found.topics.contains(&topic) {
            found.topics.push(topic);
        }
        let messages = found.messages.entry(channel.topic.clone()).or_default();
        messages.push((message.log_time, message.data.into_owned()));
    }
    found
}

/// A machine with one inside, without components.
const MACHINE: &str = "machine Outer {
      event go; event off;
      initial state Idle { transition on go to Busy; }
      state Busy { entry { activate Inner; start Inner; } transition on off to Done; }
      final state Done { entry { stop Inner; deactivate Inner; } }
      machine Inner {
        event never;
        initial state Low { entry { wait 40ms; } transition to High; }
        state High { entry { wait 40ms; } transition on never to End; transition to Low; }
        final state End { }
      }
    }";

const VALUES: &str = "{clock=Core::Clock(),
    t=Core::DoubleNetcommOut(inValue=clock.outValue,Key='outt'),
    u=Core::DoubleNetcommOut(inValue=clock.outValue,Key='outu'),
    v=Core::DoubleNetcommOut(inValue=clock.outValue,Key='outv'),
    w=Core::DoubleNetcommOut(inValue=clock.outValue,Key='outw'),
    cancel=Cancel(),outTerminate=cancel.outCancel}";

/// Polls the stream until `until`.
fn poll(stream: &mut LiveStream, to: &mut Collected, until: impl Fn(&Collected) -> bool) -> u64 {
    let mut lost = 0;
    for _ in 0..250 {
        lost += stream.poll(to, true).unwrap();
        if until(to) {
            break;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    lost
}

fn count(of: &Collected, topic: &str) -> usize {
    of.messages.get(topic).map_or(0, Vec::len)
}

#[test]
fn live_stream_has_the_messages_of_recording() {
    simulate_time(1.0);
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("live.mcap");
    let cell = Cell::recorded(&["left", "right"], Some(Recorder::start(&path).unwrap()));
    let mut stream = LiveStream::new(&cell.controller, 1);
    let mut live = Collected::default();
    stream.poll(&mut live, true).unwrap();
    let values = cell.load(VALUES);
    cell.controller.start_net(values).unwrap();
    let machine = MachineRequest {
        text: MACHINE.to_owned(),
        ..MachineRequest::default()
    };
    let machine = cell.controller.load_machine(&machine).unwrap();
    cell.controller.start_machine(&machine).unwrap();
    let net = cell.load(&swing("left", 30.0));
    cell.controller.start_net(net).unwrap();
    // Both devices are diagnosed when the stream begins, and then each second.
    let enough =
        |of: &Collected| count(of, "/left/set_points") >= 500 && count(of, "/diagnostics") >= 3;
    assert_eq!(poll(&mut stream, &mut live, enough), 0, "no row is lost");
    cell.controller
        .command_machine(&machine, "raise go")
        .unwrap();
    poll(&mut stream, &mut live, |of| {
        count(of, "/takt/machine_events") >= 6
    });
    let next = cell.load(VALUES);
    let rule = RuleRequest {
        condition: "t".to_owned(),
        stop: vec![values],
        start: vec![next],
        ..RuleRequest::default()
    };
    cell.controller.schedule(rule).unwrap();
    cell.wait_for_end(values);
    cell.controller.cancel(next).unwrap();
    cell.wait_for_end(next);
    cell.controller.abort(net).unwrap();
    cell.controller.end_machine(&machine).unwrap();
    // Started, by a rule, cancelled, and three ends.
    let ended = |of: &Collected| count(of, "/takt/net_events") >= 7;
    poll(&mut stream, &mut live, ended);
    cell.controller.unload(values).unwrap();
    poll(&mut stream, &mut live, |of| of.closed > 0);
    assert_eq!(live.closed, 1, "the topic of a net ends with it");
    cell.controller.finish_recording().unwrap().unwrap();

    let file = recorded(&path);
    let values = format!("/takt/nets/{values}");
    assert_part(&live, &file, &values);
}

/// All live messages are in the file, one after the other in each topic, those of these values too.
fn assert_part(live: &Collected, file: &Collected, values: &str) {
    let used = |topic: &&(String, _, _)| live.messages.contains_key(&topic.0);
    for topic in live.topics.iter().filter(used) {
        assert!(file.topics.contains(topic), "{topic:?}");
    }
    let least = [
        ("/left/joint_states", 400),
        ("/right/joint_states", 400),
        ("/left/set_points", 400),
        (values, 400),
        ("/takt/thread", 400),
        ("/takt/net_events", 7),
        ("/takt/machine_events", 7),
        ("/tf", 10),
        ("/diagnostics", 1),
    ];
    for (topic, least) in least {
        // What and where a device is when the stream begins; a recording has it from its own begin.
        let is_of_begin = ["/diagnostics", "/tf"].contains(&topic);
        let first = if is_of_begin { 2 } else { 0 };
        let (live, file) = (&live.messages[topic][first..], &file.messages[topic]);
        assert!(live.len() >= least, "{topic}: {}", live.len());
        let is_part = file.windows(live.len()).any(|part| part == live);
        assert!(
            is_part,
            "{topic} differs from the recording: {}",
            difference(live, file)
        );
    }
}

/// The first live message that the file lacks, for people.
fn difference(live: &[(u64, Vec<u8>)], file: &[(u64, Vec<u8>)]) -> String {
    let missing = live.iter().position(|message| !file.contains(message));
    let Some(at) = missing else {
        return "a message is missing between others".to_owned();
    };
    let (time, data) = &live[at];
    let nearest = file.iter().min_by_key(|it| it.0.abs_diff(*time));
    format!(
        "message {at} of {}\n at {time}: {data:02x?}\nfile {nearest:02x?}",
        live.len()
    )
}

#[test]
fn live_stream_every_tenth_cycle_skips_others() {
    simulate_time(1.0);
    let cell = Cell::new(&["left"]);
    let mut stream = LiveStream::new(&cell.controller, 10);
    let mut live = Collected {
        unwanted: vec!["/tf".to_owned(), "/diagnostics".to_owned()],
        ..Collected::default()
    };
    let enough = |of: &Collected| count(of, "/left/joint_states") >= 20;
    assert_eq!(poll(&mut stream, &mut live, enough), 0);
    let times: Vec<_> = live.messages["/left/joint_states"]
        .iter()
        .map(|it| it.0)
        .collect();
    for pair in times.windows(2) {
        assert!(pair[1] - pair[0] > 5_000_000, "{pair:?}");
    }
    assert!(
        count(&live, "/takt/thread") >= 190,
        "each cycle of the thread"
    );
    assert!(!live.messages.contains_key("/tf"));
    // Nothing is wanted: rows are passed over, and are not counted as lost later.
    stream.poll(&mut live, false).unwrap();
    let before = count(&live, "/left/joint_states");
    pass(Duration::from_millis(1500));
    assert_eq!(stream.poll(&mut live, false).unwrap(), 0);
    assert_eq!(stream.poll(&mut live, true).unwrap(), 0);
    assert!(count(&live, "/left/joint_states") <= before + 1);
}
