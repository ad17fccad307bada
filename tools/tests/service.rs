//! `takt run` as a service manager sees it: notifications over its socket, the effect of a reload and of
//! a crash. systemd itself is tested in the virtual machine.

#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test that cannot go on ends"
)]

mod common;

use std::io::ErrorKind;
use std::os::unix::net::UnixDatagram;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use common::{Folder, expect_status, run, run_with_input};

/// After this time a test gives up; far longer than anything takes on a busy host.
const TIMEOUT: Duration = Duration::from_secs(60);

/// A cell without robots that listens where the system likes.
const CELL: &str = "[controller]\nwebsocket = \"127.0.0.1:0\"\ntcp = \"127.0.0.1:PORT\"\n";

/// A net that runs until it is cancelled.
const PATIENT: &str = "{cancel=Cancel(), outTerminate=cancel.outCancel}";

struct Service {
    child: Child,
    socket: UnixDatagram,
    /// Notifications so far.
    received: Vec<String>,
    folder: Folder,
    server: String,
}

impl Service {
    fn start(folder: Folder) -> Self {
        // The port must be known here, and the log is not read.
        let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let port = free.local_addr().unwrap().port();
        drop(free);
        let config = folder.write("cell.toml", &CELL.replace("PORT", &port.to_string()));
        let path = folder.file("notify");
        let _ = std::fs::remove_file(&path);
        let socket = UnixDatagram::bind(&path).unwrap();
        socket
            .set_read_timeout(Some(Duration::from_millis(100)))
            .unwrap();
        let child = Command::new(env!("CARGO_BIN_EXE_takt"))
            .args(["run", "--config", &config])
            .env("NOTIFY_SOCKET", &path)
            .env("STATE_DIRECTORY", folder.file(""))
            .env("WATCHDOG_USEC", "400000")
            .env_remove("RUST_LOG")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let server = format!("127.0.0.1:{port}");
        let received = Vec::new();
        let mut service = Self {
            child,
            socket,
            received,
            folder,
            server,
        };
        service.wait_for("READY=1");
        service
    }

    /// Waits for a notification that contains `part`.
    #[track_caller]
    fn wait_for(&mut self, part: &str) -> String {
        let until = Instant::now() + TIMEOUT;
        while Instant::now() < until {
            let mut buffer = [0; 4096];
            match self.socket.recv(&mut buffer) {
                Ok(len) => self
                    .received
                    .push(String::from_utf8_lossy(&buffer[..len]).into_owned()),
                Err(error) => assert_eq!(error.kind(), ErrorKind::WouldBlock),
            }
            if let Some(last) = self.received.last().filter(|last| last.contains(part)) {
                return last.clone();
            }
        }
        panic!("no notification with {part}, only: {:#?}", self.received);
    }

    fn signal(&self, name: &str) {
        let kill = format!("kill -{name} {}", self.child.id());
        assert!(
            Command::new("sh")
                .args(["-c", &kill])
                .status()
                .unwrap()
                .success()
        );
    }

    fn reload(&mut self, cell: &str) -> String {
        let port = self.server.rsplit(':').next().unwrap().to_owned();
        self.folder.write("cell.toml", &cell.replace("PORT", &port));
        self.signal("HUP");
        self.wait_for("RELOADING=1");
        let status = self.wait_for("STATUS=");
        self.wait_for("READY=1");
        status
    }

    fn start_net(&self) -> String {
        let load = ["net", "load", "--start", "-", "--connect", &self.server];
        let output = run_with_input(&load, PATIENT);
        expect_status(&output, 0).trim().to_owned()
    }

    fn nets(&self) -> String {
        expect_status(&run(&["net", "list", "--connect", &self.server]), 0)
    }

    fn state(&self) -> String {
        std::fs::read_to_string(self.folder.file("state.json")).unwrap()
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
fn watchdog_is_fed_and_status_follows_the_nets() {
    let mut service = Service::start(Folder::new());
    service.wait_for("WATCHDOG=1");
    let net = service.start_net();
    service.wait_for(&format!("STATUS={net} runs"));
    service.wait_for("WATCHDOG=1");
    assert!(service.state().contains(&net));
}

#[test]
fn stopped_service_marks_state_file_as_stopped() {
    let mut service = Service::start(Folder::new());
    let net = service.start_net();
    service.wait_for(&format!("STATUS={net} runs"));
    service.signal("TERM");
    service.wait_for("STOPPING=1");
    let status = service.child.wait().unwrap();
    assert_eq!(status.code(), Some(0));
    assert!(
        service.state().contains("\"stopped\": true"),
        "{}",
        service.state()
    );
}

#[test]
fn start_after_crash_reports_interrupted_nets() {
    let mut service = Service::start(Folder::new());
    let net = service.start_net();
    service.wait_for(&format!("STATUS={net} runs"));
    service.child.kill().unwrap();
    service.child.wait().unwrap();
    let folder = std::mem::replace(&mut service.folder, Folder::new());
    let mut next = Service::start(folder);
    let status = next
        .received
        .iter()
        .find(|text| text.starts_with("STATUS="))
        .unwrap();
    assert!(
        status.contains(&format!("broken off while running {net}")),
        "{status}"
    );
    assert!(status.contains("no net runs"), "{status}");
    assert_eq!(next.nets(), "no nets\n");
    next.wait_for("WATCHDOG=1");
}

#[test]
fn reload_adds_a_device_while_a_net_runs() {
    let mut service = Service::start(Folder::new());
    let net = service.start_net();
    service.wait_for(&format!("STATUS={net} runs"));
    let device = "[[device]]\nname = \"left\"\ntype = \"kuka_lwr_fri\"\nlisten = \"127.0.0.1:0\"\n";
    let status = service.reload(&format!("{CELL}period = \"2ms\"\n{device}"));
    assert!(status.contains("left is offline"), "{status}");
    assert!(status.contains("period needs a restart"), "{status}");
    assert!(service.nets().contains("RUNNING"), "{}", service.nets());
    let status = service.reload(CELL);
    assert!(!status.contains("left"), "{status}");
    assert!(service.nets().contains("RUNNING"), "{}", service.nets());
}

#[test]
fn cell_that_cannot_be_read_changes_nothing() {
    let mut service = Service::start(Folder::new());
    let net = service.start_net();
    service.wait_for(&format!("STATUS={net} runs"));
    let status = service.reload("[controller]\nperoid = \"1ms\"\n");
    assert!(
        status.contains("the cell stays as it is") && status.contains("peroid"),
        "{status}"
    );
    assert!(service.nets().contains("RUNNING"), "{}", service.nets());
}
