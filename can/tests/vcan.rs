//! SocketCAN with the kernel and with common programs (can-utils, python-can). Runs on the virtual interface
//! `TAKT_VCAN` or `vcan0`; otherwise the tests are skipped. Tests that need controllers use two connected ones, named
//! by `TAKT_CAN_PAIR` (`can0,can1`). The speed of the host is not checked.
#![expect(
    clippy::unwrap_used,
    clippy::panic,
    clippy::disallowed_methods,
    reason = "a test that cannot go on ends"
)]

use std::io::{BufRead as _, BufReader, Read as _};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use takt_can::link::{Link as _, LinkError, Origin, Received};
use takt_can::linux::{
    Clock, Cyclic, Filter, Interface, Options, QueuePolicy, Setup, SocketCan, Step, Watch, Watched,
    monotonic, wall,
};
use takt_can::log::{LogLine, parse_frame};
use takt_can::{AnyFrame, BusState, ErrorFrame, FdFrame, Frame, Id};
use takt_tests::{skip, vcan};

const TIMEOUT: Duration = Duration::from_secs(20);

fn has(program: &str) -> bool {
    let paths = std::env::var_os("PATH").unwrap_or_default();
    std::env::split_paths(&paths).any(|path| path.join(program).is_file())
}

fn id(raw: u16) -> Id {
    Id::standard(raw).unwrap()
}

fn data(raw: u16, data: &[u8]) -> AnyFrame {
    Frame::new(id(raw), data).unwrap().into()
}

/// Receives only this identifier, so that parallel tests do not disturb each other.
fn open(interface: &str, raw: u16) -> SocketCan {
    let filters = [Filter::exactly(id(raw))];
    let options = Options {
        errors: false,
        filters: &filters,
        ..Options::default()
    };
    SocketCan::open(interface, &options).unwrap()
}

#[track_caller]
fn receive(link: &mut SocketCan) -> Received {
    let until = monotonic() + TIMEOUT;
    while monotonic() < until {
        if let Some(received) = link.receive(Duration::from_millis(100)).unwrap() {
            return received;
        }
    }
    panic!("no frame within {TIMEOUT:?}");
}

#[test]
fn socket_distinguishes_own_and_host_frames() {
    let Some(vcan) = vcan("socket_distinguishes_own_and_host_frames") else {
        return;
    };
    let filters = [Filter::exactly(id(0x101))];
    let options = Options {
        own: true,
        filters: &filters,
        ..Options::default()
    };
    let mut sender = SocketCan::open(&vcan, &options).unwrap();
    let mut other = open(&vcan, 0x101);
    let before = monotonic();
    sender.send(&data(0x101, &[1, 2, 3])).unwrap();
    let (own, foreign) = (receive(&mut sender), receive(&mut other));
    assert_eq!((own.origin, foreign.origin), (Origin::Own, Origin::Host));
    assert_eq!(
        (own.frame, foreign.frame),
        (data(0x101, &[1, 2, 3]), data(0x101, &[1, 2, 3]))
    );
    // The two clocks are read one after the other, so allow for some slack.
    let slack = Duration::from_millis(100);
    assert!(foreign.at + slack >= before && foreign.at <= monotonic() + slack);
    assert_eq!(foreign.hardware, None);
    assert!(!other.has_hardware_stamps());
    assert_eq!(other.receive(Duration::ZERO), Ok(None));
}

#[test]
fn socket_time_stamps_use_requested_clock() {
    let Some(vcan) = vcan("socket_time_stamps_use_requested_clock") else {
        return;
    };
    let options = Options {
        clock: Clock::Wall,
        ..Options::default()
    };
    let mut link = SocketCan::open(&vcan, &options).unwrap();
    open(&vcan, 0x102).send(&data(0x102, &[])).unwrap();
    let received = loop {
        let received = receive(&mut link);
        if received.frame == data(0x102, &[]) {
            break received;
        }
    };
    assert!(wall().abs_diff(received.at) < Duration::from_secs(60));
}

