//! One session: its nonces and the last command. It expires with its newest nonce. It knows no messages of others.

use std::hash::{DefaultHasher, Hash as _, Hasher as _};

use takt_core::Nanos;

use super::id::{Nonce, OpenId};
use super::message::{LossPolicy, Refusal, Reply};

/// A nonce and when it expires.
#[derive(Clone, Copy, Debug)]
struct Grant {
    nonce: Nonce,
    at: Nanos,
    expires: Nanos,
}

/// The last command that was executed, or is being executed.
#[derive(Debug)]
struct Last {
    content: u64,
    nonce: Nonce,
    /// `None` while it is being executed.
    reply: Option<Reply>,
}

/// What to do with a command.
#[derive(Debug)]
pub(super) enum Step {
    /// Repeat this reply.
    Repeat(Reply),
    /// Execute it until this instant.
    Execute { until: Nanos },
}

/// An open session.
#[derive(Debug)]
pub(super) struct Session {
    pub(super) number: u32,
    pub(super) open: OpenId,
    pub(super) on_loss: LossPolicy,
    newest: Grant,
    /// Commands that are on their way while a keep-alive is answered carry this one.
    previous: Option<Grant>,
    /// Number of the last command; 0 before the first.
    seq: u64,
    last: Option<Last>,
}

impl Session {
    pub(super) fn new(
        number: u32,
        open: OpenId,
        on_loss: LossPolicy,
        nonce: Nonce,
        (now, life): (Nanos, Nanos),
    ) -> Self {
        Self {
            number,
            open,
            on_loss,
            newest: Grant {
                nonce,
                at: now,
                expires: now + life,
            },
            previous: None,
            seq: 0,
            last: None,
        }
    }

    /// When it is lost unless it is renewed.
    pub(super) const fn expires(&self) -> Nanos {
        self.newest.expires
    }

    /// Whether nothing was done in it since it was opened.
    pub(super) const fn is_fresh(&self) -> bool {
        self.previous.is_none() && self.seq == 0
    }

    /// The newest nonce with its instants: granted, expires.
    pub(super) const fn granted(&self) -> (Nonce, Nanos, Nanos) {
        (self.newest.nonce, self.newest.at, self.newest.expires)
    }

    /// Until when a nonce permits.
    pub(super) fn permits(&self, nonce: Nonce, now: Nanos) -> Result<Nanos, Refusal> {
        let grants = [Some(self.newest), self.previous];
        let grant = grants.into_iter().flatten().find(|g| g.nonce == nonce);
        let session = self.number;
        let grant = grant.ok_or(Refusal::UnknownNonce { session })?;
        if now > grant.expires {
            let late_ns = (now - grant.expires).0;
            return Err(Refusal::Late { late_ns });
        }
        Ok(grant.expires)
    }

    /// Answers a keep-alive. Only one with the newest nonce extends the session; a repeated one does not.
    pub(super) fn renew(
        &mut self,
        nonce: Nonce,
        (now, life): (Nanos, Nanos),
        next: impl FnOnce() -> Nonce,
    ) -> Result<(), Refusal> {
        self.permits(nonce, now)?;
        if nonce == self.newest.nonce {
            self.previous = Some(self.newest);
            self.newest = Grant {
                nonce: next(),
                at: now,
                expires: now + life,
            };
        }
        Ok(())
    }

    /// Decides about a command with this number and content.
    pub(super) fn command(
        &mut self,
        seq: u64,
        nonce: Nonce,
        line: &str,
        (now, not_after): (Nanos, Nanos),
    ) -> Result<Step, Refusal> {
        let content = content(line);
        if let Some(last) = self.last.as_ref().filter(|_| seq == self.seq) {
            // The very query may come again after its nonce expired: its reply changes nothing.
            if nonce != last.nonce {
                self.permits(nonce, now)?;
            }
            if content != last.content {
                let next = seq.saturating_add(1);
                return Err(Refusal::SequenceReused { seq, next });
            }
            let reply = last.reply.clone();
            return reply.map(Step::Repeat).ok_or(Refusal::Busy { seq });
        }
        let until = self.permits(nonce, now)?.min(not_after);
        if now > until {
            let late_ns = (now - until).0;
            return Err(Refusal::Late { late_ns });
        }
        let next = self.seq.saturating_add(1);
        if seq < next {
            return Err(Refusal::OldSequence { seq, next });
        }
        if seq > next {
            return Err(Refusal::SequenceGap { seq, next });
        }
        if self.last.as_ref().is_some_and(|last| last.reply.is_none()) {
            return Err(Refusal::Busy { seq: self.seq });
        }
        self.seq = seq;
        self.last = Some(Last {
            content,
            nonce,
            reply: None,
        });
        Ok(Step::Execute { until })
    }

    /// Keeps the reply of the command that is being executed. Returns whether there is such a command.
    pub(super) fn finish(&mut self, seq: u64, reply: &Reply) -> bool {
        let last = self.last.as_mut().filter(|_| seq == self.seq);
        let Some(last) = last.filter(|last| last.reply.is_none()) else {
            return false;
        };
        last.reply = Some(reply.clone());
        true
    }
}

/// Distinguishes commands of one number; the session is the client's own, so that a collision harms no other client.
fn content(line: &str) -> u64 {
    let mut hasher = DefaultHasher::new();
    line.hash(&mut hasher);
    hasher.finish()
}
