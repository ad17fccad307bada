//! A node seen from the network: frames in, frames out, in virtual time.

use takt_cia402::dictionary::{Access, Entry, Mapped, Object, PdoUse};

use super::*;
use crate::LogLine;
use crate::canopen::emcy::Source;
use crate::canopen::lss::Identity;
use crate::canopen::pdo::{Parameters, PdoCob, Transmission};

const MS: Duration = Duration::from_millis(1);

/// Records events.
#[derive(Debug, Default)]
struct Recorder(Vec<Event>);

impl Application for Recorder {
    fn handle(&mut self, event: Event, _: &mut Context<'_>) {
        self.0.push(event);
    }
}

const fn mapped(index: u16) -> Mapped {
    Mapped {
        address: Address::new(index, 0),
        bits: 16,
    }
}

/// RPDO 1 (SYNC) to 2000h, RPDO 2 (event, deadline 20 ms) to 2001h; TPDO 1 (SYNC) from 2000h,
/// TPDO 2 (event) from 2001h.
fn communication() -> Communication {
    let pdo = |cob: u32, kind, index| {
        let kind = Transmission::from_raw(kind);
        Parameters::new(PdoCob::from_raw(cob), kind, vec![mapped(index)])
    };
    let mut late = pdo(0x300, 255, 0x2001);
    late.event = 20;
    Communication {
        device_type: 0x1234,
        identity: Identity::from_numbers([1, 2, 3, 4]),
        rpdos: vec![(0, pdo(0x200, 1, 0x2000)), (1, late)],
        tpdos: vec![(0, pdo(0x180, 1, 0x2000)), (1, pdo(0x280, 255, 0x2001))],
        ..Communication::default()
    }
}

struct Rig {
    node: Node<Recorder>,
    now: Duration,
}

impl Rig {
    fn new(id: Option<u8>) -> Self {
        let communication = communication();
        let mut objects = communication.objects();
        for index in [0x2000, 0x2001] {
            let entry = Entry::number("value", Access::ReadWrite, 0_u16).mappable(PdoUse::Both);
            objects.push(Object::var(index, entry));
        }
        let config = NodeConfig {
            id: id.map(|id| NodeId::new(id).unwrap()),
            dictionary: Dictionary::new(objects).unwrap(),
            relative: communication.relative(),
            sdo_len_max: 100,
            sdo_timeout: 500 * MS,
            quirks: NodeQuirks::default(),
        };
        let node = Node::new(config, Recorder::default(), Duration::ZERO).unwrap();
        let now = Duration::ZERO;
        Self { node, now }
    }

    /// A node in a state, without pending frames and events.
    fn in_state(state: State) -> Self {
        let mut rig = Self::new(Some(5));
        rig.sent();
        match state {
            State::Initialising => rig = Self::new(None),
            State::PreOperational => {}
            State::Operational => drop(rig.exchange("000#0100")),
            State::Stopped => drop(rig.exchange("000#0200")),
        }
        assert_eq!(rig.node.state(), state);
        rig.node.application.0.clear();
        rig
    }

    fn sent(&mut self) -> Vec<String> {
        std::iter::from_fn(|| self.node.poll_transmit(self.now))
            .map(|frame| frame.to_string())
            .collect()
    }

    /// Sends the node a frame in candump syntax; returns its responses.
    fn exchange(&mut self, frame: &str) -> Vec<String> {
        let line = format!("(1.000000) can0 {frame}");
        let frame = LogLine::parse(&line).unwrap().frame;
        self.node.handle_frame(&frame, self.now);
        self.sent()
    }

    /// Runs it millisecond by millisecond.
    fn pass(&mut self, ms: u32) -> Vec<String> {
        (0..ms).flat_map(|_| self.wait(MS)).collect()
    }

    fn wait(&mut self, time: Duration) -> Vec<String> {
        self.now += time;
        self.sent()
    }
}

#[test]
fn node_boots_up_into_pre_operational() {
    let mut rig = Rig::new(Some(5));
    assert_eq!(rig.sent(), ["705#00"]);
    assert_eq!(rig.node.state(), State::PreOperational);
    let identifiers = [
        (0x1014, 0, 0x85),
        (0x1200, 1, 0x605),
        (0x1400, 1, 0x205),
        (0x1801, 1, 0x285),
    ];
    for (index, sub, id) in identifiers {
        let bytes = rig
            .node
            .dictionary()
            .bytes(Address::new(index, sub))
            .unwrap();
        assert_eq!(bytes, u32::to_le_bytes(id), "{index:04X}h");
    }
}

