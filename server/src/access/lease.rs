//! What somebody was let in for, as long as it holds: tokens may be taken away while a session is open.

use std::sync::Arc;

use tokio::sync::watch;

use super::role::Role;
use super::token::TokenDigest;
use super::token_list::TokenEntry;

/// Somebody was let in for something that needs a role. Holds until the token is not known any more, or has a smaller role.
#[derive(Clone)]
pub(crate) struct Lease {
    known: watch::Receiver<Arc<[TokenEntry]>>,
    /// The token that was shown; none where none was needed.
    digest: Option<TokenDigest>,
    needed: Role,
}

impl Lease {
    pub(super) fn new(
        known: watch::Receiver<Arc<[TokenEntry]>>,
        digest: Option<TokenDigest>,
        needed: Role,
    ) -> Self {
        Self {
            known,
            digest,
            needed,
        }
    }

    /// Why it does not hold any more, if so.
    pub(crate) fn lost(&mut self) -> Option<&'static str> {
        let known = self.known.borrow_and_update();
        if known.is_empty() {
            return None;
        }
        let Some(digest) = &self.digest else {
            return Some("this server needs a token by now");
        };
        match known.iter().find(|entry| entry.digest.is(digest)) {
            None => Some("this token is not known any more"),
            Some(entry) if entry.role < self.needed => Some("this token's role has become smaller"),
            Some(_) => None,
        }
    }

    /// Waits until it does not hold any more; tells why.
    pub(crate) async fn ended(&mut self) -> &'static str {
        loop {
            if let Some(why) = self.lost() {
                return why;
            }
            if self.known.changed().await.is_err() {
                // The list is gone with the server.
                std::future::pending::<()>().await;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(role: Role, token: &str) -> TokenEntry {
        TokenEntry {
            role,
            name: token.to_owned(),
            digest: TokenDigest::of(token),
        }
    }

    fn lost(entries: &[TokenEntry], token: Option<&str>, needed: Role) -> bool {
        let (_sender, known) = watch::channel(entries.into());
        let mut lease = Lease::new(known, token.map(TokenDigest::of), needed);
        lease.lost().is_some()
    }

    #[test]
    fn a_lease_holds_as_long_as_its_token_has_the_role() {
        let known = [entry(Role::View, "a"), entry(Role::Admin, "b")];
        for (token, needed, is_lost) in [
            (Some("a"), Role::View, false),
            (Some("a"), Role::Steer, true),
            (Some("b"), Role::Steer, false),
            (Some("c"), Role::View, true),
            (None, Role::View, true),
        ] {
            assert_eq!(lost(&known, token, needed), is_lost, "{token:?} {needed}");
        }
        assert!(!lost(&[], None, Role::Admin));
        assert!(!lost(&[], Some("a"), Role::Admin));
    }
}
