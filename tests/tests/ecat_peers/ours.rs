//! Our own master on the segment, over the packet socket that drivers use: OP, SDOs beside the cycle, two
//! drives that follow positions by SYNC0, a cable that is cut and reconnected. It is not compared with the others here.

use std::time::Duration;

use takt_cia402::dictionary::{AbortCode, Address};
use takt_ethercat::coe::Whole;
use takt_ethercat::config::{Location, MasterConfig, SlaveSpec, SyncSpec};
use takt_ethercat::emulator::SharedSegment;
use takt_ethercat::link::Port;
use takt_ethercat::linux::{PacketLink, monotonic};
use takt_ethercat::master::{Cable, Event, Job, JobError, JobKind, Master};

use super::crab::{command, feedback, follow};

const CYCLE: Duration = Duration::from_millis(2);
/// Longer than a host stalls: a frame not received by then is lost.
const TIMEOUT: Duration = Duration::from_millis(200);
/// Maximum cycles of any wait: some seconds on a good host, longer on others.
const CYCLES: usize = 10_000;
/// Numbers of the drives.
const DRIVES: [usize; 2] = [3, 4];

struct Line {
    master: Master,
    port: Port<PacketLink>,
    frame: [u8; 1500],
    events: Vec<Event>,
}

fn config() -> MasterConfig {
    let names = ["coupler", "digital", "analogue", "first", "second"];
    let spec = |(position, name): (u16, &&str)| SlaveSpec {
        sync: DRIVES
            .contains(&usize::from(position))
            .then(|| SyncSpec::sync0(CYCLE)),
        // Longer than a host stalls, too.
        watchdog: (position > 0).then_some(10 * TIMEOUT),
        ..SlaveSpec::new(*name, Location::Position(position))
    };
    MasterConfig {
        cycle: CYCLE,
        slaves: (0..).zip(&names).map(spec).collect(),
        ..MasterConfig::default()
    }
}

impl Line {
    fn new(interface: &str) -> Self {
        let link = PacketLink::open(interface).unwrap();
        let mac = link.mac();
        Self {
            master: Master::new(config()).unwrap(),
            port: Port::new(link, mac),
            frame: [0; 1500],
            events: Vec::new(),
        }
    }

    fn cycle(&mut self) {
        let now = monotonic().unwrap();
        if let Some(len) = self.master.poll_transmit(now, &mut self.frame) {
            self.port.send(&self.frame[..len]).unwrap();
            while let Some((bytes, at)) = self.port.receive(TIMEOUT).unwrap() {
                if self.master.handle_frame(0, bytes, at) {
                    break;
                }
            }
        }
        while let Some(event) = self.master.poll_event() {
            self.events.push(event);
        }
        std::thread::sleep(CYCLE);
    }

    #[track_caller]
    fn until(&mut self, holds: impl Fn(&Self) -> bool) {
        for _ in 0..CYCLES {
            if holds(self) {
                return;
            }
            self.cycle();
        }
        let (phase, frames) = (self.master.phase(), self.master.frames());
        panic!("in vain: {phase:?} {frames:?} {:?}", self.events);
    }

    /// Runs a job of a drive while the cycle continues.
    fn ask(&mut self, kind: JobKind, data: Vec<u8>) -> Result<Vec<u8>, JobError> {
        let job = Job {
            slave: DRIVES[0],
            kind,
            data,
            token: 7,
        };
        self.master.submit(job).unwrap();
        for _ in 0..CYCLES {
            if let Some(reply) = self.master.poll_reply() {
                assert_eq!(reply.job.token, 7);
                return reply.result.map(|()| reply.job.data);
            }
            self.cycle();
        }
        panic!("no answer to {kind:?}");
    }

    /// Statusword and position of a drive.
    fn feedback_of(&self, drive: usize) -> (u16, i32) {
        feedback(self.master.inputs(drive).0)
    }

    /// Enables both drives, then moves them by 250 cycles of 20 counts.
    fn moves(&mut self) {
        for _ in 0..CYCLES {
            let words = DRIVES.map(|drive| self.feedback_of(drive));
            if words.iter().all(|(word, _)| word & 0x6F == 0x27) {
                break;
            }
            for (drive, (word, position)) in DRIVES.into_iter().zip(words) {
                command(self.master.outputs_mut(drive), follow(word), position);
            }
            self.cycle();
        }
        let starts = DRIVES.map(|drive| self.feedback_of(drive).1);
        for n in 1..=300 {
            for (drive, start) in DRIVES.into_iter().zip(starts) {
                command(
                    self.master.outputs_mut(drive),
                    0x0F,
                    start + 20 * n.min(250),
                );
            }
            self.master.outputs_mut(1).fill(0xA5);
            self.cycle();
        }
        for (drive, start) in DRIVES.into_iter().zip(starts) {
            let distance = self.feedback_of(drive).1 - start;
            assert!(
                (4900..=5010).contains(&distance),
                "drive {drive} moved {distance}"
            );
        }
        assert_eq!(self.master.inputs(1).0, [0xA5]);
    }
}

fn objects(line: &mut Line) {
    let one = |index, sub| (Address::new(index, sub), Whole::Entry);
    let upload = |(address, whole)| JobKind::Upload { address, whole };
    let download = |(address, whole)| JobKind::Download { address, whole };
    let answer = line.ask(upload(one(0x1000, 0)), Vec::with_capacity(4));
    assert_eq!(answer, Ok(0x0002_0192_u32.to_le_bytes().to_vec()));
    let value = 54_321_u32.to_le_bytes().to_vec();
    assert!(line.ask(download(one(0x6083, 0)), value.clone()).is_ok());
    let answer = line.ask(upload(one(0x6083, 0)), Vec::with_capacity(4));
    assert_eq!(answer, Ok(value));
    let answer = line.ask(upload(one(0x3000, 0)), Vec::with_capacity(4));
    assert_eq!(answer, Err(JobError::Abort(AbortCode::NoObject)));
}

pub(crate) fn drive(interface: &str, segment: &SharedSegment) {
    let mut line = Line::new(interface);
    line.until(|line| line.master.is_operational());
    assert_eq!(line.master.differences(), []);
    objects(&mut line);
    line.moves();
    // They drift apart while the host stalls, and converge again.
    let away = |line: &Line, drive| line.master.slave(drive).unwrap().clock_difference_ns();
    line.until(|line| {
        let mut clocks = DRIVES.into_iter().map(|drive| away(line, drive));
        clocks.all(|away| away.is_some_and(|ns| ns.abs() < 1000))
    });
    let before = line.master.groups()[0].misses;
    segment.lock().set_link(DRIVES[0], false);
    line.until(|line| {
        let (from, to) = (Some((2, 1)), Some(DRIVES[0]));
        let cut = Event::CableCut {
            cable: Cable { from, to },
        };
        line.events.contains(&cut)
    });
    assert!(line.master.groups()[0].misses > before);
    segment.lock().set_link(DRIVES[0], true);
    let runs = |line: &Line, drive| line.master.slave(drive).unwrap().is_running();
    line.until(|line| DRIVES.into_iter().all(|drive| runs(line, drive)));
    line.moves();
    assert_eq!(line.master.frames().foreign, 0);
}