/// Each service in each state, as in the table of CiA 301 (clause 7.3.2.2.5).
#[test]
fn node_services_depend_on_nmt_state() {
    for state in State::ALL {
        let answers = |frame: &str| Rig::in_state(state).exchange(frame);
        let (communicates, operational) = (state.communicates(), state == State::Operational);
        let sdo = answers("605#4000100000000000");
        assert_eq!(!sdo.is_empty(), communicates, "SDO, {state:?}: {sdo:?}");
        let sync = answers("080#");
        assert_eq!(
            sync == ["185#0000"],
            operational,
            "TPDO with SYNC, {state:?}: {sync:?}"
        );
        let guard = answers("705#R");
        assert_eq!(
            guard.len() == 1,
            state != State::Initialising,
            "guarding, {state:?}"
        );
        let lss = answers("7E5#0401000000000000");
        assert!(lss.is_empty(), "LSS, {state:?}");
        let mut rig = Rig::in_state(state);
        rig.exchange("305#0700");
        let taken = rig.node.application.0.contains(&Event::Received(1));
        assert_eq!(taken, operational, "RPDO, {state:?}");
        let mut rig = Rig::in_state(state);
        rig.node
            .errors_mut()
            .raise(Source::Device(0), 0x8611, 0x20, [0; 5]);
        let emergency = rig.sent();
        assert_eq!(
            emergency == ["085#1186210000000000"],
            communicates,
            "EMCY, {state:?}"
        );
    }
}

#[test]
fn node_sync_applies_rpdos_then_samples_tpdos() {
    let mut rig = Rig::in_state(State::Operational);
    assert_eq!(rig.exchange("205#3412"), [""; 0], "it waits for SYNC");
    assert_eq!(rig.exchange("080#"), ["185#3412"]);
    assert_eq!(rig.node.application.0, [Event::Sync, Event::Received(0)]);
    // A change of 2001h is an event of TPDO 2.
    assert_eq!(rig.exchange("305#7856"), ["285#7856"]);
}

#[test]
fn node_parameters_written_by_sdo_apply_at_once() {
    let mut rig = Rig::in_state(State::Operational);
    assert_eq!(
        rig.exchange("605#4000100000000000"),
        ["585#4300100034120000"]
    );
    let beats = rig.exchange("605#2B17100064000000");
    assert_eq!(
        beats,
        ["705#05", "585#6017100000000000"],
        "1017h = 100 ms, the first at once"
    );
    assert_eq!(rig.wait(99 * MS), [""; 0]);
    assert_eq!(rig.wait(MS), ["705#05"]);
    // TPDO 1 off: the next SYNC is without it.
    assert_eq!(
        rig.exchange("605#2300180185010080"),
        ["585#6000180100000000"]
    );
    assert_eq!(rig.exchange("080#"), [""; 0]);
    // The identifier of RPDO 2 must not change while it exists.
    assert_eq!(
        rig.exchange("605#2301140105020040"),
        ["585#8001140130000906"]
    );
}

#[test]
fn node_invalid_writes_to_communication_objects_are_rejected() {
    let mut rig = Rig::in_state(State::PreOperational);
    let writes: [(&str, u32); 14] = [
        ("2316100164000A00", 0),
        ("2316100264000A00", 0x0604_0043), // node 10 twice
        ("2316100200000A00", 0),           // time 0: not monitored
        ("2316100264008000", 0x0609_0030), // node 128
        ("2F03100001000000", 0x0609_0030), // only 0 clears
        ("2F03100000000000", 0),
        ("2F19100001000000", 0x0609_0030), // overflow 1
        ("2F191000F1000000", 0x0609_0030), // overflow 241
        ("2F1910000A000000", 0),
        ("23061000E8030000", 0),           // 1006h = 1 ms
        ("2F19100000000000", 0x0800_0022), // 1019h only while 1006h is 0
        ("2F29100103000000", 0x0609_0030), // 1029h knows 0 to 2
        ("2314100086000000", 0x0609_0030), // EMCY identifier while it exists
        ("2305100000000020", 0x0609_0030), // 29 bits
    ];
    for (message, expected) in &writes {
        let answer = rig.exchange(&format!("605#{message}")).pop().unwrap();
        let code = u32::from_str_radix(&answer[12..20], 16)
            .unwrap()
            .swap_bytes();
        let code = if answer.starts_with("585#80") {
            code
        } else {
            0
        };
        assert_eq!(code, *expected, "{message}: {answer}");
    }
}

