//! Six axes at a SYNC of 2 ms on the kernel's virtual bus, with a background transfer: commands of a cycle are sent in
//! that cycle, whatever else is sent. Runs on the virtual interface `TAKT_VCAN` or `vcan0`; otherwise it is skipped.
//! Prints the SYNC jitter; the speed of the host is not checked.
#![expect(
    clippy::unwrap_used,
    clippy::print_stderr,
    clippy::disallowed_methods,
    reason = "a test that cannot go on ends"
)]

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use takt_can::canopen::emulator::{DriveNode, DriveNodeConfig};
use takt_can::canopen::network::{
    AxisCommand, AxisPlan, Event, Network, NetworkConfig, NodePlan, Phase, Supervision, Transfer,
};
use takt_can::canopen::sdo::Outcome;
use takt_can::canopen::{NodeId, SYNC};
use takt_can::link::{Link as _, Received};
use takt_can::linux::{Filter, Options, SocketCan, monotonic};
use takt_can::{Frame, Id};
use takt_cia402::Goal;
use takt_cia402::dictionary::Address;
use takt_tests::vcan;

const CSP: i8 = 8;
const MS: Duration = Duration::from_millis(1);
const PERIOD: Duration = Duration::from_millis(2);
/// Period before and after the start of the drives, slow enough for a slow host.
const CALM: Duration = Duration::from_millis(20);
const TIMEOUT: Duration = Duration::from_secs(120);
/// Numbers that no other test on this interface uses.
const NODES: std::ops::RangeInclusive<u8> = 101..=106;
/// Evaluated periods.
const CYCLES: i32 = 500;
/// Bytes of the background transfer.
const LEN: usize = 3_000;

fn node(raw: u8) -> NodeId {
    NodeId::new(raw).unwrap()
}

fn open(interface: &str, filters: &[Filter]) -> SocketCan {
    let options = Options {
        errors: false,
        filters,
        receive_buffer: 16 << 20,
        ..Options::default()
    };
    SocketCan::open(interface, &options).unwrap()
}

/// Runs all drives on one socket until `ends`.
fn serve(interface: &str, ends: &AtomicBool) {
    let mut link = open(interface, &[]);
    let started = monotonic();
    let drive = |raw| {
        let mut config = DriveNodeConfig::new(node(raw));
        // A host that is not real-time misses SYNC now and then.
        config.axes[0].quirks.missing_set_points = None;
        config.domain_len = LEN;
        DriveNode::power_on(config, started).unwrap()
    };
    let mut drives: Vec<_> = NODES.map(drive).collect();
    // On a slow host they run slower: catching up would only increase the load.
    let mut now = started;
    while !ends.load(Ordering::Relaxed) {
        let mut wait = MS / 2;
        for _ in 0..32 {
            let Some(received) = link.receive(wait).unwrap() else {
                break;
            };
            wait = Duration::ZERO;
            if let Some(frame) = received.frame.classic() {
                drives
                    .iter_mut()
                    .for_each(|drive| drive.handle_frame(frame, now));
            }
        }
        now = (now + MS).min(monotonic());
        for drive in &mut drives {
            while let Some(frame) = drive.poll_transmit(now) {
                link.send(&frame.into()).unwrap();
            }
        }
    }
}

struct Master {
    link: SocketCan,
    network: Network,
    next: Duration,
    period: Duration,
    events: Vec<Event>,
}

impl Master {
    fn new(interface: &str) -> Self {
        let plan = |raw| {
            let axis = AxisPlan {
                missing_max: 1_000,
                ..AxisPlan::default()
            };
            let mut plan = NodePlan::drive(node(raw), axis);
            plan.supervision = Supervision::None;
            plan.rpdos.truncate(1);
            plan.tpdos.truncate(1);
            plan.sdo_len_max = LEN;
            plan
        };
        let config = NetworkConfig {
            sdo_timeout: Duration::from_secs(10),
            sdo_per_cycle: 12,
            boot_up_max: Duration::from_secs(20),
            ..NetworkConfig::default()
        };
        Self {
            link: open(interface, &[]),
            network: Network::new(config, NODES.map(plan).collect()).unwrap(),
            next: monotonic(),
            period: CALM,
            events: Vec::new(),
        }
    }

    /// One period, with its received frames.
    fn cycle(&mut self) {
        std::thread::sleep(self.next.saturating_sub(monotonic()));
        let now = monotonic();
        // Missed periods are skipped.
        self.next = (self.next + self.period).max(now);
        self.network.cycle(now);
        while let Some(frame) = self.network.poll_process() {
            self.link.send(&frame.into()).unwrap();
        }
        loop {
            while let Some(frame) = self.network.poll_service(monotonic()) {
                self.link.send(&frame.into()).unwrap();
            }
            let left = (self.next - self.period / 4).saturating_sub(monotonic());
            if left.is_zero() {
                break;
            }
            if let Some(received) = self.link.receive(left).unwrap()
                && let Some(frame) = received.frame.classic()
            {
                self.network.handle_frame(frame, received.at);
            }
        }
        let network = &mut self.network;
        self.events
            .extend(std::iter::from_fn(|| network.poll_event()));
    }