#[test]
fn socket_filters_accept_matching_frames() {
    let Some(vcan) = vcan("socket_filters_accept_matching_frames") else {
        return;
    };
    let long = Id::extended(0x103).unwrap();
    let filters = [Filter::masked(id(0x110), 0x7FE), Filter::exactly(long)];
    let options = Options {
        errors: false,
        filters: &filters,
        ..Options::default()
    };
    let mut link = SocketCan::open(&vcan, &options).unwrap();
    let mut sender = open(&vcan, 0x7FF);
    let extended: AnyFrame = Frame::empty(long).into();
    for frame in [
        data(0x103, &[]),
        data(0x112, &[]),
        data(0x111, &[]),
        extended,
    ] {
        sender.send(&frame).unwrap();
    }
    assert_eq!(receive(&mut link).frame, data(0x111, &[]));
    assert_eq!(receive(&mut link).frame, extended);
}

#[test]
fn socket_every_kind_of_frame_arrives_unchanged() {
    let Some(vcan) = vcan("socket_every_kind_of_frame_arrives_unchanged") else {
        return;
    };
    let (mut sender, mut link) = (open(&vcan, 0x104), open(&vcan, 0x104));
    let fd: AnyFrame = FdFrame::new(id(0x104), &[0xA5; 64])
        .unwrap()
        .with_flags(1)
        .into();
    let remote: AnyFrame = Frame::remote(id(0x104), 4).unwrap().into();
    for frame in [data(0x104, &[0; 8]), remote, fd, data(0x104, &[])] {
        sender.send(&frame).unwrap();
        assert_eq!(receive(&mut link).frame, frame);
    }
}

#[test]
fn socket_error_frames_arrive_with_class_and_data() {
    let Some(vcan) = vcan("socket_error_frames_arrive_with_class_and_data") else {
        return;
    };
    let mut link = SocketCan::open(&vcan, &Options::default()).unwrap();
    let report = ErrorFrame::new(0x044, [0, 0x30, 0, 0, 0, 0, 0x82, 0x05]);
    open(&vcan, 0x7FE).send(&report.into()).unwrap();
    let received = loop {
        if let AnyFrame::Error(received) = receive(&mut link).frame {
            break received;
        }
    };
    assert_eq!(
        (received, received.state()),
        (report, Some(BusState::BusOff))
    );
}

/// Frames beyond the socket's buffer are lost; their count arrives with the next frame.
#[test]
fn socket_lost_frames_are_counted() {
    let Some(vcan) = vcan("socket_lost_frames_are_counted") else {
        return;
    };
    let filters = [Filter::exactly(id(0x105))];
    let options = Options {
        filters: &filters,
        receive_buffer: 65_536,
        ..Options::default()
    };
    let mut link = SocketCan::open(&vcan, &options).unwrap();
    let mut sender = open(&vcan, 0x7FD);
    let sent = 2_000;
    for _ in 0..sent {
        sender.send(&data(0x105, &[7; 8])).unwrap();
    }
    let mut kept = 0;
    while let Some(received) = link.receive(Duration::ZERO).unwrap() {
        assert_eq!(received.dropped, 0);
        kept += 1;
    }
    assert!(kept > 10 && kept < sent, "{kept}");
    sender.send(&data(0x105, &[8; 8])).unwrap();
    assert_eq!(receive(&mut link).dropped, sent - kept);
    assert_eq!(link.dropped(), sent - kept);
}

#[test]
fn socket_default_buffer_holds_quarter_second_of_full_bus() {
    let Some(vcan) = vcan("socket_default_buffer_holds_quarter_second_of_full_bus") else {
        return;
    };
    let mut link = open(&vcan, 0x106);
    let mut sender = open(&vcan, 0x7FC);
    for number in 0..2_000_u32 {
        sender.send(&data(0x106, &number.to_le_bytes())).unwrap();
    }
    for number in 0..2_000_u32 {
        assert_eq!(receive(&mut link).frame, data(0x106, &number.to_le_bytes()));
    }
    assert_eq!(link.dropped(), 0);
}