#[test]
fn node_heartbeat_loss_sends_emcy_and_applies_1029h() {
    for (behaviour, state) in [
        (0, State::PreOperational),
        (1, State::Operational),
        (2, State::Stopped),
    ] {
        let mut rig = Rig::in_state(State::Operational);
        rig.exchange(&format!("605#2F291001{behaviour:02X}000000"));
        rig.exchange("605#2316100132000A00"); // node 10, 50 ms
        assert_eq!(rig.wait(500 * MS), [""; 0], "not received yet");
        rig.exchange("70A#05");
        rig.wait(49 * MS);
        assert_eq!(rig.node.state(), State::Operational);
        rig.node.application.0.clear();
        let sent = rig.wait(MS);
        assert_eq!(rig.node.state(), state);
        assert_eq!(rig.node.application.0[0], Event::Lost);
        // In Stopped there are no emergencies.
        let reported = sent == ["085#3081110A00000000"];
        assert_eq!(reported, state != State::Stopped, "{sent:?}");
        rig.exchange("70A#05");
        assert_eq!(rig.node.application.0.last(), Some(&Event::Back));
    }
}

#[test]
fn node_guarding_stop_is_detected() {
    let mut rig = Rig::in_state(State::Operational);
    rig.exchange("605#2B0C100014000000"); // 20 ms
    rig.exchange("605#2F0D100003000000"); // times 3
    assert_eq!(rig.exchange("705#R1"), ["705#05"]);
    assert_eq!(rig.exchange("705#R1"), ["705#85"]);
    assert_eq!(rig.wait(59 * MS), [""; 0]);
    assert_eq!(rig.wait(MS), ["085#3081110000000000"]);
    assert_eq!(rig.node.state(), State::PreOperational);
}

#[test]
fn node_error_history_is_newest_first() {
    let mut rig = Rig::in_state(State::PreOperational);
    for code in 1..=10 {
        rig.node
            .errors_mut()
            .raise(Source::Device(0), code, 0x20, [0, 0xAB, 0, 0, 0]);
        rig.sent();
    }
    assert_eq!(
        rig.exchange("605#4003100000000000"),
        ["585#4F03100008000000"]
    );
    assert_eq!(
        rig.exchange("605#4003100100000000"),
        ["585#430310010A00AB00"]
    );
    assert_eq!(
        rig.exchange("605#4003100800000000"),
        ["585#430310080300AB00"]
    );
    assert_eq!(
        rig.exchange("605#4001100000000000"),
        ["585#4F01100021000000"]
    );
    rig.exchange("605#2F03100000000000");
    assert_eq!(
        rig.exchange("605#4003100100000000"),
        ["585#8003100124000008"],
        "no data"
    );
}

#[test]
fn node_invalid_pdos_and_syncs_are_reported_once() {
    let mut rig = Rig::in_state(State::Operational);
    assert_eq!(rig.exchange("205#01"), ["085#1082110100010000"]);
    assert_eq!(rig.exchange("205#01"), [""; 0], "known");
    assert_eq!(rig.exchange("205#0100"), ["085#0000000000000000"]);
    assert_eq!(rig.exchange("205#010000"), ["085#2082110100030000"]);
    assert_eq!(rig.exchange("080#01"), ["085#4082110100000000"]);
    // TPDO 2 sends the value received by RPDO 2; then RPDO 2 is late.
    rig.exchange("305#0100");
    assert_eq!(rig.wait(19 * MS), [""; 0]);
    assert_eq!(rig.wait(MS), ["085#5082110200000000"]);
    assert!(rig.node.application.0.contains(&Event::Late(1)));
    assert_eq!(rig.exchange("305#0100"), ["085#0000110000000000"]);
}

