//! The gate: whoever asks for something has to pass it.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use axum::extract::{Request, State};
use axum::http::header::{AUTHORIZATION, CONNECTION, RETRY_AFTER, WWW_AUTHENTICATE};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, Uri};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use skycell_protocol::message::ACCESS_TOKEN_MAX_BYTES;

use super::exposure::is_loopback;
use super::hosts::Hosts;
use super::lease::Lease;
use super::peer::{Peer, PeerKey, PeerPermit, Peers};
use super::rates::{PeerRate, retry_after_s};
use super::refusal::Refusal;
use super::role::{Role, Rule, rule_of};
use super::token_list::{TokenEntry, Tokens};
use crate::api::{Problem, is_page_path};
use crate::config::Config;
use crate::metrics::Metrics;

/// Keys of an address that mean a token to somebody.
const TOKEN_KEYS: &[&str] = &[
    "token",
    "access_token",
    "auth_token",
    "bearer",
    "authorization",
];

/// How many peers with too many wrong tokens are remembered.
const BLOCKED_MAX: usize = 16 * 1024;

/// WebSockets of one peer from elsewhere that may be between their upgrade and their hello. As long as they are, they
/// take the place of viewers, token or not.
const GREETING_OF_PEER_MAX: u32 = 16;

const MINUTE: Duration = Duration::from_secs(60);

/// Why a hello is refused.
#[derive(Debug)]
pub(crate) enum HelloRefusal {
    /// No token, or a wrong one.
    Unauthorized(&'static str),
    /// Too many wrong tokens; for so many seconds.
    Blocked(u64),
}

/// Knows tokens, limits and names, and refuses whoever does not keep to them.
pub struct Gate {
    tokens: Arc<Tokens>,
    hosts: Hosts,
    /// Nobody from elsewhere reaches it, by a proxy either.
    is_local: bool,
    requests: PeerRate,
    upgrades: PeerRate,
    failures: PeerRate,
    blocked: Mutex<HashMap<PeerKey, Instant>>,
    /// WebSockets that have not said hello, per peer.
    greeting: Arc<Peers>,
    /// Viewers per peer.
    viewers: Arc<Peers>,
    viewers_per_peer_max: u32,
    metrics: Arc<Metrics>,
}

impl Gate {
    /// The gate of a server with this configuration.
    pub fn new(config: &Config, tokens: Arc<Tokens>, metrics: Arc<Metrics>) -> Arc<Self> {
        let is_local = config.serves_this_machine_alone();
        let limits = config.limits.resolved(is_local);
        Arc::new(Self {
            tokens,
            is_local,
            hosts: Hosts {
                is_loopback: is_loopback(config.listen),
                allowed_hosts: config.allowed_hosts.clone(),
                allowed_origins: config.allowed_origins.clone(),
            },
            requests: PeerRate::new(
                limits.requests_per_s,
                Duration::from_secs(1),
                limits.requests_burst,
            ),
            upgrades: PeerRate::new(limits.upgrades_per_min, MINUTE, limits.upgrades_per_min),
            failures: PeerRate::new(
                limits.failed_tokens_per_min,
                MINUTE,
                limits.failed_tokens_per_min,
            ),
            blocked: Mutex::default(),
            greeting: Arc::default(),
            viewers: Arc::default(),
            viewers_per_peer_max: limits.viewers_per_peer_max,
            metrics,
        })
    }

    /// Counts a refusal that was not the gate's own.
    pub(crate) fn count(&self, refusal: Refusal) {
        self.metrics.refused(refusal);
    }

    /// Room for one more WebSocket of a peer that has not said hello yet.
    pub(crate) fn greet(&self, peer: PeerKey) -> Result<PeerPermit, Problem> {
        let max = if self.is_local {
            u32::MAX
        } else {
            GREETING_OF_PEER_MAX
        };
        self.greeting.try_add(peer, max).ok_or_else(|| {
            self.count(Refusal::Upgrades);
            too_many("too many WebSockets of this address have not said hello", 1)
        })
    }

    /// Room for one more viewer of a peer; else how many it has.
    pub(crate) fn admit(&self, peer: PeerKey) -> Result<PeerPermit, u32> {
        let permit = self.viewers.try_add(peer, self.viewers_per_peer_max);
        permit.ok_or_else(|| {
            self.count(Refusal::ViewersOfPeer);
            self.viewers_per_peer_max
        })
    }

    /// Lets in who says hello, as long as the token is known; without tokens everybody may everything.
    pub(crate) fn check_hello(
        &self,
        peer: PeerKey,
        token: Option<&str>,
    ) -> Result<Lease, HelloRefusal> {
        match self.holder_of(peer, token) {
            Ok(holder) => {
                if let Some(entry) = &holder {
                    tracing::debug!(role = %entry.role, holder = %entry.name, "a viewer's token is known");
                }
                Ok(self.lease(holder.as_ref(), Role::View))
            }
            Err((refusal, why)) => {
                self.count(refusal);
                Err(why)
            }
        }
    }

