//! A virtual cable in a network namespace of the calling thread, the segment served at one
//! end of it, and a capture. The masters are elsewhere.

use std::fs::File;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use nix::sched::{CloneFlags, unshare};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use takt_ethercat::emulator::{
    Coupler, Io, Profile, Segment, Server, ServoConfig, ServoDrive, SharedSegment,
};
use takt_ethercat::linux::{PacketLink, monotonic};
use takt_rt::thread::{Thread, ThreadConfig, spawn};
use takt_tests::skip;

/// The end of the segment.
const NEAR: &str = "ecat-seg";
/// The end of the master.
const FAR: &str = "ecat-master";

/// The cable; it is removed with the thread that created it and its children.
pub(crate) struct Cable {
    /// Serializes these tests: each runs in real time and needs the host.
    _turn: File,
}

impl Cable {
    /// Creates it in a namespace of this thread's own, or records why it cannot.
    pub(crate) fn lay(test: &str) -> Option<Self> {
        if let Err(error) = unshare(CloneFlags::CLONE_NEWNET) {
            let why = format!(
                "needs a veth pair of its own, so CAP_SYS_ADMIN and CAP_NET_ADMIN: {error}"
            );
            skip(test, &why);
            return None;
        }
        let done = ip(&["link", "add", NEAR, "type", "veth", "peer", "name", FAR])
            && ip(&["link", "set", NEAR, "up"])
            && ip(&["link", "set", FAR, "up"]);
        if !done {
            skip(test, "needs `ip` and veth (CONFIG_VETH)");
            return None;
        }
        let turn = File::create(std::env::temp_dir().join("takt-ecat-peers.lock")).unwrap();
        turn.lock().unwrap();
        Some(Self { _turn: turn })
    }

    pub(crate) const fn master(&self) -> &'static str {
        FAR
    }
}

fn ip(arguments: &[&str]) -> bool {
    let status = Command::new("ip").args(arguments).status();
    status.is_ok_and(|status| status.success())
}

/// The served segment.
pub(crate) struct Served {
    pub(crate) segment: SharedSegment,
    stop: Arc<AtomicBool>,
    thread: Thread<()>,
}

impl Served {
    pub(crate) fn end(self) {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.join().unwrap();
    }
}

/// A segment, and the terminals whose outputs are looped back to inputs.
pub(crate) struct Bench {
    segment: Segment,
    loops: Vec<Io>,
}

/// A coupler, 8+8 digital and 1+1 analogue channels, two drives with clocks of their own.
pub(crate) fn segment() -> Bench {
    let (digital, first) = Io::digital(8, 8);
    let (analogue, second) = Io::analogue(1, 1);
    let drive = |drift_ppb| {
        let mut config = ServoConfig {
            clock: (0, drift_ppb),
            ..ServoConfig::default()
        };
        // These masters are not real-time here: they miss SYNC0 now and then.
        config.axes[0].quirks.missing_set_points = None;
        let (slave, _) = ServoDrive::slave(config).unwrap();
        slave
    };
    let slaves = [
        Coupler::slave(),
        digital,
        analogue,
        drive(20_000),
        drive(-30_000),
    ];
    Bench {
        segment: Segment::line(slaves),
        loops: vec![first, second],
    }
}

/// A coupler, and two drives that serve a log file and take firmware in BOOT; the first is busy twice at each packet.
pub(crate) fn files() -> Bench {
    let drive = |busy| {
        let (drive, _) = ServoDrive::slave(ServoConfig::default()).unwrap();
        let drive = drive.with_files();
        let files = drive.files().unwrap();
        let log = (0..=255).cycle().take(3 * 256).collect();
        files.lock().files.insert(b"log".to_vec(), log);
        files.lock().busy = busy;
        drive
    };
    Bench {
        segment: Segment::line([Coupler::slave(), drive(2), drive(0)]),
        loops: Vec::new(),
    }
}

