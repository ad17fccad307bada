//! Our drive and our master with python-canopen, over the virtual interface that `TAKT_VCAN` names or `vcan0`. Needs a
//! Python (`TAKT_PYTHON`, else `python3`) that has `canopen`; otherwise the tests are skipped. The speed of the host is
//! not checked.
#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test that cannot go on ends"
)]

use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use takt_can::AnyFrame;
use takt_can::canopen::NodeId;
use takt_can::canopen::emulator::{DriveNode, DriveNodeConfig};
use takt_can::canopen::network::{
    AxisCommand, AxisPlan, Event, Network, NetworkConfig, NodePlan, Phase, Transfer,
};
use takt_can::canopen::sdo::Outcome;
use takt_can::link::Link as _;
use takt_can::linux::{Options, SocketCan, monotonic};
use takt_cia402::Goal;
use takt_cia402::dictionary::Address;

const MS: Duration = Duration::from_millis(1);
const TIMEOUT: Duration = Duration::from_secs(240);

/// Both tests use SYNC: run one after the other.
static BUS: Mutex<()> = Mutex::new(());

fn python() -> String {
    std::env::var("TAKT_PYTHON").unwrap_or_else(|_| "python3".to_owned())
}

fn vcan(test: &str) -> Option<String> {
    let name = takt_tests::vcan(test)?;
    let probe = Command::new(python())
        .args(["-c", "import canopen, can"])
        .stderr(Stdio::null())
        .status();
    if !probe.is_ok_and(|status| status.success()) {
        takt_tests::skip(test, "needs python3 with canopen (pip install canopen)");
        return None;
    }
    Some(name)
}

fn config(raw: u8) -> DriveNodeConfig {
    let mut config = DriveNodeConfig::new(NodeId::new(raw).unwrap());
    config.domain_len = 3000;
    config.sdo_timeout = Duration::from_secs(60);
    config
}

/// The peer's process; its data sheet is a file of its own.
fn peer(role: &str, interface: &str, raw: u8) -> (Child, PathBuf) {
    let sheet = std::env::temp_dir().join(format!("takt-{role}-{}.eds", std::process::id()));
    std::fs::write(&sheet, config(raw).eds().print()).unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/canopen/peer.py");
    let child = Command::new(python())
        .arg(script)
        .args([role, interface, &raw.to_string()])
        .arg(&sheet)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    (child, sheet)
}

#[test]
fn python_canopen_homes_and_moves_our_drive() {
    let Some(interface) = vcan("python_canopen_homes_and_moves_our_drive") else {
        return;
    };
    let _turn = BUS.lock().unwrap_or_else(PoisonError::into_inner);
    let mut link = SocketCan::open(&interface, &Options::default()).unwrap();
    let mut drive = DriveNode::power_on(config(41), monotonic()).unwrap();
    let (mut child, sheet) = peer("lead", &interface, 41);
    let end = monotonic() + TIMEOUT;
    let status = loop {
        if let Some(received) = link.receive(MS).unwrap()
            && let AnyFrame::Classic(frame) = received.frame
        {
            drive.handle_frame(&frame, monotonic());
        }
        while let Some(frame) = drive.poll_transmit(monotonic()) {
            link.send(&frame.into()).unwrap();
        }
        if let Some(status) = child.try_wait().unwrap() {
            break status;
        }
        assert!(monotonic() < end, "python-canopen did not end");
    };
    let lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let printed: Vec<_> = lines.map(Result::unwrap).collect();
    std::fs::remove_file(sheet).unwrap();
    assert!(status.success(), "{printed:?}");
    let expected = [
        "ok boot-up",
        "ok segmented and block transfers",
        "ok a TPDO",
        "ok homing",
        "ok motion",
        "ok down",
    ];
    assert_eq!(printed, expected);
    let axis = drive.application().axis(0).unwrap();
    assert_eq!(axis.state(), takt_cia402::State::SwitchOnDisabled);
    // 12,000 increments at 4096 per turn.
    let turns = axis.motor().position / std::f64::consts::TAU;
    assert!((turns - 12_000.0 / 4096.0).abs() < 0.02, "{turns} turns");
}

struct Lead {
    link: SocketCan,
    network: Network,
    period: Duration,
    next: Duration,
    events: Vec<Event>,
}

impl Lead {
    /// The master of one drive with cyclic synchronous position.
    fn new(link: SocketCan, node: NodeId) -> Self {
        // A Python process needs longer timeouts than a drive.
        let axis = AxisPlan {
            missing_max: 1000,
            ..AxisPlan::default()
        };
        let mut plan = NodePlan::drive(node, axis);
        plan.supervision = takt_can::canopen::network::Supervision::Heartbeat(500 * MS);
        plan.rpdos.truncate(1);
        plan.tpdos.truncate(1);
        plan.device_type = Some(0x0002_0192);
        let config = NetworkConfig {
            boot_up_max: Duration::from_secs(30),
            sdo_timeout: Duration::from_secs(20),
            ..NetworkConfig::default()
        };
        Self {
            link,
            network: Network::new(config, vec![plan]).unwrap(),
            period: 50 * MS,
            next: monotonic(),
            events: vec![],
        }
    }

