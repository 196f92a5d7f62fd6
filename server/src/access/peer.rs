//! Who asks: the peer's address, and how many connections and viewers it has.

use std::collections::HashMap;
use std::fmt;
use std::net::{IpAddr, Ipv6Addr};
use std::sync::{Arc, Mutex, PoisonError};

/// What limits per peer go by: an IPv4 address, or the 64 bits of an IPv6 address that name a network, of which a
/// single machine has all the others.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct PeerKey(IpAddr);

impl PeerKey {
    /// Of an address.
    pub fn of(address: IpAddr) -> Self {
        Self(match address.to_canonical() {
            IpAddr::V6(address) => {
                let [a, b, c, d, ..] = address.segments();
                IpAddr::V6(Ipv6Addr::new(a, b, c, d, 0, 0, 0, 0))
            }
            v4 => v4,
        })
    }

    /// All peers for which there is no room are taken together under this one.
    pub(super) const OTHERS: Self = Self(IpAddr::V6(Ipv6Addr::UNSPECIFIED));
}

impl fmt::Display for PeerKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// Who asks: whose connection a request came on, or whom a trusted proxy names. In the extensions of every request.
#[derive(Clone, Copy, Debug)]
pub struct Peer {
    /// What limits go by.
    pub key: PeerKey,
    /// The peer has more connections than it may; what comes on this one is refused.
    pub has_too_many_connections: bool,
}

impl Peer {
    /// A peer that may have this connection.
    pub fn at(address: IpAddr) -> Self {
        Self {
            key: PeerKey::of(address),
            has_too_many_connections: false,
        }
    }
}

/// Counts something per peer. A peer without any takes no memory, so the number of entries is bounded by what is counted.
#[derive(Debug, Default)]
pub(crate) struct Peers {
    counts: Mutex<HashMap<PeerKey, u32>>,
}

impl Peers {
    /// One more of a peer; none if it has `max`. Counted until the permit is dropped.
    pub(crate) fn try_add(self: &Arc<Self>, peer: PeerKey, max: u32) -> Option<PeerPermit> {
        let mut counts = self.counts.lock().unwrap_or_else(PoisonError::into_inner);
        let count = counts.entry(peer).or_insert(0);
        if *count >= max {
            if *count == 0 {
                counts.remove(&peer);
            }
            return None;
        }
        *count += 1;
        Some(PeerPermit {
            peers: Arc::clone(self),
            peer,
        })
    }
}

/// One thing of a peer that is counted.
#[derive(Debug)]
pub(crate) struct PeerPermit {
    peers: Arc<Peers>,
    peer: PeerKey,
}

impl Drop for PeerPermit {
    fn drop(&mut self) {
        let mut counts = self
            .peers
            .counts
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        if let Some(count) = counts.get_mut(&self.peer) {
            *count -= 1;
            if *count == 0 {
                counts.remove(&self.peer);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(text: &str) -> PeerKey {
        PeerKey::of(text.parse().expect("an address"))
    }

    #[test]
    fn a_network_of_ipv6_is_one_peer_and_an_ipv4_address_is_one_however_it_is_written() {
        assert_eq!(key("2001:db8:1:2::5"), key("2001:db8:1:2:ffff::1"));
        assert!(key("2001:db8:1:2::5") != key("2001:db8:1:3::5"));
        assert_eq!(key("::ffff:192.0.2.1"), key("192.0.2.1"));
        assert!(key("192.0.2.1") != key("192.0.2.2"));
    }

    #[test]
    fn a_peer_has_no_more_than_it_may_and_leaves_nothing_behind() {
        let peers = Arc::new(Peers::default());
        let (a, b) = (key("192.0.2.1"), key("192.0.2.2"));
        let first = peers.try_add(a, 2).expect("room");
        let second = peers.try_add(a, 2).expect("room");
        assert!(peers.try_add(a, 2).is_none());
        assert!(peers.try_add(b, 2).is_some());
        drop(first);
        let third = peers.try_add(a, 2).expect("room again");
        drop((second, third));
        assert!(peers.counts.lock().expect("not poisoned").is_empty());
    }
}
