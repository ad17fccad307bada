//! Places of connections: how many there may be of each kind, and which one leaves when there is no other.
//! A connection first waits, with little memory, until it has shown what it may do; those that wait never
//! refuse a new one but displace the oldest of the address that has most of them, so that silent connections
//! keep nobody out. Admitted ones have places by what they are admitted for: a flood of one kind takes none
//! from the others. This file reads no clock and closes nothing.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::sync::Notify;

use crate::access::{Credential, Peer};

/// Most connections that wait to be admitted.
pub const WAITING_MAX: usize = 256;

/// Most of them by one address, or over the Unix socket.
pub const WAITING_PER_ADDRESS: usize = 128;

/// Most connections of messages that one credential admits.
pub const CONNECTIONS_MAX: usize = 64;

/// Most of them by one address that gave the token.
pub const CONNECTIONS_PER_ADDRESS: usize = 48;

/// Most requests over HTTP at once that one credential admits.
pub const REQUESTS_MAX: usize = 32;

/// A connection of messages that sent nothing for so long leaves if another one needs its place.
pub const IDLE_DISPLACED: Duration = Duration::from_secs(60);

/// A request that is still being sent after this leaves if another one needs its place.
const REQUEST_DISPLACED: Duration = Duration::from_secs(2);

/// All places there are.
pub const PLACES_MAX: usize = WAITING_MAX + 3 * CONNECTIONS_MAX + 2 * REQUESTS_MAX;

/// What a connection is there for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Pool {
    /// It has not shown yet what it may do.
    Waiting,
    /// One request over HTTP.
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
            // All of them are of this host.
            Self::Request(_) | Self::Messages(Credential::Loopback | Credential::Account) => {
                self.bound()
            }
        }
    }

    /// How long one must have been idle to make room.
    const fn displaced_after(self) -> Duration {
        match self {
            Self::Waiting => Duration::ZERO,
            Self::Request(_) => REQUEST_DISPLACED,
            Self::Messages(_) => IDLE_DISPLACED,
        }
    }
}

/// There is no place, and none can be made.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("too many connections: at most {bound}; close one first")]
pub(crate) struct Full {
    pub(crate) bound: usize,
}

/// All places of a server.
#[derive(Clone, Debug, Default)]
pub(crate) struct Places(Arc<Mutex<Taken>>);

#[derive(Debug, Default)]
struct Taken {
    next: u64,
    by: BTreeMap<u64, Entry>,
}

#[derive(Debug)]
struct Entry {
    peer: Peer,
    pool: Pool,
    /// When it last sent something.
    since: Duration,
    leave: Arc<Notify>,
}

/// A connection's place, until it is dropped.
#[derive(Debug)]
pub(crate) struct Place {
    places: Places,
    number: u64,
    leave: Arc<Notify>,
}

impl Places {
    fn lock(&self) -> MutexGuard<'_, Taken> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes a new connection in, which waits; another one may have to leave for it.
    pub(crate) fn enter(&self, peer: Peer, now: Duration) -> (Place, bool) {
        let mut taken = self.lock();
        let displaces = taken.make_room(Pool::Waiting, peer, now).unwrap_or(false);
        let (number, leave) = (taken.next, Arc::new(Notify::new()));
        taken.next += 1;
        let entry = Entry {
            peer,
            pool: Pool::Waiting,
            since: now,
            leave: Arc::clone(&leave),
        };
        taken.by.insert(number, entry);
        drop(taken);
        let places = self.clone();
        let place = Place {
            places,
            number,
            leave,
        };
        (place, displaces)
    }
}

impl Taken {
    /// Makes room in a pool; tells whether another connection was asked to leave.
    fn make_room(&mut self, pool: Pool, peer: Peer, now: Duration) -> Result<bool, Full> {
        let counts = self.counts(pool);
        let (all, of_peer) = (
            counts.values().sum::<usize>(),
            counts.get(&key(peer)).copied().unwrap_or(0),
        );
        let crowded = if of_peer >= pool.per_address() {
            Some((key(peer), pool.per_address()))
        } else if all >= pool.bound() {
            let most = counts.iter().max_by_key(|(_, count)| **count);
            most.map(|(peer, _)| (*peer, pool.bound()))
        } else {
            None
        };
        let Some((crowd, bound)) = crowded else {
            return Ok(false);
        };
        let members = self
            .by
            .iter()
            .filter(|(_, e)| e.pool == pool && key(e.peer) == crowd);
        let oldest = members
            .min_by_key(|(_, e)| e.since)
            .map(|(number, _)| *number);
        let idle =
            |e: &Entry| now >= e.since && now.saturating_sub(e.since) >= pool.displaced_after();
        let leaves = oldest.filter(|number| self.by.get(number).is_some_and(idle));
        let Some(entry) = leaves.and_then(|number| self.by.remove(&number)) else {
            return Err(Full { bound });
        };
        entry.leave.notify_one();
        Ok(true)
    }

    fn counts(&self, pool: Pool) -> BTreeMap<Option<std::net::IpAddr>, usize> {
        let mut counts = BTreeMap::new();
        for entry in self.by.values().filter(|e| e.pool == pool) {
            *counts.entry(key(entry.peer)).or_insert(0) += 1;
        }
        counts
    }
}