#[test]
fn node_resets_restore_defaults() {
    for (command, kept) in [("000#8205", true), ("000#8105", false), ("000#8100", false)] {
        let mut rig = Rig::in_state(State::Operational);
        rig.exchange("605#2B00200007000000");
        rig.exchange("605#2B17100064000000");
        assert_eq!(rig.exchange(command), ["705#00"], "{command}");
        let value = rig
            .node
            .dictionary()
            .bytes(Address::new(0x2000, 0))
            .unwrap()[0];
        assert_eq!(value == 7, kept, "{command}");
        assert_eq!(rig.wait(200 * MS), [""; 0], "no heartbeat any more");
    }
}

#[test]
fn node_without_number_gets_one_by_lss() {
    let mut rig = Rig::new(None);
    assert_eq!(rig.sent(), [""; 0]);
    assert_eq!(
        rig.exchange("7E5#5100000000800000"),
        ["7E4#4F00000000000000"],
        "an unconfigured slave is present"
    );
    rig.exchange("7E5#0401000000000000");
    assert_eq!(
        rig.exchange("7E5#1107000000000000"),
        ["7E4#1100000000000000"]
    );
    assert_eq!(
        rig.exchange("7E5#1700000000000000"),
        ["7E4#1700000000000000"]
    );
    assert_eq!(rig.exchange("7E5#0400000000000000"), ["707#00"]);
    assert_eq!(rig.node.id(), NodeId::new(7).ok());
    assert_eq!(
        rig.exchange("607#4000100000000000"),
        ["587#4300100034120000"]
    );
    let stored = Event::Lss(lss::Done::Store(NodeId::new(7).ok()));
    assert!(rig.node.application.0.contains(&stored));
}

#[test]
fn node_produces_sync_if_configured() {
    let mut rig = Rig::in_state(State::Operational);
    rig.exchange("605#23061000D0070000"); // 2 ms
    rig.exchange("605#2305100080000040"); // bit 30
    assert_eq!(rig.wait(2 * MS), ["080#", "185#0000"]);
    assert_eq!(rig.wait(2 * MS), ["080#", "185#0000"]);
}

#[test]
fn node_accepts_every_frame() {
    let mut rig = Rig::in_state(State::Operational);
    for raw in 0..=0x7FF {
        let id = Id::standard(raw).unwrap();
        for len in 0..=8 {
            for byte in [0x00, 0x05, 0x40, 0x81, 0xFF] {
                let frame = Frame::new(id, &[byte; 8][..len]).unwrap();
                rig.now += MS;
                rig.node.handle_frame(&frame, rig.now);
                rig.sent();
            }
        }
    }
}

/// 1010h and 1011h: stored values survive a reset; restored ones are the defaults after the next reset.
#[test]
fn node_parameters_are_stored_and_restored_by_group() {
    let mut rig = Rig::new(Some(5));
    let value = |rig: &Rig, index| {
        rig.node
            .dictionary()
            .bytes(Address::new(index, 0))
            .unwrap()
            .to_vec()
    };
    let reset = "000#8105";
    // A wrong signature, and the capability values of the objects.
    assert_eq!(
        rig.exchange("605#2310100101000000").last().unwrap(),
        "585#8010100120000008"
    );
    assert_eq!(
        rig.exchange("605#4010100100000000").last().unwrap(),
        "585#4310100101000000"
    );
    rig.exchange("605#2B17100064000000");
    rig.exchange("605#2B00200007000000");
    rig.exchange(reset);
    assert_eq!(
        (value(&rig, 0x1017), value(&rig, 0x2000)),
        (vec![0, 0], vec![0, 0])
    );
    // Communication alone is stored: `save` to 1010h:02.
    rig.exchange("605#2B17100064000000");
    rig.exchange("605#2B00200007000000");
    assert_eq!(
        rig.exchange("605#2310100273617665").last().unwrap(),
        "585#6010100200000000"
    );
    assert_eq!(
        rig.exchange("605#4010100200000000").last().unwrap(),
        "585#4310100201000000"
    );
    rig.exchange("605#2B17100001000000");
    rig.exchange(reset);
    assert_eq!(
        (value(&rig, 0x1017), value(&rig, 0x2000)),
        (vec![100, 0], vec![0, 0])
    );
    // All parameters: `save` to 1010h:01. A reset of communication leaves the application alone.
    rig.exchange("605#2B00200009000000");
    rig.exchange("605#2310100173617665");
    rig.exchange("605#2B0020000A000000");
    rig.exchange("000#8205");
    assert_eq!(value(&rig, 0x2000), [10, 0]);
    rig.exchange(reset);
    assert_eq!(
        (value(&rig, 0x1017), value(&rig, 0x2000)),
        (vec![100, 0], vec![9, 0])
    );
    // `load` to 1011h:04: the manufacturer's objects only, and not before the next reset.
    assert_eq!(
        rig.exchange("605#231110046C6F6164").last().unwrap(),
        "585#6011100400000000"
    );
    assert_eq!(value(&rig, 0x2000), [9, 0]);
    rig.exchange(reset);
    assert_eq!(
        (value(&rig, 0x1017), value(&rig, 0x2000)),
        (vec![100, 0], vec![0, 0])
    );
}