/// Kills its program at the end of a test.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn candump_receives_our_frames() {
    let test = "candump_receives_our_frames";
    let Some(vcan) = vcan(test) else { return };
    if !has("candump") {
        return skip(test, "needs candump of can-utils");
    }
    let filter = format!("{vcan},107:7FF");
    let mut child = Command::new("candump");
    let child = child.args(["-L", "-x", &filter]).stdout(Stdio::piped());
    let mut dump = Running(child.spawn().unwrap());
    let (texts, receiver) = std::sync::mpsc::channel();
    let out = BufReader::new(dump.0.stdout.take().unwrap());
    std::thread::spawn(move || {
        out.lines()
            .map_while(Result::ok)
            .for_each(|l| drop(texts.send(l)));
    });
    let mut sender = open(&vcan, 0x7FB);
    let frame = data(0x107, &[0xDE, 0xAD]);
    // It takes a while until it receives.
    let line = (0..200).find_map(|_| {
        sender.send(&frame).unwrap();
        receiver.recv_timeout(Duration::from_millis(100)).ok()
    });
    let line = line.unwrap();
    // Older versions do not know the direction in logs.
    let line = LogLine::parse(&line).unwrap();
    assert_eq!(
        (AnyFrame::from(line.frame), line.interface),
        (frame, vcan.as_str())
    );
}

#[test]
fn socket_receives_frames_of_cansend() {
    let test = "socket_receives_frames_of_cansend";
    let Some(vcan) = vcan(test) else { return };
    if !has("cansend") {
        return skip(test, "needs cansend of can-utils");
    }
    let mut link = open(&vcan, 0x108);
    for text in ["108#DEADBEEF", "108#R", "108##1112233", "108#"] {
        let status = Command::new("cansend")
            .args([&vcan, text])
            .status()
            .unwrap();
        assert!(status.success());
        let received = receive(&mut link);
        assert_eq!(received.frame, parse_frame(text).unwrap(), "{text}");
        assert_eq!(received.origin, Origin::Host);
    }
}

const ECHO: &str = "
import can, sys
bus = can.Bus(interface='socketcan', channel=sys.argv[1], fd=True,
              can_filters=[{'can_id': 0x109, 'can_mask': 0x7ff, 'extended': False}])
print('ready', flush=True)
for _ in range(2):
    m = bus.recv(20)
    m.arbitration_id = 0x10A
    bus.send(m)
";