    fn step(&mut self) {
        let now = monotonic();
        if now >= self.next {
            self.network.cycle(now);
            self.next = now + self.period;
        }
        while let Some(frame) = self.network.poll_transmit(now) {
            self.link.send(&frame.into()).unwrap();
        }
        if let Some(received) = self.link.receive(MS).unwrap()
            && let AnyFrame::Classic(frame) = received.frame
        {
            self.network.handle_frame(&frame, monotonic());
        }
        let network = &mut self.network;
        self.events
            .extend(std::iter::from_fn(|| network.poll_event()));
    }

    /// Reads or writes an object by a transfer that is not in blocks.
    fn transfer(&mut self, node: NodeId, transfer: Transfer) -> (Vec<u8>, Outcome) {
        self.network.transfer(node, transfer).unwrap();
        self.until("the end of a transfer", |l| {
            let at = l
                .events
                .iter()
                .position(|event| matches!(event, Event::Transferred(..)))?;
            if let Event::Transferred(_, done, outcome) = l.events.swap_remove(at) {
                Some((done.data, outcome))
            } else {
                None
            }
        })
    }

    fn read(&mut self, node: NodeId, index: u16) -> Vec<u8> {
        let read = Transfer {
            address: Address::new(index, 0),
            ..Transfer::default()
        };
        let (data, outcome) = self.transfer(node, read);
        assert_eq!(outcome, Outcome::Read);
        data
    }

    fn write(&mut self, node: NodeId, index: u16, data: &[u8]) {
        let write = Transfer {
            address: Address::new(index, 0),
            write: true,
            data: data.to_vec(),
            ..Transfer::default()
        };
        assert_eq!(self.transfer(node, write).1, Outcome::Written);
    }

    fn until<T>(&mut self, goal: &str, mut holds: impl FnMut(&mut Self) -> Option<T>) -> T {
        let end = monotonic() + TIMEOUT;
        while monotonic() < end {
            self.step();
            if let Some(value) = holds(self) {
                return value;
            }
        }
        panic!("timeout: {goal}: {:?}", self.events);
    }
}

#[test]
fn our_master_moves_python_canopen_drive() {
    let Some(interface) = vcan("our_master_moves_python_canopen_drive") else {
        return;
    };
    let _turn = BUS.lock().unwrap_or_else(PoisonError::into_inner);
    let node = NodeId::new(42).unwrap();
    let link = SocketCan::open(&interface, &Options::default()).unwrap();
    let (mut child, sheet) = peer("follow", &interface, 42);
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    assert_eq!(lines.next().unwrap().unwrap(), "ok follows");
    let mut lead = Lead::new(link, node);
    lead.network.start(monotonic());
    let running = |l: &mut Lead| (l.network.phase(node) == Some(Phase::Running)).then_some(());
    lead.until("running", running);
    let begun = lead.until("its position", |l| {
        let at = l.network.axis(node, 0).unwrap().state().position;
        (at != 0).then_some(at)
    });
    assert_eq!(begun, 1000);
    let command = |position| AxisCommand {
        position,
        ..AxisCommand::default()
    };
    let axis = lead.network.axis_mut(node, 0).unwrap();
    axis.command(command(begun));
    axis.set_goal(Goal::OperationEnabled, 8);
    lead.until("following", |l| {
        l.network
            .axis(node, 0)
            .unwrap()
            .state()
            .follows
            .then_some(())
    });
    lead.network
        .axis_mut(node, 0)
        .unwrap()
        .command(command(1234));
    lead.until("the move", |l| {
        (l.network.axis(node, 0).unwrap().state().position == 1234).then_some(())
    });
    assert_eq!(lead.read(node, 0x1008), b"Takt emulated drive");
    let value: Vec<u8> = (0..3000_u32)
        .map(|n| (n * 7 % 251).to_le_bytes()[0])
        .collect();
    lead.write(node, 0x2000, &value);
    assert_eq!(
        lead.read(node, 0x2000),
        value,
        "in segments, both directions"
    );
    lead.network.axis_mut(node, 0).unwrap().home();
    lead.until("homing", |l| {
        l.events.contains(&Event::Homed(node)).then_some(())
    });
    let axis = lead.network.axis_mut(node, 0).unwrap();
    assert_eq!((axis.state().homed, axis.state().position), (1, 0));
    axis.command(command(500));
    lead.until("a move from its home", |l| {
        (l.network.axis(node, 0).unwrap().state().position == 500).then_some(())
    });
    drop(child.stdin.take());
    assert_eq!(lines.next().unwrap().unwrap(), "position 500");
    assert!(child.wait().unwrap().success());
    std::fs::remove_file(sheet).unwrap();
}
