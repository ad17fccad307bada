//! A CAN bus of 1 Mbit/s in virtual time, with a master and emulated drives. It models frame times and arbitration, but
//! no bits and errors.

use std::collections::VecDeque;
use std::time::Duration;

use takt_can::Frame;
use takt_can::canopen::NodeId;
use takt_can::canopen::emulator::{DriveNode, DriveNodeConfig};
use takt_can::canopen::network::{AxisPlan, Event, Network, NetworkConfig, NodePlan, Phase};
use takt_cia402::emulator::Distortion;
use takt_tests::Random;

pub(crate) const MS: Duration = Duration::from_millis(1);
const TICK: Duration = Duration::from_micros(500);

pub(crate) fn node(raw: u8) -> NodeId {
    NodeId::new(raw).unwrap()
}

/// The plan of a drive that exchanges only its position with SYNC: one PDO per direction.
pub(crate) fn plan(raw: u8) -> NodePlan {
    let mut plan = NodePlan::drive(node(raw), AxisPlan::default());
    plan.rpdos.truncate(1);
    plan.tpdos.truncate(1);
    plan.device_type = Some(0x0002_0192);
    plan
}

/// Distorts the data of an identifier between the bus and the objects of the device.
pub(crate) struct Tamper {
    pub(crate) id: u32,
    /// Lengths of the mapped objects.
    pub(crate) lens: &'static [usize],
    /// The device receives it.
    pub(crate) receives: bool,
    pub(crate) distortion: Distortion,
}

impl Tamper {
    fn apply(&mut self, frame: &Frame) -> Frame {
        let mut data = frame.data().to_vec();
        if self.receives {
            self.distortion.receive(self.lens, &mut data);
        } else {
            self.distortion.transmit(self.lens, &mut data);
        }
        Frame::new(frame.id(), &data).unwrap()
    }
}

pub(crate) struct Bus {
    pub(crate) tamper: Vec<Tamper>,
    pub(crate) now: Duration,
    pub(crate) master: Network,
    pub(crate) drives: Vec<Option<DriveNode>>,
    /// Frames of a foreign sender, back to back.
    pub(crate) foreign_frames: VecDeque<Frame>,
    /// Frames with this identifier are lost for all.
    pub(crate) muted: Option<u32>,
    /// Loss probability of a receiver, 0 to 1.
    pub(crate) loss: f64,
    pub(crate) random: Random,
    pub(crate) period: Duration,
    /// The master is stopped: no cycles and no services.
    pub(crate) master_dead: bool,
    pub(crate) events: Vec<Event>,
    /// Maximum time from the start of a period to the end of one of its RPDOs.
    pub(crate) rpdo_latest: Duration,
    /// RPDOs that were not complete before the next period.
    pub(crate) rpdos_late: u32,
    pub(crate) frames: u64,
    /// SDO aborts sent by the master.
    pub(crate) aborts: u32,
    queues: Vec<VecDeque<Frame>>,
    sending: Option<(Frame, usize, Duration)>,
    begun: Duration,
}

impl Bus {
    pub(crate) fn new(
        config: NetworkConfig,
        plans: Vec<NodePlan>,
        drives: Vec<DriveNodeConfig>,
    ) -> Self {
        let now = Duration::ZERO;
        let drives: Vec<_> = drives
            .into_iter()
            .map(|config| Some(DriveNode::power_on(config, now).unwrap()))
            .collect();
        Self {
            tamper: Vec::new(),
            now,
            master: Network::new(config, plans).unwrap(),
            queues: vec![VecDeque::new(); drives.len() + 2],
            drives,
            foreign_frames: VecDeque::new(),
            muted: None,
            loss: 0.0,
            random: Random::new(1),
            period: 2 * MS,
            master_dead: false,
            events: vec![],
            rpdo_latest: Duration::ZERO,
            rpdos_late: 0,
            frames: 0,
            aborts: 0,
            sending: None,
            begun: now,
        }
    }

