//! A cell as a member of a fleet: its liveliness tokens, its telemetry, its resources, its commands and its part in coordinated starts, in
//! five threads of its own, two for each session of commands and one for each start while it is prepared. It knows no controller: what it
//! publishes and executes comes from a [`Cell`].
//!
//! Callbacks of zenoh only pass queries to bounded queues, since zenoh reads the link in the thread that calls back. A full queue refuses
//! the query at once. The instant of a command is that at which it leaves the queue, so that one that waited too long is refused. A
//! command that takes long delays neither the keep-alive of its session nor other sessions.

mod commands;
mod notified;
mod publish;
mod reach;
mod shared;
mod starts;

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::sync_channel;
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

use zenoh::Wait as _;
use zenoh::liveliness::LivelinessToken;

use super::observer::Fleet;
use super::{SessionError, open};
use crate::command::{Admission, Boot, Limits, random};
use crate::config::{FleetSettings, of_cell};
use crate::keys::{CellKeys, CellName};
use commands::Event;
use shared::{QUEUE, Shared, answer};

pub use shared::{Cell, Held, HeldState, LOG_LINES_KEPT, TELEMETRY_PERIOD, TOPICS_MAX, Topic};

/// Why a cell does not join.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum JoinError {
    /// The session cannot be opened or a key not declared.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// Another controller answers with this name.
    #[error(
        "another controller of this fleet has the name `{0}`\nhint: set another fleet.cell in one of the two cell files"
    )]
    Clash(CellName),
    /// The host has no thread left.
    #[error("cannot start a thread of the fleet: {0}")]
    Thread(#[from] std::io::Error),
}

/// A cell in a fleet. Dropping it leaves: sessions of clients are lost by their policies.
pub struct Member {
    shared: Arc<Shared>,
    token: Option<LivelinessToken>,
    threads: Vec<JoinHandle<()>>,
}

impl std::fmt::Debug for Member {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Member")
            .field("cell", self.shared.keys.cell())
            .finish_non_exhaustive()
    }
}

impl Member {
    /// Joins. No other member needs to be there: links are made when others come.
    ///
    /// # Errors
    /// If an address cannot be bound, or another controller that is reachable has the same name.
    pub fn join(
        name: &CellName,
        settings: &FleetSettings,
        limits: Limits,
        cell: Arc<dyn Cell>,
    ) -> Result<Self, JoinError> {
        let session = open(&of_cell(name, settings))?;
        let (keys, boot) = (CellKeys::new(name.clone()), Boot(random()()));
        let command_keys = (keys.cmd_session(), keys.cmd_directio());
        let shared = Arc::new(Shared {
            keys,
            boot,
            admission: Mutex::new(Admission::new(command_keys, boot, limits, random())),
            cell,
            session,
            connect: settings.connect.clone(),
            ends: AtomicBool::new(false),
            clashes: AtomicBool::new(false),
        });
        if shared.finds_clash()? {
            return Err(JoinError::Clash(name.clone()));
        }
        let mut member = Self {
            shared: Arc::clone(&shared),
            token: None,
            threads: Vec::new(),
        };
        let keys = &shared.keys;
        let (reads, from_reads) = sync_channel(QUEUE);
        answer(
            &shared,
            &[keys.info(), keys.of("resource/**")],
            &reads,
            |it| it,
        )?;
        let (commands, from_commands) = sync_channel(QUEUE);
        let own = [keys.cmd_session(), keys.cmd_directio()];
        answer(&shared, &own, &commands, Event::Query)?;
        member.spawn("fleet-read", move |shared| {
            publish::answer(&shared, &from_reads);
        })?;
        member.spawn("fleet-cmd", move |shared| {
            commands::serve(&shared, (commands, from_commands));
        })?;
        let starts = starts::listen(&shared)?;
        member.spawn("fleet-start", move |shared| starts::serve(&shared, starts))?;
        member.spawn("fleet-pub", |shared| publish::publish(&shared))?;
        if settings.joints_hz > 0 {
            member.spawn("fleet-joints", |shared| publish::publish_joints(&shared))?;
        }
        // At last: who sees it can query.
        let token = shared.session.liveliness().declare_token(keys.alive());
        member.token = Some(
            token
                .wait()
                .map_err(SessionError::of("cannot declare the cell alive"))?,
        );
        Ok(member)
    }

    /// This run of the controller, as its clients name it.
    #[must_use]
    pub fn boot(&self) -> Boot {
        self.shared.boot
    }

    /// What this member sees of its fleet. Other cells answer by the rights of the links between.
    #[must_use]
    pub fn observe(&self) -> Fleet {
        Fleet::of(self.shared.session.clone())
    }

    /// Whether another controller with the name of this one was there at the last search.
    #[must_use]
    pub fn clashes(&self) -> bool {
        self.shared.clashes.load(Ordering::Acquire)
    }

    fn spawn(
        &mut self,
        name: &str,
        run: impl FnOnce(Arc<Shared>) + Send + 'static,
    ) -> Result<(), std::io::Error> {
        let shared = Arc::clone(&self.shared);
        let thread = std::thread::Builder::new().name(name.to_owned());
        self.threads.push(thread.spawn(move || run(shared))?);
        Ok(())
    }
}

impl Drop for Member {
    fn drop(&mut self) {
        self.token = None;
        self.shared.ends.store(true, Ordering::Release);
        for thread in self.threads.drain(..) {
            thread.thread().unpark();
            if thread.join().is_err() {
                tracing::error!("a thread of the fleet has panicked");
            }
        }
        if let Err(why) = self.shared.session.close().wait() {
            tracing::warn!("the session of the fleet did not close in order: {why}");
        }
    }
}

#[cfg(test)]
mod tests;
