//! Who may do what: roles, tokens, hosts and origins, and how much one peer may ask for.
//!
//! [`Gate`] holds all of it and is asked in two places: before a request reaches its route, and when a viewer has said
//! hello. Nothing else in the service knows of tokens.

mod exposure;
mod gate;
mod hosts;
mod lease;
mod log_guard;
mod peer;
mod proxies;
mod rates;
mod refusal;
mod role;
mod secret_file;
mod token;
mod token_list;

pub use exposure::{ExposureError, check_exposure};
pub use gate::Gate;
pub(crate) use gate::{HelloRefusal, pass};
pub(crate) use lease::Lease;
pub use log_guard::holds_no_secret;
pub use peer::{Peer, PeerKey};
pub(crate) use peer::{PeerPermit, Peers};
pub use proxies::{PROXIES_MAX, ProxyHeader, ProxyNet, TrustedProxies};
pub use refusal::Refusal;
pub use role::{Role, Rule, rule_of};
pub use secret_file::SecretFileError;
pub(crate) use secret_file::check_secret_file;
pub use token::{TOKEN_PREFIX, Token, TokenDigest};
pub use token_list::{LINE_FORM, TokenEntry, TokenListError, Tokens, is_name};
