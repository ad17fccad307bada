//! Cost of a frame from the socket to its decoded message: received one by one or 32 per system call, decoded as
//! CANopen and counted, compared with bare receive loops: `read`, `recv`, and `recvmsg` with the same control messages
//! (time stamp, losses). Runs on `TAKT_VCAN` or `vcan0`; without an interface the in-process bus replaces the sockets.
//! `cargo bench -p takt-can`.
//!
//! Compare the ratios; absolute figures depend on the machine. Rounds alternate and medians are compared. One second of
//! a fully loaded 1 Mbit/s bus is about 8,000 frames.
#![expect(clippy::print_stdout, reason = "a benchmark prints its result")]

use std::hint::black_box;
use std::io::IoSliceMut;
use std::os::fd::{AsRawFd as _, BorrowedFd};
use std::path::Path;
use std::time::Duration;

use takt_can::bits::Rates;
use takt_can::bus::{Bus, Config, PortId};
use takt_can::canopen::Message;
use takt_can::link::{Link as _, Received};
use takt_can::linux::{Options, SocketCan, monotonic};
use takt_can::stat::Meter;
use takt_can::{AnyFrame, Frame, Id};

const FRAMES: usize = 2_000;
const ROUNDS: usize = 21;

/// The traffic of a cell: SYNC, PDOs of six drives, now and then a heartbeat.
fn traffic() -> Vec<AnyFrame> {
    let frame = |id: u16, data: &[u8]| -> AnyFrame {
        let id = Id::standard(id).expect("11 bits");
        Frame::new(id, data).expect("up to eight bytes").into()
    };
    let mut frames = Vec::new();
    for turn in 0_u16.. {
        frames.push(frame(0x080, &[]));
        for node in 1..=6 {
            let [low, _] = turn.to_le_bytes();
            frames.push(frame(0x200 + node, &[0x0F, 0, low, 1, 2, 3]));
            frames.push(frame(0x180 + node, &[0x37, 0x06, low, 1, 2, 3]));
        }
        if turn % 50 == 0 {
            frames.push(frame(0x701 + turn / 50 % 6, &[5]));
        }
        if frames.len() >= FRAMES {
            break;
        }
    }
    frames.truncate(FRAMES);
    frames
}

/// Processing of a frame.
#[derive(Clone, Copy, PartialEq)]
enum Work {
    Receive,
    Dispatch,
    Measure,
}

struct Worker {
    work: Work,
    messages: u64,
    meter: Meter,
}

impl Worker {
    fn new(work: Work) -> Self {
        Self {
            work,
            messages: 0,
            meter: Meter::new(Some(Rates::classic(1_000_000))),
        }
    }

    fn handle(&mut self, received: &Received) {
        if self.work != Work::Receive
            && let Some(frame) = received.frame.classic()
        {
            let message = black_box(Message::decode(frame));
            self.messages += u64::from(!matches!(message, Message::Unknown));
        }
        if self.work == Work::Measure {
            self.meter.handle_frame(received);
        }
        black_box(received);
    }
}

/// System call of a bare receive loop.
#[derive(Clone, Copy)]
enum Bare {
    Read,
    Recv,
    RecvMsg,
}

/// One system call per frame without processing.
fn bare(fd: BorrowedFd<'_>, call: Bare) -> usize {
    use nix::sys::socket::{MsgFlags, recv, recvmsg};
    let mut bytes = [0_u8; 72];
    let mut control = [0; 128];
    let mut one = || match call {
        Bare::Read => nix::unistd::read(fd, &mut bytes).is_ok(),
        Bare::Recv => recv(fd.as_raw_fd(), &mut bytes, MsgFlags::MSG_DONTWAIT).is_ok(),
        Bare::RecvMsg => {
            let mut vector = [IoSliceMut::new(&mut bytes)];
            let (fd, control) = (fd.as_raw_fd(), Some(control.as_mut_slice()));
            recvmsg::<()>(fd, &mut vector, control, MsgFlags::MSG_DONTWAIT).is_ok()
        }
    };
    (0..FRAMES).take_while(|_| black_box(one())).count()
}

fn ns_per_frame(work: impl FnOnce() -> usize) -> f64 {
    let start = monotonic();
    let count = work();
    let span = monotonic().saturating_sub(start);
    assert_eq!(count, FRAMES, "frames were lost");
    span.as_secs_f64() * 1e9 / FRAMES as f64
}

fn drain(link: &mut SocketCan, worker: &mut Worker) -> usize {
    let mut count = 0;
    while let Ok(Some(received)) = link.receive(Duration::ZERO) {
        worker.handle(&received);
        count += 1;
        if count == FRAMES {
            break;
        }
    }
    count
}

