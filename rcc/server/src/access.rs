//! Admission control: which clients need a token, its comparison in constant time, and the delay for addresses that
//! send wrong ones. Where a request carries the token is not known here. Nothing is encrypted: who can capture the
//! network traffic can read the token.

pub(crate) mod origin;

use std::collections::BTreeMap;
use std::net::IpAddr;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use takt_client::Token;
use takt_core::Loopback;

/// Wrong tokens per address within [`WRONG_WINDOW`] that are answered at once; further ones are answered after
/// [`WRONG_DELAY`]. The right token is always admitted: other programs or web pages of the same host must not lock
/// its holder out.
pub(crate) const WRONG_MAX: u32 = 5;

/// See [`WRONG_MAX`].
pub(crate) const WRONG_WINDOW: Duration = Duration::from_secs(60);

/// Delay of each further answer to an address that sent too many wrong tokens. With tokens of at least
/// [`TOKEN_CHARS_MIN`](takt_client::token::TOKEN_CHARS_MIN) characters and a bounded number of connections, guessing is hopeless.
pub const WRONG_DELAY: Duration = Duration::from_secs(1);

/// Addresses whose wrong tokens are counted; when full, the entry with the oldest first token is dropped.
const ADDRESSES_MAX: usize = 1024;

/// Result of the admission check.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Admission {
    /// The client is admitted.
    Admitted(Credential),
    /// It sent no token.
    Missing,
    /// It sent a wrong one.
    Wrong,
    /// It sent a wrong one after too many from the same address; the answer is sent after [`WRONG_DELAY`].
    TooMany,
}

/// Where a client's connection comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Peer {
    /// The Unix socket; the kernel reported its account, and that account is admitted.
    Local,
    /// The network, loopback included.
    Address(IpAddr),
}

/// On which grounds a client was admitted. Each has connection slots of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Credential {
    /// None: it is connected to loopback, and loopback is open.
    Loopback,
    /// The right token.
    Token,
    /// The account at the Unix socket.
    Account,
}

/// Admits clients or rejects them.
#[derive(Debug)]
pub struct Gate {
    token: Option<Token>,
    loopback: Loopback,
    wrong: Mutex<BTreeMap<IpAddr, Wrong>>,
}

#[derive(Debug)]
struct Wrong {
    count: u32,
    since: Duration,
}

impl Gate {
    /// A gate that requires this token, if any. `loopback` selects whether network clients of this host need it too;
    /// by default they do if there is one.
    pub fn new(token: Option<Token>, loopback: Option<Loopback>) -> Self {
        let default = if token.is_some() {
            Loopback::Token
        } else {
            Loopback::Open
        };
        Self {
            token,
            loopback: loopback.unwrap_or(default),
            wrong: Mutex::new(BTreeMap::new()),
        }
    }

    /// On which grounds a client is admitted without a token; `None` if it needs one.
    pub(crate) fn without_token(&self, peer: Peer) -> Option<Credential> {
        match peer {
            Peer::Local => Some(Credential::Account),
            Peer::Address(address) => (address.to_canonical().is_loopback()
                && self.loopback == Loopback::Open)
                .then_some(Credential::Loopback),
        }
    }

    /// Checks the token that a client sent; all `now` count from the same moment. The right token is always admitted,
    /// even where none is needed.
    pub fn check(&self, peer: Peer, given: Option<&str>, now: Duration) -> Admission {
        let right = |given: &str| {
            self.token
                .as_ref()
                .is_some_and(|token| token.matches(given))
        };
        match given {
            Some(given) if right(given) => Admission::Admitted(Credential::Token),
            None => match self.without_token(peer) {
                Some(credential) => Admission::Admitted(credential),
                None => Admission::Missing,
            },
            Some(_) => match self.without_token(peer) {
                Some(credential) => Admission::Admitted(credential),
                None => self.count_wrong(peer, now),
            },
        }
    }

