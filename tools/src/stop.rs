//! `takt stop`: stops controllers at once, over the channel that serves nothing else, and prints what was stopped and
//! when. It loads nothing and needs no cell; whether robots have come to rest is shown elsewhere.

use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::Context as _;
use clap::Args;
use serde::Deserialize;
use takt_client::Token;
use takt_core::stop_channel::{PRIORITY, socket_folders};
use takt_rt::thread::{ThreadConfig, spawn};

use crate::output::{complain, say, span, time};
use crate::{Verdict, token};

/// Most bytes of an answer.
const ANSWER_BYTES_MAX: u64 = 64 << 10;
/// Most controllers of one host.
const CONTROLLERS_MAX: usize = 64;

/// Stop all nets and robots of this host's controllers now, by the channel that always gets through.
///
/// All nets end, robots brake, and nothing starts until `takt stop --release`, which starts nothing by itself. It is
/// no safety function: where people are at risk, press the emergency stop of the robot.
#[derive(Debug, Args)]
pub(crate) struct Stop {
    /// Release the stop instead: programs may start nets again, and have to request them.
    #[arg(long, conflicts_with = "show")]
    release: bool,
    /// Change nothing; print whether controllers are stopped, and by which client.
    #[arg(long)]
    show: bool,
    /// The socket of one controller; else all that are found in /run/takt and in the user's own folders.
    #[arg(long, value_name = "PATH", conflicts_with = "connect")]
    socket: Option<PathBuf>,
    /// The stop port of a controller, on another host for instance; needs its token.
    #[arg(long, value_name = "HOST:PORT")]
    connect: Option<String>,
    /// File with the controller's token; else TAKT_TOKEN_FILE or TAKT_TOKEN.
    #[arg(long, value_name = "FILE", requires = "connect")]
    token_file: Option<PathBuf>,
    /// How long to wait for an answer.
    #[arg(long, value_name = "TIME", default_value = "2s", value_parser = span)]
    timeout: Duration,
    /// Print one JSON object a controller.
    #[arg(long)]
    json: bool,
}

/// The stop channel of a controller.
#[derive(Clone, Debug)]
enum Target {
    Socket(PathBuf),
    Port(String, Option<Token>),
}

/// What a controller answers.
#[derive(Clone, Debug, Deserialize)]
struct State {
    stopped: bool,
    changed: bool,
    complete: bool,
    #[serde(default)]
    by: String,
    #[serde(default)]
    stopped_for_ns: i64,
    received_ns: i64,
    waited_ns: i64,
    threads: Vec<ThreadState>,
}

/// What one of its net threads did.
#[derive(Clone, Debug, Deserialize)]
struct ThreadState {
    period_ns: i64,
    answered: bool,
    nets: u32,
    withdrawn_at_ns: i64,
}

/// The outcome of one target.
enum Outcome {
    /// It answered with this text, of this content.
    Answered(String, State),
    /// It refused, and why.
    Refused(String),
    /// It cannot be asked.
    Unreachable(anyhow::Error),
}

impl Stop {
    pub(crate) fn run(self) -> anyhow::Result<Verdict> {
        let begin = takt_rt::monotonic();
        let targets = self.targets()?;
        let path = match (self.release, self.show) {
            (true, _) => "POST /stop/release",
            (false, true) => "GET /stop",
            (false, false) => "POST /stop",
        };
        // All at once, and with real-time priority where this user may, against busy processors.
        let ask = |target: &Target| {
            let (target, timeout) = (target.clone(), self.timeout);
            let config = ThreadConfig {
                priority: Some(PRIORITY),
                ..ThreadConfig::new("takt-stop")
            };
            spawn(config, move || target.ask(path, timeout))
        };
        let threads: Vec<_> = targets.iter().map(ask).collect();
        let mut worst = 0;
        for (target, thread) in targets.iter().zip(threads) {
            let outcome = match thread.map(takt_rt::thread::Thread::join) {
                Ok(Ok(outcome)) => outcome,
                Ok(Err(_)) => Outcome::Unreachable(anyhow::anyhow!("the request panicked")),
                Err(error) => Outcome::Unreachable(error.into()),
            };
            worst = worst.max(self.print(target, &outcome, begin.0)?);
        }
        match worst {
            0 => Ok(Verdict::Good),
            1 => Ok(Verdict::Failed),
            _ => anyhow::bail!(
                "a controller could not be asked\nhint: press the emergency stop of the robot"
            ),
        }
    }

    fn targets(&self) -> anyhow::Result<Vec<Target>> {
        if let Some(address) = &self.connect {
            let token = token::of_client(self.token_file.as_deref(), Some(address))?;
            return Ok(vec![Target::Port(address.clone(), token)]);
        }
        if let Some(socket) = &self.socket {
            return Ok(vec![Target::Socket(socket.clone())]);
        }
        let folders = socket_folders();
        let found: Vec<_> = folders.iter().flat_map(|folder| sockets(folder)).collect();
        if found.is_empty() {
            let searched: Vec<_> = folders.iter().map(|f| f.display().to_string()).collect();
            anyhow::bail!(
                "no controller has a stop socket in {}\nhint: name it with --socket PATH, or its stop port with \
                 --connect HOST:PORT",
                searched.join(", ")
            );
        }
        Ok(found.into_iter().map(Target::Socket).collect())
    }