#[test]
fn python_can_echoes_every_kind_of_frame() {
    let test = "python_can_echoes_every_kind_of_frame";
    let Some(vcan) = vcan(test) else { return };
    let python = std::env::var("TAKT_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    // Not in this folder: Python would import it as the module.
    let run = |arguments: &[&str]| {
        let mut command = Command::new(&python);
        command
            .args(arguments)
            .current_dir("/")
            .stdout(Stdio::piped())
            .stderr(Stdio::null());
        command
    };
    if !run(&["-c", "import can; can.Bus"])
        .status()
        .is_ok_and(|s| s.success())
    {
        return skip(test, "needs python-can");
    }
    let mut peer = Running(run(&["-c", ECHO, &vcan]).spawn().unwrap());
    let mut ready = [0; 5];
    peer.0
        .stdout
        .take()
        .unwrap()
        .read_exact(&mut ready)
        .unwrap();
    let mut link = open(&vcan, 0x10A);
    let fd = |raw| AnyFrame::from(FdFrame::new(id(raw), &[3; 12]).unwrap().with_flags(1));
    link.send(&data(0x109, &[1, 2])).unwrap();
    assert_eq!(receive(&mut link).frame, data(0x10A, &[1, 2]));
    link.send(&fd(0x109)).unwrap();
    assert_eq!(receive(&mut link).frame, fd(0x10A));
}

#[test]
fn kernel_cyclic_transmission_stops_on_drop() {
    let Some(vcan) = vcan("kernel_cyclic_transmission_stops_on_drop") else {
        return;
    };
    let mut link = open(&vcan, 0x10B);
    let frame = |byte| Frame::new(id(0x10B), &[byte]).unwrap();
    let Ok(cyclic) = Cyclic::start(&vcan, &frame(1), Duration::from_millis(10)) else {
        return skip(
            "kernel_cyclic_transmission_stops_on_drop",
            "needs the module can-bcm",
        );
    };
    for _ in 0..3 {
        assert_eq!(receive(&mut link).frame, frame(1).into());
    }
    cyclic.update(&frame(2)).unwrap();
    while receive(&mut link).frame != frame(2).into() {}
    drop(cyclic);
    while link.receive(Duration::ZERO).unwrap().is_some() {}
    assert_eq!(link.receive(Duration::from_millis(200)), Ok(None));
}

#[test]
fn kernel_reports_receive_timeout() {
    let Some(vcan) = vcan("kernel_reports_receive_timeout") else {
        return;
    };
    let Ok(watch) = Watch::start(&vcan, id(0x70C), Duration::from_millis(100)) else {
        return skip("kernel_reports_receive_timeout", "needs the module can-bcm");
    };
    let beat = Frame::new(id(0x70C), &[5]).unwrap();
    let mut sender = open(&vcan, 0x7FA);
    sender.send(&beat.into()).unwrap();
    assert_eq!(watch.wait(TIMEOUT).unwrap(), Some(Watched::Changed(beat)));
    assert_eq!(
        watch.wait(TIMEOUT).unwrap(),
        Some(Watched::Silent(id(0x70C)))
    );
    sender.send(&beat.into()).unwrap();
    assert_eq!(
        watch.wait(TIMEOUT).unwrap(),
        Some(Watched::Changed(beat)),
        "it is back"
    );
}

#[test]
fn virtual_interface_reports_state_and_rejects_bit_rate() {
    let test = "virtual_interface_reports_state_and_rejects_bit_rate";
    let Some(vcan) = vcan(test) else { return };
    let interface = Interface::open(&vcan).unwrap();
    let details = interface.details().unwrap();
    assert!(details.up && details.is_virtual() && details.rates().is_none());
    let Some(own) = Own::create(test, "taktvcan0") else {
        return;
    };
    let interface = Interface::open(own.0).unwrap();
    assert!(!interface.details().unwrap().up);
    let mut link = SocketCan::open(own.0, &Options::default()).unwrap();
    assert_eq!(link.send(&data(1, &[])), Err(LinkError::Down));
    let bitrate = Setup {
        bitrate: Some(500_000),
        ..Setup::default()
    };
    let error = interface.set_up(&bitrate).unwrap_err().to_string();
    assert!(
        error.contains("cannot set the bit rate: it is virtual"),
        "{error}"
    );
    let queue = Setup {
        queue: Some(77),
        ..Setup::default()
    };
    assert_eq!(interface.set_up(&queue).unwrap(), [Step::Queue, Step::Up]);
    let details = interface.details().unwrap();
    assert_eq!((details.up, details.queue), (true, Some(77)));
    drop(own);
    assert!(matches!(link.send(&data(1, &[])), Err(LinkError::Lost)));
}

/// A virtual interface for one test.
struct Own(&'static str);

impl Own {
    fn create(test: &str, name: &'static str) -> Option<Self> {
        match socketcan::CanInterface::create_vcan(name, None) {
            Ok(_) => Some(Self(name)),
            Err(error) => {
                skip(
                    test,
                    &format!("needs to create a virtual interface: {error}"),
                );
                None
            }
        }
    }
}

impl Drop for Own {
    fn drop(&mut self) {
        if let Ok(interface) = socketcan::CanInterface::open(self.0) {
            let _ = interface.delete();
        }
    }
}

/// A traffic shaper emulates a slow bus.
#[test]
fn socket_full_queue_returns_error_or_blocks() {
    let test = "socket_full_queue_returns_error_or_blocks";
    if vcan(test).is_none() {
        return;
    }
    if !has("tc") {
        return skip(test, "needs tc of iproute2");
    }
    let Some(own) = Own::create(test, "taktvcan1") else {
        return;
    };
    Interface::open(own.0)
        .unwrap()
        .set_up(&Setup::default())
        .unwrap();
    let shaper = [
        "qdisc", "replace", "dev", own.0, "root", "tbf", "rate", "100kbit", "burst", "1600",
        "limit", "1600",
    ];
    if !Command::new("tc").args(shaper).status().unwrap().success() {
        return skip(test, "needs the module sch_tbf");
    }
    let mut hasty = SocketCan::open(own.0, &Options::default()).unwrap();
    // The shaper drains its queue meanwhile, as fast as a bus would: only the first error is certain, as soon as frames
    // are sent faster than that.
    let error = (0..1_000_000).find_map(|_| hasty.send(&data(1, &[0; 8])).err());
    assert_eq!(error, Some(LinkError::QueueFull));
    assert_eq!(hasty.refused(), 1);
    let options = Options {
        queue: QueuePolicy::Wait(TIMEOUT),
        ..Options::default()
    };
    let mut patient = SocketCan::open(own.0, &options).unwrap();
    for number in 0..300_u32 {
        assert_eq!(
            patient.send(&data(2, &number.to_le_bytes())),
            Ok(()),
            "{number}"
        );
    }
    assert_eq!(patient.refused(), 0);
}

/// Configures a 1 Mbit/s bus and checks the state.
fn set_up_for_a_pair(name: &str) {
    let setup = Setup {
        bitrate: Some(1_000_000),
        restart: Some(Duration::from_millis(100)),
        report_errors: Some(true),
        queue: Some(10),
        ..Setup::default()
    };
    let interface = Interface::open(name).unwrap();
    interface.set_up(&setup).unwrap();
    let details = interface.details().unwrap();
    assert!(details.up && !details.is_virtual());
    assert_eq!(details.bitrate, Some(1_000_000));
    assert_eq!(details.state, Some(BusState::ErrorActive));
    assert_eq!(
        (details.restart, details.report_errors),
        (Some(Duration::from_millis(100)), true)
    );
    assert_eq!(details.queue, Some(10));
}

/// Two connected controllers, as emulated by QEMU: configuration, exchange, full queue, statistics.
#[test]
fn controllers_are_configured_and_exchange_frames() {
    let test = "controllers_are_configured_and_exchange_frames";
    let Some(pair) = std::env::var("TAKT_CAN_PAIR").ok() else {
        return skip(
            test,
            "needs two CAN controllers on one wire (TAKT_CAN_PAIR=can0,can1)",
        );
    };
    let (first, second) = pair.split_once(',').unwrap();
    let impossible = Setup {
        bitrate: Some(7_777_777),
        ..Setup::default()
    };
    let error = Interface::open(first).unwrap().set_up(&impossible);
    let error = error.unwrap_err().to_string();
    assert!(
        error.contains("cannot set the bit rate: the controller's clock of 8 MHz"),
        "{error}"
    );
    eprintln!("{error}");
    [first, second].into_iter().for_each(set_up_for_a_pair);
    let options = Options {
        own: true,
        ..Options::default()
    };
    let mut a = SocketCan::open(first, &options).unwrap();
    let mut b = SocketCan::open(second, &options).unwrap();
    a.send(&data(0x181, &[1, 2, 3])).unwrap();
    let (received, own) = (receive(&mut b), receive(&mut a));
    assert_eq!((received.origin, own.origin), (Origin::Bus, Origin::Own));
    assert_eq!(received.frame, own.frame);
    // Faster than 1 Mbit/s.
    let sent = |number: u32| Some((number, a.send(&data(1, &[0; 8])).err()?));
    let error = (0..1_000_000).find_map(sent);
    eprintln!("frames until the queue was full, and the error: {error:?}");
    assert_eq!(error.map(|(_, error)| error), Some(LinkError::QueueFull));
    assert_eq!(a.refused(), 1);
    let options = Options {
        queue: QueuePolicy::Wait(TIMEOUT),
        ..Options::default()
    };
    let mut patient = SocketCan::open(first, &options).unwrap();
    // The peer may be too slow for so many frames; the echo of each arrives after its transmission. A socket buffers
    // only some hundred, so they are read as they arrive: first those of the burst.
    while a.receive(Duration::from_millis(200)).unwrap().is_some() {}
    for batch in 0..10_u32 {
        let mut last = None;
        for number in 0..50 {
            let frame = data(2, &(50 * batch + number).to_le_bytes());
            assert_eq!(patient.send(&frame), Ok(()), "{batch} {number}");
            last = Some(frame);
        }
        while Some(receive(&mut a).frame) != last {}
    }
}