    fn count_wrong(&self, peer: Peer, now: Duration) -> Admission {
        let Peer::Address(address) = peer else {
            return Admission::Wrong;
        };
        let mut wrong = self.wrong.lock().unwrap_or_else(PoisonError::into_inner);
        wrong.retain(|_, w| now < w.since.saturating_add(WRONG_WINDOW));
        if wrong.len() >= ADDRESSES_MAX && !wrong.contains_key(&address) {
            let first = wrong.iter().min_by_key(|(_, w)| w.since);
            if let Some(first) = first.map(|(address, _)| *address) {
                wrong.remove(&first);
            }
        }
        let entry = wrong.entry(address).or_insert(Wrong {
            count: 0,
            since: now,
        });
        entry.count = entry.count.saturating_add(1);
        if entry.count > WRONG_MAX {
            Admission::TooMany
        } else {
            Admission::Wrong
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::Ipv4Addr;

    const TOKEN: &str = "0123456789abcdef";
    const HERE: Peer = Peer::Address(IpAddr::V4(Ipv4Addr::new(192, 0, 2, 1)));
    const LOOPBACK: Peer = Peer::Address(IpAddr::V4(Ipv4Addr::LOCALHOST));

    fn gate() -> Gate {
        Gate::new(Some(Token::new(TOKEN).unwrap()), None)
    }

    #[test]
    fn only_whole_token_is_admitted() {
        let gate = gate();
        let check = |given| gate.check(HERE, given, Duration::ZERO);
        assert_eq!(check(Some(TOKEN)), Admission::Admitted(Credential::Token));
        assert_eq!(check(None), Admission::Missing);
        for wrong in ["", "0", "0123456789abcdeF", "0123456789abcdef0"] {
            assert_eq!(check(Some(wrong)), Admission::Wrong, "{wrong}");
        }
        let open = Gate::new(None, None);
        let check = |peer| open.check(peer, None, Duration::ZERO);
        let anyone = Admission::Admitted(Credential::Loopback);
        assert_eq!(check(LOOPBACK), anyone);
        assert_eq!(check(HERE), Admission::Missing, "not from this host");
    }

    #[test]
    fn right_token_after_many_wrong_ones_is_admitted() {
        let gate = gate();
        let guess = || gate.check(HERE, Some("guess"), Duration::ZERO);
        for _ in 0..WRONG_MAX {
            assert_eq!(guess(), Admission::Wrong);
        }
        assert_eq!(guess(), Admission::TooMany);
        let right = gate.check(HERE, Some(TOKEN), Duration::ZERO);
        assert_eq!(right, Admission::Admitted(Credential::Token));
        let later = gate.check(HERE, Some("guess"), WRONG_WINDOW);
        assert_eq!(later, Admission::Wrong);
    }

    #[test]
    fn loopback_requires_token_unless_open() {
        let token = || Some(Token::new(TOKEN).unwrap());
        let needs = |token, loopback| {
            let gate = Gate::new(token, loopback);
            gate.without_token(LOOPBACK).is_none()
        };
        assert!(needs(token(), None));
        assert!(!needs(token(), Some(Loopback::Open)));
        assert!(!needs(None, None));
        assert!(needs(None, Some(Loopback::Token)));
        let mapped = Peer::Address("::ffff:127.0.0.1".parse().unwrap());
        let open = Gate::new(token(), Some(Loopback::Open));
        assert_eq!(open.without_token(mapped), Some(Credential::Loopback));
        assert_eq!(open.without_token(HERE), None);
        assert_eq!(open.without_token(Peer::Local), Some(Credential::Account));
    }

    #[test]
    fn remembered_addresses_are_bounded() {
        let gate = gate();
        for number in 0..5_000_u32 {
            let address = IpAddr::V4(Ipv4Addr::from(number));
            let now = Duration::from_millis(number.into());
            gate.check(Peer::Address(address), Some("guess"), now);
        }
        assert_eq!(gate.wrong.lock().unwrap().len(), ADDRESSES_MAX);
    }
}