    fn lease(&self, holder: Option<&TokenEntry>, needed: Role) -> Lease {
        Lease::new(
            self.tokens.watch(),
            holder.map(|entry| entry.digest),
            needed,
        )
    }

    /// Lets a request pass, or says why not. Where a token is needed, tells for how long.
    fn check(&self, peer: Peer, request: &Request) -> Result<Option<Lease>, (Refusal, Problem)> {
        let (method, uri, headers) = (request.method(), request.uri(), request.headers());
        if peer.has_too_many_connections {
            let problem = too_many("this address has too many connections", 1)
                .with_header(CONNECTION, HeaderValue::from_static("close"));
            return Err((Refusal::Connections, problem));
        }
        self.requests.take(peer.key).map_err(|wait| {
            let problem = too_many("too many requests of this address", retry_after_s(wait));
            (Refusal::Requests, problem)
        })?;
        self.hosts.check_host(request.version(), headers)?;
        check_address(uri)?;
        if !matches!(*method, Method::GET | Method::HEAD) || uri.path() == "/ws" {
            self.hosts.check_origin(headers)?;
        }
        if uri.path() == "/ws" {
            self.upgrades.take(peer.key).map_err(|wait| {
                let what = "too many WebSockets were opened from this address";
                (Refusal::Upgrades, too_many(what, retry_after_s(wait)))
            })?;
        }
        self.check_role(peer.key, method, uri.path(), headers)
    }

    fn check_role(
        &self,
        peer: PeerKey,
        method: &Method,
        path: &str,
        headers: &HeaderMap,
    ) -> Result<Option<Lease>, (Refusal, Problem)> {
        let Rule::Needs(needed) = rule_of(method, path, is_page_path(path)) else {
            return Ok(None);
        };
        let token = bearer_of(headers);
        let holder = self.holder_of(peer, token).map_err(|(refusal, why)| {
            let problem = match why {
                HelloRefusal::Unauthorized(why) => unauthorized(token.is_some(), why),
                HelloRefusal::Blocked(seconds) => too_many("too many wrong tokens", seconds),
            };
            (refusal, problem)
        })?;
        match &holder {
            Some(entry) if entry.role < needed => {
                Err((Refusal::Role, forbidden(entry.role, needed)))
            }
            _ => Ok(Some(self.lease(holder.as_ref(), needed))),
        }
    }

    /// Whose a token is; nobody's where none is needed.
    fn holder_of(
        &self,
        peer: PeerKey,
        token: Option<&str>,
    ) -> Result<Option<TokenEntry>, (Refusal, HelloRefusal)> {
        if self.tokens.is_empty() {
            return Ok(None);
        }
        let Some(token) = token else {
            let why = "this server needs a token";
            return Err((Refusal::NoToken, HelloRefusal::Unauthorized(why)));
        };
        // Before the comparison: who is blocked learns nothing more, not even from a right guess.
        if let Some(wait) = self.blocked_for(peer) {
            let seconds = retry_after_s(wait);
            return Err((Refusal::FailedTokens, HelloRefusal::Blocked(seconds)));
        }
        let holder = (token.len() <= ACCESS_TOKEN_MAX_BYTES)
            .then(|| self.tokens.holder(token))
            .flatten();
        if holder.is_some() {
            return Ok(holder);
        }
        match self.failures.take(peer) {
            Ok(()) => {
                let why = "this token is not known";
                Err((Refusal::WrongToken, HelloRefusal::Unauthorized(why)))
            }
            Err(wait) => {
                self.block(peer, wait);
                let seconds = retry_after_s(wait);
                Err((Refusal::FailedTokens, HelloRefusal::Blocked(seconds)))
            }
        }
    }

    fn blocked_for(&self, peer: PeerKey) -> Option<Duration> {
        let mut blocked = self.blocked.lock().unwrap_or_else(PoisonError::into_inner);
        let until = *blocked.get(&peer)?;
        let wait = until.saturating_duration_since(Instant::now());
        if wait.is_zero() {
            blocked.remove(&peer);
            return None;
        }
        Some(wait)
    }

