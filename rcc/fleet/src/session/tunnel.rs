//! A DirectIO connection to a cell of a fleet, in a command session: a program talks to the controller as over its own socket. What is in the
//! lines is of no interest here.
//!
//! Commands are executed one after the other, also those of several threads: a net that takes long to load delays the command
//! behind it.

use std::io::{ErrorKind, Read as _, Write as _};
use std::net::Shutdown;
use std::os::unix::net::UnixStream;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use takt_client::Client;
use takt_client::wire::Message;
use takt_client::wire::lines::LineReader;

use super::observer::Fleet;
use super::remote::{Notifications, Remote, RemoteError};
use crate::command::{LossPolicy, Refusal};
use crate::keys::CellName;

/// How long a command may take, as a client waits for its reply.
const REPLY_TIMEOUT: Duration = Duration::from_secs(30);

/// Why a cell cannot be talked to.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TunnelError {
    /// The session cannot be opened.
    #[error(transparent)]
    Remote(#[from] RemoteError),
    /// The controller rejects the handshake.
    #[error(transparent)]
    Client(#[from] takt_client::Error),
    /// The system refuses a socket or a thread.
    #[error("cannot connect through the fleet: {0}")]
    System(#[from] std::io::Error),
}

/// Connects to a cell. `program` is its name for people, 1 to 64 bytes; `on_loss` says what happens to its nets when no keep-alive
/// arrives in time. The session is closed with the last clone of the client.
///
/// # Errors
/// If the cell does not answer or refuses, or the system has no thread left.
pub fn connect(
    fleet: &Fleet,
    cell: &CellName,
    program: &str,
    on_loss: LossPolicy,
) -> Result<Client, TunnelError> {
    let remote = Remote::open(fleet, cell, program, on_loss)?;
    let (own, theirs) = UnixStream::pair()?;
    let end = Arc::new(End {
        stream: Mutex::new(own.try_clone()?),
        has_ended: AtomicBool::new(false),
    });
    let (notifications, notified) = (remote.notifications(), Arc::clone(&end));
    let thread = std::thread::Builder::new().name("fleet-notified".to_owned());
    thread.spawn(move || notify(notifications, &notified))?;
    let ends = Arc::clone(&end);
    let lines = std::thread::Builder::new().name("fleet-lines".to_owned());
    if let Err(why) = lines.spawn(move || execute(remote, own, &ends)) {
        end.close();
        return Err(why.into());
    }
    Ok(Client::over(theirs, cell.to_string())?)
}

/// The program's side of the connection, shared by both threads.
struct End {
    stream: Mutex<UnixStream>,
    has_ended: AtomicBool,
}

impl End {
    fn has_ended(&self) -> bool {
        self.has_ended.load(Ordering::Acquire)
    }

    /// Passes lines to the program. If it has gone, reading its commands ends too.
    fn send(&self, lines: &[String]) {
        let mut text = lines.join("\n");
        text.push('\n');
        let mut stream = self.stream.lock().unwrap_or_else(PoisonError::into_inner);
        if stream.write_all(text.as_bytes()).is_err() {
            self.has_ended.store(true, Ordering::Release);
        }
    }

    /// Reports to the program why it is disconnected, and disconnects it.
    fn fail(&self, why: &RemoteError) {
        let line = Message::new("none", "err").with(why.to_string());
        self.send(&[line.to_string()]);
        self.close();
    }

    fn close(&self) {
        self.has_ended.store(true, Ordering::Release);
        let stream = self.stream.lock().unwrap_or_else(PoisonError::into_inner);
        // Fails only if the program closed first.
        let _ = stream.shutdown(Shutdown::Both);
    }
}

/// Body of the thread that passes notifications to the program.
fn notify(mut notifications: Notifications, end: &End) {
    while !end.has_ended() {
        match notifications.wait() {
            Ok(lines) if lines.is_empty() => {}
            Ok(lines) => end.send(&lines),
            // If the program closed its session, no client reads this.
            Err(why) => return end.fail(&why),
        }
    }
}

/// Body of the thread that executes the program's lines, until it disconnects. The session is closed at the end.
fn execute(mut remote: Remote, stream: UnixStream, end: &End) {
    match pass(&mut remote, stream, end) {
        Ok(()) => end.close(),
        Err(why) => end.fail(&why),
    }
}

/// Executes lines until the program disconnects.
fn pass(remote: &mut Remote, mut stream: UnixStream, end: &End) -> Result<(), RemoteError> {
    let mut reader = LineReader::default();
    let mut bytes = [0; 16 << 10];
    while !end.has_ended() {
        match stream.read(&mut bytes) {
            Ok(0) => break,
            Ok(count) => reader.push(bytes.get(..count).unwrap_or_default()),
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(_) => break,
        }
        loop {
            let line = reader.poll_message();
            let line = line.map_err(|why| unfit(remote, why.to_string()))?;
            let Some(line) = line else {
                break;
            };
            end.send(&reply(remote, &line)?);
        }
    }
    Ok(())
}

/// The reply to a line.
fn reply(remote: &mut Remote, line: &str) -> Result<Vec<String>, RemoteError> {
    match remote.execute(line, REPLY_TIMEOUT) {
        Ok((lines, 0)) => Ok(lines),
        Ok((_, omitted)) => {
            let text = format!(
                "{omitted} lines of a reply are too long for a message of the fleet\nhint: ask for less at once, or connect to the \
                 controller itself"
            );
            Err(unfit(remote, text))
        }
        // It was not begun: the session goes on.
        Err(RemoteError::Refused {
            reason: Refusal::TooLong { .. },
            text,
            ..
        }) => {
            let tag = Message::decode(line).map(|message| message.tag);
            let tag = tag.unwrap_or_else(|_| "none".to_owned());
            Ok(vec![Message::new(tag, "err").with(text).to_string()])
        }
        Err(why) => Err(why),
    }
}

fn unfit(remote: &Remote, text: String) -> RemoteError {
    let cell = remote.cell().to_string();
    RemoteError::Answer { cell, text }
}