    /// Plain drives 1 to `count`, all running, and their master.
    #[allow(
        dead_code,
        reason = "some of the tests that share this bus start it themselves"
    )]
    pub(crate) fn running(count: u8, change: impl Fn(&mut NodePlan)) -> Self {
        let numbers = 1..=count;
        let plans = numbers.clone().map(|raw| {
            let mut plan = plan(raw);
            change(&mut plan);
            plan
        });
        let drives = numbers.map(|raw| DriveNodeConfig::new(node(raw)));
        let mut bus = Self::new(NetworkConfig::default(), plans.collect(), drives.collect());
        bus.master.start(bus.now);
        bus.until(Duration::from_secs(20), |bus| {
            let all = bus
                .master
                .nodes()
                .all(|n| bus.master.phase(n) == Some(Phase::Running));
            all.then_some(())
        });
        bus
    }

    pub(crate) fn drive(&mut self, raw: u8) -> &mut DriveNode {
        self.drives[usize::from(raw) - 1].as_mut().expect("powered")
    }

    /// Runs until the condition holds, at most this long.
    pub(crate) fn until<T>(
        &mut self,
        longest: Duration,
        mut holds: impl FnMut(&mut Self) -> Option<T>,
    ) -> T {
        let end = self.now + longest;
        while self.now < end {
            if let Some(value) = holds(self) {
                return value;
            }
            self.step();
        }
        let nodes: Vec<_> = self.master.nodes().collect();
        for n in nodes {
            let axis = self.master.axis(n, 0);
            let (fault, state) = (axis.and_then(|a| a.fault()), axis.map(|a| *a.state()));
            println!(
                "node {n}: {:?} {:?} {fault:?} {state:?}",
                self.master.phase(n),
                self.master.fault(n)
            );
        }
        panic!("it did not come within {longest:?}, {} aborts", self.aborts);
    }

    pub(crate) fn run(&mut self, time: Duration) {
        let end = self.now + time;
        while self.now < end {
            self.step();
        }
    }

    /// Advances to the next tick or the end of the transmission; polls all nodes.
    pub(crate) fn step(&mut self) {
        let ticks = self.now.as_nanos() / TICK.as_nanos() + 1;
        let tick = TICK * u32::try_from(ticks).unwrap();
        let (next, through) = match self.sending {
            Some((frame, port, end)) if end <= tick => (end, Some((frame, port))),
            _ => (tick, None),
        };
        self.now = next;
        if let Some((frame, port)) = through {
            self.sending = None;
            self.deliver(&frame, port);
        }
        if !self.master_dead && next.as_nanos().is_multiple_of(self.period.as_nanos()) {
            self.begun = next;
            let waits = &self.queues[0];
            self.rpdos_late += u32::try_from(waits.iter().filter(|f| is_rpdo(f)).count()).unwrap();
            self.master.cycle(next);
        }
        self.poll();
        self.arbitrate();
    }

    fn deliver(&mut self, frame: &Frame, port: usize) {
        let id = frame.id().raw();
        let tamper = self.tamper.iter_mut().find(|tamper| tamper.id == id);
        let frame = &tamper.map_or(*frame, |tamper| tamper.apply(frame));
        self.frames += 1;
        let request = frame.id().raw() & 0x780 == 0x600;
        self.aborts += u32::from(port == 0 && request && frame.data().first() == Some(&0x80));
        if is_rpdo(frame) && port == 0 {
            self.rpdo_latest = self.rpdo_latest.max(self.now - self.begun);
        }
        for to in 0..self.drives.len() + 1 {
            if to == port || self.muted == Some(frame.id().raw()) || self.random.chance(self.loss) {
                continue;
            }
            if to == 0 {
                self.master.handle_frame(frame, self.now);
            } else if let Some(drive) = &mut self.drives[to - 1] {
                drive.handle_frame(frame, self.now);
            }
        }
    }

    fn poll(&mut self) {
        let now = self.now;
        let mut idle = false;
        while !self.master_dead && !idle {
            match self.master.poll_transmit(now) {
                Some(frame) => self.queues[0].push_back(frame),
                None => idle = true,
            }
        }
        self.events
            .extend(std::iter::from_fn(|| self.master.poll_event()));
        for (drive, queue) in self.drives.iter_mut().zip(&mut self.queues[1..]) {
            match drive {
                Some(drive) => queue.extend(std::iter::from_fn(|| drive.poll_transmit(now))),
                None => queue.clear(),
            }
        }
        let last = self.queues.len() - 1;
        if self.queues[last].is_empty() {
            self.queues[last].extend(self.foreign_frames.pop_front());
        }
    }

    fn arbitrate(&mut self) {
        if self.sending.is_some() {
            return;
        }
        let heads = self.queues.iter().enumerate();
        let heads = heads.filter_map(|(port, queue)| queue.front().map(|f| (f.id().raw(), port)));
        let Some((_, port)) = heads.min() else {
            return;
        };
        let frame = self.queues[port].pop_front().unwrap();
        // 47 bits around the data, and 10 % stuff bits.
        let bits = (47 + 8 * u64::from(frame.dlc())) * 11 / 10;
        self.sending = Some((frame, port, self.now + Duration::from_micros(bits)));
    }
}

fn is_rpdo(frame: &Frame) -> bool {
    matches!(frame.id().raw() & 0x780, 0x200 | 0x300)
}
