//! Connection slots: a quota for each kind of connection, and which connection is evicted when a quota is used up.
//! A new connection waits with little memory until it is admitted. Waiting connections never block a new one: the
//! oldest of the address with most of them is evicted, so that silent connections lock no client out. Admitted
//! connections have slots by their credential: a flood of one kind takes none from the others. This module reads no
//! clock and closes nothing.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::sync::Notify;

use crate::access::{Credential, Peer};

/// Most connections that wait for admission.
pub const WAITING_MAX: usize = 256;

/// Most of them from one address, or at the Unix socket.
pub const WAITING_PER_ADDRESS: usize = 128;

/// Most message connections per credential.
pub const CONNECTIONS_MAX: usize = 64;

/// Most of them from one address with the token.
pub const CONNECTIONS_PER_ADDRESS: usize = 48;

/// Most concurrent HTTP requests per credential.
pub const REQUESTS_MAX: usize = 32;

/// A message connection that has been silent for this time may be evicted.
pub const IDLE_EVICTED_AFTER: Duration = Duration::from_secs(60);

/// A request that is still being received after this time may be evicted.
const REQUEST_EVICTED_AFTER: Duration = Duration::from_secs(2);

/// Total number of slots.
pub const SLOTS_MAX: usize = WAITING_MAX + 3 * CONNECTIONS_MAX + 2 * REQUESTS_MAX;

/// The quota that a connection counts against.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Pool {
    /// Not admitted yet.
    Waiting,
    /// One HTTP request.
    Request(Credential),
    /// DirectIO messages.
    Messages(Credential),
}

impl Pool {
    const fn bound(self) -> usize {
        match self {
            Self::Waiting => WAITING_MAX,
            Self::Request(_) => REQUESTS_MAX,
            Self::Messages(_) => CONNECTIONS_MAX,
        }
    }

    const fn per_address(self) -> usize {
        match self {
            Self::Waiting => WAITING_PER_ADDRESS,
            Self::Messages(Credential::Token) => CONNECTIONS_PER_ADDRESS,
            // All of these are from this host.
            Self::Request(_) | Self::Messages(Credential::Loopback | Credential::Account) => {
                self.bound()
            }
        }
    }

    /// How long a connection must have been idle to be evicted.
    const fn evictable_after(self) -> Duration {
        match self {
            Self::Waiting => Duration::ZERO,
            Self::Request(_) => REQUEST_EVICTED_AFTER,
            Self::Messages(_) => IDLE_EVICTED_AFTER,
        }
    }
}

/// All slots are in use and none can be freed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("too many connections: at most {bound}; close one first")]
pub(crate) struct Full {
    pub(crate) bound: usize,
}

/// All connection slots of a server.
#[derive(Clone, Debug, Default)]
pub(crate) struct Slots(Arc<Mutex<SlotTable>>);

#[derive(Debug, Default)]
struct SlotTable {
    next: u64,
    entries: BTreeMap<u64, Entry>,
}

#[derive(Debug)]
struct Entry {
    peer: Peer,
    pool: Pool,
    /// When data was last received from it.
    since: Duration,
    evict: Arc<Notify>,
}

/// The slot of one connection; freed on drop.
#[derive(Debug)]
pub(crate) struct Slot {
    slots: Slots,
    number: u64,
    evict: Arc<Notify>,
}

impl Slots {
    fn lock(&self) -> MutexGuard<'_, SlotTable> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Gives a new connection a waiting slot; also returns whether another one was evicted for it.
    pub(crate) fn enter(&self, peer: Peer, now: Duration) -> (Slot, bool) {
        let mut table = self.lock();
        let evicts = table.free_slot(Pool::Waiting, peer, now).unwrap_or(false);
        let (number, evict) = (table.next, Arc::new(Notify::new()));
        table.next += 1;
        let entry = Entry {
            peer,
            pool: Pool::Waiting,
            since: now,
            evict: Arc::clone(&evict),
        };
        table.entries.insert(number, entry);
        drop(table);
        let slots = self.clone();
        let slot = Slot {
            slots,
            number,
            evict,
        };
        (slot, evicts)
    }
}

impl SlotTable {
    /// Frees a slot of a pool if it is full; returns whether a connection was evicted.
    fn free_slot(&mut self, pool: Pool, peer: Peer, now: Duration) -> Result<bool, Full> {
        let counts = self.counts(pool);
        let (all, of_peer) = (
            counts.values().sum::<usize>(),
            counts.get(&key(peer)).copied().unwrap_or(0),
        );
        let overfull = if of_peer >= pool.per_address() {
            Some((key(peer), pool.per_address()))
        } else if all >= pool.bound() {
            let most = counts.iter().max_by_key(|(_, count)| **count);
            most.map(|(peer, _)| (*peer, pool.bound()))
        } else {
            None
        };
        let Some((address, bound)) = overfull else {
            return Ok(false);
        };
        let members = self
            .entries
            .iter()
            .filter(|(_, e)| e.pool == pool && key(e.peer) == address);
        let oldest = members
            .min_by_key(|(_, e)| e.since)
            .map(|(number, _)| *number);
        let idle =
            |e: &Entry| now >= e.since && now.saturating_sub(e.since) >= pool.evictable_after();
        let evicted = oldest.filter(|number| self.entries.get(number).is_some_and(idle));
        let Some(entry) = evicted.and_then(|number| self.entries.remove(&number)) else {
            return Err(Full { bound });
        };
        entry.evict.notify_one();
        Ok(true)
    }

    fn counts(&self, pool: Pool) -> BTreeMap<Option<std::net::IpAddr>, usize> {
        let mut counts = BTreeMap::new();
        for entry in self.entries.values().filter(|e| e.pool == pool) {
            *counts.entry(key(entry.peer)).or_insert(0) += 1;
        }
        counts
    }
}

