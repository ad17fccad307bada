//! Processes of the `takt` command for tests: each is killed when its test ends, however that ends. Their speed is not
//! measured here.

#![allow(dead_code, reason = "each test binary uses a part")]
#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test that cannot go on ends"
)]

use std::io::{BufRead as _, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

/// After this time a test gives up; far longer than anything takes on a busy host.
const TIMEOUT: Duration = Duration::from_secs(60);

/// Waits until no other test runs robots, in this process or another one: on a small machine they
/// would take the processors from each other. Holds until it is dropped.
pub(crate) fn alone() -> std::fs::File {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("robots.lock");
    let lock = std::fs::File::create(path).unwrap();
    lock.lock().unwrap();
    lock
}

/// The command under test.
pub(crate) fn takt(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_takt"));
    command.args(args).stdin(Stdio::null());
    command
}

/// Runs the command to its end.
pub(crate) fn run(args: &[&str]) -> Output {
    takt(args).output().unwrap()
}

/// Runs the command to its end with a text as its standard input.
pub(crate) fn run_with_input(args: &[&str], input: &str) -> Output {
    use std::io::Write as _;
    let mut command = takt(args);
    command
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    let mut child = command.spawn().unwrap();
    child
        .stdin
        .take()
        .unwrap()
        .write_all(input.as_bytes())
        .unwrap();
    child.wait_with_output().unwrap()
}

/// What a command wrote to standard output, if it ended with that status.
#[track_caller]
pub(crate) fn expect_status(output: &Output, status: i32) -> String {
    let out = String::from_utf8_lossy(&output.stdout).into_owned();
    let err = String::from_utf8_lossy(&output.stderr);
    assert_eq!(
        output.status.code(),
        Some(status),
        "stdout:\n{out}\nstderr:\n{err}"
    );
    out
}

/// What a command wrote to standard error.
pub(crate) fn complaint(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Processor time that the threads of a process with these names have taken, s; `None` without such a thread.
pub(crate) fn processor_seconds(process: u32, is_wanted: impl Fn(&str) -> bool) -> Option<f64> {
    /// Ticks of the processor times of the system in a second.
    const TICKS: f64 = 100.0;
    let threads = std::fs::read_dir(format!("/proc/{process}/task")).ok()?;
    let seconds = threads.flatten().filter_map(|thread| {
        let stat = std::fs::read_to_string(thread.path().join("stat")).ok()?;
        let (head, rest) = stat.rsplit_once(") ")?;
        let (_, name) = head.split_once('(')?;
        let fields: Vec<_> = rest.split(' ').filter(|_| is_wanted(name)).collect();
        let ticks = |field: usize| fields.get(field)?.parse::<f64>().ok();
        // utime and stime, the 14th and 15th field.
        Some((ticks(11)? + ticks(12)?) / TICKS)
    });
    seconds.reduce(|sum, seconds| sum + seconds)
}

/// A process that goes on while the test does.
pub(crate) struct Process {
    child: Child,
    lines: Receiver<String>,
    seen: Vec<String>,
}

impl Process {
    /// Starts it.
    pub(crate) fn start(args: &[&str]) -> Self {
        Self::spawn(takt(args))
    }

    /// Starts a command as it was set up, with its output in pipes.
    pub(crate) fn spawn(mut command: Command) -> Self {
        let mut child = command
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let (sender, lines) = channel();
        let (out, err) = (child.stdout.take().unwrap(), child.stderr.take().unwrap());
        let streams: [Box<dyn Read + Send>; 2] = [Box::new(out), Box::new(err)];
        for stream in streams {
            let sender = sender.clone();
            std::thread::spawn(move || {
                let lines = BufReader::new(stream).lines().map_while(Result::ok);
                lines
                    .take_while(|line| sender.send(line.clone()).is_ok())
                    .count()
            });
        }
        Self {
            child,
            lines,
            seen: Vec::new(),
        }
    }

    /// Its number in the system.
    pub(crate) fn id(&self) -> u32 {
        self.child.id()
    }

    /// Waits for a line that contains `what`, of either stream.
    #[track_caller]
    pub(crate) fn wait_for(&mut self, what: &str) -> String {
        self.wait_until(what, |line| line.contains(what))
    }

    /// Waits for a line that fits.
    #[track_caller]
    pub(crate) fn wait_until(&mut self, what: &str, fits: impl Fn(&str) -> bool) -> String {
        let until = Instant::now() + TIMEOUT;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            match self.lines.recv_timeout(left) {
                Ok(line) => {
                    self.seen.push(line.clone());
                    if fits(&line) {
                        return line;
                    }
                }
                Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => {
                    let seen = self.seen.join("\n");
                    panic!("`{what}` did not come; what came:\n{seen}");
                }
            }
        }
    }

    /// Enters a line; its command was spawned with a piped standard input.
    pub(crate) fn enter(&mut self, line: &str) {
        use std::io::Write as _;
        let input = self.child.stdin.as_mut().unwrap();
        writeln!(input, "{line}").unwrap();
    }

    /// Ends its standard input.
    pub(crate) fn close(&mut self) {
        drop(self.child.stdin.take());
    }

    /// All lines that came, once it has ended, and its exit status.
    pub(crate) fn end(mut self) -> (Vec<String>, Option<i32>) {
        let until = Instant::now() + TIMEOUT;
        while let Ok(line) = self
            .lines
            .recv_timeout(until.saturating_duration_since(Instant::now()))
        {
            self.seen.push(line);
        }
        let status = self.child.wait().unwrap().code();
        (std::mem::take(&mut self.seen), status)
    }

    /// Asks it to end, as a service manager does.
    pub(crate) fn terminate(&self) {
        self.signal("TERM");
    }

    /// Sends it a signal, such as STOP.
    pub(crate) fn signal(&self, name: &str) {
        let kill = format!("kill -{name} {}", self.child.id());
        let status = Command::new("sh").args(["-c", &kill]).status().unwrap();
        assert!(status.success());
    }

    /// Stops it with all its threads and continues it so much later, as a host does that stalls.
    pub(crate) fn stall(&self, span: Duration) {
        let (id, span_s) = (self.child.id(), span.as_secs_f64());
        let script = format!("kill -STOP {id}; sleep {span_s}; kill -CONT {id}");
        let status = Command::new("sh").args(["-c", &script]).status().unwrap();
        assert!(status.success());
    }

    /// Takes the processor from one of its threads for so long, as an interrupt that hangs does: nothing else of the process
    /// stands still, as far as there are other processors. Needs root.
    pub(crate) fn stall_thread(&self, name: &str, span: Duration) {
        let tasks = std::fs::read_dir(format!("/proc/{}/task", self.child.id())).unwrap();
        let is_named = |task: &PathBuf| {
            std::fs::read_to_string(task.join("comm")).is_ok_and(|comm| comm.trim() == name)
        };
        let task = tasks.map(|task| task.unwrap().path()).find(is_named);
        let task = task.unwrap_or_else(|| panic!("no thread {name}"));
        let id = task.file_name().unwrap().to_string_lossy().into_owned();
        let span_s = span.as_secs_f64();
        // Above drivers and emulated robots, below what watches the host.
        let script = format!(
            "all=$(taskset -pc {id} | sed 's/.*: //') && cpu=${{all%%[-,]*}} && taskset -pc $cpu {id} && \
             {{ timeout {span_s} chrt -f 97 taskset -c $cpu sh -c 'while :; do :; done'; taskset -pc $all {id}; }}"
        );
        let output = Command::new("sh").args(["-c", &script]).output().unwrap();
        assert!(output.status.success(), "{output:?}");
    }

    /// Kills it.
    pub(crate) fn kill(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A folder of its own for a test.
pub(crate) struct Folder(PathBuf);

impl Folder {
    pub(crate) fn new() -> Self {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let name = format!("takt-tools-{}-{number}", std::process::id());
        let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    /// The path of a file in it.
    pub(crate) fn file(&self, name: &str) -> String {
        self.0.join(name).display().to_string()
    }

    /// Writes a file and gives its path.
    pub(crate) fn write(&self, name: &str, text: &str) -> String {
        let path = self.file(name);
        std::fs::write(&path, text).unwrap();
        path
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// A net of `tests/nets`.
pub(crate) fn net(name: &str) -> String {
    let path = format!(
        "{}/../tests/nets/{name}/{name}.net",
        env!("CARGO_MANIFEST_DIR")
    );
    std::fs::read_to_string(path).unwrap()
}

/// A controller with one arm, `left`, in a process of its own.
pub(crate) struct Cell {
    pub(crate) process: Process,
    /// Where it takes DirectIO lines.
    pub(crate) tcp: String,
    /// Where it takes HTTP.
    pub(crate) http: String,
    /// Where the arm's datagrams are to go.
    pub(crate) udp: String,
    /// The socket of its stop channel.
    pub(crate) stop: String,
    _folder: Folder,
}

impl Cell {
    /// Starts it; the system chooses all ports.
    pub(crate) fn start() -> Self {
        Self::start_with("")
    }

    /// The same with more tables in its cell file.
    pub(crate) fn start_with(tables: &str) -> Self {
        let folder = Folder::new();
        let stop = folder.file("stop.sock");
        let config = format!(
            "[controller]\nwebsocket = \"127.0.0.1:0\"\ntcp = \"127.0.0.1:0\"\nstop_socket = \"{stop}\"\nflight_recorder = \"flights\"\n\
             [[device]]\nname = \"left\"\ntype = \"kuka_lwr_fri\"\nlisten = \"127.0.0.1:0\"\n{tables}"
        );
        let config = folder.write("cell.toml", &config);
        let mut process = Process::start(&["run", "--config", &config]);
        let address = |line: String, before: &str| {
            line.rsplit_once(before)
                .map(|(_, address)| address.to_owned())
                .unwrap()
        };
        let http = address(process.wait_for("DirectIO at ws"), "ws://");
        let http = http.trim_end_matches("/DirectIO/").to_owned();
        let tcp = address(process.wait_for("lines at tcp"), "tcp ");
        let udp = address(process.wait_for("waits for its robot"), "udp ");
        Self {
            process,
            http,
            tcp,
            udp,
            stop,
            _folder: folder,
        }
    }

    /// An emulated arm, once it can be commanded.
    pub(crate) fn arm(&mut self) -> Process {
        let arm = Process::start(&["emulate", "lwr", "--connect", &self.udp]);
        self.process.wait_for("now=operational");
        arm
    }

    /// Runs `takt net` against this controller.
    pub(crate) fn net(&self, args: &[&str]) -> Output {
        run(&[&["net"], args, &["--connect", &self.tcp]].concat())
    }

    /// Loads a net; returns its identifier.
    #[track_caller]
    pub(crate) fn load(&self, text: &str) -> String {
        let output = run_with_input(&["net", "load", "-", "--connect", &self.tcp], text);
        expect_status(&output, 0).trim().to_owned()
    }

    /// Follows a net in a process of its own.
    pub(crate) fn watch(&self, net: &str) -> Process {
        Process::start(&["net", "watch", net, "--connect", &self.tcp])
    }
}