/// A measured case.
#[derive(Clone, Copy)]
enum Case {
    Bare(Bare),
    /// Maximum frames per call, and their processing.
    Link(usize, Work),
}

const CASES: [(&str, &str, Case); 8] = [
    ("recv", "recv loop", Case::Bare(Bare::Recv)),
    ("read", "read loop", Case::Bare(Bare::Read)),
    ("recvmsg", "recvmsg loop", Case::Bare(Bare::RecvMsg)),
    (
        "single_receive",
        "one by one, received",
        Case::Link(1, Work::Receive),
    ),
    (
        "single",
        "one by one, decoded",
        Case::Link(1, Work::Dispatch),
    ),
    (
        "batch_receive",
        "32 by a call, received",
        Case::Link(32, Work::Receive),
    ),
    (
        "batch",
        "32 by a call, decoded",
        Case::Link(32, Work::Dispatch),
    ),
    (
        "measure",
        "32 by a call, measured",
        Case::Link(32, Work::Measure),
    ),
];

/// ns per frame of each case.
fn sockets(interface: &str) -> [f64; CASES.len()] {
    let options = Options {
        receive_buffer: 8 << 20,
        ..Options::default()
    };
    let open = || SocketCan::open(interface, &options).expect("the interface is there");
    let (frames, mut sender) = (traffic(), open());
    let mut rounds = [const { Vec::new() }; CASES.len()];
    for _ in 0..ROUNDS {
        for ((.., case), times) in CASES.iter().zip(&mut rounds) {
            let mut link = open();
            frames
                .iter()
                .for_each(|frame| sender.send(frame).expect("a virtual bus is never full"));
            times.push(match case {
                Case::Bare(call) => ns_per_frame(|| bare(link.fd(), *call)),
                Case::Link(batch, work) => {
                    link.set_batch(*batch);
                    let mut worker = Worker::new(*work);
                    ns_per_frame(|| drain(&mut link, &mut worker))
                }
            });
        }
    }
    rounds.map(median)
}

/// A bus after delivery of all frames to the second port.
fn loaded(frames: &[AnyFrame]) -> (Bus, PortId) {
    let mut bus = Bus::new(Config {
        send_queue: FRAMES,
        receive_queue: FRAMES,
        ..Config::default()
    });
    let (from, to) = (bus.attach(), bus.attach());
    for frame in frames {
        bus.send(from, frame, Duration::ZERO)
            .expect("the queue has capacity");
    }
    bus.advance(Duration::from_secs(1));
    (bus, to)
}

fn in_process() -> [f64; 3] {
    let frames = traffic();
    let mut rounds = [const { Vec::new() }; 3];
    for _ in 0..ROUNDS {
        for (work, times) in [Work::Receive, Work::Dispatch, Work::Measure]
            .iter()
            .zip(&mut rounds)
        {
            let (mut bus, port) = loaded(&frames);
            let mut worker = Worker::new(*work);
            times.push(ns_per_frame(|| {
                let mut count = 0;
                while let Some(received) = bus.receive(port) {
                    worker.handle(&received);
                    count += 1;
                }
                count
            }));
        }
    }
    rounds.map(median)
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// CPU load of a full 1 Mbit/s bus, %.
fn full_load(ns: f64) -> f64 {
    ns * 8_000.0 / 1e7
}

fn main() {
    let vcan = std::env::var("TAKT_VCAN").unwrap_or_else(|_| "vcan0".to_owned());
    let [receive, dispatch, measure] = in_process();
    println!(
        "in-process bus, ns per frame: taken out {receive:.0}, decoded {dispatch:.0}, measured {measure:.0}"
    );
    let mut figures = format!(
        "\"in_process_receive_ns\":{receive:.1},\"in_process_dispatch_ns\":{dispatch:.1},\"in_process_measure_ns\":{measure:.1}"
    );
    if Path::new("/sys/class/net").join(&vcan).exists() {
        let times = sockets(&vcan);
        let [recv, read, recvmsg, ..] = times;
        println!(
            "{vcan}: {:24} ns per frame, ratio to recv, read, recvmsg",
            ""
        );
        for ((key, name, _), ns) in CASES.iter().zip(times) {
            let load = full_load(ns);
            let [recv, read, recvmsg] = [recv, read, recvmsg].map(|bare| ns / bare);
            println!(
                "{vcan}: {name:24} {ns:12.0} {recv:14.2} {read:5.2} {recvmsg:8.2}, {load:.2} % at 8,000 frames/s"
            );
            figures += &format!(",\"{key}_ns\":{ns:.1},\"{key}_ratio\":{recv:.3}");
        }
    }
    println!("{{\"bench\":\"can_dispatch\",{figures}}}");
}
