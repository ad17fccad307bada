//! The file server of a slave (FoE): files in memory, shared with their owner. Firmware is written in BOOT only.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::foe::{Foe, FoeError};
use crate::{AlState, MailboxHeader};

/// The files of a slave and how it treats them.
#[derive(Clone, Debug)]
pub struct FileStore {
    /// Contents by name.
    pub files: BTreeMap<Vec<u8>, Vec<u8>>,
    /// The password of each request; 0 for none.
    pub password: u32,
    /// Number of busy answers to each packet before it is accepted.
    pub busy: u16,
    /// Longest file, bytes.
    pub capacity: usize,
    /// The last write has not ended: without a whole firmware, PRE-OP is refused.
    pub incomplete: bool,
}

impl Default for FileStore {
    /// Empty, without password, 1 MiB.
    fn default() -> Self {
        Self {
            files: BTreeMap::new(),
            password: 0,
            busy: 0,
            capacity: 1 << 20,
            incomplete: false,
        }
    }
}

/// Access to the files of a slave.
#[derive(Clone, Debug, Default)]
pub struct Files(Arc<Mutex<FileStore>>);

impl Files {
    /// Locks the files.
    pub fn lock(&self) -> MutexGuard<'_, FileStore> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[derive(Debug)]
enum Transfer {
    Write {
        name: Vec<u8>,
        data: Vec<u8>,
        /// The packet that is expected.
        packet: u32,
        /// Busy answers to it so far.
        busy: u16,
    },
    Read {
        data: Vec<u8>,
        /// The packet that was sent, and the position behind it.
        packet: u32,
        at: usize,
        last: bool,
    },
}

/// The server.
#[derive(Debug, Default)]
pub(super) struct FileServer {
    pub(super) files: Files,
    transfer: Option<Transfer>,
}

impl FileServer {
    /// Ends the transfer.
    pub(super) fn reset(&mut self) {
        self.transfer = None;
    }

    /// Handles a message; `lens` are the lengths of the mailboxes that the slave receives and sends. Returns the answer, if
    /// there is one.
    pub(super) fn answer(
        &mut self,
        request: &[u8],
        state: AlState,
        lens: (u16, u16),
    ) -> Option<Vec<u8>> {
        let head = MailboxHeader::LEN + Foe::HEAD;
        let room = |len: u16| usize::from(len).saturating_sub(head);
        let answered = match Foe::decode(request) {
            Some(Foe::Read { password, name }) => self.begin_read(password, name, room(lens.1)),
            Some(Foe::Write { password, name }) => self.begin_write(password, name, state),
            Some(Foe::Data { packet, data }) => self.take(packet, data, room(lens.0)),
            Some(Foe::Acknowledge { packet }) => self.acknowledged(packet, room(lens.1)),
            Some(Foe::Error { .. }) => {
                self.reset();
                Ok(None)
            }
            Some(Foe::Busy { .. }) | None => Err(FoeError::ILLEGAL),
        };
        answered.unwrap_or_else(|code| {
            self.reset();
            let text = &b"emulated"[..];
            Some(encoded(&Foe::Error { code, text }))
        })
    }

    fn begin_read(&mut self, password: u32, name: &[u8], room: usize) -> Answer {
        let store = self.files.lock();
        if password != store.password {
            return Err(FoeError::DENIED);
        }
        let data = store.files.get(name).ok_or(FoeError::NOT_FOUND)?.clone();
        drop(store);
        self.transfer = Some(Transfer::Read {
            data,
            packet: 0,
            at: 0,
            last: false,
        });
        self.acknowledged(0, room)
    }

    fn begin_write(&mut self, password: u32, name: &[u8], state: AlState) -> Answer {
        if state != AlState::Boot {
            return Err(FoeError::BOOT_ONLY);
        }
        let mut store = self.files.lock();
        if password != store.password {
            return Err(FoeError::DENIED);
        }
        // The memory is erased now.
        store.incomplete = true;
        drop(store);
        self.transfer = Some(Transfer::Write {
            name: name.to_vec(),
            data: Vec::new(),
            packet: 1,
            busy: 0,
        });
        Ok(Some(encoded(&Foe::Acknowledge { packet: 0 })))
    }

    /// Takes a packet of a written file.
    fn take(&mut self, number: u32, bytes: &[u8], room: usize) -> Answer {
        let mut store = self.files.lock();
        let Some(Transfer::Write {
            name,
            data,
            packet,
            busy,
        }) = &mut self.transfer
        else {
            return Err(FoeError::ILLEGAL);
        };
        if number != *packet {
            return Err(FoeError::PACKET_NUMBER);
        }
        if *busy < store.busy {
            *busy += 1;
            let (done, all) = (*busy, store.busy);
            return Ok(Some(encoded(&Foe::Busy { done, all })));
        }
        if data.len() + bytes.len() > store.capacity {
            return Err(FoeError::DISK_FULL);
        }
        data.extend_from_slice(bytes);
        (*packet, *busy) = (number + 1, 0);
        if bytes.len() < room {
            store
                .files
                .insert(std::mem::take(name), std::mem::take(data));
            store.incomplete = false;
            self.transfer = None;
        }
        Ok(Some(encoded(&Foe::Acknowledge { packet: number })))
    }

    /// Sends the packet after an acknowledged one.
    fn acknowledged(&mut self, number: u32, room: usize) -> Answer {
        let Some(Transfer::Read {
            data,
            packet,
            at,
            last,
        }) = &mut self.transfer
        else {
            return Err(FoeError::ILLEGAL);
        };
        if number != *packet {
            return Err(FoeError::PACKET_NUMBER);
        }
        if *last {
            self.transfer = None;
            return Ok(None);
        }
        let rest = data.get(*at..).unwrap_or_default();
        let part = rest.get(..rest.len().min(room)).unwrap_or_default();
        (*packet, *at, *last) = (number + 1, *at + part.len(), part.len() < room);
        let packet = *packet;
        Ok(Some(encoded(&Foe::Data { packet, data: part })))
    }
}

/// The message to send, if there is one.
type Answer = Result<Option<Vec<u8>>, FoeError>;

fn encoded(message: &Foe<'_>) -> Vec<u8> {
    let mut bytes = vec![0; crate::link::FRAME_MAX];
    let len = message.encode(&mut bytes).unwrap_or(0);
    bytes.truncate(len);
    bytes
}