    /// Prints the outcome of one target; returns its exit status.
    fn print(&self, target: &Target, outcome: &Outcome, begin_ns: i64) -> anyhow::Result<u8> {
        let name = target.name();
        match outcome {
            Outcome::Answered(text, state) => {
                if self.json {
                    say(&self.json(&name, text, state, begin_ns)?)?;
                } else {
                    for line in state.lines(&name, target.is_here().then_some(begin_ns)) {
                        say(&line)?;
                    }
                }
                let as_wanted = self.show || state.stopped != self.release;
                if !state.complete {
                    complain(&format!(
                        "{name}: a net thread did not answer within {}; it hangs or starves\n\
                         hint: press the emergency stop of the robot, then restart the controller",
                        time(state.waited_ns)
                    ));
                }
                Ok(u8::from(!(as_wanted && state.complete)))
            }
            Outcome::Refused(why) => {
                complain(&format!("{name}: {why}"));
                Ok(1)
            }
            Outcome::Unreachable(error) => {
                complain(&format!("{name}: {error:#}"));
                Ok(2)
            }
        }
    }

    /// The answer with the figures of this side.
    fn json(&self, name: &str, text: &str, state: &State, begin_ns: i64) -> anyhow::Result<String> {
        let mut answer: serde_json::Value = serde_json::from_str(text)?;
        if let Some(members) = answer.as_object_mut() {
            members.insert("controller".to_owned(), name.into());
            members.insert("nets".to_owned(), state.nets().into());
            if let Some(last) = state.last_withdrawn().filter(|_| self.connect.is_none()) {
                members.insert("command_ns".to_owned(), begin_ns.into());
                members.insert("withdrawn_after_ns".to_owned(), (last - begin_ns).into());
            }
        }
        Ok(serde_json::to_string(&answer)?)
    }
}

/// Sockets of stop channels in a folder; none if it cannot be read.
fn sockets(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let is_socket = |path: &PathBuf| {
        let name = path.file_name().and_then(|name| name.to_str());
        name.is_some_and(|name| name.starts_with("stop-") && name.ends_with(".sock"))
    };
    let paths = entries.map(|entry| entry.path()).filter(is_socket);
    // Sockets left by a controller that has ended refuse connections.
    let alive = |path: &PathBuf| {
        let refused = UnixStream::connect(path).err().map(|e| e.kind());
        !matches!(
            refused,
            Some(io::ErrorKind::ConnectionRefused | io::ErrorKind::NotFound)
        )
    };
    paths.take(CONTROLLERS_MAX).filter(alive).collect()
}

impl Target {
    fn name(&self) -> String {
        match self {
            Self::Socket(path) => path.display().to_string(),
            Self::Port(address, _) => address.clone(),
        }
    }

    /// Whether it is on this host for sure, so that its clock is ours.
    const fn is_here(&self) -> bool {
        matches!(self, Self::Socket(_))
    }

    fn ask(&self, path: &str, timeout: Duration) -> Outcome {
        match self.exchange(path, timeout) {
            Ok(answer) => judge(&answer),
            Err(error) => Outcome::Unreachable(error),
        }
    }

    fn exchange(&self, path: &str, timeout: Duration) -> anyhow::Result<String> {
        let until = Instant::now() + timeout;
        match self {
            Self::Socket(socket) => {
                let stream = UnixStream::connect(socket).context("cannot connect")?;
                stream.set_read_timeout(Some(timeout))?;
                converse(stream, &format!("{path} HTTP/1.1\r\n\r\n"), until)
            }
            Self::Port(address, token) => {
                let stream = connect(address, timeout).context("cannot connect")?;
                stream.set_read_timeout(Some(timeout))?;
                let token = token.as_ref().map(|token| token.text()).unwrap_or_default();
                let request = format!(
                    "{path} HTTP/1.1\r\nHost: {address}\r\nAuthorization: Bearer {token}\r\n\r\n"
                );
                converse(stream, &request, until)
            }
        }
    }
}

fn connect(address: &str, timeout: Duration) -> io::Result<TcpStream> {
    use std::net::ToSocketAddrs as _;
    let mut last = io::Error::from(io::ErrorKind::NotFound);
    for candidate in address.to_socket_addrs()? {
        match TcpStream::connect_timeout(&candidate, timeout) {
            Ok(stream) => return stream.set_nodelay(true).map(|()| stream),
            Err(error) => last = error,
        }
    }
    Err(last)
}