/// What counts as one address.
fn key(peer: Peer) -> Option<std::net::IpAddr> {
    match peer {
        Peer::Local => None,
        Peer::Address(address) => Some(address.to_canonical()),
    }
}

impl Place {
    /// Changes what the connection is there for; tells whether another one had to leave.
    ///
    /// # Errors
    /// If there are as many as there may be, and none of them is idle.
    pub(crate) fn admit(&self, pool: Pool, now: Duration) -> Result<bool, Full> {
        let mut taken = self.places.lock();
        let Some((peer, before)) = taken.by.get(&self.number).map(|e| (e.peer, e.pool)) else {
            // It was asked to leave meanwhile.
            return Err(Full {
                bound: pool.bound(),
            });
        };
        if before == pool {
            return Ok(false);
        }
        let displaces = taken.make_room(pool, peer, now)?;
        if let Some(entry) = taken.by.get_mut(&self.number) {
            (entry.pool, entry.since) = (pool, now);
        }
        Ok(displaces)
    }

    /// Notes that the connection sent something.
    pub(crate) fn touch(&self, now: Duration) {
        if let Some(entry) = self.places.lock().by.get_mut(&self.number)
            && entry.pool != Pool::Waiting
        {
            entry.since = now;
        }
    }

    /// Whether it waits to be admitted.
    pub(crate) fn waits(&self) -> bool {
        let taken = self.places.lock();
        taken
            .by
            .get(&self.number)
            .is_none_or(|e| e.pool == Pool::Waiting)
    }

    /// Waits until the connection has to leave.
    pub(crate) async fn displaced(&self) {
        self.leave.notified().await;
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.places.lock().by.remove(&self.number);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::{IpAddr, Ipv4Addr};

    fn peer(last: u8) -> Peer {
        Peer::Address(IpAddr::V4(Ipv4Addr::new(192, 0, 2, last)))
    }

    fn leaves(place: &Place) -> bool {
        !place.places.lock().by.contains_key(&place.number)
    }

    #[test]
    fn silent_flood_displaces_its_own_oldest() {
        let places = Places::default();
        let (other, _) = places.enter(peer(2), Duration::ZERO);
        let mut flood: Vec<_> = (0..WAITING_PER_ADDRESS)
            .map(|n| places.enter(peer(1), Duration::from_millis(1 + n as u64)).0)
            .collect();
        assert!(!leaves(&flood[0]));
        let (honest, displaces) = places.enter(peer(1), Duration::from_secs(1));
        assert!(displaces && leaves(&flood[0]) && !leaves(&flood[1]));
        assert!(!leaves(&other), "another address is not its business");
        let now = Duration::from_secs(1);
        let pool = Pool::Messages(Credential::Token);
        assert_eq!(honest.admit(pool, now), Ok(false));
        flood.clear();
        assert_eq!(places.lock().by.len(), 2);
    }

    #[test]
    fn many_addresses_displace_the_one_with_most() {
        let places = Places::default();
        let now = Duration::ZERO;
        let few: Vec<_> = (0..6)
            .map(|n| places.enter(peer(2), now + Duration::from_nanos(n)).0)
            .collect();
        let most: Vec<_> = (0..100).map(|_| places.enter(peer(1), now).0).collect();
        let rest: Vec<_> = (0..WAITING_MAX - 106)
            .map(|n| {
                places
                    .enter(peer(3 + u8::try_from(n % 200).unwrap()), now)
                    .0
            })
            .collect();
        let (_new, displaces) = places.enter(peer(250), now);
        assert!(displaces && few.iter().chain(&rest).all(|place| !leaves(place)));
        assert_eq!(most.iter().filter(|place| leaves(place)).count(), 1);
    }

    #[test]
    fn full_pool_refuses_until_one_is_idle() {
        let places = Places::default();
        let pool = Pool::Messages(Credential::Loopback);
        let at = Duration::from_secs;
        let enter = |now| places.enter(peer(1), now).0;
        let admitted: Vec<_> = (0..CONNECTIONS_MAX).map(|_| enter(at(0))).collect();
        for place in &admitted {
            assert_eq!(place.admit(pool, at(0)), Ok(false));
        }
        let next = enter(at(59));
        let bound = CONNECTIONS_MAX;
        assert_eq!(next.admit(pool, at(59)), Err(Full { bound }));
        // Another credential has places of its own.
        let trusted = enter(at(59));
        let token = Pool::Messages(Credential::Token);
        assert_eq!(trusted.admit(token, at(59)), Ok(false));
        admitted[0].touch(at(30));
        assert_eq!(next.admit(pool, at(60)), Ok(true));
        assert!(leaves(&admitted[1]) && !leaves(&admitted[0]));
    }

    #[test]
    fn one_address_takes_not_all_places_of_the_token() {
        let places = Places::default();
        let pool = Pool::Messages(Credential::Token);
        let enter = |last| places.enter(peer(last), Duration::ZERO).0;
        let of_one: Vec<_> = (0..CONNECTIONS_PER_ADDRESS).map(|_| enter(1)).collect();
        for place in &of_one {
            assert_eq!(place.admit(pool, Duration::ZERO), Ok(false));
        }
        assert!(enter(1).admit(pool, Duration::ZERO).is_err());
        assert_eq!(enter(2).admit(pool, Duration::ZERO), Ok(false));
    }
}
