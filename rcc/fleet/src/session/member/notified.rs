//! The thread of a session that answers with what the session was notified of. It keeps what its client has not confirmed, so that a lost
//! reply loses no line; what was not fetched yet is kept, and bounded, by the cell.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Duration;

use zenoh::query::Query as Sent;

use super::shared::{Shared, refuse, reply};
use crate::command::{Reply, to_json};

/// Longest wait for the first line. Shorter than the life of a nonce, so that a client sees that its session is lost.
const WAIT_MAX: Duration = Duration::from_millis(200);

/// Requests that wait: a client sends the next one when it has its reply, or when that does not come. More are refused.
const WAITING_MAX: usize = 4;

/// A request of the client: its first line, and where the reply goes.
pub(super) struct Asked {
    pub(super) from: u64,
    pub(super) sent: Sent,
}

/// Starts the thread of a session. It ends when the sender is dropped.
pub(super) fn start(
    shared: &Arc<Shared>,
    session: u32,
) -> Result<SyncSender<Asked>, std::io::Error> {
    let (asked, from_asked) = sync_channel(WAITING_MAX);
    let shared = Arc::clone(shared);
    let thread = std::thread::Builder::new().name(format!("fleet-n{session}"));
    thread.spawn(move || answer(&shared, session, &from_asked))?;
    Ok(asked)
}

fn answer(shared: &Shared, session: u32, asked: &Receiver<Asked>) {
    let bound = shared.admission().limits().reply_bytes;
    let mut kept = Kept::default();
    while let Ok(Asked { from, sent }) = asked.recv() {
        kept.confirm(from);
        if kept.lines.is_empty() {
            match shared.cell.notifications(session, WAIT_MAX) {
                Ok(lines) => kept.lines = lines.into(),
                Err(why) => {
                    refuse(&sent, &why);
                    continue;
                }
            }
        }
        let lines = kept.fitting(bound);
        if let Some(line) = kept.lines.front().filter(|_| lines.is_empty()) {
            let bytes = line.len();
            refuse(
                &sent,
                &format!(
                    "a notification of {bytes} bytes is too long for a message of the fleet, at most {bound}"
                ),
            );
            continue;
        }
        let said = Reply::Notified {
            session,
            first: kept.first,
            lines,
        };
        let key = shared.keys.cmd_session();
        if sent.key_expr().as_str() == key {
            reply(&sent, &key, to_json(&said));
        } else {
            refuse(&sent, "the key expression has a wildcard");
        }
    }
}

/// Lines that the client has not confirmed.
#[derive(Debug, Default)]
struct Kept {
    /// Number of the first one.
    first: u64,
    lines: VecDeque<String>,
}

impl Kept {
    /// The client has all lines before this one. A number of lines that were never sent confirms those that were.
    fn confirm(&mut self, from: u64) {
        while self.first < from && self.lines.pop_front().is_some() {
            self.first += 1;
        }
    }

    /// As many lines as a reply takes; none if the first one is too long.
    fn fitting(&self, bound: usize) -> Vec<String> {
        let mut bytes = 0_usize;
        let fits = self.lines.iter().take_while(|line| {
            bytes = bytes.saturating_add(line.len());
            bytes <= bound
        });
        fits.cloned().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_kept_until_confirmed() {
        let lines = ["a", "bb", "cc"].map(str::to_owned);
        let mut kept = Kept {
            first: 5,
            lines: lines.into(),
        };
        assert_eq!(kept.fitting(3), ["a", "bb"]);
        // The reply was lost: the client asks again.
        kept.confirm(5);
        assert_eq!((kept.first, kept.fitting(8).len()), (5, 3));
        kept.confirm(7);
        assert_eq!((kept.first, kept.fitting(2)), (7, vec!["cc".to_owned()]));
        assert!(kept.fitting(1).is_empty(), "it is refused, and kept");
        // Earlier and future numbers change nothing that was not sent.
        kept.confirm(2);
        assert_eq!((kept.first, kept.lines.len()), (7, 1));
        kept.confirm(u64::MAX);
        assert_eq!((kept.first, kept.lines.len()), (8, 0));
    }
}