/// A coupler, and a drive with an Ethernet port behind its mailbox.
pub(crate) fn ethernet() -> Bench {
    let (drive, _) = ServoDrive::slave(ServoConfig::default()).unwrap();
    Bench {
        segment: Segment::line([Coupler::slave(), drive.with_ethernet()]),
        loops: Vec::new(),
    }
}

/// Slaves that answer as real devices do, with their delays multiplied by `times`.
pub(crate) fn profiles(devices: &[Profile], times: u64) -> Bench {
    let (segment, _) = Profile::line(devices, times).unwrap();
    Bench {
        segment,
        loops: Vec::new(),
    }
}

/// Serves it in a thread of its own, in the namespace of the calling thread.
pub(crate) fn serve(bench: Bench) -> Served {
    let stop = Arc::new(AtomicBool::new(false));
    let stopped = stop.clone();
    let link = PacketLink::open(NEAR).unwrap();
    let segment = SharedSegment::new(bench.segment);
    let mut server = Server::new(segment.clone(), link);
    // The load of a host does not delay a slave controller.
    let config = ThreadConfig {
        priority: Some(60),
        ..ThreadConfig::new("segment")
    };
    let thread = spawn(config, move || {
        while !stopped.load(Ordering::Relaxed) {
            server
                .turn(Duration::from_millis(10), &mut monotonic)
                .unwrap();
            for io in &bench.loops {
                io.set_inputs(&io.outputs());
            }
        }
    });
    Served {
        segment,
        stop,
        thread: thread.unwrap(),
    }
}

/// A running capture.
pub(crate) struct Capture {
    dumpcap: Child,
    path: PathBuf,
}

impl Capture {
    /// Starts a capture of the cable; `None` without the tool for it.
    pub(crate) fn begin() -> Option<Self> {
        let name = format!("takt-peers-{}.pcapng", std::process::id());
        let path = std::env::temp_dir().join(name);
        let version = Command::new("tshark").arg("--version").output();
        version.ok().filter(|output| output.status.success())?;
        let mut dumpcap = Command::new("dumpcap")
            .args(["-q", "-i", NEAR, "-f", "ether proto 0x88a4", "-w"])
            .arg(&path)
            .stderr(Stdio::piped())
            .spawn()
            .ok()?;
        // It prints a line when it has started.
        let stderr = dumpcap.stderr.take()?;
        let begun = std::io::BufRead::lines(std::io::BufReader::new(stderr))
            .map_while(Result::ok)
            .any(|line| line.starts_with("File:"));
        begun.then_some(Self { dumpcap, path })
    }

    /// Ends it: there must be frames, none of them with a dissector error.
    pub(crate) fn check(mut self) {
        let pid = i32::try_from(self.dumpcap.id()).unwrap();
        kill(Pid::from_raw(pid), Signal::SIGINT).unwrap();
        self.dumpcap.wait().unwrap();
        let frames = self.matching("ecat");
        assert!(frames.len() > 500, "{} frames", frames.len());
        // Other complaints are accepted: SOEM's source address is no station address.
        // SOEM writes the addresses that it sets one after the other, where tshark expects a place for each.
        let mut found = self.matching(
            "(_ws.malformed || _ws.short || _ws.unreassembled) && !(ecat_mailbox.eoe.type == 2)",
        );
        found.truncate(5);
        assert_eq!(found, Vec::<String>::new());
    }

    fn matching(&self, filter: &str) -> Vec<String> {
        let output = Command::new("tshark")
            .arg("-r")
            .arg(&self.path)
            .args(["-Y", filter])
            .output()
            .unwrap();
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{errors}");
        String::from_utf8_lossy(&output.stdout)
            .lines()
            .map(str::to_owned)
            .collect()
    }
}

impl Drop for Capture {
    /// A failed test leaves neither the tool nor its file.
    fn drop(&mut self) {
        let _ = self.dumpcap.kill();
        let _ = self.dumpcap.wait();
        let _ = std::fs::remove_file(&self.path);
    }
}