fn converse(
    mut stream: impl Read + Write,
    request: &str,
    until: Instant,
) -> anyhow::Result<String> {
    stream
        .write_all(request.as_bytes())
        .context("cannot send")?;
    let (mut bytes, mut part) = (Vec::new(), [0; 4096]);
    loop {
        anyhow::ensure!(Instant::now() < until, "no answer within the timeout");
        match stream.read(&mut part) {
            Ok(0) => break,
            Ok(count) => bytes.extend_from_slice(part.get(..count).unwrap_or_default()),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error).context("no answer"),
        }
        anyhow::ensure!(
            (bytes.len() as u64) < ANSWER_BYTES_MAX,
            "this is no stop channel: its answer does not end"
        );
    }
    String::from_utf8(bytes).context("this is no stop channel")
}

/// The content of an answer.
fn judge(answer: &str) -> Outcome {
    let Some((head, body)) = answer.split_once("\r\n\r\n") else {
        return Outcome::Unreachable(anyhow::anyhow!("the connection ended without an answer"));
    };
    if !head.starts_with("HTTP/1.1 200") {
        let error = serde_json::from_str::<serde_json::Value>(body).ok();
        let why = error.and_then(|error| Some(error.get("error")?.as_str()?.to_owned()));
        let status = head.lines().next().unwrap_or_default().to_owned();
        return Outcome::Refused(why.unwrap_or(status));
    }
    match serde_json::from_str(body) {
        Ok(state) => Outcome::Answered(body.to_owned(), state),
        Err(error) => Outcome::Unreachable(error.into()),
    }
}

impl State {
    fn nets(&self) -> u32 {
        let threads = self.threads.iter().filter(|thread| thread.answered);
        threads.map(|thread| thread.nets).sum()
    }

    /// When the last driver had it that nets command nothing any more, on the controller's clock.
    fn last_withdrawn(&self) -> Option<i64> {
        let threads = self.threads.iter().filter(|thread| thread.answered);
        let last = threads.map(|thread| thread.withdrawn_at_ns).max();
        last.filter(|_| self.stopped && self.changed)
    }

    /// What to print; `begin_ns` is when the command began on the controller's clock, if that is ours.
    fn lines(&self, name: &str, begin_ns: Option<i64>) -> Vec<String> {
        if !self.stopped {
            let released = if self.changed {
                "released"
            } else {
                "not stopped"
            };
            return vec![format!("{name}: {released}")];
        }
        if !self.changed {
            let since = time(self.stopped_for_ns);
            return vec![format!("{name}: stopped since {since}, by {}", self.by)];
        }
        let nets = self.nets();
        let plural = if nets == 1 { "" } else { "s" };
        let mut line = format!("{name}: stopped, {nets} net{plural} ended");
        if let Some(last) = self.last_withdrawn() {
            let inside = time(last - self.received_ns);
            line += &format!(", the last set-point {inside} after the request");
            if let Some(begin) = begin_ns {
                line += &format!(", {} after the command", time(last - begin));
            }
        }
        let mut lines = vec![line];
        for thread in self.threads.iter().filter(|thread| !thread.answered) {
            let period = time(thread.period_ns);
            lines.push(format!(
                "{name}: the net thread of {period} has not answered"
            ));
        }
        lines.push("release it with: takt stop --release".to_owned());
        lines
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ANSWER: &str = "HTTP/1.1 200 OK\r\nContent-Length: 9\r\n\r\n{\"stopped\":true,\"changed\":true,\
        \"complete\":false,\"received_ns\":1000000,\"waited_ns\":53000000,\"by\":\"process 7 of user 0\",\
        \"since_ns\":1000000,\"stopped_for_ns\":53000000,\"threads\":[{\"period_ns\":1000000,\"answered\":true,\
        \"nets\":2,\"withdrawn_at_ns\":1400000},{\"period_ns\":4000000,\"answered\":false,\"nets\":9,\
        \"withdrawn_at_ns\":0}]}\n";

    #[test]
    fn answer_names_the_thread_that_is_missing() {
        let Outcome::Answered(_, state) = judge(ANSWER) else {
            panic!("it is an answer");
        };
        let lines = state.lines("here", Some(400_000));
        assert_eq!(
            lines[0],
            "here: stopped, 2 nets ended, the last set-point 400 us after the request, 1.0 ms after the command"
        );
        assert_eq!(
            lines[1],
            "here: the net thread of 1.0 ms has not answered".replace("1.0", "4.0")
        );
    }

    #[test]
    fn stop_distinguishes_refusal_from_nonsense() {
        let refused = "HTTP/1.1 401 Unauthorized\r\n\r\n{\"error\":\"the token is wrong\"}\n";
        assert!(matches!(judge(refused), Outcome::Refused(why) if why == "the token is wrong"));
        for nonsense in ["", "HTTP/1.1 200 OK\r\n\r\n<html>"] {
            assert!(matches!(judge(nonsense), Outcome::Unreachable(_)));
        }
    }
}