    fn until(&mut self, goal: &str, mut holds: impl FnMut(&mut Self) -> bool) {
        let end = monotonic() + TIMEOUT;
        while !holds(self) {
            assert!(monotonic() < end, "timeout: {goal}: {:?}", self.events);
            self.cycle();
        }
    }

    fn all(&self, holds: impl Fn(NodeId) -> bool) -> bool {
        NODES.map(node).all(holds)
    }

    fn command(&mut self, position: i32) {
        for raw in NODES {
            self.network
                .axis_mut(node(raw), 0)
                .unwrap()
                .command(AxisCommand {
                    position,
                    ..AxisCommand::default()
                });
        }
    }
}

fn is_rpdo(frame: &Frame) -> bool {
    (0x200..0x280).contains(&frame.id().raw())
}

/// 607Ah of an RPDO.
fn target(frame: &Frame) -> i32 {
    i32::from_le_bytes(*frame.data()[3..].first_chunk().unwrap())
}

/// Checks all SYNCs and RPDOs in their order on the bus; returns the number of cycles with their own set-points.
fn judge(frames: &[Received]) -> i32 {
    let mut frames = frames
        .iter()
        .filter_map(|received| received.frame.classic())
        .peekable();
    let mut cycles = 0;
    while let Some(sync) = frames.next() {
        assert_eq!(sync.id(), SYNC, "RPDOs come behind a SYNC");
        let mut seen = Vec::new();
        while let Some(rpdo) = frames.next_if(|frame| is_rpdo(frame)) {
            seen.push((rpdo.id().raw(), target(rpdo)));
        }
        let Some((_, first)) = seen.first().copied() else {
            continue;
        };
        if !(1..=CYCLES).contains(&first) {
            continue;
        }
        let expected: Vec<_> = NODES.map(|raw| (0x200 + u32::from(raw), first)).collect();
        assert_eq!(
            seen, expected,
            "all axes, each once, with the commands of this cycle"
        );
        cycles += 1;
        assert_eq!(
            first, cycles,
            "the set-point of this cycle, none left out, none late"
        );
    }
    cycles
}

fn print_jitter(frames: &[Received]) {
    let is_sync = |r: &&Received| r.frame.classic().is_some_and(|f| f.id() == SYNC);
    let at: Vec<_> = frames.iter().filter(is_sync).map(|r| r.at).collect();
    let mut errors: Vec<_> = at
        .windows(2)
        .map(|pair| pair[1].saturating_sub(pair[0]).abs_diff(PERIOD))
        .collect();
    errors.sort_unstable();
    let part = |per_mille: usize| errors[(errors.len() - 1) * per_mille / 1_000];
    eprintln!(
        "{} intervals of SYNC at {PERIOD:?}, off by: half {:?}, 90 % {:?}, 99 % {:?}, 99.9 % {:?}, all {:?}",
        errors.len(),
        part(500),
        part(900),
        part(990),
        part(999),
        part(1_000)
    );
    for limit in [10, 20, 50, 100, 200, 500, 1_000, 2_000, 5_000] {
        let within = errors.partition_point(|e| *e <= Duration::from_micros(limit));
        eprintln!("  within {limit:5} us: {within:6}");
    }
}

#[test]
fn six_axes_on_vcan_get_each_cycles_commands() {
    let Some(interface) = vcan("six_axes_on_vcan_get_each_cycles_commands") else {
        return;
    };
    let ends = AtomicBool::new(false);
    let filters = [
        Filter::exactly(SYNC),
        Filter::masked(Id::standard(0x200).unwrap(), 0x780),
    ];
    let mut watch = open(&interface, &filters);
    let mut frames: Vec<Received> = Vec::with_capacity(20_000);
    std::thread::scope(|scope| {
        scope.spawn(|| serve(&interface, &ends));
        let mut master = Master::new(&interface);
        master.network.start(monotonic());
        master.until("all running", |m| {
            m.all(|n| m.network.phase(n) == Some(Phase::Running))
        });
        for raw in NODES {
            let axis = master.network.axis_mut(node(raw), 0).unwrap();
            axis.set_goal(Goal::OperationEnabled, CSP);
        }
        master.until("all following", |m| {
            m.all(|n| m.network.axis(n, 0).unwrap().state().follows)
        });
        while watch.receive(Duration::ZERO).unwrap().is_some() {}
        let write = Transfer {
            address: Address::new(0x2000, 0),
            write: true,
            data: vec![0xA5; LEN],
            ..Transfer::default()
        };
        master.network.transfer(node(106), write).unwrap();
        master.period = PERIOD;
        for cycle in 1..=CYCLES {
            master.command(cycle);
            master.cycle();
            frames.extend(std::iter::from_fn(|| {
                watch.receive(Duration::ZERO).unwrap()
            }));
        }
        master.period = CALM;
        let is_written =
            |e: &Event| matches!(e, Event::Transferred(n, _, Outcome::Written) if *n == node(106));
        master.until("the transfer", |m| m.events.iter().any(is_written));
        assert!(master.all(|n| master.network.axis(n, 0).unwrap().state().follows));
        ends.store(true, Ordering::Relaxed);
    });
    assert_eq!(watch.dropped(), 0);
    print_jitter(&frames);
    assert_eq!(judge(&frames), CYCLES);
}