/// Key by which connections of one address are counted.
fn key(peer: Peer) -> Option<std::net::IpAddr> {
    match peer {
        Peer::Local => None,
        Peer::Address(address) => Some(address.to_canonical()),
    }
}

impl Slot {
    /// Moves the connection to another pool; returns whether another one was evicted for it.
    ///
    /// # Errors
    /// If the pool is full and none of its connections is idle.
    pub(crate) fn admit(&self, pool: Pool, now: Duration) -> Result<bool, Full> {
        let mut table = self.slots.lock();
        let Some((peer, before)) = table.entries.get(&self.number).map(|e| (e.peer, e.pool)) else {
            // It was evicted meanwhile.
            return Err(Full {
                bound: pool.bound(),
            });
        };
        if before == pool {
            return Ok(false);
        }
        let evicts = table.free_slot(pool, peer, now)?;
        if let Some(entry) = table.entries.get_mut(&self.number) {
            (entry.pool, entry.since) = (pool, now);
        }
        Ok(evicts)
    }

    /// Records that data was received from the connection.
    pub(crate) fn touch(&self, now: Duration) {
        if let Some(entry) = self.slots.lock().entries.get_mut(&self.number)
            && entry.pool != Pool::Waiting
        {
            entry.since = now;
        }
    }

    /// Whether it waits for admission.
    pub(crate) fn is_waiting(&self) -> bool {
        let table = self.slots.lock();
        table
            .entries
            .get(&self.number)
            .is_none_or(|e| e.pool == Pool::Waiting)
    }

    /// Waits until the connection is evicted.
    pub(crate) async fn evicted(&self) {
        self.evict.notified().await;
    }
}

impl Drop for Slot {
    fn drop(&mut self) {
        self.slots.lock().entries.remove(&self.number);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::{IpAddr, Ipv4Addr};

    fn peer(last: u8) -> Peer {
        Peer::Address(IpAddr::V4(Ipv4Addr::new(192, 0, 2, last)))
    }

    fn is_evicted(slot: &Slot) -> bool {
        !slot.slots.lock().entries.contains_key(&slot.number)
    }

    #[test]
    fn silent_flood_evicts_its_own_oldest() {
        let slots = Slots::default();
        let (other, _) = slots.enter(peer(2), Duration::ZERO);
        let mut flood: Vec<_> = (0..WAITING_PER_ADDRESS)
            .map(|n| slots.enter(peer(1), Duration::from_millis(1 + n as u64)).0)
            .collect();
        assert!(!is_evicted(&flood[0]));
        let (honest, evicts) = slots.enter(peer(1), Duration::from_secs(1));
        assert!(evicts && is_evicted(&flood[0]) && !is_evicted(&flood[1]));
        assert!(!is_evicted(&other), "another address is not affected");
        let now = Duration::from_secs(1);
        let pool = Pool::Messages(Credential::Token);
        assert_eq!(honest.admit(pool, now), Ok(false));
        flood.clear();
        assert_eq!(slots.lock().entries.len(), 2);
    }

    #[test]
    fn full_waiting_pool_evicts_from_largest_address() {
        let slots = Slots::default();
        let now = Duration::ZERO;
        let few: Vec<_> = (0..6)
            .map(|n| slots.enter(peer(2), now + Duration::from_nanos(n)).0)
            .collect();
        let most: Vec<_> = (0..100).map(|_| slots.enter(peer(1), now).0).collect();
        let rest: Vec<_> = (0..WAITING_MAX - 106)
            .map(|n| slots.enter(peer(3 + u8::try_from(n % 200).unwrap()), now).0)
            .collect();
        let (_new, evicts) = slots.enter(peer(250), now);
        assert!(evicts && few.iter().chain(&rest).all(|slot| !is_evicted(slot)));
        assert_eq!(most.iter().filter(|slot| is_evicted(slot)).count(), 1);
    }

    #[test]
    fn full_pool_rejects_until_one_is_idle() {
        let slots = Slots::default();
        let pool = Pool::Messages(Credential::Loopback);
        let at = Duration::from_secs;
        let enter = |now| slots.enter(peer(1), now).0;
        let admitted: Vec<_> = (0..CONNECTIONS_MAX).map(|_| enter(at(0))).collect();
        for slot in &admitted {
            assert_eq!(slot.admit(pool, at(0)), Ok(false));
        }
        let next = enter(at(59));
        let bound = CONNECTIONS_MAX;
        assert_eq!(next.admit(pool, at(59)), Err(Full { bound }));
        // Another credential has its own slots.
        let trusted = enter(at(59));
        let token = Pool::Messages(Credential::Token);
        assert_eq!(trusted.admit(token, at(59)), Ok(false));
        admitted[0].touch(at(30));
        assert_eq!(next.admit(pool, at(60)), Ok(true));
        assert!(is_evicted(&admitted[1]) && !is_evicted(&admitted[0]));
    }

    #[test]
    fn token_slots_per_address_are_bounded() {
        let slots = Slots::default();
        let pool = Pool::Messages(Credential::Token);
        let enter = |last| slots.enter(peer(last), Duration::ZERO).0;
        let of_one: Vec<_> = (0..CONNECTIONS_PER_ADDRESS).map(|_| enter(1)).collect();
        for slot in &of_one {
            assert_eq!(slot.admit(pool, Duration::ZERO), Ok(false));
        }
        assert!(enter(1).admit(pool, Duration::ZERO).is_err());
        assert_eq!(enter(2).admit(pool, Duration::ZERO), Ok(false));
    }
}