    fn block(&self, peer: PeerKey, wait: Duration) {
        let now = Instant::now();
        let mut blocked = self.blocked.lock().unwrap_or_else(PoisonError::into_inner);
        if blocked.len() >= BLOCKED_MAX {
            blocked.retain(|_, until| *until > now);
        }
        // With no room it is refused all the same when it tries again: its bucket is empty.
        if blocked.len() < BLOCKED_MAX {
            blocked.insert(peer, now + wait);
        }
    }
}

/// Lets requests pass the gate, or answers why not.
pub(crate) async fn pass(
    State(gate): State<Arc<Gate>>,
    mut request: Request,
    next: Next,
) -> Response {
    // Every connection of the service has one; without it nobody could be told apart.
    let Some(peer) = request.extensions().get::<Peer>().copied() else {
        return Problem::new(StatusCode::INTERNAL_SERVER_ERROR, "the peer is not known")
            .into_response();
    };
    match gate.check(peer, &request) {
        Ok(lease) => {
            if let Some(lease) = lease {
                request.extensions_mut().insert(lease);
            }
            next.run(request).await
        }
        Err((refusal, problem)) => {
            gate.count(refusal);
            tracing::debug!(reason = refusal.name(), "a request is refused");
            problem.into_response()
        }
    }
}

/// A token in an address is in histories, in logs of proxies and in `Referer` headers: it is no secret any more.
fn check_address(uri: &Uri) -> Result<(), (Refusal, Problem)> {
    let has_token = uri.query().is_some_and(|query| {
        query.split('&').any(|pair| {
            let key = pair.split('=').next().unwrap_or_default();
            TOKEN_KEYS
                .iter()
                .any(|known| known.eq_ignore_ascii_case(key))
        })
    });
    if !has_token {
        return Ok(());
    }
    let detail = "a token does not belong in an address, where others can read it; treat this one as known to others. \
                  Send it in the header Authorization: Bearer, or as token in the hello of a WebSocket";
    Err((
        Refusal::TokenInUrl,
        Problem::new(StatusCode::BAD_REQUEST, detail),
    ))
}

/// The token of `Authorization: Bearer`.
fn bearer_of(headers: &HeaderMap) -> Option<&str> {
    let value = headers.get(AUTHORIZATION)?.to_str().ok()?;
    let (scheme, token) = value.split_once(' ')?;
    scheme.eq_ignore_ascii_case("bearer").then(|| token.trim())
}

fn too_many(what: &str, seconds: u64) -> Problem {
    let detail = format!("{what}; try again in {seconds} s");
    let problem = Problem::new(StatusCode::TOO_MANY_REQUESTS, detail);
    match HeaderValue::try_from(seconds.to_string()) {
        Ok(value) => problem.with_header(RETRY_AFTER, value),
        Err(_) => problem,
    }
}

/// RFC 6750, section 3.
fn unauthorized(has_token: bool, why: &str) -> Problem {
    let challenge = if has_token {
        "Bearer realm=\"skycell\", error=\"invalid_token\""
    } else {
        "Bearer realm=\"skycell\""
    };
    Problem::new(
        StatusCode::UNAUTHORIZED,
        format!("{why}; send it in the header Authorization: Bearer"),
    )
    .with_header(WWW_AUTHENTICATE, HeaderValue::from_static(challenge))
}

fn forbidden(role: Role, needed: Role) -> Problem {
    let challenge = match needed {
        Role::View => "Bearer realm=\"skycell\", error=\"insufficient_scope\", scope=\"view\"",
        Role::Steer => "Bearer realm=\"skycell\", error=\"insufficient_scope\", scope=\"steer\"",
        Role::Admin => "Bearer realm=\"skycell\", error=\"insufficient_scope\", scope=\"admin\"",
    };
    Problem::new(
        StatusCode::FORBIDDEN,
        format!("this needs a token with the role {needed}; yours has the role {role}"),
    )
    .with_role_needed(needed)
    .with_header(WWW_AUTHENTICATE, HeaderValue::from_static(challenge))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_token_in_an_address_is_found_however_it_is_written() {
        for (uri, has_token) in [
            ("/ws?token=a", true),
            ("/ws?x=1&access_token=a", true),
            ("/api/v1/scene?Token=a", true),
            ("/ws?token", true),
            ("/ws?tokens=a", false),
            ("/ws?x=token", false),
            ("/ws", false),
        ] {
            let uri: Uri = uri.parse().expect("an address");
            assert_eq!(check_address(&uri).is_err(), has_token, "{uri}");
        }
    }

    #[test]
    fn a_bearer_token_is_read_whatever_the_case_of_its_scheme() {
        for (value, token) in [
            ("Bearer abc", Some("abc")),
            ("bearer  abc ", Some("abc")),
            ("Basic abc", None),
            ("Bearer", None),
            ("", None),
        ] {
            let mut headers = HeaderMap::new();
            headers.insert(AUTHORIZATION, value.parse().expect("a header"));
            assert_eq!(bearer_of(&headers), token, "{value}");
        }
    }
}