/// The frames of a node with malfunctions, in Operational with a heartbeat of 50 ms.
fn ailing(change: impl FnOnce(&mut Malfunctions)) -> Rig {
    let mut rig = Rig::in_state(State::Operational);
    rig.exchange("605#2B17100032000000");
    rig.sent();
    change(rig.node.malfunctions_mut());
    rig
}

#[test]
fn node_malfunctions_suppress_their_frames() {
    let mut rig = ailing(|faults| faults.no_heartbeat = true);
    let frames = rig.pass(500);
    assert!(
        !frames.iter().any(|frame| frame.starts_with("705#")),
        "{frames:?}"
    );
    *rig.node.malfunctions_mut() = Malfunctions::default();
    let frames = rig.pass(500);
    assert!(frames.iter().filter(|frame| *frame == "705#05").count() >= 9);
    let mut rig = ailing(|faults| faults.no_sdo = true);
    assert!(rig.exchange("605#4000100000000000").is_empty());
    let mut rig = ailing(|faults| faults.off = true);
    assert!(rig.pass(500).is_empty());
    rig.node.malfunctions_mut().off = false;
    assert!(rig.wait(5 * MS).contains(&"705#00".to_owned()));
}

#[test]
fn node_malfunctions_repeat_at_their_interval() {
    let mut rig = ailing(|faults| faults.boot_loop = Some(100 * MS));
    let boots = rig.pass(1000);
    let boots = boots.iter().filter(|frame| *frame == "705#00").count();
    assert!((9..=11).contains(&boots), "{boots}");
    let emergency = Emergency {
        code: 0x4210,
        register: 9,
        data: [0; 5],
    };
    let mut rig = ailing(|faults| faults.emergency_storm = Some((emergency, 10 * MS)));
    let storm = rig.pass(1000);
    let storm = storm
        .iter()
        .filter(|frame| frame.starts_with("085#1042"))
        .count();
    assert!((95..=105).contains(&storm), "{storm}");
}

#[test]
fn node_with_wrong_map_reverses_its_pdos() {
    let mut rig = Rig::in_state(State::PreOperational);
    for frame in [
        "605#2301180185020080",
        "605#2F011A0000000000",
        "605#23011A0110000020",
        "605#23011A0210000120",
        "605#2F011A0002000000",
        "605#2301180185020040",
    ] {
        assert!(rig.exchange(frame)[0].starts_with("585#60"), "{frame}");
    }
    rig.exchange("605#2B01200022110000");
    rig.exchange("000#0105");
    rig.node.malfunctions_mut().wrong_map = true;
    rig.node.trigger(1);
    let sent = rig.wait(5 * MS);
    assert!(sent.contains(&"285#22110000".to_owned()), "{sent:?}");
}

#[test]
fn node_with_another_number_boots_up_there() {
    let mut rig = ailing(|_| ());
    rig.node.renumber(NodeId::new(9).unwrap(), rig.now);
    assert!(rig.wait(5 * MS).contains(&"709#00".to_owned()));
    assert!(rig.exchange("605#4000100000000000").is_empty());
    assert_eq!(rig.exchange("609#4000100000000000").len(), 1);
}
